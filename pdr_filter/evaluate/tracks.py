"""Errors of tracks after a stated alignment: position, end, heading and trajectory errors.

There are two conventions for the absolute trajectory error (ATE). `position_rmse_m` is the root mean squared distance,
sqrt(mean |e|^2), as in Sturm et al. ("A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012) and in evo.
`axis_rmse_m` averages over both axes, so that it is smaller by sqrt 2. The code of RoNIN (Herath, Yan and Furukawa,
ICRA 2020, `source/metric.py`) and its derivatives use it as ATE. Always state which convention a number has.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.values import BoolArray, FloatArray, interpolated_rows, rigid_fit, wrap_angle

Alignment = Literal["none", "origin", "first", "all"]


def positions_at(
    time_s: FloatArray, position_m: FloatArray, at_s: ArrayLike, start_position_m: ArrayLike = (0.0, 0.0)
) -> FloatArray:
    """Return interpolated positions of a track at given times.

    Parameters
    ----------
    time_s, position_m : ndarray of shape (K,) and (K, 2)
        Times of the steps in s, ascending, and position after each step in m.
    at_s : array_like of shape (T,)
        Times at which positions are returned, in s.
    start_position_m : array_like of shape (2,), default (0.0, 0.0)
        Position before the first step, `Track.start_position_m`. It differs from zero if the track is in the frame of
        fixes or of a plan.

    Returns
    -------
    ndarray of shape (T, 2)
        Positions in m, NaN for NaN times.

    Notes
    -----
    Positions are interpolated linearly between steps. Before the first step, the interpolation begins at the start
    position at the first time of `at_s`. After the last step, the position is constant.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> time_s, position_m = np.array([1.0, 2.0]), np.array([[0.0, 0.7], [0.0, 1.4]])
    >>> pdr.evaluate.positions_at(time_s, position_m, [1.5, 3.0]).round(2).tolist()
    [[0.0, 1.05], [0.0, 1.4]]
    """
    at = np.atleast_1d(np.asarray(at_s, dtype=float))
    way_m = np.vstack([np.asarray(start_position_m, dtype=float), np.reshape(position_m, (-1, 2))])
    time = np.concatenate([[np.fmin.reduce(at, initial=np.min(time_s, initial=np.inf)) - 1e-3], time_s])
    return interpolated_rows(at, time, way_m)


def moved_m(
    time_s: FloatArray,
    position_m: FloatArray,
    start_s: ArrayLike,
    end_s: ArrayLike,
    start_position_m: ArrayLike = (0.0, 0.0),
) -> FloatArray:
    """Return the displacement of a track in time intervals, which is the length of straight legs.

    Parameters
    ----------
    time_s, position_m : ndarray of shape (K,) and (K, 2)
        Times of the steps in s, ascending, and position after each step in m.
    start_s, end_s : array_like of shape (N,)
        Start and end of the intervals in s.
    start_position_m : array_like of shape (2,), default (0.0, 0.0)
        Position before the first step, as in `positions_at`.

    Returns
    -------
    ndarray of shape (N,)
        Distances in m between the positions at start and end.

    See Also
    --------
    walked_m : Sum of the step lengths, which is larger because headings vary from step to step.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> time_s, position_m = np.array([1.0, 2.0, 3.0]), np.array([[0.0, 0.7], [0.0, 1.4], [0.7, 1.4]])
    >>> pdr.evaluate.moved_m(time_s, position_m, [1.0], [2.0]).round(2).tolist()
    [0.7]
    """
    start, end = np.asarray(start_s, dtype=float), np.asarray(end_s, dtype=float)
    at_m = positions_at(time_s, position_m, np.concatenate([start, end]), start_position_m)
    return np.linalg.norm(at_m[len(start) :] - at_m[: len(start)], axis=1)


def path_m(position_m: FloatArray) -> FloatArray:
    """Return the path length up to each point.

    Parameters
    ----------
    position_m : ndarray of shape (N, 2)
        Points in m.

    Returns
    -------
    ndarray of shape (N,)
        Length in m of the line through the points, from the first point to each point.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> pdr.evaluate.path_m(np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 5.0]])).tolist()
    [0.0, 5.0, 6.0]
    """
    legs_m = np.linalg.norm(np.diff(position_m, axis=0), axis=1)
    return np.append(0.0, np.cumsum(legs_m))[: len(position_m)]


def first_of_path(reference_m: FloatArray, fraction: float = 0.2) -> BoolArray:
    """Return a mask of the points in the first part of a path.

    Parameters
    ----------
    reference_m : ndarray of shape (N, 2)
        Points of the path in m.
    fraction : float, default 0.2
        Fraction of the path length.

    Returns
    -------
    ndarray of bool, shape (N,)
        True for the points in this fraction, and at least for the first three points, because the rotation of two
        points is uncertain.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> pdr.evaluate.first_of_path(np.array([[0.0, float(k)] for k in range(21)])).sum()
    np.int64(5)
    """
    along_m = path_m(reference_m)
    if not len(along_m):
        return np.zeros(0, dtype=bool)
    return along_m <= max(fraction * along_m[-1], along_m[min(2, len(along_m) - 1)])


def fitted(estimate_m: FloatArray, reference_m: FloatArray, use: BoolArray) -> FloatArray:
    """Return the estimate after rigid alignment of selected points to the reference.

    Parameters
    ----------
    estimate_m, reference_m : ndarray of shape (N, 2)
        Estimated and true positions in m at the same times.
    use : ndarray of bool, shape (N,)
        Points that determine the rotation and the translation.

    Returns
    -------
    ndarray of shape (N, 2)
        All points of the estimate, rotated and translated.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> reference_m = np.array([[0.0, 0.0], [0.0, 10.0], [10.0, 10.0]])
    >>> pdr.evaluate.fitted(reference_m + [3.0, 4.0], reference_m, np.array([True, True, False])).round(6).tolist()
    [[0.0, 0.0], [0.0, 10.0], [10.0, 10.0]]
    """
    rotation, shift_m = rigid_fit(estimate_m[use], reference_m[use])
    return estimate_m @ rotation.T + shift_m


def aligned(
    estimate_m: FloatArray, reference_m: FloatArray, align: Alignment = "none", fraction: float = 0.2
) -> FloatArray:
    """Return the estimate after alignment to the reference, without scaling.

    Parameters
    ----------
    estimate_m, reference_m : ndarray of shape (N, 2)
        Estimated and true positions in m at the same times.
    align : {"none", "origin", "first", "all"}, default "none"
        "none" returns the estimate unchanged. "origin" translates it so that the first points agree. "first" is a rigid
        alignment to the first fraction of the path (at least three points), which corresponds to a user who knows start
        and first direction. "all" is a rigid alignment to all points, which leaves only the error of the shape. A
        filter could not know this alignment during the walk.
    fraction : float, default 0.2
        Fraction of the path that "first" uses.

    Returns
    -------
    ndarray of shape (N, 2)
        Aligned positions in m.

    Raises
    ------
    ValueError
        If positions are missing or NaN, if shapes differ, or if `align` is unknown.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> reference_m = np.array([[0.0, 0.0], [0.0, 10.0], [10.0, 10.0]])
    >>> pdr.evaluate.aligned(reference_m + [3.0, 4.0], reference_m, "origin").tolist()
    [[0.0, 0.0], [0.0, 10.0], [10.0, 10.0]]
    """
    if estimate_m.shape != reference_m.shape or not len(reference_m):
        raise ValueError(
            f"estimate and reference must have the same shape and at least one point, got {estimate_m.shape} and "
            f"{reference_m.shape}"
        )
    for name, points_m in (("estimate", estimate_m), ("reference", reference_m)):
        if not np.isfinite(points_m).all():
            row = int(np.argmin(np.isfinite(points_m).all(axis=1)))
            raise ValueError(
                f"{name} is not known at point {row}, {points_m[row]}: remove such points from both arrays"
            )
    if align == "none":
        return estimate_m
    if align == "origin":
        return estimate_m - estimate_m[0] + reference_m[0]
    if align == "first":
        return fitted(estimate_m, reference_m, first_of_path(reference_m, fraction))
    if align == "all":
        return fitted(estimate_m, reference_m, np.ones(len(reference_m), dtype=bool))
    raise ValueError(f"align must be none, origin, first or all, got {align!r}")


def position_errors_m(
    estimate_m: FloatArray, reference_m: FloatArray, align: Alignment = "none", fraction: float = 0.2
) -> FloatArray:
    """Return the position error of each point after alignment.

    Parameters
    ----------
    estimate_m, reference_m : ndarray of shape (N, 2)
        Estimated and true positions in m at the same times.
    align : {"none", "origin", "first", "all"}, default "none"
    fraction : float, default 0.2
        Alignment of the estimate, as in `aligned`.

    Returns
    -------
    ndarray of shape (N,)
        Distances from the true positions in m.

    Raises
    ------
    ValueError
        If positions are missing or NaN, if shapes differ, or if `align` is unknown.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> reference_m = np.array([[0.0, 0.0], [0.0, 10.0], [10.0, 10.0]])
    >>> pdr.evaluate.position_errors_m(reference_m + [3.0, 4.0], reference_m).tolist()
    [5.0, 5.0, 5.0]
    """
    return np.linalg.norm(aligned(estimate_m, reference_m, align, fraction) - reference_m, axis=1)


def position_rmse_m(
    estimate_m: FloatArray, reference_m: FloatArray, align: Alignment = "none", fraction: float = 0.2
) -> float:
    """Return the position RMSE after alignment, sqrt(mean |e|^2), the absolute trajectory error (ATE).

    Parameters
    ----------
    estimate_m, reference_m : ndarray of shape (N, 2)
        Estimated and true positions in m at the same times.
    align : {"none", "origin", "first", "all"}, default "none"
    fraction : float, default 0.2
        Alignment of the estimate, as in `aligned`.

    Returns
    -------
    float
        Root mean squared distance in m.

    Raises
    ------
    ValueError
        If positions are missing or NaN, if shapes differ, or if `align` is unknown.

    See Also
    --------
    axis_rmse_m : RMSE over both axes, smaller by sqrt 2.

    Notes
    -----
    This is the ATE of J. Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> reference_m = np.array([[0.0, 0.0], [0.0, 10.0], [10.0, 10.0]])
    >>> pdr.evaluate.position_rmse_m(reference_m + [3.0, 4.0], reference_m)
    5.0
    """
    return float(np.sqrt((position_errors_m(estimate_m, reference_m, align, fraction) ** 2).mean()))


def axis_rmse_m(
    estimate_m: FloatArray, reference_m: FloatArray, align: Alignment = "none", fraction: float = 0.2
) -> float:
    """Return the RMSE over both axes after alignment, which is `position_rmse_m` / sqrt 2.

    Parameters
    ----------
    estimate_m, reference_m : ndarray of shape (N, 2)
        Estimated and true positions in m at the same times.
    align : {"none", "origin", "first", "all"}, default "none"
    fraction : float, default 0.2
        Alignment of the estimate, as in `aligned`.

    Returns
    -------
    float
        Root mean squared error of a coordinate in m.

    Raises
    ------
    ValueError
        If positions are missing or NaN, if shapes differ, or if `align` is unknown.

    Notes
    -----
    The code of RoNIN (S. Herath, H. Yan and Y. Furukawa, ICRA 2020) reports this value as ATE.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> reference_m = np.array([[0.0, 0.0], [0.0, 10.0], [10.0, 10.0]])
    >>> round(pdr.evaluate.axis_rmse_m(reference_m + [3.0, 4.0], reference_m), 3)
    3.536
    """
    error_m = aligned(estimate_m, reference_m, align, fraction) - reference_m
    return float(np.sqrt((error_m**2).mean()))


def relative_error_m(estimate_m: FloatArray, reference_m: FloatArray, n_ahead: int) -> float:
    """Return the relative trajectory error (RTE), the RMS error of displacements over a number of points.

    Parameters
    ----------
    estimate_m, reference_m : ndarray of shape (N, 2)
        Estimated and true positions in m at the same times, equally spaced in time.
    n_ahead : int
        Number of points between start and end of a displacement.

    Returns
    -------
    float
        RMS over both axes of the displacement errors e_(i+n) - e_i, in m.

    Raises
    ------
    ValueError
        If `n_ahead` is not between 1 and N - 1.

    Notes
    -----
    As in the code of RoNIN (S. Herath, H. Yan and Y. Furukawa, ICRA 2020), the frames are not aligned at the start of
    each displacement. Multiplied by sqrt 2, the value is the translational relative pose error of Sturm et al. 2012.
    RoNIN uses displacements over one minute. For shorter recordings it scales the error of the whole recording by the
    ratio of the durations. This function does not; choose a smaller `n_ahead` instead.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> reference_m = np.array([[0.0, 0.0], [0.0, 10.0], [10.0, 10.0]])
    >>> pdr.evaluate.relative_error_m(reference_m + [3.0, 4.0], reference_m, 1)
    0.0
    """
    if not 0 < n_ahead < len(estimate_m):
        raise ValueError(f"n_ahead must be at least 1 and below the number of points, {len(estimate_m)}, got {n_ahead}")
    error_m = estimate_m - reference_m
    return float(np.sqrt(((error_m[n_ahead:] - error_m[:-n_ahead]) ** 2).mean()))


def end_error_percent(
    estimate_m: FloatArray, reference_m: FloatArray, align: Alignment = "none", fraction: float = 0.2
) -> float:
    """Return the position error of the last point after alignment, in per cent of the true path length.

    Parameters
    ----------
    estimate_m, reference_m : ndarray of shape (N, 2)
        Estimated and true positions in m at the same times.
    align : {"none", "origin", "first", "all"}, default "none"
    fraction : float, default 0.2
        Alignment of the estimate, as in `aligned`.

    Returns
    -------
    float
        End error in per cent.

    Raises
    ------
    ValueError
        If positions are missing or NaN, if shapes differ, if `align` is unknown, or if the true path has no length.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> reference_m = np.array([[0.0, 0.0], [0.0, 10.0], [10.0, 10.0]])
    >>> pdr.evaluate.end_error_percent(reference_m + [3.0, 4.0], reference_m)
    25.0
    """
    error_m = position_errors_m(estimate_m, reference_m, align, fraction)[-1]
    length_m = path_m(reference_m)[-1]
    if not length_m > 0:
        raise ValueError(
            "reference_m has a path length of zero, to which the end error would be relative: give at least two "
            "different points"
        )
    return float(100.0 * error_m / length_m)


def directions_rad(position_m: FloatArray, min_moved_m: float = 0.1) -> FloatArray:
    """Return the heading of the displacement between successive points.

    Parameters
    ----------
    position_m : ndarray of shape (N, 2)
        Positions (east, north) in m.
    min_moved_m : float, default 0.1
        Shortest displacement with a defined heading in m.

    Returns
    -------
    ndarray of shape (N - 1,)
        Headings in rad, clockwise from north; NaN for displacements that are too short.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> pdr.evaluate.directions_rad(np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0]])).round(3).tolist()
    [0.0, 1.571]
    """
    moved_m = np.diff(position_m, axis=0)
    heading = np.arctan2(moved_m[:, 0], moved_m[:, 1])
    return np.where(np.linalg.norm(moved_m, axis=1) >= min_moved_m, heading, np.nan)


def heading_errors_rad(estimate_rad: ArrayLike, reference_rad: ArrayLike) -> FloatArray:
    """Return heading errors, estimate minus reference, wrapped to [-pi, pi).

    Parameters
    ----------
    estimate_rad, reference_rad : array_like
        Estimated headings, and true ones, NaN if unknown, in rad.

    Returns
    -------
    ndarray
        Errors in rad, NaN for unknown headings.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> pdr.evaluate.heading_errors_rad([0.1], [2 * np.pi]).round(3)
    array([0.1])
    """
    return wrap_angle(np.asarray(estimate_rad, dtype=float) - np.asarray(reference_rad, dtype=float))
