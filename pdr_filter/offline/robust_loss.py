"""Robust losses for wrong observations, and graduated non-convexity, which needs no good initial estimate.

A control parameter mu changes the loss step by step from a convex one into truncated least squares, in which residuals
beyond a limit have no influence (H. Yang et al., "Graduated non-convexity for robust spatial perception", IEEE RA-L 5,
2020). A loss that only reduces the influence of such residuals is not sufficient. With a fifth of wrong segments, it
doubles the noise that the calibration estimates.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from pdr_filter.values import FloatArray

LOSSES = ("none", "huber", "cauchy", "gnc")
# Tuning constants of the Huber and Cauchy losses in standard deviations. Both lose 5 % of efficiency on normal errors
# (Zhang, "Parameter estimation techniques", Image and Vision Computing 15, 1997).
_HUBER, _CAUCHY = 1.345, 2.385
# Residuals above this many standard deviations are outliers: one in 370 correct ones. Truncated least squares ignores
# outliers and loses 3 % of efficiency on normal errors.
OUTLIER_STDS = 3.0
# Final mu of a calibration. Weights then fall from 1 to 0 between 2.7 and 3.4 standard deviations. With a jump, the
# estimate of the noise could oscillate.
_LAST_MU = 4.0
# Factor on mu per iteration. The paper has 1.4 (section V). With 2, the same segments and fixes are rejected in half
# the time (docs/tables/smoothing_coverage.md, and groups of people with 10 and 20 % of wrong segments).
GNC_FACTOR = 2.0
_HUBER_ITERATIONS = 5  # a redescending loss needs an initial estimate that outliers did not determine


def weights(misfit: FloatArray, loss: str, mu: float = 1.0) -> FloatArray:
    """Return the weights w(u) of residuals u in standard deviations.

    "huber" is min(1, k / |u|) and "cauchy" is 1 / (1 + (u / k)^2), with the tuning constant k of the loss. "gnc" is the
    weight of truncated least squares (`truncated_weights`). `mu` is the control parameter of the graduated
    non-convexity. Raises ValueError for an unknown loss.
    """
    if loss == "none":
        return np.ones_like(misfit)
    if loss == "huber":
        return _HUBER / np.maximum(np.abs(misfit), _HUBER)
    if loss == "cauchy":
        return 1 / (1 + (misfit / _CAUCHY) ** 2)
    if loss == "gnc":
        return truncated_weights(misfit**2, np.full(misfit.shape, OUTLIER_STDS**2), mu)
    raise ValueError(f"loss must be one of {', '.join(LOSSES)}, got {loss!r}")


@cache
def loss_moments(loss: str, mu: float = 1.0) -> tuple[float, float]:
    """Return E w u^2 / E w and the information factor of a loss with weights w(u), for standard normal residuals u.

    The first value corrects the estimated variance of the residuals. For unit variance, sum w u^2 / sum w tends to this
    value, whatever the share of residuals with weight zero. The second value is (E w u^2)^2 / (E psi^2 E w) with psi =
    w u. The weights in the normal equations are multiplied by this factor. The inverse of their matrix is then the
    asymptotic covariance of an M-estimate, which is proportional to E psi^2 / (E psi')^2.
    """
    u = np.linspace(-9, 9, 20001)
    density = np.exp(-0.5 * u**2) / np.sqrt(2 * np.pi) * (u[1] - u[0])
    w = weights(u, loss, mu)
    square, psi_square, mean = (float((density * f).sum()) for f in (w * u**2, (w * u) ** 2, w))
    return square / mean, square**2 / (psi_square * mean)


def next_stage(loss: str, iteration: int, largest: float, mu: float) -> tuple[str, float, bool]:
    """Return the loss and the control parameter mu of the next iteration, and True if they no longer change.

    "cauchy" begins with "huber" in the first iterations, until `iteration` reaches `_HUBER_ITERATIONS`. "gnc" begins
    with the mu of `truncated_start`, and multiplies it by `GNC_FACTOR` in each iteration up to `_LAST_MU`. All other
    losses are final at once. `loss` is the loss of the calibration, `iteration` the number of finished iterations,
    `largest` the largest absolute residual in standard deviations, and `mu` the last control parameter.
    """
    if loss == "cauchy" and iteration < _HUBER_ITERATIONS:
        return "huber", 1.0, False
    if loss == "gnc":
        start = truncated_start(max((largest / OUTLIER_STDS) ** 2, 1.0))
        mu = min(round(start if iteration == 1 else GNC_FACTOR * mu, 4), _LAST_MU)
        return loss, mu, mu == _LAST_MU
    return loss, 1.0, True


def truncated_start(excess: float) -> float:
    """Return the initial control parameter mu, from `excess`, the largest ratio of a squared residual to its limit.

    Such a small mu makes the loss nearly convex.
    """
    return 1 / max(2 * excess - 1, 1e-12)


def truncated_weights(squared: FloatArray, limit: FloatArray, mu: float) -> FloatArray:
    """Return the weights, 0 to 1, of squared residuals in truncated least squares (Yang et al. 2020, eq. 14).

    A weight is 1 for squared residuals well below `limit`, 0 well above it, and changes smoothly between. `limit` is
    the squared residual from which an observation is an outlier. A larger mu makes the change steeper.
    """
    between = np.sqrt(limit * mu * (mu + 1) / np.maximum(squared, 1e-12)) - mu
    below, above = squared <= limit * mu / (mu + 1), squared >= limit * (mu + 1) / mu
    return np.where(above, 0.0, np.where(below, 1.0, between))
