"""CoreMotion tables: g with Apple's sign, no time column, columns in any order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from app_files import a_walk, assert_same_streams, core_motion_text, on_one_clock, refusal, write_text
from scipy.spatial.transform import Rotation

from pdr_filter.data.io.describe import reading_report
from pdr_filter.data.io.formats import read
from pdr_filter.data.io.tables.table_streams import quaternion_of

WALK = on_one_clock(a_walk(50.0))
TEXT = core_motion_text(WALK)
HEADER = TEXT.split("\n", 1)[0]


def test_a_walk_comes_back(tmp_path: Path) -> None:
    recording = read(write_text(tmp_path / "w.csv", TEXT))
    n = len(WALK.accelerometer)
    np.testing.assert_allclose(recording.accelerometer.values, WALK.accelerometer.values, atol=1e-9)
    np.testing.assert_allclose(recording.accelerometer.time_s, np.arange(n) / 50, rtol=1e-15)
    assert "no time column" in reading_report(recording).clock
    assert reading_report(recording).streams[0].requested_hz == 50


def test_columns_are_found_by_name_whatever_their_order(tmp_path: Path) -> None:
    rows = [line.split(",") for line in TEXT.splitlines()]
    order = np.random.default_rng(0).permutation(len(rows[0]))
    text = "".join(";".join(row[i] for i in order) + "\n" for row in rows)
    recording = read(write_text(tmp_path / "w.csv", text))
    np.testing.assert_allclose(recording.accelerometer.values, WALK.accelerometer.values, atol=1e-9)


def test_a_time_column_is_used_if_there_is_one(tmp_path: Path) -> None:
    times = ["timestamp", *(f"{100 + t:.6f}" for t in WALK.accelerometer.time_s)]
    text = "".join(f"{t},{line}\n" for t, line in zip(times, TEXT.splitlines(), strict=True))
    recording = read(write_text(tmp_path / "w.csv", text))
    assert_same_streams(recording, WALK, "accelerometer gyroscope", time_s=2e-6)


def test_the_quaternion_is_that_of_yaw_pitch_roll_about_z_x_y() -> None:
    angles = np.random.default_rng(1).uniform(-1.4, 1.4, size=(50, 3))
    roll, pitch, yaw = angles.T
    expected = Rotation.from_euler("ZXY", np.column_stack([yaw, pitch, roll])).as_matrix()
    ours = Rotation.from_quat(np.roll(quaternion_of(roll, pitch, yaw), -1, axis=1)).as_matrix()
    np.testing.assert_allclose(ours, expected, atol=1e-12)


def test_gravity_is_where_the_angles_say() -> None:
    """Apple's own relation of gravity and angles: (sin roll cos pitch, -sin pitch, -cos roll cos pitch)."""
    roll, pitch, yaw = np.array([0.4]), np.array([-0.9]), np.array([2.0])
    to_world = Rotation.from_quat(np.roll(quaternion_of(roll, pitch, yaw), -1, axis=1))
    gravity = np.column_stack([np.sin(roll) * np.cos(pitch), -np.sin(pitch), -np.cos(roll) * np.cos(pitch)])
    np.testing.assert_allclose(to_world.apply(gravity), [[0, 0, -1]], atol=1e-12)


def test_gravity_in_mps2_is_refused(tmp_path: Path) -> None:
    row = ["-9.81" if name == "gravity.z" else "0" for name in HEADER.split(",")]
    text = HEADER + "\n" + 60 * (",".join(row) + "\n")
    assert "median |a| is 96.2" in refusal(write_text(tmp_path / "w.csv", text))
