"""Any CSV file, with a small TOML file beside it that says which column is what: docs/formats.md, "Any CSV"."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from pdr_filter.io.archive import open_members, read_toml
from pdr_filter.io.assemble import Parsed
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.files import beside
from pdr_filter.io.recording import Recording
from pdr_filter.io.table import TextTable, find_separator, header_fields, to_number
from pdr_filter.values import STANDARD_GRAVITY_MPS2

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


@dataclass(frozen=True, slots=True)
class _Stream:
    """Where the values of a stream are in the table."""

    columns: list[str]
    time: str  # column; empty if rows come at a fixed rate
    unit: str
    factor: float  # to the unit of `Recording`, with the sign


def mapping_beside(path: Path) -> Path:
    """Where the mapping of a CSV file is: walk.toml or walk.csv.toml beside walk.csv."""
    longer = beside(path, path.name + ".toml")
    return longer if longer.is_file() else beside(path, path.with_suffix(".toml").name)


def read_generic_csv(path: str | Path) -> Recording:
    """Return the recording in a CSV file, as the TOML file beside it says.

    RecordingError without that file, with the columns seen and the mapping to write; or if the mapping does not fit.
    """
    path = Path(path)
    beside = mapping_beside(path)
    parsed = Parsed(path, "generic CSV")
    with open_members(path) as members:
        name = members.only_text()
        where = members.where(name)
        header = TextTable(members.blocks(name), where).header
        if path.is_dir() or not beside.is_file():
            raise RecordingError(f"{where}: {mapping_hint(header, beside)}")
        mapping = _Mapping(beside, header)
        table = TextTable(members.blocks(name), where, lambda _: mapping.separator)
        streams = mapping.streams
        # Times in nanoseconds since 1970 need all digits: whole numbers, made relative to the first.
        exact = None if mapping.exact_time is None else table.fields.index(mapping.exact_time)
        used = sorted({name for stream in streams.values() for name in (stream.time, *stream.columns)} - {""})
        rows = table.parse(table.places(used), parsed.notes, whole=exact, decimal=mapping.decimal)
    at = {column: rows.values[:, i] for i, column in enumerate(used)}
    for name, stream in streams.items():
        values = np.column_stack([at[column] for column in stream.columns]) * stream.factor
        if not stream.time:
            time_s = np.arange(len(rows)) / mapping.rate_hz
        elif exact is not None:
            time_s = (rows.whole - rows.whole[:1]).astype(np.float64) * mapping.unit_s
        else:
            time_s = at[stream.time] * mapping.unit_s
        known = ~np.isnan(values).all(axis=1)  # sensors of different rates in one table leave fields empty
        parsed.streams[name] = (time_s[known], values[known])
        parsed.found.append(
            f"{name}: {', '.join(stream.columns)}, {stream.unit or 'unit as it is'}, factor {stream.factor:.6g}, "
            "as given"
        )
    if mapping.rate_hz:
        parsed.requested_hz = {"accelerometer": mapping.rate_hz}
    columns = ", ".join(sorted({stream.time for stream in streams.values()} - {""}))
    parsed.clock = f"column {columns}, in {mapping.unit}" if columns else f"rows at {mapping.rate_hz:g} Hz"
    return parsed.recording()


def mapping_hint(header: str, beside: Path) -> str:
    """Columns of a header line, and the mapping to write."""
    fields = [field for field in header_fields(header, find_separator(header)) if field]
    seen = ", ".join(fields[:30])[:300] or "none"
    numbers = [to_number(field) for field in fields]
    if numbers and all(number is not None and not math.isnan(number) for number in numbers):
        return f"the first line has numbers ({seen[:80]}); write a line with the names of the columns above it"
    t, x, y, z = ((*fields, "?", "?", "?", "?")[i] for i in range(4))
    return (
        f"no format that is known. Columns seen: {seen}. If it is a table of samples, write these two lines to "
        f"{beside.name} beside it, with your columns, unit of time (s, ms, us, ns), unit (m/s2 or g) and sign (-1 if a "
        "phone lying face up reads negative on z):\n"
        f'time = {{ column = "{t}", unit = "s" }}\n'
        f'accelerometer = {{ columns = ["{x}", "{y}", "{z}"], unit = "m/s2", sign = 1 }}\n'
    )


class _Mapping:
    """The TOML file beside a table, checked against the table's header."""

    def __init__(self, path: Path, header: str) -> None:
        self._path = path
        content = read_toml(path)
        if unknown := content.keys() - {"file", "time", *STREAMS}:
            raise RecordingError(f"{path}: unknown table {sorted(unknown)[0]!r}; known are {', '.join(STREAMS)}")
        if "accelerometer" not in content:
            raise RecordingError(f'{path}: no [accelerometer]; write it with columns = ["x", "y", "z"]')
        file = self._table(content, "file", {"separator", "decimal"})
        self.separator = str(file.get("separator", find_separator(header)))
        self.decimal = str(file.get("decimal", "."))
        unusable = (self.decimal, '"', "\n", "\r")
        if len(self.separator) != 1 or self.separator in unusable or self.decimal not in (".", ","):
            raise RecordingError(
                f"{path}: separator {self.separator!r} and decimal {self.decimal!r} cannot be used together"
            )
        time = self._table(content, "time", {"column", "unit", "rate_hz"})
        self.unit = str(time.get("unit", "s"))
        if self.unit not in TIME_UNITS:
            raise RecordingError(f"{path}: time unit {self.unit!r}; known are {', '.join(TIME_UNITS)}")
        self.unit_s = TIME_UNITS[self.unit]
        rate_hz: Any = time.get("rate_hz")
        is_rate = isinstance(rate_hz, int | float) and not isinstance(rate_hz, bool) and 0.1 < rate_hz < 1e6
        self.rate_hz = float(rate_hz) if is_rate else 0.0
        self.streams = {
            name: self._stream(name, self._table(content, name, {"columns", "unit", "sign", "time"}), time)
            for name in STREAMS
            if name in content
        }
        fields = header_fields(header, self.separator)
        for stream in self.streams.values():
            for column in (*stream.columns, *([stream.time] if stream.time else [])):
                if fields.count(column) != 1:
                    raise RecordingError(
                        f"{path}: column {column!r} is in the table {fields.count(column)} times; "
                        f"columns seen: {', '.join(fields)[:300] or 'none'}"
                    )

    @property
    def exact_time(self) -> str | None:
        """The time column, if all streams share one in nanoseconds, whose digits a float cannot hold."""
        columns = {stream.time for stream in self.streams.values()}
        return next(iter(columns)) or None if self.unit == "ns" and len(columns) == 1 else None

    def _table(self, content: dict[str, Any], key: str, known: set[str]) -> dict[str, Any]:
        value: Any = content.get(key, {})
        if not isinstance(value, dict):
            raise RecordingError(f"{self._path}: {key} must be a table, like [{key}]")
        found = cast("dict[str, Any]", value)
        if found.keys() - known:
            raise RecordingError(
                f"{self._path}: [{key}] has {sorted(found.keys() - known)[0]!r}; known are {sorted(known)}"
            )
        return found

    def _stream(self, name: str, settings: dict[str, Any], time: dict[str, Any]) -> _Stream:
        n, units = STREAMS[name]
        columns: Any = settings.get("columns")
        if not isinstance(columns, list) or len(cast("list[Any]", columns)) != n:
            raise RecordingError(f"{self._path}: [{name}] needs columns = [...] with {n} names, got {columns!r}")
        unit = str(settings.get("unit", next(iter(units))))
        if unit not in units:
            raise RecordingError(f"{self._path}: [{name}] unit {unit!r}; known are {', '.join(units)}")
        sign: Any = settings.get("sign", 1)
        if sign not in (1, -1):
            raise RecordingError(f"{self._path}: [{name}] sign must be 1 or -1, got {sign!r}")
        time_column = str(settings.get("time", time.get("column", "")))
        if not time_column and not self.rate_hz:
            raise RecordingError(f"{self._path}: [time] needs column = ... or rate_hz = ...")
        return _Stream([str(column) for column in cast("list[Any]", columns)], time_column, unit, units[unit] * sign)
