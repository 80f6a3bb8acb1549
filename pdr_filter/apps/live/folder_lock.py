"""Lock that keeps a second server from writing to the folder of a first one."""

from __future__ import annotations

import json
import os
import socket
import sys
from collections.abc import Generator
from contextlib import ExitStack, contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Any

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
    with ExitStack() as opened:
        file = opened.enter_context(path.open("a+b"))
        locked = [file.fileno()]
        if sys.platform != "win32":  # there, a file in use cannot be deleted; elsewhere, the folder is locked as well
            locked.append(os.open(folder, os.O_RDONLY))
            opened.callback(os.close, locked[-1])
        if not all(map(_is_locked, locked)):
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


def _is_locked(file: int) -> bool:
    """Lock a file descriptor without waiting, and return False if another process holds the lock."""
    if sys.platform == "win32":
        import msvcrt

        os.lseek(file, _LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return not isinstance(error, BlockingIOError)  # other errors are of file systems without locks
    return True
