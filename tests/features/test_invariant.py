from __future__ import annotations

import numpy as np
import pytest
from helpers import cut_randomly, imu, sensed
from scipy.spatial.transform import Rotation

from pdr_filter.features.invariant import NAMES, WITHOUT_GYROSCOPE, invariant_features
from pdr_filter.features.windows import FeatureWindow, FeatureWindows
from pdr_filter.sensing import Sensing
from pdr_filter.types import ImuBlock

SENSING = Sensing(windows=FeatureWindows("invariant"))


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


def features(block: ImuBlock) -> np.ndarray:
    events = sensed(SENSING, [block])
    return np.array([e.features for _, e in events if isinstance(e, FeatureWindow)])


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


def test_features_of_the_accelerometer_alone_do_not_see_the_gyroscope() -> None:
    rng = np.random.default_rng(0)
    window = rng.normal(size=(9, 200))
    without = window.copy()
    without[3:6] = 0.0
    n = len(WITHOUT_GYROSCOPE)
    assert NAMES[:n] == WITHOUT_GYROSCOPE
    np.testing.assert_array_equal(invariant_features(without, 100.0)[:n], invariant_features(window, 100.0)[:n])


def test_a_phone_on_the_table_has_finite_features() -> None:
    window = np.zeros((9, 200))
    window[8] = 1.0
    assert np.isfinite(invariant_features(window, 100.0)).all()
    assert len(invariant_features(window, 100.0)) == len(NAMES) == len(set(NAMES))


def test_features_do_not_depend_on_how_samples_arrive() -> None:
    block = walk_block()
    whole = features(block)
    for seed in range(5):
        events = sensed(SENSING, cut_randomly(block, seed))
        pieces = np.array([e.features for _, e in events if isinstance(e, FeatureWindow)])
        np.testing.assert_array_equal(pieces, whole)
