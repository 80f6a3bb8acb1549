from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pdr_filter.evaluate.steps import StepScores
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import Samples, table
from pdr_filter.values.recording import Recording, Truth
from tests.studies import zhou2019 as zhou
from tests.studies.measured import zhou2019 as measured
from tests.studies.printed import zhou2019 as paper
from tests.studies.report import Study


def small_study(data: Path) -> Study:
    return zhou.study(data, n_simulated=2, simulated_m=15.0)


# --- the printed numbers ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["Levi and Judd", "BCTFD"])
@pytest.mark.parametrize("behaviour", ["walking", "running"])
def test_wrong_steps_of_tables_4_and_5_are_over_counted_and_missed_ones(method: str, behaviour: str) -> None:
    for true, detected, over, missed, wrong, success in paper.PAPER_STEPS[method][behaviour]:
        assert detected == true + over - missed
        assert wrong == over + missed
        scores = StepScores(int(true), int(detected), int(true - missed))
        assert measured.success_percent(scores) == pytest.approx(100 * (1 - wrong / true))
        assert 0 <= measured.success_percent(scores) - success + 0.05 < 0.151  # rounded, or cut off


def test_three_success_rates_of_table_5_are_cut_off_and_none_of_table_4() -> None:
    note = next(n for n in paper.paper_notes() if "cut off" in n)
    assert note.count("printed as") == 3
    assert "99.25 printed as 99.2" in note


def test_the_four_persons_of_table_7_are_better_than_all_of_table_8_with_every_model_that_walks() -> None:
    four = np.mean(paper.PAPER_ERROR_M["walking"], axis=0) / paper.WALKED_M * 100
    assert (four < paper.PAPER_ERROR_PERCENT["walking"]).all()
    assert four[6] == pytest.approx(100 * (20.07 + 14.06 + 30.74 + 16.21) / 4800)


def test_the_height_classes_have_all_205_persons() -> None:
    assert sum(paper.HEIGHT_CLASSES) == 205


# --- what ours are made of -------------------------------------------------------------------------------------------


def foot_on_a_line(n_strides: int, length_m: float, stride_s: float = 1.2) -> Recording:
    """A foot that stands for half of each stride and then moves on by the length."""
    time_s = np.arange(0.0, n_strides * stride_s + 1.0, 1 / 200)
    phase = np.clip(time_s - 0.5, 0.0, n_strides * stride_s - 1e-9) / stride_s
    moving = np.clip((phase % 1.0 - 0.5) / 0.5, 0.0, 1.0)
    east_m = length_m * (np.floor(phase) + moving**3 * (10 - 15 * moving + 6 * moving**2))
    zero = np.zeros_like(time_s)
    position = table({"time_s": time_s, "east_m": east_m, "north_m": zero, "up_m": zero + 0.1})
    force = Samples(time_s, np.column_stack([zero, zero, zero + 9.81]))
    return Recording("foot", force, truth=Truth(position=position))


@pytest.mark.parametrize(("n", "length_m"), [(5, 0.8), (9, 1.4)])
def test_strides_of_a_foot_are_its_moves_between_stances(n: int, length_m: float) -> None:
    truth = measured.foot_truth(foot_on_a_line(n, length_m))
    assert len(truth.stride_end_s) == n
    assert truth.way_m == pytest.approx(n * length_m, rel=0.02)
    np.testing.assert_allclose(np.diff(truth.stride_end_s), 1.2, atol=0.03)


@pytest.mark.parametrize("frequency_hz", [1.5, 2.0, 3.0])
def test_levi_and_judd_find_a_step_in_every_period_of_walkers_and_runners(frequency_hz: float) -> None:
    time_s = np.arange(0.0, 40.0, 0.01)
    force = np.zeros((len(time_s), 3))
    force[:, 2] = 9.81 + 3.0 * np.sin(2 * np.pi * frequency_hz * time_s)
    found = measured.levi_judd_times_s(Recording("sway", Samples(time_s, force)), measured.LEVI_JUDD_CARRIED)
    assert len(found) == pytest.approx(40 * frequency_hz, abs=2)
    np.testing.assert_allclose(np.diff(found), 1 / frequency_hz, atol=0.03)


def test_parameters_of_exact_distances_are_found_again() -> None:
    rng = np.random.default_rng(0)
    sums = rng.uniform(50, 150, 40)[:, None] * np.column_stack([np.ones(40), rng.uniform(1.0, 3.0, 40)])
    theta = measured.fitted(sums, sums @ np.array([0.3, 0.2]))
    np.testing.assert_allclose(theta, [0.3, 0.2], atol=0.01)  # the prior is worth a hundredth


def test_parameters_of_other_persons_do_not_know_the_person() -> None:
    walk = next(iter(simulated_walks(1)))
    others = [replace(walk, person="B", true_m=2 * walk.true_m), replace(walk, person="C", true_m=2 * walk.true_m)]
    rest = measured.without_the_person([walk, *others])
    assert [w.person for w in rest(walk)] == ["B", "C"]
    assert measured.errors_percent([walk], "M6", rest) == pytest.approx(
        measured.errors_percent([replace(walk, true_m=7.0)], "M6", lambda _: others) * 7.0 / walk.true_m
        + 100 * (7.0 / walk.true_m - 1.0)
    )


def simulated_walks(n: int) -> list[measured.Walk]:
    found = [measured.walk_of(measured.followed(measured.simulated(k, "walking", 15.0))) for k in range(1, n + 1)]
    return [w for w in found if w is not None]


# --- the study -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made_up(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one simulated walk in place of each of two data sets."""
    data = tmp_path_factory.mktemp("data")
    walk = simulate([Leg("stationary", duration_s=3.0), Leg("walking", distance_m=15.0)], seed=4)
    for site in ("oxford", "humolire"):
        (data / site).mkdir()
        walk.save(data / site / f"{site}_1.zip")
    return data


@pytest.fixture(scope="module")
def done(made_up: Path) -> Study:
    return small_study(made_up)


def test_tables_4_to_8_have_the_papers_figures_beside_ours(done: Study) -> None:
    assert [t.title.split(":")[0] for t in done.tables] == [f"Table {k}" for k in range(4, 9)]
    for t in done.tables:
        names = list(t.rows[0])
        assert all(list(row) == names for row in t.rows)
        assert any(name.startswith("paper") for name in names)
        assert any(name.startswith("ours") for name in names)


def test_a_simulated_walk_has_its_steps_counted_in_both_ways(done: Study) -> None:
    steps = done.tables[1].rows
    found = [r for r in steps if "simulated" in str(r["of"]) and r["behaviour"] == "walking"]
    assert len(found) == 1
    assert float(str(found[0]["ours success %"])) > 85.0


def test_the_same_study_twice_has_the_same_digits(done: Study, made_up: Path) -> None:
    again = small_study(made_up)
    assert again.to_markdown() == done.to_markdown()
    assert [repr(t.rows) for t in again.tables] == [repr(t.rows) for t in done.tables]


@pytest.mark.recordings
def test_strides_of_real_feet_are_found_better_than_by_levi_and_judd(data_dir: Path, tmp_path: Path) -> None:
    (tmp_path / "pyshoe").mkdir()
    for path in sorted((data_dir / "pyshoe").glob("*.zip"))[1:12:4]:
        (tmp_path / "pyshoe" / path.name).symlink_to(path)
    table_6 = zhou.study(tmp_path, n_simulated=2, simulated_m=15.0).tables[2]
    row = next(r for r in table_6.rows if str(r["where"]).startswith("foot"))
    assert row["recordings"] == 3
    assert 90.0 < float(str(row["ours BCTFD %"])) <= 100.0
    assert float(str(row["ours BCTFD %"])) >= float(str(row["ours Levi and Judd %"]))
