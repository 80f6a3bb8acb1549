"""Sheets of a spreadsheet (xlsx, xls), as phyphox and people write them; needs `pip install "pdr_filter[excel]"`."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter.io import limits
from pdr_filter.io.archive import Members
from pdr_filter.io.dates import is_date, nanoseconds_of, without_midnights
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.sheets import ArraySheet, unlike
from pdr_filter.io.table import to_number
from pdr_filter.values import FloatArray, IntArray

_WORKBOOK = "xl/workbook.xml"
_OLD = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_CELL = re.compile(rb"""\br\s{0,9}=\s{0,9}["']([A-Z]{1,9})([0-9]{1,18})["']""")
# A sheet is read as a rectangle: one cell far off would make it large. Tables of samples are full.
_LEAST_FILLED = 0.05
_CELLS_FREELY = 1_000_000
_ROWS_TRIED = 40
_MOST_S = 300.0  # a sheet of a million rows takes some ten seconds


def is_spreadsheet(members: Members, name: str = "") -> bool:
    """Whether a file is one of Excel: a zip with a workbook in it, or the older kind."""
    if members.is_container:
        return _WORKBOOK in members.names
    return members.head(name or members.names[0], 8) == _OLD


def spreadsheet_sheets(members: Members) -> list[ArraySheet]:
    """The tables in a spreadsheet."""
    path = members.path
    if importlib.util.find_spec("python_calamine") is None:
        raise RecordingError(
            f'{path}: a spreadsheet needs one more package: pip install "pdr_filter[excel]"; or export CSV'
        )
    if members.is_container:
        _check_claims(members)
    command = [sys.executable, "-P", str(Path(__file__).with_name("spreadsheet_rows.py")), str(limits.MAX_TABLES)]
    try:
        content = members.file(limits.MAX_WHOLE_BYTES)
        done = subprocess.run(command, input=content, capture_output=True, timeout=_MOST_S, check=True)
        sheets = json.loads(done.stdout)
    except (subprocess.SubprocessError, ValueError) as error:
        if isinstance(error, RecordingError):
            raise
        raise RecordingError(f"{path}: this spreadsheet is damaged or no table; export it again, or as CSV") from error
    return [sheet for name, rows in sheets if (sheet := _sheet(name, rows, f"{path}: {name}")) is not None]


def _check_claims(members: Members) -> None:
    """Unpack all of it within bounds, and compare the cells that are there with the rectangle around them."""
    for name in members.names:
        n_cells = last_row = last_column = 0
        rest = b""
        for part in members.parts(name):
            text = rest + part
            for column, row in _CELL.findall(text):
                n_cells += 1
                last_row = max(last_row, int(row))
                last_column = max(last_column, sum((c - 64) * 26**i for i, c in enumerate(reversed(column))))
            rest = text[-200:] if len(text) > 200 else b""
        if last_row * last_column * _LEAST_FILLED > max(n_cells, _CELLS_FREELY * _LEAST_FILLED):
            raise RecordingError(
                f"{members.path}: {name} has a cell in row {last_row}, column {last_column}, and hardly any before it; "
                "this is no table of samples"
            )


def _sheet(name: str, rows: list[list[Any]], where: str) -> ArraySheet | None:
    """The table in a sheet; None if there is none."""
    first = next((i for i in range(min(len(rows) - 1, _ROWS_TRIED)) if _is_row(rows[i]) and _is_row(rows[i + 1])), None)
    if first is None:
        return None
    header = next((row for row in reversed(rows[:first]) if any(isinstance(v, str) and v.strip() for v in row)), None)
    n = max(map(len, rows[first : first + 2]))
    if n > limits.MAX_COLUMNS:
        raise RecordingError(f"{where}: {n} columns, more than {limits.MAX_COLUMNS}; this is no table")
    names = [str(v).strip() for v in header or []][:n]
    dates = frozenset(i for i, value in enumerate(rows[first]) if _is_date(value))
    columns: list[FloatArray | IntArray] = []
    for i in range(n):
        values = [row[i] if i < len(row) else "" for row in rows[first:]]
        columns.append(
            _nanoseconds(values, where) if i in dates else np.array([_number(v) for v in values], dtype=float)
        )
    about = "\n".join(
        " ".join(str(v) for v in row if str(v).strip())[:200] for row in rows[:first] if row is not header
    )
    return ArraySheet(name, where, unlike(names + [""] * (n - len(names))), tuple(columns), about, dates)


def _is_row(row: list[Any]) -> bool:
    known = [value for value in row if value != ""]
    n_values = sum(_is_date(value) or not np.isnan(_number(value)) for value in known)
    return n_values >= 2 and 2 * n_values > len(known)


def _is_date(value: Any) -> bool:
    return isinstance(value, str) and is_date(value)


def _number(value: Any) -> float:
    """A number, also one that was typed as text, with a point or a comma; NaN for anything else."""
    if isinstance(value, bool):
        return float("nan")
    if isinstance(value, int | float):
        return float(value)
    number = to_number(value.replace(",", ".")) if isinstance(value, str) else None
    return float("nan") if number is None else number


def _nanoseconds(values: list[Any], where: str) -> IntArray:
    """Dates of cells as whole nanoseconds."""
    found: list[int] = []
    for value in values:
        if not _is_date(value):
            raise RecordingError(f"{where}: {str(value)[:40]!r} in a column of dates; give every row its time")
        try:
            found.append(nanoseconds_of(value))
        except ValueError as error:
            raise RecordingError(f"{where}: {error}") from error
    return without_midnights(np.array(found, dtype=np.int64))
