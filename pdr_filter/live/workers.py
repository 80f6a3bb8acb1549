"""Processes that filter, so that the one that answers phones and pages never waits: each has its share of the devices.

A worker that dies is started again and goes on from what its devices saved; what it had not answered is given to it
again, and what it had taken already is recognised by the number or the time of the messages.
"""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from pdr_filter.live.messages import MessageError
from pdr_filter.live.settings import BusyError, Event, FixError, Settings, part_of

if TYPE_CHECKING:
    from pdr_filter.live.devices import Devices

# Requests that wait for one worker at most: a second of 200 phones that send five times a second.
_MAX_WAITING = 1000
# Tries for one request: a message that kills its worker must not do so for ever.
_MAX_TRIES = 2
_START_S = 60.0


@dataclass(frozen=True, slots=True)
class Take:
    """A body of a device, as it was received."""

    body: bytes
    device: str
    session: str = ""
    platform: str = ""
    received_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Whole:
    """The question for all sessions, with their paths and what is known of now."""


@dataclass(frozen=True, slots=True)
class Stop:
    """The last request: save everything and end."""


Request = Take | Whole | Stop


@dataclass(frozen=True, slots=True)
class Answer:
    """Status as of HTTP, and what is said."""

    status: int
    content: Any


def serve(connection: Connection, settings: Settings, folder: Path, part: int, n_parts: int) -> None:
    """The loop of a worker: requests in, answers and events out, until the other end is closed."""
    from pdr_filter.live.devices import Devices  # the filter is loaded here, and not where phones are answered

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the terminal; the server says when to end

    def emit(event: Event) -> None:
        connection.send((None, json.dumps(event, allow_nan=False)))

    devices = Devices(settings, folder, emit, part, n_parts)
    connection.send((None, ""))  # ready
    ticked_at = time.monotonic()
    while True:
        try:
            if connection.poll(1.0):
                number, request = connection.recv()
                if isinstance(request, Stop):
                    raise EOFError
                connection.send((number, _answer(devices, request)))
        except (EOFError, OSError):
            devices.close()
            return
        if time.monotonic() - ticked_at > 1.0:
            devices.tick()
            ticked_at = time.monotonic()


def _answer(devices: Devices, request: Take | Whole) -> Answer:
    if isinstance(request, Whole):
        return Answer(200, [event for session in devices.sessions.values() for event in session.whole()])
    try:
        content = devices.take(request.body, request.device, request.session, request.platform, request.received_s)
        return Answer(200, content)
    except MessageError as error:
        return Answer(400, {"error": str(error)})
    except FixError as error:
        return Answer(409, {"error": str(error)})
    except BusyError as error:
        return Answer(503, {"error": str(error)})
    except ValueError as error:
        return Answer(422, {"error": str(error)})


class _Worker:
    """One process and the requests that it has not answered."""

    def __init__(self, make: Callable[[], tuple[Any, Connection]], show: Callable[[str], None]) -> None:
        self._make, self._show = make, show
        self._loop = asyncio.get_running_loop()
        self._waiting: dict[int, tuple[Request, asyncio.Future[Answer], int]] = {}
        self._number = 0
        self._closed = False
        self.restarts = 0
        self._start()

    @property
    def pid(self) -> int:
        """Of the process that runs now."""
        return int(self.process.pid)

    async def ask(self, request: Request) -> Answer:
        """The answer to a request, from the process that has it or from the next one."""
        if len(self._waiting) >= _MAX_WAITING:
            return Answer(503, {"error": "too much at once; send it again later"})
        self._number += 1
        future: asyncio.Future[Answer] = self._loop.create_future()
        number = self._number
        self._waiting[number] = request, future, 1
        self._outbox.put((number, request))
        try:
            return await future
        finally:
            self._waiting.pop(number, None)

    def close(self) -> None:
        """End the process, which saves everything."""
        self._closed = True
        self._outbox.put((0, Stop()))
        self._outbox.put(None)
        self.process.join(_START_S)

    def _start(self) -> None:
        self.process, self._connection = self._make()
        self._outbox: SimpleQueue[tuple[int, Request] | None] = SimpleQueue()
        self.ready = asyncio.Event()
        threading.Thread(target=self._send, args=(self._connection, self._outbox), daemon=True).start()
        threading.Thread(target=self._receive, args=(self._connection,), daemon=True).start()

    def _send(self, connection: Connection, outbox: SimpleQueue[tuple[int, Request] | None]) -> None:
        while (item := outbox.get()) is not None:
            try:
                connection.send(item)
            except OSError:  # the process is gone; who receives from it starts the next one
                return

    def _receive(self, connection: Connection) -> None:
        while True:
            try:
                number, content = connection.recv()
            except (EOFError, OSError):
                break
            self._loop.call_soon_threadsafe(self._received, number, content)
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._gone)

    def _received(self, number: int | None, content: Any) -> None:
        if number is not None:
            _, future, _ = self._waiting.get(number, (None, None, 0))
            if future is not None and not future.done():
                future.set_result(content)
        elif content:
            self._show(content)
        else:
            self.ready.set()

    def _gone(self) -> None:
        if self._closed:
            return
        self.restarts += 1
        self._outbox.put(None)
        self._start()
        for number, (request, future, n_tries) in list(self._waiting.items()):
            if n_tries >= _MAX_TRIES:
                if not future.done():
                    future.set_result(Answer(500, {"error": "this message ended the process that took it, twice"}))
                continue
            self._waiting[number] = request, future, n_tries + 1
            self._outbox.put((number, request))


class Workers:
    """All of them; made inside of a running event loop."""

    def __init__(self, settings: Settings, folder: Path, n: int, show: Callable[[str], None]) -> None:
        context = multiprocessing.get_context("spawn")

        def made(part: int) -> tuple[Any, Connection]:
            ours, theirs = context.Pipe()
            process = context.Process(target=serve, args=(theirs, settings, folder, part, n), daemon=True)
            process.start()
            theirs.close()
            return process, ours

        def maker(part: int) -> Callable[[], tuple[Any, Connection]]:
            return lambda: made(part)

        self.workers = [_Worker(maker(part), show) for part in range(n)]

    async def ready(self) -> None:
        """Return when all of them take messages."""
        await asyncio.wait_for(asyncio.gather(*(w.ready.wait() for w in self.workers)), _START_S)

    async def take(self, request: Take) -> Answer:
        """What the worker of a device says to its message."""
        return await self.workers[part_of(request.device, len(self.workers))].ask(request)

    async def whole(self) -> list[Event]:
        """All there is to show: of each session its path, and what is known of now."""
        answers = await asyncio.gather(*(worker.ask(Whole()) for worker in self.workers))
        return [event for answer in answers for event in answer.content]

    def close(self) -> None:
        """End all of them."""
        for worker in self.workers:
            worker.close()
