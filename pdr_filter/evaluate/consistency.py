"""Consistency of covariances with actual errors: NEES, NIS, their bounds, and the coverage of ellipses."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from pdr_filter.values import FloatArray, check_cov


def nees(error: FloatArray, cov: FloatArray) -> FloatArray:
    """Return the normalised estimation error squared (NEES), e^T P^-1 e.

    Parameters
    ----------
    error, cov : ndarray of shape (N, D) and (N, D, D)
        Errors e, in any unit, and their covariances P.

    Returns
    -------
    ndarray of shape (N,)
        NEES; NaN for NaN in the error or the covariance.

    Raises
    ------
    ValueError
        If a covariance is singular or not valid.

    Notes
    -----
    If the covariances P are correct, the NEES is chi-square distributed with D degrees of freedom and mean D. A larger
    mean shows that the covariances are too small (Y. Bar-Shalom, X. R. Li and T. Kirubarajan, "Estimation with
    applications to tracking and navigation", 2001, section 5.4.2).

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> pdr.evaluate.nees(np.array([[2.0, 0.0]]), np.array([[[4.0, 0.0], [0.0, 1.0]]])).tolist()
    [1.0]
    """
    check_cov(cov[np.isfinite(cov).all(axis=(-2, -1))], "cov")
    try:
        solved = np.linalg.solve(cov, error[..., None])
    except np.linalg.LinAlgError:
        row = int(np.nanargmin(np.abs(np.linalg.det(cov))))
        raise ValueError(
            f"cov must be positive definite, but cov[{row}] is {cov[row].tolist()}: remove this row"
        ) from None
    return np.einsum("ni,ni->n", error, solved[..., 0])


def nis(innovation: FloatArray, innovation_cov: FloatArray) -> FloatArray:
    """Return the normalised innovation squared (NIS), v^T S^-1 v, which needs no ground truth.

    Parameters
    ----------
    innovation, innovation_cov : ndarray of shape (N, D) and (N, D, D)
        Innovations v, that is, measurement minus prediction, and their covariances S.

    Returns
    -------
    ndarray of shape (N,)
        NIS; NaN for NaN in the innovation or the covariance.

    Raises
    ------
    ValueError
        If a covariance is singular.

    Notes
    -----
    In a consistent filter, the NIS is chi-square distributed with D degrees of freedom and mean D, as in `nees`.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> pdr.evaluate.nis(np.array([[3.0]]), np.array([[[9.0]]])).tolist()
    [1.0]
    """
    return nees(innovation, innovation_cov)


def mean_bounds(dof: int, n: int, prob: float = 0.95) -> tuple[float, float]:
    """Return the interval that contains the mean NEES or NIS of a consistent filter with a given probability.

    Parameters
    ----------
    dof : int
        Degrees of freedom of each value, that is, the dimension of the error.
    n : int
        Number of independent values. Errors of one walk are not independent, so that n is the number of walks, not of
        steps.
    prob : float, default 0.95
        Probability of the interval.

    Returns
    -------
    tuple of float
        Lower and upper bound of the mean of n independent chi-square variables.

    Raises
    ------
    ValueError
        If `dof` or `n` is less than 1, or if `prob` is not between 0 and 1.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> low, high = pdr.evaluate.mean_bounds(2, 50)
    >>> round(low, 2), round(high, 2)
    (1.48, 2.59)
    """
    if n < 1 or dof < 1:
        raise ValueError(f"dof and n must be 1 or more, got {dof} and {n}")
    low, high = chi2.ppf([(1 - _checked(prob)) / 2, (1 + prob) / 2], dof * n) / n
    return float(low), float(high)


def ellipse_coverage(error: FloatArray, cov: FloatArray, prob: ArrayLike = (0.5, 0.95)) -> FloatArray:
    """Return the share of errors inside the ellipses of given probabilities.

    Parameters
    ----------
    error, cov : ndarray of shape (N, D) and (N, D, D)
        Errors, in any unit, and their covariances.
    prob : float or array_like, default (0.5, 0.95)
        Probabilities of the ellipses. If the covariances are correct, the result equals them.

    Returns
    -------
    ndarray
        Share of errors inside each ellipse, with the shape of `prob`; NaN without valid errors. Rows with NaN are
        ignored.

    Raises
    ------
    ValueError
        If a covariance is singular, or if a probability is not between 0 and 1.

    Notes
    -----
    An error is inside if its NEES is at most the chi-square quantile, which is 5.99 for the 95 % ellipse in the plane.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> error = np.random.default_rng(0).normal(size=(1000, 2))
    >>> pdr.evaluate.ellipse_coverage(error, np.tile(np.eye(2), (1000, 1, 1)), 0.95).round(2)
    np.float64(0.95)
    """
    levels = np.asarray(chi2.ppf(_checked(prob), error.shape[1]))
    squared = nees(error, cov)
    squared = squared[~np.isnan(squared)]
    if not len(squared):
        return np.full(levels.shape, np.nan)
    return np.asarray((squared <= levels[..., None]).mean(axis=-1))


def _checked(prob: ArrayLike) -> FloatArray:
    given = np.asarray(prob, dtype=float)
    if not ((given > 0) & (given < 1)).all():
        raise ValueError(f"prob must be between 0 and 1, such as 0.95, got {prob}")
    return given
