"""Worker process that answers one request at a time, for batches of recordings and for the live server."""

from __future__ import annotations

import asyncio
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from queue import SimpleQueue
from threading import Thread
from typing import Any, cast

Answering = Callable[[Any], Any]

_MAX_REASON = 500
DASK_CONNECT_S = 20.0
# Variables that limit the threads of numerical libraries, which would otherwise use all cores in each process.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


class LostError(ConnectionError):
    """Error for a worker process that has died or does not answer."""


class WorkerProcess:
    """Process that answers requests with a function, which the process creates by calling `make(*arguments)`.

    The process imports `make` by name and does not import the main module of its parent, so that scripts need no
    `__main__` guard. `n_threads` limits the threads of numerical libraries unless the environment sets them. The first
    request starts the process, and the first request after its death starts it again. Parent and process communicate
    by pipes that no other process holds. The death of one side therefore closes the pipe of the other, and a kill
    leaves no lock behind.
    """

    def __init__(self, make: Callable[..., Answering], *arguments: Any, n_threads: int | None = None) -> None:
        self._begin = pickle.dumps((make, arguments))
        threads = {} if n_threads is None else dict.fromkeys(_THREADS, str(n_threads))
        self._environment = {**threads, **os.environ}
        self._process: subprocess.Popen[bytes] | None = None
        self._is_closed = False
        self._asking = ThreadPoolExecutor(1)  # not the shared pool, in which other calls may block

    async def answer(self, request: Any) -> Any:
        """Return the answer to a request as `ask` does, while other tasks run."""
        return await asyncio.get_running_loop().run_in_executor(self._asking, self.ask, request)

    def ask(self, request: Any) -> Any:
        """Return the answer to a request. LostError if the process dies before it answers. Calls must not overlap."""
        pieces = [pickle.dumps(request)]
        if self._process is None:
            command = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve()"
            pipe, environment = subprocess.PIPE, self._environment
            self._process = subprocess.Popen([sys.executable, "-c", command], stdin=pipe, stdout=pipe, env=environment)
            pieces.insert(0, self._begin)
        if self._is_closed:  # another thread has called `close`
            self._end()
            raise LostError("worker process was closed by another thread")
        to, answers = cast(Any, self._process.stdin), cast(Any, self._process.stdout)
        try:
            for piece in pieces:
                pickle.dump(piece, to)
            to.flush()
            return pickle.load(answers)
        except (OSError, EOFError, pickle.UnpicklingError) as error:
            raise LostError(f"worker process died (exit code {self._end()})") from error

    def close(self) -> None:
        """End the process permanently. This may be called from any thread."""
        self._is_closed = True
        self._end()
        self._asking.shutdown(wait=False)

    def _end(self) -> int | None:
        """End the process and return its exit code, or None if no process runs."""
        process, self._process = self._process, None
        if process is None:
            return None
        with suppress(OSError), process:  # closing the input fails if the process died before reading all of it
            process.kill()
        return process.returncode


def serve() -> None:
    """Run the loop of a worker process: requests from standard input, answers to standard output."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl+C reaches all processes of a terminal; the parent ends this one
    sources, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # printed text must not mix with the answers
    pieces = SimpleQueue[bytes]()

    def read() -> None:
        try:
            while True:
                pieces.put(pickle.load(sources))
        finally:  # the parent has ended, so that nothing waits for the answer
            os._exit(1)

    Thread(target=read, daemon=True).start()
    make, arguments = pickle.loads(pieces.get())
    answer = make(*arguments)
    while True:
        found = answer(pickle.loads(pieces.get()))
        sys.stdout.flush()  # the process ends without it when its parent does
        pickle.dump(found, answers)
        answers.flush()


@contextmanager
def dask_errors(scheduler: str) -> Generator[None]:
    """Context manager that turns errors of Dask in its block into a ValueError with a remedy.

    An ImportError means that Dask is not installed. An OSError, TimeoutError or ValueError means that no scheduler
    answers at the address `scheduler`.
    """
    try:
        yield
    except ImportError as error:
        raise ValueError("scheduler needs Dask, which is not installed: pip install 'dask[distributed]'") from error
    except (OSError, TimeoutError, ValueError) as error:
        raise ValueError(
            f"no Dask scheduler at {scheduler} ({reason_of(error)}): check the address, and that it runs"
        ) from error


def reason_of(error: BaseException) -> str:
    """Return the message of an error in one line, with the kind of error unless it is a ValueError with a message."""
    text = " ".join(str(error).split())
    if not isinstance(error, ValueError) or not text:
        text = f"{type(error).__name__}: {text}".rstrip(": ")
    return text if len(text) <= _MAX_REASON else text[: _MAX_REASON - 3] + "..."
