"""Fixes that do not fit the track and agree with each other: when they are right and the track is wrong.

A fix that is off alone is an outlier. Reflections put fixes off together, for a while; a fix that stays where it was
is no fix. But a track that is off, after a ride or from wrong first fixes, stays off: fixes follow its shape from then
on, somewhere else. Three hypotheses for the rejected fixes since the last used one:

- the track is moved by some shift, or shifted and turned: it leaves chi-square c_1 between fixes and track;
- the fixes are off together and follow the track, which lasts for t with probability exp(-t / T);
- the fixes stay in one place: chi-square c_0.

The first wins when both odds, exp(t / T) and exp((c_0 - c_1) / 2), are above those that it has before.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from pdr_filter.filter.fixes.alignment import Alignment
from pdr_filter.filter.fixes.frame_rotation import PairedPoint, agreement_limit, align, least_squares_error, thinned
from pdr_filter.values import FloatArray

# T: a pedestrian leaves a reflection behind after some tens of seconds.
EPISODE_S = 20.0
# Fixes are off together about every ten minutes in a street, a track about once in five hours of walking: in 1 of 10
# recordings there is a ride, or a wrong start.
LOG_ODDS_BEFORE = math.log(30.0)
# Time over which rejected fixes must agree with each other, whatever their interval.
PATIENCE_S = LOG_ODDS_BEFORE * EPISODE_S
# Rejected fixes that are remembered. Of more, those at the most even intervals over twice the necessary time: beyond
# it, the drift of the heading bends the track between them.
MAX_DOUBTS = 12
# Any two of them agree after a rigid shift, or nearly.
_MIN_DOUBTS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """Rejected fixes that agree with each other, and later ones that agree with each other but not with these."""

    pairs: tuple[PairedPoint, ...] = ()
    rival: tuple[PairedPoint, ...] = ()
    is_used_last: bool = False  # True if the track explains the last fix

    def moved(self, positions: Callable[[FloatArray], FloatArray]) -> Doubt:
        """Return the same doubt with the places of the track moved by a function of positions (..., 2)."""
        return replace(
            self,
            pairs=tuple(pair.moved(positions) for pair in self.pairs),
            rival=tuple(pair.moved(positions) for pair in self.rival),
        )

    def with_rejected(self, pair: PairedPoint) -> Doubt:
        """Return the doubt with one more rejected fix.

        The fix joins the pairs if it agrees with them, else the rival, else it starts a new rival. A rival of three
        changes places with the pairs: a fix far from all others never makes the pairs forgotten.
        """
        doubt = replace(self, is_used_last=False)
        if _agree((*self.pairs, pair)):
            return replace(doubt, pairs=_thinned((*self.pairs, pair)))
        rival = _thinned((*self.rival, pair)) if _agree((*self.rival, pair)) else (pair,)
        if len(rival) < _MIN_DOUBTS:
            return replace(doubt, rival=rival)
        return replace(doubt, pairs=rival, rival=self.pairs)

    def with_used(self) -> Doubt:
        """Return the doubt after a used fix: none if two fixes in a row are used, or if few were rejected.

        Of two sources that contradict each other in turn, none moves the track to and fro.
        """
        if len(self.pairs) < _MIN_DOUBTS or self.is_used_last:
            return Doubt()
        return replace(self, is_used_last=True)

    def explains(self, pair: PairedPoint) -> bool:
        """True if one more fix is where two or more of them show it: then it need not be where the track does."""
        return len(self.pairs) > 1 and _agree((*self.pairs, pair))

    def alignment(self, last: PairedPoint, heading_var_rad2: float, n_steps: int, can_turn: bool) -> Alignment | None:
        """How the last rejected fix shows that the track must be shifted and turned; None while it may be right.

        The heading, with its variance, is a measurement of the turn. If that contradicts the fixes, and the turn of the
        track is from fixes too (`can_turn`), it may be any.
        """
        pairs = self.pairs
        if not self._lasts(last):
            return None
        # a heading that is known exactly divides nothing
        turn_var = max(heading_var_rad2, 1e-12)
        if least_squares_error(pairs, turn_var) - least_squares_error(pairs) > agreement_limit(1):
            if not can_turn:
                return None
            turn_var = math.inf
        if not self._follows(turn_var):
            return None
        return align((*pairs[:-1], replace(pairs[-1], var_m2=2.0 * pairs[-1].var_m2)), n_steps, turn_var)

    def contradicts(self, last: PairedPoint) -> bool:
        """True if the last rejected fix shows that a track whose turn is open must be shifted."""
        return self._lasts(last) and self._follows(math.inf)

    def _lasts(self, last: PairedPoint) -> bool:
        """True if that the track is off is more probable than that the fixes up to the last one are off together."""
        if self.pairs[-1] is not last or len(self.pairs) < _MIN_DOUBTS:
            return False
        return self.pairs[-1].time_s - self.pairs[0].time_s >= PATIENCE_S

    def _follows(self, turn_var: float) -> bool:
        """Whether that the fixes stay in one place is less probable than that they follow the track."""
        staying = tuple(replace(pair, track_m=self.pairs[0].track_m) for pair in self.pairs)
        gained = least_squares_error(staying, turn_var) - least_squares_error(self.pairs, turn_var)
        return gained >= 2.0 * LOG_ODDS_BEFORE


def _thinned(pairs: tuple[PairedPoint, ...]) -> tuple[PairedPoint, ...]:
    """At most `MAX_DOUBTS` pairs at the most even intervals, with the last one, over the last times that matter."""
    times_s = [pair.time_s for pair in pairs]
    while len(pairs) > _MIN_DOUBTS and times_s[-1] - times_s[1] >= 2.0 * PATIENCE_S:
        pairs, times_s = pairs[1:], times_s[1:]
    return thinned(pairs, MAX_DOUBTS)


def _agree(pairs: Sequence[PairedPoint]) -> bool:
    """Whether all of them can be right, for a track that may be shifted and turned."""
    return least_squares_error(pairs) <= agreement_limit(2 * len(pairs) - 3)
