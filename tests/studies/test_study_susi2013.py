from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pdr_filter.evaluate.steps import StepScores
from pdr_filter.values import Samples, known_context, table
from pdr_filter.values.recording import Recording, Truth
from tests.studies import susi2013 as measured
from tests.studies.data import together


@pytest.mark.parametrize(
    ("context", "carrying", "irregular", "mode"),
    [
        ({"walking": 0.9, "stationary": 0.1}, {"swinging": 0.8, "texting": 0.2}, 0.0, "swinging"),
        ({"walking": 0.9, "stationary": 0.1}, {"swinging": 0.2, "calling": 0.8}, 0.0, "arm at rest"),
        ({"walking": 0.1, "stationary": 0.9}, {"swinging": 0.8, "texting": 0.2}, 0.0, "static"),
        ({"walking": 0.1, "stationary": 0.9}, {"swinging": 0.8, "texting": 0.2}, 0.9, "irregular"),
    ],
)
def test_a_window_has_one_of_the_four_modes(
    context: dict[str, float], carrying: dict[str, float], irregular: float, mode: str
) -> None:
    window = replace(known_context(1.0, context, carrying, ("stationary", "walking"), "x"), irregular_prob=irregular)
    assert measured.MODES[measured.mode_of(window)] == mode


def test_only_windows_wholly_inside_and_steps_at_the_edges_count() -> None:
    ends_s = np.array([4.0, 6.0, 8.0, 10.0])
    said = measured.Sensed(ends_s, np.arange(4), np.array([3.6, 3.8, 5.0, 9.2, 9.4]))
    np.testing.assert_array_equal(said.modes_within(4.0, 9.0), [2])
    np.testing.assert_array_equal(said.steps_within(4.0, 9.0), [3.8, 5.0, 9.2])


@pytest.mark.parametrize("swing_hz", [0.8, 1.0])
def test_an_arm_turns_twice_in_each_swing(swing_hz: float) -> None:
    time_s = np.arange(0.0, 30.0, 1 / 60)
    zero = np.zeros_like(time_s)
    east_m = 1.2 * time_s + 0.25 * np.sin(2 * np.pi * swing_hz * time_s)
    position = table({"time_s": time_s, "east_m": east_m, "north_m": zero, "up_m": zero})
    force = Samples(time_s, np.column_stack([zero, zero, zero + 9.81]))
    turns_s = measured.arm_turns_s(Recording("arm", force, truth=Truth(position=position)))
    inside = turns_s[(turns_s > 5.0) & (turns_s < 25.0)]
    assert len(inside) == pytest.approx(2 * 20 * swing_hz, abs=1)
    np.testing.assert_allclose(np.diff(inside), 0.5 / swing_hz, atol=0.03)


def test_walks_taken_together_weigh_by_their_steps() -> None:
    both = together([StepScores(10, 11, 9), StepScores(30, 29, 28)])
    assert both == StepScores(40, 40, 37)
    assert both.detection_prob == 37 / 40


@pytest.mark.recordings
def test_a_person_left_out_walks_with_an_arm_at_rest_and_handles_the_phone_outside(
    data_dir: Path, tmp_path: Path
) -> None:
    (tmp_path / "ubicomp13").mkdir()
    path = data_dir / "ubicomp13" / "ubicomp13_p07_e1_hand_held.zip"
    (tmp_path / "ubicomp13" / path.name).symlink_to(path)
    walk, handling = measured.walks_and_handling(tmp_path)
    assert (walk.activity, handling.activity) == ("texting/phoning/bag", "irregular")
    assert np.mean(walk.ours == measured.MODES.index("arm at rest")) > 0.9
    assert np.mean(handling.ours >= measured.MODES.index("irregular")) > 0.7
    assert walk.steps is not None
    assert abs(walk.steps.count_error_percent) < 6.0
