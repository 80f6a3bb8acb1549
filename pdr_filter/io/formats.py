"""The formats that are known, and which one a path holds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path, PurePosixPath

from pdr_filter.io import core_motion, get_sensor_data, indoor_location, limits, phyphox, ros_bag, sensor_logger
from pdr_filter.io.any_table import TEXTS, is_of_sensors, read_table
from pdr_filter.io.archive import Members, open_members
from pdr_filter.io.core_motion import read_core_motion
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.generic_csv import mapping_beside, read_generic_csv
from pdr_filter.io.get_sensor_data import read_get_sensor_data
from pdr_filter.io.indoor_location import read_indoor_location
from pdr_filter.io.matlab import is_matlab
from pdr_filter.io.own_format import read_recording
from pdr_filter.io.phyphox import read_phyphox
from pdr_filter.io.recording import Recording
from pdr_filter.io.ronin import SIGNATURE, read_ronin
from pdr_filter.io.ros_bag import read_ros_bag
from pdr_filter.io.sensor_logger import read_sensor_logger
from pdr_filter.io.several import parts_of
from pdr_filter.io.spreadsheet import is_spreadsheet

FORMATS: dict[str, Callable[[Path], Recording]] = {
    "own": read_recording,
    "sensor_logger": read_sensor_logger,
    "phyphox": read_phyphox,
    "get_sensor_data": read_get_sensor_data,
    "indoor_location": read_indoor_location,
    "core_motion": read_core_motion,
    "ronin": read_ronin,
    "ros_bag": read_ros_bag,
    "table": read_table,
    "generic_csv": read_generic_csv,
}
# Formats of apps whose signs differ between iOS and Android.
OF_TWO_PLATFORMS: dict[str, Callable[[Path, str | None], Recording]] = {
    "sensor_logger": read_sensor_logger,
    "table": read_table,
}
PLATFORMS = ("ios", "android")


def detect(path: Path) -> str:
    """The format of a file or folder, by its content; the project's own if nothing else fits, which then explains."""
    try:
        with open_members(path) as members:
            return _detect_among(members) if members.is_container else _detect_alone(members)
    except RecordingError:
        if not path.exists() and not any(parent.is_file() for parent in path.parents):
            return "own"
        raise


def _detect_among(members: Members) -> str:
    """The format of a zip or a folder."""
    by_name = {PurePosixPath(name).name: name for name in members.names}
    if is_spreadsheet(members):
        return "table"
    if "accelerometer.csv" in by_name:
        found = detect_file(members, by_name["accelerometer.csv"])  # an experiment of phyphox may be called so, too
        if found in ("phyphox", "sensor_logger") or (found == "table" and "meta.json" not in by_name):
            return found
        return "own"
    if "data.hdf5" in by_name and members.path.is_dir():
        return "ronin"
    if ros_bag.is_bag(members):
        return "ros_bag"
    texts = [name for name in members.names if name.lower().endswith((*TEXTS, ".json", ".sqlite", ".db"))]
    found = [detect_file(members, name) for name in texts[: limits.MAX_FILES_LOOKED_AT]]
    of_apps = list(dict.fromkeys(format for format in found if format not in ("", "table")))
    # Tables of phyphox among others are tables: its members may have been renamed or rewritten.
    return (
        of_apps[0]
        if of_apps and not (of_apps == ["phyphox"] and "table" in found)
        else ("table" if "table" in found else "own")
    )


def _detect_alone(members: Members) -> str:
    """The format of one file."""
    path, name = members.path, members.names[0]
    found = detect_file(members, name)
    if name == "accelerometer.csv" and not found:
        return "own"  # which asks for the folder
    if mapping_beside(path).is_file() and mapping_beside(path) != path:
        return found if found in ("get_sensor_data", "ronin") else "generic_csv"
    head = members.head(name)
    if found == "sensor_logger" and head.lstrip()[:1] not in (b"[", b"{") and not head.startswith(b"SQLite"):
        return "table"  # one sensor of it
    if not found and head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise RecordingError(f"{path}: UTF-16 text; save it as UTF-8")
    if not found and b"\x00" not in head[:4096] and any(mark in head[:4096] for mark in (b",", b";", b"\t")):
        return "table"  # which says what it saw
    return found or "own"


def detect_file(members: Members, name: str) -> str:
    """The format that the first bytes of a file show; empty if none."""
    head = members.head(name)
    begin = head.lstrip()[:1]
    if head.startswith(SIGNATURE):
        return "ronin"
    if is_matlab(head) or is_spreadsheet(members, name):
        return "table"
    if ros_bag.looks_like(head):
        return "ros_bag"
    if sensor_logger.looks_like_export(head):
        return "sensor_logger"
    if begin in (b"[", b"{"):
        return ""
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
    is_own = line.startswith("time_s,")
    return "table" if not is_own and name.lower().endswith(TEXTS) and is_of_sensors(members, name) else ""


def read(path: str | Path, format: str | None = None, platform: str | None = None) -> Recording:
    """Return the recording at a path, a file or folder, whatever its format, or of the format of `FORMATS` given.

    The format is found by content, not by file name: the project's own, Sensor Logger, phyphox, GetSensorData (IPIN),
    indoor-location-competition 2.0, CoreMotion tables (MotionSense), RoNIN, ROS 2 bags, tables of other apps (MATLAB
    Mobile, Physics Toolbox, AndroSensor, HyperIMU, SensorLog, senslogs, spreadsheets), or any CSV file with a TOML file
    beside it. `platform`, ios or android, is for those whose signs differ between the two, where the file names none.
    A path may go on inside a zip or a log of several recordings: `export.zip/walk_2`.
    `pdr_filter.io.describe.reading_report` of the result says what was found: source, signs, units, rates, clock.
    A RecordingError (a ValueError) names the file, the column, the value and the remedy.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> path = pdr.simulate.demo_walk().save("walk.zip")
    >>> pdr.read(path)
    Recording('demo_walk', 114.4 s, accelerometer, gyroscope, magnetometer)
    >>> pdr.read("walk_2.zip")
    Traceback (most recent call last):
        ...
    pdr_filter.io.errors.RecordingError: walk_2.zip: no such file or folder; check the path
    """
    path = Path(path)
    if platform is not None and platform not in PLATFORMS:
        raise ValueError(f"platform is {platform!r}; known are {', '.join(PLATFORMS)}")
    if format is None and (parts := parts_of(path, detect_file)):
        raise RecordingError(
            f"{path}: holds {len(parts)} recordings ({', '.join(parts[:3])}); read one, such as {path / parts[0]}, "
            "or give its recordings as recordings_in lists them"
        )
    format = format.lower().replace("-", "_") if format else detect(path)
    if format not in FORMATS:
        raise ValueError(f"format is {format!r}; known are {', '.join(FORMATS)}")
    if platform is None:
        return FORMATS[format](path)
    if format not in OF_TWO_PLATFORMS:
        raise RecordingError(f"{path}: the signs of {format} are known, whatever the platform is; leave platform out")
    return OF_TWO_PLATFORMS[format](path, platform)
