"""Some seconds of what `tests.benchmarks.live_soak` does for two hours."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from tests.benchmarks import live_soak
from tests.benchmarks.live_soak import Soak


def test_phones_lose_no_row_while_the_disk_is_full_and_the_server_and_its_workers_are_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_soak, "BROKER", "")
    soak = Soak(tmp_path, 3, minutes=0.0, speed=4.0, fault_s=0.5, seed=3)
    asyncio.run(soak.run(1))
    assert min(soak.seen[name] for name in ("fill disk", "kill server", "kill workers", "sent later")) > 0
    assert soak.refused == []
    assert not list((tmp_path / "record").glob("*.damaged*"))
    for n_sent, n_missing, n_twice in soak.check().values():
        assert n_sent > 100
        assert (n_missing, n_twice) == (0, 0)
