"""How far walked distances are off, in per cent of the true ones: bias and spread apart, together as RMSE."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.values import FloatArray, Table, check_array, table


def percent_error(estimate_m: ArrayLike, true_m: ArrayLike) -> FloatArray:
    """100 (estimate - true) / true, same shape: %error of Martinelli et al. 2018, Table V. Negative is too short.

    >>> float(percent_error(93.0, 100.0))
    -7.0
    """
    true = np.asarray(true_m, dtype=float)
    check_array("true_m", true, "positive", remedy="the error is relative to it")
    return np.asarray(100.0 * (np.asarray(estimate_m, dtype=float) - true) / true)


@dataclass(frozen=True, slots=True)
class DistanceScores:
    """Of N walks or legs, every one counting alike: rmse^2 = bias^2 + spread^2."""

    n: int
    bias_percent: float  # mean
    spread_percent: float  # standard deviation, N in the denominator
    rmse_percent: float  # %RMSE, square root of the mean square
    largest_percent: float  # of the absolute errors


def distance_scores(error_percent: ArrayLike) -> DistanceScores:
    """Bias, spread and %RMSE of errors (N,) in per cent; NaN of none.

    %RMSE is that of Martinelli et al. 2018, Table IV: their Table V gives it to the digit (7.93 and 5.19 for the
    printed 7.9 and 5.2). Bias and spread apart, because a calibration takes the bias away and leaves the spread.
    """
    error = np.asarray(error_percent, dtype=float).ravel()
    if not len(error):
        return DistanceScores(0, np.nan, np.nan, np.nan, np.nan)
    rmse, largest = np.sqrt((error**2).mean()), np.abs(error).max()
    return DistanceScores(len(error), float(error.mean()), float(error.std()), float(rmse), float(largest))


def distance_table(estimate_m: ArrayLike, true_m: ArrayLike, context: Sequence[str]) -> Table:
    """A row for each context of legs (N,) and one for all: `context, n, {bias, spread, rmse, largest}_percent`."""
    error = percent_error(estimate_m, true_m).ravel()
    of_leg = np.asarray(context, dtype=str)
    if len(of_leg) != len(error):
        raise ValueError(f"{len(error)} legs and {len(of_leg)} contexts: give one for each")
    names = [str(c) for c in np.unique(of_leg)]
    scores = [distance_scores(error[of_leg == c]) for c in names] + [distance_scores(error)]
    columns = ("n", "bias_percent", "spread_percent", "rmse_percent", "largest_percent")
    return table(
        {"context": np.array([*names, "all"])} | {c: np.array([getattr(s, c) for s in scores]) for c in columns}
    )


def walked_m(time_s: FloatArray, step_length_m: FloatArray, start_s: ArrayLike, end_s: ArrayLike) -> FloatArray:
    """Sum of the lengths (K,) of the steps that ended after each start and not after its end, (N,).

    `time_s` (K,) are the contacts that end the steps, ascending, as in `Track`. NaN where start or end is.
    """
    total_m = np.concatenate([[0.0], np.cumsum(step_length_m)])
    start, end = (np.searchsorted(time_s, t, side="right") for t in (start_s, end_s))
    is_unknown = np.isnan(np.asarray(start_s, dtype=float)) | np.isnan(np.asarray(end_s, dtype=float))
    return np.where(is_unknown, np.nan, total_m[end] - total_m[start])
