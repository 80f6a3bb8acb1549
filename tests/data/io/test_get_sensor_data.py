"""GetSensorData and IPIN logs: two clocks, reference positions on the app's, g under a header of m/s2."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pymap3d
import pytest
from app_files import (
    a_walk,
    assert_same_streams,
    get_sensor_data_text,
    refusal,
    with_level_attitude,
    write_text,
    write_zip,
)

from pdr_filter.data.io.apps.get_sensor_data import rotation_vector_quaternion
from pdr_filter.data.io.describe import reading_report
from pdr_filter.data.io.formats import read
from pdr_filter.values import STANDARD_GRAVITY_MPS2
from pdr_filter.values.recording import Recording

WALK = with_level_attitude(a_walk())
TEXT = get_sensor_data_text(WALK, positions=((1.0, 40.3130, -3.4833, 0.0), (20.0, 40.3131, -3.4830, 1.0)))
ALL = "accelerometer gyroscope magnetometer attitude"


def log(path: Path, text: str) -> Path:
    return write_text(path, text, "latin-1")


def read_log(folder: Path, text: str = TEXT) -> Recording:
    return read(log(folder / "w.txt", text))


def test_a_walk_comes_back_with_the_intervals_of_the_sensors_clock(tmp_path: Path) -> None:
    recording = read_log(tmp_path)
    assert_same_streams(recording, WALK, ALL, time_s=2e-6)  # the app's times jitter by 8 ms
    assert reading_report(recording).source == "GetSensorData, Version 2.1 January 2018"
    assert recording.meta["device"] == "Some Phone"


def test_a_zip_with_the_one_log_reads_like_the_log(tmp_path: Path) -> None:
    recording = read(write_zip(tmp_path / "w.zip", {"logs/w.txt": TEXT.encode("latin-1")}))
    assert_same_streams(recording, WALK, ALL, time_s=2e-6)


def test_reference_positions_are_on_the_apps_clock(tmp_path: Path) -> None:
    for boot_s in (0.0, 81_234.5):  # whatever the sensor's clock says
        text = get_sensor_data_text(WALK, boot_s=boot_s, positions=((1.0, 40.0, -3.0, 0.0), (20.0, 40.001, -3.0, 2.0)))
        waypoints = read(log(tmp_path / f"{boot_s}.txt", text)).truth.waypoints
        # zero is the first sample on the app's clock, which is late by 4 ms in the median
        np.testing.assert_allclose(waypoints.time_s, np.array([1.0, 20.0]) - WALK.accelerometer.time_s[0], atol=0.006)
        np.testing.assert_array_equal(waypoints.floor, [0, 2])


def test_reference_positions_are_metres_from_the_first(tmp_path: Path) -> None:
    recording = read_log(tmp_path)
    waypoints = recording.truth.waypoints
    assert (waypoints.east_m[0], waypoints.north_m[0]) == (0, 0)
    back = pymap3d.enu2geodetic(waypoints.east_m[1], waypoints.north_m[1], 0, 40.3130, -3.4833, 0)
    np.testing.assert_allclose(back[:2], (40.3131, -3.4830), atol=1e-8)
    assert recording.meta["origin"] == {"latitude_deg": 40.3130, "longitude_deg": -3.4833}


def test_positions_that_are_no_degrees_are_left_out_with_a_note(tmp_path: Path) -> None:
    recording = read_log(tmp_path, TEXT + "POSI;21.0;3;4468180.2;438302.1;0;1\n")
    assert len(recording.truth.waypoints) == 2
    assert any("no latitude and longitude" in note for note in recording.notes)


def test_a_log_that_declares_mps2_and_holds_g_is_refused_with_the_remedy(tmp_path: Path) -> None:
    text = get_sensor_data_text(WALK, scale=1 / STANDARD_GRAVITY_MPS2)
    path = log(tmp_path / "w.txt", text)
    message = refusal(path)
    assert "should be in m/s^2" in message
    assert 'accelerometer_unit = "g" into w.toml' in message
    (tmp_path / "w.toml").write_text('accelerometer_unit = "g"\n')
    recording = read(path)
    assert_same_streams(recording, WALK, "accelerometer", time_s=2e-6)
    assert any("although the log declares" in line for line in reading_report(recording).found)


def test_saying_g_of_a_log_in_mps2_is_refused(tmp_path: Path) -> None:
    (tmp_path / "w.toml").write_text('accelerometer_unit = "g"\n')
    assert "median |a| is" in refusal(log(tmp_path / "w.txt", TEXT))


@pytest.mark.parametrize("text", ['accelerometer_unit = "furlong"', "accelerometer_unit ="])
def test_nonsense_beside_the_log_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "w.toml").write_text(text)
    assert "w.toml" in refusal(log(tmp_path / "w.txt", TEXT))


def with_sensor_time(tag: str, change: Callable[[float], float]) -> str:
    """The log with the sensor's time of one type changed."""
    lines = [line.split(";") for line in TEXT.splitlines()]
    return "".join(
        ";".join([*line[:2], repr(change(float(line[2]))), *line[3:]] if line[0] == tag else line) + "\n"
        for line in lines
    )


def test_a_sensor_clock_that_stands_still_gives_way_to_the_apps_with_a_note(tmp_path: Path) -> None:
    recording = read_log(tmp_path, with_sensor_time("ACCE", lambda _: 0.0))
    assert any("ACCE: the sensor's time stands still" in note for note in recording.notes)
    assert len(recording.accelerometer) == len(WALK.accelerometer)


def test_clocks_that_run_at_different_rates_are_refused(tmp_path: Path) -> None:
    assert "1000 times as fast" in refusal(log(tmp_path / "w.txt", with_sensor_time("ACCE", lambda t: 1e3 * t)))


def test_a_sensor_on_another_clock_is_moved_by_its_own_offset(tmp_path: Path) -> None:
    recording = read_log(tmp_path, with_sensor_time("GYRO", lambda t: t + 5000))
    assert_same_streams(recording, WALK, "gyroscope", time_s=0.004)


def test_other_types_and_comments_are_ignored(tmp_path: Path) -> None:
    extra = "NEWT;0.1;0.2;x;y\n% a comment\nACCELERATION;0.1;0.2;1;2;3\n\n"
    assert_same_streams(read(log(tmp_path / "w.txt", TEXT + extra)), WALK, ALL, time_s=2e-6)


def test_a_last_line_that_is_cut_off_is_left_out(tmp_path: Path) -> None:
    recording = read_log(tmp_path, TEXT + "ACCE;23.4;81257.9;1.2")
    assert len(recording.accelerometer) == len(WALK.accelerometer)
    assert any("cut off" in note for note in recording.notes)


@pytest.mark.parametrize("last", ["POSI;21.0;3;40.3132;-3.483;0;20", "ACCE;23.5;81258.0;0.1;0.2;9.8;3"])
def test_a_last_line_that_is_whole_needs_no_line_feed(tmp_path: Path, last: str) -> None:
    ended, unended = read(log(tmp_path / "a.txt", TEXT + last + "\n")), read(log(tmp_path / "b.txt", TEXT + last))
    np.testing.assert_array_equal(unended.accelerometer.values, ended.accelerometer.values)
    np.testing.assert_array_equal(unended.truth.waypoints.north_m, ended.truth.waypoints.north_m)
    assert unended.notes == ()


def test_a_line_with_too_few_fields_is_refused_with_its_type(tmp_path: Path) -> None:
    assert "ACCE lines" in refusal(log(tmp_path / "w.txt", TEXT + "ACCE;23.4;81257.9\nWIFI;1;2\n"))


def test_a_log_without_accelerometer_is_refused(tmp_path: Path) -> None:
    text = "".join(line for line in TEXT.splitlines(keepends=True) if not line.startswith("ACCE"))
    assert "no ACCE lines" in refusal(log(tmp_path / "w.txt", text))


def test_a_log_of_one_clock_is_refused_because_its_columns_stand_elsewhere(tmp_path: Path) -> None:
    text = TEXT.replace("'ACCE;AppTimestamp(s);SensorTimestamp(s);", "'ACCE;AppTimestamp(s);")
    assert "no SensorTimestamp" in refusal(log(tmp_path / "w.txt", text))


def test_a_rotation_vector_of_half_a_turn_has_no_scalar_part() -> None:
    vectors = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, math.sin(0.3)], [2.0, 0.0, 0.0]])
    expected = [[1, 0, 0, 0], [0, 1, 0, 0], [math.cos(0.3), 0, 0, math.sin(0.3)], [math.nan] * 4]
    np.testing.assert_allclose(rotation_vector_quaternion(vectors), expected, atol=1e-12)
