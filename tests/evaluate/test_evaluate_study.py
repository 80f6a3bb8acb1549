import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import pdr_filter as pdr
from pdr_filter.apps.cli.app import app
from pdr_filter.evaluate import comparison_table, context_errors, latex, markdown, study_rows, study_table, write_tables
from pdr_filter.evaluate.comparison import MEASURES
from pdr_filter.simulate import Gait, Leg, simulate
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


def test_a_measure_that_no_track_changes_has_no_difference() -> None:
    study = study_table([errors((2.0, 2.0), (1.0, 2.0)), errors((3.0, 3.0), (2.0, 2.0))])
    difference = {str(row["measure"]): row["difference"] for row in study if row["name"] == "a"}
    assert np.isnan(difference["step_error_percent"])
    assert difference["leg_error_percent"] == pytest.approx(-0.5)


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
    text = latex(table({"name": np.array(["50 %_a & {b}"]), "m": np.array([1.0])}), caption="Errors.", label="tab:a")
    assert r"50 \%\_a \& \{b\} & 1.00 \\" in text
    assert r"\caption{Errors.}" in text and r"\label{tab:a}" in text and text.count("rule") == 3


def test_latex_has_words_and_units_for_columns_and_no_empty_rows_or_columns() -> None:
    rows = [
        {"measure": "rmse_m", "name": "hc", "n_people": 2, "low": 1.5, "high": np.nan},
        {"measure": "end_error_percent", "name": "my_walk", "n_people": 0, "low": np.nan, "high": np.nan},
    ]
    lines = latex(rows).splitlines()
    assert lines[0] == r"\begin{tabular}{llrr}"
    assert lines[2] == r"Measure & Name & People & Low \\"
    assert lines[4:] == [r"rmse\_m & hc & 2 & 1.50 \\", r"\bottomrule", r"\end{tabular}"]
    assert str(markdown(rows)).count("\n") == 3
    assert latex(rows[:1]) == latex(table({name: np.array([value]) for name, value in rows[0].items()}))


def test_a_table_is_written_with_all_digits_and_as_latex(tmp_path: Path) -> None:
    written = write_tables(table({"a": np.array([1 / 3, np.nan])}), tmp_path / "deep" / "study")
    assert list(csv.reader(written[0].open())) == [["a"], [str(1 / 3)], [""]]
    assert "0.33" in written[1].read_text()


def test_compare_writes_tables_of_all_recordings(tmp_path: Path) -> None:
    for seed in (1, 2):
        walk = simulate([Leg("walking", distance_m=20.0)], seed=seed)
        replace(walk, meta={**walk.meta, "dataset": "tyrex"}).save(tmp_path / f"walk{seed}.zip")
    out = tmp_path / "out"
    files = [str(tmp_path / f"walk{seed}.zip") for seed in (1, 2)]
    ran = CliRunner().invoke(app, ["compare", *files, "--truth", "--out", str(out)], env={"COLUMNS": "200"})
    assert ran.exit_code == 0, ran.output
    assert "Step error (%)" in ran.output
    said = " ".join(ran.output.split())
    assert "1 of 2: " in said and "2 of 2: " in said
    assert "a context model was trained on recordings of tyrex" in said
    rows = list(csv.DictReader((out / "study.csv").open()))
    by_weighting = [row for row in rows if row["measure"] == "distance_error_percent"]
    assert {row["name"] for row in rows if row not in by_weighting} == {"hc", "wc", "imm"}
    known = [row for row in csv.DictReader((out / "weightings.csv").open()) if row["weighting"] == "wc, always"]
    bias = np.mean([float(row["error_percent"]) for row in known])
    assert [float(row["bias"]) for row in by_weighting if row["name"] == "wc, always"] == [pytest.approx(bias)]
    assert f"Distance error (%) wc, always 2 1 {bias:+.2f}" in said
    assert by_weighting[-1]["name"] == "imm"
    (wrong,) = (row for row in rows if (row["measure"], row["name"]) == ("context_error_percent", "hc"))
    assert wrong["difference"] == "" and "Windows of wrong context (%)" in said
    assert (out / "study.tex").read_text().startswith(r"\begin{table}")
    assert "difference to IMM" in (out / "study.tex").read_text().replace("Difference", "difference")
    assert len(list(csv.DictReader((out / "recordings.csv").open()))) == 6
    known = [row for row in csv.DictReader((out / "weightings.csv").open()) if row["weighting"] == "contexts known"]
    assert [float(row["error_percent"]) for row in known] == [0, 0]
    assert {row["context"] for row in csv.DictReader((out / "contexts.csv").open())} >= {"walking"}
    again = CliRunner().invoke(app, ["compare", *files, "--truth", "--out", str(out)])
    assert all(name in again.output.replace("\n", "") for name in ("study.csv", "recordings.tex", "contexts.csv"))


def test_a_calibration_on_one_half_of_the_people_is_compared_on_the_other_half_in_two_commands(tmp_path: Path) -> None:
    legs = [Leg("stationary", duration_s=2.0), Leg("walking", distance_m=25.0), Leg("stationary", duration_s=2.0)]
    for seed in range(4):
        walk = simulate(legs, replace(Gait.random(7), length_factor=1.2), seed=seed, name=f"walk{seed}")
        of_person = {**walk.meta["subject"], "id": f"p{seed}"}
        replace(walk, meta={**walk.meta, "subject": of_person}).save(tmp_path / f"walk{seed}.zip")
    first, other = ([str(tmp_path / f"walk{seed}.zip") for seed in half] for half in ((0, 1), (2, 3)))
    ran = CliRunner().invoke(app, ["calibrate", *first, "--out", str(tmp_path / "k.json"), "--model", "bounce"])
    assert ran.exit_code == 0, ran.output
    bias = []
    for name, options in (("own", ["--calibration", str(tmp_path / "k.json")]), ("typical", [])):
        ran = CliRunner().invoke(app, ["compare", *other, *options, "--truth", "--out", str(tmp_path / name)])
        assert ran.exit_code == 0, ran.output
        rows = list(csv.DictReader((tmp_path / name / "study.csv").open()))
        legs_of = {row["name"]: row for row in rows if row["measure"] == "leg_error_percent"}
        assert legs_of.keys() == {"hc", "wc", "imm"} and legs_of["imm"]["n_people"] == "2"
        bias.append(abs(float(legs_of["imm"]["bias"])))
    assert bias[0] < 0.5 * bias[1]


def test_compare_takes_the_model_height_and_fixes_that_track_takes(tmp_path: Path) -> None:
    walk = simulate([Leg("walking", distance_m=20.0)], seed=1)
    walk.save(tmp_path / "walk.zip")
    points = walk.truth.waypoints
    rows = [f"{p.time_s},{p.east_m + 100},{p.north_m - 50},0.3" for p in points]
    (tmp_path / "fixes.csv").write_text("\n".join(["time_s,east_m,north_m,std_m", *rows]))
    given = ["--height", "1.95", "--fixes", str(tmp_path / "fixes.csv"), "--model", "models/context.npz"]
    ran = CliRunner().invoke(app, ["compare", str(tmp_path / "walk.zip"), *given, "--json"])
    assert ran.exit_code == 0, ran.output
    ends = {row["track"]: row for row in json.loads(ran.stdout)["tracks"]}
    fixes = [pdr.PositionFix(p.time_s, np.array([p.east_m + 100, p.north_m - 50]), 0.09 * np.eye(2)) for p in points]
    tall = walk.of_height(1.95)
    expected = pdr.track(
        tall, pdr.recipes.for_recording("default", tall).in_world_frame(), weighting="hc", fixes=fixes, gnss="off"
    )
    assert ends["hc"]["end_east_m"] == pytest.approx(expected.end_position_m[0], abs=1e-3)
    assert ends["hc"]["end_east_m"] == pytest.approx(points.east_m[-1] + 100, abs=1.0)
    both = [str(tmp_path / "walk.zip"), str(tmp_path / "walk.zip")]
    refused = CliRunner().invoke(app, ["compare", *both, "--fixes", str(tmp_path / "fixes.csv")])
    assert refused.exit_code == 2 and "one by one" in " ".join(refused.output.split())


def test_recordings_that_do_not_name_their_person_are_of_different_people(tmp_path: Path) -> None:
    for k in (1, 2):
        walk = replace(simulate([Leg("walking", distance_m=20.0)], seed=k, name="same"), meta={})
        walk.save(tmp_path / f"walk{k}.zip")
    files = [str(tmp_path / f"walk{k}.zip") for k in (1, 2)]
    assert CliRunner().invoke(app, ["compare", *files, "--truth", "--out", str(tmp_path)]).exit_code == 0
    assert {row["n_people"] for row in csv.DictReader((tmp_path / "study.csv").open())} == {"2"}


def test_distances_by_context_add_up_to_the_walked_distance() -> None:
    walk = simulate([Leg("walking", distance_m=20.0), Leg("upstairs", duration_s=8.0)], seed=3)
    track = pdr.track(walk)
    inside = (track.time_s >= walk.truth.labels.start_s[0]) & (track.time_s < walk.truth.labels.end_s[-1])
    walked_m = np.diff(track.walked_m, prepend=0.0)[inside].sum()
    assert context_errors(walk, {"imm": track}).distance_m.sum() == pytest.approx(walked_m)


def test_a_printed_study_has_a_value_and_its_interval_in_one_cell() -> None:
    study = study_table([errors((1.0, 0.0)), errors((3.0, 1.0))], ["x", "y"])
    first, last = study_rows(study)
    assert first["error"] == "Step error (%)" and first["mean"].startswith("2.00 ± 12.7")
    assert first["difference to b"].startswith("+1.50 ± ") and last["difference to b"] == ""
    (alone, _) = study_rows(study_table([errors((1.0, 0.0))]))
    assert alone["mean"] == "1.00"
