"""Recordings that were cut in time, joined to one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, cast

import numpy as np

from pdr_filter.data.io.describe import READING_KEY, dict_of
from pdr_filter.data.io.files.own_format_writer import TIME_COLUMNS
from pdr_filter.values import FloatArray, Samples, Table, Wifi, table
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording, Truth

# Sensors end and begin at different samples. Parts that overlap for longer are of two phones, or of two clocks.
_MOST_OVERLAP_S = 1.0


def joined(parts: Sequence[Recording]) -> Recording:
    """Return the recording of which the given ones are parts, in any order, with the meta data of the first in time.

    Times are those since the first sample of the first part. Annotations, and steps and heading of the phone, are those
    of all parts. RecordingError if a part has no Unix time, or if parts
    overlap.
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
    """Return the meta data of the first part, with the phone's steps, headings and annotations of all parts."""
    meta = {key: value for key, value in parts[0].meta.items() if key not in ("phone", "annotations")}
    phone: dict[str, Any] = {}
    counts = [part.phone_steps for part in parts if part.phone_steps is not None]
    if len(counts) == len(parts):
        phone["n_steps"] = sum(counts)
    begin, end = (_list_of(dict_of(part.meta.get("phone")).get("heading_deg")) for part in (parts[0], parts[-1]))
    if begin and end:
        phone["heading_deg"] = [begin[0], end[-1]]
    annotations: list[dict[str, Any]] = []
    for part, shift_s in zip(parts, shifts_s, strict=True):
        for annotation in map(dict_of, _list_of(part.meta.get("annotations"))):
            if isinstance(time_s := annotation.get("time_s"), int | float):
                annotations.append({**annotation, "time_s": time_s + shift_s})
    reading = dict_of(meta.get(READING_KEY))
    if reading:  # its sentences about the phone describe one part only
        found = [str(sentence) for sentence in _list_of(reading.get("found"))]
        meta[READING_KEY] = {**reading, "found": [sentence for sentence in found if "by the phone: " not in sentence]}
    return meta | {key: value for key, value in (("phone", phone), ("annotations", annotations)) if value}


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
