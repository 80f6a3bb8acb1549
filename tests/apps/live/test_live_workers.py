"""Requests that wait for a worker are answered in their order, whatever becomes of it."""

from __future__ import annotations

import asyncio
import json
import os
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import pytest
from serving import until

from pdr_filter.apps.batch.worker_process import LostError
from pdr_filter.apps.live import workers as live_workers
from pdr_filter.apps.live.messages import Message, MessageBatch, parse
from pdr_filter.apps.live.parts import Answer, Part, Request, Response
from pdr_filter.apps.live.session import DeviceSession
from pdr_filter.apps.live.settings import Settings
from pdr_filter.apps.live.workers import Process, Workers


class Mortal:
    """A share that a message can kill, and that keeps what it has taken elsewhere."""

    def __init__(self, taken: list[bytes], shares: list[Mortal]) -> None:
        self.taken = taken
        self.is_closed = False
        shares.append(self)

    async def ask(self, requests: Sequence[Request]) -> list[Response]:
        await asyncio.sleep(0.001)
        said: list[Response] = []
        for request in requests:
            if isinstance(request, MessageBatch):
                (message,) = request.messages
                if message.source == b"deadly":
                    raise LostError("killed")
                if message.source not in self.taken:
                    self.taken.append(message.source)
            said.append(Response(Answer(200, {}), [f"shown by {len(self.taken)}"]))
        return said

    async def close(self) -> None:
        self.is_closed = True


def taken_of(source: bytes) -> MessageBatch:
    return MessageBatch("phone", [Message("phone", "", source=source)], 0.0)


def test_a_deadly_message_is_given_up_and_all_others_are_answered_in_their_order() -> None:
    taken, shares, shown = list[bytes](), list[Mortal](), list[str]()

    async def run() -> list[int]:
        async def start(part: int, n_parts: int) -> Mortal:
            assert (part, n_parts) == (0, 1)
            return Mortal(taken, shares)

        workers = Workers(start, 1, shown.append)
        await workers.start()
        bodies = [b"%d" % i for i in range(20)]
        bodies.insert(5, b"deadly")
        answers = await asyncio.gather(*(workers.take(taken_of(body)) for body in bodies))
        await workers.close()
        return [answer.status for answer in answers]

    statuses = asyncio.run(run())
    assert taken == [b"%d" % i for i in range(20)]
    assert statuses == [200] * 5 + [500] + [200] * 15
    assert len(shares) == 3  # it was tried twice
    assert [share.is_closed for share in shares] == [False, False, True]
    assert shown[-1] == "shown by 20"


def test_who_asks_more_than_a_worker_can_take_is_told_so() -> None:
    async def run() -> list[int]:
        async def start(part: int, n_parts: int) -> Mortal:
            return Mortal([], [])

        workers = Workers(start, 1, lambda _: None)
        await workers.start()
        answers = await asyncio.gather(*(workers.take(taken_of(b"")) for _ in range(1500)))
        await workers.close()
        return [answer.status for answer in answers]

    statuses = asyncio.run(run())
    assert statuses == [200] * 1000 + [503] * 500


def test_phones_are_refused_after_a_while_although_a_start_takes_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_workers, "_PATIENCE_S", 0.1)
    monkeypatch.setattr(live_workers, "_TICK_S", 0.05)
    starts, ready = list[int](), asyncio.Event()

    async def run() -> list[int]:
        async def start(part: int, n_parts: int) -> Mortal:
            starts.append(part)
            if len(starts) > 1:
                await ready.wait()
            return Mortal([], [])

        workers = Workers(start, 1, lambda _: None)
        await workers.start()
        answers = await asyncio.wait_for(asyncio.gather(*(workers.take(taken_of(b)) for b in (b"deadly", b"1"))), 60.0)
        ready.set()
        await asyncio.sleep(0.5)
        answers.append(await asyncio.wait_for(workers.take(taken_of(b"2")), 60.0))
        await workers.close()
        return [answer.status for answer in answers]

    assert asyncio.run(run()) == [503, 503, 200]


class Died(BaseException):
    """The process has ended, as that of a part does at a segmentation fault."""


class OfPart:
    """A share with a part of the devices, which is lost when what it filters raises `Died` or MemoryError."""

    def __init__(self, folder: Path) -> None:
        try:
            self._part = Part(Settings(), folder, 0, 1)
        except (Died, MemoryError) as error:
            raise LostError("died at its start") from error

    async def ask(self, requests: Sequence[Request]) -> list[Response]:
        try:
            return self._part.answer(requests)
        except (Died, MemoryError) as error:
            raise LostError("died") from error

    async def close(self) -> None:
        """Nothing is to be ended."""


def still(device: str, number: int) -> MessageBatch:
    """A message with three seconds of a phone that lies on a table."""
    rows = [[3 * number + 0.02 * k, 0.0, 0.0, 9.81 * (k % 2 + 0.5)] for k in range(150)]
    samples = {"accelerometer": rows, "gyroscope": [[row[0], 0.0, 0.0, 0.0] for row in rows]}
    content = {"device": device, "number": number, "platform": "android", "samples": samples}
    return MessageBatch(device, parse(json.dumps(content).encode()), 0.0)


@pytest.mark.parametrize(("error", "n_died"), [(Died, 5), (MemoryError, 4)])
def test_a_phone_that_ends_its_process_at_each_start_is_set_aside_and_others_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: type[BaseException], n_died: int
) -> None:
    """As a fault does that ends the process whenever one message, which is in the journal by then, is filtered."""
    monkeypatch.setattr(live_workers, "_TICK_S", 0.01)
    n_starts, filtered = 0, DeviceSession._filtered

    def deadly(self: DeviceSession, samples: dict[str, object]) -> list[object]:
        if self.device == "bad" and samples and not list(tmp_path.glob("*.damaged*")):
            raise error
        return filtered(self, samples)

    async def start(part: int, n_parts: int) -> OfPart:
        nonlocal n_starts
        n_starts += 1
        return OfPart(tmp_path)

    async def run() -> list[int]:
        workers = Workers(start, 1, lambda _: None)
        await workers.start()
        sent = [("good", 0), ("bad", 0), ("good", 1), ("bad", 1), ("good", 2), ("bad", 2), ("good", 3)]
        answers = [await asyncio.wait_for(workers.take(still(*one)), 60.0) for one in sent]
        await workers.close()
        return [answer.status for answer in answers]

    monkeypatch.setattr(DeviceSession, "_filtered", deadly)
    assert asyncio.run(run()) == [200, 500, 200, 500, 200, 200, 200]
    assert n_starts == 1 + n_died  # if only memory is missing, the process continues without the session
    (aside,) = tmp_path.glob("bad-*.damaged1")
    assert b'"number": 0' in (aside / "journal_0.json").read_bytes()


def test_a_fix_whose_process_dies_before_its_answer_is_in_the_track_once_and_the_next_equal_one_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fix = json.dumps({"device": "p", "fix": {"east_m": 1.0, "north_m": 0.0, "time_s": 2.0}}).encode()
    fixed, n_deaths = DeviceSession._fixed, 1

    def deadly(self: DeviceSession, content: object) -> object:
        nonlocal n_deaths
        event, n_deaths = fixed(self, content), n_deaths - 1
        if n_deaths >= 0:
            raise Died
        return event

    async def start(part: int, n_parts: int) -> OfPart:
        return OfPart(tmp_path)

    async def run() -> list[int]:
        workers = Workers(start, 1, lambda _: None)
        await workers.start()
        batches = [still("p", 0), *(MessageBatch("p", parse(fix), 0.0) for _ in range(2)), still("p", 1)]
        answers = [await asyncio.wait_for(workers.take(batch), 60.0) for batch in batches]
        await workers.close()
        return [answer.status for answer in answers]

    monkeypatch.setattr(DeviceSession, "_fixed", deadly)
    assert asyncio.run(run()) == [200] * 4
    (fixes,) = tmp_path.glob("*/fixes.csv")
    assert len(fixes.read_text().splitlines()) == 1 + 2


def never_ready(settings: Settings, folder: Path, part: int, n_parts: int) -> None:
    """A worker that loads for ever."""
    (folder / "started").write_text(str(os.getpid()))
    time.sleep(600.0)


def test_a_process_that_is_not_ready_in_time_is_ended_before_another_one_takes_its_sessions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_workers, "answers_of_part", never_ready)

    def pid() -> int:
        path = tmp_path / "started"
        return int(path.read_text() or 0) if path.exists() else 0

    async def run() -> None:
        starting = asyncio.create_task(Process.start(Settings(), tmp_path, 0, 1))
        await asyncio.to_thread(until, pid, 60.0)
        starting.cancel()
        with suppress(asyncio.CancelledError):
            await starting

    asyncio.run(asyncio.wait_for(run(), 90.0))
    with pytest.raises(ProcessLookupError):
        os.kill(pid(), 0)
