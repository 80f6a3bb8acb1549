"""From the frame in which a track starts to the frame of its position fixes: a shift and a turn.

Dead reckoning knows neither where it starts nor which way is north. The first fix shows where it is. The turn is
anything then, and a density over all turns, which the fixes that follow narrow: the likelihood of a turn is that of
what it leaves between the fixes and the track, whose errors grow as the filter says. Positions are the mean and the
covariance over that density, so that they are in the frame of the fixes from the first one on. A density that has
become narrow is a rotation with a standard deviation, in which the filter is linear: the track goes over into the frame
of the fixes for good (least squares as in W. Kabsch, "A solution for the best rotation to relate two sets of vectors",
Acta Cryst. A32, 1976, in the plane).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from pdr_filter.filter.motion import HEADING_OFFSET, MAX_HEADING_VARIANCE
from pdr_filter.values import FloatArray, Origin, read_only, wrap_angle

# A density this narrow (one standard deviation, 15 degrees) is a rotation: the filter refines it linearly.
MAX_ANGLE_STD_RAD = 0.26
# Fixes that are remembered for it; of more, the first and the last ones.
MAX_PAIRS = 24
_ANGLES_RAD: FloatArray = np.linspace(-np.pi, np.pi, 120, endpoint=False)
_TURNS = np.exp(1j * _ANGLES_RAD)
# One in so many good sets of fixes loses one of them.
_DISAGREE_PROB = 1e-3
_APART = 10.0
# How often a compass points anywhere: a phone that is held across, a magnet in its case. It did in 1 of 102 recordings,
# where somebody ran with the phone in his hand (tests/benchmarks/absolute_heading.py), 1 in 21 at most. With so
# much doubt no compass alone settles a turn.
_ASTRAY_PROB = 0.05
_ASTRAY_DENSITY = _ASTRAY_PROB / (2.0 * math.pi)


def _rotations(angle_rad: FloatArray) -> FloatArray:
    """R (A, 2, 2) for columns east, north, clockwise."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=-2)


_ROTATIONS = _rotations(_ANGLES_RAD)


@dataclass(frozen=True, slots=True, eq=False)
class PairedPoint:
    """A fix, and where the track was at its time."""

    track_m: FloatArray  # (2,)
    world_m: FloatArray  # (2,)
    var_m2: float  # of the fix, mean of both axes
    walked_var_m2: float = 0.0  # of the track since its start, but for its heading: it only grows
    time_s: float = 0.0
    correlation_s: float = 0.0  # of the errors of fixes, see `PositionFix`

    def moved(self, alignment: Alignment) -> PairedPoint:
        """With the place of the track moved."""
        return replace(self, track_m=read_only(alignment.positions(self.track_m)))


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where somebody is and which way he walks, in some frame."""

    position_m: FloatArray  # (2,)
    cov_m2: FloatArray  # (2, 2)
    heading_rad: float
    n_steps: int  # number of the step that led there


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """World = R (track - track_centre) + world_centre, R clockwise by an angle."""

    angle_rad: float
    angle_var_rad2: float
    track_centre_m: FloatArray  # (2,)
    world_centre_m: FloatArray  # (2,)
    centre_var_m2: float
    n_steps: int  # steps that were reported in the frame of the start

    @property
    def rotation(self) -> FloatArray:
        """R, (2, 2), for columns east, north: headings grow by the angle."""
        return _rotations(np.array([self.angle_rad]))[0]

    def positions(self, track_m: FloatArray) -> FloatArray:
        """Positions (..., 2) in the world."""
        return (track_m - self.track_centre_m) @ self.rotation.T + self.world_centre_m

    def world(self, place: Place) -> Place:
        """A place in the world."""
        position_m = self.positions(place.position_m)
        east_m, north_m = position_m - self.world_centre_m
        lever_m = np.array([north_m, -east_m])
        cov = self.rotation @ place.cov_m2 @ self.rotation.T + self.centre_var_m2 * np.eye(2)
        cov = cov + self.angle_var_rad2 * lever_m[:, None] * lever_m
        return replace(place, position_m=position_m, cov_m2=cov, heading_rad=place.heading_rad + self.angle_rad)


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
        away = wrap_angle(angle_rad - self.angle_rad)
        peak = (1.0 - _ASTRAY_PROB) / math.sqrt(2.0 * math.pi * self.var_rad2)
        return peak * np.exp(-0.5 * away**2 / self.var_rad2) + _ASTRAY_DENSITY

    def weighed(self, angle_rad: float) -> tuple[float, float]:
        """Information about a turn near an angle, and by how much the angle is too large for it."""
        astray_prob = _ASTRAY_DENSITY / float(self.density(np.array(angle_rad)))
        return (1.0 - astray_prob) / self.var_rad2, float(wrap_angle(angle_rad - self.angle_rad))


@dataclass(frozen=True, slots=True, eq=False)
class OpenTurn:
    """What is known of a turn that is not settled: a probability for each angle, and where the track's origin is."""

    prob: FloatArray  # (A,) of `_ANGLES_RAD`
    origin_m: FloatArray  # (A, 2) in the world
    origin_var_m2: float
    drawn: int | None = None  # the one turn under which places are reported, with mean squares about them; else means

    @property
    def direction(self) -> complex:
        """Mean of e^(i angle): as long as the turn is sure."""
        return complex(self.prob @ _TURNS)

    def with_compass(self, compass: Compass | None) -> OpenTurn:
        """The density with what a compass says."""
        if compass is None:
            return self
        prob = self.prob * compass.density(_ANGLES_RAD)
        return replace(self, prob=prob / prob.sum())

    @property
    def angle_rad(self) -> float:
        """The turn under which places are reported, or the mean direction."""
        return cmath.phase(self.direction) if self.drawn is None else float(_ANGLES_RAD[self.drawn])

    @property
    def angle_var_rad2(self) -> float:
        """Mean square of the turn about that."""
        return float(self.prob @ wrap_angle(_ANGLES_RAD - self.angle_rad) ** 2)

    def world(self, place: Place) -> Place:
        """A place in the world: mean and covariance over all turns."""
        each = _ROTATIONS @ place.position_m + self.origin_m
        reported = self.prob @ each if self.drawn is None else each[self.drawn]
        away = each - reported
        # the mean of R P R': its half trace stays, and (xx - yy) / 2 + i xy turns back by twice the angle
        (xx, xy), (_, yy) = place.cov_m2.tolist()
        size, shape = 0.5 * (xx + yy), complex(0.5 * (xx - yy), xy) * complex(self.prob @ _TURNS.conj() ** 2)
        cov = np.array([[size + shape.real, shape.imag], [shape.imag, size - shape.real]])
        cov = cov + (self.prob[:, None] * away).T @ away + self.origin_var_m2 * np.eye(2)
        return replace(place, position_m=reported, cov_m2=cov, heading_rad=place.heading_rad + self.angle_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Whether the track is in the frame of the fixes, and what is known of how to bring it there."""

    is_joined: bool
    pairs: tuple[PairedPoint, ...] = ()  # fixes until it is
    agreeing: tuple[PairedPoint, ...] = ()  # those of them that can all be right
    turn: OpenTurn | None = None  # from the first of them on, as they show it
    compass: Compass | None = None  # until it is
    alignment: Alignment | None = None  # how the frame of the start became that of the fixes
    north: Alignment | None = None  # how a heading fix had turned the frame of the start before
    moves: tuple[Alignment, ...] = ()  # how fixes moved the track later on, each from its step on (`doubt`)

    @property
    def north_var_rad2(self) -> float:
        """Variance of the turn before any position fix: infinite if it may be anything."""
        return math.inf if self.north is None else self.north.angle_var_rad2

    @property
    def turn_var_rad2(self) -> float:
        """Variance of a turn that is not in the filter's states: of a frame that is joined, none."""
        if self.is_joined:
            return 0.0
        known = self._open
        return known.angle_var_rad2 if known else 0.0 if self.compass is None else self.compass.std_rad**2

    @property
    def is_known(self) -> bool:
        """Whether positions are in the frame of fixes, be the turn settled or not."""
        return self.turn is not None or self.alignment is not None

    @property
    def name(self) -> str:
        """Which one positions are in: that of the "fixes", that of the start with true "north", or of the "start"."""
        if self.is_known:
            return "fixes"
        return "start" if self.compass is None else "north"

    @property
    def _open(self) -> OpenTurn | None:
        """What fixes and compass show of the turn; None before the first fix, and once it is settled."""
        return None if self.turn is None else self.turn.with_compass(self.compass)

    def world(self, place: Place) -> Place:
        """A place that was reported in the frame of the start, by what is known now."""
        if self.north is not None and place.n_steps < self.north.n_steps:
            place = self.north.world(place)
        if self.alignment is not None:
            return self.alignment.world(place)
        if self._open is not None:
            return self._open.world(place)
        if self.compass is None:
            return place
        angle_rad, var_rad2 = self.compass.angle_rad, self.compass.std_rad**2
        about_start = Alignment(angle_rad, var_rad2, np.zeros(2), np.zeros(2), 0.0, 0)
        return about_start.world(place)

    def origin(self, place: Origin) -> Origin:
        """Where the fixes have their zero, with how well they put the track there as they settled its turn, or so far.

        The turn is that of the frame of the start, a heading fix before them included.
        """
        before_rad = 0.0 if self.north is None else self.north.angle_rad
        known = self.alignment or self._open
        if known is None:
            return place
        var_m2 = known.centre_var_m2 if isinstance(known, Alignment) else known.origin_var_m2
        return replace(
            place,
            turn_rad=float(wrap_angle(before_rad + known.angle_rad)),
            turn_std_rad=math.sqrt(known.angle_var_rad2),
            position_std_m=math.sqrt(var_m2),
        )

    def drawn(self) -> Frame:
        """The same for a picture of the track, which keeps its shape: an open turn is the most probable one."""
        if self._open is None:
            return self
        # of equal ones the smallest: after one fix all are, but for rounding
        best = int(np.argmax(self._open.prob - 1e-9 * np.abs(_ANGLES_RAD)))
        return replace(self, turn=replace(self._open, drawn=best), compass=None)

    def with_pair(self, pair: PairedPoint) -> Frame:
        """With one more pair: the first of them and the latest are kept."""
        pairs = self.pairs[:1] + (*self.pairs[1:], pair)[-(MAX_PAIRS - 1) :] if self.pairs else (pair,)
        return replace(self, pairs=pairs)._turned()

    def _turned(self) -> Frame:
        """With what the pairs say of the turn."""
        if not self.pairs:
            return self
        agreeing = that_agree(self.pairs, self.north_var_rad2)
        return replace(self, agreeing=agreeing, turn=open_turn(agreeing, self.north_var_rad2))

    def with_north(self, north: Alignment) -> Frame:
        """After a heading fix has turned the frame of the start: what is left of the turn is as unsure as the fix."""
        return replace(self, north=north, compass=None)._turned()

    def with_compass(self, compass: Compass) -> Frame:
        """With what the magnetic field says by now; a heading fix knows better."""
        return self if self.is_joined or self.north is not None else replace(self, compass=compass)

    def moved(self, alignment: Alignment) -> Frame:
        """With the places of the track moved."""
        return replace(self, pairs=tuple(pair.moved(alignment) for pair in self.pairs))._turned()


START_FRAME = Frame(is_joined=True)
UNKNOWN_FRAME = Frame(is_joined=False)


class _LeastSquares(NamedTuple):
    """Pairs in the frame of the start, less the shift that fits each turn best."""

    weight: FloatArray  # (2 N, 2 N) inverse covariance of the errors
    projected: FloatArray  # (2 N, 2 N) the same with the best shift taken off
    shift_weight: FloatArray  # (2, 2) inverse covariance of the shift
    track: FloatArray  # (2 N,)


def _least_squares(pairs: Sequence[PairedPoint]) -> _LeastSquares:
    """Errors of the fixes are alike as the fixes say; those of the track are shared by all that came after them."""
    walked = np.array([p.walked_var_m2 for p in pairs])
    shared = np.minimum(walked[:, None], walked) - walked.min()
    weight = np.kron(np.linalg.inv(_fix_cov(pairs) + shared), np.eye(2))
    ones = np.kron(np.ones((len(pairs), 1)), np.eye(2))
    shift_weight = ones.T @ weight @ ones
    projected = weight - weight @ ones @ np.linalg.solve(shift_weight, ones.T @ weight)
    return _LeastSquares(weight, projected, shift_weight, np.concatenate([p.track_m for p in pairs]))


def _fix_cov(pairs: Sequence[PairedPoint]) -> FloatArray:
    """Covariance (N, N) of the errors of fixes along one axis."""
    std, time_s = np.sqrt([p.var_m2 for p in pairs]), np.array([p.time_s for p in pairs])
    correlation_s = np.array([p.correlation_s for p in pairs])
    alike_s = np.minimum(correlation_s[:, None], correlation_s)
    apart_s = np.abs(time_s[:, None] - time_s)
    alike = np.exp(-apart_s / np.maximum(alike_s, 1e-9)) * (alike_s > 0)
    np.fill_diagonal(alike, 1.0)
    return std[:, None] * std * alike


def _squares(pairs: Sequence[PairedPoint], fit: _LeastSquares, north_var_rad2: float) -> FloatArray:
    """Sum of squared errors over their covariance for each turn (A,), what is known of the north among them."""
    away = _turned_back(pairs, _ANGLES_RAD) - fit.track
    return ((away @ fit.projected) * away).sum(axis=1) + _ANGLES_RAD**2 / north_var_rad2


def open_turn(pairs: Sequence[PairedPoint], north_var_rad2: float = math.inf) -> OpenTurn:
    """The density of the turn that some pairs show, one at least."""
    fit = _least_squares(pairs)
    square = _squares(pairs, fit, north_var_rad2)
    prob = np.exp(-0.5 * (square - square.min()))
    ones = np.kron(np.ones((len(pairs), 1)), np.eye(2))
    away = _turned_back(pairs, _ANGLES_RAD) - fit.track
    shift = np.linalg.solve(fit.shift_weight, ones.T @ fit.weight @ away.T).T
    origin_m = np.einsum("aij,aj->ai", _ROTATIONS, shift)
    return OpenTurn(prob / prob.sum(), origin_m, 2.0 / float(np.trace(fit.shift_weight)))


def align(
    pairs: Sequence[PairedPoint], n_steps: int, north_var_rad2: float = math.inf, compass: Compass | None = None
) -> Alignment | None:
    """The alignment that the pairs show, or None while they leave the turn open.

    From the most probable turn of the density by Gauss-Newton; with e_i the fixes turned back into the frame of the
    start, d e_i / d angle = (-e_north, e_east). Shift and angle are independent at the weighted centre. A compass
    counts with the probability that it does not point anywhere.
    """
    turn = open_turn(pairs, north_var_rad2).with_compass(compass)
    length = min(max(abs(turn.direction), 1e-12), 1.0)
    if -2.0 * math.log(length) > MAX_ANGLE_STD_RAD**2:
        return None
    fit = _least_squares(pairs)
    angle_rad, information = float(_ANGLES_RAD[turn.prob.argmax()]), 1.0
    for _ in range(5):
        back = _turned_back(pairs, np.array([angle_rad]))[0]
        slope = np.stack([-back[1::2], back[::2]], axis=1).ravel()
        of_compass, too_large_rad = (0.0, 0.0) if compass is None else compass.weighed(angle_rad)
        information = float(slope @ fit.projected @ slope) + 1.0 / north_var_rad2 + of_compass
        pull = float(slope @ fit.projected @ (back - fit.track)) + angle_rad / north_var_rad2
        angle_rad -= (pull + of_compass * too_large_rad) / information
    of_each = centre_weights(pairs)
    track, world = np.stack([p.track_m for p in pairs]), np.stack([p.world_m for p in pairs])
    centre_var = 2.0 / float(np.trace(fit.shift_weight))
    return Alignment(angle_rad, 1.0 / information, of_each @ track, of_each @ world, centre_var, n_steps)


def centre_weights(pairs: Sequence[PairedPoint]) -> FloatArray:
    """How much each of the pairs counts in the centre of their alignment, (N,): one in sum."""
    of_each = _least_squares(pairs).weight.reshape(len(pairs), 2, -1)[:, 0, ::2].sum(axis=1)
    return of_each / of_each.sum()


def least_squares_error(pairs: Sequence[PairedPoint], north_var_rad2: float = math.inf) -> float:
    """Sum of squared errors over their covariance that the best shift and turn leave, chi-square distributed."""
    return float(_squares(pairs, _least_squares(pairs), north_var_rad2).min())


def that_agree(pairs: tuple[PairedPoint, ...], north_var_rad2: float = math.inf) -> tuple[PairedPoint, ...]:
    """The pairs that can all be right: as long as they cannot, the one is left out that costs the others most.

    Of two or three none is in the minority: they must be ten standard deviations apart.
    """

    def best(some: tuple[PairedPoint, ...]) -> float:
        return least_squares_error(some, north_var_rad2)

    while len(pairs) > 1:
        limit = chi2.isf(_DISAGREE_PROB, 2 * len(pairs) - 3) if len(pairs) > 3 else _APART**2
        if best(pairs) <= limit:
            break
        pairs = min((pairs[:k] + pairs[k + 1 :] for k in range(len(pairs))), key=best)
    return pairs


def _turned_back(pairs: Sequence[PairedPoint], angle_rad: FloatArray) -> FloatArray:
    """The fixes turned back by each angle, (A, 2 N)."""
    world = np.stack([p.world_m for p in pairs])
    R = _ROTATIONS if angle_rad is _ANGLES_RAD else _rotations(angle_rad)
    return (world @ R).reshape(len(angle_rad), -1)


def walked_var_m2(cov: FloatArray) -> float:
    """Variance of a position with covariance (4, 4) that its heading does not explain, mean of both axes."""
    # a heading that is known exactly divides nothing
    of_heading, heading_var = cov[:2, HEADING_OFFSET], max(float(cov[HEADING_OFFSET, HEADING_OFFSET]), 1e-12)
    return 0.5 * float(np.trace(cov[:2, :2]) - of_heading @ of_heading / heading_var)


def moved(mean: FloatArray, cov: FloatArray, alignment: Alignment) -> tuple[FloatArray, FloatArray]:
    """Means (M, n) and covariances (M, n, n) in the world, with what is unsure about the alignment.

    P = T P T' + var(a) g g' + var(centre) on the position, with T the rotation of the position and g the derivative of
    the state with respect to the angle.
    """
    T = np.eye(mean.shape[1])
    T[:2, :2] = alignment.rotation
    turned = mean.copy()
    turned[:, :2] = alignment.positions(mean[:, :2])
    turned[:, HEADING_OFFSET] += alignment.angle_rad
    g = np.zeros_like(mean)
    lever = turned[:, :2] - alignment.world_centre_m
    g[:, 0], g[:, 1], g[:, HEADING_OFFSET] = lever[:, 1], -lever[:, 0], 1.0
    grown = T @ cov @ T.T + alignment.angle_var_rad2 * g[:, :, None] * g[:, None, :]
    grown[:, :2, :2] += alignment.centre_var_m2 * np.eye(2)
    return turned, grown
