"""Exact motion of body and phone: everything is built on a fine grid and then read from one quintic spline.

World frame: east, north, up. Body frame: right, forward, up; at heading 0 it is the world frame. The phone's attitude
is R = Rz(a) Rx(b) Ry(c) Rx(p) Ry(r) Rz(t), sensor to world: a = -heading plus yaw, b, c what a stride turns the phone
by in the body frame, and p, r, t how it is carried. Specific force R^T (p'' + g up) and angular rate come from the
derivatives of the same spline, so they agree with position and attitude to rounding.

What a stride does to the phone are the harmonics of `strides`: displacements, the measured specific force divided by
minus its squared frequency, and angles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from pdr_filter.simulate.gait import CONTEXT_GAITS, FORCE_POWER, Gait, Leg, StepPlan, nominal_step
from pdr_filter.simulate.strides import FORCE, N_HARMONICS, TURN, Strides, of_person, usual_force_mps2, waveform
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, interpolated

GRID_HZ = 1000.0
# The grid begins and ends this much outside the walk, so that every sensor's clock may.
MARGIN_S = 0.25
CONTEXT_BLEND_S = 1.0
CARRYING_BLEND_S = 1.2
# Root mean square of a hand that holds a phone still: it nods more than it tilts or turns.
STILL_HAND_RADPS, STILL_HAND_MPS = (0.07, 0.025, 0.025), 0.0025
RIDE_RAMP_S = 1.5  # of a lift to its speed: 1 m/s with 0.7 m/s2
TURN_RATE_RADPS = 1.3  # mean; the peak of a minimum-jerk turn is 1.9 times higher
# Parts of a step from a contact to where the vertical force at step frequency is highest. Oxford: 0.02 to 0.11 before
# the foot's switch was read, which is every 0.1 s and so 0.09 late on average.
LAG = 0.03
# The blow of the heel: harmonics from three times the step frequency.
IMPACT = 5


@dataclass(frozen=True, slots=True)
class Carrying:
    """Where a phone is, how it lies there, and whose strides it makes.

    The mean attitude is Rx(pitch) Ry(roll) Rz(twist), sensor to body frame: zeros are a phone that lies level, screen
    up, its top end ahead.
    """

    place: tuple[float, float, float]  # body frame, from the ground under the person, in parts of the body height
    strides: str = "texting"  # a place of `strides`: texting, calling, swinging, pocket, back_pocket
    pitch_rad: float = 0.0
    roll_rad: float = 0.0
    twist_rad: float = 0.0
    side: float = 1.0  # -1: the left hand or pocket
    force: float = 1.0  # what arrives of the vertical force of the steps in walking
    turn: float = 1.0  # how far it turns in a stride, likewise
    loose: float = 1.0  # how much its strides differ, likewise
    tremor: float = 1.0


CARRYING: dict[str, Carrying] = {
    "texting": Carrying(place=(0.0, 0.19, 0.72), force=1.15, turn=1.15),
    "pocket": Carrying(place=(0.08, 0.04, 0.4), strides="pocket", pitch_rad=-np.pi / 2, force=1.45),
    "swinging": Carrying(place=(0.12, 0.03, 0.42), strides="swinging", roll_rad=np.pi / 2, force=1.1),
    "calling": Carrying(place=(0.05, 0.03, 0.93), strides="calling", pitch_rad=1.2, roll_rad=-1.4, force=1.1),
}

# Axes of the six angles, in the order of their rotations.
_AXES = "ZXYXYZ"


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Exact motion of the phone as a function of time, and of the body on a grid."""

    plan: StepPlan
    spline: BSpline  # phone east, north, up and the six angles
    grid_s: FloatArray  # (N,)
    body_position_m: FloatArray  # (N, 3) east, north, height of the ground under the person
    heading_rad: FloatArray  # (N,) direction the body faces, clockwise from north, unwrapped

    def position_m(self, time_s: FloatArray) -> FloatArray:
        """Phone: east, north, up, (N, 3)."""
        return self.spline(time_s)[:, :3]

    def rotation(self, time_s: FloatArray) -> Rotation:
        """Phone: sensor-to-world rotations, N of them."""
        angles = self.spline(time_s)[:, 3:]
        return Rotation.from_euler(_AXES[:3], angles[:, :3]) * Rotation.from_euler(_AXES[3:], angles[:, 3:])

    def specific_force_mps2(self, time_s: FloatArray) -> FloatArray:
        """R^T (p'' + g up) in the sensor frame, (N, 3)."""
        force_enu = self.spline(time_s, 2)[:, :3] + np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])
        return self.rotation(time_s).inv().apply(force_enu)

    def angular_rate_radps(self, time_s: FloatArray) -> FloatArray:
        """Angular rate in the sensor frame, (N, 3): the rates of the six angles, each turned by the later ones."""
        angles, rates = self.spline(time_s)[:, 3:], self.spline(time_s, 1)[:, 3:]
        rate = np.zeros((len(rates), 3))
        for k, axis in enumerate(_AXES):
            rate = _about(axis, angles[:, k]).inv().apply(rate)
            rate[:, "XYZ".index(axis)] += rates[:, k]
        return rate

    def body_at(self, time_s: FloatArray) -> FloatArray:
        """Body: east, north, height of the ground, (N, 3)."""
        return interpolated(time_s, self.grid_s, self.body_position_m)


def _about(axis: str, angle_rad: FloatArray) -> Rotation:
    """Rotations about one axis by angles of shape (N,)."""
    return Rotation.from_euler(axis, angle_rad[:, None])


def smoothstep(u: FloatArray) -> FloatArray:
    """Minimum-jerk rise from 0 to 1 over u in [0, 1]; two continuous derivatives."""
    u = np.clip(u, 0.0, 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2)


def through_contacts(time_s: FloatArray, plan: StepPlan, increment: FloatArray) -> FloatArray:
    """Values, (N,), of a smooth function that grows by `increment[k]` during step k.

    Quintic Hermite pieces with zero second derivative at the contacts; standstill at both ends of a bout.
    """
    total = np.concatenate([[0.0], np.cumsum(increment)])
    if len(increment) == 0:
        return np.zeros_like(time_s)
    duration = plan.contact_s - plan.start_s
    rate_in = np.zeros(len(increment))
    rate_in[1:] = (increment[1:] + increment[:-1]) / (duration[1:] + duration[:-1])
    rate_in[plan.first] = 0.0
    rate_out = np.append(rate_in[1:], 0.0)

    k = np.minimum(np.searchsorted(plan.contact_s, time_s), len(increment) - 1)
    h = duration[k]
    u = np.clip((time_s - plan.start_s[k]) / h, 0.0, 1.0)
    d, a, b = increment[k], h * rate_in[k], h * rate_out[k]
    c3, c4, c5 = 10 * d - 6 * a - 4 * b, -15 * d + 8 * a + 7 * b, 6 * d - 3 * a - 3 * b
    return total[k] + u * (a + u**2 * (c3 + u * (c4 + u * c5)))


Blend = Callable[[Sequence[float]], FloatArray]


def leg_blend(time_s: FloatArray, plan: StepPlan, legs: Sequence[Leg], width_s: float) -> Blend:
    """Function that turns one value for each leg into a smooth course over time.

    A change happens at the start of the new leg, but is done by its start when a person stops: then nothing moves in
    the stationary leg.
    """
    lower = np.minimum(np.searchsorted(plan.leg_end_s, time_s, side="right"), len(legs) - 1)
    upper = lower.copy()
    share = np.zeros(len(time_s))
    duration_s = plan.leg_end_s - plan.leg_start_s
    for k in range(1, len(legs)):
        width = min(width_s, 0.5 * duration_s[k - 1], 0.5 * duration_s[k])
        begin_s = plan.leg_start_s[k] - (width if legs[k - 1].moves and not legs[k].moves else 0.0)
        part = slice(*np.searchsorted(time_s, [begin_s, begin_s + width]))
        lower[part], upper[part] = k - 1, k
        share[part] = smoothstep((time_s[part] - begin_s) / width)

    def blend(values: Sequence[float]) -> FloatArray:
        value = np.asarray(values, dtype=float)
        return value[lower] + (value[upper] - value[lower]) * share

    return blend


def heading_course(
    time_s: FloatArray, plan: StepPlan, legs: Sequence[Leg], start_heading_rad: float
) -> tuple[FloatArray, FloatArray]:
    """Heading the body faces and heading of travel, clockwise from north, unwrapped, both (N,)."""
    facing = np.full(len(time_s), start_heading_rad)
    for leg, start_s, end_s in zip(legs, plan.leg_start_s, plan.leg_end_s, strict=True):
        if leg.turn_rad:
            wanted_s = max(0.8, abs(leg.turn_rad) / TURN_RATE_RADPS)
            turn_s = end_s - start_s if leg.curve else min(wanted_s, end_s - start_s)
            facing += leg.turn_rad * smoothstep((time_s - start_s) / turn_s)
    at_leg = np.minimum(np.searchsorted(plan.leg_end_s, time_s), len(legs) - 1)
    return facing, facing + np.array([leg.travel_offset_rad for leg in legs])[at_leg]


def progress_m(time_s: FloatArray, plan: StepPlan) -> FloatArray:
    """Way of the body, (N,), through the sum of the step lengths at every contact; smooth over a whole bout.

    Setting off takes some steps: pieces from contact to contact would push anew in each.
    """
    way = np.zeros_like(time_s)
    begins, ends = np.flatnonzero(plan.first), np.flatnonzero(plan.last) + 1
    for i, j in zip(begins, ends, strict=True):
        at_s = np.append(plan.start_s[i], plan.contact_s[i:j])
        way_m = np.append(0.0, np.cumsum(plan.length_m[i:j]))
        rest = [(1, 0.0), (2, 0.0)]
        spline = make_interp_spline(at_s, way_m, k=5, bc_type=(rest, rest))
        way += np.where(time_s < at_s[-1], spline(np.clip(time_s, at_s[0], at_s[-1])), way_m[-1])
    return way


def body_path(time_s: FloatArray, plan: StepPlan, travel_rad: FloatArray) -> FloatArray:
    """East, north and height of the ground under the person, (N, 3)."""
    progress = progress_m(time_s, plan)
    middle = 0.5 * (travel_rad[1:] + travel_rad[:-1])
    east, north = (np.append(0.0, np.cumsum(np.diff(progress) * f(middle))) for f in (np.sin, np.cos))
    return np.stack([east, north, through_contacts(time_s, plan, plan.rise_m)], axis=1)


def rides(time_s: FloatArray, plan: StepPlan, legs: Sequence[Leg], travel_rad: FloatArray) -> FloatArray:
    """East, north and up that lifts and escalators move the person by, (N, 3): steadily but for start and stop."""
    moved = np.zeros((len(time_s), 3))
    for leg, start_s, end_s in zip(legs, plan.leg_start_s, plan.leg_end_s, strict=True):
        if leg.ride_up_m or leg.ride_m:
            ramp_s = min(RIDE_RAMP_S, 0.5 * (end_s - start_s))
            speed = smoothstep((time_s - start_s) / ramp_s) * smoothstep((end_s - time_s) / ramp_s)
            share = speed / speed.sum()
            ahead = leg.ride_m * share
            moved += np.column_stack([ahead * np.sin(travel_rad), ahead * np.cos(travel_rad), leg.ride_up_m * share])
    return np.cumsum(moved, axis=0)


def tremor(time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Irregular course, (N,), whose rate has a root mean square of one; 0.3 to 6 Hz."""
    frequency_hz = np.geomspace(0.3, 6.0, 8) * rng.uniform(0.85, 1.15, 8)
    phase = rng.uniform(0.0, 2 * np.pi, 8)
    amplitude = np.sqrt(2 / 8) / (2 * np.pi * frequency_hz)
    return sum(
        (a * np.sin(2 * np.pi * f * time_s + p) for a, f, p in zip(amplitude, frequency_hz, phase, strict=True)),
        start=np.zeros(len(time_s)),
    )


def build_motion(
    legs: Sequence[Leg],
    places: Sequence[tuple[str, Carrying]],
    gait: Gait,
    plan: StepPlan,
    rng: np.random.Generator,
    start_heading_rad: float,
) -> Motion:
    """Motion of body and phone along the planned steps.

    `places` has for each leg the carrying mode and where the phone is then.
    """
    n = round((plan.leg_end_s[-1] + 2 * MARGIN_S) * GRID_HZ) + 1
    time_s = np.arange(n) / GRID_HZ - MARGIN_S
    carrying = [place for _, place in places]
    facing, travel = heading_course(time_s, plan, legs, start_heading_rad)
    body = body_path(time_s, plan, travel) + rides(time_s, plan, legs, travel)
    moved, turned = _of_strides(time_s, plan, legs, carrying, gait, rng)
    blend = leg_blend(time_s, plan, legs, CONTEXT_BLEND_S)
    tremor_size = blend([CONTEXT_GAITS[leg.context].tremor * c.tremor for leg, c in zip(legs, carrying, strict=True)])
    for k in range(3):
        turned[:, k] += STILL_HAND_RADPS[k] * gait.tremor_factor * tremor_size * tremor(time_s, rng)
        moved[:, k] += STILL_HAND_MPS * gait.tremor_factor * tremor_size * tremor(time_s, rng)
    turned[:, 2] -= facing
    slow = leg_blend(time_s, plan, legs, CARRYING_BLEND_S)
    at = np.column_stack([slow([gait.height_m * c.place[k] for c in carrying]) for k in range(3)])
    pitches = [gait.tilt_rad if mode == "texting" else c.pitch_rad for mode, c in places]
    held = [slow(pitches), slow([c.roll_rad for c in carrying]), slow([c.twist_rad for c in carrying])]
    position = body + _about("Z", -facing).apply(at + moved)
    spline = make_interp_spline(time_s, np.column_stack([position, turned[:, [2, 0, 1]], *held]), k=5)
    return Motion(plan, spline, time_s, body, facing)


def _of_strides(
    time_s: FloatArray,
    plan: StepPlan,
    legs: Sequence[Leg],
    carrying: Sequence[Carrying],
    gait: Gait,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """What strides do to the phone in the body frame: displacements right, forward, up and pitch, roll, yaw, (N, 3)."""
    # The right foot lands at even numbers of steps, half of them strides.
    stride = 0.5 * (through_contacts(time_s, plan, np.ones(len(plan.leg))) - LAG)
    course = np.zeros((len(time_s), 6))
    for k, (leg, place) in enumerate(zip(legs, carrying, strict=True)):
        if not leg.moves:
            continue
        own = leg_strides(leg, place, gait)
        around = [plan.leg_start_s[k] - CONTEXT_BLEND_S, plan.leg_end_s[k] + CONTEXT_BLEND_S]
        begin, end = np.searchsorted(time_s, around)
        share = leg_blend(time_s[begin:end], plan, legs, CONTEXT_BLEND_S)([float(i == k) for i in range(len(legs))])
        part = stride[begin:end]
        first, last = int(np.floor(part[0])), int(np.floor(part[-1]))
        differences = place.loose * own.differences(rng, last - first + 2)
        course[begin:end] += share[:, None] * waveform(part, own.people[0], differences, first)
    return course[:, FORCE], course[:, TURN]


def leg_strides(leg: Leg, place: Carrying, gait: Gait) -> Strides:
    """Harmonics of a person on a leg as displacements, m, and angles, rad."""
    own = of_person(place.strides, leg.context, gait.habit, place.side)
    frequency_hz, length_m = nominal_step(leg, gait)
    usual_mps2 = usual_force_mps2(place.strides, leg.context)
    force = gait.vertical_force_mps2(leg.context, frequency_hz, length_m, usual_mps2)
    force *= float(own.amplitude_mps2[0] / usual_mps2) ** FORCE_POWER
    force *= place.force if leg.context == "walking" else 1.0
    usual_m = gait.step_length_m(leg.context, gait.step_frequency_hz(leg.context))
    number = np.arange(1, N_HARMONICS + 1)
    blow = np.where(number >= IMPACT, gait.impact_factor, 1.0)
    scale = np.empty((N_HARMONICS, 6))
    scale[:, FORCE] = (-force * blow / (np.pi * frequency_hz * number) ** 2)[:, None]
    scale[:, TURN] = place.turn * gait.swing_factor * np.sqrt(length_m / usual_m)
    return own.scaled(scale)
