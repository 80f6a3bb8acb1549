"""Safe opening of untrusted files (regular files only) and atomic writing."""

from __future__ import annotations

import errno
import json
import os
import secrets
import stat
from collections.abc import Generator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from pdr_filter.values import limits
from pdr_filter.values.errors import RecordingError

# A pipe without a writer would otherwise be waited for, and a terminal become that of the process.
_FLAGS = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY", "O_BINARY"))
_KINDS = {stat.S_IFIFO: "a pipe", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device", stat.S_IFSOCK: "a socket"}


def open_regular(path: Path) -> IO[bytes]:
    """Open a regular file for reading. RecordingError for a pipe, a device or a sparse file."""
    _check_kind(path, path.stat().st_mode)  # opening a device can already do something
    number = os.open(path, _FLAGS)
    try:
        found = os.fstat(number)
        _check_kind(path, found.st_mode)
        if _is_hollow(number, found.st_size):
            raise RecordingError(
                f"{path}: {found.st_size} bytes, of which nearly all were never written; copy the recording again"
            )
        return os.fdopen(number, "rb")
    except BaseException:
        os.close(number)
        raise


def read_small(path: Path, most: int) -> bytes:
    """Return the bytes of a small regular file. RecordingError if there are more than `most`."""
    try:
        with open_regular(path) as file:
            content = file.read(most + 1)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror}); check path and permissions") from error
    if len(content) > most:
        raise RecordingError(f"{path}: more than {most} bytes; take out of it what is not needed")
    return content


def read_json(path: Path, most: int) -> Any:
    """Return the content of a small JSON file; RecordingError if it is not regular or not JSON."""
    content = read_small(path, most)
    try:
        return json.loads(content)
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{path}: not JSON ({error}); write it again as JSON in UTF-8") from error


def inside(path: Path, *folders: Path) -> Path:
    """Return the path unchanged. RecordingError if it is a link whose target is in none of the given folders."""
    target = path.resolve()
    if not any(target.is_relative_to(folder.resolve()) for folder in folders):
        raise RecordingError(f"{path}: a link that leads out of its folder, to {target}; put a copy of that file here")
    return path


def beside(path: Path, name: str) -> Path:
    """Return the path of the file `name` in the folder of `path`. RecordingError for a link to another folder."""
    return inside(path.with_name(name), path.parent, path.resolve().parent)


@contextmanager
def whole_file(path: str | Path) -> Generator[IO[bytes]]:
    """Open a file for atomic writing. It appears at the path when the block ends without an error.

    Until then it has another name in the same folder. A link stays a link. A path that is not a regular file, such as
    /dev/stdout, is written to directly.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path = path.resolve()
    there = path.exists()
    if there and not path.is_file():
        with path.open("wb") as file:
            yield file
        return
    unfinished = path.with_name(f".{secrets.token_hex(8)}.part")
    try:
        with unfinished.open("xb") as file:
            yield file
            _sync(file)
        if there:
            unfinished.chmod(stat.S_IMODE(path.stat().st_mode))
        unfinished.replace(path)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise
    if os.name == "posix":  # elsewhere a folder cannot be opened
        _sync_folder(path.parent)


def write_text(path: str | Path, text: str) -> Path:
    """Write a whole file of UTF-8 text and return its path."""
    with whole_file(path) as file:
        file.write(text.encode())
    return Path(path)


def write_files(contents: Mapping[Path, bytes]) -> None:
    """Write files that belong together. No file gets its name before all are on the disk."""
    with ExitStack() as opened:
        for path, content in contents.items():
            file = opened.enter_context(whole_file(path))
            file.write(content)
            _sync(file)


def append_whole(path: Path, content: bytes, size: int) -> int:
    """Append to a file whose first `size` bytes count, completely or not at all, and return how many count then.

    The operating system has the bytes after that, also if this process is killed. After an OSError the bytes are not
    in the file, or behind those that count: the next call cuts them off. FileNotFoundError if the folder, or some of
    the bytes that count, are not there.
    """
    try:
        with path.open("ab") as file:
            there = file.tell()
            if there < size:
                raise FileNotFoundError(errno.ENOENT, f"has {there} bytes in place of {size}", str(path))
            if there > size:
                file.truncate(size)
            file.write(content)
    except OSError:
        with suppress(OSError):
            cut_file(path, size)
        raise
    return size + len(content)


def cut_file(path: Path, size: int) -> None:
    """Shorten a file to `size` bytes if it is longer, and delete it if nothing is left."""
    if path.exists() and path.stat().st_size > size:
        if size:
            os.truncate(path, size)
        else:
            path.unlink()


def sync_file(path: Path) -> None:
    """Wait until the disk has the bytes of a file, so that a power failure does not take them."""
    with path.open("ab") as file:
        _sync(file)


def _sync(file: IO[bytes]) -> None:
    """Flush to disk, because some disks report only now that they are full."""
    file.flush()
    os.fsync(file.fileno())


def _sync_folder(path: Path) -> None:
    """Flush the names in a folder to disk, where its file system can. The files are complete without it."""
    with suppress(OSError):
        number = os.open(path, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def _check_kind(path: Path, mode: int) -> None:
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "a folder")
        raise RecordingError(f"{path}: not a file but {kind}; give a file")


def _is_hollow(number: int, size: int) -> bool:
    """Return True if too little of a file is on the disk for a zip file of this size (sparse file)."""
    if size <= limits.UNPACKED_FREELY_BYTES or not hasattr(os, "SEEK_DATA"):
        return False
    at = written = 0
    try:
        while at < size and written * limits.MAX_COMPRESSION_RATIO < size:
            begin = os.lseek(number, at, os.SEEK_DATA)
            at = os.lseek(number, begin, os.SEEK_HOLE)
            written += at - begin
    except OSError as error:
        if error.errno != errno.ENXIO:  # ENXIO: no more data; other errors: unknown
            return False
    os.lseek(number, 0, os.SEEK_SET)
    return written * limits.MAX_COMPRESSION_RATIO < size
