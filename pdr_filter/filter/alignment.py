"""From the frame in which a track starts to the frame of its position fixes: a shift and a turn.

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
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

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
    n_steps: int  # steps that were reported before
    since: int = 0  # of these, the first that was reported in the frame that it turns; all are in the world before

    def turns(self, place: Place) -> bool:
        """Whether a place was reported in the frame that it turns."""
        return self.since <= place.n_steps < self.n_steps

    @property
    def rotation(self) -> FloatArray:
        """R, (2, 2), for columns east, north: headings grow by the angle."""
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        return np.array([[c, s], [-s, c]])

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
    since: int = 0  # steps before the heading was lost and the frame with it, zero for that of the start
    pairs: tuple[PairedPoint, ...] = ()  # fixes until it is; where the heading was lost the place there before them
    agreeing: tuple[PairedPoint, ...] = ()  # those of them that can all be right
    turn: OpenTurn | None = None  # from the first of them on, as they show it
    compass: Compass | None = None  # until it is
    north_var_rad2: float = math.inf  # of the turn before any position fix: infinite if it may be anything
    north: Alignment | None = None  # how a heading fix had turned the frame of the start before the position fixes
    alignment: Alignment | None = None  # how the frame of the start became that of the fixes
    later: tuple[Alignment, ...] = ()  # how frames after a lost heading became it, and how fixes moved the track

    @property
    def moves(self) -> tuple[Alignment, ...]:
        """How fixes moved the track, each from its step on (`doubt`)."""
        return tuple(turn for turn in self.later if turn.since == turn.n_steps)

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
        """A place that was reported in a frame of its own, that of the start or a later one, by what is known now."""
        for turn in (self.north, self.alignment, *self.later):
            if turn is not None and turn.turns(place):
                place = turn.world(place)
        if self.is_joined or place.n_steps < self.since:
            return place
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
        # what is known of a place from before is no fix among others: see `doubt` for when it is wrong
        agreeing = that_agree(self.pairs, self.north_var_rad2, n_sure=1 if self.since else 0)
        return replace(self, agreeing=agreeing, turn=open_turn(agreeing, self.north_var_rad2))

    def with_north(self, north: Alignment) -> Frame:
        """After a heading fix has turned its own frame: what is left of the turn is as unsure as both together."""
        known = replace(self, compass=None, north_var_rad2=north.angle_var_rad2)
        known = replace(known, later=(*self.later, north)) if self.since else replace(known, north=north)
        return known._turned()

    def with_compass(self, compass: Compass) -> Frame:
        """With what the magnetic field says by now; a heading fix knows better."""
        return replace(self, compass=compass) if self.is_open else self

    @property
    def is_open(self) -> bool:
        """Whether nothing but positions and the magnetic field has settled the turn."""
        return not self.is_joined and self.north_var_rad2 > MAX_ANGLE_STD_RAD**2

    def joined(self, alignment: Alignment) -> Frame:
        """With the turn settled."""
        frame = Frame(is_joined=True, north=self.north, alignment=self.alignment, later=self.later)
        if self.since == 0:
            return replace(frame, alignment=alignment)
        if self.since == alignment.n_steps:  # no step was reported in it
            return frame
        return replace(frame, later=(*self.later, replace(alignment, since=self.since)))

    def opened(self, pairs: tuple[PairedPoint, ...], turn_var_rad2: float, n_steps: int) -> Frame:
        """With the turn open again from the place of the first pair on, where the heading was lost."""
        var = turn_var_rad2 if turn_var_rad2 < MAX_HEADING_VARIANCE else math.inf
        return replace(self, is_joined=False, since=n_steps, pairs=pairs, north_var_rad2=var)._turned()

    def most_probable(self, n_steps: int) -> Alignment:
        """The alignment of a turn that stays open, for what comes after."""
        turn, of_each = self.drawn().turn, centre_weights(self.agreeing)
        assert turn is not None and turn.drawn is not None
        centre_m = of_each @ np.stack([p.track_m for p in self.agreeing])
        world_m = _ROTATIONS[turn.drawn] @ centre_m + turn.origin_m[turn.drawn]
        return Alignment(turn.angle_rad, turn.angle_var_rad2, centre_m, world_m, turn.origin_var_m2, n_steps)

    def moved(self, alignment: Alignment) -> Frame:
        """With the places of the track moved."""
        return replace(self, pairs=tuple(pair.moved(alignment) for pair in self.pairs))._turned()


START_FRAME = Frame(is_joined=True)
UNKNOWN_FRAME = Frame(is_joined=False)


class _LeastSquares(NamedTuple):
    """Pairs in the frame of the start, less the shift that fits each turn best; both axes are alike."""

    projected: FloatArray  # (N, N) inverse covariance of the errors along one axis with the best shift taken off
    of_each: FloatArray  # (N,) how much each counts in the best shift: one in sum
    shift_var_m2: float
    track: FloatArray  # (N, 2)


def _least_squares(pairs: Sequence[PairedPoint]) -> _LeastSquares:
    """Errors of the fixes are alike as the fixes say; those of the track are shared by all that came after them."""
    walked = np.array([p.walked_var_m2 for p in pairs])
    shared = np.minimum(walked[:, None], walked) - walked.min()
    weight = np.linalg.inv(_fix_cov(pairs) + shared)
    of_each = weight.sum(axis=0)
    information = float(of_each.sum())
    projected = weight - of_each[:, None] * of_each / information
    track_m = np.stack([p.track_m for p in pairs])
    return _LeastSquares(projected, of_each / information, 1.0 / information, track_m)


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
    away = _turned_back(pairs, _ROTATIONS) - fit.track
    return ((fit.projected @ away) * away).sum(axis=(1, 2)) + _ANGLES_RAD**2 / north_var_rad2


def open_turn(pairs: Sequence[PairedPoint], north_var_rad2: float = math.inf) -> OpenTurn:
    """The density of the turn that some pairs show, one at least."""
    fit = _least_squares(pairs)
    square = _squares(pairs, fit, north_var_rad2)
    prob = np.exp(-0.5 * (square - square.min()))
    shift = fit.of_each @ (_turned_back(pairs, _ROTATIONS) - fit.track)
    origin_m = np.einsum("aij,aj->ai", _ROTATIONS, shift)
    return OpenTurn(prob / prob.sum(), origin_m, fit.shift_var_m2)


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
        back = _turned_back(pairs, _rotations(np.array([angle_rad])))[0]
        slope = np.stack([-back[:, 1], back[:, 0]], axis=1)
        of_compass, too_large_rad = (0.0, 0.0) if compass is None else compass.weighed(angle_rad)
        of_fixes = fit.projected @ slope
        information = float((of_fixes * slope).sum()) + 1.0 / north_var_rad2 + of_compass
        pull = float((of_fixes * (back - fit.track)).sum()) + angle_rad / north_var_rad2
        angle_rad -= (pull + of_compass * too_large_rad) / information
    centre_m, world_m = fit.of_each @ fit.track, fit.of_each @ np.stack([p.world_m for p in pairs])
    return Alignment(angle_rad, 1.0 / information, centre_m, world_m, fit.shift_var_m2, n_steps)


def centre_weights(pairs: Sequence[PairedPoint]) -> FloatArray:
    """How much each of the pairs counts in the centre of their alignment, (N,): one in sum."""
    return _least_squares(pairs).of_each


def least_squares_error(pairs: Sequence[PairedPoint], north_var_rad2: float = math.inf) -> float:
    """Sum of squared errors over their covariance that the best shift and turn leave, chi-square distributed."""
    return float(_squares(pairs, _least_squares(pairs), north_var_rad2).min())


def agreement_limit(n_free: int) -> float:
    """Chi-square that one in a thousand sets of good fixes exceeds."""
    from scipy.special import chdtri  # which takes as long to load as all the rest of a filter

    return float(chdtri(n_free, _DISAGREE_PROB)) if n_free > 0 else math.inf


def that_agree(
    pairs: tuple[PairedPoint, ...], north_var_rad2: float = math.inf, n_sure: int = 0
) -> tuple[PairedPoint, ...]:
    """The pairs that can all be right: as long as they cannot, the one is left out that costs the others most.

    Of two or three none is in the minority: they must be ten standard deviations apart. The first `n_sure` stay.
    """

    def best(some: tuple[PairedPoint, ...]) -> float:
        return least_squares_error(some, north_var_rad2)

    while len(pairs) > 1:
        limit = agreement_limit(2 * len(pairs) - 3) if len(pairs) > 3 else _APART**2
        if best(pairs) <= limit:
            break
        if len(pairs) == n_sure:
            break
        pairs = min((pairs[:k] + pairs[k + 1 :] for k in range(n_sure, len(pairs))), key=best)
    return pairs


def _turned_back(pairs: Sequence[PairedPoint], rotations: FloatArray) -> FloatArray:
    """The fixes turned back by each rotation, (A, N, 2)."""
    return np.stack([p.world_m for p in pairs]) @ rotations


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
