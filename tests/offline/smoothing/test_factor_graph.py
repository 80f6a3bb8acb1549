"""Factors of whole walks for GTSAM: derivatives, a dense oracle, and the consistency of estimated parameters."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy.optimize import least_squares

from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, LOG_SCALE
from pdr_filter.offline.smoothing.factor_graph import PersonKeys, WalkGraph, bayes_tree, least_squares_values
from pdr_filter.offline.smoothing.linear_graph import cov_of
from pdr_filter.offline.smoothing.observations import KnownHeading, LoopClosure, Observations
from pdr_filter.offline.smoothing.problem import Measurements, ObservedOffsets, ObservedStates, Problem, pose_problem
from pdr_filter.offline.smoothing.solve import Solution, solve
from pdr_filter.values import PositionFix, RangeFix
from tests.simulated_steps import STEP_S, Walk, simulated_walk

K = PersonKeys(gtsam.symbol("k", 0), gtsam.symbol("p", 0), np.array([0]))
K_ONLY = PersonKeys(gtsam.symbol("k", 0), gtsam.symbol("p", 0), np.zeros(0, dtype=np.int64))
START_COV = np.diag(np.square([1000.0, 1000.0, np.pi / np.sqrt(3), 0.025]))


def graph_of_walk(
    walk: Walk, problem: Problem, *, rate_std_radps: float = 0.0, person: PersonKeys = K_ONLY
) -> WalkGraph:
    """The walk with a single parameter, the factor of all step lengths, linearised at one."""
    by_theta = walk.steps.displacement_m[:, :, None]
    device_rad = np.linspace(0.0, 2.0, problem.n_nodes)
    return WalkGraph(problem, device_rad, walk.steps.time_s, 0.0, rate_std_radps, by_theta, np.ones(1), person)


def estimated(graph: WalkGraph, found: Solution, prior_std: float) -> tuple[float, float]:
    """The parameter and its variance."""
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    sigma = gtsam.noiseModel.Isotropic.Sigma(1, prior_std)
    factors.push_back(gtsam.PriorFactorVector(K.population, np.ones(1), sigma))
    values.insert(K.population, np.ones(1))
    graph.add_to(factors, found.weight)
    graph.insert_into(values, found)
    values = least_squares_values(factors, values)
    return float(values.atVector(K.population)[0]), float(cov_of(bayes_tree(factors, values), [K.population])[0, 0])


def numeric(factor: gtsam.NonlinearFactor, values: gtsam.Values, key: int, size: int) -> np.ndarray:
    """Derivative of the residuals of a factor by an unknown, by central differences."""
    columns = []
    for step in 1e-5 * np.eye(size):
        moved = []
        for sign in (1.0, -1.0):
            delta = gtsam.VectorValues()
            delta.insert(key, sign * step)
            moved.append(-factor.linearize(values.retract(delta)).jacobian()[1])
        columns.append((moved[0] - moved[1]) / 2e-5)
    return np.column_stack(columns)


def test_the_derivatives_of_all_factors_equal_finite_differences() -> None:
    rng = np.random.default_rng(2)
    walk = simulated_walk(60, rng, any_rotation=True, jumps=1, scale_memory=0.999)
    steps = replace(walk.steps, unknown_var_rad2=np.where(np.arange(60) == 20, 0.3, 0.0))
    places = [
        PositionFix(t, rng.normal(0, 5, 2), np.eye(2), correlation_s=c) for t, c in ((3.1, 0), (8.2, 30), (20.3, 30))
    ]
    measured = RangeFix(12.2, (40.0, 30.0), 50.0, 1.0)
    problem = pose_problem(
        steps,
        np.zeros(4),
        START_COV,
        Observations(tuple(places), (LoopClosure(2.0, 27.1),), (KnownHeading(5.0, 14.0, 0.4),)),
        ObservedOffsets(np.array([0, 30]), np.array([0.0, 0.3]), np.array([0.2, 0.3])),
        anchor_interval_s=3.0,
        states=ObservedStates(
            np.array([10, 25]), np.array([HEADING_OFFSET, LOG_SCALE]), np.array([0.3, 0.1]), np.ones(2)
        ),
        measurements=Measurements((measured,), np.zeros(60), np.array([[3.0, 4.0]])),
    )
    graph = graph_of_walk(walk, problem, rate_std_radps=0.01, person=K)
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    n = len(problem.positions) + len(problem.directions) + len(problem.states) + len(problem.measurements)
    graph.add_to(factors, np.ones(n))
    mean = rng.normal(scale=[5.0, 5.0, 1.0, 0.1], size=(problem.n_nodes, 4))
    states = rng.normal(size=(problem.n_states, 6))
    graph.insert_into(values, Solution(mean, np.zeros(0), 0.2, np.zeros(n), np.ones(n), True, states))
    values.update(graph.rate, np.array([0.02]))
    values.insert(K.population, np.array([1.2]))
    values.insert(K.person, np.array([0.9]))
    for i in range(factors.size()):
        linear, first = factors.at(i).linearize(values), 0
        by_all, _ = linear.jacobian()
        for key in list(linear.keys()):
            size = 3 if gtsam.Symbol(key).chr() == ord("x") else values.atVector(key).size
            analytic = by_all[:, first : first + size]
            np.testing.assert_allclose(
                analytic, numeric(factors.at(i), values, key, size), atol=1e-5 * (1 + np.abs(by_all).max())
            )
            first += size


def test_parameter_and_variance_equal_those_of_dense_least_squares_over_all_steps() -> None:
    rng = np.random.default_rng(4)
    walk = simulated_walk(30, rng, any_rotation=True)
    fixes = walk.fixes(9, 0.4, rng)
    observed = Observations(tuple(fixes), (LoopClosure(STEP_S * 2, STEP_S * 28, 3.0),))
    problem = pose_problem(walk.steps, np.zeros(4), START_COV, observed, anchor_interval_s=0.1)
    graph = graph_of_walk(walk, problem)
    found = replace(solve(problem), weight=np.ones(len(fixes) + 1))
    k, var = estimated(graph, found, 0.2)

    steps, n = walk.steps, 30
    roots = np.linalg.inv(np.linalg.cholesky(problem.intervals.total_cov))

    def residuals(unknown: np.ndarray) -> np.ndarray:
        factor, states = unknown[0], unknown[1:].reshape(n + 1, 4)
        result = [(factor - 1.0) / 0.2, *(states[0] / np.sqrt(np.diag(START_COV)))]
        for i in range(n):
            (e, north, o, s), b = states[i], states[i + 1]
            c, w = np.cos(o), np.sin(o)
            way = np.array([[c, -w], [w, c]]) @ (b[:2] - np.array([e, north]))
            apart = np.array([*(way - factor * np.exp(s) * steps.displacement_m[i]), b[2] - o, b[3] - s])
            result += (roots[i] @ apart).tolist()
        for fix in fixes:
            result += ((states[round(fix.time_s / STEP_S), :2] - fix.position_m) / 0.4).tolist()
        return np.array([*result, *((states[28, :2] - states[2, :2]) / 3.0)])

    start = np.concatenate([[1.0], found.mean.ravel()])
    dense = least_squares(residuals, start, x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert k == pytest.approx(dense.x[0], abs=1e-5)
    assert var == pytest.approx(np.linalg.inv(dense.jac.T @ dense.jac)[0, 0], rel=1e-3)


def test_two_fixes_and_a_loop_closure_estimate_the_step_length_of_people_within_its_variance() -> None:
    rng, nees = np.random.default_rng(8), []
    for _ in range(50):
        factor = float(np.exp(rng.normal(scale=0.15)))  # wider than the prior of a calibration, 12 %
        walk = simulated_walk(120, rng, any_rotation=True, log_scale_std=0.025, loop=True)
        of_average = replace(walk.steps, displacement_m=walk.steps.displacement_m / factor)
        observed = Observations(tuple(walk.fixes(40, 0.2, rng)[:2]), (LoopClosure(0.0, STEP_S * 120),))
        problem = pose_problem(of_average, np.zeros(4), START_COV, observed, anchor_interval_s=5.0)
        wide = START_COV.copy()
        wide[LOG_SCALE, LOG_SCALE] = 0.15**2
        found = solve(replace(problem, start_cov=wide))
        k, var = estimated(graph_of_walk(replace(walk, steps=of_average), problem), found, 0.3)
        nees.append((k - factor) ** 2 / var)
    assert 28.0 < sum(nees) < 79.5  # 99 % of chi-square with 50 degrees of freedom
