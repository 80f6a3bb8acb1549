"""Work on many items: in this process, on several processes or on a Dask cluster, each result as it comes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

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
