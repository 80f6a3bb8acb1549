"""Folder of one session: a growing recording in the project's own format, and the state from which a server goes on.

The journal holds the messages since the last saved state, one on a line as received. Messages are in it before anything
else happens to them, so an acknowledged message is never lost, and a message that could not be written changes nothing.
Samples, steps and fixes are appended to text files that other programs read (`pdr_filter.read` takes the folder). If
the disk is full, they wait in memory, because the journal has them all. `Recorder.save` writes the state and begins a
new journal. The state holds the length of each file: a longer file is cut when the state is loaded, because the journal
has the rest. A session that is not tracked (yet) has the journal alone, which `pdr_filter.read` takes if Sensor Logger
sent it.

"Written" means that the operating system has the bytes, which protects from the death of a process. After a power
failure the messages since the last saved state may be missing, because only `Recorder.save` waits for the disk. Waiting
at each message would take longer than the filter.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter.apps.live.messages import Message, parse
from pdr_filter.data.io.files.own_format_writer import FILES, STREAM_COLUMNS
from pdr_filter.values import Samples
from pdr_filter.values import serialisation as serialise
from pdr_filter.values.safe_files import append_whole, cut_file, sync_file, whole_file

STATE, CONFIG, META, STEPS, FIXES = "state.bin", "config.txt", "meta.json", "steps.jsonl", "fixes.csv"
RANGES = "ranges.csv"
DEVICE = "device.json"  # the gyroscope bias with which the session began
CONFIGS = "configurations"
# In the folder of a session while it is loaded: a byte for each try. It stays if the process does not survive this.
TRIES = ".tries"
# From the second try on, a message of the session loads it alone. A server that is killed for another reason may meet
# the same session twice. A server that ends at every try serves no other phone.
_MAX_TRIES = 4
_APPENDED = (STEPS, FIXES, RANGES, *(f"{name}.csv" for name in STREAM_COLUMNS))
_ZIP_BLOCK_BYTES = 2**20
_FIX_COLUMNS = "time_s,east_m,north_m,std_m\n"
_RANGE_COLUMNS = "time_s,anchor_east_m,anchor_north_m,range_m,std_m\n"


class DamagedError(ValueError):
    """Error for a session whose files do not have the bytes that were written. It names the file."""


class Recorder:
    """Files of one session. `journal` writes at once, and `flush` what was given to the other methods."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._description: tuple[bytes, bytes] | None = None  # metadata and configuration that `flush` writes
        self._waiting: dict[str, list[str]] = {}  # lines that `flush` writes
        self._sizes: dict[str, int] = {}  # number of valid bytes of each file except the journal
        self._n_saved, self._journal_size = 0, 0
        self._is_marked = False  # whether the mark of `trying` is to be deleted
        folder.mkdir(parents=True, exist_ok=True)

    def describe(self, meta: Mapping[str, Any], config: bytes) -> None:
        """Set the properties of the session, and its configuration. All sessions with it share one file."""
        self._description = (json.dumps(dict(meta), indent=1) + "\n").encode(), config

    def config(self) -> Any:
        """Configuration that was passed to `describe`. DamagedError if its file is not the one that was written."""
        with reading(CONFIG):
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

    def journal(self, messages: Iterable[Message]) -> None:
        """Write messages to the journal, all or none, where they stay until the next call of `save`."""
        if lines := _lines(messages):
            path = self.folder / _journal(self._n_saved)
            self._journal_size = append_whole(path, lines, self._journal_size)

    def flush(self) -> None:
        """Write all waiting lines. After an OSError, the next call writes the lines that are still waiting."""
        self._unmark()
        if self._description is not None:
            meta, config = self._description
            shared = self.folder.parent / CONFIGS / f"{hashlib.sha256(config).hexdigest()}.bin"
            if not shared.exists():
                _replace(shared, config)
            _replace(self.folder / META, meta)
            _replace(self.folder / CONFIG, shared.name.encode())
            self._description = None
        for name, lines in list(self._waiting.items()):
            content = "".join(lines).encode()
            self._sizes[name] = append_whole(self.folder / name, content, self._sizes.get(name, 0))
            del self._waiting[name]

    def save(self, state: object, held: Iterable[Message]) -> None:
        """Save a state from which `load` continues. A new journal begins with the messages that still wait.

        After an OSError the earlier state and its journal are those that `load` continues from.
        """
        self.flush()
        for name in self._sizes:
            sync_file(self.folder / name)  # a state that survives a power failure must not count bytes that do not
        old, number = self.folder / _journal(self._n_saved), self._n_saved + 1
        # before the state that names it, so that no message is without a journal
        size = append_whole(self.folder / _journal(number), _lines(held), 0)
        sync_file(self.folder / _journal(number))
        _replace(self.folder / STATE, serialise.to_bytes({"state": state, "sizes": self._sizes, "n_saved": number}))
        self._n_saved, self._journal_size = number, size
        with suppress(OSError):  # `load` deletes it otherwise
            old.unlink(missing_ok=True)

    def load(self) -> tuple[Any, Iterator[Message]]:
        """Return the state saved last, or None, and the messages since. DamagedError if a file is not what was written.

        Lines that were written after the last save, and journals of earlier saves, are deleted.
        """
        path, state = self.folder / STATE, None
        if path.exists():
            with reading(STATE):
                content = serialise.from_bytes(path.read_bytes())
                state, self._sizes, self._n_saved = content["state"], dict(content["sizes"]), int(content["n_saved"])
        journal, journals = self.folder / _journal(self._n_saved), list(self.folder.glob("journal_*"))
        if journals and journal not in journals:
            raise DamagedError(f"no {journal.name}, but {journals[0].name}: {STATE} is not the one that was saved last")
        sizes = {name: self._sizes.get(name, 0) for name in _APPENDED}
        for name, size in sizes.items():  # before anything is cut
            path = self.folder / name
            there = path.stat().st_size if path.exists() else 0
            if there < size:
                raise DamagedError(f"{name} has {there} bytes in place of {size}")
            if there > size and not journals:
                raise DamagedError(f"{name} has {there} bytes in place of {size}, and no journal has the rest")
        for name, size in sizes.items():
            cut_file(self.folder / name, size)
        for other in (*journals, *self.folder.glob(".*.part")):
            if other != journal:  # left by a process that died in `save`
                other.unlink()
        # a broken-off line was not acknowledged
        self._journal_size = sum(len(line) for line in _lines_of(journal) if line.endswith(b"\n"))
        cut_file(journal, self._journal_size)
        return state, _messages(_lines_of(journal))

    @contextmanager
    def trying(self) -> Generator[None]:
        """Mark the session while the block loads it. DamagedError if too many processes did not survive this."""
        mark = self.folder / TRIES
        n = mark.stat().st_size if mark.exists() else 0
        if n >= _MAX_TRIES:
            raise DamagedError(f"its messages ended the process that filtered them, {n} times")
        with suppress(OSError):  # a full disk must not keep a session from being shown
            mark.write_bytes(b"x" * (n + 1))
        try:
            yield
        except OSError:  # an error of the disk, which says nothing about the session
            with suppress(OSError):
                mark.unlink(missing_ok=True)
            raise
        self._is_marked = True
        with suppress(OSError):  # the next call of `flush` tries again
            self._unmark()

    def _unmark(self) -> None:
        if self._is_marked:
            (self.folder / TRIES).unlink(missing_ok=True)
            self._is_marked = False

    def steps(self) -> Iterator[dict[str, Any]]:
        """Yield the steps that were written to disk. ValueError if a line is damaged."""
        path = self.folder / STEPS
        if path.exists():
            with path.open() as file:
                yield from map(json.loads, file)

    def _append(self, name: str, header: str, lines: str) -> None:
        waiting = self._waiting.setdefault(name, [])
        if not waiting and name not in self._sizes:
            waiting.append(header)
        waiting.append(lines)


def exported_files(folder: Path, is_refused: bool = False) -> dict[str, Path]:
    """Return the files of a recording for users by name, and the messages that are in no other file.

    These are all messages of a session that was never tracked, and those since its last saved state of one that can be
    tracked no longer (`is_refused`).
    """
    names = (*FILES, STEPS, FIXES, RANGES, DEVICE) if (folder / META).exists() else ()
    found = {name: folder / name for name in names if (folder / name).exists()}
    journal = next(folder.glob("journal_*"), None)
    if journal is not None and (is_refused or not names):
        found["messages.json"] = journal
    return found


def zip_parts(files: Mapping[str, Path]) -> Iterator[bytes]:
    """Yield the parts of a zip file with some files, by their names in it. Files of any length need little memory."""
    waiting = _Waiting()
    with zipfile.ZipFile(waiting, "w") as archive:
        for name, path in sorted(files.items()):
            about = zipfile.ZipInfo.from_file(path, name, strict_timestamps=False)
            about.compress_type = zipfile.ZIP_DEFLATED
            with path.open("rb") as source, archive.open(about, "w") as member:
                while block := source.read(_ZIP_BLOCK_BYTES):
                    member.write(block)
                    yield waiting.taken()
    yield waiting.taken()


class _Waiting(io.RawIOBase):
    """File in memory whose content is taken in parts."""

    def __init__(self) -> None:
        self._content = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, content: Any) -> int:
        self._content += content
        return memoryview(content).nbytes

    def taken(self) -> bytes:
        """Return the bytes written since the previous call."""
        content, self._content = bytes(self._content), bytearray()
        return content


def _journal(number: int) -> str:
    return f"journal_{number}.json"


def _lines(messages: Iterable[Message]) -> bytes:
    """Return messages as lines of the journal.

    Device, session and platform precede the JSON text. The text may lack them, because the address of the request can
    hold them.
    """
    lines: list[bytes] = []
    for message in messages:
        names = {"device": message.device, "session": message.session, "platform": message.platform}
        lines.append(json.dumps(names).encode() + b" " + message.source.decode("utf-8", "replace").encode() + b"\n")
    return b"".join(lines)


def _lines_of(journal: Path) -> Iterator[bytes]:
    """Yield the lines of a journal, which may be too long for the memory after hours without a saved state."""
    if journal.exists():
        with journal.open("rb") as file:
            yield from file


def _messages(lines: Iterable[bytes]) -> Iterator[Message]:
    """Yield the messages of lines of the journal; DamagedError if a line has none."""
    for line in lines:
        with reading("journal"):
            text = line.decode()
            names, end = json.JSONDecoder().raw_decode(text)
            messages = parse(text[end + 1 : -1].encode(), **names)
        yield from messages


@contextmanager
def reading(name: str) -> Generator[None]:
    """Turn errors about the content of a file into DamagedError. Those of the disk and of memory remain."""
    try:
        yield
    except Exception as error:  # damaged bytes can raise any exception
        of_the_disk = isinstance(error, OSError) and not isinstance(error, FileNotFoundError | IsADirectoryError)
        if of_the_disk or isinstance(error, DamagedError | MemoryError):
            raise
        raise DamagedError(f"{name}: {error}") from error


def _replace(path: Path, content: bytes) -> None:
    with whole_file(path) as file:
        file.write(content)
