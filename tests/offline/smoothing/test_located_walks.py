"""Smoothed walks with the arguments of `track`: locations, north, a given origin, other fixes, loops and storeys."""

from __future__ import annotations

import inspect
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import true_positions
from scipy.optimize import approx_fprime
from simulated_steps import simulated_walk
from true_positions import HERE

import pdr_filter as pdr
from pdr_filter.offline.smoothing.linear_graph import Rows, graph_of, joint_covariances
from pdr_filter.offline.smoothing.location_errors import (
    errors_of,
    joined_at_contacts,
    scatter_of,
    with_even_variances,
    with_scatter,
)
from pdr_filter.offline.smoothing.observations import Observations
from pdr_filter.offline.smoothing.problem import ObservedStates, Problem, pose_problem
from pdr_filter.offline.smoothing.solve import linear_equations, solve
from pdr_filter.offline.smoothing.storeys import with_named_floors
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import FloorPassage, HeadingFix, PositionFix, Samples, SpeedFix, Standstill

pytestmark = pytest.mark.usefixtures("sensing_once")

TURN_RAD = 2.1


@cache
def bare() -> pdr.Recording:
    """Return a walk of three legs of a block, without any position information."""
    legs = [Leg("walking", distance_m=50.0)]
    legs += [Leg("walking", distance_m=d, turn_rad=np.pi / 2) for d in (30.0, 50.0)]
    return replace(simulate(legs, seed=3, name="walk"), magnetometer=None)


@cache
def smoothed_bare() -> pdr.Smoothed:
    return pdr.smooth(bare())


def truth_m(walk: pdr.Recording, times_s: np.ndarray) -> np.ndarray:
    """Return the true positions in metres from `HERE`."""
    c, s = np.cos(TURN_RAD), np.sin(TURN_RAD)
    return true_positions.true_m(walk, times_s) @ np.array([[c, s], [-s, c]]).T + [40.0, -25.0]


def located(off_m: np.ndarray | tuple[float, float] = (0.0, 0.0), accuracy_m: float = 8.0) -> pdr.Recording:
    """Return the walk with a location every two seconds, with the errors `off_m` (N, 2)."""
    time_s = np.arange(1.3, bare().duration_s, 2.0)
    latitude_deg, longitude_deg = HERE.latitude_longitude_deg(truth_m(bare(), time_s) + off_m)
    values = np.column_stack([latitude_deg, longitude_deg, np.full((len(time_s), 2), [520.0, accuracy_m])])
    return replace(bare(), location=Samples(time_s, values))


def errors_m(track: pdr.Track) -> np.ndarray:
    place_m = HERE.east_north_m(track.latitude_deg, track.longitude_deg)
    return np.linalg.norm(place_m - truth_m(bare(), track.time_s), axis=1)


# --- the arguments of track -------------------------------------------------------------------------------------------


def test_smooth_takes_every_argument_of_track() -> None:
    given, taken = (inspect.signature(f).parameters for f in (pdr.track, pdr.smooth))
    assert set(given) <= set(taken)
    assert all(given[name].default == taken[name].default for name in given)


@pytest.mark.parametrize(
    "options",
    [
        {"gnss": "sometimes"},
        {"gnss": "filter", "origin": (48.0, 11.0)},
        {"gnss": "align", "fixes": [PositionFix(5.0, (0.0, 0.0), np.eye(2))]},
        {"gnss": "align", "fixes": [HeadingFix(5.0, 0.0, 0.1)]},
        {"north": "magnetic"},
        {"north": "south"},
        {"heading_rad": np.nan},
        {"start": "anywhere"},
        {"weighting": "best"},
        {"fixes": [pdr.GridFix(5.0, (0.0, 0.0), 1.0, np.zeros((2, 2)))]},
    ],
)
def test_smooth_refuses_the_same_arguments_as_track_with_the_same_messages(options: dict[str, Any]) -> None:
    said: list[str] = []
    for function in (pdr.track, pdr.smooth):
        with pytest.raises(ValueError) as error:
            function(located(), **options)
        said.append(str(error.value))
    assert said[0] == said[1]


def test_a_walk_smoothed_with_locations_has_smaller_errors_than_the_online_track() -> None:
    walk = located()
    smoothed, online = pdr.smooth(walk).track, pdr.track(walk)
    assert (smoothed.frame, smoothed.is_smoothed, online.is_smoothed) == ("fixes", True, False)
    assert errors_m(smoothed).mean() < errors_m(online).mean() < 1.0
    assert smoothed.altitude_m is not None
    assert abs(smoothed.altitude_m - 520.0).max() < 5.0
    assert [fix.kind for fix in smoothed.fixes] == ["position"] * len(online.fixes)


def test_with_gnss_off_a_walk_is_smoothed_as_if_it_had_no_locations() -> None:
    off, alone = pdr.smooth(located(), gnss="off").track, smoothed_bare().track
    np.testing.assert_array_equal(off.position_m, alone.position_m)
    assert off.origin is None


def test_aligned_locations_rotate_and_shift_the_smoothed_walk_without_deforming_it() -> None:
    walk = located()
    smoothed, alone = pdr.smooth(walk, gnss="align").track, smoothed_bare().track
    np.testing.assert_allclose(np.diff(smoothed.walked_m), np.diff(alone.walked_m), atol=1e-9)
    apart = [t.position_m - t.position_m[0] for t in (smoothed, alone)]
    np.testing.assert_allclose(*(np.linalg.norm(a, axis=1) for a in apart), atol=1e-6)
    assert np.median(errors_m(smoothed)) < 5.0


def test_the_smoothed_walk_has_the_given_origin_and_heading() -> None:
    smoothed = pdr.smooth(bare(), origin=HERE, heading_rad=1.2)
    plain = smoothed_bare()
    expected = plain.track.turned(1.2).placed(HERE)
    np.testing.assert_array_equal(smoothed.track.position_m, expected.position_m)
    np.testing.assert_array_equal(smoothed.track.latitude_deg, expected.latitude_deg)
    turned_rad = smoothed.heading_offset_rad - plain.heading_offset_rad - 1.2
    np.testing.assert_allclose(np.sin(0.5 * turned_rad), 0.0, atol=1e-12)
    assert not smoothed.start_position_m.any()


def test_a_phone_attitude_with_north_rotates_the_smoothed_walk_to_it() -> None:
    recording = simulate([Leg("walking", distance_m=30.0)], seed=4)
    smoothed, online = (function(recording, north="magnetic", origin=HERE) for function in (pdr.smooth, pdr.track))
    assert smoothed.track.frame == online.frame == "north"
    far = smoothed.track.position_m[-1] - online.position_m[-1]
    assert np.linalg.norm(far) < 3.0 < np.linalg.norm(online.position_m[-1])


def test_heading_and_speed_fixes_and_standstills_are_used_by_the_smoother() -> None:
    plain = smoothed_bare()
    heading = HeadingFix(20.0, float(np.interp(20.0, plain.track.time_s, plain.track.walking_heading_rad)) + 1.0, 0.01)
    turned = pdr.smooth(bare(), fixes=[heading])
    wrapped = np.angle(np.exp(1j * (turned.track.walking_heading_rad - plain.track.walking_heading_rad)))
    assert np.median(wrapped) == pytest.approx(1.0, abs=0.1)
    speed = float(np.interp(20.0, plain.track.time_s, plain.track.smoothed_speed_mps))
    faster = pdr.smooth(bare(), fixes=[SpeedFix(20.0, 1.1 * speed, 0.005 * speed)])
    assert 1.005 < faster.scale / plain.scale < 1.1
    assert pdr.smooth(bare(), fixes=[Standstill(0.0, 20.0)]).track.distance_m < plain.track.distance_m - 10.0
    assert (turned.observations.weight[0], faster.observations.weight[0]) == (1.0, 1.0)


# --- errors of locations ----------------------------------------------------------------------------------------------


def test_a_location_that_contradicts_the_walk_is_named_with_its_time_and_not_used() -> None:
    n = len(located().location.time_s)
    off_m = np.zeros((n, 2))
    time_s = located().location.time_s
    off_m[(time_s > 50.0) & (time_s < 60.0)] = 120.0  # one of them is used
    smoothed = pdr.smooth(located(off_m))
    assert "the walk contradicts 1 location, at 55 s: not used" in smoothed.notes
    assert len(smoothed.rejected) == 1
    assert errors_m(smoothed.track).max() < 8.0


def test_a_common_error_of_all_locations_remains_in_the_covariance() -> None:
    smoothed = pdr.smooth(located((6.0, -6.0))).track
    error = HERE.east_north_m(smoothed.latitude_deg, smoothed.longitude_deg) - truth_m(bare(), smoothed.time_s)
    nees = np.einsum("ka,kab,kb->k", error, np.linalg.inv(smoothed.position_cov_m2), error)
    assert 5.0 < np.linalg.norm(error.mean(axis=0)) < 10.0
    assert np.median(nees) < 9.2


def test_locations_share_a_constant_error_and_other_correlated_fixes_do_not() -> None:
    fixes = [PositionFix(t, (t, 0.0), 25.0 * np.eye(2), correlation_s=20.0) for t in (0.0, 10.0)]
    located, others = (errors_of(fixes, np.full(2, is_one), np.array([0, 5])) for is_one in (True, False))
    np.testing.assert_allclose(located.by[0, :, :2], np.sqrt(0.2) * 5.0 * np.eye(2))
    np.testing.assert_allclose(located.decay[0, [0, 2]], np.exp([-10.0 / 3600.0, -0.5]))
    assert not others.by[:, :, [0, 1, 4, 5]].any()
    np.testing.assert_allclose(np.linalg.norm(others.by[0], axis=1) ** 2, 0.99 * 25.0)


@pytest.mark.parametrize(("size", "accuracy_m"), [(0.6, 5.0), (0.75, 5.0), (1.25, 8.0)])
def test_locations_of_a_small_area_do_not_change_the_step_length(size: float, accuracy_m: float) -> None:
    truth = truth_m(bare(), located().location.time_s)
    resized = pdr.smooth(located((size - 1.0) * (truth - truth.mean(axis=0)), accuracy_m))
    assert resized.scale == pytest.approx(smoothed_bare().scale, rel=0.03)
    assert resized.track.person is None


@pytest.mark.parametrize(("size", "share", "limit_m"), [(1.1, 0.07, np.inf), (0.95, 0.5, 4.5), (0.75, 0.5, np.inf)])
def test_locations_determine_the_step_length_on_a_long_way_unless_they_are_drawn_together(
    size: float, share: float, limit_m: float
) -> None:
    time_s = np.arange(0.0, 240.0, 10.0)
    corner_m = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])
    walk_m = np.column_stack([np.interp(time_s, [0.0, 80.0, 160.0, 240.0], column) for column in corner_m.T])
    fixes = [PositionFix(t, size * p, 9.0 * np.eye(2), correlation_s=20.0) for t, p in zip(time_s, walk_m, strict=True)]
    node = np.arange(len(fixes))
    shrunk = np.linalg.norm(errors_of(fixes, np.full(len(fixes), True), node, walk_m).by[:, :, 4], axis=1)
    middle = 12  # the location whose window is the whole walk
    away_m = np.linalg.norm(walk_m - walk_m.mean(axis=0), axis=1)
    assert shrunk[middle] == pytest.approx(min(share * away_m[middle], limit_m))


def test_an_outlier_does_not_hide_that_the_extent_of_locations_is_right() -> None:
    time_s = np.arange(0.0, 230.0, 10.0)
    walk_m = np.column_stack([time_s, np.abs(time_s - 100.0)])
    off_m = np.zeros_like(walk_m)
    off_m[4] = 60.0
    fixes = [
        PositionFix(t, p, 4.0 * np.eye(2), correlation_s=20.0) for t, p in zip(time_s, walk_m + off_m, strict=True)
    ]
    shrunk = errors_of(fixes, np.full(len(fixes), True), np.arange(len(fixes)), walk_m).by[:, :, 4]
    assert np.linalg.norm(shrunk, axis=1)[11] == pytest.approx(3.0)


def test_location_variances_are_moved_towards_the_median() -> None:
    fixes = [PositionFix(float(k), (0.0, 0.0), v * np.eye(2), correlation_s=20.0) for k, v in enumerate((1, 9, 9, 100))]
    assert [f.var_m2 for f in with_even_variances(fixes)] == [9.0, 9.0, 9.0, 50.0]
    assert with_even_variances([]) == ()


def _with_errors(rejected: bool) -> Problem:
    walk = simulated_walk(60, np.random.default_rng(2))
    fixes = [
        PositionFix(float(walk.steps.time_s[k]) - 0.1, walk.position_m[k], 25.0 * np.eye(2), correlation_s=20.0)
        for k in (4, 20, 40, 55)
    ]
    if rejected:
        fixes[0] = replace(fixes[0], position_m=fixes[0].position_m + 500.0)
    start_cov = np.diag(np.square([1000.0, 1000.0, 1.0, 0.06]))
    return pose_problem(walk.steps, np.zeros(4), start_cov, Observations(locations=tuple(fixes)), anchor_interval_s=5.0)


@pytest.mark.parametrize("rejected", [False, True])
def test_covariances_with_location_errors_equal_those_of_the_dense_inverse(rejected: bool) -> None:
    problem = _with_errors(rejected)
    found = solve(problem)
    assert (found.weight < 0.5).tolist() == [rejected, False, False, False]
    rows = linear_equations(problem, found.states, found.frame_rad, found.weight)
    jacobian = graph_of(rows).jacobian()[0]
    dense = np.linalg.inv(jacobian.T @ jacobian)
    joint, with_error = joint_covariances(rows, problem.n_nodes, problem.errors.node, has_frame=False)
    np.testing.assert_allclose(joint[3], dense[12:20, 12:20], rtol=1e-5, atol=1e-7)
    at = 4 * problem.n_nodes + 6 * 2
    node = 4 * int(problem.errors.node[2])
    index = [*range(node, node + 4), *range(at, at + 6)]
    np.testing.assert_allclose(with_error[2], dense[np.ix_(index, index)], rtol=1e-5, atol=1e-7)


def test_equations_with_errors_and_measured_states_are_the_derivatives_of_their_residuals() -> None:
    states = ObservedStates(np.array([10, 30]), np.array([2, 3]), np.array([0.3, 0.1]), np.array([0.2, 0.05]))
    problem = replace(_with_errors(rejected=False), states=replace(states, node=np.array([1, 4])))
    n, size = problem.n_nodes, 4 * problem.n_nodes
    mean = solve(problem).states
    mean[:n, :4] += np.random.default_rng(3).normal(scale=0.05, size=(n, 4))
    ones = np.ones(len(problem.positions) + len(states))
    begins = [4 * key if key < n else size + 6 * (key - n) for key in range(problem.n_states)]

    def rows_of(values: np.ndarray) -> list[Rows]:
        moved = np.zeros_like(mean)
        moved[:n, :4], moved[n:] = values[:size].reshape(n, 4), values[size:].reshape(-1, 6)
        return linear_equations(problem, moved, 0.0, ones)

    at = np.concatenate([mean[:n, :4].ravel(), mean[n:].ravel()])
    # the intervals are tested with every other kind of equation (test_smoother.py)
    for number in (0, 2, 3, 4, 5):
        for block, (a, b) in enumerate(zip(rows_of(at)[number].a, rows_of(at)[number].b, strict=True)):
            rows = rows_of(at)[number]
            numeric = approx_fprime(at, lambda v, i=number, k=block: -rows_of(v)[i].rhs[k], 1e-6)
            expected = np.zeros_like(np.atleast_2d(numeric))
            for key, matrices in ((a, rows.A), (b, rows.B)):
                if key >= 0:
                    expected[:, begins[key] : begins[key] + matrices.shape[2]] += matrices[block]
            np.testing.assert_allclose(np.atleast_2d(numeric), expected, atol=2e-4 * np.abs(expected).max())


def test_correlated_fixes_at_one_contact_are_joined_and_independent_ones_are_not() -> None:
    fixes = [PositionFix(float(t), (t, 0.0), 4.0 * np.eye(2), correlation_s=c) for t, c in ((3, 20), (1, 20), (2, 0))]
    joined, number = joined_at_contacts(fixes, np.array([7, 7, 7]))
    assert [(f.position_m[0], f.correlation_s) for f in joined] == [(2.0, 20.0), (2.0, 0.0)]
    assert number.tolist() == [0, 0, 1]
    np.testing.assert_allclose(joined[0].cov_m2, 4.0 * np.eye(2))


# --- loops and storeys ------------------------------------------------------------------------------------------------


@cache
def closed(last_m: float = 40.0) -> pdr.Recording:
    """Return a walk around a block with steps that are a tenth longer than usual. Its last side may be too short."""
    legs = [Leg("walking", distance_m=40.0)]
    legs += [Leg("walking", distance_m=d, turn_rad=np.pi / 2) for d in (25.0, 40.0, 25.0)]
    if last_m < 40.0:
        legs = legs[:2]
    return simulate(legs, seed=6)


def test_a_walk_with_loop_ends_at_its_start() -> None:
    open_end, closed_end = (pdr.smooth(closed(), loop=loop).track for loop in (False, True))
    distance_m = [float(np.linalg.norm(t.end_position_m - t.start_position_m)) for t in (open_end, closed_end)]
    assert distance_m[1] < 1.0
    assert closed_end.position_std_m[-1] < 0.7 * open_end.position_std_m[-1]


def test_a_loop_ends_as_certain_as_stated_after_the_gyroscope_has_ended() -> None:
    """The second-order errors of an unknown heading are those of all steps, and the loop bounds their sum."""
    walk = closed()
    gyroscope = walk.gyroscope
    is_first = gyroscope.time_s < 0.5 * walk.duration_s
    half = Samples(gyroscope.time_s[is_first], gyroscope.values[is_first])
    std_m = pdr.smooth(replace(walk, gyroscope=half), loop=True).track.position_std_m
    assert std_m[-1] < 1.0
    assert std_m.max() > 5.0


def test_a_wrong_loop_is_reported_and_not_used() -> None:
    plain, stated = (pdr.smooth(closed(25.0), loop=loop) for loop in (False, True))
    (note,) = set(stated.notes) - set(plain.notes)
    assert note == "the walk did not end within 1 m of its start: loop was not used"
    np.testing.assert_allclose(stated.track.position_m, plain.track.position_m, atol=0.05)


def a_climb(track: pdr.Track, height_m: float) -> pdr.Track:
    """Return the track with one storey more from its middle on, climbed in ten steps."""
    k = track.n_steps // 2
    way = np.clip((np.arange(track.n_steps) - k) / 10.0, 0.0, 1.0)
    floor = (way > 0.5).astype(track.floor.dtype)
    passage = FloorPassage(float(track.time_s[k]), float(track.time_s[k + 10]), 0, 1, "stairs")
    return replace(track, height_m=height_m * way, floor=floor, floor_passages=(passage,))


def test_a_fix_with_a_storey_sets_the_storeys_of_the_whole_walk() -> None:
    track = a_climb(pdr.track(bare()), 3.5)
    named = with_named_floors(track, [PositionFix(float(track.time_s[-1]), (0.0, 0.0), np.eye(2), floor=5)])
    assert (int(named.floor[0]), int(named.floor[-1])) == (4, 5)
    assert (named.floor_passages[0].from_floor, named.floor_passages[0].to_floor) == (4, 5)


@pytest.mark.parametrize("actual", [0.5, 1.0, 5.0])
def test_locations_have_the_scatter_about_the_shape_of_the_walk_if_it_is_twice_the_stated_one(actual: float) -> None:
    rng, time_s = np.random.default_rng(1), np.arange(0.0, 300.0, 10.0)
    heading_rad = 0.5 * np.pi * np.floor(time_s / 50.0)
    walk_m = np.cumsum(13.0 * np.column_stack([np.sin(heading_rad), np.cos(heading_rad)]), axis=0)
    found = []
    for _ in range(8):
        place_m = walk_m @ np.array([[0.6, -0.8], [0.8, 0.6]]) + rng.normal(scale=3.0 * actual, size=walk_m.shape)
        fixes = [PositionFix(t, p, 9.0 * np.eye(2), correlation_s=20.0) for t, p in zip(time_s, place_m, strict=True)]
        part = np.zeros(len(fixes) + 1, dtype=np.int64)
        walk = cast(Any, SimpleNamespace(time_s=time_s, position_m=walk_m))
        scatter = scatter_of(fixes, walk, part)
        found.append(scatter)
        factor = with_scatter(fixes, scatter)[3].var_m2 / fixes[3].var_m2
        assert factor == pytest.approx(scatter**2 if actual == 5.0 else 1.0)
    assert np.median(found) == pytest.approx(actual, rel=0.15)
    assert scatter_of(fixes, walk, np.arange(len(fixes) + 1)) == 0.0  # the heading is lost between all of them
