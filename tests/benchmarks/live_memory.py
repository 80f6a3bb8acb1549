"""Whether the memory of `pdr-filter live` stays what it is: an hour of one phone, replayed fifty times as fast.

usage: python -m tests.benchmarks.live_memory [--minutes 60] [--speed 50] [--print]

The embedded simulated walk follows itself again and again, with all its sensors. One program reads the events, and one
has asked for them and does not read. Memory is what the processes hold (resident set) when so much of the walk is
known; the server holds the recording that it replays.
"""

from __future__ import annotations

import asyncio
import json
import os
import resource
import socket
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from websockets.asyncio.client import connect

import pdr_filter as pdr
from tests.benchmarks.common import Tables, options

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "live"))
from serving import Server

_EVERY_S = 300.0


def long_walk(seconds: float) -> pdr.Recording:
    """The embedded walk, as often as it takes."""
    walk = pdr.simulate.demo_walk()
    step_s = float(np.diff(walk.accelerometer.time_s).mean())
    length_s = walk.duration_s + step_s
    times = range(int(np.ceil(seconds / length_s)))
    streams = {
        name: pdr.Samples(np.concatenate([s.time_s + i * length_s for i in times]), np.tile(s.values, (len(times), 1)))
        for name, s in walk.streams.items()
    }
    return pdr.Recording("long walk", **streams, meta=walk.meta)


def memory_mb(pids: list[int]) -> float:
    """What processes hold."""
    return sum(int(Path(f"/proc/{pid}/statm").read_text().split()[1]) for pid in pids) * resource.getpagesize() / 2**20


async def watch(server: Server, folder: Path, until_s: float) -> list[list[str]]:
    """A row each five minutes of the walk."""
    rows: list[list[str]] = []
    begun, n_steps = time.monotonic(), 0
    async with connect(server.address.replace("http", "ws") + "/ws", max_size=None) as reader:
        async for text in reader:
            event = json.loads(text)
            if event.get("event") != "now":
                continue
            n_steps = event["n_steps"]
            if event["time_s"] >= min((len(rows) + 1) * _EVERY_S, until_s - 5.0):
                state_kb = sum(p.stat().st_size for p in folder.glob("*/state.bin")) / 1024
                journal_kb = sum(p.stat().st_size for p in folder.glob("*/journal_*.json")) / 1024
                rows.append(
                    [
                        f"{event['time_s'] / 60:.0f}",
                        str(n_steps),
                        f"{memory_mb([server.pid]):.0f}",
                        f"{memory_mb(server.children):.0f}",
                        f"{state_kb:.0f}",
                        f"{journal_kb:.0f}",
                        f"{event['time_s'] / (time.monotonic() - begun):.0f}",
                    ]
                )
                print(rows[-1], flush=True)
            if event["time_s"] > until_s - 5.0:
                return rows
    raise AssertionError("the events ended")


def main() -> None:
    parser = options(__doc__ or "")
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--speed", type=float, default=50.0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        file = long_walk(60.0 * given.minutes).save(Path(folder) / "walk.zip")
        record = Path(folder) / "record"
        with Server("--replay", str(file), "--speed", str(given.speed), "--record", str(record)) as server:
            host, port = server.address.removeprefix("http://").split(":")
            with socket.create_connection((host, int(port))) as deaf:
                deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                deaf.sendall(f"GET /events HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
                rows = asyncio.run(watch(server, record, 60.0 * given.minutes))
    columns = ["minutes", "steps", "server, MB", "worker, MB", "state, kB", "journal, kB", "times as fast"]
    about = f"One worker; {os.cpu_count()} cores, shared."
    Tables.of(__spec__.name, given).write("live_memory", columns, rows, about)


if __name__ == "__main__":
    main()
