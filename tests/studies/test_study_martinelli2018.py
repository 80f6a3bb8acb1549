from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pdr_filter.simulate import Gait, Leg, simulate
from pdr_filter.values import CONTEXTS
from tests.studies import martinelli2018
from tests.studies.measured import martinelli2018 as measured
from tests.studies.measured.martinelli2018 import Size
from tests.studies.printed import martinelli2018 as paper
from tests.studies.printed.martinelli2018 import TABLE_III, TABLE_IV, TABLE_V, TABLE_VI, printed_checks
from tests.studies.report import Study

SMALL = Size(n_simulated=3, walked=0.3, n_windows=8, n_features=2, window_s=(1.0, 2.0))
TRIALS = {
    "std_6": "stationary",
    "sit_5": "stationary",
    "wlk_7": "walking",
    "ups_3": "upstairs",
    "dws_1": "downstairs",
    "jog_9": "running",
}


@pytest.fixture(scope="module")
def made_up(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder like that of MotionSense: three people, six trials of 14 s each."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "motionsense").mkdir()
    for i, person in enumerate(("s01", "s02", "s03")):
        for k, (trial, context) in enumerate(TRIALS.items()):
            name = f"motionsense_{person}_{trial}"
            walk = simulate([Leg(context, duration_s=14.0)], Gait.random(i), "pocket", rate_hz=50.0, seed=10 * i + k)
            meta = {**walk.meta, "name": name, "subject": {**walk.meta["subject"], "id": person}}
            # the real ones have labels and nothing else of the truth
            walk = replace(walk, name=name, meta=meta, truth=replace(walk.truth, position=None, segments=None))
            walk.save(folder / "motionsense" / f"{name}.zip")
    return folder


@pytest.fixture(scope="module")
def small(made_up: Path) -> Study:
    return martinelli2018.study(made_up, SMALL)


def rows_of(study: Study, title: str) -> list[dict[str, object]]:
    (found,) = [t for t in study.tables if t.title.split(":")[0] == title]
    return [dict(r) for r in found.rows]


def test_two_runs_are_identical(made_up: Path, small: Study, tmp_path: Path) -> None:
    again = martinelli2018.study(made_up, SMALL)
    assert again.to_markdown() == small.to_markdown()
    for one, other in zip(small.save(tmp_path / "a"), again.save(tmp_path / "b"), strict=True):
        assert one.name == other.name
        assert one.read_bytes() == other.read_bytes(), one.name


def test_every_table_has_the_paper_beside_ours_and_says_where_it_is_simulated(small: Study) -> None:
    titles = [t.title.split(":")[0] for t in small.tables]
    for number in ("III", "IV", "V", "VI"):
        assert f"Table {number}" in titles
        assert f"Table {number}, simulated" in titles
    for t in small.tables:
        assert t.rows, t.title
        assert ("simulated" in t.title) == (t.data.startswith("simulated,")), t.title
        assert any(c.startswith("paper") for c in t.rows[0]), t.title
        assert any(c.startswith("ours") for c in t.rows[0]), t.title
    assert [f.title.split(":")[0] for f in small.figures] == ["Fig. 10", "Fig. 12", "Fig. 14"]


def test_shares_of_a_true_context_add_up_to_100(small: Study) -> None:
    for title in ("Table III", "Table III, simulated"):
        for row in rows_of(small, title):
            if row["n"]:
                assert sum(float(row[f"ours {c}"]) for c in CONTEXTS) == pytest.approx(100.0), row


def test_the_rmse_of_all_is_that_of_bias_and_spread(small: Study) -> None:
    for title in ("Table IV", "Table IV, simulated"):
        of_all, bias, spread = rows_of(small, title)[-3:]
        for column in ("ours HC", "ours WC", "ours IMM"):
            rms = np.hypot(float(bias[column]), float(spread[column]))
            assert rms == pytest.approx(float(of_all[column])), column


def test_table_iv_is_the_rms_of_table_v(small: Study) -> None:
    for suffix in ("", ", simulated"):
        errors = [float(r["ours WC"]) for r in rows_of(small, f"Table V{suffix}") if r["ours"] != "-"]
        assert len(errors) == 3
        found = float(rows_of(small, f"Table IV{suffix}")[3]["ours WC"])
        assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(found)


def test_the_sweep_has_the_weightings_of_table_iv(small: Study) -> None:
    sweep = {str(r["threshold"]): r for r in rows_of(small, "Fig. 14, numbers")}
    for suffix, column in (("", "ours"), (", simulated", "ours, simulated")):
        of_all = rows_of(small, f"Table IV{suffix}")[3]
        assert sweep["0.80"][column] == of_all["ours WC"]
        assert sweep["HC"][column] == of_all["ours HC"]
        assert sweep["IMM"][column] == of_all["ours IMM"]
    assert sweep["0.80"]["paper"] == TABLE_IV["wc"][3]


def test_without_recordings_the_tables_say_so_and_the_simulated_ones_remain(tmp_path: Path) -> None:
    study = martinelli2018.study(tmp_path, SMALL)
    table = {t.title.split(":")[0]: t for t in study.tables}
    for title in ("Table III", "Table IV", "Table V", "Table VI", "Fig. 10, numbers", "Fig. 12, numbers"):
        assert not table[title].rows
        assert "motionsense are not in the folder" in table[title].data, title
    assert len(table["Table V, simulated"].rows) == 15
    assert [f.title.split(":")[0] for f in study.figures] == ["Fig. 14"]
    assert "motionsense are not in the folder" in study.to_markdown()


def test_the_printed_table_v_gives_the_printed_table_iv() -> None:
    for weighting, printed in TABLE_IV.items():
        errors = np.array(TABLE_V[weighting])
        for part, rmse in zip((errors[:5], errors[5:10], errors[10:], errors), printed, strict=True):
            assert np.sqrt(np.mean(part**2)) == pytest.approx(rmse, abs=0.11)
    notes = " ".join(printed_checks())
    assert "7.93 (HC) and 5.19 (WC)" in notes
    assert "mean -6.88 (HC) and -2.37 % (WC)" in notes


def test_the_printed_lengths_are_those_of_the_path_and_of_71_stairs() -> None:
    assert sum(row[0] for row in TABLE_VI.values()) == pytest.approx(paper.PATH_M)
    assert round(TABLE_VI["upstairs"][0] / 0.29) == round(TABLE_VI["downstairs"][0] / 0.43) == 71


def test_the_printed_errors_of_contexts_do_not_give_the_mean_error_of_wc() -> None:
    length_m, hc, wc = np.array(list(TABLE_VI.values())).T
    of_path = {"hc": length_m @ hc / length_m.sum(), "wc": length_m @ wc / length_m.sum()}
    assert of_path["hc"] == pytest.approx(np.mean(TABLE_V["hc"]), abs=0.5)
    assert of_path["wc"] < np.mean(TABLE_V["wc"]) - 1.5


def test_the_rows_of_the_printed_table_iii_add_up_and_its_diagonal_is_the_accuracy() -> None:
    np.testing.assert_allclose(TABLE_III.sum(axis=1), 100.0, atol=0.11)
    assert np.diagonal(TABLE_III).mean() == pytest.approx(paper.ACCURACY, abs=0.05)


@pytest.mark.recordings
def test_real_walks_are_put_together_with_one_gravity_and_a_label_for_each_part(data_dir: Path) -> None:
    walk = measured._put_together(data_dir, "s01")
    assert walk is not None and walk.truth.labels is not None
    labels = walk.truth.labels
    assert list(labels["context"][:3]) == ["stationary", "walking", "upstairs"]
    np.testing.assert_allclose(labels["start_s"][1:], labels["end_s"][:-1])
    force, time_s = walk.accelerometer.values, walk.accelerometer.time_s
    mean = [force[(time_s >= a) & (time_s < b)].mean(axis=0) for a, b in zip(labels.start_s, labels.end_s, strict=True)]
    up = np.array([m / np.linalg.norm(m) for m in mean])
    np.testing.assert_allclose(up @ up[0], 1.0, atol=1e-6)
    assert measured._put_together(data_dir, "s99") is None
