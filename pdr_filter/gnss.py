"""Locations of a phone to position fixes in metres that say no more than they know.

What a phone calls a location is already smoothed, and reflections and the ionosphere put consecutive ones off the same
way: the error at one time is correlated with that a time t later as exp(-t / T), `PositionFix.correlation_s`. The
filter takes from each what the one before did not say (`pdr_filter.filter.fixes`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
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
# for minutes (`filter.turn.MAX_PAIRS`).
INTERVAL_S = 10.0
# Satellites are on one side of a phone: it is off by 95 % of 13 m upwards where it is by 95 % of 8 m along the ground
# ("GPS standard positioning service performance standard", 5th edition, 2020), twice as much as along each axis.
_UPWARDS = 2.0
# A country: more is no location, and its square must stay a number.
MAX_ACCURACY_M = 1e5


@dataclass(frozen=True, slots=True)
class LocationState:
    """Where the frame of the fixes lies, and what has been seen of a stream of locations."""

    origin: Origin | None = None  # the first usable location
    last_s: float = -math.inf  # of the last fix
    n: int = 0  # locations
    n_unusable: int = 0


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
    origin, last_s, n_unusable = state.origin, state.last_s, state.n_unusable
    # one by one: the bits of a vectorised sine depend on its length
    altitude_m = np.full(len(time_s), np.nan) if altitude_m is None else altitude_m
    rows = np.column_stack([time_s, latitude_deg, longitude_deg, accuracy_m, altitude_m]).tolist()
    for t, latitude, longitude, accuracy, altitude in rows:
        if not _is_usable(latitude, longitude, accuracy) or not last_s < t < math.inf:
            n_unusable += 1
        elif t >= last_s + interval_s:
            origin, last_s = origin or Origin(latitude, longitude), t
            std_m = max(accuracy, MIN_ACCURACY_M) / RADIUS_68
            place_m, cov_m2 = origin.east_north_m(latitude, longitude), std_m**2 * np.eye(2)
            fix = PositionFix(t, place_m, cov_m2, correlation_s=CORRELATION_S)
            if math.isfinite(altitude) and altitude != 0.0:
                fix = replace(fix, altitude_m=altitude, altitude_std_m=_UPWARDS * std_m)
            fixes.append(fix)
    return LocationState(origin, last_s, state.n + len(rows), n_unusable), tuple(fixes)


def independent(fixes: Sequence[PositionFix], before: Sequence[PositionFix] = ()) -> tuple[PositionFix, ...]:
    """Fixes in the given order for what takes their errors for independent, such as `pdr_filter.smooth`.

    The covariance of each has that of the fixes before in it (`values.repeated_cov_m2`), of which some may have been
    used already.
    """
    found = list(fixes)
    last = [fix for fix in before if fix.correlation_s > 0]
    for k in sorted(range(len(found)), key=lambda k: fixes[k].time_s):
        fix = fixes[k]
        if fix.correlation_s > 0:
            found[k] = replace(fix, cov_m2=repeated_cov_m2(fix, last), correlation_s=0.0)
            last = [*last, fix][-N_BEFORE:]
    return tuple(found)


def origin_of(location: Samples) -> Origin | None:
    """The first usable place of a whole stream of locations, the zero of its fixes; None if none is usable."""
    latitude_deg, longitude_deg, _, accuracy_m = location.values.T
    rows = zip(
        location.time_s.tolist(), latitude_deg.tolist(), longitude_deg.tolist(), accuracy_m.tolist(), strict=True
    )
    for t, latitude, longitude, accuracy in rows:
        if math.isfinite(t) and _is_usable(latitude, longitude, accuracy):
            return Origin(latitude, longitude)
    return None


def fixes_of(location: Samples, origin: Origin | None = None) -> tuple[Origin | None, tuple[PositionFix, ...]]:
    """Where the fixes of a whole stream of locations have their zero, and the fixes; None and no fix if none is usable.

    The zero is the first usable location, if no other is given.

    `location` is that of a `Recording`: latitude, longitude, altitude and accuracy.
    """
    latitude_deg, longitude_deg, altitude_m, accuracy_m = location.values.T
    state, fixes = position_fixes(
        LocationState(origin), location.time_s, latitude_deg, longitude_deg, accuracy_m, altitude_m=altitude_m
    )
    return state.origin, fixes


def _is_usable(latitude_deg: float, longitude_deg: float, accuracy_m: float) -> bool:
    """Whether it is a place on Earth, and how well is known; apps write 0, 0 where they have none."""
    is_place = abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180 and (latitude_deg, longitude_deg) != (0.0, 0.0)
    return is_place and 0 < accuracy_m < MAX_ACCURACY_M
