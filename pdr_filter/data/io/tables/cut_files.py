"""Files of one sensor that were cut in time, such as one for each hour, joined to one table."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

import numpy as np

from pdr_filter.data.io.column_names import TIME_UNITS, quantity_of_file, trial_of
from pdr_filter.data.io.files.archive import LOCATIONS
from pdr_filter.data.io.tables.column_groups import groups_of
from pdr_filter.data.io.tables.column_values import time_unit_of_values
from pdr_filter.data.io.tables.sheet import Sheet
from pdr_filter.data.io.tables.text_sheets import first_rows
from pdr_filter.data.io.text_table import NumberTable, concatenated
from pdr_filter.values import FloatArray
from pdr_filter.values.errors import RecordingError

# An app that begins a new file loses a few samples at most: up to 5 s of a fast sensor, and two of a slow one, such as
# GNSS. A person who ends a recording and begins the next one takes longer.
_LONGEST_CUT_S = 5.0
_MOST_INTERVALS = 3.0
_SHORTEST_CUT_S = -1.0  # sensors of one phone end and begin at other samples
_WORD = re.compile(r"[A-Za-z]{2,}")


def with_cut_files_joined(sheets: Sequence[Sheet], notes: list[str] | None) -> list[Sheet]:
    """Return the tables, in which files of one sensor that continue each other in time are one table.

    Files of a sensor may be missing while those of another sensor continue. `notes` gets a sentence for each joined
    table.
    """
    groups: dict[object, list[Sheet]] = {}
    for i, sheet in enumerate(sheets):
        sensor = _sensor_of(sheet.name)
        groups.setdefault((sensor, sheet.fields) if is_numbered(sheet.name) and sensor[0] else i, []).append(sheet)
    found: list[Sheet] = []
    continued = {key: in_time(parts) for key, parts in groups.items() if len(parts) > 1}
    is_any_apart = None in continued.values()
    spans_s = [_span_s(ordered) for ordered in continued.values() if ordered is not None and is_any_apart]
    for key, parts in groups.items():
        ordered = continued.get(key)
        if ordered is None and len(parts) > 1 and spans_s:
            ordered = in_time(parts, spans_s)
        found += parts if ordered is None else [_joined(ordered)]
        if ordered is not None and notes is not None:
            sensor, _ = _sensor_of(ordered[0].name)
            notes.append(f"{sensor}: {len(ordered)} files that continue each other in time are joined")
    return found


def is_numbered(name: str) -> bool:
    """Return True if the name of a file has only dates or numbers beside that of its sensor, no word for a walk."""
    return LOCATIONS.issuperset(map(str.lower, _WORD.findall(trial_of(name))))


def _sensor_of(name: str) -> tuple[str, int]:
    """Return `quantity_of_file`, which is ("location", 1) for a file of locations."""
    is_location = not LOCATIONS.isdisjoint(map(str.lower, _WORD.findall(name)))
    return ("location", 1) if is_location else quantity_of_file(name)


def in_time(sheets: Sequence[Sheet], spans_s: Sequence[tuple[float, float]] = ()) -> list[Sheet] | None:
    """Return tables in the order of their times if each continues the one before, otherwise None.

    Gaps of any length inside `spans_s` are those of missing files: begin and end of other sensors in s. Tables are read
    one after the other, so that those of separate walks, whose clocks begin anew, take no time.
    """
    with suppress(RecordingError):
        times = [next((group.time for group in groups_of(sheet, 0)), None) for sheet in sheets]
        begins = [_begin(sheet, time) for sheet, time in zip(sheets, times, strict=True) if time is not None]
        if len(begins) < len(sheets) or len({*begins}) < len(sheets):
            return None
        order = sorted(range(len(sheets)), key=lambda i: begins[i])
        for k, after in pairwise(order):
            ticks = _ticks(sheets[k], times[k])
            known = ticks[np.isfinite(ticks)]
            if not len(known):
                return None
            unit_s = TIME_UNITS["ns" if times[k] in sheets[k].dates else time_unit_of_values(ticks) or "s"]
            gap_s = (begins[after] - float(known.max())) * unit_s
            usual_s = float(np.median(np.diff(known))) * unit_s if len(known) > 1 else 0.0
            end_s, next_s = float(known.max()) * unit_s, begins[after] * unit_s
            is_missing = any(begin_s <= end_s and next_s <= last_s for begin_s, last_s in spans_s)
            most_s = np.inf if is_missing else max(_LONGEST_CUT_S, _MOST_INTERVALS * usual_s)
            if not _SHORTEST_CUT_S < gap_s < most_s:
                return None
        return [sheets[i] for i in order]
    return None


def _span_s(ordered: Sequence[Sheet]) -> tuple[float, float]:
    """Return the first and the last time of tables in the order of time, in s."""
    found: list[FloatArray] = []
    for sheet in (ordered[0], ordered[-1]):
        time = next((group.time for group in groups_of(sheet, 0)), None)
        ticks = _ticks(sheet, time)
        unit = "ns" if time in sheet.dates else time_unit_of_values(ticks) or "s"
        found.append(ticks[np.isfinite(ticks)] * TIME_UNITS[unit])
    return float(found[0].min(initial=np.inf)), float(found[1].max(initial=-np.inf))


def _begin(sheet: Sheet, time: int) -> float:
    """Return the first time of a table, in ticks. Dates are not in its first numbers."""
    rows = first_rows(sheet)
    ticks = _ticks(sheet, time) if time in sheet.dates or not len(rows) else rows[:, time]
    return float(ticks[0]) if len(ticks) else np.nan


def _ticks(sheet: Sheet, time: int | None) -> FloatArray:
    return sheet.using({time}, []).stream([-1 if time is None else time], time)[0].astype(np.float64)


def _joined(sheets: Sequence[Sheet]) -> Sheet:
    """Return one table with the rows of all."""

    def parse(numbers: Sequence[int], whole: int | None, notes: list[str]) -> NumberTable:
        return concatenated([sheet.parse(numbers, whole, notes) for sheet in sheets])

    return replace(sheets[0], parse=parse)
