"""Sensors that are stuck while the phone moves count as missing, but not a phone at rest or a slow sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import condition, imu
from hypothesis import given, settings
from hypothesis import strategies as st

import pdr_filter as pdr
from pdr_filter.sensing.conditioning import MAX_FIELD_UT, Conditioner
from pdr_filter.sensing.stuck_sensors import init_watchdog, remove_stuck_values
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import Samples
from pdr_filter.values.recording import Recording

RATE_HZ = 100.0
RNG = np.random.default_rng(2)


def moving(n: int) -> np.ndarray:
    """Specific force and angular rate (n, 6) of a pedestrian."""
    t = np.arange(n)[:, None] / RATE_HZ
    wave = np.sin(2 * np.pi * 1.9 * t + np.arange(6))
    return np.array([0.0, 0.0, 9.8, 0.0, 0.0, 0.0]) + wave * [2.0, 2.0, 3.0, 0.5, 0.5, 0.5]


def with_field(motion: np.ndarray) -> np.ndarray:
    """Motion (n, 6) with a noisy magnetic field."""
    field = np.random.default_rng(3).normal(scale=0.3, size=(len(motion), 3))
    return np.column_stack([motion, np.array([20.0, 0.0, -40.0]) + field])


def watched(motion: np.ndarray) -> np.ndarray:
    return remove_stuck_values(init_watchdog(), np.arange(len(motion)) / RATE_HZ, with_field(motion))[1]


@pytest.mark.parametrize("axis", range(6))
def test_a_stuck_axis_makes_its_sensor_missing_until_it_changes_again(axis: int) -> None:
    motion = moving(2000)
    motion[500:1200, axis] = 9.8 if axis < 3 else 0.3
    missing = np.isnan(watched(motion)[:, :6]).reshape(-1, 2, 3)[:, axis // 3]
    assert (missing.all(axis=1) == missing.any(axis=1)).all()
    assert not missing[:600].any()
    assert missing[700:1200].all()
    assert not missing[1300:].any()


def test_a_constant_gyroscope_of_a_phone_at_rest_is_not_stuck() -> None:
    motion = np.tile([0.0, 0.0, 9.8, 0.0, 0.0, 0.0], (3000, 1)) + RNG.normal(scale=0.02, size=(3000, 6)) * [
        *(1, 1, 1),
        *(0, 0, 0),
    ]
    assert not np.isnan(watched(motion)).any()


def test_a_gyroscope_that_is_read_five_times_a_second_is_not_stuck() -> None:
    motion = moving(3000)
    motion[:, 3:] = motion[(np.arange(3000) // 20) * 20, 3:]
    assert not np.isnan(watched(motion)).any()


@settings(max_examples=30, deadline=None)
@given(cuts=st.lists(st.integers(0, 1500), max_size=40))
def test_the_detection_of_stuck_sensors_does_not_depend_on_blocks(cuts: list[int]) -> None:
    motion = moving(1500)
    motion[300:900, 4] = 0.0
    motion[800:1300, 2] = 1.0
    motion[100:130, 3:] = np.nan
    motion[:, 5] += 0.5
    values = with_field(motion)
    values[200:1100, 6:] = 1.0
    time_s, state, found = np.arange(1500) / RATE_HZ, init_watchdog(), list[np.ndarray]()
    for part in np.split(np.arange(1500), sorted(cuts)):
        state, result = remove_stuck_values(state, time_s[part], values[part])
        found.append(result)
    whole = remove_stuck_values(init_watchdog(), time_s, values)[1]
    assert np.isnan(whole[:, 6]).any()
    np.testing.assert_array_equal(np.concatenate(found), whole)


def test_a_magnetometer_that_is_constant_over_a_turn_is_missing_and_one_on_a_straight_way_is_not() -> None:
    turning = moving(2000)
    turning[600:1200, 5] += 0.4
    rows = with_field(turning)
    rows[500:1500, 6:] = [20.0, 0.0, -40.0]
    straight = with_field(moving(2000))
    straight[500:1500, 6:] = [20.0, 0.0, -40.0]
    time_s = np.arange(2000) / RATE_HZ
    missing = np.isnan(remove_stuck_values(init_watchdog(), time_s, rows)[1][:, 6:]).all(axis=1)
    assert missing[950:1500].all() and not missing[:700].any() and not missing[1550:].any()
    assert not np.isnan(remove_stuck_values(init_watchdog(), time_s, straight)[1]).any()


def test_a_coarse_accelerometer_is_not_stuck_while_it_rests_on_one_value() -> None:
    motion = moving(3000)
    motion[:, :3] *= 0.1
    motion[:, 2] += 9.0
    motion[1000:1600, :3] = motion[1000, :3]
    motion[1000:1600, 3:] *= np.where(np.arange(600) % 300 < 50, 1.0, 0.1)[:, None]  # turns now and then
    coarse = np.column_stack([np.round(motion[:, :3] / 0.5) * 0.5, motion[:, 3:]])
    assert not np.isnan(watched(coarse)).any()
    assert np.isnan(watched(motion)[1200:1600, :3]).any()  # a fine one is
    coarse[2000:2900, :3] = coarse[2000, :3]
    assert np.isnan(watched(coarse)[2600:2900, :3]).all()  # while the phone moves all the time


# --- tracks -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def walk() -> Recording:
    return simulate([Leg("walking", distance_m=40.0), Leg("walking", distance_m=40.0, turn_rad=np.pi / 2)], seed=5)


@pytest.mark.parametrize("first_axis", [0, 2])
def test_the_heading_of_a_stuck_gyroscope_is_unknown_and_a_note_says_so(walk: Recording, first_axis: int) -> None:
    assert walk.gyroscope is not None
    values = walk.gyroscope.values.copy()
    values[:, first_axis:] = 0.0
    dead = pdr.track(replace(walk, gyroscope=Samples(walk.gyroscope.time_s, values)))
    plain = pdr.track(walk)
    assert any("gyroscope was stuck at one value" in note for note in dead.notes)
    assert not any("one number" in note for note in plain.notes)
    off_m = np.linalg.norm(dead.position_m[-1] - plain.position_m[-1])
    assert off_m < 3.0 * np.sqrt(np.trace(dead.position_cov_m2[-1]))


@pytest.mark.parametrize("wild_ut", [2 * MAX_FIELD_UT, -1e160, 1.7e308])
def test_an_implausible_magnetic_field_counts_as_missing(wild_ut: float) -> None:
    time_s, field = np.arange(600) / RATE_HZ, np.tile([20.0, 0.0, -40.0], (600, 1))
    field[300:400, 1] = wild_ut
    block = imu(time_s, moving(600)[:, :3], moving(600)[:, 3:], field)
    state, blocks = condition(Conditioner(), [block])
    known = np.concatenate([b.magnetic_field_known for b in blocks])
    assert (state.report.n_wild_field, state.report.n_implausible) == (100, 0)
    assert 50 < (~known).sum() < 100
    online = pdr.OnlineFilter()
    online.push(block.time_s, block.specific_force_mps2, block.angular_rate_radps, block.magnetic_field_ut)
    assert any("magnetic fields beyond" in note for note in online.notes)


def test_impacts_beyond_the_range_of_phones_lose_no_step(walk: Recording) -> None:
    values = walk.accelerometer.values.copy()
    for start in np.random.default_rng(1).integers(0, len(values), 60):
        values[start : start + 3] *= 39.0
    struck = pdr.track(replace(walk, accelerometer=Samples(walk.accelerometer.time_s, values)))
    plain = pdr.track(walk)
    assert abs(struck.distance_m / plain.distance_m - 1) < 0.01
    assert any("beyond 160 m/s2" in note for note in struck.notes)


def test_samples_of_a_stuck_gyroscope_are_counted_without_a_magnetometer() -> None:
    motion = moving(2000)
    motion[500:1200, 3] = 0.3
    state, _ = condition(Conditioner(), [imu(np.arange(2000) / RATE_HZ, motion[:, :3], motion[:, 3:])])
    assert 500 <= state.report.n_dead_rate <= 700


def test_a_stuck_magnetometer_and_a_coarse_accelerometer_are_named_and_a_usual_phone_is_not(walk: Recording) -> None:
    assert walk.magnetometer is not None and walk.accelerometer is not None
    field, force = walk.magnetometer, walk.accelerometer
    values = np.where(field.time_s[:, None] > 20.0, field.values[2000], field.values)
    stuck = pdr.track(replace(walk, magnetometer=Samples(field.time_s, values)), north="magnetic")
    coarse = pdr.track(replace(walk, accelerometer=Samples(force.time_s, np.round(force.values))))
    usual = pdr.track(walk, north="magnetic")
    assert any("magnetometer was stuck at one value while the phone turned" in note for note in stuck.notes)
    assert any("accelerometer is rounded to 1 m/s2" in note for note in coarse.notes)
    assert not any("stuck" in note or "rounded" in note for note in usual.notes)
    assert not any("stuck" in note for note in coarse.notes)
    assert coarse.distance_m == pytest.approx(usual.distance_m, rel=0.03)
