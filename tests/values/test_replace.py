"""Fast replacement of fields of frozen dataclasses."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import pytest

from pdr_filter.sensing.steps.adaptive_detector import AdaptiveStepDetector
from pdr_filter.values import Step, replace_unchecked

STEP = Step(1.0, 1.1, 0.5, 2.0, *(0.0 for _ in range(8)), walking_heading_rad=0.25)


def test_replace_unchecked_equals_dataclasses_replace() -> None:
    assert replace_unchecked(STEP, time_s=3.0, on_axes=True) == dataclasses.replace(STEP, time_s=3.0, on_axes=True)


def test_the_original_does_not_change_and_the_copy_is_frozen() -> None:
    before = dataclasses.asdict(STEP)
    later = replace_unchecked(STEP, time_s=3.0)
    assert dataclasses.asdict(STEP) == before
    with pytest.raises(dataclasses.FrozenInstanceError):
        later.time_s = 4.0  # type: ignore[misc]


def test_fields_of_base_classes_are_copied_too() -> None:
    state = AdaptiveStepDetector().init()
    later = replace_unchecked(state, rhythm=dataclasses.replace(state.rhythm, n_intervals=2))
    assert later.log is state.log
    assert later.response is state.response


def test_a_field_that_the_class_does_not_have_is_refused() -> None:
    with pytest.raises(TypeError, match="Step has slots, or not all of the fields walking_rad"):
        replace_unchecked(STEP, walking_rad=1.0)


@dataclass(frozen=True, slots=True)
class _Slotted:
    a: float
    b: float = 0.0


@dataclass(frozen=True)
class _HalfSlotted(_Slotted):
    c: float = 0.0


@pytest.mark.parametrize("value", [_Slotted(1.0), _HalfSlotted(1.0)])
def test_a_value_with_slots_is_refused(value: _Slotted) -> None:
    with pytest.raises((TypeError, AttributeError)):
        replace_unchecked(value, b=2.0)
