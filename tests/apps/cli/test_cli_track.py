"""Command `pdr-filter track`: output and files for one recording, for many, and with a radio map."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import copies, run, short_walk, succeed
from heard import round_a_block, walk_with_wifi

import pdr_filter as pdr
from pdr_filter.classifiers.context_model import load_model
from pdr_filter.data.io import describe
from pdr_filter.data.io.files.own_format import write_recording
from pdr_filter.offline.smoothing.wifi_loops import wifi_loop_closures
from pdr_filter.sensing.contexts.learned_contexts import LearnedContexts

pytestmark = pytest.mark.usefixtures("sensing_once")

MODELS = Path(__file__).resolve().parents[3] / "models"


@pytest.mark.parametrize("options", [[], ["--long"]])
def test_a_person_without_fixes_is_not_written_and_a_message_says_so(
    walk: Path, options: list[str], tmp_path: Path
) -> None:
    result = succeed("track", walk, "--person", tmp_path / "me.json", "--out", tmp_path, *options)
    assert "me.json was not written, because the fixes of the walk do not determine" in result.stderr.replace("\n", "")
    assert not (tmp_path / "me.json").exists()


@pytest.mark.parametrize(
    ("option", "words"),
    [("--height=1,86", "write a point in place of the comma"), ("--fixes=x.csv", "use pdr-filter smooth")],
)
def test_a_wrong_option_of_track_is_refused_with_its_remedy(option: str, words: str) -> None:
    result = run("track", "walk.zip", option)
    assert result.exit_code == 2
    assert words in result.stderr


def test_track_json_is_one_object_a_line_and_nothing_else_on_stdout(walk: Path, broken: Path) -> None:
    command = [sys.executable, "-m", "pdr_filter.apps.cli.app", "track", "--json", str(walk), str(broken), str(walk)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    objects = [json.loads(line) for line in done.stdout.splitlines()]
    summary = pdr.smooth(pdr.read(walk)).track.summary()
    assert objects[0] == summary
    assert objects[2] == {**summary, "name": f"{summary['name']}_2"}  # as its output files would be called
    assert set(objects[1]) == {"name", "error"}
    assert objects[1]["name"] == "broken"
    assert done.returncode == 1
    assert "broken.zip" in done.stderr
    assert "Traceback" not in done.stderr


def test_long_writes_the_table_of_the_online_track(walk: Path, tmp_path: Path) -> None:
    result = succeed("track", walk, "--long", "--out", tmp_path, "--height", "1.9")
    expected = pdr.track(pdr.read(walk).of_height(1.9))
    succeed("track", walk, "--long", "--out", tmp_path / "again", "--device", tmp_path / "phone.json")
    assert repr(pdr.Device.load(tmp_path / "phone.json")) == repr(expected.device)
    assert (tmp_path / f"{walk.stem}.csv").read_bytes() == expected.to_csv(tmp_path / "whole.csv").read_bytes()
    assert f"{expected.n_steps} steps, {expected.distance_m:.1f} m" in result.stdout


def test_track_prints_one_row_for_each_file(walk: Path) -> None:
    result = run("track", walk, walk)
    summary = pdr.smooth(pdr.read(walk)).track.summary()
    rows = [line for line in result.stdout.splitlines() if "short_walk" in line and "short_walk:" not in line]
    assert result.exit_code == 0
    assert len(rows) == 2
    for value in (str(summary["n_steps"]), f"{summary['distance_m']:.1f} m", f"{summary['end_east_m']:.1f} m"):
        assert value in rows[0]


def test_notes_stand_below_the_table_and_with_json_in_the_object(tmp_path: Path) -> None:
    recording = replace(short_walk(), gyroscope=None, name="no_gyroscope")
    file = write_recording(recording, tmp_path / "no_gyroscope.zip")
    shown = run("track", file).stdout
    assert "no gyroscope" in shown
    assert shown.partition("±: one")[0].count(" unknown ") == 2  # both coordinates of its end
    with_json = run("track", "--json", file)
    assert any("no gyroscope" in note for note in json.loads(with_json.stdout)["notes"])
    assert with_json.stderr == ""


def test_the_online_track_is_shown_with_online_and_the_smoothed_track_without(walk: Path) -> None:
    smoothed, online = run("track", walk), run("track", "--online", walk)
    assert "--online shows the estimates available at each step" in " ".join(smoothed.stdout.split())
    assert "--online" not in online.stdout
    summary = json.loads(run("track", "--online", "--json", walk).stdout)
    assert summary == pdr.track(pdr.read(walk)).summary()
    assert summary["estimate"] == "online"


def test_a_report_shows_the_smoothed_walk_first_and_the_online_track_one_click_away(walk: Path, tmp_path: Path) -> None:
    succeed("track", walk, "--report", "--out", tmp_path)
    page = (tmp_path / "short_walk.html").read_text()
    assert page.index("short_walk, smoothed") < page.index("short_walk, online")
    assert page.count('name="track"') == 2
    assert "leaflet" in page
    assert "The smoothed track is the best estimate from the whole recording. The online track shows" in page
    succeed("track", walk, "--report", "--online", "--out", tmp_path / "online")
    alone = (tmp_path / "online" / "short_walk.html").read_text()
    assert 'name="track"' not in alone
    assert "Online: each position is estimated from the samples up to its step." in alone


def test_a_looped_walk_ends_where_it_began(walk: Path) -> None:
    looped = json.loads(run("track", "--loop", "--json", walk).stdout)
    assert looped == pdr.smooth(pdr.read(walk), loop=True).track.summary()
    assert np.hypot(looped["end_east_m"], looped["end_north_m"]) < 1.0


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ("--weighting hc", {"weighting": "hc"}),
        ("--weighting wc", {"weighting": "wc"}),
        ("--recipe martinelli2018", {"config": pdr.recipes.martinelli2018()}),
        ("--origin -43.77,11.25 --heading -90", {"origin": (-43.77, 11.25), "heading_rad": -np.pi / 2}),
        ("--origin -43.77,11.25 --north magnetic", {"origin": (-43.77, 11.25), "north": "magnetic"}),
    ],
)
def test_options_are_arguments_of_the_smoother(walk: Path, options: str, expected: dict[str, Any]) -> None:
    summary = json.loads(run("track", "--json", walk, *options.split()).stdout)
    assert summary == pdr.smooth(pdr.read(walk), **expected).track.summary()
    assert summary.get("frame") == "north" or "origin" not in expected


def test_the_classifier_is_the_one_asked_for(walk: Path, tmp_path: Path) -> None:
    succeed("track", "--online", "--classifier", "rvm", "--out", tmp_path, walk)
    tables = {
        name: pdr.track(pdr.read(walk), config=pdr.recipes.default(pdr.read(walk).subject, classifier=name))
        .to_csv(tmp_path / f"{name}.csv")
        .read_bytes()
        for name in ("rvm", "blend")
    }
    assert (tmp_path / "short_walk.csv").read_bytes() == tables["rvm"] != tables["blend"]


def test_the_model_replaces_the_one_for_windows_with_gyroscope(walk: Path) -> None:
    path = MODELS / "context_martinelli_forest.npz"
    result = run("track", "--json", "--model", path, walk)
    config = pdr.recipes.with_context_model(pdr.recipes.default(pdr.read(walk).subject), load_model(path))
    contexts = config.sensing.contexts
    assert isinstance(contexts, LearnedContexts)
    assert contexts.models.with_gyroscope.name == "context_martinelli_forest"
    assert contexts.windows.features.name == "martinelli"
    assert json.loads(result.stdout) == pdr.smooth(pdr.read(walk), config=config).track.summary()
    assert json.loads(result.stdout) != pdr.smooth(pdr.read(walk)).track.summary()


def test_out_gets_a_table_and_a_picture_and_with_an_origin_a_map_file(walk: Path, tmp_path: Path) -> None:
    succeed("track", walk, "--out", tmp_path / "plain")
    assert {p.name for p in (tmp_path / "plain").iterdir()} == {"short_walk.csv", "short_walk.png"}
    succeed("track", walk, "--out", tmp_path / "placed", "--origin", "43.77,-11.25")
    (feature,) = json.loads((tmp_path / "placed" / "short_walk.geojson").read_text())["features"]
    assert feature["geometry"]["coordinates"][0][:2] == pytest.approx([-11.25, 43.77])


def test_a_located_walk_gets_its_map_file_unless_its_locations_are_off(tmp_path: Path) -> None:
    walk = short_walk()
    time_s = np.arange(1.0, walk.duration_s, 4.0)
    values = np.tile([43.77, 11.25, 50.0, 30.0], (len(time_s), 1))
    file = replace(walk, location=pdr.Samples(time_s, values)).save(tmp_path / "located.zip")
    placed = run("track", file, "--out", tmp_path / "placed", "--json")
    assert json.loads(placed.stdout)["end_latitude_deg"] == pytest.approx(43.77, abs=0.002)
    (feature,) = json.loads(next((tmp_path / "placed").glob("*.geojson")).read_text())["features"]
    places = np.array(feature["geometry"]["coordinates"])[:, :2]
    np.testing.assert_allclose(places, np.tile([11.25, 43.77], (len(places), 1)), atol=0.003)
    off = run("track", file, "--out", tmp_path / "off", "--gnss", "off", "--json")
    assert json.loads(off.stdout) == pdr.smooth(replace(pdr.read(file), location=None)).track.summary()
    assert not list((tmp_path / "off").glob("*.geojson"))


def test_files_are_exported_once_whether_asked_with_commas_or_again(walk: Path, tmp_path: Path) -> None:
    kinds = ["csv", "geojson", "gpx", "kml", "tum"]
    options = ["--export", "csv, geojson,GPX", "--export", "kml,tum", "--export", "csv", "--origin", "43.77,11.25"]
    succeed("track", walk, walk, *options, "--out", tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {f"{name}.{kind}" for name in ("short_walk", "short_walk_2") for kind in [*kinds, "png"]}
    track = pdr.smooth(pdr.read(walk), origin=(43.77, 11.25)).track
    for kind in kinds:
        written = getattr(track, f"to_{kind}")(tmp_path / "expected")
        assert written.read_bytes() == (tmp_path / f"short_walk.{kind}").read_bytes()


def test_a_map_that_is_asked_for_without_a_place_is_a_local_one(walk: Path, tmp_path: Path) -> None:
    succeed("track", walk, "--export", "geojson", "--out", tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {"short_walk.csv", "short_walk.png", "short_walk.local.geojson"}


def test_points_of_gpx_have_the_time_at_which_they_were_walked_if_the_file_says_it(tmp_path: Path) -> None:
    recording = short_walk()
    for name, value in (("epoch_s", 1.7e9), ("epoch_ms", 1_700_000_000_000), ("epoch_ns", 1_700_000_000 * 10**9)):
        timed = replace(recording, name=name, meta={**recording.meta, name: value})
        assert timed.epoch_s == pytest.approx(1.7e9, abs=1e-3)
    assert recording.epoch_s is None
    file = timed.save(tmp_path / "walk.zip")
    succeed("track", file, "--origin", "43.77,11.25", "--export", "gpx", "--out", tmp_path)
    assert "<time>2023-11-14T22:13:20" in (tmp_path / "epoch_ns.gpx").read_text()


def test_a_folder_of_recordings_makes_one_table_that_is_not_made_twice(walk: Path, tmp_path: Path) -> None:
    folder, out = copies(walk, tmp_path / "many", "a", "b"), tmp_path / "out"
    for n in range(2):
        result = run("track", folder, "--jobs", "1", "--gnss", "off", "--out", out)
        assert result.exit_code == 1
        assert ("(3 of 3 rows are from an earlier run)" in result.stdout) == (n == 1)
        assert ("a.zip may have been replaced" in result.stderr.replace("\n", "")) == (n == 1)
        os.utime(folder / "a.zip", (2e9, 2e9))
        assert "2 recordings tracked, 1 failed" in result.stdout
        assert "0.zip" in result.stderr
        assert [row.gnss for row in pdr.batch.read_table(out / "tracks.csv")] == ["off"] * 3


def test_a_folder_gets_a_page_of_all_with_picture_report_and_table_of_each(walk: Path, tmp_path: Path) -> None:
    folder, out = copies(walk, tmp_path / "many", "a", "b<i>"), tmp_path / "out"
    for n in range(2):
        result = run("track", folder, "--out", out)
        assert result.exit_code == 1
        assert "1 of 3 files failed" in result.stderr
        assert ("replaced existing files" in " ".join(result.stderr.split())) == (n == 1)
    page = (out / "index.html").read_text(encoding="utf-8")
    for file in (f"{name}.{kind}" for name in ("a", "b_i_") for kind in ("csv", "png", "html")):
        assert (out / file).is_file()
        assert f'"{file}"' in page
    assert "b&lt;i&gt;" in page and "0.zip" in page
    assert "<i>" not in page


def test_a_stop_says_what_is_done_and_what_is_left(walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original = describe.describe

    def stopped(recording: pdr.Recording) -> describe.Description:
        if recording.name == "b":
            raise KeyboardInterrupt
        return original(recording)

    monkeypatch.setattr(describe, "describe", stopped)
    result = run("info", copies(walk, tmp_path, "a", "b", "c"))
    assert result.exit_code == 130
    failed, message = result.stderr.strip().splitlines()
    assert "0.zip" in failed
    assert "stopped: 1 of 4 done" in message and "b.zip and 1 more" in message


# --- Wi-Fi -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a walk to be located, and a subfolder `known` with the walks of the map."""
    folder = tmp_path_factory.mktemp("radio")
    (folder / "known").mkdir()
    for seed in (1, 2):
        walk_with_wifi(round_a_block(), seed).save(folder / "known" / f"walk{seed}.zip")
    walk_with_wifi(round_a_block(turns=4), 3).save(folder / "walk3.zip")
    return folder


def test_a_radio_map_is_fitted_on_a_folder_and_used_by_track_and_smooth(mapped: Path, tmp_path: Path) -> None:
    result = succeed("radio", mapped / "known", "--out", tmp_path / "map")
    assert "100 access points, 1 storeys) of 2 walks in 2 recordings" in result.stdout
    radio, recording = pdr.RadioMap.load(tmp_path / "map.json"), pdr.read(mapped / "walk3.zip")
    fixes = radio.fixes(recording)
    succeed("track", mapped / "walk3.zip", "--radio", tmp_path / "map.json", "--out", tmp_path)
    config = pdr.recipes.default(recording.subject).in_world_frame()
    pdr.smooth(recording, fixes=fixes, config=config).track.to_csv(tmp_path / "expected.csv")
    assert (tmp_path / "walk3.csv").read_bytes() == (tmp_path / "expected.csv").read_bytes()
    smoothed = run("smooth", mapped / "walk3.zip", "--radio", tmp_path / "map.json", "--wifi-loops")
    n = len(fixes) + len(wifi_loop_closures(recording))
    assert f"{n} observations" in smoothed.stdout
