"""Exact motion of body and phone, computed on a fine grid and represented by one quintic spline.

World frame: east, north, up. Body frame: right, forward, up; at heading 0 it equals the world frame. The attitude of
the phone is R = Rz(a) Rx(b) Ry(c) Rx(p) Ry(r) Rz(t), from the sensor frame to the world frame. The angles p, r and t
(pitch, roll, twist) are the mean attitude in which the phone is carried. Each stride rocks the phone about this
attitude, by the pitch b, the roll c and a yaw in the body frame. The angle a is this yaw minus the heading. Let x be
the position of the phone and g standard gravity. Specific force R^T (x'' + g up) and angular rate are derivatives of
the same spline, so that they agree with position and attitude except for rounding.

The periodic motion of the phone in a stride is the sum of the harmonics in `strides`. The harmonics of the displacement
are those of the measured specific force divided by minus the squared angular frequency.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from pdr_filter.simulate.gait import CONTEXT_GAITS, FORCE_POWER, Gait, Leg, StepPlan, nominal_step
from pdr_filter.simulate.strides import FORCE, N_HARMONICS, TURN, Strides, of_person, usual_force_mps2, waveform
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, interpolated_rows

GRID_HZ = 1000.0
# The grid extends this far beyond the walk, because the sensors have different clocks.
MARGIN_S = 0.25
CONTEXT_BLEND_S = 1.0
CARRYING_BLEND_S = 1.2
# Root mean square motion of a hand that holds a phone still. Pitch varies more than roll and yaw.
STILL_HAND_RADPS, STILL_HAND_MPS = (0.07, 0.025, 0.025), 0.0025
RIDE_RAMP_S = 1.5  # time in which a lift reaches its speed: 1 m/s at 0.7 m/s2
TURN_RATE_RADPS = 1.3  # mean; the peak of a minimum-jerk turn is 1.9 times higher
# Part of a step from a contact to the maximum of the vertical force at step frequency. In the Oxford data set the
# maximum is 0.02 to 0.11 before the reading of the foot switch. The switch is read every 0.1 s, so 0.09 late on
# average.
LAG = 0.03
# First stride harmonic that belongs to the heel strike. The sixth has three times the step frequency.
IMPACT = 5


@dataclass(frozen=True, slots=True)
class Carrying:
    """Place and attitude of a carried phone, and the strides that move it.

    The mean attitude is Rx(pitch) Ry(roll) Rz(twist), from the sensor frame to the body frame. With zero angles the
    phone lies level, with the screen up and its top end forwards.

    Attributes
    ----------
    place : tuple of float
        Position (right, forward, up) in the body frame relative to the ground under the person, in parts of the body
        height.
    strides : {"texting", "calling", "swinging", "pocket", "back_pocket"}, default "texting"
        Placement whose measured strides move the phone.
    pitch_rad, roll_rad, twist_rad : float, default 0.0
        Angles of the mean attitude in rad. In the mode "texting" the pitch is `Gait.tilt_rad` instead.
    side : float, default 1.0
        +1 for the right hand or pocket, -1 for the left one.
    force, turn, loose, tremor : float, default 1.0
        Factors of the vertical force of the steps that reaches the phone in walking, of the rotation of the phone in a
        stride, of the differences between strides, and of the irregular motion.

    Examples
    --------
    >>> from pdr_filter.simulate import Carrying, Leg, simulate
    >>> chest = Carrying(place=(0.05, 0.1, 0.72), pitch_rad=1.5)
    >>> walk = simulate([Leg("stationary", duration_s=2.0)], carrying_mode="chest", carrying={"chest": chest})
    >>> walk.truth.labels.carrying_mode
    array(['chest'], dtype='<U5')
    """

    place: tuple[float, float, float]
    strides: str = "texting"
    pitch_rad: float = 0.0
    roll_rad: float = 0.0
    twist_rad: float = 0.0
    side: float = 1.0
    force: float = 1.0
    turn: float = 1.0
    loose: float = 1.0
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
    """Exact motion of the phone as a function of time, and of the body on a grid.

    Attributes
    ----------
    plan, spline : StepPlan and BSpline
        All steps of the walk. Position (east, north, up) and the six angles of the phone.
    grid_s, body_position_m, heading_rad : (N,), (N, 3) and (N,) array
        Times of the grid, east, north and height of the ground under the person, and heading that the body faces,
        clockwise from north, unwrapped.
    """

    plan: StepPlan
    spline: BSpline
    grid_s: FloatArray
    body_position_m: FloatArray
    heading_rad: FloatArray

    def position_m(self, time_s: FloatArray) -> FloatArray:
        """Return the position of the phone (east, north, up) at some times, (N, 3), m."""
        return self.spline(time_s)[:, :3]

    def rotation(self, time_s: FloatArray) -> Rotation:
        """Return the rotations of the phone from the sensor frame to the world frame at N times."""
        angles = self.spline(time_s)[:, 3:]
        return Rotation.from_euler(_AXES[:3], angles[:, :3]) * Rotation.from_euler(_AXES[3:], angles[:, 3:])

    def specific_force_mps2(self, time_s: FloatArray) -> FloatArray:
        """Return the specific force R^T (p'' + g up) in the sensor frame, (N, 3), in m/s2."""
        force_enu = self.spline(time_s, 2)[:, :3] + np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])
        return self.rotation(time_s).inv().apply(force_enu)

    def angular_rate_radps(self, time_s: FloatArray) -> FloatArray:
        """Return the angular rate in the sensor frame, (N, 3), rad/s: the rates of the six angles, rotated."""
        angles, rates = self.spline(time_s)[:, 3:], self.spline(time_s, 1)[:, 3:]
        rate = np.zeros((len(rates), 3))
        for k, axis in enumerate(_AXES):
            rate = _about(axis, angles[:, k]).inv().apply(rate)
            rate[:, "XYZ".index(axis)] += rates[:, k]
        return rate

    def body_at(self, time_s: FloatArray) -> FloatArray:
        """Return the position of the body (east, north, height of the ground) at some times, (N, 3), m."""
        return interpolated_rows(time_s, self.grid_s, self.body_position_m)


def _about(axis: str, angle_rad: FloatArray) -> Rotation:
    """Return rotations about one axis by angles (N,)."""
    return Rotation.from_euler(axis, angle_rad[:, None])


def smoothstep(u: FloatArray) -> FloatArray:
    """Return a minimum-jerk rise from 0 to 1 for u in [0, 1], with two continuous derivatives."""
    u = np.clip(u, 0.0, 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2)


def through_contacts(time_s: FloatArray, plan: StepPlan, increment: FloatArray) -> FloatArray:
    """Return values (N,) of a smooth function that increases by `increment[k]` during step k.

    It consists of quintic Hermite pieces with zero second derivative at the contacts, and zero first at the ends of a
    bout.
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
    """Return a function that converts one value for each leg (stretch of the walk) into a smooth function of time.

    A change of `width_s` begins at the start of the new leg, or ends there if the person stops.
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
    """Return the heading of the body and the heading of travel, clockwise from north, unwrapped, each (N,)."""
    facing = np.full(len(time_s), start_heading_rad)
    for leg, start_s, end_s in zip(legs, plan.leg_start_s, plan.leg_end_s, strict=True):
        if leg.turn_rad:
            wanted_s = max(0.8, abs(leg.turn_rad) / TURN_RATE_RADPS)
            turn_s = end_s - start_s if leg.curve else min(wanted_s, end_s - start_s)
            facing += leg.turn_rad * smoothstep((time_s - start_s) / turn_s)
    at_leg = np.minimum(np.searchsorted(plan.leg_end_s, time_s), len(legs) - 1)
    return facing, facing + np.array([leg.travel_offset_rad for leg in legs])[at_leg]


def progress_m(time_s: FloatArray, plan: StepPlan) -> FloatArray:
    """Return the distance walked by the body (N,), which equals the sum of the step lengths at every contact.

    One spline covers a whole bout, because setting off takes several steps.
    """
    progress = np.zeros_like(time_s)
    begins, ends = np.flatnonzero(plan.first), np.flatnonzero(plan.last) + 1
    for i, j in zip(begins, ends, strict=True):
        at_s = np.append(plan.start_s[i], plan.contact_s[i:j])
        distance_m = np.append(0.0, np.cumsum(plan.length_m[i:j]))
        rest = [(1, 0.0), (2, 0.0)]
        spline = make_interp_spline(at_s, distance_m, k=5, bc_type=(rest, rest))
        progress += np.where(time_s < at_s[-1], spline(np.clip(time_s, at_s[0], at_s[-1])), distance_m[-1])
    return progress


def body_path(time_s: FloatArray, plan: StepPlan, travel_rad: FloatArray) -> FloatArray:
    """Return east, north, and height of the ground under the person at some times, (N, 3), m."""
    progress = progress_m(time_s, plan)
    middle = 0.5 * (travel_rad[1:] + travel_rad[:-1])
    east, north = (np.append(0.0, np.cumsum(np.diff(progress) * f(middle))) for f in (np.sin, np.cos))
    return np.stack([east, north, through_contacts(time_s, plan, plan.rise_m)], axis=1)


def rides(time_s: FloatArray, plan: StepPlan, legs: Sequence[Leg], travel_rad: FloatArray) -> FloatArray:
    """Return the displacement (east, north, up) by lifts and escalators, (N, 3). Their speed is mostly constant."""
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
    """Return an irregular function of time (N,) from 0.3 to 6 Hz, whose derivative has a root mean square of one."""
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
    """Return the motion along the planned steps. `places` has carrying mode and place of the phone for each leg."""
    n = round((plan.leg_end_s[-1] + 2 * MARGIN_S) * GRID_HZ) + 1
    time_s = np.arange(n) / GRID_HZ - MARGIN_S
    carrying = [place for _, place in places]
    facing, travel = heading_course(time_s, plan, legs, start_heading_rad)
    body = body_path(time_s, plan, travel) + rides(time_s, plan, legs, travel)
    moved, turned = _stride_motion(time_s, plan, legs, carrying, gait, rng)
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


def _stride_motion(
    time_s: FloatArray,
    plan: StepPlan,
    legs: Sequence[Leg],
    carrying: Sequence[Carrying],
    gait: Gait,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Return displacement (right, forward, up) and rotation (pitch, roll, yaw) of the phone by strides, (N, 3) each."""
    # stride number: the right foot lands at integers
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
    """Return the stride harmonics of a person on a leg, as displacements in m and angles in rad."""
    own = of_person(place.strides, leg.context, gait.habit, place.side)
    frequency_hz, length_m = nominal_step(leg, gait)
    usual_mps2 = usual_force_mps2(place.strides, leg.context)
    force = gait.vertical_force_mps2(leg.context, frequency_hz, length_m, usual_mps2)
    force *= float(own.amplitude_mps2[0] / usual_mps2) ** FORCE_POWER
    force *= place.force if leg.context == "walking" else 1.0
    usual_m = gait.step_length_m(leg.context, gait.step_frequency_hz(leg.context))
    number = np.arange(1, N_HARMONICS + 1)
    impact = np.where(number >= IMPACT, gait.impact_factor, 1.0)
    scale = np.empty((N_HARMONICS, 6))
    scale[:, FORCE] = (-force * impact / (np.pi * frequency_hz * number) ** 2)[:, None]
    scale[:, TURN] = place.turn * gait.swing_factor * np.sqrt(length_m / usual_m)
    return own.scaled(scale)
