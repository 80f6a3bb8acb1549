"""Mode probabilities with the evidence of observations: exact enumeration, the smoother of one mode, whole walks."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest
from simulated_steps import simulated_walk
from true_positions import position_fixes, true_m

import pdr_filter as pdr
from pdr_filter.offline.smoothing.mode_evidence import Observed, SwitchingWalk, step_log_evidence, switching_walk
from pdr_filter.offline.smoothing.observations import LoopClosure, Observations
from pdr_filter.offline.smoothing.preintegration import ModeSteps, step_states
from pdr_filter.offline.smoothing.problem import ObservedOffsets, pose_problem
from pdr_filter.offline.smoothing.smooth import SmoothingMemory
from pdr_filter.offline.smoothing.solve import solve
from pdr_filter.values import PositionFix

PERSISTENT = np.array([[0.97, 0.01, 0.02], [0.01, 0.97, 0.02], [0.05, 0.05, 0.90]])
ANY = np.full((3, 3), 1.0 / 3.0)


def small_walk(transition_prob: np.ndarray, fixes: dict[int, float], rng: np.random.Generator) -> SwitchingWalk:
    """Five steps along a line in three modes of 0.7, 1.2 and 0.3 m; the state is the position and the log scale."""
    length_m, n = np.array([0.7, 1.2, 0.3]), 5
    by_state = np.tile(np.eye(2), (n, 3, 1, 1))
    by_state[..., 0, 1] = length_m
    noise_cov = np.tile(np.diag([0.05**2, 1e-8]), (n, 3, 1, 1))
    shift = np.zeros((n, 3, 2))
    shift[..., 0] = length_m
    # two rivals of one context for three steps, then another context
    evidence = np.where(np.arange(n)[:, None] < 3, [0.0, 0.0, -3.0], [-3.0, -3.0, 0.0]) + rng.normal(0, 0.1, (n, 3))
    observed = {k: [Observed(np.array([m]), np.array([[1.0, 0.0]]), np.array([[0.04]]))] for k, m in fixes.items()}
    start = np.array([0.4, 0.4, 0.2])
    return SwitchingWalk(
        np.zeros(2), np.diag([0.01, 0.08**2]), start, by_state, noise_cov, shift, evidence, transition_prob, observed
    )


def enumerated(walk: SwitchingWalk) -> np.ndarray:
    """Mode probabilities (K, M) of all sequences of modes, each with its joint Gaussian of all observations."""
    n, n_modes, size = walk.shift.shape
    at = sorted(walk.observed)
    z = np.concatenate([walk.observed[k][0].z for k in at])
    noise = np.diag([walk.observed[k][0].R[0, 0] for k in at])
    total = np.zeros((n, n_modes))
    first = walk.start_prob @ walk.transition_prob
    for path in product(range(n_modes), repeat=n):
        log_weight = np.log(first[path[0]]) + sum(walk.log_evidence[k, m] for k, m in enumerate(path))
        log_weight += sum(np.log(walk.transition_prob[i, j]) for i, j in pairwise(path))
        # the states after each step are an affine function of the start and the noises
        mean, by = [walk.start_mean], [np.hstack([np.eye(size), np.zeros((size, n * size))])]
        for k, m in enumerate(path):
            mean.append(walk.F[k, m] @ mean[-1] + walk.shift[k, m])
            by.append(walk.F[k, m] @ by[-1])
            by[-1][:, (k + 1) * size : (k + 2) * size] = np.eye(size)
        blocks = [walk.start_cov, *(walk.Q[k, m] for k, m in enumerate(path))]
        joint = np.zeros((len(blocks) * size, len(blocks) * size))
        for k, block in enumerate(blocks):
            joint[k * size : (k + 1) * size, k * size : (k + 1) * size] = block
        sees = np.vstack([walk.observed[k][0].H @ by[k] for k in at])
        expected = np.concatenate([walk.observed[k][0].H @ mean[k] for k in at])
        cov = sees @ joint @ sees.T + noise
        log_weight -= 0.5 * float((z - expected) @ np.linalg.solve(cov, z - expected) + np.linalg.slogdet(cov)[1])
        for k, m in enumerate(path):
            total[k, m] += np.exp(log_weight)
    return total / total.sum(axis=1, keepdims=True)


@pytest.mark.parametrize("transition_prob", [PERSISTENT, ANY], ids=["persistent", "any"])
def test_mode_probabilities_are_near_those_of_all_sequences_of_modes(transition_prob: np.ndarray) -> None:
    """A fix after another context tells the rivals before it apart, which only a backward pass over pairs shows."""
    rng = np.random.default_rng(1)
    for fixes in ({5: 2.8}, {5: 4.2}, {2: 1.4, 5: 2.7}):
        walk = small_walk(transition_prob, fixes, rng)
        exact, (found, *_), (blind, *_) = (
            enumerated(walk),
            walk.smoothed_modes(),
            replace(walk, observed={}).smoothed_modes(),
        )
        assert np.abs(found - exact).max() < 0.05
        assert np.abs(blind - exact).max() > 0.2


def test_a_walk_with_one_mode_has_the_states_of_the_smoother() -> None:
    """With correlated fixes, a loop closure at the start, and heading offsets in a frame of unknown rotation."""
    rng = np.random.default_rng(5)
    walk = simulated_walk(60, rng)
    fixes = [PositionFix(f.time_s, f.position_m, 9.0 * f.cov_m2, correlation_s=20.0) for f in walk.fixes(9, 1.0, rng)]
    loop = LoopClosure(float(walk.steps.time_s[0]) - 0.5, float(walk.steps.time_s[-1]), 30.0)
    nodes = np.arange(0, 60, 7)
    offsets = ObservedOffsets(nodes, rng.normal(0.0, 0.1, len(nodes)), np.full(len(nodes), 0.3))
    start_cov = np.diag([0.01, 0.01, 1.0, 0.0064])
    observed = Observations(tuple(fixes), (loop,))
    # with an anchor at every step, both have the same linearisation
    problem = pose_problem(walk.steps, np.zeros(4), start_cov, observed, offsets, 0.5, anchor_interval_s=0.01)
    found = solve(problem)
    expected, cov = step_states(problem.intervals, found.mean, found.joint_cov)
    n, one = len(walk.steps), np.ones((1, 1))
    moved_m = walk.steps.displacement_m[:, None]
    of_one = ModeSteps(moved_m, walk.steps.cov_m2[:, None], np.zeros_like(moved_m))
    system = switching_walk(walk.steps, of_one, problem, found, np.zeros((n, 1)), np.ones(1), one)
    _, error, error_cov = system.smoothed_modes()
    assert found.weight.all() and np.ptp(expected[:, 0]) > 10.0
    np.testing.assert_allclose(error[:, 0, :4], 0.0, atol=2e-3)
    variances = np.diagonal(error_cov[:, 0, :4, :4], axis1=1, axis2=2)
    np.testing.assert_allclose(variances, np.diagonal(cov, axis1=1, axis2=2), rtol=0.02)


def test_the_evidence_of_steps_gives_their_filtered_probabilities() -> None:
    rng = np.random.default_rng(2)
    evidence, filtered, prob = rng.normal(0, 2, (9, 3)), [], np.array([0.5, 0.5, 0.0])
    for each in evidence:
        prob = (prob @ PERSISTENT) * np.exp(each)
        prob /= prob.sum()
        filtered.append(prob)
    found = step_log_evidence(np.array(filtered), np.array([0.5, 0.5, 0.0]), PERSISTENT)
    np.testing.assert_allclose(found - found[:, :1], evidence - evidence[:, :1], atol=1e-9)


def test_fixes_tell_modes_of_one_context_apart_and_leave_equal_modes_as_they_are() -> None:
    """Rivals of walking: the same length under another name, and 1.2 m."""
    walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=30.0)], seed=3)
    config = pdr.recipes.default(walk.subject)
    walking = next(mode for mode in config.model.modes if mode.name == "walking")
    same = replace(walking, name="same")
    absurd = pdr.Mode("absurd", context="walking", step_length=pdr.known_length(1.2, 0.05))
    others = [mode for mode in config.model.modes if mode.name != "walking"]
    ends_s = np.linspace(3.0, walk.duration_s - 3.0, 4)
    fixes = position_fixes(ends_s, true_m(walk, ends_s), 0.5)
    rivals, memory = config.with_modes([*others, walking, same, absurd]), SmoothingMemory()
    before = pdr.smooth(walk, config=rivals, memory=memory).track.mode_prob.mean(axis=0)
    after = pdr.smooth(walk, fixes=fixes, config=rivals, memory=memory).track.mode_prob.mean(axis=0)
    assert before[-1] > 0.3 and after[-1] < 0.05
    assert after[-2] == pytest.approx(after[-3], abs=1e-6) and after[-2] > 0.45
