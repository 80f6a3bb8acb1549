"""Angles: the only place that wraps them or converts between yaw and heading."""

from __future__ import annotations

import math

import numpy as np

from pdr_filter.values.arrays import FloatArray


def wrap_angle(angle_rad: FloatArray | float) -> FloatArray:
    """Return the same angle in [-pi, pi), radians, any shape.

    >>> float(wrap_angle(3 * np.pi))
    -3.141592653589793
    """
    # the remainder of a tiny negative number rounds up to 2 pi itself
    if isinstance(angle_rad, float):  # in Python's numbers, a tenth of the time
        one = (angle_rad + math.pi) % (2 * math.pi) - math.pi
        return np.asarray(-math.pi if one >= math.pi else one)  # NaN stays NaN
    wrapped = np.asarray((np.asarray(angle_rad) + np.pi) % (2 * np.pi) - np.pi)
    np.putmask(wrapped, wrapped >= np.pi, -np.pi)
    return wrapped


def heading_from_yaw(yaw_rad: FloatArray | float) -> FloatArray:
    """Heading clockwise from north, from yaw counter-clockwise from east; radians in [-pi, pi)."""
    return wrap_angle(np.pi / 2 - np.asarray(yaw_rad))


def yaw_from_heading(heading_rad: FloatArray | float) -> FloatArray:
    """Yaw counter-clockwise from east, from heading clockwise from north; radians in [-pi, pi)."""
    return wrap_angle(np.pi / 2 - np.asarray(heading_rad))


def circular_mean(angle_rad: FloatArray) -> float:
    """Direction of the mean unit vector of angles of shape (N,), radians in [-pi, pi].

    psi = atan2(sum sin psi_i, sum cos psi_i) (Mardia and Jupp 2000, eq. 2.2.4; Tian et al. 2016, section on heading).
    """
    return float(np.arctan2(np.sin(angle_rad).sum(), np.cos(angle_rad).sum()))
