"""phyphox (iOS, Android): a zip or folder of CSV files, or one CSV file.

Layout after the app's export code (github.com/phyphox/phyphox-android, DataExport.java) and its experiments: quoted
headers with the unit, `"Time (s)","Acceleration x (m/s^2)",...`, five pairs of separator and decimal sign, Android's
sign on both systems (docs/formats.md, "Known traps"). Time is in seconds of the experiment, which stands still while it
is paused. One CSV file alone holds all tables of the experiment one below the other, each with its own header.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path, PurePosixPath

import numpy as np

from pdr_filter.io import columns as vocabulary
from pdr_filter.io import limits
from pdr_filter.io.archive import Members, open_members
from pdr_filter.io.assemble import Parsed
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.recording import Recording
from pdr_filter.io.table import SEPARATORS, TextTable, header_fields, to_number
from pdr_filter.values import STANDARD_GRAVITY_MPS2, how_often

TIME = "Time (s)"
# Words of a column name, without axis and unit, in lower case: experiments of the app and those that users make with
# its editor, whose columns are X, Y, Z in a file called after the sensor.
STREAM_OF = {
    "acceleration": "accelerometer",
    "accelerometer": "accelerometer",
    "acceleration with g": "accelerometer",
    "gyroscope": "gyroscope",
    "magnetic field": "magnetometer",
    "magnetometer": "magnetometer",
    "pressure": "barometer",
    "barometer": "barometer",
    "illuminance": "light",
    "light": "light",
    "distance": "proximity",
    "proximity": "proximity",
}
WITHOUT_GRAVITY = ("linear acceleration", "linear accelerometer", "acceleration without g")
VECTORS = ("accelerometer", "gyroscope", "magnetometer")
# Factor to the unit of the stream. Micro is U+00B5 or U+03BC; the square is ^2 or U+00B2.
FACTOR = {
    "accelerometer": {"m/s^2": 1.0, "m/s\u00b2": 1.0, "g": STANDARD_GRAVITY_MPS2},
    "gyroscope": {"rad/s": 1.0, "\u00b0/s": math.pi / 180, "deg/s": math.pi / 180},
    "magnetometer": {"\u00b5T": 1.0, "\u03bcT": 1.0, "uT": 1.0, "mT": 1000.0},
    "barometer": {"hPa": 1.0, "mbar": 1.0, "Pa": 0.01, "kPa": 10.0},
    "light": {"lx": 1.0, "lux": 1.0},
    "proximity": {"cm": 1.0, "mm": 0.1, "m": 100.0},
}
LOCATION = (("latitude",), ("longitude",), ("height", "altitude", "altitude wgs84"), ("horizontal accuracy",))
AXES = ("x", "y", "z")
_NAMES = {*STREAM_OF, *WITHOUT_GRAVITY, *(name for names in LOCATION for name in names)}


def looks_like(header: str) -> bool:
    """Whether the header line of a CSV file is one of phyphox: a time, and a column of a sensor with its unit.

    One with a further vector under a name that phyphox does not write is another app's.
    """
    for separator in SEPARATORS:
        time, _, others = header.partition(separator)
        if time.strip('"') == TIME and others:
            first, *further = (field.strip('" ') for field in others.split(separator))
            parts = _name_axis_unit(first)
            is_first = parts is not None and (not parts[0] or parts[0] in _NAMES)
            return is_first and not any(map(_is_of_another_app, further))
    return False


def _is_of_another_app(field: str) -> bool:
    parts = _name_axis_unit(field)
    is_known = parts is not None and (not parts[0] or parts[0] in _NAMES)
    return not is_known and vocabulary.column_of(0, field.partition("(")[0]).quantity in vocabulary.VECTORS


def read_phyphox(path: str | Path) -> Recording:
    """Return the recording in a zip file, folder or CSV file of phyphox.

    RecordingError if there is no acceleration with gravity, or a column has a unit that is not known.
    """
    path = Path(path)
    parsed = Parsed(path, "phyphox")
    without_gravity = False
    with open_members(path) as members:
        for name in members.names:
            pure = PurePosixPath(name)
            is_table = pure.suffix.lower() in (".csv", ".txt") or len(members.names) == 1
            if is_table and pure.parent.name != "meta":
                for table in _tables(members.blocks(name), members.where(name)):
                    without_gravity |= _read_table(table, pure.stem, parsed)
        _read_meta(members, parsed)
    if "accelerometer" not in parsed.streams:
        remedy = "this is acceleration without gravity; " if without_gravity else ""
        raise RecordingError(f"{path}: no acceleration with gravity ({remedy}record 'Acceleration with g')")
    parsed.notes = list(dict.fromkeys(parsed.notes))
    return parsed.recording()


def _tables(blocks: Iterable[bytes], where: str) -> Iterator[TextTable]:
    """Each table of a file; only headers have quotes, so a line that begins with one begins a table."""

    def pieces() -> Iterator[tuple[int, bytes]]:
        line = first_line = 1
        n_tables = 0
        for block in blocks:
            begins = [0, *(match.start() + 1 for match in re.finditer(rb'\n"', block))]
            for begin, end in zip(begins, [*begins[1:], len(block)], strict=True):
                piece = block[begin:end]
                if piece.startswith(b'"'):
                    first_line, n_tables = line, n_tables + 1
                    if n_tables > limits.MAX_TABLES:
                        raise RecordingError(
                            f"{where}: more than {limits.MAX_TABLES} lines that begin like a header; export it again"
                        )
                yield first_line, piece
                line += piece.count(b"\n")

    for first_line, rows in groupby(pieces(), key=lambda item: item[0]):
        yield TextTable((piece for _, piece in rows), where, _separator, first_line)


def _read_table(table: TextTable, stem: str, parsed: Parsed) -> bool:
    """Put the streams of one table into `parsed`; true if it has acceleration without gravity."""
    fields, where = table.fields, table.where
    if not fields or fields[0] != TIME:
        return False
    streams, without_gravity = _columns(fields, stem, where)
    first_row = table.first_rows.split(b"\n", 1)[0]
    decimal = "," if table.separator != "," and b"," in first_row else "."
    places = [0, *(i for columns in streams.values() for i, _ in columns)]
    rows = table.parse(places, parsed.notes, decimal=decimal)
    at = 1
    for stream, columns in streams.items():
        values = rows.values[:, at : at + len(columns)] * np.array([factor for _, factor in columns])
        at += len(columns)
        known = ~np.isnan(values).all(axis=1)  # tables are as long as their longest column
        if known.any():
            if stream in parsed.streams:
                raise RecordingError(f"{where}: {stream} is there twice; keep one of them")
            parsed.streams[stream] = (rows.values[known, 0], values[known])
            first, factor = columns[0]
            sign = ", Android's sign on both systems" if stream in VECTORS else ""
            parsed.found.append(f"{stream}: from {fields[first]!r}, factor {factor:.6g}{sign}")
    return without_gravity


def _separator(header: str) -> str:
    """What is between the first two fields."""
    after = header.lstrip("\ufeff").removeprefix('"').removeprefix(TIME).removeprefix('"')[:1]
    return after if after in SEPARATORS else ","


def _columns(fields: list[str], stem: str, where: str) -> tuple[dict[str, list[tuple[int, float]]], bool]:
    """Columns of each stream in the order of its axes, with the factor to its unit."""
    found: dict[str, dict[str, tuple[int, float]]] = {}
    location: dict[int, tuple[int, float]] = {}
    without_gravity = False
    sensor = re.sub(r"[_\s]+", " ", stem.lower()).strip()
    for i, field in enumerate(fields[1:], 1):
        if (parts := _name_axis_unit(field)) is None:
            continue
        name, axis, unit = parts
        name = sensor if axis and not name else name
        if name in WITHOUT_GRAVITY:
            without_gravity = True
            continue
        for j, names in enumerate(LOCATION):
            if name in names and not axis:
                location.setdefault(j, (i, 1.0))
        if (stream := STREAM_OF.get(name)) is None or (stream in VECTORS) != bool(axis):
            continue
        if unit not in FACTOR[stream]:
            raise RecordingError(
                f"{where}: column {field!r}: unit {unit!r} is not known for the {stream}; "
                f"known are {', '.join(FACTOR[stream])}"
            )
        if axis in found.setdefault(stream, {}):
            raise RecordingError(f"{where}: two columns for {stream} {axis}; keep one")
        found[stream][axis] = (i, FACTOR[stream][unit])
    streams: dict[str, list[tuple[int, float]]] = {}
    for stream, axes in found.items():
        wanted = AXES if stream in VECTORS else ("",)
        if missing := [axis for axis in wanted if axis not in axes]:
            raise RecordingError(f"{where}: {stream} has no column for {', '.join(missing)}; export all three axes")
        streams[stream] = [axes[axis] for axis in wanted]
    if {0, 1, 2, 3} <= location.keys():
        streams["location"] = [location[j] for j in range(4)]
    return streams, without_gravity


def _name_axis_unit(field: str) -> tuple[str, str, str] | None:
    """The parts of a column's name such as `Acceleration x (m/s^2)`, the first two in lower case; None of another."""
    words, bracket, rest = field.partition("(")
    unit, closing, after = rest.partition(")")
    if not bracket or not closing or after.strip() or ")" in words or "(" in unit:
        return None
    *name, last = words.lower().rsplit(maxsplit=1) or [""]
    name, axis = ("".join(name), last) if last in AXES else (words.lower(), "")
    return name.strip(), axis, unit.strip()


def _read_meta(members: Members, parsed: Parsed) -> None:
    """Wall clock, pauses and device, as far as they are there; nothing depends on them."""
    names = {PurePosixPath(name).name: name for name in members.names if PurePosixPath(name).parent.name == "meta"}
    parsed.clock = "seconds of the experiment"
    for row in _meta_rows(members, names, "time.csv"):
        if len(row) >= 3 and row[0] == "START" and "epoch_s" not in parsed.meta:
            begun_s, epoch_s = (to_number(field.replace(",", ".")) for field in row[1:3])
            if begun_s is not None and epoch_s is not None and math.isfinite(begun_s + epoch_s):
                parsed.meta["epoch_s"] = epoch_s - begun_s
                parsed.clock = f"seconds of the experiment, which began at {epoch_s:.3f} s since 1970"
    pauses = sum(row[:1] == ["PAUSE"] for row in _meta_rows(members, names, "time.csv"))
    if pauses > 1:
        parsed.notes.append(f"the experiment was paused {how_often(pauses - 1)}; its clock stood still meanwhile")
    about = {row[0]: row[1] for row in _meta_rows(members, names, "device.csv") if len(row) >= 2}
    parsed.set_device(about.get("deviceManufacturer"), about.get("deviceModel"))
    if about.get("version"):
        parsed.source = f"phyphox {about['version'][:40]}"


def _meta_rows(members: Members, names: dict[str, str], name: str) -> list[list[str]]:
    if name not in names:
        return []
    lines = members.small(names[name]).decode("utf-8", "replace").splitlines()
    separator = next((s for s in ("\t", ";", ",") if lines and f'"{s}' in lines[0]), ",")
    return [header_fields(line, separator) for line in lines[1:1000]]
