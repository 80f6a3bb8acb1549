from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pdr_filter.recipes import default
from pdr_filter.simulate import Gait, Leg, simulate
from pdr_filter.tracking.whole_recording import track
from pdr_filter.values import table
from pdr_filter.values.recording import Recording
from tests.studies import tian2016
from tests.studies.measured import tian2016 as measured
from tests.studies.measured.tian2016 import TRANS, Size
from tests.studies.printed import tian2016 as paper
from tests.studies.printed.tian2016 import PATH_M, TABLE_IX, TABLE_VI, TABLE_VII, TABLE_VIII, printed_checks
from tests.studies.report import Study

SMALL = Size(n_people=2, n_transitions=5, n_walks=1)


def a_walk(name: str, mode: str, seed: int, legs: list[Leg]) -> Recording:
    walk = simulate(legs, Gait.random(seed), mode, rate_hz=50.0, seed=seed)
    subject = {**walk.meta["subject"], "id": f"p{seed:02d}", "gender": "F"}
    return replace(walk, name=name, meta={**walk.meta, "name": name, "subject": subject})


def of_one_segment(walk: Recording) -> Recording:
    """As ubicomp13 has them: one stretch with counted steps and one label."""
    segments, labels = walk.truth.segments, walk.truth.labels
    assert segments is not None and labels is not None
    start_s, end_s = segments.start_s[1:2], segments.end_s[-1:]
    counted = {"start_s": start_s, "end_s": end_s, "distance_m": [np.nan], "n_steps": [segments.n_steps.sum()]}
    label = {"start_s": start_s, "end_s": end_s, "context": ["walking"], "carrying_mode": labels.carrying_mode[:1]}
    truth = replace(walk.truth, segments=table(counted), labels=table(label))
    return replace(walk, truth=truth)


@pytest.fixture(scope="module")
def made_up(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with three walks like those of ubicomp13 and one each like those of humolire and tyrex."""
    folder = tmp_path_factory.mktemp("data")
    straight = [Leg("stationary", duration_s=4.0), Leg("walking", distance_m=20.0)]
    corners = [*straight, *[Leg("walking", distance_m=8.0, turn_rad=np.pi / 2)] * 3]
    walks = {"ubicomp13": [], "humolire": [a_walk("humolire_1", "texting", 7, corners)]}
    for i, mode in enumerate(("texting", "texting", "pocket")):
        walks["ubicomp13"].append(of_one_segment(a_walk(f"ubicomp13_{i}", mode, i, straight)))
    walks["tyrex"] = [a_walk("tyrex_nodist_texting", "texting", 8, corners)]
    for name, of_set in walks.items():
        (folder / name).mkdir()
        for walk in of_set:
            walk.save(folder / name / f"{walk.name}.zip")
    return folder


@pytest.fixture(scope="module")
def small(made_up: Path) -> Study:
    return tian2016.study(made_up, SMALL)


def rows_of(study: Study, title: str) -> list[dict[str, object]]:
    (found,) = [t for t in study.tables if t.title.split(":")[0] == title]
    return [dict(r) for r in found.rows]


def test_two_runs_are_identical(made_up: Path, small: Study, tmp_path: Path) -> None:
    again = tian2016.study(made_up, SMALL)
    assert again.to_markdown() == small.to_markdown()
    for one, other in zip(small.save(tmp_path / "a"), again.save(tmp_path / "b"), strict=True):
        assert one.read_bytes() == other.read_bytes(), one.name


def test_every_table_has_the_paper_beside_ours(small: Study) -> None:
    assert [t.title.split(":")[0] for t in small.tables] == [
        "Table VI",
        "Table VI, simulated",
        "Table VII",
        "Table VIII, steps",
        "Table VIII",
        "Table VIII, in a room",
        "Table VIII, simulated",
        "Table IX",
    ]
    for t in small.tables:
        assert t.rows, t.title
        assert any(c.startswith("paper") for c in t.rows[0]), t.title
        assert any(c.startswith("ours") for c in t.rows[0]), t.title
    assert all(t.data.startswith("simulated") for t in small.tables if "simulated" in t.title)
    assert small.tables[-1].data.startswith("simulated")


def test_modes_of_walks_add_up_to_100_for_each_true_mode(small: Study) -> None:
    rows = rows_of(small, "Table VI")
    for true in ("HOLDING", "POCKET"):
        assert sum(float(r[f"ours {true}"]) for r in rows) == pytest.approx(100.0)
    assert all(np.isnan(float(r["ours SWING"])) for r in rows)  # nobody swings the phone here


def test_every_model_of_table_vii_has_the_mean_28_m(small: Study) -> None:
    rows = rows_of(small, "Table VII")
    assert [r["distance, m"] for r in rows] == [*TABLE_VII, "default's model"]
    for row in rows:  # of two walks the median is the mean, and the standard deviation half of the difference
        assert float(row["ours median"]) == pytest.approx(28.0)
        half = 0.5 * (float(row["ours maximum"]) - float(row["ours minimum"]))
        assert float(row["ours STD"]) == pytest.approx(half)


def test_without_recordings_the_tables_say_so_and_the_simulated_ones_remain(tmp_path: Path) -> None:
    study = tian2016.study(tmp_path, SMALL)
    table_of = {t.title.split(":")[0]: t for t in study.tables}
    for title in ("Table VI", "Table VII", "Table VIII, steps", "Table VIII", "Table VIII, in a room"):
        assert not table_of[title].rows
        assert "not in the folder" in table_of[title].data, title
    assert len(table_of["Table IX"].rows) == 5 * len(TABLE_IX)
    assert "not in the folder" in study.to_markdown()


def test_a_track_that_is_the_truth_has_no_error() -> None:
    walk = a_walk("simulated", "texting", 3, [Leg("stationary", duration_s=3.0), Leg("walking", distance_m=25.0)])
    found, truth = track(walk, default()), walk.truth
    assert truth.position is not None and truth.steps is not None
    time_s = np.asarray(truth.steps.time_s)
    at_m = np.column_stack([np.interp(time_s, truth.position.time_s, truth.position[n]) for n in ("east_m", "north_m")])
    length_m = np.linalg.norm(np.diff(at_m, axis=0, prepend=np.zeros((1, 2))), axis=1)
    n = len(time_s)
    perfect = replace(found, time_s=time_s, position_m=at_m, step_length_m=length_m)
    # the number of steps is that of their times
    scores = measured.scores_of(walk, perfect)
    assert perfect.n_steps == n
    assert scores.steps_percent == pytest.approx(100.0)
    assert scores.distance_percent == pytest.approx(100.0, abs=0.1)
    assert scores.max_heading_deg < 1e-3
    assert scores.position_m < 0.1  # between the steps a track is straight in time, a person is not

    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    turned = measured.scores_of(walk, replace(perfect, position_m=perfect.position_m @ turn.T))
    assert turned.position_m == pytest.approx(scores.position_m)
    half = measured.scores_of(walk, replace(perfect, step_length_m=0.5 * length_m))
    assert half.distance_percent == pytest.approx(50.0, abs=0.1)


def test_what_is_said_of_the_mode_becomes_transitions_with_the_mode_after_each() -> None:
    said = measured.Carried(np.arange(7.0), ["HOLDING", TRANS, TRANS, "POCKET", "POCKET", TRANS, TRANS])
    assert said.transitions() == [(1.0, "POCKET"), (5.0, TRANS)]
    assert said.within(3.5, 4.5) == ["POCKET", "POCKET"]  # what was said last holds on
    assert said.most(0.0, 6.0) == "POCKET"
    assert said.most(5.0, 6.0) == TRANS


def test_the_printed_table_vi_is_of_32_38_and_28_transitions() -> None:
    n_of = paper._denominators()
    assert n_of == (32, 38, 28)
    assert sum(n_of) == paper.N_TRANSITIONS - 8
    np.testing.assert_allclose(TABLE_VI.sum(axis=0), 100.0)
    for column, n in zip(TABLE_VI.T, n_of, strict=True):
        counts = column * n / 100
        np.testing.assert_allclose(counts, counts.round(), atol=0.005)
    assert "92.9 % of those seen and 85.8 % of all" in printed_checks()[0]


def test_the_printed_averages_are_of_totals_where_errors_cancel() -> None:
    found = np.array([p.n_found / p.n_true for p in TABLE_IX])
    assert 100 * found.mean() == pytest.approx(paper.STEPS_MULTI, abs=0.02)
    assert 100 * (1 - np.abs(found - 1).mean()) < paper.STEPS_MULTI - 0.2
    for columns, printed in ((TABLE_VIII, paper.DISTANCE_SINGLE), (TABLE_IX, paper.DISTANCE_MULTI)):
        distance_m = np.array([p.distance_m for p in columns])
        assert 100 * distance_m.mean() / PATH_M == pytest.approx(printed, abs=0.006)
        assert 100 * (1 - np.abs(distance_m / PATH_M - 1).mean()) < printed


def test_the_printed_position_accuracy_is_of_mean_errors_over_the_path() -> None:
    mean_m = np.mean([p.position_m for p in TABLE_IX])
    assert 100 * (1 - mean_m / PATH_M) == pytest.approx(paper.POSITION_MULTI, abs=0.005)


def test_printed_shares_of_steps_follow_from_the_counts() -> None:
    for printed in (*TABLE_VIII, *TABLE_IX):
        assert 100 * printed.n_found / printed.n_true == pytest.approx(printed.percent, abs=0.06), printed.name
