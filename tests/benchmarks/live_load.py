"""Phones that one machine tracks in real time: messages over HTTP to `pdr-filter live` on this machine.

usage: python -m tests.benchmarks.live_load [--phones 10 50 100 200] [--rates 1 5] [--seconds 20]
           [--workers 2]

Each phone posts messages like Sensor Logger, one or five a second, with accelerometer and gyroscope at 100 Hz and the
magnetometer at 50 Hz. All walk the embedded simulated walk, at times spread over the second. The sender runs on the
same cores, and nothing is sent to any other machine. "Told" is the delay from a message to the first event that a
program reads after it. "Of the filter alone" is the cost of one process with the same samples in blocks of a second,
before and after each row. It shows how fast a core was, because other programs make it slower.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import resource
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from websockets.asyncio.client import connect

import pdr_filter as pdr
from pdr_filter.sensing.stream_merging import SENSORS
from pdr_filter.values import Samples
from tests.benchmarks.common import Tables, run

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "apps" / "live"))
from serving import Server, sensor_logger_messages

_NAME = "phone-000000"
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_WARM_UP_S = 12.0


@dataclass
class Seen:
    """What was measured while so many phones sent."""

    answer_s: list[float] = field(default_factory=list[float])
    shown_s: list[float] = field(default_factory=list[float])
    late_s: list[float] = field(default_factory=list[float])  # by how much a message was sent after its time
    refused: int = 0


def cpu_s(pids: list[int]) -> float:
    """Processor time of processes so far."""
    fields = [Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split() for pid in pids]
    return sum(int(f[11]) + int(f[12]) for f in fields) / _TICKS_PER_S


def memory_mb(pids: list[int]) -> float:
    """Memory that is in use."""
    return sum(int(Path(f"/proc/{pid}/statm").read_text().split()[1]) for pid in pids) * resource.getpagesize() / 2**20


async def phone(
    number: int, n: int, rate_hz: int, address: tuple[str, int], bodies: list[bytes], end: float, seen: Seen
) -> None:
    """Post so many messages a second until the end."""
    name = f"phone-{number:06d}".encode()
    begin = time.monotonic() + number / n
    reader, writer = await asyncio.open_connection(*address)
    for i, body in enumerate(bodies):
        await asyncio.sleep(max(begin + i / rate_hz - time.monotonic(), 0.0))
        sent = time.monotonic()
        if sent > end:
            break
        mine = body.replace(_NAME.encode(), name)
        head = f"POST /data HTTP/1.1\r\nHost: {address[0]}:{address[1]}\r\nContent-Length: {len(mine)}\r\n\r\n"
        writer.write(head.encode() + mine)
        answer = await reader.readuntil(b"\r\n\r\n")
        length = int(answer.lower().split(b"content-length:")[1].split(b"\r\n")[0])
        await reader.readexactly(length)
        if end - sent < end - begin - _WARM_UP_S:
            seen.answer_s.append(time.monotonic() - sent)
            seen.late_s.append(sent - (begin + i / rate_hz))
            seen.refused += b" 200 " not in answer[:20]
    writer.close()


async def watch(address: tuple[str, int], seen: Seen) -> None:
    """A page that is open: how old what it is told is."""
    async with connect(f"ws://{address[0]}:{address[1]}/ws", max_size=None) as socket:
        async for text in socket:
            event = json.loads(text)
            if event.get("received_unix_s"):
                seen.shown_s.append(time.time() - event["received_unix_s"])


async def crowd(
    n: int, rate_hz: int, server: Server, bodies: list[bytes], seconds: float, seen: Seen
) -> tuple[float, float]:
    """Cores used by server and workers, and processor time in ms for a second of samples of one phone."""
    host, port = server.address.removeprefix("http://").split(":")
    address = host, int(port)
    end = time.monotonic() + _WARM_UP_S + seconds
    watching = asyncio.create_task(watch(address, seen))
    phones = [asyncio.create_task(phone(i, n, rate_hz, address, bodies, end, seen)) for i in range(n)]
    await asyncio.sleep(_WARM_UP_S)
    seen.shown_s.clear()
    pids = [server.pid, *server.children]
    before, begun, n_before = cpu_s(pids), time.monotonic(), len(seen.answer_s)
    await asyncio.sleep(seconds)
    used_s, measured_s = cpu_s(pids) - before, time.monotonic() - begun
    phone_s = (len(seen.answer_s) - n_before) / rate_hz  # of answered messages, in real time or not
    await asyncio.gather(*phones)
    watching.cancel()
    return used_s / measured_s, 1e3 * used_s / max(phone_s, 1e-9)


def filter_ms(walk: pdr.Recording) -> float:
    """Processor time in ms of the filter alone for a second of samples, in blocks of a second: how fast a core is."""
    online, begun, seconds = pdr.OnlineFilter(), time.process_time(), np.arange(0.0, 60.0)
    for begin_s in seconds:
        rows = {n: (s, *np.searchsorted(s.time_s, [begin_s, begin_s + 1.0])) for n, s in walk.streams.items()}
        online.push_streams(
            {n: Samples(s.time_s[i:j], s.values[i:j]) for n, (s, i, j) in rows.items() if n in SENSORS}  # type: ignore[misc]
        )
    return 1e3 * (time.process_time() - begun) / len(seconds)


def of_phones(
    phones: list[int], rate_hz: int, seconds: float, workers: int, bodies: list[bytes], walk: pdr.Recording
) -> list[list[str]]:
    """A row for each number of phones."""
    rows: list[list[str]] = []
    for n in phones:
        seen, alone_ms = Seen(), filter_ms(walk)
        with tempfile.TemporaryDirectory() as folder:
            options_ = ("--record", folder, "--workers", str(workers), "--max-devices", str(n))
            with Server(*options_) as server:
                idle_mb = memory_mb(server.children)
                cores, phone_ms = asyncio.run(crowd(n, rate_hz, server, bodies, seconds, seen))
                phone_mb = (memory_mb(server.children) - idle_mb) / n
        alone_ms = (alone_ms + filter_ms(walk)) / 2
        answer, shown = (np.percentile(1e3 * np.array(s), [50, 99]) for s in (seen.answer_s, seen.shown_s or [np.nan]))
        keeps_up = np.percentile(seen.late_s, 99) < 1.0 and not seen.refused
        costs = [f"{cores:.2f}", f"{phone_ms:.1f}", f"{alone_ms:.1f}"]
        delays = [f"{median:.0f} / {late:.0f}" for median, late in (answer, shown)]
        rows.append([str(n), str(rate_hz), "yes" if keeps_up else "no", *costs, *delays, f"{phone_mb:.1f}"])
        print(rows[-1], f"load {os.getloadavg()[0]:.1f}", flush=True)
    return rows


def load(tables: Tables, arguments: argparse.Namespace) -> None:
    """How many phones a server filters."""
    walk, rows = pdr.simulate.demo_walk(), list[list[str]]()
    for rate_hz in arguments.rates:
        bodies = [json.dumps(m).encode() for m in sensor_logger_messages(walk, _NAME, part_s=1.0 / rate_hz)]
        rows += of_phones(arguments.phones, rate_hz, arguments.seconds, arguments.workers, bodies, walk)
    columns = "phones | messages a second | in real time | cores used | ms of one core a second and phone | "
    columns += "of the filter alone, then | answer p50 / p99, ms | event p50 / p99, ms | memory a phone, MB"
    about = f"{arguments.workers} workers; {os.cpu_count()} cores, shared with others (load {os.getloadavg()[0]:.0f})."
    tables.write("live_load", columns, rows, about)


if __name__ == "__main__":
    run(__doc__, load, phones=[10, 50, 100, 150, 200], rates=[1, 5], seconds=20.0, workers=2)
