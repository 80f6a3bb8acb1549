"""Events of a server, sent as text to all connected pages and clients."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable

from pdr_filter.live.settings import Event

# Events that wait for one reader at most: some seconds of many phones. A slower reader gets the present state again.
_MAX_WAITING = 500
_MAX_READERS = 100
_ALIVE_S = 15.0


class Broadcast:
    """Event streams of all connected pages and clients."""

    def __init__(self) -> None:
        self._readers: set[Reader] = set()
        self._is_ending = False

    def __len__(self) -> int:
        return len(self._readers)

    @property
    def is_full(self) -> bool:
        """True if the largest number of readers is connected."""
        return len(self._readers) >= _MAX_READERS

    def send(self, text: str) -> None:
        """Send an event, as JSON text, to all readers."""
        for reader in self._readers:
            reader.put(text)

    def end(self) -> None:
        """End all event streams, so that the server can stop without cutting connections."""
        self._is_ending = True
        self.send("")

    async def events(self, present: Callable[[], Awaitable[Iterable[Event]]]) -> AsyncIterator[str]:
        """Yield the events of `present`, then each event that is sent, and an empty text from time to time.

        `present` returns the present state as events. It is called again for a reader that was too slow.
        """
        reader = Reader()
        self._readers.add(reader)
        try:
            while not self._is_ending:
                if reader.is_stale:
                    reader.clear()
                    for event in await present():
                        yield json.dumps(event, allow_nan=False)
                text = await reader.get()
                if not self._is_ending:
                    yield text
        finally:
            self._readers.discard(reader)


class Reader:
    """Bounded queue of events for one page or client.

    `is_stale` is True if the client was too slow. It then needs the present state.
    """

    def __init__(self) -> None:
        self.is_stale = True
        self._waiting: deque[str] = deque()
        self._filled = asyncio.Event()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, text: str) -> None:
        """Add an event; a full queue is emptied first."""
        if len(self._waiting) >= _MAX_WAITING:
            self.is_stale = True
            self._waiting.clear()
        self._waiting.append(text)
        self._filled.set()

    def clear(self) -> None:
        """Empty the queue before the present state is sent."""
        self.is_stale = False
        self._waiting.clear()

    async def get(self) -> str:
        """Return the next event; "" after some time without one, or if the reader needs the present state."""
        if not self._waiting:
            self._filled.clear()
            try:
                await asyncio.wait_for(self._filled.wait(), _ALIVE_S)
            except TimeoutError:
                return ""
        return "" if self.is_stale else self._waiting.popleft()
