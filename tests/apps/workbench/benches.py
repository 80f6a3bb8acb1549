"""A workbench in this process, asked as a browser asks it, and walks for it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import httpx

import pdr_filter as pdr
from pdr_filter.apps.workbench.hub import Workbench
from pdr_filter.apps.workbench.server import workbench_application
from pdr_filter.simulate import demo_walk
from pdr_filter.values.recording import Recording, Truth

ORIGIN = "http://127.0.0.1"


@cache
def short_walk(seconds: float = 40.0) -> Recording:
    """The first seconds of the walk that the package comes with, without truth."""
    whole = demo_walk()
    cut = {name: stream.time_s < seconds for name, stream in whole.streams.items()}
    streams = {n: pdr.Samples(s.time_s[cut[n]], s.values[cut[n]]) for n, s in whole.streams.items()}
    return replace(whole, **streams, truth=Truth(), name="short")


class Client:
    """What a page asks of a workbench."""

    def __init__(self, http: httpx.AsyncClient, bench: Workbench) -> None:
        self.http, self.bench = http, bench

    async def get(self, path: str, status: int = 200) -> Any:
        answer = await self.http.get(path)
        assert answer.status_code == status, answer.text[:500]
        return answer.json() if "json" in answer.headers["content-type"] else answer.content

    async def post(self, path: str, content: Any, status: int = 200) -> Any:
        sent = {"content": content} if isinstance(content, bytes) else {"json": content}
        answer = await self.http.post(path, **sent)
        assert answer.status_code == status, answer.text[:500]
        return answer.json()

    async def walk(self, name: str) -> str:
        """Address of a walk."""
        await self.bench.scan(is_forced=True)
        return next(f"/walks/{w.id}" for w in self.bench.walks.by_id.values() if w.name == name)

    async def edit(self, address: str, status: int = 200, version: str = "", **changes: Any) -> Any:
        """Change some of the marks of a walk."""
        state = await self.get(address)
        marks = state["marks"] | changes
        return await self.post(f"{address}/marks", {"version": version or state["version"], "marks": marks}, status)

    async def drop(self, name: str, content: bytes, status: int = 200) -> Any:
        """Drop one file; the answer to its end."""
        token = f"{abs(hash(name)) % 16**16:016x}"
        await self.http.post(f"/drops/{token}", params={"name": name}, content=content)
        answer = await self.http.post(f"/drops/{token}/end", params={"name": name})
        assert answer.status_code == status, answer.text
        return answer.json()


@asynccontextmanager
async def running(folder: Path) -> AsyncIterator[Client]:
    """A client of a workbench of a folder, without its background work."""
    bench = Workbench(folder, 1)
    await bench.start()
    bench._tasks[0].cancel()
    transport = httpx.ASGITransport(workbench_application(bench, None))
    try:
        async with httpx.AsyncClient(transport=transport, base_url=ORIGIN, timeout=120) as http:
            yield Client(http, bench)
    finally:
        await bench.stop()
        await asyncio.gather(*bench._tasks, return_exceptions=True)
