"""Heading lost in a gap: the rotation of the track is unknown again until fixes determine it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from average_walk import average_walk
from helpers import nees_of, streamed, true_position_m
from scipy.stats import chi2

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.filter.pedestrian.frame import START_FRAME
from pdr_filter.filter.pedestrian.frame_rotation import Compass, PairedPoint
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import HeadingFix, PositionFix
from pdr_filter.values.recording import Recording, Samples
from pdr_filter.values.uncertainty import worst_std_m

pytestmark = pytest.mark.usefixtures("sensing_once")

# The person turns by 2.2 rad in the gap.
GAP_BEGIN_S, GAP_END_S = 97.0, 102.0
FIX_STD_M = 2.0
FAR_M = np.array([80.0, -60.0])


def in_gap(time_s: np.ndarray) -> np.ndarray:
    return (time_s > GAP_BEGIN_S) & (time_s < GAP_END_S)


@pytest.fixture(scope="module")
def whole() -> Recording:
    legs = [Leg("walking", distance_m=70.0, turn_rad=turn) for turn in (0.0, 1.2, 2.2, 0.3)]
    return simulate(legs, seed=5, name="walk")


def without(whole: Recording, is_lost: Callable[[np.ndarray], np.ndarray]) -> Recording:
    """Return the recording without the samples at some times."""
    left = {}
    for name in ("accelerometer", "gyroscope", "magnetometer"):
        samples = getattr(whole, name)
        keep = ~is_lost(samples.time_s)
        left[name] = Samples(samples.time_s[keep], samples.values[keep])
    return replace(whole, **left)


@pytest.fixture(scope="module")
def walk(whole: Recording) -> Recording:
    return without(whole, in_gap)


def fixes_of(walk: Recording) -> list[PositionFix]:
    """Return one fix in twelve seconds, none near the gap."""
    times = np.arange(3.0, walk.duration_s - 4.0, 12.0)
    errors = np.random.default_rng(2).normal(scale=FIX_STD_M, size=(len(times), 2))
    places = true_position_m(walk, times) + errors
    return [PositionFix(float(t), place, FIX_STD_M**2 * np.eye(2)) for t, place in zip(times, places, strict=True)]


def tracked(walk: Recording, fixes: list[PositionFix | HeadingFix], weighting: str = "imm") -> pdr.Track:
    return pdr.track(walk, recipes.default(walk.subject).in_world_frame(), weighting=weighting, fixes=fixes)


def nees(walk: Recording, time_s: np.ndarray, position_m: np.ndarray, cov_m2: np.ndarray) -> np.ndarray:
    return nees_of(position_m - true_position_m(walk, time_s), cov_m2)


@pytest.mark.parametrize("weighting", ["imm", "wc"])
def test_fixes_after_a_lost_heading_rotate_the_track_which_stays_inside_its_ellipse(
    walk: Recording, weighting: str
) -> None:
    track = tracked(walk, [*fixes_of(walk)], weighting)
    after = [fix.outcome for fix in track.fixes if fix.time_s > GAP_END_S]
    assert after[0] == "turned"
    assert "rejected" not in after
    assert nees(walk, track.time_s, track.position_m, track.position_cov_m2).max() < chi2.isf(1e-3, 2)
    error_m = np.linalg.norm(track.position_m - true_position_m(walk, track.time_s), axis=1)
    assert error_m[track.time_s > GAP_END_S + 40.0].max() < 8.0


def test_a_heading_fix_after_a_lost_heading_rotates_the_track_at_once(walk: Recording) -> None:
    heading = HeadingFix(108.0, 3.4, 0.1)
    track = tracked(walk, sorted([*fixes_of(walk), heading], key=lambda fix: fix.time_s))
    assert next(fix.outcome for fix in track.fixes if fix.time_s == heading.time_s) == "used"
    soon = (track.time_s > 108.0) & (track.time_s < 125.0)
    error_m = np.linalg.norm(track.position_m - true_position_m(walk, track.time_s), axis=1)
    assert error_m[soon].max() < 12.0
    assert nees(walk, track.time_s, track.position_m, track.position_cov_m2).max() < chi2.isf(1e-3, 2)


def test_a_smoothed_track_is_accurate_also_before_the_fixes_that_determine_the_rotation(walk: Recording) -> None:
    found = pdr.smooth(walk, fixes=fixes_of(walk)).track
    error_m = np.linalg.norm(found.position_m - true_position_m(walk, found.time_s), axis=1)
    assert error_m.max() < 6.0
    assert nees(walk, found.time_s, found.position_m, found.position_cov_m2).max() < chi2.isf(1e-3, 2)


@pytest.mark.parametrize("is_in_world", [True, False])
def test_a_reopened_rotation_does_not_depend_on_the_blocks_of_samples(walk: Recording, is_in_world: bool) -> None:
    config = recipes.default(walk.subject)
    config = config.in_world_frame() if is_in_world else config
    begun = without(walk, lambda time_s: time_s > GAP_END_S + 50.0)
    tracks = []
    for seed, n_resumed in ((1, 0), (2, 5)):
        _, updates = streamed(begun, config, fixes_of(walk), seed, n_resumed)
        tracks.append(np.array([u.position_m for u in updates]).tobytes())
    assert tracks[0] == tracks[1]


def with_wrong(fixes: list[PositionFix], begin_s: float, end_s: float) -> list[PositionFix]:
    """Return fixes, with an error of 100 m between two times."""
    return [replace(fix, position_m=fix.position_m + FAR_M * (begin_s < fix.time_s < end_s)) for fix in fixes]


def test_one_wrong_fix_after_a_lost_heading_does_not_move_the_track(walk: Recording) -> None:
    track = tracked(walk, [*with_wrong(fixes_of(walk), GAP_END_S, GAP_END_S + 12.0)])
    after = [fix.outcome for fix in track.fixes if fix.time_s > GAP_END_S]
    assert after[0] == "rejected"
    assert "rejected" not in after[1:]
    assert nees(walk, track.time_s, track.position_m, track.position_cov_m2).max() < chi2.isf(1e-3, 2)


def test_fixes_that_contradict_the_position_of_a_lost_heading_for_long_relocate_the_track_with_a_note(
    walk: Recording,
) -> None:
    track = tracked(walk, [*with_wrong(fixes_of(walk), GAP_END_S, np.inf)])
    moved = next(fix.time_s for fix in track.fixes if fix.outcome == "moved")
    assert moved > GAP_END_S + 60.0
    (note,) = (note for note in track.notes if "the track was moved by" in note)
    assert "," not in note.partition("the track was moved by ")[2].partition(" m")[0]  # once
    error_m = np.linalg.norm(track.position_m - true_position_m(walk, track.time_s) - FAR_M, axis=1)
    after = track.time_s > moved + 2.0
    assert error_m[after].max() < 21.0
    assert worst_std_m(track.position_cov_m2[after]).max() < 21.0  # the direction since the last fix is unknown


def test_a_fix_at_the_start_of_a_gap_has_little_information_about_the_position_at_its_end(whole: Recording) -> None:
    walk = without(whole, lambda time_s: (time_s > 97.0) & (time_s < 117.0))
    fixes = [fix for fix in fixes_of(walk) if fix.time_s < 97.0]
    late = PositionFix(99.0, true_position_m(walk, 99.0), FIX_STD_M**2 * np.eye(2))
    track = tracked(walk, [*fixes, late])
    first = int(np.searchsorted(track.time_s, 117.0))
    std_m = np.sqrt(np.linalg.eigvalsh(track.position_cov_m2[first])[0])
    assert 12.0 < std_m < 25.0  # 18 s at a metre a second
    known = tracked(walk, [*fixes, replace(late, time_s=116.9, position_m=true_position_m(walk, 116.9))])
    assert np.sqrt(np.linalg.eigvalsh(known.position_cov_m2[first])[0]) < 5.0


def test_after_a_gyroscope_failure_behind_the_fixes_the_walk_stays_inside_the_ellipse(whole: Recording) -> None:
    assert whole.gyroscope is not None
    turning, dies_s = whole.gyroscope, 60.0
    stuck = turning.values.copy()
    stuck[turning.time_s > dies_s, 2] = 0.1
    broken = replace(whole, gyroscope=Samples(turning.time_s, stuck))
    before, later = ([f for f in fixes_of(whole) if (f.time_s < dies_s) is is_before] for is_before in (True, False))
    for fixes in (before, [*before, *later[1::2]]):
        track = tracked(broken, fixes)
        off = track.time_s > dies_s + 5.0
        squared = nees(whole, track.time_s[off], track.position_m[off], track.position_cov_m2[off])
        assert (squared < chi2.ppf(0.99, 2)).mean() > 0.97


def turned_in_gap(end_s: float = 75.0) -> Recording:
    """Return a walk without samples from 30 s on, during which it turns."""
    return without(average_walk(), lambda time_s: (time_s > 30.0) & (time_s < end_s))


@pytest.mark.parametrize("weighting", ["imm", "hc"])
def test_fixes_in_the_start_frame_rotate_the_track_after_a_lost_heading(weighting: str) -> None:
    walk = turned_in_gap()
    track = pdr.track(walk, recipes.default(walk.subject), weighting=weighting, fixes=fixes_of(walk))
    assert track.frame == "start"
    assert all(fix.outcome in ("used", "turned") for fix in track.fixes)
    assert nees(walk, track.time_s, track.position_m, track.position_cov_m2).max() < chi2.isf(1e-3, 2)
    assert np.linalg.norm(track.position_m[-1] - true_position_m(walk, track.time_s[-1:])[0]) < 5.0


def test_after_wrong_fixes_behind_a_lost_heading_right_ones_relocate_the_track_in_the_start_frame() -> None:
    walk = simulate([Leg("walking", distance_m=70.0, turn_rad=turn) for turn in (0.0, 1.2, 2.2, 0.3)], seed=5)
    walk = without(walk, lambda time_s: (time_s > 60.0) & (time_s < 100.0))
    times = np.arange(3.0, walk.duration_s - 2.0, 3.0)
    places = true_position_m(walk, times)
    is_wrong = (times > 100.0) & (times < 112.0)
    places[is_wrong] = places[is_wrong][::-1]  # the way back, at the same places
    fixes = [PositionFix(float(t), p, np.eye(2)) for t, p in zip(times, places, strict=True)]
    track = pdr.track(walk, recipes.default(walk.subject), fixes=fixes)
    assert np.linalg.norm(track.position_m[-1] - true_position_m(walk, track.time_s[-1:])[0]) < 5.0


def test_without_fixes_a_track_keeps_its_shape_after_a_lost_heading_and_may_point_anywhere() -> None:
    walk = turned_in_gap()
    track = pdr.track(walk)
    after = track.time_s > 75.0
    moved_m = np.linalg.norm(np.diff(track.position_m[after], axis=0), axis=1)
    assert moved_m.sum() == pytest.approx(track.step_length_m[after][1:].sum(), rel=0.02)
    way_m = np.linalg.norm(track.position_m[after] - track.position_m[after][0], axis=1)
    var_m2 = 0.5 * np.trace(track.position_cov_m2[after], axis1=1, axis2=2)
    assert (var_m2[-1] - var_m2[0]) ** 0.5 == pytest.approx(way_m[-1], rel=0.1)  # 2 d^2 for any direction
    assert track.frame == "start"
    assert any("the heading is uncertain" in note for note in track.notes)


def test_ranges_within_a_gap_do_not_place_the_track_after_it() -> None:
    walk, rng = turned_in_gap(), np.random.default_rng(0)
    times = np.arange(5.0, 112.0, 2.0)
    anchors = [np.array(anchor) for anchor in ((-10.0, 0.0), (40.0, 0.0), (40.0, 40.0), (-10.0, 40.0))]
    ranges = [
        pdr.RangeFix(float(t), anchor, float(np.linalg.norm(place - anchor) + rng.normal(0, 0.5)), 0.5)
        for t, place in zip(times, true_position_m(walk, times), strict=True)
        for anchor in anchors
    ]
    track = pdr.track(walk, fixes=ranges)
    assert "rejected" not in {fix.outcome for fix in track.fixes}
    assert (
        np.linalg.norm(track.position_m - true_position_m(walk, track.time_s), axis=1)[track.time_s > 75.0].max() < 3.0
    )


def test_magnetic_north_does_not_rotate_a_track_in_the_start_frame() -> None:
    point = PairedPoint(np.zeros(2), np.zeros(2), 1.0)
    lost = START_FRAME.with_lost_heading((point,), np.inf, n_steps=10)
    assert lost.with_compass(Compass(1.0, 0.01)) is lost
    assert (lost.name, lost.is_known) == ("start", False)
