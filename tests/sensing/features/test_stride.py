from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pdr_filter.sensing.features.invariant import features_in_groups
from pdr_filter.sensing.features.stride import N_HARMONICS, NAMES, stride_features_of_motion

RATE_HZ = 100.0
ORDER = {name: i for i, name in enumerate(NAMES)}


def window(stride_hz: float = 0.9, swing_phase: float = 0.4, start_s: float = 0.0, third: float = 0.0) -> np.ndarray:
    """A walk with the phone in a pocket, sensor axes those of the world: the body bounces, the limb swings about x."""
    t = start_s + np.arange(200) / RATE_HZ
    phase = 2 * np.pi * stride_hz * t
    swing_rate = 1.5 * np.cos(phase + swing_phase)
    across = 1.2 * np.cos(phase + 1.0) + 0.8 * np.cos(2 * phase + 2.0)
    along, vertical = 0.5 * np.cos(phase + 2.5), 2.5 * np.cos(2 * phase) + third * np.cos(3 * phase)
    zeros, ones = np.zeros(200), np.ones(200)
    force = along, across, 9.81 + vertical
    return np.stack([vertical, along, across, swing_rate, zeros, 0.3 * np.cos(phase), zeros, zeros, ones, *force])


def features(*windows: np.ndarray) -> np.ndarray:
    return features_in_groups(stride_features_of_motion, np.array(windows), RATE_HZ, len(NAMES))


def turned(samples: np.ndarray, rotation: Rotation) -> np.ndarray:
    result = samples.copy()
    for rows in (slice(3, 6), slice(6, 9), slice(9, 12)):
        result[rows] = rotation.as_matrix() @ samples[rows]
    return result


@pytest.mark.parametrize("stride_hz", [0.55, 0.8, 1.0, 1.4])
def test_the_frequency_found_is_that_of_the_stride_and_not_of_the_step(stride_hz: float) -> None:
    assert features(window(stride_hz))[0, ORDER["stride_hz"]] == pytest.approx(stride_hz, rel=0.03)


def test_shares_of_harmonics_are_those_of_the_signal() -> None:
    found = features(window(third=1.0))[0]
    shares = [found[ORDER[f"share_of_harmonic_{k}_vertical"]] for k in range(1, N_HARMONICS + 1)]
    assert shares == pytest.approx([0.0, 2.5 / np.hypot(2.5, 1.0), 1.0 / np.hypot(2.5, 1.0), 0.0, 0.0, 0.0], abs=0.06)
    assert found[ORDER["periodic_share_swing_rate"]] == pytest.approx(1.0, abs=0.03)


def test_neither_the_attitude_nor_the_start_of_the_window_matters() -> None:
    plain = features(window())
    for seed in range(3):
        np.testing.assert_allclose(features(turned(window(), Rotation.random(random_state=seed))), plain, atol=1e-9)
    np.testing.assert_allclose(features(window(start_s=0.37)), plain, atol=0.1)


def test_the_phase_of_the_swing_against_the_bounce_is_found_whatever_the_sign_of_its_axis() -> None:
    for phase in (0.0, 0.7, 1.5):
        found = features(window(swing_phase=phase))[0]
        cosine, sine = (found[ORDER[f"{part}_of_phase_swing"]] for part in ("cosine", "sine"))
        assert np.angle((cosine + 1j * sine) * np.exp(-2j * phase)) == pytest.approx(0.0, abs=0.15)


def test_a_window_has_the_same_bits_alone_and_among_others() -> None:
    rng = np.random.default_rng(0)
    windows = np.stack([window(f) for f in rng.uniform(0.5, 1.5, 40)]) + 0.1 * rng.normal(size=(40, 12, 200))
    alone = np.concatenate([features(window) for window in windows])
    np.testing.assert_array_equal(features(*windows), alone)


def test_a_phone_at_rest_has_finite_features() -> None:
    rest = np.zeros((12, 200))
    rest[8], rest[11] = 1.0, 9.81
    assert np.isfinite(features(rest)).all()
