"""Command line: output on stdout and stderr, errors and exit codes."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import one_line, run, short_walk
from typer.testing import CliRunner

import pdr_filter as pdr
from pdr_filter.apps.cli.app import app
from pdr_filter.data.io.files.own_format import write_recording
from pdr_filter.values import table
from pdr_filter.values.recording import Truth

MODELS = Path(__file__).resolve().parents[3] / "models"


# --- untrusted text ------------------------------------------------------------------------------------------------


def on_a_terminal(*arguments: object) -> str:
    """Return the output of a command with all escape sequences."""
    done = CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "200", "TERM": "dumb"}, color=True)
    return done.output


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of walks with texts that clear the terminal or are too long for a file name, and a broken file."""
    folder = tmp_path_factory.mktemp("hostile")
    walk = short_walk()
    labels = walk.truth.labels
    assert labels is not None
    odd = labels.astype([(n, "U20" if n in ("context", "carrying_mode") else "f8") for n in labels.dtype.names or ()])
    odd["context"][0] = "\x1b[2J"
    meta = {**walk.meta, "placement": "\x1b[2Jhand", "reading": {"source": "\x1b[2J", "clock": "\x9b2J"}}
    write_recording(replace(walk, meta=meta, truth=replace(walk.truth, labels=odd)), folder / "a.zip")
    write_recording(replace(walk, name="\u4e00" * 200), folder / "b.zip")
    write_recording(replace(walk, name="\x1b[2J"), folder / "c\x1b[2J.zip")  # the name is that of the file
    (folder / "broken\x1b[2J.zip").write_text("no zip file")
    return folder


@pytest.mark.parametrize("command", ["info", "track", "compare"])
@pytest.mark.parametrize("name", ["a.zip", "c\x1b[2J.zip", "broken\x1b[2J.zip"])
def test_text_of_a_file_or_of_its_name_does_not_act_on_the_terminal(hostile: Path, command: str, name: str) -> None:
    printed = on_a_terminal(command, hostile / name)
    assert printed
    assert "\x1b[2J" not in printed
    assert "\x9b" not in printed
    if command == "info" or name != "a.zip":
        assert "\\x1b[2J" in printed


def test_a_name_too_long_for_a_file_is_shortened_and_all_files_are_written(hostile: Path, tmp_path: Path) -> None:
    assert run("track", hostile / "b.zip", "--out", tmp_path, "--report", "--origin", "51,0").exit_code == 0
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".csv", ".geojson", ".html", ".png"]
    assert len({path.stem for path in tmp_path.iterdir()}) == 1
    assert run("demo", hostile / "b.zip", "--out", tmp_path / "demo").exit_code == 0
    assert len(list((tmp_path / "demo").iterdir())) == 4


def test_one_bad_file_does_not_stop_the_others_and_is_listed(walk: Path, broken: Path) -> None:
    result = run("track", broken, walk)
    assert result.exit_code == 1
    assert "short_walk" in result.stdout
    assert "1 of 2 files failed" in result.stderr
    assert str(broken) in result.stderr


@pytest.mark.parametrize("command", ["track", "info", "compare", "demo"])
def test_a_file_that_cannot_be_used_is_one_line_and_code_2(command: str, broken: Path) -> None:
    result = run(command, broken)
    assert result.exit_code == 2
    assert result.stdout == ""
    line = one_line(result.stderr)
    assert line.startswith("error:")
    assert "broken.zip" in line


def test_a_file_that_does_not_exist_is_named(tmp_path: Path) -> None:
    result = run("track", tmp_path / "nowhere.zip")
    assert result.exit_code == 2
    assert "nowhere.zip" in one_line(result.stderr)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--recipe", "no_such_recipe"], "martinelli2018"),
        (["--recipe", "context_modes"], "no recipe"),
        (["--model", "no_such_model.npz"], "no_such_model.npz"),
        (["--origin", "Florence", "--out", "x"], "LAT,LON"),
        (["--origin", "11.25,143.77,3", "--out", "x"], "LAT,LON"),
        (["--origin", "143.77,11.25", "--out", "x"], "check the order"),
        (["--origin", "nan,11.25"], "--origin must be (latitude, longitude)"),
        (["--heading", "north"], "--heading must be degrees clockwise from north"),
        (["--heading", "nan"], "--heading must be degrees clockwise from north"),
        (["--heading", "4000"], "--heading must be degrees clockwise from north"),
        (["--export", "shp"], "csv, geojson, gpx, kml, parquet, tum, separated by commas, got 'shp'"),
        (["--export", "csv,gpx"], "short_walk: --export gpx needs a geographic position"),
        (["--origin", "43.77,11.25", "--gnss", "filter"], "got origin too"),
    ],
)
def test_an_option_that_cannot_be_used_is_one_line_with_the_remedy(walk: Path, options: list[str], said: str) -> None:
    result = run("track", walk, *options)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert said in one_line(result.stderr)


def test_an_unknown_weighting_is_refused(walk: Path) -> None:
    result = run("track", walk, "--weighting", "mean")
    assert result.exit_code == 2
    assert "imm" in result.stderr


# --- the other commands ----------------------------------------------------------------------------------------------


def test_info_tells_sensors_units_and_truth(walk: Path) -> None:
    result = run("info", walk)
    assert result.exit_code == 0
    for word in ("accelerometer", "gyroscope", "100.0 Hz", "plausible", "truth: position"):
        assert word in result.stdout


def test_info_json_is_one_object_a_line(walk: Path, broken: Path) -> None:
    result = run("info", "--json", walk, broken)
    good, bad = (json.loads(line) for line in result.stdout.splitlines())
    assert good["name"] == "short_walk"
    assert [s["name"] for s in good["streams"]] == ["accelerometer", "gyroscope", "magnetometer"]
    assert set(bad) == {"name", "error"}
    assert result.exit_code == 1


def test_compare_shows_the_three_weightings_and_their_difference(walk: Path) -> None:
    result = run("compare", walk)
    tracks = {w: pdr.track(pdr.read(walk), weighting=w) for w in ("hc", "wc", "imm")}
    lines = [line for line in result.stdout.splitlines() if " m" in line]  # without the header
    rows = {w: next(line for line in lines if w in line.split()) for w in tracks}
    for weighting, track in tracks.items():
        assert f"{track.distance_m:.1f} m" in rows[weighting]
    assert f"{tracks['hc'].distance_m - tracks['imm'].distance_m:+.1f} m" in rows["hc"]
    apart_m = np.hypot(*(tracks["wc"].position_m[-1] - tracks["imm"].position_m[-1]))
    assert f"{apart_m:.1f} m" in rows["wc"]


def test_compare_has_recipes_the_truth_a_page_of_all_and_json(walk: Path, tmp_path: Path) -> None:
    recipes = ("--recipe", "susi2013", "--recipe", "default")
    result = run("compare", walk, *recipes, "--truth", "--out", tmp_path, "--json")
    (found,) = map(json.loads, result.stdout.splitlines())
    recording = pdr.read(walk)
    for row, name in zip(found["tracks"], ("susi2013", "default"), strict=True):
        track = pdr.track(recording, pdr.recipes.for_recording(name, recording))
        assert (row["track"], row["n_steps"]) == (name, track.n_steps)
        (errors,) = pdr.evaluate.comparison_table(recording, {name: track})
        assert row["rmse_m"] == pytest.approx(errors["rmse_m"])
    (page,) = tmp_path.glob("*.compare.html")
    text = page.read_text()
    assert "short_walk, susi2013" in text and "short_walk, default" in text
    again = run("compare", walk, *recipes, "--out", tmp_path)
    assert "replaced" in again.stderr and "error (RMSE)" not in again.stdout
    table = run("compare", walk, *recipes, "--truth")
    assert f"{found['tracks'][0]['rmse_m']:.1f} m" in table.stdout
    assert "()" not in table.stdout and "interval" not in table.stdout  # which needs two people


def test_compare_of_a_file_without_truth_has_no_error_and_says_so(walk: Path, tmp_path: Path) -> None:
    bare = write_recording(replace(pdr.read(walk), name="bare", truth=Truth()), tmp_path / "w.zip")
    alone = run("compare", bare, "--truth")
    assert (alone.exit_code, "error (RMSE)" in alone.stdout) == (0, False)
    assert "because the file has no true positions or waypoints: bare" in one_line(alone.stderr)
    both = run("compare", walk, bare, "--truth", "--json")
    known, unknown = map(json.loads, both.stdout.splitlines())
    assert both.exit_code == 0
    assert all("rmse_m" in row for row in known["tracks"])
    assert not any("rmse_m" in row for row in unknown["tracks"])


def test_compare_with_no_such_recipe_says_which_there_are(walk: Path) -> None:
    unknown = run("compare", walk, "--recipe", "none")
    assert (unknown.exit_code, "there are default" in one_line(unknown.stderr)) == (2, True)


def test_the_same_seed_simulates_the_same_walk(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("a.zip", "b.zip", "c.zip")]
    for file, seed in zip(files, (5, 5, 6), strict=True):
        assert run("simulate", "--out", file, "--seed", seed).exit_code == 0
    a, b, c = (file.read_bytes() for file in files)
    assert a == b != c


@pytest.mark.parametrize("mode", ["texting", "pocket", "swinging", "calling"])
def test_a_simulated_walk_is_carried_as_asked(tmp_path: Path, mode: str) -> None:
    result = run("simulate", "--out", tmp_path / "walk.zip", "--carrying-mode", mode)
    recording = pdr.read(result.stdout.strip())
    assert recording.truth.labels is not None
    assert set(recording.truth.labels.carrying_mode) == {mode}


def people_of(folder: Path, names: dict[str, str]) -> Path:
    """Folder of labelled recordings without names of persons, with a subfolder for each of three persons."""
    for seed, person in enumerate(("anna", "ben", "carla")):
        legs = [pdr.simulate.Leg(c, duration_s=8.0) for c in ("stationary", "walking", "running", "walking")]
        walk = pdr.simulate.simulate(legs, pdr.simulate.Gait.random(seed), "pocket", seed=seed, name="walk")
        labels = walk.truth.labels
        assert labels is not None
        columns: dict[str, Any] = {name: labels[name] for name in ("start_s", "end_s", "carrying_mode")}
        columns["context"] = np.array([names.get(str(c), str(c)) for c in labels.context])
        meta = {**walk.meta, "dataset": "", "subject": {}}
        replace(walk, meta=meta, truth=Truth(labels=table(columns))).save(folder / person / "walk.zip")
    return folder


def test_train_fits_any_folder_and_track_uses_a_model_of_some_of_the_default_contexts(
    tmp_path: Path, walk: Path
) -> None:
    folder = people_of(tmp_path / "motionsense", {})  # the name of a known data set
    result = run("train", folder, "--classifier", "forest", "--out", tmp_path / "mine")
    assert result.exit_code == 0, result.stderr
    assert "of 3 people: running " in result.stdout and "log loss" in result.stdout and "confusion" in result.stdout
    assert "contexts.npz" in one_line(result.stderr)
    model = pdr.ContextModel.load(tmp_path / "mine")
    assert model.contexts == ("running", "stationary", "walking")
    assert model.card["data"] == ["own recordings"]
    assert "motionsense" not in (tmp_path / "mine" / "contexts.json").read_text("utf-8")
    tracked = run("track", walk, "--json", "--online", "--model", tmp_path / "mine" / "contexts.npz")
    assert tracked.exit_code == 0, tracked.stderr
    assert set(json.loads(tracked.stdout)["contexts"]) <= set(model.contexts)


def test_train_learns_carrying_modes_only_if_there_are_several(tmp_path: Path) -> None:
    result = run("train", people_of(tmp_path, {}), "--carrying-modes", "--out", tmp_path / "mine")
    assert result.exit_code == 2
    assert "at least two carrying modes, got 'pocket'" in one_line(result.stderr)


def test_track_with_a_model_of_other_contexts_says_how_to_give_them_a_meaning(tmp_path: Path, walk: Path) -> None:
    model = pdr.ContextModel.load("context").renamed({"walking": "level"})
    model.save(tmp_path)
    result = run("track", walk, "--model", tmp_path / "context.npz")
    assert result.exit_code == 2
    assert "'level'" in one_line(result.stderr) and "with_contexts(model, modes)" in result.stderr


@pytest.mark.parametrize("arguments", [[], ["FOLDER", "--sequences", "FOLDER"]])
def test_train_takes_either_a_folder_or_sequences(tmp_path: Path, arguments: list[str]) -> None:
    given = [tmp_path if word == "FOLDER" else word for word in arguments]
    result = run("train", *given, "--out", tmp_path / "out")
    assert (result.exit_code, "exactly one of the two" in one_line(result.stderr)) == (2, True)


def test_train_on_a_folder_without_recordings_is_one_line_and_code_2(tmp_path: Path) -> None:
    result = run("train", tmp_path, "--out", tmp_path / "models")
    assert result.exit_code == 2
    assert str(tmp_path) in one_line(result.stderr)


def test_demo_prints_the_summary_and_writes_four_files(tmp_path: Path) -> None:
    result = run("demo", "--out", tmp_path)
    assert result.exit_code == 0
    assert "simulated" in result.stdout
    assert {p.suffix for p in tmp_path.iterdir()} == {".html", ".png", ".geojson", ".csv"}


def test_demo_without_a_folder_writes_nothing_into_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, walk: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    result = run("demo", walk)
    assert result.exit_code == 0
    assert not list(tmp_path.iterdir())
    (page,) = (Path(word) for word in result.stdout.split() if word.endswith(".html"))
    assert page.is_file()
    shutil.rmtree(page.parent)


@pytest.mark.parametrize("command", ["simulate", "train"])
def test_commands_that_create_files_require_a_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.chdir(tmp_path)
    result = run(command)
    assert (result.exit_code, "--out" in result.stderr) == (2, True)
    assert not list(tmp_path.iterdir())


def test_every_command_that_writes_names_the_files_it_replaced(tmp_path: Path, walk: Path) -> None:
    plan = tmp_path / "plan.geojson"
    wall = {"type": "LineString", "coordinates": [[0, 0], [10, 0], [10, 8], [0, 8], [0, 0]]}
    feature = {"type": "Feature", "properties": {"type": "wall"}, "geometry": wall}
    plan.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    for command in (
        ["calibrate", walk, "--out", tmp_path / "c.json"],
        ["smooth", walk, "--out", tmp_path / "s"],
        ["plan", plan, "--out", tmp_path / "p"],
        ["simulate", "--out", tmp_path / "w.zip"],
    ):
        first, second = run(*command), run(*command)
        assert (first.exit_code, second.exit_code) == (0, 0), first.stderr
        assert "replaced existing files" not in first.stderr
        assert "replaced existing files" in second.stderr


def test_demo_of_a_folder_goes_on_after_a_bad_file_and_says_what_it_replaced(tmp_path: Path, walk: Path) -> None:
    folder = tmp_path / "walks"
    (folder / "a").mkdir(parents=True)
    (folder / "0.zip").write_bytes(b"no zip")
    for path in (folder / "a" / "w.zip", folder / "w.zip"):
        path.write_bytes(walk.read_bytes())
    result = run("demo", folder, "--out", tmp_path / "out")
    assert result.exit_code == 1
    assert "1 of 3 files failed" in result.stderr
    assert "replaced" not in result.stderr
    assert len(list((tmp_path / "out").glob("*.csv"))) == 2  # both recordings have the same name
    again = run("demo", walk, "--out", tmp_path / "out")
    assert "replaced existing files" in one_line(again.stderr)


def test_version_is_the_version_of_the_package() -> None:
    assert run("--version").stdout.strip() == f"pdr-filter {pdr.__version__}"


def test_without_a_command_the_help_is_shown() -> None:
    shown = run().stdout + run().stderr
    for command in ("track", "info", "train", "compare", "simulate", "demo"):
        assert command in shown


def test_the_help_of_each_command_fits_eighty_columns_without_a_broken_word(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("typer.rich_utils.MAX_WIDTH", 80)
    for command in app.registered_commands:
        assert command.callback is not None
        assert not any("\n" in paragraph for paragraph in (command.callback.__doc__ or "").split("\n\n"))
        shown = run(command.name or command.callback.__name__, "--help").stdout
        assert max(map(len, shown.splitlines())) <= 80
        assert "…" not in shown
        assert all(word[-1] in "|>" for word in shown.split() if word.startswith("<") and "|" in word)


def test_the_format_can_be_forced_and_an_unknown_one_is_refused(walk: Path) -> None:
    assert run("info", walk, "--format", "own").exit_code == 0
    result = run("info", walk, "--format", "quux")
    assert result.exit_code == 2
    assert "give one of" in result.stderr


def test_a_folder_is_all_its_recordings_for_info_and_compare_and_nothing_is_written_unasked(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = pdr.read(walk)
    for name in ("a", "b"):
        write_recording(replace(recording, name=name), tmp_path / "many" / f"{name}.zip")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for command in ("info", "track"):
        result = run(command, tmp_path / "many", "--json")
        assert [json.loads(line)["name"] for line in result.stdout.splitlines()] == ["a", "b"]
    assert list((tmp_path / "here").iterdir()) == []
    (tmp_path / "empty").mkdir()
    assert "no recordings in this folder" in one_line(run("info", tmp_path / "empty").stderr)


def test_the_exit_code_is_2_if_all_files_failed(broken: Path, tmp_path: Path) -> None:
    (tmp_path / "other.zip").write_bytes(b"no zip")
    assert run("info", broken).exit_code == run("info", broken, tmp_path / "other.zip").exit_code == 2


def test_a_file_in_place_of_an_output_folder_is_explained(walk: Path, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    result = run("track", walk, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "Errno" not in result.stderr
    assert "a file with this name exists where a folder is needed" in one_line(result.stderr)
