"""Result table of a batch, a CSV file that grows by one line per recording and remains valid if the batch is killed."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import IO, Any

from pdr_filter.apps.batch.worker_process import reason_of
from pdr_filter.data.io.files.track_writers import pandas_for_parquet
from pdr_filter.tracking.track import Track
from pdr_filter.values import CONTEXTS
from pdr_filter.values.recording import Recording
from pdr_filter.values.safe_files import whole_file
from pdr_filter.values.sanitise import csv_cell, of_csv_cell

_DONE, _FAILED = "done", "failed"


@dataclass(frozen=True, slots=True)
class Task:
    """Recording with the options of its track, which together identify a row of the table (see `Row`)."""

    path: str  # files are compared by path, not by content
    recipe: str = "default"
    weighting: str = ""
    file_format: str = ""
    height_m: float | None = None
    calibration: str = ""
    gnss: str = ""


@dataclass(frozen=True, slots=True)
class Row(Task):
    """Result of one recording of a batch, a row of the table. Numbers are None if the recording failed.

    Attributes
    ----------
    path : str
        Absolute path of the recording.
    recipe : str
        Name of the recipe.
    weighting : str
        Weighting, or "" for the weighting of the recipe.
    file_format : str
        Format of the file, or "" if it was detected from the content.
    height_m : float or None
        Height of the person in m, or None for the height in the recording.
    calibration : str
        Absolute path of a calibration or person file, or "" for none.
    gnss : str
        Use of locations, or "" for the default of `pdr_filter.track`.
    status : {"done", "failed"}
        Whether the recording was tracked.
    reason : str
        Reason of the failure.
    name : str
        Name of the recording.
    subject : str
        Person of the recording, by its meta data, or by its file name if the names in its folder are of several people.
    n_steps, phone_n_steps : int or None
        Number of steps, and that of the phone's own counter if the file has it.
    distance_m : float or None
        Walked distance in m.
    duration_s : float or None
        Duration in s.
    end_east_m, end_north_m : float or None
        End position in m.
    end_std_m : float or None
        Standard deviation of the end position in the worst direction, in m.
    context_s : mapping of str to float
        Seconds in each context by its name. Empty if the recording failed.
    notes : str
        Notes of the track, joined by "; ".

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> row = pdr.batch.Row("/data/walk.zip", status="failed", reason="no accelerometer")
    >>> row.failed, row.n_steps
    (True, None)
    """

    status: str = _DONE
    reason: str = ""
    name: str = ""
    subject: str = ""
    n_steps: int | None = None
    phone_n_steps: int | None = None
    distance_m: float | None = None
    duration_s: float | None = None
    end_east_m: float | None = None
    end_north_m: float | None = None
    end_std_m: float | None = None
    context_s: Mapping[str, float] = field(default_factory=dict[str, float], hash=False)
    notes: str = ""

    @property
    def task(self) -> Task:
        """Task of the row: the recording and the options with which it was processed."""
        return Task(*(getattr(self, f.name) for f in fields(Task)))

    @property
    def failed(self) -> bool:
        """Whether the recording could not be tracked."""
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
    """Read the table of a batch. It can be read while the batch runs.

    Parameters
    ----------
    path : str or Path
        CSV file that `pdr_filter.batch.track` has written.

    Returns
    -------
    list of Row
        Rows in the order in which recordings finished. An incomplete last line is ignored.

    Raises
    ------
    ValueError
        If the file is not a table of a batch of this version, or is damaged.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> import pdr_filter as pdr
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=10.0)]).save(f"{folder}/walk.zip")
    ...     _ = pdr.batch.track([walk], out=f"{folder}/tracks.csv")
    ...     [row.status for row in pdr.batch.read_table(f"{folder}/tracks.csv")]
    ['done']
    """
    return _parsed(Path(path).read_bytes(), Path(path))[0]


@contextmanager
def open_table(
    table: Path, retry_failed: bool, contexts: Sequence[str] = CONTEXTS
) -> Generator[tuple[list[Row], Callable[[Row], None]]]:
    """Open and lock a table. Yield its rows, and a function that appends a row.

    An incomplete last line is removed. With `retry_failed`, rows of failed recordings are removed as well. ValueError
    for a table with other contexts, for another kind of file, and if another batch has locked the table.
    """
    header = _header(contexts)
    table.parent.mkdir(parents=True, exist_ok=True)
    with table.open("a+b") as file:
        _lock(file, table)
        file.seek(0)
        content = file.read()
        rows, length = _parsed(content, table)
        if length and not content.startswith(header.encode()):
            raise ValueError(
                f"{table}: this file exists and is not a result table with the contexts {', '.join(contexts)}; give "
                "the name of a new file, or the recipe with which the table was made"
            )
        if retry_failed and any(row.failed for row in rows):
            rows = [row for row in rows if not row.failed]
            # the file is rewritten in place to keep the lock; rows lost by a kill at this point are recomputed
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
    """Lock the table against other batches until the file is closed.

    ValueError if another batch has locked it, or if its file system has no locks. On Windows, which has no `fcntl`,
    nothing is done.
    """
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise ValueError(
            f"{table}: another batch is writing this table: wait until it has finished, or give another name"
        ) from error
    except OSError as error:  # such as a network drive
        raise ValueError(f"{table}: cannot be locked ({error.strerror}): write the table to a local disk") from error


def _parsed(content: bytes, table: Path) -> tuple[list[Row], int]:
    """Return the rows of the complete lines of a table, and the number of bytes of these lines with the header.

    ValueError if the content is not a table of a batch, or if a line is damaged.
    """
    length = content.rfind(b"\n") + 1
    lines = content[:length].decode("utf-8", "surrogateescape").split("\n")[:-1]
    if not lines and not _line(_BEFORE)[:-1].encode().startswith(content[: len(_line(_BEFORE)) - 1]):
        raise ValueError(f"{table}: this file exists and is not a table of a batch; give another name")
    contexts = _contexts_in(lines[0]) if lines else ()
    if contexts is None:
        raise ValueError(f"{table}: this file is not a table of a batch of this version; give another name")
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
    """Return the contexts in the columns of a table, or None if it has other columns."""
    try:
        columns = [of_csv_cell(cell) for cell in next(csv.reader([header]), [])]
    except csv.Error:
        return None
    contexts = tuple(name.removesuffix("_s") for name in columns[len(_BEFORE) : -len(_AFTER)])
    return contexts if _header(contexts) == header + "\n" else None


def _cells(row: Row, contexts: Sequence[str]) -> list[str]:
    """Return the cells of a row. Floats have all digits, and texts are escaped so that spreadsheets run no formulas."""
    values = [
        *(getattr(row, name) for name in _BEFORE),
        *(row.context_s.get(name) for name in contexts),
        *(getattr(row, name) for name in _AFTER),
    ]
    return [csv_cell(v) if isinstance(v, str) else "" if v is None else str(v) for v in values]


def _of_cells(cells: Sequence[str], contexts: Sequence[str]) -> Row:
    """Return the row of a table from the cells of a line. ValueError for a wrong number of cells, or a wrong cell."""
    n_columns = len(columns_of(contexts))
    if len(cells) != n_columns:
        raise ValueError(f"it has {len(cells)} cells instead of {n_columns}")
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


def row_of(task: Task, result: Track, recording: Recording) -> Row:
    """Return the row of the batch table for a recording that was tracked."""
    seconds = result.context_seconds()
    end_m = result.end_position_m
    return Row(
        **asdict(task),
        name=_one_line(result.name),
        subject=_one_line(str(recording.subject.id or "")),
        n_steps=result.n_steps,
        phone_n_steps=recording.phone_steps,
        distance_m=result.distance_m,
        duration_s=float(result.duration_s),
        end_east_m=float(end_m[0]),
        end_north_m=float(end_m[1]),
        end_std_m=float(result.position_std_m[-1]) if result.n_steps else None,
        context_s={name: seconds.get(name, 0.0) for name in result.contexts},
        notes=_one_line("; ".join(result.notes)),
    )


def failed_row(task: Task, reason: str) -> Row:
    """Return the row of the batch table for a recording that could not be tracked, without results."""
    name = _one_line(Path(task.path).stem)
    return Row(**asdict(task), status=_FAILED, reason=_one_line(reason), name=name)


def _one_line(text: str) -> str:
    return " ".join(text.split())


def tables(out: str | Path) -> tuple[Path, Path | None]:
    """Return the path of the growing CSV file, and the path of the final Parquet file or None.

    `out` is the file that the caller wants; Parquet is written if its suffix is .parquet. ValueError if `out` is a
    folder, or if the packages for Parquet are missing.
    """
    out = Path(out)
    if out.is_dir():
        raise ValueError(f"{out} is a folder: give the path of a table, such as {out / 'tracks.csv'}")
    if out.suffix.lower() != ".parquet":
        return out, None
    pandas_for_parquet(out)  # raises now if pandas is missing, not after hours of work
    return out.with_suffix(".csv"), out


def write_rows_parquet(rows: Sequence[Row], path: Path, contexts: Sequence[str]) -> None:
    """Write all rows to a Parquet file atomically."""
    of_rows = [{**asdict(row), **{f"{name}_s": s for name, s in row.context_s.items()}} for row in rows]
    frame: Any = pandas_for_parquet(path).DataFrame(of_rows, columns=list(columns_of(contexts)))
    with whole_file(path) as file:
        frame.to_parquet(file, index=False)
