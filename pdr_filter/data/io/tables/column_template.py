"""Template of a column mapping, from the values of tables that cannot be read without one.

Columns that the values do not show are "?". A sensor that counts has the scale that gravity shows.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence, Set
from contextlib import suppress
from dataclasses import replace
from pathlib import PurePath
from typing import NamedTuple

import numpy as np

from pdr_filter.data.io.column_names import (
    ACCELERATION,
    RATE,
    TIME_UNITS,
    UNITS,
    column_of,
    quantity_of_file,
    words_of,
)
from pdr_filter.data.io.describe import median_norm
from pdr_filter.data.io.tables.column_groups import Group
from pdr_filter.data.io.tables.column_mapping import STREAMS, Mapping, StreamMap
from pdr_filter.data.io.tables.column_values import clocks_in, constant_part, time_unit_of_values, turning
from pdr_filter.data.io.tables.sheet import Sheet
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, limits
from pdr_filter.values.errors import RecordingError

G_OF_GRAVITY = (0.8, 1.25)  # constant part of an accelerometer in g
# Usual counts for one g, and for one degree per second: full scales of 16 bits, and the factors of data sheets.
_COUNTS_PER_G = (*(2.0**k for k in range(5, 15)), 1000.0, 100.0)
_COUNTS_PER_DEGREE = (131.0, 114.3, 65.5, 57.1, 32.8, 28.6, 16.4, 14.3, 100.0)
_NEAR = 1.07  # a usual scale that is so near to the measured one is taken
_LEAST_COUNTS = limits.SPECIFIC_FORCE_RANGE_MPS2[1]
_RATE_AS_SAID = (0.5, 2.0)  # limits of the measured turning of gravity over that of an angular rate
NOT_SHOWN = 'columns = ["?", "?", "?"]'
_AXIS = re.compile(r"[XYZxyz\d]\W*$")
_ASK = (
    "with your columns, unit of time (s, ms, us, ns, 100ns, min, h, days, date; rate_hz = 50 in place of column and "
    "unit, if rows have no time), unit (m/s2 or g), counts_per_unit if the sensor counts, sign (1, or -1 if a phone "
    "lying face up reads negative on z), and"
)


class _Force(NamedTuple):
    """Acceleration in m/s2 at its times in s."""

    time_s: FloatArray
    values: FloatArray


def asked_mapping(sheets: Sequence[Sheet], groups: Sequence[Group], file: str) -> str:
    """Return a sentence that asks for a mapping of a file, and a template of it, on a line for each sensor.

    `file` is the path of the file. `groups` are the columns that are known by their names.
    """
    streams: dict[str, StreamMap] = {}
    force: _Force | None = None
    rate_hz = next((sheet.rate_hz for sheet in sheets if sheet.rate_hz), 0.0)
    of_force = {group.sheet for group in groups if group.quantity == ACCELERATION}
    of_rate = [i for i, sheet in enumerate(sheets) if quantity_of_file(sheet.name)[0] == RATE]
    # The table of an accelerometer comes first, because its gravity shows the scale of a gyroscope.
    for i in sorted(range(len(sheets)), key=lambda i: (i not in of_force, i in of_rate)):
        known = {group.quantity: group.places for group in groups if group.sheet == i}
        found, force_of_sheet = _streams(sheets[i], known, force)
        force = force or force_of_sheet
        streams |= {
            stream.stream: replace(stream, file=sheets[i].name if len(sheets) > 1 else "")
            for stream in found
            if stream.stream not in streams
        }
    if "accelerometer" not in streams:
        time, unit = _time_of(sheets[0], np.full((0, len(sheets[0].fields)), np.nan)) if sheets[1:] else ("?", "s")
        streams = {"accelerometer": StreamMap("accelerometer", ("?",) * 3, "m/s2", math.nan, time=time, time_unit=unit)}
    template = Mapping(tuple(streams.values()), rate_hz).toml()
    ask = f"Say which is what in a file like this, where ? stands for what the values do not show, {_ASK}"
    if all(sheet.where == file for sheet in sheets):  # no table in a zip or folder
        ask += f" save it as {PurePath(file).with_suffix('.toml').name} beside the file, where all commands find it, or"
    return f"{ask} give it with pdr-filter convert {file} --map MAP.toml:\n{template}"


def _streams(
    sheet: Sheet, known: dict[str, tuple[int, ...]], force: _Force | None
) -> tuple[list[StreamMap], _Force | None]:
    """Return accelerometer and gyroscope of a table, as far as its values or `known` columns show them, and the force.

    `force` is that of another table.
    """
    numbers = [i for i in range(len(sheet.fields)) if i not in sheet.dates and i not in sheet.texts]
    values = np.full((0, len(sheet.fields)), np.nan)
    with suppress(RecordingError):
        found = sheet.parse(numbers, None, []).values
        values = np.full((len(found), len(sheet.fields)), np.nan)
        values[:, numbers] = found
    time, time_unit = _time_of(sheet, values)
    clocks = clocks_in(values)
    at_s = np.arange(len(values)) / (sheet.rate_hz or limits.SUFFICIENT_RATE_HZ)
    if clocks and not sheet.rate_hz:
        at_s = values[:, clocks[0]] * TIME_UNITS.get(time_unit, 1.0)
    axes = [i for i in numbers if i not in clocks]
    triples = [tuple(axes[k : k + 3]) for k in range(len(axes) - 2)]
    streams: list[StreamMap] = []

    times = ("", "s") if sheet.rate_hz else (time, time_unit)

    def add(stream: str, places: Sequence[int], unit: str, counts: float) -> None:
        names = tuple(sheet.fields[place] for place in places)
        sign = math.nan if stream == "accelerometer" else 1
        streams.append(StreamMap(stream, names, unit, sign, counts, (), *times))

    of_force = [known[ACCELERATION]] if ACCELERATION in known else triples
    best = _best_force(sheet, at_s, values, of_force, {*clocks, *sheet.dates})
    if best is None and ACCELERATION in known:
        best = known[ACCELERATION], "m/s2", 1.0
    if best is not None and force is None and quantity_of_file(sheet.name)[0] != RATE:
        places, unit, counts = best
        add("accelerometer", places, unit, counts)
        factor = STANDARD_GRAVITY_MPS2 if unit == "g" else 1.0
        force = _Force(at_s, values[:, [*places]] * (factor / counts))
        triples = [triple for triple in triples if not set(triple) & set(places)]
    if force is not None:
        rates = [known[RATE]] if RATE in known else triples
        scales = {triple: _rate_scale(force, at_s, values[:, [*triple]]) for triple in rates}
        fitting = {triple: scale for triple, scale in scales.items() if scale is not None}
        if not fitting and RATE in known:
            norm = median_norm(values[:, [*known[RATE]]])
            said = UNITS[RATE].get(column_of(0, sheet.fields[known[RATE][0]]).unit)
            by_size = "deg/s" if norm > limits.MAX_MEDIAN_ANGULAR_RATE_RADPS else "rad/s"
            unit = next((unit for unit in STREAMS["gyroscope"][1] if UNITS[RATE][unit] == said), by_size)
            fitting = {known[RATE]: (unit, math.nan if said is None and norm > _LEAST_COUNTS else 1.0)}
        if fitting:
            triple = max(fitting, key=lambda triple: _likeness(sheet, triple))
            add("gyroscope", triple, *fitting[triple])
    return streams, force


def _time_of(sheet: Sheet, values: FloatArray) -> tuple[str, str]:
    """Return the name of the column of times and its unit, "?" and "s" if the values do not show it."""
    if clocks := clocks_in(values):
        return sheet.fields[clocks[0]], time_unit_of_values(values[:, clocks[0]]) or "s"
    return next(((sheet.fields[i], "date") for i in sheet.dates), ("?", "s"))


def _best_force(
    sheet: Sheet, at_s: FloatArray, values: FloatArray, triples: Sequence[tuple[int, ...]], times: Set[int]
) -> tuple[tuple[int, ...], str, float] | None:
    """Return the columns of an accelerometer with gravity, their unit, and the counts for one unit, or None.

    Axes have names with common words, of one length, that differ at their end. With another column in place of an
    axis, less of gravity is constant, unless that axis has hardly any: then the columns behind one of `times` are
    taken.
    """

    def best_of(fitting: Sequence[tuple[int, ...]]) -> tuple[int, ...]:
        likeness = max(_likeness(sheet, triple) for triple in fitting)
        alike = [triple for triple in fitting if _likeness(sheet, triple) == likeness]
        best = max(alike, key=lambda triple: parts[triple])
        behind = [triple for triple in alike if triple[0] - 1 in times and parts[triple] * _NEAR > parts[best]]
        return behind[0] if behind else best

    parts = {triple: constant_part(at_s, values[:, [*triple]]) for triple in triples}
    low, high = G_OF_GRAVITY
    for unit, gravity in (("m/s2", STANDARD_GRAVITY_MPS2), ("g", 1.0)):
        if fitting := [triple for triple in triples if low <= parts[triple] / gravity <= high]:
            return best_of(fitting), unit, 1.0
    counting = [triple for triple in triples if parts[triple] > _LEAST_COUNTS and _likeness(sheet, triple)[1] == -1]
    if not counting:
        return None
    best = best_of(counting)
    return best, "g", _usual(parts[best], _COUNTS_PER_G)


def _rate_scale(force: _Force, at_s: FloatArray, values: FloatArray) -> tuple[str, float] | None:
    """Return the unit of an angular rate and its counts for one unit, as gravity turns, or None if it does not."""
    factor = turning(force.time_s, force.values, at_s, values)
    if factor is None or factor <= 0:
        return None
    low, high = _RATE_AS_SAID
    for unit, rad_s in (("rad/s", 1.0), ("deg/s", math.pi / 180)):
        if low <= factor / rad_s <= high:
            return unit, 1.0
    return "deg/s", _usual(math.pi / 180 / factor, _COUNTS_PER_DEGREE)


def _usual(counts: float, usual: Sequence[float]) -> float:
    """Return the nearest usual scale, or the measured one with two digits if none is near."""
    near = min(usual, key=lambda scale: abs(math.log(scale / counts)))
    return near if max(near / counts, counts / near) < _NEAR else float(f"{counts:.2g}")


def _likeness(sheet: Sheet, triple: Sequence[int]) -> tuple[int, int, int]:
    """Return the number of words that are in the names of all columns, and two negative numbers.

    These count different lengths of the names, and different names without their axis.
    """
    names = [sheet.fields[i] for i in triple]
    words = set[str].intersection(*(set(words_of(name)) for name in names))
    return len(words), -len({len(name) for name in names}), -len({_AXIS.sub("", name) for name in names})
