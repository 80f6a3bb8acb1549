"""Smoothed states of a problem, by GTSAM: wrong observations are found and left out, and nothing needs a start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from pdr_filter.filter.motion import HEADING_OFFSET, LOG_SCALE, N_STATES
from pdr_filter.offline.robust import GNC_FACTOR, truncated_start, truncated_weights
from pdr_filter.offline.smoothing.equations import (
    Rows,
    direction_residuals,
    graph_of,
    linearised,
    position_residuals,
    relaxed,
    relaxed_squared_residuals,
)
from pdr_filter.offline.smoothing.problem import Problem
from pdr_filter.values.angles import wrap_angle
from pdr_filter.values.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Smoothed states at the anchors, and what became of the observations (positions, then directions)."""

    mean: FloatArray  # (n + 1, 4)
    joint_cov: FloatArray  # (n, 8, 8) both ends of each interval
    frame_rad: float  # rotation from the frame of the offsets
    nis: FloatArray  # (F + H,)
    weight: FloatArray  # (F + H,)
    converged: bool


def solve(problem: Problem) -> Solution:
    """Smoothed states at the anchors, wrong observations left out.

    1. A linear problem without angles gives the initial guess: heading offset and scale together are a vector
       z = e^s (cos theta, sin theta), a displacement is M(D) z and thus linear in it. Graduated non-convexity with
       truncated least squares leaves out wrong observations on the way.
    2. Gauss-Newton with angles and scales. Observations that are further from what all others say than the 99.9 %
       quantile are left out, those nearer come back, until nothing changes.
    """
    mean, frame_rad, weight = _initial_guess(problem)
    limit, possible = problem.limit_nis, problem.possible
    seen: set[bytes] = set()
    while True:
        mean, frame_rad, converged = _gauss_newton(problem, mean, frame_rad, weight)
        tree = _eliminated(linearised(problem, mean, frame_rad, weight))
        nis = _innovations(problem, mean, weight, tree)
        seen.add(weight.tobytes())
        after = next((w for w in _changes(weight, possible * nis / limit, possible) if w.tobytes() not in seen), None)
        if after is None:
            break
        weight = after
    joint_cov = np.array([_cov_of(tree, [j, j + 1]) for j in range(len(problem.intervals))])
    return Solution(mean, joint_cov, frame_rad, nis, weight, converged)


def filtered_at(problem: Problem, found: Solution, node: int) -> tuple[FloatArray, FloatArray]:
    """Mean (4,) and covariance (4, 4) at an anchor of all that was before it and at it, linearised at the solution.

    For problems without directions and offsets.
    """
    rows = linearised(problem, found.mean, found.frame_rad, found.weight)
    tree = _eliminated([r.chosen((r.a <= node) & (r.b <= node)) for r in rows])
    cov = _cov_of(tree, [max(node - 1, 0), node])[-N_STATES:, -N_STATES:]
    return found.mean[node] + tree.optimize().at(node), 0.5 * (cov + cov.T)


def _initial_guess(problem: Problem) -> tuple[FloatArray, float, FloatArray]:
    """States and rotation to begin with, and which observations seem right, from the linear problem without angles."""
    limit, possible = problem.limit_nis, problem.possible
    weight, mu = possible.copy(), None
    state, turn = _solved(relaxed(problem, weight), problem)
    for _ in range(60 if len(limit) else 0):
        nis = relaxed_squared_residuals(problem, state)
        if mu is None:
            excess = float((possible * nis / limit).max())
            if excess <= 1:
                break
            mu = truncated_start(excess)
        weight = possible * truncated_weights(nis, limit, mu)
        mu *= GNC_FACTOR
        state, turn = _solved(relaxed(problem, weight), problem)
        if ((weight == 0) | (weight == 1)).all():
            break
    mean = state.copy()
    # more than a third longer or shorter is not the person: it is a turn that the linear problem took for a scale
    mean[:, LOG_SCALE] = np.clip(np.log(np.maximum(np.hypot(state[:, 2], state[:, 3]), 1e-3)), -0.3, 0.3)
    mean[:, LOG_SCALE] = np.median(mean[:, LOG_SCALE])
    angle = np.unwrap(np.arctan2(state[:, 3], state[:, 2]))
    nearest = wrap_angle(angle[0] - problem.start_mean[HEADING_OFFSET]) + problem.start_mean[HEADING_OFFSET]
    mean[:, HEADING_OFFSET] = angle + nearest - angle[0]
    return mean, turn, (weight > 0.5).astype(float)


def _gauss_newton(
    problem: Problem, mean: FloatArray, frame_rad: float, weight: FloatArray
) -> tuple[FloatArray, float, bool]:
    """States, rotation, and whether the iteration converged."""
    for iteration in range(60):
        change, turn = _solved(linearised(problem, mean, frame_rad, weight), problem)
        largest_turn = max(float(np.abs(change[:, HEADING_OFFSET]).max()), abs(turn))
        largest_scale = float(np.abs(change[:, LOG_SCALE]).max())
        # never further than the linearisation reaches; shorter steps where it does not converge
        share = min(1.0, 0.7 / max(largest_turn, 1e-9), 0.3 / max(largest_scale, 1e-9)) * (
            1.0 if iteration < 20 else 0.5
        )
        mean, frame_rad = mean + share * change, frame_rad + share * turn
        if share * float(np.abs(change).max()) < 1e-9 * (1 + float(np.abs(mean).max())):
            return mean, frame_rad, True
    return mean, frame_rad, False


def _changes(weight: FloatArray, excess: FloatArray, possible: FloatArray) -> list[FloatArray]:
    """Weights to try next, the best first: without the worst observations, else with all that fit again, or one.

    A wrong observation makes its neighbours look wrong, and of two that contradict each other both look wrong: only
    the worst are left out at a time. `excess` is the distance of each over its limit.
    """
    used = np.where(weight > 0, excess, 0.0)
    if used.max(initial=0.0) > 1:
        worst = np.arange(len(weight)) == used.argmax()
        many = (used > 1) & (used >= 0.5 * used.max())
        choices = [many, worst] if many.sum() > 3 else [worst]
        return [np.where(c, 0.0, weight) for c in choices]
    fits = (weight == 0) & (excess <= 1) & (possible > 0)
    if not fits.any():
        return []
    best = np.arange(len(weight)) == np.where(fits, excess, np.inf).argmin()
    return [np.where(c, 1.0, weight) for c in (fits, best)]


def _innovations(problem: Problem, mean: FloatArray, weight: FloatArray, tree: gtsam.GaussianBayesTree) -> FloatArray:
    """How far each observation is from what all others say: chi-square with its dimension if it is right.

    r' (I - L)^-1 r for a whitened residual r of an observation that is used, with its leverage L = H P H'; and
    r' (I + L)^-1 r for one that is not: by so much the least sum of squares changes with it.
    """
    positions, directions = problem.positions, problem.directions
    blocks: list[tuple[int, int, FloatArray, FloatArray, FloatArray]] = []
    residual, by_node, by_other = position_residuals(positions, mean)
    blocks += zip(positions.node.tolist(), positions.other.tolist(), residual, by_node, by_other, strict=True)
    residual, by_last = direction_residuals(directions, mean)
    blocks += zip(directions.last.tolist(), directions.first.tolist(), residual, by_last, -by_last, strict=True)
    nis = np.empty(len(blocks))
    for i, (a, b, r, A, B) in enumerate(blocks):
        keys, H = ([a], A) if b < 0 else ([a], A + B) if a == b else ([a, b], np.hstack([A, B]))
        leverage = H @ _cov_of(tree, keys) @ H.T
        S = np.eye(len(r)) + (-leverage if weight[i] > 0 else leverage)
        # where nothing else says anything of it, the difference is rounding
        nis[i] = r @ np.linalg.solve(S + 1e-12 * np.eye(len(r)), r)
    return np.maximum(nis, 0.0)


def _solved(rows: Sequence[Rows], problem: Problem) -> tuple[FloatArray, float]:
    """Solution at the anchors (n + 1, 4), and the rotation (an angle; of a vector its direction)."""
    solution = graph_of(rows).optimize(gtsam.EliminateQR)
    state = np.array([solution.at(j) for j in range(problem.n_nodes)])
    if len(problem.offsets) == 0:
        return state, 0.0
    turn = solution.at(problem.n_nodes)
    return state, float(turn[0]) if len(turn) == 1 else float(np.arctan2(turn[1], turn[0]))


def _eliminated(rows: Sequence[Rows]) -> gtsam.GaussianBayesTree:
    return graph_of(rows).eliminateMultifrontal(gtsam.Ordering.OrderingType.COLAMD, gtsam.EliminateQR)


def _cov_of(tree: gtsam.GaussianBayesTree, keys: Sequence[int]) -> FloatArray:
    """Joint covariance of some states: (R' R)^-1 of their square-root information R.

    GTSAM's own covariances are by Cholesky, which takes what is known within a kilometre for unknown.
    """
    R, _ = tree.jointBayesNet(list(keys), gtsam.EliminateQR).matrix()
    inverse = np.linalg.inv(R)
    return inverse @ inverse.T
