"""Groups of columns that belong together: the axes of a sensor or a location, with the column of their times."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from pdr_filter.data.io.column_names import (
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
    column_of_nanoseconds,
    has_time_unit,
    is_time,
    letters,
    quantity_of_file,
    time_unit_of,
)
from pdr_filter.data.io.tables.sheet import Sheet
from pdr_filter.values.errors import RecordingError

_AXES = ("x", "y", "z")
_ANGLES = ("roll", "pitch", "yaw")


@dataclass(frozen=True, slots=True)
class Group:
    """Columns of one sensor.

    Attributes
    ----------
    sheet : int
        Number of the table.
    quantity : str
        Quantity as in `column_names`, or "location".
    places : tuple of int
        Number of the column of each value, or -1 for a missing value.
    time : int or None
        Number of the column of times, or None if there is none.
    time_unit : str
        Unit that the name of the column of times states, or an empty string.
    unit : str
        Unit that the names of the columns state, as in `UNITS`, or an empty string.
    name : str
        Names of the columns, for messages.
    preference : int
        2 if the names state calibrated values, 0 for uncalibrated ones, 1 otherwise.
    """

    sheet: int
    quantity: str
    places: tuple[int, ...]
    time: int | None
    time_unit: str
    unit: str
    name: str
    preference: int = 1


def groups_of(sheet: Sheet, at: int) -> list[Group]:
    """Return a `Group` of columns for each sensor, orientation and location that the columns of a table show.

    `at` is the number of the table, which the groups store. RecordingError if an accelerometer lacks an axis, or if the
    unit of a vector is unknown.
    """
    is_named = not all(name.startswith("column ") for name in sheet.fields)
    times = _times(sheet, is_named)
    if is_named:
        columns = _named_columns(sheet)
    else:
        times = times or _numbers(sheet)[:1]
        columns = _without_names(sheet, times)
    columns = [column for column in columns if column.place not in times]

    def group(quantity: str, places: Sequence[int], unit: str, preference: int = 1) -> Group:
        time = _time_of(sheet, quantity, places, times)
        name = ", ".join(sheet.fields[place] for place in places if place >= 0)
        name += f" of {sheet.name}" if quantity_of_file(sheet.name)[0] else ""
        time_unit = "" if time is None else time_unit_of(sheet.fields[time])
        return Group(at, quantity, tuple(places), time, time_unit, unit, name, preference)

    groups: list[Group] = []
    for quantity, axes, preference in _vectors(sheet, columns, times):
        groups.append(group(quantity, [axis.place for axis in axes], _unit(sheet, quantity, axes), preference))
    angles = [column for name in _ANGLES for column in columns if column.quantity == ANGLES and column.axis == name]
    if len(angles) == len(_ANGLES):
        groups.append(group(ANGLES, [angle.place for angle in angles], angles[0].unit))
    values = _single_values(sheet, columns)
    for quantity, column in values.items():
        if quantity in SCALARS:
            groups.append(group(quantity, [column.place], column.unit if column.unit in UNITS[quantity] else ""))
    if "latitude" in values and "longitude" in values:
        groups.append(group("location", [values[name].place if name in values else -1 for name in LOCATION], ""))
    return groups


def _times(sheet: Sheet, is_named: bool) -> list[int]:
    """Return the indices of the columns of times.

    A column with the nanoseconds of a column of whole seconds is left out. If there is no date and no name of a time,
    the first column with a unit of time in brackets is the only one.
    """
    times = [i for i, name in enumerate(sheet.fields) if i in sheet.dates or (is_named and is_time(name))]
    nanoseconds = {column_of_nanoseconds(sheet.fields, i) for i in times}
    times = [i for i in times if i not in nanoseconds]
    return times or [i for i, name in enumerate(sheet.fields) if has_time_unit(name)][:1]


def _named_columns(sheet: Sheet) -> list[Column]:
    """Return quantity, axis and unit of each column of a table with column names.

    Three columns such as value1, value2, value3 are the axes x, y and z.
    """
    columns = [column_of(i, name) for i, name in enumerate(sheet.fields)]
    numbered = [i for i, name in enumerate(sheet.fields) if re.fullmatch(r"(?i)v(al(ue)?s?)?[\W_]*[0-3]\W*", name)]
    if len(numbered) == len(_AXES):
        for i, axis in zip(numbered, _AXES, strict=True):
            columns[i] = Column(i, sheet.fields[i], "", axis)
    return columns


def _numbers(sheet: Sheet) -> list[int]:
    """Return the indices of the columns without text, which hold numbers or dates."""
    return [i for i in range(len(sheet.fields)) if i not in sheet.texts]


def _without_names(sheet: Sheet, times: Sequence[int]) -> list[Column]:
    """Return the columns of the sensor in a table without column names: its three axes, or its single value.

    They are the first columns of numbers after the first column of times. The name of the file states the sensor. The
    list is empty if it states none, or if too few columns follow.
    """
    quantity, _ = quantity_of_file(sheet.name)
    axes = _AXES if quantity in VECTORS else ("",)
    after = [i for i in _numbers(sheet) if i > times[0]][: len(axes)] if times else []
    if not quantity or len(after) < len(axes):
        return []
    bare = "" if quantity in VECTORS else quantity
    return [Column(i, sheet.fields[i], bare, axis) for i, axis in zip(after, axes, strict=True)]


def _unit(sheet: Sheet, quantity: str, axes: Sequence[Column]) -> str:
    """Return the unit that the names of the axes state, or an empty string. RecordingError if it is unknown."""
    unit = next((axis.unit for axis in axes if axis.unit), "")
    if unit and unit not in UNITS[quantity]:
        raise RecordingError(
            f"{sheet.where}: column {axes[0].name!r}: unit {unit!r} is not known for the {quantity}; write one of "
            f"{', '.join(UNITS[quantity])}, or give the unit in a file with pdr-filter convert FILE --map MAP.toml"
        )
    return unit


class _Vector(NamedTuple):
    """Columns of the three axes of a sensor.

    `quantity` is the measured quantity. `preference` is 2 if the columns have calibrated values, 0 for uncalibrated
    values and 1 if unknown. The sensor with the highest preference is used.
    """

    quantity: str
    axes: list[Column]
    preference: int


class _Sensor(NamedTuple):
    """Sensor to which an axis belongs. `stem` is the name of its columns without the axis.

    `number` counts from 0 the sensors whose columns have the same names.
    """

    quantity: str
    stem: str
    number: int


def _vectors(sheet: Sheet, columns: Sequence[Column], times: Sequence[int]) -> list[_Vector]:
    """Return the sensors with three axes, in the order of the table. Sensors that lack an axis are left out.

    RecordingError if it is an accelerometer whose columns have more than the axis in their names. Axes whose names
    state no sensor may appear again, for the next sensor.
    """
    # Names such as ax and wx, which distinguish sensors, state more than the name of the file.
    is_distinct = len({column.quantity for column in columns if column.quantity in VECTORS}) > 1
    found: dict[_Sensor, dict[str, Column]] = {}
    for column in columns:
        is_vague = not column.quantity or (len(column.stem) == 1 and not is_distinct)
        quantity = _quantity_of_vague_axis(sheet, column, times) if is_vague else column.quantity
        if column.axis not in _AXES or not quantity:
            continue
        number = 0
        while column.axis in found.get(_Sensor(quantity, column.stem, number), {}):
            number += 1
        found.setdefault(_Sensor(quantity, column.stem, number), {})[column.axis] = column
    vectors: list[_Vector] = []
    for sensor, by_axis in found.items():
        missing = [axis for axis in _AXES if axis not in by_axis]
        if not missing:
            axes = [by_axis[axis] for axis in _AXES]
            is_named = any(axis.quantity for axis in axes)
            preference = min(axis.preference for axis in axes) if is_named else quantity_of_file(sheet.name)[1]
            vectors.append(_Vector(sensor.quantity, axes, preference))
        elif sensor.quantity in (ACCELERATION, LINEAR) and sensor.stem:
            raise RecordingError(
                f"{sheet.where}: {next(iter(by_axis.values())).name!r} is one axis of the accelerometer, and there is "
                f"no column for {', '.join(missing)}; export all three axes"
            )
    return vectors


def _quantity_of_vague_axis(sheet: Sheet, column: Column, times: Sequence[int]) -> str:
    """Return the quantity of an axis whose own name states it not at all, or with one letter.

    The name of the column of times before the axis decides, then the name of the file, the name of the axis, and its
    unit. If none of them states a quantity, the result is the acceleration. An empty string means that the name of the
    file states a sensor without axes.
    """
    of_file, _ = quantity_of_file(sheet.name)
    if of_file and of_file not in VECTORS:
        return ""
    before = max((time for time in times if time < column.place), default=None)
    of_time = "" if before is None else quantity_of_file(sheet.fields[before])[0]
    by_name = [quantity for quantity in (of_time, of_file) if quantity in VECTORS]
    return by_name[0] if by_name else column.quantity or OF_UNIT.get(column.unit, ACCELERATION)


def _single_values(sheet: Sheet, columns: Sequence[Column]) -> dict[str, Column]:
    """Return the preferred column of each quantity with one value, by quantity.

    Such quantities are pressure, light, distance, and the parts of a location. Of equal columns, the first is taken.
    """
    of_file, _ = quantity_of_file(sheet.name)
    found: dict[str, Column] = {}
    for column in columns:
        quantity = column.quantity
        if not quantity and of_file in SCALARS and (column.axis == "x" or len(columns) == 1):
            quantity = of_file
        best = found.get(quantity)
        if quantity and quantity not in (*VECTORS, ANGLES) and (best is None or column.preference > best.preference):
            found[quantity] = column
    return found


def _time_of(sheet: Sheet, quantity: str, places: Sequence[int], times: Sequence[int]) -> int | None:
    """Return the index of the column of times of a sensor, or None if the table has no times.

    A column named after the sensor is preferred. Next come shared columns, numbers before dates, and last the columns
    of other sensors. `places` are the indices of the columns of the sensor, and `times` the indices of the columns of
    times.
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
