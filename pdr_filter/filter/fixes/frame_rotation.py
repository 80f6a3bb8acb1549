"""The turn from the frame in which a track starts to that of its position fixes, while it is open and as it settles.

Dead reckoning knows neither where it starts nor which way is north. The first fix shows where it is. The turn is
anything then, and a density over all turns, which the fixes that follow narrow: the likelihood of a turn is that of
what it leaves between the fixes and the track, whose errors grow as the filter says. Positions are the mean and the
covariance over that density, so that they are in the frame of the fixes from the first one on. A density that has
become narrow is a rotation with a standard deviation, in which the filter is linear: the track goes over into the frame
of the fixes (least squares as in W. Kabsch, "A solution for the best rotation to relate two sets of vectors", Acta
Cryst. A32, 1976, in the plane). Where the heading is lost later on, in a time without samples, the turn is open again
from there on, about the place where the track was.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from pdr_filter.filter.fixes.alignment import Alignment, Place, turned_cov
from pdr_filter.filter.imm.motion_model import MAX_HEADING_VARIANCE
from pdr_filter.values import ComplexArray, FloatArray, error_correlation, read_only, softmax, wrap_angle

# A density this narrow (one standard deviation, 15 degrees) is a rotation: the filter refines it linearly.
MAX_ANGLE_STD_RAD = 0.26


# Fixes that are remembered for it; of more, those at the most even intervals.
MAX_PAIRS = 24


_ANGLES_RAD: FloatArray = np.linspace(-np.pi, np.pi, 120, endpoint=False)


_TURNS = np.exp(1j * _ANGLES_RAD)


# One in so many good sets of fixes loses one of them.
_DISAGREE_PROB = 1e-3


_APART = 10.0


# Degrees of freedom of Student's t, as which the errors of fixes are distributed together: they are few, and nobody
# knows whether they are as good as they say. Of points tapped on a plan, said to be good to 0.5 m, the
# ellipses of 50 % and 95 % after the first fifth of a walk held 49 and 85 % with normal errors, and 54 and 89 % with
# these, on the storeys B1 and F1 of ms_indoor, where the number was chosen of 2, 4, 8; on the others 37 and 85, 46 and
# 90 %.
_FREE = 4.0


# How often a compass points anywhere: a phone that is held across, a magnet in its case. It did in 1 of 102 recordings,
# where somebody ran with the phone in his hand (tests/benchmarks/absolute_heading.py), 1 in 21 at most. With so
# much doubt no compass alone settles a turn.
_ASTRAY_PROB = 0.05


_ASTRAY_DENSITY = _ASTRAY_PROB / (2.0 * math.pi)


# e^(i angle) and its square, whose means are all that places need to know of a density.
_TURNS_AND_SQUARES = np.column_stack([_TURNS, _TURNS**2])


@dataclass(frozen=True, slots=True, eq=False)
class PairedPoint:
    """A fix, and where the track was at its time."""

    track_m: FloatArray  # (2,)
    world_m: FloatArray  # (2,)
    var_m2: float  # of the fix, mean of both axes
    walked_var_m2: float = 0.0  # of the track since its start, but for its heading: it only grows
    time_s: float = 0.0
    correlation_s: float = 0.0  # of the errors of fixes, see `PositionFix`

    def moved(self, positions: Callable[[FloatArray], FloatArray]) -> PairedPoint:
        """Return the same pair with the place of the track moved by a function of positions (2,)."""
        return replace(self, track_m=read_only(positions(self.track_m)))


def thinned(pairs: tuple[PairedPoint, ...], most: int) -> tuple[PairedPoint, ...]:
    """At most so many pairs in the order of time, at the most even intervals, with the first and the last one."""
    while len(pairs) > most:
        times_s = [pair.time_s for pair in pairs]
        densest = min(range(1, len(pairs) - 1), key=lambda k: times_s[k + 1] - times_s[k - 1])
        pairs = (*pairs[:densest], *pairs[densest + 1 :])
    return pairs


@dataclass(frozen=True, slots=True)
class Compass:
    """What the magnetic field says of the turn from the frame of the start to true north."""

    angle_rad: float
    var_rad2: float

    @property
    def std_rad(self) -> float:
        """Standard deviation where it does not point anywhere; that of a uniform angle at most."""
        return math.sqrt(min(self.var_rad2, MAX_HEADING_VARIANCE))

    def density(self, angle_rad: FloatArray) -> FloatArray:
        """Density at turns (A,): normal, but for the compasses that point anywhere."""
        away = math.pi - np.abs(np.abs(angle_rad - self.angle_rad) - math.pi)  # both are angles of one turn
        peak = (1.0 - _ASTRAY_PROB) / math.sqrt(2.0 * math.pi * self.var_rad2)
        return peak * np.exp((-0.5 / self.var_rad2) * (away * away)) + _ASTRAY_DENSITY

    def weighed(self, angle_rad: float) -> tuple[float, float]:
        """Information about a turn near an angle, and by how much the angle is too large for it."""
        astray_prob = _ASTRAY_DENSITY / float(self.density(np.array(angle_rad)))
        return (1.0 - astray_prob) / self.var_rad2, float(wrap_angle(angle_rad - self.angle_rad))


@dataclass(frozen=True, slots=True, eq=False)
class OpenTurn:
    """What is known of a turn that is not settled: a probability for each angle, and about which place it turns."""

    prob: FloatArray  # (A,) of `_ANGLES_RAD`
    normal_prob: FloatArray  # (A,) the same if the errors of the fixes were normal: `samples`
    track_centre_m: FloatArray  # (2,)
    world_centre_m: FloatArray  # (2,) where that is, whatever the turn
    centre_var_m2: float
    drawn: int | None = None  # the one turn under which places are reported, with mean squares about them; else means

    @property
    def direction(self) -> complex:
        """Mean of e^(i angle): as long as the turn is sure."""
        return complex(self.prob @ _TURNS)

    def with_compass(self, compass: Compass | None) -> OpenTurn:
        """The density with what a compass says."""
        if compass is None:
            return self
        density = compass.density(_ANGLES_RAD)
        prob, normal_prob = _normalised(self.prob * density), _normalised(self.normal_prob * density)
        centres_m = self.track_centre_m, self.world_centre_m
        return OpenTurn(prob, normal_prob, *centres_m, self.centre_var_m2, self.drawn)

    @property
    def is_narrow(self) -> bool:
        """Whether the density is so narrow that it is a rotation."""
        length = min(max(abs(self.direction), 1e-12), 1.0)
        return -2.0 * math.log(length) <= MAX_ANGLE_STD_RAD**2

    @property
    def angle_rad(self) -> float:
        """The turn under which places are reported, or the mean direction."""
        return cmath.phase(self.direction) if self.drawn is None else float(_ANGLES_RAD[self.drawn])

    @property
    def angle_var_rad2(self) -> float:
        """Mean square of the turn about that."""
        return float(self.prob @ wrap_angle(_ANGLES_RAD - self.angle_rad) ** 2)

    @property
    def _best(self) -> int:
        """Index of the most probable turn; of equal ones, as all are after one fix but for rounding, the smallest."""
        return int(np.argmax(self.prob - 1e-9 * np.abs(_ANGLES_RAD)))

    def most_probable(self) -> OpenTurn:
        """The same with places reported under the most probable turn."""
        return replace(self, drawn=self._best)

    def alignment(self, n_steps: int) -> Alignment:
        """The most probable turn, as if it were settled."""
        drawn = self.most_probable()
        centres_m = self.track_centre_m, self.world_centre_m
        return Alignment(drawn.angle_rad, drawn.angle_var_rad2, *centres_m, self.centre_var_m2, n_steps)

    def samples(self, rng: Generator, n: int) -> FloatArray:
        """Angles (n,), at even intervals of the probability.

        They are of normal errors, which is how who draws them weighs the fixes that follow.
        """
        share = (np.arange(n) + rng.random()) / n
        at = np.minimum(np.searchsorted(np.cumsum(self.normal_prob), share), len(self.prob) - 1)
        return _ANGLES_RAD[at] + (rng.random(n) - 0.5) * 2 * math.pi / len(self.prob)

    def world(self, place: Place) -> Place:
        """A place in the world: mean and covariance over all turns.

        With positions north + i east and u = e^(i angle), a place at d from the centre is u d from it in the world.
        With r the turn under which it is reported, E[u] or the one that is drawn, its deviations (u - r) d have the
        moments E|.|^2 = |d|^2 (1 - 2 Re(E[u] r*) + |r|^2) and E[.^2] = d^2 (E[u^2] - 2 r E[u] + r^2).
        """
        u, u2 = (self.prob @ _TURNS_AND_SQUARES).tolist()
        r = u if self.drawn is None else cmath.rect(1.0, self.angle_rad)
        east_m, north_m = (place.position_m - self.track_centre_m).tolist()
        d = complex(north_m, east_m)
        reported, square = r * d, d * d * (u2 - 2.0 * r * u + r * r)
        size_m2 = 0.5 * abs(d) ** 2 * (1.0 - 2.0 * (u * r.conjugate()).real + abs(r) ** 2) + self.centre_var_m2
        east_north = 0.5 * square.imag
        cov = turned_cov(place.cov_m2, u2.conjugate())
        cov += [[size_m2 - 0.5 * square.real, east_north], [east_north, size_m2 + 0.5 * square.real]]
        position_m = self.world_centre_m + np.array([reported.imag, reported.real])
        heading_rad = place.heading_rad + (cmath.phase(u) if self.drawn is None else self.angle_rad)
        return Place(position_m, cov, heading_rad, place.n_steps)


class _Fit(NamedTuple):
    """Pairs in the frame of the start, less the shift that fits each turn best; both axes are alike."""

    pairs: tuple[PairedPoint, ...]
    projected: FloatArray  # (N, N) inverse covariance of the errors along one axis with the best shift taken off
    of_each: FloatArray  # (N,) how much each counts in the best shift: one in sum
    shift_var_m2: float
    world: ComplexArray  # (N,) the fixes, north + i east
    track: ComplexArray  # (N,) where the track was
    of_north: FloatArray  # (A,) squared angle over the variance of what is known of the north
    squares: FloatArray  # (A,) of the errors over their covariance, and of the north


def _fitted(pairs: Sequence[PairedPoint], north_var_rad2: float) -> _Fit:
    """Errors of the fixes are alike as the fixes say; those of the track are shared by all that came after them."""
    walked = np.array([p.walked_var_m2 for p in pairs])
    shared = np.minimum(walked[:, None], walked) - walked.min()
    weight = np.linalg.inv(_fix_cov(pairs) + shared)
    of_each = weight.sum(axis=0)
    information = float(of_each.sum())
    projected = weight - of_each[:, None] * of_each / information
    world, track = _complex([p.world_m for p in pairs]), _complex([p.track_m for p in pairs])
    away = np.outer(world, _TURNS.conj()) - track[:, None]
    of_north = _ANGLES_RAD**2 / north_var_rad2
    squares = ((projected @ away) * away.conj()).real.sum(axis=0) + of_north
    return _Fit(tuple(pairs), projected, of_each / information, 1.0 / information, world, track, of_north, squares)


def _complex(east_north_m: Sequence[FloatArray]) -> ComplexArray:
    """North + i east (N,), which a turn clockwise multiplies with e^(i angle)."""
    east_m, north_m = np.array(east_north_m).T
    return north_m + 1j * east_m


def _fix_cov(pairs: Sequence[PairedPoint]) -> FloatArray:
    """Covariance (N, N) of the errors of fixes along one axis."""
    var_m2 = np.array([p.var_m2 for p in pairs])
    times_s, correlation_s = np.array([p.time_s for p in pairs]), np.array([p.correlation_s for p in pairs])
    std_m = np.sqrt(var_m2)
    return std_m[:, None] * std_m * error_correlation(times_s, correlation_s, var_m2)


def open_turn(pairs: Sequence[PairedPoint], north_var_rad2: float = math.inf) -> OpenTurn:
    """The density of the turn that some pairs show, one at least."""
    return _open_turn(_fitted(pairs, north_var_rad2))


def _open_turn(fit: _Fit) -> OpenTurn:
    """Student's density: with an unknown factor on the variances and any shift, p ~ (f + s)^-((f + 2 n - 2) / 2).

    Its f are degrees of freedom and s the squares of n pairs (A. Gelman et al., "Bayesian data analysis", section 14.2,
    with that prior of the factor).
    """
    of_pairs, power = fit.squares - fit.of_north, 0.5 * (_FREE + 2 * len(fit.pairs) - 2)
    least = float(of_pairs.min())
    too_small = max(n_free(fit.pairs) - least, 0.0)  # errors are not smaller than they are said to be
    prob = softmax(-0.5 * fit.of_north - power * np.log(_FREE + too_small + of_pairs))
    normal_prob = softmax(-0.5 * fit.squares)
    return OpenTurn(prob, normal_prob, *_centres(fit), scatter(least, n_free(fit.pairs)) * fit.shift_var_m2)


def _centres(fit: _Fit) -> tuple[FloatArray, FloatArray]:
    """The place of the track that the best shift keeps whatever the turn, and the same in the world."""
    track, world = complex(fit.of_each @ fit.track), complex(fit.of_each @ fit.world)
    return np.array([track.imag, track.real]), np.array([world.imag, world.real])


def n_free(pairs: Sequence[PairedPoint]) -> int:
    """How many of the errors shift and turn leave free."""
    return max(2 * len(pairs) - 3, 0)


def scatter(squares: float, n_errors: int, n_before: int = 0) -> float:
    """By how much the variances of some errors are larger than they are said to be, by their squares; one at least.

    `n_before` errors were as large as they are said to be.
    """
    return max((_FREE + n_before + squares) / (_FREE + n_before + n_errors), 1.0)


def _normalised(prob: FloatArray) -> FloatArray:
    return prob / np.add.reduce(prob)


def align(
    pairs: Sequence[PairedPoint], n_steps: int, north_var_rad2: float = math.inf, compass: Compass | None = None
) -> Alignment | None:
    """The alignment that the pairs show, or None while they leave the turn open.

    From the most probable turn of the density by Gauss-Newton; with e_i = w_i e^(-i angle) the fixes turned back into
    the frame of the start, d e_i / d angle = -i e_i. Shift and angle are independent at the weighted centre. A compass
    counts with the probability that it does not point anywhere.
    """
    fit = _fitted(pairs, north_var_rad2)
    turn = _open_turn(fit).with_compass(compass)
    if not turn.is_narrow:
        return None
    angle_rad, information, too_sure = float(_ANGLES_RAD[turn.prob.argmax()]), 1.0, 1.0
    for _ in range(5):
        turned_back = fit.world * cmath.rect(1.0, -angle_rad)
        slope, residual = -1j * turned_back, turned_back - fit.track
        of_compass, too_large_rad = (0.0, 0.0) if compass is None else compass.weighed(angle_rad)
        too_sure = scatter(float(np.vdot(residual, fit.projected @ residual).real), n_free(pairs))
        of_fixes = fit.projected @ slope / too_sure
        information = float(np.vdot(of_fixes, slope).real) + 1.0 / north_var_rad2 + of_compass
        pull = float(np.vdot(of_fixes, residual).real) + angle_rad / north_var_rad2
        angle_rad -= (pull + of_compass * too_large_rad) / information
    return Alignment(angle_rad, 1.0 / information, *_centres(fit), too_sure * fit.shift_var_m2, n_steps)


def centre_weights(pairs: Sequence[PairedPoint]) -> FloatArray:
    """How much each of the pairs counts in the centre of their alignment, (N,): one in sum."""
    return _fitted(pairs, math.inf).of_each


def least_squares_error(pairs: Sequence[PairedPoint], north_var_rad2: float = math.inf) -> float:
    """Sum of squared errors over their covariance that the best shift and turn leave, chi-square distributed."""
    return float(_fitted(pairs, north_var_rad2).squares.min())


def disagreement(pairs: Sequence[PairedPoint], agreeing: Sequence[PairedPoint], north_var_rad2: float) -> float:
    """Squares that the best shift and turn of the agreeing pairs leave, and the limit of the gate for each other."""
    n_left_out = len(pairs) - len(agreeing)
    return least_squares_error(agreeing, north_var_rad2) + (n_left_out * agreement_limit(2) if n_left_out else 0.0)


def agreement_limit(n_free: int) -> float:
    """Chi-square that one in a thousand sets of good fixes exceeds."""
    from scipy.special import chdtri  # which takes as long to load as all the rest of a filter

    return float(chdtri(n_free, _DISAGREE_PROB)) if n_free > 0 else math.inf


def agreed_turn(
    pairs: tuple[PairedPoint, ...], north_var_rad2: float = math.inf, n_sure: int = 0
) -> tuple[tuple[PairedPoint, ...], OpenTurn]:
    """The pairs that can all be right, and the density of the turn that they show.

    As long as they cannot, the one is left out that costs the others most. Of two or three none is in the minority:
    they must be ten standard deviations apart. The first `n_sure` stay.
    """
    fit = _agreeing(pairs, north_var_rad2, n_sure)
    return fit.pairs, _open_turn(fit)


def _agreeing(pairs: tuple[PairedPoint, ...], north_var_rad2: float, n_sure: int) -> _Fit:
    fit = _fitted(pairs, north_var_rad2)
    while (n := len(fit.pairs)) > max(n_sure, 1):
        limit = agreement_limit(2 * n - 3) if n > 3 else _APART**2
        if fit.squares.min() <= limit:
            break
        subsets = (fit.pairs[:k] + fit.pairs[k + 1 :] for k in range(n_sure, n))
        fit = min((_fitted(subset, north_var_rad2) for subset in subsets), key=lambda subset: subset.squares.min())
    return fit
