from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from pdr_filter.filter.pedestrian.walking_speed import (
    CONTACT_STD_S,
    SPEED_CHANGE_MPS_PER_SQRT_S,
    WalkingSpeed,
    speed_after_step,
)


def walked(lengths: np.ndarray, durations: np.ndarray, length_var: float = 0.0036, scale_var: float = 0.0) -> list:
    speeds: list[WalkingSpeed] = []
    for length, duration in zip(lengths, durations, strict=True):
        before = speeds[-1] if speeds else None
        speeds.append(speed_after_step(before, float(length), length_var, float(duration), scale_var))
    return speeds


def test_the_speed_of_a_step_is_its_length_over_its_duration() -> None:
    speed = speed_after_step(None, 0.7, 0.0, 0.5, 0.0)
    assert speed.step_mps == speed.smoothed_mps == pytest.approx(1.4)
    assert speed.step_std_mps == pytest.approx(np.sqrt(2) * 1.4 * CONTACT_STD_S / 0.5)


def test_the_smoothed_speed_is_that_of_a_kalman_filter_with_the_stated_or_the_observed_scatter() -> None:
    rng = np.random.default_rng(0)
    lengths, durations = rng.normal(0.7, 0.06, 60), rng.normal(0.55, 0.03, 60)
    durations[30:] += np.where(np.arange(30) % 2, 0.2, -0.2)
    speeds = walked(lengths, durations)
    oracle = KalmanFilter(dim_x=1, dim_z=1)
    oracle.H = np.eye(1)
    oracle.x, oracle.P = np.array([[speeds[0].step_mps]]), np.array([[speeds[0].step_std_mps ** 2]])
    scatter = speeds[0].step_std_mps ** 2
    larger = []
    for speed, duration in zip(speeds[1:], durations[1:], strict=True):
        scatter = 0.95 * scatter + 0.05 * (speed.step_mps - float(oracle.x[0, 0])) ** 2
        larger.append(scatter > speed.step_std_mps**2)
        oracle.predict(F=np.eye(1), Q=np.array([[SPEED_CHANGE_MPS_PER_SQRT_S**2 * duration]]))
        oracle.update(speed.step_mps, R=np.array([[max(speed.step_std_mps**2, scatter)]]))
        assert speed.smoothed_mps == pytest.approx(float(oracle.x[0, 0]), abs=1e-12)
        assert speed.level_var_m2ps2 == pytest.approx(float(oracle.P[0, 0]), abs=1e-12)
        assert speed.smoothed_std_mps**2 == pytest.approx(float(oracle.P[0, 0]) + 0.5 * scatter, abs=1e-12)
    assert not all(larger[:29])
    assert all(larger[45:])


def test_missed_contacts_increase_the_variance_of_the_speed_also_in_the_next_bout() -> None:
    even = walked(np.full(60, 0.7), np.full(60, 0.5))[-1]
    uneven = walked(np.full(60, 0.7), np.where(np.arange(60) % 3, 0.5, 1.0))[-1]
    assert uneven.smoothed_std_mps > 1.5 * even.smoothed_std_mps
    fresh = [speed_after_step(before, 0.7, 0.0036, 0.5, 0.0, is_first=True) for before in (even, uneven)]
    assert fresh[0].smoothed_mps == fresh[1].smoothed_mps == pytest.approx(1.4)
    assert fresh[1].smoothed_std_mps > 1.2 * fresh[0].smoothed_std_mps


def test_limping_is_removed_from_the_smoothed_speed_and_kept_in_the_step_speed() -> None:
    durations = np.where(np.arange(60) % 2, 0.45, 0.55)
    speeds = walked(np.full(60, 0.7), durations)[30:]
    assert np.ptp([s.step_mps for s in speeds]) == pytest.approx(0.7 / 0.45 - 0.7 / 0.55)
    assert np.ptp([s.smoothed_mps for s in speeds]) < 0.4 * (0.7 / 0.45 - 0.7 / 0.55)


def test_errors_that_all_steps_share_do_not_average_out() -> None:
    speeds = walked(np.full(200, 0.7), np.full(200, 0.5), scale_var=0.08**2)
    assert speeds[-1].smoothed_std_mps > 0.08 * 1.4
    assert walked(np.full(200, 0.7), np.full(200, 0.5))[-1].smoothed_std_mps < 0.1
