"""Errors of walked distances in per cent of the true distances: bias, spread and RMSE."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.values import FloatArray, Table, check_array, table


def percent_error(estimate_m: ArrayLike, true_m: ArrayLike) -> FloatArray:
    """Return the relative error of distances in per cent. A negative error means too short.

    Parameters
    ----------
    estimate_m, true_m : array_like
        Estimated distances in m, and true ones, which are positive.

    Returns
    -------
    ndarray
        100 (estimate - true) / true, with the broadcast shape of the arguments.

    Raises
    ------
    ValueError
        If a true distance is not positive.

    Notes
    -----
    This is %error of Table V of Martinelli et al. 2018.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> float(pdr.evaluate.percent_error(93.0, 100.0))
    -7.0
    """
    true = np.asarray(true_m, dtype=float)
    check_array("true_m", true, "positive", remedy="the error is relative to it")
    return np.asarray(100.0 * (np.asarray(estimate_m, dtype=float) - true) / true)


@dataclass(frozen=True, slots=True)
class DistanceScores:
    """Summary of the distance errors of N walks or legs, which all have the same weight.

    rmse^2 = bias^2 + spread^2.

    Attributes
    ----------
    n : int
        Number of walks or legs.
    bias_percent, spread_percent, rmse_percent : float
        Mean, standard deviation (with N in the denominator) and root mean square of the errors in per cent.
    largest_percent : float
        Largest absolute error in per cent.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> pdr.evaluate.distance_scores([-7.0, 1.0]).bias_percent
    -3.0
    """

    n: int
    bias_percent: float
    spread_percent: float
    rmse_percent: float
    largest_percent: float


def distance_scores(error_percent: ArrayLike) -> DistanceScores:
    """Return bias, spread and RMSE of distance errors.

    Parameters
    ----------
    error_percent : array_like of shape (N,)
        Errors in per cent, from `percent_error`.

    Returns
    -------
    DistanceScores
        Summary of the errors; NaN without errors.

    Notes
    -----
    Bias and spread are separate, because a calibration removes the bias but not the spread. The RMSE is %RMSE of
    Table IV of Martinelli et al. 2018. Computed from their Table V, it is 7.93 and 5.19, which agrees with the printed
    7.9 and 5.2.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> pdr.evaluate.distance_scores([-7.0, 1.0]).rmse_percent
    5.0
    """
    error = np.asarray(error_percent, dtype=float).ravel()
    if not len(error):
        return DistanceScores(0, np.nan, np.nan, np.nan, np.nan)
    rmse, largest = np.sqrt((error**2).mean()), np.abs(error).max()
    return DistanceScores(len(error), float(error.mean()), float(error.std()), float(rmse), float(largest))


def distance_table(estimate_m: ArrayLike, true_m: ArrayLike, context: Sequence[str]) -> Table:
    """Return a table of distance errors for each context and for all legs.

    Parameters
    ----------
    estimate_m, true_m : array_like of shape (N,)
        Estimated lengths of the legs in m, and true ones, which are positive.
    context : sequence of str
        Context of each leg.

    Returns
    -------
    Table
        A row for each context and a row "all", with columns `context`, `n`, `bias_percent`, `spread_percent`,
        `rmse_percent` and `largest_percent`.

    Raises
    ------
    ValueError
        If a true length is not positive, or if the numbers of legs and contexts differ.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> rows = pdr.evaluate.distance_table([9.0, 11.0], [10.0, 10.0], ["walking", "running"])
    >>> dict(zip(rows.context.tolist(), rows.bias_percent.tolist()))
    {'running': 10.0, 'walking': -10.0, 'all': 0.0}
    """
    error = percent_error(estimate_m, true_m).ravel()
    of_leg = np.asarray(context, dtype=str)
    if len(of_leg) != len(error):
        raise ValueError(f"context must have one value for each of the {len(error)} legs, got {len(of_leg)}")
    names = [str(c) for c in np.unique(of_leg)]
    scores = [distance_scores(error[of_leg == c]) for c in names] + [distance_scores(error)]
    columns = ("n", "bias_percent", "spread_percent", "rmse_percent", "largest_percent")
    return table(
        {"context": np.array([*names, "all"])} | {c: np.array([getattr(s, c) for s in scores]) for c in columns}
    )


def walked_m(time_s: FloatArray, step_length_m: FloatArray, start_s: ArrayLike, end_s: ArrayLike) -> FloatArray:
    """Return the walked distance in time intervals: the sum of the step lengths in each interval.

    Parameters
    ----------
    time_s, step_length_m : ndarray of shape (K,)
        Times of the contacts that end the steps in s, ascending, as in `Track`, and lengths of the steps in m.
    start_s, end_s : array_like of shape (N,)
        Start and end of the intervals in s. A step belongs to an interval if start < time <= end.

    Returns
    -------
    ndarray of shape (N,)
        Walked distances in m; NaN if start or end is NaN.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> pdr.evaluate.walked_m(np.arange(1.0, 4.0), np.array([0.7, 0.8, 0.6]), [1.0], [3.0]).round(2).tolist()
    [1.4]
    """
    total_m = np.concatenate([[0.0], np.cumsum(step_length_m)])
    start, end = (np.searchsorted(time_s, t, side="right") for t in (start_s, end_s))
    is_unknown = np.isnan(np.asarray(start_s, dtype=float)) | np.isnan(np.asarray(end_s, dtype=float))
    return np.where(is_unknown, np.nan, total_m[end] - total_m[start])
