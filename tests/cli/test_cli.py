"""The command line: what it prints where, and how it fails."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heard import round_a_block, walk_with_wifi
from typer.testing import CliRunner, Result

import pdr_filter as pdr
from pdr_filter.classifiers.model import load_model
from pdr_filter.cli.app import app
from pdr_filter.io.own_format import write_recording
from pdr_filter.io.recording import Truth
from pdr_filter.offline.smoothing.observations import LoopClosure, fixes_of_file
from pdr_filter.offline.smoothing.wifi_loops import wifi_loop_closures
from pdr_filter.sensing.contexts.learned import LearnedContexts
from pdr_filter.training import run as training

MODELS = Path(__file__).resolve().parents[2] / "models"


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "200", "TERM": "dumb"})


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The simulated walk as a file."""
    return write_recording(pdr.simulate.demo_walk(), tmp_path_factory.mktemp("walks") / "demo_walk.zip")


@pytest.fixture
def broken(tmp_path: Path) -> Path:
    path = tmp_path / "broken.zip"
    path.write_text("this is no zip file")
    return path


def one_line(text: str) -> str:
    """The only line of a message; no traceback."""
    (line,) = text.strip().splitlines()
    return line


def test_a_person_whom_no_fix_measured_is_not_written_and_that_is_said(walk: Path, tmp_path: Path) -> None:
    result = run("track", walk, "--person", tmp_path / "me.json")
    assert result.exit_code == 0
    assert "me.json is not written: no fix says" in result.stderr.replace("\n", "")
    assert not (tmp_path / "me.json").exists()


# --- text of others ------------------------------------------------------------------------------------------------


def on_a_terminal(*arguments: object) -> str:
    """What a command prints, with all escapes."""
    done = CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "200", "TERM": "dumb"}, color=True)
    return done.output


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of walks whose texts clear the terminal or are too long for a file name, and a broken one."""
    folder = tmp_path_factory.mktemp("hostile")
    walk = pdr.simulate.demo_walk()
    labels = walk.truth.labels
    assert labels is not None
    odd = labels.astype([(n, "U20" if n in ("context", "carrying_mode") else "f8") for n in labels.dtype.names or ()])
    odd["context"][0] = "\x1b[2J"
    meta = {**walk.meta, "placement": "\x1b[2Jhand", "reading": {"source": "\x1b[2J", "clock": "\x9b2J"}}
    write_recording(replace(walk, meta=meta, truth=replace(walk.truth, labels=odd)), folder / "a.zip")
    write_recording(replace(walk, name="\u4e00" * 200), folder / "b.zip")
    write_recording(replace(walk, name="\x1b[2J"), folder / "c\x1b[2J.zip")  # called after its file
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


# --- track ---------------------------------------------------------------------------------------------------------


def test_track_json_is_one_object_a_line_and_nothing_else_on_stdout(walk: Path, broken: Path) -> None:
    command = [sys.executable, "-m", "pdr_filter.cli.app", "track", "--json", str(walk), str(broken), str(walk)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    objects = [json.loads(line) for line in done.stdout.splitlines()]
    summary = pdr.track(pdr.read(walk)).summary()
    assert objects[0] == objects[2] == summary
    assert set(objects[1]) == {"name", "error"}
    assert objects[1]["name"] == "broken"
    assert done.returncode == 1
    assert "broken.zip" in done.stderr
    assert "Traceback" not in done.stderr


def test_track_prints_one_row_for_each_file(walk: Path) -> None:
    result = run("track", walk, walk)
    summary = pdr.track(pdr.read(walk)).summary()
    rows = [line for line in result.stdout.splitlines() if "demo_walk" in line and "demo_walk:" not in line]
    assert result.exit_code == 0
    assert len(rows) == 2
    for value in (str(summary["n_steps"]), f"{summary['distance_m']:.1f} m", f"{summary['end_east_m']:.1f} m"):
        assert value in rows[0]


def test_notes_stand_below_the_table_and_with_json_in_the_object(tmp_path: Path) -> None:
    recording = replace(pdr.simulate.demo_walk(), gyroscope=None, name="no_gyroscope")
    file = write_recording(recording, tmp_path / "no_gyroscope.zip")
    assert "no gyroscope" in run("track", file).stdout
    with_json = run("track", "--json", file)
    assert any("no gyroscope" in note for note in json.loads(with_json.stdout)["notes"])
    assert with_json.stderr == ""


@pytest.mark.parametrize("weighting", ["hc", "wc", "imm"])
def test_the_weighting_is_the_one_asked_for(walk: Path, weighting: str) -> None:
    result = run("track", "--json", "--weighting", weighting, walk)
    assert json.loads(result.stdout) == pdr.track(pdr.read(walk), weighting=weighting).summary()


def test_the_recipe_is_the_one_asked_for(walk: Path) -> None:
    result = run("track", "--json", "--recipe", "martinelli2018", walk)
    assert json.loads(result.stdout) == pdr.track(pdr.read(walk), pdr.recipes.martinelli2018()).summary()


def test_the_model_replaces_the_one_for_windows_with_gyroscope(walk: Path) -> None:
    path = MODELS / "context_martinelli_forest.npz"
    result = run("track", "--json", "--model", path, walk)
    config = pdr.recipes.with_context_model(pdr.recipes.default(pdr.read(walk).subject), load_model(path))
    contexts = config.sensing.contexts
    assert isinstance(contexts, LearnedContexts)
    assert contexts.models.with_gyroscope.name == "context_martinelli_forest"
    assert contexts.windows.features.name == "martinelli"
    assert json.loads(result.stdout) == pdr.track(pdr.read(walk), config).summary()
    assert json.loads(result.stdout) != pdr.track(pdr.read(walk)).summary()


def test_out_gets_a_table_and_a_picture_and_with_an_origin_a_map_file(walk: Path, tmp_path: Path) -> None:
    assert run("track", walk, "--out", tmp_path / "plain").exit_code == 0
    assert {p.name for p in (tmp_path / "plain").iterdir()} == {"demo_walk.csv", "demo_walk.png"}
    assert run("track", walk, "--out", tmp_path / "placed", "--origin", "43.77,-11.25").exit_code == 0
    line = json.loads((tmp_path / "placed" / "demo_walk.geojson").read_text())["features"][0]["geometry"]["coordinates"]
    assert line[0][:2] == pytest.approx([-11.25, 43.77])  # and a height: the walk has stairs


def test_a_located_walk_gets_its_map_file_unless_its_locations_are_off(tmp_path: Path) -> None:
    walk = pdr.simulate.demo_walk()
    time_s = np.arange(1.0, walk.duration_s, 4.0)
    values = np.tile([43.77, 11.25, 50.0, 30.0], (len(time_s), 1))
    file = replace(walk, location=pdr.Samples(time_s, values)).save(tmp_path / "located.zip")
    placed = run("track", file, "--out", tmp_path / "placed", "--json")
    assert json.loads(placed.stdout)["end_latitude_deg"] == pytest.approx(43.77, abs=0.002)
    line = json.loads(next((tmp_path / "placed").glob("*.geojson")).read_text())["features"][0]["geometry"]
    places = np.array(line["coordinates"])[:, :2]
    np.testing.assert_allclose(places, np.tile([11.25, 43.77], (len(places), 1)), atol=0.003)
    off = run("track", file, "--out", tmp_path / "off", "--gnss", "off", "--json")
    assert json.loads(off.stdout) == pdr.track(replace(pdr.read(file), location=None)).summary()
    assert not list((tmp_path / "off").glob("*.geojson"))


def test_a_place_and_a_heading_that_are_given_are_those_of_the_track(walk: Path, tmp_path: Path) -> None:
    result = run("track", walk, "--origin", "-43.77,11.25", "--heading", "-90", "--json", "--out", tmp_path)
    expected = pdr.track(pdr.read(walk), origin=(-43.77, 11.25), heading_rad=-np.pi / 2)
    assert json.loads(result.stdout) == expected.summary()
    assert json.loads(result.stdout)["frame"] == "north"
    assert (tmp_path / "demo_walk.geojson").read_bytes() == expected.to_geojson(tmp_path / "a").read_bytes()


def test_north_of_the_magnetometer_turns_a_walk_whose_place_is_given(walk: Path) -> None:
    result = run("track", walk, "--origin", "-43.77,11.25", "--north", "magnetic", "--json")
    expected = pdr.track(pdr.read(walk), origin=(-43.77, 11.25), north="magnetic")
    assert json.loads(result.stdout) == expected.summary()
    assert expected.frame == "north"
    contradicting = run("track", walk, "--heading", "90", "--north", "magnetic")
    assert (contradicting.exit_code, "both say north" in one_line(contradicting.stderr)) == (2, True)


def test_files_are_exported_once_whether_asked_with_commas_or_again(walk: Path, tmp_path: Path) -> None:
    kinds = ["csv", "geojson", "gpx", "kml", "tum"]
    options = ["--export", "csv, geojson,GPX", "--export", "kml,tum", "--export", "csv", "--origin", "43.77,11.25"]
    assert run("track", walk, walk, *options, "--out", tmp_path).exit_code == 0
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {f"{name}.{kind}" for name in ("demo_walk", "demo_walk_2") for kind in [*kinds, "png"]}
    track = pdr.track(pdr.read(walk), origin=(43.77, 11.25))
    for kind in kinds:
        written = getattr(track, f"to_{kind}")(tmp_path / "expected")
        assert written.read_bytes() == (tmp_path / f"demo_walk.{kind}").read_bytes()


def test_a_map_that_is_asked_for_without_a_place_is_a_local_one_and_others_are_refused(
    walk: Path, tmp_path: Path
) -> None:
    assert run("track", walk, "--export", "geojson", "--out", tmp_path).exit_code == 0
    assert {p.name for p in tmp_path.iterdir()} == {"demo_walk.csv", "demo_walk.png", "demo_walk.local.geojson"}
    refused = run("track", walk, "--export", "kml,gpx", "--out", tmp_path / "no")
    assert (refused.exit_code, "--origin LAT,LON" in one_line(refused.stderr)) == (2, True)
    assert not (tmp_path / "no").exists()


def test_points_of_gpx_have_the_time_at_which_they_were_walked_if_the_file_says_it(tmp_path: Path) -> None:
    recording = pdr.simulate.demo_walk()
    for name, value in (("epoch_s", 1.7e9), ("epoch_ms", 1_700_000_000_000), ("epoch_ns", 1_700_000_000 * 10**9)):
        timed = replace(recording, name=name, meta={**recording.meta, name: value})
        assert timed.epoch_s == pytest.approx(1.7e9, abs=1e-3)
    assert recording.epoch_s is None
    file = timed.save(tmp_path / "walk.zip")
    assert run("track", file, "--origin", "43.77,11.25", "--export", "gpx", "--out", tmp_path).exit_code == 0
    assert "<time>2023-11-14T22:13:20" in (tmp_path / "epoch_ns.gpx").read_text()


def test_gnss_of_a_recording_without_location_is_one_line_and_of_many_stands_in_their_rows(
    walk: Path, tmp_path: Path
) -> None:
    for gnss in ("filter", "align"):
        alone = run("track", walk, "--gnss", gnss)
        assert (alone.exit_code, "has no location" in one_line(alone.stderr)) == (2, True)
    many = run("track", walk, "--jobs", "1", "--gnss", "off", "--out", tmp_path)
    assert many.exit_code == 0
    assert [row.gnss for row in pdr.batch.read_table(tmp_path / "tracks.csv")] == ["off"]


def test_recordings_of_one_name_do_not_overwrite_each_other(walk: Path, tmp_path: Path) -> None:
    run("track", walk, walk, walk, "--out", tmp_path)
    assert len(list(tmp_path.glob("*.csv"))) == 3


def test_one_bad_file_does_not_stop_the_others_and_is_listed(walk: Path, broken: Path) -> None:
    result = run("track", broken, walk)
    assert result.exit_code == 1
    assert "demo_walk" in result.stdout
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
        (["--origin", "143.77,11.25", "--out", "x"], "exchanged"),
        (["--origin", "nan,11.25"], "--origin must be (latitude, longitude)"),
        (["--heading", "north"], "--heading must be degrees clockwise from north"),
        (["--heading", "nan"], "--heading must be degrees clockwise from north"),
        (["--heading", "4000"], "--heading must be degrees clockwise from north"),
        (["--export", "shp"], "csv, geojson, gpx, kml, parquet, tum, got 'shp'"),
        (["--export", "csv,gpx"], "demo_walk: --export gpx needs a place on Earth"),
        (["--origin", "43.77,11.25", "--gnss", "filter"], "has no location"),
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
    assert good["name"] == "demo_walk"
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
        known = recording.truth.position
        at_m = pdr.evaluate.positions_at(track.time_s, track.position_m, known["time_s"], track.start_position_m)
        reference_m = np.column_stack([known["east_m"], known["north_m"]])
        assert row["rmse_m"] == pytest.approx(pdr.evaluate.position_rmse_m(at_m, reference_m, "all"))
    (page,) = tmp_path.glob("*.compare.html")
    text = page.read_text()
    assert "demo_walk, susi2013" in text and "demo_walk, default" in text
    again = run("compare", walk, *recipes, "--out", tmp_path)
    assert "replaced" in again.stderr and "off the truth" not in again.stdout
    table = run("compare", walk, *recipes, "--truth")
    assert f"{found['tracks'][0]['rmse_m']:.1f} m" in table.stdout


def test_compare_of_a_file_without_truth_has_no_error_and_says_so(walk: Path, tmp_path: Path) -> None:
    bare = write_recording(replace(pdr.read(walk), name="bare", truth=Truth()), tmp_path / "w.zip")
    alone = run("compare", bare, "--truth")
    assert (alone.exit_code, "off the truth" in alone.stdout) == (0, False)
    assert "no true positions or waypoints in the file, so there is no error of bare" in one_line(alone.stderr)
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


def test_train_prints_the_models_it_wrote(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def fake_train(data_dir: Path, out_dir: Path, progress: Any, sequences_dir: Any) -> list[dict[str, Any]]:
        asked.extend([data_dir, out_dir, sequences_dir])
        progress("reading", 0.5)
        return [{"name": "one"}, {"name": "two"}]

    monkeypatch.setattr(training, "train", fake_train)
    result = run("train", tmp_path, "--out", tmp_path / "out")
    assert result.stdout.split() == [str(tmp_path / "out" / "one.npz"), str(tmp_path / "out" / "two.npz")]
    assert asked == [tmp_path, tmp_path / "out", None]


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
def test_what_makes_new_files_asks_where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    monkeypatch.chdir(tmp_path)
    result = run(command)
    assert (result.exit_code, "--out" in result.stderr) == (2, True)
    assert not list(tmp_path.iterdir())


def test_what_was_there_before_is_named_by_every_command_that_writes(tmp_path: Path, walk: Path) -> None:
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
        assert "replaced, as they were there before" not in first.stderr
        assert "replaced, as they were there before" in second.stderr


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
    assert len(list((tmp_path / "out").glob("*.csv"))) == 2  # of one name
    again = run("demo", walk, "--out", tmp_path / "out")
    assert "replaced, as they were there before" in one_line(again.stderr)


def test_version_is_the_version_of_the_package() -> None:
    assert run("--version").stdout.strip() == f"pdr-filter {pdr.__version__}"


def test_without_a_command_the_help_is_shown() -> None:
    shown = run().stdout + run().stderr
    for command in ("track", "info", "train", "compare", "simulate", "demo"):
        assert command in shown


def test_a_calibration_is_written_and_used_by_track(tmp_path: Path) -> None:
    from pdr_filter.simulate import Leg, simulate

    legs = [Leg("walking", distance_m=20.0), Leg("walking", distance_m=15.0, turn_rad=1.5)]
    walks = [write_recording(simulate(legs, seed=s, name=f"walk_{s}"), tmp_path / f"walk_{s}.zip") for s in (1, 2)]
    result = run("calibrate", *walks, "--out", tmp_path / "me.json", "--figure", tmp_path / "me.png")
    assert result.exit_code == 0
    assert "4 segments" in result.stdout
    assert (tmp_path / "me.png").read_bytes().startswith(b"\x89PNG")
    result = run("track", "--json", "--calibration", tmp_path / "me.json", walks[0])
    assert result.exit_code == 0
    recording = pdr.read(walks[0])
    calibrated = pdr.track(recording, calibration=tmp_path / "me.json")
    assert json.loads(result.stdout) == calibrated.summary()
    truth_m = 35.0
    assert abs(calibrated.distance_m - truth_m) < abs(pdr.track(recording).distance_m - truth_m) + 0.1


def test_model_loss_prior_and_person_of_a_calibration_are_options(tmp_path: Path) -> None:
    from pdr_filter.calibration import load_calibration
    from pdr_filter.simulate import Leg, simulate

    walks: list[Path] = []
    for name in ("a", "b"):
        recording = replace(simulate([Leg("walking", distance_m=25.0)], seed=1, name=name), meta={})
        walks.append(write_recording(recording, tmp_path / f"{name}.zip"))
    out = tmp_path / "me.json"
    options = ("--model", "kim", "--loss", "none", "--prior", "0.3", "--subject", "anna")
    result = run("calibrate", *walks, "--out", out, *options)
    assert result.exit_code == 0
    found = load_calibration(out)
    assert type(found.models["walking"]).__name__ == "KimStepLength"
    assert list(found.subjects) == ["anna"]
    expected = pdr.calibrate([pdr.read(w) for w in walks], model="kim", loss="none", prior_std=0.3, subject="anna")
    np.testing.assert_array_equal(found.theta, expected.theta)
    for extra in ((), ("--resume", tmp_path / "kept")):
        assert run("calibrate", *walks, "--out", out, "--each-a-person", *extra).exit_code == 0
        assert list(load_calibration(out).subjects) == ["a", "b"]
    assert run("calibrate", *walks, "--out", out, "--model", "guess").exit_code == 2


def test_a_calibration_without_segments_ends_with_one_line_that_says_so(walk: Path, tmp_path: Path) -> None:
    recording = pdr.read(walk)
    bare = replace(recording, truth=replace(recording.truth, segments=None, strides=None, waypoints=None))
    path = write_recording(bare, tmp_path / "bare.zip")
    result = run("calibrate", path, "--out", tmp_path / "me.json")
    assert result.exit_code == 2
    assert "error:" in result.stderr
    assert not (tmp_path / "me.json").exists()


def test_a_walk_is_smoothed_against_its_waypoints(walk: Path, tmp_path: Path) -> None:
    result = run("smooth", walk, "--out", tmp_path)
    assert result.exit_code == 0
    assert "observations" in result.stdout
    assert "step scale" in result.stdout
    assert {p.suffix for p in tmp_path.iterdir()} >= {".csv", ".png"}


def test_a_walk_is_smoothed_against_fixes_of_a_file(walk: Path, tmp_path: Path) -> None:
    points = pdr.read(walk).truth.waypoints
    rows = [f"{p.time_s},{p.east_m},{p.north_m}" for p in points]
    (tmp_path / "fixes.csv").write_text("\n".join(["time_s,east_m,north_m", *rows]) + "\n", encoding="utf-8")
    by_file = run("smooth", walk, "--fixes", tmp_path / "fixes.csv", "--fix-std", "0.5")
    assert by_file.exit_code == 0
    assert by_file.stdout == run("smooth", walk, "--fix-std", "0.5").stdout
    (tmp_path / "own.csv").write_text("east_m,north_m,std_m,time_s\n0,0,0.5,1\n3,4,2,9\n", encoding="utf-8")
    first, second = fixes_of_file(tmp_path / "own.csv")
    np.testing.assert_array_equal([first.cov_m2[0, 0], second.cov_m2[1, 1]], [0.25, 4.0])
    np.testing.assert_array_equal([*second.position_m, second.time_s], [3.0, 4.0, 9.0])
    for content, words in (
        ("time_s,east_m\n1,2\n", "no column 'north_m'"),
        ("time_s,east_m,north_m\n", "no fixes"),
        ("time_s,east_m,north_m\n1,,3\n", "row 1"),
        ("time_s,east_m,north_m,std_m\n1,2,3,0\n", "std_m must be positive"),
    ):
        (tmp_path / "bad.csv").write_text(content, encoding="utf-8")
        result = run("smooth", walk, "--fixes", tmp_path / "bad.csv")
        assert result.exit_code == 2
        assert words in result.stderr


def test_a_walk_is_smoothed_with_loop_closures_of_a_file(walk: Path, tmp_path: Path) -> None:
    (tmp_path / "loops.csv").write_text("first_s,second_s\n3,110\n", encoding="utf-8")
    result = run("smooth", walk, "--loop-closures", tmp_path / "loops.csv", "--out", tmp_path)
    assert result.exit_code == 0
    assert "1 observations, 0 not used" in result.stdout
    smoothed = pdr.smooth(pdr.read(walk), loop_closures=[LoopClosure(3.0, 110.0)])
    smoothed.track.to_csv(tmp_path / "expected.csv")
    assert (tmp_path / "demo_walk.csv").read_bytes() == (tmp_path / "expected.csv").read_bytes()
    (tmp_path / "fixes.csv").write_text("time_s,east_m,north_m\n3,5,5\n100,5,30\n", encoding="utf-8")
    both = run("smooth", walk, "--fixes", tmp_path / "fixes.csv", "--loop-closures", tmp_path / "loops.csv")
    assert "3 observations" in both.stdout


def test_a_walk_is_smoothed_against_its_own_locations_where_it_was(tmp_path: Path) -> None:
    walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=60.0)], seed=2, name="located")
    truth, here = walk.truth.position, pdr.Origin(43.77, 11.25)
    time_s = np.arange(1.0, walk.duration_s, 2.0)
    place_m = np.column_stack([np.interp(time_s, truth.time_s, truth[n]) for n in ("north_m", "east_m")])  # to the east
    values = np.column_stack([*here.latitude_longitude_deg(place_m), np.full((len(time_s), 2), 4.0)])
    located = replace(walk, location=pdr.Samples(time_s, values), truth=replace(walk.truth, waypoints=None))
    result = run("smooth", located.save(tmp_path / "located.zip"), "--out", tmp_path)
    assert result.exit_code == 0
    line = json.loads((tmp_path / "located.geojson").read_text())["features"][0]["geometry"]["coordinates"]
    longitude_deg, latitude_deg = np.array(line).T
    assert np.linalg.norm(here.east_north_m(latitude_deg, longitude_deg)[-1] - place_m[-1]) < 4.0
    bare = run("smooth", replace(located, location=None).save(tmp_path / "bare.zip"))
    assert (bare.exit_code, "located has no waypoints; give fixes" in one_line(bare.stderr)) == (2, True)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("first_s,std_m\n1,2\n", "no column 'second_s'"),
        ("first_s,second_s\n", "no loop closures"),
        ("first_s,second_s\n1,\n", "row 1: first_s,second_s must all be numbers"),
        ("first_s,second_s\n1,x\n", "'x' is not a number"),
        ("first_s,second_s\n1,9\n9,9\n", "row 2: first_s must be before second_s, got 9 and 9"),
        ("first_s,second_s,std_m\n1,9,0\n", "row 1: std_m must be positive"),
        ("first_s,second_s\n1,900\n", "loop closure 1 at 900.0 s is outside the recording, 0.0 to 11"),
    ],
)
def test_a_file_of_loop_closures_that_cannot_be_used_is_one_line(
    walk: Path, tmp_path: Path, content: str, words: str
) -> None:
    (tmp_path / "bad.csv").write_text(content, encoding="utf-8")
    result = run("smooth", walk, "--loop-closures", tmp_path / "bad.csv")
    assert (result.exit_code, result.stdout) == (2, "")
    assert words in one_line(result.stderr)


def test_the_format_can_be_forced_and_an_unknown_one_is_refused(walk: Path) -> None:
    assert run("info", walk, "--format", "own").exit_code == 0
    result = run("info", walk, "--format", "quux")
    assert result.exit_code == 2
    assert "known are" in result.stderr


def test_a_folder_of_recordings_makes_one_table_that_is_not_made_twice(walk: Path, tmp_path: Path) -> None:
    folder = tmp_path / "many"
    folder.mkdir()
    recording = pdr.read(walk)
    for name in ("a", "b"):
        write_recording(replace(recording, name=name), folder / f"{name}.zip")
    (folder / "broken.zip").write_bytes(b"no zip")
    for _ in range(2):
        result = run("track", folder, "--jobs", "1", "--out", tmp_path / "out")
        assert result.exit_code == 1
        assert "2 recordings tracked, 1 failed" in result.stdout
        assert "broken.zip" in result.stderr
        lines = (tmp_path / "out" / "tracks.csv").read_text(encoding="utf-8").splitlines()
        assert len(lines) == 4
    result = run("track", folder, "--jobs", "1", "--json")
    assert result.exit_code == 2
    assert "without --json: leave it out" in result.stderr
    assert "say with --out in which folder" in run("track", folder, "--jobs", "1").stderr


def test_a_folder_gets_a_page_of_all_with_picture_report_and_table_of_each(walk: Path, tmp_path: Path) -> None:
    recording = pdr.read(walk)
    for name in ("a", "b<i>"):
        write_recording(replace(recording, name=name), tmp_path / "many" / f"{name}.zip")
    (tmp_path / "many" / "broken.zip").write_bytes(b"no zip")
    for n in range(2):
        result = run("track", tmp_path / "many", "--out", tmp_path / "out")
        assert result.exit_code == 1
        assert "1 of 3 files failed" in result.stderr
        assert ("replaced, as they were there before" in " ".join(result.stderr.split())) == (n == 1)
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    for name in ("a", "b_i_"):
        for kind in ("csv", "png", "html"):
            assert (tmp_path / "out" / f"{name}.{kind}").is_file()
            assert f'"{name}.{kind}"' in page
    assert "b&lt;i&gt;" in page
    assert "broken.zip" in page
    assert "<i>" not in page


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


def test_all_failed_is_one_code_whatever_the_number(broken: Path, tmp_path: Path) -> None:
    (tmp_path / "other.zip").write_bytes(b"no zip")
    assert run("info", broken).exit_code == run("info", broken, tmp_path / "other.zip").exit_code == 2


def test_a_file_in_the_place_of_the_folder_is_said_in_words(walk: Path, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    result = run("track", walk, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "Errno" not in result.stderr
    assert "a file is there where a folder is to be" in one_line(result.stderr)


def test_a_stop_says_what_is_done_and_what_is_left(walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("a", "b", "c"):
        write_recording(replace(pdr.read(walk), name=name), tmp_path / "many" / f"{name}.zip")
    from pdr_filter.io import describe

    original = describe.describe

    def stopped(recording: pdr.Recording) -> describe.Description:
        if recording.name == "b":
            raise KeyboardInterrupt
        return original(recording)

    monkeypatch.setattr(describe, "describe", stopped)
    (tmp_path / "many" / "0.zip").write_bytes(b"no zip")
    result = run("info", tmp_path / "many")
    assert result.exit_code == 130
    failed, stopped = result.stderr.strip().splitlines()
    assert "0.zip" in failed
    assert "stopped: 1 of 4 done" in stopped
    assert "b.zip and 1 more" in stopped


def test_a_report_is_one_page_beside_the_other_files(walk: Path, tmp_path: Path) -> None:
    assert run("track", walk, "--report", "--out", tmp_path).exit_code == 0
    [page] = tmp_path.glob("*.html")
    assert "leaflet" in page.read_text(encoding="utf-8")


# --- Wi-Fi -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a walk to be located, and in `known` those of the map."""
    folder = tmp_path_factory.mktemp("radio")
    (folder / "known").mkdir()
    for seed in (1, 2):
        walk_with_wifi(round_a_block(), seed).save(folder / "known" / f"walk{seed}.zip")
    walk_with_wifi(round_a_block(turns=4), 3).save(folder / "walk3.zip")
    return folder


def test_a_radio_map_is_fitted_on_a_folder_and_used_by_track_and_smooth(mapped: Path, tmp_path: Path) -> None:
    result = run("radio", mapped / "known", "--out", tmp_path / "map")
    assert result.exit_code == 0
    assert "100 access points, 1 storeys) of 2 walks in 2 recordings" in result.stdout
    radio, recording = pdr.RadioMap.load(tmp_path / "map.json"), pdr.read(mapped / "walk3.zip")
    fixes = radio.fixes(recording)
    assert run("track", mapped / "walk3.zip", "--radio", tmp_path / "map.json", "--out", tmp_path).exit_code == 0
    config = pdr.recipes.default(recording.subject).in_world_frame()
    pdr.track(recording, config, fixes=fixes).to_csv(tmp_path / "expected.csv")
    assert (tmp_path / "walk3.csv").read_bytes() == (tmp_path / "expected.csv").read_bytes()
    smoothed = run("smooth", mapped / "walk3.zip", "--radio", tmp_path / "map.json", "--wifi-loops")
    n = len(fixes) + len(wifi_loop_closures(recording))
    assert f"{n} observations" in smoothed.stdout


def test_a_radio_map_that_cannot_be_used_is_refused_before_a_file_is_read(mapped: Path, tmp_path: Path) -> None:
    missing = run("track", mapped / "walk3.zip", "--radio", tmp_path / "none.json")
    assert (missing.exit_code, "none.json: no such file" in one_line(missing.stderr)) == (2, True)
    many = run("track", mapped / "known", "--jobs", "2", "--out", tmp_path, "--radio", tmp_path / "none.json")
    assert (many.exit_code, "without --radio" in one_line(many.stderr)) == (2, True)
    without = run("radio", write_recording(pdr.simulate.demo_walk(), tmp_path / "w.zip"), "--out", tmp_path / "m")
    assert (without.exit_code, "no walk has Wi-Fi scans" in one_line(without.stderr)) == (2, True)
    assert not (tmp_path / "m.json").exists()
