from __future__ import annotations

import numpy as np
import pytest
from helpers import cut_uniform, flat_attitude, imu, uniform_block
from scipy.signal import butter, sosfilt, sosfilt_zi

from pdr_filter.recipes.martinelli2018.features import TABLE_II, features_28
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.features.feature_windows import FeatureWindow, FeatureWindows
from pdr_filter.sensing.front_end import feature_windows


def windows_of(stage: FeatureWindows, blocks: list[UniformBlock]) -> list[tuple[int, FeatureWindow]]:
    state, found = stage.init(), []
    for block in blocks:
        state, windows = stage.update(state, block, flat_attitude(block.specific_force_mps2[:, 2]))
        found += windows
    return found


def noise_block(n: int, seed: int = 0) -> UniformBlock:
    rng = np.random.default_rng(seed)
    return uniform_block(rng.gamma(4.0, 2.5, n), rate=rng.normal(size=(n, 3)), field=rng.normal(40, 5, (n, 3)))


def test_windows_end_after_two_seconds_and_then_every_second() -> None:
    found = windows_of(FeatureWindows(features=TABLE_II), [noise_block(799)])
    np.testing.assert_allclose([w.time_s for _, w in found], [2, 3, 4, 5, 6, 7], atol=1e-9)
    np.testing.assert_allclose([w.start_s for _, w in found], [0, 1, 2, 3, 4, 5], atol=1e-9)
    assert [index for index, _ in found] == [199, 299, 399, 499, 599, 699]


def test_a_window_holds_the_features_of_its_own_two_seconds() -> None:
    block = noise_block(500)
    force = block.specific_force_mps2[:, 2]
    sos = butter(2, 5.0, fs=100, output="sos")
    low_passed, _ = sosfilt(sos, force, zi=sosfilt_zi(sos) * force[0])
    signals = np.stack(
        [
            force,
            low_passed,
            np.linalg.norm(block.angular_rate_radps, axis=1),
            np.linalg.norm(block.magnetic_field_ut, axis=1),
        ]
    )
    for k, (_, window) in enumerate(windows_of(FeatureWindows(features=TABLE_II), [block])):
        expected = features_28(signals[:, 100 * k : 100 * k + 200], 100.0)
        np.testing.assert_allclose(window.features, expected, rtol=1e-9)


@pytest.mark.parametrize(("window_s", "hop_s"), [(2.0, 0.5), (2.5, 1.0), (1.0, 1.0)])
def test_windows_are_one_hop_apart_whatever_their_length(window_s: float, hop_s: float) -> None:
    singles = cut_uniform(noise_block(700), list(range(700)))
    ends = [w.time_s for _, w in windows_of(FeatureWindows(features=TABLE_II, window_s=window_s, hop_s=hop_s), singles)]
    np.testing.assert_allclose(ends, window_s + hop_s * np.arange(len(ends)), atol=1e-9)


def test_a_window_states_whether_it_has_angular_rate_throughout() -> None:
    block = noise_block(600)
    block.angular_rate_known[210:230] = False
    found = [w for _, w in windows_of(FeatureWindows(features=TABLE_II), [block])]
    assert [w.has_gyroscope for w in found] == [True, False, False, True, True]


def test_after_a_gap_windows_start_again_and_none_spans_it() -> None:
    rng = np.random.default_rng(1)
    time_s = np.concatenate([np.arange(450) / 100, 10.3 + np.arange(450) / 100])
    block = imu(time_s, rng.normal([0, 0, 9.8], 1.0, (900, 3)))
    found = list(feature_windows(FeatureWindows(features=TABLE_II), [block]))
    np.testing.assert_allclose([w.time_s for w in found], [2, 3, 4, 12.3, 13.3, 14.3], atol=1e-9)
    alone = imu(time_s[450:], block.specific_force_mps2[450:])
    second = list(feature_windows(FeatureWindows(features=TABLE_II), [alone]))
    for a, b in zip(found[3:], second, strict=True):
        np.testing.assert_array_equal(a.features, b.features)
