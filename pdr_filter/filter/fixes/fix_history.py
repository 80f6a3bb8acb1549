"""Earlier fixes of a track, as far as the next fix depends on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from pdr_filter.filter.fixes.range_placement import PairedRange
from pdr_filter.filter.fixes.relocation import Doubt
from pdr_filter.filter.fixes.repeated_fixes import SeenPlace
from pdr_filter.values import N_BEFORE, FloatArray, PositionFix, Standstill, read_only, replace_unchecked

MAX_STANDSTILLS = 16


@dataclass(frozen=True, eq=False)
class UsedFix:
    """A used position fix with a correlated error, and where the track was then; None if a gap followed it."""

    fix: PositionFix
    track_m: FloatArray | None  # (2,)


@dataclass(frozen=True, eq=False)
class FixHistory:
    """Earlier fixes: for gating, for correlated errors and for repetitions."""

    doubt: Doubt = field(default_factory=Doubt)  # position fixes that the track does not explain
    used: tuple[UsedFix, ...] = ()  # the last ones whose errors the next one shares
    seen: SeenPlace | None = None  # the last new position
    n_errors: int = 0  # innovations of used position fixes, one an axis
    squares: float = 0.0  # sum of their normalised squares
    n_frozen: int = 0  # positions that were repeated while steps went on
    standstills: tuple[tuple[float, float], ...] = ()  # begin and end of the last ones
    ranges: tuple[PairedRange, ...] = ()  # the last ones
    searched_s: float = -math.inf  # when places that fit them were searched

    def with_used(self, fix: PositionFix, track_m: FloatArray | None) -> FixHistory:
        """Return the history with one more used fix, if later ones may share its error."""
        if fix.correlation_s == 0:
            return self
        # ways that a gap has hidden stay hidden: after it the first fix counts as one more of those before
        since_gap = tuple(used for used in self.used if used.track_m is not None)
        used = UsedFix(fix, None if track_m is None else read_only(track_m))
        return replace_unchecked(self, used=(*since_gap, used)[-N_BEFORE:])

    def with_standstill(self, standstill: Standstill) -> FixHistory:
        """Return the history with one more standstill."""
        standstills = (*self.standstills, (standstill.time_s, standstill.end_s))[-MAX_STANDSTILLS:]
        return replace_unchecked(self, standstills=standstills)

    def is_standing(self, time_s: float) -> bool:
        """True if a standstill covers this time."""
        return any(begin_s <= time_s <= end_s for begin_s, end_s in self.standstills)

    def moved(self, positions: Callable[[FloatArray], FloatArray]) -> FixHistory:
        """Return the history with the places of the track moved by a function of positions (..., 2)."""
        used = (
            u if u.track_m is None else replace_unchecked(u, track_m=read_only(positions(u.track_m))) for u in self.used
        )
        seen = (
            None if self.seen is None else replace_unchecked(self.seen, track_m=read_only(positions(self.seen.track_m)))
        )
        doubt, ranges = self.doubt.moved(positions), tuple(pair.moved(positions) for pair in self.ranges)
        return replace_unchecked(self, doubt=doubt, used=tuple(used), seen=seen, ranges=ranges)

    def after_gap(self) -> FixHistory:
        """Return the history after a time without samples, in which the pedestrian may have gone anywhere."""
        used = tuple(replace_unchecked(u, track_m=None) for u in self.used)
        seen = self.seen if self.seen and self.seen.is_frozen else None
        return replace_unchecked(self, used=used, seen=seen, ranges=())
