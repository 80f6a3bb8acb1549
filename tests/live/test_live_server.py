"""A real server and real HTTP: what phones send becomes the track of `pdr_filter.track`, and bad messages nothing."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from serving import Server, own_messages, until

import pdr_filter as pdr
from pdr_filter.io.recording import Recording

EXAMPLE = Path(__file__).resolve().parents[3] / "shared" / "app_files" / "sensor_logger" / "http_push.json"


@pytest.fixture(scope="module")
def walk() -> Recording:
    """Half a minute of a walk with a barometer."""
    return pdr.simulate.demo_walk()


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("record")


@pytest.fixture(scope="module")
def server(record: Path) -> Iterator[Server]:
    with Server("--record", str(record), "--max-devices", "12") as running:
        yield running


def test_pushed_walks_give_the_track_of_their_recording(server: Server, record: Path, walk: Recording) -> None:
    for body in own_messages(walk, "whole"):
        assert server.post(body).status_code == 200
    track = server.tracks()["whole"]
    path = np.array(track["path"])
    server.http.get(f"/sessions/{track['id']}/recording.zip")
    again = pdr.track(until(lambda: _read(record / track["id"], len(walk.accelerometer))))
    np.testing.assert_array_equal(path[:, 1:3], again.position_m)
    assert len(path) > 150


def _read(folder: Path, n_samples: int) -> Recording | None:
    """The recording when all of it is on the disk."""
    if not (folder / "accelerometer.csv").exists():
        return None
    recording = pdr.read(folder)
    return recording if len(recording.accelerometer) == n_samples else None
