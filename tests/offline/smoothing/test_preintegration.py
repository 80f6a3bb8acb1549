"""Preintegrated intervals compared with the filter's recursion step by step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from simulated_steps import simulated_walk

from pdr_filter.filter.imm.motion_model import Directions, Mode, MotionNoise, advance, grow_over_gap, predict_heading
from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.step_length.models import known_length
from pdr_filter.offline.smoothing.preintegration import end_states, increments, preintegrate, state_transform
from pdr_filter.offline.smoothing.problem import nearest_contact
from pdr_filter.values import Step, step_table

WALK = simulated_walk(60, np.random.default_rng(1))
START = np.array([[3.0, -2.0, 0.8, 0.1]])


def test_the_sum_of_an_interval_equals_the_recursion_over_its_steps() -> None:
    """Mean and covariance agree with the filter's recursion P = F P F' + Q, in the frame of the interval's start."""
    steps = WALK.steps
    whole = preintegrate(steps, np.array([0, len(steps)]))
    position, state_cov = np.zeros(2), np.zeros((4, 4))
    for k in range(len(steps)):
        d = steps.displacement_m[k]
        by_state = np.eye(4)
        by_state[:2, 2], by_state[:2, 3] = [d[1], -d[0]], d
        added_cov = np.zeros((4, 4))
        added_cov[:2, :2] = steps.cov_m2[k]
        added_cov[3, 3] = steps.scale_drift_var[k]
        state_cov[2, 2] += steps.drift_var_rad2[k] if k else 0.0
        position, state_cov = position + d, by_state @ state_cov @ by_state.T + added_cov
        np.testing.assert_allclose(whole.sum_m[k], position, atol=1e-12)
        np.testing.assert_allclose(whole.cov[k], state_cov, atol=1e-12)
    np.testing.assert_allclose(whole.total_cov[0], state_cov, atol=1e-12)


def test_two_successive_intervals_equal_one_long_interval() -> None:
    steps = WALK.steps
    whole, halves = preintegrate(steps, np.array([0, 60])), preintegrate(steps, np.array([0, 25, 60]))
    start = np.zeros((1, 4))
    middle, first_step = end_states(start, halves.total_m[:1])
    end, second_step = end_states(middle, halves.total_m[1:])
    joined_cov = second_step[0] @ halves.total_cov[0] @ second_step[0].T + halves.total_cov[1]
    np.testing.assert_allclose(end, end_states(start, whole.total_m)[0], atol=1e-12)
    np.testing.assert_allclose(second_step @ first_step, end_states(start, whole.total_m)[1], atol=1e-12)
    np.testing.assert_allclose(joined_cov, whole.total_cov[0], atol=1e-12)


def test_the_derivative_of_an_interval_agrees_with_finite_differences() -> None:
    total = preintegrate(WALK.steps, np.array([0, 60])).total_m
    numeric = approx_fprime(START[0], lambda x: end_states(x[None], total)[0][0], 1e-7)
    np.testing.assert_allclose(end_states(START, total)[1][0], numeric, atol=1e-5)


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


@pytest.mark.parametrize("from_rest", [False, True])
def test_an_increment_is_the_step_of_the_filter(from_rest: bool) -> None:
    step = replace(
        Step(1.0, 1.5, 0.5, 2.0, 4.0, 3.0, -3.0, 13.0, 7.0, 1.5, 0.0, 0.7),
        heading_unknown_s=0.2,
        yaw_bias_std_radps=0.01,
        from_rest=from_rest,
        usual_duration_s=0.4,
        turn_rate_radps=0.6,
    )
    mode = Mode(
        "sideways", "sideways", known_length(0.7, 0.06), 1.5, heading_drift_rad_per_sqrt_s=0.02, extra_noise_m=0.05
    )
    noise = MotionNoise()
    found, shared = increments(step_table([step]), np.ones((1, 1)), [mode], noise, np.zeros(1))
    model = PedestrianModel((mode,), np.ones((1, 1)), noise=noise)
    length_m, length_var_m2 = np.array([0.7]), model.own_var_m2(step, np.array([0.7]))
    directions = Directions.of([mode])
    drift_cov = predict_heading(np.zeros((1, 4, 4)), step, step.duration_s, directions, noise)
    _, mean, added_cov, _ = advance(
        np.zeros((1, 4)), np.zeros((1, 4, 4)), step, length_m, length_var_m2, directions, noise
    )
    np.testing.assert_allclose(found.displacement_m[0], mean[0, :2])
    np.testing.assert_allclose(found.cov_m2[0], added_cov[0, :2, :2])
    np.testing.assert_allclose(found.drift_var_rad2[0] + found.unknown_var_rad2[0], drift_cov[0, 2, 2])
    np.testing.assert_allclose(found.unknown_var_rad2[0], 0.2)
    np.testing.assert_allclose(found.scale_drift_var[0], added_cov[0, 3, 3])
    assert shared == pytest.approx(0.0, abs=1e-15)


def test_a_gap_before_a_step_adds_the_same_variance_as_in_the_filter() -> None:
    step = Step(1.0, 1.5, 0.5, 2.0, 4.0, 3.0, -3.0, 13.0, 7.0, 1.5, 0.0, 0.7)
    mode, noise = Mode("walking", "walking", known_length(0.7, 0.06)), MotionNoise()
    found, _ = increments(step_table([step]), np.ones((1, 1)), [mode], noise, np.array([1.5]))
    grown = grow_over_gap(np.zeros((1, 4, 4)), 1.5, noise)[0]
    np.testing.assert_allclose([found.gap_var_m2[0], found.jump_var_rad2[0]], [grown[0, 0], grown[2, 2]])


def test_without_angular_rate_mean_and_covariance_agree_with_simulated_walks() -> None:
    steps = replace(WALK.steps.part(0, 20), unknown_var_rad2=np.full(20, 0.3), drift_var_rad2=np.zeros(20))
    interval = preintegrate(steps, np.array([0, 20]))
    rng = np.random.default_rng(0)
    turned = np.cumsum(rng.normal(scale=np.sqrt(0.3), size=(20000, 20)), axis=1)
    heading = turned - turned[:, :1]
    d = steps.displacement_m[:, 0] + 1j * steps.displacement_m[:, 1]
    ends = (np.exp(-1j * heading) * d).sum(axis=1)
    np.testing.assert_allclose(interval.total_m[0], [ends.real.mean(), ends.imag.mean()], atol=0.05)
    spread = np.trace(interval.total_cov[0, :2, :2] - steps.cov_m2.sum(axis=0))
    assert spread == pytest.approx(ends.real.var() + ends.imag.var(), rel=0.05)


def test_anchors_that_do_not_increase_are_refused() -> None:
    with pytest.raises(ValueError, match="anchors must increase"):
        preintegrate(WALK.steps, np.array([0, 30, 30, 60]))


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
