"""Whatever operation of the disk fails, each message is on it once after its answer, and its session goes on."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from faulty_disk import ERRORS, KILL, SHORT, FaultyDisk, Killed
from serving import own_messages, short_walk

from pdr_filter.apps.live import sessions as live_sessions
from pdr_filter.apps.live.messages import Message, MessageBatch, parse
from pdr_filter.apps.live.recorder import Recorder
from pdr_filter.apps.live.sessions import Sessions
from pdr_filter.apps.live.settings import BusyError, Settings
from pdr_filter.values import Samples
from pdr_filter.values.recording import Recording

SAVED_AFTER, FORGOTTEN_AFTER, DIES_AFTER = (1, 4), 3, 5


def thin_walk() -> Recording:
    """Some steps at 25 Hz."""
    found: dict[str, Samples] = {}
    for name, stream in short_walk(18.0).streams.items():
        kept = np.flatnonzero(stream.time_s >= 10.0)[::4]
        found[name] = Samples(stream.time_s[kept] - 10.0, stream.values[kept])
    return Recording("walk", **found)  # type: ignore[arg-type]


def rounds() -> list[list[bytes]]:
    """What comes at a time: one or two messages of a walk, a fix, and a message of a phone that is not tracked."""
    walk = own_messages(thin_walk(), part_s=1.2)
    fix = json.dumps(
        {"device": "p", "session": "s", "id": 1, "fix": {"east_m": 1.0, "north_m": 2.0, "std_m": 3.0}}
    ).encode()
    found = [walk[:1], walk[1:3], *([body] for body in walk[3:])]
    found[4].append(fix)
    for number, bodies in enumerate(found):
        still = {"device": "q", "number": number, "samples": {"barometer": [[number, 1000.0]]}}
        bodies.append(json.dumps(still).encode())
    return found


class Life:
    """Life of two sessions on a disk that may fail. It ends with a kill, and goes on until everything is saved."""

    def __init__(self, folder: Path, disk: FaultyDisk, dies_after_fault: bool = False) -> None:
        self.folder, self.disk, self.dies_after_fault = folder, disk, dies_after_fault
        self.sessions = self._started()

    def live(self, rounds: Sequence[Sequence[bytes]]) -> None:
        for number, bodies in enumerate(rounds):
            left = list(bodies)
            while left:
                was_failing = self.disk.has_failed
                left = self._sent(left)
                if was_failing and not left and self.dies_after_fault:
                    self.sessions = self._started()
            try:
                self._maintain(number)
            except Killed:
                self._rise()
        self.disk.heal()
        self.sessions = self._started()
        self.sessions.close()

    def files(self) -> dict[str, bytes]:
        """What a reader finds in the folders of the sessions, and the messages in their journals."""
        found: dict[str, bytes] = {}
        for path in self.folder.rglob("*.*"):
            name = re.sub(r"journal_\d+", "journal", path.relative_to(self.folder).as_posix())
            content = path.read_bytes() if path.is_file() else b""
            if path.suffix not in (".bin", ".txt", ".part"):
                found[name] = content
        return found

    def _started(self) -> Sessions:
        return Sessions(Settings(), self.folder, lambda event: None)

    def _rise(self) -> None:
        self.disk.heal()
        self.sessions = self._started()

    def _sent(self, bodies: Sequence[bytes]) -> list[bytes]:
        """Send messages at once, and return those that are to be sent again, when there is space again."""
        try:
            errors = self.sessions.take([MessageBatch("", parse(body), 100.0) for body in bodies])
        except Killed:
            self._rise()
            return list(bodies)
        for error in errors:
            assert error is None or isinstance(error, BusyError), error
        left = [body for body, error in zip(bodies, errors, strict=True) if error is not None]
        if left:
            assert self.disk.has_failed
            self.disk.heal()
        return left

    def _maintain(self, number: int) -> None:
        """Do what a server does from time to time."""
        for session in self.sessions.sessions.values():
            if number in SAVED_AFTER:
                session.save()
            if number == FORGOTTEN_AFTER:
                session.seen_at -= live_sessions._IDLE_S + 1.0
        self.sessions.maintain()
        if number == DIES_AFTER:
            self.sessions = self._started()


def broken_lives(
    folder: Path, monkeypatch: pytest.MonkeyPatch, stride: int, kinds: Sequence[str]
) -> tuple[int, list[str]]:
    """Return the number of lives, and those that did not end as the life without errors: kind, operation, files.

    The fault is at each operation, or at one of `stride`, and of the next kind in turn.
    """
    sent, broken = rounds(), list[str]()
    disk = FaultyDisk(folder, monkeypatch)
    right = Life(folder / "right", disk)
    disk.n = 0
    right.live(sent)
    points, expected = range(0, disk.n, stride), right.files()
    assert {Path(name).name for name in expected} >= {"accelerometer.csv", "steps.jsonl", "fixes.csv", "journal.json"}
    for at, kind in zip(points, cycle(kinds), strict=False):
        life = Life(folder / f"{kind} {at}", disk, at % 2 == 0)
        disk.fail(at, kind)
        life.live(sent)
        found = life.files()
        differ = [name for name in sorted(expected.keys() | found.keys()) if expected.get(name) != found.get(name)]
        broken += [f"{kind} {at}: {differ}"] if differ else []
        shutil.rmtree(life.folder)
    return len(points), broken


def test_whatever_operation_fails_sessions_go_on_and_have_each_acknowledged_message_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A few of all operations. `python -m tests.benchmarks.live_soak` has all."""
    n, broken = broken_lives(tmp_path, monkeypatch, 41, [*ERRORS, SHORT, KILL])
    assert n > 4
    assert broken == []


class Numbers:
    """Numbers of messages on a disk: what a session needs of its recorder, without a filter."""

    def __init__(self, folder: Path, disk: FaultyDisk) -> None:
        self._folder, self._disk = folder, disk
        self._load()

    def _load(self) -> None:
        self.recorder = Recorder(self._folder)
        state, messages = self.recorder.load()
        self.taken = [] if state is None else list(state["taken"])
        for message in messages:
            self._take(message)

    def _take(self, message: Message) -> None:
        number = float(message.number or 0)
        if number not in self.taken:  # it may come again after a kill
            self.taken.append(number)
            self.recorder.samples("gyroscope", Samples(np.array([number]), np.full((1, 3), number)))
            with suppress(OSError):
                self.recorder.flush()

    def send(self, message: Message) -> None:
        self.recorder.journal([message])
        self._take(message)

    def save(self) -> None:
        with suppress(OSError):
            self.recorder.save({"taken": tuple(self.taken)}, ())

    def do(self, what: Callable[[], None]) -> None:
        """Do something again until it succeeds; then there is space. A process that was killed starts again."""
        while True:
            try:
                return what()
            except OSError:
                self._disk.heal()
            except Killed:
                self._disk.heal()
                self._load()

    def live(self) -> None:
        for number in range(8):
            (message,) = parse(
                b'{"device": "p", "number": %d, "samples": {"gyroscope": [[%d, 0, 0, 0]]}}' % (number, number)
            )
            self.do(lambda message=message: self.send(message))
            if number in (1, 3, 4):
                self.do(self.save)
            if number in (2, 5):  # the first message after a state was saved, or was not
                self.do(self._load)
        self._disk.heal()
        self._load()
        self.save()


@pytest.mark.parametrize("kind", ["ENOSPC", "EROFS", SHORT, KILL])  # the code does not know the errors apart
def test_after_a_fault_at_any_operation_of_a_recorder_every_acknowledged_message_is_there_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    disk, at = FaultyDisk(tmp_path, monkeypatch), 0
    while disk.n >= at:  # otherwise the life before was over before its fault
        numbers = Numbers(tmp_path / str(at), disk)
        disk.fail(at, kind)
        numbers.live()
        assert numbers.taken == list(range(8)), at
        rows = (tmp_path / str(at) / "gyroscope.csv").read_text().splitlines()[1:]
        assert rows == [f"{number}.0,{number}.0,{number}.0,{number}.0" for number in range(8)], at
        at += 1
    assert at > 50


@pytest.mark.skipif(os.name != "posix", reason="elsewhere a folder cannot be synced")
def test_a_saved_state_and_the_messages_that_wait_survive_a_power_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The journal that the state needs is on the disk before it, and the new name before the old journal is gone."""
    synced: list[tuple[int, bool]] = []
    recorder = Recorder(tmp_path)
    held = parse(b'{"device": "p", "samples": {}}')
    recorder.journal(held)
    old = tmp_path / "journal_0.json"
    monkeypatch.setattr(os, "fsync", lambda number: synced.append((os.fstat(number).st_ino, old.exists())))
    recorder.save("state", held)
    files = [tmp_path / "journal_1.json", tmp_path / "state.bin", tmp_path]
    assert synced == [(path.stat().st_ino, True) for path in files]
