"""Solution of a smoothing problem by GTSAM, without an initial guess, with rejection of outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pdr_filter.filter.imm.motion_model import EAST, HEADING_OFFSET, LOG_SCALE, MAX_HEADING_VARIANCE, N_STATES
from pdr_filter.offline.late_gtsam import gtsam
from pdr_filter.offline.robust_loss import GNC_FACTOR, truncated_start, truncated_weights
from pdr_filter.offline.smoothing.linear_graph import Rows, cov_of, eliminate, graph_of, joint_covariances
from pdr_filter.offline.smoothing.location_errors import N_ERRORS, Errors
from pdr_filter.offline.smoothing.preintegration import TURN, scaled_rotation, state_transform
from pdr_filter.offline.smoothing.problem import (
    MIN_HEADING_LENGTH_M,
    ObservedDirections,
    ObservedMeasurements,
    ObservedOffsets,
    ObservedPositions,
    ObservedStates,
    Problem,
)
from pdr_filter.values import (
    BoolArray,
    FloatArray,
    HeadingFix,
    IntArray,
    PositionFix,
    measurement_of,
    read_only,
    stated_fixes,
    wrap_angle,
)

_POSITION = slice(EAST, EAST + 2)
_OF_POSITION = np.eye(2, N_STATES)
# Outliers fewer than this many anchors apart are rejected one at a time, because a wrong fix bends the track around it.
_MIN_ANCHORS_APART = 30
# Assumed standard deviation of the first estimate of a measurement's position, and the factor on the gate there.
_GUESS_STD_M, _ROUGH_LIMIT = 2.0, 4.0
# The iteration ends if a step changes no state (m, rad, log scale) by more than the first value. It has converged if
# its last step changed none by more than the second one. In the slowest cases each change is 0.9 times the one before,
# so that the remaining changes sum to ten times the last one: 1 cm.
_SMALLEST_CHANGE, _CONVERGED = 1e-7, 1e-3
# It has also converged if the last step changed the sum of squares, which has the unit of chi-square, by less than
# this: a change of a state by its standard deviation increases the sum from its minimum by 1.
_NO_GAIN = 0.01
_MOST_HALVINGS = 6
# Most iterations, and most of them before the outliers among measurements are rejected. No relaxed problem rejects
# these outliers first: with ten contradictory ranges, complete iterations linearised five times as often.
_MOST_STEPS, _FIRST_STEPS = 60, 12


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Smoothed states at the anchors, and the use of positions, directions, states and measurements.

    An anchor is a foot contact at which a state is estimated: east, north, heading offset and log scale.
    """

    mean: FloatArray  # (n + 1, 4) smoothed state at each anchor
    joint_cov: FloatArray  # (n, 8, 8) joint covariance of both ends of each interval between consecutive anchors
    frame_rad: float  # rotation from the frame of the offsets to the frame of the positions
    # (F + H + S + X,) normalised innovation squared of each observation with respect to all others: F positions, H
    # directions, S states (heading offsets and log scales) and X measurements
    nis: FloatArray
    weight: FloatArray  # (F + H + S + X,) 1 for a used observation, 0 for a rejected one
    converged: bool  # True if the Gauss-Newton iteration converged
    # (N, 6) states of the anchors, in the first four columns, followed by the errors of correlated fixes
    states: FloatArray


def solve(problem: Problem, least_gain: float = -np.inf) -> Solution:
    """Return the `Solution` of a problem: the smoothed states at the anchors, without the influence of outliers.

    A linear problem without angles gives the initial guess, and graduated non-convexity the initial set of inliers.
    After each Gauss-Newton solution, observations beyond the 99.9 % quantile are rejected, and rejected ones within it
    are used again, until no new set of observations results (docs/methods/smoothing.md). Each Gauss-Newton iteration
    ends with a step that decreases the sum of squares by less than `least_gain`, or that changes hardly anything.

    Measurements may have several solutions, such as a walk that is mirrored about the anchor of its ranges. The problem
    is therefore solved from two initial guesses, one with the measurements and one without. The solution with the
    smaller sum of squares is returned.
    """
    guesses = [_initial_guess(problem, with_path=True)]
    if len(problem.measurements) and len(_with_stated_fixes(problem)[0].positions):
        guesses.append(_initial_guess(problem, with_path=False))
    return min((solved_from(problem, *guess, least_gain) for guess in guesses), key=partial(sum_of_squares, problem))


def solved_from(
    problem: Problem, mean: FloatArray, frame_rad: float, weight: FloatArray, least_gain: float = -np.inf
) -> Solution:
    """Return the `Solution` of a problem from an initial guess: states, rotation of the frame, and weights."""
    limit, possible, has_frame = problem.limit_nis, problem.possible, len(problem.offsets) > 0
    seen: set[bytes] = set()
    most_steps = first_steps = _FIRST_STEPS if len(problem.measurements) else _MOST_STEPS
    while True:
        mean, frame_rad, converged = _gauss_newton(problem, mean, frame_rad, weight, least_gain, most_steps)
        rows = linear_equations(problem, mean, frame_rad, weight)
        joint_cov, with_error_cov = joint_covariances(rows, problem.n_nodes, problem.errors.node, has_frame)
        nis = _innovations(problem, mean, weight, rows, joint_cov, with_error_cov)
        seen.add(weight.tobytes())
        changes = _next_weights(weight, possible * nis / limit, possible, _position_anchors(problem))
        after = next((w for w in changes if w.tobytes() not in seen), None)
        if after is None and not converged and most_steps < _MOST_STEPS:
            most_steps = _MOST_STEPS
            continue
        most_steps = first_steps
        if after is None:
            return Solution(mean[: problem.n_nodes, :N_STATES], joint_cov, frame_rad, nis, weight, converged, mean)
        weight = after


def _initial_guess(problem: Problem, *, with_path: bool) -> tuple[FloatArray, float, FloatArray]:
    """Return initial states, the rotation of the frame, and observation weights for the nonlinear smoother.

    They solve the relaxed problem, which replaces heading offset and log scale by a plane vector. It is linear, so it
    needs no initial guess. The weights, 0 or 1, come from a graduated non-convexity that removes outliers. Those of
    measurements come from their residuals at the initial states.
    """
    whole, (problem, of_whole) = problem, _with_stated_fixes(problem)
    n_relaxed = len(problem.positions) + len(problem.directions) + len(problem.states)
    limit, possible = problem.limit_nis[:n_relaxed], problem.possible[:n_relaxed]
    weight, mu = possible.copy(), None
    always = graph_of([*_relaxed(problem), *(_guess_rows(problem) if with_path else [])])

    def solved_with(weight: FloatArray) -> tuple[FloatArray, float]:
        graph = graph_of(_relaxed_observations(problem, weight))
        graph.push_back(always)
        return _solved(graph, problem)

    state, turn = solved_with(weight)
    for _ in range(60 if len(limit) else 0):
        nis = _relaxed_squared_residuals(problem, state)
        if mu is None:
            excess = float((possible * nis / limit).max())
            if excess <= 1:
                break
            mu = truncated_start(excess)
        weight = possible * truncated_weights(nis, limit, mu)
        mu *= GNC_FACTOR
        state, turn = solved_with(weight)
        if ((weight == 0) | (weight == 1)).all():
            break
    mean, state = state.copy(), state[: problem.n_nodes]
    at_anchors = mean[: problem.n_nodes]
    # a scale that differs by more than a third is not the person's: the linear problem has absorbed a rotation in it
    log_scale = np.clip(np.log(np.maximum(np.hypot(state[:, 2], state[:, 3]), 1e-3)), -0.3, 0.3)
    at_anchors[:, LOG_SCALE] = np.median(log_scale)
    angle = np.unwrap(np.arctan2(state[:, 3], state[:, 2]))
    nearest = wrap_angle(angle[0] - problem.start_mean[HEADING_OFFSET]) + problem.start_mean[HEADING_OFFSET]
    at_anchors[:, HEADING_OFFSET] = angle + nearest - angle[0]
    near = _nis_of_measurements(whole, mean) <= _ROUGH_LIMIT * whole.limit_nis[len(of_whole) :]
    return mean, turn, np.concatenate([(weight[of_whole] > 0.5).astype(float), near.astype(float)])


def _with_stated_fixes(problem: Problem) -> tuple[Problem, IntArray]:
    """Return the problem with measurements that state a position or a heading (`stated_fixes`) as such observations.

    The path at which they would be linearised first may be wrong, for example mirrored with ranges to one anchor. The
    second result has the rows in it of the given positions, directions and states.
    """
    positions, states, of = problem.positions, problem.states, problem.measurements
    each = [[(k, fix) for fix in stated_fixes(fix)] for k, fix in enumerate(of.fixes)]
    places = [(k, fix) for stated in each for k, fix in stated if isinstance(fix, PositionFix)]
    headings = [(k, fix) for stated in each for k, fix in stated if isinstance(fix, HeadingFix)]
    n = [len(positions), len(problem.directions), len(states)]
    rows = np.concatenate([np.arange(n[0]), n[0] + len(places) + np.arange(n[1] + n[2])])
    at, turned = (np.array([k for k, _ in found], dtype=np.int64) for found in (places, headings))
    offset_rad = np.array([fix.walking_heading_rad - of.device_rad[k] for k, fix in headings])
    std_rad = np.array([fix.std_rad for _, fix in headings])
    cov_m2 = [fix.cov_m2 + of.extra_var_m2[k] * np.eye(2) for k, fix in places]
    stated = ObservedPositions.on_map(of.node[at], of.ahead_m[at], [fix.position_m for _, fix in places], cov_m2)
    of_headings = ObservedStates(of.node[turned], np.full(len(turned), HEADING_OFFSET), offset_rad, std_rad)
    return replace(
        problem,
        positions=ObservedPositions.concatenate([positions, stated]),
        states=ObservedStates.concatenate([states, of_headings]),
        measurements=of.part(np.setdiff1d(np.arange(len(of)), np.union1d(at, turned))),
    ), rows


def _guess_rows(problem: Problem) -> list[Rows]:
    """Return equations of the relaxed problem (`_relaxed`) that replace the measurements, which may be nonlinear.

    Each equation keeps the position at the time of a measurement near the position at which the measurement is
    linearised first (`guess_m`), with the standard deviation `_GUESS_STD_M`.
    """
    measured_, n = problem.measurements, len(problem.measurements)
    if not n:
        return []
    H = np.zeros((n, 2, N_STATES))
    H[:, 0, 0] = H[:, 1, 1] = 1.0 / _GUESS_STD_M
    H[:, :, 2:] = _rotation_matrix_of(measured_.ahead_m) / _GUESS_STD_M
    return [Rows.of_single(measured_.node, H, measured_.guess_m / _GUESS_STD_M)]


def measurement_residuals(observed: ObservedMeasurements, mean: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Return the whitened residuals (k,) of each measurement, and their derivatives (k, 4) by the state of its anchor.

    The state has east, north, heading offset and log scale. k is the number of components of the measurement.
    """
    at = mean[observed.node, :N_STATES]
    moved_m = np.einsum("nab,nb->na", scaled_rotation(at[:, HEADING_OFFSET], at[:, LOG_SCALE]), observed.ahead_m)
    position_m, heading_rad = at[:, :2] + moved_m, observed.device_rad + at[:, HEADING_OFFSET]
    result: list[tuple[FloatArray, FloatArray]] = []
    for k, fix in enumerate(observed.fixes):
        residual, J, cov = measurement_of(fix, position_m[k], float(heading_rad[k]))
        by_place = J[:, :2]
        whiten = np.linalg.inv(np.linalg.cholesky(cov + observed.extra_var_m2[k] * by_place @ by_place.T))
        H = np.zeros((len(residual), N_STATES))
        H[:, :2] = by_place
        H[:, HEADING_OFFSET] = by_place @ (TURN @ moved_m[k]) + J[:, 2]
        H[:, LOG_SCALE] = by_place @ moved_m[k]
        result.append((whiten @ residual, whiten @ H))
    return result


def _nis_of_measurements(problem: Problem, mean: FloatArray) -> FloatArray:
    """Return the squared whitened residual (X,) of each measurement."""
    return np.array([float(r @ r) for r, _ in measurement_residuals(problem.measurements, mean)])


def _position_anchors(problem: Problem) -> IntArray:
    """Return the anchor of each observed position and measurement, -1 for directions and states, (F + H + S + X,)."""
    others = np.full(len(problem.directions) + len(problem.states), -1)
    return np.concatenate([problem.positions.node, others, problem.measurements.node])


def _gauss_newton(
    problem: Problem,
    mean: FloatArray,
    frame_rad: float,
    weight: FloatArray,
    least_gain: float,
    most_steps: int = _MOST_STEPS,
) -> tuple[FloatArray, float, bool]:
    """Return the states (N, 6), the rotation of the frame, and True if the Gauss-Newton iteration converged.

    It starts at `mean` and `frame_rad`, has the fixed weights `weight` of the observations, and ends after `most_steps`
    steps. It has converged if the last step changed no state by more than `_CONVERGED`, or hardly changed the sum of
    squares. A step is limited to the range of the linearisation, and halved while it increases the sum of squares:
    without a measured heading, a turn of one step and the opposite one of the next step would alternate. The last steps
    are not halved, because the covariance of an interval turns with its start and changes the sum, too.
    """
    largest, squares, rows = 0.0, 0.0, linear_equations(problem, mean, frame_rad, weight)
    for _ in range(most_steps):
        change, turn = _solved(graph_of(rows), problem)
        at_anchors = np.abs(change[: problem.n_nodes])
        largest_turn = max(float(at_anchors[:, HEADING_OFFSET].max()), abs(turn))
        largest_scale = float(at_anchors[:, LOG_SCALE].max())
        share = min(1.0, 0.7 / max(largest_turn, 1e-9), 0.3 / max(largest_scale, 1e-9))
        squares = _sum_of_squares(rows)
        for _ in range(_MOST_HALVINGS):
            rows = linear_equations(problem, mean + share * change, frame_rad + share * turn, weight)
            largest = share * float(np.abs(change).max())
            if largest < _CONVERGED or _sum_of_squares(rows) <= squares:
                break
            share *= 0.5
        mean, frame_rad = mean + share * change, frame_rad + share * turn
        if largest < _SMALLEST_CHANGE or squares - _sum_of_squares(rows) < least_gain:
            break
    return mean, frame_rad, largest < _CONVERGED or abs(squares - _sum_of_squares(rows)) < _NO_GAIN


def sum_of_squares(problem: Problem, found: Solution) -> float:
    """Return the sum of squares of a solution, less its expected value for the positions, to compare problems.

    Other shifts of a clock leave out other positions. Each contributes its two degrees of freedom less, and a rejected
    observation its gate, above which it would have been rejected.
    """
    rejected = problem.limit_nis[(found.weight == 0) & (problem.possible > 0)]
    rows = linear_equations(problem, found.states, found.frame_rad, found.weight)
    return _sum_of_squares(rows) + float(rejected.sum()) - 2.0 * len(problem.positions)


def response(problem: Problem, found: Solution, moved_m: FloatArray) -> tuple[FloatArray, float, float]:
    """Return how the anchors (n + 1, 4) follow if the observed positions move by `moved_m` (F, 2).

    The second and third results are half of the first and of the second derivative of the least sum of squares by the
    factor on `moved_m`, at zero.
    """
    rows = linear_equations(problem, found.states, found.frame_rad, found.weight)
    positions = replace(problem.positions, position_m=problem.positions.position_m + moved_m)
    moved = linear_equations(replace(problem, positions=positions), found.states, found.frame_rad, found.weight)
    gained = [replace(after, rhs=after.rhs - before.rhs) for before, after in zip(rows, moved, strict=True)]
    graph = graph_of(gained)
    solution = graph.optimize(gtsam.EliminateQR)
    slope = sum(
        float(np.sum(before.weight * np.einsum("na,na->n", before.rhs, after.rhs)))
        for before, after in zip(rows, gained, strict=True)
        if len(before.weight)
    )
    return np.array([solution.at(j) for j in range(problem.n_nodes)]), slope, 2.0 * graph.error(solution)


def _sum_of_squares(rows: Sequence[Rows]) -> float:
    """Return the weighted sum of the squared right-hand sides of linearised equations."""
    squares = ((of.rhs**2).sum(axis=1) * (of.weight if len(of.weight) else 1.0) for of in rows)
    return float(sum(square.sum() for square in squares))


def _next_weights(weight: FloatArray, excess: FloatArray, possible: FloatArray, node: IntArray) -> list[FloatArray]:
    """Return weights to try next, the best first. The list is empty if nothing has to change.

    If there are outliers, the worst are removed first, because they increase the residuals of their neighbours.
    Otherwise rejected observations that fit are used again. The worst fixes of distant positions are removed together,
    because they do not influence each other. The second choice changes a single observation. `excess` is the normalised
    innovation squared over its gate, above 1 for an outlier. `node` (F + H + S + X,) are the anchors of the
    observations, -1 for those without a position.
    """
    used = np.where(weight > 0, excess, 0.0)
    if used.max(initial=0.0) > 1:
        worst = np.arange(len(weight)) == used.argmax()
        of_places = worst.copy()
        (places,) = np.nonzero(node >= 0)
        for i in places[np.argsort(-used[places])]:
            if used[i] <= 1:
                break
            of_places[i] |= not (np.abs(node[of_places & (node >= 0)] - node[i]) < _MIN_ANCHORS_APART).any()
        return [np.where(c, 0.0, weight) for c in (of_places, worst)]
    fits = (weight == 0) & (excess <= 1) & (possible > 0)
    if not fits.any():
        return []
    best = np.arange(len(weight)) == np.where(fits, excess, np.inf).argmin()
    return [np.where(c, 1.0, weight) for c in (fits, best)]


def _innovations(
    problem: Problem,
    mean: FloatArray,
    weight: FloatArray,
    rows: Sequence[Rows],
    joint_cov: FloatArray,
    with_error_cov: FloatArray,
) -> FloatArray:
    """Return the normalised innovation squared of each observation, predicted from all other observations.

    It has a chi-square distribution with the dimension of the observation if the observation is correct. Let r be the
    whitened residual, H its derivative by the unknowns, P their covariance and L = H P H' the leverage. The result is
    then r' (I - L)^-1 r if the observation is used, and r' (I + L)^-1 r if it is not. This is the change of the least
    sum of squares due to the observation. `with_error_cov` (E, 10, 10) is the joint covariance of the anchor and the
    error of each correlated fix.
    """
    positions, directions, states = problem.positions, problem.directions, problem.states
    n_positions, nis = len(positions), np.zeros(len(weight))
    residual, by_node, by_other = position_residuals(problem.positions, problem.errors, mean, mean[problem.n_nodes :])
    own_cov = np.concatenate([joint_cov[:, :N_STATES, :N_STATES], joint_cov[-1:, N_STATES:, N_STATES:]])

    def set_nis(at: IntArray, r: FloatArray, H: FloatArray, cov: FloatArray) -> None:
        nis[at] = _normalised_squares(r, H @ cov @ H.swapaxes(-1, -2), weight[at] > 0)

    correlated = problem.errors.position
    of_map = np.setdiff1d(np.flatnonzero(positions.other < 0), correlated)
    set_nis(of_map, residual[of_map], by_node[of_map], own_cov[positions.node[of_map]])
    by_both = np.concatenate([by_node[correlated], positions.whiten[correlated] @ problem.errors.by], axis=2)
    set_nis(correlated, residual[correlated], by_both, with_error_cov)
    residual_of_states, by_state = state_residuals(states, mean)
    at_states = n_positions + len(directions) + np.arange(len(states))
    set_nis(at_states, residual_of_states, by_state, own_cov[states.node])
    first_measured = n_positions + len(directions) + len(states)
    for k, (r, H) in enumerate(measurement_residuals(problem.measurements, mean)):
        set_nis(np.array([first_measured + k]), r[None], H[None], own_cov[problem.measurements.node[[k]]])
    pairs = [
        (i, positions.node[i], positions.other[i], residual[i], by_node[i], by_other[i])
        for i in np.flatnonzero(positions.other >= 0)
    ]
    turn, by_last = direction_residuals(directions, mean)
    ends = zip(directions.last, directions.first, turn, by_last, -by_last, strict=True)
    pairs += [(n_positions + i, *blocks) for i, blocks in enumerate(ends)]
    if pairs:
        tree = eliminate(rows)
        for i, a, b, r, A, B in pairs:
            keys, by_keys = ([int(a)], A + B) if a == b else ([int(a), int(b)], np.hstack([A, B]))
            leverage = by_keys @ cov_of(tree, keys) @ by_keys.T
            nis[i] = _normalised_squares(r[None], leverage[None], weight[i : i + 1] > 0)[0]
    return np.maximum(nis, 0.0)


def _normalised_squares(residual: FloatArray, leverage: FloatArray, is_used: BoolArray) -> FloatArray:
    """Return the normalised squares of residuals r (F, m), with leverages L (F, m, m).

    They are r' (I - L)^-1 r for used and r' (I + L)^-1 r for unused observations (see `_innovations`).
    """
    # without any other information I - L is zero up to rounding, and the small term keeps it regular
    eye = (1 + 1e-12) * np.eye(residual.shape[1])
    S = eye + np.where(is_used, -1.0, 1.0)[:, None, None] * leverage
    return np.einsum("fa,fa->f", residual, np.linalg.solve(S, residual[:, :, None])[:, :, 0])


def _solved(graph: gtsam.GaussianFactorGraph, problem: Problem) -> tuple[FloatArray, float]:
    """Return the least-squares solution of a graph: anchors and errors (N, 6), and the rotation of the frame in rad.

    Anchors use four of the six columns. In the relaxed problem the rotation is a vector, and the result is its
    direction. The rotation is zero without observed heading offsets.
    """
    solution = graph.optimize(gtsam.EliminateQR)
    n, state = problem.n_nodes, np.zeros((problem.n_states, N_ERRORS))
    state[:n, :N_STATES] = [solution.at(j) for j in range(n)]
    state[n:] = np.array([solution.at(j) for j in range(n, problem.n_states)]).reshape(-1, N_ERRORS)
    if len(problem.offsets) == 0:
        return state, 0.0
    turn = solution.at(problem.n_states)
    return state, float(turn[0]) if len(turn) == 1 else float(np.arctan2(turn[1], turn[0]))


def linear_equations(problem: Problem, mean: FloatArray, frame_rad: float, weight: FloatArray) -> list[Rows]:
    """Return the equations for the change of the states (N, 6) of anchors and errors, linearised at these states.

    They are the prior of the start, the steps between anchors, and all observations with their weights. `frame_rad` is
    the rotation from the frame of the observed heading offsets to the frame of the positions.
    """
    start_whiten = read_only(np.linalg.inv(np.linalg.cholesky(problem.start_cov)))
    rows = [Rows.of_one(0, start_whiten, -(start_whiten @ (mean[0, :N_STATES] - problem.start_mean)))]

    n = problem.n_nodes - 1
    start, end = mean[:n, :N_STATES], mean[1 : n + 1, :N_STATES]
    ahead, F = problem.intervals.ends_from(start)
    whiten = problem.intervals.whiten @ np.linalg.inv(state_transform(start))
    residual = np.einsum("nab,nb->na", whiten, end - ahead)
    rows.append(Rows(np.arange(n), -whiten @ F, -residual, np.arange(1, n + 1), whiten))
    rows += _error_rows(problem, mean)

    directions, states, measured, offsets = problem.directions, problem.states, problem.measurements, problem.offsets
    of_positions, of_directions, of_states, of_measured = problem.split(weight)
    residual, H, H_other = position_residuals(problem.positions, problem.errors, mean, mean[problem.n_nodes :])
    rows += _position_rows(problem, H, -residual, H_other, of_positions)
    residual, by_last = direction_residuals(directions, mean)
    rows.append(Rows(directions.last, by_last, -residual, directions.first, -by_last, of_directions))
    if len(states):
        residual, by_state = state_residuals(states, mean)
        rows.append(Rows.of_single(states.node, by_state, -residual, of_states))
    for k, (residual, by_anchor) in enumerate(measurement_residuals(measured, mean)):
        rows.append(Rows.of_single(measured.node[[k]], by_anchor[None], -residual[None], of_measured[[k]]))
    if len(offsets):
        inverse = 1 / offsets.std_rad
        residual = wrap_angle(mean[offsets.node, HEADING_OFFSET] - frame_rad - offsets.offset_rad) * inverse
        by_state = np.zeros((len(offsets), 1, N_STATES))
        by_state[:, 0, HEADING_OFFSET] = inverse
        key = problem.n_states
        keys = np.full(len(offsets), key)
        rows.append(Rows(offsets.node, by_state, -residual[:, None], keys, -inverse[:, None, None]))
        prior = np.array([[1 / problem.frame_std_rad]])
        rows.append(Rows.of_one(key, prior, -prior[0] * frame_rad))
    return rows


def _error_rows(problem: Problem, mean: FloatArray) -> list[Rows]:
    """Return the equations of the errors e_k of correlated fixes, which are a first-order Gauss-Markov process.

    e_0 ~ N(0, I) and e_k = a e_(k-1) + w with var w = 1 - a^2, where a is the correlation of consecutive errors.
    """
    n, decay = problem.n_nodes, problem.errors.decay
    if len(problem.errors) == 0:
        return []
    error, keys = mean[n:], np.arange(n, n + len(decay))
    inverse = 1 / np.sqrt(1 - decay**2)
    W = inverse[:, :, None] * np.eye(N_ERRORS)
    residual = inverse * (error[1:] - decay * error[:-1])
    return [
        Rows.of_one(n, np.eye(N_ERRORS), -error[0]),
        Rows(keys, -W * decay[:, :, None], -residual, keys + 1, W),
    ]


def state_residuals(states: ObservedStates, mean: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the whitened error of each measured state (S, 1), with wrapped angles, and its derivative (S, 1, 4)."""
    error = mean[states.node, states.state] - states.value
    error = np.where(states.state == HEADING_OFFSET, wrap_angle(error), error)
    H = np.zeros((len(states), 1, N_STATES))
    H[np.arange(len(states)), 0, states.state] = 1 / states.std
    return (error / states.std)[:, None], H


def point_positions(mean: FloatArray, node: IntArray, ahead_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the positions (n, 2) of points of a walk, and their derivatives (n, 2, 4) by the states of their anchors.

    `mean` (N, 4) are the states of N anchors, `node` (n,) is the anchor of each point, and `ahead_m` (n, 2) the
    displacement from the anchor to the point, before heading offset and scale.
    """
    at = mean[node, :N_STATES]
    moved = np.einsum("nab,nb->na", scaled_rotation(at[:, HEADING_OFFSET], at[:, LOG_SCALE]), ahead_m)
    H = np.zeros((len(node), 2, N_STATES))
    H[:, :, _POSITION] = np.eye(2)
    H[:, :, HEADING_OFFSET], H[:, :, LOG_SCALE] = moved @ TURN.T, moved
    return at[:, :2] + moved, H


def position_residuals(
    positions: ObservedPositions, errors: Errors, mean: FloatArray, error_mean: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the whitened residuals (F, 2) of F observed positions, and their derivatives (F, 2, 4) by both anchors.

    The residual is p + e^s R(theta) d + B e - G x_other - z. (p, theta, s) are position, heading offset and log scale
    at the anchor, and d is the displacement from the anchor to the time of the observation. B e is the correlated error
    of the fix, G x_other the position of the other anchor (loop closures only), and z the observed position, all in m.
    """
    relative, (at_m, H) = positions.other >= 0, point_positions(mean, positions.node, positions.ahead_m)
    origin = np.where(relative[:, None], mean[positions.other, :2], 0.0)
    error = at_m - origin - positions.position_m
    if len(errors):
        error[errors.position] += np.einsum("nab,nb->na", errors.by, error_mean)
    by_other = -(positions.whiten @ _OF_POSITION)
    return np.einsum("nab,nb->na", positions.whiten, error), positions.whiten @ H, by_other


def _position_rows(
    problem: Problem, H: FloatArray, rhs: FloatArray, by_other: FloatArray, weight: FloatArray
) -> list[Rows]:
    """Return the equations of positions, including the errors of correlated fixes."""
    positions, errors = problem.positions, problem.errors
    own = np.setdiff1d(np.arange(len(positions)), errors.position)
    rows = [Rows(positions.node[own], H[own], rhs[own], positions.other[own], by_other[own], weight[own])]
    if len(errors):
        shared, keys = errors.position, problem.n_nodes + np.arange(len(errors))
        by_error = positions.whiten[shared] @ errors.by
        rows.append(Rows(errors.node, H[shared], rhs[shared], keys, by_error, weight[shared]))
    return rows


def direction_residuals(directions: ObservedDirections, mean: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the whitened residuals (H, 1) of known directions, and their derivatives (H, 1, 4) by the last anchor.

    The derivatives by the first anchor have the opposite sign.
    """
    way = mean[directions.last, :2] - mean[directions.first, :2]
    square = np.maximum((way**2).sum(axis=1), (0.5 * directions.length_m) ** 2 + 1e-12)
    error = wrap_angle(np.arctan2(way[:, 0], way[:, 1]) - directions.heading_rad) / directions.std_rad
    H = np.zeros((len(directions), 1, N_STATES))
    H[:, 0, 0], H[:, 0, 1] = way[:, 1], -way[:, 0]
    return error[:, None], H / (square * directions.std_rad)[:, None, None]


def _relaxed(problem: Problem) -> list[Rows]:
    """Return the equations of the relaxed problem that do not depend on the weights of the observations.

    These are the priors, the motion between anchors, the errors of correlated fixes, and the heading offsets of the
    strides, which are never outliers. The unknowns of an anchor are its position p and z = e^s (cos theta, sin theta),
    with log scale s and heading offset theta. In these unknowns the problem is linear, with isotropic covariances, and
    needs no initial guess.
    """
    intervals, n = problem.intervals, len(problem.intervals)
    spread = min(problem.start_cov[HEADING_OFFSET, HEADING_OFFSET], MAX_HEADING_VARIANCE)
    spread += problem.start_cov[LOG_SCALE, LOG_SCALE]
    known = np.concatenate([problem.start_mean[_POSITION], _vector(problem.start_mean)])
    inverse = 1 / np.sqrt([problem.start_cov[0, 0], problem.start_cov[1, 1], spread, spread])
    rows = [Rows.of_one(0, np.diag(inverse), inverse * known)]

    variance = np.empty((n, N_STATES))
    variance[:, :2] = 0.5 * (intervals.total_cov[:, 0, 0] + intervals.total_cov[:, 1, 1])[:, None]
    drift = intervals.total_cov[:, HEADING_OFFSET, HEADING_OFFSET] + intervals.total_cov[:, LOG_SCALE, LOG_SCALE]
    variance[:, 2:] = drift[:, None]
    W = 1 / np.sqrt(variance)
    A = np.broadcast_to(np.eye(N_STATES), (n, N_STATES, N_STATES)).copy()
    A[:, :2, 2:] = _rotation_matrix_of(intervals.total_m)
    B = W[:, :, None] * np.eye(N_STATES)
    rows.append(Rows(np.arange(n), -W[:, :, None] * A, np.zeros((n, N_STATES)), np.arange(1, n + 1), B))
    rows += _error_rows(problem, np.zeros((problem.n_states, N_ERRORS)))
    if len(problem.offsets):
        rows += _relaxed_offsets(problem.offsets, problem.n_states, problem.frame_std_rad)
    return rows


def _relaxed_observations(problem: Problem, weight: FloatArray) -> list[Rows]:
    """Return the relaxed equations of observed positions, directions and heading offsets, with their weights.

    A measured log scale alone determines no vector, so that its equation has weight zero.
    """
    directions, states = problem.directions, problem.states
    of_positions, of_directions, of_states, _ = problem.split(weight)
    H, H_other, target = _relaxed_positions(problem)
    by_last, turn = _relaxed_directions(directions)
    by_state, vector = _relaxed_states(states)
    return [
        *_position_rows(problem, H, target, H_other, of_positions),
        Rows(directions.last, by_last, turn, directions.first, -by_last, of_directions),
        Rows.of_single(states.node, by_state, vector, of_states),
    ]


def _relaxed_squared_residuals(problem: Problem, state: FloatArray) -> FloatArray:
    """Return the squared whitened residuals (F + H + S,) of all observations in the relaxed problem.

    There are F positions, H directions and S states. The unknowns `state` (N, 6) of the anchors are the position p and
    z = e^s (cos theta, sin theta), with heading offset theta and log scale s.
    """
    positions, directions, errors = problem.positions, problem.directions, problem.errors
    by_errors = np.einsum("nab,nb->na", positions.whiten[errors.position] @ errors.by, state[problem.n_nodes :])
    state = state[: problem.n_nodes, :N_STATES]
    H, H_other, target = _relaxed_positions(problem)
    other = np.where((positions.other >= 0)[:, None], state[positions.other], 0.0)
    residual = np.einsum("nab,nb->na", H, state[positions.node]) + np.einsum("nab,nb->na", H_other, other)
    residual -= target
    residual[errors.position] += by_errors
    by_last, target = _relaxed_directions(directions)
    turn = np.einsum("nab,nb->na", by_last, state[directions.last] - state[directions.first]) - target
    by_state, target = _relaxed_states(problem.states)
    of_states = np.einsum("nab,nb->na", by_state, state[problem.states.node]) - target
    return np.concatenate([np.square(r).sum(axis=1) for r in (residual, turn, of_states)])


def _rotation_matrix_of(sum_m: FloatArray) -> FloatArray:
    """Return the matrices M(D) (n, 2, 2) of displacements D (n, 2), for which M(D) z is D rotated and scaled by z.

    z = e^s (cos theta, sin theta) has the heading offset theta and the log scale s.
    """
    east, north = sum_m[:, 0], sum_m[:, 1]
    return np.stack([np.stack([east, north], axis=-1), np.stack([north, -east], axis=-1)], axis=-2)


def _relaxed_positions(problem: Problem) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the derivatives (F, 2, 4) of F observed positions by their anchors, and by the other anchors of closures.

    They are followed by the targets (F, 2), the observed positions. All are whitened. The problem is relaxed: its
    unknowns are those of `_relaxed_squared_residuals`, in which it is linear.
    """
    positions = problem.positions
    H = np.zeros((len(positions), 2, N_STATES))
    H[:, :, _POSITION] = np.eye(2)
    H[:, :, 2:] = _rotation_matrix_of(positions.ahead_m)
    target = np.einsum("nab,nb->na", positions.whiten, positions.position_m)
    return positions.whiten @ H, -(positions.whiten @ _OF_POSITION), target


def _vector(state: FloatArray) -> FloatArray:
    """Return the vector e^s (cos theta, sin theta) of a state (4,), with log scale s and heading offset theta."""
    theta, s = state[HEADING_OFFSET], state[LOG_SCALE]
    return np.exp(s) * np.array([np.cos(theta), np.sin(theta)])


def _relaxed_directions(directions: ObservedDirections) -> tuple[FloatArray, FloatArray]:
    """Return the relaxed equations of directions: derivatives (H, 2, 4) by the last anchor, and targets (H, 2).

    The displacement between two anchors equals the known direction times the dead-reckoned length, with a relative
    standard deviation of a tenth or more.
    """
    inverse = 1 / (np.maximum(directions.std_rad, 0.1) * np.maximum(directions.length_m, MIN_HEADING_LENGTH_M))
    H = np.zeros((len(directions), 2, N_STATES))
    H[:, 0, 0], H[:, 1, 1] = inverse, inverse
    way = np.column_stack([np.sin(directions.heading_rad), np.cos(directions.heading_rad)])
    return H, way * (directions.length_m * inverse)[:, None]


def _relaxed_states(states: ObservedStates) -> tuple[FloatArray, FloatArray]:
    """Return the relaxed equations of measured states: derivatives (S, 2, 4) by the anchor, and targets (S, 2).

    A heading offset is a unit vector with a standard deviation of a tenth or more. A log scale has weight zero.
    """
    inverse = np.where(states.state == HEADING_OFFSET, 1 / np.maximum(states.std, 0.1), 0.0)
    H = np.zeros((len(states), 2, N_STATES))
    H[:, 0, 2], H[:, 1, 3] = inverse, inverse
    return H, np.column_stack([np.cos(states.value), np.sin(states.value)]) * inverse[:, None]


def _relaxed_offsets(offsets: ObservedOffsets, key: int, frame_std_rad: float) -> list[Rows]:
    """Return the equations of observed heading offsets in the relaxed (linear) problem, and the prior of the rotation.

    The unknowns are z = e^s (cos theta, sin theta) of each anchor, with log scale s and heading offset theta, and
    r = (cos angle, sin angle) of the rotation of the frame. The equation is z = R(offset) r, with R(offset) the
    rotation matrix of the observed offset. `key` is the number of the unknown r in the equations. The prior of r is
    (1, 0) with standard deviation `frame_std_rad`.
    """
    inverse = 1 / np.minimum(offsets.std_rad, np.sqrt(MAX_HEADING_VARIANCE))
    by_state = np.zeros((len(offsets), 2, N_STATES))
    by_state[:, 0, 2], by_state[:, 1, 3] = inverse, inverse
    c, s = np.cos(offsets.offset_rad) * inverse, np.sin(offsets.offset_rad) * inverse
    by_frame = -np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)
    prior = np.eye(2) / frame_std_rad
    measured = Rows(offsets.node, by_state, np.zeros((len(offsets), 2)), np.full(len(offsets), key), by_frame)
    return [measured, Rows.of_one(key, prior, prior[:, 0])]
