"""The formats that are known, and reading a path of any of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pdr_filter.io.apps.get_sensor_data import read_get_sensor_data
from pdr_filter.io.apps.indoor_location import read_indoor_location
from pdr_filter.io.apps.ronin import read_ronin
from pdr_filter.io.apps.ros_bag import read_ros_bag
from pdr_filter.io.apps.sensor_logger import read_sensor_logger
from pdr_filter.io.detection import detect
from pdr_filter.io.files.errors import RecordingError
from pdr_filter.io.files.own_format import read_recording
from pdr_filter.io.folders import only_recording_in
from pdr_filter.io.tables.any_table import read_generic_csv, read_table
from pdr_filter.values.recording import Recording

FORMATS: dict[str, Callable[[Path], Recording]] = {
    "own": read_recording,
    "sensor_logger": read_sensor_logger,
    "phyphox": read_table,
    "get_sensor_data": read_get_sensor_data,
    "indoor_location": read_indoor_location,
    "core_motion": read_table,
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


def known_format(format: str) -> str:
    """Return the name of a format as in `FORMATS`; ValueError if it is not known."""
    name = format.lower().replace("-", "_")
    if name not in FORMATS:
        raise ValueError(f"format is {format!r}; give one of {', '.join(FORMATS)}, or none to find it by content")
    return name


def read(path: str | Path, format: str | None = None, platform: str | None = None) -> Recording:
    """Return the recording at a path, a file or folder, whatever its format, or of the format of `FORMATS` given.

    The format is found by content, not by file name: the project's own, Sensor Logger, phyphox, GetSensorData (IPIN),
    indoor-location-competition 2.0, CoreMotion tables (MotionSense), RoNIN, ROS 2 bags, tables of other apps (MATLAB
    Mobile, Physics Toolbox, AndroSensor, HyperIMU, SensorLog, senslogs, spreadsheets), or any CSV file with a TOML file
    beside it. `platform`, ios or android, is for those whose signs differ between the two, where the file names none.
    A folder or a zip around one recording is that recording; a path may go on inside a zip or a log of several:
    `export.zip/walk_2`.
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
    pdr_filter.io.files.errors.RecordingError: walk_2.zip: no such file or folder; check the path
    """
    path = Path(path)
    if platform is not None and platform not in PLATFORMS:
        raise ValueError(f"platform is {platform!r}; give one of {', '.join(PLATFORMS)}")
    if format is None:
        path = only_recording_in(path)
    format = known_format(format) if format else detect(path)
    if platform is None:
        return FORMATS[format](path)
    if format not in OF_TWO_PLATFORMS:
        raise RecordingError(f"{path}: the signs of {format} are known, whatever the platform is; leave platform out")
    return OF_TWO_PLATFORMS[format](path, platform)
