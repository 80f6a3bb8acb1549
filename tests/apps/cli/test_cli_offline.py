"""Commands `pdr-filter calibrate` and `pdr-filter smooth`."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import mark, one_line, refusal, run, short_walk, succeed
from true_positions import HERE, located, true_m

import pdr_filter as pdr
from pdr_filter.apps.cli.options import fixes_of
from pdr_filter.apps.maps.marks import read_marks
from pdr_filter.data.io.files.own_format import write_recording
from pdr_filter.data.io.fix_files import fixes_of_file
from pdr_filter.offline.smoothing.observations import LoopClosure, waypoint_fixes
from pdr_filter.recipes.calibration import load_calibration
from pdr_filter.simulate import Gait, Leg, simulate
from pdr_filter.values.recording import Truth

pytestmark = pytest.mark.usefixtures("sensing_once")


def assert_written(expected: pdr.Smoothed, folder: Path) -> None:
    """Check the table that a command wrote for the short walk."""
    written = (folder / "short_walk.csv").read_bytes()
    assert written == expected.track.to_csv(folder / "expected.csv").read_bytes()


def test_a_calibration_is_written_and_used_by_track(tmp_path: Path) -> None:
    legs = [Leg("walking", distance_m=20.0), Leg("walking", distance_m=15.0, turn_rad=1.5)]
    walks = [write_recording(simulate(legs, seed=s, name=f"walk_{s}"), tmp_path / f"walk_{s}.zip") for s in (1, 2)]
    options = ("--figure", tmp_path / "me.png", "--tables", tmp_path / "tables")
    result = succeed("calibrate", *walks, "--out", tmp_path / "me.json", *options)
    assert "4 segments" in result.stdout
    assert (tmp_path / "me.png").read_bytes().startswith(b"\x89PNG")
    result = succeed("track", "--json", "--calibration", tmp_path / "me.json", walks[0])
    recording = pdr.read(walks[0])
    calibration = load_calibration(tmp_path / "me.json")
    for name, rows in calibration.tables().items():
        assert len((tmp_path / "tables" / f"{name}.csv").read_text().splitlines()) == len(rows) + 1
        assert (tmp_path / "tables" / f"{name}.tex").exists()
    covariance = (tmp_path / "tables" / "covariance.tex").read_text()
    walking = re.search(r"^walking & 0 & walking & 0 & (\S+) ", covariance, re.MULTILINE)
    parameters = (tmp_path / "tables" / "parameters.tex").read_text()  # only of contexts that were walked
    assert set(re.findall(r"^(\w+) & \d", parameters, re.MULTILINE)) == set(calibration.contexts) == {"walking"}
    assert float(walking[1]) == pytest.approx(calibration.k_cov["walking"][0, 0], rel=1e-4)
    calibrated = pdr.smooth(recording, calibration=tmp_path / "me.json").track
    assert json.loads(result.stdout) == calibrated.summary()
    truth_m = 35.0
    assert abs(calibrated.distance_m - truth_m) < abs(pdr.smooth(recording).track.distance_m - truth_m) + 0.1


def test_a_calibration_of_several_people_is_used_for_the_person_in_the_name_of_the_file(tmp_path: Path) -> None:
    """Without and with --long, and smoothed: each as `pdr-filter calibrate` names the persons."""
    for name, length_factor in (("anna_1", 0.85), ("anna_2", 0.85), ("ben_1", 1.15)):
        gait = Gait(length_factor=length_factor)
        recording = simulate([Leg("walking", distance_m=25.0)], gait, seed=len(name), name=name)
        write_recording(replace(recording, meta={}), tmp_path / f"{name}.zip")
    succeed("calibrate", tmp_path, "--out", tmp_path / "k.json", "--distance", 25)
    assert load_calibration(tmp_path / "k.json").subject_ids == ("anna", "ben")
    given = tmp_path / "anna_1.zip", "--person", tmp_path / "k.json", "--out", tmp_path / "out"
    for command in (("track", *given), ("track", "--long", *given), ("smooth", *given)):
        assert "step lengths of anna: calibrated for walking" in " ".join(succeed(*command).stdout.split()), command


def test_model_loss_prior_and_person_of_a_calibration_are_options(tmp_path: Path) -> None:
    walks: list[Path] = []
    for name in ("a", "b"):
        recording = replace(simulate([Leg("walking", distance_m=25.0)], seed=1, name=name), meta={})
        walks.append(write_recording(recording, tmp_path / f"{name}.zip"))
    out = tmp_path / "me.json"
    options = ("--model", "kim", "--loss", "none", "--prior", "0.3", "--subject", "anna")
    succeed("calibrate", *walks, "--out", out, *options)
    found = load_calibration(out)
    assert type(found.models["walking"]).__name__ == "KimStepLength"
    assert list(found.subjects) == ["anna"]
    expected = pdr.calibrate([pdr.read(w) for w in walks], model="kim", loss="none", prior_std=0.3, subject="anna")
    np.testing.assert_array_equal(found.theta, expected.theta)
    for extra in ((), ("--resume", tmp_path / "kept")):
        succeed("calibrate", *walks, "--out", out, "--each-a-person", *extra)
        assert list(load_calibration(out).subjects) == ["a", "b"]
    succeed("calibrate", *walks, "--out", out, "--recipe", "martinelli2018")
    expected = pdr.calibrate([pdr.read(w) for w in walks], config=pdr.recipes.martinelli2018())
    np.testing.assert_array_equal(load_calibration(out).theta, expected.theta)
    worn = write_recording(replace(pdr.read(walks[0]), name="worn", meta={"placement": "foot"}), tmp_path / "worn.zip")
    message = refusal("calibrate", walks[0], worn, "--out", out, "--recipe", "zhou2019")
    assert "one has the sensor on the foot" in message


def test_a_calibration_without_segments_ends_with_one_line_that_says_so(walk: Path, tmp_path: Path) -> None:
    recording = pdr.read(walk)
    bare = replace(recording, truth=replace(recording.truth, segments=None, strides=None, waypoints=None))
    path = write_recording(bare, tmp_path / "bare.zip")
    assert "nothing to calibrate with: short_walk" in refusal("calibrate", path, "--out", tmp_path / "me.json")
    assert not (tmp_path / "me.json").exists()


def test_a_walk_of_known_distance_calibrates_a_person(tmp_path: Path) -> None:
    walk = write_recording(replace(short_walk(), truth=Truth()), tmp_path / "walk.zip")
    result = succeed("calibrate", walk, "--distance", 25, "--steps", 200, "--out", tmp_path / "me.json")
    assert "1 segment, 25 m" in result.stdout
    assert "200 counted" in result.stdout
    calibrated = pdr.track(pdr.read(walk), calibration=tmp_path / "me.json")
    assert calibrated.distance_m == pytest.approx(25, rel=0.06)


def test_the_marks_of_a_walk_calibrate_a_person_by_smoothing(tmp_path: Path) -> None:
    recording = short_walk()
    at = recording.truth.position
    rows = [",".join(str(float(at[name][i])) for name in ("time_s", "east_m", "north_m")) for i in (300, 700, 1100)]
    walk = write_recording(replace(recording, truth=Truth(waypoints=recording.truth.waypoints)), tmp_path / "walk.zip")
    mark(walk, "\n".join(["time_s,east_m,north_m", *rows]), '{"truth_as_fixes": true}')
    succeed("calibrate", walk, "--smooth", "--out", tmp_path / "me.json")
    fixes = read_marks(walk).fixes
    fixes = [*fixes, *waypoint_fixes(pdr.read(walk))]
    expected = pdr.calibrate(pdr.read(walk), smooth=True, fixes=[fixes])
    np.testing.assert_array_equal(load_calibration(tmp_path / "me.json").people, expected.people)


def test_a_walk_is_smoothed_against_its_waypoints_if_asked_and_a_note_says_so(walk: Path, tmp_path: Path) -> None:
    result = succeed("smooth", walk, "--truth-as-fixes", "--out", tmp_path)
    assert "observations" in result.stdout
    assert "step scale" in result.stdout
    assert {p.suffix for p in tmp_path.iterdir()} >= {".csv", ".png"}

    assert "position fixes are ground truth of the recording" in " ".join(result.stdout.split())


def test_smoothing_does_not_use_the_truth_unasked(walk: Path, tmp_path: Path) -> None:
    result = run("smooth", walk, "--out", tmp_path)
    assert "0 observations" in result.stdout
    assert "ground truth" not in result.stdout
    assert_written(pdr.smooth(pdr.read(walk)), tmp_path)


def test_a_height_replaces_that_of_the_recording_and_of_its_marks(tmp_path: Path) -> None:
    path = replace(short_walk(), truth=Truth()).save(tmp_path / "walk.zip")
    mark(path, settings='{"height_m": 1.5}')
    succeed("smooth", path, "--height", "2.0", "--out", tmp_path / "out")
    assert_written(pdr.smooth(pdr.read(path).of_height(2.0)), tmp_path / "out")


def test_a_walk_is_smoothed_against_fixes_of_a_file(walk: Path, tmp_path: Path) -> None:
    points = pdr.read(walk).truth.waypoints
    rows = [f"{p.time_s},{p.east_m},{p.north_m}" for p in points]
    (tmp_path / "fixes.csv").write_text("\n".join(["time_s,east_m,north_m", *rows]) + "\n", encoding="utf-8")
    by_file = succeed("smooth", walk, "--fixes", tmp_path / "fixes.csv", "--fix-std", "0.5")
    assert by_file.stdout == run("smooth", walk, "--truth-as-fixes", "--fix-std", "0.5").stdout
    (tmp_path / "own.csv").write_text("east_m,north_m,std_m,time_s\n0,0,0.5,1\n3,4,2,9\n", encoding="utf-8")
    first, second = fixes_of_file(tmp_path / "own.csv")
    np.testing.assert_array_equal([first.cov_m2[0, 0], second.cov_m2[1, 1]], [0.25, 4.0])
    np.testing.assert_array_equal([*second.position_m, second.time_s], [3.0, 4.0, 9.0])
    with pytest.raises(ValueError, match="std_m must be a positive number, got 0"):
        fixes_of_file(tmp_path / "fixes.csv", 0.0)


@pytest.mark.parametrize("has_locations", [True, False])
@pytest.mark.parametrize(
    ("settings", "options", "expected"),
    [
        ({"origin": [52.0, 13.0]}, "", (52.0, 13.0)),
        ({"origin": [52.0, 13.0]}, "--origin 52.0005,13.0", (52.0005, 13.0)),
        ({"origin": [52.0, 13.0]}, "--plan {plan}", (52.0, 13.0)),
        ({"origin": [52.0, 13.0], "plan": "../hall.geojson", "keep_on_plan": True}, "--origin 52.002,13", (52.002, 13)),
        ({}, "--plan {plan}", (52.001, 13.001)),
        ({}, "--plan {plan} --origin 52.0005,13.0", (52.0005, 13.0)),
        ({}, "", (52.003, 13.0)),
    ],
)
def test_fixes_in_degrees_are_in_the_one_frame_of_origin_marks_or_plan(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    settings: dict[str, Any],
    options: str,
    expected: tuple[float, float],
    has_locations: bool,
) -> None:
    walk = short_walk()
    if has_locations:
        walk = replace(walk, location=pdr.Samples([0.0, 1.0], [[52.003, 13.0, 0.0, 5.0]] * 2))
    path, fixes = walk.save(tmp_path / "walk.zip"), tmp_path / "fixes.csv"
    fixes.write_text("time_s,latitude,longitude\n2,52.0002,13.0001\n")
    corners = [[13.0, 52.0], [13.002, 52.0], [13.002, 52.002], [13.0, 52.002], [13.0, 52.0]]
    hall = {"properties": {"type": "floor"}, "geometry": {"type": "Polygon", "coordinates": [corners]}}
    plan = tmp_path / "hall.geojson"
    plan.write_text(json.dumps({"type": "FeatureCollection", "features": [hall]}))
    mark(path, settings=json.dumps(settings))
    given: dict[str, Any] = {}

    def smooth(_: pdr.Recording, fixes: list[pdr.PositionFix], **arguments: Any) -> None:
        given.update(arguments, fixes=fixes)
        raise ValueError("seen")

    monkeypatch.setattr(pdr, "smooth", smooth)
    said = refusal("smooth", path, "--fixes", fixes, *options.format(plan=plan).split())
    if not (has_locations or settings or options):
        assert "origin of the track is unknown: give --origin LAT,LON" in said
        return
    frames = [given["plan"].origin] if "plan" in given else []
    frames += [pdr.Origin.of(given["origin"])] if "origin" in given else []
    assert frames
    for frame in frames:
        assert (frame.latitude_deg, frame.longitude_deg) == pytest.approx(expected, abs=1e-9)
        np.testing.assert_allclose(given["fixes"][0].position_m, frame.east_north_m(52.0002, 13.0001), atol=1e-6)


def test_fixes_in_degrees_are_not_placed_by_locations_on_a_plan_in_metres(tmp_path: Path) -> None:
    walk = replace(short_walk(), location=pdr.Samples([0.0], [[52.0, 13.0, 0.0, 5.0]]))
    (tmp_path / "fixes.csv").write_text("time_s,latitude,longitude\n2,52.0,13.0\n")
    with pytest.raises(ValueError, match="unknown: give --origin"):
        fixes_of(tmp_path / "fixes.csv", 1.0, walk, {"plan": pdr.FloorPlan("hall", ())})


def test_marks_in_degrees_are_in_metres_from_a_given_origin(tmp_path: Path) -> None:
    path = short_walk().save(tmp_path / "walk.zip")
    mark(path, "time_s,latitude,longitude\n2,52.0002,13.0001\n", '{"origin": [52.0, 13.0]}')
    for origin in (None, (52.0005, 13.0)):
        marks = read_marks(path, origin)
        expected_m = marks.arguments(pdr.read(path))["origin"].east_north_m(52.0002, 13.0001)
        np.testing.assert_allclose(marks.fixes[0].position_m, expected_m, atol=1e-9)
        assert marks.origin == pdr.Origin(*origin or (52.0, 13.0))


def test_a_walk_is_smoothed_with_loop_closures_of_a_file(walk: Path, tmp_path: Path) -> None:
    (tmp_path / "loops.csv").write_text("first_s,second_s\n4.5,23.5\n", encoding="utf-8")
    result = succeed("smooth", walk, "--loop-closures", tmp_path / "loops.csv", "--out", tmp_path)
    assert "1 observations, 0 not used" in result.stdout
    assert_written(pdr.smooth(pdr.read(walk), loop_closures=[LoopClosure(4.5, 23.5)]), tmp_path)
    (tmp_path / "fixes.csv").write_text("time_s,east_m,north_m\n5,5,5\n20,5,12\n", encoding="utf-8")
    both = run("smooth", walk, "--fixes", tmp_path / "fixes.csv", "--loop-closures", tmp_path / "loops.csv")
    assert "3 observations" in both.stdout


def test_a_walk_is_smoothed_against_its_own_locations_where_it_was(tmp_path: Path) -> None:
    walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=60.0)], seed=2, name="located")
    time_s = np.arange(1.0, walk.duration_s, 2.0)
    path = replace(located(walk, time_s, accuracy_m=4.0), truth=Truth()).save(tmp_path / "located.zip")
    succeed("smooth", path, "--out", tmp_path)
    line = json.loads((tmp_path / "located.geojson").read_text())["features"][0]["geometry"]["coordinates"]
    longitude_deg, latitude_deg = np.array(line)[:, :2].T
    assert np.linalg.norm(HERE.east_north_m(latitude_deg, longitude_deg)[-1] - true_m(walk, time_s[-1])) < 4.0


def test_a_calibration_of_a_folder_is_that_of_the_recordings_in_it(tmp_path: Path) -> None:
    folder = tmp_path / "walks"
    walks = [
        write_recording(simulate([Leg("walking", distance_m=25.0)], seed=seed, name=name), folder / f"{name}.zip")
        for seed, name in enumerate("ab")
    ]
    thetas: list[np.ndarray] = []
    for given in ([folder], walks):
        succeed("calibrate", *given, "--out", tmp_path / "me.json")
        thetas.append(load_calibration(tmp_path / "me.json").theta)
    np.testing.assert_array_equal(*thetas)


def test_a_calibration_names_the_files_that_it_replaced_and_no_others(walk: Path, tmp_path: Path) -> None:
    (tmp_path / "me.npz").write_text("of something else")
    first = run("calibrate", walk, "--out", tmp_path / "me.csv")
    assert "replaced" not in first.stderr
    assert (tmp_path / "me.npz").read_text() == "of something else"
    again = run("calibrate", walk, "--out", tmp_path / "me.csv").stderr.replace("\n", "")
    assert f"replaced existing files: {tmp_path / 'me.csv.json'}, {tmp_path / 'me.csv.npz'}" in again


def test_a_calibration_that_learns_nothing_is_not_written(tmp_path: Path) -> None:
    walk, out = write_recording(short_walk(), tmp_path / "walk.zip"), tmp_path / "me.json"
    much_m = 2.6 * pdr.track(pdr.read(walk)).distance_m
    result = run("calibrate", walk, "--distance", much_m, "--out", out)
    assert result.exit_code == 1
    assert "every segment contradicts the detected steps" in one_line(result.stderr)
    assert "WARNING: the step lengths are those of the prior" in result.stdout
    assert not out.exists()
    assert "faster than 12.5 m/s" in refusal("calibrate", walk, "--distance", 100 * much_m, "--out", out)
    assert not out.exists()


@pytest.mark.parametrize(
    ("option", "content", "words"),
    [
        ("--fixes", "time_s,east_m\n1,2\n", "no column 'north_m'"),
        ("--fixes", "time_s,east_m,north_m\n", "no fixes"),
        ("--fixes", "time_s,east_m,north_m\n1,,3\n", "line 2"),
        ("--fixes", "time_s,east_m,north_m,std_m\n1,2,3,0\n4,5,6,-1\n", "line 2: std_m is 0; write a positive number"),
        ("--loop-closures", "first_s,std_m\n1,2\n", "no column 'second_s'"),
        ("--loop-closures", "first_s,second_s\n", "no loop closures"),
        ("--loop-closures", "first_s,second_s\n1,\n", "line 2: first_s,second_s must all be numbers"),
        ("--loop-closures", "first_s,second_s\n1,x\n", "'x' is not a number"),
        ("--loop-closures", "first_s,second_s\n1,9\n9,9\n", "line 3: first_s must be before second_s, got 9 and 9"),
        ("--loop-closures", "first_s,second_s,std_m\n1,9,0\n", "line 2: std_m is 0; write a positive number"),
        ("--loop-closures", "first_s,second_s\n1,900\n", "loop closure 1 at 900.0 s is outside the recording, 0.0 to "),
    ],
)
def test_a_file_of_observations_that_cannot_be_used_is_one_line(
    walk: Path, tmp_path: Path, option: str, content: str, words: str
) -> None:
    (tmp_path / "bad.csv").write_text(content, encoding="utf-8")
    assert words in refusal("smooth", walk, option, tmp_path / "bad.csv")
