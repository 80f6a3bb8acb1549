"""Sessions of the phones of one worker: each has its own filter, its own recording and its own saved state.

No web here: `Sessions.accept` gets messages, `Sessions.settle` filters them, and events for pages go to `emit`.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from pdr_filter.apps.live.assembly import SessionError
from pdr_filter.apps.live.messages import Message, MessageError
from pdr_filter.apps.live.recorder import replace_file
from pdr_filter.apps.live.session import DeviceSession, session_id
from pdr_filter.apps.live.settings import BusyError, Event, Settings, worker_of
from pdr_filter.values.sanitise import printable

# A state costs 15 ms and is saved so often. A server that starts again filters the journal of this time.
_SAVE_S = 30.0
# A pass of the filter over 0.2 s of samples costs two thirds of one over a second. So passes of a worker take turns:
# each session has one in this time for each session, and none waits for longer than this.
_PASS_S, _LONGEST_WAIT_S = 0.2, 2.0
# A phone that sends nothing for so long is forgotten until it sends again.
_IDLE_S = 600.0
# Folder with a file for each session, which holds the names of its device and session.
NAMES = "sessions"
_LOG = logging.getLogger(__name__)


class Sessions:
    """Sessions that one worker serves. Events for the pages are passed to `emit` as JSON objects."""

    def __init__(
        self, settings: Settings, folder: Path, emit: Callable[[Event], None], part: int = 0, n_parts: int = 1
    ) -> None:
        self.settings, self.folder, self.emit = settings, folder, emit
        self.sessions: dict[str, DeviceSession] = {}
        self._taken: set[str] = set()  # sessions with messages that are not filtered yet
        for path in sorted((folder / NAMES).glob("*.json")):
            try:
                device, session, begun_unix_s = json.loads(path.read_text())
                files = list((folder / path.stem).iterdir())
                is_recent = time.time() - max(file.stat().st_mtime for file in files) < _IDLE_S
                if is_recent and worker_of(device, n_parts) == part:
                    self.sessions[path.stem] = self._loaded(device, session)
                    self.sessions[path.stem].begun_unix_s = begun_unix_s
            except (OSError, ValueError) as error:  # one folder must not stop the others
                _LOG.warning("%s: not loaded: %s", path, error)

    def accept(self, messages: Sequence[Message], received_s: float) -> tuple[Event, set[str]]:
        """Assign messages to their sessions, and return {"samples": number} and the ids of these sessions.

        A session is created for a new phone. `settle` filters and saves the samples later. MessageError for a message
        without a device, BusyError if there are too many sessions, SessionError, LateError or FixError if a message
        cannot be used. The messages before it are taken.
        """
        n, keys = 0, set[str]()
        for message in messages:
            if not message.device:
                raise MessageError("no device named; give deviceId, or ?device=NAME in the address")
            taken_by = self._session(message, received_s)
            self._taken.add(taken_by.id)
            for event in taken_by.take(message, received_s):
                self.emit(event)
            keys.add(taken_by.id)
            n += message.n_samples
        return {"samples": n}, keys

    def settle(self, is_all: bool = False) -> dict[str, Exception]:
        """Save all messages since the last call, and filter the sessions that are due.

        A session is due if enough samples wait, or if `is_all`. The result has the error of each session that failed,
        by the id of the session.
        """
        failed: dict[str, Exception] = {}
        wait_s = 0.0 if is_all else min(len(self.sessions) * _PASS_S, _LONGEST_WAIT_S)
        for key in list(self._taken):
            session = self.sessions[key]
            if session.is_due(wait_s):
                for event in session.advance():
                    self.emit(event)
                self._taken.discard(key)
            if session.refused:
                failed[key] = SessionError(session.refused)
            try:
                session.recorder.flush()
            except OSError as error:
                # the next message loads the session again, which cuts off a half-written line
                del self.sessions[key]
                self._taken.discard(key)
                failed[key] = BusyError(f"the recording cannot be written ({error}); free some space and send it again")
        return failed

    def _session(self, message: Message, received_s: float) -> DeviceSession:
        key = session_id(message.device, message.session)
        if key in self.sessions:
            return self.sessions[key]
        if len(self.sessions) >= self.settings.max_devices:
            raise BusyError(f"{len(self.sessions)} sessions already; start the server with more --max-devices")
        names = self.folder / NAMES / f"{key}.json"
        if names.exists():
            _, _, begun_unix_s = json.loads(names.read_text())
            session = self._loaded(message.device, message.session)
        else:
            session = DeviceSession(message.device, message.session, self.settings, self.folder)
            begun_unix_s = received_s
            names.parent.mkdir(exist_ok=True)
            replace_file(names, json.dumps([message.device, message.session, begun_unix_s]).encode())
        session.begun_unix_s = begun_unix_s
        self.sessions[key] = session
        return session

    def _loaded(self, device: str, session: str) -> DeviceSession:
        """Return the session in a folder. If its files cannot be used, rename the folder and return a new session."""
        try:
            return DeviceSession.load(device, session, self.settings, self.folder)
        except Exception as error:  # damaged files, or those of another version, fail in many ways
            reason = printable(error)[:200]
        kept = self.folder / session_id(device, session)
        n = sum(1 for _ in self.folder.glob(f"{kept.name}.damaged*")) + 1
        aside = kept.rename(kept.with_name(f"{kept.name}.damaged{n}"))
        _LOG.warning("%s cannot be loaded (%s): kept as %s", kept, reason, aside.name)
        made = DeviceSession(device, session, self.settings, self.folder)
        made.notes = (
            f"the recording until now cannot be continued ({reason}): it is kept in the folder {aside.name}, and the "
            "track begins again",
        )
        self.emit(made.about())
        return made

    def snapshots(self) -> list[Event]:
        """Return the events that show all sessions to a newly opened page."""
        self.settle(is_all=True)
        return [event for session in self.sessions.values() for event in session.snapshot()]

    def maintain(self) -> None:
        """Filter and save what remains, send events, and remove silent phones. Call it about once per second."""
        self.settle()
        for key, session in list(self.sessions.items()):
            events = session.rest()
            is_gone = time.monotonic() - session.seen_at > _IDLE_S
            if is_gone:
                events += session.release()
            if is_gone or session.unsaved_s > _SAVE_S:
                events += session.save()
            if is_gone:
                del self.sessions[key]
                events.append({"event": "gone", "id": key})
            for event in events:
                self.emit(event)

    def close(self) -> None:
        """Save all sessions."""
        for session in self.sessions.values():
            for event in session.save():
                self.emit(event)
