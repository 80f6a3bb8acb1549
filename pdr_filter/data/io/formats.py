"""Known file formats, and `read`, which reads a recording in any of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from pdr_filter.data.io.apps.get_sensor_data import read_get_sensor_data
from pdr_filter.data.io.apps.indoor_location import read_indoor_location
from pdr_filter.data.io.apps.ronin import read_ronin
from pdr_filter.data.io.apps.ros_bag import read_ros_bag
from pdr_filter.data.io.apps.sensor_logger import read_sensor_logger
from pdr_filter.data.io.detection import detect
from pdr_filter.data.io.files.own_format import read_recording
from pdr_filter.data.io.folders import only_recording_in
from pdr_filter.data.io.joined import joined
from pdr_filter.data.io.tables.any_table import read_any_table, read_generic_csv
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording

FORMATS: dict[str, Callable[[Path], Recording]] = {
    "own": read_recording,
    "sensor_logger": read_sensor_logger,
    "phyphox": read_any_table,
    "get_sensor_data": read_get_sensor_data,
    "indoor_location": read_indoor_location,
    "core_motion": read_any_table,
    "ronin": read_ronin,
    "ros_bag": read_ros_bag,
    "table": read_any_table,
    "generic_csv": read_generic_csv,
}
# Formats of apps whose acceleration signs differ between iOS and Android.
OF_TWO_PLATFORMS: dict[str, Callable[[Path, str | None], Recording]] = {
    "sensor_logger": read_sensor_logger,
    "table": read_any_table,
}
PLATFORMS = ("ios", "android")


def known_format(format: str) -> str:
    """Return the name of a format as in `FORMATS`. ValueError for an unknown format."""
    name = format.lower().replace("-", "_")
    if name not in FORMATS:
        raise ValueError(
            f"format is {format!r}; give one of {', '.join(FORMATS)}, or none to detect it from the content"
        )
    return name


def read(path: str | Path | Iterable[str | Path], format: str | None = None, platform: str | None = None) -> Recording:
    """Read a recording from a file or folder of any supported app.

    Parameters
    ----------
    path : str or Path, or iterable of them
        File or folder. A folder or zip file with exactly one recording stands for that recording. A path may continue
        inside a zip file or a log with several recordings, such as "export.zip/walk_2". Several paths are the parts of
        one recording that was cut in time. They are joined by their Unix times.
    format : str, optional
        Name of a format in `pdr_filter.data.io.formats.FORMATS`. By default the format is detected from the content,
        not from the file name.
    platform : {"ios", "android"}, optional
        Platform of the phone, for formats whose acceleration signs differ between the two. It is needed only if the
        file does not show the platform.

    Returns
    -------
    Recording
        Sensor streams in SI units with a common clock, metadata, and ground truth if there is any.

    Raises
    ------
    RecordingError
        If the file cannot be used. The message names the file, the column, the value and the remedy. It is a
        ValueError.
    ValueError
        If `format` or `platform` is unknown, or if `path` is no path.

    See Also
    --------
    pdr_filter.data.io.describe.reading_report : Report of the detected source, signs, units, rates and clock.

    Notes
    -----
    Supported are the project's own format, Sensor Logger, phyphox, GetSensorData (IPIN), indoor-location-competition
    2.0, CoreMotion tables (MotionSense), RoNIN, ROS 2 bags, tables of other apps (MATLAB Mobile, Physics Toolbox,
    AndroSensor, HyperIMU, SensorLog, senslogs, spreadsheets), and any CSV file with a TOML mapping next to it.

    Examples
    --------
    >>> import tempfile, pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=5.0)])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     pdr.read(walk.save(f"{folder}/walk.zip"))
    Recording('simulated_walk', 4.3 s, accelerometer, gyroscope, magnetometer)
    >>> pdr.read("walk_2.zip")
    Traceback (most recent call last):
        ...
    pdr_filter.values.errors.RecordingError: walk_2.zip: no such file or folder; check the path
    """
    if not isinstance(path, str | Path):
        try:
            parts = [Path(part) for part in path]
        except TypeError:
            raise ValueError(f"path is {path!r}; give the path of a file or folder, or a list of paths") from None
        return joined([read(part, format, platform) for part in parts])
    path = Path(path)
    if platform is not None and platform not in PLATFORMS:
        raise ValueError(f"platform is {platform!r}; give one of {', '.join(PLATFORMS)}")
    if format is None:
        path = only_recording_in(path)
    format = known_format(format) if format else detect(path)
    if platform is None:
        return FORMATS[format](path)
    if format not in OF_TWO_PLATFORMS:
        raise RecordingError(f"{path}: the signs of {format} are known without the platform; omit platform")
    return OF_TWO_PLATFORMS[format](path, platform)
