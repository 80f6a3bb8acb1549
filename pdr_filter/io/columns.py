"""Columns of a CSV text, found by the names in its header line."""

from __future__ import annotations

import contextlib
import csv
import io
import math
import re
from collections.abc import Sequence

import numpy as np

from pdr_filter.io.errors import RecordingError
from pdr_filter.values.arrays import FloatArray


def read_numbers(content: bytes, names: Sequence[str], where: str, notes: list[str]) -> FloatArray:
    """Number columns in the order of `names`, shape (N, d); NaN where a field is empty.

    Parameters
    ----------
    content : bytes
        UTF-8 text with a header line, comma as separator; byte order mark and CRLF are accepted.
    names : sequence of str
        Columns to take; others are ignored. RecordingError if one is missing.
    where : str
        File name for messages.
    notes : list of str
        What was repaired is appended here.
    """
    text = _decode(content, where)
    header, _, body = text.partition("\n")
    try:
        picked = _find_columns(next(csv.reader([header]), []), names, where)
    except csv.Error as error:
        raise RecordingError(f"{where}, line 1: not a CSV header ({error}); export it again") from error
    if not body.strip():
        return np.empty((0, len(names)))
    with contextlib.suppress(ValueError):
        return _parse(body, picked)
    with contextlib.suppress(ValueError):  # with empty fields filled: five times faster than the slow way
        return _parse(re.sub(r"(?m)^,", "nan,", re.sub(r",(?=,|\n|$)", ",nan", body)), picked)
    return fields_to_numbers(read_fields(content, names, where, notes), names, where)


def _parse(body: str, picked: list[int]) -> FloatArray:
    return np.loadtxt(
        io.StringIO(body), delimiter=",", comments=None, quotechar='"', usecols=picked, ndmin=2, encoding=None
    )


def read_fields(content: bytes, names: Sequence[str], where: str, notes: list[str]) -> list[tuple[int, list[str]]]:
    """Line number and the fields of `names`, as text without surrounding space, for every row; see `read_numbers`."""
    text = _decode(content, where)
    reader = csv.reader(io.StringIO(text))
    rows: list[tuple[int, list[str]]] = []
    try:
        picked = _find_columns(next(reader, []), names, where)
        for row in reader:
            if len(row) > max(picked):
                rows.append((reader.line_num, [row[i].strip() for i in picked]))
            elif len(row) > 1 or any(field.strip() for field in row):  # not an empty line
                line = reader.line_num
                if next(reader, None) is None and not text.endswith("\n"):
                    notes.append(f"{where}: the last line is cut off and was left out")
                    break
                raise RecordingError(
                    f"{where}, line {line}: only {len(row)} fields ({','.join(row)[:60]!r}); "
                    "every row needs one for each column, empty if unknown"
                )
    except csv.Error as error:
        raise RecordingError(f"{where}, line {reader.line_num}: not CSV text ({error}); export it again") from error
    return rows


def fields_to_numbers(rows: list[tuple[int, list[str]]], names: Sequence[str], where: str) -> FloatArray:
    """Numbers of text fields, shape (N, d); NaN for an empty one, RecordingError with its line for other text."""
    values = np.empty((len(rows), len(names)))
    for i, (line, fields) in enumerate(rows):
        try:
            values[i] = [_number(field) for field in fields]
        except ValueError as error:
            column, field = next((c, f) for c, f in zip(names, fields, strict=True) if not _is_number(f))
            raise RecordingError(
                f"{where}, line {line}, column {column}: {field[:60]!r} is not a number; "
                "use '.' as decimal point and leave unknown values empty"
            ) from error
    return values


def _number(field: str) -> float:
    if "_" in field:  # Python would read 1_0 as ten
        raise ValueError(field)
    return float(field) if field else math.nan


def _is_number(field: str) -> bool:
    try:
        _number(field)
    except ValueError:
        return False
    return True


def _decode(content: bytes, where: str) -> str:
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordingError(
            f"{where}: not UTF-8 text (byte 0x{content[error.start]:02x} at {error.start}); save it as UTF-8"
        ) from error
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _find_columns(header: list[str], names: Sequence[str], where: str) -> list[int]:
    found = [name.strip() for name in header]
    for name in names:
        if found.count(name) != 1:
            problem = "no column" if name not in found else f"{found.count(name)} columns"
            listed = ", ".join(found)[:120] or "nothing"
            raise RecordingError(
                f"{where}: {problem} {name!r} (found: {listed}); the first line must name {','.join(names)} once each"
            )
    return [found.index(name) for name in names]
