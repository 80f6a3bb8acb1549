from __future__ import annotations

import numpy as np
import pytest
from helpers import imu
from scipy.spatial.transform import Rotation

from pdr_filter.sensing.features.feature_windows import ATTITUDE_FREE, FeatureWindows
from pdr_filter.sensing.features.invariant import (
    NAMES,
    STEP_LAGS_S,
    WITHOUT_GYROSCOPE,
    features_in_groups,
    invariant_features_of_motion,
)
from pdr_filter.sensing.front_end import feature_windows
from pdr_filter.values import ImuBlock

WINDOWS = FeatureWindows(features=ATTITUDE_FREE)


def walk_block(turn: Rotation | None = None, seed: int = 0) -> ImuBlock:
    rng = np.random.default_rng(seed)
    t = np.arange(1200) / 100
    force = np.column_stack(
        [
            0.6 * np.sin(2 * np.pi * 0.95 * t),
            1.0 * np.sin(2 * np.pi * 1.9 * t + 1.0),
            9.81 + 2.5 * np.sin(2 * np.pi * 1.9 * t),
        ]
    ) + 0.1 * rng.normal(size=(1200, 3))
    rate = np.column_stack([0.8 * np.sin(2 * np.pi * 0.95 * t), np.zeros(1200), 0.2 * np.sin(2 * np.pi * 0.95 * t)])
    rate += 0.01 * rng.normal(size=(1200, 3))
    if turn is not None:
        force, rate = turn.apply(force), turn.apply(rate)
    return imu(t, force, rate)


def invariant_features(windows: np.ndarray) -> np.ndarray:
    return features_in_groups(invariant_features_of_motion, windows, 100.0, len(NAMES))


def features(block: ImuBlock) -> np.ndarray:
    return np.array([w.features[: len(NAMES)] for w in feature_windows(WINDOWS, [block])])


@pytest.mark.parametrize("seed", range(4))
def test_turning_the_phone_in_the_pocket_changes_no_feature(seed: int) -> None:
    turn = Rotation.random(random_state=seed)
    np.testing.assert_allclose(features(walk_block(turn)), features(walk_block()), atol=2e-3, rtol=2e-3)


def test_a_person_who_steps_at_another_rate_has_other_features() -> None:
    found = dict(zip(NAMES, features(walk_block())[-1], strict=True))
    assert found["peak_frequency_vertical_hz"] == pytest.approx(2.0, abs=0.26)
    assert found["step_lag_s"] == pytest.approx(1 / 1.9, abs=0.02)
    assert found["step_regularity"] > 0.9
    assert np.exp(found["log_std_vertical"]) == pytest.approx(2.5 / np.sqrt(2), rel=0.05)


def test_features_of_the_accelerometer_do_not_depend_on_the_gyroscope() -> None:
    rng = np.random.default_rng(0)
    windows = rng.normal(size=(3, 12, 200))
    without = windows.copy()
    without[:, 3:6] = 0.0
    n = len(WITHOUT_GYROSCOPE)
    assert NAMES[:n] == WITHOUT_GYROSCOPE
    np.testing.assert_array_equal(invariant_features(without)[:, :n], invariant_features(windows)[:, :n])


def test_a_phone_on_the_table_has_finite_features() -> None:
    windows = np.zeros((1, 12, 200))
    windows[:, 8] = 1.0
    windows[:, 11] = 9.81
    assert np.isfinite(invariant_features(windows)).all()
    assert invariant_features(windows).shape == (1, len(NAMES))
    assert len(set(NAMES)) == len(NAMES)


@pytest.mark.parametrize("n_windows", [2, 31, 32, 33, 70])
def test_a_window_has_the_same_bits_alone_and_among_others(n_windows: int) -> None:
    windows = np.random.default_rng(1).normal(size=(n_windows, 12, 200))
    alone = np.concatenate([invariant_features(window[None]) for window in windows])
    np.testing.assert_array_equal(invariant_features(windows), alone)
    np.testing.assert_array_equal(invariant_features(windows[:0]), alone[:0])


def swinging(tilt_phase_rad: float = 0.0, forward: float = 1.0, amplitude: float = 1.0) -> dict[str, float]:
    """Features of a limb that swings once a stride of 1 s about x; the body bounces twice and is pushed along y."""
    t = np.arange(200) / 100
    window = np.zeros((1, 12, 200))
    window[:, 8] = 1.0
    window[:, 0] = 2.0 * np.cos(2 * np.pi * 2 * t)
    window[:, 3] = amplitude * np.cos(2 * np.pi * t + tilt_phase_rad)
    window[:, 10] = -forward * np.sin(2 * np.pi * 2 * t)  # minus the vertical velocity: forward is +y
    window[:, 2] = window[:, 10]
    window[:, 11] = 9.81 + window[:, 0]
    return dict(zip(NAMES, invariant_features(window)[0], strict=True))


def test_the_square_of_a_swing_in_phase_with_the_bounce_follows_it_without_delay() -> None:
    found = swinging()
    lags = {lag: found[f"squared_swing_rate_follows_vertical_{lag:+g}_s"] for lag in STEP_LAGS_S}
    # cos^2 has the bounce's frequency and phase; the window ends where the lag begins, so only its share overlaps
    for lag, value in lags.items():
        assert value == pytest.approx(np.cos(2 * np.pi * 2 * lag) * (1 - abs(lag) / 2), abs=0.05)


def test_a_swing_a_quarter_stride_later_is_half_a_step_later() -> None:
    found = swinging(np.pi / 2)
    assert found["squared_swing_rate_follows_vertical_+0_s"] == pytest.approx(-1.0, abs=0.03)


def test_swing_repeats_after_a_stride_and_is_opposite_after_half_of_it() -> None:
    found = swinging()
    assert found["swing_repeats_after_0.92_s"] > 0.4
    assert found["swing_repeats_after_0.44_s"] < -0.6


def test_the_force_across_the_swing_points_forward_whichever_way_the_axis_points() -> None:
    there, back = swinging(forward=1.0), swinging(forward=-1.0)
    for lag in STEP_LAGS_S:
        name = f"forward_force_follows_vertical_{lag:+g}_s"
        assert there[name] == pytest.approx(back[name], abs=1e-9)
    # a push that follows minus the velocity of 2 cos(4 pi t): -sin, a quarter of a step of 0.5 s before its negative
    assert there["forward_force_follows_vertical_+0.16_s"] != pytest.approx(0.0, abs=0.2)


def test_timing_does_not_depend_on_how_far_the_limb_swings() -> None:
    small, large = swinging(0.4, amplitude=1.0), swinging(0.4, amplitude=3.0)
    for name in NAMES:
        if "follows_vertical" in name:
            assert small[name] == pytest.approx(large[name], abs=0.02), name
