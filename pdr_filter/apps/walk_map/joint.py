"""Solved states of the walks of a group, with covariances: walks deform between their knots to fit their scans.

Each walk is the problem that `pdr_filter.smooth` solves for it, with position, heading offset and step scale at every
knot. To this come the known fixes, and the likelihood of the fingerprints as a quadratic function of the positions of
the scans. The walks are solved in turn, each with the others fixed, because their rigid poses are already those of the
joint solution of `placing`. The uncertainty of the other walks is that of the joint rigid poses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pdr_filter.apps.walk_map.chains import Chain
from pdr_filter.apps.walk_map.walk_poses import (
    JoinedWalks,
    ScannedWalks,
    WalkPose,
    joint_poses,
    of_storeys,
    scans_around,
)
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, LOG_SCALE, N_STATES
from pdr_filter.offline.smoothing.linear_graph import graph_of
from pdr_filter.offline.smoothing.preintegration import step_states
from pdr_filter.offline.smoothing.problem import ObservedPositions, ObservedStates, Problem
from pdr_filter.offline.smoothing.solve import linear_equations, point_positions, solve
from pdr_filter.values import FloatArray, HeadingFix, PositionFix

Known = PositionFix | HeadingFix
# Definition of a frame without fixes: the start of its first walk.
_ORIGIN_STD_M, _ORIGIN_STD_RAD = 0.01, 0.001
# Factor on the variances from fingerprints. Without it the covariances are too small, because deviations of the signals
# last along a walk. Chosen on storey F1 of `ms_indoor`.
INFLATION = 4.0
# Sweeps over all walks, the change that ends them, and the share of each change that is made, because walks that meet
# move towards each other.
_MOST_SWEEPS, _CONVERGED_M, _SHARE = 12, 0.1, 0.6


@dataclass(frozen=True, slots=True, eq=False)
class States:
    """Solved states of one walk with N knots."""

    mean: FloatArray  # (N, 4)
    frame_rad: float  # rotation of the frame of the heading offsets
    joint_cov: FloatArray  # (N - 1, 8, 8) covariance of both ends of each interval


def solve_group(
    walks: ScannedWalks,
    group: JoinedWalks,
    known: Mapping[int, Sequence[Known]],
    fixed: Mapping[int, States] | None = None,
) -> dict[int, States]:
    """Return the solved states of the walks of a group, by the index of the walk.

    Walks in `fixed` keep their states. `known` has the fixes of each walk. The rigid poses are the initial guess.
    """
    fixed = fixed or {}
    free = [i for i in group.poses if i not in fixed]
    if not free:
        return dict(fixed)
    scans = scans_around(walks, group, free)
    rigid = joint_poses(walks, group, free, scans, weight=1.0 / INFLATION).information
    of_others = np.linalg.inv(rigid)
    state = {i: (fixed[i].mean, fixed[i].frame_rad) for i in fixed}
    for i in free:
        pose, mean = group.poses[i], walks.chains[i].mean.copy()
        mean[:, :2] = pose.of(mean[:, :2])
        mean[:, HEADING_OFFSET] += pose.turn_rad
        mean[:, LOG_SCALE] += np.log(pose.scale)
        state[i] = mean, walks.chains[i].frame_rad + pose.turn_rad
    owner = walks.owner[scans]
    own = {i: np.flatnonzero(owner == i) for i in np.unique(owner).tolist()}
    points = {i: walks.chains[i].node_of(walks.chains[i].scans.step[scans[k] - walks.first[i]]) for i, k in own.items()}
    floor = walks.floor[scans] + np.array([group.poses[i].floor for i in owner.tolist()])
    found = dict(fixed)
    for _ in range(_MOST_SWEEPS):
        largest_m, at_m = 0.0, np.zeros((len(scans), 2))
        for i, (node, ahead) in points.items():
            at_m[own[i]] = point_positions(state[i][0], node, ahead)[0]
        slope, information = np.zeros(2 * len(scans)), np.zeros((2 * len(scans), 2 * len(scans)))
        for here, _, of_scan, of_scans in of_storeys(walks, scans, at_m, floor):
            at = (2 * here[:, None] + (0, 1)).ravel()
            slope[at], information[np.ix_(at, at)] = of_scan, of_scans
        for k, i in enumerate(free):
            (mean, frame_rad), n = state[i], walks.chains[i].n_knots
            alone, right = _of_walk(walks, group, i, state[i], known.get(i, ()), is_origin=not fixed)
            by_scans = np.zeros_like(alone)
            if i in own:
                node, ahead = points[i]
                by_state = np.zeros((len(node), 2, len(right)))
                columns = N_STATES * node[:, None] + np.arange(N_STATES)
                np.put_along_axis(
                    by_state, columns[:, None, :].repeat(2, axis=1), point_positions(mean, node, ahead)[1], axis=2
                )
                by_state = by_state.reshape(-1, len(right))
                of_own = (2 * own[i][:, None] + (0, 1)).ravel()
                by_scans = by_state.T @ information[np.ix_(of_own, of_own)] @ by_state
                right += by_state.T @ slope[of_own]
            change = _SHARE * np.linalg.solve(alone + by_scans, right)
            of_knot, turn_rad = change[: N_STATES * n].reshape(n, N_STATES), float(change[N_STATES * n :].sum())
            limit = 0.5 / max(float(np.abs(of_knot[:, 2:]).max()), abs(turn_rad), 0.5)
            state[i] = mean + limit * of_knot, frame_rad + limit * turn_rad
            largest_m = max(largest_m, float(np.abs(of_knot[:, :2]).max()))
            cov = np.linalg.inv(alone + by_scans / INFLATION)[: N_STATES * n, : N_STATES * n]
            if i not in group.seeds:  # their known fixes, which the rigid poses do not have, bound their uncertainty
                pose, by_pose = slice(4 * k, 4 * k + 4), _by_pose(state[i][0], group.poses[i].shift_m)
                cov += by_pose @ (of_others[pose, pose] - np.linalg.inv(rigid[pose, pose])) @ by_pose.T
            ends = [slice(N_STATES * j, N_STATES * (j + 2)) for j in range(n - 1)]
            found[i] = States(*state[i], np.array([cov[end, end] for end in ends], dtype=np.float64))
        if largest_m < _CONVERGED_M:
            break
    return found


def _of_walk(
    walks: ScannedWalks,
    group: JoinedWalks,
    walk: int,
    state: tuple[FloatArray, float],
    known: Sequence[Known],
    *,
    is_origin: bool,
) -> tuple[FloatArray, FloatArray]:
    """Return the normal equations of a walk by its steps, its magnetometer and its known fixes.

    The unknowns are the changes of the states of its knots, then of the rotation of its frame, if it has one.
    `is_origin` is True if the first seed of the group defines the frame.
    """
    chain, (mean, frame_rad) = walks.chains[walk], state
    if is_origin and walk == next(iter(group.seeds)):
        known = [*known, *_origin(chain, group.seeds[walk], known)]
    problem = _with_known(chain, known, group.north_rad)
    weight = np.ones(len(problem.positions) + len(problem.states))
    return graph_of(linear_equations(problem, mean, frame_rad, weight)).hessian()


def _by_pose(mean: FloatArray, shift_m: FloatArray) -> FloatArray:
    """Return the derivatives (4 N, 4) of the states of N knots by rotation, east, north and log scale of the walk."""
    lever, by_pose = mean[:, :2] - shift_m, np.zeros((len(mean), N_STATES, 4))
    by_pose[:, 0, 0], by_pose[:, 1, 0] = lever[:, 1], -lever[:, 0]
    by_pose[:, 0, 1] = by_pose[:, 1, 2] = 1.0
    by_pose[:, :2, 3] = lever
    by_pose[:, HEADING_OFFSET, 0] = by_pose[:, LOG_SCALE, 3] = 1.0
    return by_pose.reshape(-1, 4)


def contradicting(chain: Chain, known: Sequence[Known], north: tuple[float, float]) -> list[Known]:
    """Return the known fixes of a walk that its steps, its magnetometer and its other fixes contradict.

    They are the outliers of the smoother (`solve`), and all positions if at most half of them agree. Headings that only
    the magnetometer contradicts are wrong as well, because it seldom errs by more than three standard deviations.
    `north` is the mean and the standard deviation of magnetic north in the frame of the fixes.
    """
    n_headings = sum(isinstance(fix, HeadingFix) for fix in known)
    used = solve(_with_known(chain, known, *north)).weight > 0
    of_places, of_north, of_headings = np.split(used, [len(known) - n_headings, len(used) - n_headings])
    if 2 * np.count_nonzero(of_places) <= len(of_places):
        of_places[:] = False
    # two positions give a direction as well
    if np.count_nonzero(of_headings) + (np.count_nonzero(of_places) > 1) <= np.count_nonzero(~of_north):
        of_headings[:] = False
    in_order = sorted(known, key=lambda fix: isinstance(fix, HeadingFix))
    return [f for f, is_used in zip(in_order, [*of_places, *of_headings], strict=True) if not is_used]


def step_positions(chain: Chain, states: States) -> tuple[FloatArray, FloatArray]:
    """Return the positions (K + 1, 2) of the start and all steps of a walk, and their covariances (K + 1, 2, 2)."""
    mean, cov = step_states(chain.problem.intervals, states.mean, states.joint_cov)
    return np.vstack([states.mean[:1, :2], mean[:, :2]]), np.concatenate([states.joint_cov[:1, :2, :2], cov[:, :2, :2]])


def _with_known(chain: Chain, known: Sequence[Known], north_rad: float, north_std_rad: float = 0.0) -> Problem:
    """Return the problem of a walk with known fixes, positions first, and magnetic north in their frame."""
    places = [f for f in known if isinstance(f, PositionFix)]
    headings = [f for f in known if isinstance(f, HeadingFix)]
    at, turned_at = ([chain.step_at(f.time_s) for f in fixes] for fixes in (places, headings))
    node, ahead_m = chain.node_of(np.array(at, dtype=np.int64))
    positions = ObservedPositions.on_map(node, ahead_m, [f.position_m for f in places], [f.cov_m2 for f in places])
    magnetic = chain.problem.states
    offsets = [f.walking_heading_rad - chain.device_rad_at(k) for f, k in zip(headings, turned_at, strict=True)]
    states = ObservedStates(
        node=np.concatenate([magnetic.node, chain.node_of(np.array(turned_at, dtype=np.int64))[0]]),
        state=np.concatenate([magnetic.state, np.full(len(headings), HEADING_OFFSET)]),
        value=np.concatenate([magnetic.value + north_rad * (magnetic.state == HEADING_OFFSET), offsets]),
        std=np.concatenate([np.hypot(magnetic.std, north_std_rad), [f.std_rad for f in headings]]),
    )
    return replace(chain.problem, positions=positions, states=states)


def _origin(chain: Chain, seed: WalkPose, known: Sequence[Known]) -> list[Known]:
    """Return the fixes by which a walk defines the frame of its group: its start and its direction, at its `seed`.

    The start is left out if there is a known position. The direction is left out if there are two fixes, or if the
    magnetometer gives it.
    """
    fixes, start_s = list[Known](), float(chain.time_s[0]) - 1.0 if len(chain.time_s) else 0.0
    if not any(isinstance(fix, PositionFix) for fix in known):
        fixes.append(PositionFix(start_s, seed.of(chain.mean[:1, :2])[0], _ORIGIN_STD_M**2 * np.eye(2)))
    if len(known) < 2 and not chain.knows_north:
        heading_rad = chain.device_rad[0] + chain.mean[0, HEADING_OFFSET] + seed.turn_rad
        fixes.append(HeadingFix(start_s, math.remainder(float(heading_rad), 2 * math.pi), _ORIGIN_STD_RAD))
    return fixes
