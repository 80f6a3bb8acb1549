"""Command `pdr-filter track`: output and files for one recording, for many, and with a radio map."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import one_line, run, short_walk
from heard import round_a_block, walk_with_wifi

import pdr_filter as pdr
from pdr_filter.classifiers.context_model import load_model
from pdr_filter.data.io.files.own_format import write_recording
from pdr_filter.offline.smoothing.wifi_loops import wifi_loop_closures
from pdr_filter.sensing.contexts.learned_contexts import LearnedContexts

MODELS = Path(__file__).resolve().parents[3] / "models"


def test_a_person_without_fixes_is_not_written_and_a_message_says_so(walk: Path, tmp_path: Path) -> None:
    result = run("track", walk, "--person", tmp_path / "me.json")
    assert result.exit_code == 0
    assert "me.json was not written, because the fixes of the walk do not determine" in result.stderr.replace("\n", "")
    assert not (tmp_path / "me.json").exists()


def test_track_json_is_one_object_a_line_and_nothing_else_on_stdout(walk: Path, broken: Path) -> None:
    command = [sys.executable, "-m", "pdr_filter.apps.cli.app", "track", "--json", str(walk), str(broken), str(walk)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    objects = [json.loads(line) for line in done.stdout.splitlines()]
    summary = pdr.smooth(pdr.read(walk)).track.summary()
    assert objects[0] == objects[2] == summary
    assert set(objects[1]) == {"name", "error"}
    assert objects[1]["name"] == "broken"
    assert done.returncode == 1
    assert "broken.zip" in done.stderr
    assert "Traceback" not in done.stderr


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
    assert "no gyroscope" in run("track", file).stdout
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
    assert run("track", walk, "--report", "--out", tmp_path).exit_code == 0
    page = (tmp_path / "short_walk.html").read_text()
    assert page.index("short_walk, smoothed") < page.index("short_walk, online")
    assert page.count('name="track"') == 2
    assert "The smoothed track is the best estimate from the whole recording. The online track shows" in page
    assert run("track", walk, "--report", "--online", "--out", tmp_path / "online").exit_code == 0
    alone = (tmp_path / "online" / "short_walk.html").read_text()
    assert 'name="track"' not in alone
    assert "Online: each position is estimated from the samples up to its step." in alone


def test_loop_is_refused_together_with_online(walk: Path) -> None:
    looped = json.loads(run("track", "--loop", "--json", walk).stdout)
    assert looped == pdr.smooth(pdr.read(walk), loop=True).track.summary()
    assert np.hypot(looped["end_east_m"], looped["end_north_m"]) < 1.0
    both = run("track", "--loop", "--online", walk)
    assert (both.exit_code, "--loop cannot be used with --online" in one_line(both.stderr)) == (2, True)


@pytest.mark.parametrize("weighting", ["hc", "wc", "imm"])
def test_the_weighting_is_the_one_asked_for(walk: Path, weighting: str) -> None:
    result = run("track", "--json", "--weighting", weighting, walk)
    assert json.loads(result.stdout) == pdr.smooth(pdr.read(walk), weighting=weighting).track.summary()


def test_the_recipe_is_the_one_asked_for(walk: Path) -> None:
    result = run("track", "--json", "--recipe", "martinelli2018", walk)
    assert json.loads(result.stdout) == pdr.smooth(pdr.read(walk), config=pdr.recipes.martinelli2018()).track.summary()


def test_the_classifier_is_the_one_asked_for(walk: Path, tmp_path: Path) -> None:
    assert run("track", "--online", "--classifier", "rvm", "--out", tmp_path, walk).exit_code == 0
    tables = {
        name: pdr.track(pdr.read(walk), config=pdr.recipes.default(pdr.read(walk).subject, classifier=name))
        .to_csv(tmp_path / f"{name}.csv")
        .read_bytes()
        for name in ("rvm", "blend")
    }
    assert (tmp_path / "short_walk.csv").read_bytes() == tables["rvm"] != tables["blend"]


@pytest.mark.parametrize("other", [("--recipe", "martinelli2018"), ("--model", MODELS / "context_boosted.npz")])
def test_a_classifier_is_refused_with_another_source_of_models(walk: Path, other: tuple[str, object]) -> None:
    result = run("track", "--classifier", "rvm", *other, walk)
    assert result.exit_code == 2
    assert f"--classifier rvm chooses a model of the recipe default, but {other[0]}" in one_line(result.stderr)


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
    assert run("track", walk, "--out", tmp_path / "plain").exit_code == 0
    assert {p.name for p in (tmp_path / "plain").iterdir()} == {"short_walk.csv", "short_walk.png"}
    assert run("track", walk, "--out", tmp_path / "placed", "--origin", "43.77,-11.25").exit_code == 0
    line = json.loads((tmp_path / "placed" / "short_walk.geojson").read_text())["features"][0]["geometry"][
        "coordinates"
    ]
    assert line[0][:2] == pytest.approx([-11.25, 43.77])


def test_a_located_walk_gets_its_map_file_unless_its_locations_are_off(tmp_path: Path) -> None:
    walk = short_walk()
    time_s = np.arange(1.0, walk.duration_s, 4.0)
    values = np.tile([43.77, 11.25, 50.0, 30.0], (len(time_s), 1))
    file = replace(walk, location=pdr.Samples(time_s, values)).save(tmp_path / "located.zip")
    placed = run("track", file, "--out", tmp_path / "placed", "--json")
    assert json.loads(placed.stdout)["end_latitude_deg"] == pytest.approx(43.77, abs=0.002)
    line = json.loads(next((tmp_path / "placed").glob("*.geojson")).read_text())["features"][0]["geometry"]
    places = np.array(line["coordinates"])[:, :2]
    np.testing.assert_allclose(places, np.tile([11.25, 43.77], (len(places), 1)), atol=0.003)
    off = run("track", file, "--out", tmp_path / "off", "--gnss", "off", "--json")
    assert json.loads(off.stdout) == pdr.smooth(replace(pdr.read(file), location=None)).track.summary()
    assert not list((tmp_path / "off").glob("*.geojson"))


def test_a_place_and_a_heading_that_are_given_are_those_of_the_track(walk: Path, tmp_path: Path) -> None:
    result = run("track", walk, "--origin", "-43.77,11.25", "--heading", "-90", "--json", "--out", tmp_path)
    expected = pdr.smooth(pdr.read(walk), origin=(-43.77, 11.25), heading_rad=-np.pi / 2).track
    assert json.loads(result.stdout) == expected.summary()
    assert json.loads(result.stdout)["frame"] == "north"
    assert (tmp_path / "short_walk.geojson").read_bytes() == expected.to_geojson(tmp_path / "a").read_bytes()


def test_north_of_the_magnetometer_turns_a_walk_whose_place_is_given(walk: Path) -> None:
    result = run("track", walk, "--origin", "-43.77,11.25", "--north", "magnetic", "--json")
    expected = pdr.smooth(pdr.read(walk), origin=(-43.77, 11.25), north="magnetic").track
    assert json.loads(result.stdout) == expected.summary()
    assert expected.frame == "north"
    contradicting = run("track", walk, "--heading", "90", "--north", "magnetic")
    assert (contradicting.exit_code, "both define north" in one_line(contradicting.stderr)) == (2, True)


def test_files_are_exported_once_whether_asked_with_commas_or_again(walk: Path, tmp_path: Path) -> None:
    kinds = ["csv", "geojson", "gpx", "kml", "tum"]
    options = ["--export", "csv, geojson,GPX", "--export", "kml,tum", "--export", "csv", "--origin", "43.77,11.25"]
    assert run("track", walk, walk, *options, "--out", tmp_path).exit_code == 0
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {f"{name}.{kind}" for name in ("short_walk", "short_walk_2") for kind in [*kinds, "png"]}
    track = pdr.smooth(pdr.read(walk), origin=(43.77, 11.25)).track
    for kind in kinds:
        written = getattr(track, f"to_{kind}")(tmp_path / "expected")
        assert written.read_bytes() == (tmp_path / f"short_walk.{kind}").read_bytes()


def test_a_map_that_is_asked_for_without_a_place_is_a_local_one_and_others_are_refused(
    walk: Path, tmp_path: Path
) -> None:
    assert run("track", walk, "--export", "geojson", "--out", tmp_path).exit_code == 0
    assert {p.name for p in tmp_path.iterdir()} == {"short_walk.csv", "short_walk.png", "short_walk.local.geojson"}
    refused = run("track", walk, "--export", "kml,gpx", "--out", tmp_path / "no")
    assert (refused.exit_code, "--origin LAT,LON" in one_line(refused.stderr)) == (2, True)
    assert not (tmp_path / "no").exists()


def test_points_of_gpx_have_the_time_at_which_they_were_walked_if_the_file_says_it(tmp_path: Path) -> None:
    recording = short_walk()
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
    assert "--json cannot be used with --jobs or --scheduler" in result.stderr
    assert "add --out FOLDER" in run("track", folder, "--jobs", "1").stderr


def test_a_folder_gets_a_page_of_all_with_picture_report_and_table_of_each(walk: Path, tmp_path: Path) -> None:
    recording = pdr.read(walk)
    for name in ("a", "b<i>"):
        write_recording(replace(recording, name=name), tmp_path / "many" / f"{name}.zip")
    (tmp_path / "many" / "broken.zip").write_bytes(b"no zip")
    for n in range(2):
        result = run("track", tmp_path / "many", "--out", tmp_path / "out")
        assert result.exit_code == 1
        assert "1 of 3 files failed" in result.stderr
        assert ("replaced existing files" in " ".join(result.stderr.split())) == (n == 1)
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    for name in ("a", "b_i_"):
        for kind in ("csv", "png", "html"):
            assert (tmp_path / "out" / f"{name}.{kind}").is_file()
            assert f'"{name}.{kind}"' in page
    assert "b&lt;i&gt;" in page
    assert "broken.zip" in page
    assert "<i>" not in page


def test_a_stop_says_what_is_done_and_what_is_left(walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("a", "b", "c"):
        write_recording(replace(pdr.read(walk), name=name), tmp_path / "many" / f"{name}.zip")
    from pdr_filter.data.io import describe

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
    """Folder with a walk to be located, and a subfolder `known` with the walks of the map."""
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
    pdr.smooth(recording, fixes, config=config).track.to_csv(tmp_path / "expected.csv")
    assert (tmp_path / "walk3.csv").read_bytes() == (tmp_path / "expected.csv").read_bytes()
    smoothed = run("smooth", mapped / "walk3.zip", "--radio", tmp_path / "map.json", "--wifi-loops")
    n = len(fixes) + len(wifi_loop_closures(recording))
    assert f"{n} observations" in smoothed.stdout


def test_a_radio_map_that_cannot_be_used_is_refused_before_a_file_is_read(mapped: Path, tmp_path: Path) -> None:
    missing = run("track", mapped / "walk3.zip", "--radio", tmp_path / "none.json")
    assert (missing.exit_code, "none.json: no such file" in one_line(missing.stderr)) == (2, True)
    many = run("track", mapped / "known", "--jobs", "2", "--out", tmp_path, "--radio", tmp_path / "none.json")
    assert (many.exit_code, "--radio cannot be used with" in one_line(many.stderr)) == (2, True)
    without = run("radio", write_recording(short_walk(), tmp_path / "w.zip"), "--out", tmp_path / "m")
    assert (without.exit_code, "no walk has Wi-Fi scans" in one_line(without.stderr)) == (2, True)
    assert not (tmp_path / "m.json").exists()
