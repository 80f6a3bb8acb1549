"""Exact motion of body and phone: everything is built on a fine grid and then read from one quintic spline.

World frame: east, north, up. Body frame: right, forward, up; at heading 0 it is the world frame. The phone's attitude
is R = Rz(a) Rx(b) Ry(c) Rz(d), sensor to world, with a = -heading plus trunk rotation, b the pitch (of the limb, if one
carries the phone), c and d the rest. Specific force R^T (p'' + g up) and angular rate come from the derivatives of the
same spline, so they agree with position and attitude to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from pdr_filter.simulate.gait import CONTEXT_GAITS, Gait, Leg, StepPlan, nominal_step
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray

GRID_HZ = 1000.0
# The grid begins and ends this much outside the walk, so that every sensor's clock may.
MARGIN_S = 0.25
CONTEXT_BLEND_S = 0.5
CARRYING_BLEND_S = 1.2
KNOCK_RADPM = 5.0  # angular acceleration by which the phone rocks, for each m/s2 of a heel strike
STILL_HAND_RADPS, STILL_HAND_MPS = 0.045, 0.0025  # root mean square of a hand that holds a phone still
TURN_RATE_RADPS = 1.3  # mean; the peak of a minimum-jerk turn is 1.9 times higher


@dataclass(frozen=True, slots=True)
class Carrying:
    """Where a phone is and what reaches it; body frame, lengths as parts of the body height.

    The phone sits `lever` away from `pivot` on a limb that swings about the body's right axis. `pitch_rad` counts
    from the limb hanging or the hand level.
    """

    pivot: tuple[float, float, float]
    lever: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pitch_rad: float = 0.0
    roll_rad: float = 0.0
    twist_rad: float = 0.0
    thigh: float = 0.0  # share of the thigh's swing that turns the phone
    arm: float = 0.0  # share of the arm's swing
    bounce: float = 1.0  # share of the body's bounce that arrives
    impact: float = 1.0  # share of the heel strike that arrives
    impact_width_s: float = 0.018
    impact_sideways: float = 0.0  # horizontal part of the heel strike
    one_sided: float = 0.0  # how much stronger the strikes of the phone's own leg are
    wobble_pitch_rad: float = 0.0  # at step frequency
    wobble_roll_rad: float = 0.0  # at stride frequency, as the next two
    wobble_yaw_rad: float = 0.0
    wobble_twist_rad: float = 0.0
    tremor: float = 1.0


CARRYING: dict[str, Carrying] = {
    "texting": Carrying(
        pivot=(0.0, 0.19, 0.72),
        bounce=0.8,
        impact=0.2,
        impact_width_s=0.025,
        wobble_pitch_rad=0.025,
        wobble_roll_rad=0.03,
        wobble_yaw_rad=0.05,
    ),
    "pocket": Carrying(
        pivot=(0.06, 0.0, 0.0),
        lever=(0.02, 0.04, -0.13),
        pitch_rad=-np.pi / 2,
        thigh=1.0,
        impact_sideways=0.7,
        one_sided=0.5,
        wobble_roll_rad=0.24,
        wobble_twist_rad=0.12,
    ),
    "swinging": Carrying(
        pivot=(0.12, 0.0, 0.69),
        lever=(0.0, 0.03, -0.27),
        roll_rad=np.pi / 2,
        arm=1.0,
        impact=0.25,
        impact_width_s=0.03,
        wobble_roll_rad=0.08,
        wobble_twist_rad=0.06,
    ),
    "calling": Carrying(
        pivot=(0.05, 0.03, 0.93),
        pitch_rad=1.2,
        roll_rad=-1.4,
        bounce=0.75,
        impact=0.15,
        impact_width_s=0.025,
        wobble_pitch_rad=0.02,
        wobble_roll_rad=0.05,
        wobble_yaw_rad=0.05,
    ),
}


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Exact motion of the phone as a function of time, and of the body on a grid."""

    plan: StepPlan
    spline: BSpline  # phone east, north, up and the four angles
    grid_s: FloatArray  # (N,)
    body_position_m: FloatArray  # (N, 3) east, north, height of the ground under the person
    heading_rad: FloatArray  # (N,) direction the body faces, clockwise from north, unwrapped

    def position_m(self, time_s: FloatArray) -> FloatArray:
        """Phone: east, north, up, (N, 3)."""
        return self.spline(time_s)[:, :3]

    def rotation(self, time_s: FloatArray) -> Rotation:
        """Phone: sensor-to-world rotations, N of them."""
        angles = self.spline(time_s)[:, 3:]
        return Rotation.from_euler("ZXY", angles[:, :3]) * _about("Z", angles[:, 3])

    def specific_force_mps2(self, time_s: FloatArray) -> FloatArray:
        """R^T (p'' + g up) in the sensor frame, (N, 3)."""
        force_enu = self.spline(time_s, 2)[:, :3] + np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])
        return self.rotation(time_s).inv().apply(force_enu)

    def angular_rate_radps(self, time_s: FloatArray) -> FloatArray:
        """Angular rate in the sensor frame, (N, 3): the rates of the four angles, each turned by the later ones."""
        _, pitch, roll, twist = self.spline(time_s)[:, 3:].T
        rates = self.spline(time_s, 1)[:, 3:]
        zero = np.zeros(len(rates))
        rate = _about("X", pitch).inv().apply(np.stack([zero, zero, rates[:, 0]], axis=1))
        rate[:, 0] += rates[:, 1]
        rate = _about("Y", roll).inv().apply(rate)
        rate[:, 1] += rates[:, 2]
        rate = _about("Z", twist).inv().apply(rate)
        rate[:, 2] += rates[:, 3]
        return rate

    def body_at(self, time_s: FloatArray) -> FloatArray:
        """Body: east, north, height of the ground, (N, 3)."""
        return np.stack([np.interp(time_s, self.grid_s, column) for column in self.body_position_m.T], axis=1)


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


def body_path(
    time_s: FloatArray, plan: StepPlan, travel_rad: FloatArray, surge_m: FloatArray, phase: FloatArray
) -> FloatArray:
    """East, north and height of the ground under the person, (N, 3).

    The progress passes through the sum of the step lengths at every contact; the surge is zero there.
    """
    progress = through_contacts(time_s, plan, plan.length_m) + surge_m * np.sin(2 * np.pi * phase)
    middle = 0.5 * (travel_rad[1:] + travel_rad[:-1])
    east, north = (np.append(0.0, np.cumsum(np.diff(progress) * f(middle))) for f in (np.sin, np.cos))
    return np.stack([east, north, through_contacts(time_s, plan, plan.rise_m)], axis=1)


def pulses(time_s: FloatArray, centre_s: FloatArray, peak: FloatArray, width_s: FloatArray) -> FloatArray:
    """Displacement, (N,), whose second derivative is a short pulse of the given peak at each centre.

    Each is -peak width^2 exp(-(t/width)^2 / 2), so that velocity and position come back to where they were.
    """
    result = np.zeros(len(time_s))
    reach = np.arange(round(-0.25 * GRID_HZ), round(0.25 * GRID_HZ) + 1)
    index = np.round((centre_s[:, None] - time_s[0]) * GRID_HZ).astype(int) + reach
    inside = (index >= 0) & (index < len(time_s))
    index = np.clip(index, 0, len(time_s) - 1)
    u = (time_s[index] - centre_s[:, None]) / width_s[:, None]
    pulse = -(peak * width_s**2)[:, None] * np.exp(-0.5 * u**2)
    np.add.at(result, index[inside], pulse[inside])
    return result


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
    phase = through_contacts(time_s, plan, np.ones(len(plan.leg)))
    context = _blended(leg_blend(time_s, plan, legs, CONTEXT_BLEND_S), [_context_row(leg, gait) for leg in legs])
    rows = [_carrying_row(mode, carrying, gait) for mode, carrying in places]
    carrying = _blended(leg_blend(time_s, plan, legs, CARRYING_BLEND_S), rows)
    facing, travel = heading_course(time_s, plan, legs, start_heading_rad)
    body = body_path(time_s, plan, travel, context["surge_m"], phase)
    course = _Course(time_s, phase, context, carrying)
    angles = _phone_angles(course, facing, course.unsteady(STILL_HAND_RADPS, gait, rng))
    offset = _phone_offset(course, course.unsteady(STILL_HAND_MPS, gait, rng))
    shift, rotation = _heel_strikes(time_s, plan, legs, [carrying for _, carrying in places], gait, rng)
    offset += shift
    angles[:, 1:] += rotation
    position = body + _about("Z", -facing).apply(offset)
    spline = make_interp_spline(time_s, np.column_stack([position, angles]), k=5)
    return Motion(plan, spline, time_s, body, facing)


Courses = dict[str, FloatArray]


def _blended(blend: Blend, rows: Sequence[dict[str, float]]) -> Courses:
    """One course over time for each name in the rows; there is one row for each leg."""
    return {name: blend([row[name] for row in rows]) for name in rows[0]}


def _context_row(leg: Leg, gait: Gait) -> dict[str, float]:
    """Amplitudes of this person on this leg."""
    typical = CONTEXT_GAITS[leg.context]
    row: dict[str, float] = asdict(typical)
    row["amplitude"] = float(leg.moves)
    if not leg.moves:
        return row
    _, length_m = nominal_step(leg, gait)
    relative = length_m / Gait().step_length_m(leg.context, typical.frequency_hz)
    # Inverted pendulum: the hip rises and falls with the square of the step length.
    row["bounce_m"] *= gait.bounce_factor * relative**2
    row["bounce2_m"] *= gait.bounce_factor * relative**2
    row["surge_m"] *= relative
    for name in ("thigh_swing_rad", "arm_swing_rad"):
        row[name] *= gait.swing_factor * np.sqrt(relative)
    return row


_VECTORS = ("pivot", "lever")


def _carrying_row(mode: str, carrying: Carrying, gait: Gait) -> dict[str, float]:
    """Place of the phone on this person, lengths in metres."""
    row: dict[str, float] = {f.name: getattr(carrying, f.name) for f in fields(Carrying) if f.name not in _VECTORS}
    for name in _VECTORS:
        for axis, value in zip("xyz", getattr(carrying, name), strict=True):
            row[f"{name}_{axis}"] = gait.height_m * value
    # The hip is where this person's legs begin.
    row["pivot_z"] += gait.height_m * gait.leg_factor * carrying.thigh
    if mode == "texting":
        row["pitch_rad"] = gait.tilt_rad
    return row


def _swing_shape(phase: FloatArray) -> FloatArray:
    """Course of a leg's swing, amplitude about 1: faster forward, in the air, than backward, on the ground."""
    angle = np.pi * (phase + 0.15)
    return np.cos(angle) - 0.17 * np.sin(2 * angle) - 0.09 * np.cos(3 * angle)


@dataclass(frozen=True, slots=True, eq=False)
class _Course:
    """How the steps follow each other, and how the person moves and has the phone, over time."""

    time_s: FloatArray  # (N,)
    phase: FloatArray  # (N,) number of steps; the right foot lands at even ones
    context: Courses
    carrying: Courses

    def limb_rad(self) -> FloatArray:
        """Swing of the limb that carries the phone, forward positive, radians (N,).

        At an even phase the thigh is just past its foremost angle, the right arm behind.
        """
        context, carrying = self.context, self.carrying
        thigh = context["thigh_mean_rad"] + context["thigh_swing_rad"] * _swing_shape(self.phase)
        arm = -context["arm_swing_rad"] * np.cos(np.pi * self.phase)
        return carrying["thigh"] * thigh + carrying["arm"] * arm

    def unsteady(self, rate: float, gait: Gait, rng: np.random.Generator) -> list[FloatArray]:
        """Three irregular courses, (N,) each, whose rate has this root mean square in a still hand."""
        size = rate * gait.tremor_factor * self.carrying["tremor"] * self.context["tremor"]
        return [size * tremor(self.time_s, rng) for _ in range(3)]


def _phone_angles(course: _Course, facing_rad: FloatArray, unsteady: Sequence[FloatArray]) -> FloatArray:
    """The four angles of the attitude, (N, 4), the first three of a hand that is unsteady."""
    carrying, wobble = course.carrying, course.context["wobble"]
    stride = np.sin(np.pi * course.phase)
    swing = _swing_shape(course.phase)
    step = np.cos(2 * np.pi * course.phase - 1.0)
    yaw = -facing_rad + wobble * carrying["wobble_yaw_rad"] * stride
    pitch = carrying["pitch_rad"] + course.limb_rad() + wobble * carrying["wobble_pitch_rad"] * step
    roll = carrying["roll_rad"] + wobble * carrying["wobble_roll_rad"] * swing
    twist = carrying["twist_rad"] + wobble * carrying["wobble_twist_rad"] * swing
    return np.column_stack([yaw + unsteady[0], pitch + unsteady[1], roll + unsteady[2], twist])


def _phone_offset(course: _Course, unsteady: Sequence[FloatArray]) -> FloatArray:
    """Phone relative to the ground under the person, body frame, without heel strikes, (N, 3)."""
    context, carrying, phase = course.context, course.carrying, course.phase
    # The hip is lowest, and pushed up most, shortly after a contact.
    lag = 2 * np.pi * (phase - 0.08)
    bounce = -context["bounce_m"] * np.cos(lag) - context["bounce2_m"] * np.cos(2 * lag)
    limb_rad = course.limb_rad()
    sine, cosine = np.sin(limb_rad), np.cos(limb_rad)
    right = carrying["pivot_x"] + carrying["lever_x"] + context["sway_m"] * np.cos(np.pi * phase)
    forward = carrying["pivot_y"] + carrying["lever_y"] * cosine - carrying["lever_z"] * sine
    up = carrying["pivot_z"] + carrying["lever_y"] * sine + carrying["lever_z"] * cosine + carrying["bounce"] * bounce
    return np.column_stack([right + unsteady[0], forward + unsteady[1], up + unsteady[2]])


def _heel_strikes(
    time_s: FloatArray,
    plan: StepPlan,
    legs: Sequence[Leg],
    places: Sequence[Carrying],
    gait: Gait,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """What the shocks after the contacts do: shift in the body frame, change of pitch, roll, twist, both (N, 3)."""
    n = len(plan.leg)
    strength = np.array([CONTEXT_GAITS[leg.context].impact_mps2 for leg in legs])[plan.leg]
    where = [places[int(k)] for k in plan.leg]
    arrives = np.array([c.impact for c in where])
    # Contacts with odd index end the steps of the right leg, where the pocket is.
    own_leg = np.where(np.arange(n) % 2 == 1, 1.0, -1.0) * np.array([c.one_sided for c in where])
    peak = gait.impact_factor * strength * arrives * (1.0 + own_leg) * (1.0 + 0.2 * rng.standard_normal(n))
    peak[plan.last] *= 0.4  # the foot is put down softly
    width_s = np.array([c.impact_width_s for c in where]) * (1.0 + 0.1 * rng.standard_normal(n))
    sideways = np.array([c.impact_sideways for c in where])
    parts = (
        peak * sideways * 0.7 * rng.standard_normal(n),
        -peak * sideways * (1.0 + 0.3 * rng.standard_normal(n)),  # the foot stops, the phone is pushed back
        peak,
    )
    centre_s = plan.contact_s + 2.0 * width_s
    shift = np.column_stack([pulses(time_s, centre_s, part, width_s) for part in parts])
    rock = KNOCK_RADPM * peak * np.array([[1.0], [0.7], [0.7]]) * rng.standard_normal((3, n))
    rock[0] -= KNOCK_RADPM * peak
    return shift, np.column_stack([pulses(time_s, centre_s, part, width_s) for part in rock])
