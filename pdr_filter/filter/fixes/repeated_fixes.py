"""Positions that are repeated exactly while steps continue, as apps report them after the loss of GNSS."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pdr_filter.values import FloatArray, PositionFix, read_only, replace_unchecked

# Ratio of displacement to walked distance since the position was new, above which a repetition is wrong. A closed walk
# that returns to a surveyed point ends closer to it, unless its heading is wrong by tens of degrees.
_MOVED_SHARE = 0.3
# Smallest such displacement, because one or two steps may be false detections.
_MIN_MOVED_M = 2.0


@dataclass(frozen=True, eq=False)
class SeenPlace:
    """Last fix position that was not a repetition, and the track at that time.

    Attributes
    ----------
    position_m : (2,) array
        Position of the fix.
    track_m : (2,) array
        Position of the track at the time of the fix.
    walked_m : float
        Distance of all steps until then.
    is_frozen : bool
        True if fixes repeated the position while steps continued.
    """

    position_m: FloatArray
    track_m: FloatArray
    walked_m: float
    is_frozen: bool = False


def seen_after(previous: SeenPlace | None, fix: PositionFix, track_m: FloatArray, walked_m: float) -> SeenPlace:
    """Return the last position that was not a repetition, after one more fix.

    `track_m` (2,) and `walked_m` are the track position and the walked distance at the time of the fix. An exact
    repetition is frozen if dead reckoning has moved by more than 2 m, the standard deviation of the fix, and 30 % of
    the distance walked since. The last condition allows a person to return. A position stays frozen until a fix has
    another one.
    """
    if previous is None or not np.array_equal(fix.position_m, previous.position_m):
        return SeenPlace(fix.position_m, read_only(track_m), walked_m)
    moved_m = float(np.linalg.norm(track_m - previous.track_m))
    far_m = max(_MIN_MOVED_M, fix.var_m2**0.5, _MOVED_SHARE * (walked_m - previous.walked_m))
    return replace_unchecked(previous, is_frozen=True) if moved_m > far_m else previous


def frozen_fixes(
    fixes: Iterable[PositionFix], time_s: FloatArray, position_m: FloatArray, walked_m: FloatArray
) -> list[bool]:
    """Return, for each fix, True if it repeats a position while steps continue.

    The fixes may be in any order. `time_s` (K,), `position_m` (K, 2) and `walked_m` (K,) are time, position and walked
    distance of the steps of dead reckoning. Without steps all results are False.
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
