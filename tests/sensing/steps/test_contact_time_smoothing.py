from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from helpers import a_step
from hypothesis import given
from hypothesis import strategies as st

from pdr_filter.sensing.steps.contact_time_smoothing import ContactTimeSmoothing
from pdr_filter.values import FloatArray, Step
from pdr_filter.values import serialisation as serialise


def steps_at(contacts_s: FloatArray) -> list[tuple[int, Step]]:
    """Steps whose durations are the intervals; the first takes 0.6 s."""
    begins_s = [contacts_s[0] - 0.6, *contacts_s[:-1]]
    return [
        (i, replace(a_step(float(t)), duration_s=float(t - b), frequency_hz=1.0 / float(t - b)))
        for i, (t, b) in enumerate(zip(contacts_s, begins_s, strict=True))
    ]


def evened(contacts_s: FloatArray) -> list[Step]:
    return [s for _, s in ContactTimeSmoothing().finish(ContactTimeSmoothing().init(), steps_at(contacts_s))[1]]


def times_s(steps: list[Step]) -> FloatArray:
    return np.array([s.time_s for s in steps])


@pytest.mark.parametrize("period_s", [0.35, 0.55, 1.2])
@pytest.mark.parametrize("share", [-0.13, -0.05, 0.1, 0.13])
def test_unequal_intervals_of_left_and_right_become_equal(period_s: float, share: float) -> None:
    k = np.arange(40)
    true_s = 5.0 + period_s * k
    error_s = min(abs(share) * period_s, 0.09) * np.sign(share)
    found = times_s(evened(true_s + error_s * (-1.0) ** k))
    np.testing.assert_allclose(found[10:], true_s[10:], atol=0.2 * abs(error_s))


def test_equal_intervals_do_not_change_at_any_pace() -> None:
    for period_s in (0.3, 0.55, 1.3):
        contacts_s = 3.0 + period_s * np.arange(30)
        np.testing.assert_allclose(times_s(evened(contacts_s)), contacts_s, atol=1e-9)


def test_after_a_rest_the_error_of_left_and_right_is_estimated_again() -> None:
    k = np.delete(np.arange(41), 20)
    true_s = 5.0 + 0.55 * k
    found = times_s(evened(true_s + 0.06 * (-1.0) ** k))
    # the two contacts around the hole have no side yet, the later ones are right again
    assert found[20] == true_s[20] + 0.06 * (-1.0) ** k[20]
    np.testing.assert_allclose(found[26:], true_s[26:], atol=0.025)


def test_a_missed_contact_is_put_in_the_middle_of_a_step_twice_as_long() -> None:
    k = np.delete(np.arange(41), 20)
    steps = [(i, replace(s, is_two=i == 20)) for i, s in steps_at(5.0 + 0.55 * k)]
    found = times_s([s for _, s in ContactTimeSmoothing().finish(ContactTimeSmoothing().init(), steps)[1]])
    np.testing.assert_allclose(found, 5.0 + 0.55 * np.arange(41))


def test_the_two_halves_of_a_step_have_together_its_turn_and_its_measurements() -> None:
    contacts_s = 5.0 + 0.5 * np.array([0, 1, 2, 3, 5])
    steps = steps_at(contacts_s)
    long = replace(
        steps[-1][1],
        heading_change_rad=0.4,
        device_heading_rad=1.0,
        walking_heading_rad=1.3,
        walking_heading_std_rad=0.2,
        offset_change_std_rad=0.6,
        heading_unknown_s=0.1,
        usual_amplitude_mps2=2.5,
        is_two=True,
    )
    first, second = (
        s for _, s in ContactTimeSmoothing().finish(ContactTimeSmoothing().init(), [*steps[:-1], (9, long)])[1][-2:]
    )
    assert (first.time_s, second.time_s) == (pytest.approx(7.0), long.time_s)
    assert (first.duration_s, second.duration_s) == (pytest.approx(0.5), pytest.approx(0.5))
    assert (first.device_heading_rad, second.device_heading_rad) == (pytest.approx(0.9), pytest.approx(1.1))
    assert first.heading_change_rad + second.heading_change_rad == pytest.approx(0.4)
    assert not first.is_two and not second.is_two
    assert first.vertical_amplitude_mps2 == second.stride_amplitude_mps2 == 2.5
    # reported once, for the angle between walking and device
    assert (first.walking_heading_std_rad, first.offset_change_std_rad, first.heading_unknown_s) == (np.inf, 0.0, 0.0)
    assert (second.walking_heading_std_rad, second.offset_change_std_rad, second.heading_unknown_s) == (0.2, 0.6, 0.1)
    assert second.walking_heading_rad - second.device_heading_rad == pytest.approx(0.3)


@given(intervals_s=st.lists(st.floats(0.15, 4.0), min_size=1, max_size=40))
def test_the_order_stays_durations_are_positive_and_end_where_the_next_step_begins(intervals_s: list[float]) -> None:
    steps = evened(2.0 + np.cumsum(intervals_s))
    for before, after in pairwise(steps):
        assert after.time_s > before.time_s
        assert after.time_s - after.duration_s == pytest.approx(before.time_s)
    assert all(s.duration_s > 0 and s.frequency_hz == 1.0 / s.duration_s for s in steps)


def test_the_first_step_of_a_bout_keeps_its_duration() -> None:
    contacts_s = 5.0 + 0.55 * np.arange(12) + 0.06 * (-1.0) ** np.arange(12)
    first = (12, replace(a_step(20.0), duration_s=0.6, frequency_hz=1 / 0.6))
    moved = ContactTimeSmoothing().finish(ContactTimeSmoothing().init(), [*steps_at(contacts_s), first])[1][-1][1]
    assert moved == first[1]


@given(intervals_s=st.lists(st.floats(0.3, 0.9), min_size=2, max_size=20), at=st.integers(0, 20))
def test_steps_are_the_same_however_they_come_and_the_state_is_saved(intervals_s: list[float], at: int) -> None:
    steps, stage = steps_at(2.0 + np.cumsum(intervals_s)), ContactTimeSmoothing()
    state, first = stage.finish(stage.init(), steps[:at])
    state = serialise.from_bytes(serialise.to_bytes(state))
    assert [*first, *stage.finish(state, steps[at:])[1]] == stage.finish(stage.init(), steps)[1]
