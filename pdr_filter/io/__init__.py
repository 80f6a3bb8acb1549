"""Reading recordings: the only place that converts units, axes and clocks."""

from __future__ import annotations

from pathlib import Path

from pdr_filter.io.own_format import read_recording
from pdr_filter.types import Recording

__all__ = ["read"]


def read(path: str | Path) -> Recording:
    """Return the recording at a path, whatever its format.

    The format is found by content, not by file name. There is one so far, the project's own: a zip file or a folder
    with accelerometer.csv and meta.json.

    Parameters
    ----------
    path : str or Path
        File or folder.

    Raises
    ------
    RecordingError
        A ValueError whose message names the file, the column, the value and the remedy.
    """
    return read_recording(path)
