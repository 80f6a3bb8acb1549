"""Phones that are shared among the machines of a Dask cluster, of which one dies."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from serving import Server, own_messages, short_walk, until

import pdr_filter as pdr
from pdr_filter.apps.live import cluster as live_cluster
from pdr_filter.apps.live.cluster import DaskCluster
from pdr_filter.apps.live.settings import Settings, worker_of

# loaded by the tests alone: it takes a second
pytestmark = pytest.mark.skipif(not find_spec("distributed"), reason="no Dask on this machine")
PHONES = ("left", "right", "third", "fourth")


@contextmanager
def cluster(folder: Path, n_workers: int) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler and workers as they are started on machines of their own, without anybody who starts them again."""
    where = folder / "scheduler.json"
    local = ["--no-dashboard", "--host", "127.0.0.1"]
    options: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    dask = [sys.executable, "-m", "distributed.cli"]
    one = [*local, "--no-nanny", "--nthreads", "1", "--local-directory", str(folder)]
    running = [
        subprocess.Popen(
            [*dask[:-1], "distributed.cli.dask_scheduler", *local, "--port", "0", "--scheduler-file", str(where)],
            **options,
        )
    ]
    try:
        until(lambda: where.exists() and where.read_text().endswith("}"), 60.0)  # dask does not write it at once
        address = json.loads(where.read_text())["address"]
        running += [
            subprocess.Popen([*dask[:-1], "distributed.cli.dask_worker", address, *one], **options)
            for _ in range(n_workers)
        ]
        import distributed

        with distributed.Client(address, set_as_default=False) as client:
            client.wait_for_workers(n_workers, timeout=60)
        yield address, running[1:]
    finally:
        for process in running:
            process.kill()
            process.wait(10)


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_with_one_of_two_machines_killed_every_phone_goes_on_and_no_step_is_there_twice(tmp_path: Path) -> None:
    assert {worker_of(name, 2) for name in PHONES} == {0, 1}
    walk = short_walk(30.0)
    bodies = {name: own_messages(walk, name, part_s=1.0) for name in PHONES}
    n = len(bodies["left"])
    record = tmp_path / "record"
    with (
        cluster(tmp_path, 2) as (address, machines),
        Server("--record", str(record), "--scheduler", address, "--workers", "2") as server,
    ):
        for i in range(n):
            if i == n // 2:
                os.kill(machines[0].pid, signal.SIGKILL)
            for name in PHONES:
                answer = server.post(bodies[name][i])
                assert answer.status_code == 200, answer.text
        tracks = server.tracks()
        assert machines[1].poll() is None
    print("".join(server.said))
    expected = pdr.track(pdr.read(record / tracks["left"]["id"]))
    assert expected.n_steps > 30
    for name in PHONES:
        np.testing.assert_array_equal(np.array(tracks[name]["path"])[:, 1:3], expected.position_m)
        lines = (record / tracks[name]["id"] / "steps.jsonl").read_text().splitlines()
        assert [json.loads(line)["index"] for line in lines] == list(range(expected.n_steps))


def test_a_cluster_that_is_not_there_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_cluster, "DASK_CONNECT_S", 0.5)
    with pytest.raises(ValueError, match="no Dask scheduler at tcp://"):
        asyncio.run(DaskCluster("tcp://127.0.0.1:9", Settings(), tmp_path).connect())
