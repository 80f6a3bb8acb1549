"""What is known from elsewhere: fixes of position, heading and speed, standstills."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, Literal, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pdr_filter.values.arrays import FloatArray, read_only
from pdr_filter.values.checks import check_array, check_number
from pdr_filter.values.json_values import as_plain
from pdr_filter.values.origin import Origin, check_place
from pdr_filter.values.uncertainty import RADIUS_68

# Two fixes of one moment.
_SAME_S = 0.01
# What is further from its zero is in no frame of this Earth, grids with the number of their zone in front included; its
# square must leave enough digits to walk in.
_MAX_M = 1e9
# A standard deviation beyond this says nothing. Products of four of them, and of their inverses, must stay numbers.
_MIN_STD, _MAX_STD = 1e-12, 1e12


@dataclass(frozen=True, slots=True, eq=False)
class PositionFix:
    """A position from elsewhere (GNSS, Wi-Fi, a waypoint) with its covariance, and the storey if that is known.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> fix = pdr.PositionFix(12.0, (3.0, 4.0), 0.5**2 * np.eye(2))  # at 12 s, 0.5 m along each axis
    >>> there = pdr.PositionFix.from_lat_lon(12.0, 51.4779, -0.0015, (51.4777, -0.0015), accuracy_m=8.0)
    >>> there.position_m.round()
    array([ 0., 22.])
    """

    time_s: float  # when the position was true, on the time base of the samples
    position_m: FloatArray  # (2,) east, north
    cov_m2: FloatArray  # (2, 2) positive definite
    received_time_s: float | None = None  # when it arrived, not before `time_s`; `time_s` if not given
    correlation_s: float = 0.0  # T: errors of two such fixes a time t apart are alike by exp(-t / T); 0: not at all
    floor: int | None = None  # number of the storey
    altitude_m: float | None = None  # above the ellipsoid or the sea, as who fixed it counts; with its std
    altitude_std_m: float | None = None

    def __post_init__(self) -> None:
        _take_numbers(self, "time_s", "received_time_s", "correlation_s", "floor", "altitude_m", "altitude_std_m")
        _take_arrays(self, "position_m", "cov_m2")
        if self.position_m.shape != (2,) or not (np.abs(self.position_m) <= _MAX_M).all():
            raise ValueError(f"position_m must be (east, north) in m, up to {_MAX_M:g}, got {self.position_m}")
        if not (self.cov_m2.shape == (2, 2) and _is_cov(self.cov_m2)):
            raise ValueError(
                "cov_m2 must be a symmetric positive definite (2, 2) array in m2, of standard deviations from "
                f"{_MIN_STD:g} to {_MAX_STD:g} m, got {self.cov_m2}"
            )
        _check_correlation_and_floor(self)
        if (self.altitude_m is None) != (self.altitude_std_m is None):
            raise ValueError(
                f"altitude_m and altitude_std_m belong together, got {self.altitude_m} and {self.altitude_std_m}"
            )
        if self.altitude_m is not None:
            check_array("altitude_m", self.altitude_m, remedy="leave it out if it is not known")
        if self.altitude_std_m is not None:
            _checked_std("altitude_std_m", self.altitude_std_m)
        _check_times(self.time_s, self.received_time_s)

    @property
    def var_m2(self) -> float:
        """Variance of one axis, the mean of both."""
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
        """The fix of a place on Earth, in metres east and north of an origin (an Origin, or latitude and longitude).

        Either `std_m`, the standard deviation along each axis, or `accuracy_m`, the radius that holds 68 %, as phones
        report it. It is taken at its word: `pdr_filter.filter.fixes.gnss.position_fixes` doubts a phone that claims too
        much.
        """
        check_place("a fix", latitude_deg, longitude_deg)
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
    """How probable each cell of a grid is, where somebody may be in several places: for a track on a floor plan.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> either = np.log([[0.6, 0.1, 0.3]])  # of three cells side by side, of 3 m
    >>> fix = pdr.GridFix(12.0, (0.0, 0.0), 3.0, either)
    >>> np.exp(fix.log_likelihood_at(np.array([[7.0, 1.0]]))).round(3)
    array([0.3])
    """

    time_s: float  # when it was true, on the time base of the samples
    south_west_m: FloatArray  # (2,) east, north of the corner of the first cell
    cell_m: float  # side of a cell
    log_likelihood: FloatArray  # (rows to the north, columns to the east); outside of it is as its least cell
    received_time_s: float | None = None  # when it arrived, not before `time_s`; `time_s` if not given
    correlation_s: float = 0.0  # as that of a `PositionFix`
    floor: int | None = None  # number of the storey

    def __post_init__(self) -> None:
        _take_numbers(self, "time_s", "received_time_s", "cell_m", "correlation_s", "floor")
        _take_arrays(self, "south_west_m", "log_likelihood")
        check_array("south_west_m", self.south_west_m, shape=(2,), remedy="give (east, north)")
        check_array("log_likelihood", self.log_likelihood)
        shape = self.log_likelihood.shape
        if len(shape) != 2 or 0 in shape:
            raise ValueError(f"log_likelihood must be (rows to the north, columns to the east), got {shape}")
        check_array("cell_m", self.cell_m, "positive")
        _check_correlation_and_floor(self)
        _check_times(self.time_s, self.received_time_s)

    def log_likelihood_at(self, position_m: FloatArray) -> FloatArray:
        """That of the cells of positions (N, 2), (N,)."""
        column, row = np.floor((position_m - self.south_west_m) / self.cell_m).T
        n_rows, n_columns = self.log_likelihood.shape
        inside = (row >= 0) & (row < n_rows) & (column >= 0) & (column < n_columns)
        index = np.where(inside, row * n_columns + column, 0).astype(np.int64)
        return np.where(inside, self.log_likelihood.ravel()[index], self.log_likelihood.min())


def repetition(fix: PositionFix | GridFix, last_s: float) -> float:
    """By how much the variance must be multiplied for a fix and one before it to count as independent.

    Of correlated fixes at intervals t the mean is (1 + r) / (1 - r) = coth(t / 2T) times as uncertain as that of
    independent ones, r = exp(-t / T): any number of them in a time T is one witness. One where none was before.
    """
    if fix.correlation_s == 0 or math.isinf(last_s):
        return 1.0
    return 1.0 / math.tanh(max(abs(fix.time_s - last_s), _SAME_S) / (2.0 * fix.correlation_s))


@dataclass(frozen=True, slots=True)
class HeadingFix:
    """A walking heading from elsewhere: a corridor, a compass that is trusted, the course of a GNSS receiver.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> corridor = pdr.HeadingFix(12.0, walking_heading_rad=np.pi / 2, std_rad=0.05)
    """

    time_s: float  # when it was true, on the time base of the samples
    walking_heading_rad: float  # clockwise from the track's north, any number of turns
    std_rad: float  # standard deviation
    received_time_s: float | None = None  # when it arrived, not before `time_s`; `time_s` if not given

    def __post_init__(self) -> None:
        _take_numbers(self, "time_s", "received_time_s", "walking_heading_rad", "std_rad")
        _check_times(self.time_s, self.received_time_s)
        check_array("walking_heading_rad", self.walking_heading_rad)
        _checked_std("std_rad", self.std_rad)


@dataclass(frozen=True, slots=True)
class SpeedFix:
    """A walking speed from elsewhere, such as a GNSS receiver's: it teaches the person's step scale.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> pdr.SpeedFix(12.0, speed_mps=1.3, std_mps=0.1).speed_mps
    1.3
    """

    time_s: float  # when it was true, on the time base of the samples
    speed_mps: float  # over ground, positive
    std_mps: float  # standard deviation
    received_time_s: float | None = None  # when it arrived, not before `time_s`; `time_s` if not given

    def __post_init__(self) -> None:
        _take_numbers(self, "time_s", "received_time_s", "speed_mps", "std_mps")
        _check_times(self.time_s, self.received_time_s)
        check_array("speed_mps", self.speed_mps, "positive", remedy="somebody who stands is a Standstill")
        _checked_std("std_mps", self.std_mps)


@dataclass(frozen=True, slots=True)
class Standstill:
    """The person is known to stand: steps in this time were not walked.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> recording = pdr.simulate.demo_walk()
    >>> stood = pdr.Standstill(0.0, 20.0)
    >>> pdr.track(recording, fixes=[stood]).distance_m < pdr.track(recording).distance_m
    True
    """

    time_s: float  # begin and end, on the time base of the samples
    end_s: float
    received_time_s: float | None = None  # not before `time_s`; steps that were reported before are not taken back

    def __post_init__(self) -> None:
        _take_numbers(self, "time_s", "received_time_s", "end_s")
        _check_times(self.time_s, self.received_time_s)
        if not self.time_s < self.end_s < np.inf:
            raise ValueError(f"a standstill must end after its begin, got {self.time_s} to {self.end_s} s")


@runtime_checkable
class Measurement(Protocol):
    """A fix of any other kind: a measurement that depends on where the person was and which way the phone pointed.

    The filter linearises it again at each estimate, gates it, and uses it at its time; the smoother does the same.
    A class needs two attributes, `time_s` and `received_time_s` (None for at once), and one method.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> class OnLine:  # the person crosses a light barrier at 5 m north
    ...     received_time_s = None
    ...
    ...     def __init__(self, time_s):
    ...         self.time_s = time_s
    ...
    ...     def measurement(self, position_m, heading_rad):
    ...         return np.array([position_m[1] - 5.0]), np.array([[0.0, 1.0]]), np.array([[0.1**2]])
    >>> isinstance(OnLine(12.0), pdr.protocols.Fix)
    True
    """

    @property
    def time_s(self) -> float:
        """When it was true, on the time base of the samples."""
        ...

    @property
    def received_time_s(self) -> float | None:
        """When it arrived, not before `time_s`; None for `time_s`."""
        ...

    def measurement(self, position_m: FloatArray, heading_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residual (k,), its Jacobian (k, 2) or (k, 3), and the covariance (k, k) of the measurement's error.

        `position_m` (2,) is east and north in m, and `heading_rad` the walking heading, clockwise from north, both in
        the frame of the track. The residual is predicted less measured, in any unit. The columns of the Jacobian are
        its derivatives with respect to east, north and, if there are three, the heading. The other usual convention,
        an innovation (measured less predicted) with the derivative of the prediction, is recognised and means the same.
        """
        ...


# Probability that a range comes from a reflection where no others are known, and by how many standard deviations it is
# then too long in the mean.
_REFLECTED_PROB, _MEAN_EXCESS_STD = 0.2, 10.0


@dataclass(frozen=True, slots=True, eq=False)
class RangeFix:
    """A distance to an anchor whose place is known: UWB, Wi-Fi round-trip time, Bluetooth channel sounding.

    A signal that was reflected on its way makes the range too long and never too short. A too long range therefore
    counts less, and one that is longer than a direct path explains is rejected.

    Ranges to one or two anchors can fit two places. The filter follows both until later ranges decide
    (docs/ranges.md).

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> fix = pdr.RangeFix(12.0, anchor_m=(3.0, 4.0), range_m=5.2, std_m=0.3)
    >>> residual, jacobian, cov = fix.measurement((0.0, 0.0), 0.0)
    >>> residual.round(2), jacobian
    (array([-0.2]), array([[-0.6, -0.8]]))
    """

    time_s: float  # when it was true, on the time base of the samples
    anchor_m: FloatArray  # (2,) east, north; or (3,) with the height of the anchor above the phone
    range_m: float  # distance in space, not negative
    std_m: float  # standard deviation on a direct path
    received_time_s: float | None = None  # when it arrived, not before `time_s`; `time_s` if not given

    def __post_init__(self) -> None:
        _take_numbers(self, "time_s", "received_time_s", "range_m", "std_m")
        _take_arrays(self, "anchor_m")
        if self.anchor_m.shape not in ((2,), (3,)) or not (np.abs(self.anchor_m) <= _MAX_M).all():
            raise ValueError(
                f"anchor_m must be (east, north) in m, or (east, north, up) with the height above the phone, up to "
                f"{_MAX_M:g}, got {self.anchor_m}"
            )
        if not 0 <= self.range_m <= _MAX_M:
            raise ValueError(f"range_m must be a distance in m, 0 to {_MAX_M:g}, got {self.range_m}; leave the fix out")
        if not _MIN_STD <= self.std_m <= _MAX_STD:
            raise ValueError(f"std_m must be positive, got {self.std_m}; 0.3 is usual for UWB, 2 for Wi-Fi")
        _check_times(self.time_s, self.received_time_s)

    @property
    def up_m(self) -> float:
        """Height of the anchor above the phone; 0 if it is not given."""
        return float(self.anchor_m[2]) if len(self.anchor_m) == 3 else 0.0

    def measurement(self, position_m: FloatArray, heading_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residual (1,), Jacobian (1, 2) and variance (1, 1): see `pdr_filter.protocols.Fix`."""
        residual_m, direction = range_residuals(
            np.asarray(position_m, dtype=float), self.anchor_m[:2], self.up_m, self.range_m
        )
        return np.array([float(residual_m)]), direction[None], np.array([[self.std_m**2]])

    def direct_prob(self, residual_m: float, var_m2: float, reflected_prob: float = _REFLECTED_PROB) -> float:
        """Probability that the path was direct, given a residual that has this variance in all."""
        residual, var, std = (np.array(number) for number in (residual_m, var_m2, self.std_m))
        log_direct, log_reflected = range_log_densities(residual, var, std, reflected_prob)
        return float(np.exp(log_direct - np.logaddexp(log_direct, log_reflected)))


def range_residuals(
    position_m: FloatArray, anchor_m: FloatArray, up_m: FloatArray | float, range_m: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Distance less range (...,) of positions (..., 2) from anchors (..., 2), and its derivative (..., 2)."""
    away_m = position_m - anchor_m
    distance_m = np.sqrt((away_m**2).sum(axis=-1) + np.square(up_m))
    return distance_m - range_m, away_m / np.maximum(distance_m, _MIN_STD)[..., None]


def range_log_densities(
    residual_m: FloatArray, var_m2: FloatArray, std_m: FloatArray, reflected_prob: float = _REFLECTED_PROB
) -> tuple[FloatArray, FloatArray]:
    """Log densities (...,) of residuals of ranges with variances in all, on direct paths and on reflected ones.

    Reflected paths are longer by an exponential distribution with mean b, and all have the noise of direct ones:
    p(e) = exp(-max(e, 0) / b) / b * P(noise < e), with the logistic approximation of the normal distribution for
    positive e, and a bound of its tail for negative e.
    """
    excess_m, all_std_m = -residual_m, np.sqrt(var_m2)
    mean_m = np.sqrt((_MEAN_EXCESS_STD * std_m) ** 2 + var_m2)  # an unsure track does not make a range reflected
    normed = excess_m / all_std_m
    log_direct = math.log(1.0 - reflected_prob) - 0.5 * normed**2 - np.log(all_std_m * math.sqrt(2.0 * math.pi))
    log_tail = np.where(normed < 0.0, math.log(0.5) - 0.5 * normed**2, -np.log1p(np.exp(-1.702 * np.abs(normed))))
    log_reflected = math.log(reflected_prob) - np.log(mean_m) - np.maximum(excess_m, 0.0) / mean_m + log_tail
    return log_direct, log_reflected


def _is_cov(cov_m2: FloatArray) -> bool:
    """Whether it is symmetric, but for rounding, and positive definite, (2, 2)."""
    (_, upper), (lower, _) = cov_m2.tolist()
    is_symmetric = abs(upper - lower) <= 1e-8 + 1e-5 * abs(lower)
    return is_symmetric and bool(np.isfinite(cov_m2).all()) and _are_variances(np.linalg.eigvalsh(cov_m2))


def _are_variances(values: NDArray[Any]) -> bool:
    return bool(((values >= _MIN_STD**2) & (values <= _MAX_STD**2)).all())


_MAY_BE_UNKNOWN = ("received_time_s", "floor", "altitude_m", "altitude_std_m")


def _take_numbers(fix: object, *names: str) -> None:
    """Make fields floats; ValueError for what is no number."""
    for name in names:
        value = getattr(fix, name)
        if value is not None or name not in _MAY_BE_UNKNOWN:
            object.__setattr__(fix, name, _taken(fix, name, value, float))


def _take_arrays(fix: object, *names: str) -> None:
    """Make fields read-only arrays of floats; ValueError for what is none."""
    for name in names:
        object.__setattr__(fix, name, _taken(fix, name, getattr(fix, name), read_only))


def _taken(fix: object, name: str, value: Any, as_numbers: Callable[[Any], Any]) -> Any:
    try:
        if isinstance(value, str | bytes):
            raise TypeError
        return as_numbers(value)
    except (TypeError, ValueError, OverflowError):
        what = f"{name} of {type(fix).__name__} must be a number or an array of numbers, got {value!r}"
        raise ValueError(what[:300]) from None


def _checked_std(name: str, value: Any) -> float:
    check_number(name, value, _MIN_STD, _MAX_STD, "give a positive one; leave out a fix whose error is not known")
    return float(value)


def _check_correlation_and_floor(fix: PositionFix | GridFix) -> None:
    """ValueError unless they can be meant; the floor becomes a whole number."""
    check_array("correlation_s", fix.correlation_s, "0 or more")
    if fix.floor is not None:
        if not (np.isfinite(fix.floor) and fix.floor == np.round(fix.floor)):
            raise ValueError(f"floor must be a whole number, such as 0 for the ground floor, got {fix.floor!r}")
        object.__setattr__(fix, "floor", int(fix.floor))


def _check_times(time_s: float, received_time_s: float | None) -> None:
    received_s = time_s if received_time_s is None else received_time_s
    if not (np.isfinite(time_s) and np.isfinite(received_s) and received_s >= time_s):
        raise ValueError(
            f"time_s of a fix must be finite and received_time_s not before it, got {time_s} and {received_time_s}"
        )


# What a filter takes besides samples.
Fix = PositionFix | GridFix | HeadingFix | SpeedFix | Standstill | Measurement
OWN_FIXES = PositionFix | GridFix | HeadingFix | SpeedFix | Standstill | RangeFix
AnyFix = TypeVar("AnyFix", bound=Fix)


def all_fixes(fixes: Iterable[AnyFix]) -> tuple[AnyFix, ...]:
    """Fixes of any iterable, an iterator among them, as a tuple; ValueError for one fix where there may be several."""
    if isinstance(fixes, OWN_FIXES | Measurement):
        raise ValueError(f"fixes must be a sequence, got one {type(fixes).__name__}: give [fix]")
    return tuple(fixes)


def check_fix(fix: object, has_plan: bool) -> None:
    """ValueError unless it is a fix that the filter can use."""
    if not isinstance(fix, OWN_FIXES):
        _check_measurement(fix)
    if isinstance(fix, GridFix) and not has_plan:
        raise ValueError(
            f"a GridFix (at {fix.time_s:g} s) is for particles on a floor plan: give plan too, or its mean and "
            "covariance as a PositionFix, such as those of RadioMap.fixes"
        )


def _check_measurement(fix: object) -> None:
    """ValueError unless it has what `Measurement` needs."""
    if isinstance(fix, type) or not isinstance(fix, Measurement):
        names = ("time_s", "received_time_s", "measurement")
        missing = [] if isinstance(fix, type) else [name for name in names if not hasattr(fix, name)]
        raise ValueError(
            "a fix must be a PositionFix, GridFix, HeadingFix, SpeedFix, RangeFix or Standstill, or an instance of a "
            f"class with time_s, received_time_s and measurement(position_m, heading_rad); without "
            f"{', '.join(missing) or 'an instance'}, got {str(fix)[:100]}; a position is "
            "PositionFix(time_s, (east_m, north_m), std_m**2 * np.eye(2))"
        )
    for name in ("time_s", "received_time_s"):
        value = getattr(fix, name)
        if not (isinstance(value, Real) or (value is None and name == "received_time_s")):
            raise ValueError(f"{name} of {type(fix).__name__} must be a number in s, got {value!r}")
    _check_times(float(fix.time_s), None if fix.received_time_s is None else float(fix.received_time_s))


def measured(fix: Measurement, position_m: FloatArray, heading_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residual (k,), its derivative (k, 3) with respect to east, north and heading, and the covariance (k, k).

    ValueError that names what the measurement must return. A derivative of the prediction, which is minus that of the
    residual where the residual is measured less predicted, is recognised by a small displacement.
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
            f"measurement of {name} must return a residual (k,), a jacobian (k, 2) or (k, 3) and a cov (k, k), got "
            f"shapes {residual.shape}, {jacobian.shape} and {cov.shape}"
        )
    if not (np.isfinite(residual).all() and np.isfinite(jacobian).all() and np.isfinite(cov).all()):
        raise ValueError(f"measurement of {name} must return finite numbers, got {residual}, {jacobian} and {cov}")
    if not (np.allclose(cov, cov.T) and _are_variances(np.linalg.eigvalsh(cov))):
        raise ValueError(f"cov of {name} must be symmetric and positive definite, got {cov}")
    jacobian = np.column_stack([jacobian, np.zeros((k, 3 - jacobian.shape[1]))])
    moved = _SMALL * jacobian[np.abs(jacobian).sum(axis=1).argmax()]
    scale = math.sqrt(float(moved @ moved))
    if scale > 0:
        moved *= _SMALL / scale
        after = np.asarray(fix.measurement(position_m + moved[:2], heading_rad + float(moved[2]))[0], dtype=float)
        if float((after - residual) @ (jacobian @ moved)) < 0:
            jacobian = -jacobian
    return residual, jacobian, cov


# Displacement in m and rad that shows the sign of a derivative.
_SMALL = 1e-4


def has_frame(fix: Fix) -> bool:
    """True of a fix that is in a frame: all but those of speeds, standstills and grids, which are on a plan."""
    return not isinstance(fix, GridFix | SpeedFix | Standstill)


def received_s(fix: Fix) -> float:
    """When a fix became known: when it was received, or at once."""
    return fix.time_s if fix.received_time_s is None else fix.received_time_s


FixOutcome = Literal["used", "placed", "turned", "moved", "rejected", "frozen", "waiting", "nothing to compare"]


@dataclass(frozen=True, slots=True)
class FixResult:
    """What the filter made of a fix."""

    kind: str  # "position", "grid", "heading", "speed", "standstill", "range", or the lower-case name of another class
    time_s: float  # when it was true
    used_s: float  # when the filter took it
    # "used"; "placed": the first in a frame that the track did not know, which is there from then on; "turned": one of
    # those that show which way the track lies there; "moved": the last of many that agree with each other and not with
    # the track, which is where they show it from then on; "rejected": it does not fit, or is of another time;
    # "frozen": it repeats the last position exactly while steps go on, as apps do when they have lost GNSS;
    # "waiting": for samples of its time, or for ranges that show with it where the track is; "nothing to compare": no
    # step yet that it says something of, or no known frame.
    outcome: FixOutcome
    # Normalised innovation squared in the mode that explains it best; infinite if it is of another time, NaN where
    # there was nothing to compare it with.
    nis: float = np.nan
    anchor_m: tuple[float, float] | None = None  # east and north of the anchor of a range; None for other fixes

    @classmethod
    def of(cls, fix: Fix, used_s: float, outcome: FixOutcome, nis: float = np.nan) -> FixResult:
        """That of a fix."""
        anchor_m = (float(fix.anchor_m[0]), float(fix.anchor_m[1])) if isinstance(fix, RangeFix) else None
        return cls(type(fix).__name__.removesuffix("Fix").lower(), fix.time_s, used_s, outcome, nis, anchor_m)

    def turned(self, rotation: FloatArray) -> FixResult:
        """Return the result with its anchor in axes that are turned by a rotation (2, 2)."""
        if self.anchor_m is None:
            return self
        east_m, north_m = (rotation @ self.anchor_m).tolist()
        return replace(self, anchor_m=(east_m, north_m))

    @property
    def accepted(self) -> bool:
        """Whether the filter used it."""
        return self.outcome in ("used", "placed", "turned", "moved")

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON has them, None for what is not finite."""
        return {**as_plain(self), "accepted": self.accepted}
