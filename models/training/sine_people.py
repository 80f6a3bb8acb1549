"""Simulated people for the training of carrying modes, whose phones move by sines and heel strikes.

The amplitudes are fitted to public recordings: the standard deviation and main frequency of the force, and the mean and
standard deviation of the rate, are within 30 % in windows of 2 s. How people hold phones is drawn with wide spreads,
which are assumptions, because there are no public statistics. `pdr_filter.simulate` moves a phone by strides measured
on one or two people for each place. Its swinging hands differ less from each other, and models trained on them
recognise fewer swinging hands of held-out people.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from pdr_filter.simulate.gait import Leg, StepPlan
from pdr_filter.simulate.motion import GRID_HZ, MARGIN_S, heading_course, leg_blend, through_contacts, tremor
from pdr_filter.simulate.sensors import SensorErrors
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, table
from pdr_filter.values.recording import Recording, Truth
from pdr_filter.values.samples import Samples

MODES: tuple[str, ...] = ("texting", "calling", "swinging", "pocket")
# Attitude at the ear: the top end is raised, and the phone is rolled until the screen faces the head.
EAR_PITCH_RAD, EAR_ROLL_RAD = 0.75, 1.45
_STAIR_TREAD_M, _TYPICAL_HEIGHT_M = 0.29, 1.75
_END_STEP_FACTOR = 0.7  # the first and the last step of a bout are shorter
_CONTEXT_BLEND_S = 0.5
_KNOCK_RADPM = 5.0  # angular acceleration that rocks the phone, for each m/s2 of a heel strike
# Root mean square motion of a hand that holds a phone still.
_STILL_HAND_RADPS, _STILL_HAND_MPS = 0.045, 0.0025
_PULSE_REACH_S = 0.25


@dataclass(frozen=True, slots=True)
class ContextMotion:
    """Motion of a typical person in one context. Amplitudes are half of peak-to-peak.

    The step length is height * (length_offset + length_slope_s * frequency), but the tread on stairs.
    """

    frequency_hz: float = 0.0
    length_offset: float = 0.0
    length_slope_s: float = 0.0
    rise_m: float = 0.0  # height of a step on stairs
    bounce_m: float = 0.0  # vertical, at step frequency
    bounce2_m: float = 0.0  # vertical, at twice the step frequency
    surge_m: float = 0.0  # forward, at step frequency
    sway_m: float = 0.0  # sideways, at stride frequency
    impact_mps2: float = 0.0  # peak of the heel strike at the hip
    thigh_mean_rad: float = 0.0
    thigh_swing_rad: float = 0.0  # at stride frequency
    arm_swing_rad: float = 0.0
    wobble: float = 0.0  # rotation of the phone in hand or pocket, relative to walking
    tremor: float = 1.0  # irregular motion, relative to standing


CONTEXT_MOTIONS: dict[str, ContextMotion] = {
    "stationary": ContextMotion(),
    "walking": ContextMotion(
        1.9, 0.06, 0.18, 0.0, 0.0225, 0.0015, 0.008, 0.018, 14.5, 0.15, 0.38, 0.45, wobble=1.0, tremor=5.0
    ),
    "upstairs": ContextMotion(
        1.7, 0.0, 0.0, 0.17, 0.018, 0.002, 0.008, 0.025, 7.0, 0.45, 0.42, 0.25, wobble=1.0, tremor=5.0
    ),
    "downstairs": ContextMotion(
        1.9, 0.0, 0.0, -0.17, 0.021, 0.003, 0.006, 0.02, 12.0, 0.3, 0.28, 0.2, wobble=0.9, tremor=5.0
    ),
    "running": ContextMotion(
        2.7, -0.239, 0.3, 0.0, 0.042, 0.0035, 0.008, 0.012, 18.0, 0.3, 0.45, 0.6, wobble=1.3, tremor=8.0
    ),
}


@dataclass(frozen=True, slots=True)
class Person:
    """Height, and motion relative to a typical person of this height."""

    height_m: float
    leg_factor: float  # height of the hip divided by that of the body
    frequency_factor: float
    length_factor: float
    bounce_factor: float
    impact_factor: float
    swing_factor: float  # swing of legs and arms
    tremor_factor: float
    frequency_std: float  # relative, from step to step
    length_std: float

    @classmethod
    def random(cls, seed: int, rng: np.random.Generator) -> Person:
        """Return a random adult of a population. `seed` and `rng` both give random numbers."""
        of_seed = np.random.default_rng(seed)

        def about(mean: float, std: float) -> float:
            return mean + std * float(np.clip(of_seed.standard_normal(), -2.0, 2.0))

        height_m, leg_factor = about(1.72, 0.09), about(0.53, 0.01)
        frequency_factor, length_factor = about(1.0, 0.05), about(1.0, 0.05)
        bounce_factor = about(1.0, 0.12) * random_factor(rng, 1.0, 0.2)
        impact_factor = about(1.0, 0.2) * random_factor(rng, 1.0, 0.3)
        swing_factor = about(1.0, 0.12) * random_factor(rng, 1.0, 0.15)
        tremor_factor, _ = about(1.0, 0.25), about(0.65, 0.12)
        frequency_std, length_std = about(0.025, 0.004), about(0.025, 0.004)
        return cls(
            height_m,
            leg_factor,
            frequency_factor,
            length_factor,
            bounce_factor,
            impact_factor,
            swing_factor,
            tremor_factor,
            frequency_std,
            length_std,
        )

    def nominal_step(self, leg: Leg) -> tuple[float, float]:
        """Return the mean step frequency in Hz and step length in m on a leg of the walk."""
        motion = CONTEXT_MOTIONS[leg.context]
        frequency_hz = motion.frequency_hz * self.frequency_factor * leg.frequency_factor
        return frequency_hz, _step_length_m(motion, self.length_factor, self.height_m, frequency_hz)


def _step_length_m(motion: ContextMotion, length_factor: float, height_m: float, frequency_hz: float) -> float:
    if motion.rise_m:
        return _STAIR_TREAD_M
    return length_factor * height_m * (motion.length_offset + motion.length_slope_s * frequency_hz)


@dataclass(frozen=True, slots=True)
class Place:
    """Place of a phone, and the motion that reaches it. Lengths are parts of the body height in the body frame.

    The phone is at `lever` from `pivot` on a limb, which swings about the right axis of the body. `pitch_rad` is zero
    for a hanging limb or a level hand.
    """

    pivot: tuple[float, float, float]
    lever: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pitch_rad: float = 0.0
    roll_rad: float = 0.0
    twist_rad: float = 0.0
    thigh: float = 0.0  # part of the swing of the thigh that rotates the phone
    arm: float = 0.0  # part of the swing of the arm
    bounce: float = 1.0  # part of the bounce of the body that arrives
    impact: float = 1.0  # part of the heel strike that arrives
    impact_width_s: float = 0.018
    impact_sideways: float = 0.0  # horizontal part of the heel strike
    one_sided: float = 0.0  # relative excess of the heel strikes of the leg that carries the phone
    wobble_pitch_rad: float = 0.0  # at step frequency
    wobble_roll_rad: float = 0.0  # at stride frequency, as the next two
    wobble_yaw_rad: float = 0.0
    wobble_twist_rad: float = 0.0
    tremor: float = 1.0


def simulated_person(mode: str, number: int) -> Recording:
    """Return a walk of a random person with corners, and with running or stairs, in one carrying mode.

    Equal modes and numbers give equal recordings. The number determines rate, sensor errors and legs together:
    recordings at 50 Hz have no stairs, those at 100 Hz upstairs and those at 200 Hz downstairs. Use the recordings for
    carrying modes, not for contexts.
    """
    seed = number * len(MODES) + MODES.index(mode)
    rng = np.random.default_rng([MODES.index(mode), number])
    person = Person.random(1000 + seed, rng)
    tilt_rad = float(np.clip(rng.normal(0.4, 0.3), -0.1, 1.15))
    legs = _walk(number, rng)
    heading_rad = float(rng.uniform(0.0, 2 * np.pi))
    place = _texting(rng, tilt_rad) if mode == "texting" else _PLACES[mode](rng)
    of_plan, of_motion, of_sensors = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(3))
    plan = plan_steps(legs, person, of_plan)
    motion = phone_motion(legs, place, person, plan, of_motion, heading_rad)
    rate_hz, errors = (50.0, 100.0, 200.0)[number % 3], SensorErrors() if number % 2 else SensorErrors.bmi160()
    accelerometer_s = _clock(plan, rate_hz, 0.0)
    jitter_s = errors.jitter_s * of_sensors.standard_normal(len(accelerometer_s))
    jitter_s[0] = 0.0  # the first sample is the origin of time
    force = errors.accelerometer.apply(specific_force_mps2(motion, accelerometer_s), rate_hz, of_sensors)
    accelerometer = Samples(accelerometer_s + jitter_s, force)
    gyroscope_s = _clock(plan, rate_hz, 0.3 / rate_hz)
    jitter_s = errors.jitter_s * of_sensors.standard_normal(len(gyroscope_s))
    rate = errors.gyroscope.apply(angular_rate_radps(motion, gyroscope_s), rate_hz, of_sensors)
    contexts, modes = [leg.context for leg in legs], [mode] * len(legs)
    return Recording(
        name=f"simulated_{mode}_{number}",
        accelerometer=accelerometer,
        gyroscope=Samples(gyroscope_s + jitter_s, rate),
        truth=Truth(
            labels=table(
                {"start_s": plan.leg_start_s, "end_s": plan.leg_end_s, "context": contexts, "carrying_mode": modes}
            )
        ),
        meta={"dataset": "simulated", "subject": {"id": "simulated", "height_m": person.height_m}},
    )


def _clock(plan: StepPlan, rate_hz: float, start_s: float) -> FloatArray:
    """Return the times of samples from `start_s` to the end of the walk."""
    n_samples = int(np.floor((float(plan.leg_end_s[-1]) - start_s) * rate_hz + 1e-9)) + 1
    return start_s + np.arange(n_samples) / rate_hz


# --- The walk and its steps


def _walk(number: int, rng: np.random.Generator) -> list[Leg]:
    """Return 4 s of standing and 25 s of slow and fast walking with two turns, followed by running, stairs, or both."""
    slow, fast = float(rng.uniform(0.6, 0.95)), float(rng.uniform(0.9, 1.15))
    turns = [float(random_side(rng) * rng.uniform(0.4, 2.2)) for _ in range(2)]
    legs = [
        Leg("stationary", duration_s=4.0),
        Leg("walking", duration_s=9.0, frequency_factor=slow),
        Leg("walking", duration_s=7.0, frequency_factor=slow, turn_rad=turns[0], curve=bool(rng.random() < 0.5)),
        Leg("walking", duration_s=9.0, frequency_factor=fast, turn_rad=turns[1]),
    ]
    if number % 3 == 0 or number % 2:
        legs.append(Leg("running", duration_s=8.0))
    if number % 3:
        legs.append(Leg(("upstairs", "downstairs")[number % 3 - 1], duration_s=8.0))
    return legs


def plan_steps(legs: Sequence[Leg], person: Person, rng: np.random.Generator) -> StepPlan:
    """Return the plan of all steps along legs with a duration, with random variation from step to step."""
    leg_end: list[float] = []
    parts: list[tuple[FloatArray, ...]] = []
    clock_s = 0.0
    for k, leg in enumerate(legs):
        if leg.moves:
            joins_previous = k > 0 and legs[k - 1].joins(leg)
            joins_next = k + 1 < len(legs) and leg.joins(legs[k + 1])
            durations, length = _leg_steps(leg, legs[k - 1] if joins_previous else None, joins_next, person, rng)
            number = np.arange(n := len(durations))
            contact = clock_s + np.cumsum(durations)
            first, last = (number == 0) & (not joins_previous), (number == n - 1) & (not joins_next)
            rise = np.full(n, CONTEXT_MOTIONS[leg.context].rise_m)
            parts.append((np.full(n, k), np.append(clock_s, contact[:-1]), contact, length, rise, first, last))
            clock_s = float(contact[-1])
        else:
            clock_s += float(leg.duration_s or 0.0)
        leg_end.append(clock_s)
    of_leg, start, contact, length, rise, first, last = (np.concatenate(column) for column in zip(*parts, strict=True))
    started, ended = np.array([0.0, *leg_end])[:-1], np.array(leg_end)
    return StepPlan(
        started, ended, of_leg.astype(np.int64), start, contact, length, rise, first.astype(bool), last.astype(bool)
    )


def _leg_steps(
    leg: Leg, before: Leg | None, joins_next: bool, person: Person, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return the durations in s and the lengths in m of the steps of one moving leg."""
    frequency_hz, mean_m = person.nominal_step(leg)
    duration_s = float(leg.duration_s or 0.0)
    n = max(1, round(duration_s * frequency_hz))
    variation = np.clip(rng.standard_normal((2, n)), -2.5, 2.5)
    durations = (1.0 + person.frequency_std * variation[0]) / frequency_hz
    lengths = np.full(n, mean_m)
    on_stairs = CONTEXT_MOTIONS[leg.context].rise_m != 0.0
    if not on_stairs:
        lengths *= 1.0 + person.length_std * variation[1]
        lengths[0] *= _END_STEP_FACTOR if before is None else 1.0
        lengths[-1] *= 1.0 if joins_next else _END_STEP_FACTOR
    if before is not None:
        # the first step at a new pace is the mean of both paces
        before_hz, before_m = person.nominal_step(before)
        durations[0] = 0.5 * (durations[0] + 1.0 / before_hz)
        lengths[0] = lengths[0] if on_stairs else 0.5 * (lengths[0] + before_m)
    return durations * (duration_s / durations.sum()), lengths


# --- The motion of the phone

# Functions of time (N,), by the names of the fields of `ContextMotion`, and `amplitude` 1 for moving legs.
Courses = dict[str, FloatArray]


def phone_motion(
    legs: Sequence[Leg],
    place: Place,
    person: Person,
    plan: StepPlan,
    rng: np.random.Generator,
    start_heading_rad: float,
) -> BSpline:
    """Return the motion of the phone as a spline of time: east, north, up and the four angles of the attitude.

    The attitude is Rz(a) Rx(b) Ry(c) Rz(d), from the sensor frame to the world frame.
    """
    n = round((plan.leg_end_s[-1] + 2 * MARGIN_S) * GRID_HZ) + 1
    time_s = np.arange(n) / GRID_HZ - MARGIN_S
    phase = through_contacts(time_s, plan, np.ones(len(plan.leg)))
    blend = leg_blend(time_s, plan, legs, _CONTEXT_BLEND_S)
    rows = [_amplitudes(leg, person) for leg in legs]
    context = {name: blend([row[name] for row in rows]) for name in rows[0]}
    facing, travel = heading_course(time_s, plan, legs, start_heading_rad)
    body = _body_path(time_s, plan, travel, context["surge_m"], phase)
    limb = _limb_angle(phase, context, place)
    angles = _angles(time_s, phase, facing, limb, context, place, person, rng)
    offset = _offset(time_s, phase, limb, context, place, person, rng)
    shift, rotation = _heel_strikes(time_s, plan, legs, place, person, rng)
    offset += shift
    angles[:, 1:] += rotation
    position = body + _about_axis("Z", -facing).apply(offset)
    return make_interp_spline(time_s, np.column_stack([position, angles]), k=5)


def _rotation(motion: BSpline, time_s: FloatArray) -> Rotation:
    """Return the rotations of the phone from the sensor frame to the world frame at N times."""
    angles = motion(time_s)[:, 3:]
    return Rotation.from_euler("ZXY", angles[:, :3]) * _about_axis("Z", angles[:, 3])


def specific_force_mps2(motion: BSpline, time_s: FloatArray) -> FloatArray:
    """Return the specific force in the sensor frame at some times, (N, 3), in m/s2."""
    force_enu = motion(time_s, 2)[:, :3] + np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])
    return _rotation(motion, time_s).inv().apply(force_enu)


def angular_rate_radps(motion: BSpline, time_s: FloatArray) -> FloatArray:
    """Return the angular rate in the sensor frame, (N, 3), rad/s: the rates of the four angles, rotated."""
    _, pitch, roll, twist = motion(time_s)[:, 3:].T
    rates = motion(time_s, 1)[:, 3:]
    zero = np.zeros(len(rates))
    rate = _about_axis("X", pitch).inv().apply(np.stack([zero, zero, rates[:, 0]], axis=1))
    rate[:, 0] += rates[:, 1]
    rate = _about_axis("Y", roll).inv().apply(rate)
    rate[:, 1] += rates[:, 2]
    rate = _about_axis("Z", twist).inv().apply(rate)
    rate[:, 2] += rates[:, 3]
    return rate


def _about_axis(axis: str, angle_rad: FloatArray) -> Rotation:
    return Rotation.from_euler(axis, angle_rad[:, None])


def _amplitudes(leg: Leg, person: Person) -> dict[str, float]:
    """Return the amplitudes of a person on a leg, by name."""
    typical = CONTEXT_MOTIONS[leg.context]
    row: dict[str, float] = {field.name: getattr(typical, field.name) for field in fields(ContextMotion)}
    if not leg.moves:
        return row
    relative = person.nominal_step(leg)[1] / _step_length_m(typical, 1.0, _TYPICAL_HEIGHT_M, typical.frequency_hz)
    # inverted pendulum: the hip rises and falls with the square of the step length
    row["bounce_m"] *= person.bounce_factor * relative**2
    row["bounce2_m"] *= person.bounce_factor * relative**2
    row["surge_m"] *= relative
    for name in ("thigh_swing_rad", "arm_swing_rad"):
        row[name] *= person.swing_factor * np.sqrt(relative)
    return row


def _body_path(
    time_s: FloatArray, plan: StepPlan, travel_rad: FloatArray, surge_m: FloatArray, phase: FloatArray
) -> FloatArray:
    """Return east, north and height of the ground under the person, (N, 3)."""
    progress = through_contacts(time_s, plan, plan.length_m)
    progress = progress + surge_m * np.sin(2 * np.pi * phase)  # the surge is zero at the contacts
    middle = 0.5 * (travel_rad[1:] + travel_rad[:-1])
    east = np.append(0.0, np.cumsum(np.diff(progress) * np.sin(middle)))
    north = np.append(0.0, np.cumsum(np.diff(progress) * np.cos(middle)))
    return np.stack([east, north, through_contacts(time_s, plan, plan.rise_m)], axis=1)


def _swing_shape(phase: FloatArray) -> FloatArray:
    """Return the swing of a leg with an amplitude of about 1: faster forward, in the air, than backward."""
    angle = np.pi * (phase + 0.15)
    return np.cos(angle) - 0.17 * np.sin(2 * angle) - 0.09 * np.cos(3 * angle)


def _limb_angle(phase: FloatArray, context: Courses, place: Place) -> FloatArray:
    """Return the swing of the limb that carries the phone, forward positive, in rad, (N,).

    The right foot lands at even phases. The right thigh is just past its foremost angle then, and the right arm behind.
    """
    thigh = context["thigh_mean_rad"] + context["thigh_swing_rad"] * _swing_shape(phase)
    arm = -context["arm_swing_rad"] * np.cos(np.pi * phase)
    return place.thigh * thigh + place.arm * arm


def _angles(
    time_s: FloatArray,
    phase: FloatArray,
    facing_rad: FloatArray,
    limb_rad: FloatArray,
    context: Courses,
    place: Place,
    person: Person,
    rng: np.random.Generator,
) -> FloatArray:
    """Return the four angles of the attitude without heel strikes, (N, 4)."""
    stride, swing, step = np.sin(np.pi * phase), _swing_shape(phase), np.cos(2 * np.pi * phase - 1.0)
    unsteady = _STILL_HAND_RADPS * person.tremor_factor * place.tremor * context["tremor"]
    wobble = context["wobble"]
    yaw = -facing_rad + wobble * place.wobble_yaw_rad * stride + unsteady * tremor(time_s, rng)
    pitch = place.pitch_rad + limb_rad + wobble * place.wobble_pitch_rad * step + unsteady * tremor(time_s, rng)
    roll = place.roll_rad + wobble * place.wobble_roll_rad * swing + unsteady * tremor(time_s, rng)
    return np.column_stack([yaw, pitch, roll, place.twist_rad + wobble * place.wobble_twist_rad * swing])


def _offset(
    time_s: FloatArray,
    phase: FloatArray,
    limb_rad: FloatArray,
    context: Courses,
    place: Place,
    person: Person,
    rng: np.random.Generator,
) -> FloatArray:
    """Return the position of the phone relative to the ground under the person, without heel strikes, (N, 3)."""
    # the hip is lowest, and pushed up most, shortly after a contact
    lag = 2 * np.pi * (phase - 0.08)
    bounce = -context["bounce_m"] * np.cos(lag) - context["bounce2_m"] * np.cos(2 * lag)
    sine, cosine = np.sin(limb_rad), np.cos(limb_rad)
    unsteady = _STILL_HAND_MPS * person.tremor_factor * place.tremor * context["tremor"]
    pivot = [person.height_m * value for value in place.pivot]
    lever = [person.height_m * value for value in place.lever]
    pivot[2] += person.height_m * person.leg_factor * place.thigh  # the hip
    right = pivot[0] + lever[0] + context["sway_m"] * np.cos(np.pi * phase) + unsteady * tremor(time_s, rng)
    forward = pivot[1] + lever[1] * cosine - lever[2] * sine + unsteady * tremor(time_s, rng)
    up = pivot[2] + lever[1] * sine + lever[2] * cosine + place.bounce * bounce + unsteady * tremor(time_s, rng)
    return np.column_stack([right, forward, up])


def _heel_strikes(
    time_s: FloatArray, plan: StepPlan, legs: Sequence[Leg], place: Place, person: Person, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return the shift in the body frame and the change of pitch, roll and twist by heel strikes, (N, 3) each."""
    n = len(plan.leg)
    strength = np.array([CONTEXT_MOTIONS[leg.context].impact_mps2 for leg in legs])[plan.leg]
    # contacts with odd index end the steps of the right leg, where the pocket is
    own_leg = np.where(np.arange(n) % 2 == 1, 1.0, -1.0) * place.one_sided
    peak = person.impact_factor * strength * place.impact * (1.0 + own_leg) * (1.0 + 0.2 * rng.standard_normal(n))
    peak[plan.last] *= 0.4  # the foot is put down softly
    width_s = place.impact_width_s * (1.0 + 0.1 * rng.standard_normal(n))
    sideways = place.impact_sideways
    parts = (
        peak * sideways * 0.7 * rng.standard_normal(n),
        -peak * sideways * (1.0 + 0.3 * rng.standard_normal(n)),  # the foot stops, and the phone is pushed back
        peak,
    )
    centre_s = plan.contact_s + 2.0 * width_s
    shift = np.column_stack([_pulses(time_s, centre_s, part, width_s) for part in parts])
    rock = _KNOCK_RADPM * peak * np.array([[1.0], [0.7], [0.7]]) * rng.standard_normal((3, n))
    rock[0] -= _KNOCK_RADPM * peak
    return shift, np.column_stack([_pulses(time_s, centre_s, part, width_s) for part in rock])


def _pulses(time_s: FloatArray, centre_s: FloatArray, peak: FloatArray, width_s: FloatArray) -> FloatArray:
    """Return a displacement (N,) whose second derivative is a short pulse of the given peak at each centre.

    A pulse is -peak width^2 exp(-(t/width)^2 / 2), so that velocity and position return to their former values.
    """
    result = np.zeros(len(time_s))
    reach = np.arange(round(-_PULSE_REACH_S * GRID_HZ), round(_PULSE_REACH_S * GRID_HZ) + 1)
    index = np.round((centre_s[:, None] - time_s[0]) * GRID_HZ).astype(int) + reach
    inside = (index >= 0) & (index < len(time_s))
    index = np.clip(index, 0, len(time_s) - 1)
    u = (time_s[index] - centre_s[:, None]) / width_s[:, None]
    pulse = -(peak * width_s**2)[:, None] * np.exp(-0.5 * u**2)
    np.add.at(result, index[inside], pulse[inside])
    return result


# --- Random places of the phone


def random_side(rng: np.random.Generator) -> float:
    """Return -1 or 1 with equal probability."""
    return float(rng.choice([-1.0, 1.0]))


def random_factor(rng: np.random.Generator, median: float, spread: float) -> float:
    """Return a random log-normal value with a median and a standard deviation of the logarithm (`spread`)."""
    return median * float(np.exp(rng.normal(0.0, spread)))


def _texting(rng: np.random.Generator, tilt_rad: float) -> Place:
    """Return a random place and attitude of a phone in front of the chest. One in eight people holds it in landscape.

    The top end is raised by `tilt_rad`.
    """
    wobble = random_factor(rng, 0.75, 0.4)
    across = random_side(rng) * np.pi / 2 if rng.uniform() < 0.12 else 0.0
    return Place(
        pivot=(rng.uniform(-0.05, 0.05), rng.uniform(0.14, 0.24), rng.uniform(0.62, 0.78)),
        pitch_rad=tilt_rad,
        roll_rad=rng.normal(0.0, 0.12),
        twist_rad=across + rng.normal(0.0, 0.12),
        bounce=rng.uniform(0.6, 1.1),
        impact=random_factor(rng, 0.2, 0.5),
        impact_width_s=rng.uniform(0.012, 0.03),
        impact_sideways=random_factor(rng, 0.5, 0.5),
        wobble_pitch_rad=0.025 * wobble,
        wobble_roll_rad=0.03 * wobble * rng.uniform(0.5, 1.5),
        wobble_yaw_rad=0.05 * wobble * rng.uniform(0.5, 1.5),
        tremor=random_factor(rng, 0.8, 0.4),
    )


def _calling(rng: np.random.Generator) -> Place:
    """Return a random place and attitude of a phone at the right or the left ear."""
    side, wobble = random_side(rng), random_factor(rng, 0.75, 0.4)
    return Place(
        pivot=(side * 0.05, 0.03, 0.93),
        pitch_rad=rng.normal(EAR_PITCH_RAD, 0.2),
        roll_rad=-side * rng.normal(EAR_ROLL_RAD, 0.25),
        bounce=rng.uniform(0.6, 1.1),
        impact=random_factor(rng, 0.18, 0.5),
        impact_width_s=rng.uniform(0.015, 0.035),
        impact_sideways=random_factor(rng, 0.5, 0.5),
        wobble_pitch_rad=0.025 * wobble,
        wobble_roll_rad=0.04 * wobble * rng.uniform(0.5, 1.5),
        wobble_yaw_rad=0.05 * wobble * rng.uniform(0.5, 1.5),
        tremor=random_factor(rng, 0.8, 0.4),
    )


def _swinging(rng: np.random.Generator) -> Place:
    """Return a random place and attitude of a phone in a swinging hand at the side of the body.

    With a probability of 0.7 the phone lies along the fingers, otherwise with a long edge down. Three of ten people
    bend the arm, which shortens the lever.
    """
    side, wobble = random_side(rng), random_factor(rng, 1.0, 0.4)
    along = rng.uniform() < 0.7
    long_arm = rng.uniform() < 0.7
    return Place(
        pivot=(side * 0.12, 0.0, rng.uniform(0.66, 0.72)),
        lever=(0.0, rng.uniform(0.0, 0.08), -rng.uniform(0.2, 0.36) if long_arm else -rng.uniform(0.08, 0.2)),
        pitch_rad=rng.normal(0.0, 0.45) if along else random_side(rng) * np.pi / 2 + rng.normal(0.0, 0.35),
        roll_rad=side * (np.pi / 2 + rng.normal(0.0, 0.35)) if along else rng.uniform(-np.pi, np.pi),
        twist_rad=rng.normal(0.0, 0.15),
        arm=random_factor(rng, 0.9, 0.4),
        bounce=rng.uniform(0.7, 1.05),
        impact=random_factor(rng, 0.25, 0.45),
        impact_width_s=rng.uniform(0.014, 0.035),
        impact_sideways=random_factor(rng, 0.75, 0.5),
        wobble_pitch_rad=0.02 * wobble,
        wobble_roll_rad=0.1 * wobble * rng.uniform(0.4, 1.4),
        wobble_yaw_rad=0.08 * wobble * rng.uniform(0.0, 1.5),
        wobble_twist_rad=0.08 * wobble,
        tremor=random_factor(rng, 1.1, 0.4),
    )


def _pocket(rng: np.random.Generator) -> Place:
    """Return a random place and attitude of a phone in a front pocket or, for nearly a half, a back pocket.

    Either end may be down and any face towards the leg. One phone in twelve lies across. A back pocket is behind the
    hip and closer to it, and moves less with the thigh.
    """
    side, wobble = random_side(rng), random_factor(rng, 1.0, 0.4)
    back = rng.uniform() < 0.45
    across = random_side(rng) * np.pi / 2 if rng.uniform() < 0.08 else 0.0
    return Place(
        pivot=(side * 0.06, 0.0, 0.0),
        lever=(
            side * 0.02,
            -rng.uniform(0.03, 0.07) if back else rng.uniform(0.02, 0.06),
            -rng.uniform(0.0, 0.07) if back else -rng.uniform(0.06, 0.16),
        ),
        pitch_rad=random_side(rng) * np.pi / 2 + rng.normal(0.0, 0.15),
        roll_rad=rng.choice([0.0, np.pi / 2, np.pi, -np.pi / 2], p=[0.4, 0.1, 0.4, 0.1]) + rng.normal(0.0, 0.35),
        twist_rad=across + rng.normal(0.0, 0.35),
        thigh=rng.uniform(*((0.4, 0.9) if back else (0.6, 1.1))) * random_factor(rng, 0.86, 0.3),
        bounce=rng.uniform(0.8, 1.1),
        impact=random_factor(rng, 0.6 if back else 0.8, 0.4),
        impact_width_s=rng.uniform(0.012, 0.028),
        impact_sideways=rng.uniform(0.5, 1.3),
        one_sided=rng.uniform(0.1, 0.6),
        wobble_roll_rad=0.2 * wobble * rng.uniform(0.3, 1.4),
        wobble_yaw_rad=0.06 * wobble,
        wobble_twist_rad=0.12 * wobble * rng.uniform(0.3, 1.4),
        tremor=random_factor(rng, 1.1, 0.3),
    )


_PLACES: dict[str, Callable[[np.random.Generator], Place]] = {
    "calling": _calling,
    "swinging": _swinging,
    "pocket": _pocket,
}
