"""Recordings that were cut in time, joined to one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, cast

import numpy as np

from pdr_filter.data.io.column_names import PHONE_STEPS
from pdr_filter.data.io.describe import dict_of
from pdr_filter.data.io.files.own_format_writer import TIME_COLUMNS
from pdr_filter.values import FloatArray, Samples, Table, Wifi, table
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording, Truth

# Sensors end and begin at different samples. Parts that overlap for longer are of two phones, or of two clocks.
_MOST_OVERLAP_S = 1.0


def joined(parts: Sequence[Recording]) -> Recording:
    """Return the recording of which the given ones are parts, in any order, with the meta data of the first in time.

    Times are those since the first sample of the first part. Annotations are those of all parts. The phone's steps are
    unknown if a part lacks them. RecordingError if a part has no Unix time, or if parts overlap.
    """
    if not parts:
        raise ValueError("no recordings to join: give one or more paths")
    if len(parts) == 1:
        return parts[0]
    starts = {id(part): part.epoch_s for part in parts}
    unknown = next((part for part in parts if part.epoch_s is None), None)
    if unknown is not None:
        raise RecordingError(
            f"{unknown.source}: its times are not since 1970, so it cannot be joined to another file; export it with "
            "dates or Unix times, or track the parts one by one"
        )
    parts = sorted(parts, key=lambda part: starts[id(part)] or 0.0)
    first_s = parts[0].epoch_s or 0.0
    # Whole microseconds, because a Unix time in a float has no more.
    shifts_s = [round((part.epoch_s or 0.0) - first_s, 6) for part in parts]
    for (before, at_s), (after, next_s) in pairwise(zip(parts, shifts_s, strict=True)):
        end_s, begin_s = before.accelerometer.time_s.max(), after.accelerometer.time_s.min()
        overlap_s = float((at_s + end_s) - (next_s + begin_s))
        if overlap_s > _MOST_OVERLAP_S:
            raise RecordingError(
                f"{after.source}: begins {overlap_s:.1f} s before the end of {before.source}, so they are not parts of "
                "one recording; read them one by one"
            )
    names = dict.fromkeys(name for part in parts for name in part.streams)
    if any(PHONE_STEPS not in part.streams for part in parts):
        parts = [replace(part, **{PHONE_STEPS: None}) for part in parts]
        names.pop(PHONE_STEPS, None)
    truths = dict.fromkeys(name for part in parts for name in part.truth.present())
    heard = [
        replace(part.wifi, time_s=part.wifi.time_s + shift_s)
        for part, shift_s in zip(parts, shifts_s, strict=True)
        if part.wifi is not None
    ]
    wifi = None
    if heard:
        columns = ("time_s", "bssid", "rssi_dbm", "frequency_mhz")
        wifi = Wifi(*(np.concatenate([getattr(rows, name) for rows in heard]) for name in columns))
    return replace(
        parts[0],
        **{name: _samples(parts, shifts_s, name) for name in names},
        wifi=wifi,
        truth=Truth(**{name: _truth(parts, shifts_s, name) for name in truths}),
        meta=_meta(parts, shifts_s),
        source=", ".join(part.source for part in parts),
        notes=tuple(dict.fromkeys(note for part in parts for note in part.notes)),
    )


def _meta(parts: Sequence[Recording], shifts_s: Sequence[float]) -> dict[str, Any]:
    """Return the meta data of the first part, with the annotations of all parts."""
    meta = {key: value for key, value in parts[0].meta.items() if key != "annotations"}
    annotations: list[dict[str, Any]] = []
    for part, shift_s in zip(parts, shifts_s, strict=True):
        for annotation in map(dict_of, _list_of(part.meta.get("annotations"))):
            if isinstance(time_s := annotation.get("time_s"), int | float):
                annotations.append({**annotation, "time_s": time_s + shift_s})
    return meta | ({"annotations": annotations} if annotations else {})


def _list_of(value: Any) -> list[Any]:
    """Return the value if it is a list, else an empty one: untrusted files may hold anything."""
    return cast("list[Any]", value) if isinstance(value, list) else []


def _samples(parts: Sequence[Recording], shifts_s: Sequence[float], name: str) -> Samples:
    found = [(part.streams[name], s) for part, s in zip(parts, shifts_s, strict=True) if name in part.streams]
    values = np.concatenate([samples.values for samples, _ in found])
    return Samples(np.concatenate([samples.time_s + shift_s for samples, shift_s in found]), values)


def _truth(parts: Sequence[Recording], shifts_s: Sequence[float], name: str) -> Table:
    found = [(t, s) for part, s in zip(parts, shifts_s, strict=True) if (t := getattr(part.truth, name)) is not None]
    columns: dict[str, FloatArray] = {
        key: np.concatenate([rows[key] + (shift_s if key in TIME_COLUMNS else 0.0) for rows, shift_s in found])
        if found[0][0][key].dtype.kind == "f"
        else np.concatenate([rows[key] for rows, _ in found])
        for key in found[0][0].dtype.names or ()
    }
    return table(columns)
