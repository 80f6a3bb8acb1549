"""Remove the alternating error of contact times between left and right that the place of the phone causes.

In a pocket the wavelet detects the steps of the near leg at another phase than those of the far leg. Every second
contact is therefore early and the others late, with a difference of up to 0.17 s. The error belongs to the place of the
phone, alternates with the steps and changes slowly. It is estimated from past steps only, so that no step waits for the
next one, and online and offline results are equal.

For three consecutive contacts, d = t_1 - (t_0 + t_2) / 2 is the deviation of the middle one from equal intervals. If
contact k is late by (-1)^k e, then d = 2 (-1)^k e, and d / 2 estimates (-1)^k e. This has half the correction and half
the noise of replacing the middle contact by t_0 / 4 + t_1 / 2 + t_2 / 4. The signed estimates are averaged by an
exponentially weighted mean.

Before the correction, a step that spans two steps is split in the middle. The detector missed the contact there. With a
swinging hand, every second contact is weak.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from pdr_filter.sensing.steps.step_log import NumberedSteps
from pdr_filter.sensing.steps.step_stage import StepStage
from pdr_filter.values import Step, replace_unchecked

# Largest ratio of consecutive intervals of left and right. Beyond it a step is missing, or there was a pause.
_MAX_RATIO = 1.8
# Decay of the mean per step, which averages about the last five steps. Values from 0.6 to 0.95 make no difference
# (0.0005 in F1, oxford).
_DECAY = 0.8
# Largest shift of a contact, in s and as a share of its interval, which keeps the steps in order.
_MAX_SHIFT_S, _MAX_SHARE = 0.1, 0.2
# Weight of the prior of zero error, in steps: the first estimate of a bout counts two thirds.
_PRIOR_STEPS = 0.5


@dataclass(frozen=True)
class ContactTimeSmoothingState:
    """Last detected contacts, and the estimate of the alternating error."""

    # Detected times of the last contacts (up to three) without a pause between them, s.
    contacts_s: tuple[float, ...] = ()
    shift_s: float = 0.0  # correction added to the last contact, s
    n: float = 0.0  # total weight of the estimates, in steps
    late_s: float = 0.0  # weighted sum of the estimated delays of the foot of the last contact, s


@dataclass(frozen=True, slots=True)
class ContactTimeSmoothing(StepStage[ContactTimeSmoothingState]):
    """Causal stage that moves contacts to equal intervals of left and right, as far as past steps show their error.

    It has no parameters and no delay. It also splits steps that span two steps because a contact was missed.

    Examples
    --------
    Contacts of the left foot are detected 0.05 s late:

    >>> from dataclasses import replace
    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> from pdr_filter.sensing.steps.contact_time_smoothing import ContactTimeSmoothing
    >>> step = pdr.Step(0.0, 0.0, 0.5, 2.0, 4.0, 2.0, -2.0, 12.0, 8.0, 1.0, 0.0, 0.0)
    >>> contacts_s = 0.5 * np.arange(20) + 0.05 * (np.arange(20) % 2)
    >>> durations_s = np.diff([-0.45, *contacts_s])
    >>> durations_s[-3:].round(2)
    array([0.55, 0.45, 0.55])
    >>> steps = [(k, replace(step, time_s=contacts_s[k], duration_s=durations_s[k])) for k in range(20)]
    >>> state, moved = ContactTimeSmoothing().finish(ContactTimeSmoothing().init(), steps)
    >>> np.array([step.duration_s for _, step in moved[-3:]]).round(3)
    array([0.505, 0.495, 0.505])
    """

    def init(self) -> ContactTimeSmoothingState:
        return ContactTimeSmoothingState()

    def finish(
        self, state: ContactTimeSmoothingState, steps: NumberedSteps
    ) -> tuple[ContactTimeSmoothingState, NumberedSteps]:
        moved: NumberedSteps = []
        for number, step in steps:
            for part in _halves(step) if step.is_two else (step,):
                before, state = state, _with_contact(state, part.time_s)
                moved.append((number, _with_shift(part, before, state.shift_s)))
        return state, moved


def _halves(step: Step) -> tuple[Step, Step]:
    """Return the two halves of a step that spans two steps, with the usual vertical amplitude of the person.

    The measurements of the walking direction and of north stay with the second half.
    """
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
        walking_heading_rad=step.walking_heading_rad - quarter_rad * step.states_heading,
        walking_heading_std_rad=0.0 if step.states_heading else inf,
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


def _with_contact(state: ContactTimeSmoothingState, contact_s: float) -> ContactTimeSmoothingState:
    """Return the state after a contact, with the new estimate of the alternating error and the shift of this contact.

    The estimate starts again after a pause or a missed step.
    """
    contacts_s = (*state.contacts_s[-2:], contact_s)
    if len(contacts_s) < 3:
        return ContactTimeSmoothingState(contacts_s)
    earlier_s, later_s = contacts_s[1] - contacts_s[0], contacts_s[2] - contacts_s[1]
    if max(earlier_s, later_s) > _MAX_RATIO * min(earlier_s, later_s):
        return ContactTimeSmoothingState(contacts_s[1:])
    # The estimate d / 2 of the middle contact is (earlier - later) / 4. The last contact is of the other foot, so its
    # delay has the opposite sign.
    n = _DECAY * state.n + 1.0
    late_s = -_DECAY * state.late_s - (earlier_s - later_s) / 4
    limit_s = min(_MAX_SHIFT_S, _MAX_SHARE * later_s)
    return ContactTimeSmoothingState(contacts_s, min(max(-late_s / (n + _PRIOR_STEPS), -limit_s), limit_s), n, late_s)


def _with_shift(step: Step, before: ContactTimeSmoothingState, shift_s: float) -> Step:
    """Return a step with corrected contact times.

    Its start is corrected like the contact before it, if it starts at that contact.
    """
    begins_s = step.time_s - step.duration_s
    follows = bool(before.contacts_s) and abs(begins_s - before.contacts_s[-1]) < 1e-6
    duration_s = step.duration_s + shift_s - (before.shift_s if follows else 0.0)
    return replace_unchecked(step, time_s=step.time_s + shift_s, duration_s=duration_s, frequency_hz=1.0 / duration_s)
