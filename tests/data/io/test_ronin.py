"""RoNIN hdf5: calibration of info.json, position, what is missing. Needs h5py, an extra."""

from __future__ import annotations

import builtins
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from app_files import a_walk, assert_same_streams, on_one_clock, refusal, with_level_attitude

from pdr_filter.data.io.describe import reading_report
from pdr_filter.data.io.formats import read

WALK = with_level_attitude(on_one_clock(a_walk(200.0)))
SCALE, BIAS, GYRO_BIAS = np.array([1.01, 0.99, 1.0]), np.array([0.1, -0.2, 0.05]), np.array([0.01, -0.02, 0.03])
INFO = {
    "device": "asus5",
    "imu_acce_scale": SCALE.tolist(),
    "imu_acce_bias": BIAS.tolist(),
    "imu_init_gyro_bias": GYRO_BIAS.tolist(),
}


def arrays() -> dict[str, np.ndarray]:
    """The data sets of a file, so that calibration gives the walk."""
    n = len(WALK.accelerometer)
    return {
        "synced/time": WALK.accelerometer.time_s + 5000.0,
        "synced/acce": WALK.accelerometer.values / SCALE + BIAS,
        "synced/gyro_uncalib": WALK.gyroscope.values + GYRO_BIAS,
        "synced/gyro": WALK.gyroscope.values + 0.5 * GYRO_BIAS,
        "synced/game_rv": WALK.attitude.values,
        "synced/magnet": np.tile([0.0, 20.0, -44.0], (n, 1)),
        "pose/tango_pos": np.column_stack([np.arange(n), 2 * np.arange(n), np.zeros(n)]) / 200,
    }


def folder_with(path: Path, data: dict[str, Any] | None = None, info: dict[str, Any] | None = INFO) -> Path:
    h5py = pytest.importorskip("h5py")
    path.mkdir(exist_ok=True)
    with h5py.File(path / "data.hdf5", "w") as file:
        for name, values in (arrays() if data is None else data).items():
            file.create_dataset(name, data=values)
    if info is not None:
        (path / "info.json").write_text(json.dumps(info))
    return path


@pytest.mark.parametrize("file", ["", "data.hdf5"])
def test_a_walk_comes_back_calibrated(tmp_path: Path, file: str) -> None:
    recording = read(folder_with(tmp_path / "a000_1") / file)
    assert_same_streams(recording, WALK, "accelerometer gyroscope attitude", time_s=1e-9, rtol=1e-9)
    assert recording.meta["device"] == "asus5"
    assert any("scale (acce - bias)" in line for line in reading_report(recording).found)


def test_the_position_is_truth_on_the_same_clock(tmp_path: Path) -> None:
    position = read(folder_with(tmp_path / "a")).truth.position
    assert position.time_s[0] == 0
    np.testing.assert_allclose(position.north_m, 2 * position.east_m)


def test_without_info_the_values_are_as_recorded_with_a_note(tmp_path: Path) -> None:
    recording = read(folder_with(tmp_path / "a", info=None))
    np.testing.assert_allclose(recording.accelerometer.values, arrays()["synced/acce"])
    np.testing.assert_allclose(recording.gyroscope.values, arrays()["synced/gyro"])
    assert any("no info.json" in note for note in recording.notes)


def test_what_is_missing_or_of_another_shape_is_refused(tmp_path: Path) -> None:
    data = arrays()
    pytest.importorskip("h5py")
    assert "cannot be read (No such file" in refusal(tmp_path / "missing.hdf5", "ronin")
    assert "no synced/time" in refusal(folder_with(tmp_path / "a", {"raw/imu/acce": data["synced/acce"]}))
    assert "no synced/acce" in refusal(folder_with(tmp_path / "b", {"synced/time": data["synced/time"]}))
    flat = data | {"synced/acce": data["synced/acce"][:, :2]}
    assert "has the shape" in refusal(folder_with(tmp_path / "c", flat))
    column = data | {"synced/time": data["synced/time"][:, None]}
    assert "write it as an array of the shape (N,)" in refusal(folder_with(tmp_path / "f", column))
    short = data | {"synced/acce": data["synced/acce"][:-5]}
    assert "but" in refusal(folder_with(tmp_path / "d", short))
    text = data | {"synced/acce": np.full((len(data["synced/time"]), 3), b"x")}
    assert "write it as numbers" in refusal(folder_with(tmp_path / "e", text))


def test_a_quaternion_of_the_other_order_is_refused(tmp_path: Path) -> None:
    """Raw RoNIN files hold xyzw: the specific force then points anywhere but up, here down."""
    data = arrays()
    n = len(data["synced/time"])
    data["synced/acce"] = np.tile([0.0, 0.0, 9.81], (n, 1))
    data["synced/game_rv"] = np.tile([0.1, 0.99, 0.0, 0.0], (n, 1))  # xyzw of a turn about y, read as wxyz
    assert "points down" in refusal(folder_with(tmp_path / "a", data, info=None))


@pytest.mark.parametrize("bias", [[1.0, "x", 2.0], [1.0, 2.0], [1.0, 2.0, 1e300], [1.0, 2.0, None], 3.0])
def test_a_calibration_that_is_no_vector_is_refused(tmp_path: Path, bias: Any) -> None:
    assert "imu_acce_bias is not three numbers" in refusal(
        folder_with(tmp_path / "a", info=INFO | {"imu_acce_bias": bias})
    )


def test_without_h5py_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "h5py":
            raise ImportError(name)
        return found(name, *args, **kwargs)

    (tmp_path / "data.hdf5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    monkeypatch.setattr(builtins, "__import__", without)
    assert "install pdr_filter[hdf5]" in refusal(tmp_path / "data.hdf5")
