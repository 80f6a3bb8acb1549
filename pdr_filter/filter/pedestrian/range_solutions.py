"""Search for positions and rotations of a track that fit the last ranges, with their odds.

A linear update requires an estimate that is more certain than the distance to the anchors. There is no such estimate if
the frame of the anchors is unknown, after a gap, or if the track is wrong. Ranges then fit several positions: ranges to
two anchors fit a path and nearly its mirror image. Least squares from many starting points finds them. The steps of the
track connect the ranges with each other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdr_filter.filter.pedestrian.alignment import Alignment
from pdr_filter.filter.pedestrian.frame_rotation import MAX_ANGLE_STD_RAD
from pdr_filter.values import (
    FloatArray,
    RangeFix,
    range_log_densities,
    range_residuals,
    read_only,
    replace_unchecked,
    wrap_angle,
)

# Largest number and age of stored ranges. Dead reckoning between older ranges is not accurate enough.
MAX_RANGES, MAX_AGE_S = 30, 40.0
# Starting points of the least squares: rotations, and positions on circles about the anchors with the range as radius.
_N_ANGLES, _N_BEARINGS = 12, 8
# Iterations from all starting points, number of best ones that are kept, and total number of iterations.
_N_ROUGH, _N_KEPT, _N_ITERATIONS = 8, 32, 25
# Error of the track between two ranges, relative to the displacement between them.
_WAY_SHARE = 0.05
# Poses whose positions and rotations differ by less are one solution.
_SAME_M, _SAME_RAD = 0.5, 0.1
# A solution with lower odds against the best one is discarded.
MIN_LOG_ODDS = -math.log(1000.0)
_MIN_RANGES = 4  # three for the unknowns, and one to verify them


@dataclass(frozen=True, eq=False)
class PairedRange:
    """Range, and the track position at its time."""

    fix: RangeFix
    track_m: FloatArray  # (2,) position of the track
    is_used: bool  # True if the filter has used the range

    def with_moved_track(self, positions: Callable[[FloatArray], FloatArray]) -> PairedRange:
        """Return the range with the track position transformed by a function of positions (..., 2)."""
        return replace_unchecked(self, track_m=read_only(positions(self.track_m)))


@dataclass(frozen=True, slots=True, eq=False)
class PriorPose:
    """Prior of the pose: the position of one point of the track and the rotation of the frame."""

    track_m: FloatArray  # (2,) point of the track
    position_m: FloatArray  # (2,) prior mean of the position of this point in the frame of the anchors
    information: FloatArray  # (3, 3) information matrix of the position and the rotation
    angle_rad: float = 0.0  # prior mean of the rotation from the track to the frame of the anchors


@dataclass(frozen=True, slots=True, eq=False)
class RangeSolution:
    """Shift and rotation of the track that fit the ranges."""

    # (2,) centre of rotation in both frames.
    track_centre_m: FloatArray
    world_centre_m: FloatArray
    angle_rad: float  # angle of the rotation
    cov: FloatArray  # (3, 3) covariance of the centre and the angle
    log_odds: float  # log of the ratio of the probabilities of this solution and the most probable one, 0 or less
    log_density: float  # log density of the ranges and the prior at this pose
    # True for ranges that fit the pose and are more probably direct than reflected, in the order of the ranges.
    fits: tuple[bool, ...]

    @property
    def is_settled(self) -> bool:
        """True if the rotation is known well enough for a joined frame."""
        return float(self.cov[2, 2]) <= MAX_ANGLE_STD_RAD**2

    def alignment(self, n_steps: int, since: int) -> Alignment:
        """Return the solution as an alignment about the point whose position is independent of the rotation.

        `n_steps` and `since` are the attributes of the `Alignment` with these names.
        """
        # p(q) = c + R q: its error is that of c plus (q_n, -q_e) times that of the angle, least at this lever
        of_angle = self.cov[:2, 2] / self.cov[2, 2]
        lever = np.array([of_angle[1], -of_angle[0]])
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        back = np.array([[c, -s], [s, c]])
        own = self.cov[:2, :2] - np.outer(of_angle, of_angle) * self.cov[2, 2]
        var_m2 = float(np.linalg.eigvalsh(own)[-1])
        return Alignment(
            self.angle_rad,
            float(self.cov[2, 2]),
            self.track_centre_m + back @ lever,
            self.world_centre_m + lever,
            max(var_m2, 0.0),
            n_steps,
            since,
        )


def recent(pairs: Sequence[PairedRange], pair: PairedRange) -> tuple[PairedRange, ...]:
    """Return the last ranges and one more, in order of time.

    Ranges older than `MAX_AGE_S` are left out. If there are more than `MAX_RANGES`, one range is removed. It is the one
    with the shortest time between its neighbours to the same anchor.
    """
    newest_s = max(p.fix.time_s for p in (*pairs, pair))
    kept = sorted((p for p in (*pairs, pair) if newest_s - p.fix.time_s <= MAX_AGE_S), key=lambda p: p.fix.time_s)
    if len(kept) > MAX_RANGES:
        by_anchor = dict[tuple[float, ...], list[PairedRange]]()
        for p in kept:
            by_anchor.setdefault(tuple(p.fix.anchor_m.tolist()), []).append(p)
        # time between the neighbours to the same anchor; the first and the last range of each anchor are kept
        inner = [
            (c.fix.time_s - a.fix.time_s, b)
            for each in by_anchor.values()
            for a, b, c in zip(each, each[1:], each[2:], strict=False)
        ]
        densest = min(inner, key=lambda gap: gap[0])[1] if inner else kept[0]
        kept = [p for p in kept if p is not densest]
    return tuple(kept)


def solutions(pairs: Sequence[PairedRange], prior: PriorPose | None = None) -> list[RangeSolution]:
    """Return the possible shifts and rotations of the track that fit the ranges, the most probable first.

    Solutions that are a thousand times less probable than the best one are removed. The list is empty if there are
    too few ranges (below four without a prior), or if they leave a continuum of solutions.
    """
    fixes = [pair.fix for pair in pairs]
    if len(fixes) < (_MIN_RANGES if prior is None else 1):
        return []
    track = np.array([pair.track_m for pair in pairs])
    centre = track.mean(axis=0)
    problem = _Problem(fixes, track - centre, prior, centre)
    pose = problem.starts()
    for iteration in range(_N_ITERATIONS):
        if iteration == _N_ROUGH:
            pose = _distinct(pose[np.argsort(-problem.log_density(pose))])
        pose = problem.improved(pose, is_robust=iteration >= _N_ROUGH // 2, damping=10.0 ** (-iteration / 4))
    value = problem.log_density(pose)
    found: list[tuple[float, float, FloatArray, FloatArray]] = []
    for k in np.argsort(-value):
        best = found[0][1] if found else value[k]
        if value[k] < best + 3.0 * MIN_LOG_ODDS:
            break
        if any(_is_same(pose[k], other) for _, _, other, _ in found):
            continue
        information = problem.information(pose[k])
        if np.linalg.eigvalsh(information)[0] < 1e-6:
            return []
        # Laplace approximation of the probability of all poses near this one
        volume = -0.5 * float(np.linalg.slogdet(information)[1])
        inverse = np.asarray(np.linalg.inv(information), dtype=float)
        found.append((float(value[k]) + volume, float(value[k]), pose[k], inverse))
    highest = max((odds for odds, *_ in found), default=0.0)
    result = [
        RangeSolution(centre, read_only(p[:2]), float(wrap_angle(p[2])), cov, odds - highest, density, problem.fits(p))
        for odds, density, p, cov in sorted(found, key=lambda f: -f[0])
    ]
    return [solution for solution in result if solution.log_odds > MIN_LOG_ODDS]


def _distinct(pose: FloatArray) -> FloatArray:
    """Return the first of each group of equal poses (P, 3), at most `_N_KEPT` of them.

    Poses that differ by at most `_SAME_M` and `_SAME_RAD` are equal.
    """
    kept = list[FloatArray]()
    left = pose
    while len(left) and len(kept) < _N_KEPT:
        kept.append(left[0])
        away_m = np.hypot(left[:, 0] - left[0, 0], left[:, 1] - left[0, 1])
        left = left[(away_m > _SAME_M) | (np.abs(wrap_angle(left[:, 2] - left[0, 2])) > _SAME_RAD)]
    return np.array(kept)


def log_density_unmoved(pairs: Sequence[PairedRange]) -> float:
    """Return the log density of the ranges if the track has its present position and rotation."""
    track = np.array([pair.track_m for pair in pairs])
    centre = track.mean(axis=0)
    problem = _Problem([pair.fix for pair in pairs], track - centre, None, centre)
    return float(problem.log_density(np.array([[*centre, 0.0]]))[0])


def _is_same(a: FloatArray, b: FloatArray) -> bool:
    """Return True if two poses are the same solution within small tolerances."""
    return bool(np.hypot(*(a[:2] - b[:2])) < _SAME_M and abs(float(wrap_angle(a[2] - b[2]))) < _SAME_RAD)


@dataclass(frozen=True)
class _Problem:
    """Least-squares problem of N ranges to a track, for P poses (P, 3): position of the track centre, and rotation."""

    fixes: list[RangeFix]
    lever_m: FloatArray  # (N, 2)
    prior: PriorPose | None
    centre_m: FloatArray  # (2,)

    @cached_property
    def _var_m2(self) -> FloatArray:
        """Variance (N,) of each residual, m2: variance of the range plus variance of the way from the centre."""
        own = np.array([fix.std_m**2 for fix in self.fixes])
        return own + (_WAY_SHARE**2) * (self.lever_m**2).sum(axis=1)

    def starts(self) -> FloatArray:
        """Return the poses (P, 3) from which the least squares start.

        The positions are on circles about up to three anchors, and at the prior. The rotations are spread over the
        circle. If the prior of the rotation is narrow, only its mean is used.
        """
        angles = np.linspace(-math.pi, math.pi, _N_ANGLES, endpoint=False)
        if self.prior is not None and self.prior.information[2, 2] > 1.0 / MAX_ANGLE_STD_RAD**2:
            angles = np.array([self.prior.angle_rad])
        bearing = np.linspace(-math.pi, math.pi, _N_BEARINGS, endpoint=False)
        anchors = {tuple(fix.anchor_m.tolist()): fix for fix in self.fixes}
        around = np.concatenate(
            [
                fix.anchor_m[:2] + max(fix.range_m, 0.5) * np.column_stack([np.sin(bearing), np.cos(bearing)])
                for fix in list(anchors.values())[:3]
            ]
        )
        if self.prior is not None:
            around = np.vstack([around, self.prior.position_m + self.centre_m - self.prior.track_m])
        place, angle = np.repeat(around, len(angles), axis=0), np.tile(angles, len(around))
        return np.column_stack([place, angle])

    def _parts(self, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residuals (P, N) of the ranges at poses (P, 3), and their derivatives (P, N, 3) by the pose."""
        c, s = np.cos(pose[:, 2, None]), np.sin(pose[:, 2, None])
        east, north = self.lever_m.T
        turned = np.stack([c * east + s * north, c * north - s * east], axis=-1)
        residual, direction = range_residuals(pose[:, None, :2] + turned, *self._anchors)
        by_angle = direction[..., 0] * turned[..., 1] - direction[..., 1] * turned[..., 0]
        return residual, np.concatenate([direction, by_angle[..., None]], axis=-1)

    @cached_property
    def _anchors(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions (N, 2) and heights (N,) of the anchors, and the ranges (N,)."""
        columns = np.array([(*fix.anchor_m[:2], fix.up_m, fix.range_m) for fix in self.fixes])
        return columns[:, :2], columns[:, 2], columns[:, 3]

    def _log_densities(self, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the log densities (P, N) of the residuals of N ranges for direct and for reflected paths."""
        return range_log_densities(residual, self._var_m2, np.array([fix.std_m for fix in self.fixes]))

    def _direct(self, residual: FloatArray) -> FloatArray:
        """Return the probability (P, N) that the path of each range is direct, given the residuals."""
        direct, reflected = self._log_densities(residual)
        return np.exp(direct - np.logaddexp(direct, reflected))

    def _from_prior(self, prior: PriorPose, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the differences (P, 3) of poses from the prior, and their derivatives (P, 3, 3) by the pose."""
        lever = prior.track_m - self.centre_m
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        turned = np.column_stack([c * lever[0] + s * lever[1], c * lever[1] - s * lever[0]])
        difference = np.column_stack(
            [pose[:, :2] + turned - prior.position_m, wrap_angle(pose[:, 2] - prior.angle_rad)]
        )
        by = np.tile(np.eye(3), (len(pose), 1, 1))
        by[:, 0, 2], by[:, 1, 2] = turned[:, 1], -turned[:, 0]
        return difference, by

    def _normal(self, pose: FloatArray, is_robust: bool) -> tuple[FloatArray, FloatArray]:
        """Return the normal matrices (P, 3, 3) and gradients (P, 3) of the least squares at poses (P, 3).

        The prior is included. If `is_robust` is True, each range has the weight of its probability to be direct.
        """
        residual, J = self._parts(pose)
        weight = (self._direct(residual) if is_robust else np.ones_like(residual)) / self._var_m2
        normal = np.einsum("pn,pna,pnb->pab", weight, J, J)
        gradient = np.einsum("pn,pna,pn->pa", weight, J, residual)
        if self.prior is not None:
            difference, by = self._from_prior(self.prior, pose)
            weighted = np.einsum("pba,bc->pac", by, self.prior.information)
            normal, gradient = normal + weighted @ by, gradient + np.einsum("pac,pc->pa", weighted, difference)
        return normal, gradient

    def improved(self, pose: FloatArray, is_robust: bool, damping: float) -> FloatArray:
        """Return the poses after one iteration of Levenberg-Marquardt with the equations of `_normal`."""
        normal, gradient = self._normal(pose, is_robust)
        damped = normal + damping * np.einsum("paa->pa", normal)[:, :, None] * np.eye(3) + 1e-9 * np.eye(3)
        return pose - np.linalg.solve(damped, gradient[..., None])[..., 0]

    def information(self, pose: FloatArray) -> FloatArray:
        """Return the information matrix (3, 3) of one pose, from the prior and the ranges that are probably direct."""
        return self._normal(pose[None], is_robust=True)[0][0]

    def log_density(self, pose: FloatArray) -> FloatArray:
        """Return the log density (P,) of the ranges and the prior at poses (P, 3).

        Each range is either direct, or reflected and longer.
        """
        total = np.logaddexp(*self._log_densities(self._parts(pose)[0])).sum(axis=1)
        if self.prior is None:
            return total
        difference, _ = self._from_prior(self.prior, pose)
        return total - 0.5 * np.einsum("pa,ab,pb->p", difference, self.prior.information, difference)

    def fits(self, pose: FloatArray) -> tuple[bool, ...]:
        """Return, for each range, True if it fits one pose (3,).

        Its residual is then below 3.7 standard deviations, and its path is more probably direct than reflected.
        """
        residual, _ = self._parts(pose[None])
        near = residual[0] ** 2 <= 13.8 * self._var_m2
        return tuple((near & (self._direct(residual)[0] >= 0.5)).tolist())
