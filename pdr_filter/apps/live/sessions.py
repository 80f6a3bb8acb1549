"""Sessions of the phones of one worker: each has its own filter, its own recording and its own saved state.

No web here: `Sessions.take` gets messages, records and filters them, and events for pages go to `emit`.
"""

from __future__ import annotations

import errno
import json
import logging
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from pdr_filter.apps.batch.worker_process import reason_of
from pdr_filter.apps.live.assembly import SessionError
from pdr_filter.apps.live.messages import Message, MessageBatch, MessageError
from pdr_filter.apps.live.recorder import TRIES, DamagedError
from pdr_filter.apps.live.session import DeviceSession, session_id
from pdr_filter.apps.live.settings import BusyError, Event, Settings, worker_of
from pdr_filter.values.safe_files import write_text
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
_LOG = logging.getLogger(__package__)


class Sessions:
    """Sessions that one worker serves. Events for the pages are passed to `emit` as JSON objects."""

    def __init__(
        self, settings: Settings, folder: Path, emit: Callable[[Event], None], part: int = 0, n_parts: int = 1
    ) -> None:
        self.settings, self.folder, self.emit = settings, folder, emit
        self.sessions: dict[str, DeviceSession] = {}
        self._taken: set[str] = set()  # sessions with messages that are not filtered yet
        self._unloaded: dict[str, DeviceSession] = {}  # sessions that only their next message loads
        for path in sorted((folder / NAMES).glob("*.json")):
            try:
                device, session, begun_unix_s = json.loads(path.read_text())
                silent_s = time.time() - max(file.stat().st_mtime for file in (folder / path.stem).iterdir())
                if silent_s < _IDLE_S and worker_of(device, n_parts) == part:
                    self._begin(device, session, begun_unix_s, silent_s)
            except Exception as error:  # one folder must not stop the others
                _LOG.warning("%s: not loaded: %s", path, error)

    def _begin(self, device: str, session: str, begun_unix_s: float, silent_s: float) -> None:
        """Load a recent session. If this fails, or has ended an earlier process, its next message tries it alone."""
        key = session_id(device, session)
        reason = "the server ended while it loaded this session, and tries again at the next message"
        if not (self.folder / key / TRIES).exists():
            try:
                self.sessions[key] = self._loaded(device, session)
                self.sessions[key].begun_unix_s = begun_unix_s
                self.emit(self.sessions[key].about())
                return
            except Exception as error:
                _LOG.warning("%s: not loaded: %s", self.folder / key, error)
                reason = f"the session cannot be loaded ({printable(reason_of(error))}): the next message tries again"
        made = DeviceSession(device, session, self.settings, self.folder)
        made.unloaded, made.begun_unix_s, made.seen_at = reason, begun_unix_s, time.monotonic() - max(silent_s, 0.0)
        self._unloaded[key] = made
        self.emit(made.about())

    def take(self, batches: Sequence[MessageBatch]) -> list[Exception | None]:
        """Record messages, filter the sessions that are due, and return the first error of each batch, or None.

        The messages of a session are written to its journal together, before anything else happens to them. If this
        fails, nothing is kept of them, and the session goes on when they are sent again.

        Errors are MessageError for a message without a device, BusyError if there are too many sessions or no space,
        and SessionError, LateError or FixError if a message cannot be used. The other messages are taken.
        """
        errors: list[Exception | None] = [None] * len(batches)
        received: dict[str, list[tuple[int, Message]]] = {}
        for number, batch in enumerate(batches):
            try:
                for message in batch.messages:
                    key = self._session(message, batch.received_s).id
                    received.setdefault(key, []).append((number, message))
            except (MessageError, BusyError) as error:
                errors[number] = error
        for key, found in received.items():
            session = self.sessions[key]
            try:
                with _writing():
                    session.recorder.journal(message for _, message in found if session.is_kept(message))
            except BusyError as error:
                if isinstance(error.__cause__, FileNotFoundError):
                    self._forget(key)
                for number, _ in found:
                    errors[number] = error
                continue
            self._taken.add(key)
            for number, message in found:
                try:
                    for event in session.take(message, batches[number].received_s):
                        self.emit(event)
                except ValueError as error:
                    errors[number] = errors[number] or error
        self.advance()
        for key, found in received.items():
            if key in self.sessions and (reason := self.sessions[key].refused):
                for number, _ in found:
                    errors[number] = errors[number] or SessionError(reason)
        return errors

    def advance(self, is_all: bool = False) -> None:
        """Filter the sessions that are due, and write their samples and steps.

        A session is due if enough samples wait, or if `is_all`.
        """
        wait_s = 0.0 if is_all else min(len(self.sessions) * _PASS_S, _LONGEST_WAIT_S)
        for key in list(self._taken):
            session = self.sessions[key]
            if session.is_due(wait_s):
                for event in session.advance():
                    self.emit(event)
                self._taken.discard(key)
            try:
                session.recorder.flush()
            except FileNotFoundError:
                self._forget(key)
            except OSError:  # the journal has all of it, and the next call writes what waits
                pass

    def _forget(self, key: str) -> None:
        """Remove a session from memory. Its next message loads its files again, or renames their folder if damaged."""
        self.sessions.pop(key, None)
        self._unloaded.pop(key, None)
        self._taken.discard(key)
        self.emit({"event": "gone", "id": key})

    def _session(self, message: Message, received_s: float) -> DeviceSession:
        """Return the session of a message, new or loaded if it is not in memory."""
        if not message.device:
            raise MessageError("no device named; give deviceId, or ?device=NAME in the address")
        key = session_id(message.device, message.session)
        if key not in self.sessions:
            if len(self.sessions) >= self.settings.max_devices:
                raise BusyError(f"{len(self.sessions)} sessions already; start the server with more --max-devices")
            with _writing():
                self.sessions[key] = self._opened(message, received_s)
            self._unloaded.pop(key, None)
        return self.sessions[key]

    def _opened(self, message: Message, received_s: float) -> DeviceSession:
        key = session_id(message.device, message.session)
        names, kept = self.folder / NAMES / f"{key}.json", self.folder / key
        is_kept = kept.is_dir() and any(kept.iterdir())
        session = (self._loaded if is_kept else self._new)(message.device, message.session)
        if names.exists():
            with suppress(ValueError):  # a damaged file seems to begin now
                _, _, received_s = json.loads(names.read_text())
        else:
            write_text(names, json.dumps([message.device, message.session, received_s]))
        session.begun_unix_s = received_s
        if is_kept:  # pages may know nothing of it, or not its path
            self.emit(session.about())
            self.emit(session.track())
        return session

    def _new(self, device: str, session: str) -> DeviceSession:
        made = DeviceSession(device, session, self.settings, self.folder)
        made.begin()
        return made

    def _loaded(self, device: str, session: str) -> DeviceSession:
        """Return the session in a folder. If its files are damaged, rename the folder and return a new session."""
        try:
            return DeviceSession.load(device, session, self.settings, self.folder)
        except DamagedError as error:
            reason = printable(error)[:200]
        kept = self.folder / session_id(device, session)
        n = sum(1 for _ in self.folder.glob(f"{kept.name}.damaged*")) + 1
        aside = kept.rename(kept.with_name(f"{kept.name}.damaged{n}"))
        _LOG.warning("%s cannot be loaded (%s): kept as %s", kept, reason, aside.name)
        made = self._new(device, session)
        made.notes = (
            f"the recording until now cannot be continued ({reason}): it is kept in the folder {aside.name}, and the "
            "track begins again",
        )
        self.emit(made.about())
        return made

    def snapshots(self) -> list[Event]:
        """Return the events that show all sessions to a newly opened page."""
        self.advance(is_all=True)
        shown = (*self.sessions.values(), *self._unloaded.values())
        return [event for session in shown for event in session.snapshot()]

    def maintain(self) -> None:
        """Filter and save what remains, send events, and remove silent phones. Call it about once per second."""
        self.advance()
        for key, session in list(self.sessions.items()):
            events = session.rest()
            is_gone = time.monotonic() - session.seen_at > _IDLE_S
            if is_gone:
                events += session.release()
            if is_gone or session.unsaved_s > _SAVE_S:
                events += session.save()
            for event in events:
                self.emit(event)
            if is_gone:
                self._forget(key)
        for key, session in list(self._unloaded.items()):
            if time.monotonic() - session.seen_at > _IDLE_S:
                self._forget(key)

    def close(self) -> None:
        """Save all sessions."""
        for session in self.sessions.values():
            for event in session.save():
                self.emit(event)


@contextmanager
def _writing() -> Generator[None]:
    """Turn an error of the disk into BusyError, so that the phone sends its message again."""
    try:
        yield
    except OSError as error:
        remedy = "free some space" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "check disk and folder"
        reason = error.strerror or error
        raise BusyError(f"the recording cannot be written ({reason}); {remedy} and send it again") from error
