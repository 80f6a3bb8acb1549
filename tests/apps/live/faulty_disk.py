"""A disk whose n-th operation fails, for tests that fail each operation in turn, as SQLite tests itself."""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

# Errors of a disk. After the first two, a part of what was to be written is on the disk.
ERRORS = {"ENOSPC": errno.ENOSPC, "EIO": errno.EIO, "EDQUOT": errno.EDQUOT, "EROFS": errno.EROFS}
SHORT, KILL = "short", "kill"


class Killed(BaseException):
    """The process ends here, so nothing that it does later has an effect."""


class FaultyDisk:
    """Files below a folder, with the number of operations on them so far.

    From operation number `fails_at` on, each fails with an error of `ERRORS` until `heal` is called. `SHORT` writes a
    part without an error, as the system may at any time. `KILL` writes a part, and then the process is dead.
    """

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self._folder = str(folder)
        self.n, self.fails_at, self.kind = 0, -1, ""
        self._open: Any = io.open
        monkeypatch.setattr(io, "open", self._opened)
        monkeypatch.setattr(os, "fsync", lambda number: self.count(number))  # which would take most of the time
        for name in ("open", "replace", "rename", "unlink", "truncate", "mkdir"):
            monkeypatch.setattr(os, name, self._failing(getattr(os, name)))

    def fail(self, at: int, kind: str) -> None:
        """Count from zero again, and let operation number `at` be the first that fails."""
        self.n, self.fails_at, self.kind = 0, at, kind

    def heal(self) -> None:
        """Let all further operations succeed."""
        self.fails_at = -1

    @property
    def has_failed(self) -> bool:
        """True if an operation has failed since the last call of `heal`."""
        return 0 <= self.fails_at < self.n

    def count(self, path: object, write_part: Callable[[], object] = lambda: None) -> None:
        """Count an operation. If it is to fail, write a part, and raise the error."""
        self.n += 1
        if not self.has_failed or self.kind == SHORT:
            return
        if self.kind != "EROFS" and self.n == self.fails_at + 1:
            write_part()
        if self.kind == KILL:
            raise Killed
        raise OSError(ERRORS[self.kind], os.strerror(ERRORS[self.kind]), str(path))

    def _failing(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def called(path: Any, *arguments: Any, **named: Any) -> Any:
            if str(path).startswith(self._folder):
                self.count(path)
            return call(path, *arguments, **named)

        return called

    def _opened(self, file: Any, mode: str = "r", buffering: int = -1, *arguments: Any, **named: Any) -> Any:
        if not str(file).startswith(self._folder):
            return self._open(file, mode, buffering, *arguments, **named)
        self.count(file)
        raw = _File(self, str(file), mode.replace("b", "").replace("t", ""))
        made = io.BufferedReader(raw) if mode.startswith("r") else io.BufferedWriter(raw)
        return made if "b" in mode else io.TextIOWrapper(made, *arguments, **named)


class _File(io.FileIO):
    def __init__(self, disk: FaultyDisk, path: str, mode: str) -> None:
        super().__init__(path, mode)
        self._disk = disk

    def write(self, content: Any) -> int:
        half = bytes(content)[: len(content) // 2]
        self._disk.count(self.name, lambda: super(_File, self).write(half))
        is_short = self._disk.kind == SHORT and self._disk.n == self._disk.fails_at + 1
        return super().write(half if is_short and half else content)

    def readall(self) -> bytes:
        self._disk.count(self.name)
        return super().readall()

    def truncate(self, size: int | None = None) -> int:
        self._disk.count(self.name)
        return super().truncate(size)

    def close(self) -> None:
        is_first = not self.closed
        super().close()
        if is_first and self.writable_mode:
            self._disk.count(self.name)

    @property
    def writable_mode(self) -> bool:
        return "r" not in self.mode
