"""Tracks with a given origin and heading, and the standard deviation of a position as one number."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

import pdr_filter as pdr
from pdr_filter.apps.report.geometry import ellipse_axes
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import RADIUS_68, RADIUS_95, HeadingFix, Origin, PositionFix, Samples
from pdr_filter.values.recording import Recording
from pdr_filter.values.uncertainty import worst_std_m

pytestmark = pytest.mark.usefixtures("sensing_once")

HERE = (48.137, 11.575)


@pytest.fixture(scope="module")
def walk() -> Recording:
    """A walk of 30 m straight ahead, then 20 m to the right."""
    legs = [Leg("walking", distance_m=30.0), Leg("walking", distance_m=20.0, turn_rad=np.pi / 2)]
    return simulate(legs, seed=3, name="walk")


@pytest.fixture(scope="module")
def alone(walk: Recording) -> pdr.Track:
    return pdr.track(walk)


def located(walk: Recording) -> Recording:
    """Return the walk with constant locations."""
    time_s = np.arange(1.0, walk.duration_s, 2.0)
    return replace(walk, location=Samples(time_s, np.tile([*HERE, 520.0, 6.0], (len(time_s), 1))))


# --- how sure ---------------------------------------------------------------------------------------------------------


def random_cov_m2(n: int = 50) -> np.ndarray:
    root = np.random.default_rng(0).normal(size=(n, 2, 2)) * [1.0, 3.0]
    return root @ root.swapaxes(1, 2)


def test_the_radii_contain_68_and_95_percent_of_a_circular_normal_distribution() -> None:
    assert chi2.cdf(RADIUS_68**2, 2) == pytest.approx(0.6827, abs=1e-3)
    assert chi2.cdf(RADIUS_95**2, 2) == pytest.approx(0.95, abs=1e-5)


def test_the_drawn_ellipse_has_the_semi_axis_of_95_percent_in_its_least_certain_direction() -> None:
    cov_m2 = random_cov_m2()
    np.testing.assert_allclose(RADIUS_95 * worst_std_m(cov_m2), ellipse_axes(cov_m2)[0][:, 1], rtol=1e-9)


def test_summary_report_and_description_agree_on_the_end_position(alone: pdr.Track) -> None:
    end_m = np.sqrt(np.linalg.eigvalsh(alone.position_cov_m2[-1])[-1])
    assert alone.summary()["end_std_m"] == pytest.approx(end_m, abs=1e-3)
    assert alone.how_sure == f"± {end_m:.1f} m (one standard deviation, worst direction)"
    assert alone.how_sure in alone.report()


# --- turned -----------------------------------------------------------------------------------------------------------


def test_a_given_heading_rotates_the_track(walk: Recording, alone: pdr.Track) -> None:
    east = pdr.track(walk, heading_rad=np.pi / 2)
    # a quarter to the right: north becomes east, east becomes south
    np.testing.assert_allclose(east.position_m, alone.position_m @ [[0, -1], [1, 0]], atol=1e-12)
    np.testing.assert_allclose(np.cos(east.walking_heading_rad - alone.walking_heading_rad - np.pi / 2), 1.0)
    a, b, c = (alone.position_cov_m2[:, i, j] for i, j in ((0, 0), (0, 1), (1, 1)))
    turned = np.stack([np.stack([c, -b], axis=-1), np.stack([-b, a], axis=-1)], axis=-2)
    np.testing.assert_allclose(east.position_cov_m2, turned, atol=1e-12)
    assert (alone.frame, east.frame, east.origin) == ("start", "north", None)
    assert "first heading" in alone.about_frame
    assert "true north, as given" in east.about_frame


def test_the_covariance_of_an_uncertain_rotation_equals_that_of_sampled_rotations(alone: pdr.Track) -> None:
    std_rad, exact = 0.05, alone.turned(0.8)
    grown = alone.turned(0.8, std_rad).position_cov_m2 - exact.position_cov_m2
    ends_m = np.array([alone.turned(0.8 + e).position_m[-1] for e in np.random.default_rng(2).normal(0, std_rad, 4000)])
    np.testing.assert_allclose(grown[-1], np.cov(ends_m.T), atol=0.05 * np.trace(grown[-1]))
    np.testing.assert_array_equal(exact.position_std_m.round(9), alone.position_std_m.round(9))


def test_a_track_with_true_north_cannot_be_rotated(alone: pdr.Track) -> None:
    with pytest.raises(ValueError, match=r"already true north, got turn_rad=0\.3"):
        alone.turned(1.0).turned(0.3)


# --- placed -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("turn", [(np.nan,), (np.inf,), (1.0, -0.1), (1.0, np.nan)])
def test_an_invalid_rotation_is_refused(alone: pdr.Track, turn: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=r"(turn_rad must be|std_rad must be 0 or more and) finite"):
        alone.turned(*turn)


def test_a_track_on_a_floor_plan_cannot_be_rotated(alone: pdr.Track) -> None:
    plan = pdr.FloorPlan("hall", storeys=())
    with pytest.raises(ValueError, match="frame of its floor plan"):
        replace(alone, plan=plan, frame="plan").turned(1.0)
    with pytest.raises(ValueError, match="already true north"):
        replace(alone, plan=plan, frame="plan", origin=Origin(*HERE)).turned(1.0)


@pytest.mark.parametrize("mode", ["pocket", "calling", "swinging", "texting"])
@pytest.mark.parametrize("track_of", [pdr.track, lambda *args, **named: pdr.smooth(*args, **named).track])
def test_a_given_heading_is_that_of_the_first_steps_after_the_phone_was_moved(mode: str, track_of: Any) -> None:
    first = "pocket" if mode == "texting" else "texting"
    legs = [Leg("stationary", duration_s=5.0, carrying_mode=first), Leg("walking", distance_m=40.0, carrying_mode=mode)]
    track = track_of(simulate(legs, carrying_mode=first, seed=1), heading_rad=2.0)
    along_m = track.end_position_m @ [np.sin(2.0), np.cos(2.0)]
    assert along_m > np.cos(0.35) * np.linalg.norm(track.end_position_m) > 20.0


def test_a_given_heading_is_that_before_a_turn_of_the_person_at_rest() -> None:
    legs = [Leg("stationary", duration_s=5.0), Leg("walking", distance_m=40.0, turn_rad=1.2)]
    track = pdr.track(simulate(legs, seed=1), heading_rad=0.5)
    assert np.arctan2(*track.end_position_m) == pytest.approx(1.7, abs=0.3)


def test_the_speed_at_an_unknown_time_is_nan(alone: pdr.Track) -> None:
    during_s = float(alone.time_s[5]) - 0.1
    np.testing.assert_equal(np.isnan(alone.speed_mps([during_s, np.nan, -1.0])), [False, True, False])


def test_a_track_is_placed_at_the_given_origin(walk: Recording, alone: pdr.Track) -> None:
    track = pdr.track(walk, origin=HERE, heading_rad=1.1)
    assert track.origin == Origin(*HERE, turn_rad=1.1)
    np.testing.assert_array_equal(track.position_m, alone.turned(1.1).position_m)
    there_m = Origin(*HERE).east_north_m(track.latitude_deg, track.longitude_deg)
    np.testing.assert_allclose(there_m, track.position_m, atol=2e-3)


def test_the_covariance_includes_the_standard_deviations_of_the_origin(alone: pdr.Track) -> None:
    track = alone.placed(Origin(*HERE, turn_rad=0.4, turn_std_rad=0.1, position_std_m=3.0))
    expected = alone.turned(0.4, 0.1).position_cov_m2 + 9.0 * np.eye(2)
    np.testing.assert_allclose(track.position_cov_m2, expected)
    assert "measured, ± 6 degrees." in track.about_frame


def test_a_track_with_an_origin_but_no_heading_states_that_north_is_unknown(walk: Recording) -> None:
    track = pdr.track(walk, origin=HERE)
    assert track.frame == "start"
    assert "from the start of the walk at 48.137000, 11.575000; north is the direction" in track.about_frame
    assert "true north is unknown" in track.about_frame


def test_a_track_may_be_placed_first_and_rotated_afterwards(alone: pdr.Track) -> None:
    late, at_once = alone.placed(HERE).turned(0.7, 0.1), alone.placed(Origin(*HERE, turn_rad=0.7, turn_std_rad=0.1))
    assert late.origin == at_once.origin
    np.testing.assert_array_equal(late.position_m, at_once.position_m)
    np.testing.assert_array_equal(late.position_cov_m2, at_once.position_cov_m2)


def test_a_placed_track_moves_to_another_origin_unchanged(alone: pdr.Track) -> None:
    track = alone.placed(Origin(*HERE, turn_rad=0.4))
    again = track.placed(Origin(0.0, 0.0, turn_rad=2.0))
    np.testing.assert_array_equal(again.position_m, track.position_m)
    assert abs(again.latitude_deg).max() < 1e-3


def test_a_given_origin_disables_the_locations_with_a_note(walk: Recording, alone: pdr.Track) -> None:
    for given in ({"origin": HERE}, {"heading_rad": 0.0}):
        track = pdr.track(located(walk), **given)
        np.testing.assert_allclose(track.position_m, alone.position_m)
        assert track.fixes == ()
        assert any("locations of the recording were not used" in note for note in track.notes)
        assert not any(
            "locations of the recording were not used" in note
            for note in pdr.track(located(walk), gnss="off", **given).notes
        )


def test_fixes_in_metres_of_a_map_are_placed_by_the_origin_of_the_map(walk: Recording) -> None:
    fixes = [PositionFix(t, np.array([5.0, 7.0 + t]), np.eye(2)) for t in (5.0, 12.0, 18.0)]
    config = pdr.recipes.default(walk.subject).in_world_frame()
    track, placed = (pdr.track(walk, config, fixes=fixes, origin=origin) for origin in (None, HERE))
    np.testing.assert_array_equal(track.position_m, placed.position_m)
    assert placed.frame == "fixes"
    assert track.about_frame == "East and north are metres in the frame of the fixes."
    where = "in the frame of the fixes, whose origin is at 48.137000, 11.575000; north is true north; the direction"
    assert where in placed.about_frame
    assert placed.knows_north
    # the frame of the start does not affect the frame of the fixes
    as_it_is = track.placed(Origin(*HERE, turn_rad=1.0, turn_std_rad=0.2, position_std_m=9.0))
    np.testing.assert_array_equal(as_it_is.position_m, track.position_m)
    np.testing.assert_array_equal(as_it_is.position_cov_m2, track.position_cov_m2)
    assert track.turned(1.0).placed(HERE).frame == "north"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"origin": (91.0, 0.0)}, r"origin must be \(latitude, longitude\).*got \(91.0, 0.0\)"),
        ({"heading_rad": math.nan}, "heading_rad must be a finite number"),
        ({"heading_rad": "1"}, r"heading_rad must be a finite number.*'1'; 90 degrees are math.radians"),
        ({"heading_rad": 0.1, "fixes": [HeadingFix(5.0, 0.0, 0.1)]}, "together with fixes in another frame"),
        ({"origin": HERE, "gnss": "on"}, "gnss must be"),
        ({"origin": HERE, "gnss": "filter"}, r'gnss="filter" .* got origin too: leave out gnss or origin'),
        ({"heading_rad": 0.1, "gnss": "filter"}, "got heading_rad too"),
    ],
)
def test_contradicting_arguments_and_invalid_origins_are_refused(
    walk: Recording, given: dict[str, object], said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        pdr.track(located(walk), **given)  # type: ignore[arg-type]


# --- fixes in degrees -------------------------------------------------------------------------------------------------


def test_a_fix_in_degrees_equals_the_fix_in_metres() -> None:
    origin = Origin(*HERE)
    latitude_deg, longitude_deg = (float(v) for v in origin.latitude_longitude_deg(np.array([120.0, -40.0])))
    for place in (origin, HERE):
        fix = PositionFix.from_lat_lon(7.0, latitude_deg, longitude_deg, place, std_m=4.0, received_time_s=8.0)
        np.testing.assert_allclose(fix.position_m, [120.0, -40.0], atol=2e-3)
        np.testing.assert_array_equal(fix.cov_m2, 16.0 * np.eye(2))
        assert (fix.time_s, fix.received_time_s) == (7.0, 8.0)


def test_a_degree_is_longer_at_a_higher_altitude() -> None:
    low, high = (Origin(*HERE, height_m=h).east_north_m(HERE[0] + 0.01, HERE[1])[1] for h in (None, 6371.0))
    assert high / low == pytest.approx(1.001, abs=1e-5)
    at = Origin(*HERE, height_m=6371.0)
    np.testing.assert_allclose(
        at.east_north_m(*at.latitude_longitude_deg(np.array([30.0, 40.0]))), [30.0, 40.0], atol=1e-3
    )
