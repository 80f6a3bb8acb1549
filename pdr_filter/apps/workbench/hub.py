"""Hub of the workbench: background work on all cores, quick answers for the open walk, and events for pages."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import time
from collections.abc import AsyncIterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from pdr_filter.apps.batch.worker_process import LostError, WorkerProcess
from pdr_filter.apps.live.broadcast import Broadcast
from pdr_filter.apps.workbench.walks import HIDDEN, Walk, Walks
from pdr_filter.apps.workbench.worker import make_worker, progress_of
from pdr_filter.values.safe_files import write_text

# Between two searches for new recordings.
_SCAN_S = 5.0
_PROGRESS_S = 0.5
# A recording that has just changed may still be growing.
_GROWING_S = 5.0


class FailedError(ValueError):
    """Error for a request that a worker could not answer. `errno` is the error number of an OSError, or 0."""

    def __init__(self, reason: str, errno: int = 0) -> None:
        super().__init__(reason)
        self.errno = errno


async def _result(process: WorkerProcess, method: str, *arguments: Any) -> Any:
    """Return the result of a method of `worker.Worker` in a process. FailedError with the reason if it fails."""
    try:
        answer = await process.answer((method, arguments))
    except LostError as error:
        raise FailedError(
            f"{error}: the file is too large or damaged, or the workbench was closed; give a smaller file, or "
            "export it again"
        ) from None
    if isinstance(answer, dict) and "error" in answer:
        raise FailedError(answer["error"], answer.get("errno") or 0)
    return answer


class Workbench:
    """Recordings of one folder, the worker processes that smooth them, and the open pages of the workbench."""

    def __init__(self, folder: Path, n_processes: int | None = None) -> None:
        self.folder, self.walks = folder, Walks(folder)
        self.cache = folder / HIDDEN / "cache"
        self.incoming = folder / HIDDEN / "incoming"
        n_others = n_processes or os.cpu_count() or 1
        make = partial(WorkerProcess, make_worker, str(self.cache), n_threads=1)
        self._quick, self._others = make(), [make() for _ in range(n_others)]
        self._waiting: asyncio.Queue[Walk] = asyncio.Queue()
        self.broadcast = Broadcast()
        self._tasks: list[asyncio.Task[None]] = []
        self._scanning, self._scanned_s = asyncio.Lock(), -_SCAN_S

    async def start(self) -> None:
        """Start the background tasks that process walks and look for new recordings."""
        shutil.rmtree(self.incoming, ignore_errors=True)  # of a server that was killed
        for folder in (self.cache, self.incoming):
            folder.mkdir(parents=True, exist_ok=True)
        write_text(self.cache.parent / ".gitignore", "*\n")
        self._tasks = [asyncio.create_task(self._work(process)) for process in self._others]
        self._tasks.append(asyncio.create_task(self._watch()))

    async def stop(self) -> None:
        """Close the event streams, and end the background tasks and the worker processes."""
        self.broadcast.end()
        for task in self._tasks:
            task.cancel()
        for process in (self._quick, *self._others):
            process.close()

    async def scan(self, is_forced: bool = False) -> None:
        """Look for new, changed and deleted recordings, at most every `_SCAN_S` unless `is_forced`; tell the pages."""
        async with self._scanning:
            if time.monotonic() - self._scanned_s < _SCAN_S and not is_forced:
                return
            known = set(self.walks.by_id)
            for walk in await asyncio.to_thread(self.walks.scan):
                self._waiting.put_nowait(walk)
                self.tell(walk.event())
            for id in known - set(self.walks.by_id):
                self.tell({"event": "gone", "id": id})
            self._scanned_s = time.monotonic()

    async def quick(self, method: str, *arguments: Any) -> Any:
        """Return the result of a method of `worker.Worker` in the process that is reserved for open pages."""
        return await _result(self._quick, method, *arguments)

    async def show(self, walk: Walk) -> dict[str, Any]:
        """Process a walk with its present marks in the worker process of open pages, and return its summary."""
        walk.summary = await self.quick("walk", str(walk.path), True)
        walk.state, walk.reason = "done", ""
        self.tell(walk.event())
        return walk.summary

    async def _work(self, process: WorkerProcess) -> None:
        while True:
            walk = await self._waiting.get()
            if time.time() - walk.stamp[1] / 1e9 < _GROWING_S and walk.path.is_dir():
                await asyncio.sleep(1.0)
                self._waiting.put_nowait(walk)
                continue
            walk.state = "working"
            self.tell(walk.event())
            try:
                walk.summary = await _result(process, "walk", str(walk.path))
                walk.state, walk.reason = "done", ""
            except FailedError as error:
                walk.state, walk.reason = "failed", str(error).replace(f"{self.folder}/", "")
            self.tell(walk.event())

    async def _watch(self) -> None:
        """While a page is open, send it the progress of walks in state "working", and look for new recordings."""
        while True:
            await asyncio.sleep(_PROGRESS_S)
            if not len(self.broadcast):
                continue
            for walk in list(self.walks.by_id.values()):
                if walk.state == "working":
                    self.tell({"event": "progress", "id": walk.id, "done": progress_of(self.cache, str(walk.path))})
            if time.monotonic() - self._scanned_s > 2 * _SCAN_S:
                with suppress(OSError):
                    await self.scan()

    # --- events ---

    def tell(self, event: dict[str, Any]) -> None:
        """Send an event to all pages."""
        self.broadcast.send(json.dumps(event))

    def events(self) -> AsyncIterator[str]:
        """Yield one page's events as JSON texts: first the state of all walks, then each event."""
        return self.broadcast.events(self._present)

    async def _present(self) -> list[str]:
        return [json.dumps({"event": "all", "walks": [walk.event() for walk in self.walks.by_id.values()]})]
