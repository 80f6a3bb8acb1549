"""All walks of a group in one least-squares problem, solved by GTSAM, with covariances.

Each walk is the problem that `pdr_filter.smooth` solves for it, with position, heading offset and step scale at every
knot. Pairs of similar scans and known fixes are added between the walks. The pairs have a Cauchy loss, whose weights
are recomputed at every iteration, and the rigid poses of `placing` are the initial guess.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, LOG_SCALE, N_STATES
from pdr_filter.offline.smoothing.linear_graph import Rows, cov_of, eliminated, graph_of
from pdr_filter.offline.smoothing.preintegration import TURN, scaled_rotation, step_states
from pdr_filter.offline.smoothing.solve import linearised
from pdr_filter.values import FloatArray, HeadingFix, IntArray, PositionFix, wrap_angle
from pdr_filter.walk_map.placing import Pairs, PlacedGroup, ScannedWalks, pairs_of, residuals, turned

Known = PositionFix | HeadingFix
# Factor on the standard deviations of the ranges, so that the covariances are valid, because the scans of one place
# share the errors of the walls around them. Chosen on storey F1 of `ms_indoor`.
INFLATION = 3.0
# Definition of a frame without fixes: the start of its first walk.
_ORIGIN_STD_M, _ORIGIN_STD_RAD = 0.01, 0.001
_ITERATIONS = 15


@dataclass(frozen=True, slots=True, eq=False)
class States:
    """Solved states of one walk with N knots."""

    mean: FloatArray  # (N, 4)
    frame_rad: float  # rotation of the frame of the heading offsets
    joint_cov: FloatArray  # (N - 1, 8, 8) covariance of both ends of each interval


def solve_group(
    walks: ScannedWalks,
    group: PlacedGroup,
    known: Mapping[int, Sequence[Known]],
    fixed: Mapping[int, States] | None = None,
) -> dict[int, States]:
    """Return the solved states of the walks of a group, by the index of the walk.

    Walks in `fixed` keep their states. `known` has the fixes of each walk. The rigid poses of the group are the initial
    guess.
    """
    fixed = fixed or {}
    free = [i for i in group.poses if i not in fixed]
    if not free:
        return dict(fixed)
    chains = walks.chains
    # keys of a walk: its knots, then the rotation of the frame of its heading offsets
    base = dict(zip(free, np.cumsum([0, *(chains[i].n_knots + 1 for i in free)]).tolist(), strict=False))
    state = {i: (fixed[i].mean, fixed[i].frame_rad) for i in fixed}
    for i in free:
        pose, mean = group.poses[i], chains[i].mean.copy()
        mean[:, :2] = mean[:, :2] @ turned(pose.turn_rad) + pose.shift_m
        mean[:, HEADING_OFFSET] += pose.turn_rad
        state[i] = mean, chains[i].frame_rad + pose.turn_rad
    pairs = pairs_of(walks, group, free)
    points = {
        i: chains[i].node_of(chains[i].scans.step) for i in {*walks.owner[pairs.first], *walks.owner[pairs.second]}
    }
    rows: list[Rows] = []
    for _ in range(_ITERATIONS):
        rows = []
        for i in free:
            problem = chains[i].problem
            own = linearised(problem, *state[i], np.ones(len(problem.states)))
            rows += [replace(r, a=r.a + base[i], b=np.where(r.b >= 0, r.b + base[i], -1)) for r in own]
            rows += _known_rows(walks, i, state[i][0], known.get(i, ()), base[i])
        rows += _origin_rows(walks, group, free, base, state, known, bool(fixed))
        rows += _range_rows(walks, pairs, points, state, base)
        solution = graph_of(rows).optimize(gtsam.EliminateQR)
        largest = 0.0
        for i in free:
            n, (mean, frame_rad) = chains[i].n_knots, state[i]
            change = np.array([solution.at(base[i] + k) for k in range(n)])
            turn = float(solution.at(base[i] + n)[0]) if len(chains[i].problem.offsets) else 0.0
            largest = max(largest, float(np.abs(change[:, :2]).max()))
            limit = 0.5 / max(float(np.abs(change[:, 2:]).max()), abs(turn), 0.5)
            state[i] = mean + limit * change, frame_rad + limit * turn
        if largest < 0.01:
            break
    tree = eliminated(rows)
    found = dict(fixed)
    for i in free:
        keys = range(base[i], base[i] + chains[i].n_knots - 1)
        found[i] = States(*state[i], np.array([cov_of(tree, [k, k + 1]) for k in keys]))
    return found


def step_positions(walks: ScannedWalks, walk: int, states: States) -> tuple[FloatArray, FloatArray]:
    """Return the positions (K + 1, 2) of the start and all steps of a walk, and their covariances (K + 1, 2, 2)."""
    mean, cov = step_states(walks.chains[walk].problem.intervals, states.mean, states.joint_cov)
    return np.vstack([states.mean[:1, :2], mean[:, :2]]), np.concatenate([states.joint_cov[:1, :2, :2], cov[:, :2, :2]])


def _by_state(state: FloatArray, node: IntArray, ahead_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the positions (n, 2) of points of a walk, and their derivatives (n, 2, 4) by the states of their knots.

    `state` (N, 4) are the states of the N knots of the walk, and `node` (n,) the knot of each point. `ahead_m` (n, 2)
    is the displacement from the knot to the point, before heading offset and scale.
    """
    at = state[node]
    moved = np.einsum("nab,nb->na", scaled_rotation(at[:, HEADING_OFFSET], at[:, LOG_SCALE]), ahead_m)
    by_state = np.zeros((len(node), 2, N_STATES))
    by_state[:, 0, 0] = by_state[:, 1, 1] = 1.0
    by_state[:, :, HEADING_OFFSET], by_state[:, :, LOG_SCALE] = moved @ TURN.T, moved
    return at[:, :2] + moved, by_state


def _known_rows(walks: ScannedWalks, walk: int, state: FloatArray, known: Sequence[Known], base: int) -> list[Rows]:
    """Return the equations of the known positions and headings of a walk, linearised at its states.

    `base` is the key of the first knot of the walk.
    """
    chain, rows = walks.chains[walk], list[Rows]()
    for fix in known:
        step = chain.step_at(fix.time_s)
        (node,), ahead = chain.node_of(np.array([step]))
        if isinstance(fix, HeadingFix):
            device_rad = chain.device_rad[min(step, len(chain.device_rad) - 1)]
            error = wrap_angle(state[node, HEADING_OFFSET] + device_rad - fix.walking_heading_rad)
            by_state = np.zeros((1, N_STATES))
            by_state[0, HEADING_OFFSET] = 1.0 / fix.std_rad
            rows.append(Rows.of_one(base + int(node), by_state, -np.array([error / fix.std_rad])))
        else:
            (place,), (by_state,) = _by_state(state, np.array([node]), ahead)
            whiten = np.linalg.inv(np.linalg.cholesky(fix.cov_m2))
            rows.append(Rows.of_one(base + int(node), whiten @ by_state, -(whiten @ (place - fix.position_m))))
    return rows


def _origin_rows(
    walks: ScannedWalks,
    group: PlacedGroup,
    free: Sequence[int],
    base: Mapping[int, int],
    state: Mapping[int, tuple[FloatArray, float]],
    known: Mapping[int, Sequence[Known]],
    has_fixed: bool,
) -> list[Rows]:
    """Return the equations that define the frame of a group without fixes: the start and the direction of one walk.

    This walk is the first seed of the group. The list is empty if some walks are fixed. The start is left out if there
    is a known position. The direction is left out if there are two fixes, or if the magnetometer of a walk gives it.
    """
    fixes = [fix for i in free for fix in known.get(i, ())]
    seed, rows = next((i for i in free if i in group.seeds), free[0]), list[Rows]()
    if has_fixed:
        return rows
    if not any(isinstance(fix, PositionFix) for fix in fixes):
        start_m = group.poses[seed].of(walks.chains[seed].mean[:1, :2])[0]
        by_state = np.eye(2, N_STATES) / _ORIGIN_STD_M
        rows.append(Rows.of_one(base[seed], by_state, (start_m - state[seed][0][0, :2]) / _ORIGIN_STD_M))
    if len(fixes) < 2 and not any(walks.chains[i].knows_north for i in free):
        by_state = np.zeros((1, N_STATES))
        by_state[0, HEADING_OFFSET] = 1.0 / _ORIGIN_STD_RAD
        error = state[seed][0][0, HEADING_OFFSET] - group.poses[seed].turn_rad
        rows.append(Rows.of_one(base[seed], by_state, -np.array([error / _ORIGIN_STD_RAD])))
    return rows


def _range_rows(
    walks: ScannedWalks,
    pairs: Pairs,
    points: Mapping[int, tuple[IntArray, FloatArray]],
    state: Mapping[int, tuple[FloatArray, float]],
    base: Mapping[int, int],
) -> list[Rows]:
    """Return the equations of the ranges of pairs of scans. The position of a scan of a fixed walk is a constant.

    `points` has the knot of each scan and its displacement from it, by walk. `base` has the first key of each walk that
    is not fixed.
    """
    places: list[FloatArray] = []
    blocks: list[FloatArray] = []
    keys: list[IntArray] = []
    for scans in (pairs.first, pairs.second):
        place, by_state, key = np.zeros((len(scans), 2)), np.zeros((len(scans), 2, N_STATES)), np.full(len(scans), -1)
        owner = walks.owner[scans]
        for i in np.unique(owner).tolist():
            own = owner == i
            node, ahead = points[i]
            number = scans[own] - walks.first[i]
            place[own], by_state[own] = _by_state(state[i][0], node[number], ahead[number])
            if i in base:
                key[own] = base[i] + node[number]
        places, blocks, keys = [*places, place], [*blocks, by_state], [*keys, key]
    if not len(pairs.first):
        return []
    residual, unit, weight = residuals(pairs, places[0] - places[1])
    root = np.sqrt(weight) / INFLATION
    by_first, by_second = (np.einsum("na,nab->nb", root[:, None] * unit, block)[:, None, :] for block in blocks)
    rhs, both = (-root * residual)[:, None], keys[1] >= 0
    alone = np.full(int((~both).sum()), -1)
    return [
        Rows(keys[0][both], by_first[both], rhs[both], keys[1][both], -by_second[both]),
        Rows(keys[0][~both], by_first[~both], rhs[~both], alone, np.zeros((0, 0, 0))),
    ]
