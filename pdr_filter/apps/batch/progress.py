"""Progress of a batch, with an estimate of the remaining time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pdr_filter.apps.batch.result_table import Row, Task


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of a batch.

    Attributes
    ----------
    n_done : int
        Number of rows in the table, including failed recordings and rows of earlier runs.
    n_failed : int
        Number of failed recordings among them.
    n : int
        Number of all recordings.
    elapsed_s : float
        Duration of this run in s.
    left_s : float or None
        Estimated remaining time in s: None before this run has finished a recording, 0 if no recording is left.
    last : Row or None
        Row of the recording that has just finished, or None at the start of the run.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> pdr.batch.Progress(n_done=3, n_failed=0, n=12, elapsed_s=6.0, left_s=18.0, last=None).fraction
    0.25
    """

    n_done: int
    n_failed: int
    n: int
    elapsed_s: float
    left_s: float | None
    last: Row | None

    @property
    def fraction(self) -> float:
        """Fraction of the recordings in the table, 0 to 1."""
        return self.n_done / self.n if self.n else 1.0


class Clock:
    """Report of the progress of a batch.

    The remaining time is estimated from the file sizes, because recordings may last seconds or hours.
    """

    def __init__(self, tasks: Sequence[Task], rows: Mapping[Task, Row], report: Callable[[Progress], None]) -> None:
        known = [rows[task] for task in tasks if task in rows]
        self._report, self._n = report, len(tasks)
        self._start_s = time.monotonic()
        self._n_done, self._n_failed = len(known), sum(row.failed for row in known)
        # one byte is added, so that empty files count
        self._bytes_of = {task: 1 + _n_bytes(Path(task.path)) for task in tasks if task not in rows}
        self._left_bytes, self._done_bytes = sum(self._bytes_of.values()), 0
        self._show(None)

    def after(self, row: Row) -> None:
        """Count a row that was added to the table, and pass the new `Progress` to the function `report`."""
        size = self._bytes_of[row.task]
        self._left_bytes, self._done_bytes = self._left_bytes - size, self._done_bytes + size
        self._n_done, self._n_failed = self._n_done + 1, self._n_failed + row.failed
        self._show(row)

    def _show(self, last: Row | None) -> None:
        elapsed_s = time.monotonic() - self._start_s
        left_s = None if self._left_bytes else 0.0
        if self._left_bytes and self._done_bytes:
            left_s = elapsed_s * self._left_bytes / self._done_bytes
        self._report(Progress(self._n_done, self._n_failed, self._n, elapsed_s, left_s, last))


def _n_bytes(path: Path) -> int:
    try:
        files = [p for p in path.rglob("*") if p.is_file()] if path.is_dir() else [path]
        return sum(p.stat().st_size for p in files)
    except OSError:
        return 0
