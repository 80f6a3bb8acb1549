"""Comparisons of several tracks of one recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.evaluate import comparison, runs, tracks
from pdr_filter.filter.chain.weighted_tracker import WeightedTracker
from pdr_filter.filter.imm.weighting import HC, weighted_distances
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.simulate.walk import demo_legs
from pdr_filter.values import steps_of
from pdr_filter.values.recording import Truth
from tests.oracles import martinelli2018 as printed_algorithms
from tests.oracles import track_scores as oracle


@pytest.fixture(scope="module")
def walk() -> pdr.Recording:
    return pdr.simulate.demo_walk()


@pytest.fixture(scope="module")
def config(walk: pdr.Recording) -> pdr.Config:
    return pdr.recipes.for_recording("default", walk)


@pytest.fixture(scope="module")
def by_weighting(walk: pdr.Recording, config: pdr.Config) -> dict[str, pdr.Track]:
    return runs.weighting_tracks(walk, config)


def test_the_samples_of_a_walk_are_sensed_once_for_all_weightings(
    walk: pdr.Recording, config: pdr.Config, by_weighting: dict[str, pdr.Track], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, track in by_weighting.items():
        alone = pdr.track(walk, config, weighting=name, gnss="off")
        np.testing.assert_array_equal(track.position_m, alone.position_m)
        np.testing.assert_array_equal(track.position_cov_m2, alone.position_cov_m2)
        assert track.notes == alone.notes
    sensed: list[int] = []
    update = Sensing.update
    monkeypatch.setattr(Sensing, "update", lambda *of: (sensed.append(len(of[2].time_s)), update(*of))[1])
    runs.weighting_errors(walk)
    runs.threshold_sweep(walk, config, [0.0, 1.0])
    assert sum(sensed) == 2 * len(walk.accelerometer)


def test_the_weightings_are_those_of_the_default_recipe_if_none_is_given_and_report_their_progress(
    walk: pdr.Recording, by_weighting: dict[str, pdr.Track]
) -> None:
    seen: list[float] = []
    found = runs.weighting_tracks(walk, progress=seen.append)
    for name, track in found.items():
        np.testing.assert_array_equal(track.position_m, by_weighting[name].position_m)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


def test_the_weightings_share_their_steps_and_windows(by_weighting: dict[str, pdr.Track]) -> None:
    assert list(by_weighting) == ["hc", "wc", "imm"]
    assert [t.weighting for t in by_weighting.values()] == ["hc", "wc", "imm"]
    for other in by_weighting.values():
        np.testing.assert_array_equal(other.time_s, by_weighting["hc"].time_s)
        np.testing.assert_array_equal(other.windows.context_prob, by_weighting["hc"].windows.context_prob)


def test_the_cost_of_contexts_is_that_of_the_tracks_where_all_steps_are_labelled(
    walk: pdr.Recording, by_weighting: dict[str, pdr.Track]
) -> None:
    labels = walk.truth.labels.copy()
    labels.start_s[0], labels.end_s[-1] = -1.0, np.inf
    found = runs.weighting_errors(replace(walk, truth=replace(walk.truth, labels=labels)))
    distance_m = dict(zip(found.weighting.tolist(), found.distance_m, strict=True))
    for name in ("hc", "wc", "imm"):
        assert distance_m[name] == pytest.approx(by_weighting[name].distance_m, rel=1e-9)
    assert distance_m["imm, as the steps were made"] == pytest.approx(by_weighting["imm"].step_length_m.sum())
    errors = dict(zip(found.weighting.tolist(), found.error_percent, strict=True))
    assert errors["contexts known"] == 0
    assert errors["hc"] == pytest.approx(100 * (distance_m["hc"] / distance_m["contexts known"] - 1))


def test_without_a_label_that_names_a_context_there_is_nothing_to_hold_contexts_against(walk: pdr.Recording) -> None:
    labels = walk.truth.labels.copy()
    labels.context[:] = "swimming"
    for truth in (replace(walk.truth, labels=labels), Truth()):
        with pytest.raises(ValueError, match="inside a label"):
            runs.weighting_errors(replace(walk, truth=truth))


def test_the_table_is_what_the_functions_say(walk: pdr.Recording, by_weighting: dict[str, pdr.Track]) -> None:
    found = comparison.comparison_table(walk, by_weighting)
    assert found.name.tolist() == ["hc", "wc", "imm"]
    imm, points = by_weighting["imm"], walk.truth.waypoints
    reference = np.column_stack([points.east_m, points.north_m])
    estimate = tracks.positions_at(imm.time_s, imm.position_m, points.time_s)
    assert found.rmse_m[2] == tracks.position_rmse_m(estimate, reference, "all")
    assert found.end_error_percent[2] == tracks.end_error_percent(estimate, reference, "first")
    assert found.distance_m[2] == imm.distance_m
    assert found.step_error_percent[2] == pytest.approx(100 * (imm.n_steps / len(walk.truth.steps) - 1))
    assert found.leg_error_percent[2] == comparison.leg_error_percent(walk, imm)
    assert np.isnan(found.nis).all() and found.inside_95_percent[2] == 100


def test_legs_have_the_length_of_the_accuracy_benchmark() -> None:
    # without a gyroscope bias: corrections of the heading move positions, and the benchmark measures between positions
    errors = pdr.simulate.SensorErrors.none()
    walk = pdr.simulate.simulate(demo_legs(0), pdr.simulate.Gait(height_m=1.86), "pocket", errors=errors)
    imm = pdr.track(walk)
    segments = walk.truth.segments
    walked = replace(walk, truth=replace(walk.truth, segments=segments[segments.distance_m > 0]))
    expected = oracle.track_errors(walked, imm)[3]
    # where within its first step the walk begins is taken otherwise: less than that step
    first = 100 * imm.step_length_m[0] / segments.distance_m.sum()
    assert comparison.leg_error_percent(walk, imm) == pytest.approx(expected, abs=first)
    with pytest.raises(ValueError, match="no truth segments"):
        comparison.leg_error_percent(replace(walk, truth=Truth()), imm)


def test_a_leg_with_a_turn_has_the_length_of_its_path(walk: pdr.Recording, by_weighting: dict[str, pdr.Track]) -> None:
    imm, total_m = by_weighting["imm"], walk.truth.segments.distance_m.sum()
    whole = replace(walk, truth=replace(walk.truth, segments=walk.of_distance(float(total_m)).truth.segments))
    assert comparison.leg_error_percent(whole, imm) == pytest.approx(100 * (imm.distance_m / total_m - 1), abs=0.01)


def test_nees_and_coverage_are_those_of_places_in_the_frame_of_the_fixes(walk: pdr.Recording) -> None:
    points = walk.truth.waypoints
    place_m, shift_m = np.column_stack([points.east_m, points.north_m]), np.array([500.0, 20.0])
    fixes = [pdr.PositionFix(t, p + shift_m, np.eye(2)) for t, p in zip(points.time_s, place_m, strict=True)]
    track = pdr.track(walk, pdr.recipes.default().in_world_frame(), fixes=fixes)
    moved = points.copy()
    moved.east_m, moved.north_m = (place_m + shift_m).T
    given = replace(walk, truth=replace(walk.truth, waypoints=moved))
    (row,) = comparison.comparison_table(given, {"fixes": track}, truth_std_m=0.1)
    used = (points.time_s >= track.time_s[0]) & (points.time_s <= track.time_s[-1])
    after = np.searchsorted(track.time_s, points.time_s[used])
    at_m = np.column_stack([np.interp(points.time_s[used], track.time_s, track.position_m[:, k]) for k in (0, 1)])
    error_m, cov_m2 = at_m - place_m[used] - shift_m, track.position_cov_m2[after] + 0.01 * np.eye(2)
    squared = [e @ np.linalg.inv(c) @ e for e, c in zip(error_m, cov_m2, strict=True)]
    assert row["nees"] == pytest.approx(np.mean(squared))
    assert row["inside_50_percent"] == pytest.approx(100 * np.mean(np.array(squared) < -2 * np.log(0.5)))
    assert row["inside_95_percent"] == pytest.approx(100 * np.mean(np.array(squared) < -2 * np.log(0.05)))
    assert row["nis"] == pytest.approx(np.mean([f.nis for f in track.fixes if f.outcome == "used"]))


def test_without_truth_there_are_no_errors(walk: pdr.Recording, by_weighting: dict[str, pdr.Track]) -> None:
    blind = replace(walk, truth=Truth())
    found = comparison.comparison_table(blind, by_weighting)
    for name in ("step_error_percent", "leg_error_percent", "rmse_m", "end_error_percent"):
        assert np.isnan(found[name]).all()
    with pytest.raises(ValueError, match="no waypoints"):
        comparison.in_truth_frame(blind, by_weighting["imm"])


def test_in_the_frame_of_the_truth_it_is_as_far_off_as_the_table_says(
    walk: pdr.Recording, by_weighting: dict[str, pdr.Track]
) -> None:
    imm, points = by_weighting["imm"], walk.truth.waypoints
    turned = comparison.in_truth_frame(walk, imm)
    assert turned.shape == (imm.n_steps + 1, 2)
    moved_m = np.linalg.norm(np.diff(np.vstack([[0, 0], imm.position_m]), axis=0), axis=1)
    np.testing.assert_allclose(np.linalg.norm(np.diff(turned, axis=0), axis=1), moved_m, atol=1e-9)
    inside = (points.time_s >= imm.time_s[0]) & (points.time_s <= imm.time_s[-1])
    at = np.column_stack([np.interp(points.time_s[inside], imm.time_s, turned[1:, k]) for k in (0, 1)])
    estimate = tracks.positions_at(imm.time_s, imm.position_m, points.time_s)
    expected = tracks.aligned(estimate, np.column_stack([points.east_m, points.north_m]), "all")[inside]
    np.testing.assert_allclose(at, expected, atol=1e-9)


def test_a_track_in_the_frame_of_fixes_is_as_far_off_as_in_its_own(
    walk: pdr.Recording, by_weighting: dict[str, pdr.Track]
) -> None:
    imm, shift_m = by_weighting["imm"], np.array([400.0, -300.0])
    moved = replace(imm, position_m=imm.position_m + shift_m, start_position_m=shift_m)
    found = comparison.comparison_table(walk, {"own": imm, "fixes": moved})
    for name in ("rmse_m", "end_error_percent"):
        assert found[name][1] == pytest.approx(found[name][0], rel=1e-6)
    here, there = (comparison.leg_error_percent(walk, t) for t in (imm, moved))
    assert there == pytest.approx(here, rel=1e-6)
    turned = comparison.in_truth_frame(walk, imm)
    np.testing.assert_allclose(comparison.in_truth_frame(walk, moved), turned, atol=1e-6)


def test_waypoints_that_are_not_known_are_left_out(walk: pdr.Recording, by_weighting: dict[str, pdr.Track]) -> None:
    points = walk.truth.waypoints
    holed = points.copy()
    holed.east_m[3], holed.time_s[5] = np.nan, np.nan
    without = np.delete(points, [3, 5]).view(np.recarray)
    with_truth = [replace(walk, truth=replace(walk.truth, waypoints=table)) for table in (holed, without)]
    first, second = (comparison.comparison_table(walk, {"imm": by_weighting["imm"]}) for walk in with_truth)
    np.testing.assert_equal(first.tolist(), second.tolist())
    assert np.isfinite(first.rmse_m).all()


def test_the_sweep_goes_from_always_weighted_to_the_highest(
    walk: pdr.Recording, config: pdr.Config, by_weighting: dict[str, pdr.Track]
) -> None:
    found = runs.threshold_sweep(walk, config, (0.0, 0.8, 1.0))
    assert found.distance_m[1] == by_weighting["wc"].distance_m
    assert found.distance_m[2] == pytest.approx(by_weighting["hc"].distance_m, rel=1e-9)
    assert found.distance_m[0] != pytest.approx(found.distance_m[2], rel=1e-3)


def test_the_ratio_is_zero_if_one_is_certain_and_one_if_two_are_equal() -> None:
    prob = np.array([[1.0, 0.0, 0.0], [0.4, 0.2, 0.4], [0.2, 0.3, 0.5]])
    np.testing.assert_allclose(comparison.second_over_first(prob), [0.0, 1.0, 0.6])
    assert comparison.second_over_first(np.zeros((0, 6))).shape == (0,)


@pytest.mark.parametrize("threshold", [None, 0.8])
def test_epochs_of_a_track_have_the_distances_of_the_printed_algorithms_and_of_the_tracker(
    config: pdr.Config, threshold: float | None
) -> None:
    legs = [pdr.simulate.Leg("walking", distance_m=8.0), pdr.simulate.Leg("upstairs", distance_m=2.0)]
    walk = pdr.simulate.simulate(legs)
    modes = config.model.modes
    without_evidence = replace(config.model, step_log_odds_stationary=0.0)  # the paper has no step evidence
    tracker = WeightedTracker(without_evidence, HC if threshold is None else threshold)
    track = pdr.track(walk, replace(config, tracker=tracker), gnss="off")
    distance_m, prob = runs.epoch_distances(track, modes)
    ends_s = track.windows.time_s
    length_m = np.array([[m.step_length.predict(s)[0] for m in modes] for s in steps_of(track.steps)])
    expected = printed_algorithms.distances_of_epochs(track.time_s, length_m, ends_s)
    np.testing.assert_allclose(distance_m, expected, atol=1e-9)
    totals = weighted_distances(distance_m, prob, HC if threshold is None else threshold)
    paper = printed_algorithms.algorithms(expected, prob, threshold)
    np.testing.assert_allclose(totals.total_final_m, paper["total_final_m"], atol=1e-9)
    walked_m = [track.step_length_m[track.time_s <= end_s].sum() for end_s in ends_s[:-1]]
    np.testing.assert_allclose(walked_m, paper["total_final_m"], atol=1e-9)


def test_modes_that_miss_a_context_are_refused(config: pdr.Config, by_weighting: dict[str, pdr.Track]) -> None:
    with pytest.raises(ValueError, match="exactly one mode for each"):
        runs.epoch_distances(by_weighting["hc"], config.model.modes[:-1])


def test_true_positions_without_waypoints_give_the_error_at_the_steps_after_the_best_rigid_alignment(
    walk: pdr.Recording, by_weighting: dict[str, pdr.Track]
) -> None:
    position, imm = walk.truth.position, by_weighting["imm"]
    unknown = position.copy()
    unknown.east_m[::7] = np.nan
    for known in (position, unknown):
        seen = replace(walk, truth=replace(walk.truth, position=known, waypoints=None))
        row = comparison.comparison_table(seen, {"imm": imm})[0]
        use = np.isfinite(known.east_m)
        truth = np.column_stack(
            [np.interp(imm.time_s, known.time_s[use], known[name][use]) for name in ("east_m", "north_m")]
        )
        a, b = imm.position_m - imm.position_m.mean(axis=0), truth - truth.mean(axis=0)
        u, _, v = np.linalg.svd(a.T @ b)  # Kabsch
        rotation = u @ np.diag([1.0, np.sign(np.linalg.det(u @ v))]) @ v
        assert row.rmse_m == pytest.approx(np.sqrt(((a @ rotation - b) ** 2).sum(axis=1).mean()), rel=1e-9)
        assert 0 < row.end_error_percent < 5
    turned = comparison.in_truth_frame(seen, imm)
    assert np.sqrt(((turned[1:] - truth) ** 2).sum(axis=1).mean()) == pytest.approx(row.rmse_m, rel=1e-9)
    still = replace(
        walk,
        truth=Truth(
            position=pdr.values.table(
                {**{n: position[n] * 0 for n in ("east_m", "north_m")}, "time_s": position.time_s}
            )
        ),
    )
    assert np.isnan(comparison.comparison_table(still, {"imm": imm}).rmse_m[0])
