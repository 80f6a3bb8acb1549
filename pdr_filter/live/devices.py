"""Phones while they walk: each session of each device has its own filter, its own recording and its own saved state.

No web here: `Devices.take` gets the body of a message and says what came of it; what there is to show goes to `emit`.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

from pdr_filter.live.assembly import SessionError
from pdr_filter.live.messages import Message, MessageError, parse
from pdr_filter.live.session import Session, session_id
from pdr_filter.live.settings import BusyError, Event, Settings, part_of

# A state is saved when this much has come since the last time; the journal has what is newer.
_SAVE_S = 10.0
# A phone that sends nothing for so long is forgotten until it sends again.
_IDLE_S = 600.0
# Which device and session a folder is of.
ABOUT = "session.json"


class Devices:
    """The sessions of one worker. What there is to show is given to `emit`, as JSON objects."""

    def __init__(
        self, settings: Settings, folder: Path, emit: Callable[[Event], None], part: int = 0, n_parts: int = 1
    ) -> None:
        self.settings, self.folder, self.emit = settings, folder, emit
        self.part, self.n_parts = part, n_parts
        self.sessions: dict[str, Session] = {}
        for path in sorted(folder.glob("*/" + ABOUT)):
            device, session = json.loads(path.read_text())
            is_recent = time.time() - max(f.stat().st_mtime for f in path.parent.iterdir()) < _IDLE_S
            if is_recent and part_of(device, n_parts) == part:
                loaded = Session.load(device, session, settings, folder)
                self.sessions[loaded.id] = loaded

    def take(self, body: bytes, device: str, session: str, platform: str, received_s: float) -> Event:
        """How many samples a body held, all of which are taken.

        MessageError, SessionError, FixError or BusyError if one of its messages cannot be used; those before it are.
        """
        n = 0
        for message in parse(body, device, session, platform):
            if not message.device:
                raise MessageError("no device named; give deviceId, or ?device=NAME in the address")
            if part_of(message.device, self.n_parts) != self.part:
                raise MessageError("one body is of one device; send messages of different devices apart")
            taken_by = self._session(message)
            try:
                events = taken_by.take(message, received_s)
            except SessionError:
                self.emit(taken_by.about())  # the page says why, too
                raise
            for event in events:
                self.emit(event)
            n += message.n_samples
        return {"samples": n}

    def _session(self, message: Message) -> Session:
        key = session_id(message.device, message.session)
        if key not in self.sessions:
            if len(self.sessions) >= self.settings.max_devices:
                raise BusyError(f"{len(self.sessions)} sessions already; start the server with more --max-devices")
            kept = self.folder / key / ABOUT
            make = Session.load if kept.exists() else Session
            self.sessions[key] = make(message.device, message.session, self.settings, self.folder)
            if not kept.exists():
                kept.write_text(json.dumps([message.device, message.session]))
        return self.sessions[key]

    def tick(self) -> None:
        """Tell and save what is left, and forget phones that are silent; to be called about once a second."""
        for key, session in list(self.sessions.items()):
            for event in session.rest():
                self.emit(event)
            silent_s = time.monotonic() - session.seen_at
            if silent_s > _IDLE_S:
                session.save()
                del self.sessions[key]
                self.emit({"event": "gone", "id": key})
            elif session.unsaved_s > _SAVE_S or (session.unsaved_s and silent_s > 1.0):
                session.save()

    def close(self) -> None:
        """Save everything."""
        for session in self.sessions.values():
            session.save()
