"""Whether a covariance is the size of the errors: NEES, NIS, their bounds, and how often an ellipse holds the truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from pdr_filter.values import FloatArray, check_cov


def nees(error: FloatArray, cov: FloatArray) -> FloatArray:
    """e^T P^-1 e of errors (N, D) and covariances (N, D, D), (N,): normalised estimation error squared.

    Chi-square with D degrees of freedom if the covariance is right; its mean is D (Bar-Shalom, Li and Kirubarajan 2001,
    section 5.4.2). Larger means the filter is too sure. NaN where either is; ValueError for a covariance that is zero
    along some direction, in which no error is of its size.
    """
    check_cov(cov[np.isfinite(cov).all(axis=(-2, -1))], "cov")
    try:
        solved = np.linalg.solve(cov, error[..., None])
    except np.linalg.LinAlgError:
        row = int(np.argmin(np.abs(np.linalg.det(cov))))
        raise ValueError(f"cov must be positive definite, number {row} is {cov[row].tolist()}: leave it out") from None
    return np.einsum("ni,ni->n", error, solved[..., 0])


def nis(innovation: FloatArray, innovation_cov: FloatArray) -> FloatArray:
    """v^T S^-1 v of innovations (N, D), (N,): as `nees`, without any truth (Bar-Shalom et al. 2001, section 5.4.2)."""
    return nees(innovation, innovation_cov)


def mean_bounds(dof: int, n: int, prob: float = 0.95) -> tuple[float, float]:
    """Between these is the mean of n independent chi-square numbers with this probability.

    Errors of one walk are not independent: count walks and not steps.

    >>> low, high = mean_bounds(2, 50)
    >>> round(low, 2), round(high, 2)
    (1.48, 2.59)
    """
    if n < 1 or dof < 1:
        raise ValueError(f"dof and n must be 1 or more, got {dof} and {n}")
    low, high = chi2.ppf([(1 - _checked(prob)) / 2, (1 + prob) / 2], dof * n) / n
    return float(low), float(high)


def ellipse_coverage(error: FloatArray, cov: FloatArray, prob: ArrayLike = (0.5, 0.95)) -> FloatArray:
    """Share of errors (N, D) inside the ellipses that should hold them with these probabilities, same shape as `prob`.

    Inside is NEES <= chi-square quantile: for the 95 % ellipse in the plane 5.99. Errors that are not known count
    neither way; NaN if none is.
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
