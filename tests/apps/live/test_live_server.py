"""A real server and real clients: what phones send becomes the track of `pdr_filter.track`, bad messages nothing."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import ssl
import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from serving import COMMAND, Server, own_messages, short_walk, until
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

import pdr_filter as pdr
from pdr_filter.apps.live import session as live_session
from pdr_filter.apps.live import sources
from pdr_filter.apps.live.broadcast import Reader
from pdr_filter.apps.live.certificate import certificate
from pdr_filter.apps.live.messages import parse
from pdr_filter.apps.live.parts import Answer
from pdr_filter.apps.live.settings import Settings
from pdr_filter.values.recording import Recording
from pdr_filter.values.serialisation import to_bytes


@pytest.fixture(scope="module")
def walk() -> Recording:
    return short_walk(32.0)


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("record")


@pytest.fixture(scope="module")
def server(record: Path) -> Iterator[Server]:
    with Server("--record", str(record), "--max-devices", "20") as running:
        yield running


def recorded(record: Path, track: dict[str, Any], walk: Recording) -> Recording:
    """The recording of a session when all of it is on the disk: its files are written one after the other."""

    def whole() -> Recording | None:
        folder = record / track["id"]
        if not (folder / "accelerometer.csv").exists() or not (folder / "gyroscope.csv").exists():
            return None
        recording, names = pdr.read(folder), ("accelerometer", "gyroscope", "magnetometer")
        is_whole = all(len(getattr(recording, n) or ()) >= len(getattr(walk, n)) for n in names)
        return recording if is_whole else None

    return until(whole)


def positions(track: dict[str, Any]) -> np.ndarray:
    return np.array(track["path"])[:, 1:3]


def test_a_pushed_walk_gives_the_track_of_its_recording_and_both_can_be_downloaded(
    server: Server, record: Path, walk: Recording, tmp_path: Path
) -> None:
    first, *rest = own_messages(walk, "whole", part_s=1.0)
    assert server.post([json.loads(first)]).json()["samples"] > 0  # an app may send several messages together
    for body in rest:
        assert server.post(body).status_code == 200
    track = server.tracks()["whole"]
    again = pdr.track(recorded(record, track, walk))
    np.testing.assert_array_equal(positions(track), again.position_m)
    assert len(again.time_s) > 40
    (feature,) = server.http.get(f"/sessions/{track['id']}/track.geojson").json()["features"]
    assert feature["geometry"]["type"] == "LineString"
    assert len(feature["geometry"]["coordinates"]) == len(track["path"])

    def has_all_steps() -> bool:  # they are written after the samples
        (tmp_path / "whole.zip").write_bytes(server.http.get(f"/sessions/{track['id']}/recording.zip").content)
        with zipfile.ZipFile(tmp_path / "whole.zip") as archive:
            assert {"meta.json", "steps.jsonl"} <= set(archive.namelist())
            return len(archive.read("steps.jsonl").splitlines()) == len(track["path"])

    until(has_all_steps)
    assert len(pdr.read(tmp_path / "whole.zip").accelerometer) == len(walk.accelerometer)


def test_a_websocket_gets_an_answer_to_each_message_and_the_track_of_its_recording(
    server: Server, record: Path, walk: Recording
) -> None:
    address = server.address.replace("http", "ws") + "/stream?device=socket"
    bodies = own_messages(walk, "", "")
    with connect(address) as client:
        for body in bodies:
            client.send(body)
        answers = [json.loads(client.recv(timeout=60)) for _ in bodies]
        client.send("{")
        assert json.loads(client.recv(timeout=60))["status"] == 400
    assert {answer["status"] for answer in answers} == {200}
    track = server.tracks()["socket"]
    again = pdr.track(recorded(record, track, walk))
    np.testing.assert_array_equal(positions(track), again.position_m)


def test_a_page_that_comes_late_is_told_the_contexts_until_then(
    walk: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_session, "_NOW_S", 0.0)  # what is sent at once is told as if it came in its time
    session = live_session.DeviceSession("late", "s", Settings(), tmp_path)
    for body in own_messages(walk, "late", part_s=0.5):
        for message in parse(body):
            session.take(message, 0.0)
            session.advance()
    track = session.snapshot()[0]
    times_s = [row["time_s"] for row in track["history"]]
    assert len(times_s) > 20
    assert min(np.diff(times_s)) >= 1.0
    assert max(row["context_prob"]["walking"] or 0.0 for row in track["history"]) > 0.5


@pytest.mark.parametrize(
    ("options", "height_m"),
    [({}, 1.62), ({"height_m": 1.9}, 1.62), ({"heights_m": (("wat", 1.55), ("watch", 1.5))}, 1.5)],
)
def test_person_and_placement_that_a_phone_sends_reach_the_filter_and_the_recording(
    walk: Recording, tmp_path: Path, options: dict[str, Any], height_m: float
) -> None:
    meta = {"name": "Ann's walk", "placement": "Left foot", "subject": {"height_m": 1.62, "age": 40, "x": "y"}}
    session = live_session.DeviceSession("watch 1", "s", Settings("zhou2019", **options), tmp_path)
    for body in own_messages(walk, "watch 1", "s")[:6]:
        for message in parse(json.dumps(json.loads(body) | {"meta": meta}).encode()):
            session.take(message, 0.0)
    assert session.online is not None
    session.save()
    recording = pdr.read(session.recorder.folder)
    assert (recording.name, recording.is_on_foot) == ("Ann's walk", True)
    assert (recording.subject.height_m, recording.subject.age) == (height_m, 40.0)
    expected = pdr.recipes.for_recording("zhou2019", recording)
    assert to_bytes(session.online.config) == to_bytes(expected)
    assert to_bytes(expected) != to_bytes(pdr.recipes.for_recording("zhou2019", walk))


def test_events_come_while_the_phone_sends(server: Server, walk: Recording) -> None:
    messages = own_messages(walk, "timed")[:40]
    seen: list[dict[str, Any]] = []
    with connect(server.address.replace("http", "ws") + "/ws") as reader:
        sender = threading.Thread(target=lambda: [server.post(message) for message in messages])
        sender.start()
        end = time.monotonic() + 60
        while time.monotonic() < end:
            event = json.loads(reader.recv(timeout=60))
            seen.append(event)
            if event.get("event") == "now" and event["id"].startswith("timed"):
                if event["received_unix_s"]:
                    event["delay_s"] = time.time() - event["received_unix_s"]
                if event["time_s"] > 17:  # the walk has 20 s; a slow server delays its last seconds
                    break
    mine = [e for e in seen if e.get("id", "").startswith("timed")]
    assert {"session", "step", "now"} <= {e["event"] for e in mine}
    assert all(e["delay_s"] >= 0 for e in mine if "delay_s" in e)
    steps = [e["index"] for e in mine if e["event"] == "step"]
    assert steps == sorted(set(steps))


def test_i_am_here_is_taken_and_nonsense_is_not(server: Server, walk: Recording) -> None:
    for body in own_messages(walk, "fixed", part_s=1.0)[:20]:
        server.post(body)
    track = server.tracks()["fixed"]
    address = f"/sessions/{track['id']}/fix"
    assert server.http.post(address, json={"east_m": 0.0, "north_m": 20.0}).status_code == 200
    assert server.http.post(address, json={"east_m": "x"}).status_code == 409
    assert server.http.post(address, content=b"{").status_code == 400
    assert server.http.post("/sessions/none/fix", json={}).status_code == 404


@pytest.mark.parametrize(
    ("body", "status"), [(b"{", 400), (b"", 400), (b"\x00" * 1000, 400), (b'{"payload": 1, "deviceId": "x"}', 400)]
)
def test_what_is_no_message_is_refused_with_a_reason(server: Server, body: bytes, status: int) -> None:
    answer = server.post(body)
    assert answer.status_code == status
    assert answer.json()["error"]


def test_a_body_of_100_megabytes_is_refused_without_being_kept(server: Server) -> None:
    def hundred() -> Iterator[bytes]:
        for _ in range(100):
            yield b" " * 2**20

    def memory_kb() -> int:
        return int(Path(f"/proc/{server.pid}/statm").read_text().split()[1]) * 4

    before = memory_kb()
    with contextlib.suppress(httpx.WriteError):  # the server has closed the connection already
        assert server.http.post("/data", content=hundred()).status_code == 413
    assert memory_kb() - before < 20_000
    assert server.post(b"{}").status_code == 200


def test_one_phone_that_sends_too_much_is_slowed_down_and_the_others_are_not(server: Server) -> None:
    body = b'{"deviceId": "flood", "hello": "' + b" " * 3_900_000 + b'"}'
    statuses = [server.post(body).status_code for _ in range(8)]
    assert 429 in statuses
    assert server.post(b'{"deviceId": "calm"}').status_code == 200


def test_pages_of_other_sites_and_other_names_are_refused(server: Server) -> None:
    assert server.http.get("/sessions", headers={"Origin": "http://evil.example"}).status_code == 403
    assert server.http.get("/sessions", headers={"Host": "evil.example"}).status_code == 403
    with pytest.raises(InvalidStatus):
        connect(server.address.replace("http", "ws") + "/ws", origin="http://evil.example").close()


@pytest.mark.parametrize("path", ["/page/../server.py", "/page/%2e%2e%2fserver.py", "/page/..%2fcli", "/page/x.js"])
def test_nothing_but_the_page_is_served(server: Server, path: str) -> None:
    assert server.http.get(path).status_code == 404


def test_a_reader_who_does_not_read_does_not_hold_up_the_others(server: Server, walk: Recording) -> None:
    host, port = server.address.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port))) as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.sendall(f"GET /events HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
        for body in own_messages(walk, "slow")[:60]:
            assert server.post(body).status_code == 200
        assert len(server.tracks()["slow"]["path"]) > 30
        slow.settimeout(60)
        received = b""
        while b'"event": "' not in received:
            received += slow.recv(1 << 20)


def test_what_waits_for_a_slow_reader_is_bounded_and_then_he_begins_anew() -> None:
    async def read() -> list[str]:
        reader = Reader()
        assert reader.is_stale  # at the beginning everybody gets the whole
        reader.clear()
        for i in range(500):
            reader.put(str(i))
        first = await reader.get()
        for i in range(500, 700):
            reader.put(str(i))
        assert reader.is_stale
        assert len(reader) < 500
        return [first, await reader.get()]

    assert asyncio.run(read()) == ["0", ""]


# --- servers of their own ---------------------------------------------------------------------------------------------


def test_a_server_with_open_pages_ends_without_a_traceback(walk: Recording) -> None:
    with Server() as server:
        for body in own_messages(walk)[:10]:
            server.post(body)
        host, port = server.address.removeprefix("http://").split(":")
        with (
            connect(server.address.replace("http", "ws") + "/ws") as reader,
            connect(server.address.replace("http", "ws") + "/stream") as sender,
            socket.create_connection((host, int(port))) as page,
        ):
            page.sendall(f"GET /events HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
            reader.recv(timeout=60)
            sender.send(b"{}")
            assert json.loads(sender.recv(timeout=60))["status"] == 200
            assert b"200 OK" in page.recv(1000)
            server.end()
    assert len(server.said) == 3  # the addresses, and how to end


def test_a_token_is_asked_for_when_others_can_reach_the_server(tmp_path: Path) -> None:
    with Server("--host", "0.0.0.0", "--record", str(tmp_path)) as server:
        assert len(server.token) >= 16
        assert server.post(b"{}").status_code == 200
        bare = httpx.Client(base_url=server.address)
        for path in ("/", "/sessions", "/events", "/phone", "/page/live.js", "/data?token=wrong", "/sessions?token="):
            assert bare.get(path).status_code == 401, path
        assert bare.get(f"/?token={server.token}").status_code == 200
        assert bare.get("/sessions").status_code == 200  # the page goes on with a cookie
        with pytest.raises(InvalidStatus):
            connect(server.address.replace("http", "ws") + "/stream").close()
        token = server.token
    with Server("--host", "0.0.0.0", "--record", str(tmp_path)) as server:
        assert server.token == token  # phones keep their address


def test_https_has_a_certificate_that_its_own_authority_vouches_for(tmp_path: Path) -> None:
    with Server("--https", "--token", "known", "--record", str(tmp_path)) as server:
        assert "browsers     https://" in "".join(server.said)
        trusted = ssl.create_default_context(cafile=str(tmp_path / "certificate" / "authority.pem"))
        with httpx.Client(base_url=server.address, verify=trusted, params={"token": "known"}) as client:
            assert client.get("/phone").status_code == 200
            assert client.get("/authority.pem").content == (tmp_path / "certificate" / "authority.pem").read_bytes()
        address = server.address.replace("https", "wss") + "/stream?token=known&device=safe"
        with connect(address, ssl=trusted) as socket:
            socket.send('{"samples": {"gyroscope": [[0, 1, 2, 3]]}}')
            assert json.loads(socket.recv(timeout=60)) == {"status": 200, "samples": 1}
        assert (tmp_path / "certificate" / "server.pem").stat().st_mode & 0o077 == 0


def test_a_certificate_is_kept_for_its_host_and_replaced_for_another_one(tmp_path: Path) -> None:
    first = certificate(tmp_path, "10.0.0.1").read_bytes()
    assert certificate(tmp_path, "10.0.0.1").read_bytes() == first
    assert certificate(tmp_path, "localhost").read_bytes() == first
    second = certificate(tmp_path, "10.0.0.22")
    assert second.read_bytes() != first
    ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(second)
    second.write_bytes(b"damaged")
    assert certificate(tmp_path, "10.0.0.22").read_bytes() != b"damaged"
    ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(second)


def test_a_replay_of_a_file_that_cannot_be_read_ends_the_server(tmp_path: Path) -> None:
    for name, content in (("nowhere.zip", None), ("broken.zip", b"no zip")):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        program = [sys.executable, "-c", COMMAND, "live", "--port", "0", "--replay"]
        done = subprocess.run([*program, str(tmp_path / name)], capture_output=True, text=True, timeout=90, check=False)
        assert done.returncode == 2
        assert f"{name}: " in done.stderr
        assert "page" not in done.stdout


def test_a_replay_ends_with_the_track_of_the_file(walk: Recording, tmp_path: Path) -> None:
    name = "Gänge \u2197 'zwei'"
    path = replace(walk, name=name).save(tmp_path / "walk.zip")
    with Server("--replay", str(path), "--speed", "100", "--workers", "2") as server:

        def ended() -> dict[str, Any] | None:
            found = [track for track in server.tracks().values() if track["has_ended"]]
            return found[0] if found else None

        track = until(ended)
    assert track["device"] == f"replay {name}"
    np.testing.assert_array_equal(positions(track), pdr.track(pdr.read(path)).position_m)


def test_a_replay_waits_for_a_busy_server_and_ends_with_the_reason_of_a_refusal(walk: Recording) -> None:
    said, bodies = list[str](), list[bytes]()
    answers = iter([Answer(503, {"error": "busy"}), Answer(200, {}), Answer(422, {"error": "no acceleration"})])

    async def take(body: bytes, **_: str) -> Answer:
        bodies.append(body)
        return next(answers)

    asyncio.run(sources.replay(walk, 100.0, sources.told(take, "--replay walk", said.append)))
    assert said == ["--replay walk: no acceleration"]
    assert bodies[0] == bodies[1] != bodies[2]
