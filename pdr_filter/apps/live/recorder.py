"""Folder of one session: a growing recording in the project's own format, and the state from which a server goes on.

Samples, steps and fixes are appended to text files that other programs read (`pdr_filter.read` takes the folder). The
journal holds the messages since the last saved state, one on a line as received. `Recorder.flush` writes both before a
message is acknowledged. `Recorder.saved` writes the state and begins a new journal. The state holds the length of each
file: a longer file is cut when the state is loaded, because the journal has the rest. A session that is not tracked
(yet) has the journal alone, which `pdr_filter.read` takes if Sensor Logger sent it. All this is for a process that
dies. After a power failure the last seconds may be missing, because nothing waits for the disk.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter.apps.live.messages import Message
from pdr_filter.data.io.files.own_format_writer import FILES, STREAM_COLUMNS
from pdr_filter.values import Samples
from pdr_filter.values import serialisation as serialise

STATE, CONFIG, META, STEPS, FIXES = "state.bin", "config.txt", "meta.json", "steps.jsonl", "fixes.csv"
RANGES = "ranges.csv"
DEVICE = "device.json"  # the gyroscope bias with which the session began
CONFIGS = "configurations"
_FIX_COLUMNS = "time_s,east_m,north_m,std_m\n"
_RANGE_COLUMNS = "time_s,anchor_east_m,anchor_north_m,range_m,std_m\n"


class Recorder:
    """Files of one session. Everything given to `samples`, `step`, `fix` and `journal` is in them after `flush`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._waiting: dict[str, list[str]] = {}
        self._sizes: dict[str, int] = {}
        self._n_saved = 0
        folder.mkdir(parents=True, exist_ok=True)

    def describe(self, meta: Mapping[str, Any], config: bytes) -> None:
        """Write the properties of the session, and its configuration to a file that all sessions with it share."""
        replace_file(self.folder / META, (json.dumps(dict(meta), indent=1) + "\n").encode())
        shared = self.folder.parent / CONFIGS / f"{hashlib.sha256(config).hexdigest()}.bin"
        if not shared.exists():
            shared.parent.mkdir(exist_ok=True)
            replace_file(shared, config)
        replace_file(self.folder / CONFIG, shared.name.encode())

    @property
    def is_described(self) -> bool:
        """True after `describe`, also by an earlier process."""
        return (self.folder / CONFIG).exists()

    def config(self) -> Any:
        """Configuration that was passed to `describe`."""
        name = (self.folder / CONFIG).read_text()
        return serialise.from_bytes((self.folder.parent / CONFIGS / name).read_bytes())

    def samples(self, name: str, rows: Samples) -> None:
        """Append samples of a sensor with all digits, so that the recording equals what the filter received."""
        table = np.column_stack([rows.time_s, rows.values]).tolist()
        lines = "".join([",".join(map(repr, row)) + "\n" for row in table]).replace("nan", "")
        self._append(f"{name}.csv", ",".join(("time_s", *STREAM_COLUMNS[name])) + "\n", lines)

    def step(self, line: str) -> None:
        """Append a step as JSON."""
        self._append(STEPS, "", line + "\n")

    def fix(self, time_s: float, east_m: float, north_m: float, std_m: float) -> None:
        """Append a fix in the columns that `pdr-filter smooth --fixes` reads."""
        self._append(FIXES, _FIX_COLUMNS, f"{time_s!r},{east_m!r},{north_m!r},{std_m!r}\n")

    def range(self, time_s: float, east_m: float, north_m: float, range_m: float, std_m: float) -> None:
        """Append a range to an anchor in the columns that `pdr-filter smooth --ranges` reads."""
        self._append(RANGES, _RANGE_COLUMNS, f"{time_s!r},{east_m!r},{north_m!r},{range_m!r},{std_m!r}\n")

    def journal(self, message: Message) -> None:
        """Append a message to the journal, where it stays until the next call of `saved`."""
        self._append(_journal(self._n_saved), "", _line(message))

    def flush(self) -> None:
        """Write everything that was appended. When this returns, the operating system has the data."""
        for name, lines in self._waiting.items():
            with (self.folder / name).open("ab", buffering=0) as file:
                file.write("".join(lines).encode())
                self._sizes[name] = file.tell()
        self._waiting = {}

    def save(self, state: object, held: Iterable[Message]) -> None:
        """Save a state from which `load` continues. A new journal begins with the messages that still wait."""
        self.flush()
        old = _journal(self._n_saved)
        self._n_saved += 1
        # before the state that names it, so that no message is without a journal
        lines = "".join(map(_line, held))
        new = _journal(self._n_saved)
        (self.folder / new).write_bytes(lines.encode())
        sizes = {name: size for name, size in self._sizes.items() if name != old}
        content = {"state": state, "sizes": sizes, "n_saved": self._n_saved}
        replace_file(self.folder / STATE, serialise.to_bytes(content))
        (self.folder / old).unlink(missing_ok=True)
        self._sizes = {**sizes, new: len(lines)}

    def load(self) -> tuple[Any, list[tuple[str, str, str, bytes]]]:
        """Return the state saved last, or None, and the messages since: device, session, platform and JSON.

        Lines that were written after the last save, and journals of earlier saves, are deleted.
        """
        path, state = self.folder / STATE, None
        if path.exists():
            content = serialise.from_bytes(path.read_bytes())
            state, self._sizes, self._n_saved = content["state"], dict(content["sizes"]), int(content["n_saved"])
        for name in (STEPS, FIXES, RANGES, *(f"{name}.csv" for name in STREAM_COLUMNS)):
            self._cut(name, self._sizes.get(name, 0))
        journal = self.folder / _journal(self._n_saved)
        for other in self.folder.glob("journal_*"):
            if other != journal:  # left by a process that died between two writes of `saved`
                other.unlink()
        whole, _, _ = (journal.read_bytes() if journal.exists() else b"").rpartition(b"\n")
        if journal.exists():  # a broken-off line was not acknowledged, and the next one must not follow it
            self._cut(journal.name, len(whole) + bool(whole))
            self._sizes[journal.name] = len(whole) + bool(whole)
        return state, [_entry(line.decode()) for line in whole.split(b"\n") if line]

    def steps(self) -> list[dict[str, Any]]:
        """Return the steps that were written to disk."""
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


def exported_files(folder: Path) -> dict[str, Path]:
    """Return the files of a recording for users, or the messages of a session that was not tracked, by name."""
    names = [name for name in (*FILES, STEPS, FIXES, RANGES, DEVICE) if (folder / name).exists()]
    journal = next(folder.glob("journal_*"), None)
    if not names and journal is not None:
        return {"messages.json": journal}
    return {name: folder / name for name in names}


def zip_bytes(files: Mapping[str, Path]) -> bytes:
    """Return a zip file with some files, by their names in it."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", compression=zipfile.ZIP_DEFLATED) as archive:
        for name, path in sorted(files.items()):
            archive.write(path, name)
    return content.getvalue()


def _journal(number: int) -> str:
    return f"journal_{number}.json"


def _line(message: Message) -> str:
    """Return a message as one line of the journal.

    Device, session and platform precede the JSON text. The text may lack them, because the address of the request can
    hold them.
    """
    names = {"device": message.device, "session": message.session, "platform": message.platform}
    return f"{json.dumps(names)} {message.source.decode('utf-8', 'replace')}\n"


def _entry(line: str) -> tuple[str, str, str, bytes]:
    names, end = json.JSONDecoder().raw_decode(line)
    return names["device"], names["session"], names["platform"], line[end + 1 :].encode()


def replace_file(path: Path, content: bytes) -> None:
    """Replace a file atomically: even if the process ends suddenly, the file is the old or the new one."""
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.part")  # two workers may write one configuration
    unfinished.write_bytes(content)
    unfinished.replace(path)
