"""How far a batch is, and how long the rest takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pdr_filter.batch.result_table import Row, Task


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a batch is."""

    n_done: int  # rows in the table, failures and those of an earlier run included
    n_failed: int
    n: int
    elapsed_s: float  # of this run
    left_s: float | None  # estimate by the bytes of the recordings; None before the first has finished
    last: Row | None

    @property
    def fraction(self) -> float:
        """Part of the recordings that is in the table."""
        return self.n_done / self.n if self.n else 1.0


class Clock:
    """Reports how far the batch is, and estimates the rest by bytes: recordings may be of seconds or of hours."""

    def __init__(self, tasks: Sequence[Task], rows: Mapping[Task, Row], report: Callable[[Progress], None]) -> None:
        known = [rows[task] for task in tasks if task in rows]
        self._report, self._n = report, len(tasks)
        self._start_s = time.monotonic()
        self._n_done, self._n_failed = len(known), sum(row.failed for row in known)
        # One more, so that empty files count.
        self._bytes_of = {task: 1 + _n_bytes(Path(task.path)) for task in tasks if task not in rows}
        self._left_bytes, self._done_bytes = sum(self._bytes_of.values()), 0
        self._show(None)

    def after(self, row: Row) -> None:
        """Count a row that is in the table now."""
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
