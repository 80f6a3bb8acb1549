"""The table of a batch: a CSV file that grows by one line for each recording and survives a kill at any moment."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
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
    # Seconds in each context, in the order of the table's columns; empty where it failed.
    context_s: Mapping[str, float] = field(default_factory=dict[str, float], hash=False)
    notes: str = ""  # of the track, joined by "; "

    @property
    def task(self) -> Task:
        """Which recording it is of, and how it was tracked."""
        return Task(*(getattr(self, f.name) for f in fields(Task)))

    @property
    def failed(self) -> bool:
        """Whether there is no track."""
        return self.status == _FAILED


_NAMES = tuple(f.name for f in fields(Row))
_BEFORE, _AFTER = _NAMES[: _NAMES.index("context_s")], _NAMES[_NAMES.index("context_s") + 1 :]


def columns_of(contexts: Sequence[str]) -> tuple[str, ...]:
    """Return the columns of a table: the fields of `Row`, with one column "NAME_s" for each context.

    Raises ValueError if a context would have the column of a field.
    """
    of_contexts = tuple(f"{name}_s" for name in contexts)
    if taken := {*of_contexts} & {*_NAMES}:
        raise ValueError(f"a context cannot have the column {min(taken)!r}, which tables have already: rename it")
    return (*_BEFORE, *of_contexts, *_AFTER)


def read_table(path: str | Path) -> list[Row]:
    """Rows of a table that `track` writes, also while it grows; a last line that is cut short is left out."""
    return _parsed(Path(path).read_bytes(), Path(path))[0]


@contextmanager
def opened(
    table: Path, retry_failed: bool, contexts: Sequence[str] = CONTEXTS
) -> Generator[tuple[list[Row], Callable[[Row], None]]]:
    """The rows that are there, and what appends one; no line that is cut short is left.

    ValueError for a table of other contexts.
    """
    header = _header(contexts)
    table.parent.mkdir(parents=True, exist_ok=True)
    with table.open("a+b") as file:
        _lock(file, table)
        file.seek(0)
        content = file.read()
        rows, length = _parsed(content, table)
        if length and not content.startswith(header.encode()):
            raise ValueError(f"{table}: not a table of the contexts {', '.join(contexts)}; give another name")
        if retry_failed and any(row.failed for row in rows):
            rows = [row for row in rows if not row.failed]
            # In place, under the lock; what a kill could lose here is done again.
            file.truncate(0)
            _append(file, header + "".join(_line(_cells(row, contexts)) for row in rows))
        else:
            file.truncate(length)
            if length == 0:
                _append(file, header)

        def append(row: Row) -> None:
            _append(file, _line(_cells(row, contexts)))

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
    if not lines and not _line(_BEFORE)[:-1].encode().startswith(content[: len(_line(_BEFORE)) - 1]):
        raise ValueError(f"{table}: not a table of a batch; give another name")
    contexts = _contexts_in(lines[0]) if lines else ()
    if contexts is None:
        raise ValueError(f"{table}: not a table of a batch of this version; give another name")
    rows: list[Row] = []
    for number, line in enumerate(lines[1:], 2):
        try:
            (cells,) = csv.reader([line])
            rows.append(_of_cells(cells, contexts))
        except (ValueError, csv.Error) as error:
            raise ValueError(f"{table}: line {number} is damaged ({reason_of(error)}): remove it") from error
    return rows, length


def _line(cells: Iterable[str]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()


def _header(contexts: Sequence[str]) -> str:
    return _line(csv_cell(name) for name in columns_of(contexts))


def _contexts_in(header: str) -> tuple[str, ...] | None:
    """Contexts of the columns of a table; None for other columns."""
    try:
        columns = [of_csv_cell(cell) for cell in next(csv.reader([header]), [])]
    except csv.Error:
        return None
    contexts = tuple(name.removesuffix("_s") for name in columns[len(_BEFORE) : -len(_AFTER)])
    return contexts if _header(contexts) == header + "\n" else None


def _cells(row: Row, contexts: Sequence[str]) -> list[str]:
    """Floats with all their digits, texts that no program takes for a formula: what is read back has the same bits."""
    values = [
        *(getattr(row, name) for name in _BEFORE),
        *(row.context_s.get(name) for name in contexts),
        *(getattr(row, name) for name in _AFTER),
    ]
    return [csv_cell(v) if isinstance(v, str) else "" if v is None else str(v) for v in values]


def _of_cells(cells: Sequence[str], contexts: Sequence[str]) -> Row:
    n_columns = len(columns_of(contexts))
    if len(cells) != n_columns:
        raise ValueError(f"{len(cells)} of {n_columns} cells")
    n_before = len(_BEFORE)
    of_contexts = cells[n_before : n_before + len(contexts)]
    seconds = {name: float(cell) for name, cell in zip(contexts, of_contexts, strict=True) if cell}
    values: dict[str, Any] = {"context_s": seconds}
    kinds = {f.name: str(f.type).removesuffix(" | None") for f in fields(Row)}
    others = [*cells[:n_before], *cells[n_before + len(contexts) :]]
    for name, cell in zip((*_BEFORE, *_AFTER), others, strict=True):
        if kinds[name] == "str":
            values[name] = of_csv_cell(cell)
        else:
            values[name] = None if not cell else int(cell) if kinds[name] == "int" else float(cell)
    return Row(**values)


def row_of(task: Task, result: Track) -> Row:
    """The row of a track."""
    seconds = result.context_seconds()
    end_m = result.end_position_m
    return Row(
        **asdict(task),
        name=_one_line(result.name),
        n_steps=result.n_steps,
        distance_m=result.distance_m,
        duration_s=float(result.duration_s),
        end_east_m=float(end_m[0]),
        end_north_m=float(end_m[1]),
        end_std_m=float(result.position_std_m[-1]) if result.n_steps else None,
        context_s={name: seconds.get(name, 0.0) for name in result.contexts},
        notes=_one_line("; ".join(result.notes)),
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


def write_parquet(rows: Sequence[Row], path: Path, contexts: Sequence[str]) -> None:
    """Write all rows at once; the file is there when it is whole."""
    of_rows = [{**asdict(row), **{f"{name}_s": s for name, s in row.context_s.items()}} for row in rows]
    frame: Any = pandas_for_parquet(path).DataFrame(of_rows, columns=list(columns_of(contexts)))
    with whole_file(path) as file:
        frame.to_parquet(file, index=False)
