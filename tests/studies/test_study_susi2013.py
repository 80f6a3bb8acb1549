from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pdr_filter.evaluate.steps import StepScores
from pdr_filter.sensing.contexts.context_stage import known_context
from pdr_filter.values import Samples, table
from pdr_filter.values.recording import Recording, Truth
from tests.studies import susi2013 as susi
from tests.studies.measured import susi2013 as measured
from tests.studies.printed import susi2013 as paper
from tests.studies.report import Study, together


def small_study(data: Path) -> Study:
    return susi.study(data, n_simulated=2, simulated_m=18.0)


# --- the printed numbers ---------------------------------------------------------------------------------------------


def test_one_row_of_table_1_adds_up_to_102_percent() -> None:
    np.testing.assert_array_equal(paper.PAPER_MODES_PERCENT.sum(axis=1), [100, 102, 100])
    assert "texting/phoning/bag 102 %" in paper.paper_notes()[0]


def test_table_2_has_the_occurrences_of_table_1_without_irregular_motion() -> None:
    swinging, texting, phoning, bag = (row[0] for row in paper.PAPER_STEPS_PERCENT.values())
    assert swinging == paper.PAPER_OCCURRENCE_PERCENT[0]
    assert texting + phoning + bag == paper.PAPER_OCCURRENCE_PERCENT[1]
    assert all(detected + missed == 100 for _, detected, _, missed in paper.PAPER_STEPS_PERCENT.values())


def test_table_4_has_another_mean_of_modes_than_it_prints() -> None:
    assert np.mean(paper.PAPER_MOTION_PERCENT) == 99.5
    assert np.mean(paper.PAPER_DETECTED_PERCENT) == pytest.approx(paper.PAPER_MEANS_PERCENT[1])
    assert "99.5 % of modes (printed: 99.6)" in paper.paper_notes()[2]


def test_six_percent_of_a_walk_are_not_7_2_percent_of_its_distance() -> None:
    assert "72 steps" in paper.paper_notes()[3]
    assert "43.2 m of 720 m: 6.0 %" in paper.paper_notes()[3]


# --- what ours are made of -------------------------------------------------------------------------------------------


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


# --- the study -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Study:
    return small_study(tmp_path_factory.mktemp("nothing"))


def test_tables_1_to_4_are_simulated_without_data_sets(done: Study) -> None:
    assert [t.title.split(":")[0] for t in done.tables] == [f"Table {k}" for k in range(1, 5)]
    for t in done.tables:
        assert "simulated" in t.data
        assert len(t.rows) > 0
        assert len({tuple(row) for row in t.rows}) == 1, t.title


def test_simulated_people_swing_and_hold_still_as_they_were_made_to(done: Study) -> None:
    texting, swinging = done.tables[2].rows
    assert float(str(texting["ours texting %"])) > 80.0
    assert float(str(swinging["ours swinging %"])) > 80.0


def test_the_same_study_twice_has_the_same_digits(done: Study, tmp_path: Path) -> None:
    again = small_study(tmp_path)
    assert again.to_markdown() == done.to_markdown()
    assert [repr(t.rows) for t in again.tables] == [repr(t.rows) for t in done.tables]


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
