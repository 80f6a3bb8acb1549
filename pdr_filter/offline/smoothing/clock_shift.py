"""Shift between the clock of fixes and that of the samples, as an unknown of the smoother.

The times of locations often come from another clock than those of the samples: GPS time is 18 s ahead of UTC, and
watches and tables that are logged separately differ by seconds. All observations of one source are then late or early
by one shift. Its prior is a mixture: zero, or, with the probability `_SHIFTED_PROB`, normal with the standard deviation
`_SHIFT_STD_S`. A walk with turns determines the shift to a second or two. On a straight walk it looks like another
start, and the prior alone makes its positions uncertain by the distance walked in sqrt(`_SHIFTED_PROB`) `_SHIFT_STD_S`
= 1.4 s, about 2 m. A rest before or after the walk decreases or increases this. Observations from before the first
sample or after the last one show another clock on a straight walk, too (`ShiftPrior.of`).

Let F(d) be the least sum of squares of the walk whose observations are earlier by d, F its minimum at D, G = F(0) - F
and I half of its second derivative there. With the prior mean p of a shift and its prior information q = 1 / s^2, a
shift has the posterior variance 1 / (I + q), the mean (I D + q p) / (I + q), and the Bayes factor
sqrt(q / (I + q)) exp((G - (D - p)^2 I q / (I + q)) / 2) against zero (Laplace).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pdr_filter.values import FloatArray

# Assumed share of sources with another clock, and standard deviation of their shifts in s, which covers 18 s.
_SHIFTED_PROB, _SHIFT_STD_S = 0.02, 10.0
# Probability of another clock if observations come from outside the samples, by more than a second and less than three
# standard deviations of a shift. In 20 of 20 recordings of ipin2023 all locations lie within the samples. A receiver
# that runs longer than the samples and another clock are then assumed to be equally probable.
_SHIFTED_PROB_OUTSIDE, _OUTSIDE_S, _MOST_OUTSIDE_S = 0.5, 1.0, 3.0 * _SHIFT_STD_S
# Smallest odds at which a shift is applied, so that one in a hundred is false, and smallest shift in s: that of a phone
# that rounds times to seconds.
_ODDS, _MIN_SHIFT_S = 100.0, 1.0
# Root mean square error of a shift of zero in s, from which on the possible shift is named.
_NAMED_SHIFT_S = 5.0
# The shift is searched for above these odds, predicted at zero, and if observations are rejected. The search starts at
# zero or the best of these shifts, in s, because F has other minima where many observations are rejected.
_POSSIBLE_ODDS, _STARTS_S = 0.01, (-20.0, -10.0, 10.0, 20.0)
# Largest change of the shift in one iteration of Gauss-Newton, the change at which it ends, in s, and their number.
_MAX_CHANGE_S, _SMALL_CHANGE_S, _MOST_SOLUTIONS = 10.0, 0.2, 10


class ShiftPrior(NamedTuple):
    """Prior of a shift in s: zero, or with a probability `prob` normal with `mean_s` and `std_s` between two limits."""

    prob: float = _SHIFTED_PROB
    mean_s: float = 0.0
    std_s: float = _SHIFT_STD_S
    least_s: float = -np.inf
    most_s: float = np.inf

    @classmethod
    def of(cls, time_s: FloatArray, start_s: float, end_s: float) -> ShiftPrior:
        """Return the prior of the shift of observations at these times (F,), for samples from `start_s` to `end_s`.

        On the right clock, observations lie within the samples, but for one that may be older. Observations outside the
        samples probably have another clock. Shifted, they begin or end with the samples, to one interval.
        """
        ordered_s = np.sort(time_s)
        half_s = 0.5 * float(np.median(np.diff(ordered_s)))
        least_s = float(ordered_s[-1]) - end_s - _OUTSIDE_S
        most_s = float(ordered_s[1]) - start_s + _OUTSIDE_S
        for outside_s, sign in ((least_s, 1.0), (-most_s, -1.0)):
            if least_s < most_s and 0.0 < outside_s < _MOST_OUTSIDE_S:
                mean_s = sign * (outside_s + _OUTSIDE_S + half_s)
                return cls(_SHIFTED_PROB_OUTSIDE, mean_s, _OUTSIDE_S + half_s, least_s, most_s)
        return cls(least_s=min(least_s, 0.0), most_s=max(most_s, 0.0))

    def limited(self, shift_s: float) -> float:
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

    @property
    def gain(self) -> float:
        """Decrease of the sum of squares to the minimum of the parabola."""
        return -self.slope * self.remaining_s


class ClockShift(NamedTuple):
    """Shift of the clock of fixes against that of the samples.

    Attributes
    ----------
    late_s : float
        Applied shift in s, positive if the times of the fixes are late. Zero unless the walk determines a shift.
    var_s2 : float
        Mean square error in s^2 of the applied shift. Zero if it does not matter.
    probable_s : float
        Shift in s that explains a root mean square error of more than 5 s, and was not applied. Zero if there is none.
    """

    late_s: float = 0.0
    var_s2: float = 0.0
    probable_s: float = 0.0

    def notes(self, what: str) -> tuple[str, ...]:
        """Return a note on the shift of observations named `what`, or nothing if none is probable."""
        shift_s = self.late_s or self.probable_s
        if not shift_s:
            return ()
        late = f"{abs(shift_s):.1f} s {'late' if shift_s > 0 else 'early'} on the clock of the samples"
        cause = "their times are probably of another clock, as GPS time is 18 s ahead of UTC; put both on one clock"
        if not self.late_s:
            unsure = "were not shifted, because a walk without clear turns hardly shows this"
            return (f"the {what} are perhaps {late} and {unsure}; positions are uncertain along the walk: {cause}",)
        return (f"the {what} are {late} (± {self.var_s2**0.5:.1f} s), and were shifted: {cause}",)


def estimated_shift(at: Callable[[float], ShiftedWalk], prior: ShiftPrior) -> ClockShift:
    """Return the shift of a source, given a function of the shift in s by which its observations are late."""
    zero = at(0.0)
    found = [_posterior(zero.gain, zero.remaining_s, zero.information, prior)]
    # the parabola at zero says nothing about shifts that are far away, as of observations outside the samples
    if found[0][0] > _POSSIBLE_ODDS or zero.is_rejecting or prior.limited(0.0) != 0.0:
        possible = {prior.limited(late_s) for late_s in (0.0, *_STARTS_S)}
        starts = {late_s: at(late_s) if late_s else zero for late_s in possible}
        late_s, walk = min(starts.items(), key=lambda start: start[1].squares)
        change_s = walk.remaining_s
        for _ in range(_MOST_SOLUTIONS):
            change_s = prior.limited(late_s + float(np.clip(change_s, -_MAX_CHANGE_S, _MAX_CHANGE_S))) - late_s
            if abs(change_s) < _SMALL_CHANGE_S:
                break
            new = at(late_s + change_s)
            if new.squares < walk.squares:
                late_s, walk, change_s = late_s + change_s, new, new.remaining_s
            else:
                change_s *= 0.5
        found.append(_posterior(zero.squares - walk.squares, late_s, walk.information, prior))
    odds, mean_s, var_s2 = found[-1]
    if odds > _ODDS and abs(mean_s) > _MIN_SHIFT_S:
        return ClockShift(mean_s, var_s2)
    # The search may miss the shift that the parabola shows. The larger of both errors is used.
    limit_s2 = max(prior.least_s**2, prior.most_s**2)
    error_s2, mean_s = max((odds / (1.0 + odds) * min(m**2 + v, limit_s2), m) for odds, m, v in found)
    if error_s2 < _MIN_SHIFT_S**2:
        return ClockShift()
    return ClockShift(0.0, error_s2, mean_s if error_s2 > _NAMED_SHIFT_S**2 else 0.0)


def _posterior(gain: float, best_s: float, information: float, prior: ShiftPrior) -> tuple[float, float, float]:
    """Return the posterior odds of a shift against zero, and its mean in s and variance in s^2.

    `gain` is the decrease of the sum of squares from zero to its minimum at `best_s`.
    """
    q = prior.std_s**-2
    var_s2 = 1.0 / (information + q)
    mean_s = (information * best_s + q * prior.mean_s) * var_s2
    contradiction = q * information * var_s2 * (best_s - prior.mean_s) ** 2
    log_factor = 0.5 * (gain - contradiction + np.log(q * var_s2))
    odds = prior.prob / (1.0 - prior.prob) * float(np.exp(min(log_factor, 100.0)))
    return odds, mean_s, var_s2
