"""Gravity is restored in walks whose acceleration lacks it, and refused where nobody walks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pdr_filter as pdr
from pdr_filter.sensing.gravity import with_gravity
from pdr_filter.simulate import Leg, phone_motion
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, Samples

LEGS = [
    Leg("walking", distance_m=40.0),
    Leg("walking", distance_m=30.0, turn_rad=1.2),
    Leg("walking", distance_m=20.0, turn_rad=-1.5),
]
RATE_HZ = 50.0


def walk_of(carrying_mode: str, seed: int = 1) -> tuple[pdr.Recording, FloatArray]:
    """A simulated walk with exact sensors, and up in the sensor frame (N, 3)."""
    motion = phone_motion(LEGS, carrying_mode=carrying_mode, seed=seed)
    time_s = np.arange(0.0, motion.grid_s[-1], 1 / RATE_HZ)
    up = motion.rotation(time_s).inv().apply([0.0, 0.0, 1.0])
    force = Samples(time_s, motion.specific_force_mps2(time_s))
    return pdr.Recording("walk", force, Samples(time_s, motion.angular_rate_radps(time_s))), up


def linear_of(recording: pdr.Recording, up: FloatArray) -> Samples:
    force = recording.accelerometer
    return Samples(force.time_s, force.values - STANDARD_GRAVITY_MPS2 * up)


def angles_deg(restored: Samples, linear: Samples, up: FloatArray) -> FloatArray:
    """Angles between the restored and the true vertical."""
    gravity = restored.values - linear.values
    return np.degrees(np.arccos(np.clip((gravity * up).sum(axis=1) / STANDARD_GRAVITY_MPS2, -1.0, 1.0)))


def turning_walk(turns: Rotation) -> tuple[Samples, Samples, FloatArray]:
    """Linear acceleration and angular rate of a level phone, seen in a sensor frame that `turns` has rotated.

    The person bobs at 2 Hz, surges forward a quarter of a step later and half as much, and walks a circle.
    """
    time_s = np.arange(0.0, 40.0, 0.01)
    phase, turn_radps = 2 * np.pi * 2.0 * time_s, 0.3
    noise = np.random.default_rng(0).normal(0.0, 1e-4, (len(time_s), 3))  # a constant axis would count as stuck
    body = noise + np.column_stack([0.0 * time_s, 1.5 * np.cos(phase), 3.0 * np.sin(phase)])
    rate = noise + np.array([0.0, 0.0, turn_radps])
    up = np.tile(turns.inv().apply([0.0, 0.0, 1.0]), (len(time_s), 1))
    return Samples(time_s, turns.inv().apply(body)), Samples(time_s, turns.inv().apply(rate)), up


@pytest.mark.parametrize("tilt_deg", [0.0, 40.0, 80.0])
def test_the_vertical_of_bobbing_and_turning_is_exact_at_any_tilt(tilt_deg: float) -> None:
    linear, rate, up = turning_walk(Rotation.from_euler("xyz", [tilt_deg, 10.0, 30.0], degrees=True))
    assert angles_deg(with_gravity(linear, rate).force, linear, up).max() < 0.5


@pytest.mark.parametrize("carrying_mode", ["texting", "pocket", "swinging"])
def test_the_vertical_of_a_simulated_walk_is_found_with_its_sense(carrying_mode: str) -> None:
    recording, up = walk_of(carrying_mode)
    linear = linear_of(recording, up)
    restored = with_gravity(linear, recording.gyroscope)
    assert np.median(angles_deg(restored.force, linear, up)) < 15.0
    assert restored.is_sense_sure
    np.testing.assert_array_equal(restored.force.time_s, linear.time_s)


@pytest.mark.parametrize("carrying_mode", ["texting", "pocket"])
def test_steps_and_path_are_those_of_the_walk_with_gravity(carrying_mode: str) -> None:
    recording, up = walk_of(carrying_mode)
    restored = with_gravity(linear_of(recording, up), recording.gyroscope).force
    with_it, without = pdr.track(recording), pdr.track(replace(recording, accelerometer=restored))
    assert without.n_steps == pytest.approx(with_it.n_steps, rel=0.03)
    assert np.linalg.norm(without.position_m[-1] - with_it.position_m[-1]) < 0.05 * with_it.distance_m


def test_a_phone_that_turns_in_the_hand_keeps_its_vertical() -> None:
    linear, rate, up = turning_walk(Rotation.identity())
    half = len(linear) // 2
    # within half a second the phone is turned by a right angle about its x axis
    angle = np.clip((linear.time_s - linear.time_s[half]) / 0.5, 0.0, 1.0) * np.pi / 2
    turns = Rotation.from_rotvec(np.outer(angle, [1.0, 0.0, 0.0]))
    extra = np.where((angle > 0) & (angle < np.pi / 2), np.pi, 0.0)
    values = turns.inv().apply(np.array(rate.values)) + np.outer(extra, [1.0, 0.0, 0.0])
    turned = Samples(linear.time_s, turns.inv().apply(np.array(linear.values)))
    restored = with_gravity(turned, Samples(linear.time_s, values))
    assert np.median(angles_deg(restored.force, turned, turns.inv().apply(up))) < 3.0
    assert np.percentile(angles_deg(restored.force, turned, turns.inv().apply(up)), 95) < 12.0


def test_without_a_gyroscope_the_steps_are_found() -> None:
    recording, up = walk_of("texting")
    restored = with_gravity(linear_of(recording, up)).force
    with_it = pdr.track(replace(recording, gyroscope=None))
    without = pdr.track(replace(recording, accelerometer=restored, gyroscope=None))
    assert without.n_steps == pytest.approx(with_it.n_steps, rel=0.03)
    assert without.distance_m == pytest.approx(with_it.distance_m, rel=0.1)


@pytest.mark.parametrize(("later_s", "silent_s"), [(50.0, 0.0), (40.0, 1.0)], ids=["gap", "silent gyroscope"])
def test_a_phone_that_turned_in_a_gap_or_while_the_gyroscope_was_silent_has_a_new_vertical(
    later_s: float, silent_s: float
) -> None:
    linear, rate, up = turning_walk(Rotation.identity())
    second, second_rate, second_up = turning_walk(Rotation.from_euler("x", 70.0, degrees=True))
    time_s = np.concatenate([linear.time_s, linear.time_s + later_s])
    both = Samples(time_s, np.vstack([linear.values, second.values]))
    rates = np.vstack([rate.values, second_rate.values])
    rates[np.abs(time_s - 40.0) < silent_s] = np.nan
    error_deg = angles_deg(with_gravity(both, Samples(time_s, rates)).force, both, np.vstack([up, second_up]))
    assert error_deg[np.abs(time_s - 40.0) >= 1.1 * silent_s].max() < 0.5


@pytest.mark.parametrize("what", ["rest", "noise", "one shake", "5 s of walking", "nothing finite"])
def test_a_recording_in_which_nobody_walks_is_refused(what: str) -> None:
    linear, rate, _ = turning_walk(Rotation.identity())
    rng = np.random.default_rng(0)
    values = {
        "rest": rng.normal(0.0, 0.02, linear.values.shape),
        "noise": rng.normal(0.0, 3.0, linear.values.shape),
        "one shake": linear.values * (np.abs(linear.time_s - 20.0) < 1.0)[:, None],
        "5 s of walking": linear.values * (linear.time_s < 5.0)[:, None],
        "nothing finite": np.full_like(linear.values, np.nan),
    }[what]
    with pytest.raises(ValueError, match="nobody walks in it for 12 s"):
        with_gravity(Samples(linear.time_s, values), rate)


@pytest.mark.recordings
@pytest.mark.parametrize("name", ["oxiod_anon_floor1_handheld1", "oxiod_anon_floor1_pocket4"])
def test_a_real_walk_keeps_its_steps_and_its_shape(data_dir: Path, name: str) -> None:
    from tests.benchmarks.without_gravity import shape_m, up_of_phone

    recording = pdr.read(data_dir / "oxiod" / f"{name}.zip")
    linear = linear_of(recording, up_of_phone(recording))
    restored = with_gravity(linear, recording.gyroscope)
    with_it = pdr.track(recording)
    without = pdr.track(replace(recording, accelerometer=restored.force))
    assert without.n_steps == pytest.approx(with_it.n_steps, rel=0.03)
    assert shape_m(recording, without) < max(1.5 * shape_m(recording, with_it), 0.01 * with_it.distance_m)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_swinging_phone_shows_up_although_its_screen_faces_any_way(seed: int) -> None:
    recording, up = walk_of("swinging", seed)
    assert recording.gyroscope is not None
    for turned in (
        Rotation.identity(),
        Rotation.from_euler("x", 180.0, degrees=True),
        Rotation.from_rotvec([1.5, 0, 0]),
    ):
        linear = linear_of(recording, up)
        linear = Samples(linear.time_s, turned.apply(np.array(linear.values)))
        rate = Samples(linear.time_s, turned.apply(np.array(recording.gyroscope.values)))
        assert np.median(angles_deg(with_gravity(linear, rate).force, linear, turned.apply(up))) < 20.0


def test_the_pivot_of_a_pendulum_is_above_it_although_the_screen_faces_down() -> None:
    time_s = np.arange(0.0, 40.0, 0.01)
    phase = 2 * np.pi * time_s  # the arm swings at 1 Hz; steps have 2 Hz, in phase with the squared rate
    rate = np.random.default_rng(0).normal(0.0, 1e-4, (len(time_s), 3))
    rate[:, 0] += 0.5 * np.cos(phase)
    force = np.random.default_rng(1).normal(0.0, 1e-4, (len(time_s), 3))
    force[:, 1] -= 0.8 * np.pi * np.sin(phase)  # dw/dt x r, with the phone 0.8 m below the pivot
    force[:, 1] += 1.5 * np.sin(2 * phase)
    force[:, 2] += 3.0 * np.cos(2 * phase)
    down = Rotation.from_euler("x", 180.0, degrees=True)
    restored = with_gravity(Samples(time_s, down.apply(force)), Samples(time_s, down.apply(rate))).force
    assert restored.values.mean(axis=0)[2] < -9.0
