"""Likelihoods and factors of a map of walks, against closed forms."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.walk_map import placing
from pdr_filter.walk_map.chains import Chain, Scans, chain_of
from pdr_filter.walk_map.joint import _by_state, solve_group, step_positions
from pdr_filter.walk_map.likeness import fingerprint_matrix, log_ratio, ranges
from pdr_filter.walk_map.placing import Pairs, PlacedGroup, Pose, ScannedWalks, residuals, turned


def test_similar_scans_are_more_probable_near_and_dissimilar_ones_far() -> None:
    far_m = np.array([[2.0], [20.0], [60.0]])
    similar, dissimilar = (log_ratio(np.array([[c]]), far_m)[0] for c in (0.88, 0.0))
    assert (np.diff(similar) < 0).all() and (np.diff(dissimilar) > 0).all()


def test_log_ratios_of_several_mapped_scans_are_added() -> None:
    cosine, far_m = np.array([[0.9, 0.1], [0.5, 0.7]]), np.array([[3.0, 40.0], [10.0, 5.0], [70.0, 0.0]])
    alone = [log_ratio(cosine[:, [k]], far_m[:, [k]]) for k in range(2)]
    np.testing.assert_allclose(log_ratio(cosine, far_m), alone[0] + alone[1], rtol=1e-6)


def test_ranges_fall_with_the_cosine() -> None:
    range_m, std_m = ranges(np.array([0.65, 0.75, 0.85, 0.95]))
    assert (np.diff(range_m) < 0).all() and (np.diff(std_m) <= 0).all() and std_m.min() > 0


def test_a_clockwise_quarter_turn_moves_north_to_east() -> None:
    np.testing.assert_allclose(np.array([[0.0, 1.0]]) @ turned(np.pi / 2), [[1.0, 0.0]], atol=1e-15)


def test_the_residual_of_a_range_is_distance_minus_range_with_a_cauchy_weight() -> None:
    pairs = Pairs(np.array([0, 1]), np.array([2, 3]), np.array([4.0, 5.0]), np.array([2.0, 2.0]))
    residual, unit, weight = residuals(pairs, np.array([[3.0, 4.0], [30.0, 40.0]]))
    np.testing.assert_allclose(residual, [1.0, 45.0])
    np.testing.assert_allclose(unit, [[0.6, 0.8], [0.6, 0.8]])
    np.testing.assert_allclose(weight, [0.25 / (1 + (r / 2 / 2.385) ** 2) for r in (1.0, 45.0)])


def test_derivatives_of_points_are_those_of_differences() -> None:
    state, ahead = np.array([[3.0, -2.0, 0.4, 0.1]]), np.array([[5.0, 2.0]])
    place, by_state = _by_state(state, np.array([0]), ahead)
    for k in range(4):
        moved = state.copy()
        moved[0, k] += 1e-6
        np.testing.assert_allclose(
            (_by_state(moved, np.array([0]), ahead)[0] - place)[0] / 1e-6, by_state[0, :, k], atol=1e-5
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
    found = solve_group(walks, PlacedGroup({0: Pose(0.3, np.zeros(2))}, frozenset([0])), {0: known})
    position_m, cov_m2 = step_positions(walks, 0, found[0])
    np.testing.assert_allclose(position_m[[0, -1]], ends, atol=0.15)
    np.testing.assert_allclose(cov_m2[[0, -1]], np.tile(0.05**2 * np.eye(2), (2, 1, 1)), rtol=0.2, atol=3e-4)
    middle = len(position_m) // 2
    np.testing.assert_allclose(position_m[middle], ends.mean(axis=0), atol=1.5)
    assert cov_m2[middle, 0, 0] > cov_m2[0, 0, 0]


def test_a_known_heading_rotates_a_walk(chain: Chain) -> None:
    walks, half_s = ScannedWalks.of([chain]), float(chain.time_s[len(chain.time_s) // 2])
    known = [pdr.PositionFix(0.0, (0.0, 0.0), 0.01 * np.eye(2)), pdr.HeadingFix(half_s, np.pi / 2, 0.01)]
    found = solve_group(walks, PlacedGroup({0: Pose(1.2, np.zeros(2))}, frozenset([0])), {0: known})
    end_m = step_positions(walks, 0, found[0])[0][-1]
    assert end_m[0] == pytest.approx(25.0, rel=0.15) and abs(end_m[1]) < 3.0


def test_the_index_gives_cosines_of_fingerprints() -> None:
    # the loudness is the square of the level: 1 at -30 dBm, 0.25 at -65 dBm
    scans = Scans(np.array([0, 1]), np.array([0, 2, 3]), np.array([5, 9, 9]), np.array([-30.0, -65.0, -50.0]))
    matrix, known = fingerprint_matrix([scans])
    assert known.tolist() == [5, 9]
    cosine = 0.25 / np.hypot(1.0, 0.25)
    np.testing.assert_allclose((matrix @ matrix.T).toarray(), [[1.0, cosine], [cosine, 1.0]])


def test_walks_that_are_on_a_map_stay_although_the_others_do_not_confirm_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(placing, "_is_confirmed", lambda *_: False)
    monkeypatch.setattr(placing, "adjust", lambda *_: None)
    group = PlacedGroup({i: Pose(0.0, np.zeros(2)) for i in range(4)}, frozenset([0]))
    assert placing.settle(cast(Any, None), group, kept=frozenset([0, 2])) == [1, 3]
    assert set(group.poses) == {0, 2}
