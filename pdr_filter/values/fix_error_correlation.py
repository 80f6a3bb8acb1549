"""Covariance of the errors of position fixes: correlated fixes, independent fixes, and mixtures of both.

The correlation of two errors is that of two Ornstein-Uhlenbeck processes driven by the same white noise. Let T_i and
T_j be the time constants, t the time from the earlier fix to the later one, and T the time constant of the later one.
Then

    r_ij = (1 - e) s g c exp(-t / T),  c = 2 sqrt(T_i T_j) / (T_i + T_j),
    s = min(v_i, v_j) / sqrt(v_i v_j),  g = exp(-log(T_i / T_j)^2 / 2)

- The factor s bounds the common part of two errors: it has at most the variance of the better fix, min(v_i, v_j).
- The factor g reduces the correlation of fixes with different time constants, because they come from different sources.
- A share e of each error is independent, so that simultaneous fixes do not make the covariance singular.
- A fix with T = 0 is independent of all others.

The matrix is positive definite for any times, time constants and variances. It is an elementwise product of covariances
(of the two processes, of a random walk, and of a Gaussian kernel) plus a diagonal. For equal time constants and
variances it is exp(-t / T), except for e. The simpler form `exp(-t / min(T_i, T_j))` would have negative eigenvalues.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdr_filter.values.arrays import FloatArray
from pdr_filter.values.fixes import PositionFix

# Independent share e of the variance of each error.
INDEPENDENT_SHARE = 0.01
# Number of earlier fixes whose errors are correlated with the next one. At intervals of a fiftieth of the time
# constant, where the independent share matters most, older fixes would change the result by less than a thousandth.
N_BEFORE = 8
# Shrinkage: locations are too close to their mean, because phones smooth them. Its standard deviation is this share of
# the distance from the mean, and at most this number of standard deviations of a location (chosen on ipin2023, see
# `offline.smoothing.location_errors`).
SHRINKAGE_STD, MAX_SHRINKAGE = 0.5, 1.5
# Maximum factor on the variance of a fix that contains no information beyond the previous fixes.
_MAX_REPETITION = 1e6


def error_correlation(time_s: FloatArray, correlation_s: FloatArray, var_m2: FloatArray) -> FloatArray:
    """Return the correlation matrix (N, N) of the errors of N fixes along one axis. It is positive definite.

    The arguments (N,) are the times in s, the time constants of the errors in s, and their variances in m^2.
    """
    apart_s = time_s[:, None] - time_s
    later_s = np.where(apart_s >= 0, correlation_s[:, None], correlation_s)
    shorter_s, longer_s = np.minimum(correlation_s[:, None], correlation_s), np.maximum(correlation_s[:, None], 1e-300)
    ratio = shorter_s / np.maximum(longer_s, correlation_s)
    with np.errstate(over="ignore"):
        decay = np.exp(-np.abs(apart_s) / np.maximum(later_s, 1e-300))
    std = np.sqrt(var_m2)
    shared = np.minimum(std[:, None], std) / np.maximum(std[:, None], std)
    alike = 2.0 * np.sqrt(ratio) / (1.0 + ratio) * np.exp(-0.5 * np.log(np.maximum(ratio, 1e-300)) ** 2)
    result = (1.0 - INDEPENDENT_SHARE) * shared * alike * decay
    np.fill_diagonal(result, 1.0)
    return result


def error_given_before(fix: PositionFix, before: Sequence[PositionFix]) -> tuple[FloatArray, FloatArray]:
    """Return the regression of the error of a fix on the errors e_i of m earlier fixes.

    The error is sum_i A_i e_i + w. The results are A_i (m, 2, 2), and the covariance R (2, 2) of the independent w.
    With the correlations r and S S = cov_m2: A_i = (r_n r^-1)_i S_n S_i^-1 and R = (1 - r_n r^-1 r_n') cov_m2.
    """
    every = (*before, fix)
    correlation = error_correlation(
        np.array([f.time_s for f in every]),
        np.array([f.correlation_s for f in every]),
        np.array([f.var_m2 for f in every]),
    )
    share = np.linalg.solve(correlation[:-1, :-1], correlation[:-1, -1])
    own = 1.0 - float(share @ correlation[:-1, -1])
    root = _root(fix.cov_m2)
    by_error = [s * root @ np.linalg.inv(_root(f.cov_m2)) for s, f in zip(share, before, strict=True)]
    return np.array(by_error).reshape(-1, 2, 2), own * fix.cov_m2


def repeated_cov_m2(fix: PositionFix, before: Sequence[PositionFix]) -> FloatArray:
    """Return the covariance (2, 2) in m2 with which a fix can be used as if it were independent of earlier fixes.

    It is `fix.cov_m2` times a factor of at least one, with which the mean of the fixes of a standing pedestrian has the
    right variance: (1 + r) / (1 - r) at even intervals t, with r = exp(-t / T) and the time constant T of the errors.
    """
    if fix.correlation_s == 0 or not before:
        return fix.cov_m2
    by_error, own_cov = error_given_before(fix, before)
    new = max(1.0 - 0.5 * float(np.trace(by_error.sum(axis=0))), 1e-9)
    share = 0.5 * float(np.trace(np.linalg.solve(fix.cov_m2, own_cov)))
    return min(max(share / new**2, 1.0), _MAX_REPETITION) * fix.cov_m2


def _root(cov: FloatArray) -> FloatArray:
    """Return the symmetric root (P + sqrt(det) I) / sqrt(tr + 2 sqrt(det)) of a covariance P (2, 2)."""
    det = np.sqrt(max(float(np.linalg.det(cov)), 0.0))
    return (cov + det * np.eye(2)) / np.sqrt(float(np.trace(cov)) + 2.0 * det)
