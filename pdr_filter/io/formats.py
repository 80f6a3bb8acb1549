"""The formats that are known, and which one a path holds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path, PurePosixPath

from pdr_filter.io import core_motion, get_sensor_data, indoor_location, phyphox, sensor_logger
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
HEAD_BYTES = 65536
# Looking at the first lines of more files than this takes longer than reading a recording; real ones have tens.
MAX_FILES_LOOKED_AT = 100


def detect(path: Path) -> str:
    """The format of a file or folder, by its content; the project's own if nothing else fits, which then explains."""
    if not path.exists():
        return "own"
    with open_members(path) as members:
        names = {PurePosixPath(name).name for name in members.names}
        is_container = path.is_dir() or _is_zip(members)
        for name in members.names:
            if is_container and PurePosixPath(name).name == "accelerometer.csv":
                found = _of_file(members, name)  # an experiment of phyphox may be called so, too
                return found if found in ("phyphox", "sensor_logger") else "own"
        if is_container and "data.hdf5" in names and path.is_dir():
            return "ronin"
        if not is_container and path.name == "accelerometer.csv":
            return "own"  # which asks for the folder
        if not is_container and mapping_beside(path).is_file() and mapping_beside(path) != path:
            found = _of_file(members, members.names[0])
            return found if found in ("get_sensor_data", "ronin") else "generic_csv"
        texts = [n for n in members.names if n.lower().endswith((".csv", ".txt", ".log", ".json"))]
        for name in (texts if is_container else list(members.names))[:MAX_FILES_LOOKED_AT]:
            found = _of_file(members, name)
            if found == "sensor_logger" and not is_container and members.content(name, 100).lstrip()[:1] != b"[":
                raise RecordingError(
                    f"{path}: one sensor of a Sensor Logger recording; give the folder or zip that also holds the "
                    "others and Metadata.csv"
                )
            if found:
                return found
        if not is_container and members.content(members.names[0], 2)[:2] in (b"\xff\xfe", b"\xfe\xff"):
            raise RecordingError(f"{path}: UTF-16 text; save it as UTF-8")
        if not is_container and _is_table(members, members.names[0]):
            return "generic_csv"
        return "own"


def _is_zip(members: Members) -> bool:
    return members.path.is_file() and members.names != (members.path.name,)


def _of_file(members: Members, name: str) -> str:
    """The format that the first bytes of a file show; empty if none."""
    head = members.content(name, HEAD_BYTES)[:HEAD_BYTES]
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
    if core_motion.looks_like(line):
        return "core_motion"
    return ""


def _is_table(members: Members, name: str) -> bool:
    """Whether a file is text whose first lines have the same number of at least four fields."""
    head = members.content(name, HEAD_BYTES)[:HEAD_BYTES]
    if b"\x00" in head:
        return False
    lines = head.decode("latin-1").splitlines()[:3]
    counts = {max(line.count(separator) for separator in ",;\t") for line in lines}
    return len(lines) >= 2 and len(counts) == 1 and counts.pop() >= 3


def read(path: str | Path, format: str | None = None) -> Recording:
    """Return the recording at a path, whatever its format.

    The format is found by content, not by file name: the project's own, Sensor Logger, phyphox, GetSensorData (IPIN),
    indoor-location-competition 2.0, CoreMotion tables (MotionSense), RoNIN, or any CSV file with a TOML file beside it.
    `pdr_filter.io.report.reading_report` of the result says what was found: source, signs, units, rates, clock.

    Parameters
    ----------
    path : str or Path
        File or folder.
    format : str, optional
        Name of a format to force, one of `FORMATS`.

    Raises
    ------
    RecordingError
        A ValueError whose message names the file, the column, the value and the remedy.
    """
    path = Path(path)
    format = format.lower().replace("-", "_") if format else None
    if format is not None and format not in FORMATS:
        raise ValueError(f"format is {format!r}; known are {', '.join(FORMATS)}")
    reader: Callable[[Path], Recording] = FORMATS[format or detect(path)]
    return reader(path)
