"""How many windows and steps there were, and how many of them were odd: what notes are made of."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np

from pdr_filter.sensing.contexts.stage import WindowContext
from pdr_filter.values import CONTEXTS, HARDLY_AGREE, Step

_STATIONARY, _WALKING = CONTEXTS.index("stationary"), CONTEXTS.index("walking")


@dataclass(frozen=True, slots=True)
class WindowCounts:
    """How many windows there were, and how many of them were odd."""

    n: int = 0
    without_gyroscope: int = 0
    unknown: int = 0
    stairs_unknown: int = 0  # of windows without climb rate in which somebody walks
    irregular: int = 0

    def plus(self, window: WindowContext) -> WindowCounts:
        """With one window more."""
        irregular = window.irregular_prob > 0.5 and window.prob[_STATIONARY] < 0.5
        blind = window.stairs_unknown_share > 0.5 and window.prob[_WALKING] > 0.5 and np.isnan(window.climb_rate_mps)
        return WindowCounts(
            self.n + 1,
            self.without_gyroscope + (not window.has_gyroscope),
            self.unknown + (window.unknown_share > 0.5),
            self.stairs_unknown + int(blind),
            self.irregular + int(irregular),
        )


@dataclass(frozen=True, slots=True)
class StepCounts:
    """How many steps there were, and of how many the direction, or all, is doubtful."""

    n: int = 0
    untrusted: int = 0
    quick_and_soft: int = 0

    def plus(self, step: Step) -> StepCounts:
        """With one step more."""
        is_untrusted = isfinite(step.shown_offset_std_rad) and step.direction_trust < HARDLY_AGREE
        return StepCounts(self.n + 1, self.untrusted + is_untrusted, self.quick_and_soft + step.is_quick_and_soft)
