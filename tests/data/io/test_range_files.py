"""Ranges and anchors from files, and on the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import pdr_filter as pdr
from pdr_filter.apps.cli.app import app
from pdr_filter.apps.cli.options import fixes_of, ranges_of
from pdr_filter.data.io.fix_files import anchors_of_file, fixes_of_file, ranges_of_file
from pdr_filter.values.uncertainty import RADIUS_68

ANCHORS = {"door": (-8.0, -6.0), "window": (45.0, -5.0, 1.5), "stairs": (5.0, 50.0)}


def anchors_file(path: Path, places: dict[str, tuple[float, ...]]) -> Path:
    features = [
        {"type": "Feature", "properties": {"name": n}, "geometry": {"type": "Point", "coordinates": list(place)}}
        for n, place in places.items()
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}), encoding="utf-8")
    return path


def ranges_file(path: Path, recording: pdr.Recording) -> Path:
    truth, rows = recording.truth.position, ["anchor,time_s,range_m"]
    for time_s in np.arange(6.0, 100.0, 2.0):
        here_m = np.array([np.interp(time_s, truth.time_s, column) for column in (truth.east_m, truth.north_m)])
        for name, place in ANCHORS.items():
            away_m = np.append(here_m - place[:2], place[2:])
            rows.append(f"{name},{time_s},{np.linalg.norm(away_m):.3f}")
    path.write_text("\n".join(rows), encoding="utf-8")
    return path


def test_a_last_row_without_its_optional_cells_is_a_fix(tmp_path: Path) -> None:
    (tmp_path / "fixes.csv").write_text("time_s,east_m,north_m,floor\n1,2,3,0\n5,6,7", encoding="utf-8")
    assert [fix.floor for fix in fixes_of_file(tmp_path / "fixes.csv")] == [0, None]


def test_ranges_of_a_file_are_to_the_anchors_that_it_names(tmp_path: Path) -> None:
    anchors = anchors_file(tmp_path / "anchors.geojson", ANCHORS)
    (tmp_path / "ranges.csv").write_text("time_s,anchor,range_m,std_m\n1.5,window,7.25,0.2\n2.5,door,3,0.4\n")
    first, second = ranges_of_file(tmp_path / "ranges.csv", anchors)
    assert (first.time_s, first.range_m, first.std_m, first.up_m) == (1.5, 7.25, 0.2, 1.5)
    np.testing.assert_array_equal(second.anchor_m, ANCHORS["door"])
    (tmp_path / "own.csv").write_text("time_s,anchor_east_m,anchor_north_m,range_m\n1,3,4,5\n")
    (only,) = ranges_of_file(tmp_path / "own.csv", std_m=0.7)
    np.testing.assert_array_equal([*only.anchor_m, only.range_m, only.std_m], [3.0, 4.0, 5.0, 0.7])


def test_named_anchors_without_their_file_are_refused_with_the_option_that_is_missing(tmp_path: Path) -> None:
    (tmp_path / "ranges.csv").write_text("time_s,anchor,range_m\n1.5,window,7.25\n")
    with pytest.raises(ValueError, match=r"ranges.csv: .* give the file of the anchors, --anchors"):
        ranges_of_file(tmp_path / "ranges.csv")


@pytest.mark.parametrize("end", ["", "\n"])
def test_a_last_line_that_is_cut_off_is_refused_with_its_number(tmp_path: Path, end: str) -> None:
    anchors = anchors_file(tmp_path / "anchors.geojson", ANCHORS)
    (tmp_path / "ranges.csv").write_text(f"time_s,anchor,range_m\n1.5,window,7.25\n2.5,do{end}")
    with pytest.raises(ValueError, match=r"line 3: time_s,range_m must all be numbers"):
        ranges_of_file(tmp_path / "ranges.csv", anchors)


@pytest.mark.parametrize("row", ["5,6,7", "5,6,7,", "5,6,7\n", "5,6,7,\n"])
def test_a_fix_without_its_standard_deviation_has_the_given_one(tmp_path: Path, row: str) -> None:
    (tmp_path / "fixes.csv").write_text(f"time_s,east_m,north_m,std_m\n1,2,3,0.5\n{row}", encoding="utf-8")
    stds_m = [np.sqrt(fix.cov_m2[0, 0]) for fix in fixes_of_file(tmp_path / "fixes.csv", 4.0)]
    np.testing.assert_allclose(stds_m, [0.5, 4.0])


@pytest.mark.parametrize("names", ["latitude_deg,longitude_deg", "lat,lon", "Latitude,Longitude (deg)"])
def test_fixes_in_degrees_are_metres_from_the_origin(tmp_path: Path, names: str) -> None:
    path = tmp_path / "fixes.csv"
    path.write_text(f"time_s,{names},std_m\n5,10.0001,20,2\n9,10,19.9999,2\n", encoding="utf-8")
    origin = pdr.Origin(10.0, 20.0)
    first, second = fixes_of_file(path, origin=origin)
    np.testing.assert_allclose(first.position_m, origin.east_north_m(10.0001, 20.0), atol=1e-9)
    np.testing.assert_allclose(second.position_m, origin.east_north_m(10.0, 19.9999), atol=1e-9)
    with pytest.raises(ValueError, match=r"positions are in degrees.*: origin=\(10\.000100, 20\.000000\)"):
        fixes_of_file(path)
    path.write_text(f"time_s,{names}\n\n5,100,20\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"fixes\.csv, line 3: position must be \(latitude, longitude\)"):
        fixes_of_file(path, origin=origin)


@pytest.mark.parametrize(
    ("names", "cell", "std_m"),
    [
        ("horizontal_accuracy_m", "25", 25.0 / RADIUS_68),
        ("speed_accuracy,vertical_accuracy,accuracy", "1,2,25", 25.0 / RADIUS_68),
        ("accuracy", "", 1.0),
        ("accuracy", "-1", 1.0),
        ("accuracy,std_m", "25,3", 3.0),
    ],
)
@pytest.mark.parametrize("place", ["latitude,longitude", "east_m,north_m"])
def test_an_accuracy_is_the_radius_of_68_percent_of_a_fix(
    tmp_path: Path, place: str, names: str, cell: str, std_m: float
) -> None:
    (tmp_path / "fixes.csv").write_text(f"time_s,{place},{names}\n1.5,10,20,{cell}\n")
    (fix,) = fixes_of_file(tmp_path / "fixes.csv", origin=(10.0, 20.0))
    np.testing.assert_allclose(fix.cov_m2, std_m**2 * np.eye(2))


def test_exchanged_latitude_and_longitude_of_a_fix_are_refused_with_the_row(tmp_path: Path) -> None:
    path = tmp_path / "fixes.csv"
    path.write_text("time_s,latitude,longitude\n1.0,48.1372,11.5751\n2.0,11.5751,48.1372\n")
    with pytest.raises(ValueError, match=r"line 3: .* is 4,\d00 km from the origin.*longitude are exchanged; exchange"):
        fixes_of_file(path, origin=(48.1372, 11.5751))


def test_anchors_on_both_sides_of_180_degrees_are_near_each_other(tmp_path: Path) -> None:
    path = anchors_file(tmp_path / "a.geojson", {"a": (179.9999, -16.8), "b": (-179.9999, -16.8)})
    found = anchors_of_file(path, origin=(-16.8, 179.9999))
    np.testing.assert_allclose([found["a"], found["b"]], [[0.0, 0.0], [21.32, 0.0]], atol=0.05)
    one = anchors_file(tmp_path / "one.geojson", {"a": (179.9999, -16.8)})
    np.testing.assert_allclose(anchors_of_file(one, origin=(-16.8, -179.9999))["a"], [-21.32, 0.0], atol=0.05)
    in_metres = anchors_file(tmp_path / "metres.geojson", {"a": (-180.0, 0.0), "b": (180.0, 0.0)})
    for origin in (None, (48.0, 11.0)):
        np.testing.assert_array_equal(anchors_of_file(in_metres, origin=origin)["a"], [-180.0, 0.0])


def test_the_command_line_places_fixes_in_degrees_by_an_origin_or_the_first_location(tmp_path: Path) -> None:
    (tmp_path / "fixes.csv").write_text("time_s,latitude_deg,longitude_deg\n5,10.0001,20\n")
    walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=5.0)])
    located = replace(walk, location=pdr.Samples([0.0, 1.0], [[10.0, 20.0, 0.0, 5.0]] * 2))
    given: tuple[dict[str, Any], ...] = ({"origin": (10.0, 20.0)}, {}, {"gnss": "filter"})
    for recording, where in zip((walk, located, located), given, strict=True):
        (fix,) = fixes_of(tmp_path / "fixes.csv", 2.0, recording, where)
        np.testing.assert_allclose(fix.position_m, [0.0, 11.06], atol=0.01)
        assert (where.get("origin") is None) == (where.get("gnss") == "filter")  # its origin is the first location
    with pytest.raises(ValueError, match=r"positions are in degrees.*: give --origin LAT,LON, such") as refused:
        fixes_of(tmp_path / "fixes.csv", 2.0, walk, {})
    assert "Python" not in str(refused.value)


def test_anchors_in_degrees_become_metres_from_the_origin(tmp_path: Path) -> None:
    path = anchors_file(tmp_path / "a.geojson", {"a": (-0.0015, 51.4779), "b": (-0.0015, 51.4781)})
    found = anchors_of_file(path, origin=(51.4779, -0.0015))
    np.testing.assert_allclose([found["a"], found["b"]], [[0.0, 0.0], [0.0, 22.25]], atol=0.05)
    with pytest.raises(ValueError, match="--origin LAT,LON"):
        anchors_of_file(path)
    (tmp_path / "ranges.csv").write_text("time_s,anchor,range_m\n1.5,b,7.25\n")
    plan = pdr.FloorPlan("hall", (), pdr.Origin(51.4779, -0.0015))
    (measured,) = ranges_of(tmp_path / "ranges.csv", path, {"plan": plan})
    np.testing.assert_array_equal(measured.anchor_m, found["b"])


def test_one_anchor_is_in_degrees_if_it_is_near_the_origin(tmp_path: Path) -> None:
    path = anchors_file(tmp_path / "a.geojson", {"a": (-0.0015, 51.4781)})
    np.testing.assert_allclose(anchors_of_file(path, origin=(51.4779, -0.0015))["a"], [0.0, 22.25], atol=0.05)
    for origin in (None, (50.0, 8.0)):  # else nothing tells it from a place in metres
        np.testing.assert_array_equal(anchors_of_file(path, origin=origin)["a"], [-0.0015, 51.4781])


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("time_s,range_m,anchor\n1,3,door\n2,3\n", "line 3: .*no anchor ''"),
        ("time_s,range_m,anchor\n1,3,door\n\n2,3,roof\n", "line 4: .*no anchor 'roof'"),
        ("time_s,anchor,range_m\n1,door,3\n2,door\n", "line 3: time_s,range_m must all be numbers"),
        ("time_s,anchor,range_m\n1,roof,3\n", "line 2: .*no anchor 'roof' .*door"),
        ("time_s,range_m\n1,3\n", "no column anchor"),
        ("time_s,anchor,range_m\n1,door,-3\n", "line 2: range_m must be a distance"),
        ("time_s,anchor,range_m\n1,door,x\n", "x"),
        ("time_s,anchor,range_m\n", "no ranges"),
        ("", "no column 'time_s'"),
    ],
)
def test_a_table_of_ranges_that_cannot_be_used_is_refused_with_its_row(
    table: str, message: str, tmp_path: Path
) -> None:
    anchors = anchors_file(tmp_path / "anchors.geojson", ANCHORS)
    (tmp_path / "ranges.csv").write_text(table)
    with pytest.raises(ValueError, match=message):
        ranges_of_file(tmp_path / "ranges.csv", anchors)


@pytest.mark.parametrize("content", ["[]", "{}", '{"features": []}', '{"features": [{"properties": {}}]}', "x"])
def test_anchors_that_cannot_be_read_are_refused(content: str, tmp_path: Path) -> None:
    (tmp_path / "a.geojson").write_text(content)
    with pytest.raises(ValueError, match=r"a\.geojson"):
        anchors_of_file(tmp_path / "a.geojson")


@pytest.mark.parametrize("command", ["track", "smooth"])
def test_a_command_takes_ranges_and_anchors(command: str, tmp_path: Path) -> None:
    walk = pdr.simulate.demo_walk()
    walk.save(tmp_path / "walk.zip")
    ranges, anchors = ranges_file(tmp_path / "r.csv", walk), anchors_file(tmp_path / "a.geojson", ANCHORS)
    options = ["--online", "--json"] if command == "track" else []
    asked = [command, str(tmp_path / "walk.zip"), "--ranges", str(ranges), "--anchors", str(anchors), *options]
    done = CliRunner().invoke(app, asked)
    assert done.exit_code == 0, done.output
    if command == "track":
        result, truth = json.loads(done.stdout), walk.truth.position
        off_m = np.hypot(result["end_east_m"] - truth.east_m[-1], result["end_north_m"] - truth.north_m[-1])
        assert off_m < 6.0  # of a walk whose last 14 s are without ranges
    else:
        assert "141 observations" in done.stdout
    alone = CliRunner().invoke(app, [command, str(tmp_path / "walk.zip"), "--anchors", str(anchors)])
    assert alone.exit_code == 2 and "without --ranges" in " ".join(alone.output.split())
