"""Mapping from columns of a table to streams, read from a TOML file or guessed, and written as one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from pdr_filter.data.io.column_names import ACCELERATION, ANGLES, GRAVITY, LINEAR, TIME_UNITS, UNITS, normal_unit
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
}


@dataclass(frozen=True, slots=True)
class StreamMap:
    """Columns, unit and sign of one stream."""

    stream: str  # one of `STREAMS`
    columns: tuple[str, ...]  # an empty name is a value that is not known
    unit: str
    sign: int = 1
    time: str = ""  # column; empty if rows come at a fixed rate
    time_unit: str = "s"
    file: str = ""  # name without suffix, of one of several tables

    @property
    def factor(self) -> float:
        """Factor from the unit and sign of the column to the unit and sign in `Recording`."""
        quantity = ACCELERATION if self.stream == "accelerometer" else self.stream
        return UNITS.get(quantity, {}).get(normal_unit(self.unit), 1.0) * self.sign


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
        lines: list[str] = []
        if self.separator or self.decimal:
            given = {"separator": self.separator, "decimal": self.decimal}
            lines += ["[file]", *(f"{key} = {_quoted(value)}" for key, value in given.items() if value)]
        if self.rate_hz:
            lines += ["[time]", f"rate_hz = {self.rate_hz:g}"]
        for stream in self.streams:
            lines += [f"[{stream.stream}]"]
            if stream.file:
                lines += [f"file = {_quoted(stream.file)}"]
            lines += [f"columns = [{', '.join(map(_quoted, stream.columns))}]"]
            lines += [f"unit = {_quoted(stream.unit)}"] if stream.unit else []
            lines += [f"sign = {stream.sign}"] if stream.stream in _SIGNED or stream.sign != 1 else []
            if stream.time:
                lines += [f"time = {_quoted(stream.time)}", f"time_unit = {_quoted(stream.time_unit)}"]
        return "\n".join(lines) + "\n"


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
    known = {"columns", "unit", "sign", "time", "time_unit", "file"}
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
    if not isinstance(columns, list) or len(cast("list[Any]", columns)) != n:
        raise RecordingError(f"{path}: [{name}] columns is {columns!r}; write {n} names, as in columns = [...]")
    unit = str(settings.get("unit", units[0]))
    if unit not in units:
        remedy = f"write one of {', '.join(filter(None, units))}" if any(units) else "leave it out"
        raise RecordingError(f"{path}: [{name}] unit is {unit!r}; {remedy}")
    sign: Any = settings.get("sign", 1)
    if sign not in (1, -1):
        raise RecordingError(f"{path}: [{name}] sign is {sign!r}; write 1 or -1")
    time_column = str(settings.get("time", time.get("column", "")))
    time_unit = str(settings.get("time_unit", time.get("unit", "s")))
    if time_unit not in (*TIME_UNITS, "date"):
        raise RecordingError(f"{path}: time unit is {time_unit!r}; write one of {', '.join(TIME_UNITS)}, date")
    if not time_column and "rate_hz" in time and not is_rate:
        raise RecordingError(f"{path}: [time] rate_hz is {time['rate_hz']!r}; write a number over 0.1 and below 1e6")
    if not time_column and not is_rate:
        raise RecordingError(f"{path}: [time] names no time; write column = ... or rate_hz = ...")
    names = tuple(str(column) for column in cast("list[Any]", columns))
    return StreamMap(name, names, unit, sign, time_column, time_unit, str(settings.get("file", "")))


def _quoted(text: str) -> str:
    r"""Return a text as a quoted TOML string.

    >>> print(_quoted('a"b'))
    "a\"b"
    """
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08X}" for c in escaped) + '"'
