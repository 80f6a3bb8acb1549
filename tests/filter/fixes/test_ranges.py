"""Ranges to anchors and measurements of other classes: accuracy, reflections, two hypotheses, gating."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from helpers import OfHeading, clockwise, nees_of, push_part, resumed, true_position_m
from scipy.stats import chi2

import pdr_filter as pdr
from pdr_filter.filter.chain.handler import part_of
from pdr_filter.filter.chain.imm_tracker import ImmTracker
from pdr_filter.filter.chain.two_hypotheses import Hypotheses
from pdr_filter.filter.fixes import range_updates
from pdr_filter.filter.fixes.range_updates import _is_wide
from pdr_filter.filter.pedestrian.pedestrian_state import initial_state
from pdr_filter.filter.pedestrian.range_solutions import (
    MAX_RANGES,
    PairedRange,
    PriorPose,
    RangeSolution,
    recent,
    solutions,
)
from pdr_filter.sensing.clock import on_track_clock
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import Fix, FloatArray, Measurement
from tests.benchmarks.consistency import own_model, simulated_walk

pytestmark = pytest.mark.usefixtures("sensing_once")

ANCHORS = ((-8.0, -6.0), (25.0, -5.0), (5.0, 25.0))


@cache
def walk(seed: int, n_rounds: int = 3) -> pdr.Recording:
    """Rounds of a rectangle of 18 m by 12 m."""
    sides = [Leg("walking", distance_m=distance_m, turn_rad=np.pi / 2) for distance_m in (18.0, 12.0)]
    legs = 2 * n_rounds * sides
    return simulate(legs, carrying_mode="texting" if seed % 2 else "pocket", seed=seed)


@cache
def without_fixes(seed: int) -> pdr.Track:
    return pdr.track(walk(seed))


def a_range(
    recording: pdr.Recording, time_s: float, anchor_m: Sequence[float], error_m: float, std_m: float = 0.3
) -> pdr.RangeFix:
    distance_m = float(np.linalg.norm(true_position_m(recording, time_s) - np.asarray(anchor_m)[:2]))
    return pdr.RangeFix(time_s, np.array(anchor_m), max(distance_m + error_m, 0.0), std_m)


def ranges(
    recording: pdr.Recording, anchors: Sequence[Sequence[float]], seed: int, reflected: float = 0.0
) -> list[pdr.RangeFix]:
    """Return a range to each anchor every two seconds with noise of 0.3 m. Reflected ones are 3 m too long."""
    rng = np.random.default_rng(seed)
    return [
        a_range(recording, time_s, anchor_m, 3.0 * (rng.random() < reflected) + 0.3 * rng.normal())
        for time_s in np.arange(1.0, recording.truth.position.time_s[-1], 2.0)
        for anchor_m in anchors
    ]


def errors(track: pdr.Track, recording: pdr.Recording) -> tuple[float, float]:
    """Return the root mean square error in m, and the mean normalised squared error with two degrees of freedom."""
    off = track.position_m - true_position_m(recording, track.time_s)
    return float(np.sqrt((off**2).sum(axis=1).mean())), float(nees_of(off, track.position_cov_m2).mean())


@pytest.mark.parametrize(
    ("seed", "reflected", "most_m", "world"),
    [(4, 0.0, 0.5, False), (5, 0.0, 0.5, True), (4, 1 / 3, 0.8, True), (5, 1 / 3, 0.8, False)],
)
def test_ranges_to_three_anchors_keep_the_error_below_half_a_metre_and_with_reflections_below_eight_tenths(
    seed: int, reflected: float, most_m: float, world: bool
) -> None:
    recording, config = walk(seed), pdr.recipes.default()
    fixes = ranges(recording, ANCHORS, seed, reflected)
    track = pdr.track(recording, config=config.in_world_frame() if world else config, fixes=fixes)
    rmse_m, nees = errors(track, recording)
    assert rmse_m < most_m
    assert nees < 3.0
    assert track.frame == ("fixes" if world else "start")
    without_m, _ = errors(without_fixes(seed), recording)
    assert rmse_m < without_m
    outcomes = [fix.outcome for fix in track.fixes]
    assert outcomes.count("placed") == world
    assert set(outcomes) <= {"used", "rejected", "placed", "waiting"}
    assert outcomes.count("rejected") / len(outcomes) == pytest.approx(reflected, abs=0.1)


def test_the_innovations_of_ranges_are_as_large_as_the_filter_expects() -> None:
    model, nis, anchors = own_model("walking"), list[float](), 300.0 * np.array([[0, 1], [1, 0], [-0.7, -0.7]])
    tracker, n_walks = ImmTracker(own_model("walking")), 30
    for n in range(n_walks):
        rng = np.random.default_rng([3, n])
        drawn, state = simulated_walk(model, 100, rng), tracker.init()
        for k, step in enumerate(drawn.steps):
            state, _ = tracker.on_step(state, step)
            if k % 8 == 7:
                anchor_m = anchors[k // 8 % 3]
                distance_m = float(np.linalg.norm(drawn.state[k, :2] - anchor_m))
                fix = pdr.RangeFix(step.time_s, anchor_m, distance_m + 0.3 * rng.normal(), 0.3)
                state, _, of_fix = tracker.on_fix(state, fix)
                nis.append(of_fix)
    low, high = chi2.ppf([0.005, 0.995], len(nis)) / len(nis)
    assert low < np.mean(nis) < high


def test_ranges_to_two_anchors_leave_two_hypotheses_until_the_path_turns() -> None:
    recording, seen = walk(7, 2), list[tuple[float, float, float]]()
    filter_ = pdr.OnlineFilter(pdr.recipes.default().in_world_frame())
    samples = pdr.merge_streams(recording)
    fixes = ranges(recording, ANCHORS[:2], 7)
    for i in range(0, len(samples.time_s), 50):
        part = slice(i, i + 50)
        while fixes and fixes[0].time_s <= samples.time_s[part][-1]:
            filter_.add_fix(fixes.pop(0))
        push_part(filter_, samples, part)
        if part_of(filter_.state.chain, Hypotheses).rival is not None:
            away_m = float(np.linalg.norm(filter_.position_m - true_position_m(recording, samples.time_s[part][-1])))
            std_m = float(np.sqrt(np.linalg.eigvalsh(filter_.position_cov_m2)[-1]))
            seen.append((samples.time_s[i], away_m, std_m))
    assert len(seen) > 5
    assert seen[0][0] < 20.0 and seen[-1][0] < 40.0
    assert all(away_m < 3.5 * std_m + 1.0 for _, away_m, std_m in seen)
    assert max(std_m for *_, std_m in seen) > 4.0
    assert part_of(filter_.state.chain, Hypotheses).rival is None
    filter_.finish()
    path = filter_.path()
    off_m = np.linalg.norm(path.position_m - true_position_m(recording, path.time_s), axis=1)
    assert np.quantile(off_m, 0.9) < 1.5


def test_saving_does_not_change_a_filter_with_two_hypotheses() -> None:
    recording, samples = walk(7, 2), pdr.merge_streams(walk(7, 2))
    first = pdr.OnlineFilter(pdr.recipes.default().in_world_frame())
    n = int(np.searchsorted(samples.time_s, 16.0))
    for fix in ranges(recording, ANCHORS[:2], 7):
        if fix.time_s < 15.0:
            first.add_fix(fix)
    push_part(first, samples, slice(n))
    assert part_of(first.state.chain, Hypotheses).rival is not None
    second = resumed(first)
    updates = [push_part(f, samples, slice(n, None)) for f in (first, second)]
    np.testing.assert_array_equal(*([u.position_m for u in each] for each in updates))


def test_placements_by_ranges_are_the_mirror_images_of_a_straight_path() -> None:
    rng = np.random.default_rng(0)
    start_m = np.array([3.0, 4.0])
    track_m = np.column_stack([np.zeros(8), 1.3 * np.arange(0.0, 16.0, 2.0)])
    pairs = [
        PairedRange(
            pdr.RangeFix(2.0 * k, np.array(a), float(np.hypot(*(place + start_m - a))) + 0.1 * rng.normal(), 0.1),
            place,
            is_used=False,
        )
        for k, place in enumerate(track_m)
        for a in ((-5.0, 0.0), (12.0, 0.0))
    ]
    first, second = solutions(pairs)
    starts = [(s.world_centre_m + (track_m[0] - s.track_centre_m) @ clockwise(s.angle_rad).T) for s in (first, second)]
    found = sorted(starts, key=lambda place: -place[1])
    np.testing.assert_allclose(found, [(3.0, 4.0), (3.0, -4.0)], atol=0.4)
    assert solutions([p for p in pairs if p.fix.anchor_m[0] < 0]) == []  # ranges to one anchor leave a circle


@dataclass
class FromAnchor:
    """Range of another library, as an innovation with the derivative of the prediction, or as a residual."""

    time_s: float
    fix: pdr.RangeFix
    is_innovation: bool
    received_time_s: float | None = None

    def measurement(self, position_m: FloatArray, heading_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        residual, jacobian, cov = self.fix.measurement(position_m, heading_rad)
        return (-residual if self.is_innovation else residual), jacobian, cov


def test_a_measurement_of_a_foreign_class_is_used_online_and_smoothed_with_either_sign() -> None:
    recording = walk(5, 2)
    given = ranges(recording, ANCHORS, 5)
    tracks = [
        pdr.track(recording, fixes=[FromAnchor(f.time_s, f, sign) for f in given], weighting="wc")
        for sign in (False, True)
    ]
    np.testing.assert_array_equal(tracks[0].position_m, tracks[1].position_m)
    assert errors(tracks[0], recording)[0] < 0.5
    assert tracks[0].fixes[0].kind == "fromanchor"
    smoothed = pdr.smooth(recording, fixes=[FromAnchor(f.time_s, f, True) for f in given], weighting="wc")
    assert errors(smoothed.track, recording)[0] < errors(tracks[0], recording)[0]
    assert (smoothed.observations.weight > 0.5).mean() > 0.95


def test_a_measurement_of_the_heading_turns_a_track_like_a_heading_fix() -> None:
    recording = walk(5, 2)
    times_s = np.arange(5.0, 60.0, 5.0)
    first = pdr.HeadingFix(times_s[0], np.pi / 2, 0.05)  # it determines the north of the track
    own = pdr.track(recording, fixes=[first, pdr.HeadingFix(times_s[1], 0.1 + np.pi / 2, 0.05)])
    foreign = pdr.track(recording, fixes=[first, OfHeading(times_s[1], 0.1 + np.pi / 2, 0.05)])
    np.testing.assert_allclose(foreign.position_m[-1], own.position_m[-1], atol=1e-6)


@pytest.mark.parametrize("reflected", [0.0, 1 / 3])
def test_smoothing_with_ranges_has_small_errors_and_leaves_out_reflections(
    reflected: float,
) -> None:
    recording = walk(4)
    fixes = ranges(recording, ANCHORS, 4, reflected)
    smoothed = pdr.smooth(recording, fixes=fixes)
    rmse_m, nees = errors(smoothed.track, recording)
    assert rmse_m < 0.35
    assert nees < 3.0
    assert smoothed.track.frame == "fixes"
    left_out = smoothed.observations.weight < 0.5
    assert left_out.mean() == pytest.approx(reflected, abs=0.1)
    assert {fix.kind for fix in smoothed.track.fixes} == {"range"}


def test_anchors_at_coordinates_of_a_map_are_smoothed_as_well_as_those_near_the_origin() -> None:
    recording, away_m = walk(4, 2), np.array([4e5, 5.8e6])
    near = ranges(recording, ANCHORS, 4)
    far = [replace(fix, anchor_m=fix.anchor_m + away_m) for fix in near]
    config = pdr.recipes.default().in_world_frame()
    tracks = [pdr.smooth(recording, fixes=fixes, config=config).track for fixes in (near, far)]
    (rmse_m, _), (far_rmse_m, _) = (
        errors(replace(track, position_m=track.position_m - offset_m), recording)
        for track, offset_m in zip(tracks, (np.zeros(2), away_m), strict=True)
    )
    assert far_rmse_m == pytest.approx(rmse_m, abs=1e-4)
    assert rmse_m < 0.35


def test_the_range_to_an_anchor_above_the_phone_is_a_distance_in_space() -> None:
    fix = pdr.RangeFix(1.0, (3.0, 0.0, 4.0), 5.0, 0.1)
    residual, jacobian, _ = fix.measurement(np.zeros(2), 0.0)
    np.testing.assert_allclose(residual, 0.0, atol=1e-12)
    np.testing.assert_allclose(jacobian, [[-0.6, 0.0]])


def test_only_ranges_that_are_too_long_count_as_reflections() -> None:
    fix = pdr.RangeFix(1.0, (10.0, 0.0), 10.0, 0.3)
    longer, shorter = fix.direct_prob(-2.0, 0.5**2), fix.direct_prob(2.0, 0.5**2)
    assert longer < 0.05 and shorter > 0.9
    assert fix.direct_prob(-2.0, 2.0**2) > 0.6  # the track may have an error of this size
    assert fix.direct_prob(0.0, 20.0**2) > 0.7  # an uncertain track does not make a range that fits it a reflection


@pytest.mark.parametrize(
    ("fix", "message"),
    [
        (FromAnchor("x", pdr.RangeFix(1.0, (0, 0), 1, 1), False), "time_s of FromAnchor must be a number"),  # type: ignore[arg-type]
        (FromAnchor(2.0, pdr.RangeFix(1.0, (0, 0), 1, 1), False, 1.0), "received_time_s not before"),
    ],
)
def test_an_object_that_is_not_a_valid_fix_is_refused_with_the_reason(fix: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        pdr.OnlineFilter().add_fix(fix)  # type: ignore[arg-type]


def test_a_measurement_with_a_wrong_shape_is_refused_with_the_expected_shape() -> None:
    class Wrong(OfHeading):
        def measurement(self, position_m: FloatArray, heading_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
            return np.zeros(2), np.zeros((1, 2)), np.eye(2)

    with pytest.raises(ValueError, match=r"measurement of Wrong must return a residual \(k,\)"):
        pdr.track(walk(5), fixes=[Wrong(10.0, 0.0)])


def test_ranges_and_own_measurements_fulfil_the_measurement_protocol_and_heading_fixes_do_not() -> None:
    of_all: list[Fix] = [pdr.RangeFix(1.0, (0, 0), 1, 1), OfHeading(1.0, 0.0)]
    assert all(isinstance(fix, Measurement) for fix in of_all)
    assert not isinstance(pdr.HeadingFix(1.0, 0.0, 0.1), Measurement)


def test_stored_ranges_are_in_order_of_time_and_cover_the_whole_time_at_a_high_rate() -> None:
    pairs: tuple[PairedRange, ...] = ()
    for time_s in np.arange(0.0, 30.0, 0.1):
        for anchor_m in ANCHORS:
            pairs = recent(pairs, PairedRange(pdr.RangeFix(time_s, anchor_m, 5.0, 0.3), np.zeros(2), True))
    times_s = [pair.fix.time_s for pair in pairs]
    assert len(pairs) == MAX_RANGES
    assert max(np.diff(times_s)) < 10.0
    assert times_s[0] < 10.0
    late = PairedRange(pdr.RangeFix(12.34, ANCHORS[0], 5.0, 0.3), np.zeros(2), True)
    times_s = [pair.fix.time_s for pair in recent(pairs, late)]
    assert times_s == sorted(times_s)
    assert times_s[-1] == pytest.approx(29.9)


def test_frequent_ranges_place_a_track_in_an_unknown_frame() -> None:
    recording = walk(4)
    rng, times_s = np.random.default_rng(0), np.arange(2.0, 30.0, 0.2)
    fixes = [a_range(recording, t, anchor_m, 2.0 * rng.normal(), 2.0) for t in times_s for anchor_m in ANCHORS]
    track = pdr.track(recording, config=pdr.recipes.default().in_world_frame(), fixes=fixes)
    assert track.frame == "fixes"


def test_after_a_time_behind_walls_correct_ranges_are_used_again() -> None:
    recording = walk(4)
    rng, fixes = np.random.default_rng(0), list[pdr.RangeFix]()
    for time_s in np.arange(1.0, 100.0, 1.0):
        extra_m = rng.exponential(8.0) + 4.0 if 15.0 < time_s < 60.0 else 0.0
        fixes.append(a_range(recording, time_s, ANCHORS[0], 0.3 * rng.normal() + extra_m))
    after = [fix for fix in pdr.track(recording, fixes=fixes).fixes if fix.time_s > 61.0]
    assert sum(fix.outcome == "used" for fix in after) > 0.8 * len(after)


def test_a_range_to_an_overhead_anchor_has_less_curvature_than_one_at_the_same_level() -> None:
    overhead = pdr.RangeFix(1.0, (0.1, 0.0, 3.0), 3.0, 0.3)
    beside = pdr.RangeFix(1.0, (0.1, 0.0), 0.1, 0.3)
    model = pdr.recipes.default().model
    state = initial_state(model, model.long_run_mode_prob)
    cov = state.estimates.cov.copy()
    cov[:, [0, 1], [0, 1]] = 1.0
    state = replace(state, estimates=replace(state.estimates, cov=cov), std_at_start_m=1.0)
    assert not _is_wide(state, overhead, np.zeros(3))
    assert _is_wide(state, beside, np.zeros(3))


def searches(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of ranges of the searches for places from now on."""
    counted = list[int]()

    def counting(pairs: Sequence[PairedRange], *prior: PriorPose | None) -> list[RangeSolution]:
        counted.append(len(pairs))
        return solutions(pairs, *prior)

    monkeypatch.setattr(range_updates, "solutions", counting)
    return counted


def test_places_are_searched_twice_a_second_at_most_however_often_ranges_come(monkeypatch: pytest.MonkeyPatch) -> None:
    counted, recording = searches(monkeypatch), walk(4)
    fixes = [
        pdr.RangeFix(time_s, np.array(anchor_m), 200.0 + 0.01 * time_s, 0.3)  # too long for any place
        for time_s in np.arange(5.0, 9.0, 1 / 60)
        for anchor_m in ANCHORS[:2]
    ]
    track = pdr.track(recording, config=pdr.recipes.default().in_world_frame(), fixes=fixes)
    assert {fix.outcome for fix in track.fixes} == {"waiting"}
    assert any("ranges, to 2 anchors, fit more than one position" in note for note in track.notes)
    assert 5 <= len(counted) <= 2 * 9  # and those of one moment are all tried


def test_ranges_that_a_track_has_used_do_not_place_it_again(monkeypatch: pytest.MonkeyPatch) -> None:
    model = own_model("walking")
    tracker, drawn = ImmTracker(model), simulated_walk(model, 30, np.random.default_rng(1))
    state = tracker.init()
    for step in drawn.steps:
        state, _ = tracker.on_step(state, step)
    time_s, pedestrian = drawn.steps[-1].time_s, state.pedestrian
    cov = pedestrian.estimates.cov.copy()
    cov[:, [0, 1], [0, 1]] = 400.0
    used = tuple(
        PairedRange(pdr.RangeFix(time_s - k, np.array(ANCHORS[k % 3]), 9.0, 0.3), np.zeros(2), is_used=True)
        for k in (9, 8, 7, 6, 5)
    )
    known = replace(
        pedestrian,
        estimates=replace(pedestrian.estimates, cov=cov),
        fixes=replace(pedestrian.fixes, ranges=used),
    )
    counted, outcomes = searches(monkeypatch), list[str]()
    state = replace(state, pedestrian=known)
    for k in range(4):
        fix = pdr.RangeFix(time_s + 0.01 * k, np.array(ANCHORS[k % 3]), 9.0 + 0.01 * k, 0.3)
        state, outcome, _ = tracker.on_fix(state, fix)
        outcomes.append(outcome)
    assert outcomes[:3] == ["waiting"] * 3
    assert counted == [4]


class WithProperties:
    received_time_s = None

    @property
    def time_s(self) -> float:
        return 12.0

    def measurement(self, position_m: FloatArray, heading_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        return np.zeros(1), np.ones((1, 2)), np.eye(1)


@dataclass
class WithClassAttribute:
    time_s: float
    received_time_s = None

    def measurement(self, position_m: FloatArray, heading_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        return np.zeros(1), np.ones((1, 2)), np.eye(1)


def test_fixes_of_other_classes_follow_a_backward_clock_jump_or_are_refused() -> None:
    assert on_track_clock(WithClassAttribute(12.0), 10.0).time_s == 22.0
    with pytest.raises(ValueError, match="time_s of WithProperties cannot be set"):
        on_track_clock(WithProperties(), 10.0)
