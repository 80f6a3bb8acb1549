"""Angles: wrapping, means, and the conversion between yaw and heading. No other module does these."""

from __future__ import annotations

import math

import numpy as np

from pdr_filter.values.arrays import FloatArray

# Standard deviation of an unknown angle, which is uniform on the circle.
UNKNOWN_STD_RAD = math.pi / math.sqrt(3.0)
UNKNOWN_VAR_RAD2 = UNKNOWN_STD_RAD**2


def wrap_angle(angle_rad: FloatArray | float) -> FloatArray:
    """Wrap angles to [-pi, pi).

    Parameters
    ----------
    angle_rad : float or ndarray
        Angles of any shape, rad. NaN stays NaN.

    Returns
    -------
    ndarray
        Wrapped angles of the same shape, rad.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.values.angles import wrap_angle
    >>> float(wrap_angle(3 * np.pi))
    -3.141592653589793
    """
    # The remainder of a tiny negative number can round up to 2 pi, which is mapped to -pi here.
    if isinstance(angle_rad, float):  # ten times as fast as NumPy
        one = (angle_rad + math.pi) % (2 * math.pi) - math.pi
        return np.asarray(-math.pi if one >= math.pi else one)  # NaN stays NaN
    wrapped = np.asarray((np.asarray(angle_rad) + np.pi) % (2 * np.pi) - np.pi)
    np.putmask(wrapped, wrapped >= np.pi, -np.pi)
    return wrapped


def heading_from_yaw(yaw_rad: FloatArray | float) -> FloatArray:
    """Convert yaw, counter-clockwise from east, to heading, clockwise from north.

    Parameters
    ----------
    yaw_rad : float or ndarray
        Yaw of any shape, rad.

    Returns
    -------
    ndarray
        Heading of the same shape, rad, in [-pi, pi).

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.values.angles import heading_from_yaw
    >>> float(heading_from_yaw(np.pi / 2))  # yaw to the north
    0.0
    """
    return wrap_angle(np.pi / 2 - np.asarray(yaw_rad))


def yaw_from_heading(heading_rad: FloatArray | float) -> FloatArray:
    """Convert heading, clockwise from north, to yaw, counter-clockwise from east.

    Parameters
    ----------
    heading_rad : float or ndarray
        Heading of any shape, rad.

    Returns
    -------
    ndarray
        Yaw of the same shape, rad, in [-pi, pi).

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.values.angles import yaw_from_heading
    >>> float(yaw_from_heading(np.pi / 2))  # heading to the east
    0.0
    """
    return wrap_angle(np.pi / 2 - np.asarray(heading_rad))


def circular_mean(angle_rad: FloatArray) -> float:
    """Return the mean direction of angles: the direction of their mean unit vector.

    Parameters
    ----------
    angle_rad : ndarray, shape (N,)
        Angles, rad.

    Returns
    -------
    float
        Mean direction, rad, in [-pi, pi].

    Notes
    -----
    psi = atan2(sum sin psi_i, sum cos psi_i) (Mardia and Jupp, Directional Statistics, 2000, eq. 2.2.4).

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.values.angles import circular_mean
    >>> round(circular_mean(np.radians([350.0, 30.0])), 3)  # 10 degrees
    0.175
    """
    return float(np.arctan2(np.sin(angle_rad).sum(), np.cos(angle_rad).sum()))
