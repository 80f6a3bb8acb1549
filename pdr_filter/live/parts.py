"""One share of the devices, where it filters: in a process of this machine or in an actor of a cluster.

It answers requests in their order, and says with each answer what there is to show.
"""

from __future__ import annotations

import json
import signal
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from pdr_filter.live.messages import MessageError
from pdr_filter.live.settings import BusyError, Event, FixError, Settings


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
class Tick:
    """Time to save what has grown, and to forget who is silent."""


@dataclass(frozen=True, slots=True)
class Save:
    """The last request: save everything."""


Request = Take | Whole | Tick | Save


@dataclass(frozen=True, slots=True)
class Answer:
    """Status as of HTTP, and what is said."""

    status: int
    content: Any


@dataclass(frozen=True, slots=True)
class Said:
    """An answer, and the events that go with it, as JSON."""

    answer: Answer
    events: list[str]


class Part:
    """The devices of one share.

    Parameters
    ----------
    settings : Settings
        How phones are tracked.
    folder : Path
        Of all sessions, of every part.
    part, n_parts : int
        Which of so many.
    """

    def __init__(self, settings: Settings, folder: Path, part: int, n_parts: int) -> None:
        from pdr_filter.live.devices import Devices  # the filter is loaded here, and not where phones are answered

        if not folder.is_dir():
            raise ValueError(f"no folder {folder} here: the server and all workers need the same one")
        self._events: list[str] = []
        self._devices = Devices(settings, folder, self._emit, part, n_parts)

    def _emit(self, event: Event) -> None:
        self._events.append(json.dumps(event, allow_nan=False))

    def answer(self, requests: Sequence[Request]) -> list[Said]:
        """What is said to each request."""
        said: list[Said] = []
        for request in requests:
            answer = self._answer(request)
            said.append(Said(answer, self._events))
            self._events = []
        return said

    def _answer(self, request: Request) -> Answer:
        devices = self._devices
        if isinstance(request, Take):
            return self._taken(request)
        if isinstance(request, Whole):
            return Answer(200, [event for session in devices.sessions.values() for event in session.whole()])
        if isinstance(request, Tick):
            devices.tick()
        else:
            devices.close()
        return Answer(200, None)

    def _taken(self, request: Take) -> Answer:
        try:
            taken = self._devices.take(
                request.body, request.device, request.session, request.platform, request.received_s
            )
        except MessageError as error:
            return Answer(400, {"error": str(error)})
        except FixError as error:
            return Answer(409, {"error": str(error)})
        except BusyError as error:
            return Answer(503, {"error": str(error)})
        except ValueError as error:
            return Answer(422, {"error": str(error)})
        return Answer(200, taken)


def serve(connection: Connection, settings: Settings, folder: Path, part: int, n_parts: int) -> None:
    """The loop of a process: requests in, what is said out, until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the terminal; the server says when to end
    devices = Part(settings, folder, part, n_parts)
    try:
        connection.send([])  # ready
        while True:
            connection.send(devices.answer(connection.recv()))
    except (EOFError, OSError):
        devices.answer([Save()])
