"""Shift between the clock of fixes and that of the samples, as an unknown of the smoother.

The times of locations often come from another clock than those of the samples: GPS time is 18 s ahead of UTC, and
watches and tables that are logged separately differ by seconds. All observations of one source are then late or early
by one shift. Its prior is a mixture: zero, or, with the probability `_SHIFTED_PROB`, normal with the standard deviation
`_SHIFT_STD_S`. A walk with turns determines the shift to a second or two. On a straight walk it looks like another
start, and the prior alone makes its positions uncertain by the distance walked in sqrt(`_SHIFTED_PROB`) `_SHIFT_STD_S`:
about 2 m with locations and 4 m with fixes. A rest before or after the walk, and the start and end of the samples,
decrease or increase this. Observations from before the first sample or after the last one show another clock on a
straight walk, too (`ShiftPrior.of`).

Let F(d) be the least sum of squares of the walk whose observations are earlier by d. Its posterior is the prior times
exp(-F(d) / 2). F is known with its derivatives at some shifts. Between them, it is the parabola of the nearest one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from pdr_filter.offline.smoothing.observations import Source
from pdr_filter.values import FloatArray, PositionFix

# Assumed share of sources with another clock. Locations are recorded by the phone itself: none of 20 recordings of
# ipin2023 has another clock. Fixes are often logged by another device. On a straight walk no data show this, and late
# fixes stay too certain: in simulated walks of 80 m with fixes of 0.5 m that are 3 s late, the end is 5 standard
# deviations off with a share of 0.02, and 2.8 with 0.1, which makes right ones wider by 0.3 m.
_SHIFTED_PROB: dict[Source, float] = {"locations": 0.02, "fixes": 0.1}
# Standard deviation of the shifts in s, which covers 18 s.
_SHIFT_STD_S = 10.0
# Probability of another clock if observations come from outside the samples, by more than a second and less than 30 s.
# In 20 of 20 recordings of ipin2023 all locations lie within the samples. A receiver that runs longer than the samples,
# or gives an old location, and another clock are then assumed to be equally probable.
_SHIFTED_PROB_OUTSIDE, _OUTSIDE_S, _MOST_OUTSIDE_S = 0.5, 1.0, 30.0
# Walking speed in m/s, with which the position becomes unknown before the first and after the last sample.
_SPEED_MPS = 1.4
# Time in s that receivers may take to their first location, after the first sample.
_RECEIVER_START_S = 10.0
# Smallest odds at which a shift is applied, so that one in a hundred is false, and smallest shift in s: that of a phone
# that rounds times to seconds.
_ODDS, _MIN_SHIFT_S = 100.0, 1.0
# Root mean square error of a shift of zero in s, from which on it is part of the covariance (0.4 m of walking), and
# from which on the possible shift is named.
_LEAST_ERROR_S, _NAMED_SHIFT_S = 0.3, 5.0
# The parabola of F at zero suffices if its standard deviation is below 0.5 s, and the odds of a shift are below the
# first number. Otherwise F, which has other minima, is computed at the shifts _STARTS_S, and the best is improved.
_POSSIBLE_ODDS, _SURE_INFORMATION, _STARTS_S = 0.01, 4.0, (-20.0, -10.0, 10.0, 20.0)
# Largest change of the shift in one iteration of Gauss-Newton, the change at which it ends, in s, and their number.
_MAX_CHANGE_S, _SMALL_CHANGE_S, _MOST_SOLUTIONS = 10.0, 0.2, 6
# Shifts in s at which the posterior is computed, up to six standard deviations of the prior.
_GRID_S = np.linspace(-60.0, 60.0, 1201)


class ShiftPrior(NamedTuple):
    """Prior of a shift in s between two limits: zero, or, with a probability `prob`, one of some normal densities.

    The densities have the means `mean_s` and the standard deviations `std_s`, and equal probabilities.
    """

    prob: float
    mean_s: FloatArray | float = 0.0
    std_s: FloatArray | float = _SHIFT_STD_S
    least_s: float = -np.inf
    most_s: float = np.inf

    @classmethod
    def of(cls, source: Source, fixes: Sequence[PositionFix], start_s: float, end_s: float) -> ShiftPrior:
        """Return the prior of the shift of the position fixes of a source, for samples from `start_s` to `end_s`.

        On the right clock, observations lie within the samples, but for much older ones. Observations outside the
        samples probably have another clock. Shifted, they begin or end with the samples, to one interval or to the time
        that a receiver takes to start. Each of them is then explained by the walk to its standard deviation. On the
        right clock it is only within walking distance of its neighbour, so that its density is smaller.
        """
        fixes = sorted((f for f in fixes if f.time_s > start_s - _MOST_OUTSIDE_S), key=lambda fix: fix.time_s)
        if len(fixes) < 2:
            return cls(_SHIFTED_PROB[source])
        ordered_s = np.array([fix.time_s for fix in fixes])
        half_s = 0.5 * float(np.median(np.diff(ordered_s)))
        least_s = float(ordered_s[-1]) - end_s - _OUTSIDE_S
        most_s = float(ordered_s[0]) - start_s + _OUTSIDE_S
        for outside_s, sign in ((least_s, 1.0), (-most_s, -1.0)):
            if least_s < most_s and 0.0 < outside_s < _MOST_OUTSIDE_S:
                away_s = np.clip(np.maximum(start_s - ordered_s, ordered_s - end_s), 0.0, 2.0 * half_s)
                wider = 1.0 + (_SPEED_MPS * away_s) ** 2 / np.array([fix.var_m2 for fix in fixes])
                right = (1.0 / _SHIFTED_PROB_OUTSIDE - 1.0) / float(np.prod(wider))
                inside_s = np.array([_OUTSIDE_S + half_s, _RECEIVER_START_S])
                return cls(1.0 / (1.0 + right), sign * (outside_s + inside_s), inside_s, least_s, most_s)
        return cls(_SHIFTED_PROB[source], least_s=min(least_s, 0.0), most_s=max(most_s, 0.0))

    def density(self, shift_s: FloatArray) -> FloatArray:
        """Return the density (N,) in 1/s of shifts (N,), without the probability of zero."""
        away = np.asarray((shift_s[:, None] - self.mean_s) / self.std_s)
        inside = (shift_s >= self.least_s) & (shift_s <= self.most_s)
        return self.prob * inside * (np.exp(-0.5 * away**2) / (np.sqrt(2.0 * np.pi) * self.std_s)).mean(axis=1)

    def nearest_possible(self, shift_s: float) -> float:
        """Return the possible shift that is nearest to a shift."""
        return min(max(shift_s, self.least_s), self.most_s)


class ShiftedWalk(NamedTuple):
    """Least sum of squares of a walk with shifted observations, and its derivatives by a further shift.

    `slope` is half of the first derivative in 1/s, and `information` half of the second one in 1/s^2. `is_rejecting` is
    True if the walk contradicts some of the observations.
    """

    squares: float
    slope: float
    information: float
    is_rejecting: bool = False

    @property
    def remaining_s(self) -> float:
        """Further shift in s at the minimum of the parabola with these derivatives."""
        return -self.slope / self.information if self.information > 0 else 0.0


class ClockShift(NamedTuple):
    """Shift of the clock of fixes against that of the samples."""

    # applied shift in s, positive if the times of the fixes are late. Zero unless the walk determines a shift.
    late_s: float = 0.0
    var_s2: float = 0.0  # mean square error in s^2 of the applied shift. Zero if it does not matter.
    # shift in s that explains a root mean square error of more than 5 s, and was not applied. Zero if there is none.
    probable_s: float = 0.0

    def notes(self, what: str) -> tuple[str, ...]:
        """Return a note on the shift of observations named `what`, or nothing if none is probable."""
        shift_s = self.late_s or self.probable_s
        if not shift_s:
            return ()
        late = f"{abs(shift_s):.1f} s {'late' if shift_s > 0 else 'early'} on the clock of the samples"
        cause = "their times are probably of another clock, as GPS time is 18 s ahead of UTC; put both on one clock"
        if not self.late_s:
            unsure = "were not shifted, because this walk hardly shows it; its positions are uncertain by the shift"
            return (f"the {what} are perhaps {late}, and {unsure}: {cause}",)
        return (f"the {what} are {late} (± {self.var_s2**0.5:.1f} s), and were shifted: {cause}",)


def estimated_shift(at: Callable[[float], ShiftedWalk], prior: ShiftPrior) -> ClockShift:
    """Return the shift of a source, given a function of the shift in s by which its observations are late."""
    walks = {0.0: at(0.0)}
    zero = walks[0.0]
    is_determined = zero.information > _SURE_INFORMATION and _posterior(walks, prior)[0] < _POSSIBLE_ODDS
    if not is_determined or zero.is_rejecting or prior.nearest_possible(0.0) != 0.0:
        possible = {prior.nearest_possible(late_s) for late_s in (0.0, *_STARTS_S)}
        walks |= {late_s: at(late_s) for late_s in sorted(possible - {0.0})}
        late_s = min(possible, key=lambda late_s: walks[late_s].squares)
        change_s = walks[late_s].remaining_s
        for _ in range(_MOST_SOLUTIONS):
            change_s = prior.nearest_possible(late_s + float(np.clip(change_s, -_MAX_CHANGE_S, _MAX_CHANGE_S))) - late_s
            if abs(change_s) < _SMALL_CHANGE_S:
                break
            new_s = late_s + change_s
            walks[new_s] = at(new_s)
            if walks[new_s].squares < walks[late_s].squares:
                late_s, change_s = new_s, walks[new_s].remaining_s
            else:
                change_s *= 0.5
    odds, mean_s, var_s2 = _posterior(walks, prior)
    if odds > _ODDS and abs(mean_s) > _MIN_SHIFT_S:
        return ClockShift(mean_s, var_s2)
    # The other shifts may miss one that the parabola at zero shows. The larger of both errors is used.
    both = (odds, mean_s, var_s2), _posterior({0.0: zero}, prior)
    error_s2, mean_s = max((odds / (1.0 + odds) * (mean_s**2 + var_s2), mean_s) for odds, mean_s, var_s2 in both)
    if error_s2 < _LEAST_ERROR_S**2:
        return ClockShift()
    return ClockShift(0.0, error_s2, mean_s if error_s2 > _NAMED_SHIFT_S**2 else 0.0)


def _posterior(walks: dict[float, ShiftedWalk], prior: ShiftPrior) -> tuple[float, float, float]:
    """Return the posterior odds of a shift against zero, and its mean in s and variance in s^2.

    `walks` are walks with shifted observations, by their shifts.
    """
    at_s = np.array(list(walks))
    nearest = np.abs(_GRID_S[:, None] - at_s).argmin(axis=1)
    squares, slope, information, _ = np.array(list(walks.values())).T[:, nearest]
    ahead_s = _GRID_S - at_s[nearest]
    squares = squares + (2.0 * slope + information * ahead_s) * ahead_s - walks[0.0].squares
    weight = prior.density(_GRID_S) * np.exp(np.minimum(-0.5 * squares, 300.0)) * (_GRID_S[1] - _GRID_S[0])
    total = float(weight.sum())
    if total == 0.0:
        return 0.0, 0.0, 0.0
    mean_s = float(weight @ _GRID_S) / total
    return total / max(1.0 - prior.prob, 1e-300), mean_s, float(weight @ (_GRID_S - mean_s) ** 2) / total
