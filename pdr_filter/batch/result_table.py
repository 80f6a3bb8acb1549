"""The table of a batch: a CSV file that grows by one line for each recording and survives a kill at any moment."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import IO, Any

from pdr_filter.batch.worker_process import reason_of
from pdr_filter.io.files.safe_files import whole_file
from pdr_filter.io.files.track_writers import pandas_for_parquet
from pdr_filter.tracking.track import Track
from pdr_filter.values import CONTEXTS
from pdr_filter.values.sanitise import csv_cell, of_csv_cell

_DONE, _FAILED = "done", "failed"


@dataclass(frozen=True, slots=True)
class Task:
    """A recording and all that its track depends on: what identifies a row of the table."""

    path: str  # absolute; another file under the same path is taken for the same recording
    recipe: str = "default"
    weighting: str = ""  # the recipe's own if empty
    file_format: str = ""  # found by content if empty
    height_m: float | None = None  # what the recording says if None
    calibration: str = ""  # path of one, absolute; none if empty
    gnss: str = ""  # what becomes of locations: "filter" where there are some if empty


@dataclass(frozen=True, slots=True)
class Row(Task):
    """What came of a recording; numbers are None where it failed."""

    status: str = _DONE  # or "failed"
    reason: str = ""  # why it failed
    name: str = ""
    n_steps: int | None = None
    distance_m: float | None = None
    duration_s: float | None = None
    end_east_m: float | None = None
    end_north_m: float | None = None
    end_std_m: float | None = None  # `Track.position_std_m` of the end: in the worst direction
    stationary_s: float | None = None
    walking_s: float | None = None
    upstairs_s: float | None = None
    downstairs_s: float | None = None
    sideways_s: float | None = None
    running_s: float | None = None
    notes: str = ""  # of the track, joined by "; "

    @property
    def task(self) -> Task:
        """Which recording it is of, and how it was tracked."""
        return Task(*(getattr(self, f.name) for f in fields(Task)))

    @property
    def failed(self) -> bool:
        """Whether there is no track."""
        return self.status == _FAILED


COLUMNS: tuple[str, ...] = tuple(f.name for f in fields(Row))


def read_table(path: str | Path) -> list[Row]:
    """Rows of a table that `track` writes, also while it grows; a last line that is cut short is left out."""
    return _parsed(Path(path).read_bytes(), Path(path))[0]


@contextmanager
def opened(table: Path, retry_failed: bool) -> Generator[tuple[list[Row], Callable[[Row], None]]]:
    """The rows that are there, and what appends one; no line that is cut short is left."""
    table.parent.mkdir(parents=True, exist_ok=True)
    with table.open("a+b") as file:
        _lock(file, table)
        file.seek(0)
        content = file.read()
        rows, length = _parsed(content, table)
        if retry_failed and any(row.failed for row in rows):
            rows = [row for row in rows if not row.failed]
            # In place, under the lock; what a kill could lose here is done again.
            file.truncate(0)
            _append(file, _line(COLUMNS) + "".join(_line(_cells(row)) for row in rows))
        else:
            file.truncate(length)
            if length == 0:
                _append(file, _line(COLUMNS))

        def append(row: Row) -> None:
            _append(file, _line(_cells(row)))

        yield rows, append


def _append(file: IO[bytes], text: str) -> None:
    file.seek(0, os.SEEK_END)
    file.write(text.encode("utf-8", "surrogateescape"))
    file.flush()
    os.fsync(file.fileno())


def _lock(file: IO[bytes], table: Path) -> None:
    """Keep others from writing; the lock goes with the process. Without `fcntl` (Windows) nothing is locked."""
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        raise ValueError(f"{table}: another batch is writing this table") from error


def _parsed(content: bytes, table: Path) -> tuple[list[Row], int]:
    """Rows of complete lines, and how many bytes these have."""
    length = content.rfind(b"\n") + 1
    lines = content[:length].decode("utf-8", "surrogateescape").split("\n")[:-1]
    header = _line(COLUMNS)
    if not lines and not header.encode().startswith(content):
        raise ValueError(f"{table}: not a table of a batch; give another name")
    if lines and lines[0] + "\n" != header:
        raise ValueError(f"{table}: not a table of a batch of this version; give another name")
    rows: list[Row] = []
    for number, line in enumerate(lines[1:], 2):
        try:
            (cells,) = csv.reader([line])
            rows.append(_of_cells(cells))
        except (ValueError, csv.Error) as error:
            raise ValueError(f"{table}: line {number} is damaged ({reason_of(error)}): remove it") from error
    return rows, length


def _line(cells: Iterable[str]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()


def _cells(row: Row) -> list[str]:
    """Floats with all their digits, texts that no program takes for a formula: what is read back has the same bits."""
    values = (getattr(row, name) for name in COLUMNS)
    return [csv_cell(v) if isinstance(v, str) else "" if v is None else str(v) for v in values]


def _of_cells(cells: Sequence[str]) -> Row:
    if len(cells) != len(COLUMNS):
        raise ValueError(f"{len(cells)} of {len(COLUMNS)} cells")
    values: dict[str, Any] = {}
    for f, cell in zip(fields(Row), cells, strict=True):
        kind = str(f.type).removesuffix(" | None")
        if kind == "str":
            values[f.name] = of_csv_cell(cell)
        else:
            values[f.name] = None if not cell else int(cell) if kind == "int" else float(cell)
    return Row(**values)


def row_of(task: Task, result: Track) -> Row:
    """The row of a track."""
    seconds = result.context_seconds()
    end_m = result.end_position_m
    of_contexts: dict[str, Any] = {f"{name}_s": seconds.get(name, 0.0) for name in CONTEXTS}
    return Row(
        **asdict(task),
        name=_one_line(result.name),
        n_steps=result.n_steps,
        distance_m=result.distance_m,
        duration_s=float(result.duration_s),
        end_east_m=float(end_m[0]),
        end_north_m=float(end_m[1]),
        end_std_m=float(result.position_std_m[-1]) if result.n_steps else None,
        notes=_one_line("; ".join(result.notes)),
        **of_contexts,
    )


def failed_row(task: Task, reason: str) -> Row:
    """The row of a recording without a track."""
    name = _one_line(Path(task.path).stem)
    return Row(**asdict(task), status=_FAILED, reason=_one_line(reason), name=name)


def _one_line(text: str) -> str:
    return " ".join(text.split())


def tables(out: str | Path) -> tuple[Path, Path | None]:
    """Where the rows grow, as CSV, and where they are written as parquet in the end, if that is asked for."""
    out = Path(out)
    if out.is_dir():
        raise ValueError(f"{out} is a folder: give the table a name, such as {out / 'tracks.csv'}")
    if out.suffix.lower() != ".parquet":
        return out, None
    pandas_for_parquet(out)  # missing now, not after hours of work
    return out.with_suffix(".csv"), out


def write_parquet(rows: Sequence[Row], path: Path) -> None:
    """Write all rows at once; the file is there when it is whole."""
    frame: Any = pandas_for_parquet(path).DataFrame([asdict(row) for row in rows], columns=list(COLUMNS))
    with whole_file(path) as file:
        frame.to_parquet(file, index=False)
