"""Sheets of a spreadsheet (xlsx, xls), as phyphox and people write them; needs `pip install "pdr_filter[excel]"`."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from pdr_filter.data.io.files.archive import Members
from pdr_filter.data.io.tables.sheet import Sheet
from pdr_filter.data.io.tables.text_sheets import text_sheet
from pdr_filter.values import limits
from pdr_filter.values.errors import RecordingError

_WORKBOOK = "xl/workbook.xml"
_OLD = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_CELL = re.compile(rb"""\br\s{0,9}=\s{0,9}["']([A-Z]{1,9})([0-9]{1,18})["']""")
# A sheet is read as a rectangle: one cell far off would make it large. Tables of samples are full.
_LEAST_FILLED = 0.05
_CELLS_FREELY = 1_000_000
_BREAKS = re.compile(r"[\t\r\n]")
_MOST_S = 300.0  # a sheet of a million rows takes some ten seconds


def is_spreadsheet(members: Members, name: str = "") -> bool:
    """Return True if a file is an Excel file: a zip file that contains a workbook, or the older format."""
    if members.is_container:
        return _WORKBOOK in members.names
    return members.head(name or members.names[0], 8) == _OLD


def spreadsheet_sheets(members: Members) -> list[Sheet]:
    """Return the tables in the sheets of a spreadsheet. RecordingError if it is damaged or its package is missing."""
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
        raise RecordingError(
            f"{path}: this spreadsheet is damaged, encrypted or too large; export it again, or as CSV"
        ) from error
    return [sheet for name, rows in sheets if (sheet := _sheet(members, name, rows)) is not None]


def _check_claims(members: Members) -> None:
    """Raise RecordingError if a spreadsheet unpacks to too much, or has few cells in a huge rectangle."""
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
                "this is no table of samples; export the sheet with the samples as CSV"
            )


def _sheet(members: Members, name: str, rows: list[list[Any]]) -> Sheet | None:
    """Table in a sheet, read like the text that the sheet would be as CSV; None if there is none."""
    lines = ("\t".join(_BREAKS.sub(" ", "" if isinstance(v, bool) else str(v)) for v in row) for row in rows)
    content = "".join(f"{line}\n" for line in lines).encode()
    found = text_sheet(members, name, "\t", lambda: iter([content] if content else []))
    return None if found is None else replace(found, name=name, where=f"{members.path}: {name}")
