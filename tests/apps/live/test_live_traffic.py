"""Figures of a server for its pages."""

from __future__ import annotations

import asyncio
import shutil
from pathlib import Path
from types import SimpleNamespace

import httpx
import pytest

from pdr_filter.apps.live import traffic
from pdr_filter.apps.live.access import MAX_BODY_BYTES
from pdr_filter.apps.live.hub import Live
from pdr_filter.apps.live.parts import Answer
from pdr_filter.apps.live.server import live_application
from pdr_filter.apps.live.settings import Settings
from pdr_filter.apps.live.traffic import Traffic


def test_rates_are_of_the_last_half_minute_and_a_nearly_full_disk_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    now_s, free = [100.0], [1e12]
    monkeypatch.setattr(traffic.time, "monotonic", lambda: now_s[0])
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free[0]))
    server = Traffic(tmp_path)
    event = server.event()
    assert (event["messages_per_s"], event["answer_s"], event["disk_left_s"]) == (0.0, None, 1e12 / 0.1e6)
    for _ in range(30):  # a minute with a message a second
        for status in (200, 503):
            server.add(500_000, "p\x1b", Answer(status, {"error": "no space"}), 0.25)
        now_s[0] += 2.0
        event = server.event()
    assert (event["messages_per_s"], event["bytes_per_s"], event["answer_s"]) == (1.0, 500_000.0, 0.25)
    assert (event["n_refused"], event["refusal"]) == ({"503": 30}, "p\\x1b: no space")
    assert (event["disk_left_s"], event["is_disk_low"]) == (2e6, False)
    for free[0] in (1.7e9, 1.6e9, 1.9e9, 0.0):  # an hour of this rate needs 1.8 GB
        server.event()
    assert [record.getMessage().split(": ")[1] for record in caplog.records] == [
        "1700 MB left on the disk",
        "0 MB left on the disk",
    ]


def test_a_body_that_is_too_long_is_counted_as_refused(tmp_path: Path) -> None:
    live = Live(Settings(), tmp_path)

    async def post() -> int:
        application = httpx.ASGITransport(live_application(live))
        async with httpx.AsyncClient(transport=application, base_url="http://localhost") as client:
            return (await client.post("/data?device=watch", content=b" " * (MAX_BODY_BYTES + 1))).status_code

    assert asyncio.run(post()) == 413
    event = live.traffic.event()
    assert event["n_refused"] == {"413": 1}
    assert event["refusal"].startswith("watch: more than")
