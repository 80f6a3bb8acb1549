"""Share of the devices that one worker process or one actor of a cluster serves.

It answers requests in their order, and returns events for pages with the answers.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path
from typing import Any

from pdr_filter.apps.live.assembly import LateError
from pdr_filter.apps.live.messages import Message, MessageError
from pdr_filter.apps.live.settings import BusyError, Event, FixError, Settings


@dataclass(frozen=True, slots=True)
class MessageBatch:
    """Request to process the messages that one device sent in one HTTP body, received at `received_s`."""

    device: str
    messages: Sequence[Message]
    received_s: float


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
            self._events.append(json.dumps(event, allow_nan=False))

        self._sessions = Sessions(settings, folder, emit, part, n_parts)

    def answer(self, requests: Sequence[Request]) -> list[Response]:
        """Return a `Response` for each request, in order. Consecutive messages are filtered and saved together."""
        responses: list[Response] = []
        taken: list[tuple[Answer, set[str]]] = []
        for request in requests:
            if isinstance(request, MessageBatch):
                taken.append(self._accept(request))
            else:
                responses += self._filtered_responses(taken)
                taken = []
                responses.append(Response(self._answer(request), self._new_events()))
        return [*responses, *self._filtered_responses(taken)]

    def _filtered_responses(self, taken: Sequence[tuple[Answer, set[str]]]) -> list[Response]:
        """Return a `Response` for each message, after the sessions were saved and those that are due were filtered.

        If a session failed, its error becomes the answer to its messages. The first `Response` has all events.
        """
        failed = self._sessions.settle()
        answers: list[Answer] = []
        for answer, keys in taken:
            errors = [failed[key] for key in keys if key in failed]
            answers.append(_refusal(errors[0]) if errors and answer.status == 200 else answer)
        events = self._new_events()
        return [Response(answer, events if i == 0 else []) for i, answer in enumerate(answers)]

    def _new_events(self) -> list[str]:
        """Return the events since the previous call."""
        events, self._events = self._events, []
        return events

    def _answer(self, command: Command) -> Answer:
        sessions = self._sessions
        if command is Command.LIST:
            return Answer(200, sessions.snapshots())
        if command is Command.MAINTAIN:
            sessions.maintain()
        else:
            sessions.close()
        return Answer(200, None)

    def _accept(self, request: MessageBatch) -> tuple[Answer, set[str]]:
        try:
            content, keys = self._sessions.accept(request.messages, request.received_s)
        except (ValueError, BusyError, OSError) as error:
            return _refusal(error), set()
        return Answer(200, content), keys


def _refusal(error: Exception) -> Answer:
    statuses = {MessageError: 400, FixError: 409, LateError: 410, BusyError: 503, OSError: 503}
    status = next((status for kind, status in statuses.items() if isinstance(error, kind)), 422)
    return Answer(status, {"error": str(error)})


def answers_of_part(
    settings: Settings, folder: Path, part: int, n_parts: int
) -> Callable[[Sequence[Request]], list[Response]]:
    """Load one part of the devices, and return its `Part.answer`. A worker process calls this function once."""
    return Part(settings, folder, part, n_parts).answer
