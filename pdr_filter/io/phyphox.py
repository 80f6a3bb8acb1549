"""phyphox (iOS, Android): a zip or folder of CSV files, or one CSV file.

Layout after the app's export code (github.com/phyphox/phyphox-android, DataExport.java) and its experiments:

- Headers are quoted and carry the unit, `"Time (s)","Acceleration x (m/s^2)",...`; numbers look like 9.810000000E0.
- The user chooses one of five pairs of separator and decimal sign: comma and point; tabulator or semicolon with point
  or comma. The header shows the separator, the first row of numbers the decimal sign.
- The sign is Android's on both systems: phyphox turns it on iOS. `Linear Acceleration` has gravity removed.
- Time is in seconds of the experiment, which stands still while it is paused; `meta/time.csv` has the wall clock.
- One CSV file alone holds all tables of the experiment one below the other, each with its own header.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath

import numpy as np

from pdr_filter.io.archive import Members, open_members
from pdr_filter.io.assemble import Parsed
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.recording import Recording
from pdr_filter.io.table import SEPARATORS, Layout, decode, header_fields, parse_blocks, to_number
from pdr_filter.values.samples import STANDARD_GRAVITY_MPS2

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
# Experiments have at most some ten tables.
MAX_TABLES = 100
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
LOCATION = (
    ("latitude",),
    ("longitude",),
    ("height", "altitude", "altitude wgs84"),
    ("horizontal accuracy",),
)
COLUMN = re.compile(r"^\s*(?P<name>[^()]*?)(?:\s+(?P<axis>[xyzXYZ]))?\s*\((?P<unit>[^()]*)\)\s*$")
AXIS_ONLY = re.compile(r"^\s*(?P<axis>[xyzXYZ])\s*\((?P<unit>[^()]*)\)\s*$")


def looks_like(header: str) -> bool:
    """Whether the header line of a CSV file is one of phyphox."""
    return any(
        header.lstrip("\ufeff").startswith(f'"{TIME}"{s}') or header.startswith(f"{TIME}{s}") for s in SEPARATORS
    )


def read_phyphox(path: str | Path) -> Recording:
    """Return the recording in a zip file, folder or CSV file of phyphox.

    Raises
    ------
    RecordingError
        If there is no acceleration with gravity, or a column has a unit that is not known.
    """
    path = Path(path)
    parsed = Parsed(path, "phyphox")
    without_gravity = False
    with open_members(path) as members:
        for name in members.names:
            pure = PurePosixPath(name)
            is_table = pure.suffix.lower() in (".csv", ".txt") or len(members.names) == 1
            if is_table and pure.parent.name != "meta":
                for header, blocks, line in _tables(members.blocks(name), members.where(name)):
                    found = _read_table(header, blocks, line, pure.stem, members.where(name), parsed)
                    without_gravity = without_gravity or found
        _read_meta(members, parsed)
    if "accelerometer" not in parsed.streams:
        remedy = "this is acceleration without gravity; " if without_gravity else ""
        raise RecordingError(f"{path}: no acceleration with gravity ({remedy}record 'Acceleration with g')")
    parsed.notes = list(dict.fromkeys(parsed.notes))
    return parsed.recording()


def _tables(blocks: Iterable[bytes], where: str) -> Iterator[tuple[bytes, Iterator[bytes], int]]:
    """Each table of a file: its header, the blocks of its rows, and the line number of its first row."""
    source = iter(blocks)
    waiting = next(source, None)
    line = 1
    for _ in range(MAX_TABLES):
        if not waiting:
            return
        header, _, waiting = waiting.partition(b"\n")
        line += 1

        def rows(begin: bytes) -> Iterator[bytes]:
            nonlocal waiting, line
            block: bytes | None = begin
            waiting = None
            while block is not None:
                at = 0 if block.startswith(b'"') else block.find(b'\n"') + 1
                if at or block.startswith(b'"'):  # only headers have quotes: the next table begins
                    waiting = block[at:]
                    line += block.count(b"\n", 0, at)
                    if at:
                        yield block[:at]
                    return
                if block:
                    yield block
                line += block.count(b"\n")
                block = next(source, None)

        yield header, rows(waiting), line
    raise RecordingError(f"{where}: more than {MAX_TABLES} lines that begin like a header; export it again")


def _read_table(header: bytes, blocks: Iterator[bytes], line: int, stem: str, where: str, parsed: Parsed) -> bool:
    """Put the streams of one table into `parsed`; true if it has acceleration without gravity."""
    text = decode(header, where)
    separator = _separator(text)
    fields = header_fields(text, separator)
    if not fields or fields[0] != TIME:
        for _ in blocks:
            pass
        return False
    streams, without_gravity = _columns(fields, stem, where)
    picked = (0, *(i for columns in streams.values() for i, _ in columns))
    first = next(blocks, b"")
    decimal = "," if separator != "," and b"," in first.split(b"\n", 1)[0] else "."
    names = tuple(fields[i] for i in picked)

    def all_blocks() -> Iterator[bytes]:
        yield first
        yield from blocks

    table = parse_blocks(all_blocks(), Layout(picked, None, separator, decimal, names), where, parsed.notes, line)
    at = 1
    for stream, columns in streams.items():
        values = table.values[:, at : at + len(columns)] * np.array([factor for _, factor in columns])
        at += len(columns)
        known = ~np.isnan(values).all(axis=1)  # tables are as long as their longest column
        if known.any():
            if stream in parsed.streams:
                raise RecordingError(f"{where}: {stream} is there twice; keep one of them")
            parsed.streams[stream] = (table.values[known, 0], values[known])
            units = fields[columns[0][0]]
            parsed.found.append(f"{stream}: from {units!r}, factor {columns[0][1]:.6g}, Android's sign on both systems")
    return without_gravity


def _separator(header: str) -> str:
    """What stands between the first two fields."""
    after = header.lstrip("\ufeff").removeprefix('"').removeprefix(TIME).removeprefix('"')[:1]
    return after if after in SEPARATORS else ","


def _columns(fields: list[str], stem: str, where: str) -> tuple[dict[str, list[tuple[int, float]]], bool]:
    """Columns of each stream in the order of its axes, with the factor to its unit."""
    found: dict[str, dict[str, tuple[int, float]]] = {}
    location: dict[int, tuple[int, float]] = {}
    without_gravity = False
    sensor = re.sub(r"[_\s]+", " ", stem.lower()).strip()
    for i, field in enumerate(fields[1:], 1):
        match = AXIS_ONLY.match(field) or COLUMN.match(field)
        if match is None:
            continue
        unit, axis = match["unit"].strip(), (match["axis"] or "").lower()
        name = match.groupdict().get("name")
        name = sensor if name is None else name.lower().strip()
        if name in WITHOUT_GRAVITY:
            without_gravity = True
            continue
        for j, names in enumerate(LOCATION):
            if name in names and not axis:
                location.setdefault(j, (i, 1.0))
        stream = STREAM_OF.get(name)
        if stream is None or (stream in VECTORS) != bool(axis):
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
        wanted = ("x", "y", "z") if stream in VECTORS else ("",)
        missing = [axis for axis in wanted if axis not in axes]
        if missing:
            raise RecordingError(f"{where}: {stream} has no column for {', '.join(missing)}; export all three axes")
        streams[stream] = [axes[axis] for axis in wanted]
    if {0, 1, 2, 3} <= location.keys():
        streams["location"] = [location[j] for j in range(4)]
    return streams, without_gravity


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
        parsed.notes.append(f"the experiment was paused {pauses - 1} times; its clock stood still meanwhile")
    about = {row[0]: row[1] for row in _meta_rows(members, names, "device.csv") if len(row) >= 2}
    device = " ".join(about.get(key, "") for key in ("deviceManufacturer", "deviceModel")).strip()
    if device:
        parsed.meta["device"] = device[:200]
    if about.get("version"):
        parsed.source = f"phyphox {about['version'][:40]}"


def _meta_rows(members: Members, names: dict[str, str], name: str) -> list[list[str]]:
    if name not in names:
        return []
    lines = members.content(names[name]).decode("utf-8", "replace").splitlines()
    separator = next((s for s in ("\t", ";", ",") if lines and f'"{s}' in lines[0]), ",")
    return [header_fields(line, separator) for line in lines[1:1000]]
