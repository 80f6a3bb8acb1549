"""Logs in which every line names its type: the lines of each type are found as arrays and parsed as one table."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from pdr_filter.data.io.files.archive import Members
from pdr_filter.data.io.text_table import Layout, NumberTable, concatenated, parse_blocks
from pdr_filter.values import FloatArray, limits


class TaggedLog:
    """Text file in which each line names the type of its data. `header` has the comment lines at its start."""

    def __init__(self, members: Members, comment: str) -> None:
        self.name = members.only_text()
        self.where = members.where(self.name)
        head = members.head(self.name, limits.MAX_HEADER_BYTES).removeprefix(b"\xef\xbb\xbf").decode("latin-1")
        lines = head.splitlines()[: limits.MAX_HEADER_LINES]
        self.header = [line.lstrip(comment).strip() for line in lines if line.startswith(comment)]
        self._members = members

    def header_values(self, separator: str = "\n") -> dict[str, str]:
        """Return the values of `key: value` pairs in the comment lines. The first value of a key counts."""
        values: dict[str, str] = {}
        for line in self.header:
            for part in line.split(separator):
                key, _, value = part.partition(":")
                if value.strip():
                    values.setdefault(key.strip(), value.strip()[: limits.MAX_NAME_CHARS])
        return values

    def tables(
        self,
        layouts: Mapping[str, Layout],
        tag_field: int,
        notes: list[str],
        rewritten: Mapping[str, Callable[[bytes], bytes]] | None = None,
    ) -> tuple[dict[str, NumberTable], int]:
        """Return a table for each type of line in `layouts`, and the total number of lines of all other types.

        `layouts` have one separator, and columns counted from the start of the line. `tag_field` (0 or 1) is the field
        of the type. `rewritten` has functions that change the lines of a type before they are parsed. `notes` get
        repairs.
        """
        separator = next(iter(layouts.values())).separator.encode()
        parts: dict[str, list[NumberTable]] = {tag: [] for tag in layouts}
        n_seen = dict.fromkeys(layouts, 0)
        n_fields = {tag: layout.needed for tag, layout in layouts.items()}  # in the last line of each type
        n_others = 0
        for block in self._members.blocks(self.name):
            text = block
            if not block.endswith(b"\n"):  # the last line of the file; it may end in the middle of a number
                text = _ended(block, separator, tag_field, n_fields)
                if text is None:
                    notes.append(f"{self.where}: the last line is cut off and was left out")
            if not text:
                continue
            ascii_only = text if text.isascii() else text.decode("latin-1").encode("ascii", "replace")
            bytes_ = np.frombuffer(ascii_only, dtype=np.uint8)
            ends = np.flatnonzero(bytes_ == 10) + 1
            starts = np.concatenate([[0], ends[:-1]])
            tags = starts if tag_field == 0 else _after_first(bytes_, starts, separator)
            is_other = np.ones(len(starts), dtype=bool)
            for tag, layout in layouts.items():
                chosen = _begins(bytes_, tags, tag.encode() + separator)
                is_other &= ~chosen
                if chosen.any():
                    lines = bytes_[np.repeat(chosen, ends - starts)].tobytes()
                    if rewritten is not None and tag in rewritten:
                        lines = rewritten[tag](lines)
                    where = f"{self.where}, {tag} lines"
                    parts[tag].append(parse_blocks([lines], layout, where, notes, first_line=n_seen[tag] + 1))
                    n_seen[tag] += int(chosen.sum())
                    at = int(np.flatnonzero(chosen)[-1])
                    n_fields[tag] = ascii_only.count(separator, int(starts[at]), int(ends[at])) + 1
            n_others += int(is_other.sum())
        return {tag: concatenated(found) for tag, found in parts.items() if found}, n_others


def rotation_vector_quaternion(vector: FloatArray) -> FloatArray:
    """Return the quaternions (w, x, y, z) of Android's rotation vectors (N, 3).

    Their norm is the sine of half the angle, so w = sqrt(1 - x^2 - y^2 - z^2). NaN if it exceeds one by more than
    rounding.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        rest = 1 - np.square(vector).sum(axis=1)
        w = np.where(rest > -0.02, np.sqrt(np.maximum(rest, 0)), np.nan)
        quaternion = np.column_stack([w, vector])
        return quaternion / np.sqrt(np.square(quaternion).sum(axis=1))[:, None]


def _ended(line: bytes, separator: bytes, tag_field: int, n_fields: Mapping[str, int]) -> bytes | None:
    """Return the last line of a file with a line feed, or None if it was cut off.

    It is then shorter than the previous line of its type, `n_fields`. The result is b"" for a type that is not in
    there.
    """
    fields = line.split(separator)
    tag = fields[tag_field].decode("latin-1") if len(fields) > tag_field else ""
    if tag not in n_fields:
        return b""
    return line + b"\n" if len(fields) >= n_fields[tag] else None


def _after_first(bytes_: NDArray[np.uint8], starts: NDArray[np.int64], separator: bytes) -> NDArray[np.int64]:
    """Return the index of the byte at which the second field of each line begins. Each line should have two."""
    at = np.append(np.flatnonzero(bytes_ == separator[0]), len(bytes_))
    return at[np.searchsorted(at, starts)] + 1


def _begins(bytes_: NDArray[np.uint8], tags: NDArray[np.int64], wanted: bytes) -> NDArray[np.bool_]:
    """Return True for each index in `tags` (N,) at which the text `bytes_` continues with the bytes `wanted`."""
    fits = np.ones(len(tags), dtype=bool)
    for i, byte in enumerate(wanted):
        at = tags + i
        inside = at < len(bytes_)
        fits &= inside
        fits[inside] &= bytes_[at[inside]] == byte
        if not fits.any():
            break
    return fits
