"""Wrong observations: robust losses, and graduated non-convexity, which finds them without a good start.

H. Yang et al., "Graduated non-convexity for robust spatial perception", IEEE RA-L 5, 2020. A control parameter mu turns
the loss from a convex one into the wanted one: Geman-McClure's for the calibration, which keeps a little of every
segment, and truncated least squares for the smoother, which needs a decision.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from pdr_filter.values import FloatArray

LOSSES = ("none", "huber", "cauchy", "gnc")
# Tuning constants in standard deviations: Huber's and Cauchy's lose 5 % of efficiency on normal errors (Zhang,
# "Parameter estimation techniques", Image and Vision Computing 15, 1997); Geman-McClure's, at the end of the graduated
# non-convexity, about as much.
_HUBER, _CAUCHY, _GEMAN_MCCLURE = 1.345, 2.385, 4.0
# By how much mu changes in an iteration (section V of the paper).
GNC_FACTOR = 1.4
_HUBER_ITERATIONS = 5  # a redescending loss needs a start that outliers did not choose


def weights(misfit: FloatArray, loss: str, mu: float = 1.0) -> FloatArray:
    """Weights w(u) of residuals u in standard deviations; `mu` is the control parameter of the graduated non-convexity.

    Huber min(1, k / |u|); Cauchy 1 / (1 + (u / k)^2); Geman-McClure (mu k^2 / (u^2 + mu k^2))^2, whose loss is convex
    for large mu and redescending for 1.
    """
    if loss == "none":
        return np.ones_like(misfit)
    if loss == "huber":
        return _HUBER / np.maximum(np.abs(misfit), _HUBER)
    if loss == "cauchy":
        return 1 / (1 + (misfit / _CAUCHY) ** 2)
    if loss == "gnc":
        return (mu * _GEMAN_MCCLURE**2 / (misfit**2 + mu * _GEMAN_MCCLURE**2)) ** 2
    raise ValueError(f"loss must be one of {LOSSES}, got {loss!r}")


@cache
def moments(loss: str, mu: float = 1.0) -> tuple[float, float]:
    """E w u^2 and the information factor of a loss on standard normal residuals.

    The first makes the scale consistent: sum w u^2 / n tends to it. The second, (E w u^2)^2 / (E psi^2 E w) with
    psi = w u, multiplies the weights and makes covariances those of an M-estimate, E psi^2 / (E psi')^2.
    """
    u = np.linspace(-9, 9, 20001)
    density = np.exp(-0.5 * u**2) / np.sqrt(2 * np.pi) * (u[1] - u[0])
    w = weights(u, loss, mu)
    square, psi_square, mean = (float((density * f).sum()) for f in (w * u**2, (w * u) ** 2, w))
    return square, square**2 / (psi_square * mean)


def next_stage(loss: str, iteration: int, largest: float, mu: float) -> tuple[str, float, bool]:
    """Loss and control parameter of the next iteration, and whether they are final; `largest` is the largest misfit."""
    if loss == "cauchy" and iteration < _HUBER_ITERATIONS:
        return "huber", 1.0, False
    if loss == "gnc":
        start = max(1.0, round(2 * (largest / _GEMAN_MCCLURE) ** 2, 1))
        mu = start if iteration == 1 else max(1.0, round(mu / GNC_FACTOR, 3))
        return loss, mu, mu == 1.0
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
