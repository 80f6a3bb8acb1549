"""Uncertainty of a position as one number, used for everything that users read."""

from __future__ import annotations

import math

import numpy as np

from pdr_filter.values.arrays import BoolArray, FloatArray

# Radius that contains 68 % or 95 % of a circular normal distribution, in standard deviations of one axis:
# sqrt(-2 log(1 - p)) with p = 0.683 and 0.95. Phones report the first as their accuracy.
RADIUS_68 = 1.515
RADIUS_95 = 2.4477
# Largest standard deviation of a known north: half a quadrant. Beyond it, north may as well be east or west at one
# standard deviation. A compass is then only a prior for fixes and plans.
MAX_NORTH_STD_RAD = math.pi / 4.0

# Half of a usual storey height, m: a larger error of the height leads to another storey.
_HALF_STOREY_M = 1.9


def floor_prob(height_std_m: FloatArray) -> FloatArray:
    """Return the probability that a storey is right, for standard deviations of the height (...).

    It is that of a normal error of less than half a storey. Below 0.5, at 2.8 m, the storey counts as unknown.
    """
    std_m = np.atleast_1d(height_std_m)
    prob = [math.erf(_HALF_STOREY_M / (math.sqrt(2.0) * std)) if std > 0 else 1.0 for std in std_m.tolist()]
    return np.array(prob).reshape(np.shape(height_std_m))


def is_floor_unknown(height_std_m: FloatArray) -> BoolArray:
    """Return True for standard deviations of the height (...) with which the storey is more likely wrong than right."""
    return floor_prob(height_std_m) < 0.5


def worst_std_m(cov_m2: FloatArray) -> FloatArray:
    """Return the standard deviation along the least certain direction, m, of covariances (..., 2, 2)."""
    a, b, c = cov_m2[..., 0, 0], cov_m2[..., 0, 1], cov_m2[..., 1, 1]
    with np.errstate(invalid="ignore"):  # an infinite covariance has no axes
        return np.sqrt(np.maximum(0.5 * (a + c) + np.hypot(0.5 * (a - c), b), 0.0))


# Degrees of freedom of Student's t distribution of the joint errors of fixes. There are few fixes, and their true
# accuracy is unknown. Test: points tapped on a plan with a stated standard deviation of 0.5 m, after the first fifth of
# a walk. On the storeys B1 and F1 of ms_indoor the 50 % and 95 % ellipses covered 49 and 85 % with normal errors, 54
# and 89 % with this value, which was chosen there among 2, 4 and 8. On the held-out storeys they covered 37 and 85 %,
# and 46 and 90 %.
STUDENT_DOF = 4.0


def variance_factor(squares: float, n_errors: int) -> float:
    """Return the factor by which variances exceed their stated values, given the sum of normalised squared errors.

    It is at least one. The prior is worth `STUDENT_DOF` errors with the stated variances.
    """
    return max((STUDENT_DOF + squares) / (STUDENT_DOF + n_errors), 1.0)
