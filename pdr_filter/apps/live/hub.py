"""Hub of the server: bodies of phones go to the workers, and events of the workers go to all readers."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator
from contextlib import suppress
from functools import partial
from pathlib import Path

from pdr_filter.apps.live.access import MAX_BODY_BYTES, Rates
from pdr_filter.apps.live.broadcast import Broadcast
from pdr_filter.apps.live.cluster import DaskCluster
from pdr_filter.apps.live.messages import MessageBatch, MessageError, parse
from pdr_filter.apps.live.parts import Answer
from pdr_filter.apps.live.settings import Event, Settings
from pdr_filter.apps.live.traffic import REPORT_S, Traffic
from pdr_filter.apps.live.workers import Process, Starter, Workers


class Live:
    """State of a running server that all its requests share."""

    def __init__(self, settings: Settings, folder: Path, n_workers: int = 1, scheduler: str = "") -> None:
        self.settings, self.folder, self.n_workers, self.scheduler = settings, folder, n_workers, scheduler
        self.rates = Rates()
        self.sessions: dict[str, Event] = {}
        self.broadcast = Broadcast()
        self.traffic = Traffic(folder)
        self._reporting: asyncio.Task[None] | None = None
        self._workers: Workers | None = None
        self._cluster: DaskCluster | None = None

    @property
    def workers(self) -> Workers:
        """Workers of the running server; RuntimeError before it runs."""
        if self._workers is None:
            raise RuntimeError("the server does not run: call start() before, or do not use it after its end")
        return self._workers

    async def start(self) -> None:
        """Start the workers, which load recent sessions; ValueError if one cannot start."""
        start: Starter = partial(Process.start, self.settings, self.folder)
        if self.scheduler:
            self._cluster = DaskCluster(self.scheduler, self.settings, self.folder)
            await self._cluster.connect()
            start = self._cluster.start
        self._workers = Workers(start, self.n_workers, self._shown)
        await self._workers.start()
        self._reporting = asyncio.create_task(self._report())

    async def tracks(self) -> dict[str, Event]:
        """`track` events of all sessions, by the id of the session."""
        events = map(json.loads, await self.workers.snapshots())
        return {event["id"]: event for event in events if event["event"] == "track"}

    async def stop(self) -> None:
        """Save all sessions and end the workers."""
        if self._reporting is not None:
            self._reporting.cancel()
        if self._workers is not None:
            await self._workers.close()
        if self._cluster is not None:
            await self._cluster.close()

    async def take(self, body: bytes | None, device: str = "", session: str = "", platform: str = "") -> Answer:
        """Pass the messages in the body of a request to the worker of their device, and return its answer.

        None stands for a body that was too long to be read. `device`, `session` and `platform` are used for messages
        that do not contain them.
        """
        begun_s = time.monotonic()
        name, answer = await self._answer(body, device, session, platform)
        self.traffic.add(len(body or b""), name, answer, time.monotonic() - begun_s)
        return answer

    async def _answer(self, body: bytes | None, device: str, session: str, platform: str) -> tuple[str, Answer]:
        """Return the name of the device that sent a body, and the answer to it."""
        if body is None or len(body) > MAX_BODY_BYTES:
            return device, Answer(413, {"error": f"more than {MAX_BODY_BYTES} bytes in one message; send smaller ones"})
        try:
            messages = parse(body, device, session, platform)
        except MessageError as error:
            return device, Answer(400, {"error": str(error)})
        names = {message.device for message in messages}
        if len(names) > 1:
            return device, Answer(400, {"error": "one body is of one device; send messages of different devices apart"})
        name = next(iter(names), device)
        if not self.rates.allows(name, len(body)):
            return name, Answer(429, {"error": f"{name} sends too much; a phone may send 1 MB a second"})
        return name, await self.workers.take(MessageBatch(name, messages, time.time()))

    def _shown(self, text: str) -> None:
        """Pass an event of a worker on to all pages and clients. The last `session` event of each session is kept."""
        head = json.loads(text[: text.index(",")] + "}")["event"]
        if head in ("session", "gone"):
            event = json.loads(text)
            if head == "gone":
                self.sessions.pop(event["id"], None)
            else:
                self.sessions[event["id"]] = event
        self.broadcast.send(text)

    def events(self) -> AsyncIterator[str]:
        """Yield the present state of all sessions, then each event, and an empty text now and then between events."""
        return self.broadcast.events(self.workers.snapshots)

    async def _report(self) -> None:
        """Send a `server` event to all pages and clients every `REPORT_S`."""
        while True:
            await asyncio.sleep(REPORT_S)
            with suppress(OSError):  # the folder is on a drive that does not answer
                self.broadcast.send(json.dumps(await asyncio.to_thread(self.traffic.event)))
