"""Parallel application of a function to many items, in one process, several processes or on a Dask cluster."""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from queue import SimpleQueue
from threading import Thread
from typing import Any, TypeVar

from pdr_filter.apps.batch.worker_process import DASK_CONNECT_S, LostError, WorkerProcess, dask_errors, reason_of

T = TypeVar("T")
R = TypeVar("R")

_CAUSE_OF_DEATH = "the recording may be too large for the memory, or may crash a library"


@dataclass(frozen=True, slots=True)
class Failure:
    """Result of an item whose function raised or whose process died, with the message in one line."""

    reason: str


def each(
    work: Callable[[T], R], items: Sequence[T], *, jobs: int = 1, scheduler: str | None = None
) -> Iterator[tuple[int, R | Failure]]:
    """Apply a function to many items in parallel, and yield each result when it is finished.

    `pdr_filter.batch.track` and `pdr_filter.batch.calibrate` use this function.

    Parameters
    ----------
    work : callable
        Function of one item. It must be importable by name if it runs in other processes.
    items : sequence
        Items, which must be picklable if the function runs in other processes.
    jobs : int, default 1
        Number of processes on this machine, or -1 for the number of cores. With 1, the function runs in this process.
    scheduler : str, optional
        Address of a Dask scheduler, such as "tcp://host:8786", instead of `jobs`.

    Yields
    ------
    index : int
        Index of the item. Each item is yielded exactly once.
    result : object or Failure
        Result of the function, or a `Failure` with the reason if the function raised or its process died.

    Raises
    ------
    ValueError
        If `jobs` is invalid, if `work` cannot be imported by other processes, or if the scheduler does not answer.
    RuntimeError
        If the Dask cluster fails.

    Notes
    -----
    If a process dies at an item, the item is tried again alone at the end. On a cluster, Dask passes the item to other
    workers. The result is a `Failure` if the process dies again, or if the item has ended four workers. With `jobs=1`
    the calling process ends.

    Examples
    --------
    >>> import math
    >>> import pdr_filter as pdr
    >>> dict(pdr.batch.each(math.sqrt, [4.0, -1.0]))
    {0: 2.0, 1: Failure(reason='math domain error')}
    """
    if jobs == 0 or jobs < -1:
        raise ValueError(f"jobs must be a positive number of processes, or -1 for all cores, got {jobs}")
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
    """Yield index and result of each item, computed by worker processes, in the order in which items finish.

    A thread for each process passes one item at a time, so that the item at which a process died is known. It is tried
    again alone at the end, because several large items at the same time can exhaust the memory. If the process dies
    again, the result is a `Failure`.
    """
    from joblib import cpu_count

    n_cores = int(cpu_count())
    n = min(n_cores if jobs == -1 else jobs, len(items))
    todo, results = deque(range(len(items))), SimpleQueue[tuple[int, Any]]()
    if getattr(getattr(work, "func", work), "__module__", "") == "__main__":  # `func` is that of a partial
        raise ValueError(
            f"{work!r} is defined in the main script, which other processes cannot import: move it to a module"
        )
    workers = [WorkerProcess(partial, _guarded, work, n_threads=max(n_cores // n, 1)) for _ in range(n)]

    def run(worker: WorkerProcess) -> None:
        with suppress(IndexError):
            while True:
                i = todo.popleft()
                try:
                    results.put((i, worker.ask(items[i])))
                except BaseException as error:  # any exception, because the loop below waits for this item
                    results.put((i, error))

    died: list[int] = []
    try:
        for worker in workers:
            # daemon threads, so that the program can end while an item is processed
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
                yield i, Failure(f"its {error}: {_CAUSE_OF_DEATH}")
    finally:
        todo.clear()
        for worker in workers:
            worker.close()


def _on_cluster(work: Callable[[T], R], items: Sequence[T], scheduler: str) -> Iterator[tuple[int, R | Failure]]:
    with dask_errors(scheduler):
        from distributed import Client, KilledWorker, as_completed

        client: Any = Client(scheduler, timeout=DASK_CONNECT_S, set_as_default=False)
    with client:
        # pure=False, because Dask would otherwise return the result of an earlier call for the same path
        futures: list[Any] = [client.submit(_on_worker, work, item, pure=False) for item in items]
        number = {future.key: i for i, future in enumerate(futures)}
        finished: Any = as_completed(futures, with_results=True, raise_errors=False, loop=client.loop)
        for future, result in finished:
            i = number.pop(future.key)
            if future.status == "finished":
                yield i, result
            elif isinstance(error := _exception(result), KilledWorker):
                # Dask raises this after four workers in a row have died with this item
                yield i, Failure(f"its worker processes died: {_CAUSE_OF_DEATH}")
            else:  # not caused by the recording: the scheduler has died, or the workers lack this package
                raise RuntimeError(f"the cluster at {scheduler} failed ({future.status}): {error!r}; check its workers")
            futures[i] = None  # release the result on the cluster


def _on_worker(work: Callable[[T], R], item: T) -> R | Failure:
    """Return the result of an item in a worker of a cluster."""
    keep_freed_memory()
    return _guarded(work, item)


# Numbers of the parameters of mallopt. The thresholds, in bytes, are those of glibc after large arrays were freed.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_TRIM_BYTES, _MMAP_BYTES = 64 * 1024**2, 32 * 1024**2


@cache
def keep_freed_memory() -> None:
    """Let the allocator of this process keep freed arrays, up to 64 MB, for the next ones.

    Dask starts its workers with MALLOC_TRIM_THRESHOLD_=65536, so that each freed array goes back to the system, and
    each new one is filled with zeros again: 34,000 page faults and a third more processor time for two minutes of
    samples. Without glibc nothing is done.
    """
    with suppress(OSError, AttributeError):
        libc = ctypes.CDLL("libc.so.6")
        libc.mallopt(_M_MMAP_THRESHOLD, _MMAP_BYTES)
        libc.mallopt(_M_TRIM_THRESHOLD, _TRIM_BYTES)


def _exception(result: Any) -> Any:
    """Return the exception of a failed future, whose result is (type, value, traceback)."""
    return result[1] if isinstance(result, tuple) and len(result) > 1 else result
