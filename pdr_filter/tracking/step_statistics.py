"""How many windows and steps there were, and how many of them were odd: what notes are made of."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pdr_filter.sensing.contexts.context_stage import WindowContext
from pdr_filter.values import HARDLY_AGREE, ContextSet, Step

# Half a radian: a step in this direction is an eighth shorter than a linear filter takes it to be.
UNKNOWN_HEADING_RAD = 0.5
# A position that moves by more than two steps besides the step itself is worth a warning.
MOVE_M = 2.0


@dataclass(frozen=True, slots=True)
class WindowCounts:
    """How many windows there were, and how many of them were odd."""

    n: int = 0
    without_gyroscope: int = 0
    unknown: int = 0
    stairs_unknown: int = 0  # of windows without climb rate in which somebody walks
    irregular: int = 0

    def plus(self, window: WindowContext, contexts: ContextSet) -> WindowCounts:
        """With one window more."""
        irregular = window.irregular_prob > 0.5 and window.prob[contexts.standing].sum() < 0.5
        walks = window.stairs_unknown_share > 0.5 and window.prob[contexts.level_walking].sum() > 0.5
        blind = walks and np.isnan(window.climb_rate_mps)
        return WindowCounts(
            self.n + 1,
            self.without_gyroscope + (not window.has_gyroscope),
            self.unknown + (window.unknown_share > 0.5),
            self.stairs_unknown + int(blind),
            self.irregular + int(irregular),
        )


@dataclass(frozen=True, slots=True)
class StepCounts:
    """Number of steps, of those with a doubtful direction, and where the heading was unknown or found late."""

    n: int = 0
    untrusted: int = 0
    quick_and_soft: int = 0
    heading_unknown: int = 0  # with a standard deviation of the heading of more than `UNKNOWN_HEADING_RAD`
    unknown_from_s: float = math.nan  # the first of them
    unknown_until_s: float = math.nan  # and the last
    largest_move_m: float = 0.0  # by which the filter moved the present position at a step, besides the step itself
    largest_move_s: float = math.nan

    def plus(self, step: Step, heading_std_rad: float, moved_m: float) -> StepCounts:
        """Return the counts with one more step, the heading's uncertainty after it, and the move of the position."""
        is_untrusted = math.isfinite(step.shown_offset_std_rad) and step.direction_trust < HARDLY_AGREE
        counts = replace(
            self,
            n=self.n + 1,
            untrusted=self.untrusted + is_untrusted,
            quick_and_soft=self.quick_and_soft + step.is_quick_and_soft,
        )
        if heading_std_rad > UNKNOWN_HEADING_RAD:
            since_s = self.unknown_from_s if self.heading_unknown else step.time_s
            n = self.heading_unknown + 1
            counts = replace(counts, heading_unknown=n, unknown_from_s=since_s, unknown_until_s=step.time_s)
        if moved_m > max(self.largest_move_m, MOVE_M):
            counts = replace(counts, largest_move_m=moved_m, largest_move_s=step.time_s)
        return counts
