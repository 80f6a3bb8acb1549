"""Whether a covariance is the size of the errors: NEES, NIS, their bounds, and how often an ellipse holds the truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from pdr_filter.values import FloatArray


def nees(error: FloatArray, cov: FloatArray) -> FloatArray:
    """e^T P^-1 e of errors (N, D) and covariances (N, D, D), (N,): normalised estimation error squared.

    Chi-square with D degrees of freedom if the covariance is right; its mean is D (Bar-Shalom, Li and Kirubarajan 2001,
    section 5.4.2). Larger means the filter is too sure.
    """
    return np.einsum("ni,ni->n", error, np.linalg.solve(cov, error[..., None])[..., 0])


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
    low, high = chi2.ppf([(1 - prob) / 2, (1 + prob) / 2], dof * n) / n
    return float(low), float(high)


def ellipse_coverage(error: FloatArray, cov: FloatArray, prob: ArrayLike = (0.5, 0.95)) -> FloatArray:
    """Share of errors (N, D) inside the ellipses that should hold them with these probabilities, same shape as `prob`.

    Inside is NEES <= chi-square quantile: for the 95 % ellipse in the plane 5.99.
    """
    levels = np.asarray(chi2.ppf(prob, error.shape[1]))
    return np.asarray((nees(error, cov) <= levels[..., None]).mean(axis=-1))
