"""Mapping of undescribed tables, guessed from the names of their columns, the app and the values.

Notes and evidence report each guess.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from pdr_filter.data.io.checks import constant_axis, is_of_phone, up_cosine
from pdr_filter.data.io.column_names import (
    ACCELERATION,
    ANGLES,
    FIELD,
    GRAVITY,
    LINEAR,
    PHONE_HEADING,
    PHONE_STEPS,
    RATE,
    ROTATION,
    SCALARS,
    TIME_UNITS,
    UNITS,
    column_of,
    period_of,
)
from pdr_filter.data.io.describe import median_norm
from pdr_filter.data.io.tables.app_dialects import Dialect
from pdr_filter.data.io.tables.column_groups import Group
from pdr_filter.data.io.tables.column_mapping import Mapping, StreamMap
from pdr_filter.data.io.tables.column_template import G_OF_GRAVITY, NOT_SHOWN, asked_mapping
from pdr_filter.data.io.tables.column_values import constant_part, time_unit_of_values, turning
from pdr_filter.data.io.tables.sheet import Sheet
from pdr_filter.data.io.tables.table_streams import is_new_position, quaternion_of
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, Samples, interpolated_rows, limits
from pdr_filter.values.errors import RecordingError

# Share of the constant part in the norm of an acceleration: gravity outweighs the motion of walking.
_GRAVITY_SHARE = 0.6
_LEAST_GRAVITY_MPS2, _MOST_GRAVITY_MPS2 = limits.SPECIFIC_FORCE_RANGE_MPS2
# A gyroscope in deg/s that is taken for one in rad/s makes gravity turn 57 times too little.
_DEGREES_BELOW = 0.13  # the geometric mean of 1 and pi/180
# An angular rate turns gravity as far as it says, in rad/s or deg/s, within this factor; where gravity hardly turns,
# its mean over two seconds is a small share of its norm. Of 107 recordings that takes 89, and of their phones'
# orientations, as quaternions, rotation vectors or Euler angles, none.
_TURNS_AS_SAID = (0.5, 2.0)
_RATE_SHARE = 0.25
# A name with a number and its unit, above a table.
_STATED = re.compile(r"([A-Za-z][A-Za-z _]{0,30}?) ?(?:[:=,;]|is) ?(\d{1,9}(?:\.\d{1,9})?) ?([A-Za-z]*)")
_NAMES = {
    **{"ut": "uT", "mt": "mT", "gauss": "G", "t": "T", "hpa": "hPa", "pa": "Pa", "kpa": "kPa", "lx": "lux", "i": "cm"},
    **{"m/s^2": "m/s2", "m/s/s": "m/s2", "\u00b0/s": "deg/s", "dps": "deg/s", "\u00b0": "deg"},
}
# Plausible range of the median of a quantity, and the units to try.
_BY_SIZE = {
    FIELD: (limits.MAGNETIC_FIELD_RANGE_UT, ("ut", "gauss", "mt", "t")),
    "barometer": (limits.PRESSURE_RANGE_HPA, ("hpa", "pa", "kpa")),
}


class NoAccelerometerError(RecordingError):
    """Error for tables without an acceleration that includes gravity."""


@dataclass
class Guess:
    """Guessed mapping of the columns, with the evidence for it."""

    mapping: Mapping
    evidence: list[str] = field(default_factory=list[str])
    notes: list[str] = field(default_factory=list[str])
    source: str = ""
    is_time_declared: bool = False  # unit of the accelerometer's times


@dataclass(frozen=True, slots=True, eq=False)
class _Stream:
    """Columns of one sensor, with their values."""

    group: Group
    sheet: Sheet
    time_unit: str
    time_s: FloatArray  # on the clock of the table
    values: FloatArray
    is_unit_declared: bool
    unit: str  # as in `UNITS`; empty if not known
    is_time_declared: bool
    constant: float  # `constant_part` of an acceleration or a rotation, else NaN

    @property
    def factor(self) -> float:
        return UNITS.get(self.group.quantity, {}).get(self.unit, 1.0)


def guess(
    sheets: Sequence[Sheet], groups: Sequence[Group], dialect: Dialect, platform: str | None, where: str
) -> Guess:
    """Return the guessed mapping of the columns of these tables.

    `dialect` is the app. `platform` ("ios" or "android") decides the sign of the acceleration if the app does
    not. `where` names the file in messages. RecordingError if there is no acceleration, if its unit is unknown, if it
    is in g with an unknown sign, or if a table has neither times nor a known rate.
    """
    result = Guess(Mapping(()), source=f"table of {dialect.app}" if dialect.app else "table")
    asked = partial(asked_mapping, sheets, groups, _file_of(where))
    rate_hz = _rate_of_rows(sheets, groups, dialect, where)
    streams = [_stream(group, sheets[group.sheet], dialect, rate_hz) for group in groups]
    # Times of slower sensors than the accelerometer do not show their unit.
    fast = (s for s in streams if s.group.quantity in (ACCELERATION, LINEAR, GRAVITY))
    fastest = next((s for s in fast if s.time_unit and len(s.time_s)), None)
    streams = [s if s is fastest else _in_time_unit_of(fastest, s) for s in streams]
    streams = [s if s.time_unit else replace(s, time_unit="s") for s in streams]
    streams = [s for s in streams if len(s.values)]
    counted = [s for s in streams if _is_counted(s)]
    streams = [s for s in streams if s not in counted]
    for s in counted:
        words = (
            f"{s.group.name} are counts of the sensor, or in an unknown unit: their constant part is {s.constant:.4g}, "
            "and gravity is 9.8 m/s2 or 1 g"
        )
        if not _show_gravity(streams):
            raise RecordingError(f"{where}: {words}; a mapping gives their scale. {asked()}")
        result.evidence.append(f"not used: {words}")
    forces = _forces(streams, dialect, result, where, asked)
    is_linear = len(forces) == 1 and not _has_gravity(forces[0])
    time_s, force = forces[0].time_s, _force(forces)
    if is_linear:  # without gravity nothing shows how the phone turns
        time_s, force = time_s[:0], force[:0]
    streams = [_as_rate(s, time_s, force) for s in streams]
    chosen = [*forces]
    result.is_time_declared = forces[0].is_time_declared
    for quantity in (RATE, FIELD, *SCALARS, "location", ANGLES, PHONE_HEADING, PHONE_STEPS):
        fitting = [s for s in streams if s.group.quantity == quantity]
        if fitting:
            near = max(
                fitting,
                key=lambda s: (_is_of_earth(s), s.group.preference, s.sheet is forces[0].sheet, len(s.values)),
            )
            if quantity == "location" and near.sheet is forces[0].sheet and _common_s(near, forces[0]) <= 0:
                # A clock that began elsewhere: what counts is when the rows of the table have another place.
                on_clock = replace(near.group, time=forces[0].group.time, time_unit=forces[0].time_unit)
                near = _stream(on_clock, near.sheet, dialect, rate_hz)
            near = _with_unit(near, force, time_s, result)
            if is_of_phone(quantity, near.time_s, near.factor * near.values, float(np.ptp(forces[0].time_s))):
                chosen.append(near)
            else:
                result.evidence[-1] += "; not used, because its values are not those of a phone"
    left_out = sorted({s.sheet.name for s in streams} - {s.sheet.name for s in chosen})
    if left_out:
        result.notes.append(f"left out: {', '.join(left_out)[:200]}")
    angles = next((s for s in chosen if s.group.quantity == ANGLES and not is_linear), None)
    cosine, of_other_pitch = (math.nan, math.nan) if angles is None else _up_cosines(angles, Samples(time_s, force))
    limit = limits.UP_COSINE_DOUBTFUL
    # Android's pitch has the opposite sign, and its acceleration is in m/s2; that of an iPhone is in g.
    is_either = min(cosine, of_other_pitch) < -limit and max(cosine, of_other_pitch) > limit
    is_either = is_either and forces[0].unit not in ("g", "mg")
    sign = _sign(dialect, platform, forces, math.nan if is_either else cosine, result, where)
    if is_either and sign * cosine < 0:
        chosen = [s for s in chosen if s is not angles]
        result.evidence.append("angles: not used, because pitch or acceleration has the opposite sign")
    for s in chosen:
        if bias := ", ".join(s.sheet.fields[p] for p in s.group.bias):
            result.evidence.append(f"{s.group.quantity}: its biases {bias} are subtracted")
    many = len(sheets) > 1
    result.mapping = Mapping(
        tuple(
            StreamMap(
                stream="accelerometer" if s in forces and not is_linear and len(forces) == 1 else s.group.quantity,
                columns=tuple(s.sheet.fields[p] if p >= 0 else "" for p in s.group.places),
                unit=_NAMES.get(s.unit, s.unit),
                sign=sign if s in forces else 1,
                bias=tuple(s.sheet.fields[p] for p in s.group.bias),
                time="" if s.group.time is None else s.sheet.fields[s.group.time],
                time_unit="date" if s.group.time in s.sheet.dates else s.time_unit,
                file=s.sheet.name if many else "",
            )
            for s in chosen
        ),
        rate_hz=rate_hz,
        where=where,
    )
    return result


def _rate_of_rows(sheets: Sequence[Sheet], groups: Sequence[Group], dialect: Dialect, where: str) -> float:
    """Return the sampling rate in Hz of tables without a column of times, or zero if all tables have one.

    It is in the lines above the first table, or usual for the app, else RecordingError.
    """
    if all(group.time is not None for group in groups):
        return 0.0
    first = sheets[groups[0].sheet]
    if period_ms := dialect.period_of(first.about):
        return 1000 / period_ms
    stated = (period_of(f"{name} ({unit})", float(number)) for name, number, unit in _STATED.findall(first.about))
    if rate_hz := first.rate_hz or next((1 / period_s for period_s in stated if period_s), 0.0):
        return rate_hz
    sheet = next(sheets[group.sheet] for group in groups if group.time is None)
    names = ", ".join(sheet.fields)[:200]
    app = f"this looks like {dialect.app}, but there is" if dialect.app else "there is"
    raise RecordingError(
        f"{sheet.where}: {app} no column of times (columns: {names}); export it with times, or give column or rate. "
        f"{asked_mapping(sheets, groups, _file_of(where))}"
    )


def _file_of(where: str) -> str:
    """Return the path of the file that messages call `where`."""
    return where.partition(": ")[0]


def _stream(group: Group, sheet: Sheet, dialect: Dialect, rate_hz: float) -> _Stream:
    """Return the values of a sensor at its times, in s if the unit of the times is known."""
    ticks, values = sheet.stream(group.places, group.time, group.bias)
    declared = group.unit or dialect.units.get(group.quantity, "")
    is_time_declared = bool(group.time is None or group.time_unit or group.time in sheet.dates)
    if group.time is None:
        unit, time_s = "s", ticks.astype(np.float64) / rate_hz
    else:
        unit = "ns" if group.time in sheet.dates else group.time_unit
        unit = unit or time_unit_of_values(ticks.astype(np.float64))
        time_s = ticks.astype(np.float64) * TIME_UNITS.get(unit, 1.0)
    known = np.isfinite(time_s)
    if group.quantity == "location":
        known &= is_new_position(values)
    if group.quantity == PHONE_HEADING and group.unit != "rad":
        known &= values[:, 0] != -1  # which iOS writes for unknown
    if not known.all():
        time_s, values = time_s[known], values[known]
    has_constant = group.quantity in (ACCELERATION, LINEAR, GRAVITY, ROTATION)
    constant = constant_part(time_s, values) if has_constant else math.nan
    return _Stream(group, sheet, unit, time_s, values, bool(declared), declared, is_time_declared, constant)


def _forces(
    streams: Sequence[_Stream], dialect: Dialect, result: Guess, where: str, asked: Callable[[], str]
) -> list[_Stream]:
    """Return the streams that give the specific force: the accelerometer, or linear acceleration and gravity.

    Without them it is the linear acceleration alone. RecordingError if there is none, or if its unit is unknown.
    """
    app = f"this looks like {dialect.app}, whose table" if dialect.app else "this table"
    found = [_with_force_unit(s) for s in streams if s.group.quantity in (ACCELERATION, LINEAR, GRAVITY)]
    if not found:
        others = ", ".join(sorted({s.group.quantity for s in streams})) or "none"
        used = {(s.sheet.name, p) for s in streams for p in (*s.group.places, s.group.time)}
        sheets = {s.sheet.name: s.sheet.fields for s in streams}
        left = [name for sheet, fields in sheets.items() for p, name in enumerate(fields) if (sheet, p) not in used]
        rest = [name for name in left if column_of(0, name).unit in ("", *UNITS[ACCELERATION])]
        is_there = ", ".join(rest)[:200]
        mapping = asked() if rest[2:] else ""
        is_shown = mapping and NOT_SHOWN not in mapping
        remedy = f", or if it is among {is_there}, give a mapping. {mapping}" if is_shown else ""
        raise NoAccelerometerError(
            f"{where}: {app} has no accelerometer (sensors seen: {others}); record it and export again{remedy}"
        )
    if all(math.isnan(s.constant) for s in found):
        raise RecordingError(
            f"{where}: no row has all values of {found[0].group.name}; export all three axes, in the same rows"
        )
    of = {q: [s for s in found if s.group.quantity == q] for q in (ACCELERATION, LINEAR, GRAVITY)}
    # The linear acceleration of ROS messages includes gravity.
    with_gravity = [s for s in (of[ACCELERATION] or of[LINEAR]) if s.unit and _has_gravity(s)]
    rates = [s for s in streams if s.group.quantity == RATE]
    if with_gravity:
        best = max(
            with_gravity,
            key=lambda s: (
                s.group.preference,
                max([_common_s(s, other) for other in rates], default=0.0),
                len(s.values),
            ),
        )
        result.evidence.append(_force_words(best))
        return [best]
    linear = [s for s in (*of[LINEAR], *of[ACCELERATION]) if not _has_gravity(s) or not s.unit]
    if of[GRAVITY] and linear:
        gravity = max(of[GRAVITY], key=lambda s: len(s.values))
        if not gravity.group.unit and G_OF_GRAVITY[0] <= gravity.constant <= G_OF_GRAVITY[1]:
            gravity = replace(gravity, unit="g")  # as from a watch, in an app that writes m/s2 of a phone
        best = max(linear, key=lambda s: (s.group.quantity == LINEAR, len(s.values)))
        if not best.group.unit:
            best = replace(best, unit=gravity.unit)
        best = replace(best, group=replace(best.group, quantity=LINEAR))
        result.evidence.append(
            f"accelerometer: {best.group.name} and {gravity.group.name} added; {_force_words(gravity)}"
        )
        return [best, gravity]
    if known := [s for s in linear if s.unit]:
        best = max(known, key=lambda s: (s.group.quantity == LINEAR, s.group.preference, len(s.values)))
        best = replace(best, group=replace(best.group, quantity=LINEAR))
        result.evidence.append(_force_words(best))
        return [best]
    seen = (linear or found)[0]
    app = f"this looks like {dialect.app or 'a table'}"
    instead = dialect.instead if dialect.app else "the accelerometer itself"
    if not linear and seen.group.quantity == GRAVITY:
        raise NoAccelerometerError(f"{where}: {app} of gravity alone ({seen.group.name}); export {instead} instead")
    still = f"{still}, " if (still := constant_axis(seen.values)) else ""
    raise NoAccelerometerError(
        f"{where}: {app}, whose acceleration ({seen.group.name}) lacks gravity: {still}the constant part of it is "
        f"{seen.constant:.2g}, and gravity is 9.8 m/s2 or 1 g; export {instead} instead"
    )


def _with_force_unit(s: _Stream) -> _Stream:
    """Return an acceleration with its unit, by its constant part if nothing states it. The unit may stay empty."""
    if s.is_unit_declared:
        return s
    constant = s.constant
    share = constant / max(median_norm(s.values), 1e-12)
    if G_OF_GRAVITY[0] <= constant <= G_OF_GRAVITY[1] and share > _GRAVITY_SHARE:
        return replace(s, unit="g")
    is_mps2 = constant >= _LEAST_GRAVITY_MPS2 or s.group.quantity == LINEAR
    return replace(s, unit="m/s2" if is_mps2 else "")


def _is_counted(s: _Stream) -> bool:
    """Return True for an acceleration that is larger than gravity in any unit that a table leaves out."""
    return s.group.quantity == ACCELERATION and not s.is_unit_declared and s.constant > _MOST_GRAVITY_MPS2


def _show_gravity(streams: Sequence[_Stream]) -> bool:
    """Return True if one of the streams is an acceleration with gravity, or linear acceleration and gravity are."""
    quantities = {s.group.quantity for s in streams}
    known = [_with_force_unit(s) for s in streams if s.group.quantity in (ACCELERATION, LINEAR)]
    return {LINEAR, GRAVITY} <= quantities or any(s.unit and _has_gravity(s) for s in known)


def _has_gravity(s: _Stream) -> bool:
    """Return True if an acceleration contains gravity.

    It is also True if the header states m/s2 for values in g, which the checks of every reader refuse later.
    """
    low, high = G_OF_GRAVITY
    if s.constant * s.factor >= _LEAST_GRAVITY_MPS2:
        return True
    is_near_1 = s.is_unit_declared and low <= s.constant <= high
    return is_near_1 and s.constant / max(median_norm(s.values), 1e-12) > 0.8


def _force_words(s: _Stream) -> str:
    said = "as its name says" if s.group.unit else "as the app writes" if s.is_unit_declared else "by its size"
    return (
        f"{s.group.quantity}: {s.group.name}, {_NAMES.get(s.unit, s.unit)} {said}; its constant part is "
        f"{s.constant * s.factor / STANDARD_GRAVITY_MPS2:.3f} of gravity"
    )


def _with_unit(s: _Stream, force: FloatArray, time_s: FloatArray, result: Guess) -> _Stream:
    """Return the stream of a sensor other than the accelerometer with its unit, guessed if nothing states it.

    `force` and `time_s` are the specific force in m/s2 and its times. `result` gets evidence: for a gyroscope, how far
    gravity turns compared with what it predicts.
    """
    quantity, name = s.group.quantity, s.group.name
    if quantity == RATE:
        factor = turning(time_s, force, s.time_s, s.values * (s.factor if s.unit else 1.0))
        turns = (
            "gravity hardly turns, so that it cannot be checked"
            if factor is None
            else f"the direction of gravity turns {factor:.2f} times as far as this sensor measures (1 is right)"
        )
        if not s.unit:
            is_deg = median_norm(s.values) > limits.MAX_MEDIAN_ANGULAR_RATE_RADPS
            is_deg = is_deg or (factor is not None and 0 < factor < _DEGREES_BELOW)
            s = replace(s, unit="deg/s" if is_deg else "rad/s")
        result.evidence.append(f"gyroscope: {name}, {_NAMES.get(s.unit, s.unit)}; {turns}")
        return s
    if not s.unit and quantity in _BY_SIZE:
        (low, high), units = _BY_SIZE[quantity]
        norm = median_norm(s.values)
        fits = [unit for unit in units if low <= norm * UNITS[quantity][unit] <= high]
        s = replace(s, unit=fits[0] if fits else units[0])
    elif not s.unit and quantity == PHONE_HEADING:
        s = replace(s, unit="rad" if np.abs(s.values).max() <= 2 * math.pi else "deg")
    elif not s.unit:
        s = replace(s, unit={"light": "lux", "proximity": "cm", ANGLES: "rad", PHONE_STEPS: "steps"}.get(quantity, ""))
    result.evidence.append(f"{quantity}: {name}, {_NAMES.get(s.unit, s.unit) or 'degrees and metres'}")
    return s


def _as_rate(s: _Stream, time_s: FloatArray, force: FloatArray) -> _Stream:
    """Return a stream called rotation as a gyroscope stream if it holds an angular rate, others unchanged.

    Gravity then turns as far as it predicts. Where gravity hardly turns or is unknown (no rows of `force`), the
    constant part of an angular rate is small. Other rotations are orientations, which are not used.
    """
    if s.group.quantity != ROTATION:
        return s
    factor = turning(time_s, force, s.time_s, s.values)
    if factor is None:
        is_rate = s.constant < _RATE_SHARE * median_norm(s.values)
    else:
        low, high = _TURNS_AS_SAID
        is_rate = any(low < factor / unit < high for unit in UNITS[RATE].values())
    return replace(s, group=replace(s.group, quantity=RATE, preference=0)) if is_rate else s


def _force(forces: Sequence[_Stream]) -> FloatArray:
    """Return the sum of accelerations (N, 3) in m/s2, such as linear one and gravity, at the times of the first."""
    at_s = forces[0].time_s
    total = np.zeros_like(forces[0].values)
    for s in forces:
        is_same = np.array_equal(s.time_s, at_s)
        total += s.factor * (s.values if is_same else interpolated_rows(at_s, s.time_s, s.values))
    return total


def _is_of_earth(s: _Stream) -> bool:
    """Return False for a magnetic field that is not as strong as the Earth's, such as with a magnet in the phone."""
    low, high = limits.MAGNETIC_FIELD_RANGE_UT
    return s.group.quantity != FIELD or low <= median_norm(s.values) * s.factor <= high


def _up_cosines(angles: _Stream, force: Samples) -> list[float]:
    """Return the mean cosine between the acceleration and up in the attitude, with the pitch as it is and negated."""
    pitches = (np.array([1.0, sign, 1.0]) for sign in (1.0, -1.0))
    attitudes = (quaternion_of(*(angles.values * angles.factor * pitch).T) for pitch in pitches)
    return [up_cosine(force, Samples(angles.time_s, attitude)) for attitude in attitudes]


def _sign(
    dialect: Dialect, platform: str | None, forces: Sequence[_Stream], cosine: float, result: Guess, where: str
) -> int:
    """Return the factor 1 or -1 that gives acceleration and gravity Android's sign, by app, platform or attitude.

    `cosine` is that between the acceleration and up in the phone's own attitude, NaN if unknown. Without all three the
    factor is 1, with a note. RecordingError if both app and platform decide, or if values in g have an unknown sign.
    """
    if dialect.sign is not None:
        if platform is not None:
            raise RecordingError(
                f"{where}: {dialect.app} writes the same sign whatever the platform is; leave platform out"
            )
        result.evidence.append(f"sign: {'Android' if dialect.sign > 0 else 'Apple'}'s, as {dialect.app} writes it")
        return dialect.sign
    if platform is not None:
        result.evidence.append(f"sign: that of {platform}, as given or as the metadata say")
        return -1 if platform == "ios" else 1
    if abs(cosine) > limits.UP_COSINE_DOUBTFUL:
        result.evidence.append(f"sign: {'Android' if cosine > 0 else 'Apple'}'s, as the phone's attitude shows")
        return 1 if cosine > 0 else -1
    if dialect.units.get(GRAVITY) == "m/s2" and len(forces) > 1 and forces[1].unit == "g":
        result.evidence.append("sign: Apple's, whose gravity is in g; that of Android is in m/s2")
        return -1
    if not dialect.app and forces[0].unit in ("g", "mg"):
        raise RecordingError(
            f"{where}: acceleration in g, and nothing shows its sign, which is Apple's or Android's: a phone lying "
            "face up reads -1 or +1 on z; say it with pdr-filter convert FILE --platform ios, or --platform android, "
            'and in Python with pdr.read(path, platform="ios")'
        )
    result.notes.append(
        "accelerometer: nothing in the file shows its sign, so Android's is taken; if a phone lying face up reads "
        "negative on z, turns come out mirrored: then convert the file with --platform ios"
    )
    return 1


def _in_time_unit_of(other: _Stream | None, s: _Stream) -> _Stream:
    """Return a stream in the unit of time of another one if its times then agree better, unless its name states one."""
    if other is None or s.is_time_declared or not len(s.time_s):
        return s
    factor = TIME_UNITS[other.time_unit] / TIME_UNITS.get(s.time_unit, 1.0)
    same = replace(s, time_unit=other.time_unit, time_s=s.time_s * factor)
    return max(s, same, key=lambda each: (bool(each.time_unit), _share_of_common_time(each, other)))


def _share_of_common_time(a: _Stream, b: _Stream) -> float:
    """Return the time in which both streams have samples as a fraction of the time from the first to the last one."""
    both_s = np.concatenate([a.time_s, b.time_s])
    return _common_s(a, b) / max(float(np.ptp(both_s)), 1e-9)


def _common_s(s: _Stream, other: _Stream) -> float:
    """Return how long two streams overlap in time, in whole seconds, negative for a gap between them."""
    return round(min(s.time_s.max(), other.time_s.max()) - max(s.time_s.min(), other.time_s.min()))
