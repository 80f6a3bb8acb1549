"""Storeys of a smoothed walk: without hills, and numbered as fixes name them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from pdr_filter.values import FloatArray, FloorPassage, IntArray, PositionFix, TrackRows

AnyRows = TypeVar("AnyRows", bound=TrackRows)

# Stairs lead 1.5 to 2 m forward for each metre up and come back at a landing: locations moved by at most 3.2 m for
# each metre on 8 climbs of ipin2023, and by 6 m on a hill. A ramp that people can walk leads 6 m or more.
_LEAST_WAY_OF_A_HILL = 4.5
# Locations worse than this do not show a way of some metres.
_GOOD_M = 10.0


def without_hills(track: AnyRows, location_s: FloatArray, place_m: FloatArray, accuracy_m: FloatArray) -> AnyRows:
    """A track without the floor changes during which the locations (L,), (L, 2), (L,) led up or down a hill."""
    good = np.isfinite(place_m).all(axis=1) & (accuracy_m <= _GOOD_M)
    if good.sum() < 2 or not track.floor_passages:
        return track
    location_s, place_m = location_s[good], place_m[good]

    def is_hill(passage: FloorPassage) -> bool:
        ends_s = [passage.start_s, passage.end_s]
        if passage.how == "lift" or not ((location_s >= ends_s[0]) & (location_s <= ends_s[1])).any():
            return False
        way_m = np.diff([np.interp(ends_s, location_s, column) for column in place_m.T], axis=1)
        climbed_m = float(np.diff(np.interp(ends_s, track.time_s, track.height_m))[0])
        return float(np.hypot(*way_m)[0]) > _LEAST_WAY_OF_A_HILL * max(abs(climbed_m), 1.0)

    shift, kept = np.zeros(track.n_steps, dtype=np.int64), list[FloorPassage]()
    lower = 0
    for passage in track.floor_passages:
        if is_hill(passage):
            lower += passage.to_floor - passage.from_floor
            since = _step_at(track, passage.start_s)
            shift[since + int(np.argmax(track.floor[since:] != track.floor[max(since - 1, 0)])) :] = -lower
        else:
            kept.append(replace(passage, from_floor=passage.from_floor - lower, to_floor=passage.to_floor - lower))
    return replace(track, floor=_shifted(track, shift), floor_passages=tuple(kept))


def with_named_floors(track: AnyRows, fixes: Sequence[object]) -> AnyRows:
    """A track whose storeys are numbered as fixes name them: all of them by the first, later ones by those after it."""
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
    return min(int(np.searchsorted(track.time_s, time_s)), track.n_steps - 1)


def _shifted(track: TrackRows, shift: IntArray) -> IntArray:
    floor = track.floor + shift
    floor.flags.writeable = False
    return floor
