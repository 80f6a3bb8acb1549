"""Tables in texts: where the header of a text is, what separates its fields, which column is a date.

A text may begin with blank lines, `sep=;`, comments or lines about the device. Its table begins where lines of numbers
begin; the line above them, if it has as many fields, names the columns.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count, islice, pairwise

import numpy as np

from pdr_filter.data.io.column_names import column_of, is_time, is_unit, since_1970
from pdr_filter.data.io.files.archive import Members
from pdr_filter.data.io.tables.dates import as_nanoseconds, column_nanoseconds, is_date, without_midnights
from pdr_filter.data.io.tables.sheet import Sheet
from pdr_filter.data.io.text_table import Layout, NumberTable, concatenated, header_fields, parse_blocks
from pdr_filter.values import FloatArray, limits
from pdr_filter.values.errors import RecordingError

_SEPARATORS = (",", ";", "\t", "|", "/", " ")
# A field with several numbers, in brackets or with another mark between them, and a number with a mark at the line end.
_ONE = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
_PACKED = re.compile(rf"[\[({{]?\s*{_ONE}(?:[\s,;|/]+{_ONE})+\s*[\])}}]?;?|{_ONE};")
_MARKS = re.compile(r"[\s,;|/\[\](){}]")
_LONGEST_PACKED = 200
_AXES = ("x", "y", "z")
_NUMBER = re.compile(r"[+\u2212-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?|nan|NaN|null|None|#?N/?A|-?inf|-?Infinity")
_WHOLE = re.compile(r"[+-]?\d+")
_LINES_TRIED = 40  # the first line of numbers among them begins the table
_LINES_COMPARED = 8
_ROWS_LOOKED_AT = 200  # for columns of times
# Some apps and spreadsheets write a header in the code page of the phone; numbers are the same in all of them. The
# first in which most names are known is taken. charset-normalizer takes half of such headers for another language.
_CODE_PAGES = ("latin-1", "cp1251", "gbk", "shift_jis", "big5", "euc_kr")
_MOST_SENSORS = 40  # sensors in a file with one row for each sample of any sensor
# A whole number from here on would lose digits as a float: nanoseconds and microseconds since 1970.
LARGEST_FLOAT_WHOLE = 2**53


@dataclass(frozen=True, slots=True)
class TextRows:
    """Rows of a table in a text, which are parsed when they are used."""

    where: str  # for messages
    fields: tuple[str, ...]
    dates: frozenset[int]  # columns of dates and clock times
    separator: str
    decimal: str
    n_before: int  # lines before the first row
    blocks: Callable[[], Iterator[bytes]] = field(repr=False)
    packed: tuple[tuple[int, int], ...] = ()  # columns with several numbers in a field, and how many
    only: tuple[int, str] | None = None  # a column and its text in the selected rows

    def __call__(self, numbers: Sequence[int], whole: int | None, notes: list[str]) -> NumberTable:
        """Return the columns `numbers` as floats, and the column `whole` as integers. Dates become nanoseconds."""
        names = tuple(self.fields[i] for i in numbers)
        layout = Layout(tuple(numbers), whole, self.separator, self.decimal, names)
        if whole is None or whole not in self.dates:
            return parse_blocks(self._rows(), layout, self.where, notes, self.n_before + 1)
        parts: list[NumberTable] = []
        line = self.n_before + 1
        for rows in self._rows():
            parts.append(self._dated(rows, layout, whole, notes, line))
            line += rows.count(b"\n")
        if not parts:
            return NumberTable(np.empty(0, np.int64), np.empty((0, len(numbers))))
        found = concatenated(parts)
        return NumberTable(without_midnights(found.whole), found.values)

    def in_parts(self) -> Iterator[TextRows]:
        """Yield tables of consecutive rows, one for each block of the text."""
        for rows in self._rows():
            yield replace(self, blocks=partial(_one_block, rows), n_before=0, packed=(), only=None)

    def _dated(self, rows: bytes, layout: Layout, dates: int, notes: list[str], line: int) -> NumberTable:
        """Return the numbers of rows whose column number `dates` holds dates, which become nanoseconds."""
        try:
            ns = column_nanoseconds(rows, self.separator.encode(), dates)
            if ns is not None:
                found = parse_blocks([rows], replace(layout, whole=None), self.where, notes, line)
                if len(found) == len(ns):
                    return NumberTable(ns, found.values)
            return parse_blocks([as_nanoseconds(rows, self.separator.encode(), dates)], layout, self.where, notes, line)
        except RecordingError:
            raise
        except ValueError as error:
            raise RecordingError(f"{self.where}: {error}") from error

    def _rows(self) -> Iterator[bytes]:
        """Yield the rows of the table in blocks of bytes: all, or those with the text of `only`."""
        left = self.n_before
        for block in self.blocks():
            at = 0
            while left and (end := block.find(b"\n", at)) >= 0:
                at, left = end + 1, left - 1
            rows = block[at:]
            if left or not rows:
                continue
            if b"#" in rows:
                rows = re.sub(rb"(?m)^#(?!N/?A).*", b"", rows)  # comments between rows
            rows = re.sub(rb"(?m)^ | $", b"", re.sub(rb"[ \t]+", b" ", rows)) if self.separator == " " else rows
            if self.packed:
                rows = _unpacked_rows(rows, self.separator, dict(self.packed), self.where)
            if self.only is not None:
                column, text = self.only
                pattern = (
                    self._up_to(column) + b'"?' + re.escape(text.encode()) + b'"?(?=\\s|$|' + self._mark + rb").*\n?"
                )
                rows = b"".join(re.findall(pattern, rows))
            if rows:
                yield rows

    @property
    def _mark(self) -> bytes:
        return re.escape(self.separator.encode())

    def _up_to(self, column: int) -> bytes:
        """Return a regular expression that matches a row from its beginning up to the field of a column."""
        return rb"(?m)^(?:[^\n" + self._mark + rb"]*" + self._mark + b"){%d}" % column

    def texts_of(self, column: int) -> list[str]:
        """Return the different values of a column of text without the empty one, or no values if there are over 40."""
        pattern = self._up_to(column) + rb'"?([^\n"' + self._mark + rb"]*)"
        texts: dict[bytes, None] = {}
        for rows in self._rows():
            texts |= dict.fromkeys(re.findall(pattern, rows))
            if len(texts) > _MOST_SENSORS:
                return []
        return [text.decode("utf-8", "replace") for text in texts if text]


def _one_block(rows: bytes) -> Iterator[bytes]:
    yield rows


def by_text(sheet: Sheet, column: int) -> list[Sheet]:
    """Split the sheet of a text file by the texts in a column, such as sensors. Empty for more than 40 texts."""
    if not isinstance(rows := sheet.parse, TextRows):
        return []
    return [replace(sheet, name=name, parse=replace(rows, only=(column, name))) for name in rows.texts_of(column)]


def first_rows(sheet: Sheet) -> FloatArray:
    """Return the first rows of a table (N, d), with NaN in columns of text or dates, and no rows for a damaged one."""
    numbers = [i for i in range(len(sheet.fields)) if i not in sheet.texts and i not in sheet.dates]
    parse = sheet.parse
    if isinstance(parse, TextRows):
        head = next(parse.blocks(), b"")[: limits.HEAD_BYTES].split(b"\n", parse.n_before + _ROWS_LOOKED_AT)[:-1]
        parse = replace(parse, blocks=lambda: iter([b"\n".join([*head, b""])]))
    found = np.full((0, len(sheet.fields)), np.nan)
    with suppress(RecordingError):
        values = parse(numbers, None, []).values[:_ROWS_LOOKED_AT]
        found = np.full((len(values), len(sheet.fields)), np.nan)
        found[:, numbers] = values
    return found


def text_sheets(members: Members, member: str, separator: str | None = None) -> list[Sheet]:
    """Return the tables in a text file, which usually has one table or none.

    It has several if several different lines begin with its first column name in quotation marks: their headers.
    """
    header = members.head(member).removeprefix(b"\xef\xbb\xbf").partition(b"\n")[0].strip()
    if header.startswith(b'"') and (first := re.match(rb'"[^"\d]*"', header)):
        n_tables = sum(len(_begins(block, first[0])) for block in members.blocks(member))
        if n_tables > limits.MAX_TABLES:
            raise RecordingError(
                f"{members.where(member)}: {n_tables} lines begin with {first[0].decode('utf-8', 'replace')[:60]} like "
                "the first; write each table into a file, or a line of names above all rows"
            )
        tables = [partial(_table_at, members, member, first[0], n) for n in range(n_tables)]
        if n_tables > 1 and len({next(table(), b"").partition(b"\n")[0] for table in tables}) == n_tables:
            sheets = [text_sheet(members, member, separator, table) for table in tables]
            return [replace(sheet, name=f"{sheet.name} {n}") for n, sheet in enumerate(sheets, 1) if sheet is not None]
    sheet = text_sheet(members, member, separator)
    return [] if sheet is None else [sheet]


def _begins(block: bytes, first: bytes) -> list[int]:
    """Return the start indices of those lines of a block that begin with the bytes `first`."""
    return [found.start() for found in re.finditer(re.escape(b"\n" + first), b"\n" + block)]


def _table_at(members: Members, member: str, first: bytes, n: int) -> Iterator[bytes]:
    """Yield the blocks of table number n, from 0, in a text with several. Headers begin with the bytes `first`."""
    at = -1
    for block in members.blocks(member):
        begins = _begins(block, first)
        for begin, end in pairwise(sorted({0, *begins, len(block)})):
            at += begin in begins
            if at == n:
                yield block[begin:end]


def text_sheet(
    members: Members, member: str, separator: str | None = None, blocks: Callable[[], Iterator[bytes]] | None = None
) -> Sheet | None:
    """Return the table in a text file, or None if there is none.

    Without `separator`, the one is taken that gives the first rows the largest share of numbers. `blocks` yields a text
    that is not the content of the file `member`.
    """
    head = members.head(member) if blocks is None else next(blocks(), b"")[: limits.HEAD_BYTES]
    if b"\x00" in head[:4096]:
        return None
    lines = _lines(head)
    try:
        layouts = [layout for s in ((separator,) if separator else _SEPARATORS) if (layout := _layout(lines, s))]
    except RecordingError as error:
        raise RecordingError(f"{members.where(member)}: {error}") from error
    found = max(layouts, key=lambda f: f.score, default=None)
    if found is None:
        return None
    named, row, packed = _unpacked(found)
    if len(row) > limits.MAX_COLUMNS:
        raise RecordingError(f"{members.where(member)}: {len(row)} columns, over {limits.MAX_COLUMNS}; export fewer")
    before = [line for i, line in enumerate(lines[: found.first]) if i != found.at_header and line.strip()]
    stem = member.rpartition("/")[2].rpartition(".")[0] or member
    where, fields = members.where(member), unlike(named or [""] * len(row))
    start_and_rate = [] if named else [{*_split(line, found.separator)} for line in lines[found.first :][:2]]
    rate_hz = _rate_in(start_and_rate)
    n_before = found.first + (2 if rate_hz else 0)
    dates = frozenset(i for i, text in enumerate(row) if is_date(text))
    blocks = blocks or (lambda: members.blocks(member))
    return Sheet(
        name=stem,
        where=where,
        fields=fields,
        parse=TextRows(where, fields, dates, found.separator, found.decimal, n_before, blocks, packed),
        about="\n".join(before),
        dates=dates,
        exact=frozenset(i for i, text in enumerate(row) if text.isdecimal() and int(text[:40]) > LARGEST_FLOAT_WHOLE),
        texts={i: text for i, text in enumerate(row) if text and not _is_value(text)},
        rate_hz=rate_hz,
    )


def _unpacked(found: _Found) -> tuple[list[str], list[str], tuple[tuple[int, int], ...]]:
    """Return header and first row of a table with one number in each field, and the columns with several.

    A name above three numbers in one field is that of three axes, unless it has as many parts as they have.
    """
    header: list[str] = []
    row: list[str] = []
    packed: list[tuple[int, int]] = []
    for i, (name, text) in enumerate(zip(found.header or [""] * len(found.row), found.row, strict=True)):
        is_packed = _is_packed(text) and not (found.decimal == "," and "," in text)
        numbers = _parts(text) if is_packed else [text]
        marks = re.escape("".join(_MARKS.findall(text)))
        names = [part for part in re.split(f"[{marks}]+", name) if part] if is_packed else [name]
        if len(names) != len(numbers):
            names = [f"{name} {axis}".strip() for axis in _AXES] if len(numbers) == len(_AXES) and name else [name]
            names = (names + [""] * len(numbers))[: len(numbers)]
        header += names if found.header else []
        row += numbers
        packed += [(i, len(numbers))] if is_packed else []
    return header, row, tuple(packed)


def _parts(text: str) -> list[str]:
    """Return the numbers in a field, without the marks between, around and behind them."""
    return [part for part in _MARKS.split(text) if part]


def _unpacked_rows(rows: bytes, separator: str, packed: Mapping[int, int], where: str) -> bytes:
    """Return rows with a field for each number in the columns that hold several, `packed`.

    Fields with another number of them are kept, so that they are named where they are used.
    """
    found = io.StringIO()
    writer = csv.writer(found, delimiter=separator, lineterminator="\n")
    try:
        for row in csv.reader(io.StringIO(rows.decode("utf-8", "surrogateescape")), delimiter=separator):
            fields: list[str] = []
            for i, text in enumerate(row):
                n = packed.get(i, 0)
                parts = _parts(text) if n else [text]
                fields += parts if len(parts) == n or not n else [text, *[""] * (n - 1)]
            writer.writerow(fields)
    except csv.Error as error:
        raise RecordingError(f"{where}: not CSV text ({error}); export again") from error
    text = found.getvalue() if rows.endswith(b"\n") else found.getvalue().removesuffix("\n")
    return text.encode("utf-8", "surrogateescape")


def _rate_in(rows: Sequence[set[str]]) -> float:
    """Return the sampling rate in Hz if two rows are the time of the start and the rate, else zero.

    Each is there once for each column, as Empatica writes them.
    """
    with suppress(ValueError):
        start_s, rate_hz = (float(text) for row in rows for text in row)
        low, high = limits.RATE_RANGE_HZ
        return rate_hz if since_1970(start_s, "s") is not None and low <= rate_hz <= high else 0.0
    return 0.0


def unlike(names: Sequence[str]) -> tuple[str, ...]:
    """Return unique column names: "column 3" for a third one without a name, and "NAME #2" for a second NAME."""
    found: list[str] = []
    for i, name in enumerate(names, 1):
        name = name or f"column {i}"
        free = (n for n in count(2) if f"{name} #{n}" not in found)
        found.append(f"{name} #{next(free)}" if name in found else name)
    return tuple(found)


@dataclass(frozen=True, slots=True)
class _Found:
    separator: str
    decimal: str
    first: int  # line of the first row
    row: list[str]
    at_header: int | None
    header: list[str]
    score: tuple[float, int]


def _lines(head: bytes) -> list[str]:
    """Return the complete lines in the first bytes of a text, in UTF-8 or the code page with most known names."""
    try:
        text = head.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = max((head.decode(page, "replace") for page in _CODE_PAGES), key=_n_known)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return lines[:-1] if len(head) == limits.HEAD_BYTES else lines


def _n_known(text: str) -> int:
    """Return the number of non-ASCII fields in the first lines that are names of a time, quantity or axis."""
    fields = {field.strip(' "') for line in text.splitlines()[:_LINES_TRIED] for field in re.split(r"[,;|\t]", line)}
    columns = [(name, column_of(0, name)) for name in fields if not name.isascii()]
    return sum(is_time(name) or bool(column.quantity or column.axis) for name, column in columns)


def _layout(lines: list[str], separator: str) -> _Found | None:
    """Return first row, header and decimal mark of the table in lines, if `separator` separates its fields, or None.

    RecordingError if its commas are both in numbers and between them.
    """
    # Line ends that were converted twice leave a blank line after each.
    places = [*islice((i for i, line in enumerate(lines) if line.strip()), _LINES_TRIED + _LINES_COMPARED)]
    if separator != " " and not any(separator in lines[i] for i in places):
        return None
    split = [_split(lines[i], separator) for i in places]
    for first, (row, after) in enumerate(pairwise([*split, None][: _LINES_TRIED + 1])):
        n = len(row or ())
        is_only = after is None and first > 0 and len(split[first - 1]) == n and not _is_row(split[first - 1])
        if row is None or n < 2 or not _is_row(row):
            continue
        if not is_only and (after is None or len(after) != n or not _is_row(after)):
            continue
        rows = [r for r in split[first : first + _LINES_COMPARED] if len(r) == n]
        values = [text for r in rows for text in r if text]
        share = sum(_is_value(text) or 0.9 * _is_packed(text) for text in values) / max(len(values), 1)
        has_comma = any(re.fullmatch(r"[+-]?\d*,\d+([eE][+-]?\d+)?", text) for text in values)
        at = next((i for i in range(first - 1, -1, -1) if any(split[i])), None)
        header = split[at] if at is not None else []
        if separator == "," and len(header) > 1 and n == 2 * len(header) and all(map(_WHOLE.fullmatch, row)):
            raise RecordingError(
                f"rows of {n} numbers below {len(header)} names: its commas are both in numbers and between them; "
                "export it with points in numbers, or with semicolons"
            )
        if at is None or _is_row(header) or abs(len(header) - n) > 1:
            at, header = None, []
        if at and header and all(map(is_unit, filter(None, header))) and len(split[at - 1]) == len(header):
            header = [f"{name} ({unit})" if unit else name for name, unit in zip(split[at - 1], header, strict=True)]
        elif at and header and len(split[at - 1]) == len(header) and len({*header}) < len(header):
            header = [f"{above} {name}".strip() for above, name in zip(_merged(split[at - 1]), header, strict=True)]
        header = (header + [""] * n)[:n] if header else []
        if not header and any(map(_is_packed, values)):
            share -= 0.1  # of two marks in a row, that of the header separates the columns
        at_header = None if at is None else places[at]
        return _Found(separator, "," if has_comma else ".", places[first], row, at_header, header, (round(share, 2), n))
    return None


def _merged(names: list[str]) -> list[str]:
    """Return column names in which a name also stands over the unnamed columns after it, as in merged cells."""
    found: list[str] = []
    for name in names:
        found.append(name or (found[-1] if found else ""))
    return found


def _split(line: str, separator: str) -> list[str]:
    return line.split() if separator == " " else header_fields(line, separator)


def _is_packed(text: str) -> bool:
    """Return True for several numbers in one field, one of them with a point, or a number with a mark at its end."""
    if len(text) > _LONGEST_PACKED or not ("." in text or text.endswith(";")):
        return False
    return _PACKED.fullmatch(text) is not None and not _is_value(text)


def _is_value(text: str) -> bool:
    return _NUMBER.fullmatch(text) is not None or is_date(text)


def _is_row(row: list[str]) -> bool:
    """Return True if at least two fields of a line, and most of those that are not empty, are numbers or dates."""
    known = [text for text in row if text]
    n_values = sum(map(_is_value, known))
    if n_values:  # beside a time, fields may hold several numbers
        n_values += 2 * sum(_is_packed(text) for text in known)
    return n_values >= 2 and 2 * n_values > len(known)
