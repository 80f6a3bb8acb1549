from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import cut_uniform, uniform_block
from scipy.spatial.transform import Rotation

from pdr_filter.sensing.attitude import (
    AttitudeBlock,
    AttitudeEstimator,
    AttitudeState,
    _horizontal,
    _mean_up_and_vector,
)
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.device import Device
from pdr_filter.sensing.gyroscope_bias import GyroBias
from pdr_filter.values import STANDARD_GRAVITY_MPS2

# Sensor-to-world attitudes: up in the sensor frame is the third row of the rotation matrix.
TILTS = {
    "face up": Rotation.identity(),
    "reading": Rotation.from_euler("x", 40, degrees=True),
    "upright": Rotation.from_euler("x", 90, degrees=True),
    "upside down in the pocket": Rotation.from_euler("xy", [-80, 25], degrees=True),
    "on its side": Rotation.from_euler("y", -90, degrees=True),
    "face down": Rotation.from_euler("x", 180, degrees=True),
}


def samples(
    up_sensor: np.ndarray, turn_rate_radps: np.ndarray, known: bool = True, rate_hz: float = 100.0
) -> UniformBlock:
    """A phone that turns counter-clockwise (seen from above) about the vertical and feels gravity only."""
    n = len(turn_rate_radps)
    rate = turn_rate_radps[:, None] * up_sensor if known else None
    block = uniform_block(np.full(n, STANDARD_GRAVITY_MPS2), rate_hz, rate=rate)
    return replace(block, specific_force_mps2=np.tile(STANDARD_GRAVITY_MPS2 * up_sensor, (n, 1)))


def attitude_of(block: UniformBlock, edges: list[int] | None = None) -> tuple[AttitudeState, list[AttitudeBlock]]:
    estimator = AttitudeEstimator()
    state, outputs = estimator.init(), []
    for piece in cut_uniform(block, edges or []):
        state, attitude = estimator.update(state, piece)
        outputs.append(attitude)
    return state, outputs


def moving(attitudes: Rotation, rate_hz: float = 100.0, bias_radps: np.ndarray | None = None) -> UniformBlock:
    """A phone in given sensor-to-world attitudes, the first before the first sample, that feels gravity only."""
    n = len(attitudes) - 1
    rate = (attitudes[:-1].inv() * attitudes[1:]).as_rotvec() * rate_hz
    block = samples(np.array([0.0, 0.0, 1.0]), np.zeros(n), rate_hz=rate_hz)
    up = attitudes[1:].inv().apply([0.0, 0.0, 1.0])
    return replace(
        block,
        specific_force_mps2=STANDARD_GRAVITY_MPS2 * up,
        angular_rate_radps=rate + (0.0 if bias_radps is None else bias_radps),
    )


def about(axis: str, angle_rad: np.ndarray) -> Rotation:
    return Rotation.from_rotvec(np.outer(angle_rad, np.eye(3)["xyz".index(axis)]))


def a_walk(seconds: int, seed: int, bias_radps: np.ndarray) -> tuple[UniformBlock, np.ndarray, np.ndarray]:
    """A phone held in front that bobs, turns corners of a second, stands now and then, and feels a magnetic field.

    Noisy samples, heading (N,) and up (N, 3) of the sensor.
    """
    rng = np.random.default_rng(seed)
    n = 100 * seconds
    time_s = np.arange(n + 1) / 100
    is_walking = (time_s % 40) > 6
    corner = np.floor(time_s / 15) + np.clip(time_s % 15 - 14, 0, 1)
    heading = np.pi / 2 * corner + np.where(is_walking, 0.05 * np.sin(2 * np.pi * time_s), 0.0)
    nod = 0.7 + np.where(is_walking, 0.05 * np.sin(4 * np.pi * time_s), 0.0)
    attitudes = about("z", -heading) * about("x", nod)
    block = moving(attitudes, bias_radps=bias_radps)
    up = attitudes[1:].inv().apply([0.0, 0.0, 1.0])
    bob = np.where(is_walking, 3 * np.sin(4 * np.pi * time_s), 0.0)[1:]
    noisy = replace(
        block,
        specific_force_mps2=block.specific_force_mps2 + bob[:, None] * up + rng.normal(scale=0.05, size=(n, 3)),
        angular_rate_radps=block.angular_rate_radps + rng.normal(scale=0.01, size=(n, 3)),
        magnetic_field_ut=attitudes[1:].inv().apply([3.0, 20.0, -40.0]) + rng.normal(size=(n, 3)),
        magnetic_field_known=np.full(n, True),
    )
    return noisy, heading[1:], up


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
    rate = np.full(1300, 0.5)  # more than a full turn, which is not wrapped
    _, [attitude] = attitude_of(samples(up_sensor, rate))
    np.testing.assert_allclose(attitude.device_heading_rad, -np.cumsum(rate) / 100, atol=1e-4)
    np.testing.assert_allclose(attitude.up_sensor[-1], up_sensor, atol=1e-4)


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 200.0])
@pytest.mark.parametrize("tilt", ["reading", "upside down in the pocket"])
def test_a_wobble_does_not_change_the_heading_after_any_number_of_revolutions(tilt: str, rate_hz: float) -> None:
    t = np.arange(int(20 * rate_hz) + 1) / rate_hz
    around = 2 * np.pi * t  # up moves around a cone of 12 degrees once a second
    axis = np.column_stack([np.cos(around), np.sin(around), np.zeros(len(t))])
    attitudes = Rotation.from_rotvec(np.deg2rad(12) * axis) * TILTS[tilt]
    block = moving(attitudes, rate_hz)
    estimator = AttitudeEstimator(rate_hz=rate_hz)
    _, attitude = estimator.update(estimator.init(), block)
    integral = -np.cumsum((block.angular_rate_radps * attitude.up_sensor).sum(axis=1)) / rate_hz
    assert abs(integral[-1]) > 20 * 2 * np.pi * (1 - np.cos(np.deg2rad(12))) * 0.9
    # back at the first attitude after each second
    whole = np.arange(1, 21) * int(rate_hz) - 1
    assert np.abs(attitude.device_heading_rad[whole]).max() < 0.03
    assert np.abs(attitude.device_heading_rad).max() < 0.1


def test_turning_counts_the_same_while_the_phone_swings_by_80_degrees() -> None:
    t = np.arange(3001) / 100
    swing = np.deg2rad(40) * np.sin(2 * np.pi * t)
    attitudes = about("z", -0.4 * t) * about("x", np.deg2rad(60) + swing)
    _, [attitude] = attitude_of(moving(attitudes))
    assert attitude.device_heading_rad[-1] == pytest.approx(12.0, abs=0.05)


def test_the_heading_follows_a_phone_that_is_put_upright_into_a_pocket() -> None:
    t = np.arange(1501) / 100
    tilt = np.interp(t, [5, 6], [np.deg2rad(30), np.deg2rad(160)])
    heading = np.interp(t, [0, 5, 8, 12], [0.0, 1.0, 1.0, 3.0])
    attitudes = about("z", -heading) * about("x", tilt)
    _, [attitude] = attitude_of(moving(attitudes))
    assert attitude.device_heading_rad[499] == pytest.approx(1.0, abs=0.01)
    assert attitude.device_heading_rad[-1] == pytest.approx(3.0, abs=0.05)


def test_the_vertical_force_is_the_force_along_up_less_gravity() -> None:
    up = TILTS["reading"].inv().apply([0.0, 0.0, 1.0])
    block = samples(up, np.zeros(400))
    bob_mps2 = 2.0 * np.sin(2 * np.pi * 2 * block.time_s)
    bobbing = replace(block, specific_force_mps2=block.specific_force_mps2 + bob_mps2[:, None] * up)
    _, [attitude] = attitude_of(bobbing)
    np.testing.assert_allclose(attitude.vertical_mps2, bob_mps2, atol=1e-6)


def test_without_angular_rate_up_is_still_known_and_the_heading_stands_still(up_sensor: np.ndarray) -> None:
    _, [attitude] = attitude_of(samples(up_sensor, np.full(300, 0.5), known=False))
    np.testing.assert_array_equal(attitude.device_heading_rad, np.zeros(300))
    np.testing.assert_allclose(attitude.up_sensor[-1], up_sensor, atol=1e-6)


def test_when_the_angular_rate_goes_missing_the_heading_stays_where_it_was() -> None:
    estimator, up = AttitudeEstimator(), np.array([0.0, 0.0, 1.0])
    # a bias of 1 deg/s, estimated at rest, must not turn the heading while the rate is missing
    state, rest = estimator.update(estimator.init(), samples(up, np.full(2000, np.deg2rad(1.0))))
    late_drift = rest.device_heading_rad[-1] - rest.device_heading_rad[-500]
    assert abs(late_drift) < 0.1 * np.deg2rad(5.0)
    state, missing = estimator.update(state, samples(up, np.zeros(300), known=False))
    np.testing.assert_array_equal(missing.device_heading_rad, rest.device_heading_rad[-1])


def test_after_a_gap_up_is_estimated_again_and_the_heading_continues() -> None:
    estimator = AttitudeEstimator()
    flat, upright = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    state, before = estimator.update(estimator.init(), samples(flat, np.full(1000, -0.3)))
    state, after = estimator.update(estimator.after_gap(state), samples(upright, np.zeros(100)))
    np.testing.assert_allclose(after.up_sensor[20:], np.tile(upright, (80, 1)), atol=1e-3)
    assert after.device_heading_rad[0] == pytest.approx(before.device_heading_rad[-1], abs=1e-3)


@pytest.mark.parametrize("bias", [0.0, 0.02, 0.1])
def test_a_biased_phone_in_corridors_drifts_less_the_longer_it_is_carried(bias: float) -> None:
    block, heading, _ = a_walk(120, 1, bias * np.array([0.0, np.sin(0.7), np.cos(0.7)]))
    _, [attitude] = attitude_of(block)
    error = attitude.device_heading_rad - heading
    assert abs(error[-1] - error[-6000]) < 60 * 0.003
    assert abs(error[-1]) < 0.05 + 0.25 * 120 * bias


def test_the_bias_of_all_axes_is_subtracted_before_the_inclination_is_estimated() -> None:
    # uncorrected, 0.1 rad/s about a level axis and 3 s to correct it tilt the vertical by up to 0.3 rad
    block, _, up = a_walk(80, 2, np.array([0.1, 0.0, 0.0]))
    _, [attitude] = attitude_of(block)
    tilt = np.arccos(np.clip((attitude.up_sensor * up).sum(axis=1), -1, 1))
    assert tilt[800:].max() < 0.1


def test_the_standard_deviation_of_the_heading_rate_shrinks_and_is_about_the_vertical() -> None:
    # the field determines the bias about up, so the remaining error is about the other axes
    block, _, _ = a_walk(60, 3, np.zeros(3))
    no_rest = GyroBias(still_gyr_radps=1e-9)
    estimator = AttitudeEstimator(bias=no_rest)
    # the last half second still has the error of the whole windows before
    state, attitude = estimator.update(estimator.init(), cut_uniform(block, [5950])[0])
    prior = np.sqrt(np.dot(no_rest.prior_prob, np.square(no_rest.prior_std_radps)))
    np.testing.assert_allclose(attitude.yaw_bias_std_radps[:100], prior, rtol=1e-9)
    assert attitude.yaw_bias_std_radps[-1] < 0.3 * prior
    cov = state.bias.bias_cov_radps2
    about_x = np.sqrt(cov[0, 0])
    assert about_x > 1.5 * attitude.yaw_bias_std_radps[-1]
    up = attitude.up_sensor[-1]
    assert np.sqrt(up @ cov @ up) == pytest.approx(attitude.yaw_bias_std_radps[-1], rel=1e-9)


def test_a_step_changes_neither_the_samples_nor_the_old_state() -> None:
    estimator = AttitudeEstimator()
    block = samples(np.array([0.0, 0.6, 0.8]), np.full(200, 0.1))
    force, rate = block.specific_force_mps2.copy(), block.angular_rate_radps.copy()
    state, _ = estimator.update(estimator.init(), block)
    _, once = estimator.update(state, block)
    _, again = estimator.update(state, block)
    np.testing.assert_array_equal(once.device_heading_rad, again.device_heading_rad)
    np.testing.assert_array_equal(once.up_sensor, again.up_sensor)
    np.testing.assert_array_equal(block.specific_force_mps2, force)
    np.testing.assert_array_equal(block.angular_rate_radps, rate)


def test_a_complete_bias_window_counts_before_the_next_sample_arrives() -> None:
    block, _, _ = a_walk(20, 5, np.array([0.02, 0.0, 0.0]))
    first, second = cut_uniform(block, [1000])
    estimator = AttitudeEstimator()
    state, _ = estimator.update(estimator.init(), first)
    later, _ = estimator.update(state, cut_uniform(second, [1])[0])
    expected = later.bias.bias_radps
    assert not np.array_equal(state.bias.bias_radps, expected)
    np.testing.assert_array_equal(estimator.bias_state(state).bias_radps, expected)
    np.testing.assert_array_equal(estimator.after_gap(state).bias.bias_radps, expected)
    np.testing.assert_array_equal(estimator.bias_state(later).bias_radps, expected)


def test_a_change_of_the_bias_gives_the_attitude_that_is_estimated_with_the_new_bias() -> None:
    bias = 0.02 * np.array([0.0, np.sin(0.7), np.cos(0.7)])
    block, _, _ = a_walk(60, 6, bias)
    before, known = AttitudeEstimator(), AttitudeEstimator(bias=GyroBias(device=Device(bias, 1e-6 * np.eye(3))))
    first, expected, other = before.init(), known.init(), known.init()
    turn_rad = 0.0
    for part in cut_uniform(block, [1730, 1750, 4000]):
        first, old = before.update(first, part)
        expected, wanted = known.update(expected, part)
        other, found = known.with_other_bias(other.bias, turn_rad, part, (first, old))
        turn = found.device_heading_rad - old.device_heading_rad
        turn_rad = turn[-1]
        np.testing.assert_allclose(found.device_heading_rad, wanted.device_heading_rad, atol=0.01)
        np.testing.assert_allclose(found.heading_error_rad, wanted.heading_error_rad, atol=0.01)
        for name in ("yaw_bias_std_radps", "heading_error_var_rad2", "heading_lost_var_rad2"):
            np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=0.05, atol=1e-6)
        np.testing.assert_allclose(other.bias.bias_radps, expected.bias.bias_radps, atol=2e-4)
        assert other.device_heading_rad == found.device_heading_rad[-1]
        # the axes of the phone turn with its heading, and not up
        attitudes = (Rotation.from_quat(a.quat[:, [1, 2, 3, 0]]) for a in (old, found))
        old_axes, axes = (attitude.as_matrix() for attitude in attitudes)
        np.testing.assert_allclose(axes, about("z", -turn).as_matrix() @ old_axes, atol=1e-12)
        np.testing.assert_allclose(found.horizontal_mps2, _horizontal(found.quat, part.specific_force_mps2), atol=1e-9)
    assert turn_rad > 0.1


def test_rotated_vectors_agree_with_the_rotations_of_scipy() -> None:
    rng = np.random.default_rng(8)
    quat, vectors = rng.normal(size=(40, 4)), rng.normal(size=(40, 3))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    attitude = Rotation.from_quat(quat[:, [1, 2, 3, 0]])
    up_sensor, mean = _mean_up_and_vector(quat, np.column_stack([vectors, np.ones(40)]), vectors.mean(axis=0))
    np.testing.assert_allclose(mean, attitude.apply(vectors).mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(up_sensor, attitude.inv().apply([0.0, 0.0, 1.0]).mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(_horizontal(quat, vectors), attitude.apply(vectors)[:, :2], atol=1e-12)
