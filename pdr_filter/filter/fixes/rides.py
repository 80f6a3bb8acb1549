"""Vehicle rides between position fixes, which the track does not follow."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pdr_filter.values import BoolArray, FloatArray, PositionFix

# Smallest speed of a ride, and largest step rate in it: a walk has more than one step a second, a run more than two.
_RIDE_MPS, _RIDE_STEPS_HZ = 2.5, 0.5
# Shortest interval in which missing steps mean anything: a walk has a step at least every two seconds.
_MIN_RIDE_S = 2.0
# Smallest share of the interval in which there are samples. In a gap nothing shows whether the pedestrian walked.
_MIN_SEEN_SHARE = 0.5
# Ratio of net displacement to travelled distance below which a ride is an outlier.
_OUTLIER_SHARE = 0.25
# Smallest net displacement of a ride in which the phone lies still, as in a train. While a receiver converges, its
# positions move by less, because errors of 100 m are stated as such.
_STILL_RIDE_M = 100.0
_MAX_RIDES = 16  # number of stored rides, because a filter may run for days


@dataclass(frozen=True, slots=True)
class Ride:
    """Interval in which position fixes move faster than a walk and the pedestrian makes hardly any steps."""

    # Times of the first and the last fix
    begin_s: float
    end_s: float
    length_m: float  # sum of the distances between consecutive fixes
    # First and last fix
    first: PositionFix
    last: PositionFix
    is_still: bool  # True if the phone lay still in most of the time

    @property
    def is_outlier(self) -> bool:
        """True if errors of the fixes explain the ride.

        The fixes then moved away and came back, as after a reflection of satellite signals, or moved a short way while
        the phone lay still.
        """
        net_m = float(np.linalg.norm(self.last.position_m - self.first.position_m))
        return net_m < _OUTLIER_SHARE * self.length_m or (self.is_still and net_m < _STILL_RIDE_M)


@dataclass(frozen=True, slots=True)
class Rides:
    """Last rides between position fixes."""

    found: tuple[Ride, ...] = ()  # last rides
    last: PositionFix | None = None  # last fix with another position than the fix before
    # Time with samples since this fix, and the part of it in which the phone moved.
    seen_s: float = 0.0
    moving_s: float = 0.0

    @classmethod
    def of(
        cls, fixes: Iterable[PositionFix], step_time_s: FloatArray, window_time_s: FloatArray, moves: BoolArray
    ) -> Rides:
        """Return the vehicle rides between fixes, given in order of time.

        Steps are given by their times (K,), s. `window_time_s` (W,) are the ends of context windows, and `moves` (W,)
        is True if the phone moved in a window.
        """
        rides, n_before = cls(), 0
        hop_s = float(np.median(np.diff(window_time_s))) if len(window_time_s) > 1 else 0.0
        for fix in fixes:
            n = int(np.searchsorted(window_time_s, fix.time_s, side="right"))
            new = moves[n_before:n]
            n_before = max(n, n_before)
            rides = rides.with_windows(hop_s * len(new), hop_s * float(new.sum())).plus(fix, step_time_s)
        return rides

    def with_windows(self, seen_s: float, moving_s: float) -> Rides:
        """Return the rides after more time with samples, of which `moving_s` with a moving phone."""
        return Rides(self.found, self.last, self.seen_s + seen_s, self.moving_s + moving_s)

    def plus(self, fix: PositionFix, step_time_s: FloatArray) -> Rides:
        """Return the vehicle rides with one more fix. Steps are given by their times (K,), s.

        A fast interval with samples and hardly any steps begins a ride, or extends the ride that ends at the last fix.
        It must be longer than three standard deviations. A fix that repeats the last position, or that is not at least
        two seconds later, is ignored. Only the last `_MAX_RIDES` rides are kept.
        """
        previous = self.last
        if previous is None:
            return Rides((), fix)
        duration_s = fix.time_s - previous.time_s
        length_m = float(np.linalg.norm(fix.position_m - previous.position_m))
        if duration_s < _MIN_RIDE_S or length_m == 0.0:
            return self
        n_steps = np.count_nonzero((step_time_s > previous.time_s) & (step_time_s <= fix.time_s))
        is_sure = length_m > 3 * math.sqrt(previous.var_m2 + fix.var_m2) and self.seen_s >= _MIN_SEEN_SHARE * duration_s
        if not is_sure or length_m < _RIDE_MPS * duration_s or n_steps > _RIDE_STEPS_HZ * duration_s:
            return Rides(self.found, fix)
        is_still = self.moving_s < 0.5 * self.seen_s
        if self.found and self.found[-1].end_s == previous.time_s:
            ride = self.found[-1]
            is_still &= ride.is_still
            ride = Ride(ride.begin_s, fix.time_s, ride.length_m + length_m, ride.first, fix, is_still)
            return Rides((*self.found[:-1], ride), fix)
        ride = Ride(previous.time_s, fix.time_s, length_m, previous, fix, is_still)
        return Rides((*self.found, ride)[-_MAX_RIDES:], fix)
