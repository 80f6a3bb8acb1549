"""Work that other processes import by name."""

from __future__ import annotations

import os
import signal
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


def square_or_die(n: int) -> int:
    """Return the square of a positive number. A negative one kills the process."""
    if n < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    if n == 0:
        raise ValueError("nothing to square")
    return n * n
