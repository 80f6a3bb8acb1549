"""How well steps were found: counts against counts, and times against times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.values import FloatArray, IntArray, check_array


def count_error_percent(n_found: ArrayLike, n_true: ArrayLike) -> FloatArray:
    """100 (n_found - n_true) / n_true, same shape as the counts: positive where too many were found.

    >>> float(count_error_percent(98, 100))
    -2.0
    """
    true = np.asarray(n_true, dtype=float)
    check_array("n_true", true, "positive", remedy="the error is relative to it")
    return np.asarray(100.0 * (np.asarray(n_found, dtype=float) - true) / true)


def matched_steps(true_s: FloatArray, found_s: FloatArray, tolerance_s: float) -> IntArray:
    """One-to-one matches within the tolerance, (M, 2): index of the true step, index of the found one, in time order.

    As many as there can be: for points on a line and one tolerance, taking the earliest pair that fits is optimal.
    True (N,) and found times (K,) ascend; a distance of just the tolerance is a match.
    """
    if not tolerance_s >= 0:
        raise ValueError(f"tolerance_s must be 0 or more, got {tolerance_s}")
    for name, times in (("true_s", true_s), ("found_s", found_s)):
        if np.isnan(times).any() or not (np.diff(times) >= 0).all():
            raise ValueError(f"{name} must be ascending and known: sort it, and leave out NaN")
    pairs: list[tuple[int, int]] = []
    i = j = 0
    while i < len(true_s) and j < len(found_s):
        if abs(found_s[j] - true_s[i]) <= tolerance_s:
            pairs.append((i, j))
            i, j = i + 1, j + 1
        elif found_s[j] < true_s[i]:
            j += 1
        else:
            i += 1
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


@dataclass(frozen=True, slots=True)
class StepScores:
    """Counts of matched steps and what follows from them; NaN where a share is of nothing."""

    n_true: int
    n_found: int
    n_matched: int

    @property
    def detection_prob(self) -> float:
        """Share of the true steps that were found (recall; P_det of Susi et al. 2013, Table 2)."""
        return self.n_matched / self.n_true if self.n_true else np.nan

    @property
    def miss_prob(self) -> float:
        """Share of the true steps that were not found, 1 - detection (P_md of Susi et al. 2013)."""
        return 1.0 - self.detection_prob

    @property
    def false_alarm_prob(self) -> float:
        """Share of the found steps that were none, 1 - precision.

        P_fa of Susi et al. 2013, Table 2, is "the percentage of incorrectly identified samples", without saying of
        what. Of the found ones is the reading that is never above one.
        """
        return 1.0 - self.n_matched / self.n_found if self.n_found else np.nan

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall, 2 matched / (true + found)."""
        total = self.n_true + self.n_found
        return 2.0 * self.n_matched / total if total else np.nan

    @property
    def count_error_percent(self) -> float:
        """Of the counts: false steps make up for missed ones."""
        return float(count_error_percent(self.n_found, self.n_true)) if self.n_true else np.nan


def step_scores(true_s: FloatArray, found_s: FloatArray, tolerance_s: float = 0.25) -> StepScores:
    """Scores of found step times (K,) against true ones (N,), one-to-one within the tolerance."""
    return StepScores(len(true_s), len(found_s), len(matched_steps(true_s, found_s, tolerance_s)))


def f1_score(true_s: FloatArray, found_s: FloatArray, tolerance_s: float = 0.25) -> float:
    """F1 of one-to-one matches: 2 matched / (true + found)."""
    return step_scores(true_s, found_s, tolerance_s).f1


# From -0.4 to 0.4 s: more than a contact at the phone differs from one at a foot switch, less than a step.
OFFSETS_S = np.linspace(-0.4, 0.4, 41)


def best_offset_s(
    true_s: FloatArray, found_s: FloatArray, tolerance_s: float = 0.25, offsets_s: FloatArray = OFFSETS_S
) -> float:
    """Constant that, added to the found times, gives the highest F1; of equal ones the smallest.

    For detectors that mark another instant of the step than the reference does. It is fitted: report the F1 with it as
    such.
    """
    smallest_first = sorted((float(o) for o in offsets_s), key=abs)
    return max(smallest_first, key=lambda offset_s: f1_score(true_s, found_s + offset_s, tolerance_s))
