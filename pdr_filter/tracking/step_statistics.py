"""Doubtful windows and steps: the criteria, the words, and how many there are.

Notes give the number of doubtful windows or steps, the report gives their times. Both use these criteria and words.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pdr_filter.sensing.contexts.context_stage import WindowContext
from pdr_filter.values import HARDLY_AGREE, BoolArray, ContextSet, FloatArray, Step

# Half a radian: a step in this direction is an eighth shorter than a linear filter takes it to be.
UNKNOWN_HEADING_RAD = 0.5
# A position that moves by more than two steps besides the step itself is worth a warning.
MOVE_M = 2.0
_KNOW_BIAS = "rest for five seconds before the walk, or give `device` of an earlier recording of the phone or fixes"

NO_STEPS = "no steps found, so that dead reckoning does not apply here"
STEPLESS = "the phone moved without steps, as in a vehicle or a lift: no distance is counted there"
HANDLED = "the phone was handled, not carried: steps there may be false or lost"
UNFAMILIAR = (
    "the motion is unlike all that the context model was trained on: contexts, and the step lengths that follow from "
    "them, are guesses"
)
NO_DIRECTION = (
    "strides do not agree on where walking leads, as in a bag: the turn of the phone alone leads the track, and where "
    "the phone was turned against the body the track has turned too"
)
QUICK_AND_SOFT = (
    "steps are as quick as running and as soft as walking, as on the spot: how long they are, and where they lead, is "
    "unsure"
)
LATE = (
    "when the heading or the context of earlier steps was found to be another one: pdr_filter.smooth corrects these "
    f"steps, too; {_KNOW_BIAS}"
)
HEADING_UNKNOWN = f"the bias of the gyroscope is hardly known; {_KNOW_BIAS}"
REJECTED = "not fit the track or its time"


def is_moving(standing_prob: FloatArray | float) -> BoolArray:
    """Whether the phone moves in a window (...,), from the probability of the contexts that stand."""
    return np.asarray(standing_prob) < 0.5


def is_handled(irregular_prob: FloatArray | float, standing_prob: FloatArray | float) -> BoolArray:
    """Whether the phone moves in a window (...,) and is not carried by somebody who walks."""
    return is_moving(standing_prob) & (irregular_prob > 0.5)


def is_unfamiliar(unknown_share: FloatArray | float) -> BoolArray:
    """Whether a window (...,) is unlike those of the training."""
    return np.asarray(unknown_share) > 0.5


def is_without_direction(shown_offset_std_rad: FloatArray | float, direction_trust: FloatArray | float) -> BoolArray:
    """Whether strides disagree on the walking direction at a step (...,)."""
    return np.isfinite(shown_offset_std_rad) & (np.asarray(direction_trust) < HARDLY_AGREE)


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
        standing_prob = float(window.prob[contexts.standing].sum())
        walks = window.stairs_unknown_share > 0.5 and window.prob[contexts.level_walking].sum() > 0.5
        blind = walks and np.isnan(window.climb_rate_mps)
        return WindowCounts(
            self.n + 1,
            self.without_gyroscope + (not window.has_gyroscope),
            self.unknown + int(is_unfamiliar(window.unknown_share)),
            self.stairs_unknown + int(blind),
            self.irregular + int(is_handled(window.irregular_prob, standing_prob)),
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
        is_untrusted = bool(is_without_direction(step.shown_offset_std_rad, step.direction_trust))
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
