"""Likelihoods and factors of a map of walks, against closed forms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.apps.walk_map import walk_map, walk_poses
from pdr_filter.apps.walk_map.chains import Chain, Scans, chain_of
from pdr_filter.apps.walk_map.joint import contradicting, solve_group, step_positions
from pdr_filter.apps.walk_map.likeness import (
    EVIDENCE,
    LENGTH_M,
    NOISE,
    OF_WALK,
    fingerprint_matrix,
    likelihood,
    log_ratio,
)
from pdr_filter.apps.walk_map.walk_poses import (
    PACES,
    JoinedWalks,
    ScannedWalks,
    WalkPose,
    _thinned,
    adjust,
    clockwise_rotation,
    joint_poses,
    log_evidence,
    partners_of,
    scans_around,
)
from pdr_filter.offline.smoothing.solve import point_positions


@pytest.fixture
def scans() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, walks and cosines of seven scans."""
    rng = np.random.default_rng(0)
    heard = rng.random((7, 30))
    heard /= np.linalg.norm(heard, axis=1)[:, None]
    return rng.normal(0.0, 10.0, (7, 2)), np.array([0, 0, 0, 1, 1, 2, 2]), heard @ heard.T


def moved(position_m: np.ndarray, k: int, by_m: float) -> np.ndarray:
    found = position_m.copy()
    found.flat[k] += by_m
    return found


def test_a_scan_is_most_probable_at_the_mapped_scan_that_it_equals() -> None:
    cosine = np.eye(3)
    mapped_m = np.array([[0.0, 0.0], [40.0, 0.0], [0.0, 40.0]])
    ratio = log_ratio(cosine, cosine, mapped_m, np.arange(3), np.vstack([mapped_m, [[5000.0, 0.0]]]))
    assert ratio.argmax(axis=1).tolist() == [0, 1, 2]
    np.testing.assert_allclose(ratio[:, 3], 0.0, atol=1e-3)  # relative to a place far away


def test_the_likelihood_is_that_of_a_matrix_normal_distribution(
    scans: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    position_m, owner, cosine = scans
    far2 = ((position_m[:, None] - position_m) ** 2).sum(axis=-1)
    cov = (1 + OF_WALK * (owner[:, None] == owner)) / (1 + far2 / LENGTH_M**2) + NOISE * np.eye(7)
    cov /= cov[0, 0]
    expected = -0.5 * EVIDENCE * (np.trace(np.linalg.inv(cov) @ cosine) + np.log(np.linalg.det(cov)))
    assert likelihood(position_m, owner, cosine)[0] == pytest.approx(expected)


def test_the_gradient_of_the_likelihood_is_that_of_differences(
    scans: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    position_m, owner, cosine = scans
    value = [[likelihood(moved(position_m, k, h), owner, cosine)[0] for h in (1e-5, -1e-5)] for k in range(14)]
    np.testing.assert_allclose(likelihood(position_m, owner, cosine)[1], -np.diff(value)[:, 0] / 2e-5, atol=1e-8)


def test_the_information_is_the_expected_curvature(scans: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    position_m, owner, _ = scans
    far2 = ((position_m[:, None] - position_m) ** 2).sum(axis=-1)
    expected = (1 + OF_WALK * (owner[:, None] == owner)) / (1 + far2 / LENGTH_M**2) + NOISE * np.eye(7)
    expected /= expected[0, 0]  # the mean of the cosines, if the model holds
    slope = [[likelihood(moved(position_m, k, h), owner, expected)[1] for h in (1e-4, -1e-4)] for k in range(14)]
    curvature = np.diff(slope, axis=1)[:, 0] / 2e-4
    np.testing.assert_allclose(likelihood(position_m, owner, expected)[2], curvature, atol=1e-8)


def test_a_clockwise_quarter_turn_moves_north_to_east() -> None:
    np.testing.assert_allclose(np.array([[0.0, 1.0]]) @ clockwise_rotation(np.pi / 2), [[1.0, 0.0]], atol=1e-15)


def hearing_walks(chain: Chain, n: int) -> ScannedWalks:
    """Walks with five scans that are the same in each."""
    power_dbm = np.random.default_rng(1).uniform(-80, -40, 30)
    scans = Scans(np.arange(0, 20, 4), np.arange(0, 35, 6), np.tile(np.arange(6), 5), power_dbm)
    return ScannedWalks.of([replace(chain, scans=scans)] * n)


def test_the_slope_of_the_joint_poses_is_that_of_differences(chain: Chain) -> None:
    """Two walks that hear the same access points, and one of them defines the frame."""
    walks = hearing_walks(chain, 2)
    poses = {0: WalkPose(0.1, np.array([1.0, 2.0])), 1: WalkPose(-0.2, np.array([9.0, -4.0]), scale=1.1)}
    group = JoinedWalks(poses, {0: WalkPose(0.0, np.zeros(2))}, 0.05)
    scans = scans_around(walks, group, [0, 1])
    before = joint_poses(walks, group, [0, 1], scans)

    def objective(k: int, by: float) -> float:
        change = by * np.eye(9)[k]
        changed = {
            i: WalkPose(
                pose.turn_rad + change[4 * i],
                pose.shift_m + change[4 * i + 1 : 4 * i + 3],
                pose.floor,
                pose.scale * np.exp(change[4 * i + 3]),
            )
            for i, pose in poses.items()
        }
        return joint_poses(walks, replace(group, poses=changed, north_rad=0.05 + change[8]), [0, 1], scans).objective

    expected = [(objective(k, 1e-5) - objective(k, -1e-5)) / 2e-5 for k in range(9)]
    # without the first walk, because its known start moves with its rotation
    np.testing.assert_allclose(before.slope[4:], expected[4:], rtol=1e-5, atol=1e-6)
    adjust(walks, group, [0, 1], n_iterations=30)
    after = joint_poses(walks, group, [0, 1], scans)
    assert after.objective > before.objective + 1.0 and np.abs(after.slope[4:7]).max() < 1.0


def test_the_evidence_of_a_walk_is_zero_far_away_and_positive_where_it_hears_the_same(chain: Chain) -> None:
    walks = hearing_walks(replace(chain, knows_north=False), 2)
    groups = [{0: HERE}, {0: HERE, 1: WalkPose(0.0, np.array([1e6, 0.0]))}, {0: HERE, 1: HERE}]
    alone, far, same = (log_evidence(walks, JoinedWalks(poses, {0: HERE})) for poses in groups)
    assert alone == pytest.approx(0.0, abs=1e-9) and far == pytest.approx(0.0, abs=1e-4)
    assert same > 3.0


def with_parts(monkeypatch: pytest.MonkeyPatch, **parts: Callable[..., object]) -> None:
    """Replace parts of the growth of a map; those that are not given do nothing."""
    nothing = {"adjust": lambda *_, **__: None, "drop_doubtful_storeys": lambda *_: [], "settle": lambda *_: []}
    for name, part in {**nothing, **parts}.items():
        monkeypatch.setattr(walk_map, name, part)


HERE = WalkPose(0.0, np.zeros(2))


@pytest.mark.parametrize("better", [0, 1])
def test_of_two_paces_of_growth_the_more_probable_result_counts(monkeypatch: pytest.MonkeyPatch, better: int) -> None:
    """At the first pace walks 1 and 2 join, at the other one walks 1 and 3, and walk 4 is removed."""

    def grow(_: object, group: JoinedWalks, free: set[int], pace: int) -> None:
        joined = {PACES[0]: (1, 2), PACES[1]: (1, 3)}[pace]
        group.poses.update({i: WalkPose(float(pace), np.zeros(2)) for i in joined})
        group.north_rad = float(pace)
        free.difference_update({*joined, 4})

    with_parts(monkeypatch, grow=grow, settle=lambda *_: [4], log_evidence=lambda _, group: 2 + better in group.poses)
    walks = SimpleNamespace(partners=[set(range(5)) for _ in range(5)])
    group, free = JoinedWalks({0: WalkPose(0.0, np.zeros(2))}, {}), {1, 2, 3, 4}
    reasons = dict[int, str]()
    walk_map._extend(cast(Any, walks), group, free, reasons)
    assert set(group.poses) == {0, 1, 2 + better} and group.north_rad == PACES[better]
    assert free == {3 - better} and reasons.keys() == {4}


def test_walks_of_other_storeys_do_not_move_a_walk(chain: Chain) -> None:
    walks = hearing_walks(chain, 3)
    poses = {i: WalkPose(0.0, np.array([9.0 * i, 0.0]), floor) for i, floor in enumerate((0, 0, 1))}
    group = JoinedWalks(poses, {1: poses[1]})
    scans = scans_around(walks, group, [0])
    assert set(walks.owner[scans].tolist()) == {0, 1}
    with_other = np.concatenate([scans, walks.scans_of([2])])
    expected = joint_poses(walks, group, [0], with_other)
    np.testing.assert_allclose(joint_poses(walks, group, [0], scans).slope, expected.slope, rtol=1e-9)


@pytest.mark.parametrize("first", range(5))
def test_walks_that_share_three_scans_in_a_row_are_partners(chain: Chain, first: int) -> None:
    def walk(name: int, shared: slice) -> Chain:
        address = 100 * name + np.arange(7)
        address[shared] = 1000
        return replace(chain, scans=Scans(np.arange(7), np.arange(8), address, np.full(7, -50.0)))

    chains = [walk(1, slice(first, first + 3)), walk(2, slice(2, 5)), walk(3, slice(0, 0))]
    assert partners_of(ScannedWalks.of(chains)) == [{1}, {0}, set()]


def test_one_scan_of_each_square_is_kept_on_each_storey() -> None:
    at_m = np.array([[1.0, 1.0], [2.0, 5.0], [7.0, 1.0], [1.5, 1.5], [-0.5, 1.0]])
    assert sorted(_thinned(at_m, np.array([0, 0, 0, 1, 0])).tolist()) == [0, 2, 3, 4]


def test_derivatives_of_points_are_those_of_differences() -> None:
    state, ahead = np.array([[3.0, -2.0, 0.4, 0.1]]), np.array([[5.0, 2.0]])
    place, by_state = point_positions(state, np.array([0]), ahead)
    for k in range(4):
        moved = state.copy()
        moved[0, k] += 1e-6
        np.testing.assert_allclose(
            (point_positions(moved, np.array([0]), ahead)[0] - place)[0] / 1e-6, by_state[0, :, k], atol=1e-5
        )


@pytest.fixture(scope="module")
def chain() -> Chain:
    return chain_of(pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=25.0)], seed=3))


def test_points_of_a_chain_end_at_its_knots(chain: Chain) -> None:
    nodes = chain.problem.intervals.nodes
    np.testing.assert_allclose(chain.position_m(nodes), chain.mean[:, :2], atol=1e-9)
    inside = chain.position_m(np.array([int(nodes[1]) - 1]))[0]
    assert 0.2 < np.hypot(*(inside - chain.mean[1, :2])) < 1.5  # one step before the knot


def test_a_known_start_and_end_of_one_walk_are_its_solution_with_their_covariances(chain: Chain) -> None:
    """A closed form: with exact ends, the walk is shifted, rotated and scaled onto them."""
    walks = ScannedWalks.of([chain])
    ends = np.array([[10.0, 20.0], [10.0, 46.0]])
    known = [pdr.PositionFix(t, p, 0.05**2 * np.eye(2)) for t, p in zip((0.0, chain.time_s[-1]), ends, strict=True)]
    pose = WalkPose(0.3, np.zeros(2))
    found = solve_group(walks, JoinedWalks({0: pose}, {0: pose}), {0: known})
    position_m, cov_m2 = step_positions(walks.chains[0], found[0])
    np.testing.assert_allclose(position_m[[0, -1]], ends, atol=0.15)
    np.testing.assert_allclose(cov_m2[[0, -1]], np.tile(0.05**2 * np.eye(2), (2, 1, 1)), rtol=0.2, atol=3e-4)
    middle = len(position_m) // 2
    np.testing.assert_allclose(position_m[middle], ends.mean(axis=0), atol=1.5)
    assert cov_m2[middle, 0, 0] > cov_m2[0, 0, 0]


def test_a_known_heading_rotates_a_walk(chain: Chain) -> None:
    walks, half_s = ScannedWalks.of([chain]), float(chain.time_s[len(chain.time_s) // 2])
    known = [pdr.PositionFix(0.0, (0.0, 0.0), 0.01 * np.eye(2)), pdr.HeadingFix(half_s, np.pi / 2, 0.01)]
    pose = WalkPose(1.2, np.zeros(2))
    found = solve_group(walks, JoinedWalks({0: pose}, {0: pose}), {0: known})
    end_m = step_positions(walks.chains[0], found[0])[0][-1]
    assert end_m[0] == pytest.approx(25.0, rel=0.15) and abs(end_m[1]) < 3.0


def test_the_index_gives_cosines_of_fingerprints() -> None:
    # the loudness is the square of the level: 1 at -30 dBm, 0.25 at -65 dBm
    scans = Scans(np.array([0, 1]), np.array([0, 2, 3]), np.array([5, 9, 9]), np.array([-30.0, -65.0, -50.0]))
    matrix = fingerprint_matrix([scans])
    assert matrix.shape == (2, 2)
    cosine = 0.25 / np.hypot(1.0, 0.25)
    np.testing.assert_allclose((matrix @ matrix.T).toarray(), [[1.0, cosine], [cosine, 1.0]])


def test_walks_that_are_on_a_map_stay_although_the_others_do_not_confirm_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walk_poses, "_is_confirmed", lambda *_: False)
    monkeypatch.setattr(walk_poses, "adjust", lambda *_: None)
    poses = {i: WalkPose(0.0, np.zeros(2)) for i in range(4)}
    group = JoinedWalks(poses, {0: poses[0]})
    assert walk_poses.settle(cast(Any, None), group, kept=frozenset([0, 2])) == [1, 3]
    assert set(group.poses) == {0, 2}


def test_walks_leave_a_storey_on_which_no_walk_of_the_frame_is_confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walk_poses, "_is_confirmed", lambda _, group, i, prob: i == 0 and prob == walk_poses.SURE)
    poses = {i: WalkPose(0.0, np.zeros(2), floor) for i, floor in enumerate((0, 1, 0, 1, 2, 0))}
    group = JoinedWalks(poses, {})
    # the walks 0 and 5 of storey 0 define the frame, of which one is confirmed; storey 2 has none
    assert walk_poses.drop_doubtful_storeys(cast(Any, None), group, frozenset([0, 1, 5])) == [3]
    assert set(group.poses) == {0, 1, 2, 4, 5}


def test_after_a_map_without_agreement_the_other_pace_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[int] = []

    def grow(_: object, group: JoinedWalks, free: set[int], pace: int) -> None:
        tried.append(pace)
        group.poses[1] = WalkPose(float(pace), np.zeros(2))
        free.discard(1)

    def drop(_: object, group: JoinedWalks, __: object) -> list[int]:
        return [i for i in (1,) if group.poses[1].turn_rad == PACES[0] and group.poses.pop(1)]

    with_parts(monkeypatch, grow=grow, drop_doubtful_storeys=drop, log_evidence=lambda _, group: len(group.poses))
    group, free = JoinedWalks({0: WalkPose(0.0, np.zeros(2))}, {}), {1}
    walk_map._extend(cast(Any, SimpleNamespace(partners=[{1}, {0}])), group, free, reasons := dict[int, str]())
    assert tried == list(PACES) and set(group.poses) == {0, 1} and not reasons


def fixes_along(chain: Chain, every: int, std_m: float = 0.5) -> list[pdr.PositionFix]:
    """Positions of every so many steps of a walk, rotated and shifted, with the order of their times."""
    steps = np.arange(0, len(chain.time_s), every)
    at_m = WalkPose(0.3, np.array([50.0, -20.0])).of(chain.position_m(steps))
    times_s = np.append(chain.time_s[:1] - 0.1, chain.time_s)[steps]
    return [pdr.PositionFix(t, p, std_m**2 * np.eye(2)) for t, p in zip(times_s.tolist(), at_m, strict=True)]


@pytest.mark.parametrize("wrong", range(4))
def test_a_known_position_that_the_steps_and_the_others_contradict_is_found(chain: Chain, wrong: int) -> None:
    fixes, north = fixes_along(chain, len(chain.time_s) // 4), (0.3, 0.05)
    assert len(fixes) >= 4 and contradicting(chain, fixes, north) == []
    fixes[wrong] = replace(fixes[wrong], position_m=np.add(fixes[wrong].position_m, (24.0, -32.0)))
    assert contradicting(chain, fixes, north) == [fixes[wrong]]


def test_of_two_contradicting_positions_both_are_found(chain: Chain) -> None:
    (first, *_, last), north = fixes_along(chain, 5), (0.3, 0.05)
    assert contradicting(chain, [first, last], north) == []
    last = replace(last, position_m=np.add(last.position_m, (300.0, 0.0)))
    assert contradicting(chain, [first, last], north) == [first, last]


@pytest.mark.parametrize("off_rad", [0.0, np.pi, 2.5])
def test_a_known_heading_that_the_magnetometer_contradicts_is_found(chain: Chain, off_rad: float) -> None:
    assert chain.knows_north
    step, first = 8, fixes_along(chain, 5)[0]
    node = int(chain.node_of(np.array([step]))[0][0])
    heading_rad = chain.device_rad_at(step) + float(chain.mean[node, 2]) + 0.3 + off_rad
    heading = pdr.HeadingFix(float(chain.time_s[step - 1]), heading_rad, 0.1)
    assert contradicting(chain, [first, heading], (0.3, 0.05)) == ([heading] if off_rad else [])
