"""Estimate at the time of the newest sample: repeatable, ahead of the accepted steps, and convertible to JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers import push_part, resumed, true_position_m

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.filter.pedestrian.alignment import Pose
from pdr_filter.simulate import Leg, simulate
from pdr_filter.tracking.extrapolation import _ACROSS_SHARE, _ALONG_SHARE, _extrapolated, _on_plan, _silent_s
from pdr_filter.values import CARRYING_MODES, CONTEXTS, FixResult, OnPlan, PositionFix

LEGS = [Leg("stationary", duration_s=4.0), Leg("walking", distance_m=25.0), Leg("stationary", duration_s=6.0)]
WALK = simulate(LEGS, seed=5)
SAMPLES = pdr.merge_streams(WALK)


def walked(online: pdr.OnlineFilter, until_s: float = np.inf) -> Iterator[pdr.Now]:
    """Return the estimates after each tenth of a second."""
    for i in range(0, int(np.searchsorted(SAMPLES.time_s, until_s)), 10):
        push_part(online, SAMPLES, slice(i, i + 10))
        yield online.now()


def test_now_does_not_change_the_filter_and_is_repeatable() -> None:
    online = pdr.OnlineFilter()
    now = next(now for now in walked(online) if now.n_steps > 10 and now.provisional_steps)
    blob = online.save()
    assert online.now().to_dict() == now.to_dict()
    assert online.save() == blob


@pytest.mark.parametrize("until_s", [12.3, np.inf])
def test_after_the_end_nothing_is_provisional(until_s: float) -> None:
    online = pdr.OnlineFilter()
    assert any(now.is_provisional for now in walked(online, until_s))
    online.finish()
    now = online.now()
    assert (now.is_provisional, now.provisional_steps, now.walking_speed_mps) == (False, (), 0.0)
    np.testing.assert_array_equal(now.position_m, online.position_m)
    np.testing.assert_array_equal(now.position_cov_m2, online.position_cov_m2)


@pytest.mark.parametrize("weighting", ["imm", "wc"])
def test_the_position_of_now_is_nearer_to_the_track_that_is_accepted_later_than_the_last_accepted_one(
    weighting: str,
) -> None:
    online = pdr.OnlineFilter(recipes.default().with_weighting(weighting))
    seen = [(now.time_s, online.position_m, now.position_m) for now in walked(online)]
    track = pdr.track(WALK, recipes.default(), weighting=weighting)
    at = [(t, a, b) for t, a, b in seen if track.time_s[0] < t < track.time_s[-1]]
    true = np.column_stack([np.interp([t for t, *_ in at], track.time_s, axis) for axis in track.position_m.T])
    accepted, shown = (np.linalg.norm(np.array([row[k] for row in at]) - true, axis=1) for k in (1, 2))
    assert np.median(shown) < 0.25 * np.median(accepted)


def test_a_position_ahead_of_the_accepted_steps_is_provisional_and_has_a_larger_covariance() -> None:
    online, n_ahead = pdr.OnlineFilter(), 0
    for now in walked(online):
        n_ahead += bool(now.provisional_steps)
        ahead_m = np.linalg.norm(now.position_m - online.position_m)
        assert now.is_provisional == (ahead_m > 0 or bool(now.provisional_steps))
        assert np.trace(now.position_cov_m2) >= np.trace(online.position_cov_m2) - 1e-9
        assert [s.time_s for s in now.provisional_steps] == sorted(s.time_s for s in now.provisional_steps)
    assert n_ahead > 50
    assert not now.is_provisional
    np.testing.assert_array_equal(now.position_m, online.position_m)


def test_a_walking_pedestrian_has_a_speed_and_a_context_and_a_standing_one_has_none() -> None:
    seen = list(walked(pdr.OnlineFilter()))
    walking, now = [now for now in seen if 10.0 < now.time_s < 18.0], seen[-1]
    assert len(walking) > 75
    assert all(0.8 < now.walking_speed_mps < 2.0 and 0.0 < now.walking_speed_std_mps < 0.6 for now in walking)
    assert all(now.context_prob[CONTEXTS.index("walking")] > 0.9 for now in walking)
    assert (now.walking_speed_mps, np.isnan(now.walking_speed_std_mps)) == (0.0, True)
    assert now.context_prob[CONTEXTS.index("stationary")] > 0.9
    assert now.n_steps > 25
    assert now.distance_m == pytest.approx(25.0, rel=0.15)


def test_between_two_contacts_the_position_advances_at_the_walking_speed() -> None:
    seen = [now for now in walked(pdr.OnlineFilter()) if 10.0 < now.time_s < 18.0]
    advanced_m, expected_m = [], []
    for before, after in pairwise(seen):
        if (before.n_steps, before.provisional_steps) == (after.n_steps, after.provisional_steps):
            advanced_m.append(np.linalg.norm(after.position_m - before.position_m))
            expected_m.append(after.walking_speed_mps * (after.time_s - before.time_s))
    assert len(advanced_m) > 30
    np.testing.assert_allclose(advanced_m, expected_m, atol=0.02)


def test_a_gyroscope_on_another_clock_does_not_move_the_position_and_the_note_names_the_remedy() -> None:
    online, ahead_m = pdr.OnlineFilter(), list[float]()
    force, rate = WALK.accelerometer, WALK.streams["gyroscope"]
    for second in range(20):
        for stream, push, later_s in ((force, online.push_accelerometer, 0.0), (rate, online.push_gyroscope, 1000.0)):
            part = slice(*np.searchsorted(stream.time_s, [second, second + 1]))
            push(stream.time_s[part] + later_s, stream.values[part])
        now = online.now()
        ahead_m.append(float(np.linalg.norm(now.position_m - online.position_m)))
    assert now.n_steps > 10
    assert 0.5 < max(ahead_m) < 10.0
    assert _silent_s(online.config, online.state) == 0.0
    assert any(
        "accelerometer: no samples since" in note and "put all sensors on one clock" in note for note in online.notes
    )


@pytest.mark.parametrize("is_stuck", [False, True])
def test_an_accelerometer_that_fails_in_mid_walk_leaves_the_position_uncertain(is_stuck: bool) -> None:
    """It fails at 10 s, and the person walks on. After the usual delays of seconds, the deviation covers the way."""
    online, std_m = pdr.OnlineFilter(), list[float]()
    force, rate = WALK.accelerometer, WALK.streams["gyroscope"]
    for second in range(22):
        part = slice(*np.searchsorted(force.time_s, [second, second + 1]))
        if second < 10 or is_stuck:
            values = force.values[part] if second < 10 else np.tile(force.values[1000], (part.stop - part.start, 1))
            online.push_accelerometer(force.time_s[part], values)
        part = slice(*np.searchsorted(rate.time_s, [second, second + 1]))
        online.push_gyroscope(rate.time_s[part], rate.values[part])
        std_m.append(online.now().position_std_m)
    now = online.now()
    assert np.linalg.norm(now.position_m - true_position_m(WALK, 22.0)) < 3.0 * now.position_std_m
    assert std_m[9] < 3.0 and now.position_std_m > 8.0
    assert now.walking_speed_mps == 0.0
    assert any("accelerometer" in note for note in now.notes)


def test_now_before_any_sample_is_empty() -> None:
    now = pdr.OnlineFilter().now()
    assert (now.n_steps, now.distance_m, now.is_provisional, now.rates_hz) == (0, 0.0, False, {})
    assert now.to_dict()["time_s"] is None


def test_rates_are_reported_for_each_sensor() -> None:
    online = pdr.OnlineFilter()
    time_s = np.arange(300) / 100.0
    online.push_accelerometer(time_s, np.tile([0.0, 0.0, 9.8], (300, 1)))
    online.push_gyroscope(time_s[::2], np.zeros((150, 3)))
    online.push_pressure(time_s[::50], np.full(6, 1000.0))
    rates = online.now().rates_hz
    assert rates == {
        "accelerometer": pytest.approx(100.0),
        "gyroscope": pytest.approx(50.0),
        "barometer": pytest.approx(2.0),
    }
    online = pdr.OnlineFilter()
    time_s = np.round(np.arange(300) / 418.0, 3)  # in whole milliseconds, most intervals are 2 ms
    online.push_accelerometer(time_s, np.tile([0.0, 0.0, 9.8], (300, 1)))
    assert online.now().rates_hz == {"accelerometer": pytest.approx(418.0, rel=0.01)}


def test_now_and_updates_convert_to_json_without_nan() -> None:
    online = pdr.OnlineFilter()
    online.add_fix(PositionFix(12.0, np.zeros(2), np.eye(2)))
    *_, now = walked(online, until_s=16.0)
    updates = push_part(online, SAMPLES, slice(1600, None))
    content = now.to_dict()
    assert set(content["context_prob"]) == set(CONTEXTS)
    assert set(content["carrying_prob"]) == set(CARRYING_MODES)
    assert [fix["kind"] for fix in content["fixes"]] == ["position"]
    step = updates[0].to_dict()
    assert step["time_s"] == updates[0].step.time_s
    assert step["position_m"] == updates[0].position_m.tolist()
    assert step["step"]["walking_heading_std_rad"] is None or step["step"]["walking_heading_std_rad"] > 0
    result = FixResult("position", 1.0, 2.0, "rejected", np.inf).to_dict()
    assert result == {
        "kind": "position", "time_s": 1.0, "used_s": 2.0, "outcome": "rejected", "nis": None, "accepted": False,
        "anchor_m": None,
    }  # fmt: skip
    assert json.loads(json.dumps([content, step, result], allow_nan=False)) == [content, step, result]


def test_extrapolation_during_a_turn_follows_the_chord_of_the_turn() -> None:
    there = Pose(np.zeros(2), np.zeros((2, 2)), heading_rad=np.pi / 2, n_steps=3)  # to the east now, to the north then
    ahead = _extrapolated(there, 2.0, turned_rad=np.pi / 2)
    np.testing.assert_allclose(ahead.position_m, [2**0.5, 2**0.5])
    along, across = np.linalg.eigvalsh(ahead.cov_m2)[::-1] ** 0.5 / 2.0
    assert (along, across) == pytest.approx((_ALONG_SHARE, _ACROSS_SHARE))
    assert np.array([1.0, 1.0]) @ ahead.cov_m2 @ [1.0, 1.0] > np.array([1.0, -1.0]) @ ahead.cov_m2 @ [1.0, -1.0]


def test_the_covariance_on_a_plan_stays_valid_if_the_extrapolated_position_is_more_certain() -> None:
    behind = Pose(np.zeros(2), 4.0 * np.eye(2), heading_rad=0.0, n_steps=3)
    ahead = Pose(np.array([0.0, 1.0]), np.diag([1.0, 9.0]), heading_rad=0.0, n_steps=4)
    there = OnPlan(np.array([5.0, 5.0]), 0.25 * np.eye(2), np.pi / 2, (), 100, 80.0)
    placed = _on_plan(ahead, behind, there)
    np.testing.assert_allclose(placed.position_m, [6.0, 5.0], atol=1e-12)  # what was north is east on the plan
    np.testing.assert_allclose(placed.cov_m2, np.diag([5.25, 0.25]), atol=1e-12)


# --- motion without known steps ---------------------------------------------------------------------------------------


def test_before_the_first_known_steps_the_deviation_is_a_metre_for_each_second_of_walking() -> None:
    before = [now for now in walked(pdr.OnlineFilter(), until_s=8.0) if now.n_steps == 0 and not now.provisional_steps]
    rest, begun = ([now for now in before if is_rest == (now.time_s < 3.9)] for is_rest in (True, False))
    assert max(now.position_std_m for now in rest) == 0.0
    assert len(begun) > 8
    for now in begun[3:]:
        # the walk begins at 4 s, and motion is judged for whole fifths of a second
        assert now.position_std_m == pytest.approx(now.time_s - 4.0, abs=0.5)
        np.testing.assert_array_equal(now.position_m, 0.0)


def test_the_deviation_is_that_of_the_steps_again_when_they_are_known() -> None:
    online = pdr.OnlineFilter()
    seen = list(walked(online, until_s=14.0))
    waiting = max(now.position_std_m for now in seen if now.n_steps == 0)
    assert waiting > 1.0
    assert all(now.position_std_m < 0.5 * waiting for now in seen if 8.0 < now.time_s < 10.0)


@pytest.mark.parametrize("weighting", ["wc", "hc"])
def test_the_deviation_is_the_same_for_any_blocks_and_after_save_and_resume(weighting: str) -> None:
    def shown(cut: int, resumes: bool) -> list[float]:
        online, found = pdr.OnlineFilter(recipes.default().with_weighting(weighting)), []
        for start in range(0, 1400, 700):
            for i in range(start, start + 700, cut):
                push_part(online, SAMPLES, slice(i, i + cut))
            online = resumed(online) if resumes else online
            found.append(online.now().position_std_m)
        return found

    assert shown(7, resumes=True) == shown(350, resumes=False)


def grown(recording: pdr.Recording, until_s: float) -> list[tuple[pdr.Now, float, float, float]]:
    """Return each half second: now, true and shown distance from the last final step, and growth of the deviation."""
    assert recording.truth is not None
    truth, samples = recording.truth.position, pdr.merge_streams(recording)
    online, time_s = pdr.OnlineFilter(recipes.for_recording("default", recording)), samples.time_s
    begin_s = max(time_s[0], truth.time_s[0])
    ends = np.unique(np.searchsorted(time_s, np.arange(begin_s, min(truth.time_s[-1], begin_s + until_s), 0.5)))
    last_s, rows = begin_s, []
    for a, b in pairwise([0, *ends[1:]]):
        updates = push_part(online, samples, slice(a, b))
        last_s = max([last_s, *(u.step.time_s for u in updates if u.is_final)])
        now = online.now()
        gone_m = np.diff(true_position_m(recording, np.array([time_s[b - 1], last_s])), axis=0)
        growth_m2 = np.linalg.eigvalsh(now.position_cov_m2 - online.position_cov_m2)[1]
        shown_m = float(np.linalg.norm(now.position_m - online.position_m))
        rows.append((now, float(np.linalg.norm(gone_m)), shown_m, math.sqrt(max(growth_m2, 0.0))))
    return rows


@pytest.mark.recordings
@pytest.mark.parametrize(
    "name",
    [
        "oxiod/oxiod_anon_floor1_handheld1",
        "oxiod/oxiod_anon_floor1_pocket5",
        "oxiod/oxiod_anon_floor1_handbag8",
        "oxiod/oxiod_user1_room_running1_7",
        "oxiod/oxiod_user1_room_trolley2_2",
    ],
)
def test_the_deviation_covers_the_way_since_the_last_step(data_dir: Path, name: str) -> None:
    """At least a third of the distance, and 95 % of the errors within 2.45 deviations.

    The positions of oxiod belong to the phone. Taking it out and putting it away moves it by up to half a metre.
    """
    rows = grown(pdr.read(data_dir / f"{name}.zip"), until_s=60.0)
    error_m = np.array([max(abs(true_m - shown_m) - 0.5, 0.0) for _, true_m, shown_m, _ in rows])
    std_m = np.array([growth_m for *_, growth_m in rows])
    assert np.mean(error_m > 2.45 * std_m) < 0.05
    assert np.mean(std_m < error_m / 3) < 0.05
    assert error_m.max() > 0.3  # there was something to cover


@pytest.mark.recordings
def test_a_trolley_is_never_certain_and_a_sitting_person_stays_within_two_metres(data_dir: Path) -> None:
    trolley = grown(pdr.read(data_dir / "oxiod" / "oxiod_user1_room_trolley2_2.zip"), until_s=60.0)
    assert trolley[-1][0].n_steps == 0
    assert trolley[-1][0].position_std_m > 40.0
    track = pdr.track(pdr.read(data_dir / "oxiod" / "oxiod_user1_room_trolley2_2.zip"))
    assert track.how_far == "distance unknown"
    assert "distance unknown in" in track.report()
    sitting = pdr.merge_streams(pdr.read(data_dir / "motionsense" / "motionsense_s01_sit_5.zip"))
    online = pdr.OnlineFilter()
    for i in range(0, len(sitting.time_s), 500):
        push_part(online, sitting, slice(i, i + 500))
        assert online.now().position_std_m <= 2.0 + 1e-9
