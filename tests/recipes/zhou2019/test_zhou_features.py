from __future__ import annotations

import cmath

import numpy as np
import pytest
from helpers import cut_uniform, flat_attitude, uniform_block
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import firwin, freqz
from scipy.spatial.transform import Rotation

from pdr_filter.recipes.zhou2019.features import (
    NAMES,
    BehaviourState,
    BehaviourWindow,
    BehaviourWindows,
    acceleration,
    behaviour_features,
    static_bias,
)
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.values import STANDARD_GRAVITY_MPS2

RATE_HZ = 100.0
G = STANDARD_GRAVITY_MPS2


def block_of(force: np.ndarray) -> UniformBlock:
    block = uniform_block(np.zeros(len(force)))
    block.specific_force_mps2[:] = force
    return block


def walk(n: int, seed: int = 0, static_samples: int = 150) -> UniformBlock:
    """A foot that stands still with a biased accelerometer and then moves."""
    rng = np.random.default_rng(seed)
    force = np.tile([0.1, -0.2, G + 0.3], (n, 1)) + rng.normal(0, 0.02, (n, 3))
    force[static_samples:] += rng.normal(0, 4.0, (n - static_samples, 3))
    return block_of(force)


def run(
    stage: BehaviourWindows, blocks: list[UniformBlock]
) -> tuple[BehaviourState, list[tuple[int, BehaviourWindow]]]:
    state, found = stage.init(), []
    for block in blocks:
        state, windows = stage.update(state, block, flat_attitude(block.specific_force_mps2[:, 2]))
        found += windows
    return state, found


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


def test_there_are_three_names() -> None:
    assert NAMES == ("variance", "dc_component", "energy")


@pytest.mark.parametrize("amplitude", [0.5, 4.0])
def test_a_sinusoid_has_its_amplitude_as_energy_and_half_its_square_as_variance(amplitude: float) -> None:
    t = np.arange(200) / RATE_HZ
    variance, dc_component, energy = behaviour_features(2.0 + amplitude * np.sin(2 * np.pi * 2.0 * t))
    assert variance == pytest.approx(amplitude**2 / 2)
    assert dc_component == pytest.approx(2.0)
    assert energy == pytest.approx(amplitude)


def test_a_constant_moves_the_dc_component_alone_and_time_reversal_nothing() -> None:
    window = np.random.default_rng(0).normal(size=200)
    plain = behaviour_features(window)
    np.testing.assert_allclose(behaviour_features(window + 3.0), plain + np.array([0.0, 3.0, 0.0]))
    np.testing.assert_allclose(behaviour_features(window[::-1].copy()), plain)


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


def test_how_the_sensor_is_mounted_does_not_matter() -> None:
    block = walk(800)
    turned = block_of(Rotation.from_euler("xyz", [0.4, -1.1, 2.0]).apply(block.specific_force_mps2))
    for (_, a), (_, b) in zip(run(BehaviourWindows(), [block])[1], run(BehaviourWindows(), [turned])[1], strict=True):
        np.testing.assert_allclose(a.features, b.features, rtol=1e-9)
        assert a.max_mps2 == pytest.approx(b.max_mps2)


def test_the_bias_is_that_of_the_first_second() -> None:
    block = walk(400)
    state, _ = run(BehaviourWindows(), [block])
    assert state.bias_mps2 is not None
    np.testing.assert_allclose(state.bias_mps2, static_bias(block.specific_force_mps2[:100]))
    assert np.linalg.norm(state.bias_mps2) == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize("force", [walk(400, static_samples=0).specific_force_mps2, np.zeros((400, 3))])
def test_a_start_that_is_not_still_or_has_no_gravity_gives_no_bias(force: np.ndarray) -> None:
    state, windows = run(BehaviourWindows(), [block_of(force)])
    assert state.bias_mps2 is not None
    np.testing.assert_array_equal(state.bias_mps2, np.zeros(3))
    assert len(windows) == 2


def test_a_window_holds_the_filtered_acceleration_of_its_two_seconds() -> None:
    stage, block = BehaviourWindows(), walk(900)
    a = acceleration(block.specific_force_mps2, static_bias(block.specific_force_mps2[:100]))
    taps = firwin(51, 10.0, window="hamming", fs=RATE_HZ)
    padded = np.concatenate([np.full(50, a[0]), a])
    filtered = np.array([taps[::-1] @ padded[k : k + 51] for k in range(900)])
    _, found = run(stage, [block])
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
    _, found = run(stage, [block_of(blow)])
    (with_blow,) = [w for _, w in found if w.max_mps2 > 1.0]
    assert with_blow.time_s == pytest.approx(5.75)
    assert with_blow.time_s - 2.0 < 4.8 < with_blow.time_s


def test_the_filter_passes_a_step_and_stops_what_shakes_faster_than_running() -> None:
    taps = firwin(51, 10.0, window="hamming", fs=RATE_HZ)
    _, response = freqz(taps, worN=[2.0, 5.0, 14.0, 30.0], fs=RATE_HZ)
    gain = np.abs(response)
    np.testing.assert_allclose(gain[:2], 1.0, atol=0.01)
    assert (gain[2:] < 0.01).all()
    t = np.arange(1000) / RATE_HZ
    for frequency_hz, passes in ((2.0, True), (30.0, False)):
        force = np.column_stack([0 * t, 0 * t, G + np.where(t > 2, np.sin(2 * np.pi * frequency_hz * t), 0.0)])
        _, window = run(BehaviourWindows(), [block_of(force)])[1][-1]
        assert (window.features[0] > 0.4) == passes


def test_after_a_gap_the_bias_is_kept_and_windows_start_afresh() -> None:
    stage, block = BehaviourWindows(), walk(900)
    state, _ = run(stage, [block])
    again = stage.after_gap(state)
    moving = block_of(block.specific_force_mps2[500:])
    state, found = stage.update(again, moving, flat_attitude(moving.specific_force_mps2[:, 2]))
    assert state.bias_mps2 is again.bias_mps2
    assert [index for index, _ in found] == [199, 399]


@settings(max_examples=30, deadline=None)
@given(edges=st.lists(st.integers(0, 900), max_size=60), shape=st.sampled_from([(2.0, 2.0), (1.0, 0.5), (1.0, 0.05)]))
def test_windows_do_not_depend_on_how_samples_arrive(edges: list[int], shape: tuple[float, float]) -> None:
    stage, block = BehaviourWindows(window_s=shape[0], hop_s=shape[1]), walk(900)
    (_, whole), (_, pieces) = run(stage, [block]), run(stage, cut_uniform(block, edges))
    assert [(i, w.time_s, w.max_mps2) for i, w in pieces] == [(i, w.time_s, w.max_mps2) for i, w in whole]
    for (_, piece), (_, window) in zip(pieces, whole, strict=True):
        np.testing.assert_array_equal(piece.features, window.features)


def test_sample_by_sample_gives_the_same_bits_as_the_whole() -> None:
    block = walk(450)
    (_, whole), (_, singles) = run(BehaviourWindows(), [block]), run(BehaviourWindows(), cut_uniform(block, range(450)))
    for (_, single), (_, window) in zip(singles, whole, strict=True):
        np.testing.assert_array_equal(single.features, window.features)


@pytest.mark.parametrize("wrong", [{"hop_s": 3.0}, {"static_s": 2.5}, {"static_s": 0.0}, {"low_pass_hz": 50.0}])
def test_a_stage_that_cannot_work_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="must be"):
        BehaviourWindows(**wrong)
