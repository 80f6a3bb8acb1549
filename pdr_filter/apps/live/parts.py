"""Share of the devices that one worker process or one actor of a cluster serves.

It answers requests in their order, and returns events for pages with the answers.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from itertools import groupby
from pathlib import Path
from typing import Any, cast

from pdr_filter.apps.live.assembly import LateError
from pdr_filter.apps.live.messages import MessageBatch, MessageError
from pdr_filter.apps.live.settings import BusyError, Event, FixError, Settings


class Command(Enum):
    """Request about all sessions of a worker."""

    LIST = auto()  # return all sessions, with their paths and present estimates
    MAINTAIN = auto()  # about once per second: filter what waits, save changed sessions and forget silent phones
    SAVE = auto()  # the last request: save all sessions


Request = MessageBatch | Command


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer to the sender of a request: HTTP status and content."""

    status: int
    content: Any


@dataclass(frozen=True, slots=True)
class Response:
    """Response of a part to one request: the answer for the sender, and the events for the open web pages."""

    answer: Answer
    events: list[str]  # JSON texts, for all changes since the previous response


class Part:
    """Part number `part` of `n_parts` of the devices, with their sessions. `folder` has the sessions of all parts."""

    def __init__(self, settings: Settings, folder: Path, part: int, n_parts: int) -> None:
        from pdr_filter.apps.live.sessions import Sessions  # here, because the server must not load the filter

        if not folder.is_dir():
            raise ValueError(f"no folder {folder} here: the server and all workers need the same one")
        self._events: list[str] = []

        def emit(event: Event) -> None:
            self._events.append(_text(event))

        self._sessions = Sessions(settings, folder, emit, part, n_parts)

    def answer(self, requests: Sequence[Request]) -> list[Response]:
        """Return a `Response` for each request, in order. Consecutive messages are written and filtered together."""
        responses: list[Response] = []
        for kind, group in groupby(requests, type):
            if kind is MessageBatch:
                batches = cast("list[MessageBatch]", list(group))
                answers = [*map(_answer_to, batches, self._sessions.take(batches))]
                # the first has the events of all
                responses += [Response(a, [] if i else self._new_events()) for i, a in enumerate(answers)]
            else:
                commands = cast("Iterator[Command]", group)
                responses += [Response(self._answer(command), self._new_events()) for command in commands]
        return responses

    def _new_events(self) -> list[str]:
        """Return the events since the previous call."""
        events, self._events = self._events, []
        return events

    def _answer(self, command: Command) -> Answer:
        sessions = self._sessions
        if command is Command.LIST:
            return Answer(200, list(map(_text, sessions.snapshots())))
        if command is Command.MAINTAIN:
            sessions.maintain()
        else:
            sessions.close()
        return Answer(200, None)


def _text(event: Event) -> str:
    return json.dumps(event, allow_nan=False)


def _answer_to(batch: MessageBatch, error: Exception | None) -> Answer:
    if error is None:
        return Answer(200, {"samples": sum(message.n_samples for message in batch.messages)})
    statuses: dict[type[Exception], int] = {MessageError: 400, FixError: 409, LateError: 410, BusyError: 503}
    return Answer(statuses.get(type(error), 422), {"error": str(error)})


def answers_of_part(
    settings: Settings, folder: Path, part: int, n_parts: int
) -> Callable[[Sequence[Request]], list[Response]]:
    """Load one part of the devices, and return its `Part.answer`. A worker process calls this function once."""
    return Part(settings, folder, part, n_parts).answer
