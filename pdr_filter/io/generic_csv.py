"""Any CSV file, with a small TOML file beside it that says which column is what.

`walk.csv` is read with `walk.toml`:

    [time]
    column = "t"                    # or rate_hz = 100 if there is no time column
    unit = "ms"                     # s, ms, us or ns
    [accelerometer]
    columns = ["ax", "ay", "az"]    # x right, y up along the screen, z out of it
    unit = "g"                      # m/s2 or g
    sign = -1                       # -1 if a phone lying face up reads -1 g on z (iOS), else 1
    [gyroscope]
    columns = ["gx", "gy", "gz"]
    unit = "deg/s"                  # rad/s or deg/s

Further tables are magnetometer (uT, mT, G), barometer (hPa, Pa, kPa; `columns = ["p"]`), light, proximity, attitude
(columns of qw, qx, qy, qz) and location (latitude, longitude, altitude, accuracy). A table may name its own
`time = "column"`. Without the TOML file the refusal lists the columns and the mapping to write.
"""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Any, cast

import numpy as np

from pdr_filter.io.archive import open_members
from pdr_filter.io.assemble import Parsed
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.get_sensor_data import only_text
from pdr_filter.io.recording import Recording
from pdr_filter.io.table import Layout, find_separator, header_fields, parse_blocks, split_header, to_number
from pdr_filter.values.samples import STANDARD_GRAVITY_MPS2

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
# For each stream: how many columns, and its units with the factor to the one of `Recording`; "" if none is needed.
STREAMS: dict[str, tuple[int, dict[str, float]]] = {
    "accelerometer": (3, {"m/s2": 1.0, "g": STANDARD_GRAVITY_MPS2}),
    "gyroscope": (3, {"rad/s": 1.0, "deg/s": math.pi / 180}),
    "magnetometer": (3, {"uT": 1.0, "mT": 1000.0, "G": 100.0}),
    "barometer": (1, {"hPa": 1.0, "mbar": 1.0, "Pa": 0.01, "kPa": 10.0}),
    "light": (1, {"lux": 1.0, "": 1.0}),
    "proximity": (1, {"cm": 1.0, "": 1.0}),
    "attitude": (4, {"": 1.0}),
    "location": (4, {"": 1.0}),
}
KEYS = {"columns", "unit", "sign", "time"}
MAX_MAPPING_BYTES = 100_000


def mapping_beside(path: Path) -> Path:
    """Where the mapping of a CSV file is: walk.toml or walk.csv.toml beside walk.csv."""
    longer = path.with_name(path.name + ".toml")
    return longer if longer.is_file() else path.with_suffix(".toml")


def read_generic_csv(path: str | Path) -> Recording:
    """Return the recording in a CSV file, as the TOML file beside it says.

    Raises
    ------
    RecordingError
        Without the TOML file, with the columns seen and the mapping to write; or if the mapping does not fit.
    """
    path = Path(path)
    beside = mapping_beside(path)
    parsed = Parsed(path, "generic CSV")
    with open_members(path) as members:
        name = only_text(members)
        where = members.where(name)
        header, body = split_header(members.blocks(name), where)
        if path.is_dir() or not beside.is_file():
            raise RecordingError(f"{where}: {mapping_hint(header, beside)}")
        mapping = _mapping(beside)
        file = _sub(mapping, "file", {"separator", "decimal"}, beside)
        separator = str(file.get("separator", find_separator(header)))
        decimal = str(file.get("decimal", "."))
        if len(separator) != 1 or decimal not in (".", ",") or separator in (decimal, '"', "\n", "\r"):
            raise RecordingError(f"{beside}: separator {separator!r} and decimal {decimal!r} cannot be used together")
        fields = header_fields(header, separator)
        streams = _streams(mapping, fields, beside)
        time = _sub(mapping, "time", {"column", "unit", "rate_hz"}, beside)
        unit_s = TIME_UNITS.get(str(time.get("unit", "s")))
        if unit_s is None:
            raise RecordingError(f"{beside}: time unit {time['unit']!r}; known are {', '.join(TIME_UNITS)}")
        time_columns = {stream: str(_of(mapping, stream).get("time", time.get("column", ""))) for stream in streams}
        for column in {*time_columns.values()} - {""}:
            _index(column, fields, beside)
        rate_hz = time.get("rate_hz")
        if "" in time_columns.values() and not (_is_number(rate_hz) and 0.1 < cast("float", rate_hz) < 1e6):
            raise RecordingError(f"{beside}: [time] needs column = ... or rate_hz = ...")
        used = sorted({*(c for c in time_columns.values() if c), *(c for cs in streams.values() for c in cs)})
        # Times in nanoseconds since 1970 need all digits: they are taken as text and made relative to the first.
        layout = Layout(tuple(fields.index(c) for c in used), None, separator, decimal, names=tuple(used))
        exact = _exact_time(time_columns, unit_s, fields)
        if exact is not None:
            layout = Layout(layout.picked, exact, separator, decimal, layout.names)
        rows = parse_blocks(body, layout, where, parsed.notes)
    at = {column: rows.values[:, i] for i, column in enumerate(used)}
    for stream, columns in streams.items():
        settings = _of(mapping, stream)
        unit = str(settings.get("unit", next(iter(STREAMS[stream][1]))))
        factor = STREAMS[stream][1][unit] * float(settings.get("sign", 1))
        values = np.column_stack([at[column] for column in columns]) * factor
        column = time_columns[stream]
        if not column:
            time_s = np.arange(len(rows)) / float(cast("float", rate_hz))
        elif exact is not None:
            zero = rows.whole[0] if len(rows) else 0
            time_s = (rows.whole - zero).astype(np.float64) * unit_s
        else:
            time_s = at[column] * unit_s
        known = ~np.isnan(values).all(axis=1)  # sensors of different rates in one table leave fields empty
        parsed.streams[stream] = (time_s[known], values[known])
        parsed.found.append(f"{stream}: {', '.join(columns)}, {unit or 'unit as it is'}, factor {factor:.6g}, as told")
    if _is_number(rate_hz):
        parsed.requested_hz = {"accelerometer": float(cast("float", rate_hz))}
    columns_said = ", ".join(sorted({*time_columns.values()} - {""}))
    parsed.clock = f"column {columns_said}, in {time.get('unit', 's')}" if columns_said else f"rows at {rate_hz} Hz"
    return parsed.recording()


def mapping_hint(header: str, beside: Path) -> str:
    """Columns of a header line, and the mapping to write."""
    fields = [field for field in header_fields(header, find_separator(header)) if field]
    seen = ", ".join(fields[:30])[:300] or "none"
    if (
        fields
        and all(not math.isnan(number) for field in fields if (number := to_number(field)) is not None)
        and all(to_number(field) is not None for field in fields)
    ):
        return f"the first line has numbers ({seen[:80]}); write a line with the names of the columns above it"
    t, x, y, z = ((*fields, "?", "?", "?", "?")[i] for i in range(4))
    return (
        f"no format that is known. Columns seen: {seen}. If it is a table of samples, write these two lines to "
        f"{beside.name} beside it, with your columns, unit of time (s, ms, us, ns), unit (m/s2 or g) and sign (-1 if a "
        "phone lying face up reads negative on z):\n"
        f'time = {{ column = "{t}", unit = "s" }}\n'
        f'accelerometer = {{ columns = ["{x}", "{y}", "{z}"], unit = "m/s2", sign = 1 }}\n'
    )


def _mapping(beside: Path) -> dict[str, Any]:
    try:
        if beside.stat().st_size > MAX_MAPPING_BYTES:
            raise ValueError("too long")
        mapping = tomllib.loads(beside.read_text(encoding="utf-8-sig"))
    except (ValueError, OSError, RecursionError) as error:
        raise RecordingError(f"{beside}: not TOML ({error}); correct it") from error
    unknown = mapping.keys() - {"file", "time", *STREAMS}
    if unknown:
        raise RecordingError(f"{beside}: unknown table {sorted(unknown)[0]!r}; known are {', '.join(STREAMS)}")
    if "accelerometer" not in mapping:
        raise RecordingError(f'{beside}: no [accelerometer]; write it with columns = ["x", "y", "z"]')
    return mapping


def _of(mapping: dict[str, Any], stream: str) -> dict[str, Any]:
    return cast("dict[str, Any]", mapping[stream])


def _sub(mapping: dict[str, Any], key: str, known: set[str], beside: Path) -> dict[str, Any]:
    value: Any = mapping.get(key, {})
    if not isinstance(value, dict):
        raise RecordingError(f"{beside}: {key} must be a table, like [{key}]")
    found = cast("dict[str, Any]", value)
    if found.keys() - known:
        raise RecordingError(f"{beside}: [{key}] has {sorted(found.keys() - known)[0]!r}; known are {sorted(known)}")
    return found


def _streams(mapping: dict[str, Any], fields: list[str], beside: Path) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for stream, (n, units) in STREAMS.items():
        if stream not in mapping:
            continue
        settings = _sub(mapping, stream, KEYS, beside)
        columns: Any = settings.get("columns")
        if not isinstance(columns, list) or len(cast("list[Any]", columns)) != n:
            raise RecordingError(f"{beside}: [{stream}] needs columns = [...] with {n} names, got {columns!r}")
        unit: Any = settings.get("unit", next(iter(units)))
        if unit not in units:
            raise RecordingError(f"{beside}: [{stream}] unit {unit!r}; known are {', '.join(units)}")
        if settings.get("sign", 1) not in (1, -1):
            raise RecordingError(f"{beside}: [{stream}] sign must be 1 or -1, got {settings['sign']!r}")
        found[stream] = [str(column) for column in cast("list[Any]", columns)]
        for column in found[stream]:
            _index(column, fields, beside)
    return found


def _index(column: str, fields: list[str], beside: Path) -> int:
    if fields.count(column) != 1:
        raise RecordingError(
            f"{beside}: column {column!r} is in the table {fields.count(column)} times; "
            f"columns seen: {', '.join(fields)[:300] or 'none'}"
        )
    return fields.index(column)


def _exact_time(time_columns: dict[str, str], unit_s: float, fields: list[str]) -> int | None:
    """The time column, if all streams share one in nanoseconds, whose digits a float cannot hold."""
    columns = {*time_columns.values()}
    if unit_s == TIME_UNITS["ns"] and len(columns) == 1 and "" not in columns:
        return fields.index(next(iter(columns)))
    return None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
