from __future__ import annotations

import warnings

import numpy as np
import pytest
from helpers import block_of, run_stage
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, sosfilt, stft

from pdr_filter.recipes.susi2013.features import (
    NAMES,
    MotionWindows,
    dominant_frequencies,
    motion_features,
)
from pdr_filter.sensing.conditioning import UniformBlock

RATE_HZ = 100.0


def noise_block(n: int, seed: int = 0) -> UniformBlock:
    rng = np.random.default_rng(seed)
    return block_of(rng.normal([0, 2, 9], 2.0, (n, 3)), rng.normal(0.3, 1.0, (n, 3)))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.sampled_from([64, 128, 255, 256]))
def test_energy_and_variance_equal_their_literal_formulas(seed: int, n: int) -> None:
    window = np.random.default_rng(seed).normal([[0.3], [-0.1]], [[2.0], [0.5]], (2, n))
    features = dict(zip(NAMES, motion_features(window, RATE_HZ), strict=True))
    for name, row in zip(("acc", "gyro"), window.tolist(), strict=True):
        mean = sum(row) / n
        assert features[f"energy_{name}"] == pytest.approx(sum(v**2 for v in row) / n)
        assert features[f"variance_{name}"] == pytest.approx(sum((v - mean) ** 2 for v in row) / n)


def test_there_are_ten_names_and_half_of_them_need_no_gyroscope() -> None:
    of_gyroscope = {name for name in NAMES if "gyro" in name}
    assert len(set(NAMES)) == len(NAMES) == 10 == 2 * len(of_gyroscope)
    window = np.random.default_rng(0).normal(size=(2, 256))
    other = window.copy()
    other[1] = 0.0
    changed = motion_features(window, RATE_HZ) != motion_features(other, RATE_HZ)
    assert {n for n, c in zip(NAMES, changed, strict=True) if c} == of_gyroscope
    assert not motion_features(other, RATE_HZ)[["gyro" in n for n in NAMES]].any()


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_dominant_frequencies_are_the_highest_maxima_of_scipys_spectrogram(seed: int) -> None:
    signal = np.random.default_rng(seed).normal(size=256)
    frequency_hz, _, transform = stft(signal, fs=RATE_HZ, window="hann", nperseg=256, boundary=None, padded=False)
    power = np.abs(transform[:, 0]) ** 2
    maxima = [
        k
        for k in range(len(power))
        if (k == 0 or power[k] > power[k - 1]) and (k == len(power) - 1 or power[k] >= power[k + 1])
    ]
    expected = frequency_hz[sorted(maxima, key=lambda k: -power[k])[:3]]
    np.testing.assert_allclose(dominant_frequencies(signal, RATE_HZ), expected)


@pytest.mark.parametrize("level", [0.0, 1e-12])
def test_a_window_without_motion_gives_zeros_and_no_warning(level: float) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        features = motion_features(level * np.random.default_rng(0).normal(size=(2, 256)), RATE_HZ)
    np.testing.assert_allclose(features, 0.0, atol=1e-20)


def test_frequencies_follow_the_sampling_rate_and_nothing_else_does() -> None:
    window = np.random.default_rng(1).normal(size=(2, 256))
    slow, fast = motion_features(window, 50.0), motion_features(window, 100.0)
    hertz = np.array([n.endswith("_hz") for n in NAMES])
    np.testing.assert_allclose(fast[hertz], 2 * slow[hertz])
    np.testing.assert_array_equal(fast[~hertz], slow[~hertz])


def test_a_window_holds_low_passed_norms_less_their_moving_mean() -> None:
    block = noise_block(900)
    sos = butter(10, 15.0, fs=RATE_HZ, output="sos")
    norms = []
    for components in (block.specific_force_mps2, block.angular_rate_radps):
        # what was before the first sample is like it: 10 s of it let the filter settle
        before = np.tile(components[0], (1000, 1))
        filtered = sosfilt(sos, np.concatenate([before, components]), axis=0)[1000:]
        norms.append(np.linalg.norm(filtered, axis=1))
    deviation = np.array([[v[k] - v[max(k - 255, 0) : k + 1].mean() for k in range(900)] for v in norms])
    found = run_stage(MotionWindows(), [block])[1]
    assert len(found) == 6
    for index, window in found:
        expected = motion_features(deviation[:, index - 255 : index + 1], RATE_HZ)
        np.testing.assert_allclose(window.features, expected, rtol=1e-7)


def test_a_window_says_whether_the_gyroscope_was_there() -> None:
    block = noise_block(700)
    block.angular_rate_known[300:350] = False
    assert [w.has_gyroscope for _, w in run_stage(MotionWindows(), [block])[1]] == [True, False, False, True]
