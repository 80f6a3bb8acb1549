"""The smoother agrees with a reference in which every step is a state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_steps import simulated_walk

import pdr_filter as pdr
from pdr_filter.offline.smoothing.observations import Observations
from pdr_filter.offline.smoothing.preintegration import step_states
from pdr_filter.offline.smoothing.problem import pose_problem, start_covariance
from pdr_filter.offline.smoothing.solve import solve
from tests.oracles.batch_smoother import smooth_every_step

NOISE = pdr.recipes.default().model.noise


@pytest.mark.parametrize(
    ("drift", "anchor_interval_s", "atol"),
    [(NOISE.log_scale_drift_per_sqrt_step, 0.01, 1e-6), (0.01, 0.01, 1e-6), (0.01, 2.0, 0.005)],
)
def test_the_smoother_agrees_with_a_batch_solution_over_all_steps(
    drift: float, anchor_interval_s: float, atol: float
) -> None:
    """With an anchor at every step to a micrometre, and with anchors every 2 s to half a centimetre."""
    noise = replace(NOISE, log_scale_drift_per_sqrt_step=drift)
    rng = np.random.default_rng(4)
    walk = simulated_walk(40, rng, log_scale_std=noise.log_scale_std, scale_memory=noise.log_scale_memory)
    steps = replace(walk.steps, scale_drift_var=np.full(40, noise.log_scale_drift_var))
    fixes = walk.fixes(8, 0.5, rng)
    start_cov = start_covariance(1.0, 0.15, noise.log_scale_std**2)
    problem = pose_problem(
        steps, np.zeros(4), start_cov, Observations(tuple(fixes)), anchor_interval_s=anchor_interval_s
    )
    found = solve(problem)
    assert (found.weight == 1).all()
    mean, _ = step_states(problem.intervals, found.mean, found.joint_cov)
    numbers = [int(np.searchsorted(steps.time_s, f.time_s - 1e-6)) + 1 for f in fixes]
    expected = smooth_every_step(steps, np.zeros(4), start_cov, list(zip(numbers, fixes, strict=True)))
    np.testing.assert_allclose(mean[:, :2], expected[1:, :2], atol=atol)
    np.testing.assert_allclose(mean[:, 3], expected[1:, 3], atol=atol)


@pytest.mark.parametrize("drift", [0.001, 0.01])
def test_without_fixes_the_scale_is_as_uncertain_as_between_people(drift: float) -> None:
    """The filter has the same standard deviation after any number of steps."""
    walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=60.0)], seed=1)
    config = pdr.recipes.default(walk.subject)
    noise = replace(config.model.noise, log_scale_drift_per_sqrt_step=drift)
    found = pdr.smooth(walk, config=config.with_model(noise=noise))
    np.testing.assert_allclose(found.log_scale_std, noise.log_scale_std, rtol=1e-6)
