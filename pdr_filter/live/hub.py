"""What phones send goes to the workers, what the workers say goes to all who read: a server without its addresses."""

from __future__ import annotations

import asyncio
import json
import time
from collections import deque
from collections.abc import AsyncIterator
from functools import partial
from pathlib import Path

from pdr_filter.live.access import MAX_BODY_BYTES, Rates
from pdr_filter.live.cluster import Cluster
from pdr_filter.live.messages import MessageError, devices_of
from pdr_filter.live.parts import Answer, Take
from pdr_filter.live.settings import Event, Settings
from pdr_filter.live.workers import Process, Starter, Workers

# Events that wait for one reader at most: some seconds of many phones. Who reads slower gets the whole anew.
_MAX_WAITING = 500
_MAX_READERS = 100
_ALIVE_S = 15.0


class Live:
    """What the parts of a running server share."""

    def __init__(self, settings: Settings, folder: Path, n_workers: int = 1, scheduler: str = "") -> None:
        self.settings, self.folder, self.n_workers, self.scheduler = settings, folder, n_workers, scheduler
        self.rates = Rates()
        self.sessions: dict[str, Event] = {}
        self._readers: set[Reader] = set()
        self._is_ending = False
        self._workers: Workers | None = None
        self._cluster: Cluster | None = None

    @property
    def workers(self) -> Workers:
        """Of the server while it runs."""
        if self._workers is None:
            raise RuntimeError("the server does not run")
        return self._workers

    async def start(self) -> None:
        """Start the workers, which go on with the sessions that they find; ValueError if that cannot be."""
        start: Starter = partial(Process.start, self.settings, self.folder)
        if self.scheduler:
            self._cluster = Cluster(self.scheduler, self.settings, self.folder)
            await self._cluster.connect()
            start = self._cluster.start
        self._workers = Workers(start, self.n_workers, self._shown)
        await self._workers.start()
        without = ("path", "history", "silent_s")
        for key, track in (await self.tracks()).items():
            self.sessions[key] = {n: v for n, v in track.items() if n not in without} | {"event": "session"}

    async def tracks(self) -> dict[str, Event]:
        """Sessions with their paths, by their names."""
        return {event["id"]: event for event in await self.workers.whole() if event["event"] == "track"}

    async def stop(self) -> None:
        """Save everything."""
        if self._workers is not None:
            await self._workers.close()
        if self._cluster is not None:
            await self._cluster.close()

    async def take(self, body: bytes, device: str = "", session: str = "", platform: str = "") -> Answer:
        """Answer to the body of a message; `device` and the others are for messages that do not hold them."""
        if len(body) > MAX_BODY_BYTES:
            return Answer(413, {"error": f"more than {MAX_BODY_BYTES} bytes in one message; send smaller ones"})
        try:
            names = devices_of(body, device)
        except MessageError as error:
            return Answer(400, {"error": str(error)})
        if len(names) > 1:
            return Answer(400, {"error": "one body is of one device; send messages of different devices apart"})
        name = next(iter(names), device)
        if not self.rates.allows(name, len(body)):
            return Answer(429, {"error": f"{name} sends too much; a phone may send 1 MB a second"})
        return await self.workers.take(Take(body, name, session, platform, time.time()))

    def _shown(self, text: str) -> None:
        """An event of a worker, to all who read."""
        head = json.loads(text[: text.index(",")] + "}")["event"]
        if head in ("session", "gone"):
            event = json.loads(text)
            if head == "gone":
                self.sessions.pop(event["id"], None)
            else:
                self.sessions[event["id"]] = event
        for reader in self._readers:
            reader.put(text)

    def end_readers(self) -> None:
        """End the events of all readers, so that a server that is to end need not cut them off."""
        self._is_ending = True
        for reader in self._readers:
            reader.put("")

    @property
    def is_full(self) -> bool:
        """Whether as many read as may."""
        return len(self._readers) >= _MAX_READERS

    async def events(self) -> AsyncIterator[str]:
        """Everything there is to show, from the whole as it is now; "" now and then while there is nothing."""
        reader = Reader()
        self._readers.add(reader)
        try:
            while True:
                if reader.is_stale:
                    reader.clear()
                    for event in await self.workers.whole():
                        yield json.dumps(event, allow_nan=False)
                text = await reader.get()
                if self._is_ending:
                    return
                yield text
        finally:
            self._readers.discard(reader)


class Reader:
    """What waits for one who reads events; it is bounded, and who is too slow is told so by `is_stale`."""

    def __init__(self) -> None:
        self.is_stale = True
        self._waiting: deque[str] = deque()
        self._filled = asyncio.Event()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, text: str) -> None:
        """Add an event, or forget them all."""
        if len(self._waiting) >= _MAX_WAITING:
            self.is_stale = True
            self._waiting.clear()
        self._waiting.append(text)
        self._filled.set()

    def clear(self) -> None:
        """Begin anew."""
        self.is_stale = False
        self._waiting.clear()

    async def get(self) -> str:
        """The next event; "" after some time without one, or where there is a new beginning."""
        if not self._waiting:
            self._filled.clear()
            try:
                await asyncio.wait_for(self._filled.wait(), _ALIVE_S)
            except TimeoutError:
                return ""
        return "" if self.is_stale else self._waiting.popleft()
