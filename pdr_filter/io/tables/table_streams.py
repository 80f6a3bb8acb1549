"""The columns of tables as streams: parsed once, made into one time base, units and signs as a mapping says."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdr_filter.io.assemble import Parsed
from pdr_filter.io.files.errors import RecordingError
from pdr_filter.io.tables.column_mapping import Mapping, StreamMap
from pdr_filter.io.tables.column_names import ANGLES, GRAVITY, LINEAR, TIME_UNITS
from pdr_filter.io.tables.sheet import Sheet
from pdr_filter.values import BoolArray, FloatArray, IntArray, interpolated_near, limits


def fill(parsed: Parsed, mapping: Mapping, sheets: Sequence[Sheet]) -> None:
    """Fill `parsed` with the streams of a mapping and with the properties of their times."""
    times = sorted(
        {f"{stream.time.removeprefix('column ')} ({stream.time_unit})" for stream in mapping.streams if stream.time}
    )
    parsed.clock = f"column {', '.join(times)}" if times else f"no time column: rows at {mapping.rate_hz:g} Hz"
    parsed.is_clock = any(stream.time_unit == "date" for stream in mapping.streams)
    parsed.rate_hz = mapping.rate_hz if times else 0.0
    if mapping.rate_hz and not times:
        parsed.requested_hz = {"accelerometer": mapping.rate_hz}
    found: dict[str, tuple[IntArray | FloatArray, float, FloatArray]] = {}
    for stream in mapping.streams:
        sheet = _sheet_of(stream, mapping, sheets)
        time = _place(stream.time, sheet, mapping) if stream.time else None
        places = [_place(name, sheet, mapping) if name else -1 for name in stream.columns]
        ticks, values = sheet.stream(places, time)
        if stream.stream == "location":
            is_new = is_new_place(values)
            ticks, values = ticks[is_new], values[is_new]
            values[values[:, 3] < 0, 3] = np.nan  # apps write -1 for unknown
        unit_s = 1 / mapping.rate_hz if time is None else TIME_UNITS.get(stream.time_unit, 1e-9)
        found[stream.stream] = (ticks, unit_s, values * stream.factor)
    if GRAVITY in found and LINEAR in found and "accelerometer" not in found:
        found["accelerometer"] = _summed(found[LINEAR], found[GRAVITY])
    elif LINEAR in found and "accelerometer" not in found:
        found["accelerometer"] = found[LINEAR]
        parsed.linear = ", ".join(name for s in mapping.streams if s.stream == LINEAR for name in s.columns)
    if ANGLES in found:
        ticks, unit_s, angles = found.pop(ANGLES)
        found["attitude"] = ticks, unit_s, quaternion_of(*angles.T)
    first = found.get("accelerometer", (np.empty(0), 1.0, np.empty(0)))
    whole = [ticks for ticks, _, _ in found.values() if ticks.dtype.kind == "i"]
    # Differences of whole numbers keep all digits, so they are taken before the conversion to seconds.
    zero, zero_unit_s = (0, 1.0) if not whole or not len(first[0]) else (first[0][0].item(), first[1])
    for name, (ticks, unit_s, values) in found.items():
        if name not in (GRAVITY, LINEAR):
            parsed.streams[name] = (_seconds(ticks, unit_s, zero, zero_unit_s), values)
    if whole and len(first[0]) and first[0].dtype.kind == "i" and first[0][0] * first[1] > 1e9:
        parsed.meta["epoch_s"] = float(first[0][0]) * first[1]


def quaternion_of(roll_rad: FloatArray, pitch_rad: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Return quaternions (w, x, y, z), from sensor to world with z up, from the angles of CoreMotion.

    The rotation matrix is R = Rz(yaw) Rx(pitch) Ry(roll).
    """
    with np.errstate(invalid="ignore"):
        (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a / 2), np.sin(a / 2)) for a in (roll_rad, pitch_rad, yaw_rad))
    # q_z(yaw) q_x(pitch) = (cy cp, cy sp, sy sp, sy cp); times q_y(roll) = (cr, 0, sr, 0)
    w, x, y, z = cy * cp, cy * sp, sy * sp, sy * cp
    return np.column_stack([w * cr - y * sr, x * cr - z * sr, y * cr + w * sr, z * cr + x * sr])


def is_new_place(values: FloatArray) -> BoolArray:
    """Return True for rows with a new location.

    Tables with a row for each sample repeat locations. Latitude 0 with longitude 0 is not a location.
    """
    changes = np.ones(len(values), dtype=bool)
    changes[1:] = (values[1:, :2] != values[:-1, :2]).any(axis=1)
    return changes & ~np.isnan(values[:, :2]).any(axis=1) & (values[:, :2] != 0).any(axis=1)


def _summed(
    linear: tuple[IntArray | FloatArray, float, FloatArray], gravity: tuple[IntArray | FloatArray, float, FloatArray]
) -> tuple[IntArray | FloatArray, float, FloatArray]:
    """Return the sum of linear acceleration and gravity, which may have different times."""
    zero = linear[0][0].item() if len(linear[0]) else 0
    at_s = _seconds(linear[0], linear[1], zero, linear[1])
    known_s = _seconds(gravity[0], gravity[1], zero, linear[1])
    if np.array_equal(at_s, known_s):
        return linear[0], linear[1], linear[2] + gravity[2]
    known = ~np.isnan(known_s)
    gravity_there = interpolated_near(at_s, known_s[known], gravity[2][known], limits.GRAVITY_GAP_S)
    return linear[0], linear[1], linear[2] + gravity_there


def _seconds(ticks: IntArray | FloatArray, unit_s: float, zero: float, zero_unit_s: float) -> FloatArray:
    """Return times in s since `zero` from ticks of `unit_s` seconds.

    `zero` is in ticks of `zero_unit_s` seconds. Integer ticks keep their full precision.
    """
    if unit_s == zero_unit_s or zero == 0:
        return np.asarray(ticks - zero, dtype=np.float64) * unit_s
    return ticks.astype(np.float64) * unit_s - float(zero) * zero_unit_s


def _sheet_of(stream: StreamMap, mapping: Mapping, sheets: Sequence[Sheet]) -> Sheet:
    if not stream.file:
        if len(sheets) == 1:
            return sheets[0]
        fitting = [s for s in sheets if set(stream.columns) - {""} <= set(s.fields)]
    else:
        fitting = [s for s in sheets if s.name == stream.file]
    if len(fitting) != 1:
        names = ", ".join(s.name for s in sheets[:10])
        raise RecordingError(
            f"{mapping.where}: [{stream.stream}] file = {stream.file!r} fits {len(fitting)} tables; name one of {names}"
        )
    return fitting[0]


def _place(name: str, sheet: Sheet, mapping: Mapping) -> int:
    if (n := sheet.fields.count(name)) != 1:
        raise RecordingError(
            f"{mapping.where}: column {name!r} is in the table {n} times (columns: "
            f"{', '.join(sheet.fields)[:300] or 'none'}); name one that is there once"
        )
    return sheet.fields.index(name)
