"""What the server fetches itself, given to `take` as if a phone had sent it."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Awaitable, Callable
from pathlib import Path

import numpy as np

from pdr_filter.io.formats import read
from pdr_filter.live.messages import N_VALUES, Message, Rows, to_json

# Takes a body, and the names of device and session and the platform for messages that do not say them.
Taker = Callable[..., Awaitable[object]]
# Samples of so long are one message, as with phones that send several times a second.
_PART_S = 0.2


async def replay(file: Path, speed: float, take: Taker) -> None:
    """Send a recording as if it were walked now, or `speed` times as fast."""
    recording = await asyncio.to_thread(read, file)
    streams = {name: samples for name, samples in recording.streams.items() if name in N_VALUES and name != "attitude"}
    time_s = recording.accelerometer.time_s
    # In recorded order: what a recording's clock did is replayed too. Other sensors go with the samples of their time.
    cuts = np.append(np.arange(float(time_s[0]), float(time_s.max()), _PART_S)[1:], np.inf)
    session, loop = uuid.uuid4().hex[:8], asyncio.get_running_loop()
    begun, sent = loop.time(), dict.fromkeys(streams, 0)
    for number, end_s in enumerate(cuts):
        rows: dict[str, Rows] = {}
        for name, samples in streams.items():
            ahead = samples.time_s[sent[name] :] >= end_s
            n = int(ahead.argmax()) if ahead.any() else len(ahead)
            if n:
                part = slice(sent[name], sent[name] + n)
                rows[name] = Rows(samples.time_s[part], samples.values[part])
                sent[name] += n
        is_end = number == len(cuts) - 1
        message = Message(f"replay {recording.name}", session, number, "android", rows, is_end=is_end)
        await asyncio.sleep(max(begun + (number + 1) * _PART_S / speed - loop.time(), 0.0))
        await take(to_json(message))
