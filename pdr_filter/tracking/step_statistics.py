"""Criteria, texts and counters for windows and steps that are unreliable.

The warnings (`warnings`) give the number of unreliable windows or steps, and the report (`trust_report`) gives their
times. Both use the criteria and texts of this module.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdr_filter.values import (
    HARDLY_AGREE,
    BoolArray,
    ContextSet,
    FloatArray,
    IntArray,
    Step,
    WindowContext,
    replace_unchecked,
)

# Standard deviation of the heading above which it counts as unknown. At an error of 0.5 rad a step advances by 12 %
# less along the estimated direction than a linear filter assumes.
UNKNOWN_HEADING_RAD = 0.5
# Minimum correction of the position that is reported: more than two step lengths, besides the step itself.
MOVE_M = 2.0
_BIAS_REMEDY = (
    "to estimate the gyroscope bias early, rest for three seconds before the walk, or give fixes or the `device` of an "
    "earlier recording of the phone"
)

# Texts shared by the warnings of `warnings` and the report of `trust_report`. Each follows a number or times.
NO_STEPS = "no steps were detected, so that the track stays at its start; dead reckoning needs a recording of a walk"
STEPLESS = (
    "the phone moved without steps, as in a vehicle or a lift: no distance is counted there; track the walks before "
    "and after a ride separately"
)
HANDLED = (
    "the phone was handled (taken out, turned or put away): steps there may be false or missed; carry the phone in one "
    "place"
)
UNFAMILIAR = (
    "the motion is unlike all training data of the context model: contexts and step lengths there are unreliable; "
    "train a model with such motion (pdr_filter.fit_contexts)"
)
UNLIKE = (
    "the motion is farther from the training data of the context model than nearly all motion of people who were held "
    "out: the person or the placement of the phone may be new, and contexts and step lengths wrong; train a model with "
    "such motion (pdr_filter.fit_contexts)"
)
IN_STANDING = (
    "steps were detected in a context without steps (such as stationary): the context model does not fit this person "
    "or placement, or the steps are false; train a model with such motion (pdr_filter.fit_contexts), or use the "
    "default model"
)
NO_DIRECTION = (
    "the walking direction is uncertain, because the phone was moved to another place where strides do not agree on a "
    "direction (as in a bag): give position or heading fixes"
)
QUICK_AND_SOFT = (
    "steps are as quick as running and as soft as walking, and push in no common direction (as when running on the "
    "spot): their length and direction are uncertain; give position fixes"
)
LATE = (
    "because the heading or the context of earlier steps was corrected late: pdr_filter.smooth also corrects the "
    f"earlier positions; {_BIAS_REMEDY}"
)
HEADING_UNKNOWN = f"the gyroscope bias is poorly known, or the angular rate is missing; {_BIAS_REMEDY}"
REJECTED = "not fit the track or its time"


def is_moving(standing_prob: FloatArray | float) -> BoolArray:
    """True for windows (...,) in which the phone moves.

    The contexts without steps then have less than half of the probability (`standing_prob`).
    """
    return np.asarray(standing_prob) < 0.5


def is_handled(irregular_prob: FloatArray | float, standing_prob: FloatArray | float) -> BoolArray:
    """True for windows (...,) in which the phone is taken out, turned, or put away.

    The phone then moves, and irregular motion has more than half of the probability.
    """
    return is_moving(standing_prob) & (irregular_prob > 0.5)


def is_unfamiliar(unknown_share: FloatArray | float) -> BoolArray:
    """True for windows (...,) that are unlike the training windows of the context model.

    With the sensor at the leg (terrain), no window is above the limit of 0.5. A limit of 0.25 would report 29 % of
    these windows, but also 6 % of those of ubicomp13, in which walking is recognised.
    """
    return np.asarray(unknown_share) > 0.5


def is_in_standing(context_prob: FloatArray, standing: Sequence[int] | IntArray) -> BoolArray:
    """True for steps (...,) whose most probable context has no steps.

    `context_prob` (..., C) are the context probabilities of the steps, and `standing` the indices of the contexts
    without steps.
    """
    return (context_prob.argmax(axis=-1)[..., None] == np.asarray(standing)).any(axis=-1)  # np.isin takes 30 us a step


def is_without_direction(
    carried_since_s: FloatArray | float, first_carried_s: float, direction_trust: FloatArray | float
) -> BoolArray:
    """True for steps (...,) whose strides disagree on the walking direction, after the phone was moved.

    In its first place, at time `first_carried_s`, the phone needs no direction from strides, because the first heading
    defines the frame of the track.
    """
    return (np.asarray(carried_since_s) > first_carried_s) & (np.asarray(direction_trust) < HARDLY_AGREE)


def is_on_the_spot(is_quick_and_soft: BoolArray | bool, direction_trust: FloatArray | float) -> BoolArray:
    """True for quick and soft steps (...,) whose strides push in no common direction.

    Strides that agree on a direction lead somewhere, and the covariance contains the uncertain length of quick and soft
    steps (`PedestrianModel.own_var_m2`).
    """
    return np.asarray(is_quick_and_soft) & (np.asarray(direction_trust) < HARDLY_AGREE)


@dataclass(frozen=True, slots=True)
class WindowCounts:
    """Number of windows, and of those that are unreliable."""

    n: int = 0  # all windows
    without_gyroscope: int = 0  # windows without angular rate
    unknown: int = 0  # windows that are unlike the training data of the context model
    irregular: int = 0  # windows in which the phone was handled
    unlike: int = 0  # windows farther from the training data than nine of ten windows of held-out people

    def plus(self, window: WindowContext, contexts: ContextSet) -> WindowCounts:
        """Return the counts with one more window."""
        standing_prob = float(window.prob[contexts.standing].sum())
        return WindowCounts(
            self.n + 1,
            self.without_gyroscope + (not window.has_gyroscope),
            self.unknown + int(is_unfamiliar(window.unknown_share)),
            self.irregular + int(is_handled(window.irregular_prob, standing_prob)),
            self.unlike + int(window.is_unlike),
        )


@dataclass(frozen=True)
class StepCounts:
    """Number of steps, of those that are unreliable, and the times of the problems."""

    n: int = 0  # all steps
    untrusted: int = 0  # steps whose strides disagree on the walking direction, after the phone was moved
    in_standing: int = 0  # steps whose most probable context has no steps
    # Steps that are too quick for walking and too soft for running, and push in no common direction
    on_the_spot: int = 0
    # Time when the phone was put into its first place, s. Infinite before the first stride.
    first_carried_s: float = math.inf
    heading_unknown: int = 0  # steps with a standard deviation of the heading above `UNKNOWN_HEADING_RAD`
    # Times of the first and the last step with an unknown heading, s. NaN if there are none.
    unknown_from_s: float = math.nan
    unknown_until_s: float = math.nan
    # Largest correction of the position at a step, besides the step itself, m. 0 if none exceeds `MOVE_M`.
    largest_move_m: float = 0.0
    largest_move_s: float = math.nan  # time of the step with this largest correction, s. NaN if there is none.

    def plus(self, step: Step, heading_std_rad: float, moved_m: float) -> StepCounts:
        """Return the counts with one more step.

        `heading_std_rad` is the standard deviation of the heading after the step. `moved_m` is the correction of the
        position besides the step itself.
        """
        since_s, trust = step.carried_since_s, step.direction_trust
        first_s = min(self.first_carried_s, since_s) if math.isfinite(since_s) else self.first_carried_s
        counts = replace_unchecked(
            self,
            n=self.n + 1,
            untrusted=self.untrusted + bool(is_without_direction(since_s, first_s, trust)),
            on_the_spot=self.on_the_spot + bool(is_on_the_spot(step.is_quick_and_soft, trust)),
            first_carried_s=first_s,
        )
        if heading_std_rad > UNKNOWN_HEADING_RAD:
            since_s = self.unknown_from_s if self.heading_unknown else step.time_s
            n = self.heading_unknown + 1
            counts = replace_unchecked(counts, heading_unknown=n, unknown_from_s=since_s, unknown_until_s=step.time_s)
        if moved_m > max(self.largest_move_m, MOVE_M):
            counts = replace_unchecked(counts, largest_move_m=moved_m, largest_move_s=step.time_s)
        return counts

    def plus_context(self, is_in_standing: bool) -> StepCounts:
        """Return the counts with one more step whose context is known, and without steps if `is_in_standing`."""
        return replace_unchecked(self, in_standing=self.in_standing + 1) if is_in_standing else self
