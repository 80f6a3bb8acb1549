"""Many recordings: tracked on several processes or a Dask cluster, into a table that survives a kill.

Every recording is one call of `whole.track` with `recipes.for_recording`, on whatever process it runs: the numbers are
those of one by one, to the last bit on the same machine and library versions.
"""

from __future__ import annotations

import csv
import io
import os
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, TypeVar

import numpy as np

from pdr_filter import recording_run as whole
from pdr_filter.io.formats import FORMATS, detect, read
from pdr_filter.io.generic_csv import mapping_beside
from pdr_filter.io.writers import pandas_for_parquet
from pdr_filter.recipes import for_recording
from pdr_filter.tracks import Track
from pdr_filter.values.contexts import CONTEXTS

if TYPE_CHECKING:
    from pdr_filter.calibration import Calibration
    from pdr_filter.offline.calibration.priors import StepLengthPrior
    from pdr_filter.offline.calibration.segments import Segment

T = TypeVar("T")
R = TypeVar("R")

_DONE, _FAILED = "done", "failed"
_MAX_REASON = 500
_CONNECT_S = 20.0
# Files that tell that the folder around them is one recording.
_MEMBERS = {"accelerometer.csv", "accelerometer.json", "data.hdf5", "metadata.csv", "raw data.csv"}
_TEXTS = {".csv", ".txt", ".json"}
_FILES = {".zip", ".hdf5", ".h5"}


@dataclass(frozen=True, slots=True)
class Task:
    """A recording and all that its track depends on: what identifies a row of the table."""

    path: str  # absolute; another file under the same path is taken for the same recording
    recipe: str = "default"
    weighting: str = ""  # the recipe's own if empty
    file_format: str = ""  # found by content if empty
    height_m: float | None = None  # what the recording says if None
    calibration: str = ""  # path of one, absolute; none if empty


@dataclass(frozen=True, slots=True)
class Row:
    """What came of a recording; numbers are None where it failed."""

    path: str
    recipe: str
    weighting: str
    file_format: str
    height_m: float | None
    calibration: str
    status: str  # "done" or "failed"
    reason: str  # why it failed
    name: str
    n_steps: int | None
    distance_m: float | None
    duration_s: float | None
    end_east_m: float | None
    end_north_m: float | None
    end_std_m: float | None  # square root of the trace of the end's covariance
    stationary_s: float | None
    walking_s: float | None
    upstairs_s: float | None
    downstairs_s: float | None
    sideways_s: float | None
    running_s: float | None
    notes: str  # of the track, joined by "; "

    @property
    def task(self) -> Task:
        """Which recording it is of, and how it was tracked."""
        return Task(*(getattr(self, f.name) for f in fields(Task)))

    @property
    def failed(self) -> bool:
        """Whether there is no track."""
        return self.status == _FAILED


COLUMNS: tuple[str, ...] = tuple(f.name for f in fields(Row))


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


@dataclass(frozen=True, slots=True)
class Failure:
    """Why there is no result: the message of the exception, in one line."""

    reason: str


def track(
    paths: str | Path | Iterable[str | Path],
    recipe: str = "default",
    weighting: str | None = None,
    *,
    out: str | Path,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[Progress], None] | None = None,
    file_format: str | None = None,
    height_m: float | None = None,
    calibration: str | Path | None = None,
    retry_failed: bool = False,
) -> list[Row]:
    """Rows of the recordings in the order of the paths, after all of them are in the table at `out`.

    The table grows by one line for each recording that finishes, which is on the disk before the next is waited for.
    Started again with the same table, recordings that are in it are not tracked again; a line that a kill cut short is
    dropped. One process at a time can write a table.

    Parameters
    ----------
    paths : path or iterable of paths
        Recordings; a folder that is not a recording stands for all recordings in it.
    recipe, weighting : str
        As in `pdr_filter.track`; a recipe is made for each recording's person and placement.
    out : path
        CSV file with the columns `COLUMNS`. With the suffix .parquet the rows grow in the CSV file beside it and are
        written as parquet in the end, which needs pandas and pyarrow.
    jobs : int
        Processes on this machine (joblib); -1 for as many as there are cores. With 1 the work is done in this one,
        where a recording that exhausts the memory takes the batch with it.
    scheduler : str, optional
        Address of a Dask scheduler, such as tcp://host:8786, instead of `jobs`. Its workers must see the same files
        under the same paths and have the same version of this package.
    progress : callable, optional
        Called with a `Progress` at the start and after every recording.
    file_format, height_m, calibration
        As in `pdr_filter.track`, for all recordings.
    retry_failed : bool
        Track those again that failed in an earlier run; their lines are taken out first.

    Raises
    ------
    ValueError
        If an option cannot be used, or the table is of something else. What is wrong with a recording is in its row.
    """
    _check(recipe, weighting, file_format, calibration)
    table, parquet = _tables(out)
    found = {str(path.resolve()): None for path in _expanded(paths)}
    found.pop(str(table.resolve()), None)
    tasks = [
        Task(
            path,
            recipe,
            weighting or "",
            file_format or "",
            None if height_m is None else float(height_m),
            "" if calibration is None else str(Path(calibration).resolve()),
        )
        for path in found
    ]
    if broken := [t.path for t in tasks if "\n" in t.path or "\r" in t.path]:
        raise ValueError(f"{broken[0]!r} has a line break in its name, which a line of a table cannot hold: rename it")
    with _opened(table, retry_failed) as (known, append):
        rows = {row.task: row for row in known}
        clock = _Clock(tasks, rows, progress)
        todo = [task for task in tasks if task not in rows]
        for i, result in each(track_one, todo, jobs=jobs, scheduler=scheduler):
            row = result if isinstance(result, Row) else _failed(todo[i], result.reason)
            if row.task not in rows:
                append(row)
                rows[row.task] = row
                clock.after(row)
    result = [rows[task] for task in tasks]
    if parquet is not None:
        _write_parquet(result, parquet)
    return result


def calibrate(
    paths: str | Path | Iterable[str | Path],
    priors: Mapping[str, StepLengthPrior] | None = None,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[float], None] | None = None,
    file_format: str | None = None,
    anchor_std_m: float | None = None,
    measure: str = "displacement",
    loss: str = "gnc",
) -> Calibration:
    """What `pdr_filter.calibrate` finds from all recordings, each reduced to its segments where it is read.

    Only the steps between known places travel, no samples; then all segments are solved for at once. They are taken in
    the order of the paths, so the result has the same bits wherever the work was done. Recordings that cannot be used
    are left out, with their reason in the notes.

    Parameters
    ----------
    paths : path or iterable of paths
        Recordings; a folder that is not a recording stands for all recordings in it.
    priors, anchor_std_m, measure, loss
        As in `pdr_filter.calibrate`.
    jobs, scheduler, file_format
        As in `track`.
    progress : callable, optional
        Called with the fraction of recordings done.

    Raises
    ------
    ValueError
        An option cannot be used, or nothing determines the parameters.
    """
    from pdr_filter.offline.calibration.fit import calibrate_segments

    if measure not in ("displacement", "length"):  # otherwise the reason of every recording
        raise ValueError(f'measure must be "displacement" or "length", got {measure!r}')
    files = list(dict.fromkeys(str(path.resolve()) for path in _expanded(paths)))
    reduce = partial(reduced, file_format=file_format, anchor_std_m=anchor_std_m, measure=measure)
    found: dict[int, tuple[list[Segment], list[str]]] = {}
    for i, result in each(reduce, files, jobs=jobs, scheduler=scheduler):
        found[i] = ([], [f"{files[i]}: left out: {result.reason}"]) if isinstance(result, Failure) else result
        if progress is not None:
            progress(len(found) / len(files))
    segments = [segment for i in range(len(files)) for segment in found[i][0]]
    notes = [note for i in range(len(files)) for note in found[i][1]]
    if not segments:
        raise ValueError("nothing to calibrate with: " + ("; ".join(notes) or "no recordings"))
    return calibrate_segments(segments, priors, loss=loss, notes=notes)


def reduced(
    path: str, file_format: str | None, anchor_std_m: float | None, measure: str
) -> tuple[list[Segment], list[str]]:
    """Segments of known length of one recording, and notes: what a calibration needs of it."""
    from pdr_filter.offline.calibration.segments import segments_of

    recording = read(path, file_format)
    segments, notes = segments_of(recording, whole.track(recording), anchor_std_m, measure)
    if segments and not recording.subject.id:
        notes.append(f"{recording.name}: no subject id, so a person of its own")
    return segments, notes


def track_one(task: Task) -> Row:
    """The row of one recording; a failure is a row with its reason."""
    try:
        recording = read(task.path, task.file_format or None)
        if task.height_m is not None:
            recording = recording.of_height(task.height_m)
        config = for_recording(task.recipe, recording)
        result = whole.track(recording, config, task.weighting or None, calibration=task.calibration or None)
    except Exception as error:  # whatever a file provokes belongs beside the successes, not in place of them
        return _failed(task, reason_of(error))
    return _row(task, result)


def each(
    work: Callable[[T], R], items: Sequence[T], *, jobs: int = 1, scheduler: str | None = None
) -> Iterator[tuple[int, R | Failure]]:
    """Number and result of every item exactly once, as they finish; a `Failure` where it raised or its process died.

    This is what `track` runs on; reducing recordings to anything else, such as sums for a calibration, takes the same.

    Parameters
    ----------
    work : callable
        Importable by name: it runs in other processes.
    items : sequence
        What it is called with, one at a time.
    jobs, scheduler
        As in `track`.
    """
    if jobs == 0 or jobs < -1:
        raise ValueError(f"jobs must be a number of processes, or -1 for all cores, got {jobs}")
    if not items:
        return
    if scheduler is not None:
        yield from _on_cluster(work, items, scheduler)
    elif jobs == 1:
        for i, item in enumerate(items):
            yield _guarded(work, i, item)
    else:
        yield from _on_processes(work, items, jobs)


def recordings_in(folder: str | Path) -> list[Path]:
    """Paths of the recordings in a folder and the folders in it, sorted.

    Every zip and hdf5 file is taken for one, so that a broken one is reported; text files only if they look like one of
    the known formats, or have a TOML file of their columns beside them.
    """
    folder = Path(folder)
    inside = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    if any(path.name.lower() in _MEMBERS for path in inside):
        return [folder]
    found: list[Path] = []
    for path in inside:
        if path.is_dir() and not path.is_symlink():
            found += recordings_in(path)
        elif path.is_file() and (path.suffix.lower() in _FILES or (path.suffix.lower() in _TEXTS and _is_known(path))):
            found.append(path)
    return found


def read_table(path: str | Path) -> list[Row]:
    """Rows of a table that `track` writes, also while it grows; a last line that is cut short is left out."""
    return _parsed(Path(path).read_bytes(), Path(path))[0]


def reason_of(error: BaseException) -> str:
    """What is wrong, in one line; the kind of error too unless its message was written for people."""
    text = " ".join(str(error).split())
    if not isinstance(error, ValueError) or not text:
        text = f"{type(error).__name__}: {text}".rstrip(": ")
    return text if len(text) <= _MAX_REASON else text[: _MAX_REASON - 3] + "..."


# --- where the work is done ----------------------------------------------------------------------------------------


def _guarded(work: Callable[[T], R], i: int, item: T) -> tuple[int, R | Failure]:
    try:
        return i, work(item)
    except Exception as error:
        return i, Failure(reason_of(error))


def _on_processes(work: Callable[[T], R], items: Sequence[T], jobs: int) -> Iterator[tuple[int, R | Failure]]:
    from joblib import Parallel, cpu_count, delayed

    jobs = int(cpu_count()) if jobs == -1 else jobs

    def run(numbers: Sequence[int], n_jobs: int) -> Iterator[tuple[int, R | Failure]]:
        # One at a time and none in advance: when a process dies, only the first `n_jobs` unfinished can have killed it.
        options: Any = {"batch_size": 1, "pre_dispatch": "n_jobs", "return_as": "generator_unordered"}
        pool = Parallel(n_jobs=n_jobs, **options)
        done: Any = pool(delayed(_guarded)(work, i, items[i]) for i in numbers)
        yield from done

    waiting = dict.fromkeys(range(len(items)))
    while waiting:
        try:
            for i, result in run(list(waiting), max(jobs, 2)):
                del waiting[i]
                yield i, result
        except _pool_errors():
            # What was being done when the pool broke is done again, each on a pool of its own.
            for i in list(waiting)[: max(jobs, 2)]:
                try:
                    ((_, result),) = list(run([i], 2))
                except _pool_errors() as error:
                    result = Failure(f"its process died: {reason_of(error)}")
                del waiting[i]
                yield i, result


def _pool_errors() -> tuple[type[BaseException], ...]:
    from joblib.externals.loky.process_executor import BrokenProcessPool, TerminatedWorkerError

    return BrokenProcessPool, TerminatedWorkerError


def _on_cluster(work: Callable[[T], R], items: Sequence[T], scheduler: str) -> Iterator[tuple[int, R | Failure]]:
    try:
        from distributed import Client, KilledWorker, as_completed
    except ImportError as error:
        raise ValueError("a scheduler needs Dask: pip install 'dask[distributed]'") from error
    try:
        client: Any = Client(scheduler, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise ValueError(f"no Dask scheduler at {scheduler}: {reason_of(error)}") from error
    with client:
        # Not pure: Dask would otherwise give the result of an earlier call for the same path.
        futures: list[Any] = [client.submit(_guarded, work, i, item, pure=False) for i, item in enumerate(items)]
        number = {future.key: i for i, future in enumerate(futures)}
        finished: Any = as_completed(futures, with_results=True, raise_errors=False, loop=client.loop)
        for future, result in finished:
            i = number.pop(future.key)
            if future.status == "finished":
                yield i, result[1]
            elif isinstance(error := _exception(result), KilledWorker):
                # Dask gives up on what four workers in a row did not survive: not bad luck any more.
                yield i, Failure("the workers that had it died: too large, or it crashes them")
            else:  # no fault of the recording: the scheduler is gone, or the workers lack this package
                raise RuntimeError(f"the cluster at {scheduler} failed ({future.status}): {error!r}")
            futures[i] = None  # lets the cluster forget the result


def _exception(result: Any) -> Any:
    """From (type, value, traceback), which is what a future that failed gives in place of a result."""
    return result[1] if isinstance(result, tuple) and len(result) > 1 else result


# --- the table -----------------------------------------------------------------------------------------------------


@contextmanager
def _opened(table: Path, retry_failed: bool) -> Generator[tuple[list[Row], Callable[[Row], None]]]:
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
    """Floats with all their digits: what is read back has the same bits."""
    return ["" if value is None else str(value) for value in (getattr(row, name) for name in COLUMNS)]


def _of_cells(cells: Sequence[str]) -> Row:
    if len(cells) != len(COLUMNS):
        raise ValueError(f"{len(cells)} of {len(COLUMNS)} cells")
    values: dict[str, Any] = {}
    for f, cell in zip(fields(Row), cells, strict=True):
        kind = str(f.type).removesuffix(" | None")
        values[f.name] = cell if kind == "str" else None if not cell else int(cell) if kind == "int" else float(cell)
    return Row(**values)


def _row(task: Task, result: Track) -> Row:
    seconds = result.context_seconds()
    end_m = result.position_m[-1] if result.n_steps else np.zeros(2)
    end_std_m = float(np.sqrt(np.trace(result.position_cov_m2[-1]))) if result.n_steps else None
    values: dict[str, Any] = {
        **asdict(task),
        "status": _DONE,
        "reason": "",
        "name": _one_line(result.name),
        "n_steps": result.n_steps,
        "distance_m": result.distance_m,
        "duration_s": float(result.duration_s),
        "end_east_m": float(end_m[0]),
        "end_north_m": float(end_m[1]),
        "end_std_m": end_std_m,
        **{f"{name}_s": seconds.get(name, 0.0) for name in CONTEXTS},
        "notes": _one_line("; ".join(result.notes)),
    }
    return Row(**values)


def _failed(task: Task, reason: str) -> Row:
    values: dict[str, Any] = {**dict.fromkeys(COLUMNS), **asdict(task), "name": _one_line(Path(task.path).stem)}
    values |= {"status": _FAILED, "reason": _one_line(reason), "notes": ""}
    return Row(**values)


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _tables(out: str | Path) -> tuple[Path, Path | None]:
    out = Path(out)
    if out.is_dir():
        raise ValueError(f"{out} is a folder: give the table a name, such as {out / 'tracks.csv'}")
    if out.suffix.lower() != ".parquet":
        return out, None
    pandas_for_parquet(out)  # missing now, not after hours of work
    return out.with_suffix(".csv"), out


def _write_parquet(rows: Sequence[Row], path: Path) -> None:
    frame: Any = pandas_for_parquet(path).DataFrame([asdict(row) for row in rows], columns=list(COLUMNS))
    part = path.with_name(path.name + ".part")
    frame.to_parquet(part, index=False)
    part.replace(path)


# --- what is to be done, and how long it takes ----------------------------------------------------------------------


def _check(recipe: str, weighting: str | None, file_format: str | None, calibration: str | Path | None) -> None:
    """ValueError for what would otherwise be the reason of every row."""
    from pdr_filter.recipes import RECIPES

    if recipe not in RECIPES:
        raise ValueError(f"no recipe {recipe!r}; there are {', '.join(sorted(RECIPES))}")
    if weighting is not None and weighting not in ("imm", "wc", "hc"):
        raise ValueError(f'weighting must be "imm", "wc" or "hc", got {weighting!r}')
    if file_format is not None and file_format.lower().replace("-", "_") not in FORMATS:
        raise ValueError(f"format is {file_format!r}; known are {', '.join(FORMATS)}")
    if calibration is not None:
        from pdr_filter.calibration import load_calibration

        load_calibration(calibration)


def _expanded(paths: str | Path | Iterable[str | Path]) -> Iterator[Path]:
    for path in [paths] if isinstance(paths, str | Path) else paths:
        path = Path(path)
        if path.is_dir():
            yield from recordings_in(path) or [path]
        else:
            yield path


def _is_known(path: Path) -> bool:
    try:
        found = detect(path)
    except Exception:
        return True  # something is wrong with it, which its row will say
    return found != "own" and (found != "generic_csv" or mapping_beside(path).is_file())


def _n_bytes(path: Path) -> int:
    try:
        files = [p for p in path.rglob("*") if p.is_file()] if path.is_dir() else [path]
        return sum(p.stat().st_size for p in files)
    except OSError:
        return 0


@dataclass(slots=True)
class _Clock:
    """Tells how far the batch is, and estimates the rest by bytes: recordings may be of seconds or of hours."""

    tasks: Sequence[Task]
    rows: dict[Task, Row]
    progress: Callable[[Progress], None] | None
    start_s: float = field(default_factory=lambda: time.monotonic())
    bytes_of: dict[Task, int] = field(default_factory=dict[Task, int])
    left_bytes: int = 0
    done_bytes: int = 0
    n_done: int = 0
    n_failed: int = 0

    def __post_init__(self) -> None:
        if self.progress is None:
            return
        known = [self.rows[task] for task in self.tasks if task in self.rows]
        self.n_done, self.n_failed = len(known), sum(row.failed for row in known)
        # One more, so that empty files count.
        self.bytes_of = {t: 1 + _n_bytes(Path(t.path)) for t in self.tasks if t not in self.rows}
        self.left_bytes = sum(self.bytes_of.values())
        self._tell(None)

    def after(self, row: Row) -> None:
        if self.progress is None:
            return
        size = self.bytes_of[row.task]
        self.left_bytes, self.done_bytes = self.left_bytes - size, self.done_bytes + size
        self.n_done, self.n_failed = self.n_done + 1, self.n_failed + row.failed
        self._tell(row)

    def _tell(self, last: Row | None) -> None:
        if self.progress is None:
            return
        elapsed_s = time.monotonic() - self.start_s
        left_s = None if self.left_bytes else 0.0
        if self.left_bytes and self.done_bytes:
            left_s = elapsed_s * self.left_bytes / self.done_bytes
        self.progress(Progress(self.n_done, self.n_failed, len(self.tasks), elapsed_s, left_s, last))
