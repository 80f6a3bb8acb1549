"""Phones with real times and real troubles: no acknowledged row is lost, and the track is that of the recording."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from serving import EPOCH_NS, Server, sensor_logger_messages, short_walk, take, until

import pdr_filter as pdr
from pdr_filter.apps.live.sessions import Sessions
from pdr_filter.apps.live.settings import Settings
from pdr_filter.values.recording import Recording

Messages = list[dict[str, Any]]
N_STEPS = 40  # least number of steps: the last ones of the walk wait for later samples


@pytest.fixture(scope="module")
def walk() -> Recording:
    return short_walk(32.0)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Server, Path]]:
    record = tmp_path_factory.mktemp("record")
    with Server("--record", str(record), "--workers", "2", "--max-devices", "40") as running:
        yield running, record


def with_times(messages: Messages, change: Callable[[int], Any]) -> Messages:
    return [{**m, "payload": [{**s, "time": change(s["time"])} for s in m["payload"]]} for m in messages]


def outage(messages: Messages) -> Messages:
    """Twenty seconds without network: the newest message arrives before those that were kept."""
    return [*messages[:7], messages[27], *messages[7:27], *messages[28:]]


def set_back(messages: Messages) -> Messages:
    return with_times(messages, lambda t: t - 30_000_000_000 * (t >= EPOCH_NS + 20_000_000_000))


TROUBLES: dict[str, Callable[[Messages], Messages]] = {
    "none": lambda messages: messages,
    "outage": outage,
    "clock set back": set_back,
    "milliseconds": lambda messages: with_times(messages, lambda t: t // 1_000_000),
    "float milliseconds": lambda messages: with_times(messages, lambda t: t / 1_000_000),
    "float nanoseconds": lambda messages: with_times(messages, float),
    "float seconds": lambda messages: with_times(messages, lambda t: t / 1e9),
}


def check(record: Path, track: dict[str, Any], walk: Recording, n_steps: int = N_STEPS) -> Recording:
    """Every row of the walk is in the recording, whose track is the live one."""

    def whole() -> Recording | None:
        recording = pdr.read(record / track["id"])
        return recording if all(len(recording.streams[n]) == len(s) for n, s in walk.streams.items()) else None

    recording = until(whole)
    for name, stream in walk.streams.items():
        order = np.argsort(recording.streams[name].time_s, kind="stable")
        np.testing.assert_array_equal(recording.streams[name].values[order], stream.values)
    path = np.array(track["path"])[:, 1:3]
    np.testing.assert_array_equal(path, pdr.track(recording).position_m[: len(path)])
    assert len(path) >= n_steps
    return recording


@pytest.mark.parametrize("trouble", TROUBLES)
def test_whatever_happens_on_the_way_the_recording_has_every_row_and_the_track_is_its(
    server: tuple[Server, Path], walk: Recording, trouble: str
) -> None:
    running, record = server
    for message in TROUBLES[trouble](sensor_logger_messages(walk, trouble, part_s=1.0)):
        assert running.post(message).status_code == 200
    track = running.tracks()[trouble]
    check(record, track, walk)
    assert (track["n_lost_messages"], track["n_repeated_messages"]) == (0, 0)


@pytest.mark.parametrize("name", ["iPhone de José", 'back\\slash "quoted"', "\U0001f4f1", 4711])
def test_every_name_reaches_the_worker_of_its_phone(
    server: tuple[Server, Path], walk: Recording, name: str | int
) -> None:
    """In JSON a name may be written with escapes, or be a number."""
    running, record = server
    messages = sensor_logger_messages(walk, "x", part_s=1.0)
    for number, message in enumerate(messages):
        body = json.dumps({**message, "deviceId": name}, ensure_ascii=number % 2 == 0).encode()
        assert running.post(body).status_code == 200
    check(record, running.tracks()[str(name)], walk)


def test_a_server_and_workers_that_are_killed_go_on_with_real_times(walk: Recording, tmp_path: Path) -> None:
    messages = sensor_logger_messages(walk, "iPhone de José")
    n_rows = 0
    with Server("--record", str(tmp_path), "--workers", "2") as server:
        for number, message in enumerate(messages[:50]):
            assert server.post(message).status_code == 200
            n_rows += sum(sample["name"] == "totalacceleration" for sample in message["payload"])
            if number in (20, 40):
                for pid in server.children:
                    os.kill(pid, signal.SIGKILL)
        server.kill()
    (folder,) = tmp_path.glob("iPhone*")
    assert len(pdr.read(folder).accelerometer) == n_rows  # before any server has gone on
    with Server("--record", str(tmp_path)) as server:
        for message in messages[49:]:
            assert server.post(message).status_code == 200
        check(tmp_path, server.tracks()["iPhone de José"], walk)
    steps = [json.loads(line)["index"] for line in (folder / "steps.jsonl").read_text().splitlines()]
    assert steps == list(range(len(steps)))  # none twice


def test_a_phone_that_returns_after_an_hour_goes_on_in_its_session(walk: Recording, tmp_path: Path) -> None:
    devices = Sessions(Settings(), tmp_path, lambda _: None)
    messages = sensor_logger_messages(walk)
    later = with_times(messages[45:], lambda t: t + 3600 * 10**9)
    for message in messages[:45]:
        take(devices, json.dumps(message).encode())
    (session,) = devices.sessions.values()
    session.seen_at -= 3600.0
    devices.maintain()
    assert devices.sessions == {}
    for message in later:
        take(devices, json.dumps(message).encode())
    (session,) = devices.sessions.values()
    recording = check(tmp_path, session.track(), walk, n_steps=40)
    assert recording.accelerometer.time_s[-1] > 3600.0
