"""North of a track from a magnetometer, alone, with fixes, and with an error."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from helpers import clockwise, nees_of, streamed, true_position_m
from scipy.spatial.transform import Rotation

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.filter.pedestrian.alignment import Alignment, Pose
from pdr_filter.filter.pedestrian.frame import UNKNOWN_FRAME
from pdr_filter.filter.pedestrian.frame_rotation import Compass, PairedPoint, align, rotation_density
from pdr_filter.simulate import Leg, simulate
from pdr_filter.simulate.walk import phone_motion
from pdr_filter.values import Origin, PositionFix, Samples, wrap_angle
from pdr_filter.values.recording import MissingSensorError, Recording

pytestmark = pytest.mark.usefixtures("sensing_once")

LEGS = [Leg("walking", distance_m=35.0), Leg("walking", distance_m=30.0, turn_rad=1.4)]
HERE = Origin(48.137, 11.575)
WRONG_RAD = math.radians(90.0)


def walked(start_heading_rad: float) -> Recording:
    """A walk in the frame of its magnetic field."""
    return simulate(LEGS, seed=3, start_heading_rad=start_heading_rad)


@pytest.fixture(scope="module")
def walk() -> Recording:
    return walked(2.0)


def fix_at(walk: Recording, time_s: float, std_m: float = 0.5) -> PositionFix:
    return PositionFix(time_s, true_position_m(walk, time_s), std_m**2 * np.eye(2))


def located(walk: Recording, turn_rad: float = 0.0, every_s: float = 1.0) -> Recording:
    """Return the walk with correct locations, in a world rotated clockwise against the magnetic field."""
    time_s = np.arange(1.3, walk.duration_s, every_s)
    place_m = true_position_m(walk, time_s) @ clockwise(turn_rad).T
    rows = np.column_stack([*HERE.latitude_longitude_deg(place_m), np.full((len(time_s), 2), 6.0)])
    return replace(walk, location=Samples(time_s, rows))


def config_of(walk: Recording, declination_rad: float = 0.0) -> pdr.Config:
    return recipes.for_recording("default", walk).with_magnetic_north(declination_rad)


def rms_m(walk: Recording, track: pdr.Track, from_s: float = 0.0) -> float:
    late = track.time_s > from_s
    return float(np.sqrt(((track.position_m - true_position_m(walk, track.time_s))[late] ** 2).sum(axis=1).mean()))


def nees(walk: Recording, track: pdr.Track) -> np.ndarray:
    return nees_of(track.position_m - true_position_m(walk, track.time_s), track.position_cov_m2)


# --- the declination --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("year", "pose", "declination_deg"),
    [
        # the test values that are published with the models of 2025 and 2020
        (2025.0, (80.0, 0.0), 1.28),
        (2025.0, (0.0, 120.0), -0.16),
        (2025.0, (-80.0, -120.0), 68.78),
        (2020.0, (80.0, 0.0), -1.28),
        (2020.0, (0.0, 120.0), 0.16),
        (2020.0, (-80.0, -120.0), 69.36),
    ],
)
def test_the_declination_is_that_of_the_world_magnetic_model(
    year: float, pose: tuple[float, float], declination_deg: float
) -> None:
    assert math.degrees(Origin(*pose).declination_rad(year)) == pytest.approx(declination_deg, abs=0.005)


def test_years_outside_of_the_models_use_the_nearest_model_year() -> None:
    assert HERE.declination_rad(1970.0) == HERE.declination_rad(2010.0)
    assert HERE.declination_rad(2090.0) == pytest.approx(HERE.declination_rad(2029.9), abs=1e-3)


# --- the turn of a frame ----------------------------------------------------------------------------------------------


def test_a_compass_has_a_normal_error_except_for_five_percent_uniform_outliers() -> None:
    compass, angles = Compass(3.0, 0.04), np.linspace(-np.pi, np.pi, 4000, endpoint=False)
    density = compass.density(angles)
    assert density.mean() * 2 * np.pi == pytest.approx(1.0, abs=1e-6)
    assert density.min() == pytest.approx(0.05 / (2 * np.pi), rel=1e-6)
    assert angles[density.argmax()] == pytest.approx(3.0, abs=2e-3)
    near = np.abs(wrap_angle(angles - 3.0)) < 0.2
    assert density[near].mean() * 2 * np.pi * near.mean() == pytest.approx(0.95 * 0.6827 + 0.05 * 0.4 / 6.283, abs=2e-3)


def test_a_compass_and_one_fix_leave_the_rotation_open_and_a_more_distant_fix_determines_it() -> None:
    first, on = (
        PairedPoint(np.zeros(2), np.zeros(2), 1.0),
        PairedPoint(np.array([0.0, 10.0]), np.array([10.0, 0.0]), 9.0),
    )
    assert align([first], 0, compass=Compass(np.pi / 2, 0.02)) is None
    assert align([first, on], 0) is None
    found = align([first, on], 0, compass=Compass(np.pi / 2 + 0.1, 0.02))
    assert found is not None
    # two independent measurements: of the fixes a right angle with the variance 10 / 10^2, and of the compass
    of_fixes, of_compass = 10.0**2 / 10.0, 1.0 / 0.02
    expected = (of_fixes * np.pi / 2 + of_compass * (np.pi / 2 + 0.1)) / (of_fixes + of_compass)
    assert found.angle_rad == pytest.approx(expected, abs=2e-3)
    assert found.angle_var_rad2 == pytest.approx(1.0 / (of_fixes + of_compass), rel=0.02)


def test_the_density_of_the_rotation_is_the_product_of_fixes_and_compass() -> None:
    pairs = [PairedPoint(np.zeros(2), np.zeros(2), 1.0), PairedPoint(np.array([0.0, 5.0]), np.array([4.0, 3.0]), 4.0)]
    compass, turn = Compass(1.2, 0.05), rotation_density(pairs)
    product = turn.prob * compass.density(np.linspace(-np.pi, np.pi, 120, endpoint=False))
    np.testing.assert_allclose(turn.with_compass(compass).prob, product / product.sum(), rtol=1e-12)
    np.testing.assert_array_equal(turn.with_compass(None).prob, turn.prob)


def test_a_heading_fix_overrides_a_compass() -> None:
    frame = UNKNOWN_FRAME.with_compass(Compass(1.0, 0.04))
    assert frame.name == "north"
    pose = frame.world(Pose(np.array([0.0, 10.0]), np.zeros((2, 2)), 0.3, 4))
    np.testing.assert_allclose(pose.position_m, [10 * math.sin(1.0), 10 * math.cos(1.0)])
    np.testing.assert_allclose(np.linalg.eigvalsh(pose.cov_m2), [0.0, 0.04 * 100.0], atol=1e-9)
    known = frame.with_north(Alignment(0.2, 0.01, np.zeros(2), np.zeros(2), 0.0, 3))
    assert known.compass is None
    assert known.with_compass(Compass(1.0, 0.04)).compass is None


# --- tracks -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("start_heading_rad", [0.0, 2.0, -1.2])
def test_a_rotated_walk_gives_the_same_rotated_track_with_true_north(start_heading_rad: float) -> None:
    walk = walked(start_heading_rad)
    alone, track = pdr.track(walk), pdr.track(walk, north="magnetic")
    assert (alone.frame, track.frame) == ("start", "north")
    np.testing.assert_allclose(
        np.linalg.norm(track.position_m, axis=1), np.linalg.norm(alone.position_m, axis=1), rtol=1e-9
    )
    way = (track.position_m[-1] - true_position_m(walk, track.time_s[-1])).tolist()
    error_rad = math.hypot(*way) / np.linalg.norm(track.position_m[-1])
    assert error_rad < math.radians(15.0)
    assert np.trace(track.position_cov_m2[-1]) > np.trace(alone.position_cov_m2[-1])
    assert any("north comes from the magnetic field" in note for note in track.notes)


@pytest.mark.parametrize("weighting", ["imm", "wc"])
def test_one_fix_and_the_magnetic_field_georeference_the_track(walk: Recording, weighting: str) -> None:
    fix = fix_at(walk, 5.0)
    config = recipes.for_recording("default", walk)
    off = pdr.track(walk, config.in_world_frame(), weighting=weighting, fixes=[fix])
    track = pdr.track(walk, config_of(walk), weighting=weighting, fixes=[fix])
    assert rms_m(walk, track) < 5.0 < 0.3 * rms_m(walk, off)
    assert nees(walk, track).max() < 13.8  # one in a thousand


def test_fixes_overrule_a_compass_that_is_wrong_by_a_right_angle(walk: Recording) -> None:
    fixes = [fix_at(walk, t, 2.0) for t in np.arange(4.0, walk.duration_s, 6.0)]
    config = recipes.for_recording("default", walk)
    off = pdr.track(walk, config.in_world_frame(), fixes=fixes)
    track = pdr.track(walk, config_of(walk, WRONG_RAD), fixes=fixes)
    half_s = 0.5 * walk.duration_s
    assert rms_m(walk, track, half_s) < rms_m(walk, off, half_s) + 1.0 < 2.0
    assert nees(walk, track).max() < 13.8


def test_locations_enable_the_magnetometer_unless_north_is_off(walk: Recording) -> None:
    declination_rad = HERE.declination_rad()
    # true north is west of magnetic north, in a world as it is
    here = located(walk, declination_rad)
    track, off = pdr.track(here), pdr.track(here, north="off")
    bare = pdr.track(replace(here, magnetometer=None))
    assert np.isinf(off.steps.north_std_rad).all() and np.isinf(bare.steps.north_std_rad).all()
    assert np.isfinite(track.steps.north_std_rad[5:]).all()
    only = replace(here, location=Samples(here.location.time_s[:1], here.location.values[:1]))
    placed = pdr.track(only)
    heading_rad = float(wrap_angle(placed.walking_heading_rad[10] - 2.0 - declination_rad))
    assert abs(heading_rad) < math.radians(15.0)


def test_the_declination_is_that_of_the_date_of_the_recording(walk: Recording) -> None:
    def north_rad(meta: dict[str, float | None]) -> float:
        here = replace(located(walk), meta={**walk.meta, **meta})
        return float(pdr.track(here).steps.north_rad[20])

    then_s = (2012.5 - 1970.0) * 365.2425 * 86400.0
    change_rad = HERE.declination_rad(2012.5) - HERE.declination_rad(2025.0)
    assert abs(change_rad) > math.radians(1.0)
    assert north_rad({}) - north_rad({"epoch_s": then_s}) == pytest.approx(change_rad, abs=1e-6)
    assert north_rad({}) == north_rad({"epoch_s": None, "epoch_ns": math.nan})
    assert north_rad({}) - north_rad({"epoch_ns": int(then_s * 1e9)}) == pytest.approx(change_rad, abs=1e-6)


def test_an_unknown_place_makes_the_declination_an_uncertainty(walk: Recording) -> None:
    nowhere, here = pdr.track(walk, north="magnetic"), pdr.track(located(walk), north="magnetic")
    var = nowhere.steps.north_std_rad[20] ** 2 - here.steps.north_std_rad[20] ** 2
    # at a known pose, the strength of the field excludes iron, which narrows north further
    assert var > 0.2**2 - math.radians(1.0) ** 2


@pytest.mark.parametrize("seed", range(2))
def test_online_results_with_north_are_identical_for_any_blocks_and_after_loading(walk: Recording, seed: int) -> None:
    fixes = [fix_at(walk, 5.0), fix_at(walk, 9.0, 3.0)]
    track = pdr.track(walk, config_of(walk), fixes=fixes)
    _, updates = streamed(walk, config_of(walk), fixes, seed, n_resumed=2)
    np.testing.assert_array_equal([u.step.north_rad for u in updates], track.steps.north_rad)
    np.testing.assert_array_equal([u.step.north_std_rad for u in updates], track.steps.north_std_rad)
    np.testing.assert_array_equal(updates[-1].position_m, track.position_m[-1])
    np.testing.assert_array_equal(updates[-1].position_cov_m2, track.position_cov_m2[-1])


@pytest.mark.parametrize(("iron_ut", "stated"), [(0.0, "± 29 degrees"), (30.0, "± 47 degrees"), (200.0, "± a radian")])
def test_a_north_uncertain_by_more_than_half_a_quadrant_is_not_used(iron_ut: float, stated: str) -> None:
    walk = simulate([Leg("walking", distance_m=20.0), Leg("walking", distance_m=10.0, turn_rad=0.5)], seed=2)
    iron = iron_ut * np.array([0.8, -0.5, 0.33])
    walk = replace(walk, magnetometer=replace(walk.magnetometer, values=walk.magnetometer.values + iron))
    for track in (pdr.track(walk, north="magnetic"), pdr.smooth(walk, north="magnetic").track):
        (note,) = (n for n in track.notes if "the magnetic field" in n)
        assert stated in note
        assert note.startswith("north comes from" if iron_ut == 0.0 else "the magnetic field does not determine north")
        assert track.frame == ("north" if iron_ut == 0.0 else "start")
        assert (track.position_std_m[-1] > 5.0) == (iron_ut == 0.0)


def test_contradicting_sources_of_north_are_refused(walk: Recording) -> None:
    with pytest.raises(MissingSensorError, match="no magnetometer"):
        pdr.track(replace(walk, magnetometer=None), north="magnetic")
    with pytest.raises(MissingSensorError, match="no gyroscope"):
        pdr.track(replace(walk, gyroscope=None), north="magnetic")
    with pytest.raises(ValueError, match="'martinelli2018' does not estimate the walking direction"):
        pdr.track(walk, recipes.martinelli2018(), north="magnetic")


@pytest.mark.parametrize(("north", "quarters"), [("rotation-vector", 0), ("true-heading", 1)])
def test_an_attitude_with_known_north_rotates_the_track_like_the_magnetic_field(
    walk: Recording, north: Literal["rotation-vector", "true-heading"], quarters: int
) -> None:
    time_s = np.arange(0.0, walk.duration_s, 0.02)
    in_its_world = Rotation.from_euler("z", -90.0 * quarters, degrees=True)  # where x, not y, is north
    true = in_its_world * phone_motion(LEGS, seed=3, start_heading_rad=2.0).rotation(time_s)
    own = replace(walk, magnetometer=None, attitude=Samples(time_s, true.as_quat()[:, [3, 0, 1, 2]]))
    by_attitude, by_field = pdr.track(own, north=north), pdr.track(walk, north="magnetic")
    assert by_attitude.frame == "north"
    np.testing.assert_allclose(by_attitude.position_m, by_field.position_m, atol=0.02 * by_field.distance_m)
    with pytest.raises(MissingSensorError, match="no attitude"):
        pdr.track(replace(walk, attitude=None), north=north)


def test_only_magnetic_north_is_corrected_by_the_declination(walk: Recording) -> None:
    time_s = np.arange(0.0, walk.duration_s, 0.02)
    true = phone_motion(LEGS, seed=3, start_heading_rad=2.0).rotation(time_s)
    own = replace(walk, attitude=Samples(time_s, true.as_quat()[:, [3, 0, 1, 2]]))
    for north, declination_rad in (("rotation-vector", HERE.declination_rad()), ("true-heading", 0.0)):
        there, nowhere = (pdr.track(own, origin=o, north=north) for o in (HERE, None))
        turned_rad = wrap_angle(there.walking_heading_rad - nowhere.walking_heading_rad)
        np.testing.assert_allclose(turned_rad, declination_rad, atol=1e-9)


def test_a_given_origin_defines_the_declination_and_a_given_heading_replaces_north(walk: Recording) -> None:
    track = pdr.track(walk, origin=(48.137, 11.575), north="magnetic")
    nowhere = pdr.track(walk, north="magnetic")
    assert (track.frame, track.knows_north) == ("north", True)
    change_rad = wrap_angle(track.walking_heading_rad - nowhere.walking_heading_rad)
    np.testing.assert_allclose(change_rad, HERE.declination_rad(), atol=1e-3)


def test_only_locations_rotate_the_track_of_a_recipe_without_walking_directions(walk: Recording) -> None:
    here, config = located(walk), recipes.martinelli2018()
    track, off = pdr.track(here, config), pdr.track(here, config, north="off")
    np.testing.assert_array_equal(track.position_m, off.position_m)
