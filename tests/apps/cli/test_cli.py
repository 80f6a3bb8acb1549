"""Command line: output on stdout and stderr, errors and exit codes."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import copies, one_line, refusal, run, short_walk, succeed
from typer.testing import CliRunner

import pdr_filter as pdr
from pdr_filter.apps.cli.app import app
from pdr_filter.data.io.describe import describe
from pdr_filter.data.io.files.own_format import write_recording
from pdr_filter.simulate import walk as simulated_walk
from pdr_filter.simulate.motion import build_motion
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
    succeed("track", hostile / "b.zip", "--out", tmp_path, "--report", "--origin", "51,0")
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".csv", ".geojson", ".html", ".png"]
    assert len({path.stem for path in tmp_path.iterdir()}) == 1
    assert "simulated" not in succeed("demo", hostile / "b.zip", "--out", tmp_path / "demo").stdout
    assert sorted(p.suffix for p in (tmp_path / "demo").iterdir()) == [".csv", ".geojson", ".html", ".png"]


def test_one_bad_file_does_not_stop_the_others_and_is_listed(walk: Path, broken: Path, tmp_path: Path) -> None:
    result = run("track", broken, walk)
    assert result.exit_code == 1
    assert "short_walk" in result.stdout
    assert "1 of 2 files failed" in result.stderr
    assert str(broken) in result.stderr
    assert run("info", broken, tmp_path / "nowhere.zip").exit_code == 2  # all files failed


REFUSED = {
    "track {walk} --recipe no_such_recipe": "martinelli2018",
    "track {walk} --recipe context_modes": "no recipe",
    "track {walk} --model no_such_model.npz": "no_such_model.npz",
    "track {walk} --model {out}/level/context.npz": "with_contexts(model, modes)",
    "track {walk} --origin Florence --out x": "LAT,LON",
    "track {walk} --origin 11.25,143.77,3 --out x": "LAT,LON",
    "track {walk} --origin 143.77,11.25 --out x": "check the order",
    "track {walk} --origin nan,11.25": "--origin must be (latitude, longitude)",
    "track {walk} --heading north": "--heading must be degrees clockwise from north",
    "track {walk} --heading nan": "--heading must be degrees clockwise from north",
    "track {walk} --heading 4000": "--heading must be degrees clockwise from north",
    "track {walk} --heading 90 --north magnetic": "both define north",
    "track {walk} --export shp": "csv, geojson, gpx, kml, parquet, tum, separated by commas, got 'shp'",
    "track {walk} --export csv,gpx": "short_walk: --export gpx needs a geographic position",
    "track {walk} --export kml,gpx --out x": "--origin LAT,LON",
    "track {walk} --origin 43.77,11.25 --gnss filter": "got origin too",
    "track {walk} --gnss filter": "has no location",
    "track {walk} --gnss align": 'which gnss="align" (--gnss align) requires: omit it',
    "track {walk} --start 0,0": "--start 0,0 is a place on a floor plan: give --plan, or omit --start",
    "track {walk} --tiles https://tiles": "--tiles https://tiles is for the page of --report: give --report",
    "track {walk} --tiles https://tiles --long --out x": "--tiles cannot be used with --long",
    "track {walk} --model {broken}": "broken.zip: not usable as context model, which is a file .json with a file .npz",
    "track {walk} --person {broken}": "track --person, or a calibration with pdr-filter calibrate",
    "track {walk} --loop --online": "--loop cannot be used with --online",
    "track {walk} --classifier rvm --recipe martinelli2018": "chooses a model of the recipe default, but --recipe",
    "track {walk} --classifier rvm --model {models}/context_boosted.npz": "of the recipe default, but --model",
    "track {walk} --radio {out}/none.json": "none.json: no such file",
    "track {walk} --jobs 2 --out x --radio none.json": "--radio cannot be used with",
    "track {walk} --long --loop --out x": "--loop cannot be used with --long",
    "track {walk} --jobs 1 --json": "--json cannot be used with --jobs or --scheduler",
    "track {walk} --jobs 1": "add --out FOLDER",
    "track {walk} --out {broken}": "a file with this name exists where a folder is needed",
    "track {broken}": "broken.zip",
    "track {out}/nowhere.zip": "nowhere.zip",
    "info {broken}": "broken.zip",
    "info {walk} --format quux": "give one of",
    "info {out}/empty": "no recordings in this folder",
    "compare {broken}": "broken.zip",
    "compare {walk} --recipe none": "there are default",
    "demo {broken}": "broken.zip",
    "map {out}/empty --out {out}/map": "empty",
    "radio {walk} --out {out}/radio": "no walk has Wi-Fi scans",
    "train --out {out}/models": "exactly one of the two",
    "train {out} --sequences {out} --out {out}/models": "exactly one of the two",
    "train {out}/empty --out {out}/models": "empty",
    "train --sequences {out}/empty --out {out}/models": "no recordings in this folder",
    "track {walk} --jobs 2 --out x --transitions {broken}": "--transitions",
    "track {walk} --transitions {broken}": "broken.zip: not usable as transitions",
    "calibrate {walk} --out x --steps 40": "give --distance in m",
    "calibrate {walk} --out x --distance 0": "give the length of the walk in metres",
    "calibrate {walk} --out x --distance 25 --steps 5": "distance_m (--distance) / n_steps (--steps) must be",
    "calibrate {walk} --out x --distance 25 --jobs 2": "leave out --jobs",
    "calibrate {walk} --out x --smooth --jobs 2": "leave out --jobs",
    "calibrate nowhere.zip --out x --figure me.xyz": (
        "me.xyz: pictures with the suffix '.xyz' are not supported; use .png, .pdf or .svg"
    ),
}


@pytest.mark.parametrize(("command", "said"), REFUSED.items())
def test_a_command_that_cannot_be_used_is_one_line_with_the_remedy_and_writes_nothing(
    walk: Path, broken: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, said: str
) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "empty").mkdir()
    if "level" in command:
        pdr.ContextModel.load("context").renamed({"walking": "level"}).save(tmp_path / "level")
    monkeypatch.chdir(tmp_path / "here")
    message = refusal(*command.format(walk=walk, broken=broken, out=tmp_path, models=MODELS).split())
    assert said in message and "Errno" not in message
    assert not list((tmp_path / "here").iterdir())
    assert not {"map", "radio", "models"} & {path.stem for path in tmp_path.iterdir()}


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("track {walk} --weighting mean", "imm"),
        ("track {walk} --height 178", "in metres, 0.4 to 2.8"),
        ("smooth {walk} --height 178", "in metres, 0.4 to 2.8"),
        ("live --height 178", "in metres, 0.4 to 2.8"),
        ("calibrate {walk} --out me.json --model guess", "kim"),
        ("simulate", "--out"),
        ("train", "--out"),
    ],
)
def test_a_value_that_an_option_cannot_have_is_refused_in_a_box(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    result = run(*command.format(walk=walk).split())
    assert (result.exit_code, said in result.stderr) == (2, True)
    assert not list(tmp_path.iterdir())


# --- the other commands ----------------------------------------------------------------------------------------------


def test_info_tells_sensors_units_and_truth(walk: Path) -> None:
    result = succeed("info", walk)
    for word in ("accelerometer", "gyroscope", "100.0 Hz", "plausible", "truth: position"):
        assert word in result.stdout
    for stream in describe(pdr.read(walk)).streams:
        assert re.search(rf"{stream.name} .* {stream.first_s:z.1f} s +{stream.last_s:.1f} s ", result.stdout)


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
    both = succeed("compare", walk, bare, "--truth", "--json")
    known, unknown = map(json.loads, both.stdout.splitlines())
    assert all("rmse_m" in row for row in known["tracks"])
    assert not any("rmse_m" in row for row in unknown["tracks"])


def test_compare_takes_people_from_the_names_of_files(tmp_path: Path) -> None:
    recording = replace(pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=4.0)]), meta={})
    for name in ("anna_1", "ben_1", "anna_2"):
        replace(recording, name=name).save(tmp_path / f"{name}.zip")
    said = succeed("compare", tmp_path, "--out", tmp_path / "out").stdout
    assert "people from the names of files: anna, ben" in " ".join(said.split())
    assert ",hc,3,2," in (tmp_path / "out" / "study.csv").read_text()  # three recordings of two people


def test_the_same_seed_simulates_the_same_walk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulated_walk, "build_motion", build_motion)  # which tests store
    files = [tmp_path / name for name in ("a.zip", "b.zip", "c.zip")]
    for file, seed in zip(files, (5, 5, 6), strict=True):
        succeed("simulate", "--out", file, "--seed", seed)
    a, b, c = (sha256(file.read_bytes()).hexdigest() for file in files)  # pytest needs hours to compare the bytes
    assert a == b != c


@pytest.mark.parametrize("mode", ["texting", "pocket", "swinging", "calling"])
def test_a_simulated_walk_is_carried_as_asked(tmp_path: Path, mode: str) -> None:
    result = run("simulate", "--out", tmp_path / "walk.zip", "--carrying-mode", mode)
    recording = pdr.read(result.stdout.strip())
    assert set(recording.truth.labels.carrying_mode) == {mode}


def people_of(folder: Path, names: dict[str, str]) -> Path:
    """Folder of labelled recordings without names of persons, with a subfolder for each of three persons."""
    for seed, person in enumerate(("anna", "ben", "carla")):
        legs = [pdr.simulate.Leg(c, duration_s=8.0) for c in ("stationary", "walking", "running", "walking")]
        walk = pdr.simulate.simulate(legs, pdr.simulate.Gait.random(seed), "pocket", seed=seed, name="walk")
        labels = walk.truth.labels
        columns: dict[str, Any] = {name: labels[name] for name in ("start_s", "end_s", "carrying_mode")}
        columns["context"] = np.array([names.get(str(c), str(c)) for c in labels.context])
        meta = {**walk.meta, "dataset": "", "subject": {}}
        replace(walk, meta=meta, truth=Truth(labels=table(columns))).save(folder / person / "walk.zip")
    return folder


def test_train_fits_any_folder_and_track_uses_a_model_of_some_of_the_default_contexts(
    tmp_path: Path, walk: Path
) -> None:
    folder = people_of(tmp_path / "motionsense", {})  # the name of a known data set
    assert "two carrying modes, got 'pocket'" in refusal("train", folder, "--carrying-modes", "--out", tmp_path / "x")
    result = succeed("train", folder, "--classifier", "forest", "--out", tmp_path / "mine")
    assert "of 3 people: running " in result.stdout and "log loss" in result.stdout and "confusion" in result.stdout
    assert "contexts.npz" in one_line(result.stderr)
    model = pdr.ContextModel.load(tmp_path / "mine")
    assert model.contexts == ("running", "stationary", "walking")
    assert model.card["data"] == ["own recordings"]
    assert "motionsense" not in (tmp_path / "mine" / "contexts.json").read_text("utf-8")
    tracked = succeed("track", walk, "--json", "--online", "--model", tmp_path / "mine" / "contexts.npz")
    assert set(json.loads(tracked.stdout)["contexts"]) <= set(model.contexts)


def test_demo_without_a_folder_writes_nothing_into_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, walk: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    result = succeed("demo", walk)
    assert not list(tmp_path.iterdir())
    (page,) = (Path(word) for word in result.stdout.split() if word.endswith(".html"))
    assert page.is_file()
    shutil.rmtree(page.parent)


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


def test_demo_takes_height_and_platform_of_a_recording_and_of_nothing_else(tmp_path: Path, walk: Path) -> None:
    written = succeed("demo", walk, "--height", "1.9", "--out", tmp_path).stdout
    steps = pdr.smooth(pdr.read(walk).of_height(1.9)).track
    assert f"{steps.distance_m:.1f} m" in written
    assert "height is not known" not in written
    assert "omit platform" in one_line(run("demo", walk, "--platform", "ios").stderr)
    assert "none is given" in one_line(run("demo", "--height", "1.9").stderr)


def test_demo_of_a_folder_goes_on_after_a_bad_file_and_says_what_it_replaced(tmp_path: Path, walk: Path) -> None:
    folder, out = copies(walk, tmp_path / "walks", "w"), tmp_path / "out"
    (folder / "deep").mkdir()
    shutil.copy(folder / "w.zip", folder / "deep" / "w.zip")
    result = run("demo", folder, "--out", out)
    assert result.exit_code == 1
    assert "1 of 3 files failed" in result.stderr
    assert "replaced" not in result.stderr
    assert len(list(out.glob("*.csv"))) == 2  # both recordings have the same name
    assert "replaced existing files" in one_line(run("demo", folder / "w.zip", "--out", out).stderr)


def test_version_is_the_version_of_the_package() -> None:
    assert run("--version").stdout.strip() == f"pdr-filter {pdr.__version__}"


def test_without_a_command_the_help_is_shown() -> None:
    shown = run().stdout + run().stderr
    for command in ("track", "info", "train", "compare", "simulate", "demo"):
        assert command in shown


def test_the_help_of_each_command_fits_eighty_columns_without_a_broken_word(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("typer.rich_utils.MAX_WIDTH", 80)
    for command in app.registered_commands:
        assert not any("\n" in paragraph for paragraph in (command.callback.__doc__ or "").split("\n\n"))
        shown = run(command.name or command.callback.__name__, "--help").stdout
        assert max(map(len, shown.splitlines())) <= 80
        assert "…" not in shown
        assert all(word[-1] in "|>" for word in shown.split() if word.startswith("<") and "|" in word)


def test_a_folder_is_all_its_recordings_and_nothing_is_written_unasked(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = copies(walk, tmp_path / "many", "a", "b")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for command in ("info", "track"):
        result = run(command, folder, "--json")
        assert [json.loads(line)["name"] for line in result.stdout.splitlines()] == ["0", "a", "b"]
    assert list((tmp_path / "here").iterdir()) == []
