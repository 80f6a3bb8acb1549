"""Last final steps of a track, as needed by the next step, by late fixes and by the walking speed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from pdr_filter.filter.imm.motion_model import EAST, LOG_SCALE, NORTH
from pdr_filter.filter.pedestrian.walking_speed import WalkingSpeed, speed_after_step
from pdr_filter.values import FloatArray, Step, interpolated_rows, replace_unchecked

# Number of stored final steps: one minute at four steps a second, the largest delay of a fix
# (`filtering.MAX_FIX_AGE_S`).
TRAIL_STEPS = 256
# Columns of the trail.
TRAIL_TIME, TRAIL_HEADING = 0, 3
TRAIL_POSITION = slice(1, 3)


@dataclass(frozen=True, slots=True, eq=False)
class Walked:
    """Length and heading of one step, weighted over the modes of a tracker.

    The estimated position may move by a different amount, because evidence also corrects it.
    """

    length_m: float  # weighted length in m
    length_var_m2: float  # variance of the length in m2, without the scale of the person
    heading_rad: float  # walking heading in rad
    # (M,) standard deviation in m due to the parameters of the length model of each mode, times the probability of the
    # mode
    parameter_std_m: FloatArray
    # (M, 2) unit vector (east, north) of the walking direction in each mode, or in all modes together
    direction: FloatArray


@dataclass(frozen=True, eq=False)
class StepHistory:
    """Last steps of a track whose estimates are final."""

    n_final: int = 0  # number of final steps
    # Time of the foot contact that ended the last step, s. NaN before the first step of a segment.
    last_s: float = math.nan
    gap_s: float = 0.0  # time without samples since the last step, s
    # time of motion without a known step since the last step, s, as far as it has been added to the covariance
    stepless_s: float = 0.0
    speed: WalkingSpeed | None = None  # walking speed after the last step, or None before the first step of a segment
    # (R, 4) time (s), east (m), north (m) and device heading (rad) of the last R steps
    trail: FloatArray = field(default_factory=lambda: np.empty((0, 4)))

    @property
    def end_s(self) -> float:
        """Contact of the last step, or minus infinity before the first step."""
        return float(self.trail[-1, TRAIL_TIME]) if len(self.trail) else -math.inf

    def plus(self, step: Step, walked: Walked, x: FloatArray, P: FloatArray) -> StepHistory:
        """Return the history with one more step, after which the estimate has mean x (4,) and covariance P (4, 4).

        The state x is east and north (m), heading offset (rad), and log scale of the step length.
        """
        # after a pause the smoothed speed starts again
        is_first = math.isnan(self.last_s) or step.time_s - self.last_s > 1.5 * step.duration_s
        scale_var = float(P[LOG_SCALE, LOG_SCALE])
        speed = speed_after_step(
            self.speed, walked.length_m, walked.length_var_m2, step.duration_s, scale_var, is_first
        )
        trail = np.empty((min(len(self.trail) + 1, TRAIL_STEPS), 4))
        trail[:-1] = self.trail[len(self.trail) + 1 - len(trail) :]
        trail[-1] = step.time_s, x[EAST], x[NORTH], step.reference_heading_rad
        return StepHistory(self.n_final + 1, step.time_s, speed=speed, trail=trail)

    def after_gap(self, gap_s: float) -> StepHistory:
        """Return the history after a time without samples, without the time and the walking speed of a last step.

        `gap_s` is added to the earlier gaps since the last step. The stored positions of the steps are kept.
        """
        return replace_unchecked(self, last_s=math.nan, gap_s=self.gap_s + gap_s, speed=None)

    def with_moved_track(self, positions: Callable[[FloatArray], FloatArray]) -> StepHistory:
        """Return the history with its positions transformed by a function of positions (..., 2)."""
        trail = self.trail.copy()
        trail[:, TRAIL_POSITION] = positions(self.trail[:, TRAIL_POSITION])
        return replace_unchecked(self, trail=trail)

    def at(self, time_s: float) -> FloatArray | None:
        """Return east, north and device heading (3,) at a time, interpolated between the steps.

        Before the first step it has the values of the first step, and after the last step the values of the last step.
        The result is None without steps, and before the oldest stored step if earlier steps are no longer stored.
        """
        trail = self.trail
        if len(trail) == 0 or (time_s < trail[0, TRAIL_TIME] and len(trail) == TRAIL_STEPS):
            return None
        return interpolated_rows(time_s, trail[:, TRAIL_TIME], trail[:, 1 : TRAIL_HEADING + 1])
