"""Contact times without the unevenness of left and right that the place of the phone makes.

In a pocket the wavelet sees the step of the near leg at another phase than that of the far one, so that every second
contact is early and the others late, by up to 0.17 s together. The offset is the place's, alternates with the steps and
changes slowly: it is learnt from the past, so that no step waits for the next one and online is offline.

With three contacts the one in the middle is off by d = t_1 - (t_0 + t_2) / 2 from even steps. If contact k is late by
(-1)^k e, d is twice that: (-1)^k e is estimated as d / 2, which takes half of the way and half of the noise that the
mean t_0 / 4 + t_1 / 2 + t_2 / 4 takes of the middle one. The estimates, each with its sign, have a running mean.

Before that, a step that is two becomes two, with the contact that the detector missed in the middle: in a hand that
swings every second one is weak.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

from pdr_filter.values import Step, replace_unchecked

# Intervals that differ by more are not left and right: a step is missing or a pause lies between.
_MAX_RATIO = 1.8
# A mean of about the last five steps; 0.6 to 0.95 make no difference (0.0005 in F1, oxford).
_DECAY = 0.8
# No contact is moved further, nor by more than a fifth of its interval: the order of the steps stays.
_MAX_SHIFT_S, _MAX_SHARE = 0.1, 0.2
# Weight of no unevenness, in steps: the first estimate of a bout counts two thirds.
_PRIOR_STEPS = 0.5


@dataclass(frozen=True)
class EvenStepsState:
    """The last contacts as they were found, and the unevenness."""

    contacts_s: tuple[float, ...] = ()  # the last two of an even stretch
    shift_s: float = 0.0  # what was added to the last contact
    n: float = 0.0  # weight of the estimates
    late_s: float = 0.0  # their sum: lateness of the last contact's side


@dataclass(frozen=True, slots=True)
class EvenSteps:
    """Moves contacts to where left and right are even, as far as the steps so far tell; causal, without delay."""

    def init(self) -> EvenStepsState:
        """State before the first step."""
        return EvenStepsState()

    def update(
        self, state: EvenStepsState, steps: Sequence[tuple[int, Step]]
    ) -> tuple[EvenStepsState, list[tuple[int, Step]]]:
        """New state, and the steps with their times, durations and frequencies made even."""
        moved: list[tuple[int, Step]] = []
        for number, step in steps:
            for part in _halves(step) if step.is_two else (step,):
                before, state = state, _after(state, part.time_s)
                moved.append((number, _moved(part, before, state.shift_s)))
        return state, moved


def _halves(step: Step) -> tuple[Step, Step]:
    """The two steps, with the person's usual bounce; what was learnt of the direction is known after both."""
    half_s, quarter_rad = 0.5 * step.duration_s, 0.25 * step.heading_change_rad
    both = replace_unchecked(
        step,
        duration_s=half_s,
        frequency_hz=1.0 / half_s,
        heading_change_rad=2.0 * quarter_rad,
        vertical_amplitude_mps2=step.usual_amplitude_mps2,
        stride_amplitude_mps2=step.usual_amplitude_mps2,
        is_two=False,
    )
    first = replace_unchecked(
        both,
        time_s=step.time_s - half_s,
        device_heading_rad=step.device_heading_rad - quarter_rad,
        walking_heading_std_rad=inf,
        offset_change_std_rad=0.0,
        heading_unknown_s=0.0,
        north_std_rad=inf,
    )
    second = replace_unchecked(
        both,
        device_heading_rad=step.device_heading_rad + quarter_rad,
        walking_heading_rad=step.walking_heading_rad + quarter_rad,
    )
    return first, second


def _after(state: EvenStepsState, contact_s: float) -> EvenStepsState:
    """State after a contact."""
    contacts_s = (*state.contacts_s[-2:], contact_s)
    if len(contacts_s) < 3:
        return EvenStepsState(contacts_s)
    earlier_s, later_s = contacts_s[1] - contacts_s[0], contacts_s[2] - contacts_s[1]
    if max(earlier_s, later_s) > _MAX_RATIO * min(earlier_s, later_s):
        return EvenStepsState(contacts_s[1:])
    # the middle contact is late by a quarter of what the interval before it is longer; this one is of the other side
    n = _DECAY * state.n + 1.0
    late_s = -_DECAY * state.late_s - (earlier_s - later_s) / 4
    limit_s = min(_MAX_SHIFT_S, _MAX_SHARE * later_s)
    return EvenStepsState(contacts_s, min(max(-late_s / (n + _PRIOR_STEPS), -limit_s), limit_s), n, late_s)


def _moved(step: Step, before: EvenStepsState, shift_s: float) -> Step:
    """The step with its contact moved, and its beginning with the contact before it, where that is its beginning."""
    begins_s = step.time_s - step.duration_s
    follows = bool(before.contacts_s) and abs(begins_s - before.contacts_s[-1]) < 1e-6
    duration_s = step.duration_s + shift_s - (before.shift_s if follows else 0.0)
    return replace_unchecked(step, time_s=step.time_s + shift_s, duration_s=duration_s, frequency_hz=1.0 / duration_s)
