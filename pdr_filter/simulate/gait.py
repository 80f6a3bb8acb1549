"""What is simulated: the person (`Gait`), the stretches of the walk (`Leg`) and the steps planned from both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pdr_filter.values import CONTEXTS, BoolArray, FloatArray, IntArray, check_array

STAIR_RISE_M = 0.17
STAIR_TREAD_M = 0.29
STOREY_HEIGHT_M = 18 * STAIR_RISE_M
TYPICAL_HEIGHT_M = 1.75
# A person sets off and stops with shorter steps: the first is half a step, since the feet are together.
END_STEP_FACTORS = (0.45, 0.8, 0.95)


@dataclass(frozen=True, slots=True)
class ContextGait:
    """How a typical person moves in one context; what that does to the phone is in `strides`.

    Step length is height * (length_offset + length_slope_s * frequency), except on stairs, where it is the tread.
    """

    frequency_hz: float = 0.0
    length_offset: float = 0.0
    length_slope_s: float = 0.0
    rise_m: float = 0.0  # height gained by each step
    tremor: float = 1.0  # motion that does not repeat with the strides, relative to standing


CONTEXT_GAITS = {
    "stationary": ContextGait(),
    "walking": ContextGait(1.9, 0.05, 0.2, tremor=2.2),
    "upstairs": ContextGait(1.85, rise_m=STAIR_RISE_M, tremor=1.5),
    "downstairs": ContextGait(2.05, rise_m=-STAIR_RISE_M, tremor=1.5),
    "sideways": ContextGait(1.4, 0.089, 0.12, tremor=1.5),
    "running": ContextGait(2.7, -0.239, 0.3, tremor=2.0),
}

# Step length L, m, of somebody of height h: L = k h (f A)^(1/4), f the step frequency and A the amplitude of the
# vertical force at it, fitted on 298 legs of known length; the default's own law has no f (`BounceStepLength`).
BOUNCE_K = 0.293
# People's steps differ by 6 % from that law: some take longer steps than others of that height and cadence without more
# force. For differences of length between people A goes with this power of the length, not with the fourth.
LENGTH_POWER = 2.4
# People measured differ by 0.29 in the logarithm of A, of which 6 % of the length explain 0.24.
FORCE_POWER = 0.8


def walking_law(frequency_hz: float) -> float:
    """A, m/s2, of steps of the usual length at that frequency."""
    return Gait().vertical_force_mps2("walking", frequency_hz, Gait().step_length_m("walking", frequency_hz), 0.0)


@dataclass(frozen=True, slots=True)
class Gait:
    """A person; `Gait()` is a typical one and `Gait.random(seed)` somebody else; factors are to the typical one."""

    height_m: float = TYPICAL_HEIGHT_M  # step lengths and the places of the phone scale with it
    frequency_factor: float = 1.0
    stairs_factor: float = 1.0  # of the frequency on stairs
    length_factor: float = 1.0  # of steps, beside a typical person of that height
    bounce_factor: float = 1.0  # force of the steps, beside what their length and frequency say
    impact_factor: float = 1.0  # heel strike
    swing_factor: float = 1.0  # of legs and arms
    tremor_factor: float = 1.0  # unsteadiness of the hand
    tilt_rad: float = 0.65  # how far the top end of the phone is raised when it is held for reading
    frequency_std: float = 0.025  # relative, from step to step, as the next
    length_std: float = 0.025
    habit: int | None = None  # seed of how this person's strides differ from the typical ones

    @classmethod
    def random(cls, seed: int) -> Gait:
        """Person drawn from a population of adults; the same one for the same seed."""
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
        """Steps per second of this person in a context, 0 when stationary."""
        typical = CONTEXT_GAITS[context]
        return typical.frequency_hz * self.frequency_factor * (self.stairs_factor if typical.rise_m else 1.0)

    def step_length_m(self, context: str, frequency_hz: float) -> float:
        """Length of an average step of this person: the tread on stairs, else height * (a + b * frequency)."""
        typical = CONTEXT_GAITS[context]
        if typical.rise_m != 0.0:
            return STAIR_TREAD_M
        return self.length_factor * self.height_m * (typical.length_offset + typical.length_slope_s * frequency_hz)

    def vertical_force_mps2(self, context: str, frequency_hz: float, length_m: float, usual_mps2: float) -> float:
        """Amplitude of the vertical specific force at step frequency of such steps.

        Walking, what the law of the step length says; else that of people measured, which grows like that of an
        inverted pendulum, with the squares of length and frequency.
        """
        if context == "walking":
            usual = length_m / (self.length_factor * self.height_m)
            return self.bounce_factor * self.length_factor**LENGTH_POWER * (usual / BOUNCE_K) ** 4 / frequency_hz
        usual_hz = CONTEXT_GAITS[context].frequency_hz
        relative = length_m / Gait().step_length_m(context, usual_hz)
        return self.bounce_factor * usual_mps2 * (relative * frequency_hz / usual_hz) ** 2


@dataclass(frozen=True, slots=True)
class Leg:
    """One stretch of the walk in one context.

    Parameters
    ----------
    context : str
        One of `pdr_filter.values.contexts.CONTEXTS`.
    duration_s, distance_m : float, optional
        Exactly one of them; kept exactly, except that a distance on stairs is rounded to whole treads. Stationary
        legs take a duration.
    frequency_factor : float
        Step frequency relative to the person's usual one; the step length follows from it.
    turn_rad : float
        Change of heading, clockwise positive.
    curve : bool
        False: turn at the start of the leg, then straight on. True: turn over the whole leg.
    carrying_mode : str, optional
        From here on; as before if None.
    side : {"right", "left"}
        Where a sideways leg goes.
    ride_up_m, ride_m : float
        What a lift or an escalator moves the person in this leg, up and ahead, whether he walks on it or not.
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
        """True unless stationary."""
        return self.context != "stationary"

    @property
    def travel_offset_rad(self) -> float:
        """Walking heading minus the heading the body faces."""
        if self.context != "sideways":
            return 0.0
        return np.pi / 2 if self.side == "right" else -np.pi / 2

    def joins(self, other: Leg) -> bool:
        """Whether a person walks from this leg into the other without coming to a stop."""
        return self.moves and other.moves and self.travel_offset_rad == other.travel_offset_rad


@dataclass(frozen=True, slots=True, eq=False)
class StepPlan:
    """All steps of a walk; a bout is a row of steps between two standstills.

    `contact_s` is when the foot lands, which ends the step; `leg` says which leg a step belongs to.
    """

    leg_start_s: FloatArray  # (n_legs,)
    leg_end_s: FloatArray  # (n_legs,)
    leg: IntArray  # (K,)
    start_s: FloatArray  # (K,)
    contact_s: FloatArray  # (K,)
    length_m: FloatArray  # (K,)
    rise_m: FloatArray  # (K,)
    first: BoolArray  # (K,) first of its bout
    last: BoolArray  # (K,) last of its bout


def plan_steps(legs: Sequence[Leg], gait: Gait, rng: np.random.Generator) -> StepPlan:
    """Durations and lengths of all steps, with the person's variability from step to step."""
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
    """Durations and lengths of the steps of one moving leg."""
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
        # The first step of a new pace is between the paces.
        before_hz, before_m = nominal_step(before, gait)
        durations[0] = 0.5 * (durations[0] + 1.0 / before_hz)
        lengths[0] = lengths[0] if on_stairs else 0.5 * (lengths[0] + before_m)
    if leg.duration_s is not None:
        durations *= leg.duration_s / durations.sum()
    elif not on_stairs:
        lengths *= float(leg.distance_m or 0.0) / lengths.sum()
    return durations, lengths


def nominal_step(leg: Leg, gait: Gait) -> tuple[float, float]:
    """Step frequency, Hz, and step length, m, that the person aims at on this leg."""
    frequency_hz = gait.step_frequency_hz(leg.context) * leg.frequency_factor
    length_m = gait.step_length_m(leg.context, frequency_hz)
    if length_m < 0.1:
        raise ValueError(
            f"frequency_factor {leg.frequency_factor} makes {leg.context} steps of {length_m:.2f} m: "
            "use a factor closer to 1"
        )
    return frequency_hz, length_m
