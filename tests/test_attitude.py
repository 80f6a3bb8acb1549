from __future__ import annotations

import numpy as np
import pytest
from helpers import cut_uniform
from scipy.spatial.transform import Rotation

from pdr_filter.attitude import AttitudeBlock, AttitudeEstimator, AttitudeState
from pdr_filter.conditioning import UniformBlock
from pdr_filter.types import STANDARD_GRAVITY_MPS2

# Sensor-to-world attitudes: up in the sensor frame is the third row of the rotation matrix.
TILTS = {
    "face up": Rotation.identity(),
    "reading": Rotation.from_euler("x", 40, degrees=True),
    "upright": Rotation.from_euler("x", 90, degrees=True),
    "upside down in the pocket": Rotation.from_euler("xy", [-80, 25], degrees=True),
    "on its side": Rotation.from_euler("y", -90, degrees=True),
    "face down": Rotation.from_euler("x", 180, degrees=True),
}


def samples(up_sensor: np.ndarray, turn_rate_radps: np.ndarray, known: bool = True) -> UniformBlock:
    """A phone that turns counter-clockwise (seen from above) about the vertical and feels gravity only."""
    n = len(turn_rate_radps)
    return UniformBlock(
        time_s=(np.arange(n) + 0.5) / 100,
        specific_force_mps2=np.tile(STANDARD_GRAVITY_MPS2 * up_sensor, (n, 1)),
        angular_rate_radps=turn_rate_radps[:, None] * up_sensor if known else np.zeros((n, 3)),
        angular_rate_known=np.full(n, known),
        magnetic_field_ut=np.zeros((n, 3)),
        magnetic_field_known=np.zeros(n, dtype=bool),
        gap_before_s=np.inf,
    )


def attitude_of(block: UniformBlock, edges: list[int] | None = None) -> tuple[AttitudeState, list[AttitudeBlock]]:
    estimator = AttitudeEstimator()
    state, outputs = estimator.init(), []
    for piece in cut_uniform(block, edges or []):
        state, attitude = estimator.step(state, piece)
        outputs.append(attitude)
    return state, outputs


@pytest.fixture(params=TILTS)
def up_sensor(request: pytest.FixtureRequest) -> np.ndarray:
    return TILTS[request.param].inv().apply([0.0, 0.0, 1.0])


def test_a_still_phone_knows_up_from_the_first_sample_and_feels_no_vertical_force(up_sensor: np.ndarray) -> None:
    _, [attitude] = attitude_of(samples(up_sensor, np.zeros(300)))
    np.testing.assert_allclose(attitude.up_sensor, np.tile(up_sensor, (300, 1)), atol=1e-6)
    np.testing.assert_allclose(attitude.vertical_mps2, 0.0, atol=1e-9)
    np.testing.assert_allclose(attitude.horizontal_mps2, 0.0, atol=1e-5)
    np.testing.assert_allclose(attitude.device_heading_rad, 0.0, atol=1e-12)


def test_turning_counter_clockwise_lowers_the_heading_by_the_angle_turned(up_sensor: np.ndarray) -> None:
    rate = np.full(600, 0.5)
    _, [attitude] = attitude_of(samples(up_sensor, rate))
    np.testing.assert_allclose(attitude.device_heading_rad, -np.cumsum(rate) / 100, atol=1e-4)
    np.testing.assert_allclose(attitude.up_sensor[-1], up_sensor, atol=1e-4)


def test_a_full_turn_clockwise_is_not_wrapped() -> None:
    _, [attitude] = attitude_of(samples(np.array([0.0, 1.0, 0.0]), np.full(1000, -2 * np.pi / 10)))
    assert attitude.device_heading_rad[-1] == pytest.approx(2 * np.pi, abs=1e-3)


def test_nodding_is_no_turn() -> None:
    t = (np.arange(1000) + 0.5) / 100
    nod_rad, nod_rate = 0.5 * np.sin(2 * t), np.cos(2 * t)
    up = np.column_stack([np.zeros(1000), np.sin(nod_rad), np.cos(nod_rad)])
    block = samples(np.array([0.0, 0.0, 1.0]), np.zeros(1000))
    rate = np.column_stack([nod_rate, np.zeros((1000, 2))])
    moving = UniformBlock(
        block.time_s,
        STANDARD_GRAVITY_MPS2 * up,
        rate,
        block.angular_rate_known,
        block.magnetic_field_ut,
        block.magnetic_field_known,
        np.inf,
    )
    _, [attitude] = attitude_of(moving)
    assert np.abs(attitude.device_heading_rad).max() < 0.01
    np.testing.assert_allclose(attitude.up_sensor, up, atol=0.05)


def test_the_vertical_force_is_the_force_along_up_less_gravity() -> None:
    up = TILTS["reading"].inv().apply([0.0, 0.0, 1.0])
    block = samples(up, np.zeros(400))
    bob_mps2 = 2.0 * np.sin(2 * np.pi * 2 * block.time_s)
    moving = UniformBlock(
        block.time_s,
        block.specific_force_mps2 + bob_mps2[:, None] * up,
        block.angular_rate_radps,
        block.angular_rate_known,
        block.magnetic_field_ut,
        block.magnetic_field_known,
        np.inf,
    )
    _, [attitude] = attitude_of(moving)
    np.testing.assert_allclose(attitude.vertical_mps2, bob_mps2, atol=1e-6)


def test_without_angular_rate_up_is_still_known_and_the_heading_stands_still(up_sensor: np.ndarray) -> None:
    _, [attitude] = attitude_of(samples(up_sensor, np.full(300, 0.5), known=False))
    np.testing.assert_array_equal(attitude.device_heading_rad, np.zeros(300))
    np.testing.assert_allclose(attitude.up_sensor[-1], up_sensor, atol=1e-6)


def test_when_the_angular_rate_goes_missing_the_heading_stays_where_it_was() -> None:
    estimator, up = AttitudeEstimator(), np.array([0.0, 0.0, 1.0])
    # a bias of 1 deg/s, learnt at rest, must not turn the heading while the rate is missing
    state, rest = estimator.step(estimator.init(), samples(up, np.full(2000, np.deg2rad(1.0))))
    late_drift = rest.device_heading_rad[-1] - rest.device_heading_rad[-500]
    assert abs(late_drift) < 0.1 * np.deg2rad(5.0)
    state, missing = estimator.step(state, samples(up, np.zeros(300), known=False))
    np.testing.assert_array_equal(missing.device_heading_rad, rest.device_heading_rad[-1])


def test_after_a_gap_up_is_found_afresh_and_the_heading_goes_on() -> None:
    estimator = AttitudeEstimator()
    flat, upright = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    state, before = estimator.step(estimator.init(), samples(flat, np.full(1000, -0.3)))
    state, after = estimator.step(estimator.after_gap(state), samples(upright, np.zeros(100)))
    np.testing.assert_allclose(after.up_sensor[20:], np.tile(upright, (80, 1)), atol=1e-3)
    assert after.device_heading_rad[0] == pytest.approx(before.device_heading_rad[-1], abs=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_the_attitude_does_not_depend_on_how_samples_arrive(seed: int) -> None:
    rng = np.random.default_rng(seed)
    block = samples(np.array([0.0, 0.6, 0.8]), rng.normal(size=700))
    noisy = UniformBlock(
        block.time_s,
        block.specific_force_mps2 + rng.normal(size=(700, 3)),
        block.angular_rate_radps + rng.normal(size=(700, 3)),
        rng.random(700) > 0.1,
        block.magnetic_field_ut,
        block.magnetic_field_known,
        np.inf,
    )
    _, [whole] = attitude_of(noisy)
    _, pieces = attitude_of(noisy, list(rng.integers(0, 700, 80)))
    for name in AttitudeBlock.__slots__:
        np.testing.assert_array_equal(np.concatenate([getattr(p, name) for p in pieces]), getattr(whole, name))


def test_a_step_changes_neither_the_samples_nor_the_old_state() -> None:
    estimator = AttitudeEstimator()
    block = samples(np.array([0.0, 0.6, 0.8]), np.full(200, 0.1))
    force, rate = block.specific_force_mps2.copy(), block.angular_rate_radps.copy()
    state, _ = estimator.step(estimator.init(), block)
    _, once = estimator.step(state, block)
    _, again = estimator.step(state, block)
    np.testing.assert_array_equal(once.device_heading_rad, again.device_heading_rad)
    np.testing.assert_array_equal(once.up_sensor, again.up_sensor)
    np.testing.assert_array_equal(block.specific_force_mps2, force)
    np.testing.assert_array_equal(block.angular_rate_radps, rate)
