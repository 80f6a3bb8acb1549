"""Uncertainty of a position as one number, used for everything that users read."""

from __future__ import annotations

import numpy as np

from pdr_filter.values.arrays import FloatArray

# Radius that contains 68 % or 95 % of a circular normal distribution, in standard deviations of one axis:
# sqrt(-2 log(1 - p)) with p = 0.683 and 0.95. Phones report the first as their accuracy.
RADIUS_68 = 1.515
RADIUS_95 = 2.4477


def worst_std_m(cov_m2: FloatArray) -> FloatArray:
    """Return the standard deviation along the least certain direction, m, for covariances (..., 2, 2).

    It is sqrt(l), with l = (a + c) / 2 + sqrt((a - c)^2 / 4 + b^2) the larger eigenvalue of the covariance ((a, b), (b,
    c)).
    """
    a, b, c = cov_m2[..., 0, 0], cov_m2[..., 0, 1], cov_m2[..., 1, 1]
    with np.errstate(invalid="ignore"):  # an infinite covariance has no axes
        return np.sqrt(np.maximum(0.5 * (a + c) + np.hypot(0.5 * (a - c), b), 0.0))
