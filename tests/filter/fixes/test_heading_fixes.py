"""Heading fixes: the first one determines the north of a track, later ones correct it or are rejected."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import OfHeading, streamed

import pdr_filter as pdr
from pdr_filter import HeadingFix, PositionFix
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import Fix, wrap_angle
from pdr_filter.values.recording import Recording

pytestmark = pytest.mark.usefixtures("sensing_once")

NORTH_RAD = (math.radians(45), math.radians(90), math.radians(180))


@pytest.fixture(scope="module")
def walk() -> Recording:
    turns = [Leg("walking", distance_m=30.0), Leg("walking", distance_m=20.0, turn_rad=1.4)]
    return simulate([Leg("stationary", duration_s=5.0), *turns], seed=1)


def headings(angle_rad: float) -> list[Fix]:
    """Three headings on the first leg, which leads to `angle_rad` clockwise from their north."""
    return [HeadingFix(t, angle_rad, 0.1) for t in (10.0, 15.0, 20.0)]


@pytest.mark.parametrize("weighting", ["imm", "wc", "hc"])
@pytest.mark.parametrize("angle_rad", NORTH_RAD)
def test_the_first_heading_fix_rotates_the_whole_track_online_and_smoothed(
    walk: Recording, weighting: str, angle_rad: float
) -> None:
    fixes = headings(angle_rad)
    online, smoothed = (f(walk, fixes=fixes, weighting=weighting) for f in (pdr.track, pdr.smooth))
    for track in (online, smoothed.track):
        assert track.frame == "heading fixes"
        assert [f.outcome for f in track.fixes] == ["used"] * 3
        first_leg = track.time_s < 20.0
        assert abs(wrap_angle(track.walking_heading_rad[first_leg] - angle_rad)).max() < 0.2
        toward = math.atan2(*track.position_m[first_leg][-1])
        assert abs(wrap_angle(toward - angle_rad)) < 0.1
    assert np.linalg.norm(online.end_position_m - smoothed.track.end_position_m) < 4.0


def test_a_filter_that_is_cut_saved_and_resumed_places_the_track_by_the_same_heading_fix(walk: Recording) -> None:
    fixes = headings(2.0)
    whole = pdr.track(walk, fixes=fixes)
    online, updates = streamed(walk, pdr.recipes.default(walk.subject), fixes, seed=3, n_resumed=6)
    frame = online.state.pedestrian.frame
    assert frame.name == whole.frame == "heading fixes"
    np.testing.assert_array_equal([u.in_frame(frame).position_m for u in updates], whole.position_m)
    np.testing.assert_array_equal([u.in_frame(frame).position_cov_m2 for u in updates], whole.position_cov_m2)
    np.testing.assert_allclose(online.path().position_m[-1], whole.position_m[-1], atol=1e-9)


@pytest.mark.parametrize("off_rad", [math.pi / 2, -math.pi / 2, math.pi])
@pytest.mark.parametrize("kind", [lambda t, z: HeadingFix(t, z, 0.1), OfHeading])
def test_a_heading_that_is_90_degrees_off_is_rejected_because_the_pedestrian_does_not_walk_sideways(
    walk: Recording, off_rad: float, kind: type[OfHeading]
) -> None:
    track = pdr.track(walk, fixes=[HeadingFix(10.0, 0.3, 0.1), kind(15.0, 0.3 + off_rad)])
    assert [f.outcome for f in track.fixes] == ["used", "rejected"]
    assert track.fixes[1].nis > 10.8
    assert any("not used: 1" in note for note in track.notes)


def test_a_wrong_heading_fix_among_right_ones_is_rejected_online_and_smoothed_with_a_note(walk: Recording) -> None:
    fixes = [HeadingFix(10.0, 0.5, 0.1), HeadingFix(14.0, 0.52, 0.1), HeadingFix(18.0, 2.5, 0.1)]
    for track in (pdr.track(walk, fixes=fixes), pdr.smooth(walk, fixes=fixes).track):
        assert [f.outcome for f in track.fixes] == ["used", "used", "rejected"]
        assert any("not used" in note for note in track.notes)
        assert abs(wrap_angle(track.walking_heading_rad[track.time_s < 18.0] - 0.5)).max() < 0.2


def test_position_fixes_relative_to_the_start_confirm_its_direction_unless_they_are_at_the_start(
    walk: Recording,
) -> None:
    heading = HeadingFix(18.0, 1.5, 0.1)
    at = pdr.track(walk)
    far = PositionFix(16.0, at.position_m[np.searchsorted(at.time_s, 16.0)], 0.25 * np.eye(2))
    confirmed = pdr.track(walk, fixes=[far, heading])
    assert ([f.outcome for f in confirmed.fixes], confirmed.frame) == (["used", "rejected"], "start")
    begun = pdr.track(walk, fixes=[PositionFix(5.0, (0.0, 0.0), 0.25 * np.eye(2)), heading])
    assert ([f.outcome for f in begun.fixes], begun.frame) == (["used", "used"], "heading fixes")
    assert begun.position_m[-1] @ (1.0, 0.0) > 25.0  # east, as the heading fix of 1.5 rad says


def test_two_vague_heading_fixes_do_not_rotate_the_steps_before_the_first_one_only_once(walk: Recording) -> None:
    vague = [HeadingFix(12.0, 2.0, 0.5), HeadingFix(18.0, 2.0, 0.5)]
    track = pdr.track(walk, fixes=vague)
    first_leg = track.time_s < 20.0
    assert abs(wrap_angle(track.walking_heading_rad[first_leg] - 2.0)).max() < 0.3


def test_a_heading_in_a_known_place_gives_true_north(walk: Recording) -> None:
    track = pdr.track(walk, fixes=headings(1.0), origin=(48.0, 11.0))
    assert track.frame == "heading fixes" and track.knows_north
    assert "north is that of the heading fixes" in track.about_frame
    east_first = track.longitude_deg[track.time_s < 20.0][-1] > 11.0
    assert east_first
    assert pdr.track(walk, fixes=headings(1.0)).turned(0.1).frame == "north"


def without_samples(walk: Recording, from_s: float, until_s: float) -> Recording:
    """Walk whose samples are missing for so long that the heading is lost."""
    kept = {}
    for name in ("accelerometer", "gyroscope"):
        samples = getattr(walk, name)
        rows = (samples.time_s < from_s) | (samples.time_s > until_s)
        kept[name] = pdr.Samples(samples.time_s[rows], samples.values[rows])
    return replace(walk, magnetometer=None, **kept)


def test_the_first_heading_fix_after_a_lost_heading_rotates_the_whole_track_online_and_smoothed() -> None:
    legs = [Leg("walking", distance_m=60.0), Leg("walking", distance_m=60.0, turn_rad=np.pi / 2)]
    walk = without_samples(simulate(legs, seed=3), 25.0, 60.0)
    heading_rad = 2.6  # after the corner, so that the first leg leads to 1.03 rad if the phone is held alike
    fix = HeadingFix(70.0, heading_rad, 0.1)
    track, smoothed = pdr.track(walk, fixes=[fix]), pdr.smooth(walk, fixes=[fix]).track
    for each in (track, smoothed):
        assert (each.frame, each.fixes[0].outcome) == ("heading fixes", "used")
        assert abs(wrap_angle(each.walking_heading_rad[each.time_s > 62.0] - heading_rad)).max() < 0.3
    # the first leg is rotated by the same angle, and its direction is uncertain by the gap
    alone = pdr.track(walk)
    first_leg = track.time_s < 25.0
    turned_rad = wrap_angle(track.walking_heading_rad - alone.walking_heading_rad)[first_leg]
    np.testing.assert_allclose(turned_rad, turned_rad[0], atol=1e-9)
    assert abs(wrap_angle(turned_rad[0] + alone.walking_heading_rad[-1] - heading_rad)) < 0.3
    at_gap = np.flatnonzero(first_leg)[-1]
    assert track.position_std_m[at_gap] > 0.7 * np.linalg.norm(track.position_m[at_gap])
    online, updates = streamed(walk, pdr.recipes.default(walk.subject), [fix], seed=5, n_resumed=4)
    frame = online.state.pedestrian.frame
    np.testing.assert_array_equal([u.in_frame(frame).position_m for u in updates], track.position_m)
    path = online.path()
    np.testing.assert_allclose(path.position_m[: path.n_steps][first_leg], track.position_m[first_leg], atol=0.3)
