"""Work on many items: in this process, on several processes or on a Dask cluster, each result as it comes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from queue import SimpleQueue
from threading import Thread
from typing import Any, TypeVar

from pdr_filter.batch.worker_process import LostError, WorkerProcess, dask_errors, reason_of

T = TypeVar("T")
R = TypeVar("R")

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
            yield i, _guarded(work, item)
    else:
        yield from _on_processes(work, items, jobs)


def _guarded(work: Callable[[T], R], item: T) -> R | Failure:
    try:
        return work(item)
    except Exception as error:
        return Failure(reason_of(error))


def _on_processes(work: Callable[[T], R], items: Sequence[T], jobs: int) -> Iterator[tuple[int, R | Failure]]:
    """One thread for each process, which gives it one item after the other: so a death has a known item.

    An item whose process died is tried again at the end, alone: several large items at once can exhaust the memory.
    """
    from joblib import cpu_count

    n_cores = int(cpu_count())
    n = min(n_cores if jobs == -1 else jobs, len(items))
    todo, results = deque(range(len(items))), SimpleQueue[tuple[int, Any]]()
    if getattr(work, "__module__", "") == "__main__":
        raise ValueError(f"{work!r} runs in other processes: put it into a module that they can import")
    workers = [WorkerProcess(partial, _guarded, work, n_threads=max(n_cores // n, 1)) for _ in range(n)]

    def run(worker: WorkerProcess) -> None:
        with suppress(IndexError):
            while True:
                i = todo.popleft()
                try:
                    results.put((i, worker.ask(items[i])))
                except BaseException as error:  # any exception, as the loop below waits for this item
                    results.put((i, error))

    died: list[int] = []
    try:
        for worker in workers:
            # A daemon, because the program must be able to end in the middle of an item.
            Thread(target=run, args=(worker,), daemon=True).start()
        for _ in items:
            i, result = results.get()
            if isinstance(result, LostError):
                died.append(i)
            elif isinstance(result, BaseException):
                raise result
            else:
                yield i, result
        for i in died:
            try:
                yield i, workers[0].ask(items[i])
            except LostError as error:
                yield i, Failure(f"its {error}: too large, or it crashes it")
    finally:
        todo.clear()
        for worker in workers:
            worker.close()


def _on_cluster(work: Callable[[T], R], items: Sequence[T], scheduler: str) -> Iterator[tuple[int, R | Failure]]:
    with dask_errors(scheduler):
        from distributed import Client, KilledWorker, as_completed

        client: Any = Client(scheduler, timeout=_CONNECT_S, set_as_default=False)
    with client:
        # Not pure: Dask would otherwise give the result of an earlier call for the same path.
        futures: list[Any] = [client.submit(_guarded, work, item, pure=False) for item in items]
        number = {future.key: i for i, future in enumerate(futures)}
        finished: Any = as_completed(futures, with_results=True, raise_errors=False, loop=client.loop)
        for future, result in finished:
            i = number.pop(future.key)
            if future.status == "finished":
                yield i, result
            elif isinstance(error := _exception(result), KilledWorker):
                # Dask gives up on what four workers in a row did not survive: not bad luck any more.
                yield i, Failure("the workers that had it died: too large, or it crashes them")
            else:  # no fault of the recording: the scheduler is gone, or the workers lack this package
                raise RuntimeError(f"the cluster at {scheduler} failed ({future.status}): {error!r}")
            futures[i] = None  # lets the cluster forget the result


def _exception(result: Any) -> Any:
    """From (type, value, traceback), which is what a future that failed gives in place of a result."""
    return result[1] if isinstance(result, tuple) and len(result) > 1 else result
