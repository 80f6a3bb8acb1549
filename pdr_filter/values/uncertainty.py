"""How far off a position may be, in one number: the definition of all that people read."""

from __future__ import annotations

import numpy as np

from pdr_filter.values.arrays import FloatArray

# Radius that holds 68 and 95 % of a round normal distribution in standard deviations of one axis: the square root of
# -2 log(1 - p), p = 0.683 and 0.95. The accuracy that phones report is the former.
RADIUS_68 = 1.515
RADIUS_95 = 2.4477


def worst_std_m(cov_m2: FloatArray) -> FloatArray:
    """Standard deviation in the worst direction, in m, of covariances (..., 2, 2).

    sqrt(l), with l = (a + c) / 2 + sqrt((a - c)^2 / 4 + b^2) the larger eigenvalue of ((a, b), (b, c)).
    """
    a, b, c = cov_m2[..., 0, 0], cov_m2[..., 0, 1], cov_m2[..., 1, 1]
    with np.errstate(invalid="ignore"):  # infinite ones have no axes
        return np.sqrt(np.maximum(0.5 * (a + c) + np.hypot(0.5 * (a - c), b), 0.0))
