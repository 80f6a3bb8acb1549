from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import a_step

from pdr_filter.sensing.steps.doubled import DoubledSteps
from pdr_filter.values import Step


def a_pair(time_s: float) -> Step:
    """Two steps of 2.6 Hz that were found as one."""
    return replace(a_step(time_s, duration_s=1 / 1.3), vertical_amplitude_mps2=0.5, second_amplitude_mps2=2.0)


def of(steps: list[Step]) -> list[Step]:
    stage = DoubledSteps()
    return [s for _, s in stage.step(stage.init(), list(enumerate(steps)))[1]]


def test_a_jog_of_which_every_second_contact_was_passed_over_has_all_but_its_first_contacts() -> None:
    steps = of([a_pair((k + 1) / 1.3) for k in range(20)])
    assert len(steps) == 2 + 2 * 18
    late = steps[2:]
    assert np.diff([s.time_s for s in late]) == pytest.approx(np.full(35, 1 / 2.6))
    assert all(s.frequency_hz == pytest.approx(2.6) and s.vertical_amplitude_mps2 == 2.0 for s in late)


def test_the_halves_of_a_step_begin_and_end_with_it_and_say_once_what_it_says() -> None:
    whole = replace(
        a_pair(4.0),
        heading_change_rad=0.3,
        walking_heading_std_rad=0.2,
        offset_change_std_rad=0.5,
        heading_unknown_s=0.1,
    )
    first, second = of([a_pair(2.0), a_pair(3.0), whole])[2:]
    assert second.time_s == whole.time_s
    assert first.time_s - first.duration_s == pytest.approx(whole.time_s - whole.duration_s)
    assert first.heading_change_rad + second.heading_change_rad == pytest.approx(0.3)
    assert (first.walking_heading_std_rad, first.offset_change_std_rad, first.heading_unknown_s) == (0.2, 0.5, 0.1)
    assert (second.walking_heading_std_rad, second.offset_change_std_rad, second.heading_unknown_s) == (
        np.inf,
        0.0,
        0.0,
    )


@pytest.mark.parametrize(
    "changed",
    [
        {"second_amplitude_mps2": 1.1},  # a heel strike in a pocket
        {"vertical_amplitude_mps2": 1.3},  # a brisk walk
        {"duration_s": 0.5},  # two steps would be of 4 Hz
        {"from_rest": True},
    ],
)
def test_a_step_of_walking_stays_one_step(changed: dict[str, float]) -> None:
    steps = [replace(a_pair(float(k)), **changed) for k in range(10)]
    assert of(steps) == steps


def test_a_stumble_is_one_step() -> None:
    walk = [a_step(0.5 * k) for k in range(20)]
    walk[4] = walk[12] = a_pair(0.0)
    assert of(walk) == walk


def test_steps_may_come_one_at_a_time() -> None:
    stage, steps = DoubledSteps(), [a_pair(float(k)) for k in range(8)]
    state, found = stage.init(), list[Step]()
    for k, step in enumerate(steps):
        state, more = stage.step(state, [(k, step)])
        found += [s for _, s in more]
    assert found == of(steps)
