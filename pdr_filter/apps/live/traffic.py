"""Traffic of a server for its pages: messages and their answers, refused ones, and how long the disk suffices."""

from __future__ import annotations

import logging
import shutil
import time
from collections import deque
from pathlib import Path

from pdr_filter.apps.live.parts import Answer
from pdr_filter.apps.live.settings import Event
from pdr_filter.values.sanitise import printable

# Interval of `server` events, and the number of them over which rates are averaged: half a minute.
REPORT_S = 2.0
_N_AVERAGED = 15
# A recording of some minutes has 0.8 to 1.3 times the bytes of its messages, so the disk fills as messages come. One
# phone with all sensors at 100 Hz sends 0.1 MB/s.
_LEAST_BYTES_PER_S = 0.1e6
# An hour is enough to notice a warning and to free some space.
_WARNING_S = 3600.0
_MAX_REASON = 200
_LOG = logging.getLogger(__package__)


class Traffic:
    """Counts of the messages that a server has answered. Recordings are written to `folder`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._n, self._n_bytes, self._waited_s = 0, 0, 0.0
        self._refused: dict[str, int] = {}
        self._refusal = ""
        # Time and counts at the latest reports.
        self._before: deque[tuple[float, int, int, float]] = deque(maxlen=_N_AVERAGED)
        self._is_low = False
        self._count()

    def _count(self) -> tuple[float, int, int, float]:
        """Return the counts of now, and keep them for later reports."""
        self._before.append((time.monotonic(), self._n, self._n_bytes, self._waited_s))
        return self._before[-1]

    def add(self, n_bytes: int, device: str, answer: Answer, waited_s: float) -> None:
        """Count a request with messages, and its answer after `waited_s` seconds."""
        self._n, self._n_bytes, self._waited_s = self._n + 1, self._n_bytes + n_bytes, self._waited_s + waited_s
        if answer.status != 200:
            status = str(answer.status)
            self._refused[status] = self._refused.get(status, 0) + 1
            self._refusal = printable(f"{device}: {answer.content['error']}".removeprefix(": "))[:_MAX_REASON]

    def event(self) -> Event:
        """Return the `server` event. A disk that is nearly full is logged once. Call it every `REPORT_S`."""
        then_s, n_then, n_bytes_then, waited_then_s = self._before[0]
        now_s, n, n_bytes, waited_s = self._count()
        span_s = max(now_s - then_s, 1e-3)
        bytes_per_s = (n_bytes - n_bytes_then) / span_s
        left_bytes = shutil.disk_usage(self.folder).free
        left_s = left_bytes / max(bytes_per_s, _LEAST_BYTES_PER_S)
        was_low, self._is_low = self._is_low, left_s < _WARNING_S
        if self._is_low and not was_low:
            _LOG.warning("%s: %.0f MB left on the disk: free some space", self.folder, left_bytes / 1e6)
        return {
            "event": "server",
            "messages_per_s": (n - n_then) / span_s,
            "bytes_per_s": bytes_per_s,
            "answer_s": (waited_s - waited_then_s) / (n - n_then) if n > n_then else None,
            "n_refused": dict(self._refused),
            "refusal": self._refusal,
            "disk_left_bytes": left_bytes,
            "disk_left_s": left_s,
            "is_disk_low": self._is_low,
        }
