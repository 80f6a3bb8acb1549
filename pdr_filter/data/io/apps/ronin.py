"""RoNIN (Herath, Yan, Furukawa 2020): data.hdf5 with its info.json, or the hdf5 file alone.

Layout after the authors' loader (github.com/Sachini/ronin, data_glob_speed.py): `synced/{time, gyro, gyro_uncalib,
acce, magnet, game_rv}` at 200 Hz in seconds, m/s2, rad/s, uT, quaternions wxyz; `pose/tango_pos` is the position from
visual odometry. The group `raw`, with quaternions xyzw, is not read. With info.json, as they do:

    specific force = imu_acce_scale (acce - imu_acce_bias),   angular rate = gyro_uncalib - imu_init_gyro_bias.

Reading needs the package h5py (extra `hdf5`).
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Generator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter.data.io.assemble import Parsed
from pdr_filter.data.io.files.archive import json_object, most_unpacked
from pdr_filter.data.io.text_table import finite
from pdr_filter.values import FloatArray, limits
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording
from pdr_filter.values.safe_files import beside, inside, open_regular, read_small

RATE_HZ = 200.0
SIGNATURE = b"\x89HDF\r\n\x1a\n"
# hdf5 meets damaged bytes in many places, and h5py passes its complaints on as these.
HDF5_ERRORS = (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError, OverflowError, AttributeError)
# Filters written by h5py, each at most once: deflate, shuffle, checksum, lzf.
FILTERS = (1, 2, 3, 32000)
# Data sets and numbers of their columns.
_TIME = ("synced/time", 1)
ARRAYS = {
    "accelerometer": ("synced/acce", 3),
    "gyroscope": ("synced/gyro", 3),
    "raw gyroscope": ("synced/gyro_uncalib", 3),
    "magnetometer": ("synced/magnet", 3),
    "attitude": ("synced/game_rv", 4),
    "position": ("pose/tango_pos", 3),
}


def read_ronin(path: str | Path) -> Recording:
    """Return the recording in an hdf5 file of RoNIN or in its folder; the visual position is `truth.position`.

    The calibration in info.json is applied if it exists. RecordingError if an array is missing or has another shape.
    """
    with open_ronin(Path(path)) as ronin:
        if ronin.n_rows > limits.MAX_ARRAY_ROWS:
            raise RecordingError(
                f"{ronin.file}: synced/time claims {ronin.n_rows} rows, more than {limits.MAX_ARRAY_ROWS}; cut the "
                "recording"
            )
        return ronin.parsed(slice(None)).recording()


@dataclass(frozen=True, slots=True, eq=False)
class RoninFile:
    """Open file with its data sets, which are read when they are used."""

    path: Path
    file: Path
    data_sets: Mapping[str, Any]  # keys are "time" and the names of `ARRAYS` that exist
    n_rows: int

    def parsed(self, rows: slice) -> Parsed:
        """Return the streams of some rows, with the calibration in info.json if it exists."""
        parsed = Parsed(self.path, "RoNIN")
        info = _info(beside(self.file, "info.json"), parsed)
        with _hdf5_errors(self.file):
            arrays = {name: _floats(found, rows, parsed.notes) for name, found in self.data_sets.items()}
        time_s = arrays.pop("time")
        scale, bias = _vector(info, "imu_acce_scale", self.file), _vector(info, "imu_acce_bias", self.file)
        if scale is not None and bias is not None:
            arrays["accelerometer"] = scale * (arrays["accelerometer"] - bias)
            parsed.found.append("accelerometer: scale (acce - bias) with info.json, m/s2")
        else:
            parsed.found.append("accelerometer: acce as recorded, m/s2, no calibration in info.json")
        raw_gyroscope, gyro_bias = arrays.pop("raw gyroscope", None), _vector(info, "imu_init_gyro_bias", self.file)
        if raw_gyroscope is not None and gyro_bias is not None:
            arrays["gyroscope"] = raw_gyroscope - gyro_bias
            parsed.found.append("gyroscope: gyro_uncalib minus the bias of info.json, rad/s")
        elif "gyroscope" in arrays:
            parsed.found.append("gyroscope: gyro as the phone corrected it, rad/s")
        position_m = arrays.pop("position", None)
        if position_m is not None:
            east_m, north_m, up_m = position_m.T
            parsed.truth["position"] = {"time_s": time_s, "east_m": east_m, "north_m": north_m, "up_m": up_m}
            about = "visual odometry of a second phone on the body; its axes turn freely about the vertical"
            parsed.meta["truth"] = about
        parsed.streams = {stream: (time_s, values) for stream, values in arrays.items()}
        parsed.requested_hz = dict.fromkeys(arrays, RATE_HZ)
        parsed.clock = "seconds of the phone (synced/time)"
        return parsed


@contextmanager
def open_ronin(path: Path) -> Generator[RoninFile]:
    """Context manager that opens the file of a recording, or that of its folder, and yields its data sets."""
    file = inside(path / "data.hdf5", path) if path.is_dir() else path
    try:
        import h5py  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise RecordingError(f"{file}: reading hdf5 needs h5py; install pdr_filter[hdf5]") from error
    try:
        open_regular(file).close()
    except OSError as error:
        raise RecordingError(f"{file}: cannot be read ({error.strerror}); check path and permissions") from error
    with ExitStack() as stack:
        with _hdf5_errors(file):
            data: Any = stack.enter_context(h5py.File(file, "r"))
            known = {key: _data_set(data, name, n, file) for key, (name, n) in {"time": _TIME, **ARRAYS}.items()}
            known = {key: found for key, found in known.items() if found is not None}
            groups = ", ".join(map(str, islice(data, 8)))
        if "time" not in known:
            raise RecordingError(f"{file}: no synced/time (found: {groups or 'nothing'}); take data.hdf5 as published")
        n_rows = len(known["time"])
        if "accelerometer" not in known:
            raise RecordingError(f"{file}: no synced/acce, which holds the accelerometer; take data.hdf5 as published")
        for name, found in known.items():
            if len(found) != n_rows:
                raise RecordingError(
                    f"{file}: {len(found)} rows of {name}, but {n_rows} times, as in a damaged file; take data.hdf5 "
                    "as published"
                )
        yield RoninFile(path, file, known, n_rows)


@contextmanager
def _hdf5_errors(file: Path) -> Generator[None]:
    """Context manager that turns errors of damaged files into a RecordingError."""
    try:
        yield
    except RecordingError:
        raise
    except HDF5_ERRORS as error:
        raise RecordingError(f"{file}: no hdf5 file, or a damaged one ({str(error)[:120]}); copy it again") from error


def _data_set(data: Any, name: str, columns: int, file: Path) -> Any:
    """Return a data set (N,) or (N, columns) of an HDF5 file, or None if the file does not have it.

    RecordingError for another shape and for text.
    """
    found: Any = _inside_file(data, name, file)
    if found is None:
        return None
    shape: Any = getattr(found, "shape", None)
    if shape is None or len(shape) != (1 if columns == 1 else 2) or (columns > 1 and shape[1] != columns):
        wanted = "(N,)" if columns == 1 else f"(N, {columns})"
        raise RecordingError(f"{file}: {name} has the shape {shape}; write it as an array of the shape {wanted}")
    if np.dtype(found.dtype).kind not in "fiu":
        raise RecordingError(f"{file}: {name} holds {found.dtype}; write it as numbers")
    _check_storage(found, name, file)
    return found


def _floats(data_set: Any, rows: slice, notes: list[str]) -> FloatArray:
    """Return some rows of a data set as floats."""
    with np.errstate(over="ignore", invalid="ignore"):
        return finite(np.array(data_set[rows], dtype=np.float64), data_set.name[1:], notes)


def _inside_file(data: Any, name: str, file: Path) -> Any:
    """Return the data set of this name, or None. RecordingError for a link, and for values in other files."""
    import h5py  # pyright: ignore[reportMissingImports]

    found = data
    for part in name.split("/"):
        link = found.get(part, getlink=True)
        if link is None:
            return None
        if not isinstance(link, h5py.HardLink):
            raise RecordingError(
                f"{file}: {name} is a link, which may lead to another file; take data.hdf5 as published, or write the "
                "values into one file with h5py"
            )
        found = found[part]
    if getattr(found, "external", None) or getattr(found, "is_virtual", False):
        raise RecordingError(
            f"{file}: {name} is kept in other files; take data.hdf5 as published, or write the values into one file "
            "with h5py"
        )
    return found


def _check_storage(found: Any, name: str, file: Path) -> None:
    """Raise RecordingError for an unknown compression, and for a data set that is much larger than its file."""
    filters: Any = found.id.get_create_plist()
    names = [filters.get_filter(i)[0] for i in range(filters.get_nfilters())]
    if not set(names) <= set(FILTERS) or len(set(names)) < len(names):
        raise RecordingError(f"{file}: {name} is packed with the filters {names}; pack it with gzip (h5repack)")
    claimed = max(math.prod(found.shape) * 8, math.prod(found.chunks or (0,)) * found.dtype.itemsize)
    stored = min(found.id.get_storage_size(), file.stat().st_size)
    if claimed > most_unpacked(stored):
        raise RecordingError(
            f"{file}: {name} claims {claimed} bytes and {stored} are stored, unlike sensor data; write the file again"
        )
    if FILTERS[0] in names:
        _check_chunks(found, name, file)


def _check_chunks(found: Any, name: str, file: Path) -> None:
    """Raise RecordingError for a chunk that unpacks to more than its declared size, which hdf5 does not check."""
    most = math.prod(found.chunks) * found.dtype.itemsize + 4  # a checksum has 4 bytes
    for i in range(found.id.get_num_chunks()):
        mask, piece = found.id.read_direct_chunk(found.id.get_chunk_info(i).chunk_offset)
        if not mask and len(zlib.decompressobj().decompress(piece, most + 1)) > most:
            raise RecordingError(f"{file}: {name} has a piece of more than {most} bytes unpacked; write the file again")


def _info(path: Path, parsed: Parsed) -> dict[str, Any]:
    if not path.is_file():
        parsed.notes.append("no info.json beside the file, so the calibration of the data set is not applied")
        return {}
    info = json_object(read_small(path, limits.MAX_SMALL_BYTES), str(path))
    if isinstance(info.get("device"), str):
        parsed.set_device(info["device"])
    return info


def _vector(info: dict[str, Any], key: str, file: Path) -> FloatArray | None:
    if key not in info:
        return None
    try:
        value = np.asarray(info[key], dtype=np.float64)
        if value.shape != (3,) or not (np.abs(value) < limits.LARGEST_VALUE).all():
            raise ValueError(key)
    except (ValueError, TypeError, OverflowError) as error:
        raise RecordingError(f"{file.parent / 'info.json'}: {key} is not three numbers; correct it") from error
    return value
