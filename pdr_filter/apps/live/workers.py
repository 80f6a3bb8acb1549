"""Worker processes that run the filters, so that the web server never blocks. Each serves a fixed share of the devices.

A share is in a process of this machine, or in an actor of a Dask cluster (`apps.live.cluster`). A share that dies is
started again and goes on from the files of its devices. Requests without an answer are given to it again; messages that
it had already taken are recognised by their number or content.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Protocol

from pdr_filter.apps.batch.worker_process import LostError, WorkerProcess
from pdr_filter.apps.live.messages import MessageBatch
from pdr_filter.apps.live.parts import Answer, Command, Request, Response, answers_of_part
from pdr_filter.apps.live.settings import Settings, worker_of

# Requests that wait for one worker at most: a second of 200 phones that send five times a second.
_MAX_WAITING = 1000
# Requests that are given at once: the way there and back costs an actor some milliseconds, and messages of one phone
# among them are filtered in one pass. The first of them waits for the answer to the last.
_AT_ONCE = 32
# Tries for one request: a message that kills its worker must not do so for ever.
_MAX_TRIES = 2
_TICK_S = 1.0
# A start loads all sessions, up to a second each on a slow machine. A process that dies meanwhile is noticed at once.
_START_S, _CLOSE_S = 180.0, 20.0
# Between two tries to start a share: the reason may last, and each try loads the filter.
_LONGEST_WAIT_S = 30.0
# Phones wait for an answer as long as a worker takes to start; most apps give up after half a minute.
_PATIENCE_S = 10.0

_LOG = logging.getLogger(__package__)


class Share(Protocol):
    """Interface of a worker that serves a share of the devices and their sessions."""

    async def ask(self, requests: Sequence[Request]) -> list[Response]:
        """Return an answer to each request. LostError if the process or actor has died. Calls must not overlap."""
        ...

    async def close(self) -> None:
        """Save all sessions and end the share."""
        ...


class Process(Share):
    """Worker process on this computer that serves a share of the devices."""

    def __init__(self, settings: Settings, folder: Path, part: int, n_parts: int) -> None:
        self._process = WorkerProcess(answers_of_part, settings, folder, part, n_parts)

    @classmethod
    async def start(cls, settings: Settings, folder: Path, part: int, n_parts: int) -> Process:
        """Return a new process that is ready for requests."""
        made = cls(settings, folder, part, n_parts)
        try:
            await made.ask([])
        except BaseException:  # also if the caller waits no longer: two processes must not write the same sessions
            made._process.close()
            raise
        return made

    async def ask(self, requests: Sequence[Request]) -> list[Response]:
        return await self._process.answer(requests)

    async def close(self) -> None:
        await self.ask([Command.SAVE])
        self._process.close()


@dataclass(slots=True, eq=False)
class _Waiting:
    """Request that has not been answered yet."""

    request: Request
    answered: asyncio.Future[Answer]
    n_tries: int = 0


class _Worker:
    """Queue of requests for a share of the devices. If the share dies, a new one replaces it."""

    def __init__(self, start: Callable[[], Awaitable[Share]], show: Callable[[str], None]) -> None:
        self._start, self._show = start, show
        self._waiting: deque[_Waiting] = deque()
        self._filled = asyncio.Event()
        self._closed = False
        self._n_alone = 0  # requests that are given alone, because one of them may be what ended the last share
        self._running: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Start the process that serves this worker's share, and show its sessions.

        TimeoutError if it is not ready within `_START_S`.
        """
        share = await asyncio.wait_for(self._start(), _START_S)
        self._running = asyncio.create_task(self._run(share))
        await self.ask(Command.MAINTAIN)

    async def ask(self, request: Request) -> Answer:
        """Return the answer to a request, with status 503 if too many requests wait or the worker is closed."""
        if len(self._waiting) >= _MAX_WAITING or self._closed:
            return Answer(503, {"error": "too much at once; send it again later"})
        waiting = _Waiting(request, asyncio.get_running_loop().create_future())
        self._waiting.append(waiting)
        self._filled.set()
        return await waiting.answered

    async def close(self) -> None:
        """End the share after all requests are answered."""
        self._closed = True
        self._filled.set()
        if self._running is not None:
            with suppress(TimeoutError):  # a lost share may find no place to start
                await asyncio.wait_for(self._running, _CLOSE_S)

    async def _run(self, share: Share) -> None:
        """Pass requests to the share, or to its replacement after it died, until the worker is closed."""
        ticked_at = time.monotonic()
        while self._waiting or not self._closed:
            batch = list(islice(self._waiting, 1 if self._n_alone else _AT_ONCE))
            requests = [waiting.request for waiting in batch]
            if time.monotonic() - ticked_at > _TICK_S:
                requests.append(Command.MAINTAIN)
                ticked_at = time.monotonic()
            if not requests:
                self._filled.clear()
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._filled.wait(), _TICK_S)
                continue
            try:
                said = await share.ask(requests)
            except LostError as error:
                _LOG.warning("%s; its phones go on elsewhere", error)
                self._lost(batch)
                share = await self._restart()
                continue
            self._n_alone = max(self._n_alone - len(batch), 0)
            for one in said:
                for event in one.events:
                    self._show(event)
            for waiting, one in zip(batch, said, strict=False):  # a tick has no caller
                self._answered(waiting, one.answer)
        with suppress(LostError):
            await share.close()

    def _answered(self, waiting: _Waiting, answer: Answer) -> None:
        self._waiting.remove(waiting)
        if not waiting.answered.done():  # the caller may have been cancelled
            waiting.answered.set_result(answer)

    def _lost(self, batch: Sequence[_Waiting]) -> None:
        """Count one attempt for each request that a share had not answered when it died.

        The requests are then given one at a time. A request that ended a share when it was given alone, and that was
        given twice, is answered with status 500.
        """
        self._n_alone = len(batch)
        for waiting in batch:
            waiting.n_tries += 1
        if len(batch) == 1 and batch[0].n_tries >= _MAX_TRIES:
            self._answered(batch[0], Answer(500, {"error": "this message ended the process that took it, twice"}))

    async def _restart(self) -> Share:
        """Start a new share, however long this takes.

        After a while, requests are refused, so that phones do not wait for an answer.
        """
        wait_s, begun = _TICK_S, time.monotonic()
        while True:
            starting = asyncio.create_task(asyncio.wait_for(self._start(), _START_S))
            try:
                while not starting.done():
                    await asyncio.wait([starting], timeout=_TICK_S)
                    self._refuse_after_patience(begun)
                return starting.result()
            except (LostError, TimeoutError, ValueError) as error:
                _LOG.warning("no worker yet: %s", error)
            finally:
                starting.cancel()  # if this is cancelled itself
            await asyncio.sleep(wait_s)
            wait_s = min(2 * wait_s, _LONGEST_WAIT_S)

    def _refuse_after_patience(self, begun: float) -> None:
        is_long = time.monotonic() - begun > _PATIENCE_S
        for waiting in list(self._waiting) if is_long else ():
            self._answered(waiting, Answer(503, {"error": "no worker at present; send it again later"}))


# Starts the share with this number, of so many.
Starter = Callable[[int, int], Awaitable[Share]]


class Workers:
    """All workers of the server."""

    def __init__(self, start: Starter, n: int, show: Callable[[str], None]) -> None:
        def starter(part: int) -> Callable[[], Awaitable[Share]]:
            return lambda: start(part, n)

        self._workers = [_Worker(starter(part), show) for part in range(n)]

    async def start(self) -> None:
        """Start all workers, and return when they are ready."""
        await asyncio.gather(*(worker.start() for worker in self._workers))

    async def take(self, request: MessageBatch) -> Answer:
        """Return the answer of the worker of a device to its message."""
        return await self._workers[worker_of(request.device, len(self._workers))].ask(request)

    async def snapshots(self) -> list[str]:
        """Return the events with the path and the present estimate of each session, as JSON texts."""
        answers = await asyncio.gather(*(worker.ask(Command.LIST) for worker in self._workers))
        return [event for answer in answers if answer.status == 200 for event in answer.content]

    async def close(self) -> None:
        """End all workers."""
        await asyncio.gather(*(worker.close() for worker in self._workers))
