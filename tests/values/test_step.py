from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from helpers import a_step

import pdr_filter as pdr
from pdr_filter.values import Step, step_table, steps_of


def test_steps_of_a_table_equal_the_original_steps() -> None:
    steps = (a_step(1.0), replace(a_step(1.6, duration_s=0.6), from_rest=True, walking_heading_std_rad=0.2))
    assert steps_of(step_table(steps)) == steps
    assert steps_of(step_table([])) == ()


def test_a_step_from_a_table_has_the_types_of_its_fields() -> None:
    (step,) = steps_of(step_table([replace(a_step(), from_rest=True)]))
    assert {f.name: type(getattr(step, f.name)).__name__ for f in fields(Step)} == {
        f.name: f.type for f in fields(Step)
    }


def test_further_columns_of_a_table_are_ignored() -> None:
    table = step_table([a_step()])
    wider = np.zeros(1, dtype=[("length_m", float), *table.dtype.descr]).view(np.recarray)
    for name in table.dtype.names or ():
        wider[name] = table[name]
    assert steps_of(wider) == (a_step(),)


def test_a_step_of_a_time_is_a_typical_walking_step_and_takes_any_field() -> None:
    step = Step.of(12.0, duration_s=0.5, variance=6.0, detected_time_s=12.4)
    assert (step.time_s, step.detected_time_s, step.duration_s, step.frequency_hz) == (12.0, 12.4, 0.5, 2.0)
    assert step.variance == 6.0
    length_m, _ = pdr.recipes.default().model.modes[1].step_length.predict(step)
    assert 0.5 < length_m < 0.9
    with pytest.raises(ValueError, match=r"duration_s must be a number from 0\.1 to 10, got 500"):
        Step.of(12.0, duration_s=500.0)
