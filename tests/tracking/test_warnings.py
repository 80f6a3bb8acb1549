"""Thresholds of the warnings about steps."""

from __future__ import annotations

import pytest

from pdr_filter.tracking.step_statistics import StepCounts
from pdr_filter.tracking.warnings import _step_notes  # pyright: ignore[reportPrivateUsage]


@pytest.mark.parametrize(
    ("untrusted", "n", "is_said"), [(21, 60, True), (20, 60, False), (41, 200, True), (40, 200, False)]
)
def test_uncertain_directions_cause_a_note_above_a_fifth_of_the_steps_and_above_twenty_steps(
    untrusted: int, n: int, is_said: bool
) -> None:
    notes = list(_step_notes(StepCounts(n=n, untrusted=untrusted)))
    assert [note.about for note in notes] == (["heading"] if is_said else [])
    assert all(f"{untrusted} of {n} steps" in note.text for note in notes)
