"""Evaluation of step detectors: step counts and step times against the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.values import FloatArray, IntArray, check_array


def count_error_percent(n_found: ArrayLike, n_true: ArrayLike) -> FloatArray:
    """Return the relative error of step counts in per cent. A positive error means too many steps.

    Parameters
    ----------
    n_found, n_true : array_like
        Detected step counts, and true ones, which are positive.

    Returns
    -------
    ndarray
        100 (n_found - n_true) / n_true, with the broadcast shape of the arguments.

    Raises
    ------
    ValueError
        If a true count is not positive.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> float(pdr.evaluate.count_error_percent(98, 100))
    -2.0
    """
    true = np.asarray(n_true, dtype=float)
    check_array("n_true", true, "positive", remedy="the error is relative to it")
    return np.asarray(100.0 * (np.asarray(n_found, dtype=float) - true) / true)


def matched_steps(true_s: FloatArray, found_s: FloatArray, tolerance_s: float) -> IntArray:
    """Return one-to-one matches of true and detected steps.

    Parameters
    ----------
    true_s, found_s : ndarray of shape (N,) and (K,)
        True and detected step times in s, ascending.
    tolerance_s : float
        Largest difference of matched times in s, inclusive.

    Returns
    -------
    ndarray of int, shape (M, 2)
        Index of the true step and index of the detected step of each match, in time order.

    Raises
    ------
    ValueError
        If times are not ascending or NaN, or if the tolerance is negative.

    Notes
    -----
    The number of matches is maximal. For points on a line and a single tolerance, matching the earliest possible pair
    is optimal.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> true_s, found_s = np.array([1.0, 1.5, 2.0]), np.array([1.1, 2.05, 2.6])
    >>> pdr.evaluate.matched_steps(true_s, found_s, 0.25).tolist()
    [[0, 0], [2, 1]]
    """
    if not tolerance_s >= 0:
        raise ValueError(f"tolerance_s must be 0 or more, got {tolerance_s}")
    for name, times in (("true_s", true_s), ("found_s", found_s)):
        if np.isnan(times).any() or not (np.diff(times) >= 0).all():
            raise ValueError(f"{name} must be ascending without NaN: sort the times, and remove NaN")
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
    """Counts of true, detected and matched steps, with the scores that follow. Undefined scores are NaN.

    Attributes
    ----------
    n_true, n_found, n_matched : int
        Numbers of true steps, of detected steps and of one-to-one matches.

    Examples
    --------
    >>> from pdr_filter.evaluate import StepScores
    >>> StepScores(n_true=100, n_found=98, n_matched=97).detection_prob
    0.97
    """

    n_true: int
    n_found: int
    n_matched: int

    @property
    def detection_prob(self) -> float:
        """Share of the true steps that were detected (recall; P_det of Susi et al. 2013, Table 2)."""
        return self.n_matched / self.n_true if self.n_true else np.nan

    @property
    def miss_prob(self) -> float:
        """Share of the true steps that were missed, 1 - `detection_prob` (P_md of Susi et al. 2013)."""
        return 1.0 - self.detection_prob

    @property
    def false_alarm_prob(self) -> float:
        """Share of the detected steps that are false, 1 - precision.

        P_fa of Susi et al. 2013, Table 2, is "the percentage of incorrectly identified samples" without a stated
        denominator. The number of detected steps is the denominator for which P_fa never exceeds one.
        """
        return 1.0 - self.n_matched / self.n_found if self.n_found else np.nan

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall, 2 matched / (true + found)."""
        total = self.n_true + self.n_found
        return 2.0 * self.n_matched / total if total else np.nan

    @property
    def count_error_percent(self) -> float:
        """Relative error of the step count in per cent, in which false steps cancel missed steps."""
        return float(count_error_percent(self.n_found, self.n_true)) if self.n_true else np.nan


def step_scores(true_s: FloatArray, found_s: FloatArray, tolerance_s: float = 0.25) -> StepScores:
    """Return the scores of detected step times against true step times.

    Parameters
    ----------
    true_s, found_s : ndarray
        True and detected step times in s.
    tolerance_s : float, default 0.25
        Largest difference of matched times in s.

    Returns
    -------
    StepScores
        Counts of true, detected and one-to-one matched steps, and scores.

    Raises
    ------
    ValueError
        If times are not ascending or NaN, or if the tolerance is negative.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> true_s, found_s = np.array([1.0, 1.5, 2.0]), np.array([1.1, 2.05, 2.6])
    >>> pdr.evaluate.step_scores(true_s, found_s)
    StepScores(n_true=3, n_found=3, n_matched=2)
    """
    return StepScores(len(true_s), len(found_s), len(matched_steps(true_s, found_s, tolerance_s)))


def f1_score(true_s: FloatArray, found_s: FloatArray, tolerance_s: float = 0.25) -> float:
    """Return the F1 score of detected step times, 2 matched / (true + found).

    Parameters
    ----------
    true_s, found_s : ndarray
        True and detected step times in s.
    tolerance_s : float, default 0.25
        Largest difference of matched times in s.

    Returns
    -------
    float
        Harmonic mean of precision and recall, 0 to 1; NaN without any steps.

    Raises
    ------
    ValueError
        If times are not ascending or NaN, or if the tolerance is negative.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> true_s, found_s = np.array([1.0, 1.5, 2.0]), np.array([1.1, 2.05, 2.6])
    >>> round(pdr.evaluate.f1_score(true_s, found_s), 3)
    0.667
    """
    return step_scores(true_s, found_s, tolerance_s).f1


# Offsets up to 0.4 s exceed the difference between a contact at the phone and at a foot switch, but are less than a
# step.
OFFSETS_S = np.linspace(-0.4, 0.4, 41)


def best_offset_s(
    true_s: FloatArray, found_s: FloatArray, tolerance_s: float = 0.25, offsets_s: FloatArray = OFFSETS_S
) -> float:
    """Return the constant time offset of detected steps that maximises the F1 score.

    Parameters
    ----------
    true_s, found_s : ndarray
        True and detected step times in s.
    tolerance_s : float, default 0.25
        Largest difference of matched times in s.
    offsets_s : ndarray, default -0.4 to 0.4 in steps of 0.02
        Candidates of the offset in s.

    Returns
    -------
    float
        Offset in s to add to the detected times. Among equal scores, it is the smallest in magnitude.

    Raises
    ------
    ValueError
        If times are not ascending or NaN, or if the tolerance is negative.

    Notes
    -----
    The offset is for detectors that mark another instant of the step than the reference. It is fitted to the truth, so
    that an F1 score with this offset must be reported as in-sample.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> true_s = np.arange(1.0, 9.0, 0.7)
    >>> round(pdr.evaluate.best_offset_s(true_s, true_s + 0.3, tolerance_s=0.05), 2)
    -0.26
    """
    smallest_first = sorted((float(o) for o in offsets_s), key=abs)
    return max(smallest_first, key=lambda offset_s: f1_score(true_s, found_s + offset_s, tolerance_s))
