import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import pdr_filter as pdr
from pdr_filter.cli.app import app
from pdr_filter.evaluate import comparison_table, context_errors, latex, study_table, write_tables
from pdr_filter.evaluate.study import MEASURES
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import Table, table
from pdr_filter.values.recording import Truth


def errors(steps: tuple[float, float], legs: tuple[float, float] = (np.nan, np.nan)) -> Table:
    """Errors of the tracks a and b on one recording."""
    nothing = {name: np.full(2, np.nan) for name in MEASURES}
    known = {"step_error_percent": np.array(steps), "leg_error_percent": np.array(legs)}
    return table({"name": np.array(["a", "b"]), **nothing, **known})


def test_means_are_over_people_and_differences_are_paired() -> None:
    rows = [errors((1.0, 0.0)), errors((-3.0, 1.0)), errors((4.0, 2.0))]
    study = study_table(rows, ["x", "x", "y"])
    a, b = study
    assert (a["n_recordings"], a["n_people"], b["n_people"]) == (3, 2, 2)
    assert a["bias"] == pytest.approx((-1.0 + 4.0) / 2)
    assert a["mean"] == pytest.approx((2.0 + 4.0) / 2)
    assert a["difference"] == pytest.approx(((2.0 - 0.5) + (4.0 - 2.0)) / 2)
    assert np.isnan(b["difference"])


def test_the_interval_is_that_of_students_t() -> None:
    from scipy.stats import ttest_1samp

    sizes = np.array([1.0, 2.0, 4.0, 8.0])
    row = study_table([errors((size, 0.0)) for size in sizes])[0]
    low, high = ttest_1samp(sizes, 0.0).confidence_interval(0.95)
    assert (row["low"], row["high"]) == pytest.approx((low, high))
    assert (row["difference_low"], row["difference_high"]) == pytest.approx((low, high))


def test_one_person_has_a_mean_and_no_interval() -> None:
    row = study_table([errors((1.0, 0.0)), errors((3.0, 0.0))], ["x", "x"])[0]
    assert row["mean"] == 2.0
    assert np.isnan(row["low"])


def test_a_recording_counts_only_in_the_measures_that_its_truth_has() -> None:
    study = study_table([errors((1.0, 1.0), (2.0, 2.0)), errors((1.0, 1.0))])
    counts = {str(row["measure"]): int(row["n_recordings"]) for row in study}
    assert counts == {"step_error_percent": 2, "leg_error_percent": 1}


@pytest.mark.parametrize(
    ("rows", "people", "message"),
    [
        ([], None, "got none"),
        ([errors((np.nan, np.nan))], None, "no recording has a truth"),
        ([errors((1.0, 1.0))], ["x", "y"], "got 2"),
        ([errors((1.0, 1.0)), errors((1.0, 1.0))[:1]], None, "same tracks"),
    ],
)
def test_rows_that_cannot_be_compared_are_refused(rows: list[Table], people: list[str] | None, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        study_table(rows, people)


def test_errors_in_contexts_need_labels_and_no_positions() -> None:
    walk = simulate([Leg("stationary", duration_s=10.0), Leg("walking", distance_m=30.0)], seed=1)
    labelled = pdr.Recording(
        "labelled", walk.accelerometer, gyroscope=walk.gyroscope, truth=Truth(labels=walk.truth.labels)
    )
    tracks = {"imm": pdr.track(labelled)}
    rows = {str(row["context"]): row for row in context_errors(labelled, tracks)}
    assert rows["stationary"]["time_s"] == pytest.approx(10.0, abs=0.1)
    assert rows["walking"]["wrong_percent"] < 20.0
    assert rows["walking"]["distance_m"] == pytest.approx(30.0, rel=0.15)
    assert np.isnan(rows["walking"]["leg_error_percent"])
    assert comparison_table(labelled, tracks)["context_error_percent"][0] < 20.0
    without = pdr.Recording("bare", walk.accelerometer, gyroscope=walk.gyroscope)
    with pytest.raises(ValueError, match=r"bare has no labels: add truth_labels\.csv"):
        context_errors(without, tracks)


def test_the_leg_error_of_a_context_is_that_of_its_own_segments() -> None:
    walk = simulate([Leg("walking", distance_m=20.0), Leg("stationary", duration_s=3.0)] * 2, seed=1)
    legs = walk.truth.segments[walk.truth.segments.distance_m > 0]
    spans = {"start_s": legs.start_s, "end_s": legs.end_s}
    truth = Truth(
        labels=table({**spans, "context": np.array(["level", "longer"])}),
        segments=table({**spans, "distance_m": legs.distance_m * [1.0, 2.0]}),
    )
    rows = context_errors(replace(walk, truth=truth), {"imm": pdr.track(walk)})
    errors_percent = {str(row["context"]): row["leg_error_percent"] for row in rows}
    assert errors_percent["level"] == pytest.approx(0.0, abs=12.0)
    assert errors_percent["longer"] == pytest.approx(-50.0, abs=6.0)


def test_latex_escapes_what_has_a_meaning_there() -> None:
    text = latex(table({"name": np.array(["50 %_a & {b}"]), "m": np.array([np.nan])}))
    assert r"50 \%\_a \& \{b\} & -- \\" in text


def test_a_table_is_written_with_all_digits_and_as_latex(tmp_path: Path) -> None:
    written = write_tables(table({"a": np.array([1 / 3, np.nan])}), tmp_path / "deep" / "study")
    assert list(csv.reader(written[0].open())) == [["a"], [str(1 / 3)], [""]]
    assert "0.33" in written[1].read_text()


def test_compare_writes_tables_of_all_recordings(tmp_path: Path) -> None:
    for seed in (1, 2):
        simulate([Leg("walking", distance_m=20.0)], seed=seed).save(tmp_path / f"walk{seed}.zip")
    out = tmp_path / "out"
    files = [str(tmp_path / f"walk{seed}.zip") for seed in (1, 2)]
    ran = CliRunner().invoke(app, ["compare", *files, "--truth", "--out", str(out)])
    assert ran.exit_code == 0, ran.output
    assert "step_error_percent" in ran.output
    rows = list(csv.DictReader((out / "study.csv").open()))
    assert {row["name"] for row in rows} == {"hc", "wc", "imm"}
    assert (out / "study.tex").read_text().startswith(r"\begin{tabular}")
    assert len(list(csv.DictReader((out / "recordings.csv").open()))) == 6
    assert {row["context"] for row in csv.DictReader((out / "contexts.csv").open())} >= {"walking"}
    again = CliRunner().invoke(app, ["compare", *files, "--truth", "--out", str(out)])
    assert all(name in again.output.replace("\n", "") for name in ("study.csv", "recordings.tex", "contexts.csv"))


def test_recordings_that_do_not_name_their_person_are_of_different_people(tmp_path: Path) -> None:
    for k in (1, 2):
        walk = replace(simulate([Leg("walking", distance_m=20.0)], seed=k, name="same"), meta={})
        walk.save(tmp_path / f"walk{k}.zip")
    files = [str(tmp_path / f"walk{k}.zip") for k in (1, 2)]
    assert CliRunner().invoke(app, ["compare", *files, "--truth", "--out", str(tmp_path)]).exit_code == 0
    assert {row["n_people"] for row in csv.DictReader((tmp_path / "study.csv").open())} == {"2"}
