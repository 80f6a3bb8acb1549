"""Conversion of phone locations to position fixes in metres with realistic errors.

The locations of a phone are already smoothed. Reflections and the ionosphere shift consecutive locations in the same
direction. The correlation of errors a time t apart is exp(-t / T), with T in `PositionFix.correlation_s`. The filter
uses from each fix only the information that earlier ones do not contain (`pdr_filter.filter.fixes.fix_updates`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pdr_filter.values import N_BEFORE, RADIUS_68, FloatArray, Origin, PositionFix, Samples, repeated_cov_m2

# Smallest accuracy: the error of phones under open sky (F. van Diggelen and P. Enge, "The world's first GPS MOOC and
# worldwide laboratory using smartphones", ION GNSS+ 2015). A smaller reported accuracy is the scatter of the phone's
# filter.
MIN_ACCURACY_M = 4.9
# Correlation time T of the errors. This is an assumption between two values: a walking person meets one reflection for
# some seconds, and the autocorrelation of a static receiver has a bend after one minute (D. L. Wilson, twenty days of a
# Garmin 12XL).
CORRELATION_S = 20.0
# Half of the correlation time. More frequent fixes hardly add information. The rotation of a track is estimated from a
# limited number of fixes (`frame_rotation.MAX_PAIRS`), which then cover some minutes.
INTERVAL_S = 10.0
# Vertical standard deviation relative to that along each horizontal axis. 95 % of the errors are below 13 m vertically
# and below 8 m horizontally ("GPS standard positioning service performance standard", 5th edition, 2020).
_VERTICAL_RATIO = 2.0
# Largest accuracy radius, about the size of a country. Its square must be finite.
MAX_ACCURACY_M = 1e5


@dataclass(frozen=True, slots=True)
class LocationState:
    """State of the conversion of locations to fixes: origin of the fixes, and counts of unusable locations.

    Attributes
    ----------
    origin : Origin or None
        Geographic origin of the fixes: the first usable location unless another origin was given.
    last_s : float
        Time of the last fix, or minus infinity.
    n : int
        Number of locations.
    n_not_on_earth : int
        Number of locations whose coordinates are not a place on Earth.
    n_without_accuracy : int
        Number of locations without an accuracy.
    n_backward : int
        Number of locations whose time is not finite or not after the time of the last fix.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.filter.fixes.gnss import LocationState, position_fixes
    >>> state, fixes = position_fixes(LocationState(), np.zeros(1), np.array([48.1]), np.array([11.6]), np.zeros(1))
    >>> state.n, state.n_without_accuracy, state.n_unusable
    (1, 1, 1)
    """

    origin: Origin | None = None
    last_s: float = -math.inf
    n: int = 0
    n_not_on_earth: int = 0
    n_without_accuracy: int = 0
    n_backward: int = 0

    @property
    def n_unusable(self) -> int:
        """Number of locations that cannot be used.

        Usable locations that are skipped because they follow the last fix too closely do not count.
        """
        return self.n_not_on_earth + self.n_without_accuracy + self.n_backward

    def reasons(self) -> str:
        """Return the reasons why locations are not used.

        Returns
        -------
        str
            Number of locations for each reason, with its remedy. Empty if all locations are usable.
        """
        causes = {
            "coordinates that are not a place on Earth (give latitude and longitude in degrees)": self.n_not_on_earth,
            "no horizontal accuracy above 0 (export the accuracy, or pass the positions as fixes)": (
                self.n_without_accuracy
            ),
            "a time that is not after the previous one (sort the locations by time)": self.n_backward,
        }
        return ", ".join(f"{n} with {words}" for words, n in causes.items() if n)

    def unusable(self) -> str:
        """Return a message about the locations that are not used.

        Returns
        -------
        str
            Number of unusable locations, and the reasons.
        """
        return f"{self.n_unusable} of {self.n} locations are not used: {self.reasons()}"


def position_fixes(
    state: LocationState,
    time_s: FloatArray,
    latitude_deg: FloatArray,
    longitude_deg: FloatArray,
    accuracy_m: FloatArray,
    interval_s: float = INTERVAL_S,
    altitude_m: FloatArray | None = None,
) -> tuple[LocationState, tuple[PositionFix, ...]]:
    """Return the state after some locations, and the position fixes made from them.

    A location is left out and counted if it is not a place on Earth, if its time is not finite or not after that of the
    last fix, or if it has no accuracy. Phones without an accuracy report 0 (Android), a negative number (iOS) or
    nothing. Locations closer than `interval_s` to the last fix are left out as well. Locations may arrive in blocks of
    any size with identical results.

    Parameters
    ----------
    state : LocationState
        State after earlier locations, or `LocationState()`.
    time_s : (N,) array
        Times on the time base of the samples.
    latitude_deg, longitude_deg : (N,) array
        Coordinates on WGS 84.
    accuracy_m : (N,) array
        Horizontal accuracy as reported by the phone: the radius in m of the 68 % circle.
    interval_s : float, default 10.0
        Smallest time in s between two fixes.
    altitude_m : (N,) array, optional
        Altitudes in m. An altitude of 0 counts as missing.

    Returns
    -------
    state : LocationState
        State after these locations.
    fixes : tuple of PositionFix
        Fixes in metres (east, north) from the origin, with a correlation time of 20 s.

    Notes
    -----
    The accuracy is at least 4.9 m, the error of phones under open sky (F. van Diggelen and P. Enge, "The world's first
    GPS MOOC and worldwide laboratory using smartphones", ION GNSS+ 2015).

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.filter.fixes.gnss import LocationState, position_fixes
    >>> time_s, latitude_deg = np.array([0.0, 5.0, 12.0]), np.array([48.1, 48.1001, 48.1002])
    >>> state, fixes = position_fixes(LocationState(), time_s, latitude_deg, np.full(3, 11.6), np.full(3, 6.0))
    >>> [fix.time_s for fix in fixes]
    [0.0, 12.0]
    >>> fixes[1].position_m.round()
    array([ 0., 22.])
    """
    fixes: list[PositionFix] = []
    origin, last_s = state.origin, state.last_s
    n_not_on_earth, n_without_accuracy, n_backward = state.n_not_on_earth, state.n_without_accuracy, state.n_backward
    # one location at a time: the bits of a vectorised sine depend on the length of the array
    altitude_m = np.full(len(time_s), np.nan) if altitude_m is None else altitude_m
    rows = np.column_stack([time_s, latitude_deg, longitude_deg, accuracy_m, altitude_m]).tolist()
    for t, latitude, longitude, accuracy, altitude in rows:
        if not _is_on_earth(latitude, longitude):
            n_not_on_earth += 1
        elif not _is_accuracy(accuracy):
            n_without_accuracy += 1
        elif not last_s < t < math.inf:
            n_backward += 1
        elif t >= last_s + interval_s:
            origin, last_s = origin or Origin(latitude, longitude), t
            std_m = max(accuracy, MIN_ACCURACY_M) / RADIUS_68
            position_m, cov_m2 = origin.east_north_m(latitude, longitude), std_m**2 * np.eye(2)
            fix = PositionFix(t, position_m, cov_m2, correlation_s=CORRELATION_S)
            if math.isfinite(altitude) and altitude != 0.0:
                fix = replace(fix, altitude_m=altitude, altitude_std_m=_VERTICAL_RATIO * std_m)
            fixes.append(fix)
    n = state.n + len(rows)
    return LocationState(origin, last_s, n, n_not_on_earth, n_without_accuracy, n_backward), tuple(fixes)


# Largest accuracy radius at which displacements of some metres are visible.
_GOOD_M = 10.0
# Age up to which a location counts as the present position.
_PRESENT_S = 2.0
_MAX_SPEED_MPS = 2.0  # fast walking
_NO_POSITION = [math.nan, math.nan]


def good_locations(
    origin: Origin,
    time_s: FloatArray,
    latitude_deg: FloatArray,
    longitude_deg: FloatArray,
    accuracy_m: FloatArray,
    last: tuple[float, float, float] = (-math.inf, math.nan, math.nan),
) -> FloatArray:
    """Return time, east and north (P, 3) of the locations (N,) that are later than the row `last` and all earlier ones.

    East and north are NaN if the coordinates are not a place on Earth, if the accuracy is unknown or above 10 m, or if
    the location is farther from the one before than its accuracy and a pedestrian's speed allow: its accuracy is then
    stated too small.
    """
    found = list[tuple[float, float, float]]()
    last_s, *last_m = last
    # one location at a time: the bits of a vectorised sine depend on the length of the array
    for t, *place, accuracy in np.column_stack([time_s, latitude_deg, longitude_deg, accuracy_m]).tolist():
        if last_s < t < math.inf:
            is_good = _is_on_earth(*place) and 0 < accuracy <= _GOOD_M
            position_m = origin.east_north_m(*place).tolist() if is_good else _NO_POSITION
            if math.dist(position_m, last_m) > accuracy + _MAX_SPEED_MPS * (t - last_s):  # False if one is unknown
                position_m = _NO_POSITION
            last_s, last_m = t, position_m
            found.append((t, position_m[0], position_m[1]))
    return np.array(found).reshape(-1, 3)


def location_at(locations: FloatArray, time_s: float) -> tuple[float, float] | None:
    """Return east and north in m of the last location at or before a time.

    `locations` (P, 3) are the result of `good_locations`. The result is None if there is no location in the last 2 s,
    or if one of them is not accurate.
    """
    first = np.searchsorted(locations[:, 0], time_s - _PRESENT_S)
    end = np.searchsorted(locations[:, 0], time_s, side="right")
    if first == end or np.isnan(locations[first:end, 1]).any():
        return None
    east_m, north_m = locations[end - 1, 1:].tolist()
    return east_m, north_m


def independent(fixes: Sequence[PositionFix]) -> tuple[PositionFix, ...]:
    """Return fixes with independent errors that contain the same information as fixes with correlated errors.

    The covariance of each fix is multiplied by a factor of one or more. The factor is such that the weighted mean of
    the fixes of a standing pedestrian has the variance that follows from the correlated errors. Use the result for
    algorithms that assume independent errors, such as `pdr_filter.smooth`.

    Parameters
    ----------
    fixes : sequence of PositionFix
        Fixes in any order.

    Returns
    -------
    tuple of PositionFix
        Fixes in the same order with `correlation_s` 0. Fixes that were independent are unchanged.

    Examples
    --------
    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> from pdr_filter.filter.fixes.gnss import independent
    >>> fixes = [pdr.PositionFix(t, (0.0, 0.0), np.eye(2), correlation_s=20.0) for t in (0.0, 10.0)]
    >>> [round(float(fix.cov_m2[0, 0]), 2) for fix in independent(fixes)]
    [1.0, 4.01]
    """
    independent_fixes = list(fixes)
    last = list[PositionFix]()
    for k in sorted(range(len(independent_fixes)), key=lambda k: fixes[k].time_s):
        fix = fixes[k]
        if fix.correlation_s > 0:
            independent_fixes[k] = replace(fix, cov_m2=repeated_cov_m2(fix, last), correlation_s=0.0)
            last = [*last, fix][-N_BEFORE:]
    return tuple(independent_fixes)


def origin_of(location: Samples) -> Origin | None:
    """Return the first usable location of a recording as the origin of its fixes, or None if none is usable.

    `location` is the stream of a `Recording`. A location is usable if its time is finite, and if place and accuracy are
    known.
    """
    latitude_deg, longitude_deg, _, accuracy_m = location.values.T
    rows = np.column_stack([location.time_s, latitude_deg, longitude_deg, accuracy_m])
    for t, latitude, longitude, accuracy in rows.tolist():
        if math.isfinite(t) and _is_on_earth(latitude, longitude) and _is_accuracy(accuracy):
            return Origin(latitude, longitude)
    return None


def locations_of(location: Samples) -> tuple[LocationState, tuple[PositionFix, ...]]:
    """Return the state after all locations of a recording, and their position fixes.

    `location` is the stream of a `Recording`. The origin is the first usable location.
    """
    latitude_deg, longitude_deg, altitude_m, accuracy_m = location.values.T
    return position_fixes(
        LocationState(), location.time_s, latitude_deg, longitude_deg, accuracy_m, altitude_m=altitude_m
    )


def _is_on_earth(latitude_deg: float, longitude_deg: float) -> bool:
    """Return True for a place on Earth other than (0, 0), which apps write for a missing location."""
    return abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180 and (latitude_deg, longitude_deg) != (0.0, 0.0)


def _is_accuracy(accuracy_m: float) -> bool:
    """Return True for a known accuracy below `MAX_ACCURACY_M`.

    Phones report 0 (Android), a negative number (iOS) or NaN for an unknown one.
    """
    return 0 < accuracy_m < MAX_ACCURACY_M
