"""Estimation of the rotation from the start frame of a track to the frame of its position fixes.

Dead reckoning knows neither its start nor north. The first fix shows the position. The rotation is then unknown and
represented by a density over all angles, which later fixes narrow. The likelihood of an angle follows from the
differences that remain between fixes and track; the errors of the track grow as in the filter. Positions are the mean
and covariance over this density, so that they are in the frame of the fixes from the first one on.

When the density is narrow, it is replaced by an angle with a standard deviation, for which the filter is linear. The
track is then transformed into the frame of the fixes by least squares (W. Kabsch, "A solution for the best rotation to
relate two sets of vectors", Acta Cryst. A32, 1976, in the plane). If the heading is lost later, in a gap, the rotation
is unknown again from there on, about the position of the track at that time.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from pdr_filter.filter.imm.motion_model import MAX_HEADING_VARIANCE
from pdr_filter.filter.pedestrian.alignment import Alignment, Pose, rotated_cov
from pdr_filter.values import ComplexArray, FloatArray, error_correlation, read_only, softmax, wrap_angle
from pdr_filter.values.uncertainty import STUDENT_DOF, variance_factor

# Standard deviation (15 degrees) up to which the filter treats the rotation as an angle and refines it linearly.
MAX_ANGLE_STD_RAD = 0.26

# Largest number of stored pairs. Beyond it they are thinned to even intervals.
MAX_PAIRS = 24


_ANGLES_RAD: FloatArray = np.linspace(-np.pi, np.pi, 120, endpoint=False)


_UNIT_VECTORS = np.exp(1j * _ANGLES_RAD)


# Significance level of the consistency test of a set of fixes.
_SIGNIFICANCE = 1e-3


# Standard deviations from which two or three fixes, which have no majority, count as inconsistent.
_MIN_DISAGREEMENT = 10.0


# Probability that a compass fails and points in any direction: the phone is held in landscape, or there is a magnet in
# its case. It failed in 1 of 102 recordings, in which a person ran with the phone in the hand
# (tests/benchmarks/absolute_heading.py). The upper confidence limit is 1 in 21. With this probability a compass alone
# never determines the rotation.
_FAILURE_PROB = 0.05


_FAILURE_DENSITY = _FAILURE_PROB / (2.0 * math.pi)


# e^(i angle) and its square. Their means are sufficient to transform poses.
_UNIT_VECTORS_AND_SQUARES = np.column_stack([_UNIT_VECTORS, _UNIT_VECTORS**2])


@dataclass(frozen=True, slots=True, eq=False)
class PairedPoint:
    """Position fix, and the track position at its time."""

    track_m: FloatArray  # (2,) position of the track
    world_m: FloatArray  # (2,) position of the fix
    var_m2: float  # variance of the fix, as mean of both axes
    # Variance of the track since its start that the heading does not explain. It only grows.
    walked_var_m2: float = 0.0
    time_s: float = 0.0  # time of the fix
    correlation_s: float = 0.0  # correlation time of the errors of fixes (see `PositionFix`)

    def with_moved_track(self, positions: Callable[[FloatArray], FloatArray]) -> PairedPoint:
        """Return the pair with the track position transformed by a function of positions (2,)."""
        return replace(self, track_m=read_only(positions(self.track_m)))


def spaced_pairs(pairs: tuple[PairedPoint, ...], most: int) -> tuple[PairedPoint, ...]:
    """Return at most `most` of the point pairs in order of time, about evenly spaced, with the first and the last one.

    The pair whose neighbours are closest in time is removed, until `most` pairs are left.
    """
    while len(pairs) > most:
        times_s = [pair.time_s for pair in pairs]
        densest = min(range(1, len(pairs) - 1), key=lambda k: times_s[k + 1] - times_s[k - 1])
        pairs = (*pairs[:densest], *pairs[densest + 1 :])
    return pairs


@dataclass(frozen=True, slots=True)
class Compass:
    """Rotation from the start frame to true north as measured by the magnetic field."""

    angle_rad: float  # angle of the rotation
    var_rad2: float  # variance of the angle if the compass does not fail

    @property
    def std_rad(self) -> float:
        """Standard deviation if the compass does not fail, at most the value of a uniform angle, pi / sqrt(3)."""
        return math.sqrt(min(self.var_rad2, MAX_HEADING_VARIANCE))

    def density(self, angle_rad: FloatArray) -> FloatArray:
        """Return the density at angles (A,): a normal density plus a uniform one for compasses that fail."""
        away = math.pi - np.abs(np.abs(angle_rad - self.angle_rad) - math.pi)  # both angles are in one turn
        peak = (1.0 - _FAILURE_PROB) / math.sqrt(2.0 * math.pi * self.var_rad2)
        return peak * np.exp((-0.5 / self.var_rad2) * (away * away)) + _FAILURE_DENSITY

    def linearised(self, angle_rad: float) -> tuple[float, float]:
        """Return the information of the compass about the rotation near an angle, and the residual of the angle.

        The information is in 1/rad2. The residual is the given angle minus the angle of the compass, in rad.
        """
        failure_prob = _FAILURE_DENSITY / float(self.density(np.array(angle_rad)))
        return (1.0 - failure_prob) / self.var_rad2, float(wrap_angle(angle_rad - self.angle_rad))


@dataclass(frozen=True, slots=True, eq=False)
class RotationDensity:
    """Density of the unknown rotation from the start frame to the frame of the fixes, and the centre of rotation."""

    prob: FloatArray  # (A,) probability of each of the angles `_ANGLES_RAD`
    # (A,) Probability of each angle if the errors of the fixes are normally distributed, used by `samples`. `prob` is
    # for errors with a Student's t distribution.
    normal_prob: FloatArray
    track_centre_m: FloatArray  # (2,) centre of rotation in the start frame
    # (2,) position of the centre in the frame of the fixes, which does not depend on the angle
    world_centre_m: FloatArray
    centre_var_m2: float  # variance of `world_centre_m` along each axis
    # Index of the single angle with which positions are reported, as for a plot. Covariances are then the mean squares
    # of the deviations from these positions, over all angles. If it is None, positions are means over the density and
    # covariances are about these means.
    drawn: int | None = None

    @property
    def direction(self) -> complex:
        """Mean of e^(i angle), whose modulus is 1 for a known angle and 0 for a uniform density."""
        return complex(self.prob @ _UNIT_VECTORS)

    def with_compass(self, compass: Compass | None) -> RotationDensity:
        """Return the density multiplied by the density of a compass, or unchanged if the compass is None."""
        if compass is None:
            return self
        density = compass.density(_ANGLES_RAD)
        prob, normal_prob = _normalised(self.prob * density), _normalised(self.normal_prob * density)
        centres_m = self.track_centre_m, self.world_centre_m
        return RotationDensity(prob, normal_prob, *centres_m, self.centre_var_m2, self.drawn)

    @property
    def is_narrow(self) -> bool:
        """True if the density is so narrow that the filter can treat it as an angle with a standard deviation."""
        length = min(max(abs(self.direction), 1e-12), 1.0)
        return -2.0 * math.log(length) <= MAX_ANGLE_STD_RAD**2

    @property
    def angle_rad(self) -> float:
        """Angle by which track positions are rotated in the output, rad.

        It is the angle with the index `drawn`, or the mean direction of the density if `drawn` is None.
        """
        return cmath.phase(self.direction) if self.drawn is None else float(_ANGLES_RAD[self.drawn])

    @property
    def angle_var_rad2(self) -> float:
        """Mean square of the angle about `angle_rad`."""
        return float(self.prob @ wrap_angle(_ANGLES_RAD - self.angle_rad) ** 2)

    @property
    def _best(self) -> int:
        """Index of the most probable angle.

        After one fix all angles are equally probable except for rounding. The smallest of equal ones is used.
        """
        return int(np.argmax(self.prob - 1e-9 * np.abs(_ANGLES_RAD)))

    def most_probable(self) -> RotationDensity:
        """Return the same density, with `drawn` set so that positions are rotated by the most probable angle."""
        return replace(self, drawn=self._best)

    def alignment(self, n_steps: int) -> Alignment:
        """Return the alignment by the most probable angle. Its angle variance is the mean square about this angle.

        `n_steps` is the number of steps to which the alignment applies.
        """
        drawn = self.most_probable()
        centres_m = self.track_centre_m, self.world_centre_m
        return Alignment(drawn.angle_rad, drawn.angle_var_rad2, *centres_m, self.centre_var_m2, n_steps)

    def samples(self, rng: Generator, n: int) -> FloatArray:
        """Return n angles (rad) at even intervals of the cumulative probability of the rotation.

        The intervals have a random offset, and each angle a uniform noise of one grid interval. The density is that for
        normally distributed errors, because the particle filter weights later fixes in the same way.
        """
        share = (np.arange(n) + rng.random()) / n
        at = np.minimum(np.searchsorted(np.cumsum(self.normal_prob), share), len(self.prob) - 1)
        return _ANGLES_RAD[at] + (rng.random(n) - 0.5) * 2 * math.pi / len(self.prob)

    def world(self, pose: Pose) -> Pose:
        """Return a pose in the frame of the fixes, with mean and covariance over all angles.

        Let positions be complex numbers north + i east and u = e^(i angle). A pose at d from the centre is u d from it
        in the frame of the fixes. E is the mean over all angles, and r the rotation used for the output: E[u], or e^(i
        angle) of the angle with the index `drawn`. The deviations (u - r) d have the moments E|.|^2 = |d|^2 (1 - 2
        Re(E[u] r*) + |r|^2) and E[.^2] = d^2 (E[u^2] - 2 r E[u] + r^2).
        """
        u, u2 = (self.prob @ _UNIT_VECTORS_AND_SQUARES).tolist()
        r = u if self.drawn is None else cmath.rect(1.0, self.angle_rad)
        east_m, north_m = (pose.position_m - self.track_centre_m).tolist()
        d = complex(north_m, east_m)
        reported, square = r * d, d * d * (u2 - 2.0 * r * u + r * r)
        size_m2 = 0.5 * abs(d) ** 2 * (1.0 - 2.0 * (u * r.conjugate()).real + abs(r) ** 2) + self.centre_var_m2
        east_north = 0.5 * square.imag
        cov = rotated_cov(pose.cov_m2, u2.conjugate())
        cov += [[size_m2 - 0.5 * square.real, east_north], [east_north, size_m2 + 0.5 * square.real]]
        position_m = self.world_centre_m + np.array([reported.imag, reported.real])
        heading_rad = pose.heading_rad + (cmath.phase(u) if self.drawn is None else self.angle_rad)
        return Pose(position_m, cov, heading_rad, pose.n_steps)


class _Fit(NamedTuple):
    """Fit of a shift to point pairs, for each angle of the rotation.

    Errors along east and north are independent and have equal variances. Positions are therefore complex numbers, and
    one covariance matrix serves both axes.
    """

    pairs: tuple[PairedPoint, ...]
    projected: FloatArray  # (N, N) inverse covariance of the errors along one axis, projected to remove the best shift
    centre_weight: FloatArray  # (N,) weight of each pair in the best shift, sum one
    shift_var_m2: float
    world: ComplexArray  # (N,) positions of the fixes, north + i east
    track: ComplexArray  # (N,) positions of the track
    prior_squares: FloatArray  # (A,) squared angle over the variance of its prior
    squares: FloatArray  # (A,) normalised squared errors of the pairs and the prior


def _fitted(pairs: Sequence[PairedPoint], north_var_rad2: float) -> _Fit:
    """Return the fit of the best shift to point pairs, for each angle of the rotation.

    `north_var_rad2` is the prior variance of the rotation about zero. Errors of the fixes are correlated in time
    (`PairedPoint.correlation_s`). An error of the track at one pair is shared by all later pairs.
    """
    walked = np.array([p.walked_var_m2 for p in pairs])
    shared = np.minimum(walked[:, None], walked) - walked.min()
    weight = np.linalg.inv(_fix_cov(pairs) + shared)
    centre_weight = weight.sum(axis=0)
    information = float(centre_weight.sum())
    projected = weight - centre_weight[:, None] * centre_weight / information
    world, track = _complex([p.world_m for p in pairs]), _complex([p.track_m for p in pairs])
    away = np.outer(world, _UNIT_VECTORS.conj()) - track[:, None]
    prior_squares = _ANGLES_RAD**2 / north_var_rad2
    squares = ((projected @ away) * away.conj()).real.sum(axis=0) + prior_squares
    return _Fit(
        tuple(pairs), projected, centre_weight / information, 1.0 / information, world, track, prior_squares, squares
    )


def _complex(east_north_m: Sequence[FloatArray]) -> ComplexArray:
    """Return positions as complex numbers north + i east, (N,), with the imaginary unit i.

    A clockwise rotation by an angle multiplies them by e^(i angle).
    """
    east_m, north_m = np.array(east_north_m).T
    return north_m + 1j * east_m


def _fix_cov(pairs: Sequence[PairedPoint]) -> FloatArray:
    """Return the covariance (N, N) of the errors of the fixes along one axis."""
    var_m2 = np.array([p.var_m2 for p in pairs])
    times_s, correlation_s = np.array([p.time_s for p in pairs]), np.array([p.correlation_s for p in pairs])
    std_m = np.sqrt(var_m2)
    return std_m[:, None] * std_m * error_correlation(times_s, correlation_s, var_m2)


def rotation_density(pairs: Sequence[PairedPoint]) -> RotationDensity:
    """Return the density of the rotation from the track to the fixes, for one or more point pairs and without prior."""
    return _density_of_fit(_fitted(pairs, math.inf))


def _density_of_fit(fit: _Fit) -> RotationDensity:
    """Return the density of the rotation for a fit, for fix errors with a Student's t distribution.

    The probability of an angle is proportional to its prior times (f + s)^(-(f + 2 n - 2) / 2). s is the sum of the
    normalised squared errors of the n pairs at that angle, after the best shift. The formula holds if all variances
    have an unknown common factor and the shift is unknown (A. Gelman et al., "Bayesian Data Analysis", section 14.2).
    The factor has a scaled inverse chi-square prior with f degrees of freedom, unlike in the book.
    If the minimum of s is below the degrees of freedom, 2 n - 3 (at least 0), s is increased by a constant, so that its
    minimum equals them, because errors are at least as large as stated.
    """
    pair_squares, power = fit.squares - fit.prior_squares, 0.5 * (STUDENT_DOF + 2 * len(fit.pairs) - 2)
    least = float(pair_squares.min())
    deficit = max(degrees_of_freedom(fit.pairs) - least, 0.0)  # errors are at least as large as stated
    prob = softmax(-0.5 * fit.prior_squares - power * np.log(STUDENT_DOF + deficit + pair_squares))
    normal_prob = softmax(-0.5 * fit.squares)
    return RotationDensity(
        prob, normal_prob, *_centres(fit), variance_factor(least, degrees_of_freedom(fit.pairs)) * fit.shift_var_m2
    )


def _centres(fit: _Fit) -> tuple[FloatArray, FloatArray]:
    """Return the centre of rotation in the start frame and in the frame of the fixes, (2,) each (east, north).

    The two points are the weighted means of the track positions and of the fixes, with the weights `centre_weight`. The
    best shift maps one mean to the other for every angle.
    """
    track, world = complex(fit.centre_weight @ fit.track), complex(fit.centre_weight @ fit.world)
    return np.array([track.imag, track.real]), np.array([world.imag, world.real])


def degrees_of_freedom(pairs: Sequence[PairedPoint]) -> int:
    """Return the degrees of freedom of the errors of n pairs after shift and rotation: 2 n - 3, at least 0."""
    return max(2 * len(pairs) - 3, 0)


def _normalised(prob: FloatArray) -> FloatArray:
    """Return probabilities scaled so that they sum to one."""
    return prob / np.add.reduce(prob)


def align(
    pairs: Sequence[PairedPoint], n_steps: int, north_var_rad2: float = math.inf, compass: Compass | None = None
) -> Alignment | None:
    """Return the least-squares alignment of track and fixes in point pairs, or None if the rotation is too uncertain.

    Gauss-Newton iterations start at the most probable angle of the density. With e_i = w_i e^(-i angle) the fixes
    rotated back to the start frame, d e_i / d angle = -i e_i. Shift and angle are independent at the weighted centre. A
    compass has the weight of its probability not to fail.
    """
    fit = _fitted(pairs, north_var_rad2)
    turn = _density_of_fit(fit).with_compass(compass)
    if not turn.is_narrow:
        return None
    angle_rad, information, factor = float(_ANGLES_RAD[turn.prob.argmax()]), 1.0, 1.0
    for _ in range(5):
        turned_back = fit.world * cmath.rect(1.0, -angle_rad)
        slope, residual = -1j * turned_back, turned_back - fit.track
        compass_information, compass_residual_rad = (0.0, 0.0) if compass is None else compass.linearised(angle_rad)
        factor = variance_factor(float(np.vdot(residual, fit.projected @ residual).real), degrees_of_freedom(pairs))
        fix_gradient = fit.projected @ slope / factor
        information = float(np.vdot(fix_gradient, slope).real) + 1.0 / north_var_rad2 + compass_information
        gradient = float(np.vdot(fix_gradient, residual).real) + angle_rad / north_var_rad2
        angle_rad -= (gradient + compass_information * compass_residual_rad) / information
    return Alignment(angle_rad, 1.0 / information, *_centres(fit), factor * fit.shift_var_m2, n_steps)


def centre_weights(pairs: Sequence[PairedPoint]) -> FloatArray:
    """Return the weights (N,) of the pairs, with sum one, whose weighted mean is the centre of rotation of `align`."""
    return _fitted(pairs, math.inf).centre_weight


def least_squares_error(pairs: Sequence[PairedPoint], north_var_rad2: float = math.inf) -> float:
    """Return the sum of normalised squared errors after the best shift and rotation (chi-square distributed)."""
    return float(_fitted(pairs, north_var_rad2).squares.min())


def disagreement(pairs: Sequence[PairedPoint], agreeing: Sequence[PairedPoint], north_var_rad2: float) -> float:
    """Return the misfit of pairs (position fix, track position) if only those in `agreeing` are taken as correct.

    The misfit is the sum of the normalised squared errors of the pairs in `agreeing`, after the best shift and
    rotation of the track. `north_var_rad2` is the prior variance of this rotation. Each pair of `pairs` that is not in
    `agreeing` adds a constant: the 99.9 % quantile of the chi-square distribution with two degrees of freedom.
    """
    n_left_out = len(pairs) - len(agreeing)
    return least_squares_error(agreeing, north_var_rad2) + (n_left_out * agreement_limit(2) if n_left_out else 0.0)


def agreement_limit(dof: int) -> float:
    """Return the chi-square that only a share `_SIGNIFICANCE` (one in a thousand) of sets of correct fixes exceeds.

    `dof` is the number of degrees of freedom. Without any, the limit is infinite.
    """
    from scipy.special import chdtri  # imported here: it takes as long to load as the rest of the filter

    return float(chdtri(dof, _SIGNIFICANCE)) if dof > 0 else math.inf


def consistent_pairs(
    pairs: tuple[PairedPoint, ...], north_var_rad2: float = math.inf, n_sure: int = 0
) -> tuple[tuple[PairedPoint, ...], RotationDensity]:
    """Return the pairs that can all be correct, and the density of the rotation that follows from them.

    While the pairs are inconsistent, the pair whose removal reduces the error most is removed. Two or three pairs have
    no majority, so that they are inconsistent only from ten standard deviations. The first `n_sure` pairs are never
    removed.
    """
    fit = _consistent_fit(pairs, north_var_rad2, n_sure)
    return fit.pairs, _density_of_fit(fit)


def _consistent_fit(pairs: tuple[PairedPoint, ...], north_var_rad2: float, n_sure: int) -> _Fit:
    """Return the fit of shift and rotation to the `consistent_pairs`."""
    fit = _fitted(pairs, north_var_rad2)
    while (n := len(fit.pairs)) > max(n_sure, 1):
        limit = agreement_limit(2 * n - 3) if n > 3 else _MIN_DISAGREEMENT**2
        if fit.squares.min() <= limit:
            break
        subsets = (fit.pairs[:k] + fit.pairs[k + 1 :] for k in range(n_sure, n))
        fit = min((_fitted(subset, north_var_rad2) for subset in subsets), key=lambda subset: subset.squares.min())
    return fit
