"""Locations of a phone: their conversion to fixes, tracks on Earth, and unusable locations."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
import pytest
from helpers import clockwise, cut_randomly, nees_of, of_nobody, pushed, true_position_m
from scipy.stats import chi2

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.filter.fixes import gnss
from pdr_filter.filter.fixes.gnss import (
    CORRELATION_S,
    INTERVAL_S,
    MIN_ACCURACY_M,
    RADIUS_68,
    LocationState,
    good_locations,
    independent,
    location_at,
    position_fixes,
)
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import HeadingFix, Origin, PositionFix, Samples, SpeedFix
from pdr_filter.values.recording import MissingSensorError, Recording

pytestmark = pytest.mark.usefixtures("sensing_once")

HERE = Origin(48.137, 11.575)
TURN_RAD = 2.1


@pytest.fixture(scope="module")
def bare() -> Recording:
    """Walk without locations."""
    legs = [Leg("walking", distance_m=70.0), Leg("walking", distance_m=60.0, turn_rad=np.pi / 2)]
    # the world frame is rotated against the walk, but the magnetic field is not
    return replace(simulate(legs, seed=3, name="walk"), magnetometer=None)


def truth_m(walk: Recording, times: np.ndarray) -> np.ndarray:
    """Return true positions in the frame of `HERE`."""
    return true_position_m(walk, times) @ clockwise(TURN_RAD).T + [40.0, -25.0]


def rows(time_s: np.ndarray, position_m: np.ndarray, accuracy_m: float = 6.0) -> Samples:
    latitude_deg, longitude_deg = HERE.latitude_longitude_deg(position_m)
    values = np.column_stack([latitude_deg, longitude_deg, np.full((len(time_s), 2), [520.0, accuracy_m])])
    return Samples(time_s, values)


def located(walk: Recording, until_s: float = np.inf, noise_m: float = 3.0) -> Recording:
    """Walk with a location each second, whose errors are correlated as the filter assumes."""
    time_s = np.arange(1.3, min(walk.duration_s, until_s))
    rng, r = np.random.default_rng(8), np.exp(-1.0 / CORRELATION_S)
    error = rng.normal(scale=noise_m, size=(len(time_s), 2))
    for k in range(1, len(time_s)):
        error[k] = r * error[k - 1] + np.sqrt(1 - r**2) * error[k]
    return replace(walk, location=rows(time_s, truth_m(walk, time_s) + error))


@pytest.fixture(scope="module")
def walk(bare: Recording) -> Recording:
    return located(bare)


@pytest.fixture(scope="module")
def found(walk: Recording) -> pdr.Track:
    """Track of the walk with its locations."""
    return pdr.track(walk)


@pytest.fixture(scope="module")
def alone(bare: Recording) -> pdr.Track:
    """Dead reckoning without locations."""
    return pdr.track(bare)


def in_frame_of_here(track: pdr.Track) -> np.ndarray:
    return HERE.east_north_m(track.latitude_deg, track.longitude_deg)


# --- places and metres ------------------------------------------------------------------------------------------------


def test_a_short_displacement_in_degrees_follows_from_the_two_radii_of_curvature() -> None:
    a, e2 = 6378137.0, 0.0066943799901413165
    for latitude_deg in (-62.0, 0.0, 48.137):
        origin, w = Origin(latitude_deg, 11.575), 1 - e2 * np.sin(np.radians(latitude_deg)) ** 2
        east_north_m = origin.east_north_m(latitude_deg + 1e-4, 11.575 + 1e-4)
        meridian_m, normal_m = a * (1 - e2) / w**1.5, a / np.sqrt(w)
        expected = np.radians(1e-4) * np.array([normal_m * np.cos(np.radians(latitude_deg)), meridian_m])
        np.testing.assert_allclose(east_north_m, expected, rtol=1e-5)


def test_metres_and_degrees_convert_both_ways_and_agree_with_pymap3d() -> None:
    position_m = np.random.default_rng(0).normal(scale=800.0, size=(20, 2))
    latitude_deg, longitude_deg = HERE.latitude_longitude_deg(position_m)
    np.testing.assert_allclose(HERE.east_north_m(latitude_deg, longitude_deg), position_m, atol=1e-3)
    east_m, north_m, _ = pymap3d.geodetic2enu(latitude_deg, longitude_deg, 0.0, 48.137, 11.575, 0.0)
    np.testing.assert_array_equal(HERE.east_north_m(latitude_deg, longitude_deg), np.column_stack([east_m, north_m]))


# --- locations to fixes -----------------------------------------------------------------------------------------------


def fixes_of(location: Samples) -> tuple[LocationState, tuple[PositionFix, ...]]:
    latitude_deg, longitude_deg, _, accuracy_m = location.values.T
    return position_fixes(LocationState(), location.time_s, latitude_deg, longitude_deg, accuracy_m)


def test_the_first_location_is_the_origin_and_has_its_own_accuracy() -> None:
    state, fixes = fixes_of(rows(np.array([2.0]), np.array([[30.0, 10.0]]), accuracy_m=9.0))
    np.testing.assert_allclose(HERE.east_north_m(state.origin.latitude_deg, state.origin.longitude_deg), [30.0, 10.0])
    np.testing.assert_array_equal(fixes[0].position_m, [0.0, 0.0])
    # 68 % of a circular normal distribution are within the accuracy radius
    assert chi2.cdf(9.0**2 / fixes[0].cov_m2[0, 0], 2) == pytest.approx(0.6827, abs=1e-3)


def test_the_variance_of_the_mean_of_many_fixes_accounts_for_correlated_errors() -> None:
    time_s = np.arange(0.0, 4000.0)  # one a second
    _, correlated = fixes_of(rows(time_s, np.zeros((len(time_s), 2)), accuracy_m=RADIUS_68 * 4.0))
    fixes = independent(correlated)
    assert {fix.correlation_s for fix in correlated} == {CORRELATION_S}
    assert {fix.correlation_s for fix in fixes} == {0.0}
    times = np.array([fix.time_s for fix in fixes])
    assert np.diff(times).min() >= INTERVAL_S
    true_var = 16.0 * np.exp(-np.abs(times[:, None] - times) / CORRELATION_S).mean()
    claimed = 1.0 / sum(1.0 / fix.cov_m2[0, 0] for fix in fixes)
    assert claimed == pytest.approx(true_var, rel=0.03)
    # 4000 locations count as at most a hundred independent ones
    assert 16.0 / claimed < 4000.0 / (2 * CORRELATION_S) + 2


def test_an_implausibly_small_accuracy_is_replaced_by_the_smallest_plausible_one() -> None:
    _, (fix,) = fixes_of(rows(np.zeros(1), np.zeros((1, 2)), accuracy_m=0.1))
    assert fix.cov_m2[0, 0] == pytest.approx((MIN_ACCURACY_M / RADIUS_68) ** 2)


BAD = {
    "latitude beyond the pole": (0, 91.0),
    "latitude nan": (0, np.nan),
    "longitude beyond the date line": (1, 999.0),
    "longitude infinite": (1, np.inf),
    "accuracy nan": (3, np.nan),
    "accuracy zero": (3, 0.0),
    "accuracy negative": (3, -1.0),
    "accuracy infinite": (3, np.inf),
    "accuracy of a continent": (3, 1e200),
}


@pytest.mark.parametrize("what", BAD)
def test_an_unusable_location_is_left_out_and_counted(what: str) -> None:
    good = rows(np.array([0.0, 20.0, 40.0]), np.array([[0.0, 0.0], [9.0, 9.0], [18.0, 18.0]]))
    column, value = BAD[what]
    values = good.values.copy()
    values[0, column] = value
    state, fixes = fixes_of(Samples(good.time_s, values))
    assert [fix.time_s for fix in fixes] == [20.0, 40.0]
    np.testing.assert_array_equal(fixes[0].position_m, [0.0, 0.0])
    assert (state.n, state.n_unusable) == (3, 1)


def test_zero_zero_is_no_place_and_locations_that_go_back_in_time_are_left_out() -> None:
    good = rows(np.array([5.0, 20.0, 3.0, 20.0, 40.0]), np.zeros((5, 2)))
    values = good.values.copy()
    values[0, :2] = 0.0
    state, fixes = fixes_of(Samples(good.time_s, values))
    assert [fix.time_s for fix in fixes] == [20.0, 40.0]
    assert state.n_unusable == 3


# --- tracks -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("weighting", ["imm", "wc"])
def test_a_track_with_locations_lies_where_the_person_walked(walk: Recording, weighting: str) -> None:
    track = pdr.track(walk, weighting=weighting)
    error_m = np.linalg.norm(in_frame_of_here(track) - truth_m(walk, track.time_s), axis=1)
    assert np.median(error_m) < 5.0  # a location has an error of 4 m
    assert error_m.max() < 12.0
    assert track.frame == "fixes"
    error = in_frame_of_here(track) - truth_m(walk, track.time_s)
    assert nees_of(error, track.position_cov_m2).max() < chi2.isf(1e-3, 2)


def test_the_origin_contains_rotation_and_position_of_the_track_with_standard_deviations(
    bare: Recording, found: pdr.Track, alone: pdr.Track
) -> None:
    known = found.origin
    assert abs(np.angle(np.exp(1j * (known.turn_rad - TURN_RAD)))) < 3.0 * known.turn_std_rad < 0.8
    assert 0.0 < known.position_std_m < 6.0 / RADIUS_68
    # dead reckoning rotated by it follows the person
    placed = alone.placed(known)
    along_m = placed.position_m[-1] - placed.start_position_m
    true_m = truth_m(bare, placed.time_s[[-1]])[0] - truth_m(bare, np.zeros(1))[0]
    assert np.linalg.norm(along_m - true_m) < 3.0 * known.turn_std_rad * np.linalg.norm(true_m)


def test_after_one_location_the_origin_has_an_unknown_rotation(bare: Recording) -> None:
    time_s = np.array([20.0])
    known = pdr.track(replace(bare, location=rows(time_s, truth_m(bare, time_s)))).origin
    assert known.turn_std_rad == pytest.approx(np.pi / np.sqrt(3.0), rel=1e-3)
    assert known.position_std_m == pytest.approx(6.0 / RADIUS_68, rel=0.1)


def test_after_the_last_location_the_track_continues_in_the_world_frame(bare: Recording) -> None:
    track = pdr.track(located(bare, until_s=45.0))
    late = track.time_s > 60.0
    error = (in_frame_of_here(track) - truth_m(bare, track.time_s))[late]
    assert np.median(np.linalg.norm(error, axis=1)) < 10.0
    assert nees_of(error, track.position_cov_m2[late]).max() < chi2.isf(1e-3, 2)


def test_missing_and_disabled_locations_give_identical_tracks(walk: Recording, alone: pdr.Track) -> None:
    off = pdr.track(walk, gnss="off")
    for track in (off, pdr.track(walk, config=recipes.for_recording("default", walk), gnss="off")):
        np.testing.assert_array_equal(track.position_m, alone.position_m)
        np.testing.assert_array_equal(track.position_cov_m2, alone.position_cov_m2)
        np.testing.assert_array_equal(track.walking_heading_rad, alone.walking_heading_rad)
        assert (track.origin, track.frame, track.fixes) == (None, "start", ())
        assert track.notes == alone.notes


@pytest.mark.parametrize(("asked", "accuracy_m"), [({}, -1.0), ({"gnss": "align"}, np.nan)], ids=["filter", "align"])
def test_unusable_locations_do_not_change_the_track_and_are_reported(
    walk: Recording, alone: pdr.Track, asked: dict[str, Any], accuracy_m: float
) -> None:
    values = walk.location.values.copy()
    values[:, 3] = accuracy_m
    track = pdr.track(replace(walk, location=Samples(walk.location.time_s, values)), **asked)
    np.testing.assert_array_equal(track.position_m, alone.position_m)
    np.testing.assert_array_equal(track.position_cov_m2, alone.position_cov_m2)
    assert (track.origin, track.frame, track.fixes) == (None, "start", ())
    n = len(values)
    assert any(f"{n} of {n} locations are not used" in note for note in track.notes)


def test_jumps_of_a_kilometre_are_rejected(walk: Recording, found: pdr.Track) -> None:
    values, wrong_s = walk.location.values.copy(), [found.fixes[k].time_s for k in (4, 6)]
    values[np.isin(walk.location.time_s, wrong_s), 0] += 0.009
    track = pdr.track(replace(walk, location=Samples(walk.location.time_s, values)))
    rejected = [fix.time_s for fix in track.fixes if fix.outcome == "rejected"]
    assert rejected == wrong_s
    assert np.linalg.norm(track.position_m - found.position_m, axis=1).max() < 6.0


def test_of_unordered_locations_those_in_order_of_time_are_used(walk: Recording) -> None:
    order = np.arange(len(walk.location.time_s))
    order[10:40] = order[10:40][::-1]
    mixed = replace(walk, location=Samples(walk.location.time_s[order], walk.location.values[order]))
    for asked in ("filter", "align"):
        track = pdr.track(mixed, gnss=asked)
        error_m = np.linalg.norm(in_frame_of_here(track) - truth_m(walk, track.time_s), axis=1)
        assert np.median(error_m) < 6.0
        assert any("locations are not used" in note for note in track.notes)


def test_a_hundred_locations_with_a_common_error_do_not_count_as_a_hundred(bare: Recording) -> None:
    time_s = np.arange(1.3, bare.duration_s)
    shifted = pdr.track(replace(bare, location=rows(time_s, truth_m(bare, time_s) + np.array([9.0, 0.0]))))
    error = in_frame_of_here(shifted) - truth_m(bare, shifted.time_s)
    nees = nees_of(error, shifted.position_cov_m2)
    # the locations cover some correlation times, but contain less information than two independent ones
    assert np.median(nees) < 2 * 9.0**2 / (6.0 / RADIUS_68) ** 2


def test_the_blocks_of_samples_and_locations_change_no_bit_of_an_online_track(walk: Recording) -> None:
    walk = of_nobody(walk)
    whole = pdr.track(walk, recipes.default())
    location, sent = walk.location, 0

    def push_locations(online: pdr.OnlineFilter, until_s: float) -> None:
        nonlocal sent
        new = slice(sent, sent := int(np.searchsorted(location.time_s, until_s)))
        latitude_deg, longitude_deg, altitude_m, accuracy_m = location.values[new].T
        online.push_location(location.time_s[new], latitude_deg, longitude_deg, accuracy_m, altitude_m)

    online = pdr.OnlineFilter(recipes.default().in_world_frame())
    assert online.origin is None
    blocks = cut_randomly(pdr.merge_streams(walk), 1)
    online, updates = pushed(online, blocks, push_locations, n_resumed=6)
    frame = online.state.pedestrian.frame
    told = [u.position_m if u.of_start is None else frame.world(u.of_start).position_m for u in updates]
    np.testing.assert_array_equal(told, whole.position_m)
    assert online.origin == whole.origin
    assert online.notes == tuple(note for note in whole.notes if note not in walk.notes)


def test_a_single_location_can_be_pushed_as_four_numbers() -> None:
    online = pdr.OnlineFilter(recipes.default().in_world_frame())
    online.push_location(0.0, 48.137, 11.575, 5.0)
    assert len(online.state.waiting_fixes) == 1


# --- aligned as a whole -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("weighting", ["imm", "wc"])
def test_an_aligned_track_is_dead_reckoning_after_a_rotation_and_a_shift(walk: Recording, weighting: str) -> None:
    track, alone = pdr.track(walk, weighting=weighting, gnss="align"), pdr.track(walk, weighting=weighting, gnss="off")
    turn_rad = float(np.angle(np.exp(1j * (track.walking_heading_rad - alone.walking_heading_rad)).mean()))
    turned_m = alone.position_m @ clockwise(turn_rad).T
    np.testing.assert_allclose(track.position_m - track.position_m[0], turned_m - turned_m[0], atol=1e-6)
    np.testing.assert_allclose(track.start_position_m - track.position_m[0], -turned_m[0], atol=1e-6)
    np.testing.assert_array_equal(track.step_length_m, alone.step_length_m)
    error = in_frame_of_here(track) - truth_m(walk, track.time_s)
    assert np.linalg.norm(error, axis=1).max() < 12.0
    assert nees_of(error, track.position_cov_m2).max() < chi2.isf(1e-3, 2)
    assert np.linalg.eigvalsh(track.position_cov_m2).min() > 0
    assert track.frame == "fixes"
    assert {fix.outcome for fix in track.fixes} == {"turned"}


def test_outliers_do_not_rotate_an_aligned_track(walk: Recording) -> None:
    good = pdr.track(walk, gnss="align")
    values, wrong_s = walk.location.values.copy(), [good.fixes[k].time_s for k in (0, 4, 6)]
    values[np.isin(walk.location.time_s, wrong_s), 0] += 0.009
    track = pdr.track(replace(walk, location=Samples(walk.location.time_s, values)), gnss="align")
    assert [fix.time_s for fix in track.fixes if fix.outcome == "rejected"] == wrong_s
    error_m = np.linalg.norm(in_frame_of_here(track) - truth_m(walk, track.time_s), axis=1)
    assert error_m.max() < 14.0
    assert any("not fit the track or its time were not used: 3" in note for note in track.notes)


@pytest.mark.parametrize("gnss", ["filter", "align"])
@pytest.mark.parametrize("n", [1, 2])
def test_one_or_two_locations_place_any_track_and_leave_north_unknown(
    bare: Recording, alone: pdr.Track, n: int, gnss: str
) -> None:
    time_s = np.array([20.0, 31.0])[:n]
    recording = replace(bare, location=rows(time_s, truth_m(bare, time_s) + np.array([2.0, -1.0])))
    track = pdr.track(recording, gnss=gnss)
    side = [np.linalg.norm(t.position_m[-1] - t.position_m[0]) for t in (track, alone)]
    assert side[0] == pytest.approx(side[1], rel=1e-9)
    error = in_frame_of_here(track) - truth_m(bare, track.time_s)
    assert nees_of(error, track.position_cov_m2).max() < chi2.isf(1e-3, 2)
    assert any("do not determine the rotation of the track (±" in note for note in track.notes)


def test_a_position_without_another_one_does_not_give_north() -> None:
    bare = replace(simulate([Leg("walking", distance_m=12.0)], seed=3), magnetometer=None)
    place = PositionFix(6.0, np.zeros(2), 36.0 * np.eye(2))
    located = replace(bare, location=rows(np.array([6.0]), np.zeros((1, 2))))
    world, placed = pdr.recipes.default().in_world_frame(), {"fixes": [place], "origin": HERE}
    tracks = pdr.track(located), pdr.smooth(located).track, pdr.track(bare, world, **placed)
    for track in (*tracks, pdr.smooth(bare, **placed).track):
        assert (track.frame, track.knows_north) == ("fixes", False)
        assert not track.placed((0.0, 0.0)).knows_north
        assert "the direction of the walk is unknown, ± " in track.about_frame


def test_locations_that_determine_the_rotation_give_north_without_a_note(bare: Recording) -> None:
    time_s = np.array([1.0, 31.0, 45.0])
    track = pdr.track(replace(bare, location=rows(time_s, truth_m(bare, time_s), 9.0)))
    assert track.knows_north
    assert track.origin.turn_std_rad < 0.26
    assert not any("rotation of the track" in note for note in track.notes)


# --- contradictions ---------------------------------------------------------------------------------------------------


def test_fixes_in_their_own_frame_disable_the_locations_and_exclude_gnss_options(walk: Recording) -> None:
    fix = PositionFix(20.0, np.array([0.0, 20.0]), np.eye(2))
    assert pdr.track(walk, fixes=[fix]).origin is None
    assert pdr.track(walk, fixes=[HeadingFix(20.0, 0.0, 0.1)]).origin is None
    assert pdr.track(walk, fixes=[SpeedFix(20.0, 1.3, 0.1)]).origin is not None
    with pytest.raises(ValueError, match="position and rotation of the whole track, got ranges or positions"):
        pdr.track(walk, fixes=[fix], gnss="align")
    with pytest.raises(ValueError, match="determines the rotation of the whole track, got a HeadingFix"):
        pdr.track(walk, fixes=[HeadingFix(20.0, 0.0, 0.1)], gnss="align")


def test_fixes_in_metres_from_the_first_location_are_used_beside_the_locations(walk: Recording) -> None:
    alone = pdr.track(walk)
    row = int(np.searchsorted(alone.time_s, 60.0))
    fix = PositionFix(float(alone.time_s[row]), alone.position_m[row] + [3.0, 0.0], 0.01 * np.eye(2))
    both = pdr.track(walk, fixes=[fix], gnss="filter")
    assert both.origin is not None
    assert len(both.fixes) == len(alone.fixes) + 1
    np.testing.assert_allclose(both.position_m[row + 3] - alone.position_m[row + 3], [3.0, 0.0], atol=0.2)
    np.testing.assert_array_equal(both.position_m[: row - 1], alone.position_m[: row - 1])


def test_a_missing_stream_of_locations_is_refused(bare: Recording) -> None:
    with pytest.raises(MissingSensorError, match="walk has no location"):
        pdr.track(bare, gnss="filter")


def test_impossible_pushes_of_locations_are_refused_with_the_remedy() -> None:
    online = pdr.OnlineFilter(recipes.default().in_world_frame())
    with pytest.raises(ValueError, match=r"got shapes time_s \(2,\), latitude_deg \(1,\)"):
        online.push_location([0.0, 1.0], 48.0, 11.0, 5.0)
    online.finish()
    with pytest.raises(ValueError, match="is finished"):
        online.push_location(0.0, 48.0, 11.0, 5.0)


# --- files ------------------------------------------------------------------------------------------------------------


def test_map_files_of_a_located_track_need_no_origin_and_others_state_what_is_missing(
    found: pdr.Track, alone: pdr.Track, tmp_path: Path
) -> None:
    track = found
    feature = json.loads(track.to_geojson(tmp_path / "a.geojson").read_text())["features"][0]
    longitude_deg, latitude_deg = np.array(feature["geometry"]["coordinates"])[1:, :2].T
    np.testing.assert_allclose(latitude_deg, track.latitude_deg, atol=1e-8)
    np.testing.assert_allclose(longitude_deg, track.longitude_deg, atol=1e-8)
    assert feature["properties"]["frame"] == "fixes"
    assert "in the frame of the fixes, whose origin is at" in feature["properties"]["about"]
    assert f'lat="{track.latitude_deg[-1]:.9f}"' in track.to_gpx(tmp_path / "a.gpx").read_text()
    assert track.summary()["end_latitude_deg"] == pytest.approx(track.latitude_deg[-1], abs=1e-7)
    for write in (alone.to_geojson, alone.to_gpx, alone.to_kml):
        with pytest.raises(ValueError, match=r"the geographic position .*origin=\(latitude_deg, longitude_deg\)"):
            write(tmp_path / "b")
    with pytest.raises(ValueError, match="the geographic position of the track"):
        _ = alone.latitude_deg
    assert not (tmp_path / "b").exists()


def test_calibration_and_gnss_share_one_accuracy_constant() -> None:
    from pdr_filter.offline.calibration import segments

    assert segments.RADIUS_68 is gnss.RADIUS_68


def test_inaccurate_locations_rotate_and_shift_a_short_walk_without_bending_it(bare: Recording) -> None:
    """Distances between positions equal those of dead reckoning while its errors are below those of the locations."""
    time_s = np.arange(1.3, bare.duration_s)
    errors_m = np.random.default_rng(5).normal(scale=3.0, size=(len(time_s), 2))
    poor = rows(time_s, truth_m(bare, time_s) + errors_m, 13.0)
    located, alone = pdr.track(replace(bare, location=poor)), pdr.track(bare)
    assert {fix.outcome for fix in located.fixes} == {"placed", "turned"}
    apart_m = [np.linalg.norm(t.position_m[:, None] - t.position_m, axis=2) for t in (located, alone)]
    np.testing.assert_allclose(*apart_m, atol=1e-6)


def test_a_location_that_jumps_farther_than_its_accuracy_shows_no_present_position_for_two_seconds() -> None:
    origin, time_s, east_m = Origin(48.1, 11.6), np.arange(8.0), np.array([0.0, 1.0, 2.0, 3.0, 14.0, 15.0, 16.0, 17.0])
    latitude_deg, longitude_deg = origin.latitude_longitude_deg(np.column_stack([east_m, np.zeros(8)]))

    def places(accuracy_m: float, cut: int = 0) -> np.ndarray:
        columns = time_s, latitude_deg, longitude_deg, np.full(8, accuracy_m)
        first = good_locations(origin, *(c[:cut] for c in columns))
        last = [tuple(row) for row in first[-1:].tolist()]
        return np.concatenate([first, good_locations(origin, *(c[cut:] for c in columns), *last)])

    assert np.isfinite(places(10.0)).all()  # 11 m in a second: 9 m of error and 2 m of walking
    found = places(5.0)
    assert [location_at(found, t) is None for t in (3.5, 4.0, 5.9, 6.0, 6.5)] == [False, True, True, True, False]
    for cut in (3, 4, 5):
        np.testing.assert_array_equal(places(5.0, cut), found)
