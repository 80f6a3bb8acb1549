"""Locations of a phone to position fixes in metres that say no more than they know.

What a phone calls a location is already smoothed, and reflections and the ionosphere put consecutive ones off the same
way: the error at one time is correlated with that a time t later as exp(-t / T), `PositionFix.correlation_s`. The
filter takes from each what the one before did not say (`pdr_filter.filter.fixes.fix_updates`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pdr_filter.values import N_BEFORE, RADIUS_68, FloatArray, Origin, PositionFix, Samples, repeated_cov_m2

# Phones are off by 4.9 m under open sky (F. van Diggelen and P. Enge, "The world's first GPS MOOC and worldwide
# laboratory using smartphones", ION GNSS+ 2015). One that claims less means its own scatter.
MIN_ACCURACY_M = 4.9
# T. An assumption, between the seconds for which somebody who walks meets one reflection and the minute after which the
# autocorrelation of a standing receiver has a bend (D. L. Wilson's twenty days of a Garmin 12XL).
CORRELATION_S = 20.0
# Half of it: fixes in between would hardly say more, and those that show the turn of a track are few and so reach back
# for minutes (`filter.fixes.frame_rotation.MAX_PAIRS`).
INTERVAL_S = 10.0
# Satellites are on one side of a phone: it is off by 95 % of 13 m upwards where it is by 95 % of 8 m along the ground
# ("GPS standard positioning service performance standard", 5th edition, 2020), twice as much as along each axis.
_UPWARDS = 2.0
# Faster than a walk, which has more than one step a second: a run has more than two.
_RIDE_MPS, _RIDE_STEPS_HZ = 2.5, 0.5
# Net distance of an outlier against the way there and back.
_OUTLIER_SHARE = 0.25
_MOST_RIDES = 16  # that are remembered: a filter may run for days
# A country: more is no location, and its square must stay a number.
MAX_ACCURACY_M = 1e5


@dataclass(frozen=True, slots=True)
class LocationState:
    """Where the frame of the fixes lies, and what has been seen of a stream of locations."""

    origin: Origin | None = None  # the first usable location
    last_s: float = -math.inf  # of the last fix
    n: int = 0  # locations
    n_nowhere: int = 0  # no place on Earth
    n_vague: int = 0  # without an accuracy
    n_backward: int = 0  # in time

    @property
    def n_unusable(self) -> int:
        """Number of locations that are not used."""
        return self.n_nowhere + self.n_vague + self.n_backward

    def reasons(self) -> str:
        """Why locations are not used, with the number of each cause and its remedy."""
        causes = {
            "no place on Earth (latitude and longitude in degrees are needed)": self.n_nowhere,
            "no horizontal accuracy above 0 (export it too, or give the positions as fixes)": self.n_vague,
            "a time that is not after the one before (sort them by time)": self.n_backward,
        }
        return ", ".join(f"{n} with {words}" for words, n in causes.items() if n)

    def unusable(self) -> str:
        """How many locations are not used, and why, in words."""
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
    """New state and fixes, `interval_s` apart or more, of locations (N,) each, however they are cut into blocks.

    Left out and counted are locations that are no place on Earth, that go back in time, and those without an accuracy:
    a phone that says 0 (Android), less (iOS) or nothing does not know where it is. An altitude of 0 is none.
    """
    fixes: list[PositionFix] = []
    origin, last_s = state.origin, state.last_s
    n_nowhere, n_vague, n_backward = state.n_nowhere, state.n_vague, state.n_backward
    # one by one: the bits of a vectorised sine depend on its length
    altitude_m = np.full(len(time_s), np.nan) if altitude_m is None else altitude_m
    rows = np.column_stack([time_s, latitude_deg, longitude_deg, accuracy_m, altitude_m]).tolist()
    for t, latitude, longitude, accuracy, altitude in rows:
        if not _is_place(latitude, longitude):
            n_nowhere += 1
        elif not _is_accuracy(accuracy):
            n_vague += 1
        elif not last_s < t < math.inf:
            n_backward += 1
        elif t >= last_s + interval_s:
            origin, last_s = origin or Origin(latitude, longitude), t
            std_m = max(accuracy, MIN_ACCURACY_M) / RADIUS_68
            place_m, cov_m2 = origin.east_north_m(latitude, longitude), std_m**2 * np.eye(2)
            fix = PositionFix(t, place_m, cov_m2, correlation_s=CORRELATION_S)
            if math.isfinite(altitude) and altitude != 0.0:
                fix = replace(fix, altitude_m=altitude, altitude_std_m=_UPWARDS * std_m)
            fixes.append(fix)
    return LocationState(origin, last_s, state.n + len(rows), n_nowhere, n_vague, n_backward), tuple(fixes)


# Locations worse than this do not show a way of some metres.
_GOOD_M = 10.0
# A location is where the phone is for so long.
_PRESENT_S = 2.0


def good_places(
    origin: Origin,
    time_s: FloatArray,
    latitude_deg: FloatArray,
    longitude_deg: FloatArray,
    accuracy_m: FloatArray,
    last_s: float = -math.inf,
) -> FloatArray:
    """Time, east and north (P, 3) of locations (N,) later than `last_s`, NaN where they are not good."""
    found = list[tuple[float, float, float]]()
    # one by one: the bits of a vectorised sine depend on its length
    for t, *place, accuracy in np.column_stack([time_s, latitude_deg, longitude_deg, accuracy_m]).tolist():
        if last_s < t < math.inf:
            is_good = _is_place(*place) and 0 < accuracy <= _GOOD_M
            east_m, north_m = origin.east_north_m(*place).tolist() if is_good else (math.nan, math.nan)
            last_s = t
            found.append((t, east_m, north_m))
    return np.array(found).reshape(-1, 3)


def place_at(places: FloatArray, time_s: float) -> tuple[float, float] | None:
    """East and north of the last of some `good_places` (P, 3) at a time; None if it is old or not good."""
    k = int(np.searchsorted(places[:, 0], time_s, side="right")) - 1
    if k < 0:
        return None
    t, east_m, north_m = places[k].tolist()
    return None if time_s - t > _PRESENT_S or math.isnan(east_m) else (east_m, north_m)


def independent(fixes: Sequence[PositionFix]) -> tuple[PositionFix, ...]:
    """Fixes in the given order for what takes their errors for independent, such as `pdr_filter.smooth`.

    The covariance of each has that of the fixes before in it (`values.repeated_cov_m2`).
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
    """The first usable place of a whole stream of locations, the zero of its fixes; None if none is usable."""
    latitude_deg, longitude_deg, _, accuracy_m = location.values.T
    rows = zip(
        location.time_s.tolist(), latitude_deg.tolist(), longitude_deg.tolist(), accuracy_m.tolist(), strict=True
    )
    for t, latitude, longitude, accuracy in rows:
        if math.isfinite(t) and _is_place(latitude, longitude) and _is_accuracy(accuracy):
            return Origin(latitude, longitude)
    return None


def fixes_of(location: Samples, origin: Origin | None = None) -> tuple[Origin | None, tuple[PositionFix, ...]]:
    """Where the fixes of a whole stream of locations have their zero, and the fixes; None and no fix if none is usable.

    The zero is the first usable location, if no other is given.

    `location` is that of a `Recording`: latitude, longitude, altitude and accuracy.
    """
    state, fixes = locations_of(location, origin)
    return state.origin, fixes


def locations_of(location: Samples, origin: Origin | None = None) -> tuple[LocationState, tuple[PositionFix, ...]]:
    """Return the state after all locations, and their position fixes in metres from the first usable location."""
    latitude_deg, longitude_deg, altitude_m, accuracy_m = location.values.T
    return position_fixes(
        LocationState(origin), location.time_s, latitude_deg, longitude_deg, accuracy_m, altitude_m=altitude_m
    )


@dataclass(frozen=True, slots=True)
class Ride:
    """Stretch of time in which position fixes move faster than a walk and the pedestrian makes no steps."""

    begin_s: float
    end_s: float
    way_m: float  # sum of the distances between its fixes
    first: PositionFix
    last: PositionFix

    @property
    def is_outlier(self) -> bool:
        """True of fixes that went off and came back, as after a reflection of satellite signals."""
        return float(np.linalg.norm(self.last.position_m - self.first.position_m)) < _OUTLIER_SHARE * self.way_m


@dataclass(frozen=True, slots=True)
class Rides:
    """The last rides between position fixes, and the last fix."""

    found: tuple[Ride, ...] = ()
    last: PositionFix | None = None

    @classmethod
    def of(cls, fixes: Iterable[PositionFix], step_time_s: FloatArray) -> Rides:
        """Return the rides between fixes in order of time."""
        rides = cls()
        for fix in fixes:
            rides = rides.plus(fix, step_time_s)
        return rides

    def plus(self, fix: PositionFix, step_time_s: FloatArray) -> Rides:
        """Return the rides with one more fix; steps are given by their times (K,)."""
        previous = self.last
        if previous is None or fix.time_s <= previous.time_s:
            return self if previous is not None else Rides((), fix)
        duration_s = fix.time_s - previous.time_s
        way_m = float(np.linalg.norm(fix.position_m - previous.position_m))
        n_steps = np.count_nonzero((step_time_s > previous.time_s) & (step_time_s <= fix.time_s))
        is_sure = way_m > 3 * math.sqrt(previous.var_m2 + fix.var_m2)
        if not is_sure or way_m < _RIDE_MPS * duration_s or n_steps > _RIDE_STEPS_HZ * duration_s:
            return Rides(self.found, fix)
        if self.found and self.found[-1].end_s == previous.time_s:
            ride = self.found[-1]
            ride = Ride(ride.begin_s, fix.time_s, ride.way_m + way_m, ride.first, fix)
            return Rides((*self.found[:-1], ride), fix)
        return Rides((*self.found, Ride(previous.time_s, fix.time_s, way_m, previous, fix))[-_MOST_RIDES:], fix)


def _is_place(latitude_deg: float, longitude_deg: float) -> bool:
    """True for a place on Earth; apps write 0, 0 where they have none."""
    return abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180 and (latitude_deg, longitude_deg) != (0.0, 0.0)


def _is_accuracy(accuracy_m: float) -> bool:
    """True for an accuracy that a phone may report: 0 (Android), less (iOS) and NaN mean that it is not known."""
    return 0 < accuracy_m < MAX_ACCURACY_M
