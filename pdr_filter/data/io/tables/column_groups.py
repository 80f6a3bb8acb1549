"""Groups of columns that belong together: the axes of a sensor or a location, with the column of their times."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

from pdr_filter.data.io.column_names import (
    ACCELERATION,
    ANGLES,
    LINEAR,
    LOCATION,
    OF_UNIT,
    PHONE_HEADING,
    PHONE_STEPS,
    SCALARS,
    UNITS,
    VECTORS,
    Column,
    bias_of,
    column_of,
    column_of_nanoseconds,
    has_time_unit,
    heading_unit,
    is_heading,
    is_step_count,
    is_time,
    letters,
    quantity_of_file,
    time_unit_of,
)
from pdr_filter.data.io.tables.column_values import clocks_in
from pdr_filter.data.io.tables.sheet import Sheet
from pdr_filter.data.io.tables.text_sheets import first_rows
from pdr_filter.values.errors import RecordingError

_AXES = ("x", "y", "z")
_ANGLES = ("roll", "pitch", "yaw")
_NUMBERED = re.compile(r"(?i)(double_)?v(al(ue)?s?)?[\W_]*[0-3]\W*")


@dataclass(frozen=True, slots=True)
class Group:
    """Columns of one sensor."""

    sheet: int  # number of the table
    quantity: str  # as in `column_names`, or "location"
    places: tuple[int, ...]  # column of each value, or -1 for a missing value
    time: int | None  # column of times
    time_unit: str  # as the name of the column of times states, or empty
    unit: str  # as in `UNITS`, as the names of the columns state, or empty
    name: str  # names of the columns, for messages
    preference: int = 1  # 2 if the names state calibrated values, 0 for uncalibrated ones
    bias: tuple[int, ...] = ()  # columns of the biases of uncalibrated values


def groups_of(sheet: Sheet, at: int) -> list[Group]:
    """Return a `Group` of columns for each sensor, orientation and location that table number `at` shows.

    RecordingError if an accelerometer lacks an axis, or if the unit of a vector is unknown.
    """
    is_named = not all(name.startswith("column ") for name in sheet.fields)
    times = _times(sheet, is_named)
    if is_named:
        columns = _named_columns(sheet)
    else:
        clocks = [] if sheet.rate_hz else clocks_in(first_rows(sheet))
        times = times or clocks[:1] or ([] if sheet.rate_hz else _numbers(sheet)[:1])
        columns = _without_names(sheet, [*times, *clocks])
    columns = [column for column in columns if column.place not in times]

    biases = {bias: i for i, name in enumerate(sheet.fields) if is_named and (bias := bias_of(name)) is not None}
    vectors = _vectors(sheet, columns, times)

    def group(quantity: str, places: Sequence[int], unit: str, preference: int = 1) -> Group:
        time = _time_of(sheet, quantity, places, times)
        name = ", ".join(sheet.fields[place] for place in places if place >= 0)
        name += f" of {sheet.name}" if quantity_of_file(sheet.name)[0] else ""
        time_unit = "" if time is None else time_unit_of(sheet.fields[time])
        bias: tuple[int, ...] = ()
        for key in (quantity, "") if len(vectors) == 1 else (quantity,):
            if not preference and all((key, axis) in biases for axis in _AXES):
                bias = tuple(biases[key, axis] for axis in _AXES)
                break
        return Group(at, quantity, tuple(places), time, time_unit, unit, name, preference, bias)

    groups: list[Group] = []
    for quantity, axes, preference in vectors:
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


def phone_groups_of(sheet: Sheet, at: int) -> list[Group]:
    """Return a `Group` for the steps, and one for the heading, that the phone computed itself, if the table has them.

    The first column of numbers with such a name is taken.
    """
    times = _times(sheet, is_named=True)
    groups: list[Group] = []
    for quantity, is_named in ((PHONE_STEPS, is_step_count), (PHONE_HEADING, is_heading)):
        named = (i for i in _numbers(sheet) if i not in sheet.dates and is_named(sheet.fields[i]))
        place = next((i for i in named if _is_readable(sheet, i)), None)
        if place is not None:
            name = sheet.fields[place]
            unit = heading_unit(name) if quantity == PHONE_HEADING else "steps"
            time = _time_of(sheet, quantity, [place], times)
            time_unit = "" if time is None else time_unit_of(sheet.fields[time])
            groups.append(Group(at, quantity, (place,), time, time_unit, unit, name))
    return groups


def _is_readable(sheet: Sheet, place: int) -> bool:
    """Return True if all cells of a column are numbers, or empty. Other columns are ignored."""
    with suppress(RecordingError):
        sheet.parse([place], None, [])
        return sheet.fields.count(sheet.fields[place]) == 1
    return False


def _times(sheet: Sheet, is_named: bool) -> list[int]:
    """Return the indices of the columns of times, without nanoseconds that belong to whole seconds.

    They are dates and names of times, or else the first column with a unit of time in brackets.
    """
    times = [i for i, name in enumerate(sheet.fields) if i in sheet.dates or (is_named and is_time(name))]
    nanoseconds = {column_of_nanoseconds(sheet.fields, i) for i in times}
    times = [i for i in times if i not in nanoseconds]
    return times or [i for i, name in enumerate(sheet.fields) if has_time_unit(name)][:1]


def _named_columns(sheet: Sheet) -> list[Column]:
    """Return the columns of a table with column names. Three such as value1, value2, value3 are x, y and z."""
    columns = [column_of(i, name) for i, name in enumerate(sheet.fields)]
    numbered = [i for i, name in enumerate(sheet.fields) if _NUMBERED.fullmatch(name)]
    if len(numbered) == len(_AXES):
        for i, axis in zip(numbered, _AXES, strict=True):
            columns[i] = Column(i, sheet.fields[i], "", axis)
    return columns


def _numbers(sheet: Sheet) -> list[int]:
    """Return the indices of the columns without text, which hold numbers or dates."""
    return [i for i in range(len(sheet.fields)) if i not in sheet.texts]


def _without_names(sheet: Sheet, times: Sequence[int]) -> list[Column]:
    """Return the columns of a table without column names: those after the times, for the sensor of the file name.

    They are the first ones if too few are behind them. A clock or a count of the rows is a time, too.
    """
    quantity, _ = quantity_of_file(sheet.name)
    axes = _AXES if quantity in VECTORS else ("",)
    others = [i for i in _numbers(sheet) if i not in times]
    after = [i for i in others if not times or i > max(times)][: len(axes)]
    places = after if len(after) == len(axes) else others[: len(axes)]
    if not quantity or len(places) < len(axes):
        return []
    bare = "" if quantity in VECTORS else quantity
    return [Column(i, sheet.fields[i], bare, axis) for i, axis in zip(places, axes, strict=True)]


def _unit(sheet: Sheet, quantity: str, axes: Sequence[Column]) -> str:
    """Return the unit that the names of the axes state, or an empty string. RecordingError if it is unknown."""
    unit = next((axis.unit for axis in axes if axis.unit), "")
    if unit and unit not in UNITS[quantity]:
        raise RecordingError(
            f"{sheet.where}: column {axes[0].name!r}: unit {unit!r} is not known for the {quantity}; write one of "
            f"{', '.join(UNITS[quantity])}, or give the unit in a file with pdr-filter convert FILE --map MAP.toml"
        )
    return unit


def _vectors(sheet: Sheet, columns: Sequence[Column], times: Sequence[int]) -> list[tuple[str, list[Column], int]]:
    """Return quantity, axes and preference of the sensors with three axes, in the order of the table.

    RecordingError if an accelerometer lacks an axis. Axes whose names state no sensor may appear again, for the next
    one.
    """
    # Names such as ax and wx, which distinguish sensors, state more than the name of the file.
    is_distinct = len({column.quantity for column in columns if column.quantity in VECTORS}) > 1
    found: dict[tuple[str, str, int], dict[str, Column]] = {}  # by quantity, stem, and number of those of one stem
    for column in columns:
        is_vague = not column.quantity or (len(column.stem) == 1 and not is_distinct)
        quantity = _quantity_of_vague_axis(sheet, column, times) if is_vague else column.quantity
        if column.axis not in _AXES or not quantity:
            continue
        number = 0
        while column.axis in found.get((quantity, column.stem, number), {}):
            number += 1
        found.setdefault((quantity, column.stem, number), {})[column.axis] = column
    vectors: list[tuple[str, list[Column], int]] = []
    for (quantity, stem, _), by_axis in found.items():
        missing = [axis for axis in _AXES if axis not in by_axis]
        if not missing:
            axes = [by_axis[axis] for axis in _AXES]
            is_named = any(axis.quantity for axis in axes)
            preference = min(axis.preference for axis in axes) if is_named else quantity_of_file(sheet.name)[1]
            vectors.append((quantity, axes, preference))
        elif quantity in (ACCELERATION, LINEAR) and stem:
            raise RecordingError(
                f"{sheet.where}: {next(iter(by_axis.values())).name!r} is one axis of the accelerometer, and there is "
                f"no column for {', '.join(missing)}; export all three axes"
            )
    return vectors


def _quantity_of_vague_axis(sheet: Sheet, column: Column, times: Sequence[int]) -> str:
    """Return the quantity of an axis whose own name states it not at all, or with one letter.

    The name of the time before it decides, then the file, the axis, its unit, and else it is an acceleration. "" if the
    file is of a sensor without axes.
    """
    of_file, _ = quantity_of_file(sheet.name)
    if of_file and of_file not in VECTORS:
        return ""
    before = max((time for time in times if time < column.place), default=None)
    of_time = "" if before is None else quantity_of_file(sheet.fields[before])[0]
    by_name = [quantity for quantity in (of_time, of_file) if quantity in VECTORS]
    return by_name[0] if by_name else column.quantity or OF_UNIT.get(column.unit, ACCELERATION)


def _single_values(sheet: Sheet, columns: Sequence[Column]) -> dict[str, Column]:
    """Return the preferred column of each quantity with one value: pressure, light, distance, parts of a location."""
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
    """Return the index of the column of times of a sensor with columns `places`, or None without times.

    One named after the sensor is preferred, then shared ones, numbers before dates, and last those of other sensors.
    """
    if not times:
        return None
    first = min((p for p in places if p >= 0), default=0)

    def order(time: int) -> tuple[bool, bool, bool, int]:
        of = _sensor_of_time(sheet.fields[time])
        is_other = bool(of) and of != quantity
        # shared times: numbers before dates; own times: the nearest one before the sensor
        return is_other, of != quantity, time in sheet.dates, (first - time) if first - time > 0 else 1000 + time

    return min(times, key=order)


def _sensor_of_time(name: str) -> str:
    """Return the quantity whose times the name of a column states, or an empty string."""
    stem = letters(name)
    if stem.startswith("location"):
        return "location"
    if stem.startswith("altimeter"):
        return "barometer"
    return quantity_of_file(name)[0]
