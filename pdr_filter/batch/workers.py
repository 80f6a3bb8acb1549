"""Work on many items: in this process, on several processes or on a Dask cluster, each result as it comes."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, TypeVar, cast

from pdr_filter.io.formats import FORMATS

T = TypeVar("T")
R = TypeVar("R")

_MAX_REASON = 500
_CONNECT_S = 20.0


@dataclass(frozen=True, slots=True)
class Failure:
    """Why there is no result: the message of the exception, in one line."""

    reason: str


def each(
    work: Callable[[T], R], items: Sequence[T], *, jobs: int = 1, scheduler: str | None = None
) -> Iterator[tuple[int, R | Failure]]:
    """Number and result of every item exactly once, as they finish; a `Failure` where it raised or its process died.

    This is what `track` runs on; reducing recordings to anything else, such as sums for a calibration, takes the same.
    `work` is called with one item at a time and must be importable by name, as it runs in other processes; `jobs` and
    `scheduler` are as in `track`.
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


def check_format(file_format: str | None) -> None:
    """ValueError for what would otherwise be the reason of every recording."""
    if file_format is not None and file_format.lower().replace("-", "_") not in FORMATS:
        raise ValueError(f"format is {file_format!r}; known are {', '.join(FORMATS)}")


def reason_of(error: BaseException) -> str:
    """What is wrong, in one line; the kind of error too unless its message was written for people."""
    text = " ".join(str(error).split())
    if not isinstance(error, ValueError) or not text:
        text = f"{type(error).__name__}: {text}".rstrip(": ")
    return text if len(text) <= _MAX_REASON else text[: _MAX_REASON - 3] + "..."


def _guarded(work: Callable[[T], R], i: int, item: T) -> tuple[int, R | Failure]:
    try:
        return i, work(item)
    except Exception as error:
        return i, Failure(reason_of(error))


def _on_processes(work: Callable[[T], R], items: Sequence[T], jobs: int) -> Iterator[tuple[int, R | Failure]]:
    """One thread for each process, which it gives one item after the other: so it is known what a process died of.

    What was being done is done again in the end, alone: many large items at once are no failure, a second death is.
    """
    from joblib import cpu_count

    n_cores = int(cpu_count())
    n = min(n_cores if jobs == -1 else jobs, len(items))
    todo, results = SimpleQueue[int](), SimpleQueue[tuple[int, Any]]()
    for i in range(len(items)):
        todo.put(i)
    if getattr(work, "__module__", "") == "__main__":
        raise ValueError(f"{work!r} runs in other processes: put it into a module that they can import")
    begin = pickle.dumps(work)
    workers = [_BatchWorker(begin, max(n_cores // n, 1)) for _ in range(n)]

    def run(worker: _BatchWorker) -> None:
        with suppress(Empty):
            while True:
                i = todo.get_nowait()
                try:
                    results.put(worker.done(i, items[i]))
                except BaseException as error:  # whatever it is, somebody waits for this item
                    results.put((i, error))

    died: list[int] = []
    try:
        for worker in workers:
            Thread(target=run, args=(worker,), daemon=True).start()
        for _ in items:
            i, result = results.get()
            if isinstance(result, _DeathError):
                died.append(i)
            elif isinstance(result, BaseException):
                raise result
            else:
                yield i, result
        for i in died:
            try:
                yield workers[0].done(i, items[i])
            except _DeathError as error:
                yield i, Failure(f"its process died ({error}): too large, or it crashes it")
    finally:
        for worker in workers:
            worker.kill()


class _DeathError(Exception):
    """A process has ended in the middle of an item."""


class _BatchWorker:
    """A process for one item after the other, started when it is needed, and again after its death.

    Each end sees the death of the other as the end of a pipe that nobody else holds. There is no lock to be left
    behind, and nothing to wait for.
    """

    def __init__(self, begin: bytes, n_threads: int) -> None:
        self._begin = begin
        self._environment = {**dict.fromkeys(_THREADS, str(n_threads)), **os.environ}
        self._process: subprocess.Popen[bytes] | None = None

    def done(self, i: int, item: Any) -> Any:
        """What `_guarded` makes of an item; `_DeathError` if the process ends before."""
        if self._process is None:
            command = f"import sys; sys.path[:] = {sys.path!r}; from pdr_filter.batch.workers import serve; serve()"
            pipe, environment = subprocess.PIPE, self._environment
            self._process = subprocess.Popen([sys.executable, "-c", command], stdin=pipe, stdout=pipe, env=environment)
            pieces = (self._begin, pickle.dumps((i, item)))
        else:
            pieces = (pickle.dumps((i, item)),)
        to, answers = cast(Any, self._process.stdin), cast(Any, self._process.stdout)
        try:
            for piece in pieces:
                pickle.dump(piece, to)
            to.flush()
            return pickle.load(answers)
        except (OSError, EOFError, pickle.UnpicklingError) as error:
            raise _DeathError(f"exit code {self.kill()}") from error

    def kill(self) -> int | None:
        """End the process; its exit code."""
        process, self._process = self._process, None
        if process is None:
            return None
        with process:
            process.kill()
        return process.returncode


# Processes share the cores: numerical libraries of each take their part, as joblib has it.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


def serve() -> None:
    """Loop of a process: a function, and then items, from standard input; what came of each to standard output."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the terminal: whoever started this process ends it
    sources, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # what the work prints is no answer
    pieces = SimpleQueue[bytes]()

    def read() -> None:
        try:
            while True:
                pieces.put(pickle.load(sources))
        finally:  # whoever wanted the work is gone
            os._exit(1)

    Thread(target=read, daemon=True).start()
    work = pickle.loads(pieces.get())
    while True:
        i, item = pickle.loads(pieces.get())
        pickle.dump(_guarded(work, i, item), answers)
        answers.flush()


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
