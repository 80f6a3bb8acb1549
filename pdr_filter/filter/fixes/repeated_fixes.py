"""Positions that are repeated exactly while steps go on, as apps do when they have lost GNSS."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pdr_filter.values import FloatArray, PositionFix, read_only, replace_unchecked

# Displacement over walked distance of dead reckoning since a position was new, from which its repetition is wrong. A
# closed walk that returns to a surveyed point ends nearer to it: its heading would have to be off by tens of degrees.
_MOVED_SHARE = 0.3
# Least displacement, because a step or two may be false detections.
_MIN_MOVED_M = 2.0


@dataclass(frozen=True, eq=False)
class SeenPlace:
    """The last position that a fix gave for the first time, and where the track was then."""

    position_m: FloatArray  # (2,)
    track_m: FloatArray  # (2,)
    walked_m: float  # of all steps until then
    is_frozen: bool = False  # True if fixes repeated it while steps went on


def seen_after(previous: SeenPlace | None, fix: PositionFix, track_m: FloatArray, walked_m: float) -> SeenPlace:
    """Last new position after a fix, given the place of the track and the walked distance at its time.

    An exact repetition is frozen if dead reckoning has left the place by more than the standard deviation of the fix,
    and has not walked in a circle. It stays frozen until a fix gives another position.
    """
    if previous is None or not np.array_equal(fix.position_m, previous.position_m):
        return SeenPlace(fix.position_m, read_only(track_m), walked_m)
    moved_m = float(np.linalg.norm(track_m - previous.track_m))
    far_m = max(_MIN_MOVED_M, fix.var_m2**0.5, _MOVED_SHARE * (walked_m - previous.walked_m))
    return replace_unchecked(previous, is_frozen=True) if moved_m > far_m else previous


def frozen_fixes(
    fixes: Iterable[PositionFix], time_s: FloatArray, position_m: FloatArray, walked_m: FloatArray
) -> list[bool]:
    """For each fix, True if it repeats a position while steps go on; fixes in any order.

    `time_s` (K,), `position_m` (K, 2) and `walked_m` (K,) are the steps of dead reckoning.
    """
    fixes = list(fixes)
    result, seen = [False] * len(fixes), None
    if len(time_s) == 0:
        return result
    for k in sorted(range(len(fixes)), key=lambda k: fixes[k].time_s):
        fix = fixes[k]
        east_m, north_m, walked = (float(np.interp(fix.time_s, time_s, values)) for values in (*position_m.T, walked_m))
        seen = seen_after(seen, fix, np.array([east_m, north_m]), walked)
        result[k] = seen.is_frozen
    return result
