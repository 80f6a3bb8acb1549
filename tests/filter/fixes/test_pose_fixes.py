"""Fixes of position and heading at once, and the outcome that `add_fix` returns."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from helpers import clockwise, push_part, true_position_m

import pdr_filter as pdr
from pdr_filter.offline.smoothing.observations import Observations
from pdr_filter.offline.smoothing.problem import Measurements, pose_problem
from pdr_filter.offline.smoothing.solve import _initial_guess, solve
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import FloatArray, stated_fixes
from tests.simulated_steps import simulated_walk

pytestmark = pytest.mark.usefixtures("sensing_once")

ANGLE_RAD, SHIFT_M = 2.0, np.array([100.0, 50.0])
TIMES_S = (4.0, 14.0, 26.0, 38.0)


@dataclass(frozen=True)
class Door:
    """The pedestrian goes through a door at a known place, along a known direction."""

    time_s: float
    pose: tuple[float, float, float]
    cov: FloatArray
    received_time_s: float | None = None
    by_pose: FloatArray = field(default_factory=lambda: np.eye(3))

    def measurement(self, position_m: FloatArray, heading_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        turn_rad = (heading_rad - self.pose[2] + np.pi) % (2 * np.pi) - np.pi
        error = np.array([position_m[0] - self.pose[0], position_m[1] - self.pose[1], turn_rad])
        return self.by_pose @ error, self.by_pose, self.by_pose @ self.cov @ self.by_pose.T


@pytest.fixture(scope="module")
def walk() -> pdr.Recording:
    return simulate([Leg("walking", distance_m=d, turn_rad=1.5) for d in (20.0, 15.0, 20.0)], seed=1)


def poses(walk: pdr.Recording) -> list[tuple[float, float, float]]:
    """True positions and walking directions at four times, in a rotated and shifted frame."""

    def at(time_s: float) -> FloatArray:
        return clockwise(ANGLE_RAD) @ true_position_m(walk, time_s) + SHIFT_M

    ways = [at(t + 0.5) - at(t - 0.5) for t in TIMES_S]
    return [(*at(t).tolist(), float(np.arctan2(*way))) for t, way in zip(TIMES_S, ways, strict=True)]


@pytest.mark.parametrize("weighting", ["imm", "hc"])
def test_a_fix_of_position_and_heading_places_a_track_as_the_two_fixes_do(walk: pdr.Recording, weighting: str) -> None:
    cov = np.diag([0.25, 0.25, 0.01])
    doors = [Door(t, pose, cov) for t, pose in zip(TIMES_S, poses(walk), strict=True)]
    two = [
        fix
        for door in doors
        for fix in (
            pdr.HeadingFix(door.time_s, door.pose[2], 0.1),
            pdr.PositionFix(door.time_s, door.pose[:2], cov[:2, :2]),
        )
    ]
    config = pdr.recipes.default(walk.subject).in_world_frame()
    track, expected = (pdr.track(walk, config=config, weighting=weighting, fixes=fixes) for fixes in (doors, two))
    assert track.frame == expected.frame == "fixes"
    assert [each.outcome for each in track.fixes] == [each.outcome for each in expected.fixes[1::2]]
    assert "placed" in {each.outcome for each in track.fixes} and track.fixes[0].kind == "door"
    np.testing.assert_allclose(track.position_m, expected.position_m, atol=0.15)
    if weighting == "imm":
        smoothed, expected = (pdr.smooth(walk, fixes=fixes).track for fixes in (doors, two))
        np.testing.assert_allclose(smoothed.position_m, expected.position_m, atol=0.01)


def test_doors_decide_on_which_side_of_a_beacon_a_walk_is() -> None:
    """The first path is mirrored about the beacon, which agrees with all its ranges."""
    rng = np.random.default_rng(4)
    walk = simulated_walk(48, rng, any_rotation=True)
    true_m = walk.position_m + np.array([300.0, 200.0])
    beacon_m = true_m.mean(axis=0) + np.array([4.0, -3.0])
    at = np.arange(4, 48, 4)
    times_s, places_m = walk.steps.time_s[at - 1], true_m[at]
    ranges = np.hypot(*(places_m - beacon_m).T) + rng.normal(scale=0.3, size=len(at))
    fixes = [pdr.RangeFix(t, beacon_m, r, 0.3) for t, r in zip(times_s.tolist(), ranges.tolist(), strict=True)]
    doors = [
        Door(
            float(times_s[k]), (*places_m[k].tolist(), float(walk.heading_offset_rad[at[k]])), np.diag([0.1, 0.1, 0.01])
        )
        for k in (2, 8)
    ]
    guess_m = np.vstack([places_m, places_m[[2, 8]]]) * (-1.0, 1.0) + (2.0 * beacon_m[0], 0.0)
    start_cov = np.diag([1e6, 1e6, np.pi**2 / 3, 0.06**2])
    problem = pose_problem(
        walk.steps,
        np.zeros(4),
        start_cov,
        Observations(()),
        anchor_interval_s=2.0,
        measurements=Measurements((*fixes, *doors), np.zeros(48), guess_m),
    )
    guess, found = _initial_guess(problem, with_path=False), solve(problem)
    for mean, weight, largest_m in ((guess[0], guess[2], 3.0), (found.mean, found.weight, 1.0)):
        error_m = mean[:, :2] - true_m[problem.intervals.nodes]
        assert weight.all() and np.hypot(*error_m.T).max() < largest_m


def test_the_fixes_of_a_linear_measurement_have_its_least_squares_pose() -> None:
    """In other axes, with a component measured twice; a bearing or one axis of the position give no fix."""
    rng = np.random.default_rng(3)
    by_pose, root = rng.normal(size=(4, 3)), rng.normal(size=(3, 3))
    door = Door(1.0, (3.0, -2.0, 0.7), root @ root.T, by_pose=by_pose[:3])
    heading, position = stated_fixes(door)
    assert isinstance(heading, pdr.HeadingFix) and isinstance(position, pdr.PositionFix)
    assert heading.walking_heading_rad == pytest.approx(0.7) and heading.std_rad**2 == pytest.approx(door.cov[2, 2])
    np.testing.assert_allclose(position.position_m, [3.0, -2.0], atol=1e-9)
    np.testing.assert_allclose(position.cov_m2, door.cov[:2, :2])
    for rows, kinds in (([0, 1], [pdr.PositionFix]), ([2], [pdr.HeadingFix]), ([0], []), ([0, 2], [])):
        found = stated_fixes(Door(1.0, (3.0, -2.0, 0.7), np.eye(3), by_pose=np.eye(3)[rows]))
        assert [type(fix) for fix in found] == kinds
    assert stated_fixes(pdr.RangeFix(1.0, (3.0, 4.0), 5.0, 0.1)) == ()


def test_an_added_fix_returns_its_outcome_or_that_it_waits(walk: pdr.Recording) -> None:
    samples = pdr.merge_streams(walk)
    online = pdr.OnlineFilter(pdr.recipes.default(walk.subject).in_world_frame())
    n = int(np.searchsorted(samples.time_s, 30.0))
    push_part(online, samples, slice(n))
    (a, b, c, d), cov = poses(walk), 0.04 * np.eye(2)
    times_s = dict(zip((a, b, c, d), TIMES_S, strict=True))
    added = [online.add_fix(pdr.PositionFix(times_s[p], p[:2], cov)) for p in (a, b, c)]
    twice, late = online.add_fix(pdr.PositionFix(times_s[c], c[:2], cov)), pdr.PositionFix(times_s[d], d[:2], cov)
    assert [each.outcome for each in (*added, twice)] == ["placed", "turned", "turned", "repeated"]
    assert online.add_fix(late).outcome == "waiting" and np.isnan(added[0].nis)
    before = online.save()
    wrong = online.add_fix(pdr.PositionFix(25.0, np.array([900.0, 0.0]), cov))
    assert wrong.outcome == "rejected" and wrong.nis > online.config.model.fix_gate_nis
    resumed = pdr.OnlineFilter.load(before)
    push_part(resumed, samples, slice(n, None))
    resumed.finish()
    assert [each.outcome for each in resumed.state.last.fixes] == ["placed", "turned", "turned", "repeated", "turned"]
    np.testing.assert_equal(resumed.state.last.fixes[2].nis, added[2].nis)
