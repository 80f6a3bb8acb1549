"""Fixes: positions, headings, ranges, speeds and standstills known from other sources."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from numbers import Real
from typing import Any, Literal, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pdr_filter.values.arrays import FloatArray, read_only
from pdr_filter.values.checks import check_array, check_heading, check_number
from pdr_filter.values.json_values import as_plain
from pdr_filter.values.origin import Origin, check_coordinates
from pdr_filter.values.uncertainty import RADIUS_68

# Minimum time between two fixes in the correlation of their errors. Fixes closer than this are simultaneous.
_SAME_S = 0.01
# Largest coordinate. Map grids on Earth are smaller, including those with a zone number in front of the easting. The
# square of a coordinate must keep enough digits to resolve a step.
_MAX_M = 1e9
# Range of standard deviations. Products of four of them, and of their inverses, must not overflow.
_MIN_STD, _MAX_STD = 1e-12, 1e12


@dataclass(frozen=True, slots=True, eq=False)
class PositionFix:
    """Position from another source (GNSS, Wi-Fi, a waypoint) with its covariance, and the storey if it is known.

    Attributes
    ----------
    time_s : float
        Time at which the position was true, on the clock of the samples, s.
    position_m : array_like, shape (2,)
        East and north, m: from the start, with north along the first heading, or in a frame of its own for a
        configuration of `Config.in_world_frame`. `pdr_filter.smooth` takes any frame.
    cov_m2 : array_like, shape (2, 2)
        Symmetric positive definite covariance of the position, m^2.
    received_time_s : float, optional
        Time at which the fix arrived, not before `time_s`, s. The default is `time_s`.
    correlation_s : float, default 0.0
        Time constant T of the errors, s: errors of two such fixes at an interval t have the correlation exp(-t / T). 0
        means independent errors.
    floor : int, optional
        Storey.
    altitude_m, altitude_std_m : float, optional
        Altitude above the ellipsoid or the sea, as its source defines it, and its standard deviation, m.

    Raises
    ------
    ValueError
        If a number is out of range, the covariance is not positive definite, or the fix arrives before its time.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> fix = pdr.PositionFix(12.0, (3.0, 4.0), 0.5**2 * np.eye(2))  # at 12 s, 0.5 m along each axis
    >>> there = pdr.PositionFix.from_lat_lon(12.0, 51.4779, -0.0015, (51.4777, -0.0015), accuracy_m=8.0)
    >>> there.position_m.round()
    array([ 0., 22.])
    """

    time_s: float
    position_m: FloatArray
    cov_m2: FloatArray
    received_time_s: float | None = None
    correlation_s: float = 0.0
    floor: int | None = None
    altitude_m: float | None = None
    altitude_std_m: float | None = None

    def __post_init__(self) -> None:
        _prepare(self)
        if self.position_m.shape != (2,) or not (np.abs(self.position_m) <= _MAX_M).all():
            raise ValueError(f"position_m must be (east, north) in m, up to {_MAX_M:g}, got {self.position_m}")
        if not (self.cov_m2.shape == (2, 2) and _is_cov(self.cov_m2)):
            raise ValueError(
                "cov_m2 must be a symmetric positive definite (2, 2) array in m2, of standard deviations from "
                f"{_MIN_STD:g} to {_MAX_STD:g} m, got {self.cov_m2}: give std_m**2 * np.eye(2)"
            )
        _check_correlation_and_floor(self)
        if (self.altitude_m is None) != (self.altitude_std_m is None):
            raise ValueError(
                f"altitude_m and altitude_std_m must be given together, got {self.altitude_m} and {self.altitude_std_m}"
            )
        if self.altitude_m is not None:
            check_array("altitude_m", self.altitude_m, remedy="leave it out if it is not known")
        if self.altitude_std_m is not None:
            _checked_std("altitude_std_m", self.altitude_std_m)

    @property
    def var_m2(self) -> float:
        """Variance along one axis, m^2: the mean of both axes."""
        return 0.5 * float(np.trace(self.cov_m2))

    @classmethod
    def from_lat_lon(
        cls,
        time_s: float,
        latitude_deg: float,
        longitude_deg: float,
        origin: Origin | tuple[float, float],
        *,
        std_m: float | None = None,
        accuracy_m: float | None = None,
        received_time_s: float | None = None,
    ) -> PositionFix:
        """Create a fix from a geographic position, in metres east and north of an origin.

        The given accuracy is used unchanged. For locations of a phone, which may claim too small an accuracy, use
        `pdr_filter.filter.fixes.gnss.position_fixes`.

        Parameters
        ----------
        time_s : float
            Time at which the position was true, on the clock of the samples, s.
        latitude_deg, longitude_deg : float
            WGS 84 coordinates, degrees.
        origin : Origin or (latitude_deg, longitude_deg)
            Origin of the frame of the fix.
        std_m : float, optional
            Standard deviation along each axis, m. Give either `std_m` or `accuracy_m`.
        accuracy_m : float, optional
            Radius that contains the true position with 68 % probability, m, as phones report it.
        received_time_s : float, optional
            Time at which the fix arrived, s. The default is `time_s`.

        Returns
        -------
        PositionFix
            The fix, with equal variances along both axes.

        Raises
        ------
        ValueError
            If the coordinates are invalid, or not exactly one of `std_m` and `accuracy_m` is given.
        """
        check_coordinates("a fix", latitude_deg, longitude_deg)
        if (std_m is None) == (accuracy_m is None):
            raise ValueError(
                "give either std_m (standard deviation along each axis) or accuracy_m (radius of 68 %), got "
                f"std_m={std_m} and accuracy_m={accuracy_m}"
            )
        if accuracy_m is None:
            each_m = _checked_std("std_m", std_m)
        else:
            each_m = _checked_std("accuracy_m", accuracy_m) / RADIUS_68
        position_m = Origin.of(origin).east_north_m(latitude_deg, longitude_deg)
        return cls(time_s, position_m, each_m**2 * np.eye(2), received_time_s)


@dataclass(frozen=True, slots=True, eq=False)
class GridFix:
    """Likelihood of the position in each cell of a grid, for a position with several candidates on a floor plan.

    Attributes
    ----------
    time_s : float
        Time at which the likelihood was true, on the clock of the samples, s.
    south_west_m : array_like, shape (2,)
        East and north of the outer corner of the first cell, m.
    cell_m : float
        Side of a cell, m.
    log_likelihood : array_like, shape (rows, columns)
        Log-likelihood of each cell, with rows from south to north and columns from west to east. Positions outside of
        the grid have the smallest value of the grid.
    received_time_s : float, optional
        Time at which the fix arrived, not before `time_s`, s. The default is `time_s`.
    correlation_s : float, default 0.0
        Time constant T of the errors, s: errors of two such fixes at an interval t have the correlation exp(-t / T). 0
        means independent errors.
    floor : int, optional
        Storey.

    Raises
    ------
    ValueError
        If a number or a shape is invalid, or the fix arrives before its time.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> log_likelihood = np.log([[0.6, 0.1, 0.3]])  # three cells of 3 m, side by side
    >>> fix = pdr.GridFix(12.0, (0.0, 0.0), 3.0, log_likelihood)
    >>> np.exp(fix.log_likelihood_at(np.array([[7.0, 1.0]]))).round(3)
    array([0.3])
    """

    time_s: float
    south_west_m: FloatArray
    cell_m: float
    log_likelihood: FloatArray
    received_time_s: float | None = None
    correlation_s: float = 0.0
    floor: int | None = None

    def __post_init__(self) -> None:
        _prepare(self)
        check_array("south_west_m", self.south_west_m, shape=(2,), remedy="give (east, north)")
        check_array("log_likelihood", self.log_likelihood)
        shape = self.log_likelihood.shape
        if len(shape) != 2 or 0 in shape:
            raise ValueError(
                f"log_likelihood must have rows (to the north) and columns (to the east), got shape {shape}"
            )
        check_array("cell_m", self.cell_m, "positive")
        _check_correlation_and_floor(self)

    def log_likelihood_at(self, position_m: FloatArray) -> FloatArray:
        """Return the log-likelihood at given positions.

        Parameters
        ----------
        position_m : ndarray, shape (N, 2)
            East and north, m.

        Returns
        -------
        ndarray, shape (N,)
            Log-likelihood of the cell of each position. Outside of the grid it is the smallest value of the grid.
        """
        column, row = np.floor((position_m - self.south_west_m) / self.cell_m).T
        n_rows, n_columns = self.log_likelihood.shape
        inside = (row >= 0) & (row < n_rows) & (column >= 0) & (column < n_columns)
        index = np.where(inside, row * n_columns + column, 0).astype(np.int64)
        return np.where(inside, self.log_likelihood.ravel()[index], self.log_likelihood.min())


def repetition(fix: PositionFix | GridFix, last_s: float) -> float:
    """Return the factor on the variance with which a fix counts as independent of the previous one, at `last_s`.

    The mean of correlated fixes at intervals t has (1 + r) / (1 - r) = coth(t / 2T) times the variance of independent
    ones, with r = exp(-t / T). The factor is 1 without a previous fix (`last_s` is -inf), and for independent errors.
    """
    if fix.correlation_s == 0 or math.isinf(last_s):
        return 1.0
    return 1.0 / math.tanh(max(abs(fix.time_s - last_s), _SAME_S) / (2.0 * fix.correlation_s))


@dataclass(frozen=True, slots=True)
class HeadingFix:
    """Walking direction from another source: a corridor, a trusted compass, or the course of a GNSS receiver.

    While the north of the track is unknown, the first heading fix determines it: the whole track is rotated to the fix
    (`Track.frame` is "heading fixes"). Later ones correct the heading, and those that contradict it are rejected.

    Attributes
    ----------
    time_s : float
        Time at which the heading was true, on the clock of the samples, s.
    walking_heading_rad : float
        Walking direction, rad, clockwise from north, -2 pi to 2 pi. All heading fixes, and position fixes, if any, must
        have the same north, such as true north or that of a building.
    std_rad : float
        Standard deviation, rad.
    received_time_s : float, optional
        Time at which the fix arrived, not before `time_s`, s. The default is `time_s`.

    Raises
    ------
    ValueError
        If a number is invalid, or the fix arrives before its time.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> corridor = pdr.HeadingFix(12.0, walking_heading_rad=np.pi / 2, std_rad=0.05)
    >>> corridor.std_rad
    0.05
    """

    time_s: float
    walking_heading_rad: float
    std_rad: float
    received_time_s: float | None = None

    def __post_init__(self) -> None:
        _prepare(self)
        check_heading("walking_heading_rad", self.walking_heading_rad)
        _checked_std("std_rad", self.std_rad)


@dataclass(frozen=True, slots=True)
class SpeedFix:
    """Walking speed from another source, such as a GNSS receiver. The filter learns the person's step length from it.

    Attributes
    ----------
    time_s : float
        Time at which the speed was true, on the clock of the samples, s.
    speed_mps : float
        Positive speed over ground, m/s.
    std_mps : float
        Standard deviation, m/s.
    received_time_s : float, optional
        Time at which the fix arrived, not before `time_s`, s. The default is `time_s`.

    Raises
    ------
    ValueError
        If a number is invalid, or the fix arrives before its time.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> pdr.SpeedFix(12.0, speed_mps=1.3, std_mps=0.1).speed_mps
    1.3
    """

    time_s: float
    speed_mps: float
    std_mps: float
    received_time_s: float | None = None

    def __post_init__(self) -> None:
        _prepare(self)
        check_array("speed_mps", self.speed_mps, "positive", remedy="give a Standstill for a pedestrian who stands")
        _checked_std("std_mps", self.std_mps)


@dataclass(frozen=True, slots=True)
class Standstill:
    """Period in which the pedestrian is known to stand: steps detected within it have no length.

    If their rate is that of walking, a note counts them, and the position is uncertain by the length that they lack.

    Attributes
    ----------
    time_s : float
        Begin of the period on the clock of the samples, s.
    end_s : float
        End of the period, s.
    received_time_s : float, optional
        Time at which the information arrived, not before `time_s`, s. The default is `time_s`. Steps that were reported
        before that time are not withdrawn.

    Raises
    ------
    ValueError
        If a number is invalid, or the period does not end after its begin.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> recording = pdr.simulate.demo_walk()
    >>> stood = pdr.Standstill(0.0, 20.0)
    >>> pdr.track(recording, fixes=[stood]).distance_m < pdr.track(recording).distance_m
    True
    """

    time_s: float
    end_s: float
    received_time_s: float | None = None

    def __post_init__(self) -> None:
        _prepare(self)
        if not self.time_s < self.end_s < np.inf:
            raise ValueError(
                f"end_s of a Standstill must be finite and after its time_s, got {self.time_s} to {self.end_s} s"
            )


@runtime_checkable
class Measurement(Protocol):
    """Interface of a user-defined fix: a measurement that depends on the position and the walking direction.

    The filter linearises the measurement at each estimate, gates it, and uses it at its time. The smoother does the
    same. A class needs two attributes, `time_s` and `received_time_s`, and the method `measurement`.

    Notes
    -----
    A measurement is rejected if its normalised innovation squared exceeds the 99.9 % quantile of the chi-square
    distribution. In an unknown frame, a measurement with a constant Jacobian that determines a position, a heading or
    both places and rotates the track as a PositionFix and a HeadingFix do. Other measurements wait until fixes have
    determined the frame.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> class LightBarrier:  # the pedestrian crosses a line at 5 m north
    ...     received_time_s = None
    ...
    ...     def __init__(self, time_s):
    ...         self.time_s = time_s
    ...
    ...     def measurement(self, position_m, heading_rad):
    ...         return np.array([position_m[1] - 5.0]), np.array([[0.0, 1.0]]), np.array([[0.1**2]])
    >>> isinstance(LightBarrier(12.0), pdr.protocols.Fix)
    True
    """

    @property
    def time_s(self) -> float:
        """Time at which the measurement was true, on the clock of the samples, s."""
        ...

    @property
    def received_time_s(self) -> float | None:
        """Time at which the measurement arrived, not before `time_s`, s. None means `time_s`."""
        ...

    def measurement(self, position_m: FloatArray, heading_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return residual, Jacobian and covariance of the measurement at a predicted position and walking direction.

        The residual is predicted minus measured. The other convention, an innovation (measured minus predicted) with
        the derivative of the prediction, is recognised by a numerical check and gives the same result.

        Parameters
        ----------
        position_m : ndarray, shape (2,)
            Predicted east and north in the frame of the track, m.
        heading_rad : float
            Predicted walking direction, rad, clockwise from the north of the track.

        Returns
        -------
        residual : ndarray, shape (k,)
            Predicted minus measured value, in any unit.
        jacobian : ndarray, shape (k, 2) or (k, 3)
            Derivatives of the residual with respect to east, north and, with three columns, the walking direction.
        cov : ndarray, shape (k, k)
            Covariance of the measurement error.
        """
        ...


# Prior probability that a range comes from a reflection, and the mean excess of a reflected range, in standard
# deviations of a direct range.
_REFLECTED_PROB, _MEAN_EXCESS_STD = 0.2, 10.0


@dataclass(frozen=True, slots=True, eq=False)
class RangeFix:
    """Distance to an anchor at a known position: UWB, Wi-Fi round-trip time, or Bluetooth channel sounding.

    A reflected signal makes a range too long and never too short. A range that is too long therefore has less weight,
    and a range longer than a direct path can explain is rejected. Ranges to one or two anchors can fit two positions.
    The filter tracks both until later ranges decide.

    Attributes
    ----------
    time_s : float
        Time at which the range was true, on the clock of the samples, s.
    anchor_m : array_like, shape (2,) or (3,)
        East and north of the anchor, and its height above the phone, m.
    range_m : float
        Distance in space, 0 or more, m.
    std_m : float
        Standard deviation of a range on a direct path, m.
    received_time_s : float, optional
        Time at which the fix arrived, not before `time_s`, s. The default is `time_s`.

    Raises
    ------
    ValueError
        If a number or a shape is invalid, or the fix arrives before its time.

    Notes
    -----
    With three anchors and 0.3 m of noise every two seconds, simulated walks of 180 m have a root mean square error of
    0.3 to 0.5 m. It is 0.4 to 0.7 m if a third of the ranges are 3 m too long, and 0.2 m after smoothing.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> fix = pdr.RangeFix(12.0, anchor_m=(3.0, 4.0), range_m=5.2, std_m=0.3)
    >>> residual, jacobian, cov = fix.measurement((0.0, 0.0), 0.0)
    >>> residual.round(2), jacobian
    (array([-0.2]), array([[-0.6, -0.8]]))
    """

    time_s: float
    anchor_m: FloatArray
    range_m: float
    std_m: float
    received_time_s: float | None = None

    def __post_init__(self) -> None:
        _prepare(self)
        if self.anchor_m.shape not in ((2,), (3,)) or not (np.abs(self.anchor_m) <= _MAX_M).all():
            raise ValueError(
                f"anchor_m must be (east, north) in m, or (east, north, up) with the height above the phone, up to "
                f"{_MAX_M:g}, got {self.anchor_m}"
            )
        if not 0 <= self.range_m <= _MAX_M:
            raise ValueError(f"range_m must be a distance in m, 0 to {_MAX_M:g}, got {self.range_m}; leave the fix out")
        check_number("std_m", self.std_m, _MIN_STD, _MAX_STD, "0.3 m is usual for UWB, 2 m for Wi-Fi")

    @property
    def up_m(self) -> float:
        """Height of the anchor above the phone, m. 0 if it is not given."""
        return float(self.anchor_m[2]) if len(self.anchor_m) == 3 else 0.0

    def measurement(self, position_m: FloatArray, heading_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return residual, Jacobian and variance of the range at a predicted position.

        Parameters
        ----------
        position_m : array_like, shape (2,)
            Predicted east and north, m.
        heading_rad : float
            Predicted walking direction, rad. It has no effect.

        Returns
        -------
        tuple of ndarray, shape (1,), (1, 2) and (1, 1)
            Predicted minus measured distance, m, its derivatives by east and north, and the variance of the range, m^2.
        """
        residual_m, direction = range_residuals(
            np.asarray(position_m, dtype=float), self.anchor_m[:2], self.up_m, self.range_m
        )
        return np.array([float(residual_m)]), direction[None], np.array([[self.std_m**2]])

    def direct_prob(self, residual_m: float, var_m2: float, reflected_prob: float = _REFLECTED_PROB) -> float:
        """Return the probability that the signal came on the direct path, given the residual of the range.

        Parameters
        ----------
        residual_m : float
            Predicted minus measured distance, m.
        var_m2 : float
            Total variance of the residual: of the prediction and of the range, m^2.
        reflected_prob : float, default 0.2
            Prior probability of a reflection.

        Returns
        -------
        float
            Posterior probability of the direct path.
        """
        residual, var, std = (np.array(number) for number in (residual_m, var_m2, self.std_m))
        log_direct, log_reflected = range_log_densities(residual, var, std, reflected_prob)
        return float(np.exp(log_direct - np.logaddexp(log_direct, log_reflected)))


def range_residuals(
    position_m: FloatArray, anchor_m: FloatArray, up_m: FloatArray | float, range_m: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Return predicted minus measured distances (...,) and their derivatives (..., 2) by east and north.

    `position_m` and `anchor_m` have the shape (..., 2).
    """
    away_m = position_m - anchor_m
    distance_m = np.sqrt((away_m**2).sum(axis=-1) + np.square(up_m))
    return distance_m - range_m, away_m / np.maximum(distance_m, _MIN_STD)[..., None]


def range_log_densities(
    residual_m: FloatArray, var_m2: FloatArray, std_m: FloatArray, reflected_prob: float = _REFLECTED_PROB
) -> tuple[FloatArray, FloatArray]:
    """Return the log densities (...,) of range residuals on direct paths and on reflected paths.

    Each includes the log prior probability of its path. `var_m2` are the total variances of the residuals. A reflected
    path is longer by an exponentially distributed excess with mean b = sqrt((10 std_m)^2 + var_m2). The noise of a
    direct path is added to it, and with e = -residual (measured minus predicted) the density is

        p(e) = exp(-max(e, 0) / b) / b * P(noise < e).

    P is the logistic approximation of the normal distribution for positive e, and a bound of its tail for negative e.
    """
    excess_m, all_std_m = -residual_m, np.sqrt(var_m2)
    # The variance of the track is part of the mean excess, so that an uncertain track does not make a range reflected.
    mean_m = np.sqrt((_MEAN_EXCESS_STD * std_m) ** 2 + var_m2)
    normed = excess_m / all_std_m
    log_direct = math.log(1.0 - reflected_prob) - 0.5 * normed**2 - np.log(all_std_m * math.sqrt(2.0 * math.pi))
    log_tail = np.where(normed < 0.0, math.log(0.5) - 0.5 * normed**2, -np.log1p(np.exp(-1.702 * np.abs(normed))))
    log_reflected = math.log(reflected_prob) - np.log(mean_m) - np.maximum(excess_m, 0.0) / mean_m + log_tail
    return log_direct, log_reflected


def _is_cov(cov_m2: FloatArray) -> bool:
    """True if a matrix (2, 2) is symmetric up to rounding and positive definite."""
    (_, upper), (lower, _) = cov_m2.tolist()
    is_symmetric = abs(upper - lower) <= 1e-8 + 1e-5 * abs(lower)
    return is_symmetric and bool(np.isfinite(cov_m2).all()) and _are_variances(np.linalg.eigvalsh(cov_m2))


def _are_variances(values: NDArray[Any]) -> bool:
    return bool(((values >= _MIN_STD**2) & (values <= _MAX_STD**2)).all())


def _prepare(fix: Any) -> None:
    """Convert the fields of a fix to floats or read-only arrays, and check its times.

    ValueError for a value that is not numeric. None is allowed in a field whose default is None. Fields of a subclass
    of the user may be anything.
    """
    own = next(c for c in type(fix).__mro__ if c.__module__ == __name__)
    for field in fields(own):
        if field.default is None and getattr(fix, field.name) is None:
            continue
        value: Any = getattr(fix, field.name)
        try:
            if isinstance(value, str | bytes):
                raise TypeError
            numbers = read_only(value) if field.type == "FloatArray" else float(value)
        except (TypeError, ValueError, OverflowError):
            what = f"{field.name} of {type(fix).__name__} must be a number or an array of numbers, got {value!r}"
            raise ValueError(what[:300]) from None
        object.__setattr__(fix, field.name, numbers)
    _check_times(fix.time_s, fix.received_time_s)


def _checked_std(name: str, value: Any) -> float:
    check_number(name, value, _MIN_STD, _MAX_STD, "give a positive one; leave out a fix whose error is not known")
    return float(value)


def _check_correlation_and_floor(fix: PositionFix | GridFix) -> None:
    """Raise ValueError for an invalid time constant or storey, and convert the storey to an integer."""
    check_array("correlation_s", fix.correlation_s, "0 or more")
    if fix.floor is not None:
        if not (np.isfinite(fix.floor) and fix.floor == np.round(fix.floor)):
            raise ValueError(f"floor must be a whole number, such as 0 for the ground floor, got {fix.floor!r}")
        object.__setattr__(fix, "floor", int(fix.floor))


def _check_times(time_s: float, received_time_s: float | None) -> None:
    received_s = time_s if received_time_s is None else received_time_s
    if not (np.isfinite(time_s) and np.isfinite(received_s) and received_s >= time_s):
        raise ValueError(
            "time_s and received_time_s of a fix must be finite, and received_time_s not before time_s, got "
            f"{time_s} and {received_time_s}"
        )


# Inputs of a filter besides samples.
Fix = PositionFix | GridFix | HeadingFix | SpeedFix | Standstill | Measurement
OWN_FIXES = PositionFix | GridFix | HeadingFix | SpeedFix | Standstill | RangeFix
AnyFix = TypeVar("AnyFix", bound=Fix)


def all_fixes(fixes: Iterable[AnyFix]) -> tuple[AnyFix, ...]:
    """Return the fixes of any iterable as a tuple. ValueError for a single fix and for other objects."""
    if isinstance(fixes, OWN_FIXES | Measurement):
        raise ValueError(f"fixes must be a sequence, got one {type(fixes).__name__}: give [fix]")
    if not isinstance(fixes, Iterable):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ValueError(f"fixes must be a sequence of fixes, got {fixes!r}: give other arguments by their names")
    return tuple(fixes)


def check_fix(fix: object, has_plan: bool) -> None:
    """Raise ValueError unless the filter can use an object as a fix. A GridFix needs a plan (`has_plan`)."""
    if not isinstance(fix, OWN_FIXES):
        _check_measurement(fix)
    if isinstance(fix, GridFix) and not has_plan:
        raise ValueError(
            f"a GridFix (at {fix.time_s:g} s) requires a particle filter on a floor plan: give plan as well, or "
            "replace the GridFix by a PositionFix with its mean and covariance, as RadioMap.fixes returns"
        )


def _check_measurement(fix: object) -> None:
    """Raise ValueError unless an object has the attributes of `Measurement`."""
    if isinstance(fix, type) or not isinstance(fix, Measurement):
        names = ("time_s", "received_time_s", "measurement")
        missing = [] if isinstance(fix, type) else [name for name in names if not hasattr(fix, name)]
        raise ValueError(
            "a fix must be a PositionFix, GridFix, HeadingFix, SpeedFix, RangeFix or Standstill, or an instance of a "
            f"class with time_s, received_time_s and measurement(position_m, heading_rad); without "
            f"{', '.join(missing) or 'an instance'}, got {str(fix)[:100]}; for a position give "
            "PositionFix(time_s, (east_m, north_m), std_m**2 * np.eye(2))"
        )
    for name in ("time_s", "received_time_s"):
        value = getattr(fix, name)
        if not (isinstance(value, Real) or (value is None and name == "received_time_s")):
            raise ValueError(f"{name} of {type(fix).__name__} must be a number in s, got {value!r}")
    _check_times(float(fix.time_s), None if fix.received_time_s is None else float(fix.received_time_s))


def measurement_of(
    fix: Measurement, position_m: FloatArray, heading_rad: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return residual (k,), Jacobian (k, 3) and covariance (k, k) of a measurement.

    The columns of the Jacobian are the derivatives of the returned residual by east, north and walking direction. If
    the class returns an innovation (measured minus predicted) with the derivative of the prediction, which a small
    displacement shows, the sign of the Jacobian is corrected. ValueError names what `measurement` must return.
    """
    name = type(fix).__name__
    if isinstance(fix, RangeFix):
        residual, direction, cov = fix.measurement(position_m, heading_rad)
        return residual, np.append(direction, [[0.0]], axis=1), cov
    try:
        residual, jacobian, cov = (np.asarray(part, dtype=float) for part in fix.measurement(position_m, heading_rad))
    except (TypeError, ValueError) as error:
        raise ValueError(f"measurement of {name} must return residual, jacobian and cov as arrays: {error}") from error
    k = residual.size
    if residual.shape != (k,) or jacobian.shape not in ((k, 2), (k, 3)) or cov.shape != (k, k) or k == 0:
        raise ValueError(
            f"measurement of {name} must return a residual (k,), k > 0, a jacobian (k, 2) or (k, 3) and a cov (k, k), "
            f"got shapes {residual.shape}, {jacobian.shape} and {cov.shape}"
        )
    if not (np.isfinite(residual).all() and np.isfinite(jacobian).all() and np.isfinite(cov).all()):
        raise ValueError(f"measurement of {name} must return finite numbers, got {residual}, {jacobian} and {cov}")
    if not (np.allclose(cov, cov.T) and _are_variances(np.linalg.eigvalsh(cov))):
        raise ValueError(
            f"cov of {name} must be symmetric and positive definite, of standard deviations from {_MIN_STD:g} to "
            f"{_MAX_STD:g}, got {cov}"
        )
    jacobian = np.column_stack([jacobian, np.zeros((k, 3 - jacobian.shape[1]))])
    moved = _SMALL * jacobian[np.abs(jacobian).sum(axis=1).argmax()]
    scale = math.sqrt(float(moved @ moved))
    if scale > 0:
        moved *= _SMALL / scale
        after = np.asarray(fix.measurement(position_m + moved[:2], heading_rad + float(moved[2]))[0], dtype=float)
        if float((after - residual) @ (jacobian @ moved)) < 0:
            jacobian = -jacobian
    return residual, jacobian, cov


# Displacement, in m and rad, for the numerical check of the sign of a derivative.
_SMALL = 1e-4


def stated_fixes(fix: Measurement) -> tuple[HeadingFix | PositionFix, ...]:
    """Return the heading fix and the position fix that a measurement of both is equivalent to, in this order.

    A measurement of one of them gives one fix, any other none. A measurement r = J x - z with covariance C has a
    constant J, with x = (east, north, heading). The fixes have the least-squares solution x and its covariance
    (J' C^-1 J)^-1, without the covariance of heading and position.
    """
    if isinstance(fix, RangeFix):
        return ()
    try:
        residual, jacobian, cov = measurement_of(fix, np.zeros(2), 0.0)
        weighted = jacobian.T @ np.linalg.inv(cov)
        x_cov = np.linalg.pinv(weighted @ jacobian, hermitian=True)
        x = -x_cov @ weighted @ residual
        residual_there, jacobian_there, cov_there = measurement_of(fix, x[:2], float(x[2]))
    except ValueError:  # such as a bearing at the position of its anchor
        return ()
    is_linear = np.allclose(jacobian, jacobian_there) and np.allclose(cov, cov_there)
    if not is_linear or not np.allclose(weighted @ residual_there, 0.0, atol=1e-6 * np.abs(weighted).max()):
        return ()
    has_heading, n_axes = bool(jacobian[:, 2].any()), int(np.linalg.matrix_rank(jacobian[:, :2]))
    if n_axes == 1 or np.linalg.matrix_rank(jacobian) != n_axes + has_heading:
        return ()
    stated: list[HeadingFix | PositionFix] = []
    if has_heading:
        heading_rad = math.remainder(float(x[2]), 2 * math.pi)
        stated.append(HeadingFix(fix.time_s, heading_rad, math.sqrt(float(x_cov[2, 2])), fix.received_time_s))
    if n_axes:
        stated.append(PositionFix(fix.time_s, x[:2], np.asarray(x_cov[:2, :2], dtype=float), fix.received_time_s))
    return tuple(stated)


def has_position(fix: Fix) -> bool:
    """True for a fix that places a track in its frame: a position, a range, or a measurement that states a position."""
    if isinstance(fix, PositionFix | RangeFix):
        return True
    if not isinstance(fix, Measurement):
        return False
    return any(isinstance(each, PositionFix) for each in stated_fixes(fix))


def has_frame(fix: Fix) -> bool:
    """True for a fix with a position or a direction in some frame: not a speed, a standstill or a grid on a plan."""
    return not isinstance(fix, GridFix | SpeedFix | Standstill)


def received_s(fix: Fix) -> float:
    """Return the time at which a fix was received, which is its own time if none is given."""
    return fix.time_s if fix.received_time_s is None else fix.received_time_s


FixOutcome = Literal[
    "used", "placed", "turned", "moved", "rejected", "frozen", "repeated", "waiting", "nothing to compare"
]


@dataclass(frozen=True, slots=True)
class FixResult:
    """Outcome of a fix.

    Attributes
    ----------
    kind : str
        "position", "grid", "heading", "speed", "standstill", "range", or the name of a user-defined class in lower
        case.
    time_s : float
        Time of the fix, s.
    used_s : float
        Time at which the filter processed the fix, s.
    outcome : str
        "used": the fix corrected the track. "placed": the first fix in an unknown frame, to which the track was
        shifted. "turned": one of the fixes that determine the rotation of the track. "moved": the last of several fixes
        that agree with each other but not with the track, which was shifted to them. "rejected": the fix does not fit
        the track or its time. "frozen": the fix repeats the previous position exactly during walking, as apps do
        without GNSS reception. "repeated": the fix has the values of an earlier one and was delivered again, so that it
        contains nothing new. "waiting": samples of its time, or ranges that determine a position together with it,
        are missing. "nothing to compare": there is no step or no known frame to which the fix applies.
    nis : float
        Normalised innovation squared, over all modes by their probabilities. Infinite for a fix with a wrong time. NaN
        if there was nothing to compare with.
    anchor_m : tuple of float or None
        East and north of the anchor of a range, m. None for other fixes.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> fix = pdr.HeadingFix(12.0, walking_heading_rad=0.0, std_rad=0.1)
    >>> track = pdr.track(pdr.simulate.demo_walk(), fixes=[fix])
    >>> result = track.fixes[0]
    >>> result.kind, result.outcome, result.accepted
    ('heading', 'used', True)
    """

    kind: str
    time_s: float
    used_s: float
    outcome: FixOutcome
    nis: float = np.nan
    anchor_m: tuple[float, float] | None = None

    @classmethod
    def of(cls, fix: Fix, used_s: float, outcome: FixOutcome, nis: float = np.nan) -> FixResult:
        """Create the result of a fix.

        Parameters
        ----------
        fix : PositionFix, GridFix, HeadingFix, RangeFix, SpeedFix, Standstill or Measurement
            The fix.
        used_s : float
            Time at which the filter processed the fix, s.
        outcome : str
            Outcome, as described for the attribute.
        nis : float, optional
            Normalised innovation squared. The default is NaN.

        Returns
        -------
        FixResult
            Result with kind and time of the fix.
        """
        anchor_m = (float(fix.anchor_m[0]), float(fix.anchor_m[1])) if isinstance(fix, RangeFix) else None
        return cls(type(fix).__name__.removesuffix("Fix").lower(), fix.time_s, used_s, outcome, nis, anchor_m)

    def turned(self, rotation: FloatArray) -> FixResult:
        """Return the result with its anchor in rotated axes.

        Parameters
        ----------
        rotation : ndarray, shape (2, 2)
            Rotation matrix.

        Returns
        -------
        FixResult
            Result with the rotated anchor. Results without an anchor are returned unchanged.
        """
        if self.anchor_m is None:
            return self
        east_m, north_m = (rotation @ self.anchor_m).tolist()
        return replace(self, anchor_m=(east_m, north_m))

    @property
    def accepted(self) -> bool:
        """True if the fix changed the track: "used", "placed", "turned" or "moved"."""
        return self.outcome in ("used", "placed", "turned", "moved")

    def to_dict(self) -> dict[str, Any]:
        """Return the fields and `accepted` as JSON values.

        Returns
        -------
        dict
            Fields by name. Numbers that are not finite are None.
        """
        return {**as_plain(self), "accepted": self.accepted}
