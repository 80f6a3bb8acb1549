"""Reader of JSON tables, as written by SensorLog and by self-made loggers.

Three layouts are read: an object for each row, in an array or one after the other; an object with an array for each
column; and an array of rows for each sensor. A nested value is a column such as `accelerometer.x`.
"""

from __future__ import annotations

import codecs
import json
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import chain
from typing import Any, cast

import numpy as np

from pdr_filter.data.io.column_names import (
    VECTORS,
    column_of,
    is_time,
    period_of,
    quantity_of_file,
    states_period,
)
from pdr_filter.data.io.files.archive import Members
from pdr_filter.data.io.tables.dates import is_date, nanoseconds_of, without_midnights
from pdr_filter.data.io.tables.sheet import Sheet
from pdr_filter.data.io.tables.text_sheets import LARGEST_FLOAT_WHOLE
from pdr_filter.data.io.text_table import NumberTable, finite, refuse_far_times, to_number, whole_number
from pdr_filter.values import FloatArray, IntArray, how_many, limits
from pdr_filter.values.errors import RecordingError

SUFFIXES = (".json", ".jsonl", ".ndjson")
_BETWEEN = re.compile(r"[\s,\[\]\x1e]*")
_BEGIN = re.compile(rb"\s*(\{|\[\s*([\[{\]\"\d.-]|null|$))")  # brackets around a word are TOML or a settings section
_SENSOR = ("sensor", "sensorType", "type", "name")  # keys whose value says of which sensor a row is
_PLAIN = ("values", "value", "data", "payload", "fields", "samples")  # keys that do not name their content
_AXES = ("x", "y", "z")
ROWS_AT_ONCE = 10_000  # limit of the rows that are in memory as Python objects
_MAX_DEPTH = 5
_NUMBERS = (float, int, str, bool)
_WHOLE = re.compile(r"[0-9]{1,19}(,[0-9]{1,19})*+")

Row = dict[str, Any]


def is_json(head: bytes) -> bool:
    """Return True if a text begins like JSON, judged by its first bytes."""
    return _BEGIN.match(head.removeprefix(codecs.BOM_UTF8)) is not None


def json_sheets(members: Members, name: str, notes: list[str] | None = None) -> list[Sheet]:
    """Return the tables in a JSON text, one for each sensor. Tables without numbers are left out.

    Rows before a damage are returned with a note. RecordingError if there are none, or if `notes` is None.
    """
    where = members.where(name)
    tables: dict[str, _Columns] = {}
    for item in objects_in(members.pieces(name), where, notes):
        for sensor, rows in _rows_of(item):
            if len(tables) >= limits.MAX_TABLES and sensor not in tables:
                raise RecordingError(f"{where}: more than {limits.MAX_TABLES} tables; export one recording")
            tables.setdefault(sensor, _Columns(where)).add(rows)
    stem = name.rpartition("/")[2].partition(".")[0]
    return [sheet for sensor, table in tables.items() if (sheet := table.sheet(sensor or stem)) is not None]


def json_fields(members: Members, name: str) -> list[Sheet]:
    """Return the tables of JSON without values, from the first bytes, or from all if no object ends in them."""
    head, found = members.head(name), dict[str, dict[str, None]]()
    for pieces in ([head], members.pieces(name)):
        with suppress(RecordingError):
            for item in objects_in(pieces, members.where(name)):
                for sensor, rows in _rows_of(item):
                    found.setdefault(sensor, {}).update(dict.fromkeys(rows if isinstance(rows, dict) else rows[0]))
        if found or len(head) < limits.HEAD_BYTES:
            break
    if n := next((n for fields in found.values() if (n := len(fields)) > limits.MAX_COLUMNS), 0):
        raise RecordingError(_too_many_columns(members.where(name), n))
    return [
        Sheet.of_columns(sensor, members.where(name), dict.fromkeys(fields, np.empty(0)))
        for sensor, fields in found.items()
    ]


def _too_many_columns(where: str, n: int) -> str:
    return f"{where}: {n} columns, over {limits.MAX_COLUMNS}; export fewer"


def objects_in(pieces: Iterable[bytes], where: str, notes: list[str] | None = None) -> Iterator[Row]:
    """Iterate over the JSON objects in a text, which are elements of an array or follow one another.

    Objects before a damage are returned, with a note. RecordingError if there is none, if `notes` is None, or if the
    text is not UTF-8.
    """
    decoder, utf_8 = json.JSONDecoder(), codecs.getincrementaldecoder("utf-8")()
    text, n_found, n_open, wanted = "", 0, 0, 0
    try:
        for piece in chain(pieces, [None]):
            text += utf_8.decode(piece or b"", piece is None).removeprefix("\ufeff" if not n_found else "")
            if len(text) < wanted and piece is not None:
                continue
            end = 0
            while True:
                at = end + 1
                if not text.startswith(",{", end):  # as between most objects; a search takes longer
                    between = cast("re.Match[str]", _BETWEEN.match(text, end))[0]
                    n_open += between.count("[") - between.count("]")
                    at = end + len(between)
                    if at == len(text):
                        break
                try:
                    value, end = decoder.raw_decode(text, at)
                except ValueError:
                    break
                if isinstance(value, dict):
                    n_found += 1
                    yield value
            text = text[at:]
            wanted = 2 * len(text)  # an object that is longer than a piece is not tried again for every one
            if len(text) > limits.MAX_WHOLE_BYTES:
                raise RecordingError(
                    f"{where}: an object of more than {limits.MAX_WHOLE_BYTES} characters, or damaged JSON; export "
                    "again, as CSV if the app can"
                )
    except (RecursionError, UnicodeDecodeError) as error:
        raise RecordingError(f"{where}: the JSON is damaged ({error}); export it again") from error
    if not text and n_open <= 0:
        return
    behind = f" behind {how_many(n_found, 'object')}" if n_found else ""
    words = f"{where}: the JSON is damaged or cut off{behind}"
    if notes is None or not n_found:
        raise RecordingError(f"{words}; export it again")
    notes.append(f"{words}; the rest was left out")


def _rows_of(
    item: Row, name: str = "", depth: int = 0, times: Row | None = None
) -> Iterator[tuple[str, list[Row] | dict[str, list[Any]]]]:
    """Yield the name and the rows or columns of the tables in a JSON object.

    The name is the sensor that a row or the object names, else the key, or `name` for keys such as "data". An object
    that is a row itself is a table of one row. Nested objects are searched, too, and so are packets: objects with the
    time of several samples, which then all have this time. `times` are those of the objects around this one; a list of
    times belongs to the lists that are as long.
    """
    item = _of_data_frame(item)
    if _is_plain(item):
        yield _sensor_of(item) or name, [_flat(item)]
        return
    lists = {key: cast("list[Any]", value) for key, value in item.items() if isinstance(value, list)}
    times = {**(times or {}), **_times_in(item)}
    tables = {key: rows for key, values in lists.items() if (rows := _as_rows(values, times))}
    columns = {key: rows for key, rows in lists.items() if key not in tables and _is_column(key, rows)}
    name = _sensor_of(item) or name
    of_rows = {key: v for key, v in times.items() if not isinstance(v, list)}
    for key, rows in tables.items():
        by_sensor: dict[str, list[Row]] = {}
        is_packed = depth < _MAX_DEPTH and _is_packet(rows[0])
        for row in rows:
            if is_packed:
                yield from _rows_of(row, name if key in _PLAIN else key, depth + 1, of_rows)
            else:
                by_sensor.setdefault(_sensor_of(row) or (name if key in _PLAIN else key), []).append(_flat(row))
        for sensor, found in by_sensor.items():
            yield sensor, _with_times(found, of_rows)
    if not all(map(is_time, columns)):
        n = max(map(len, columns.values()))
        yield name, columns if any(map(is_time, columns)) else _repeated(times, n) | columns
    inner = {key: cast("Row", value) for key, value in item.items() if isinstance(value, dict)}
    if not tables and not columns and not _is_packet(item):
        yield name, [_flat(item)]
    elif depth < _MAX_DEPTH:
        for key, value in inner.items():
            if _holds_samples(value):
                yield from _rows_of(value, name if key in _PLAIN else key, depth + 1, times)


def _of_data_frame(item: Row) -> Row:
    """Return an object with a list for each column, if it is a table as pandas and databases write it.

    Its columns are then objects of values by row number, or the names and the rows are two lists.
    """
    for value in item.values():  # this runs for each row of a large file
        if isinstance(value, dict) and "0" in value:
            return {key: _by_number(rows) if isinstance(rows, dict) else rows for key, rows in item.items()}
    names: Any = item.get("columns")
    for key in ("data", "values", "rows"):
        rows: Any = item.get(key)
        if isinstance(names, list) and isinstance(rows, list) and _are_rows(rows, len(cast("list[Any]", names))):
            columns = map(list, zip(*cast("list[list[Any]]", rows), strict=True))
            others = {name: value for name, value in item.items() if name not in ("columns", "index", key)}
            return others | dict(zip(map(str, cast("list[Any]", names)), columns, strict=True))
    return item


def _by_number(rows: Row) -> list[Any] | Row:
    """Return the values whose keys are all row numbers in the order of the numbers, and other objects unchanged."""
    numbers = [str(i) for i in range(len(rows))]
    return [rows[number] for number in numbers] if numbers and all(n in rows for n in numbers) else rows


def _are_rows(values: list[Any], n: int) -> bool:
    """Return True for a list of lists of `n` values each."""
    return values != [] and all(isinstance(row, list) and len(cast("list[Any]", row)) == n for row in values)


# Keys of objects about the whole recording. A rate in another object, such as that of locations, is not of all rows.
_ABOUT = re.compile(r"(?i).*(meta|info|header|about|setting|config|sampling|recording|session|device)\w*")


def _times_in(item: Row) -> Row:
    """Return the times of an object, and its sampling rate or interval, which may be among its metadata."""
    found: Row = {}
    for key, value in item.items():
        if isinstance(value, dict):
            inside = cast("Row", value)
            if _ABOUT.fullmatch(key) and not _holds_samples(inside):
                found |= {k: v for k, v in inside.items() if states_period(k) and isinstance(v, int | float)}
        elif is_time(key) or (isinstance(value, int | float) and states_period(key)):
            found[key] = value
    return found


def _is_plain(item: Row) -> bool:
    """Return True if an object, and those in it, have no list: most rows of large files."""
    for value in item.values():
        if isinstance(value, list):
            return False
        if isinstance(value, dict) and not all(type(inner) in _NUMBERS for inner in cast("Row", value).values()):
            return False
    return True


def _as_rows(values: list[Any], times: Row) -> list[Row]:
    """Return the objects in a list, or its lists of three values as x, y and z. Empty for another list.

    They get the times of a list that is as long, unless they have times of their own.
    """
    if values and isinstance(values[0], list):
        vectors = [cast("list[Any]", value) if isinstance(value, list) else [] for value in values]
        rows: list[Row] = [dict(zip(_AXES, v, strict=True)) if len(v) == len(_AXES) else {} for v in vectors]
    else:
        rows = [cast("Row", row) if isinstance(row, dict) else {} for row in values]
    found = [row for row in rows if row]
    lists = {key: v for key, v in times.items() if isinstance(v, list)}
    if not found or any(map(is_time, found[0])) or not (columns := _repeated(lists, len(rows))):
        return found
    at = (dict(zip(columns, now, strict=True)) for now in zip(*columns.values(), strict=True))
    return [time | row for time, row in zip(at, rows, strict=True) if row]


def _repeated(times: Row, n: int) -> dict[str, list[Any]]:
    """Return columns of n times: lists of that length, and single times that are repeated."""
    lists = {key: cast("list[Any]", t) if isinstance(t, list) else [t] * n for key, t in times.items()}
    return {key: column for key, column in lists.items() if len(column) == n}


def _is_column(key: str, values: list[Any]) -> bool:
    """Return True for a list that holds the values of a column. Short ones are a packet of one axis."""
    return len(values) >= limits.MIN_SAMPLES or (values != [] and column_of(0, key).axis != "")


def _holds_samples(item: Row) -> bool:
    """Return True if an object has a list of samples, or an object with one."""
    lists = ((key, cast("list[Any]", value)) for key, value in item.items() if isinstance(value, list))
    return any(_is_column(key, values) or (values and isinstance(values[0], dict | list)) for key, values in lists)


def _is_packet(item: Row) -> bool:
    """Return True if the samples of an object are in a list inside it, and not its own values."""
    inner = [cast("Row", value) for value in item.values() if isinstance(value, dict)]
    return any(map(_holds_samples, (item, *inner))) and not any(column_of(0, name).axis for name in _flat(item))


def _with_times(samples: list[Row], times: Row) -> list[Row]:
    """Return samples with the times of their packet, unless they have a time of their own."""
    return samples if not times or any(map(is_time, samples[0])) else [{**times, **sample} for sample in samples]


def _sensor_of(row: Row) -> str:
    """Return the sensor that a row names if it measures a vector, otherwise an empty string."""
    said = next((row[key] for key in _SENSOR if isinstance(row.get(key), str)), "")
    return said[: limits.MAX_NAME_CHARS] if quantity_of_file(said)[0] in VECTORS else ""


def _flat(item: Row, before: str = "", depth: int = 0) -> Row:
    """Return the values in a nested object by name, with points between levels, except keys such as "values".

    A list of three values becomes x, y and z. Other lists are left out.
    """
    found: Row = {}
    for key, value in item.items():
        name = before if key in _PLAIN else f"{before}.{key}" if before else key
        if isinstance(value, list) and _is_vector(key, values := cast("list[Any]", value)):
            value = dict(zip(_AXES, values, strict=True))
        if isinstance(value, dict):
            if depth < _MAX_DEPTH:
                found |= _flat(cast("Row", value), name, depth + 1)
        elif not isinstance(value, list):
            found[name or key] = value
    return found


def _is_vector(key: str, values: list[Any]) -> bool:
    """Return True for a list of three numbers, unless they are three samples of one axis."""
    return len(values) == len(_AXES) and not isinstance(values[0], list | dict) and not column_of(0, key).axis


class _Columns:
    """Columns of a table, filled in blocks of some thousand rows, so that few rows are in memory as objects."""

    def __init__(self, where: str) -> None:
        self._where = where
        self._rows: list[Row] = []
        self._parts: list[tuple[int, dict[str, _Column]]] = []  # number of rows, and columns

    def add(self, rows: list[Row] | dict[str, list[Any]]) -> None:
        if isinstance(rows, dict) and len({*map(len, rows.values())}) == 1:  # many small packets are kept together
            n = len(next(iter(rows.values())))
            if n < ROWS_AT_ONCE:
                rows = [dict(zip(rows, values, strict=True)) for values in zip(*rows.values(), strict=True)]
        if isinstance(rows, dict):
            n = max(map(len, rows.values()))
            self._keep({key: [*column, *[None] * (n - len(column))] for key, column in rows.items()}, n)
            return
        self._rows += rows
        if len(self._rows) >= ROWS_AT_ONCE:
            self._keep_rows()

    def sheet(self, name: str) -> Sheet | None:
        """Return the table, or None if no column holds numbers or dates."""
        self._keep_rows()
        columns: dict[str, FloatArray | IntArray] = {}
        places: dict[str, list[int]] = {"": [], "date": [], "exact": []}
        period_s = 0.0
        for field in dict.fromkeys(key for _, part in self._parts for key in part):
            known = [part.get(field, (np.full(n, np.nan), "")) for n, part in self._parts]
            kinds = {kind for _, kind in known}
            kind = kinds.pop() if len(kinds) == 1 else ""
            column: Any = np.concatenate([column for column, _ in known]).astype(np.int64 if kind else float)
            is_constant = len(column) > 1 and (column == column[0]).all()
            if is_constant and not kind and (of_field_s := period_of(field, float(column[0]))):
                period_s = of_field_s
                continue
            if is_constant and is_time(field):
                continue  # that of the start or of the whole file
            columns[field] = without_midnights(column) if kind == "date" else column
            places[kind].append(len(columns) - 1)
        if not columns:
            return None
        if period_s and not any(map(is_time, columns)):
            columns["time_s"] = period_s * np.arange(len(next(iter(columns.values()))), dtype=np.float64)
        return Sheet.of_columns(name, self._where, columns, {*places["date"]}, {*places["exact"]})

    def _keep_rows(self) -> None:
        if self._rows:
            keys = dict.fromkeys(key for row in self._rows for key in row)
            if len(keys) > limits.MAX_COLUMNS:
                raise RecordingError(_too_many_columns(self._where, len(keys)))
            self._keep({key: [row.get(key) for row in self._rows] for key in keys}, len(self._rows))
            self._rows = []

    def _keep(self, columns: dict[str, list[Any]], n: int) -> None:
        found = {key: _column(values, self._where) for key, values in columns.items()}
        self._parts.append((n, {key: column for key, column in found.items() if column is not None}))


_Column = tuple[FloatArray | IntArray, str]  # values, and whether they are dates or exact whole numbers


def _column(values: list[Any], where: str) -> _Column | None:
    """Return the values of a column and their kind, or None for a column of text.

    The kind is "date" for int64 nanoseconds, "exact" for int64 numbers that a float would round, and "" for floats,
    which all others and those with a missing value become.
    """
    first = next((value for value in values if value not in (None, "", "null")), None)
    try:
        if isinstance(first, str) and is_date(first):
            kind, whole = "date", [nanoseconds_of(v) if isinstance(v, str) and is_date(v) else None for v in values]
        elif str(first)[:20].isdecimal() and int(str(first)[:20]) > LARGEST_FLOAT_WHOLE:
            kind, whole = "exact", _wholes(["" if v is None else str(v) for v in values])
        else:
            return np.array(_floats(values), dtype=np.float64), ""
        if None in whole:  # NaN says so; what a float loses of nanoseconds is less than any clock's jitter
            return np.array([np.nan if v is None else float(v) for v in whole]), ""
        ticks = np.array(whole, dtype=np.int64)
    except (ValueError, OverflowError):
        return None
    refuse_far_times(ticks, where)
    return ticks, kind


def table_of_rows(rows: Sequence[Row], columns: Sequence[str], where: str, notes: list[str]) -> NumberTable:
    """Return a table of JSON objects: the key `time` as whole numbers, and the keys in `columns` as floats.

    Objects without a time are left out. RecordingError for a missing key, or a value that is not a number.
    """
    if rows and (missing := [key for key in ("time", *columns) if key not in rows[0]]):
        found = ", ".join(map(str, rows[0]))[:120]
        raise RecordingError(f"{where}: no key {missing[0]!r} (found: {found}); export again")
    try:
        times = _wholes([str(row["time"]) for row in rows])
        if None in times:
            rows = [row for row, time in zip(rows, times, strict=True) if time is not None]
        whole = np.array([time for time in times if time is not None], dtype=np.int64)
        values = np.empty((len(rows), len(columns)))
        for i, key in enumerate(columns):
            values[:, i] = _floats([row.get(key) for row in rows])
    except KeyError as error:
        raise RecordingError(f"{where}: an object has no key {error}; export it again") from error
    except (ValueError, TypeError, OverflowError) as error:
        raise RecordingError(f"{where}: not a number ({str(error)[:60]}); export it again") from error
    refuse_far_times(whole, where)
    return NumberTable(whole, finite(values, where, notes))


def _wholes(texts: list[str]) -> list[int | None]:
    """Convert texts of numbers to integers, without fractions, or None for empty texts and words such as null."""
    return [*map(int if _WHOLE.fullmatch(",".join(texts)) else whole_number, texts)]


def _floats(column: list[Any]) -> list[float]:
    """Return numbers, or texts of numbers, as floats, with NaN for missing values. ValueError for anything else."""
    kinds = set(map(type, column))
    if kinds <= {int, float} or (kinds == {str} and "_" not in "".join(column)):  # Python would read 1_0 as ten
        with suppress(ValueError):
            return list(map(float, column))
    return list(map(_float, column))


def _float(value: Any) -> float:
    if value is None:
        return math.nan
    if type(value) in (int, float):
        return float(value)
    number = to_number(value) if isinstance(value, str) else None
    if number is None:
        raise ValueError(repr(value))
    return number
