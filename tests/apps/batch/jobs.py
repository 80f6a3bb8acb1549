"""Work that other processes import by name."""

from __future__ import annotations

import os
import time


def pid_after(seconds: float) -> int:
    """Who did it."""
    time.sleep(seconds)
    return os.getpid()
