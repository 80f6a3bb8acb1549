"""North from the magnetic field: closed forms, iron in the phone and in the building, consistent uncertainty."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import a_step
from scipy.stats import multivariate_normal

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.heading.magnetic_north import MagneticNorth
from pdr_filter.sensing.steps.step_detector import unknown_contexts
from pdr_filter.values import FloatArray, Step, wrap_angle

STAGE = MagneticNorth()
RATE_HZ, STEP_S = 100, 0.5
EARTH_UT = (20.0, -44.0)  # horizontal, up
TURNS = np.repeat([0.0, 1.6, 3.1, 0.4], 30)  # heading of the phone at each step


def way(
    heading_rad: FloatArray,
    north_rad: float = 0.0,
    iron_ut: FloatArray | None = None,
    place_ut: FloatArray | None = None,
) -> tuple[UniformBlock, AttitudeBlock, list[tuple[int, Step]]]:
    """A phone held 0.5 rad upright, a heading for each step; `place_ut` (K, 3) are disturbances."""
    heading = np.repeat(heading_rad, round(STEP_S * RATE_HZ))
    n, tilt = len(heading), 0.25
    # first tilted about x, then turned clockwise about up
    c, s, a, b = np.cos(-heading / 2), np.sin(-heading / 2), math.cos(tilt), math.sin(tilt)
    quat = np.column_stack([c * a, c * b, s * b, s * a])
    earth = [EARTH_UT[0] * math.sin(north_rad), EARTH_UT[0] * math.cos(north_rad), EARTH_UT[1]]
    field = np.tile(earth, (n, 1))
    if place_ut is not None:
        field = field + np.repeat(place_ut, round(STEP_S * RATE_HZ), axis=0)
    to_frame = rotations(quat)
    in_sensor = np.einsum("nji,nj->ni", to_frame, field) + (0.0 if iron_ut is None else iron_ut)
    time_s = (np.arange(n) + 1) / RATE_HZ
    known = np.ones(n, dtype=bool)
    block = UniformBlock(time_s, np.zeros((n, 3)), np.zeros((n, 3)), known, known, in_sensor, known, 0.0)
    attitude = AttitudeBlock(np.zeros(n), np.zeros((n, 2)), to_frame[:, 2], heading, quat=quat)
    # each becomes known a second after its contact
    contacts = np.arange(1, len(heading_rad) - 1) * STEP_S
    return block, attitude, [(round((t + 1.0) * RATE_HZ) - 1, a_step(float(t), duration_s=STEP_S)) for t in contacts]


def rotations(quat: FloatArray) -> FloatArray:
    w, v = quat[:, :1], quat[:, 1:]
    eye = np.eye(3)
    columns = [e + 2 * np.cross(v, np.cross(v, np.tile(e, (len(v), 1))) + w * e) for e in eye]
    return np.stack(columns, axis=-1)


def found(block: UniformBlock, attitude: AttitudeBlock, steps: list[tuple[int, Step]], stage: MagneticNorth = STAGE):
    return [s for _, s in stage.update(stage.init(), block, attitude, unknown_contexts(len(block.time_s)), steps)[1]]


def error_rad(step: Step, north_rad: float) -> float:
    return float(wrap_angle(step.north_rad - north_rad))


@pytest.mark.parametrize("north_rad", [0.0, 2.0, -3.0])
def test_north_is_where_the_field_points_less_the_declination(north_rad: float) -> None:
    last = found(*way(TURNS, north_rad))[-1]
    assert error_rad(last, north_rad) == pytest.approx(0.0, abs=1e-6)
    there = found(*way(TURNS, north_rad), MagneticNorth(declination_rad=0.3, declination_std_rad=0.2))[-1]
    assert error_rad(there, north_rad - 0.3) == pytest.approx(0.0, abs=1e-6)
    assert there.north_std_rad == pytest.approx(math.hypot(last.north_std_rad, 0.2))


def test_a_north_known_to_a_third_of_a_degree_does_not_depend_on_its_direction() -> None:
    """Between two directions of the grid it is as certain as at one of them."""
    stage = MagneticNorth(disturbance_ut=0.5)
    at_three, between = (found(*way(TURNS, math.radians(angle)), stage)[-1] for angle in (3.0, 4.4))
    assert error_rad(between, math.radians(4.4)) == pytest.approx(0.0, abs=1e-5)
    assert between.north_std_rad == pytest.approx(at_three.north_std_rad, rel=1e-4)
    assert math.radians(0.1) < between.north_std_rad < math.radians(0.5)


def test_turning_reveals_thirty_microtesla_of_hard_iron_in_the_phone() -> None:
    last = found(*way(TURNS, 0.7, iron_ut=np.array([25.0, -15.0, 8.0])))[-1]
    assert abs(error_rad(last, 0.7)) < math.radians(10.0)
    assert abs(error_rad(last, 0.7)) < 3.0 * last.north_std_rad


def test_before_the_first_turn_hard_iron_is_part_of_the_standard_deviation() -> None:
    last = found(*way(np.zeros(120), iron_ut=np.array([10.0, 0.0, 0.0])))[-1]
    # ten microtesla across twenty
    assert error_rad(last, 0.0) == pytest.approx(math.atan(0.5), abs=1e-6)
    assert last.north_std_rad > math.atan(0.5) / 1.5
    assert found(*way(TURNS))[-1].north_std_rad < 0.6 * last.north_std_rad


def test_north_is_the_mean_of_all_directions_weighted_by_the_density_of_all_readings() -> None:
    rng = np.random.default_rng(0)
    turns = np.repeat([0.0, 0.5, 0.9, 0.3], 5)
    place_ut = np.repeat(rng.normal(scale=5.0, size=(4, 3)), 5, axis=0)
    block, attitude, steps = way(turns, 1.1, np.array([16.0, -12.0, 10.0]), place_ut)
    # with a given variance, as if estimated from a million readings
    stage = MagneticNorth(disturbance_ut=6.0, disturbance_readings=1e6, field_ut=(22.0, -40.0), field_std_ut=(5.0, 9.0))
    last = found(block, attitude, steps, stage)[-1]
    size = round(STEP_S * RATE_HZ)
    to_frame = rotations(attitude.quat)
    readings = np.einsum("nij,nj->ni", to_frame, block.magnetic_field_ut).reshape(-1, size, 3).mean(axis=1)
    means = to_frame.reshape(-1, size, 3, 3).mean(axis=1)
    n = len(steps)
    weight = np.exp(-(STEP_S * np.arange(n)[::-1]) / stage.memory_s)
    r = math.exp(-1.0 / stage.correlation_readings)
    noise_var = np.repeat(36.0 * (1 + r) / (1 - r) / weight, 3)
    turned, z = means[:n].reshape(-1, 3), readings[:n].ravel()
    log_density, directions = [], np.linspace(0.03, 2 * np.pi + 0.03, 120, endpoint=False)
    for psi in directions:
        u = np.array([[math.sin(psi), 0.0], [math.cos(psi), 0.0], [0.0, 1.0]])
        earth = np.tile(u, (n, 1))
        of_earth = earth @ np.diag([25.0, 81.0]) @ earth.T + np.diag(noise_var)
        irons_ut = (3.5, 7.0, 14.0, 28.0, 56.0, 112.0)
        log_density.append(
            [
                multivariate_normal(earth @ [22.0, -40.0], of_earth + s**2 * turned @ turned.T).logpdf(z)
                for s in irons_ut
            ]
        )
    prob = np.exp(np.array(log_density) - np.max(log_density))
    prob /= prob.sum()
    mean = np.exp(1j * directions) @ prob.sum(axis=1)
    assert np.sum(prob.sum(axis=0) > 0.05) >= 3  # three densities of the hard iron count
    assert last.north_rad == pytest.approx(float(np.angle(mean)), abs=1e-6)
    assert last.north_std_rad == pytest.approx(math.sqrt(-2.0 * math.log(abs(mean))), rel=1e-6)


def test_at_a_known_place_a_field_of_another_strength_reveals_iron_on_straight_walks() -> None:
    rng, here = np.random.default_rng(1), MagneticNorth(field_ut=EARTH_UT, field_std_ut=(5.0, 10.0))
    normalised: list[float] = []
    for _ in range(40):
        iron = rng.normal(size=3)
        last = found(*way(np.zeros(25), 0.7, rng.uniform(30.0, 100.0) * iron / np.linalg.norm(iron)), here)[-1]
        normalised.append(abs(error_rad(last, 0.7)) / last.north_std_rad)
    assert np.mean(np.less(normalised, 1.0)) > 0.6
    assert np.mean(np.less(normalised, 2.0)) > 0.85
    # without iron, the place makes north better
    assert found(*way(np.zeros(50)), here)[-1].north_std_rad < 0.9 * found(*way(np.zeros(50)))[-1].north_std_rad


@pytest.mark.parametrize("iron_ut", [150.0, 300.0])
def test_raw_data_leave_north_unknown_until_the_pedestrian_turns(iron_ut: float) -> None:
    for direction in np.linspace(0.0, 6.0, 7):
        iron = iron_ut * np.array([math.cos(direction), 0.8 * math.sin(direction), 0.6 * math.sin(direction)])
        straight, turned = found(*way(np.zeros(120), 0.7, iron))[-1], found(*way(TURNS, 0.7, iron))[-1]
        assert straight.north_std_rad > 1.0
        assert turned.north_std_rad < 0.5
        assert abs(error_rad(turned, 0.7)) < 0.1


@pytest.mark.parametrize("scatter_ut", [3.0, 6.0, 15.0])
def test_in_buildings_the_error_of_north_agrees_with_its_standard_deviation(scatter_ut: float) -> None:
    z = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        place_ut, r = rng.normal(scale=scatter_ut, size=(len(TURNS), 3)), math.exp(-1.0 / STAGE.correlation_readings)
        for k in range(1, len(place_ut)):
            place_ut[k] = r * place_ut[k - 1] + math.sqrt(1 - r * r) * place_ut[k]
        iron_ut = rng.normal(scale=5.0, size=3)
        last = found(*way(TURNS, 0.7, iron_ut, place_ut))[-1]
        z.append(error_rad(last, 0.7) / last.north_std_rad)
    # For 60 independent normal errors it is 0.65 to 1.4 with a probability of 99 %. A small value means that the
    # standard deviation is too large.
    assert np.mean(np.square(z)) < 1.4
    assert np.mean(np.square(z)) > 0.15


def test_a_lift_on_the_way_increases_the_standard_deviation() -> None:
    place_ut = np.zeros((len(TURNS), 3))
    place_ut[50:58, 0] = 120.0
    quiet, last = found(*way(TURNS, 0.7))[-1], found(*way(TURNS, 0.7, place_ut=place_ut))[-1]
    assert last.north_std_rad > 2.0 * quiet.north_std_rad
    assert abs(error_rad(last, 0.7)) < 2.0 * last.north_std_rad


def test_without_a_magnetic_field_north_is_unknown() -> None:
    block, attitude, steps = way(TURNS)
    nowhere = np.zeros(len(block.time_s), dtype=bool)
    unknown = replace(block, magnetic_field_ut=np.zeros_like(block.magnetic_field_ut), magnetic_field_known=nowhere)
    assert all(math.isinf(s.north_std_rad) for s in found(unknown, attitude, steps))


def test_a_magnetometer_that_reads_zero_leaves_north_unknown() -> None:
    block, attitude, steps = way(TURNS)
    block.magnetic_field_ut[:] = 0.0
    assert all(s.north_std_rad > math.pi for s in found(block, attitude, steps))


def test_north_is_estimated_again_when_the_turn_of_the_phone_was_not_measured() -> None:
    block, attitude, steps = way(TURNS)
    number, step = steps[60]
    steps[60] = number, a_step(step.time_s, duration_s=STEP_S, heading_unknown_s=0.4)
    after = found(block, attitude, steps)
    assert after[60].north_std_rad == after[0].north_std_rad > 3.0 * after[59].north_std_rad


def test_standing_for_long_does_not_reduce_the_standard_deviation() -> None:
    block, attitude, steps = way(np.zeros(120))
    walked, stood = found(block, attitude, steps), found(block, attitude, steps[:5])
    assert stood[-1].north_std_rad == walked[4].north_std_rad > walked[-1].north_std_rad
