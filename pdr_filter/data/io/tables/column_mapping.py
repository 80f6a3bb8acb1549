"""Mapping from columns of a table to streams, read from a TOML file or guessed, and written as one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from pdr_filter.data.io.column_names import (
    ACCELERATION,
    ANGLES,
    GRAVITY,
    LINEAR,
    PHONE_HEADING,
    PHONE_STEPS,
    TIME_UNITS,
    UNITS,
    normal_unit,
)
from pdr_filter.data.io.files.archive import read_toml
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.safe_files import beside

_SIGNED = ("accelerometer", GRAVITY, LINEAR)
# For each stream: how many columns, and its units; the first if none is given.
STREAMS: dict[str, tuple[int, tuple[str, ...]]] = {
    **dict.fromkeys(_SIGNED, (3, ("m/s2", "g", "mg"))),
    "gyroscope": (3, ("rad/s", "deg/s", "mdps")),
    "magnetometer": (3, ("uT", "mT", "G", "T")),
    "barometer": (1, ("hPa", "mbar", "Pa", "kPa")),
    "light": (1, ("lux", "")),
    "proximity": (1, ("cm", "mm", "m", "")),
    "attitude": (4, ("",)),
    ANGLES: (3, ("rad", "deg")),
    "location": (4, ("",)),
    PHONE_HEADING: (1, ("deg", "rad")),
    PHONE_STEPS: (1, ("steps",)),
}


@dataclass(frozen=True, slots=True)
class StreamMap:
    """Columns, unit and sign of one stream."""

    stream: str  # one of `STREAMS`
    columns: tuple[str, ...]  # an empty name is a value that is not known
    unit: str
    sign: float = 1  # NaN in a template, because values do not show it
    counts_per_unit: float = 1.0  # numbers of the sensor for one unit; NaN in a template, if not known
    bias: tuple[str, ...] = ()  # columns that are subtracted
    time: str = ""  # column; empty if rows come at a fixed rate
    time_unit: str = "s"
    file: str = ""  # name without suffix, of one of several tables

    @property
    def factor(self) -> float:
        """Factor from the unit and sign of the column to the unit and sign in `Recording`."""
        quantity = ACCELERATION if self.stream == "accelerometer" else self.stream
        return UNITS.get(quantity, {}).get(normal_unit(self.unit), 1.0) * self.sign / self.counts_per_unit


@dataclass(frozen=True, slots=True)
class Mapping:
    """Columns of all streams of a recording."""

    streams: tuple[StreamMap, ...]
    rate_hz: float = 0.0  # rate of tables without a time
    separator: str = ""  # between the columns of a text; empty if it is to be detected
    decimal: str = ""  # decimal point or comma; empty if it is to be detected
    where: str = ""  # name of the TOML file, or of the recording whose columns were guessed, for messages

    def toml(self) -> str:
        """Return the mapping as the text of a TOML file."""
        times = {(stream.time, stream.time_unit) for stream in self.streams}
        time, unit = times.pop() if len(times) == 1 else ("", "")
        shared = {"column": time, "unit": unit if time else "", "rate_hz": self.rate_hz}
        tables: dict[str, dict[str, Any]] = {
            "file": {"separator": self.separator, "decimal": self.decimal},
            "time": shared,
        }
        for s in self.streams:
            is_signed = s.stream in _SIGNED or s.sign != 1
            own_time = {} if time else {"time": s.time, "time_unit": s.time_unit if s.time else ""}
            tables[s.stream] = {
                **{"file": s.file, "columns": s.columns, "unit": s.unit, "bias": s.bias},
                **{"counts_per_unit": s.counts_per_unit if s.counts_per_unit != 1 else 0},
                **{"sign": s.sign if is_signed else 0, **own_time},
            }
        return "".join(
            f"{name} = {{ {', '.join(f'{key} = {_toml(value)}' for key, value in known.items())} }}\n"
            for name, table in tables.items()
            if (known := {key: value for key, value in table.items() if value})
        )


def _toml(value: str | float | Sequence[str]) -> str:
    """Return a text, a number or a list of texts as a value of a TOML file."""
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, int | float):
        return '"?"' if math.isnan(value) else f"{value:.10g}"
    return f"[{', '.join(map(_quoted, value))}]"


def mapping_beside(path: Path) -> Path:
    """Return the path of the column mapping of walk.csv: walk.csv.toml if that exists, otherwise walk.toml."""
    longer = beside(path, path.name + ".toml")
    return longer if longer.is_file() else beside(path, path.with_suffix(".toml").name)


def read_mapping(path: Path) -> Mapping:
    """Read a column mapping from a TOML file. RecordingError if it is invalid."""
    content = read_toml(path)
    if unknown := content.keys() - {"file", "time", *STREAMS}:
        raise RecordingError(f"{path}: unknown table {sorted(unknown)[0]!r}; use file, time, {', '.join(STREAMS)}")
    if "accelerometer" not in content and LINEAR not in content:
        raise RecordingError(
            f'{path}: no [accelerometer]; write it with columns = ["x", "y", "z"], or [{LINEAR}], with [{GRAVITY}] if '
            "the table has it"
        )
    file = _table(path, content, "file", {"separator", "decimal"})
    separator, decimal = str(file.get("separator", "")), str(file.get("decimal", ""))
    unusable = (decimal or ".", '"', "\n", "\r")
    if ("separator" in file and len(separator) != 1) or separator in unusable or decimal not in ("", ".", ","):
        raise RecordingError(
            f"{path}: separator {separator!r} and decimal {decimal!r} do not fit; write ';' and ',', or ',' or '\\t' "
            "and '.'"
        )
    time = _table(path, content, "time", {"column", "unit", "rate_hz"})
    rate_hz: Any = time.get("rate_hz")
    is_rate = isinstance(rate_hz, int | float) and not isinstance(rate_hz, bool) and 0.1 < rate_hz < 1e6
    known = {"columns", "unit", "counts_per_unit", "bias", "sign", "time", "time_unit", "file"}
    streams = tuple(
        _stream(path, name, _table(path, content, name, known), time, is_rate) for name in STREAMS if name in content
    )
    return Mapping(streams, float(rate_hz) if is_rate else 0.0, separator, decimal, str(path))


def _table(path: Path, content: dict[str, Any], key: str, known: set[str]) -> dict[str, Any]:
    value: Any = content.get(key, {})
    if not isinstance(value, dict):
        raise RecordingError(f"{path}: {key} is not a table; write it as [{key}]")
    found = cast("dict[str, Any]", value)
    if found.keys() - known:
        raise RecordingError(f"{path}: [{key}] has {sorted(found.keys() - known)[0]!r}; use {', '.join(sorted(known))}")
    return found


def _stream(path: Path, name: str, settings: dict[str, Any], time: dict[str, Any], is_rate: bool) -> StreamMap:
    n, units = STREAMS[name]
    columns: Any = settings.get("columns")
    bias: Any = settings.get("bias", [])
    for key, found, lengths in (("columns", columns, (n,)), ("bias", bias, (0, n))):
        if not isinstance(found, list) or len(cast("list[Any]", found)) not in lengths:
            raise RecordingError(f"{path}: [{name}] {key} is {found!r}; write {n} names, as in {key} = [...]")
    unit = str(settings.get("unit", units[0]))
    if unit not in units:
        remedy = f"write one of {', '.join(filter(None, units))}" if any(units) else "leave it out"
        raise RecordingError(f"{path}: [{name}] unit is {unit!r}; {remedy}")
    counts: Any = settings.get("counts_per_unit", 1)
    if isinstance(counts, bool) or not isinstance(counts, int | float) or not 1e-9 < counts < 1e9:
        raise RecordingError(
            f"{path}: [{name}] counts_per_unit is {counts!r}; write the positive number by which the values are "
            f"divided to get {unit or 'the unit'}"
        )
    sign: Any = settings.get("sign", 1)
    if sign not in (1, -1):
        raise RecordingError(
            f"{path}: [{name}] sign is {sign!r}; write 1, or -1 if a phone lying face up reads negative on z"
        )
    time_column = str(settings.get("time", time.get("column", "")))
    time_unit = str(settings.get("time_unit", time.get("unit", "s")))
    if time_unit not in (*TIME_UNITS, "date"):
        raise RecordingError(f"{path}: time unit is {time_unit!r}; write one of {', '.join(TIME_UNITS)}, date")
    if not time_column and "rate_hz" in time and not is_rate:
        raise RecordingError(f"{path}: [time] rate_hz is {time['rate_hz']!r}; write a number over 0.1 and below 1e6")
    if not time_column and not is_rate:
        raise RecordingError(f"{path}: [time] names no time; write column = ... or rate_hz = ...")
    names, biases = (tuple(map(str, cast("list[Any]", found))) for found in (columns, bias))
    return StreamMap(
        name, names, unit, sign, float(counts), biases, time_column, time_unit, str(settings.get("file", ""))
    )


def _quoted(text: str) -> str:
    r"""Return a text as a quoted TOML string.

    >>> print(_quoted('a"b'))
    "a\"b"
    """
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08X}" for c in escaped) + '"'
