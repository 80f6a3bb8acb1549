"""Relocation: decision between a wrong track and wrong fixes if rejected fixes agree with each other.

A single wrong fix is an outlier. Reflections shift several fixes together for some time. A fix that does not move is
frozen. A track that is wrong, after a ride or because of wrong first fixes, stays wrong: later fixes then follow its
shape in another place. There are three hypotheses for the rejected fixes since the last used one:

- The track is wrong. After a shift, or a shift and rotation, the fixes have chi-square c_1.
- The fixes are wrong together and follow the track. This lasts for a time t with probability exp(-t / T).
- The fixes stay in one place, with chi-square c_0.

The first hypothesis is accepted when both odds, exp(t / T) and exp((c_0 - c_1) / 2), exceed its prior odds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from pdr_filter.filter.pedestrian.alignment import Alignment
from pdr_filter.filter.pedestrian.frame_rotation import (
    PairedPoint,
    agreement_limit,
    align,
    least_squares_error,
    spaced_pairs,
)
from pdr_filter.values import FloatArray

# T: a reflection affects a pedestrian for some tens of seconds.
EPISODE_S = 20.0
# Fixes have a common error about every ten minutes in a street. A track is wrong about once in five hours of walking: 1
# of 10 recordings has a ride or a wrong start.
PRIOR_LOG_ODDS = math.log(30.0)
# Time over which rejected fixes must be consistent, for any interval between them.
PATIENCE_S = PRIOR_LOG_ODDS * EPISODE_S
# Largest number of stored rejected fixes. Beyond it they are thinned to even intervals over twice the necessary time.
# The drift of the heading bends the track between older ones.
MAX_REJECTED = 12
# Any two fixes are consistent, or nearly, after a shift and rotation, so three are required.
_MIN_REJECTED = 3


@dataclass(frozen=True, slots=True, eq=False)
class RelocationEvidence:
    """Rejected position fixes that are consistent with each other."""

    pairs: tuple[PairedPoint, ...] = ()  # rejected fixes that are consistent up to a shift and rotation of the track
    rival: tuple[PairedPoint, ...] = ()  # later fixes that are consistent with each other but not with `pairs`
    is_used_last: bool = False  # True if the last fix was used

    def with_moved_track(self, positions: Callable[[FloatArray], FloatArray]) -> RelocationEvidence:
        """Return the evidence with the track positions of its fixes transformed by a function of positions (..., 2)."""
        return replace(
            self,
            pairs=tuple(pair.with_moved_track(positions) for pair in self.pairs),
            rival=tuple(pair.with_moved_track(positions) for pair in self.rival),
        )

    def with_rejected(self, pair: PairedPoint) -> RelocationEvidence:
        """Return the stored rejected fixes after one more rejected fix.

        The fix joins `pairs` if it is consistent with them, else `rival`, else it starts a new rival. A rival of three
        fixes becomes `pairs`, and the former pairs become the rival. A single outlier therefore never removes the
        pairs.
        """
        evidence = replace(self, is_used_last=False)
        if _agree((*self.pairs, pair)):
            return replace(evidence, pairs=_thinned((*self.pairs, pair)))
        rival = _thinned((*self.rival, pair)) if _agree((*self.rival, pair)) else (pair,)
        if len(rival) < _MIN_REJECTED:
            return replace(evidence, rival=rival)
        return replace(evidence, pairs=rival, rival=self.pairs)

    def with_used(self) -> RelocationEvidence:
        """Return the stored rejected fixes after a used fix.

        The result is empty if two fixes in a row were used, or if fewer than three were rejected. Two sources that
        alternate and contradict each other therefore never relocate the track. A single used fix does not remove three
        or more rejected ones.
        """
        if len(self.pairs) < _MIN_REJECTED or self.is_used_last:
            return RelocationEvidence()
        return replace(self, is_used_last=True)

    def explains(self, pair: PairedPoint) -> bool:
        """Return True if one more fix is consistent with two or more rejected ones.

        The fix is then treated as rejected even if the track could explain it.
        """
        return len(self.pairs) > 1 and _agree((*self.pairs, pair))

    def alignment(self, last: PairedPoint, heading_var_rad2: float, n_steps: int, can_turn: bool) -> Alignment | None:
        """Return the alignment by which the rejected fixes relocate the track, or None while the track may be right.

        `last` must be the last rejected fix. The heading of the track is a measurement that the rotation is zero, with
        the variance `heading_var_rad2`. If the fixes contradict this measurement, the rotation is estimated from the
        fixes alone. The estimation requires `can_turn`, which is True if the present rotation of the track was itself
        estimated from fixes. Otherwise the result is None. The last fix is used with half of its information, because
        an update with the other half follows. `n_steps` is the number of steps so far.
        """
        pairs = self.pairs
        if not self._persists(last):
            return None
        # a heading that is known exactly has variance zero
        turn_var = max(heading_var_rad2, 1e-12)
        if least_squares_error(pairs, turn_var) - least_squares_error(pairs) > agreement_limit(1):
            if not can_turn:
                return None
            turn_var = math.inf
        if not self._follows_track(turn_var):
            return None
        return align((*pairs[:-1], replace(pairs[-1], var_m2=2.0 * pairs[-1].var_m2)), n_steps, turn_var)

    def contradicts(self, last: PairedPoint) -> bool:
        """Return True if the last rejected fix shows that a track with unknown rotation must be relocated."""
        return self._persists(last) and self._follows_track(math.inf)

    def _persists(self, last: PairedPoint) -> bool:
        """Return True if `last` and at least two earlier rejected fixes agree over `PATIENCE_S` seconds or more.

        A wrong track is then more probable than a single error that all these fixes share, such as reflected signals.
        """
        if self.pairs[-1] is not last or len(self.pairs) < _MIN_REJECTED:
            return False
        return self.pairs[-1].time_s - self.pairs[0].time_s >= PATIENCE_S

    def _follows_track(self, turn_var: float) -> bool:
        """Return True if fixes that follow the track explain the rejected fixes much better than fixes in one place.

        The likelihood must be at least 30 times as large (`PRIOR_LOG_ODDS`), each with the best shift and rotation.
        """
        staying = tuple(replace(pair, track_m=self.pairs[0].track_m) for pair in self.pairs)
        gained = least_squares_error(staying, turn_var) - least_squares_error(self.pairs, turn_var)
        return gained >= 2.0 * PRIOR_LOG_ODDS


def _thinned(pairs: tuple[PairedPoint, ...]) -> tuple[PairedPoint, ...]:
    """Return at most `MAX_REJECTED` evenly spaced pairs, with the last one, over about twice `PATIENCE_S`."""
    times_s = [pair.time_s for pair in pairs]
    while len(pairs) > _MIN_REJECTED and times_s[-1] - times_s[1] >= 2.0 * PATIENCE_S:
        pairs, times_s = pairs[1:], times_s[1:]
    return spaced_pairs(pairs, MAX_REJECTED)


def _agree(pairs: Sequence[PairedPoint]) -> bool:
    """Return True if all pairs can be correct for a track that is shifted and rotated."""
    return least_squares_error(pairs) <= agreement_limit(2 * len(pairs) - 3)
