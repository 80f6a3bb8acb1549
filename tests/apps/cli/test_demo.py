"""Demonstration: four files and a correct summary."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from true_positions import HERE, located, true_m

import pdr_filter as pdr
from pdr_filter.apps.cli.demo import Demo, run_demo
from pdr_filter.apps.report.page_data import track_data
from pdr_filter.data.io.files.own_format import write_recording


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    fractions: list[float] = []
    demo = run_demo(None, tmp_path_factory.mktemp("demo"), fractions.append)
    assert fractions == sorted(fractions) and fractions[-1] == 1.0
    return demo


def straight_walk() -> pdr.Recording:
    return pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=40.0)], seed=3, name="walk")


def printed(demo: Demo) -> str:
    console = Console(width=100, highlight=False)
    with console.capture() as capture:
        demo.print(console)
    return capture.get()


def test_the_demo_writes_a_report_a_picture_a_map_file_and_a_table(simulated: Demo) -> None:
    assert simulated.report.read_text().startswith("<!DOCTYPE html>")
    assert simulated.picture.read_bytes().startswith(b"\x89PNG")
    assert len(simulated.csv.read_text().splitlines()) == simulated.track.n_steps + 1
    (feature,) = json.loads(simulated.geojson.read_text())["features"]
    assert len(feature["geometry"]["coordinates"]) == simulated.track.n_steps + 1


def test_a_map_file_without_a_place_says_so_in_its_name_and_content_and_on_screen(simulated: Demo) -> None:
    assert simulated.geojson.name == "demo_walk.local.geojson"
    (feature,) = json.loads(simulated.geojson.read_text())["features"]
    assert feature["properties"]["frame"] == "local, not on Earth"
    assert "not on Earth" in feature["properties"]["name"]
    places_deg = np.array(feature["geometry"]["coordinates"])[:, :2]
    assert np.abs(places_deg).max() < 0.01  # in the open sea, where a metre is a metre both ways
    assert "shape only, because the position on Earth is unknown" in printed(simulated)


def test_the_picture_of_the_simulated_walk_shows_the_true_way(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    drawn: list[np.ndarray | None] = []
    monkeypatch.setattr("pdr_filter.apps.report.plot.track", lambda track, path, reference_m: drawn.append(reference_m))
    demo = run_demo(None, tmp_path)
    truth = demo.recording.truth.position
    run_demo(write_recording(demo.recording, tmp_path / "mine.zip"), tmp_path)
    np.testing.assert_array_equal(drawn[0], np.column_stack([truth.east_m, truth.north_m]))
    assert drawn[1] is None  # the frame of another recording is unrelated to the track


def test_the_summary_says_that_the_walk_is_simulated_and_what_is_true(simulated: Demo) -> None:
    text = printed(simulated)
    truth = simulated.recording.truth
    assert "simulated" in text
    assert "ground truth is known exactly" in text
    assert f"truth: {len(truth.steps)}" in text
    assert f"truth: {truth.segments.distance_m.sum():.1f} m" in text
    assert f"{simulated.track.n_steps}" in text
    assert f"{simulated.track.distance_m:.1f} m" in text


def test_the_demo_shows_all_contexts_and_ends_within_its_ellipse(simulated: Demo) -> None:
    """The demo shows all contexts, its ellipse of 95 % holds the true end, and it has no notes."""
    track, truth = simulated.track, simulated.recording.truth
    middle_s = track.windows.time_s - 1.0
    true = truth.labels.context[np.searchsorted(truth.labels.end_s, middle_s)]
    best = np.array(track.contexts)[track.windows.context_prob.argmax(axis=1)]
    for context in ("stationary", "walking", "upstairs", "downstairs", "running"):
        assert (best[true == context] == context).mean() > 0.8, context
    end_m = np.array([truth.position.east_m[-1], truth.position.north_m[-1]])
    nees = pdr.evaluate.nees((track.end_position_m - end_m)[None], track.position_cov_m2[-1:])
    assert 0.1 < nees[0] < 5.99  # the person and the phone are not the typical ones, which end much closer
    assert track.floor_changes()[0].to_floor == 1
    assert track.floor[-1] == 0
    assert track.notes == ()


def test_the_summary_names_the_files_the_uncertainty_and_the_next_step(simulated: Demo) -> None:
    text = printed(simulated)
    for path in (simulated.report, simulated.picture, simulated.geojson, simulated.csv):
        assert str(path) in text
    how_sure = f"± {simulated.track.position_std_m[-1]:.1f} m  +standard deviation in the worst direction"
    assert re.search(how_sure, text)
    assert "pdr-filter demo YOUR.zip" in text
    assert len(text.splitlines()) <= 24  # one screen


def test_the_demo_of_a_file_tracks_that_file_and_claims_no_truth(tmp_path: Path) -> None:
    walk = straight_walk()
    file = write_recording(walk, tmp_path / "mine.zip")
    demo = run_demo(file, tmp_path / "out")
    assert demo.track.n_steps == pdr.track(pdr.read(file)).n_steps
    text = printed(demo)
    assert str(file) in text
    assert "truth" not in text
    assert "Next" not in text  # there is no next step after a recording of the user


def test_the_map_is_where_the_locations_of_the_recording_say(tmp_path: Path) -> None:
    walk = straight_walk()
    time_s = np.arange(1.0, walk.duration_s, 5.0)
    file = write_recording(located(walk, time_s), tmp_path / "mine.zip")
    demo = run_demo(file, tmp_path / "out")
    (feature,) = json.loads(demo.geojson.read_text())["features"]
    longitude_deg, latitude_deg = np.array(feature["geometry"]["coordinates"])[:, :2].T
    assert np.linalg.norm(HERE.east_north_m(latitude_deg, longitude_deg)[-1] - true_m(walk, time_s[-1])) < 15.0
    assert "georeferenced by the locations in the recording" in printed(demo)
    assert run_demo(file, tmp_path / "off", gnss="off").geojson.name.endswith(".local.geojson")


def test_a_recording_without_steps_makes_a_demo_that_says_so(tmp_path: Path) -> None:
    legs = [pdr.simulate.Leg("stationary", duration_s=20.0)]
    walk = pdr.simulate.simulate(legs, name="rest")
    demo = run_demo(write_recording(walk, tmp_path / "rest.zip"), tmp_path / "out")
    assert demo.track.n_steps == 0
    assert "no steps were detected" in printed(demo)
    assert demo.picture.is_file()


def test_the_end_error_on_the_screen_is_that_of_the_report_at_the_last_step(simulated: Demo) -> None:
    position_m = simulated.track.position_m.copy()
    position_m[-1] += 9.0
    off = replace(simulated, track=replace(simulated.track, position_m=position_m))
    for demo in (simulated, off):
        data = track_data(demo.track, demo.recording, None, 1)
        assert f"{data['from_truth'][-1]:.1f} m after rigid alignment" in printed(demo)
        assert (data["from_truth"][-1] > 5.0) == (demo is off)
    data = track_data(simulated.track, simulated.recording, None, 1)
    assert f'"from_truth":{json.dumps(data["from_truth"], separators=(",", ":"))}' in simulated.report.read_text()


def test_a_printed_note_is_not_repeated(simulated: Demo) -> None:
    noted = replace(simulated, track=replace(simulated.track, notes=("the height is not known",)))
    console, said = Console(width=100, highlight=False), set[str]()
    with console.capture() as capture:
        for _ in range(3):
            noted.print(console, said)
    assert capture.get().count("the height is not known") == 1
