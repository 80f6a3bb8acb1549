"""RoNIN (Herath, Yan, Furukawa 2020): data.hdf5 with info.json beside it, or the hdf5 file alone.

Layout after the authors' loader (github.com/Sachini/ronin, data_glob_speed.py): `synced/{time, gyro, gyro_uncalib,
acce, magnet, game_rv}` at 200 Hz in seconds, m/s2, rad/s, uT, quaternions wxyz; `pose/tango_pos` is the position from
visual odometry. With info.json, as they do:

    specific force = imu_acce_scale (acce - imu_acce_bias),   angular rate = gyro_uncalib - imu_init_gyro_bias.

Reading needs the package h5py (extra `hdf5`).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, cast

import numpy as np

from pdr_filter.io.assemble import Parsed
from pdr_filter.io.checks import LARGEST_VALUE, finite
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.recording import Recording
from pdr_filter.values.arrays import FloatArray

RATE_HZ = 200.0
SIGNATURE = b"\x89HDF\r\n\x1a\n"
# A day at 200 Hz; more is a mistake or an attack, and would be read into memory at once.
MAX_ROWS = 24 * 3600 * 200
MAX_INFO_BYTES = 10_000_000
STREAMS = {"magnetometer": ("synced/magnet", 3), "attitude": ("synced/game_rv", 4)}


def read_ronin(path: str | Path) -> Recording:
    """Return the recording in an hdf5 file of RoNIN or in its folder; the visual position is `truth.position`.

    Raises
    ------
    RecordingError
        If a data set is missing or has another shape, or h5py is not installed.
    """
    path = Path(path)
    try:
        import h5py  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise RecordingError(f"{path}: reading hdf5 needs h5py; install pdr_filter[hdf5]") from error
    file = path / "data.hdf5" if path.is_dir() else path
    parsed = Parsed(path, "RoNIN")
    info = _info(file.parent / "info.json", parsed)
    try:
        with h5py.File(file, "r") as opened:
            data: Any = opened
            time_s = _array(data, "synced/time", 1, file, parsed.notes)
            if time_s is None:
                groups = ", ".join(map(str, list(data)[:8]))
                raise RecordingError(f"{file}: no synced/time (found: {groups or 'nothing'}); raw files are not read")
            force = _array(data, "synced/acce", 3, file, parsed.notes)
            rate = _array(data, "synced/gyro", 3, file, parsed.notes)
            raw_rate = _array(data, "synced/gyro_uncalib", 3, file, parsed.notes)
            others = {stream: _array(data, name, n, file, parsed.notes) for stream, (name, n) in STREAMS.items()}
            position_m = _array(data, "pose/tango_pos", 3, file, parsed.notes)
    except RecordingError:
        raise
    # hdf5 meets damaged bytes in many places, and h5py passes its complaints on as these
    except (
        OSError,
        RuntimeError,
        KeyError,
        ValueError,
        TypeError,
        MemoryError,
        OverflowError,
        AttributeError,
    ) as error:
        raise RecordingError(f"{file}: a damaged hdf5 file ({str(error)[:120]}); copy it again") from error
    if force is None:
        raise RecordingError(f"{file}: no synced/acce; this file cannot be used")
    scale, bias = _vector(info, "imu_acce_scale", file), _vector(info, "imu_acce_bias", file)
    if scale is not None and bias is not None:
        force = scale * (force - bias)
        parsed.found.append("accelerometer: scale (acce - bias) with info.json, m/s2")
    else:
        parsed.found.append("accelerometer: acce as recorded, m/s2, no calibration in info.json")
    gyro_bias = _vector(info, "imu_init_gyro_bias", file)
    if raw_rate is not None and gyro_bias is not None:
        rate = raw_rate - gyro_bias
        parsed.found.append("gyroscope: gyro_uncalib minus the bias of info.json, rad/s")
    elif rate is not None:
        parsed.found.append("gyroscope: gyro as the phone corrected it, rad/s")
    for stream, values in {"accelerometer": force, "gyroscope": rate, **others}.items():
        if values is not None:
            if len(values) != len(time_s):
                raise RecordingError(f"{file}: {len(values)} rows of {stream}, but {len(time_s)} times; take it whole")
            parsed.streams[stream] = (time_s, values)
            parsed.requested_hz[stream] = RATE_HZ
    if position_m is not None:
        if len(position_m) != len(time_s):
            raise RecordingError(f"{file}: {len(position_m)} positions, but {len(time_s)} times; take it whole")
        east_m, north_m, up_m = position_m.T
        parsed.truth["position"] = {"time_s": time_s, "east_m": east_m, "north_m": north_m, "up_m": up_m}
        parsed.meta["truth"] = "visual odometry of a second phone on the body; its axes turn freely about the vertical"
    parsed.clock = "seconds of the phone (synced/time)"
    return parsed.recording()


def _array(data: Any, name: str, columns: int, file: Path, notes: list[str]) -> FloatArray | None:
    """A data set as floats, (N,) or (N, columns); None if it is not there."""
    if name not in data:
        return None
    found: Any = data[name]
    shape: Any = getattr(found, "shape", None)
    if shape is None or len(shape) != (1 if columns == 1 else 2) or (columns > 1 and shape[1] != columns):
        raise RecordingError(f"{file}: {name} has the shape {shape}, expected (N, {columns})")
    if shape[0] > MAX_ROWS:
        raise RecordingError(f"{file}: {name} claims {shape[0]} rows, more than {MAX_ROWS}; cut the recording")
    if np.dtype(found.dtype).kind not in "fiu":
        raise RecordingError(f"{file}: {name} holds {found.dtype}, no numbers")
    with np.errstate(over="ignore", invalid="ignore"):
        return finite(np.array(found[()], dtype=np.float64), name, notes)


def _info(path: Path, parsed: Parsed) -> dict[str, Any]:
    if not path.is_file():
        parsed.notes.append("no info.json beside the file, so the calibration of the data set is not applied")
        return {}
    try:
        if path.stat().st_size > MAX_INFO_BYTES:
            raise ValueError("too long")
        value: Any = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError) as error:
        raise RecordingError(f"{path}: not JSON ({error}); correct it or leave it out") from error
    if not isinstance(value, dict):
        raise RecordingError(f"{path}: must be one object in braces")
    info = cast("dict[str, Any]", value)
    if isinstance(info.get("device"), str):
        parsed.meta["device"] = info["device"][:200]
    return info


def _vector(info: dict[str, Any], key: str, file: Path) -> FloatArray | None:
    if key not in info:
        return None
    try:
        value = np.asarray(info[key], dtype=np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise RecordingError(f"{file.parent / 'info.json'}: {key} is not three numbers") from error
    if value.shape != (3,) or not (np.abs(value) < LARGEST_VALUE).all():
        raise RecordingError(f"{file.parent / 'info.json'}: {key} is not three numbers")
    return value
