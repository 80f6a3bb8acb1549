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
from collections.abc import Sequence
from dataclasses import dataclass, replace

from pdr_filter.filter.alignment import Alignment
from pdr_filter.filter.turn import PairedPoint, agreement_limit, align, least_squares_error

# T: somebody who walks leaves a reflection behind after some tens of seconds.
EPISODE_S = 20.0
# Fixes are off together about every ten minutes in a street, a track about once in five hours of walking: in 1 of 10
# recordings there is a ride, or a wrong start.
LOG_ODDS_BEFORE = math.log(30.0)
# Rejected fixes that are remembered, and how far apart: two minutes of them. Of fixes a second apart a dozen in a row
# would be too short a time to tell anything.
MAX_DOUBTS, _APART_S = 12, 10.0
# Two of them agree whatever they are, or nearly.
_MIN_DOUBTS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """Rejected fixes that agree with each other, and the last one if it does not."""

    pairs: tuple[PairedPoint, ...] = ()
    stray: PairedPoint | None = None

    def moved(self, alignment: Alignment) -> Doubt:
        """With the places of the track moved."""
        stray = None if self.stray is None else self.stray.moved(alignment)
        return Doubt(tuple(pair.moved(alignment) for pair in self.pairs), stray)

    def with_rejected(self, pair: PairedPoint) -> Doubt:
        """With one more: it joins those that it agrees with, or begins anew with the one before."""
        is_soon = len(self.pairs) > 1 and pair.time_s - self.pairs[-2].time_s < _APART_S
        together = (*(self.pairs[:-1] if is_soon else self.pairs), pair)[-MAX_DOUBTS:]
        if _agree(together):
            return Doubt(together)
        if self.stray is not None and _agree((self.stray, pair)):
            return Doubt((self.stray, pair))
        return Doubt(self.pairs if self.stray is None else (), pair)

    def explains(self, pair: PairedPoint) -> bool:
        """Whether one more fix is where two or more of them show it: then it need not be where the track does."""
        return self.stray is None and len(self.pairs) > 1 and _agree((*self.pairs, pair))

    def alignment(self, heading_var_rad2: float, n_steps: int, can_turn: bool) -> Alignment | None:
        """How the track must be shifted and turned, or None as long as it may be right.

        The heading, with its variance, is a measurement of the turn. If that contradicts the fixes, and the turn of the
        track is from fixes too (`can_turn`), it may be any.
        """
        pairs = self.pairs
        if not self._lasts:
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

    @property
    def contradicts(self) -> bool:
        """Whether a track whose turn is open must be shifted."""
        return self._lasts and self._follows(math.inf)

    @property
    def _lasts(self) -> bool:
        """Whether that fixes are off together is less probable than that the track is."""
        if self.stray is not None or len(self.pairs) < _MIN_DOUBTS:
            return False
        return (self.pairs[-1].time_s - self.pairs[0].time_s) / EPISODE_S >= LOG_ODDS_BEFORE

    def _follows(self, turn_var: float) -> bool:
        """Whether that the fixes stay in one place is less probable than that they follow the track."""
        staying = tuple(replace(pair, track_m=self.pairs[0].track_m) for pair in self.pairs)
        gained = least_squares_error(staying, turn_var) - least_squares_error(self.pairs, turn_var)
        return gained >= 2.0 * LOG_ODDS_BEFORE


def _agree(pairs: Sequence[PairedPoint]) -> bool:
    """Whether all of them can be right, for a track that may be shifted and turned."""
    return least_squares_error(pairs) <= agreement_limit(2 * len(pairs) - 3)
