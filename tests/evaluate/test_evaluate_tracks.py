"""Track metrics: closed forms, scipy's rotation fit, and the benchmark's own numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import clockwise
from scipy.spatial.transform import Rotation

import pdr_filter as pdr
from pdr_filter.evaluate import distance, tracks
from tests.oracles import track_scores as oracle


def turned(points: np.ndarray, angle_rad: float, shift_m: tuple[float, float]) -> np.ndarray:
    return points @ clockwise(angle_rad) + shift_m


@pytest.fixture
def way() -> np.ndarray:
    return np.cumsum(np.random.default_rng(0).normal(size=(40, 2)), axis=0)


def test_rmse_is_the_root_of_the_mean_squared_distance() -> None:
    estimate, reference = np.array([[3.0, 4.0], [0.0, 0.0]]), np.zeros((2, 2))
    assert tracks.position_rmse_m(estimate, reference) == pytest.approx(np.sqrt(25 / 2))


def test_the_convention_of_ronin_is_smaller_by_the_root_of_two(way: np.ndarray) -> None:
    estimate = way + np.random.default_rng(1).normal(size=way.shape)
    for align in ("none", "origin", "first", "all"):
        ours, theirs = tracks.position_rmse_m(estimate, way, align), tracks.axis_rmse_m(estimate, way, align)
        assert ours == pytest.approx(np.sqrt(2) * theirs)


def test_a_track_that_is_only_turned_and_moved_has_the_right_shape(way: np.ndarray) -> None:
    estimate = turned(way, 2.5, (7.0, -3.0))
    assert tracks.position_rmse_m(estimate, way, "all") == pytest.approx(0.0, abs=1e-12)
    assert tracks.position_rmse_m(estimate, way, "first") == pytest.approx(0.0, abs=1e-12)
    assert tracks.position_rmse_m(estimate, way, "none") > 1.0


def test_alignment_neither_scales_nor_mirrors(way: np.ndarray) -> None:
    larger = 1.1 * (way - way.mean(axis=0))
    assert tracks.position_rmse_m(larger, way, "all") == pytest.approx(0.1 * np.sqrt((way - way.mean(0)).var(0).sum()))
    assert tracks.position_rmse_m(way * [-1, 1], way, "all") > 0.5


def test_the_origin_alignment_moves_and_does_not_turn(way: np.ndarray) -> None:
    np.testing.assert_allclose(tracks.aligned(way + np.array([5.0, 6.0]), way, "origin"), way, atol=1e-12)
    estimate = tracks.aligned(turned(way, 0.5, (1.0, 2.0)), way, "origin")
    np.testing.assert_allclose(estimate[0], way[0])
    assert tracks.position_errors_m(estimate, way)[1:].min() > 0


def test_the_rotation_is_that_of_scipy(way: np.ndarray) -> None:
    """scipy turns in space: the vertical direction is nailed down by a pair of long vectors."""
    estimate = turned(way, 1.0, (1.0, 1.0)) + 0.3 * np.random.default_rng(2).normal(size=way.shape)
    a, b = (np.column_stack([p - p.mean(axis=0), np.zeros(len(p))]) for p in (estimate, way))
    up = np.array([[0.0, 0.0, 1e4]])
    rotation, _ = Rotation.align_vectors(np.vstack([b, up]), np.vstack([a, up]))
    expected = rotation.apply(a)[:, :2] + way.mean(axis=0)
    np.testing.assert_allclose(tracks.aligned(estimate, way, "all"), expected, atol=1e-6)


def test_the_first_fraction_is_of_the_path_and_has_three_points() -> None:
    reference = np.column_stack([np.zeros(11), np.arange(11.0)])
    assert tracks.first_of_path(reference, 0.5).sum() == 6
    assert tracks.first_of_path(reference, 0.05).sum() == 3


def test_the_end_error_is_in_per_cent_of_the_path() -> None:
    reference = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 20.0]])
    estimate = reference + np.array([[0.0, 0.0], [0.0, 0.0], [3.0, 4.0]])
    assert tracks.end_error_percent(estimate, reference) == pytest.approx(10.0)


def test_a_constant_drift_has_the_relative_error_of_what_it_drifts(way: np.ndarray) -> None:
    """0.1 m east a point: 1 m in ten, over both axes 1 / sqrt 2; a constant shift is no relative error at all."""
    drift = np.column_stack([0.1 * np.arange(len(way)), np.full(len(way), 7.0)])
    assert tracks.relative_error_m(way + drift, way, 10) == pytest.approx(1 / np.sqrt(2))


def test_directions_are_clockwise_from_north_and_unknown_at_rest() -> None:
    found = tracks.directions_rad(np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [1.0, 0.0]]))
    np.testing.assert_allclose(found, [0.0, np.pi / 2, np.pi, np.nan])


def test_heading_errors_do_not_count_turns() -> None:
    np.testing.assert_allclose(tracks.heading_errors_rad([0.1 + 6 * np.pi, -3.1], [0.0, 3.1]), [0.1, 2 * np.pi - 6.2])


def test_positions_of_a_track_begin_at_the_origin_and_stay_at_the_end() -> None:
    found = tracks.positions_at(np.array([1.0, 2.0]), np.array([[0.0, 1.0], [0.0, 2.0]]), [0.0, 1.0, 1.5, 9.0])
    np.testing.assert_allclose(found, [[0, 0.001 / 1.001], [0, 1], [0, 1.5], [0, 2]], atol=1e-12)
    assert tracks.positions_at(np.zeros(0), np.zeros((0, 2)), [1.0, 2.0]).tolist() == [[0, 0], [0, 0]]


def test_a_track_in_another_frame_begins_where_it_is_said_to() -> None:
    time_s, position_m, start_m = np.array([1.0, 2.0]), np.array([[50.0, 1.0], [50.0, 2.0]]), (50.0, 0.0)
    found = tracks.positions_at(time_s, position_m, [np.nan, -5.0, 0.0, 1.0], start_m)
    np.testing.assert_allclose(found[1:], [[50.0, 0.0], [50.0, 5.0 / 6.0], [50.0, 1.0]], atol=1e-3)
    assert np.isnan(found[0]).all()
    assert tracks.positions_at(np.zeros(0), np.zeros((0, 2)), [1.0], start_m).tolist() == [[50.0, 0.0]]
    np.testing.assert_allclose(tracks.moved_m(time_s, position_m, [0.0], [2.0], start_m), [2.0], atol=2e-3)


@pytest.mark.parametrize("align", ["none", "origin", "first", "all"])
def test_points_that_are_not_known_are_refused_with_their_number(align: tracks.Alignment) -> None:
    known = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 1.0], [3.0, 3.0]])
    unknown = known.copy()
    unknown[2] = np.nan
    for name, pair in (("reference", (known, unknown)), ("estimate", (unknown, known))):
        for score in (tracks.position_rmse_m, tracks.axis_rmse_m, tracks.end_error_percent):
            with pytest.raises(ValueError, match=f"{name} is not known at point 2"):
                score(*pair, align)
    with pytest.raises(ValueError, match="at least one point"):
        tracks.position_rmse_m(known[:0], known[:0], align)


def test_of_no_points_there_is_no_path() -> None:
    assert tracks.path_m(np.zeros((0, 2))).shape == (0,)
    assert tracks.first_of_path(np.zeros((0, 2))).shape == (0,)
    assert tracks.path_m(np.ones((1, 2))).tolist() == [0.0]


def test_a_leg_that_comes_back_has_moved_nobody() -> None:
    time_s, position_m = np.array([1.0, 2.0, 3.0]), np.array([[0.0, 3.0], [4.0, 0.0], [0.0, 3.0]])
    np.testing.assert_allclose(tracks.moved_m(time_s, position_m, [1.0, 1.0, 2.0], [2.0, 3.0, 9.0]), [5.0, 0.0, 5.0])


def test_the_numbers_are_those_of_the_accuracy_benchmark() -> None:
    """Of a simulated walk, whose waypoints and distances are in the same tables as those of real ones."""
    recording = pdr.simulate.demo_walk()
    track = pdr.track(recording)
    shape, first, end, moved = oracle.track_errors(recording, track)
    points, segments = recording.truth.waypoints, recording.truth.segments
    reference = np.column_stack([points.east_m, points.north_m])
    estimate = tracks.positions_at(track.time_s, track.position_m, points.time_s)
    assert tracks.position_rmse_m(estimate, reference, "all") == pytest.approx(shape, rel=1e-12)
    assert tracks.position_rmse_m(estimate, reference, "first") == pytest.approx(first, rel=1e-12)
    assert tracks.end_error_percent(estimate, reference, "first") == pytest.approx(end, rel=1e-12)

    legs_m = tracks.moved_m(track.time_s, track.position_m, segments.start_s, segments.end_s)
    assert distance.percent_error(legs_m.sum(), segments.distance_m.sum()) == pytest.approx(moved, rel=1e-9)


def test_the_legs_of_a_recording_have_all_the_steps_of_its_track(data_dir: Path) -> None:
    recording = pdr.read(data_dir / "humolire" / "humolire_user1_straight.zip")
    track = pdr.track(recording)
    walked = distance.walked_m(track.time_s, track.step_length_m, [-np.inf, 60.0], [60.0, np.inf])
    assert walked.sum() == pytest.approx(track.step_length_m.sum())
    reference = np.column_stack([recording.truth.waypoints.east_m, recording.truth.waypoints.north_m])
    estimate = tracks.positions_at(track.time_s, track.position_m, recording.truth.waypoints.time_s)
    assert tracks.position_rmse_m(estimate, reference, "all") == pytest.approx(
        oracle.track_errors(recording, track)[0], rel=1e-12
    )
