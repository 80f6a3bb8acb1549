"""Logs in which every line names its type: the lines of each type are gathered and parsed as one table.

The lines are found with array operations on the bytes, so that ten million of them take seconds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdr_filter.io.table import Layout, NumberTable, parse_blocks

MAX_HEADER_LINES = 1000
MAX_HEADER_BYTES = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class TaggedLog:
    """Tables by type, the comment lines, and how many lines each other type had."""

    tables: dict[str, NumberTable]
    ignored: int  # lines of other types


def read_tagged(
    blocks: Iterable[bytes], layouts: Mapping[str, Layout], tag_field: int, where: str, notes: list[str]
) -> TaggedLog:
    """Tables of all types in `layouts`; other lines are ignored.

    Parameters
    ----------
    blocks : iterable of bytes
        Text that ends with a line in each block.
    layouts : mapping
        By type: columns are counted from the begin of the line. All have the same separator.
    tag_field : {0, 1}
        Which field of a line holds its type.
    where : str
        File name for messages.
    notes : list of str
        What was repaired is appended here.
    """
    separator = next(iter(layouts.values())).separator.encode()
    parts: dict[str, list[NumberTable]] = {tag: [] for tag in layouts}
    seen = dict.fromkeys(layouts, 0)
    needed = {tag: max(layout.picked) + 1 for tag, layout in layouts.items()}  # fields of the last line of each type
    ignored = 0
    for block in blocks:
        text = block
        if not block.endswith(b"\n"):  # the last line of the file; it may end in the middle of a number
            cut = block.rfind(b"\n") + 1
            last = _ended(block[cut:], separator, tag_field, needed)
            if last is None:
                notes.append(f"{where}: the last line is cut off and was left out")
            text = block[:cut] + (last or b"")
        if not text:
            continue
        ascii_only = text if text.isascii() else text.decode("latin-1").encode("ascii", "replace")
        bytes_ = np.frombuffer(ascii_only, dtype=np.uint8)
        ends = np.flatnonzero(bytes_ == 10) + 1
        starts = np.concatenate([[0], ends[:-1]]) if len(ends) else ends
        tags = starts if tag_field == 0 else _after_first(bytes_, starts, separator)
        others = np.ones(len(starts), dtype=bool)
        for tag, layout in layouts.items():
            chosen = _begins(bytes_, tags, tag.encode() + separator)
            others &= ~chosen
            if chosen.any():
                lines = bytes_[np.repeat(chosen, ends - starts)].tobytes()
                table = parse_blocks([lines], layout, f"{where}, {tag} lines", notes, first_line=seen[tag] + 1)
                seen[tag] += int(chosen.sum())
                at = int(np.flatnonzero(chosen)[-1])
                needed[tag] = ascii_only.count(separator, int(starts[at]), int(ends[at])) + 1
                parts[tag].append(table)
        ignored += int(others.sum())
    tables = {
        tag: NumberTable(np.concatenate([p.whole for p in found]), np.concatenate([p.values for p in found]))
        for tag, found in parts.items()
        if found
    }
    return TaggedLog(tables, ignored)


def comments(head: bytes, sign: str) -> list[str]:
    """Comment lines at the begin of a log."""
    lines = head[:MAX_HEADER_BYTES].decode("latin-1").splitlines()[:MAX_HEADER_LINES]
    return [line for line in lines if line.lstrip("\ufeff").startswith(sign)]


def _ended(line: bytes, separator: bytes, tag_field: int, needed: Mapping[str, int]) -> bytes | None:
    """A last line with the line feed that it lacks; empty if its type is not read, None if it is cut off.

    It is whole if it has as many fields as the line of its type before it.
    """
    fields = line.split(separator)
    tag = fields[tag_field].decode("latin-1") if len(fields) > tag_field else ""
    if tag not in needed:
        return b""
    return line + b"\n" if len(fields) >= needed[tag] else None


def _after_first(bytes_: NDArray[np.uint8], starts: NDArray[np.int64], separator: bytes) -> NDArray[np.int64]:
    """Where the second field of each line begins; past the end where there is none."""
    at = np.append(np.flatnonzero(bytes_ == separator[0]), len(bytes_))
    return at[np.searchsorted(at, starts)] + 1


def _begins(bytes_: NDArray[np.uint8], tags: NDArray[np.int64], wanted: bytes) -> NDArray[np.bool_]:
    """Whether the bytes at each place are the wanted ones."""
    fits = np.ones(len(tags), dtype=bool)
    for i, byte in enumerate(wanted):
        at = tags + i
        inside = at < len(bytes_)
        fits &= inside
        fits[inside] &= bytes_[at[inside]] == byte
        if not fits.any():
            break
    return fits
