"""Number tables of any size: parsed block by block, whole numbers of nanoseconds without loss."""

from __future__ import annotations

import contextlib
import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal

import numpy as np

from pdr_filter.io.checks import finite
from pdr_filter.io.errors import RecordingError
from pdr_filter.values.arrays import FloatArray, IntArray

SEPARATORS = (",", ";", "\t")
MAX_INT64 = 2**63 - 1
MAX_TIME = 2**62


@dataclass(frozen=True, slots=True, eq=False)
class NumberTable:
    """Picked columns of a table: one of whole numbers if asked for, the others as floats, NaN where empty."""

    whole: IntArray  # (N,) the column of whole numbers; zeros if none was asked for
    values: FloatArray  # (N, d)

    def __len__(self) -> int:
        return len(self.values)


@dataclass(frozen=True, slots=True)
class Layout:
    """How the fields of a table stand in its lines.

    Parameters
    ----------
    picked : tuple of int
        Columns to take as floats.
    whole : int, optional
        Column to take as int64; rows in which it is empty are left out.
    separator, decimal : str
        As in the file.
    names : tuple of str
        Of the picked columns, for messages.
    """

    picked: tuple[int, ...]
    whole: int | None = None
    separator: str = ","
    decimal: str = "."
    names: tuple[str, ...] = ()


def header_fields(line: str, separator: str) -> list[str]:
    """Fields of a header line without quotes and surrounding space."""
    try:
        return [field.strip() for field in next(csv.reader([line], delimiter=separator), [])]
    except csv.Error:
        return []


def find_separator(header: str) -> str:
    """The separator that splits a header line into most fields; a comma if none does."""
    return max(SEPARATORS, key=lambda separator: len(header_fields(header, separator)))


def split_header(blocks: Iterable[bytes], where: str) -> tuple[str, Iterator[bytes]]:
    """The first line, and the blocks after it; an empty line if there is none."""
    rest = iter(blocks)
    first = next(rest, b"")
    head, _, body = first.partition(b"\n")

    def after() -> Iterator[bytes]:
        if body:
            yield body
        yield from rest

    return decode(head, where), after()


def decode(content: bytes, where: str) -> str:
    """Text of UTF-8 bytes; RecordingError names the byte that is none."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordingError(
            f"{where}: not UTF-8 text (byte 0x{content[error.start]:02x} at {error.start}); save it as UTF-8"
        ) from error


def parse_blocks(
    blocks: Iterable[bytes], layout: Layout, where: str, notes: list[str], first_line: int = 2
) -> NumberTable:
    """Parse the lines of all blocks; `first_line` is the line number of the first one, for messages.

    An empty field is NaN. A last line that is cut off is left out with a note; any other line with too few fields or
    with text in a number column is refused with its number.
    """
    parts: list[NumberTable] = []
    line = first_line
    pending: bytes | None = None  # one block behind, to know which one is the last
    for block in blocks:
        if pending is not None:
            parts.append(_parse_block(pending, layout, where, notes, line, last=False))
            line += pending.count(b"\n")
        pending = block
    if pending is not None:
        parts.append(_parse_block(pending, layout, where, notes, line, last=True))
    if not parts:
        return NumberTable(np.empty(0, dtype=np.int64), np.empty((0, len(layout.picked))))
    whole = np.concatenate([part.whole for part in parts])
    refuse_far_times(whole, where)
    # At once, so that no arithmetic of a reader meets a value that is absurd.
    return NumberTable(whole, finite(np.concatenate([part.values for part in parts]), where, notes))


def refuse_far_times(whole: IntArray, where: str) -> None:
    """Refuse whole times whose differences an int64 could not hold: in nanoseconds, the years 1824 to 2116 are fine."""
    if len(whole) and not (whole.min() >= -MAX_TIME and whole.max() <= MAX_TIME):
        raise RecordingError(f"{where}: a time of {whole.max()} or {whole.min()}, which is no time since 1970")


def _parse_block(block: bytes, layout: Layout, where: str, notes: list[str], line: int, last: bool) -> NumberTable:
    if not block.strip():
        return NumberTable(np.empty(0, dtype=np.int64), np.empty((0, len(layout.picked))))
    complete = not last or block.endswith(b"\n")
    text = decode(block, where)
    if layout.decimal != ".":
        text = text.replace(layout.decimal, ".")
    # A last line without line feed may be cut off in the middle of a number: only the slow way looks at it closely.
    if complete:
        with contextlib.suppress(ValueError):
            return parse_lines(text.split("\n"), layout)
        with contextlib.suppress(ValueError):  # with empty fields filled: five times faster than the slow way
            if layout.whole is None:
                return parse_lines(_filled(text, layout.separator).split("\n"), layout)
    return _slow(text, layout, where, notes, line, complete)


def _filled(text: str, separator: str) -> str:
    between = re.escape(separator)
    return re.sub(
        rf"(?m)^{between}", f"nan{separator}", re.sub(rf"{between}(?={between}|\n|$)", f"{separator}nan", text)
    )


def parse_lines(lines: Sequence[str], layout: Layout) -> NumberTable:
    """Parse lines that have a number in every picked field; ValueError if one has not."""
    columns = ([layout.whole] if layout.whole is not None else []) + list(layout.picked)
    kinds: list[tuple[str, type]] = [(f"f{i}", float) for i in range(len(columns))]
    if layout.whole is not None:
        kinds[0] = ("f0", np.int64)
    quote = '"' if layout.separator != '"' else None
    rows = np.loadtxt(
        lines,
        delimiter=layout.separator,
        comments=None,
        usecols=columns,
        dtype=np.dtype(kinds),
        ndmin=1,
        quotechar=quote,
    )
    names = [name for name, _ in kinds]
    values = np.empty((len(rows), len(layout.picked)))
    for i, name in enumerate(names[len(names) - len(layout.picked) :]):
        values[:, i] = rows[name]
    whole = rows["f0"].astype(np.int64) if layout.whole is not None else np.zeros(len(rows), dtype=np.int64)
    return NumberTable(whole, values)


def _slow(text: str, layout: Layout, where: str, notes: list[str], line: int, complete: bool) -> NumberTable:
    reader = csv.reader(io.StringIO(text), delimiter=layout.separator)
    needed = max([*layout.picked, layout.whole or 0])
    rows: list[list[float]] = []
    whole: list[int] = []
    timeless = 0
    try:
        for row in reader:
            if not any(field.strip() for field in row):
                continue
            at = line + reader.line_num - 1
            if not complete and reader.line_num >= text.count("\n") + 1:
                if _is_whole_line(row, layout, needed):
                    complete = True
                else:
                    notes.append(f"{where}: the last line is cut off and was left out")
                    break
            if len(row) <= needed:
                raise RecordingError(
                    f"{where}, line {at}: only {len(row)} fields ({layout.separator.join(row)[:60]!r}); "
                    "every row needs one for each column, empty if unknown"
                )
            if layout.whole is not None:
                known = _whole_number(row[layout.whole], where, at)
                if known is None:
                    timeless += 1
                    continue
                whole.append(known)
            rows.append([_float(row[i], layout, i, where, at) for i in layout.picked])
    except csv.Error as error:
        raise RecordingError(f"{where}, line {line + reader.line_num - 1}: not CSV text ({error})") from error
    if timeless:
        notes.append(f"{where}: {timeless} rows without a time left out")
    values = np.array(rows, dtype=float).reshape(len(rows), len(layout.picked))
    return NumberTable(
        np.array(whole, dtype=np.int64) if layout.whole is not None else np.zeros(len(rows), np.int64), values
    )


def _is_whole_line(row: list[str], layout: Layout, needed: int) -> bool:
    """Whether a last line without line feed can be taken: all fields are there, and no number ends in mid-air."""
    if len(row) <= needed:
        return False
    return all(to_number(row[i]) is not None for i in (*layout.picked, *([layout.whole] if layout.whole else [])))


def to_number(field: str) -> float | None:
    """The number in a field, NaN if it is empty, None if it is text."""
    field = field.strip()
    if not field or field in ("null", "None"):
        return math.nan
    if "_" in field:  # Python would read 1_0 as ten
        return None
    try:
        return float(field)
    except ValueError:
        return None


def _float(field: str, layout: Layout, column: int, where: str, line: int) -> float:
    number = to_number(field)
    if number is None:
        index = layout.picked.index(column)
        name = layout.names[index] if index < len(layout.names) else str(column + 1)
        raise RecordingError(f"{where}, line {line}, column {name}: {field[:60]!r} is not a number")
    return number


def whole_number(field: str) -> int | None:
    """The whole number in a field without loss, None if it is empty; ValueError if it is something else."""
    field = field.strip()
    if not field or field in ("null", "nan", "NaN"):
        return None
    if len(field) > 40 or "_" in field:
        raise ValueError(field[:40])
    try:
        number = Decimal(field)
        fits = number.is_finite() and abs(number) <= MAX_INT64
    except ArithmeticError as error:  # no number, or one with an exponent beyond all bounds
        raise ValueError(field) from error
    if not fits:
        raise ValueError(field)
    return int(number)


def _whole_number(field: str, where: str, line: int) -> int | None:
    try:
        return whole_number(field)
    except ValueError as error:
        raise RecordingError(f"{where}, line {line}: {field[:40]!r} is no time in whole units since 1970") from error
