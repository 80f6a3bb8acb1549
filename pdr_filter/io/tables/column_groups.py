"""Columns of tables that belong together: the axes of a sensor, a location, with the column of their times."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from pdr_filter.io.files.errors import RecordingError
from pdr_filter.io.tables.column_names import (
    ACCELERATION,
    ANGLES,
    LINEAR,
    LOCATION,
    OF_UNIT,
    SCALARS,
    UNITS,
    VECTORS,
    Column,
    column_of,
    has_time_unit,
    is_time,
    letters,
    nanoseconds_of,
    quantity_of_file,
    time_unit_of,
)
from pdr_filter.io.tables.sheet import Sheet

_AXES = ("x", "y", "z")
_ANGLES = ("roll", "pitch", "yaw")


@dataclass(frozen=True, slots=True)
class Group:
    """Columns of one sensor."""

    sheet: int  # which of several
    quantity: str  # of `columns`, or "location"
    places: tuple[int, ...]  # -1 of a value that is not there
    time: int | None  # column of its times
    time_unit: str  # as its name says; empty if it does not
    unit: str  # as the names say, as in `UNITS`; empty if they do not
    name: str  # for people
    preference: int = 1  # 2 of values that are called calibrated, 0 of those that are not


def groups_of(sheet: Sheet, at: int) -> list[Group]:
    """Return the columns of a table grouped by sensor."""
    is_named = not all(name.startswith("column ") for name in sheet.fields)
    columns = [column_of(i, name) for i, name in enumerate(sheet.fields)]
    numbered = [i for i, name in enumerate(sheet.fields) if re.fullmatch(r"(?i)v(al(ue)?s?)?[\W_]*[0-3]\W*", name)]
    if len(numbered) == len(_AXES):  # value1, value2, value3
        for i, axis in zip(numbered, _AXES, strict=True):
            columns[i] = Column(i, sheet.fields[i], "", axis)
    times = [i for i, name in enumerate(sheet.fields) if i in sheet.dates or (is_named and is_time(name))]
    nanoseconds = {nanoseconds_of(sheet.fields, i) for i in times}
    times = [i for i in times if i not in nanoseconds]
    times = times or [i for i, name in enumerate(sheet.fields) if has_time_unit(name)][:1]
    if not is_named:
        columns, times = _without_names(sheet, times)
    columns = [column for column in columns if column.place not in times]
    groups: list[Group] = []
    for quantity, axes, preference in _triples(sheet, columns, times):
        unit = next((column.unit for column in axes if column.unit), "")
        if unit and unit not in UNITS[quantity]:
            raise RecordingError(
                f"{sheet.where}: column {axes[0].name!r}: unit {unit!r} is not known for the {quantity}; write one of "
                f"{', '.join(UNITS[quantity])}, or give the unit in a file with pdr-filter convert FILE --map MAP.toml"
            )
        places = tuple(column.place for column in axes)
        groups.append(_group(sheet, at, quantity, places, times, unit, preference))
    angles = [column for name in _ANGLES for column in columns if column.quantity == ANGLES and column.axis == name]
    if len(angles) == len(_ANGLES):
        places = tuple(column.place for column in angles)
        groups.append(_group(sheet, at, ANGLES, places, times, angles[0].unit, 1))
    groups += _scalars(sheet, at, columns, times)
    return groups


def _group(
    sheet: Sheet, at: int, quantity: str, places: tuple[int, ...], times: Sequence[int], unit: str, preference: int
) -> Group:
    time = _time_of(sheet, quantity, places, times)
    known = [sheet.fields[p] for p in places if p >= 0]
    name = ", ".join(known) + (f" of {sheet.name}" if quantity_of_file(sheet.name)[0] else "")
    unit_of_time = "" if time is None else time_unit_of(sheet.fields[time])
    return Group(at, quantity, places, time, unit_of_time, unit, name, preference)


def _without_names(sheet: Sheet, times: list[int]) -> tuple[list[Column], list[int]]:
    """Return columns in the order of a table without column names.

    The first is the time. The others are the axes of the sensor that the file name states.
    """
    quantity, _ = quantity_of_file(sheet.name)
    numbers = [i for i in range(len(sheet.fields)) if i not in sheet.texts]
    times = times or numbers[:1]
    axes = _AXES if quantity in VECTORS else ("",)
    after = [i for i in numbers if i > times[0]][: len(axes)] if times else []
    if not quantity or len(after) < len(axes):
        return [], times
    bare = "" if quantity in VECTORS else quantity
    return [Column(i, sheet.fields[i], bare, axis) for i, axis in zip(after, axes, strict=True)], times


def _triples(sheet: Sheet, columns: Sequence[Column], times: Sequence[int]) -> list[tuple[str, list[Column], int]]:
    """Return the quantity and the columns of the three axes of each sensor, in the order of the table."""
    of_file, of_file_preference = quantity_of_file(sheet.name)
    # Sensors that differ, as in ax and wx or in ax and gyro_x, say more than the name of a file.
    differ = len({column.quantity for column in columns if column.quantity in VECTORS}) > 1
    found: dict[tuple[str, str, int], dict[str, Column]] = {}
    for column in columns:
        quantity = column.quantity
        says_little = not quantity or (len(column.stem) == 1 and not differ)
        if column.axis not in _AXES or (says_little and of_file and of_file not in VECTORS):
            continue
        if says_little:
            before = max((t for t in times if t < column.place), default=-1)
            of_time = quantity_of_file(sheet.fields[before])[0] if before >= 0 else ""
            by_name = [q for q in (of_time, of_file) if q in VECTORS]
            quantity = (by_name or [quantity or OF_UNIT.get(column.unit, ACCELERATION)])[0]
        n = 0  # axes without a word may be there again, for the next sensor
        while column.axis in found.get((quantity, column.stem, n), {}):
            n += 1
        found.setdefault((quantity, column.stem, n), {})[column.axis] = column
    triples: list[tuple[str, list[Column], int]] = []
    for (quantity, stem, _), axes in found.items():
        named = any(axis.quantity for axis in axes.values())
        if all(axis in axes for axis in _AXES):
            preference = min(axes[axis].preference for axis in _AXES) if named else of_file_preference
            triples.append((quantity, [axes[axis] for axis in _AXES], preference))
        elif quantity in (ACCELERATION, LINEAR) and stem:
            missing = ", ".join(axis for axis in _AXES if axis not in axes)
            raise RecordingError(
                f"{sheet.where}: {next(iter(axes.values())).name!r} is one axis of the accelerometer, and there is no "
                f"column for {missing}; export all three axes"
            )
    return triples


def _scalars(sheet: Sheet, at: int, columns: Sequence[Column], times: Sequence[int]) -> list[Group]:
    """Return the groups of quantities with one value (pressure, light, distance), and the location."""
    of_file, _ = quantity_of_file(sheet.name)
    first: dict[str, Column] = {}
    for column in columns:
        quantity = column.quantity
        if not quantity and of_file in SCALARS and (column.axis == "x" or len(columns) == 1):
            quantity = of_file
        best = first.get(quantity)
        if quantity and quantity not in (*VECTORS, ANGLES) and (best is None or column.preference > best.preference):
            first[quantity] = column
    groups = [
        _group(sheet, at, q, (c.place,), times, c.unit if c.unit in UNITS[q] else "", 1)
        for q, c in first.items()
        if q in SCALARS
    ]
    if "latitude" in first and "longitude" in first:
        places = tuple(first[name].place if name in first else -1 for name in LOCATION)
        groups.append(_group(sheet, at, "location", places, times, "", 1))
    return groups


def _time_of(sheet: Sheet, quantity: str, places: Sequence[int], times: Sequence[int]) -> int | None:
    """Return the place of the column of times of a sensor, or None.

    Its own time comes first, then a column of numeric times, then one of dates.
    """
    if not times:
        return None
    first = min((p for p in places if p >= 0), default=0)

    def order(time: int) -> tuple[bool, bool, bool, int]:
        name = sheet.fields[time]
        of = _sensor_of_time(name)
        is_other = bool(of) and of != quantity
        # shared times: numbers before dates; own times: the nearest one before the sensor
        return is_other, of != quantity, time in sheet.dates, (first - time) if first - time > 0 else 1000 + time

    return min(times, key=order)


def _sensor_of_time(name: str) -> str:
    """Return the quantity whose times a column holds, if the name of the column states it, or an empty string."""
    stem = letters(name)
    if stem.startswith("location"):
        return "location"
    if stem.startswith("altimeter"):
        return "barometer"
    return quantity_of_file(name)[0]
