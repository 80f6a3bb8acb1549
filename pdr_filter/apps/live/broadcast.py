"""Events of a server, sent as text to all connected pages and clients.

An event is a JSON object with `event`, its kind, and `id`, the session. A reader gets the present state first, then the
changes. A reader that is too slow loses events and then gets `track`, `path` and `now` again. After 15 s without an
event, `/ws` sends an empty object and `/events` a comment.

- `session`: `device`, `session`, `begun_unix_s`, `origin` (latitude and longitude, or null), `frame` ("start",
  "heading fixes", "north" or "fixes"), `has_location`, `force` (sensor and sign of the specific force), `waits` (reason
  why there is no track yet), `refused` (reason why the session cannot be tracked), `has_ended`, `notes`,
  `n_lost_messages`, `n_repeated_messages`.
- `track`: the fields of `session`, `silent_s` (time since the last message) and `path`: rows of time, east, north and
  the covariance ee, en, nn after each step. The path replaces all earlier rows. A new reader also gets `history`: time,
  contexts and walking speed of the last five minutes.
- `path`: rows of time, east and north of the current estimate of the path (`OnlineFilter.path`). The event is sent
  after corrections of more than 1 m, at most every two seconds.
- `step`: the fields of `StepUpdate.to_dict`. A step with a known `index` replaces the earlier one.
- `fix`: the fields of `FixResult.to_dict`. A fix of a user is sent first with the outcome "waiting" and `east_m`,
  `north_m` and `std_m` (`range_m` for a range), and again when it is used.
- `now`: the fields of `OnlineFilter.now`, `received_unix_s` of the last message, and `silent_s`, at most five times a
  second.
- `gone`: the phone has been silent for ten minutes.
- `server`, every two seconds and without `id`: over half a minute, `messages_per_s`, `bytes_per_s` and `answer_s` (mean
  time until a message was answered, or null); since the start, `n_refused` by HTTP status; `refusal`, the device and
  the reason of the last one; `disk_left_bytes`, `disk_left_s` (time until the disk is full at this rate, or at that of
  one phone if this is lower) and `is_disk_low` (true for less than an hour).
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable

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

    async def events(self, present: Callable[[], Awaitable[Iterable[str]]]) -> AsyncIterator[str]:
        """Yield the events of `present`, then each event that is sent, and an empty text from time to time.

        `present` returns the present state as events. It is called again for a reader that was too slow.
        """
        reader = Reader()
        self._readers.add(reader)
        try:
            while not self._is_ending:
                if reader.is_stale:
                    reader.clear()
                    for text in await present():
                        yield text
                text = await reader.get()
                if not self._is_ending:
                    yield text
        finally:
            self._readers.discard(reader)


class Reader:
    """Bounded queue of events for one page or client."""

    def __init__(self) -> None:
        self.is_stale = True  # the client was too slow, and needs the present state
        self._waiting: asyncio.Queue[str] = asyncio.Queue()

    def __len__(self) -> int:
        return self._waiting.qsize()

    def put(self, text: str) -> None:
        """Add an event; a full queue is emptied first."""
        if len(self) >= _MAX_WAITING:
            self.clear()
            self.is_stale = True
        self._waiting.put_nowait(text)

    def clear(self) -> None:
        """Empty the queue before the present state is sent."""
        self.is_stale = False
        self._waiting = asyncio.Queue()  # nothing waits for an item of a queue that is not empty

    async def get(self) -> str:
        """Return the next event; "" after some time without one, or if the reader needs the present state."""
        try:
            text = self._waiting.get_nowait() if len(self) else await asyncio.wait_for(self._waiting.get(), _ALIVE_S)
        except TimeoutError:
            return ""
        return "" if self.is_stale else text
