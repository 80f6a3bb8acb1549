"""How far a track is from the truth after a stated alignment: position, end, heading, trajectory errors.

Two conventions are about. `position_rmse_m` is the root of the mean squared distance, sqrt(mean |e|^2): the absolute
trajectory error of Sturm et al. ("A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012) and of evo.
`axis_rmse_m` is what the code of RoNIN (Herath, Yan and Furukawa, ICRA 2020, `source/metric.py`) and of those who took
it over calls ATE: the mean is over both axes, so that the error of the same track is smaller by sqrt 2. Say which one a
number is.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.values import BoolArray, FloatArray, interpolated, rigid_fit, wrap_angle

Alignment = Literal["none", "origin", "first", "all"]


def positions_at(
    time_s: FloatArray, position_m: FloatArray, at_s: ArrayLike, start_position_m: ArrayLike = (0.0, 0.0)
) -> FloatArray:
    """Positions (T, 2) of a track at any times (T,), linear between its steps; NaN where a time is.

    A track has a row for each step and begins at `start_position_m` (2,), which is `Track.start_position_m` where the
    track is in the frame of fixes or of a plan. There it is until the first time that is asked for, or the first step
    if that is earlier. After its last step it stays. Steps (K,), (K, 2) ascend in time.
    """
    at = np.atleast_1d(np.asarray(at_s, dtype=float))
    way_m = np.vstack([np.asarray(start_position_m, dtype=float), np.reshape(position_m, (-1, 2))])
    time = np.concatenate([[np.fmin.reduce(at, initial=np.min(time_s, initial=np.inf)) - 1e-3], time_s])
    return interpolated(at, time, way_m)


def moved_m(
    time_s: FloatArray,
    position_m: FloatArray,
    start_s: ArrayLike,
    end_s: ArrayLike,
    start_position_m: ArrayLike = (0.0, 0.0),
) -> FloatArray:
    """Distance between where a track is at each start and at its end, (N,): the length of legs that are straight.

    Shorter than the sum of the step lengths (`walked_m`), as headings waver: compare like with like. The track begins
    as in `positions_at`.
    """
    start, end = np.asarray(start_s, dtype=float), np.asarray(end_s, dtype=float)
    at_m = positions_at(time_s, position_m, np.concatenate([start, end]), start_position_m)
    return np.linalg.norm(at_m[len(start) :] - at_m[: len(start)], axis=1)


def path_m(position_m: FloatArray) -> FloatArray:
    """Length of the line through points (N, 2) up to each of them, (N,)."""
    legs_m = np.linalg.norm(np.diff(position_m, axis=0), axis=1)
    return np.append(0.0, np.cumsum(legs_m))[: len(position_m)]


def first_of_path(reference_m: FloatArray, fraction: float = 0.2) -> BoolArray:
    """Points (N,) in the first fraction of the path through (N, 2), and never fewer than three: two make no corner."""
    along_m = path_m(reference_m)
    if not len(along_m):
        return np.zeros(0, dtype=bool)
    return along_m <= max(fraction * along_m[-1], along_m[min(2, len(along_m) - 1)])


def fitted(estimate_m: FloatArray, reference_m: FloatArray, use: BoolArray) -> FloatArray:
    """All points (N, 2) of the estimate, turned and moved so that the used ones (N,) fit the reference best."""
    rotation, shift_m = rigid_fit(estimate_m[use], reference_m[use])
    return estimate_m @ rotation.T + shift_m


def aligned(
    estimate_m: FloatArray, reference_m: FloatArray, align: Alignment = "none", fraction: float = 0.2
) -> FloatArray:
    """The estimate (N, 2) in the frame of the reference (N, 2), never scaled.

    none: as it is. origin: moved so that the first points agree, not turned. first: turned and moved onto the first
    fraction of the path (never fewer than three points), what a user would see who knows where he started and where to.
    all: onto all points, the error of the shape alone; no filter could know it on the way.
    ValueError for points that are not known, and for none.
    """
    if estimate_m.shape != reference_m.shape or not len(reference_m):
        raise ValueError(
            f"estimate and reference must be alike and of a point at least, got {estimate_m.shape} and "
            f"{reference_m.shape}"
        )
    for name, points_m in (("estimate", estimate_m), ("reference", reference_m)):
        if not np.isfinite(points_m).all():
            row = int(np.argmin(np.isfinite(points_m).all(axis=1)))
            raise ValueError(f"{name} is not known at point {row}, {points_m[row]}: leave such points out of both")
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
    """Distance of each point from the truth after the alignment, (N,)."""
    return np.linalg.norm(aligned(estimate_m, reference_m, align, fraction) - reference_m, axis=1)


def position_rmse_m(
    estimate_m: FloatArray, reference_m: FloatArray, align: Alignment = "none", fraction: float = 0.2
) -> float:
    """Root of the mean squared distance, sqrt(mean |e|^2) (Sturm et al. 2012)."""
    return float(np.sqrt((position_errors_m(estimate_m, reference_m, align, fraction) ** 2).mean()))


def axis_rmse_m(
    estimate_m: FloatArray, reference_m: FloatArray, align: Alignment = "none", fraction: float = 0.2
) -> float:
    """Root of the mean squared error over both axes, `position_rmse_m` / sqrt 2: "ATE" of the code of RoNIN."""
    error_m = aligned(estimate_m, reference_m, align, fraction) - reference_m
    return float(np.sqrt((error_m**2).mean()))


def relative_error_m(estimate_m: FloatArray, reference_m: FloatArray, n_ahead: int) -> float:
    """RTE: RMS over both axes of how much the displacement over so many points is off, e_i+n - e_i.

    As the code of RoNIN has it, frames not turned onto each other at the start of each window; times sqrt 2 it is the
    relative pose error of Sturm et al. 2012 in translation. Points must be equally far apart in time for it to
    be one of a time.

    RoNIN's code takes a minute, and for a shorter recording scales the error of the whole with the ratio of the times,
    which this does not: choose another `n_ahead`.
    """
    if not 0 < n_ahead < len(estimate_m):
        raise ValueError(f"n_ahead must be from 1 to {len(estimate_m) - 1}, got {n_ahead}")
    error_m = estimate_m - reference_m
    return float(np.sqrt(((error_m[n_ahead:] - error_m[:-n_ahead]) ** 2).mean()))


def end_error_percent(
    estimate_m: FloatArray, reference_m: FloatArray, align: Alignment = "none", fraction: float = 0.2
) -> float:
    """Distance of the last point from the truth in per cent of the path through the reference."""
    error_m = position_errors_m(estimate_m, reference_m, align, fraction)[-1]
    length_m = path_m(reference_m)[-1]
    if not length_m > 0:
        raise ValueError("the reference goes nowhere: the end error is relative to its path")
    return float(100.0 * error_m / length_m)


def directions_rad(position_m: FloatArray, min_moved_m: float = 0.1) -> FloatArray:
    """Heading of each displacement between points (N, 2), (N - 1,), clockwise from north; NaN where it is too short."""
    moved_m = np.diff(position_m, axis=0)
    heading = np.arctan2(moved_m[:, 0], moved_m[:, 1])
    return np.where(np.linalg.norm(moved_m, axis=1) >= min_moved_m, heading, np.nan)


def heading_errors_rad(estimate_rad: ArrayLike, reference_rad: ArrayLike) -> FloatArray:
    """Estimate less reference in [-pi, pi), same shape, one for each step; NaN where the reference is not known.

    >>> heading_errors_rad([0.1], [2 * np.pi]).round(3)
    array([0.1])
    """
    return wrap_angle(np.asarray(estimate_rad, dtype=float) - np.asarray(reference_rad, dtype=float))
