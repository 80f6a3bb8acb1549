"""Storeys of a smoothed walk: changed at arrivals, and numbered as in the fixes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from pdr_filter.values import IntArray, PositionFix, TrackRows

AnyRows = TypeVar("AnyRows", bound=TrackRows)


def with_arrivals(track: AnyRows) -> AnyRows:
    """Return a track that changes its storey only where a floor passage led to another one.

    The filter changes the storey before it has confirmed the arrival, or before accurate locations reveal a hill
    instead. Steps during a passage keep the storey of the filter.
    """
    floor, begin, now = track.floor.copy(), 0, int(track.floor[0]) if track.n_steps else 0
    for passage in track.floor_passages:
        floor[begin : np.searchsorted(track.time_s, passage.start_s)] = passage.from_floor
        begin, now = int(np.searchsorted(track.time_s, passage.end_s)), passage.to_floor
    floor[begin:] = now
    return replace(track, floor=_shifted(track, floor - track.floor))


def with_named_floors(track: AnyRows, fixes: Sequence[object]) -> AnyRows:
    """Return a track with storeys numbered as in the fixes.

    The first fix with a storey sets the number of all storeys. Each later one corrects those from its time on.
    """
    named = sorted((f.time_s, f.floor) for f in fixes if isinstance(f, PositionFix) and f.floor is not None)
    if not named or not track.n_steps:
        return track
    floor = track.floor.copy()
    for number, (time_s, name) in enumerate(named):
        k = _step_at(track, time_s)
        floor[k if number else 0 :] += name - floor[k]
    shift = floor - track.floor
    passages = tuple(
        replace(p, from_floor=p.from_floor + up, to_floor=p.to_floor + up)
        for p, up in ((p, int(shift[_step_at(track, p.end_s)])) for p in track.floor_passages)
    )
    return replace(track, floor=_shifted(track, shift), floor_passages=passages)


def _step_at(track: TrackRows, time_s: float) -> int:
    """Return the index of the first step whose contact is at a time or later, or else of the last step."""
    return min(int(np.searchsorted(track.time_s, time_s)), track.n_steps - 1)


def _shifted(track: TrackRows, shift: IntArray) -> IntArray:
    """Return the storeys of a track plus a shift, read-only."""
    floor = track.floor + shift
    floor.flags.writeable = False
    return floor
