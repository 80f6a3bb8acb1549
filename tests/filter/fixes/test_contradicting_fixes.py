"""Fixes of which most contradict the walk: mirrored or exchanged axes, speeds in another unit."""

import numpy as np
import pytest
from helpers import streamed, true_position_m

import pdr_filter as pdr
from pdr_filter.filter.fixes.fix_conflict import FixConflict
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import FloatArray
from pdr_filter.values.recording import Recording

MIRRORED, EXCHANGED = np.diag([-1.0, 1.0]), np.array([[0.0, 1.5], [0.67, 0.0]])


@pytest.fixture(scope="module")
def walk() -> Recording:
    legs = [Leg("walking", distance_m=d, turn_rad=np.pi / 2) for _ in range(2) for d in (40, 25, 40, 25)]
    return simulate(legs, seed=2)


def positions(walk: Recording, axes: FloatArray) -> list[pdr.PositionFix]:
    """Position fixes with errors of 3 m along each axis, whose true positions are transformed by a matrix (2, 2)."""
    truth, rng = walk.truth.position, np.random.default_rng(0)
    times_s = np.arange(3.0, truth.time_s[-1] - 1.0, 7.0)
    places = true_position_m(walk, times_s)
    places = (places + rng.normal(0.0, 3.0, places.shape)) @ axes.T
    return [pdr.PositionFix(t, p, 9.0 * np.eye(2)) for t, p in zip(times_s.tolist(), places, strict=True)]


def tracks(walk: Recording, fixes: list[pdr.PositionFix]) -> list[pdr.Track]:
    online = pdr.track(walk, pdr.recipes.default(walk.subject).in_world_frame(), fixes=fixes)
    return [online, pdr.smooth(walk, fixes=fixes).track]


@pytest.mark.parametrize("axes", [MIRRORED, EXCHANGED])
def test_a_majority_of_contradicting_positions_is_counted_in_a_note_and_the_deviation_covers_them(
    walk: Recording, axes: FloatArray
) -> None:
    fixes = positions(walk, axes)
    for track in tracks(walk, fixes):
        rejected = [k for k, f in enumerate(track.fixes) if f.outcome == "rejected"]
        assert len(rejected) > sum(f.outcome == "used" for f in track.fixes)
        (note,) = (n for n in track.notes if "contradict the walk" in n)
        n_contradicting, n_compared = (int(word) for word in note.split()[:3:2])
        assert len(rejected) >= n_contradicting > n_compared / 2
        far_m = [
            np.linalg.norm(track.position_m[np.searchsorted(track.time_s, fixes[k].time_s) - 1] - fixes[k].position_m)
            for k in rejected[-8:]
        ]
        assert np.median(far_m) < 2.0 * track.position_std_m[-1]


def test_correct_positions_cause_no_note_and_no_larger_deviation(walk: Recording) -> None:
    for track in tracks(walk, positions(walk, np.eye(2))):
        assert not any("contradict" in note for note in track.notes)
        assert track.position_std_m[-1] < 3.0


def test_positions_of_another_frame_leave_the_deviation_of_a_track_in_its_own_frame(walk: Recording) -> None:
    fixes = [pdr.PositionFix(f.time_s, f.position_m + 300.0, f.cov_m2) for f in positions(walk, np.eye(2))[:10]]
    track = pdr.track(walk, fixes=fixes)
    assert track.frame == "start"
    np.testing.assert_array_equal(track.position_cov_m2, pdr.track(walk).position_cov_m2)
    assert any(f"{len(fixes)} of {len(fixes)} position fixes" in note for note in track.notes)


def test_a_resumed_filter_states_the_same_deviation_in_any_blocks(walk: Recording) -> None:
    config, fixes = pdr.recipes.default(walk.subject).in_world_frame(), positions(walk, MIRRORED)
    whole = pdr.track(walk, config, fixes=fixes)
    online, updates = streamed(walk, config, fixes, seed=4, n_resumed=4)
    np.testing.assert_array_equal(updates[-1].position_cov_m2, whole.position_cov_m2[-1])
    assert set(online.notes) <= set(whole.notes)


def test_a_walk_is_doubtful_from_four_fixes_that_contradict_it_and_half_as_many_as_fit_not_by_rotation() -> None:
    away_m = np.array([3.0, 4.0])

    def after(n_used: int, n_rejected: int) -> FixConflict:
        found = FixConflict()
        for outcome in ["placed", "turned", *(8 * ["used"])][:n_used] + ["rejected"] * n_rejected:
            found = found.plus(outcome, away_m)
        return found

    assert [after(3, n).is_doubtful for n in (3, 4)] == [False, True]
    assert [after(10, n).is_doubtful for n in (4, 5)] == [False, True]
    np.testing.assert_allclose(after(6, 6).cov_m2, 0.5 * 25.0 * np.eye(2))
    assert not after(0, 6).cov_m2.any() and not after(10, 4).cov_m2.any()
    assert not after(2, 6).plus("moved", away_m).is_doubtful


def test_speeds_in_km_per_hour_do_not_change_the_smoothed_walk_and_are_named(walk: Recording) -> None:
    times_s = np.arange(3.0, walk.duration_s - 3.0, 5.0).tolist()
    wrong = pdr.smooth(walk, fixes=[pdr.SpeedFix(t, 3.6 * 1.3, 0.2 + 0.01 * k) for k, t in enumerate(times_s)])
    assert wrong.track.distance_m == pytest.approx(pdr.smooth(walk).track.distance_m, rel=1e-6)
    assert not wrong.observations.weight.any()
    (note,) = (n for n in wrong.notes if "km/h" in n)
    assert "times that of the steps" in note
    right = pdr.smooth(walk, fixes=[pdr.SpeedFix(t, 1.3 + 0.001 * k, 0.2) for k, t in enumerate(times_s)])
    assert right.observations.weight.all()
