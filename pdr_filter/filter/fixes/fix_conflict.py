"""Position fixes of which many contradict a walk, as fixes with mirrored axes or a wrong accuracy do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.values import FixOutcome, FloatArray

# Smallest number of rejected fixes that make a walk doubtful: two or three fixes have no majority (`frame_rotation`).
_MIN_REJECTED = 4


@dataclass(frozen=True, eq=False)
class FixConflict:
    """Numbers of used and rejected position fixes, and the places at which the rejected ones have the pedestrian.

    If many fixes are rejected, those that fit may do so by chance, such as mirrored fixes of a straight leg, or fixes
    with errors larger than stated. The place of the walk in the frame of the fixes is then doubtful.
    """

    # Numbers of position fixes since the track was last moved to fixes.
    n_used: int = 0
    n_rejected: int = 0
    square_m2: float = 0.0  # sum of the squared distances of the rejected fixes from the track

    def plus(self, outcome: FixOutcome, away_m: FloatArray | None) -> FixConflict:
        """Return the numbers after one more position fix.

        `away_m` (2,) is the position of the fix minus that of the track, or None if the track has no position at its
        time.
        """
        if outcome == "moved":
            return FixConflict()
        if outcome in ("used", "placed", "turned"):
            return FixConflict(self.n_used + 1, self.n_rejected, self.square_m2)
        if outcome != "rejected" or away_m is None:
            return self
        return FixConflict(self.n_used, self.n_rejected + 1, self.square_m2 + float(away_m @ away_m))

    @property
    def is_doubtful(self) -> bool:
        """True if a third of the fixes contradict the walk, apart from two, which fit any walk after a rotation.

        None of the locations of 21 walks of ipin2023 contradicts its walk. Of locations with seven times the stated
        error, four in ten do, because the track follows the others.
        """
        return self.n_rejected > max(0.5 * (self.n_used - 2), _MIN_REJECTED - 1)

    @property
    def cov_m2(self) -> FloatArray:
        """Covariance (2, 2) that the rejected fixes add to that of the position.

        With the share of the rejected fixes as probability, the position is as far away as they are on average. The
        direction is unknown, because rejected fixes with wrong axes are no positions either. The covariance is zero
        unless many fixes are rejected. It is also zero without used fixes, because the track is then in its own frame.
        """
        n = self.n_used + self.n_rejected
        return (self.square_m2 / n if self.is_doubtful and self.n_used else 0.0) * np.eye(2)
