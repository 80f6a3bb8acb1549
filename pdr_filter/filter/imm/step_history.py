"""The last final steps of a track: what the next step, late fixes and the walking speed need of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from pdr_filter.filter.imm.motion_model import EAST, LOG_SCALE, NORTH
from pdr_filter.filter.imm.walking_speed import WalkingSpeed, after_step
from pdr_filter.values import FloatArray, Step, interpolated, replace_unchecked

# Final steps that are remembered for late fixes: a minute at four steps a second, which is how late a fix may be
# (`filtering.MAX_FIX_AGE_S`).
TRAIL_STEPS = 256
# Columns of the trail.
TRAIL_TIME, TRAIL_HEADING = 0, 3
TRAIL_POSITION = slice(1, 3)


@dataclass(frozen=True, slots=True, eq=False)
class Walked:
    """One step as a tracker weighted it. Evidence also moves the estimated position, which is not walking."""

    length_m: float
    length_var_m2: float  # without the person's scale
    heading_rad: float
    parameter_std_m: FloatArray  # (M,) due to the parameters of each mode's length model, weighted by its probability
    direction: FloatArray  # (M, 2), or (1, 2) of all: east and north of the unit vector in which each mode walked


@dataclass(frozen=True, eq=False)
class StepHistory:
    """The last final steps."""

    n_final: int = 0  # steps so far
    last_s: float = math.nan  # contact of the last one; NaN before the first of a segment
    gap_s: float = 0.0  # time without samples since then
    speed: WalkingSpeed | None = None  # after the last one; None before the first of a segment
    trail: FloatArray = field(default_factory=lambda: np.empty((0, 4)))  # (R, 4) time, east, north, device heading

    @property
    def end_s(self) -> float:
        """Contact of the last step; minus infinity before the first."""
        return float(self.trail[-1, TRAIL_TIME]) if len(self.trail) else -math.inf

    def plus(self, step: Step, walked: Walked, x: FloatArray, P: FloatArray) -> StepHistory:
        """Return the history with one more step, after which the estimate has mean x (4,) and covariance P (4, 4)."""
        # a pause before the step starts the smoothed speed afresh
        is_first = math.isnan(self.last_s) or step.time_s - self.last_s > 1.5 * step.duration_s
        scale_var = float(P[LOG_SCALE, LOG_SCALE])
        speed = after_step(self.speed, walked.length_m, walked.length_var_m2, step.duration_s, scale_var, is_first)
        trail = np.empty((min(len(self.trail) + 1, TRAIL_STEPS), 4))
        trail[:-1] = self.trail[len(self.trail) + 1 - len(trail) :]
        trail[-1] = step.time_s, x[EAST], x[NORTH], step.device_heading_rad
        return StepHistory(self.n_final + 1, step.time_s, 0.0, speed, trail)

    def after_gap(self, gap_s: float) -> StepHistory:
        """Return the history after a time without samples."""
        return replace_unchecked(self, last_s=math.nan, gap_s=self.gap_s + gap_s, speed=None)

    def moved(self, positions: Callable[[FloatArray], FloatArray]) -> StepHistory:
        """Return the history with its places moved by a function of positions (..., 2)."""
        trail = self.trail.copy()
        trail[:, TRAIL_POSITION] = positions(self.trail[:, TRAIL_POSITION])
        return replace_unchecked(self, trail=trail)

    def at(self, time_s: float) -> FloatArray | None:
        """East, north and device heading (3,) at a time; None before the first step, or from before the trail."""
        trail = self.trail
        if len(trail) == 0 or (time_s < trail[0, TRAIL_TIME] and len(trail) == TRAIL_STEPS):
            return None
        return interpolated(time_s, trail[:, TRAIL_TIME], trail[:, 1 : TRAIL_HEADING + 1])
