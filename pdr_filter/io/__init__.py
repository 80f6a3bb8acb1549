"""Reading recordings: the only place that converts units, axes and clocks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pdr_filter.io.formats import FORMATS, detect
from pdr_filter.types import Recording

__all__ = ["FORMATS", "read"]


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
