"""Work that other processes import by name."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pdr_filter as pdr


def pid_after(seconds: float) -> int:
    """Who did it."""
    time.sleep(seconds)
    return os.getpid()


def track_into(folder: str, path: str) -> int:
    """Write the track of a recording in parts, unless it is there, and tell how many were written."""
    out = Path(folder) / f"{Path(path).stem}.csv"
    if out.exists():
        return 0
    pdr.batch.track_file(path, out)
    return 1
