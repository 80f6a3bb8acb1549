"""Relocation of a track by fixes that agree with each other but not with the track."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from helpers import clockwise, nees_of, of_nobody, streamed, true_position_m
from scipy.stats import chi2

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.filter.pedestrian.frame_rotation import PairedPoint
from pdr_filter.filter.pedestrian.relocation import EPISODE_S, MAX_REJECTED, PRIOR_LOG_ODDS, RelocationEvidence
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import PositionFix
from pdr_filter.values.recording import Recording

pytestmark = pytest.mark.usefixtures("sensing_once")

TURN_RAD = 1.9
FAR_M = np.array([80.0, -60.0])
# Time until the odds are sufficient, plus the interval of ten seconds between two fixes.
PATIENCE_S = PRIOR_LOG_ODDS * EPISODE_S + 11.0


@pytest.fixture(scope="module")
def walk() -> Recording:
    """Walk of five minutes through streets."""
    legs = [Leg("walking", distance_m=60.0, turn_rad=turn) for turn in (0.0, 1.2, -0.9, 1.6, 0.7, -1.4, 1.0)]
    return of_nobody(simulate(legs, seed=3, name="walk"))


def truth_m(walk: Recording, times: np.ndarray) -> np.ndarray:
    return true_position_m(walk, times) @ clockwise(TURN_RAD).T


def fixes_of(walk: Recording, wrong_m: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> list[PositionFix]:
    """Return a fix each 10 s with errors of 4 m, plus the error `wrong_m` (times, places)."""
    times = np.arange(2.0, walk.duration_s - 4.0, 10.0)
    places = truth_m(walk, times)
    errors = np.random.default_rng(4).normal(scale=4.0, size=places.shape)
    return [
        PositionFix(float(t), place, 16.0 * np.eye(2))
        for t, place in zip(times, places + errors + wrong_m(times, places), strict=True)
    ]


def tracked(walk: Recording, fixes: list[PositionFix], weighting: str = "imm") -> pdr.Track:
    return pdr.track(walk, recipes.default(walk.subject).in_world_frame(), weighting=weighting, fixes=fixes)


def outcomes(track: pdr.Track) -> list[str]:
    return [fix.outcome for fix in track.fixes]


def displaced(begin_s: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return an error of `FAR_M` from some time on, as after a ride."""
    return lambda times, _: FAR_M * (times > begin_s)[:, None]


@pytest.mark.parametrize("weighting", ["imm", "wc"])
def test_after_a_ride_the_track_is_relocated_and_a_note_says_so(walk: Recording, weighting: str) -> None:
    track = tracked(walk, fixes_of(walk, displaced(120.0)), weighting)
    assert outcomes(track).count("moved") == 1
    error = track.position_m - truth_m(walk, track.time_s) - FAR_M * (track.time_s > 120.0)[:, None]
    late = track.time_s > 120.0 + PATIENCE_S
    assert np.linalg.norm(error[late], axis=1).max() < 15.0
    assert nees_of(error[late], track.position_cov_m2[late]).max() < chi2.isf(1e-3, 2)
    assert any("the track was moved by 1" in note for note in track.notes)
    moved = next(fix for fix in track.fixes if fix.outcome == "moved")
    assert moved.accepted
    assert np.linalg.norm(error[track.time_s < 120.0], axis=1).max() < 15.0


@pytest.mark.parametrize("angle_rad", [0.0, 2.0])
def test_the_track_recovers_from_wrong_first_fixes_that_determined_the_frame(walk: Recording, angle_rad: float) -> None:
    """The wrong fixes are a kilometre away, and rotated."""

    def wrong_m(times: np.ndarray, places: np.ndarray) -> np.ndarray:
        return ((places @ clockwise(angle_rad).T - places) + [800.0, 600.0]) * (times < 45.0)[:, None]

    track = tracked(walk, fixes_of(walk, wrong_m))
    assert "used" in outcomes(track)[:5] or "turned" in outcomes(track)[:5]
    assert outcomes(track).count("moved") == 1
    error_m = np.linalg.norm(track.position_m - truth_m(walk, track.time_s), axis=1)
    assert error_m[track.time_s > 45.0 + PATIENCE_S + 20.0].max() < 20.0


def test_the_track_recovers_from_wrong_first_fixes_that_left_the_rotation_unknown(walk: Recording) -> None:
    begin_m = truth_m(walk, np.array([2.0]))[0]
    # fixes in one place leave the rotation unknown, so that only later fixes can correct the track
    wrong = fixes_of(walk, lambda times, places: (begin_m + 10.0 * FAR_M - places) * (times < 50.0)[:, None])
    track = tracked(walk, [replace(fix, cov_m2=64.0 * np.eye(2)) for fix in wrong])
    assert "moved" in outcomes(track)
    moved_s = track.fixes[outcomes(track).index("moved")].time_s
    assert moved_s < 50.0 + PATIENCE_S + 10.0
    late = track.time_s > moved_s + 30.0
    error_m = np.linalg.norm(track.position_m - truth_m(walk, track.time_s), axis=1)
    assert np.median(error_m[late]) < 10.0


def test_inconsistent_outliers_stay_rejected(walk: Recording) -> None:
    rng = np.random.default_rng(1)

    def wrong_m(times: np.ndarray, places: np.ndarray) -> np.ndarray:
        return rng.normal(scale=1000.0, size=places.shape) * ((times > 60.0) & (rng.random(len(times)) < 0.5))[:, None]

    track = tracked(walk, fixes_of(walk, wrong_m))
    assert outcomes(track).count("rejected") > 5
    assert "moved" not in outcomes(track)
    error_m = np.linalg.norm(track.position_m - truth_m(walk, track.time_s), axis=1)
    assert error_m.max() < 15.0


@pytest.mark.parametrize(("lasts_s", "is_moved"), [(0.8, False), (2.0, True)])
def test_fixes_with_a_common_error_relocate_the_track_when_they_outlast_a_reflection(
    walk: Recording, lasts_s: float, is_moved: bool
) -> None:
    end_s = 120.0 + lasts_s * PRIOR_LOG_ODDS * EPISODE_S
    track = tracked(walk, fixes_of(walk, lambda times, _: FAR_M * ((times > 120.0) & (times < end_s))[:, None]))
    assert ("moved" in outcomes(track)) == is_moved


def test_static_fixes_do_not_relocate_a_walking_pedestrian(walk: Recording) -> None:
    """The fixes stay in one place for two minutes."""

    def wrong_m(times: np.ndarray, places: np.ndarray) -> np.ndarray:
        stays = (times > 120.0) & (times < 240.0)
        return (places[12] + FAR_M - places) * stays[:, None]

    track = tracked(walk, fixes_of(walk, wrong_m))
    assert outcomes(track).count("rejected") > 9
    assert "moved" not in outcomes(track)


def test_static_fixes_do_not_relocate_a_standing_pedestrian() -> None:
    evidence = RelocationEvidence()
    for t in np.arange(0.0, 600.0, 10.0):
        last = PairedPoint(np.zeros(2), FAR_M, 9.0, 0.0, t)
        evidence = evidence.with_rejected(last)
        assert evidence.alignment(last, 0.01, 0, True) is None
    walked = RelocationEvidence()
    for t in np.arange(0.0, 100.0, 10.0):
        place = np.array([0.0, t])
        last = PairedPoint(place, place + FAR_M, 9.0, 0.0, t)
        walked = walked.with_rejected(last)
    alignment = walked.alignment(last, 0.01, 0, True)
    assert alignment is not None
    np.testing.assert_allclose(alignment.positions(np.zeros(2)), FAR_M)
    assert alignment.angle_rad == pytest.approx(0.0, abs=1e-9)
    assert alignment.angle_var_rad2 < 0.01


def test_a_given_frame_is_shifted_but_never_rotated(walk: Recording) -> None:
    straight = [
        replace(fix, position_m=fix.position_m @ clockwise(TURN_RAD) + FAR_M * (fix.time_s > 100.0))
        for fix in fixes_of(walk, lambda times, places: np.zeros_like(places))
    ]
    config = recipes.default(walk.subject)
    assert outcomes(pdr.track(walk, config, fixes=straight)).count("moved") == 1
    turned = [replace(fix, position_m=fix.position_m @ clockwise(2.0).T) for fix in straight]
    assert "moved" not in outcomes(pdr.track(walk, config, fixes=turned))


def test_block_sizes_and_saving_change_no_bit_of_a_relocated_track(walk: Recording) -> None:
    fixes, config = fixes_of(walk, displaced(120.0)), recipes.default().in_world_frame()
    whole = pdr.track(walk, config, fixes=fixes)
    assert "moved" in outcomes(whole)
    online, updates = streamed(walk, config, fixes, seed=2, n_resumed=8)
    later = [u for u in updates if u.of_start is None]
    np.testing.assert_array_equal([u.position_m for u in later], whole.position_m[-len(later) :])
    assert online.notes == tuple(note for note in whole.notes if note not in walk.notes)


@pytest.mark.parametrize("every_s", [2.0, 10.0, 45.0])
def test_stored_rejected_fixes_reach_back_twice_the_necessary_time_and_are_at_most_twelve(every_s: float) -> None:
    evidence = RelocationEvidence()
    for time_s in np.arange(0.0, 600.0, every_s):
        track_m = np.array([1.3 * time_s, 0.0])
        evidence = evidence.with_rejected(PairedPoint(track_m, track_m + FAR_M, 16.0, time_s=float(time_s)))
    times_s = np.array([pair.time_s for pair in evidence.pairs])
    assert 3 <= len(times_s) <= MAX_REJECTED
    # one fix may be older than this time, because the fixes must cover all of it
    assert times_s[-1] - times_s[1] < 2.0 * PRIOR_LOG_ODDS * EPISODE_S <= times_s[-1] - times_s[0] + every_s
