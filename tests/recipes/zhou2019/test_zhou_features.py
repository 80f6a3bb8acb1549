from __future__ import annotations

import cmath

import numpy as np
import pytest
from helpers import block_of, flat_attitude, run_stage
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import firwin
from scipy.spatial.transform import Rotation

from pdr_filter.recipes.zhou2019.features import (
    BehaviourWindows,
    acceleration,
    behaviour_features,
    static_bias,
)
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.values import STANDARD_GRAVITY_MPS2

RATE_HZ = 100.0
G = STANDARD_GRAVITY_MPS2


def walk(n: int, seed: int = 0, static_samples: int = 150) -> UniformBlock:
    """A foot that stands still with a biased accelerometer and then moves."""
    rng = np.random.default_rng(seed)
    force = np.tile([0.1, -0.2, G + 0.3], (n, 1)) + rng.normal(0, 0.02, (n, 3))
    force[static_samples:] += rng.normal(0, 4.0, (n - static_samples, 3))
    return block_of(force)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.sampled_from([16, 50, 101, 200]))
def test_every_feature_equals_its_literal_formula(seed: int, n: int) -> None:
    window = np.random.default_rng(seed).normal(1.3, 2.0, n)
    mean = sum(window) / n
    f = [
        sum(a * cmath.exp(-2j * cmath.pi * j * k / n) for k, a in enumerate(window.tolist())) for j in range(n)
    ]  # Fourier coefficients by their definition
    variance = sum((a - mean) ** 2 for a in window) / n
    energy = sum(abs(f_j) for f_j in f[1:]) / n  # eq. 4, f_0 removed
    np.testing.assert_allclose(behaviour_features(window), [variance, f[0].real / n, energy], rtol=1e-9)


def test_the_bias_of_a_horizontal_sensor_is_the_mean_less_gravity_as_printed() -> None:
    start = np.random.default_rng(0).normal([0.1, -0.2, G + 0.3], 0.02, (100, 3))
    expected = sum(start) / 100 - np.array([0, 0, G])  # eq. 3
    np.testing.assert_allclose(static_bias(start, np.array([0.0, 0.0, 1.0])), expected)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), excess=st.floats(-0.5, 0.5))
def test_a_turned_sensor_at_rest_has_no_acceleration_and_its_excess_as_bias(seed: int, excess: float) -> None:
    up = Rotation.random(random_state=seed).as_matrix()[2]
    start = np.tile((G + excess) * up, (50, 1))
    bias = static_bias(start)
    np.testing.assert_allclose(bias, excess * up, atol=1e-12)
    np.testing.assert_allclose(acceleration(start, bias), 0.0, atol=1e-12)


def test_acceleration_is_the_norm_less_bias_less_gravity() -> None:
    rng = np.random.default_rng(0)
    force, bias = rng.normal(0, 10, (20, 3)), np.array([0.1, -0.2, 0.3])
    expected = [np.linalg.norm(f - bias) - np.linalg.norm([0, 0, G]) for f in force]  # eq. 2
    np.testing.assert_allclose(acceleration(force, bias), expected)


def test_the_bias_is_that_of_the_first_second() -> None:
    block = walk(400)
    state, _ = run_stage(BehaviourWindows(), [block])
    assert state.bias_mps2 is not None
    np.testing.assert_allclose(state.bias_mps2, static_bias(block.specific_force_mps2[:100]))
    assert np.linalg.norm(state.bias_mps2) == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize("force", [walk(400, static_samples=0).specific_force_mps2, np.zeros((400, 3))])
def test_a_start_that_is_not_still_or_has_no_gravity_gives_no_bias(force: np.ndarray) -> None:
    state, windows = run_stage(BehaviourWindows(), [block_of(force)])
    assert state.bias_mps2 is not None
    np.testing.assert_array_equal(state.bias_mps2, np.zeros(3))
    assert len(windows) == 2


def test_a_window_holds_the_filtered_acceleration_of_its_two_seconds() -> None:
    stage, block = BehaviourWindows(), walk(900)
    a = acceleration(block.specific_force_mps2, static_bias(block.specific_force_mps2[:100]))
    taps = firwin(51, 10.0, window="hamming", fs=RATE_HZ)
    padded = np.concatenate([np.full(50, a[0]), a])
    filtered = np.array([taps[::-1] @ padded[k : k + 51] for k in range(900)])
    _, found = run_stage(stage, [block])
    assert [index for index, _ in found] == [199, 399, 599, 799]
    for index, window in found:
        part = filtered[index - 199 : index + 1]
        np.testing.assert_allclose(window.features, behaviour_features(part), rtol=1e-9, atol=1e-12)
        assert window.max_mps2 == pytest.approx(part.max())


def test_a_window_is_dated_by_the_motion_in_it_and_not_by_the_delay_of_the_filter() -> None:
    stage = BehaviourWindows()
    assert stage.latency_s == pytest.approx(0.25)
    blow = np.tile([0.0, 0.0, G], (1000, 1))
    blow[480, 2] += 50.0  # at 4.8 s
    _, found = run_stage(stage, [block_of(blow)])
    (with_blow,) = [w for _, w in found if w.max_mps2 > 1.0]
    assert with_blow.time_s == pytest.approx(5.75)
    assert with_blow.time_s - 2.0 < 4.8 < with_blow.time_s


def test_after_a_gap_the_bias_is_kept_and_windows_start_afresh() -> None:
    stage, block = BehaviourWindows(), walk(900)
    state, _ = run_stage(stage, [block])
    again = stage.after_gap(state)
    moving = block_of(block.specific_force_mps2[500:])
    state, found = stage.update(again, moving, flat_attitude(moving.specific_force_mps2[:, 2]))
    assert state.bias_mps2 is again.bias_mps2
    assert [index for index, _ in found] == [199, 399]
