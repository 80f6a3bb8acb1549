"""Lock that keeps a second server from writing to the folder of a first one."""

from __future__ import annotations

import json
import os
import socket
import sys
from collections.abc import Generator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import IO, Any

NAME = ".lock"
# Windows forbids reading of locked bytes, so the locked byte lies behind the text.
_LOCKED_BYTE = 1 << 20


@contextmanager
def folder_lock(folder: Path, owner: str) -> Generator[None]:
    """Hold the lock of a folder, which is created if it does not exist, while the block runs.

    The operating system releases the lock when the process ends, also by a kill or a power failure. `owner` names the
    program and its address for the message of others. ValueError, which names the other process, if the lock is held. A
    file system that has no locks, such as some network drives, protects from nothing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / NAME
    with path.open("a+b") as file:
        if not _is_locked(file):
            raise ValueError(
                f"{folder} is in use by {_owner(path)}: two servers on one folder would lose samples; stop the other "
                "one, or give another folder"
            )
        with suppress(OSError):  # a full disk has no room for the name
            file.truncate(0)
            began = datetime.now().astimezone().isoformat(timespec="seconds")
            content = {"owner": owner, "process": os.getpid(), "host": socket.gethostname(), "began": began}
            file.write(json.dumps(content).encode() + b"\n")
            file.flush()
        yield


def _owner(path: Path) -> str:
    try:
        found: Any = json.loads(path.read_text())
        return f"{found['owner']} (process {found['process']} on {found['host']}, since {found['began']})"
    except (OSError, ValueError, KeyError, TypeError):  # the other process is about to write it, or had no room
        return "another process"


def _is_locked(file: IO[bytes]) -> bool:
    """Lock a file without waiting, and return False if another process holds the lock."""
    if sys.platform == "win32":
        import msvcrt

        file.seek(_LOCKED_BYTE)
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return not isinstance(error, BlockingIOError)  # other errors are of file systems without locks
    return True
