"""Wrong observations: robust losses, and graduated non-convexity, which finds them without a good start.

H. Yang et al., "Graduated non-convexity for robust spatial perception", IEEE RA-L 5, 2020. A control parameter mu turns
the loss from a convex one into truncated least squares: what is beyond a limit does not count at all. A loss that only
counts it for little lets a fifth of wrong segments double the noise that the calibration finds.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from pdr_filter.values import FloatArray

LOSSES = ("none", "huber", "cauchy", "gnc")
# Tuning constants in standard deviations: Huber's and Cauchy's lose 5 % of efficiency on normal errors (Zhang,
# "Parameter estimation techniques", Image and Vision Computing 15, 1997).
_HUBER, _CAUCHY = 1.345, 2.385
# A residual of more than so many standard deviations is wrong: one good one in 370. Truncated least squares leaves it
# out; it loses 3 % of efficiency on normal errors.
DISTRUST = 3.0
# Where the graduation of a calibration ends: weights fall from 1 to 0 between 2.7 and 3.4 standard deviations. With a
# jump, the estimation of the noise could go round in circles.
_LAST_MU = 4.0
# By how much mu changes in an iteration. The paper has 1.4 (section V); with 2 the same segments and fixes are left out
# (docs/tables/smoothing_coverage.md, and groups of people with 10 and 20 % of wrong segments) in half the time.
GNC_FACTOR = 2.0
_HUBER_ITERATIONS = 5  # a redescending loss needs a start that outliers did not choose


def weights(misfit: FloatArray, loss: str, mu: float = 1.0) -> FloatArray:
    """Weights w(u) of residuals u in standard deviations; `mu` is the control parameter of the graduated non-convexity.

    Huber min(1, k / |u|); Cauchy 1 / (1 + (u / k)^2); "gnc" those of truncated least squares (`truncated_weights`).
    """
    if loss == "none":
        return np.ones_like(misfit)
    if loss == "huber":
        return _HUBER / np.maximum(np.abs(misfit), _HUBER)
    if loss == "cauchy":
        return 1 / (1 + (misfit / _CAUCHY) ** 2)
    if loss == "gnc":
        return truncated_weights(misfit**2, np.full(misfit.shape, DISTRUST**2), mu)
    raise ValueError(f"loss must be one of {', '.join(LOSSES)}, got {loss!r}")


@cache
def moments(loss: str, mu: float = 1.0) -> tuple[float, float]:
    """E w u^2 / E w and the information factor of a loss on standard normal residuals.

    The first makes the scale consistent: sum w u^2 / sum w tends to it, whatever the share of residuals of weight zero.
    The second, (E w u^2)^2 / (E psi^2 E w) with psi = w u, multiplies the weights and makes covariances those of an
    M-estimate, E psi^2 / (E psi')^2.
    """
    u = np.linspace(-9, 9, 20001)
    density = np.exp(-0.5 * u**2) / np.sqrt(2 * np.pi) * (u[1] - u[0])
    w = weights(u, loss, mu)
    square, psi_square, mean = (float((density * f).sum()) for f in (w * u**2, (w * u) ** 2, w))
    return square / mean, square**2 / (psi_square * mean)


def next_stage(loss: str, iteration: int, largest: float, mu: float) -> tuple[str, float, bool]:
    """Loss and control parameter of the next iteration, and whether they are final; `largest` is the largest misfit."""
    if loss == "cauchy" and iteration < _HUBER_ITERATIONS:
        return "huber", 1.0, False
    if loss == "gnc":
        start = truncated_start(max((largest / DISTRUST) ** 2, 1.0))
        mu = min(round(start if iteration == 1 else GNC_FACTOR * mu, 4), _LAST_MU)
        return loss, mu, mu == _LAST_MU
    return loss, 1.0, True


def truncated_start(excess: float) -> float:
    """Control parameter to begin with, for the largest squared residual over its limit."""
    return 1 / max(2 * excess - 1, 1e-12)


def truncated_weights(squared: FloatArray, limit: FloatArray, mu: float) -> FloatArray:
    """Weights of squared residuals that count up to a limit (eq. 14 of the paper).

    1 below, 0 above, and a smooth change between that gets steeper as mu grows.
    """
    between = np.sqrt(limit * mu * (mu + 1) / np.maximum(squared, 1e-12)) - mu
    below, above = squared <= limit * mu / (mu + 1), squared >= limit * (mu + 1) / mu
    return np.where(above, 0.0, np.where(below, 1.0, between))
