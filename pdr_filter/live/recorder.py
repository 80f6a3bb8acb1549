"""The folder of one session: a recording in the project's own format that grows, and what a killed server goes on from.

Samples, steps and fixes are appended to text files that other programs read (`pdr_filter.read` takes the folder). What
came since the last time that all was saved is in a journal, message by message as received, so that nothing that was
acknowledged is lost: `Recorder.saved` writes samples and state and begins a new journal; the state says how long each
file was, and a file that is longer is cut when the state is loaded again, because the journal has the rest. All this
is for a process that dies; after a power failure the last seconds may be missing, because nothing waits for the disk.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter import serialise
from pdr_filter.io.own_writer import STREAM_COLUMNS
from pdr_filter.live.messages import Message
from pdr_filter.values import Samples

STATE, CONFIG, META, STEPS, FIXES = "state.bin", "config.txt", "meta.json", "steps.jsonl", "fixes.csv"
CONFIGS = "configurations"
_FIX_COLUMNS = "time_s,east_m,north_m,std_m\n"
# Of the state and of the length of a message in a journal.
_LENGTH_BYTES = 8


class Recorder:
    """Files of one session. What is given to `samples`, `step` and `fix` is on the disk after `saved`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._waiting: dict[str, list[str]] = {}
        self._sizes: dict[str, int] = {}
        self._n_saved = 0
        folder.mkdir(parents=True, exist_ok=True)

    def describe(self, meta: Mapping[str, Any], config: bytes) -> None:
        """Write what is known of the session once and for all; sessions of one configuration share its file."""
        _replace(self.folder / META, (json.dumps(dict(meta), indent=1) + "\n").encode())
        shared = self.folder.parent / CONFIGS / f"{hashlib.sha256(config).hexdigest()}.bin"
        if not shared.exists():
            shared.parent.mkdir(exist_ok=True)
            _replace(shared, config)
        _replace(self.folder / CONFIG, shared.name.encode())

    def config(self) -> Any:
        """The configuration that `describe` was given."""
        name = (self.folder / CONFIG).read_text()
        return serialise.from_bytes((self.folder.parent / CONFIGS / name).read_bytes())

    def samples(self, name: str, rows: Samples) -> None:
        """Append samples of a sensor: every digit, so that the recording is what the filter had."""
        table = np.column_stack([rows.time_s, rows.values]).tolist()
        lines = "".join([",".join(map(repr, row)) + "\n" for row in table]).replace("nan", "")
        self._append(f"{name}.csv", ",".join(("time_s", *STREAM_COLUMNS[name])) + "\n", lines)

    def step(self, line: str) -> None:
        """Append a step as JSON."""
        self._append(STEPS, "", line + "\n")

    def fix(self, time_s: float, east_m: float, north_m: float, std_m: float) -> None:
        """Append a fix, as `pdr-filter smooth --fixes` reads it."""
        self._append(FIXES, _FIX_COLUMNS, f"{time_s!r},{east_m!r},{north_m!r},{std_m!r}\n")

    def journal(self, message: Message) -> None:
        """Keep a message until the next `saved`; it is out of this process when this returns."""
        content = json.dumps([message.device, message.session, message.platform]).encode() + b"\n" + message.source
        with self._journal(self._n_saved).open("ab") as file:
            file.write(len(content).to_bytes(_LENGTH_BYTES) + content)

    def saved(self, state: object) -> None:
        """Write what waits, and a state from which `load` goes on; the journal begins anew."""
        for name, lines in self._waiting.items():
            path = self.folder / name
            with path.open("ab") as file:
                file.write("".join(lines).encode())
                self._sizes[name] = file.tell()
        self._waiting = {}
        content = {"state": state, "sizes": self._sizes, "n_saved": self._n_saved + 1}
        _replace(self.folder / STATE, serialise.to_bytes(content))
        self._journal(self._n_saved).unlink(missing_ok=True)
        self._n_saved += 1

    def load(self) -> tuple[Any, list[tuple[str, str, str, bytes]]]:
        """The state that was saved last, None if none was, and what has come since: device, session, platform, JSON."""
        path, state = self.folder / STATE, None
        if path.exists():
            content = serialise.from_bytes(path.read_bytes())
            state, self._sizes, self._n_saved = content["state"], dict(content["sizes"]), int(content["n_saved"])
        for name in (STEPS, FIXES, *(f"{name}.csv" for name in STREAM_COLUMNS)):
            self._cut(name, self._sizes.get(name, 0))
        entries: list[tuple[str, str, str, bytes]] = []
        journal = self._journal(self._n_saved)
        content = journal.read_bytes() if journal.exists() else b""
        at = 0
        while at + _LENGTH_BYTES <= len(content):
            end = at + _LENGTH_BYTES + int.from_bytes(content[at : at + _LENGTH_BYTES])
            if end > len(content):
                break  # the write that was broken off: it was not acknowledged
            head, _, body = content[at + _LENGTH_BYTES : end].partition(b"\n")
            device, session, platform = json.loads(head)
            entries.append((device, session, platform, body))
            at = end
        return state, entries

    def steps(self) -> list[dict[str, Any]]:
        """The steps that are on the disk."""
        path = self.folder / STEPS
        return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []

    def _append(self, name: str, header: str, lines: str) -> None:
        waiting = self._waiting.setdefault(name, [])
        if not waiting and name not in self._sizes:
            waiting.append(header)
        waiting.append(lines)

    def _cut(self, name: str, size: int) -> None:
        path = self.folder / name
        if path.exists() and path.stat().st_size > size:
            if size == 0:
                path.unlink()
            else:
                with path.open("r+b") as file:
                    file.truncate(size)

    def _journal(self, number: int) -> Path:
        return self.folder / f"journal_{number}.bin"


def _replace(path: Path, content: bytes) -> None:
    """A file is the old one or the new one, whenever the process ends."""
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.part")  # two workers may write one configuration
    unfinished.write_bytes(content)
    unfinished.replace(path)
