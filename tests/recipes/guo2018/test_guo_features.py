from __future__ import annotations

import statistics

import numpy as np
import pytest
from helpers import uniform_block
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pdr_filter.recipes.guo2018.features import (
    NAMES,
    WITHOUT_LIGHT_AND_PROXIMITY,
    MotionLevel,
    PoseWindow,
    PoseWindows,
    pitch_and_roll,
    pose_features,
)
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock


def literal_features(window: np.ndarray) -> list[float]:
    """Table 1, row after row."""
    found: list[float] = []
    for row in window[:2].tolist():
        rms = (sum(v**2 for v in row) / len(row)) ** 0.5
        found += [sum(row) / len(row), statistics.median(row), max(row), min(row), rms, max(row) - min(row)]
    for row in window[2:].tolist():
        rms = (sum(v**2 for v in row) / len(row)) ** 0.5
        found += [sum(row) / len(row), statistics.median(row), rms]
    return found


def up_of(rotation: Rotation) -> np.ndarray:
    """Up in the sensor frame for a sensor-to-world rotation: what its matrix's last row says."""
    return rotation.as_matrix()[..., 2, :]


def samples(n: int, seed: int = 0) -> tuple[UniformBlock, AttitudeBlock]:
    rng = np.random.default_rng(seed)
    block = uniform_block(9.8 + rng.normal(size=n), rate=rng.normal(size=(n, 3)))
    up = up_of(Rotation.random(n, random_state=seed))
    return block, AttitudeBlock(np.zeros(n), np.zeros((n, 2)), up, np.zeros(n))


def windows_of(stage: PoseWindows, block: UniformBlock, attitude: AttitudeBlock) -> list[tuple[int, PoseWindow]]:
    return stage.update(stage.init(), block, attitude)[1]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(1, 80), rows=st.sampled_from([2, 4]))
def test_every_feature_equals_its_row_of_table_1(seed: int, n: int, rows: int) -> None:
    rng = np.random.default_rng(seed)
    window = np.stack([rng.uniform(-1.5, 1.5, n), rng.uniform(-1.5, 1.5, n), *rng.uniform(0, 900, (rows - 2, n))])
    np.testing.assert_allclose(pose_features(window), literal_features(window), rtol=1e-9, atol=1e-12)


def test_there_are_18_distinct_names_of_which_12_need_no_ambient_sensor() -> None:
    assert len(set(NAMES)) == len(NAMES) == 18
    assert len(WITHOUT_LIGHT_AND_PROXIMITY) == 12
    assert not any("light" in n or "proximity" in n for n in WITHOUT_LIGHT_AND_PROXIMITY)
    assert (NAMES[5], NAMES[6], NAMES[12], NAMES[17]) == ("range_pitch", "mean_roll", "mean_light", "rms_proximity")


def test_the_12_features_are_the_first_of_the_18() -> None:
    window = np.random.default_rng(0).uniform(0, 1, (4, 60))
    np.testing.assert_array_equal(pose_features(window[:2]), pose_features(window)[:12])


@settings(max_examples=100, deadline=None)
@given(yaw=st.floats(-3.1, 3.1), pitch=st.floats(-1.5, 1.5), roll=st.floats(-3.1, 3.1), other_yaw=st.floats(-3.1, 3.1))
def test_pitch_and_roll_are_those_of_the_rotation_matrix_whatever_the_yaw(
    yaw: float, pitch: float, roll: float, other_yaw: float
) -> None:
    # capital letters: about the turned axes, so the matrix is R_z(yaw) R_x(pitch) R_y(roll)
    ups = up_of(Rotation.from_euler("ZXY", [[yaw, pitch, roll], [other_yaw, pitch, roll]]))
    pitches, rolls = pitch_and_roll(ups)
    np.testing.assert_allclose(pitches, pitch, atol=1e-9)
    np.testing.assert_allclose(rolls, roll, atol=1e-9)


def test_a_vector_a_little_longer_than_one_has_a_pitch() -> None:
    (pitch,), _ = pitch_and_roll(np.array([[0.0, 1.0 + 1e-12, 0.0]]))
    assert pitch == pytest.approx(np.pi / 2)


def test_a_phone_that_rocks_about_face_down_has_a_small_range_of_roll() -> None:
    rocking = np.pi + 0.1 * np.sin(np.linspace(0, 12, 60))
    wrapped = (rocking + np.pi) % (2 * np.pi) - np.pi
    assert np.ptp(wrapped) > 6
    features = dict(zip(NAMES, pose_features(np.stack([np.zeros(60), wrapped])), strict=False))
    assert features["range_roll"] == pytest.approx(np.ptp(rocking))
    assert abs(features["mean_roll"]) == pytest.approx(np.pi, abs=0.1)


@settings(max_examples=30, deadline=None)
@given(turns=st.integers(-3, 3), seed=st.integers(0, 1000))
def test_full_turns_of_roll_change_nothing(turns: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    window = np.cumsum(rng.normal(0, 0.2, (2, 60)), axis=1)
    turned = window + np.array([[0.0], [2 * np.pi * turns]])
    np.testing.assert_allclose(pose_features(turned), pose_features(window), atol=1e-9)


def test_a_window_holds_the_features_and_the_level_of_its_own_samples() -> None:
    block, attitude = samples(240)
    rows = np.stack(pitch_and_roll(attitude.up_sensor))
    _, level, has_rate = MotionLevel().update(MotionLevel().init(), block)
    found = windows_of(PoseWindows(hop_s=0.3), block, attitude)
    assert len(found) == 7
    for index, window in found:
        own = np.ascontiguousarray(rows[:, index - 59 : index + 1])
        np.testing.assert_array_equal(window.features, pose_features(own))
        assert (window.level, window.has_gyroscope) == (level[index], has_rate[index])
