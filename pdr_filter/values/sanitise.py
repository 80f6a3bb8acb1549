"""Sanitise untrusted text for terminals, CSV cells and file names."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from itertools import chain, count

# File systems allow 255 bytes. The rest is for a number and the longest suffix.
_MAX_FILE_NAME_BYTES = 200
# Characters that spreadsheet programs interpret as the begin of a formula, at the begin of a cell. Some programs also
# split cells at semicolons.
_LIVE = re.compile(r"(^|[;\t])(\s*)(?=['=+@\-])")
_QUOTED = re.compile(r"(^|[;\t])(\s*)'(?=['=+@\-])")


def printable(text: object) -> str:
    r"""Escape all characters that do not print: control characters, changes of direction, unusual spaces.

    >>> printable("a\x1b[2Jb")
    'a\\x1b[2Jb'
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(text))


def printable_lines(text: object) -> str:
    """Escape all characters that do not print in each line of a text, and keep the line breaks."""
    return "\n".join(map(printable, str(text).split("\n")))


def csv_cell(text: str) -> str:
    """Put an apostrophe before text that a spreadsheet would interpret as a formula. `of_csv_cell` removes it.

    Text after a semicolon or tab is treated in the same way, because some programs split cells there.

    >>> csv_cell("=1+1")
    "'=1+1"
    """
    return _LIVE.sub(r"\1\2'", text)


def of_csv_cell(cell: str) -> str:
    """Return the original text of a cell written by `csv_cell`."""
    return _QUOTED.sub(r"\1\2", cell)


def file_name(name: str) -> str:
    """Return a file name for the name of a recording, without folders. A checksum replaces the end of a long name."""
    clean = re.sub(r'[/\\:*?"<>|]', "_", printable(name)).strip(". ") or "recording"
    if len(clean.encode()) <= _MAX_FILE_NAME_BYTES:
        return clean
    checksum = hashlib.sha256(clean.encode()).hexdigest()[:8]
    return f"{clean.encode()[: _MAX_FILE_NAME_BYTES - 9].decode(errors='ignore')}_{checksum}"


def free_name(name: str, is_taken: Callable[[str], bool], form: str = "{}_{}") -> str:
    """Return the name, with the smallest number from 2 that makes it a free one if it is taken.

    >>> free_name("walk", {"walk", "walk_2"}.__contains__)
    'walk_3'
    """
    numbered = (form.format(name, number) for number in count(2))
    return next(each for each in chain([name], numbered) if not is_taken(each))
