# ruff: noqa: N806 - the letters of the equations
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from helpers import a_step, clockwise
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime

from pdr_filter.filter.imm.motion_model import (
    HEADING_OFFSET,
    LOG_SCALE,
    MAX_HEADING_VARIANCE,
    Directions,
    Mode,
    MotionNoise,
    grow_over_gap,
    initial_estimate,
    second_order_errors,
)
from pdr_filter.filter.imm.step_cycle import advance, expect_first_direction, predict_heading, update_heading
from pdr_filter.filter.step_length.models import known_length
from pdr_filter.values import HeadingDrift, Step

STILL = MotionNoise(HeadingDrift(random_walk_rad_per_sqrt_s=0.0), log_scale_drift_per_sqrt_step=0.0)
NO_COV = np.zeros((1, 4, 4))


def walking(offset_rad: Sequence[float], heading_var_rad2: Sequence[float]) -> Directions:
    """Return the directions of modes with these offsets and standard deviations."""
    none = np.zeros(len(offset_rad))
    return Directions(np.asarray(offset_rad), np.asarray(heading_var_rad2), none, none)


def advance_one(
    mean: np.ndarray,
    cov: np.ndarray = NO_COV[0],
    step: Step | None = None,
    *,
    length_m: float = 0.7,
    length_var_m2: float = 0.0,
    offset_rad: float = 0.0,
    heading_var_rad2: float = 0.0,
    noise: MotionNoise = STILL,
) -> tuple[np.ndarray, np.ndarray]:
    """Apply `predict_heading` and `advance` to a single mode."""
    step, directions = step or a_step(), walking([offset_rad], [heading_var_rad2])
    drifted = predict_heading(cov[None], step, step.duration_s, directions, noise)
    moved = advance(
        np.asarray(mean, dtype=float)[None],
        drifted,
        step,
        np.array([length_m]),
        np.array([length_var_m2]),
        directions,
        noise,
    )
    return moved.mean[0], moved.cov[0]


# --- direction of a step --------------------------------------------------------------------------------------------


# --- uncertainty of a step ------------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(
    state=st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3, 3), st.floats(-0.3, 0.3)),
    heading_rad=st.floats(-7, 7),
    length_m=st.floats(0, 1.5),
    offset_rad=st.sampled_from([0.0, np.pi / 2, -0.4]),
)
def test_the_jacobian_equals_finite_differences(
    state: tuple[float, ...], heading_rad: float, length_m: float, offset_rad: float
) -> None:
    x, step = np.array(state), a_step(heading_rad=heading_rad)

    def moved(mean: np.ndarray) -> np.ndarray:
        return advance_one(mean, step=step, length_m=length_m, offset_rad=offset_rad)[0]

    J = approx_fprime(x, moved, 1e-6)
    root = np.random.default_rng(0).normal(size=(4, 4)) / 5
    P = root @ root.T
    _, cov = advance_one(x, P, step, length_m=length_m, offset_rad=offset_rad)
    np.testing.assert_allclose(cov, J @ P @ J.T, atol=1e-4)


def test_a_step_in_a_turn_may_lead_in_any_direction_within_the_turn() -> None:
    step = replace(a_step(heading_rad=0.8, duration_s=0.5), turn_rate_radps=0.4)
    _, cov = advance_one(np.zeros(4), step=step, length_m=0.7)
    directions = 0.8 + np.linspace(-0.1, 0.1, 10001)
    ends = 0.7 * np.column_stack([np.sin(directions), np.cos(directions)])
    np.testing.assert_allclose(cov[:2, :2], np.cov(ends.T), rtol=0.01, atol=1e-5)
    whirled = replace(step, turn_rate_radps=40.0)
    _, cov = advance_one(np.zeros(4), step=whirled, length_m=0.7)
    assert np.trace(cov[:2, :2]) == pytest.approx(0.7**2 * np.pi**2 / 12)


def test_a_phone_that_turns_ahead_of_the_walking_direction_makes_steps_in_curves_less_certain() -> None:
    step = replace(a_step(duration_s=0.5), turn_rate_radps=0.4)
    at_ear = replace(step, ahead_s=1.0)
    _, cov = advance_one(np.zeros(4), step=at_ear, length_m=0.7)
    assert np.sqrt(cov[0, 0]) == pytest.approx(0.7 * 0.4 * (0.5 / np.sqrt(12.0) + 1.0), rel=1e-3)
    straight = [replace(each, turn_rate_radps=0.0) for each in (step, at_ear)]
    covs = [advance_one(np.zeros(4), step=each, length_m=0.7)[1] for each in straight]
    np.testing.assert_array_equal(*covs)


def test_the_estimated_scale_decays_towards_the_population_prior() -> None:
    noise = MotionNoise(log_scale_std=0.08, log_scale_drift_per_sqrt_step=0.01)
    memory = 1 - 0.01**2 / 0.08**2  # decay of the variance in a step
    mean, cov = np.array([0.0, 0.0, 0.0, 0.1]), np.zeros((4, 4))
    for _ in range(100):
        mean, cov = advance_one(mean, cov, noise=noise)
    assert mean[LOG_SCALE] == pytest.approx(0.1 * memory**50)
    assert cov[LOG_SCALE, LOG_SCALE] == pytest.approx(0.08**2 * (1 - memory**100))


def test_an_exactly_known_scale_stays_known() -> None:
    noise = MotionNoise(log_scale_std=0.0)
    mean, cov = advance_one(np.array([0.0, 0.0, 0.0, 0.1]), noise=noise)
    assert mean[LOG_SCALE] == 0.1 and cov[LOG_SCALE, LOG_SCALE] == 0.0


def test_drift_and_noise_of_a_mode_are_added() -> None:
    mode = Mode(
        "bag", "walking", known_length(0.7, 0.0), heading_std_rad=0.0, carrying_mode="bag",
        heading_drift_rad_per_sqrt_s=0.3, extra_noise_m=0.2,
    )  # fmt: skip
    step, directions = a_step(duration_s=0.5), Directions.of([mode])
    drifted = predict_heading(NO_COV, step, 0.5, directions, STILL)
    np.testing.assert_allclose(drifted[0], np.diag([0.0, 0.0, 0.09 * 0.5, 0.0]), atol=1e-15)
    cov = advance(np.zeros((1, 4)), NO_COV, step, np.array([0.7]), np.zeros(1), directions, STILL).cov
    np.testing.assert_allclose(cov[0], np.diag([0.04, 0.04, 0.0, 0.0]), atol=1e-15)


def test_without_angular_rate_the_heading_variance_grows_up_to_that_of_a_uniform_heading() -> None:
    noise = MotionNoise()
    step = a_step(duration_s=0.5, heading_unknown_s=0.5)
    _, cov = advance_one(np.zeros(4), step=step, noise=noise)
    assert cov[HEADING_OFFSET, HEADING_OFFSET] == pytest.approx(noise.heading_drift.unknown_rad_per_sqrt_s**2 * 0.5)
    mean = np.zeros(4)
    for _ in range(100):
        mean, cov = advance_one(mean, cov, step, noise=noise)
        assert cov[HEADING_OFFSET, HEADING_OFFSET] <= MAX_HEADING_VARIANCE * (1 + 1e-12)
        assert np.linalg.eigvalsh(cov).min() > -1e-9
    assert cov[HEADING_OFFSET, HEADING_OFFSET] == pytest.approx(np.pi**2 / 3)


def test_every_mode_moves_independently() -> None:
    rng = np.random.default_rng(0)
    mean, root = rng.normal(size=(3, 4)), rng.normal(size=(3, 4, 4)) / 5
    cov = root @ root.transpose(0, 2, 1)
    length, var_l, offset, var_h = rng.uniform(0.1, 1, (4, 3))
    copies = mean.copy(), cov.copy()
    step = a_step(heading_rad=0.4)
    moved = advance(mean, cov, step, length, var_l, walking(offset, var_h), STILL)
    for j in range(3):
        alone = advance_one(
            mean[j],
            cov[j],
            step,
            length_m=length[j],
            length_var_m2=var_l[j],
            offset_rad=offset[j],
            heading_var_rad2=var_h[j],
        )
        np.testing.assert_allclose(moved.mean[j], alone[0], atol=1e-12)
        np.testing.assert_allclose(moved.cov[j], alone[1], atol=1e-12)
    np.testing.assert_array_equal(mean, copies[0])
    np.testing.assert_array_equal(cov, copies[1])


@pytest.mark.parametrize("gap_s", [0.5, 2.0, 60.0])
def test_a_gap_adds_the_variance_of_a_possible_displacement(gap_s: float) -> None:
    noise = MotionNoise(HeadingDrift(unknown_rad_per_sqrt_s=0.7), gap_speed_mps=1.2)
    cov = np.tile(np.diag([1.0, 2.0, 0.01, 0.02]), (2, 1, 1))
    grown = grow_over_gap(cov, gap_s, noise)
    heading = min(0.01 + 0.7**2 * gap_s, np.pi**2 / 3)
    walked = (1.2 * gap_s) ** 2
    np.testing.assert_allclose(grown[1], np.diag([1.0 + walked, 2.0 + walked, heading, 0.02]))
    np.testing.assert_array_equal(cov[0], np.diag([1.0, 2.0, 0.01, 0.02]))


def test_the_filter_starts_at_the_origin_with_the_spread_of_people() -> None:
    mean, cov = initial_estimate(MotionNoise(initial_heading_offset_std_rad=0.2, log_scale_std=0.1))
    np.testing.assert_array_equal(mean, np.zeros(4))
    np.testing.assert_allclose(cov, np.diag([0.0, 0.0, 0.04, 0.01]))


# --- step lengths ---------------------------------------------------------------------------------------------------


def test_a_known_length_does_not_depend_on_the_step() -> None:
    fit = known_length(0.29, 0.05)
    assert fit.predict(a_step(variance=1.0)) == fit.predict(a_step(variance=50.0, duration_s=0.3))
    assert fit.predict(a_step()) == (pytest.approx(0.29), pytest.approx(0.0025))


@pytest.mark.parametrize(("heading_std", "scale_std"), [(0.1, 0.08), (0.5, 0.08), (1.8, 0.08), (0.5, 0.0), (0.0, 0.3)])
def test_the_second_order_errors_are_those_of_normal_errors_of_heading_and_scale(
    heading_std: float, scale_std: float
) -> None:
    rng = np.random.default_rng(0)
    e, s = heading_std * rng.normal(size=1_000_000), scale_std * rng.normal(size=1_000_000)
    along = np.sqrt(((np.exp(s) * np.cos(e) - 1 - s) ** 2).mean())
    across = np.sqrt((((np.exp(s) - 1) * np.sin(e)) ** 2).mean())
    assert second_order_errors(heading_std**2, scale_std**2) == pytest.approx((along, across), rel=0.02, abs=1e-12)


def test_exactly_known_headings_and_scales_have_no_second_order_error() -> None:
    assert second_order_errors(0.0, 0.0) == (0.0, 0.0)


# --- measured walking heading ---------------------------------------------------------------------------------------


def some_estimate(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return a mean and a covariance with correlations, for one mode."""
    root = 0.2 * np.random.default_rng(seed).normal(size=(4, 4))
    return np.array([[1.0, 2.0, 0.3, 0.05]]), (root @ root.T + 0.01 * np.eye(4))[None]


def test_a_small_correction_of_the_heading_is_a_kalman_update() -> None:
    mean, cov = some_estimate()
    step = replace(a_step(heading_rad=1.0), walking_heading_rad=1.0 + 0.1 + 0.3 + 1e-4, walking_heading_std_rad=0.2)
    updated, updated_cov = update_heading(mean, cov, step, 0.1)
    oracle = KalmanFilter(dim_x=4, dim_z=1)
    oracle.x, oracle.P, oracle.H = mean[0][:, None], cov[0], np.array([[0.0, 0.0, 1.0, 0.0]])
    oracle.update(np.array([[0.3 + 1e-4]]), R=np.array([[0.04]]))
    np.testing.assert_allclose(updated[0], oracle.x[:, 0], atol=1e-8)
    np.testing.assert_allclose(updated_cov[0], oracle.P, atol=1e-4)


def test_a_large_correction_of_the_heading_rotates_the_path_since_it_was_lost() -> None:
    """After thirty steps with a heading error of a radian, the update gives the position without this error."""
    mean, cov = np.zeros((1, 4)), np.diag([0.0, 0.0, 1.0, 0.0])[None]
    turns = np.linspace(0.0, 2.0, 30)
    noise, directions = replace(STILL, log_scale_std=0.0), walking([0.0], [0.0])
    for turn in turns:
        step = a_step(heading_rad=float(turn))
        _, mean, cov, _ = advance(mean, cov, step, np.array([0.7]), np.zeros(1), directions, noise)
    way = mean[0, :2].copy()
    shown = replace(a_step(heading_rad=2.0), walking_heading_rad=2.0 + 1.3, walking_heading_std_rad=1e-6)
    updated, updated_cov = update_heading(mean, cov, shown, 0.0)
    np.testing.assert_allclose(updated[0, :2], clockwise(1.3) @ way, atol=1e-6)
    assert np.linalg.eigvalsh(updated_cov[0]).min() > -1e-9


def test_the_rotated_covariance_stays_valid_and_rotates_with_the_path() -> None:
    mean, cov = some_estimate(1)
    step = replace(a_step(), walking_heading_rad=2.4, walking_heading_std_rad=0.5)
    updated, updated_cov = update_heading(mean, cov, step, 0.0)
    assert np.linalg.eigvalsh(updated_cov[0]).min() > 0
    lever = cov[0, :2, HEADING_OFFSET] / cov[0, HEADING_OFFSET, HEADING_OFFSET]
    after = updated_cov[0, :2, HEADING_OFFSET] / updated_cov[0, HEADING_OFFSET, HEADING_OFFSET]
    correction = updated[0, HEADING_OFFSET] - mean[0, HEADING_OFFSET]
    np.testing.assert_allclose(after, clockwise(float(correction)) @ lever, atol=1e-12)


@pytest.mark.parametrize("turns", [-3, -1, 1, 2])
def test_whole_turns_of_a_walking_heading_change_nothing(turns: int) -> None:
    mean, cov = some_estimate()
    step = replace(a_step(heading_rad=1.0), walking_heading_rad=1.5, walking_heading_std_rad=0.2)
    turned = replace(step, walking_heading_rad=1.5 + 2 * np.pi * turns)
    both = update_heading(mean, cov, step, 0.0), update_heading(mean, cov, turned, 0.0)
    for once, again in zip(*both, strict=True):
        np.testing.assert_allclose(once, again, atol=1e-12)


def test_a_step_without_a_measured_direction_changes_nothing() -> None:
    mean, cov = some_estimate()
    updated, updated_cov = update_heading(mean, cov, a_step(), 0.0)
    np.testing.assert_array_equal(updated, mean)
    np.testing.assert_array_equal(updated_cov, cov)


def test_moving_the_phone_adds_the_variance_of_the_offset_change() -> None:
    _, cov = some_estimate()
    step = replace(a_step(), offset_change_std_rad=0.7)
    drifted = predict_heading(cov, step, 0.0, walking([0.0], [0.0]), STILL)
    expected = cov[0, HEADING_OFFSET, HEADING_OFFSET] + 0.49
    assert drifted[0, HEADING_OFFSET, HEADING_OFFSET] == pytest.approx(expected)


def test_a_heading_lost_long_ago_does_not_rotate_earlier_steps() -> None:
    """At the variance of a uniform heading the lever decays, so that its length stays bounded."""
    cov, step = np.zeros((1, 4, 4)), a_step(duration_s=0.5, heading_unknown_s=0.5)
    directions, mean = walking([0.0], [0.0]), np.zeros((1, 4))
    levers = list[float]()
    for _ in range(60):
        cov = predict_heading(cov, step, 0.5, directions, MotionNoise())
        _, mean, cov, _ = advance(mean, cov, step, np.array([0.7]), np.zeros(1), directions, MotionNoise())
        levers.append(float(np.hypot(*cov[0, :2, HEADING_OFFSET])) / cov[0, HEADING_OFFSET, HEADING_OFFSET])
    # each step forgets the share q / (pi^2 / 3 + q) of the lever, q = 0.5 rad2, and adds its own 0.7 m
    assert levers[-1] == pytest.approx(0.7 * (1.0 + MAX_HEADING_VARIANCE / 0.5), rel=0.02)


def test_the_first_walking_heading_gives_earlier_steps_its_own_uncertainty() -> None:
    begun = {}
    for std in (STILL.initial_heading_offset_std_rad, 0.6):
        mean, cov = initial_estimate(replace(STILL, initial_heading_offset_std_rad=std))
        for heading in (0.0, 0.4, 1.0):
            mean, cov = advance_one(mean, cov, a_step(heading_rad=heading), length_var_m2=0.01)
        begun[std] = cov
    first, expected = begun.values()
    np.testing.assert_allclose(expect_first_direction(first[None], 0.6)[0], expected, atol=1e-12)


def test_a_gyroscope_bias_increases_the_heading_variance_by_its_variance_and_memory() -> None:
    noise = replace(STILL, heading_drift=HeadingDrift(random_walk_rad_per_sqrt_s=0.0, bias_correlation_s=20.0))
    step = replace(a_step(duration_s=0.5), yaw_bias_std_radps=0.01)
    _, cov = advance_one(np.zeros(4), step=step, noise=noise)
    assert cov[HEADING_OFFSET, HEADING_OFFSET] == pytest.approx(2 * 20.0 * 0.01**2 * 0.5)
