"""Fixes that are delivered again, and positions that are frozen.

Receivers and bridges deliver a fix several times, with the same time or with later ones. A repetition has the same
error, so that it contains no information. Apps also report the last position after the loss of GNSS, while the person
walks on.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from pdr_filter.values import Fix, FloatArray, PositionFix, Standstill, measurement_of, read_only, replace_unchecked
from pdr_filter.values.fixes import OWN_FIXES

# Equal values within this time are one measurement. Most receivers measure at least every five seconds, and bridges
# repeat faster. Later equal values, such as a rounded speed or the direction of a corridor, are measured again.
_REPEATED_S = 5.0
# Number of different fixes that are compared with a new one, because several sources or anchors alternate.
_N_RECENT = 16
# Ratio of displacement to walked distance since the position was new, above which a repetition is wrong. A closed walk
# that returns to a surveyed point ends closer to it, unless its heading is wrong by tens of degrees.
_MOVED_SHARE = 0.3
# Smallest such displacement, because one or two steps may be false detections.
_MIN_MOVED_M = 2.0


# A frozen position does not follow the steps. A repeated fix is delivered again.
Repetition = Literal["", "frozen", "repeated"]


@dataclass(frozen=True, eq=False)
class SeenPosition:
    """Last fix position that was not a repetition, and the track at that time."""

    position_m: FloatArray  # (2,) position of the fix
    track_m: FloatArray  # (2,) position of the track at the time of the fix
    walked_m: float  # distance of all steps until then
    is_frozen: bool = False  # True if fixes repeated the position while steps continued
    floor: int | None = None  # storey of the fix. The same position on another storey is not a repetition.


@dataclass(frozen=True, eq=False)
class RecentFix:
    """Fix that was not a repetition."""

    kind: str  # name of the class
    time_s: float  # time of the fix
    # (3,) east, north and heading of the track at which a measurement of a user-defined class was evaluated.
    pose: FloatArray
    values: str  # hash of all values except the times


def recent_after(recent: tuple[RecentFix, ...], fix: Fix, pose: FloatArray) -> tuple[RecentFix, ...]:
    """Return the last different fixes after one more, or `recent` itself if the fix repeats one of them.

    A repetition has equal values within `_REPEATED_S`. `pose` (3,) is east, north and heading of the track at the time
    of the fix. Standstills are never stored, because their repetition changes nothing.
    """
    kind = type(fix).__name__
    near = [other for other in recent if other.kind == kind and abs(fix.time_s - other.time_s) < _REPEATED_S]
    if isinstance(fix, Standstill) or not any(_values(fix, other.pose) == other.values for other in near):
        return (*recent, RecentFix(kind, fix.time_s, read_only(pose), _values(fix, pose)))[-_N_RECENT:]
    return recent


def _values(fix: Fix, pose: FloatArray) -> str:
    """Return a hash of the values of a fix, of its measurement at a pose if its class is user-defined."""
    if isinstance(fix, OWN_FIXES):
        parts = [getattr(fix, f.name) for f in fields(fix) if f.name not in ("time_s", "received_time_s")]
    else:
        parts = measurement_of(fix, pose[:2], float(pose[2]))
    content = b"".join(np.asarray(part, dtype=float).tobytes() for part in parts)
    return hashlib.blake2b(content, digest_size=16).hexdigest()


def seen_after(previous: SeenPosition | None, fix: PositionFix, track_m: FloatArray, walked_m: float) -> SeenPosition:
    """Return the last position that was not a repetition, after one more fix.

    `track_m` (2,) and `walked_m` are the track position and the walked distance at the time of the fix. An exact
    repetition is frozen if dead reckoning has moved by more than 2 m, the standard deviation of the fix, and 30 % of
    the distance walked since. A position stays frozen until a fix has another one. A repetition is new only if the
    person can have returned: dead reckoning has moved by at most 30 % of the distance, which is long enough for a way
    out of that radius and back. Any other repetition leaves `previous` unchanged.
    """
    new = SeenPosition(fix.position_m, read_only(track_m), walked_m, floor=fix.floor)
    if previous is None or fix.floor != previous.floor or not np.array_equal(fix.position_m, previous.position_m):
        return new
    moved_m, since_m = float(np.linalg.norm(track_m - previous.track_m)), walked_m - previous.walked_m
    radius_m, share_m = max(_MIN_MOVED_M, fix.var_m2**0.5), _MOVED_SHARE * since_m
    if moved_m > max(radius_m, share_m):
        return replace_unchecked(previous, is_frozen=True)
    is_return = moved_m <= share_m and since_m >= 2.0 * radius_m and not previous.is_frozen
    return new if is_return else previous


@dataclass(frozen=True, eq=False)
class FixMemory:
    """Earlier fixes with which a new one is compared."""

    seen: SeenPosition | None = None  # last position that was not a repetition
    recent: tuple[RecentFix, ...] = ()  # last fixes of all kinds that were not repetitions

    def plus(self, fix: Fix, pose: FloatArray, walked_m: float) -> tuple[FixMemory, Repetition]:
        """Return the memory after one more fix, and whether the fix is a repetition.

        `pose` (3,) is east, north and heading of the track at the time of the fix, and `walked_m` the walked distance.
        """
        recent, seen = recent_after(self.recent, fix, pose), self.seen
        is_repeated = recent is self.recent
        if isinstance(fix, PositionFix):
            seen = seen_after(self.seen, fix, pose[:2], walked_m)
            is_repeated |= seen is self.seen
            if seen.is_frozen:
                return FixMemory(seen, recent), "frozen"
        return FixMemory(seen, recent), "repeated" if is_repeated else ""

    def with_moved_track(self, positions: Callable[[FloatArray], FloatArray]) -> FixMemory:
        """Return the memory with the track position of `seen` transformed by a function of positions (..., 2)."""
        if self.seen is None:
            return self
        seen = replace_unchecked(self.seen, track_m=read_only(positions(self.seen.track_m)))
        return replace_unchecked(self, seen=seen)

    def after_gap(self) -> FixMemory:
        """Return the memory after a gap, without the last position unless it is frozen."""
        return replace_unchecked(self, seen=self.seen if self.seen and self.seen.is_frozen else None)


def repetitions(
    fixes: Sequence[Fix], time_s: FloatArray, position_m: FloatArray, walked_m: FloatArray
) -> list[Repetition]:
    """Return, for each fix, whether it repeats another one.

    The fixes may be in any order. `time_s` (K,), `position_m` (K, 2) and `walked_m` (K,) are time, position and walked
    distance of the steps of dead reckoning.
    """
    result: list[Repetition] = [""] * len(fixes)
    memory, columns = FixMemory(), (*position_m.T, walked_m) if len(time_s) else ()
    for k in sorted(range(len(fixes)), key=lambda k: fixes[k].time_s):
        pose = np.zeros(4)  # east, north, distance, and a heading of zero
        pose[: len(columns)] = [np.interp(fixes[k].time_s, time_s, column) for column in columns]
        memory, result[k] = memory.plus(fixes[k], pose[[0, 1, 3]], float(pose[2]))
    return result
