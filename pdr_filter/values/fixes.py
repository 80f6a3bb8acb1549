"""What is known from elsewhere: fixes of position, heading and speed, standstills."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

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
Fix = PositionFix | GridFix | HeadingFix | SpeedFix | Standstill
AnyFix = TypeVar("AnyFix", bound=Fix)


def all_fixes(fixes: Iterable[AnyFix]) -> tuple[AnyFix, ...]:
    """Fixes of any iterable, an iterator among them, as a tuple; ValueError for one fix where there may be several."""
    if isinstance(fixes, Fix):
        raise ValueError(f"fixes must be a sequence, got one {type(fixes).__name__}: give [fix]")
    return tuple(fixes)


def check_fix(fix: object, has_plan: bool) -> None:
    """ValueError unless it is a fix that the filter can use."""
    if not isinstance(fix, PositionFix | GridFix | HeadingFix | SpeedFix | Standstill):
        raise ValueError(
            f"a fix must be a PositionFix, GridFix, HeadingFix, SpeedFix or Standstill, got {fix!r}; a position is "
            "PositionFix(time_s, (east_m, north_m), std_m**2 * np.eye(2))"
        )
    if isinstance(fix, GridFix) and not has_plan:
        raise ValueError(
            f"a GridFix (at {fix.time_s:g} s) is for particles on a floor plan: give plan too, or its mean and "
            "covariance as a PositionFix, such as those of RadioMap.fixes"
        )


def received_s(fix: Fix) -> float:
    """When a fix became known: when it was received, or at once."""
    return fix.time_s if fix.received_time_s is None else fix.received_time_s


FixOutcome = Literal["used", "placed", "turned", "moved", "rejected", "frozen", "waiting", "nothing to compare"]


@dataclass(frozen=True, slots=True)
class FixResult:
    """What the filter made of a fix."""

    kind: str  # "position", "grid", "heading", "speed", "standstill"
    time_s: float  # when it was true
    used_s: float  # when the filter took it
    # "used"; "placed": the first in a frame that the track did not know, which is there from then on; "turned": one of
    # those that show which way the track lies there; "moved": the last of many that agree with each other and not with
    # the track, which is where they show it from then on; "rejected": it does not fit, or is of another time;
    # "frozen": it repeats the last position exactly while steps go on, as apps do when they have lost GNSS;
    # "waiting": for samples of its time; "nothing to compare": no step yet that it says something of.
    outcome: FixOutcome
    # Normalised innovation squared in the mode that explains it best; infinite if it is of another time, NaN where
    # there was nothing to compare it with.
    nis: float = np.nan

    @classmethod
    def of(cls, fix: Fix, used_s: float, outcome: FixOutcome, nis: float = np.nan) -> FixResult:
        """That of a fix."""
        return cls(type(fix).__name__.removesuffix("Fix").lower(), fix.time_s, used_s, outcome, nis)

    @property
    def accepted(self) -> bool:
        """Whether the filter used it."""
        return self.outcome in ("used", "placed", "turned", "moved")

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON has them, None for what is not finite."""
        return {**as_plain(self), "accepted": self.accepted}
