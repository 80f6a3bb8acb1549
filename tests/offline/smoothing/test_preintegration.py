"""Preintegrated intervals compared with the filter's recursion step by step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import a_step
from scipy.optimize import approx_fprime
from simulated_steps import simulated_walk

import pdr_filter as pdr
from pdr_filter.filter.chain.weighted_tracker import WeightedTracker
from pdr_filter.filter.imm.motion_model import (
    Mode,
    MotionNoise,
    grow_over_gap,
    stepless_var_m2,
)
from pdr_filter.filter.imm.step_cycle import advance, predict_heading
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.step_length.models import StaticStepLength, known_length
from pdr_filter.offline.smoothing.preintegration import increments, preintegrate, state_transform
from pdr_filter.offline.smoothing.problem import nearest_contact
from pdr_filter.values import Step, step_table

MEMORY = 0.99
WALK = simulated_walk(60, np.random.default_rng(1), scale_memory=MEMORY)
START = np.array([[3.0, -2.0, 0.8, 0.1]])


def test_the_sum_of_an_interval_equals_the_recursion_over_its_steps() -> None:
    """Mean and covariance agree with the filter's recursion P = F P F' + Q, in the frame of the interval's start."""
    steps = WALK.steps
    whole = preintegrate(steps, np.array([0, len(steps)]))
    position, state_cov = np.zeros(2), np.zeros((4, 4))
    for k in range(len(steps)):
        d = steps.displacement_m[k]
        by_state = np.eye(4)
        by_state[:2, 2], by_state[:2, 3], by_state[3, 3] = [d[1], -d[0]], d, MEMORY
        added_cov = np.zeros((4, 4))
        added_cov[:2, :2] = steps.cov_m2[k]
        added_cov[3, 3] = steps.scale_drift_var[k]
        state_cov[2, 2] += steps.drift_var_rad2[k] if k else 0.0
        position, state_cov = position + d, by_state @ state_cov @ by_state.T + added_cov
        np.testing.assert_allclose(whole.sum_m[k], position, atol=1e-12)
        np.testing.assert_allclose(whole.cov[k], state_cov, atol=1e-10)
    np.testing.assert_allclose(whole.total_cov[0], state_cov, atol=1e-10)


def test_the_states_at_the_contacts_are_those_of_the_filter_without_noise() -> None:
    """The log scale decays with each step, so that the factor on the lengths changes within an interval."""
    steps, (east_m, north_m, offset_rad, log_scale) = WALK.steps, START[0]
    found, _ = preintegrate(steps, np.array([0, 25, 60])).steps_from(
        np.array([START[0], [0.0, 0.0, offset_rad, MEMORY**25 * log_scale]])
    )
    c, s = np.cos(offset_rad), np.sin(offset_rad)
    place_m = np.array([east_m, north_m])
    for k, (east, north) in enumerate(steps.displacement_m):
        place_m = np.zeros(2) if k == 25 else place_m
        place_m = place_m + np.exp(log_scale) * np.array([c * east + s * north, -s * east + c * north])
        log_scale *= MEMORY
        np.testing.assert_allclose(found[k], [*place_m, offset_rad, log_scale], atol=1e-12)


def test_two_successive_intervals_equal_one_long_interval() -> None:
    steps, start = WALK.steps, np.zeros((1, 4))
    whole, first, second = (
        preintegrate(part, np.array([0, len(part)]))
        for part in (steps, steps.part(slice(0, 25)), steps.part(slice(25, 60)))
    )
    drift_cov = np.zeros((4, 4))
    drift_cov[2, 2] = steps.drift_var_rad2[25]
    middle, first_step = first.ends_from(start)
    end, second_step = second.ends_from(middle)
    joined_cov = second_step[0] @ (first.total_cov[0] + drift_cov) @ second_step[0].T + second.total_cov[0]
    np.testing.assert_allclose(end, whole.ends_from(start)[0], atol=1e-12)
    np.testing.assert_allclose(second_step @ first_step, whole.ends_from(start)[1], atol=1e-12)
    np.testing.assert_allclose(joined_cov, whole.total_cov[0], atol=1e-10)


def test_the_derivatives_of_an_interval_agree_with_finite_differences() -> None:
    whole = preintegrate(WALK.steps, np.array([0, 60]))
    numeric = approx_fprime(START[0], lambda x: whole.ends_from(x[None])[0][0], 1e-7)
    np.testing.assert_allclose(whole.ends_from(START)[1][0], numeric, atol=2e-5)
    rest = preintegrate(WALK.steps.part(slice(40, 60)), np.array([0, 20]))
    np.testing.assert_allclose(whole.to_end[39], rest.ends_from(np.zeros((1, 4)))[1][0], atol=1e-12)


def test_rotating_and_scaling_a_walk_rotates_and_scales_its_sum_and_covariance() -> None:
    """This property makes the sums reusable: a change of heading offset or scale needs no new summation."""
    own_frame = state_transform(START)[0]
    rotation = own_frame[:2, :2]
    steps = WALK.steps
    other = replace(
        steps, displacement_m=steps.displacement_m @ rotation.T, cov_m2=rotation @ steps.cov_m2 @ rotation.T
    )
    one, two = (preintegrate(s, np.array([0, 60])) for s in (steps, other))
    np.testing.assert_allclose(two.total_m[0], rotation @ one.total_m[0], atol=1e-12)
    np.testing.assert_allclose(two.total_cov[0], own_frame @ one.total_cov[0] @ own_frame.T, atol=1e-12)


@pytest.mark.parametrize("is_weighted", [False, True])
@pytest.mark.parametrize("duration_s", [0.5, 0.25])
def test_an_increment_is_the_step_of_the_filter(duration_s: float, is_weighted: bool) -> None:
    """The step of 0.25 s is quick and soft, so that its length is less certain."""
    step = replace(
        Step(1.0, 1.5, duration_s, 1 / duration_s, 4.0, 3.0, -3.0, 13.0, 7.0, 1.5, 0.0, 0.7),
        heading_unknown_s=0.2,
        yaw_bias_std_radps=0.01,
        from_rest=True,
        usual_duration_s=0.4,
        turn_rate_radps=0.6,
    )
    assert step.is_quick_and_soft == (duration_s == 0.25)
    fit = pdr.StepLengthFit(StaticStepLength(1.75), np.array([0.4]), np.array([[0.02**2]]), residual_std_m=0.06)
    mode = Mode("sideways", "sideways", fit, 1.5, heading_drift_rad_per_sqrt_s=0.02, extra_noise_m=0.05)
    noise = MotionNoise(log_scale_drift_per_sqrt_step=0.01)
    model = PedestrianModel((mode,), np.ones((1, 1)), noise=noise, contexts=("sideways",))
    found, shared = increments(step_table([step]), np.ones((1, 1)), model, np.zeros(1), is_weighted=is_weighted)
    length_m, _, own_var_m2, parameter_std_m = model.lengths(step)
    drift_cov = predict_heading(np.zeros((1, 4, 4)), step, step.duration_s, model.directions, noise)
    of_filter = advance(np.zeros((1, 4)), np.zeros((1, 4, 4)), step, length_m, own_var_m2, model.directions, noise)
    np.testing.assert_allclose(found.length_m, length_m)
    np.testing.assert_allclose(found.displacement_m[0], of_filter.mean[0, :2])
    # the heading diffuses within a step of unmeasured heading
    inside_m2 = 0.2 / 3 * length_m[0] ** 2 * np.eye(2)
    np.testing.assert_allclose(found.cov_m2[0], of_filter.cov[0, :2, :2] + inside_m2)
    np.testing.assert_allclose(found.drift_var_rad2[0] + found.unknown_var_rad2[0], drift_cov[0, 2, 2])
    np.testing.assert_allclose(found.unknown_var_rad2[0], 0.2)
    np.testing.assert_allclose(found.scale_memory[0], of_filter.by_state[0, 3, 3])
    np.testing.assert_allclose(found.scale_drift_var[0], of_filter.cov[0, 3, 3])
    np.testing.assert_allclose(shared[0, 0], parameter_std_m[0] * of_filter.motion.along[0])
    np.testing.assert_allclose(shared[0, 1], noise.log_scale_std * of_filter.mean[0, :2])


def test_with_weights_the_increment_has_the_length_and_the_direction_of_the_weighted_tracker() -> None:
    """A step that is half to the side and half ahead is not shortened to the mean of both directions."""
    step = Step(1.0, 1.5, 0.5, 2.0, 4.0, 3.0, -3.0, 13.0, 7.0, 1.5, 0.0, 0.7)
    modes = Mode("ahead", step_length=known_length(0.8, 0.05)), Mode("aside", "aside", known_length(0.4, 0.05), 1.5)
    model = PedestrianModel(modes, np.full((2, 2), 0.5), contexts=("ahead", "aside"))
    found, _ = increments(step_table([step]), np.array([[0.6, 0.4]]), model, np.zeros(1), is_weighted=True)
    tracker = WeightedTracker(model, function=lambda _: np.array([0.6, 0.4]))
    _, (update,) = tracker.finish(tracker.on_step(tracker.init(), step)[0])
    np.testing.assert_allclose(found.displacement_m[0], update.position_m)
    np.testing.assert_allclose(np.hypot(*found.displacement_m[0]), 0.6 * 0.8 + 0.4 * 0.4)


def test_a_gap_before_a_step_adds_the_same_variance_as_in_the_filter() -> None:
    step = Step(1.0, 1.5, 0.5, 2.0, 4.0, 3.0, -3.0, 13.0, 7.0, 1.5, 0.0, 0.7)
    model = PedestrianModel((Mode("walking", "walking", known_length(0.7, 0.06)),), np.ones((1, 1)))
    found, _ = increments(step_table([step]), np.ones((1, 1)), model, np.array([1.5]))
    grown = grow_over_gap(np.zeros((1, 4, 4)), 1.5, model.noise)[0]
    np.testing.assert_allclose([found.gap_var_m2[0], found.jump_var_rad2[0]], [grown[0, 0], grown[2, 2]])


def test_motion_without_steps_is_a_gap_of_the_position_alone() -> None:
    model = pdr.recipes.default().model
    prob = np.full((1, len(model.modes)), 1 / len(model.modes))
    (usual, _), (found, _) = (
        increments(step_table([replace(a_step(), stepless_s=s)]), prob, model, np.zeros(1)) for s in (0.0, 6.0)
    )
    assert (usual.gap_var_m2[0], found.gap_var_m2[0]) == (0.0, float(stepless_var_m2(6.0)))
    assert found.is_turned[0]
    np.testing.assert_array_equal([found.jump_var_rad2, found.length_m], [usual.jump_var_rad2, usual.length_m])


@pytest.mark.parametrize("jump_var_rad2", [0.0, 0.3])
def test_a_fix_late_in_a_step_belongs_to_the_contact_after_it_whose_heading_may_be_unknown(
    jump_var_rad2: float,
) -> None:
    jumps = np.zeros(len(WALK.steps))
    jumps[21] = jump_var_rad2
    steps = replace(WALK.steps, jump_var_rad2=jumps)
    step_m = steps.displacement_m[20]
    number, from_contact_m, var_m2 = nearest_contact(steps, steps.time_s[20] - 0.2 * steps.duration_s[20])
    assert number == 21
    if jump_var_rad2:  # the fifth of the step before the contact is an error of unknown direction
        np.testing.assert_array_equal(from_contact_m, np.zeros(2))
        assert var_m2 == pytest.approx(0.2**2 * step_m @ step_m)
    else:
        np.testing.assert_allclose(from_contact_m, -0.2 * step_m)
        assert var_m2 == pytest.approx(0.2**2 * 0.5 * np.trace(steps.cov_m2[20]))
