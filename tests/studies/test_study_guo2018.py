from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pdr_filter.evaluate.classification import accuracy, kappa, macro_recall, precision
from pdr_filter.evaluate.steps import count_error_percent
from pdr_filter.simulate.motion import CARRYING
from tests.studies import guo2018 as guo
from tests.studies.measured import guo2018 as measured
from tests.studies.printed import guo2018 as paper
from tests.studies.report import Study


def small_study(data: Path) -> Study:
    return guo.study(data, n_simulated=2, n_sided=3, simulated_m=12.0)


# --- the printed numbers ---------------------------------------------------------------------------------------------


def test_table_3_gives_its_accuracy_kappa_precision_and_recall() -> None:
    assert 100 * accuracy(paper.PAPER_CONFUSION) == pytest.approx(98.85, abs=0.005)
    assert 100 * kappa(paper.PAPER_CONFUSION) == pytest.approx(98.46, abs=0.005)
    assert 100 * precision(paper.PAPER_CONFUSION).mean() == pytest.approx(98.833, abs=0.005)
    assert 100 * macro_recall(paper.PAPER_CONFUSION) == pytest.approx(98.828, abs=0.005)


def test_table_4_gives_its_own_accuracy_and_kappa_and_not_those_of_the_text() -> None:
    assert 100 * accuracy(paper.PAPER_SIDED) == pytest.approx(98.19, abs=0.005)
    assert 100 * kappa(paper.PAPER_SIDED) == pytest.approx(97.70, abs=0.005)
    assert paper.PAPER_SIDED.sum() == 4420


def test_table_4_with_its_sides_together_is_table_3() -> None:
    np.testing.assert_array_equal(paper.merged_sides(), paper.PAPER_CONFUSION)


def test_the_percentages_of_steps_are_of_totals_and_walks_are_worse() -> None:
    walk_by_walk = {}
    for pose, (true, found) in paper.PAPER_STEPS.items():
        of_totals = 100 - abs(float(count_error_percent(sum(found), sum(true))))
        assert of_totals == pytest.approx(paper.PAPER_COUNTED_PERCENT[pose], abs=0.011)
        walk_by_walk[pose] = np.abs(count_error_percent(found, true)).mean()
    assert np.mean(list(paper.PAPER_COUNTED_PERCENT.values())) == pytest.approx(99.68, abs=0.005)
    assert walk_by_walk["texting"] == pytest.approx(0.66, abs=0.005)
    assert walk_by_walk["swinging"] == pytest.approx(2.9, abs=0.05)
    assert walk_by_walk["pocket"] == pytest.approx(2.2, abs=0.05)
    assert walk_by_walk["calling"] == pytest.approx(1.2, abs=0.05)


def test_the_averages_of_table_7_are_means_of_the_poses() -> None:
    for model, errors in paper.PAPER_ERROR_PERCENT.items():
        assert np.mean(errors) == pytest.approx(paper.PAPER_AVERAGE_PERCENT[model], abs=0.006)


def test_kims_texting_and_calling_are_the_static_models_calling_and_texting() -> None:
    static, kim = (paper.PAPER_ERROR_PERCENT[m] for m in ("static", "Kim"))
    assert kim[:2] == static[1::-1]
    assert paper.PAPER_STD_M["Kim"][:2] == paper.PAPER_STD_M["static"][1::-1]


def test_the_static_models_error_while_swinging_is_more_than_its_counts_allow() -> None:
    assert paper.static_bound_percent() < 20.0 < paper.PAPER_ERROR_PERCENT["static"][paper.TABLE_7.index("swinging")]


def test_calling_and_swinging_are_exchanged_between_tables_8_and_9() -> None:
    error = {pose: float(e.mean()) for pose, e in paper.errors_of_table_8().items()}
    printed = {pose: paper.PAPER_SPEED_ERROR_MPS[pose][0] for pose in error}
    for pose, other in (("texting",) * 2, ("pocket",) * 2, ("calling", "swinging"), ("swinging", "calling")):
        assert error[pose] == pytest.approx(printed[other], abs=0.0015)


# --- what ours are made of -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["texting", "calling", "swinging", "pocket"])
def test_the_left_hand_is_the_mirror_of_the_right(mode: str) -> None:
    right, left = (measured.sided(mode, side, np.random.default_rng(1)) for side in (1.0, -1.0))
    assert left.place == (-right.place[0], *right.place[1:])
    assert left.side == -right.side
    assert left.roll_rad == -right.roll_rad
    assert left.twist_rad == -right.twist_rad
    assert left.pitch_rad == right.pitch_rad
    assert right.place == CARRYING[mode].place


def test_a_scale_from_the_same_walk_gives_its_true_distance() -> None:
    walks, pretraining = measured.simulated_walks(1, 12.0)
    for model in ("Weinberg", "Kim", "Chen"):
        scale = measured.scale_of(model, pretraining)
        assert scale * pretraining[0].distance_m(measured._fit(model, pretraining[0])) == pytest.approx(
            pretraining[0].true_m
        )
    assert {w.pose for w in walks} == set(paper.POSES)


def test_the_statistics_are_those_of_table_9() -> None:
    # the printed columns of Table 9 from the printed speeds of Table 8, as exchanged
    error = paper.errors_of_table_8()["swinging"]
    found, printed = guo._statistics(error), paper.PAPER_SPEED_ERROR_MPS["calling"]
    np.testing.assert_allclose(found, printed, atol=0.009)  # speeds are printed to 0.01


# --- the study -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Study:
    return small_study(tmp_path_factory.mktemp("nothing"))


def test_without_data_sets_the_real_tables_are_empty_and_say_so(done: Study) -> None:
    by_title = {t.title.split(":")[0]: t for t in done.tables}
    for title in ("Table 3", "Table 3, scores", "Table 3, other people", "Table 9, real walks"):
        assert by_title[title].rows == ()
        assert "none" in by_title[title].data
    for title in ("Table 4", "Table 5", "Table 7", "Table 8", "Table 9"):
        assert len(by_title[title].rows) > 0
        assert "simulated" in by_title[title].data


def test_every_row_of_a_table_has_the_same_columns(done: Study) -> None:
    for t in done.tables:
        assert len({tuple(row) for row in t.rows}) <= 1, t.title


def test_the_same_study_twice_has_the_same_digits(done: Study, tmp_path: Path) -> None:
    again = small_study(tmp_path)
    assert again.to_markdown() == done.to_markdown()
    assert [repr(t.rows) for t in again.tables] == [repr(t.rows) for t in done.tables]


@pytest.mark.recordings
def test_a_real_walk_on_known_legs_has_its_speed(data_dir: Path, tmp_path: Path) -> None:
    (tmp_path / "humolire").mkdir()
    for name in ("1f", "2f"):
        path = data_dir / "humolire" / f"humolire_user1_{name}.zip"
        (tmp_path / "humolire" / path.name).symlink_to(path)
    walks = measured.real_walks(tmp_path)
    assert len(walks) == 2
    true = np.array([w.true_mps for w in walks])
    np.testing.assert_allclose(measured.speeds_mps(walks, walks), true, rtol=0.06)
    assert measured.distances_m("Chen", walks, walks) == pytest.approx([w.true_m for w in walks], rel=0.06)
