"""Text of others made safe for where it goes: a terminal, the cell of a table, the name of a file."""

from __future__ import annotations

import hashlib
import re

# Of 255 bytes that file systems allow, with room for a number and the longest ending.
_MAX_FILE_NAME_BYTES = 200
# What programs for tables take for a formula, at the begin of a cell; some cut lines at semicolons, too.
_LIVE = re.compile(r"(^|[;\t])(\s*)(?=['=+@\-])")
_QUOTED = re.compile(r"(^|[;\t])(\s*)'(?=['=+@\-])")


def printable(text: object) -> str:
    r"""The text with escapes for whatever would not print: control characters, changed directions, odd spaces.

    >>> printable("a\x1b[2Jb")
    'a\\x1b[2Jb'
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(text))


def printable_lines(text: object) -> str:
    """The same of every line."""
    return "\n".join(map(printable, str(text).split("\n")))


def csv_cell(text: str) -> str:
    """The text with an apostrophe before what would be a formula; `of_csv_cell` takes it away.

    >>> csv_cell("=1+1")
    "'=1+1"
    """
    return _LIVE.sub(r"\1\2'", text)


def of_csv_cell(cell: str) -> str:
    """The text that `csv_cell` was given."""
    return _QUOTED.sub(r"\1\2", cell)


def file_name(name: str) -> str:
    """A name for files, from that of a recording: without folders, and short enough for an ending to follow.

    What is cut off is replaced by a checksum of the whole, so that two long names stay two.
    """
    clean = re.sub(r'[/\\:*?"<>|]', "_", printable(name)).strip(". ") or "recording"
    if len(clean.encode()) <= _MAX_FILE_NAME_BYTES:
        return clean
    checksum = hashlib.sha256(clean.encode()).hexdigest()[:8]
    return f"{clean.encode()[: _MAX_FILE_NAME_BYTES - 9].decode(errors='ignore')}_{checksum}"
