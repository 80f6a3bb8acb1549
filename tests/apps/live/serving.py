"""A real server in a process of its own, and walks as phones would send them."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import TracebackType
from typing import Any

import httpx
import numpy as np
from average_walk import average_walk

from pdr_filter.apps.live.messages import N_VALUES, Message, MessageBatch, SensorRows, parse, to_json
from pdr_filter.apps.live.sessions import Sessions
from pdr_filter.values import Samples
from pdr_filter.values.recording import Recording

COMMAND = "from pdr_filter.apps.cli import main; main()"
START_S = 120.0  # a server that has not printed its addresses by then is killed, and its test fails
EPOCH_NS = 1_716_760_513_715_797_500


def take(devices: Sessions, body: bytes, unix_s: float = 0.0) -> None:
    """Process the body of a message, which is then filtered and on the disk."""
    (error,) = devices.take([MessageBatch("", parse(body), unix_s)])
    devices.advance(is_all=True)
    if error is not None:
        raise error


class Server:
    """`pdr-filter live` with these options; what it says is in `said`."""

    def __init__(self, *options: str, **environment: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", COMMAND, "live", "--port", "0", *options],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env={**os.environ, "OMP_NUM_THREADS": "1", **environment},
            start_new_session=True,
            text=True,
        )
        self.said: list[str] = []
        give_up = threading.Timer(START_S, self._process.kill)
        give_up.start()
        for line in self._process.stderr:
            self.said.append(line)
            if "Ctrl+C" in line:
                break
        give_up.cancel()
        found = re.search(r"phones send +(https?://\S+)/data(\?token=(\S+))?", "".join(self.said))
        if found is None:
            raise RuntimeError("".join(self.said) or "the server said nothing")
        self.token = found[3] or ""
        address = re.sub(r"//[^:]+:", "//127.0.0.1:", found[1])
        self.address = address
        headers = {"Authorization": f"Bearer {self.token}"} if self.token else {}
        self.http = httpx.Client(base_url=address, headers=headers, timeout=90, verify=False)
        self._listening = threading.Thread(target=self._listen, daemon=True)  # a full pipe would stop the server
        self._listening.start()

    def __enter__(self) -> Server:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._process.poll() is None:
            self.end()

    @property
    def pid(self) -> int:
        """Of the process that answers."""
        return self._process.pid

    @property
    def children(self) -> list[int]:
        """The workers."""
        threads = Path(f"/proc/{self.pid}/task").glob("*/children")  # each lists the processes that it has started
        listed = [pid for thread in threads for pid in thread.read_text().split()]
        names = {int(pid): Path(f"/proc/{pid}/cmdline").read_bytes() for pid in listed}
        return [pid for pid, name in names.items() if b"worker_process" in name]

    def end(self) -> int:
        """End it as Ctrl+C does."""
        self.http.close()
        self._process.send_signal(signal.SIGINT)
        return self._close()

    def kill(self) -> None:
        """End it and its workers in the middle of whatever they do."""
        os.killpg(self.pid, signal.SIGKILL)
        self._close()

    def _close(self) -> int:
        self._listening.join(30)
        self._process.stderr.close()
        return self._process.wait(30)

    def _listen(self) -> None:
        for line in self._process.stderr:
            self.said.append(line)

    def post(self, body: bytes | dict[str, Any] | list[Any], **parameters: str) -> httpx.Response:
        """What is said to a message."""
        content = body if isinstance(body, bytes) else json.dumps(body).encode()
        return self.http.post("/data", content=content, params=parameters)

    def tracks(self) -> dict[str, dict[str, Any]]:
        """Sessions with their paths, by device: what a page is told first."""
        n = len(self.http.get("/sessions").json()["sessions"])
        found: dict[str, dict[str, Any]] = {}
        if not n:
            return found
        with self.http.stream("GET", "/events") as answer:
            for event in events_of(answer):
                if event["event"] == "track":
                    found[event["device"]] = event
                if len(found) >= n:
                    return found
        raise AssertionError("the stream of events ended")


class Quiet(BaseHTTPRequestHandler):
    """Handler of requests that logs nothing."""

    def answer(self, body: bytes) -> None:
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: Any) -> None: ...


@contextmanager
def http_server(handler: type[Quiet]) -> Iterator[int]:
    """Port of a server in a thread."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server.server_address[1]
    server.shutdown()


def events_of(answer: httpx.Response) -> Iterator[dict[str, Any]]:
    """Server-sent events."""
    for line in answer.iter_lines():
        if line.startswith("data: "):
            yield json.loads(line[6:])


def until(condition: Any, timeout_s: float = 60.0) -> Any:
    """What a function returns when it first is true."""
    end, wait_s = time.monotonic() + timeout_s, 0.02
    while not (value := condition()):
        assert time.monotonic() < end, "never true"
        time.sleep(wait_s)
        wait_s = min(1.5 * wait_s, 0.5)  # a server that is asked all the time does little else
    return value


def short_walk(seconds: float) -> Recording:
    """The first seconds of the walk that the package comes with."""
    whole = average_walk()
    cut = {name: stream.time_s < seconds for name, stream in whole.streams.items()}
    return replace(whole, **{n: Samples(s.time_s[cut[n]], s.values[cut[n]]) for n, s in whole.streams.items()})


@dataclass(frozen=True)
class Part:
    """Samples of some time."""

    streams: dict[str, SensorRows]


def parts(recording: Recording, part_s: float = 0.5) -> list[Part]:
    """A recording cut by time."""
    streams = {n: s for n, s in recording.streams.items() if n in N_VALUES and n != "attitude"}
    begin_s = min(float(s.time_s[0]) for s in streams.values())
    end_s = max(float(s.time_s[-1]) for s in streams.values())
    found: list[Part] = []
    for at_s in np.arange(begin_s, end_s + part_s, part_s):
        inside = {n: (s.time_s >= at_s) & (s.time_s < at_s + part_s) for n, s in streams.items()}
        found.append(Part({n: SensorRows(s.time_s[inside[n]], s.values[inside[n]]) for n, s in streams.items()}))
    return found


def own_messages(recording: Recording, device: str = "p", session: str = "s", part_s: float = 0.5) -> list[bytes]:
    """A recording as messages of our own layout."""
    return list(_own_messages(recording, device, session, part_s))


@lru_cache(8)  # most tests send the same walk
def _own_messages(recording: Recording, device: str, session: str, part_s: float) -> list[bytes]:
    cut = parts(recording, part_s)
    return [
        to_json(
            Message(
                device,
                session,
                number,
                rows={n: r for n, r in part.streams.items() if len(r.time)},
                is_end=number == len(cut) - 1,
            )
        )
        for number, part in enumerate(cut)
    ]


def sensor_logger_messages(
    recording: Recording, device: str = "phone", session: str = "one", part_s: float = 0.5, ios: bool = False
) -> list[dict[str, Any]]:
    """A recording as Sensor Logger pushes it: iOS with gravity apart and the other sign, Android as a whole."""
    messages: list[dict[str, Any]] = []
    for number, part in enumerate(parts(recording, part_s)):
        payload: list[dict[str, Any]] = []
        for name, rows in part.streams.items():
            for time_s, values in zip(rows.time.tolist(), rows.values.tolist(), strict=True):
                time_ns = EPOCH_NS + round(time_s * 1e9)
                if name == "accelerometer" and ios:
                    gravity = [0.5, 5.0, 8.0]
                    rest = [-v - g for v, g in zip(values, gravity, strict=True)]
                    payload += [_sample("gravity", time_ns, gravity), _sample("accelerometer", time_ns, rest)]
                elif name == "accelerometer":
                    payload.append(_sample("totalacceleration", time_ns, values))
                elif name == "location":
                    keys = ("latitude", "longitude", "altitude", "horizontalAccuracy")
                    found = dict(zip(keys, values, strict=True))
                    payload.append({"name": "location", "time": time_ns, "values": found})
                elif name == "barometer":
                    payload.append({"name": name, "time": time_ns, "values": {"pressure": values[0]}})
                else:
                    payload.append(_sample(name, time_ns, values))
        payload.sort(key=lambda sample: sample["name"], reverse=True)  # in no order of time
        messages.append({"messageId": number, "sessionId": session, "deviceId": device, "payload": payload})
    return messages


def _sample(name: str, time_ns: int, values: list[float]) -> dict[str, Any]:
    return {"name": name, "time": time_ns, "values": dict(zip(("z", "y", "x"), reversed(values), strict=True))}
