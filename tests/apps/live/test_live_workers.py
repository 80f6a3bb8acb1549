"""Requests that wait for a worker are answered in their order, whatever becomes of it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from pdr_filter.apps.batch.worker_process import LostError
from pdr_filter.apps.live.messages import Message, MessageBatch
from pdr_filter.apps.live.parts import Answer, Request, Response
from pdr_filter.apps.live.workers import Workers


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
