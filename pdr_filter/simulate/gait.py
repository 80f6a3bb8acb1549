"""Persons (`Gait`), stretches of a walk (`Leg`), and the steps planned from both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pdr_filter.values import CONTEXTS, BoolArray, FloatArray, IntArray, check_array, check_numbers, check_step_length
from pdr_filter.values.recording import check_height

STAIR_RISE_M = 0.17
STAIR_TREAD_M = 0.29
STOREY_HEIGHT_M = 18 * STAIR_RISE_M
TYPICAL_HEIGHT_M = 1.75
# Length factors of the steps after setting off and before stopping. The first is half a step, since the feet are
# together.
END_STEP_FACTORS = (0.45, 0.8, 0.95)


@dataclass(frozen=True, slots=True)
class ContextGait:
    """Movement of a typical person in one context. The resulting motion of the phone is in `strides`."""

    frequency_hz: float = 0.0
    length_offset: float = 0.0  # step length = height * (length_offset + length_slope_s * frequency); stairs: tread
    length_slope_s: float = 0.0
    rise_m: float = 0.0  # height gained in each step
    tremor: float = 1.0  # motion that does not repeat with the strides, relative to standing


CONTEXT_GAITS = {
    "stationary": ContextGait(),
    "walking": ContextGait(1.9, 0.05, 0.2, tremor=2.2),
    "upstairs": ContextGait(1.85, rise_m=STAIR_RISE_M, tremor=1.5),
    "downstairs": ContextGait(2.05, rise_m=-STAIR_RISE_M, tremor=1.5),
    "sideways": ContextGait(1.4, 0.089, 0.12, tremor=1.5),
    "running": ContextGait(2.7, -0.239, 0.3, tremor=2.0),
}

# k in the step length L = k h (f A)^(1/4), in m, for body height h, step frequency f, and amplitude A of the vertical
# force at that frequency. Fitted on 298 legs of known length. The default step-length model (`BounceStepLength`) has no
# f.
BOUNCE_K = 0.293
# Step lengths of people differ by 6 % from that law: some take longer steps than others of the same height and cadence
# without more force. Between people, A grows with this power of the length, not with the fourth power.
LENGTH_POWER = 2.4
# Exponent of the measured amplitudes of people: log A differs by 0.29 between people, and the 6 % of length explain
# 0.24.
FORCE_POWER = 0.8


@dataclass(frozen=True, slots=True)
class Gait:
    """Simulated person. `Gait()` is a typical person, `Gait.random(seed)` a random one.

    Attributes
    ----------
    height_m : float, default 1.75
        Body height in m. Step lengths and the place of the phone scale with it.
    frequency_factor, stairs_factor : float, default 1.0
        Step frequency relative to the typical person, and additional factor on stairs.
    length_factor : float, default 1.0
        Step length relative to a typical person of the same height.
    bounce_factor : float, default 1.0
        Vertical force of the steps relative to the value that follows from their length and frequency.
    impact_factor, swing_factor, tremor_factor : float, default 1.0
        Heel strike, swing of legs and arms, and unsteadiness of the hand relative to the typical person.
    tilt_rad : float, default 0.65
        Angle in rad by which the top end of the phone is raised for reading.
    frequency_std, length_std : float, default 0.025
        Relative standard deviations of step frequency and step length from step to step.
    habit : int, optional
        Seed of the individual shape of the strides. None stands for the typical shape.

    Raises
    ------
    ValueError
        If a number is not plausible. The message names the field.

    Examples
    --------
    >>> from pdr_filter.simulate import Gait
    >>> Gait().step_frequency_hz("walking")
    1.9
    >>> Gait.random(3) == Gait.random(3)
    True
    """

    height_m: float = TYPICAL_HEIGHT_M
    frequency_factor: float = 1.0
    stairs_factor: float = 1.0
    length_factor: float = 1.0
    bounce_factor: float = 1.0
    impact_factor: float = 1.0
    swing_factor: float = 1.0
    tremor_factor: float = 1.0
    tilt_rad: float = 0.65
    frequency_std: float = 0.025
    length_std: float = 0.025
    habit: int | None = None

    def __post_init__(self) -> None:
        zero = ("impact_factor", "swing_factor", "tremor_factor", "frequency_std", "length_std")
        check_numbers(self, zero=zero, signed=("tilt_rad",))
        check_height(self.height_m)
        length_m = self.step_length_m("walking", self.step_frequency_hz("walking"))
        check_step_length("the length of a walking step", length_m)

    @classmethod
    def random(cls, seed: int) -> Gait:
        """Return a person drawn at random from a population of adults.

        Parameters
        ----------
        seed : int
            Seed. Equal seeds give equal persons.

        Returns
        -------
        Gait
            Random person.
        """
        rng = np.random.default_rng(seed)

        def about(mean: float, std: float) -> float:
            return mean + std * float(np.clip(rng.standard_normal(), -2.0, 2.0))

        return cls(
            height_m=about(1.72, 0.09),
            frequency_factor=about(1.0, 0.06),
            stairs_factor=about(1.0, 0.1),
            length_factor=about(1.0, 0.05),
            bounce_factor=about(1.0, 0.05),
            impact_factor=about(1.0, 0.1),
            swing_factor=about(1.0, 0.08),
            tremor_factor=about(1.0, 0.25),
            tilt_rad=about(0.65, 0.12),
            frequency_std=about(0.025, 0.004),
            length_std=about(0.025, 0.004),
            habit=seed,
        )

    def step_frequency_hz(self, context: str) -> float:
        """Return the usual step frequency of this person in a context.

        Parameters
        ----------
        context : str
            One of `pdr_filter.CONTEXTS`.

        Returns
        -------
        float
            Steps per second, 0 for "stationary".
        """
        typical = CONTEXT_GAITS[context]
        return typical.frequency_hz * self.frequency_factor * (self.stairs_factor if typical.rise_m else 1.0)

    def step_length_m(self, context: str, frequency_hz: float) -> float:
        """Return the length of an average step of this person.

        Parameters
        ----------
        context : str
            One of `pdr_filter.CONTEXTS`.
        frequency_hz : float
            Step frequency in Hz.

        Returns
        -------
        float
            Length in m: the tread on stairs, else length_factor * height * (a + b * frequency).
        """
        typical = CONTEXT_GAITS[context]
        if typical.rise_m != 0.0:
            return STAIR_TREAD_M
        return self.length_factor * self.height_m * (typical.length_offset + typical.length_slope_s * frequency_hz)

    def vertical_force_mps2(self, context: str, frequency_hz: float, length_m: float, usual_mps2: float) -> float:
        """Return the amplitude of the vertical specific force at the step frequency.

        Parameters
        ----------
        context : str
            One of `pdr_filter.CONTEXTS`.
        frequency_hz, length_m : float
            Step frequency in Hz, and step length in m.
        usual_mps2 : float
            Measured amplitude at the usual frequency and length in this context. Not used for walking.

        Returns
        -------
        float
            Amplitude in m/s2.

        Notes
        -----
        For walking the amplitude follows from the step-length law (`BOUNCE_K`). In other contexts it is the measured
        amplitude, scaled with the squares of length and frequency as for an inverted pendulum.
        """
        if context == "walking":
            usual = length_m / (self.length_factor * self.height_m)
            return self.bounce_factor * self.length_factor**LENGTH_POWER * (usual / BOUNCE_K) ** 4 / frequency_hz
        usual_hz = CONTEXT_GAITS[context].frequency_hz
        relative = length_m / Gait().step_length_m(context, usual_hz)
        return self.bounce_factor * usual_mps2 * (relative * frequency_hz / usual_hz) ** 2


@dataclass(frozen=True, slots=True)
class Leg:
    """One stretch of a simulated walk in one context.

    Parameters
    ----------
    context : str
        One of `pdr_filter.CONTEXTS`.
    duration_s, distance_m : float, optional
        Exactly one of them. It is kept exactly, except that a distance on stairs is rounded to whole treads. Stationary
        legs take a duration.
    frequency_factor : float, default 1.0
        Step frequency relative to the usual one of the person. The step length follows from it.
    turn_rad : float, default 0.0
        Change of heading in rad, clockwise positive.
    curve : bool, default False
        If False, the person turns at the start of the leg and then walks straight on. If True, the turn extends over
        the whole leg.
    carrying_mode : str, optional
        Carrying mode from this leg on. None keeps the previous one.
    side : {"right", "left"}, default "right"
        Direction of a sideways leg.
    ride_up_m, ride_m : float, default 0.0
        Displacement by a lift or an escalator in this leg, upwards and forwards, in addition to the steps.

    Raises
    ------
    ValueError
        If the context is unknown, if not exactly one of duration and distance is given, or if a number is not allowed.

    Examples
    --------
    >>> from pdr_filter.simulate import Leg
    >>> legs = [Leg("walking", distance_m=20.0), Leg("upstairs", distance_m=5.22), Leg("stationary", duration_s=3.0)]
    >>> legs[0].joins(legs[1]), legs[1].joins(legs[2])
    (True, False)
    """

    context: str
    duration_s: float | None = None
    distance_m: float | None = None
    frequency_factor: float = 1.0
    turn_rad: float = 0.0
    curve: bool = False
    carrying_mode: str | None = None
    side: Literal["right", "left"] = "right"
    ride_up_m: float = 0.0
    ride_m: float = 0.0

    def __post_init__(self) -> None:
        if self.context not in CONTEXTS:
            raise ValueError(
                f"context must be one of {', '.join(CONTEXTS)}, got {self.context!r}: simulate a movement that is like "
                "it, and rename the labels of the recording"
            )
        if (self.duration_s is None) == (self.distance_m is None):
            raise ValueError(f"give a leg either duration_s or distance_m, got {self.duration_s} and {self.distance_m}")
        if self.context == "stationary" and self.duration_s is None:
            raise ValueError("a stationary leg covers no distance: give its duration_s")
        for name in ("duration_s", "distance_m", "frequency_factor"):
            if getattr(self, name) is not None:
                check_array(f"{name} of a leg", getattr(self, name), "positive")
        for name in ("turn_rad", "ride_up_m", "ride_m"):
            check_array(f"{name} of a leg", getattr(self, name))

    @property
    def moves(self) -> bool:
        """True unless the context is "stationary"."""
        return self.context != "stationary"

    @property
    def travel_offset_rad(self) -> float:
        """Walking heading minus the heading that the body faces, in rad."""
        if self.context != "sideways":
            return 0.0
        return np.pi / 2 if self.side == "right" else -np.pi / 2

    def joins(self, other: Leg) -> bool:
        """Return whether the person continues from this leg into another one without a stop.

        Parameters
        ----------
        other : Leg
            Next leg.

        Returns
        -------
        bool
            True if both legs move in the same direction relative to the body.
        """
        return self.moves and other.moves and self.travel_offset_rad == other.travel_offset_rad


@dataclass(frozen=True, slots=True, eq=False)
class StepPlan:
    """All K steps of a walk. A bout is a sequence of steps between two standstills."""

    leg_start_s: FloatArray  # (n_legs,)
    leg_end_s: FloatArray
    leg: IntArray  # (K,), as all following
    start_s: FloatArray
    contact_s: FloatArray  # contact of the foot that ends the step
    length_m: FloatArray
    rise_m: FloatArray
    first: BoolArray  # True for the first step of a bout
    last: BoolArray  # True for the last one


def plan_steps(legs: Sequence[Leg], gait: Gait, rng: np.random.Generator) -> StepPlan:
    """Return the plan of all steps along legs, with the random variation of the person from step to step."""
    leg_end: list[float] = []
    parts: list[tuple[FloatArray, ...]] = [tuple(np.zeros(0) for _ in range(7))]
    clock_s = 0.0
    for k, leg in enumerate(legs):
        if leg.moves:
            joins_previous = k > 0 and legs[k - 1].joins(leg)
            joins_next = k + 1 < len(legs) and leg.joins(legs[k + 1])
            durations, length = _leg_steps(leg, legs[k - 1] if joins_previous else None, joins_next, gait, rng)
            number = np.arange(n := len(durations))
            contact = clock_s + np.cumsum(durations)
            first, last = (number == 0) & (not joins_previous), (number == n - 1) & (not joins_next)
            rise = np.full(n, CONTEXT_GAITS[leg.context].rise_m)
            start = np.append(clock_s, contact[:-1])
            parts.append((np.full(n, k), start, contact, length, rise, first, last))
            clock_s = float(contact[-1])
        else:
            clock_s += float(leg.duration_s or 0.0)
        leg_end.append(clock_s)
    leg_of, start, contact, length, rise, first, last = (np.concatenate(column) for column in zip(*parts, strict=True))
    started, ended = np.array([0.0, *leg_end])[:-1], np.array(leg_end)
    of_leg, first, last = leg_of.astype(np.int64), first.astype(bool), last.astype(bool)
    return StepPlan(started, ended, of_leg, start, contact, length, rise, first, last)


def _leg_steps(
    leg: Leg, before: Leg | None, joins_next: bool, gait: Gait, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return the durations in s and the lengths in m of the steps of one moving leg.

    `before` is the previous leg if the person continues from it, else None. The steps after setting off and before
    stopping are shorter. Their sum is the duration or length of the leg, except for a distance on stairs.
    """
    frequency_hz, mean_m = nominal_step(leg, gait)
    on_stairs = CONTEXT_GAITS[leg.context].rise_m != 0.0
    n_ends = 0 if on_stairs else (before is None) + (not joins_next)
    if leg.duration_s is not None:
        n = max(1, round(leg.duration_s * frequency_hz))
    else:
        missing = n_ends * sum(1.0 - factor for factor in END_STEP_FACTORS)
        n = max(1, round(float(leg.distance_m or 0.0) / mean_m + missing))
    variation = np.clip(rng.standard_normal((2, n)), -2.5, 2.5)
    durations = (1.0 + gait.frequency_std * variation[0]) / frequency_hz
    lengths = np.full(n, mean_m)
    if not on_stairs:
        lengths *= 1.0 + gait.length_std * variation[1]
        for k, factor in enumerate(END_STEP_FACTORS[:n]):
            lengths[k] *= factor if before is None else 1.0
            lengths[-1 - k] *= 1.0 if joins_next else factor
    if before is not None:
        # the first step at a new pace is the mean of both paces
        before_hz, before_m = nominal_step(before, gait)
        durations[0] = 0.5 * (durations[0] + 1.0 / before_hz)
        lengths[0] = lengths[0] if on_stairs else 0.5 * (lengths[0] + before_m)
    if leg.duration_s is not None:
        durations *= leg.duration_s / durations.sum()
    elif not on_stairs:
        lengths *= float(leg.distance_m or 0.0) / lengths.sum()
    return durations, lengths


def nominal_step(leg: Leg, gait: Gait) -> tuple[float, float]:
    """Return the mean step frequency in Hz and step length in m on a leg. ValueError for steps under 0.1 m."""
    frequency_hz = gait.step_frequency_hz(leg.context) * leg.frequency_factor
    length_m = gait.step_length_m(leg.context, frequency_hz)
    if length_m < 0.1:
        raise ValueError(
            f"frequency_factor {leg.frequency_factor} gives steps of {length_m:.2f} m in the context {leg.context!r}: "
            "use a factor closer to 1"
        )
    return frequency_hz, length_m
