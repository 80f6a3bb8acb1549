"""The columns of tables as streams: parsed once, made into one time base, units and signs as a mapping says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from pdr_filter.io.assemble import Parsed
from pdr_filter.io.columns import ANGLES, GRAVITY, LINEAR, TIME_UNITS, nanoseconds_of
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.mapping import Mapping, StreamMap
from pdr_filter.io.sheets import Sheet
from pdr_filter.io.table import NumberTable
from pdr_filter.values import BoolArray, FloatArray, IntArray

# Gravity is interpolated to the times of the accelerometer; within this it turns by less than a step's swing.
GRAVITY_GAP_S = 0.3


@dataclass
class SheetData:
    """A sheet with the columns of it that are used; each is parsed once for each column of exact times."""

    sheet: Sheet
    places: tuple[int, ...]
    notes: list[str]
    _parsed: dict[int | None, NumberTable] = field(default_factory=dict[int | None, NumberTable])

    def __post_init__(self) -> None:
        beside = {nanoseconds_of(self.sheet.fields, place) for place in self.places}
        self.places = tuple(sorted({*self.places, *(place for place in beside if place is not None)}))

    def ticks(self, time: int) -> IntArray | FloatArray:
        """A column of times, with the nanoseconds in the one beside it: whole numbers if only these hold it."""
        if (nanoseconds := nanoseconds_of(self.sheet.fields, time)) is not None:
            return self.values((time, nanoseconds), time) @ [1.0, 1e-9]
        exact = self._exact(time)
        return self._rows(exact).whole if exact is not None else self.values((time,), time)[:, 0]

    def values(self, places: Sequence[int], time: int | None) -> FloatArray:
        """Columns, shape (N, d), of the rows that have this time; NaN for a place that is not there (-1)."""
        table = self._rows(self._exact(time))
        unknown = np.full(len(table), np.nan)
        at = [unknown if p < 0 else table.values[:, self.places.index(p)] for p in places]
        return np.column_stack(at) if at else np.empty((len(table), 0))

    def _exact(self, time: int | None) -> int | None:
        is_exact = time is not None and (time in self.sheet.dates or time in self.sheet.exact)
        return time if is_exact else None

    def _rows(self, exact: int | None) -> NumberTable:
        if exact not in self._parsed:
            numbers = [p for p in self.places if p not in self.sheet.dates]
            found = self.sheet.table(numbers, exact, self.notes)
            values = np.full((len(found), len(self.places)), np.nan)
            for i, p in enumerate(self.places):
                if p in numbers:
                    values[:, i] = found.values[:, numbers.index(p)]
            self._parsed[exact] = NumberTable(found.whole, values)
        return self._parsed[exact]


def fill(parsed: Parsed, mapping: Mapping, data: Sequence[SheetData]) -> None:
    """Put the streams of a mapping into what becomes the recording."""
    found: dict[str, tuple[IntArray | FloatArray, float, FloatArray]] = {}
    for stream in mapping.streams:
        at = _sheet_of(stream, mapping, data)
        time = _place(stream.time, at.sheet, mapping) if stream.time else None
        places = [_place(name, at.sheet, mapping) if name else -1 for name in stream.columns]
        values = at.values(places, time) * stream.factor
        unit_s = TIME_UNITS.get(stream.time_unit, 1e-9)
        if time is None:
            ticks, unit_s = np.arange(len(values)), 1 / mapping.rate_hz
        else:
            ticks = at.ticks(time)
        known = ~np.isnan(values).all(axis=1)  # sensors of different rates in one table leave fields empty
        if stream.stream == "location":
            known &= is_new_place(values)
            values[values[:, 3] < 0, 3] = np.nan  # apps write -1 for unknown
        found[stream.stream] = (ticks[known], unit_s, values[known])
    if GRAVITY in found and LINEAR in found and "accelerometer" not in found:
        found["accelerometer"] = _summed(found[LINEAR], found[GRAVITY])
    if ANGLES in found:
        ticks, unit_s, angles = found.pop(ANGLES)
        found["attitude"] = ticks, unit_s, quaternion_of(*angles.T)
    first = found.get("accelerometer", (np.empty(0), 1.0, np.empty(0)))
    whole = [ticks for ticks, _, _ in found.values() if ticks.dtype.kind == "i"]
    # Whole numbers need all their digits: made relative before they become seconds.
    zero, zero_unit_s = (0, 1.0) if not whole or not len(first[0]) else (first[0][0].item(), first[1])
    for name, (ticks, unit_s, values) in found.items():
        if name not in (GRAVITY, LINEAR):
            parsed.streams[name] = (_seconds(ticks, unit_s, zero, zero_unit_s), values)
    if whole and len(first[0]) and first[0].dtype.kind == "i" and first[0][0] * first[1] > 1e9:
        parsed.meta["epoch_s"] = float(first[0][0]) * first[1]


def quaternion_of(roll_rad: FloatArray, pitch_rad: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Quaternions wxyz, sensor to world with z up, of CoreMotion's angles: R = Rz(yaw) Rx(pitch) Ry(roll)."""
    with np.errstate(invalid="ignore"):
        (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a / 2), np.sin(a / 2)) for a in (roll_rad, pitch_rad, yaw_rad))
    # q_z(yaw) q_x(pitch) = (cy cp, cy sp, sy sp, sy cp); times q_y(roll) = (cr, 0, sr, 0)
    w, x, y, z = cy * cp, cy * sp, sy * sp, sy * cp
    return np.column_stack([w * cr - y * sr, x * cr - z * sr, y * cr + w * sr, z * cr + x * sr])


def is_new_place(values: FloatArray) -> BoolArray:
    """Where a location is another than in the row before: tables with a row for each sample repeat it; 0, 0 is none."""
    changes = np.ones(len(values), dtype=bool)
    changes[1:] = (values[1:, :2] != values[:-1, :2]).any(axis=1)
    return changes & ~np.isnan(values[:, :2]).any(axis=1) & (values[:, :2] != 0).any(axis=1)


def interpolated(
    time_s: FloatArray, known_s: FloatArray, values: FloatArray, gap_s: float = GRAVITY_GAP_S
) -> FloatArray:
    """Values interpolated linearly, NaN where there is none within the gap."""
    result = np.full((len(time_s), values.shape[1]), np.nan)
    if len(known_s) == 0 or len(time_s) == 0:
        return result
    order = np.argsort(known_s, kind="stable")
    known_s = known_s[order]
    for i in range(result.shape[1]):
        result[:, i] = np.interp(time_s, known_s, values[order, i])
    right = np.clip(np.searchsorted(known_s, time_s), 0, len(known_s) - 1)
    left = np.maximum(right - 1, 0)
    far = np.minimum(np.abs(known_s[right] - time_s), np.abs(known_s[left] - time_s)) > gap_s
    result[far] = np.nan
    return result


def _summed(
    linear: tuple[IntArray | FloatArray, float, FloatArray], gravity: tuple[IntArray | FloatArray, float, FloatArray]
) -> tuple[IntArray | FloatArray, float, FloatArray]:
    """Linear acceleration and gravity, which may have other times."""
    zero = linear[0][0].item() if len(linear[0]) else 0
    at_s = _seconds(linear[0], linear[1], zero, linear[1])
    known_s = _seconds(gravity[0], gravity[1], zero, linear[1])
    known = ~np.isnan(known_s)
    return linear[0], linear[1], linear[2] + interpolated(at_s, known_s[known], gravity[2][known])


def _seconds(ticks: IntArray | FloatArray, unit_s: float, zero: float, zero_unit_s: float) -> FloatArray:
    """Times in s from a time that is an int if it is that of whole numbers."""
    if unit_s == zero_unit_s or zero == 0:
        return np.asarray(ticks - zero, dtype=np.float64) * unit_s
    return ticks.astype(np.float64) * unit_s - float(zero) * zero_unit_s


def _sheet_of(stream: StreamMap, mapping: Mapping, data: Sequence[SheetData]) -> SheetData:
    if not stream.file:
        if len(data) == 1:
            return data[0]
        fitting = [d for d in data if set(stream.columns) - {""} <= set(d.sheet.fields)]
    else:
        fitting = [d for d in data if d.sheet.name == stream.file]
    if len(fitting) != 1:
        names = ", ".join(d.sheet.name for d in data[:10])
        raise RecordingError(
            f"{mapping.where}: [{stream.stream}] file = {stream.file!r} fits {len(fitting)} tables; there are {names}"
        )
    return fitting[0]


def _place(name: str, sheet: Sheet, mapping: Mapping) -> int:
    if (n := sheet.fields.count(name)) != 1:
        raise RecordingError(
            f"{mapping.where}: column {name!r} is in the table {n} times; "
            f"columns seen: {', '.join(sheet.fields)[:300] or 'none'}"
        )
    return sheet.fields.index(name)
