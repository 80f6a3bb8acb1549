"""Phones that are asked, listened to, or heard over a broker; other programs stand for the phones."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np
import pytest
from serving import Quiet, Server, http_server, sensor_logger_messages, short_walk, until
from websockets.sync.server import ServerConnection, serve

import pdr_filter as pdr
from pdr_filter.values.recording import Recording

BROKER = shutil.which("mosquitto") or next((p for p in ["/usr/sbin/mosquitto"] if Path(p).exists()), "")
_LONGEST_S = 120.0  # a machine with other work takes long, and nothing but a failure takes as long as this
CONFIG = {
    "inputs": [
        {"source": "bluetooth"},
        {"source": "accelerometer", "outputs": [{"x": "aX"}, {"y": "aY"}, {"z": "aZ"}, {"t": "a t"}]},
        {"source": "gyroscope", "outputs": [{"x": "gX"}, {"y": "gY"}, {"z": "gZ"}, {"t": "g t"}]},
    ]
}


@pytest.fixture(scope="module")
def walk() -> Recording:
    """Forty seconds of a walk with two sensors."""
    return replace(short_walk(30.0), magnetometer=None)


@contextmanager
def phyphox(walk: Recording) -> Iterator[int]:
    """The remote interface of phyphox, on a port, with a walk that goes on by three seconds with each question.

    The phone has no network for two questions in the middle.
    """
    gyroscope = walk.gyroscope
    columns = {"a t": walk.accelerometer.time_s, "g t": gyroscope.time_s}
    columns |= {f"a{axis}": walk.accelerometer.values[:, i] for i, axis in enumerate("XYZ")}
    columns |= {f"g{axis}": gyroscope.values[:, i] for i, axis in enumerate("XYZ")}
    n_asked, without_network = 0, [5, 6]
    configs = [{"inputs": CONFIG["inputs"][:1]}]

    class Handler(Quiet):
        def do_GET(self) -> None:  # noqa: N802
            nonlocal n_asked
            url = urlsplit(self.path)
            if without_network and n_asked == without_network[0]:
                without_network.pop(0)
                n_asked += 1
                self.close_connection = True
            elif url.path == "/config":
                self.answer(json.dumps(configs.pop() if configs else CONFIG).encode())
            elif url.path == "/control":
                self.answer(b'{"result": true}')
            else:
                n_asked += 1
                content = {"buffer": self.buffers(url.query), "status": {"session": "x1", "measuring": True}}
                self.answer(json.dumps(content).encode())

        def buffers(self, query: str) -> dict[str, Any]:
            """As phyphox reads NAME=T|OTHER: what has a larger value than T in the other buffer."""
            until_s = 3.0 * n_asked
            found: dict[str, Any] = {}
            for name, asked in parse_qsl(query):
                after, _, other = asked.partition("|")
                by = columns[other or name]
                inside = (by > float(after)) & (by <= until_s)
                found[name] = {"buffer": columns[name][inside].tolist(), "size": 0, "updateMode": "partial"}
            return found

    with http_server(Handler) as port:
        yield port


@contextmanager
def sensor_server(walk: Recording) -> Iterator[int]:
    """SensorServer on a port: events of both sensors one by one."""
    events = [
        (t, {"type": f"android.sensor.{name}", "timestamp": round(1e9 * (1000.0 + t)), "values": v, "accuracy": 3})
        for name in ("accelerometer", "gyroscope")
        for t, v in zip(walk.streams[name].time_s.tolist(), walk.streams[name].values.tolist(), strict=True)
    ]
    events.sort(key=lambda event: event[0])

    def send(connection: ServerConnection) -> None:
        assert "android.sensor.gyroscope" in connection.request.path
        for _, event in events:
            connection.send(json.dumps(event))
        for _ in connection:  # until it is closed
            pass

    server = serve(send, "127.0.0.1", 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server.socket.getsockname()[1]
    server.shutdown()


@contextmanager
def broker(folder: Path) -> Iterator[tuple[int, int]]:
    """Mosquitto, over TCP and over WebSocket as Sensor Logger needs it."""
    ports: list[int] = []
    for _ in range(2):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            ports.append(free.getsockname()[1])
    path = folder / "mosquitto.conf"
    path.write_text(
        f"listener {ports[0]} 127.0.0.1\nlistener {ports[1]} 127.0.0.1\nprotocol websockets\nallow_anonymous true\n"
    )
    process = subprocess.Popen([BROKER, "-c", str(path)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield ports[0], ports[1]
    finally:
        process.terminate()
        process.wait(10)


def check(walk: Recording, record: Path, track: dict[str, Any]) -> None:
    """It is the walk's track, but for times that went through the app, and to the last bit that of what was recorded.

    But for the last steps, which wait for what follows.
    """
    path = np.array(track["path"])
    for expected, atol in ((pdr.track(replace(walk, meta={})), 0.02), (pdr.track(pdr.read(record / track["id"])), 0.0)):
        assert expected.n_steps - 8 <= len(path) <= expected.n_steps
        np.testing.assert_allclose(path[:, 1:3], expected.position_m[: len(path)], rtol=0, atol=atol)


def test_phyphox_and_sensor_server_give_the_track_of_the_walk(walk: Recording, tmp_path: Path) -> None:
    with (
        phyphox(walk) as asked,
        sensor_server(walk) as heard,
        Server(
            *("--record", str(tmp_path), "--phyphox", f"127.0.0.1:{asked}", "--sensorserver", f"127.0.0.1:{heard}")
        ) as server,
    ):
        names = (f"phyphox 127.0.0.1:{asked}", f"SensorServer 127.0.0.1:{heard}")
        n_steps = pdr.track(replace(walk, meta={})).n_steps

        def whole() -> dict[str, Any] | None:
            found = server.tracks()
            return found if all(n in found and len(found[n]["path"]) >= n_steps - 8 for n in names) else None

        found = until(whole, _LONGEST_S)
    for name in names:
        check(walk, tmp_path, found[name])
    assert "no acceleration with g" in "".join(server.said)
    assert "RemoteDisconnected" in "".join(server.said)


@contextmanager
def broker_and_server(folder: Path, *options: str) -> Iterator[tuple[Server, Callable[[str], None]]]:
    """A server that hears a broker, and a function that publishes a message over WebSocket as a phone does."""
    if not BROKER:
        if os.environ.get("CI") == "true":
            pytest.fail("CI needs mosquitto, which .ci/run installs")
        pytest.skip("no mosquitto on this machine")
    import paho.mqtt.client as mqtt

    with (
        broker(folder) as (tcp, websocket),
        Server(*options, "--mqtt", f"mqtt://127.0.0.1:{tcp}/phones/+") as server,
    ):
        client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, transport="websockets")
        client.connect("127.0.0.1", websocket)
        client.loop_start()

        def publish(content: str) -> None:
            client.publish("phones/one", content, qos=1).wait_for_publish(5)

        def subscribed() -> bool:
            """QoS 0 keeps nothing for those who are not there."""
            publish('{"device": "probe", "session": "s", "samples": {"gyroscope": [[0, 1, 2, 3]]}}')
            return bool(server.http.get("/sessions").json()["sessions"])

        until(subscribed)
        yield server, publish
        client.loop_stop()


def test_a_broker_passes_on_what_phones_publish_while_others_are_not_there(walk: Recording, tmp_path: Path) -> None:
    absent = ("--phyphox", "127.0.0.1:9", "--sensorserver", "127.0.0.1:9")
    record = tmp_path / "record"
    with broker_and_server(tmp_path, "--record", str(record), *absent) as (server, publish):
        for message in sensor_logger_messages(walk, "over mqtt"):
            publish(json.dumps(message))
        n_steps = pdr.track(replace(walk, meta={})).n_steps

        def whole() -> dict[str, Any] | None:
            found = server.tracks().get("over mqtt")
            return found if found and len(found["path"]) >= n_steps - 8 else None

        track = until(whole, _LONGEST_S)
    check(walk, record, track)
    said = [line for line in "".join(server.said).splitlines() if "trying again" in line]
    assert len(said) == 2 and all("127.0.0.1:9: " in line for line in said)  # phones that are not there, once each


def test_a_broker_keeps_what_is_published_while_the_server_is_down(walk: Recording, tmp_path: Path) -> None:
    record = tmp_path / "record"
    messages = [json.dumps(message) for message in sensor_logger_messages(walk, "over mqtt")]
    with broker_and_server(tmp_path, "--record", str(record)) as (server, publish):
        for message in messages[:20]:
            publish(message)
        until(lambda: "over mqtt" in server.tracks(), _LONGEST_S)
        server.kill()
        for message in messages[20:]:
            publish(message)
        n = len(walk.accelerometer)
        port = (tmp_path / "mosquitto.conf").read_text().split()[1]
        with Server("--record", str(record), "--mqtt", f"mqtt://127.0.0.1:{port}/phones/+"):
            (folder,) = record.glob("over_mqtt-*")
            until(lambda: len((folder / "accelerometer.csv").read_text().splitlines()) >= 1 + n, _LONGEST_S)
    assert len((folder / "accelerometer.csv").read_text().splitlines()) == 1 + n


def test_the_reason_why_a_message_of_a_broker_is_refused_is_told_once(walk: Recording, tmp_path: Path) -> None:
    with broker_and_server(tmp_path) as (server, publish):
        publish("no message")
        publish("no message")
        for message in sensor_logger_messages(walk, "unsigned", ios=True)[:8]:
            publish(json.dumps(message))
        until(lambda: server.tracks().get("unsigned", {}).get("refused"), _LONGEST_S)
    told = [line for line in server.said if "--mqtt: " in line]
    assert len(told) == 2
    assert "not JSON" in told[0]
    assert "iOS and Android have opposite signs" in told[1]
