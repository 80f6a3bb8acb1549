"""Correlated errors of locations, as unknowns of the smoother.

The error of a location is not white noise. On 20 walks of ipin2023, a part of the error is constant for the whole walk,
and another part is correlated for some 20 s. Phones smooth their locations. This makes closed walks smaller (0.7 to
0.95 of their size outdoors, 0.6 to 0.8 indoors) and delays them by 2 to 4 s. With a white noise model, the smoother
would attribute smaller loops to shorter steps. The shrinkage is proportional to the walk, not to the locations. Their
scatter would otherwise hide it, as errors in a regressor do.

The error of a location is the sum of these parts, each a Gauss-Markov process:

- constant over a walk, east and north: standard deviation sqrt(0.2) of that of the location, memory 1 h;
- varying, east and north: sqrt(0.7) of that of the location, memory 20 s (the correlation time of the fix);
- shrinkage of the walk towards its mean within 2 min before and after: standard deviation half of the distance from
  this mean, memory 1 h. It is limited to 1.5 standard deviations of the location where the locations themselves show
  that their extent is right, and to 7 % of the distance where they are larger than the walk (`_shrinkage_m`);
- delay, along the velocity of the walk: standard deviation 3 s, memory 30 s;
- white: the remaining tenth of the variance.

The parts and the memory of 30 s were chosen on the routes 01 and 02 of ipin2023, and the median variance of
`with_even_variances` on the routes 21 to 23. Other correlated fixes have the varying and the white part alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pdr_filter.values import INDEPENDENT_SHARE, BoolArray, FloatArray, IntArray, PositionFix, TrackRows
from pdr_filter.values.fix_error_correlation import MAX_SHRINKAGE, SHRINKAGE_STD

# Entries of the error state of a location, each a Gauss-Markov process of variance one.
_CONSTANT, _VARYING, _SHRUNK, _LATE = slice(0, 2), slice(2, 4), 4, 5
N_ERRORS = 6
# Share of the variance of a location that is constant for a walk (of up to an hour), and share of its independent
# noise.
_CONSTANT_SHARE, _CONSTANT_S, _OWN_SHARE = 0.2, 3600.0, 0.1
# The shrinkage (`SHRINKAGE_STD`) is towards the mean of the walk within two minutes. It lasts for the whole walk, so
# that the mean of many locations does not determine the step length. The delay changes within half a minute.
_SHRUNK_WITHIN_S = 120.0
# The extent of locations is right if it is ten times their error, so that a shrinkage of 1.5 standard deviations is at
# most 15 % of it, and if it is not below 0.87 of that of the walk, two standard deviations (7 %) of the step length of
# people. Smaller extents are shrinkage rather than a person with short steps.
_LONG_WAY, _MIN_SIZE = 10.0, 0.87
# Locations shrink a walk and never enlarge it. Where their extent is larger than that of the walk by more than the
# standard deviation of the step length of people, the steps are longer than those of the model, and a shrinkage that
# longer steps hide is about this standard deviation. The extent must be seven errors, so that an enlargement by two of
# these standard deviations (14 %) is more than the error of a location at the edge of the walk.
_LONG_WAY_OF_LARGER, _PEOPLE_STD = 7.0, 0.07
# Median and 99.9 % quantile of the length of a vector with two standard normal components.
_MEDIAN_RADIUS, _OUTLIER_RADIUS = 1.177, 3.717
_LATE_STD_S, _LATE_WITHIN_S = 3.0, 15.0
_FILTERED_S = 30.0
# Largest speed of a pedestrian. A faster displacement is an error, or a ride.
_MAX_SPEED_MPS = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Errors of correlated fixes, one state (6,) per fix, in order of time.

    Each component is a Gauss-Markov process of variance one. Two components are the constant part of the position
    error, and two the varying part. The fifth is the shrinkage of the walk towards its local mean, and the last is the
    delay of the locations.
    """

    position: IntArray  # (E,) index of the fix among the observed positions
    node: IntArray  # (E,) index of the anchor of the fix, increasing
    by: FloatArray  # (E, 2, 6) derivative of the observed position (east, north) with respect to the error state, in m
    decay: FloatArray  # (E - 1, 6) correlation of each component with the same component of the previous fix, 0 to 1

    def __len__(self) -> int:
        return len(self.node)


NO_ERRORS = Errors(
    np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((0, 2, N_ERRORS)), np.zeros((0, N_ERRORS))
)


def independent_share(fix: PositionFix, is_location: bool) -> float:
    """Return the share, above 0 up to 1, of the variance of a fix that is independent of all other fixes.

    It is 1 for a fix without a correlation time. `is_location` is True for a location reported by the phone.
    """
    return 1.0 if fix.correlation_s == 0 else _OWN_SHARE if is_location else INDEPENDENT_SHARE


def errors_of(
    fixes: Sequence[PositionFix], is_location: BoolArray, node: IntArray, shape_m: FloatArray | None = None
) -> Errors:
    """Return the error states of the E correlated fixes among F fixes in order of time.

    The error of a phone's location has all four parts: constant, varying, shrinkage and delay (see `Errors`). The error
    of any other fix has the varying part only. `node` (F,) is the index of each fix's anchor, the foot contact at which
    the smoother estimates a state. `is_location` (F,) is True for locations of the phone. `shape_m` (F, 2) are
    positions at the fixes that show the shape of the walk, in the axes of the fixes and with step lengths of the model.
    The default is the fixes.
    """
    position = np.flatnonzero([f.correlation_s > 0 for f in fixes])
    if not len(position):
        return NO_ERRORS
    chosen = [fixes[k] for k in position.tolist()]
    time_s, position_m = np.array([f.time_s for f in chosen]), np.array([f.position_m for f in chosen])
    root = np.linalg.cholesky(np.array([f.cov_m2 for f in chosen]))
    by = np.zeros((len(chosen), 2, N_ERRORS))
    located = is_location[position]
    varying = np.where(located, 1.0 - _CONSTANT_SHARE - _OWN_SHARE, 1.0 - INDEPENDENT_SHARE)
    by[:, :, _VARYING] = np.sqrt(varying)[:, None, None] * root
    by[:, :, _CONSTANT] = np.where(located, np.sqrt(_CONSTANT_SHARE), 0.0)[:, None, None] * root
    std_m = np.sqrt([f.var_m2 for f in chosen])
    shrunk_m = _shrinkage_m(time_s, position_m, position_m if shape_m is None else shape_m[position], std_m)
    by[:, :, _SHRUNK] = np.where(located[:, None], -shrunk_m, 0.0)
    by[:, :, _LATE] = -_LATE_STD_S * located[:, None] * _velocity_mps(time_s, position_m)
    memory_s = np.full((len(chosen) - 1, N_ERRORS), _CONSTANT_S)
    memory_s[:, _VARYING] = np.array([f.correlation_s for f in chosen[1:]])[:, None]
    memory_s[:, _LATE] = _FILTERED_S
    return Errors(position, node[position], by, np.exp(-np.diff(time_s)[:, None] / memory_s))


def turned_to(locations: Sequence[PositionFix], at_m: FloatArray, walk_m: FloatArray) -> FloatArray:
    """Return positions (N, 2) of a walk in the axes of L locations, by the best rotation of its positions at them.

    `at_m` (L, 2) are the positions of the walk at the times of the locations.
    """
    if not locations:
        return walk_m
    position_m = np.array([f.position_m for f in locations])
    a, b = at_m - at_m.mean(axis=0), position_m - position_m.mean(axis=0)
    angle = np.arctan2(float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])), float(np.sum(a * b)))
    c, s = np.cos(angle), np.sin(angle)
    return walk_m @ np.array([[c, s], [-s, c]])


def _shrinkage_m(time_s: FloatArray, position_m: FloatArray, shape_m: FloatArray, std_m: FloatArray) -> FloatArray:
    """Return the standard deviation of the shrinkage of each location, as a vector (E, 2) away from the local mean.

    It is half of the position in `shape_m` (E, 2) relative to the mean of all positions in [t - d, t + d), with d =
    `_SHRUNK_WITHIN_S`. Its length is limited where the extent of these locations is right: they follow the shape of the
    walk with an error below a tenth of the extent, and are not smaller than the walk. It is limited further where they
    are larger than the walk. The error is that of the best similarity, or the stated one if that is larger.
    """
    place, shape = (m[:, 0] + 1j * m[:, 1] for m in (position_m, shape_m))
    most_m = np.full(len(time_s), np.inf)
    away = np.zeros((len(time_s), 2))
    first, end = (np.searchsorted(time_s, time_s + d).tolist() for d in (-_SHRUNK_WITHIN_S, _SHRUNK_WITHIN_S))
    for k, (i, j) in enumerate(zip(first, end, strict=True)):
        size, error_m = _size_and_error(shape[i:j], place[i:j])
        error_m = max(error_m, float(std_m[k]))
        extent_m = float(np.std(shape[i:j]))
        if size > _MIN_SIZE and extent_m > _LONG_WAY * error_m:
            most_m[k] = MAX_SHRINKAGE * error_m
        away[k] = shape_m[k] - shape_m[i:j].mean(axis=0)
        if size > 1.0 + _PEOPLE_STD and extent_m > _LONG_WAY_OF_LARGER * error_m:
            most_m[k] = min(most_m[k], _PEOPLE_STD * float(np.hypot(*away[k])))
    return _limited(SHRINKAGE_STD * away, most_m)


def _size_and_error(shape: NDArray[np.complexfloating], place: NDArray[np.complexfloating]) -> tuple[float, float]:
    """Return the scale of the similarity from the walk to its locations, and their standard deviation along each axis.

    Positions (N,) are complex numbers. The similarity is fitted again, without outliers beyond the 99.9 % quantile
    of the distances from it, given their median. The standard deviation is infinite for fewer than three locations.
    """
    if len(place) < 3:
        return 0.0, np.inf
    size, std_m, used = 0.0, np.inf, np.ones(len(place), dtype=bool)
    for _ in range(2):
        walked, located = shape - shape[used].mean(), place - place[used].mean()
        similarity = complex(np.vdot(walked[used], located[used])) / max(float(np.sum(np.abs(walked[used]) ** 2)), 1e-9)
        away_m = np.abs(located - similarity * walked)
        size, std_m = abs(similarity), float(np.median(away_m)) / _MEDIAN_RADIUS
        used = away_m <= _OUTLIER_RADIUS * std_m
    return size, std_m * float(np.sqrt(len(place) / (len(place) - 2)))


def _velocity_mps(time_s: FloatArray, position_m: FloatArray) -> FloatArray:
    """Return the mean velocity (E, 2) around each location, limited to the speed of a pedestrian.

    It is computed from the first and the last location in [t - d, t + d), with d = `_LATE_WITHIN_S`.
    """
    first, end = (np.searchsorted(time_s, time_s + d) for d in (-_LATE_WITHIN_S, _LATE_WITHIN_S))
    apart_s = np.maximum(time_s[end - 1] - time_s[first], 1.0)
    velocity_mps = (position_m[end - 1] - position_m[first]) / apart_s[:, None]
    return _limited(velocity_mps, np.full(len(time_s), _MAX_SPEED_MPS))


def _limited(vector: FloatArray, length: FloatArray) -> FloatArray:
    """Return vectors (E, 2) shortened to at most `length` (E,)."""
    return vector * np.minimum(1.0, length / np.maximum(np.hypot(*vector.T), 1e-9))[:, None]


# Smallest factor by which `with_even_variances` reduces a claimed variance.
_MIN_VARIANCE_FACTOR = 0.5


def with_even_variances(locations: Sequence[PositionFix]) -> tuple[PositionFix, ...]:
    """Return the locations with covariances moved towards the median variance of the walk.

    Smaller covariances are increased to the median. Larger ones are reduced to the median, but at most by half.
    Indoors, a phone reports an accuracy of 8 m at one time and of 64 m at another, with the same actual error.
    """
    if not locations:
        return ()
    usual = float(np.median([f.var_m2 for f in locations]))
    return tuple(replace(f, cov_m2=max(usual / f.var_m2, _MIN_VARIANCE_FACTOR) * f.cov_m2) for f in locations)


# Half of the time within which dead reckoning shows the shape of a walk to a metre or two, and smallest number of
# locations in it that show their scatter.
_SHAPE_WITHIN_S, _MIN_LOCATIONS = 60.0, 5
# Scatter in units of the stated standard deviation above which the stated one is wrong. It is 0.2 to 1.3 on 17 walks of
# ipin2023.
MOST_SCATTER = 2.0


def scatter_of(locations: Sequence[PositionFix], track: TrackRows, part: IntArray) -> float:
    """Return the scatter of locations about the shape of the walk, in units of their stated standard deviation.

    It is the median, over all windows of two minutes, of the standard deviation from the best similarity. `part`
    (K + 1,) are the numbers of the parts of the walk, before and after each step, within which the heading is known.
    The result is 0 without a window with five locations in one part. A clock that is up to 20 s late or early is no
    scatter: the result is the smallest of all such shifts.
    """
    time_s = np.array([f.time_s for f in locations])
    scatter = _scatter_at(locations, track, part, time_s)
    if scatter <= MOST_SCATTER:
        return scatter
    return min(_scatter_at(locations, track, part, time_s + shift_s) for shift_s in range(-20, 21, 2))


def _scatter_at(locations: Sequence[PositionFix], track: TrackRows, part: IntArray, time_s: FloatArray) -> float:
    """Return the scatter of locations if they were true at the times `time_s`."""
    std_m = np.sqrt([f.var_m2 for f in locations])
    of_part = part[np.searchsorted(track.time_s, time_s)]
    walk_m = np.column_stack([np.interp(time_s, track.time_s, column) for column in track.position_m.T])
    place, walk = (np.reshape(m, (-1, 2)) @ [1, 1j] for m in ([f.position_m for f in locations], walk_m))
    scatters = list[float]()
    for k, t in enumerate(time_s.tolist()):
        near = (np.abs(time_s - t) <= _SHAPE_WITHIN_S) & (of_part == of_part[k])
        if near.sum() >= _MIN_LOCATIONS:
            scatters.append(_size_and_error(walk[near], place[near])[1] / float(np.median(std_m[near])))
    return float(np.median(scatters)) if scatters else 0.0


def with_scatter(locations: Sequence[PositionFix], scatter: float) -> tuple[PositionFix, ...]:
    """Return the locations with covariances for their `scatter_of`, if it shows that they are stated too small."""
    factor = scatter**2 if scatter > MOST_SCATTER else 1.0
    return tuple(replace(f, cov_m2=factor * f.cov_m2) for f in locations)


def joined_at_contacts(fixes: Sequence[PositionFix], contacts: IntArray) -> tuple[tuple[PositionFix, ...], IntArray]:
    """Return the fixes in order of time, with the correlated fixes at one contact joined into one.

    Fixes without a correlation time remain single. The second result (F,) is the index of each given fix in the
    returned fixes. `contacts` (F,) is the number of steps before the contact nearest to each fix. Each correlated fix
    adds an error state to the unknowns, and a resting phone receives locations at a single contact for as long as it
    rests. Their mean is assigned the covariance of one of them, which is too large after a long rest.
    """
    groups: dict[tuple[int, bool], list[int]] = {}
    for k in sorted(range(len(fixes)), key=lambda k: fixes[k].time_s):
        is_own = fixes[k].correlation_s == 0
        groups.setdefault((k if is_own else int(contacts[k]), is_own), []).append(k)
    number = np.zeros(len(fixes), dtype=np.int64)
    for j, members in enumerate(groups.values()):
        number[members] = j
    return tuple(_joined([fixes[k] for k in members]) for members in groups.values()), number


def _joined(fixes: Sequence[PositionFix]) -> PositionFix:
    """Return the information-weighted mean of correlated fixes, with the time of the middle one.

    Its covariance is the harmonic mean of their covariances, as for a single fix.
    """
    if len(fixes) == 1:
        return fixes[0]
    position_m, mean_cov = mean_position(fixes)
    middle = fixes[len(fixes) // 2]
    return replace(middle, position_m=position_m, cov_m2=len(fixes) * 0.5 * (mean_cov + mean_cov.T))


def mean_position(fixes: Sequence[PositionFix]) -> tuple[FloatArray, FloatArray]:
    """Return the information-weighted mean (2,) of fixes, and its covariance (2, 2) for independent errors."""
    information = np.linalg.inv(np.array([f.cov_m2 for f in fixes]))
    cov = np.linalg.inv(information.sum(axis=0))
    return cov @ np.einsum("nab,nb->a", information, np.array([f.position_m for f in fixes])), cov
