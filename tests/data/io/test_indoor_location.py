"""indoor-location-competition 2.0: types, milliseconds, waypoints in map metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from app_files import T0_MS, a_walk, assert_same_streams, indoor_location_text, refusal, with_level_attitude, write_text

from pdr_filter.data.io.describe import reading_report
from pdr_filter.data.io.formats import read

WALK = with_level_attitude(a_walk())
TEXT = indoor_location_text(WALK, ((0.2, 196.41757, 117.84907), (20.0, 200.0, 118.5)))
ALL = "accelerometer gyroscope magnetometer attitude"


def test_a_walk_comes_back_to_the_millisecond(tmp_path: Path) -> None:
    recording = read(write_text(tmp_path / "w.txt", TEXT))
    assert_same_streams(recording, WALK, ALL, time_s=1.01e-3)
    assert recording.notes == ()
    assert recording.meta["device"] == "SOME Phone"
    assert recording.meta["epoch_ms"] == T0_MS + round(WALK.accelerometer.time_s[0] * 1000)


def test_waypoints_are_map_metres_on_the_floor_of_the_header(tmp_path: Path) -> None:
    waypoints = read(write_text(tmp_path / "w.txt", TEXT)).truth.waypoints
    np.testing.assert_allclose(waypoints.time_s, np.array([0.2, 20.0]) - WALK.accelerometer.time_s[0], atol=1e-3)
    np.testing.assert_array_equal(waypoints.east_m, [196.41757, 200.0])
    np.testing.assert_array_equal(waypoints.north_m, [117.84907, 118.5])
    np.testing.assert_array_equal(waypoints.floor, [1, 1])


@pytest.mark.parametrize(("name", "floor"), [("F1", 0), ("1F", 0), ("B1", -1), ("L7", np.nan), ("", np.nan)])
def test_floor_names_are_storeys_or_unknown(tmp_path: Path, name: str, floor: float) -> None:
    waypoints = read(write_text(tmp_path / "w.txt", TEXT.replace("FloorName:F2", f"FloorName:{name}"))).truth.waypoints
    np.testing.assert_array_equal(waypoints.floor, [floor, floor])


def test_uncalibrated_values_and_unknown_types_are_ignored(tmp_path: Path) -> None:
    assert "TYPE_ACCELEROMETER_UNCALIBRATED\t99.0" in TEXT
    extra = f"{T0_MS + 5}\tTYPE_SOMETHING_NEW\tx\ty\n{T0_MS}\n\t\n"
    recording = read(write_text(tmp_path / "w.txt", TEXT + "\n" + extra))
    assert_same_streams(recording, WALK, ALL, time_s=1.01e-3)
    assert any("lines of other types ignored" in line for line in reading_report(recording).found)


def test_a_byte_order_mark_changes_nothing(tmp_path: Path) -> None:
    plain, marked = (read(write_text(tmp_path / "w.txt", mark + TEXT)) for mark in ("", "\ufeff"))
    assert marked.meta == plain.meta
    assert_same_streams(marked, WALK, ALL, time_s=1.01e-3)


def test_a_walk_without_accelerometer_is_refused(tmp_path: Path) -> None:
    text = "".join(line for line in TEXT.splitlines(keepends=True) if "\tTYPE_ACCELEROMETER\t" not in line)
    assert "no TYPE_ACCELEROMETER lines" in refusal(write_text(tmp_path / "w.txt", text))


def test_a_time_that_is_no_whole_number_is_refused(tmp_path: Path) -> None:
    assert "time 'now' is neither a number up to 9.2e+18 nor a known date" in refusal(
        write_text(tmp_path / "w.txt", f"now\tTYPE_ACCELEROMETER\t0\t0\t9.8\t3\n{TEXT}")
    )


def test_a_last_line_that_is_whole_needs_no_line_feed(tmp_path: Path) -> None:
    last = f"\n{T0_MS + 23_500}\tTYPE_WAYPOINT\t1.5\t2.5"
    waypoints = read(write_text(tmp_path / "w.txt", TEXT + last)).truth.waypoints
    assert len(waypoints) == 3
    assert waypoints.north_m[2] == 2.5
