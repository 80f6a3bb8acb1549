"""Phones that send to `pdr-filter live` for hours while its processes, its disk, its network and the phones fail.

usage: python -m tests.benchmarks.live_soak [phones] [disk] [--minutes 120] [--phones 25] [--speed 1] [--seed 0]

`phones`: each phone posts numbered messages of one second until they are answered. All but the first post over HTTP,
and the first one publishes to an MQTT broker. Meanwhile the server or its workers are killed, files cannot grow (as on
a full disk, by RLIMIT_FSIZE), clients hold half-sent requests, phones close connections before the answer and send
again, clocks of phones jump, and the broker is restarted. A row of a recording shows by its value which sample it is,
so that missing rows and rows that are there twice can be counted. What is published over the broker is not acknowledged
by the server, and is counted apart.

`disk`: the life of two sessions with a fault at each operation of the disk in turn, with each kind of fault.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdr_filter.simulate import demo_walk
from tests.benchmarks.common import Tables, run

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "apps" / "live"))
from faulty_disk import ERRORS, KILL, SHORT
from serving import Server
from test_live_full_disk import broken_lives

_RATE_HZ = 50
# An acceleration is rounded to this, and its number times the smaller one is added.
_GRID_MPS2, _NUMBER_MPS2 = 1e-3, 1e-9
_MAX_ROWS = int(0.5 * _GRID_MPS2 / _NUMBER_MPS2)
_FILE_BYTES = 20_000
_AGAIN_S, _ANSWER_S = 0.2, 20.0
_N_SLOW, _N_STARTS = 20, 5
BROKER = shutil.which("mosquitto") or next((p for p in ["/usr/sbin/mosquitto"] if Path(p).exists()), "")


@dataclass
class Phone:
    """Phone that walks the demo walk again and again, and numbers its samples."""

    name: str
    rng: np.random.Generator
    samples: np.ndarray[Any, Any]  # (N, 6), force and rate
    n_messages: int = 0
    n_rows: int = 0
    clock_s: float = 0.0

    def message(self, seen: Counter[str]) -> bytes:
        """Return the next second of samples."""
        if self.n_messages > 5 and self.rng.random() < 0.01:
            self.clock_s += float(self.rng.choice([-3600.0, -5.0, 5.0, 600.0]))
            seen["clock jumps"] += 1
        numbers = self.n_rows + np.arange(_RATE_HZ)
        if numbers[-1] > _MAX_ROWS:
            raise ValueError(f"more than {_MAX_ROWS} rows of a phone: choose fewer minutes or a lower speed")
        time_s = (self.clock_s + 1e5 + numbers / _RATE_HZ).tolist()
        rows = self.samples[numbers % len(self.samples)]
        force = np.round(rows[:, :3] / _GRID_MPS2) * _GRID_MPS2
        force[:, 0] += numbers * _NUMBER_MPS2
        streams = {"accelerometer": force.tolist(), "gyroscope": rows[:, 3:].tolist()}
        samples = {n: [[t, *v] for t, v in zip(time_s, values, strict=True)] for n, values in streams.items()}
        self.n_rows += _RATE_HZ
        self.n_messages += 1
        content = {"device": self.name, "session": "s", "number": self.n_messages - 1, "samples": samples}
        return json.dumps(content).encode()


@dataclass
class Soak:
    """Server under faults, and what was seen of it."""

    folder: Path
    n_phones: int
    minutes: float
    speed: float
    fault_s: float  # mean time between faults
    seed: int
    server: Server = field(init=False)
    seen: Counter[str] = field(default_factory=Counter[str])  # in all
    periods: list[tuple[Counter[str], float, float]] = field(default_factory=list[tuple[Counter[str], float, float]])
    refused: list[str] = field(default_factory=list[str])  # answers that no phone should get
    memory_mb: tuple[float, float] = 0.0, 0.0  # largest of server and of workers since the last period
    n_faults: int = 0
    is_over: bool = False

    def __post_init__(self) -> None:
        walk, rng = demo_walk(), np.random.default_rng(self.seed)
        step = round(100 / _RATE_HZ)
        assert walk.gyroscope is not None
        n = min(len(walk.accelerometer), len(walk.gyroscope))
        samples = np.column_stack([walk.accelerometer.values[:n:step], walk.gyroscope.values[:n:step]])
        self.rng = rng
        self.phones = [Phone(f"soak{i}", rng.spawn(1)[0], samples) for i in range(self.n_phones)]
        self.broker = _Broker(self.folder) if BROKER else None
        self.faults = [self._kill_server, self._kill_workers, self._fill_disk, self._hold_requests]
        self.faults += [] if self.broker is None else [self._restart_broker]

    def start(self) -> None:
        """Start the server, on the folder that an earlier one may have left."""
        mqtt = [] if self.broker is None else ["--mqtt", f"mqtt://127.0.0.1:{self.broker.port}/phones/+"]
        record, n = str(self.folder / "record"), str(self.n_phones + 5)
        self.server = Server("--record", record, "--workers", "2", "--max-devices", n, *mqtt)

    async def run(self, n_periods: int) -> None:
        """Let phones send and faults happen, each at least once, until the time is over and all is answered."""
        begun_s = time.monotonic()
        await asyncio.to_thread(self.start)
        phones = [asyncio.create_task(self._phone(phone, begun_s)) for phone in self.phones]
        others = [asyncio.create_task(self._faults()), asyncio.create_task(self._memory())]
        before = Counter[str]()
        for number in range(n_periods):
            await asyncio.sleep(begun_s + (number + 1) * 60 * self.minutes / n_periods - time.monotonic())
            self.periods.append((self.seen - before, *self.memory_mb))
            before, self.memory_mb = self.seen.copy(), (0.0, 0.0)
            print(self.periods[-1], self.refused[-3:], flush=True)
        while self.n_faults < len(self.faults):
            await asyncio.sleep(0.1)
        self.is_over = True
        await asyncio.gather(*phones, *others)
        await asyncio.sleep(3.0)  # for what the broker passes on
        await asyncio.to_thread(self.server.end)
        if self.broker is not None:
            self.broker.close()

    def check(self) -> dict[str, tuple[int, int, int]]:
        """Return the numbers of rows that were sent, that are missing and that are there twice, by phone."""
        found: dict[str, tuple[int, int, int]] = {}
        for phone in self.phones:
            folders = (self.folder / "record").glob(f"{phone.name}-*")
            (folder,) = (folder for folder in folders if ".damaged" not in folder.name)
            x = np.loadtxt(folder / "accelerometer.csv", delimiter=",", skiprows=1, usecols=1)
            numbers = np.round((x - np.round(x / _GRID_MPS2) * _GRID_MPS2) / _NUMBER_MPS2).astype(int)
            n_distinct = len(np.unique(numbers))
            found[phone.name] = phone.n_rows, phone.n_rows - n_distinct, len(numbers) - n_distinct
        return found

    # --- phones ---

    async def _phone(self, phone: Phone, begun_s: float) -> None:
        is_published = phone is self.phones[0] and self.broker is not None
        while not self.is_over:
            due_s = begun_s + phone.n_messages / self.speed
            await asyncio.sleep(max(due_s - time.monotonic(), 0.0))
            body = phone.message(self.seen)
            if is_published and self.broker is not None:
                self.broker.publish(body)
                continue
            while not await self._sent(phone, body):
                await asyncio.sleep(_AGAIN_S)

    async def _sent(self, phone: Phone, body: bytes) -> bool:
        """Return True if a message was answered. Sometimes the phone does not wait for the answer."""
        try:
            status, text = await asyncio.wait_for(self._posted(body, phone.rng.random() < 0.02), _ANSWER_S)
        except (OSError, EOFError, TimeoutError, ValueError):
            self.seen["reconnects"] += 1
            return False
        if status in (429, 503):
            self.seen["sent later"] += 1
            return False
        if status != 200:
            self.refused.append(f"{phone.name} {phone.n_messages - 1}: {status} {text}")
        self.seen["answered"] += 1
        return True

    async def _posted(self, body: bytes, is_impatient: bool) -> tuple[int, str]:
        host, port = self.server.address.removeprefix("http://").split(":")
        reader, writer = await asyncio.open_connection(host, int(port))
        try:
            head = f"POST /data HTTP/1.1\r\nHost: {host}:{port}\r\nContent-Length: {len(body)}\r\n"
            writer.write(f"{head}Connection: close\r\n\r\n".encode() + body)
            await writer.drain()
            if is_impatient:
                raise TimeoutError
            answer = await reader.read()
            if not answer:
                raise EOFError
        finally:
            writer.close()
        return int(answer.split(b" ", 2)[1]), answer.rpartition(b"\r\n\r\n")[2].decode()

    # --- faults ---

    async def _faults(self) -> None:
        while not self.is_over:
            await asyncio.sleep(min(self.rng.exponential(self.fault_s), 3 * self.fault_s))
            if self.n_faults % len(self.faults) == 0:
                self.rng.shuffle(self.faults)  # type: ignore[arg-type]
            fault = self.faults[self.n_faults % len(self.faults)]
            self.seen[fault.__name__.strip("_").replace("_", " ")] += 1
            await fault()
            self.n_faults += 1

    async def _kill_server(self) -> None:
        await asyncio.to_thread(self.server.kill)
        for _ in range(_N_STARTS):
            try:
                await asyncio.to_thread(self.start)
                break
            except RuntimeError as error:
                self.refused.append(f"the server did not start: {error}")

    async def _kill_workers(self) -> None:
        for pid in self.server.children:
            os.kill(pid, signal.SIGKILL)

    async def _fill_disk(self) -> None:
        """Let no file of the workers grow beyond a size for a while."""
        pids = self.server.children
        hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
        for limit in (int(self.rng.integers(_FILE_BYTES)), hard):
            for pid in pids:
                resource.prlimit(pid, resource.RLIMIT_FSIZE, (limit, hard))
            await asyncio.sleep(float(self.rng.uniform(0.5, 4.0)) if limit != hard else 0.0)

    async def _hold_requests(self) -> None:
        host, port = self.server.address.removeprefix("http://").split(":")
        held: list[asyncio.StreamWriter] = []
        try:
            for _ in range(_N_SLOW):
                held.append((await asyncio.open_connection(host, int(port)))[1])
                held[-1].write(f"POST /data HTTP/1.1\r\nHost: {host}:{port}\r\nContent-Length: 9000\r\n\r\n{{".encode())
            await asyncio.sleep(float(self.rng.uniform(0.5, 4.0)))
        except OSError:
            pass
        for writer in held:
            writer.close()

    async def _restart_broker(self) -> None:
        if self.broker is not None:
            await asyncio.to_thread(self.broker.restart)

    async def _memory(self) -> None:
        while not self.is_over:
            await asyncio.sleep(1.0)
            try:
                found = [_memory_mb([self.server.pid]), _memory_mb(self.server.children)]
            except (OSError, StopIteration):  # it was just killed
                continue
            self.memory_mb = max(found[0], self.memory_mb[0]), max(found[1], self.memory_mb[1])


class _Broker:
    """Mosquitto, and a client that publishes."""

    def __init__(self, folder: Path) -> None:
        import socket

        import paho.mqtt.client as mqtt

        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = int(free.getsockname()[1])
        self._config = folder / "mosquitto.conf"
        kept = f"persistence true\npersistence_location {folder}/\nautosave_on_changes true\nautosave_interval 1\n"
        self._config.write_text(f"listener {self.port} 127.0.0.1\nallow_anonymous true\nuser root\n{kept}")
        self._start()
        self._client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
        self._client.reconnect_delay_set(1, 2)
        self._client.connect("127.0.0.1", self.port)
        self._client.loop_start()

    def _start(self) -> None:
        quiet = subprocess.DEVNULL
        self._process = subprocess.Popen([BROKER, "-c", str(self._config)], stdout=quiet, stderr=quiet)
        time.sleep(0.5)

    def publish(self, body: bytes) -> None:
        self._client.publish("phones/one", body, qos=1)

    def restart(self) -> None:
        self._process.kill()
        self._process.wait()
        self._start()

    def close(self) -> None:
        self._client.disconnect()
        self._process.kill()
        self._process.wait()


def _memory_mb(pids: list[int]) -> float:
    """Return the memory of processes. Each of N processes that share a page counts an N-th of it."""
    kinds = [Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines() for pid in pids]
    return sum(int(next(line for line in lines if line.startswith("Pss:")).split()[1]) for lines in kinds) / 1024


def phones(tables: Tables, arguments: argparse.Namespace) -> None:
    """Phones and faults, a fifth of the time in a row."""
    folder = Path(tempfile.mkdtemp(prefix="pdr_filter_soak_"))
    made = Soak(folder, arguments.phones, arguments.minutes, arguments.speed, arguments.fault_s, arguments.seed)
    asyncio.run(made.run(5))
    rows: list[list[object]] = []
    kinds = ("answered", "sent later", "reconnects", "clock jumps")
    faults = ("kill server", "kill workers", "fill disk", "hold requests", "restart broker")
    for number, (seen, server_mb, workers_mb) in enumerate(made.periods):
        minutes = [round(arguments.minutes * n / len(made.periods), 1) for n in (number, number + 1)]
        counts = [[seen[name] for name in names] for names in (kinds, faults)]
        row = [f"{minutes[0]:g} to {minutes[1]:g}", *counts[0], " / ".join(map(str, counts[1]))]
        rows.append([*row, f"{server_mb:.0f}", f"{workers_mb:.0f}"])
    found = made.check()
    published = found.pop(made.phones[0].name) if made.broker is not None else (0, 0, 0)
    n, missing, twice = np.sum(list(found.values()), axis=0)
    n_aside = len(list((folder / "record").glob("*.damaged*")))
    about = (
        f"{arguments.phones} phones, {arguments.speed:g} s of samples a second each, 2 workers. Of {n} rows of "
        f"acknowledged messages {missing} are missing and {twice} are there twice; {n_aside} sessions were set aside, "
        f"and {len(made.refused)} messages were answered with an error. Over the broker, {published[1]} of "
        f"{published[0]} published rows are missing and {published[2]} are there twice."
    )
    columns = (
        "minutes | answered | sent again after 503 | after no answer | clock jumps | server killed / workers killed"
    )
    columns += " / disk full / requests held / broker restarted | memory of the server, MB | of both workers, MB"
    print(*made.refused, sep="\n")
    tables.write("live_soak", columns, rows, about)
    shutil.rmtree(folder)


def disk(tables: Tables, arguments: argparse.Namespace) -> None:
    """A fault at each operation of the disk."""
    rows: list[list[object]] = []
    for kind in (*ERRORS, SHORT, KILL):
        with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as folder:
            n, broken = broken_lives(Path(folder), patch, arguments.stride, [kind])
        print(kind, *broken, sep="\n", flush=True)
        rows.append([kind, n, len(broken)])
    columns = "fault | operations of the disk at which it began | lives that ended with other files"
    about = f"Life of two sessions with saved states, restarts, a fix and an end; every {arguments.stride}. operation."
    tables.write("live_disk", columns, rows, about.replace("every 1. operation", "every operation"))


if __name__ == "__main__":
    run(__doc__, phones, disk, minutes=120.0, phones=25, speed=1.0, fault_s=5.0, seed=0, stride=1)
