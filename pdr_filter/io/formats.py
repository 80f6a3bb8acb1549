"""The formats that are known, and which one a path holds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path, PurePosixPath

from pdr_filter.io import core_motion, get_sensor_data, indoor_location, limits, phyphox, sensor_logger
from pdr_filter.io.archive import Members, open_members
from pdr_filter.io.core_motion import read_core_motion
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.generic_csv import mapping_beside, read_generic_csv
from pdr_filter.io.get_sensor_data import read_get_sensor_data
from pdr_filter.io.indoor_location import read_indoor_location
from pdr_filter.io.own_format import read_recording
from pdr_filter.io.phyphox import read_phyphox
from pdr_filter.io.recording import Recording
from pdr_filter.io.ronin import SIGNATURE, read_ronin
from pdr_filter.io.sensor_logger import read_sensor_logger
from pdr_filter.io.table import SEPARATORS

FORMATS: dict[str, Callable[[Path], Recording]] = {
    "own": read_recording,
    "sensor_logger": read_sensor_logger,
    "phyphox": read_phyphox,
    "get_sensor_data": read_get_sensor_data,
    "indoor_location": read_indoor_location,
    "core_motion": read_core_motion,
    "ronin": read_ronin,
    "generic_csv": read_generic_csv,
}


def detect(path: Path) -> str:
    """The format of a file or folder, by its content; the project's own if nothing else fits, which then explains."""
    if not path.exists():
        return "own"
    with open_members(path) as members:
        return _detect_among(members) if members.is_container else _detect_alone(members)


def _detect_among(members: Members) -> str:
    """The format of a zip or a folder."""
    by_name = {PurePosixPath(name).name: name for name in members.names}
    if "accelerometer.csv" in by_name:
        found = _detect_file(members, by_name["accelerometer.csv"])  # an experiment of phyphox may be called so, too
        return found if found in ("phyphox", "sensor_logger") else "own"
    if "data.hdf5" in by_name and members.path.is_dir():
        return "ronin"
    texts = [name for name in members.names if name.lower().endswith((".csv", ".txt", ".log", ".json"))]
    return next(filter(None, (_detect_file(members, name) for name in texts[: limits.MAX_FILES_LOOKED_AT])), "own")


def _detect_alone(members: Members) -> str:
    """The format of one file."""
    path, name = members.path, members.names[0]
    if name == "accelerometer.csv":
        return "own"  # which asks for the folder
    found = _detect_file(members, name)
    if mapping_beside(path).is_file() and mapping_beside(path) != path:
        return found if found in ("get_sensor_data", "ronin") else "generic_csv"
    head = members.head(name)
    if found == "sensor_logger" and head.lstrip()[:1] != b"[":
        raise RecordingError(
            f"{path}: one sensor of a Sensor Logger recording; give the folder or zip that also holds the others and "
            "Metadata.csv"
        )
    if not found and head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise RecordingError(f"{path}: UTF-16 text; save it as UTF-8")
    return found or ("generic_csv" if _is_table(head) else "own")


def _detect_file(members: Members, name: str) -> str:
    """The format that the first bytes of a file show; empty if none."""
    head = members.head(name)
    if head.startswith(SIGNATURE):
        return "ronin"
    if head.lstrip()[:1] == b"[" and b'"sensor"' in head[:4096]:
        return "sensor_logger"
    if indoor_location.looks_like(head):
        return "indoor_location"
    if get_sensor_data.looks_like(head):
        return "get_sensor_data"
    line = head.removeprefix(b"\xef\xbb\xbf").split(b"\n", 1)[0].decode("latin-1").rstrip("\r")
    if phyphox.looks_like(line):
        return "phyphox"
    if sensor_logger.looks_like(line):
        return "sensor_logger"
    return "core_motion" if core_motion.looks_like(line) else ""


def _is_table(head: bytes) -> bool:
    """Whether these are the first bytes of a text whose first lines have the same number of at least four fields."""
    lines = head.decode("latin-1").splitlines()[:3]
    counts = {max(line.count(separator) for separator in SEPARATORS) for line in lines}
    return b"\x00" not in head and len(lines) >= 2 and len(counts) == 1 and counts.pop() >= 3


def read(path: str | Path, format: str | None = None) -> Recording:
    """Return the recording at a path, a file or folder, whatever its format, or of the format of `FORMATS` given.

    The format is found by content, not by file name: the project's own, Sensor Logger, phyphox, GetSensorData (IPIN),
    indoor-location-competition 2.0, CoreMotion tables (MotionSense), RoNIN, or any CSV file with a TOML file beside it.
    `pdr_filter.io.describe.reading_report` of the result says what was found: source, signs, units, rates, clock.
    A RecordingError (a ValueError) names the file, the column, the value and the remedy.
    """
    path = Path(path)
    format = format.lower().replace("-", "_") if format else detect(path)
    if format not in FORMATS:
        raise ValueError(f"format is {format!r}; known are {', '.join(FORMATS)}")
    return FORMATS[format](path)
