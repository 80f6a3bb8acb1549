"""Streams from the columns of tables, on one time base, with the units and signs that a mapping states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pdr_filter.data.io.assemble import Parsed
from pdr_filter.data.io.column_names import ANGLES, GRAVITY, LINEAR, PHONE_HEADING, TIME_UNITS, since_1970
from pdr_filter.data.io.tables.column_mapping import Mapping, StreamMap
from pdr_filter.data.io.tables.sheet import Sheet
from pdr_filter.values import BoolArray, FloatArray, IntArray, interpolated_near, limits
from pdr_filter.values.errors import RecordingError


@dataclass(frozen=True, slots=True, eq=False)
class _MappedStream:
    """Values (N, d) of a stream at times (N,) in ticks of `unit_s` seconds. Integer ticks keep all digits."""

    ticks: IntArray | FloatArray
    unit_s: float
    values: FloatArray


class Zero(NamedTuple):
    """Origin of the times in s: a tick of `unit_s` seconds."""

    tick: float = 0
    unit_s: float = 1.0


def fill_streams(parsed: Parsed, mapping: Mapping, sheets: Sequence[Sheet], zero: Zero | None = None) -> Zero:
    """Fill `parsed` with the streams of a mapping, read from the tables, and return the origin of their times.

    By default it is the first time of the accelerometer, if a time is a whole number. `parsed` also gets the properties
    of the times, and in `parsed.linear` the columns of an acceleration without gravity. RecordingError unless each
    column is there once.
    """
    _describe_clock(parsed, mapping)
    found = {stream.stream: _read(stream, mapping, sheets) for stream in mapping.streams}
    streams = _combined(found)
    first = streams.get("accelerometer")
    if zero is None:
        is_whole = first is not None and len(first.ticks) and any(map(_has_whole_ticks, found.values()))
        zero = Zero(first.ticks[0].item(), first.unit_s) if first is not None and is_whole else Zero()
    if first is not None and len(first.ticks):
        unit = next((unit for unit, unit_s in TIME_UNITS.items() if unit_s == first.unit_s), "")
        epoch_s = since_1970(float(first.ticks[0]), unit) if unit else None
        if epoch_s is not None:
            parsed.meta["epoch_s"] = epoch_s
    for name, stream in streams.items():
        parsed.streams[name] = (_seconds(stream, zero), stream.values)
    if first is not None and first is found.get(LINEAR):
        parsed.linear = ", ".join(name for s in mapping.streams if s.stream == LINEAR for name in s.columns)
    return zero


def _describe_clock(parsed: Parsed, mapping: Mapping) -> None:
    """Describe the clock in `parsed`: the columns of times with their units, or the rate of the rows."""
    times = sorted({_name_of_time(stream) for stream in mapping.streams if stream.time})
    parsed.clock = ", ".join(times) if times else f"no time column: rows at {mapping.rate_hz:g} Hz"
    parsed.is_clock = any(stream.time_unit == "date" for stream in mapping.streams)
    parsed.rate_hz = mapping.rate_hz if times else 0.0
    if mapping.rate_hz and not times:
        parsed.requested_hz = {"accelerometer": mapping.rate_hz}


def _name_of_time(stream: StreamMap) -> str:
    unit = "dates" if stream.time_unit == "date" else f"in {stream.time_unit}"
    return f"column '{stream.time.removeprefix('column ')}', {unit}"


def _read(stream: StreamMap, mapping: Mapping, sheets: Sequence[Sheet]) -> _MappedStream:
    """Return a stream of a mapping in the units and with the signs of `Recording`, without repeated locations."""
    sheet = sheet_of(stream, mapping, sheets)
    time = _place(stream.time, sheet, mapping) if stream.time else None
    places, bias = (
        [_place(name, sheet, mapping) if name else -1 for name in names] for names in (stream.columns, stream.bias)
    )
    ticks, values = sheet.stream(places, time, bias)
    if stream.stream == "location":
        is_new = is_new_position(values)
        ticks, values = ticks[is_new], values[is_new]
        values[values[:, 3] < 0, 3] = np.nan  # apps write -1 for unknown
    if stream.stream == PHONE_HEADING and stream.unit == "deg":
        is_known = values[:, 0] != -1  # which iOS writes for unknown
        ticks, values = ticks[is_known], values[is_known]
    unit_s = 1 / mapping.rate_hz if time is None else TIME_UNITS.get(stream.time_unit, 1e-9)
    return _MappedStream(ticks, unit_s, values * stream.factor)


def _combined(found: dict[str, _MappedStream]) -> dict[str, _MappedStream]:
    """Return the streams of a recording, with the angles as quaternions of the stream "attitude".

    A missing accelerometer is the sum of linear acceleration and gravity, or the former if there is no gravity.
    """
    streams = {name: stream for name, stream in found.items() if name not in (GRAVITY, LINEAR, ANGLES)}
    if GRAVITY in found and LINEAR in found and "accelerometer" not in found:
        streams["accelerometer"] = _summed(found[LINEAR], found[GRAVITY])
    elif LINEAR in found and "accelerometer" not in found:
        streams["accelerometer"] = found[LINEAR]
    if ANGLES in found:
        streams["attitude"] = replace(found[ANGLES], values=quaternion_of(*found[ANGLES].values.T))
    return streams


def _has_whole_ticks(stream: _MappedStream) -> bool:
    return stream.ticks.dtype.kind == "i"


def quaternion_of(roll_rad: FloatArray, pitch_rad: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Return quaternions (w, x, y, z), sensor to world, of CoreMotion's angles: R = Rz(yaw) Rx(pitch) Ry(roll)."""
    with np.errstate(invalid="ignore"):
        (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a / 2), np.sin(a / 2)) for a in (roll_rad, pitch_rad, yaw_rad))
    # q_z(yaw) q_x(pitch) = (cy cp, cy sp, sy sp, sy cp); times q_y(roll) = (cr, 0, sr, 0)
    w, x, y, z = cy * cp, cy * sp, sy * sp, sy * cp
    return np.column_stack([w * cr - y * sr, x * cr - z * sr, y * cr + w * sr, z * cr + x * sr])


def is_new_position(values: FloatArray) -> BoolArray:
    """Return a mask of the rows whose location is known, is not (0, 0), and differs from that of the row before."""
    changes = np.ones(len(values), dtype=bool)
    changes[1:] = (values[1:, :2] != values[:-1, :2]).any(axis=1)
    return changes & ~np.isnan(values[:, :2]).any(axis=1) & (values[:, :2] != 0).any(axis=1)


def _summed(linear: _MappedStream, gravity: _MappedStream) -> _MappedStream:
    """Return linear acceleration plus gravity, interpolated if its times differ, and NaN in its gaps."""
    zero = Zero(linear.ticks[0].item() if len(linear.ticks) else 0, linear.unit_s)
    at_s, known_s = _seconds(linear, zero), _seconds(gravity, zero)
    if np.array_equal(at_s, known_s):
        return replace(linear, values=linear.values + gravity.values)
    known = ~np.isnan(known_s)
    at_linear = interpolated_near(at_s, known_s[known], gravity.values[known], limits.GRAVITY_GAP_S)
    return replace(linear, values=linear.values + at_linear)


def _seconds(stream: _MappedStream, zero: Zero) -> FloatArray:
    """Return the times of a stream since `zero`, in s. Differences of whole numbers come first, to keep all digits."""
    if stream.unit_s == zero.unit_s or zero.tick == 0:
        return np.asarray(stream.ticks - zero.tick, dtype=np.float64) * stream.unit_s
    return stream.ticks.astype(np.float64) * stream.unit_s - float(zero.tick) * zero.unit_s


def sheet_of(stream: StreamMap, mapping: Mapping, sheets: Sequence[Sheet]) -> Sheet:
    """Return the table of a stream. RecordingError unless one table fits."""
    if not stream.file:
        if len(sheets) == 1:
            return sheets[0]
        fitting = [s for s in sheets if set(stream.columns) - {""} <= set(s.fields)]
    else:
        fitting = [s for s in sheets if s.name == stream.file]
    if len(fitting) != 1:
        names = ", ".join(s.name for s in sheets[:10])
        what, remedy = f"file = {stream.file!r} fits", "write"
        if not stream.file:
            what, remedy = f"columns {', '.join(stream.columns)[:100]} are in", "correct them, or write"
        raise RecordingError(
            f"{mapping.where}: [{stream.stream}] {what} {len(fitting)} tables; {remedy} file = one of {names}"
        )
    return fitting[0]


def _place(name: str, sheet: Sheet, mapping: Mapping) -> int:
    if (n := sheet.fields.count(name)) != 1:
        raise RecordingError(
            f"{mapping.where}: column {name!r} is in the table {n} times (columns: "
            f"{', '.join(sheet.fields)[:300] or 'none'}); name one that is there once"
        )
    return sheet.fields.index(name)
