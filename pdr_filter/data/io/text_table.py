"""Tables as text: parsed block by block into columns of numbers, whole numbers of nanoseconds without loss."""

from __future__ import annotations

import contextlib
import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import chain
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pdr_filter.values import FloatArray, IntArray, limits
from pdr_filter.values.errors import RecordingError

SEPARATORS = (",", ";", "\t")
UNKNOWN = ("null", "None", "NA", "N/A", "#N/A", "-", "--")  # missing values of programs, besides "" and NaN
LARGE_BYTES = 1024**2  # of a block; below, loading pyarrow takes longer than it saves


@dataclass(frozen=True, slots=True, eq=False)
class NumberTable:
    """Columns of a table: one of whole numbers if asked for, the others as floats, NaN where empty."""

    whole: IntArray  # (N,) the column of whole numbers; zeros if none was asked for
    values: FloatArray  # (N, d), a column behind the other in memory: streams take columns
    texts: tuple[tuple[str, ...], ...] = ()  # (N,) of the columns of text, if any were asked for

    def __len__(self) -> int:
        return len(self.values)


@dataclass(frozen=True, slots=True)
class Layout:
    """Places of the fields of a table in its lines."""

    picked: tuple[int, ...]  # columns to take as floats
    whole: int | None = None  # column to take as int64; rows in which it is empty are left out
    separator: str = ","
    decimal: str = "."
    names: tuple[str, ...] = ()  # names of the picked columns, for messages
    texts: tuple[int, ...] = ()  # columns to take as text, without surrounding space

    @property
    def needed(self) -> int:
        """Least number of fields in a line."""
        return 1 + max([*self.picked, *self.texts, self.whole or 0])


def header_fields(line: str, separator: str) -> list[str]:
    """Fields of a header line without quotes and surrounding space."""
    try:
        return [field.strip() for field in next(csv.reader([line], delimiter=separator), [])]
    except csv.Error:
        return []


def find_separator(header: str) -> str:
    """Return the separator that splits a header line into most fields, or a comma if none does."""
    return max(SEPARATORS, key=lambda separator: len(header_fields(header, separator)))


class TextTable:
    """A table whose first line names its columns; the rows are parsed when they are asked for.

    Its text comes in blocks that end with a line feed, except perhaps the last. `where` is for messages.
    """

    def __init__(self, blocks: Iterable[bytes], where: str, separator: str = "") -> None:
        self.where = where
        self._rest = iter(blocks)
        head, _, first_rows = next(self._rest, b"").partition(b"\n")
        self.first_rows = first_rows or next(self._rest, b"")  # the first block of them
        self.header = decode(head, where)
        self.separator = separator or find_separator(self.header)
        self.fields = header_fields(self.header, self.separator)
        if len(self.fields) > limits.MAX_COLUMNS:
            raise RecordingError(f"{where}: {len(self.fields)} columns, more than {limits.MAX_COLUMNS}; export fewer")

    @property
    def is_empty(self) -> bool:
        """True if the table has neither a header nor a row."""
        return not self.header.strip() and not self.first_rows.strip()

    def places(self, names: Sequence[str]) -> tuple[int, ...]:
        """Return the indices of the columns with these names. RecordingError unless each name exists exactly once."""
        for name in names:
            if (n := self.fields.count(name)) != 1:
                raise RecordingError(
                    f"{self.where}: {f'{n} columns' if n else 'no column'} {name!r} "
                    f"(found: {', '.join(self.fields)[:160] or 'nothing'}); "
                    f"write {','.join(names)} once each into the first line"
                )
        return tuple(self.fields.index(name) for name in names)

    def numbered_rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the line and the cells of each row that is not empty, with the header in line 1."""
        text = decode(b"".join(chain([self.first_rows], self._rest)), self.where, 2)
        for line, cells, _ in _rows(text, self.separator, self.where, 2):
            yield line, cells

    def parse(
        self,
        places: Sequence[int],
        notes: list[str],
        whole: int | None = None,
        texts: Sequence[int] = (),
        decimal: str = ".",
    ) -> NumberTable:
        """Return columns as floats, one as integers, and some as texts. The table can be parsed only once."""
        layout = self._layout(places, whole, texts, decimal)
        return parse_blocks(chain([self.first_rows], self._rest), layout, self.where, notes)

    def parse_in_parts(self, places: Sequence[int], notes: list[str]) -> Iterator[NumberTable]:
        """Yield columns as floats, block by block. The table can be parsed only once."""
        line, layout = 2, self._layout(places)
        for block in chain([self.first_rows], self._rest):
            yield parse_blocks([block], layout, self.where, notes, line)
            line += block.count(b"\n")

    def _layout(
        self, places: Sequence[int], whole: int | None = None, texts: Sequence[int] = (), decimal: str = "."
    ) -> Layout:
        names = tuple(self.fields[place] for place in places)
        return Layout(tuple(places), whole, self.separator, decimal, names, tuple(texts))


def decode(content: bytes, where: str, first_line: int = 1) -> str:
    """Decode UTF-8 bytes. RecordingError names the invalid byte and its line."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = first_line + error.object.count(b"\n", 0, error.start)
        raise RecordingError(
            f"{where}, line {line}: not UTF-8 text (byte 0x{error.object[error.start]:02x}); save it as UTF-8"
        ) from error


def text_rows(content: bytes, where: str) -> list[list[str]]:
    """Return the rows of a small CSV text as lists of fields, with the header and without empty rows."""
    text = decode(content.replace(b"\x00", b""), where)
    separator = find_separator(text.partition("\n")[0])
    try:
        return [row for row in csv.reader(io.StringIO(text), delimiter=separator) if row]
    except csv.Error as error:
        raise RecordingError(f"{where}: not CSV text ({error}); export it again") from error


def parse_blocks(
    blocks: Iterable[bytes], layout: Layout, where: str, notes: list[str], first_line: int = 2
) -> NumberTable:
    """Parse the lines of all blocks, of which only the last may lack its final line feed.

    Empty, infinite and absurd values become NaN. A last line that is cut off, and rows without the whole number, are
    left out with a note. RecordingError for any other line with too few fields or text in a number column names the
    line, counted from `first_line`.
    """
    parts: list[NumberTable] = []
    for block in blocks:
        next_line = first_line + block.count(b"\n")
        if layout.texts and next_line > limits.MAX_TEXT_ROWS:
            raise RecordingError(
                f"{where}: more than {limits.MAX_TEXT_ROWS} rows; write one for each stretch, not for each sample"
            )
        if block.strip():
            parts.append(_parse_block(block, layout, where, notes, first_line))
        first_line = next_line
    if not parts:
        return NumberTable(np.empty(0, dtype=np.int64), np.empty((0, len(layout.picked))), ((),) * len(layout.texts))
    joined = concatenated(parts)
    refuse_far_times(joined.whole, where)
    # At once, so that no arithmetic of a reader meets a value that is absurd.
    return NumberTable(joined.whole, finite(joined.values, where, notes), joined.texts)


def concatenated(parts: Sequence[NumberTable]) -> NumberTable:
    """Return the rows of all parts in one table."""
    return NumberTable(
        np.concatenate([part.whole for part in parts]),
        np.concatenate([part.values for part in parts]),
        tuple(tuple(chain(*columns)) for columns in zip(*(part.texts for part in parts), strict=True)),
    )


def finite(values: FloatArray, where: str, notes: list[str]) -> FloatArray:
    """Return values in which infinite and absurdly large ones are replaced by NaN, and add a note about them."""
    # Without a copy, which may be large, and whatever is NaN.
    low, high = (float(extreme.reduce(values, axis=None, initial=0.0)) for extreme in (np.fmin, np.fmax))
    if low >= -limits.LARGEST_VALUE and high <= limits.LARGEST_VALUE:
        return values
    beyond = np.abs(values) > limits.LARGEST_VALUE
    notes.append(f"{where}: {int(beyond.sum())} infinite or absurdly large values taken as unknown")
    return np.where(beyond, np.nan, values)


def refuse_far_times(whole: IntArray, where: str) -> None:
    """Raise RecordingError for integer times so large that their differences would exceed an int64."""
    if len(whole) and not (whole.min() >= -limits.MAX_WHOLE_TIME and whole.max() <= limits.MAX_WHOLE_TIME):
        raise RecordingError(
            f"{where}: times from {whole.min()} to {whole.max()}, too large for nanoseconds since 1970; export them as "
            "they were recorded"
        )


def _parse_block(block: bytes, layout: Layout, where: str, notes: list[str], line: int) -> NumberTable:
    """Return the table in a block of lines, by a fast reader if every field is plain, otherwise row by row."""
    # A last line without line feed may be cut off in the middle of a number, and decimal commas may stand in quotation
    # marks between commas: only row by row are they looked at closely.
    if block.endswith(b"\n") and not layout.texts and layout.decimal != layout.separator:
        columns = [*([] if layout.whole is None else [layout.whole]), *layout.picked]
        for read in (_by_arrow, _by_numpy):
            with contextlib.suppress(ImportError, KeyError, ValueError):
                found = read(block, layout, columns)
                values = np.empty((len(found[0]), len(layout.picked)), order="F")
                for i, column in enumerate(found[len(columns) - len(layout.picked) :]):
                    values[:, i] = column
                return NumberTable(np.zeros(len(values), np.int64) if layout.whole is None else found[0].copy(), values)
    return _parse_rows(decode(block, where, line), layout, where, notes, line, block.endswith(b"\n"))


def _by_arrow(block: bytes, layout: Layout, columns: Sequence[int]) -> list[NDArray[Any]]:
    """Return columns of a large block by pyarrow, with the bits of numpy in a third of the time.

    ImportError, KeyError or ValueError without pyarrow, or if anything in the block is unusual.
    """
    if len(block) < LARGE_BYTES or not block.isascii() or b'"' in block or len(set(columns)) < len(columns):
        raise ValueError
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    names = [f"f{column}" for column in columns]
    kinds = dict.fromkeys(names, pa.float64()) | ({} if layout.whole is None else {names[0]: pa.int64()})
    rows = arrow_csv.read_csv(
        pa.BufferReader(block),
        arrow_csv.ReadOptions(use_threads=False, autogenerate_column_names=True, block_size=len(block)),
        arrow_csv.ParseOptions(delimiter=layout.separator, quote_char=False),
        arrow_csv.ConvertOptions(
            include_columns=names, column_types=kinds, null_values=["", *UNKNOWN], decimal_point=layout.decimal
        ),
    )
    if layout.whole is not None and rows.column(0).null_count:
        raise ValueError
    return [column.to_numpy() for column in rows.columns]


def _by_numpy(block: bytes, layout: Layout, columns: Sequence[int]) -> list[NDArray[Any]]:
    """Return columns of a block of numbers. Fields may be empty if `layout.whole` is None. ValueError for texts."""
    text = block.decode("utf-8-sig")
    if layout.decimal != ".":
        text = text.replace(layout.decimal, ".")
    kinds = [(f"f{i}", np.int64 if column == layout.whole and i == 0 else float) for i, column in enumerate(columns)]

    def read(text: str) -> list[NDArray[Any]]:
        lines = text.split("\n")
        rows = np.loadtxt(lines, np.dtype(kinds), None, layout.separator, usecols=columns, ndmin=1, quotechar='"')
        return [rows[name] for name, _ in kinds]

    try:
        return read(text)
    except ValueError:
        if layout.whole is not None:
            raise
        mark = re.escape(layout.separator)  # with empty fields filled: five times faster than row by row
        text = re.sub(rf"{mark}(?={mark}|\n|$)", f"{layout.separator}nan", text)
        return read(re.sub(rf"(?m)^{mark}", f"nan{layout.separator}", text))


def _parse_rows(text: str, layout: Layout, where: str, notes: list[str], line: int, is_whole: bool) -> NumberTable:
    """Return the table in the text of a block row by row, so that a message can name the line and the field.

    `line` is the number of the first line. `is_whole` is False if the last line may be cut off.
    """
    values: list[list[float]] = []
    whole: list[int] = []
    texts: list[list[str]] = []
    n_timeless = n_long = 0
    for at, row, is_last in _rows(text, layout.separator, where, line):
        if layout.decimal != ".":
            row = [field.replace(layout.decimal, ".") for field in row]
        if not is_whole and is_last and not _is_complete(row, layout):
            notes.append(f"{where}: the last line is cut off and was left out")
            break
        if len(row) < layout.needed:
            raise RecordingError(
                f"{where}, line {at}: only {len(row)} fields ({layout.separator.join(row)[:60]!r}); "
                "write one for each column in every row, empty if unknown"
            )
        if layout.whole is not None:
            try:
                known = whole_number(row[layout.whole])
            except ValueError as error:
                raise RecordingError(
                    f"{where}, line {at}: time {row[layout.whole].strip()[:40]!r} is neither a number up to "
                    f"{limits.MAX_INT64:.1e} nor a known date; export the file again, or take the line out"
                ) from error
            if known is None:
                n_timeless += 1
                continue
            whole.append(known)
        numbers = [to_number(row[i]) for i in layout.picked]
        if None in numbers:
            raise _no_number(row, numbers.index(None), layout, f"{where}, line {at}")
        values.append(cast("list[float]", numbers))
        found = [row[i].strip() for i in layout.texts]
        texts.append([text[: limits.MAX_NAME_CHARS] for text in found])
        n_long += found != texts[-1]
    if n_long:
        notes.append(f"{where}: {n_long} rows with texts of more than {limits.MAX_NAME_CHARS} characters, cut there")
    if n_timeless:
        notes.append(f"{where}: {n_timeless} rows without a time left out")
    return NumberTable(
        np.array(whole, dtype=np.int64) if layout.whole is not None else np.zeros(len(values), np.int64),
        np.array(values, dtype=float).reshape(len(values), len(layout.picked)),
        tuple(tuple(row[i] for row in texts) for i in range(len(layout.texts))),
    )


def _rows(text: str, separator: str, where: str, line: int) -> Iterator[tuple[int, list[str], bool]]:
    """Yield the line number, the fields, and True for the last row, for every row that is not empty."""
    reader = csv.reader(io.StringIO(text), delimiter=separator)
    n_lines = text.count("\n") + 1
    try:
        for row in reader:
            if any(field.strip() for field in row):
                yield line + reader.line_num - 1, row, reader.line_num >= n_lines
    except csv.Error as error:
        raise RecordingError(
            f"{where}, line {line + reader.line_num - 1}: not CSV text ({error}); export again"
        ) from error


def _is_complete(row: list[str], layout: Layout) -> bool:
    """Return True if a last line without line feed is complete: it has all fields, and no number is cut."""
    numbers = (*layout.picked, *([] if layout.whole is None else [layout.whole]))
    return len(row) >= layout.needed and all(to_number(row[i]) is not None for i in numbers)


def _no_number(row: list[str], i: int, layout: Layout, where: str) -> RecordingError:
    """Return the error for the i-th picked field of a row, which is not a number."""
    name = layout.names[i] if i < len(layout.names) else str(layout.picked[i] + 1)
    if row[layout.picked[i]].strip() == name:
        return RecordingError(
            f"{where}: the header is there again, so two recordings are one behind the other; cut the file there"
        )
    return RecordingError(
        f"{where}, column {name}: {row[layout.picked[i]].strip()[:60]!r} is not a number; use {layout.decimal!r} as "
        "decimal point, no mark between thousands, leave unknown values empty, and take out lines that are no samples"
    )


_MINUS_SIGN = "\u2212"  # in place of the hyphen, as word processors and some languages of a phone write it


def to_number(field: str) -> float | None:
    """Return the number in a field, NaN if the field is empty or a word such as null or NA, or None for other text."""
    field = field.strip()
    if not field or field in UNKNOWN:
        return math.nan
    if "_" in field:  # Python would read 1_0 as ten
        return None
    try:
        return float(field.replace(_MINUS_SIGN, "-"))
    except ValueError:
        return None


def whole_number(field: str) -> int | None:
    """Return the whole number in a field with all digits, or None if it is unknown. ValueError for other texts."""
    field = field.strip()
    if not field or field in ("nan", "NaN", *UNKNOWN):
        return None
    if len(field) > 40 or "_" in field:
        raise ValueError(field[:40])
    try:
        number = Decimal(field)
        if number.is_finite() and abs(number) <= limits.MAX_INT64:
            return int(number)
    except ArithmeticError as error:  # no number, or one with an exponent beyond all bounds
        raise ValueError(field) from error
    raise ValueError(field)
