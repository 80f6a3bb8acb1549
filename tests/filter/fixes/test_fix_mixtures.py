"""Mixtures of correct and wrong fixes of every kind: valid covariances, and recovery from wrong fixes."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers import nees_of
from scipy.stats import chi2
from sensed_walk import SensedWalk, Tracked

import pdr_filter as pdr
from pdr_filter.filter.chain.imm_tracker import ImmTracker
from pdr_filter.filter.pedestrian.repeated_fixes import repetitions
from pdr_filter.simulate import Gait, Leg, SensorErrors, simulate
from pdr_filter.tracking.filtering import MAX_FIX_AGE_S
from pdr_filter.values import HeadingFix, PositionFix, Samples

STD_M = 3.0
RIDE_S = 60.0
FAR_M = np.array([200.0, 0.0])
UNTIL_S = 140.0  # the rest of the walk shows nothing new about early fixes


def rounds(n: int) -> list[Leg]:
    return [Leg("walking", distance_m=d, turn_rad=np.pi / 2) for _ in range(n) for d in (40.0, 25.0, 40.0, 25.0)]


@pytest.fixture(scope="module")
def walk() -> SensedWalk:
    """Walk of seven and a half minutes round a block."""
    return SensedWalk(simulate(rounds(5), seed=2))


@pytest.fixture(scope="module")
def poor_walk() -> SensedWalk:
    """Walk of an unknown person with long steps and a cheap gyroscope: dead reckoning soon has errors of metres."""
    made = simulate(rounds(3), Gait(length_factor=1.2), errors=SensorErrors.bmi160(), seed=5)
    return SensedWalk(replace(made, meta={**made.meta, "subject": {}}))


@pytest.fixture(scope="module")
def poor_alone_m2(poor_walk: SensedWalk) -> float:
    """Mean squared error of dead reckoning."""
    return float(np.mean(poor_walk.errors_m(poor_walk.tracked([], poor_walk.config)) ** 2))


def fix_at(walk: SensedWalk, time_s: float, off_m: np.ndarray, **more: float) -> PositionFix:
    return PositionFix(float(time_s), walk.at(time_s) + off_m, STD_M**2 * np.eye(2), **more)


def every(walk: SensedWalk, interval_s: float, rng: np.random.Generator, jitter: float = 0.0) -> list[PositionFix]:
    """Return correct fixes with independent errors."""
    times = np.arange(3.0, walk.end_s - 1.0, interval_s)
    times = np.sort(times + interval_s * rng.uniform(-jitter, jitter, len(times)))
    return [fix_at(walk, t, rng.normal(0.0, STD_M, 2)) for t in times]


# --- any mixture ------------------------------------------------------------------------------------------------------


def mixture(walk: SensedWalk, rng: np.random.Generator, has_wrong: bool) -> list[PositionFix]:
    """Return fixes of two sources at any and at equal times, some late, with outliers, frozen intervals and gaps."""
    n = int(rng.integers(5, 100))
    times = rng.uniform(2.0, walk.end_s - 1.0, n)
    if rng.random() < 0.5:
        times = np.round(times)
    times = np.sort(np.concatenate([times, rng.choice(times, n // 5)]))
    constants_s, errors = rng.choice([0.0, 5.0, 20.0, 120.0], 2), dict[float, tuple[float, np.ndarray]]()
    found: list[PositionFix] = []
    for t in times:
        constant_s, error = float(rng.choice(constants_s)), rng.normal(0.0, STD_M, 2)
        if constant_s > 0 and constant_s in errors:  # each source is an Ornstein-Uhlenbeck process
            before_s, before = errors[constant_s]
            left = np.exp(-(t - before_s) / constant_s)
            error = left * before + np.sqrt(1.0 - left**2) * error
        errors[constant_s] = float(t), error
        received_s = float(t + rng.uniform(0.0, 50.0)) if rng.random() < 0.1 else None
        found.append(replace(fix_at(walk, t, error, correlation_s=constant_s), received_time_s=received_s))
    if not has_wrong:
        return found
    begin_s, lasts_s = rng.uniform(20.0, walk.end_s - 60.0), rng.uniform(10.0, 60.0)
    held = next((f.position_m for f in found if f.time_s > begin_s), np.zeros(2))
    for k, fix in enumerate(found):
        if begin_s < fix.time_s < begin_s + lasts_s:
            found[k] = replace(fix, position_m=held)
        elif rng.random() < 0.1:
            found[k] = replace(fix, position_m=fix.position_m + rng.normal(0.0, 60.0, 2))
    gap_s = rng.uniform(20.0, walk.end_s - 60.0)
    return [f for f in found if not gap_s < f.time_s < gap_s + 30.0]


@pytest.mark.parametrize("has_wrong", [False, True])
@pytest.mark.parametrize("frame", ["world", "start"])
def test_any_mixture_of_fixes_leaves_valid_covariances_that_hold_the_truth_and_improves_dead_reckoning(
    poor_walk: SensedWalk, poor_alone_m2: float, frame: str, has_wrong: bool
) -> None:
    config = poor_walk.world if frame == "world" else poor_walk.config
    nees: list[float] = []
    for seed in range(6):
        fixes = mixture(poor_walk, np.random.default_rng(seed), has_wrong)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            track = poor_walk.tracked(fixes, config)
        assert np.linalg.eigvalsh(track.cov_m2).min() > 0.0
        known = track.time_s > min(track.times_of("used"), default=np.inf) + 10.0
        error = (track.position_m - poor_walk.at(track.time_s))[known]
        if len(error):
            nees.append(float(nees_of(error, track.cov_m2[known]).mean()))
        if frame == "start":  # in which dead reckoning has no unknown rotation
            assert np.mean(poor_walk.errors_m(track) ** 2) < poor_alone_m2
    # the expected mean is two; the errors of one walk are correlated, and wrong fixes increase them
    assert np.median(nees) < (3.0 if has_wrong else 2.5)
    assert np.mean(nees) < (6.0 if has_wrong else 4.0)


@pytest.mark.parametrize("constants_s", [(20.0,), (20.0, 12.0), (300.0, 20.0)])
def test_correlated_fixes_at_one_time_and_from_two_sources_are_used(
    walk: SensedWalk, constants_s: tuple[float, ...]
) -> None:
    rng = np.random.default_rng(1)
    fixes = [
        fix_at(walk, t, rng.normal(0.0, 1.5, 2), correlation_s=constants_s[k % len(constants_s)])
        for t in np.arange(5.0, 200.0, 6.0)
        for k in range(2)
    ]
    fixes += [replace(fix) for fix in fixes[::3]]  # exact repetitions
    track = walk.tracked(fixes, until_s=220.0)
    assert np.linalg.eigvalsh(track.cov_m2).min() > 0.0
    assert walk.errors_m(track)[track.time_s > 60.0].max() < 6.0


def test_a_hundred_consistent_fixes_give_the_covariance_of_a_kalman_filter() -> None:
    """The factor of Student's t is that of all errors together. It does not grow with each error above the mean."""
    tracker = pdr.recipes.default().tracker
    assert isinstance(tracker, ImmTracker)
    larger = []
    for seed in range(8):
        rng, state = np.random.default_rng(seed), tracker.init()
        pedestrian = state.pedestrian
        cov = pedestrian.estimates.cov.copy()
        cov[:, :2, :2] = 16.0 * np.eye(2)
        state = replace(state, pedestrian=replace(pedestrian, estimates=replace(pedestrian.estimates, cov=cov)))
        truth = rng.normal(0.0, 4.0, 2)
        for k in range(100):
            state, outcome, _ = tracker.on_fix(state, PositionFix(k, truth + rng.normal(0.0, 3.0, 2), 9.0 * np.eye(2)))
            assert outcome == "used"
        expected = 1.0 / (1.0 / 16.0 + 100.0 / 9.0)
        larger.append(float(state.pedestrian.estimates.cov[0, 0, 0]) / expected)
    assert 0.9 < np.mean(larger) < 1.15


# --- recovery ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("interval_s", "n_wrong"),
    [(0.2, 10), (1.0, 1), (4.9, 3), (5.0, 3), (5.5, 5), (6.3, 3), (20.0, 1), (60.0, 2)],
)
def test_the_track_recovers_from_wrong_first_fixes_at_any_interval(
    walk: SensedWalk, interval_s: float, n_wrong: int
) -> None:
    fixes = every(walk, interval_s, np.random.default_rng(n_wrong), jitter=0.3 if n_wrong == 5 else 0.0)
    fixes[:n_wrong] = [replace(f, position_m=f.position_m + FAR_M) for f in fixes[:n_wrong]]
    late_s = fixes[n_wrong].time_s + 75.0 + 3.0 * interval_s
    track = walk.tracked(fixes, until_s=late_s + 40.0)
    is_late = track.time_s > late_s
    assert walk.errors_m(track)[is_late].max() < 15.0
    if n_wrong > 1:  # a single wrong fix is outvoted before it places the track
        assert len(track.times_of("moved")) == 1
        assert track.known.frame.relocations


@pytest.fixture(scope="module")
def broken_walk() -> SensedWalk:
    """Two stretches of walking with a minute between them, in which there may be a ride."""
    return SensedWalk(simulate([*rounds(1), Leg("stationary", duration_s=RIDE_S), *rounds(2)], seed=3))


@pytest.mark.parametrize(("interval_s", "far_m"), [(0.5, 30.0), (0.5, 1e5), (5.5, 1e3), (20.0, 30.0), (20.0, 1e5)])
def test_after_a_ride_of_any_length_the_track_is_relocated_to_its_fixes(
    broken_walk: SensedWalk, interval_s: float, far_m: float
) -> None:
    walk, ride_s = broken_walk, RIDE_S
    truth = walk.recording.truth.position
    stands = np.hypot(np.diff(truth.east_m), np.diff(truth.north_m)) < 0.01 * np.diff(truth.time_s)
    begin_s = float(truth.time_s[:-1][stands & (truth.time_s[:-1] > 60.0)][0])

    def ridden_m(time_s: np.ndarray | float) -> np.ndarray:
        share = np.clip((np.asarray(time_s) - begin_s) / ride_s, 0.0, 1.0)
        return share[..., None] * np.array([far_m, 0.3 * far_m])

    fixes = every(walk, interval_s, np.random.default_rng(4), jitter=0.3)
    track = walk.tracked([replace(f, position_m=f.position_m + ridden_m(f.time_s)) for f in fixes])
    error_m = np.linalg.norm(track.position_m - walk.at(track.time_s) - ridden_m(track.time_s), axis=1)
    assert error_m[track.time_s > begin_s + ride_s + 120.0].max() < 12.0


def test_outliers_in_between_do_not_remove_the_rejected_fixes(walk: SensedWalk) -> None:
    rng = np.random.default_rng(7)
    fixes = every(walk, 1.0, rng)
    for k, fix in enumerate(fixes):
        if k < 4:
            fixes[k] = replace(fix, position_m=fix.position_m + FAR_M)
        elif rng.random() < 0.2:
            fixes[k] = replace(fix, position_m=fix.position_m + rng.normal(0.0, 300.0, 2))
    track = walk.tracked(fixes, until_s=UNTIL_S + 60.0)
    (moved_s,) = track.times_of("moved")
    assert moved_s < 130.0
    assert np.median(walk.errors_m(track)[track.time_s > moved_s + 20.0]) < 3.0


def test_two_contradicting_sources_do_not_relocate_the_track_repeatedly(walk: SensedWalk) -> None:
    fixes = every(walk, 2.0, np.random.default_rng(8))
    fixes = [replace(f, position_m=f.position_m + FAR_M) if k % 2 else f for k, f in enumerate(fixes)]
    track = walk.tracked(fixes, walk.config)
    assert not track.times_of("moved")
    assert walk.errors_m(track).max() < 10.0


# --- headings ---------------------------------------------------------------------------------------------------------


def with_heading(walk: SensedWalk, time_s: float, off_deg: float, interval_s: float, seed: int) -> Tracked:
    east_m, north_m = walk.at(time_s + 1.0) - walk.at(time_s - 1.0)
    heading = HeadingFix(time_s, float(np.arctan2(east_m, north_m) + np.radians(off_deg)), 0.1)
    return walk.tracked([*every(walk, interval_s, np.random.default_rng(seed)), heading], until_s=UNTIL_S)


@pytest.fixture(scope="module")
def late_error_m(walk: SensedWalk) -> Callable[[int], float]:
    """Largest error after a minute of the track with correct fixes alone, by seed."""

    @cache
    def of_seed(seed: int) -> float:
        track = walk.tracked(every(walk, 1.0, np.random.default_rng(seed)), until_s=UNTIL_S)
        return float(walk.errors_m(track)[track.time_s > 60.0].max())

    return of_seed


@pytest.mark.parametrize(("time_s", "seed", "off_deg"), [(4.0, 2, 45.0), (4.0, 3, 90.0), (7.0, 1, 180.0)])
def test_one_wrong_early_heading_fix_is_discarded(
    walk: SensedWalk, late_error_m: Callable[[int], float], time_s: float, seed: int, off_deg: float
) -> None:
    track = with_heading(walk, time_s, off_deg, 1.0, seed)
    assert track.outcomes.count("rejected") < 10
    assert track.known.frame.is_north_wrong
    assert walk.errors_m(track)[track.time_s > 60.0].max() < late_error_m(seed) + 1.0 < 6.0


@pytest.mark.parametrize("interval_s", [1.0, 5.0])
def test_a_correct_early_heading_fix_rotates_the_track_from_the_first_position_fix_on(
    walk: SensedWalk, interval_s: float
) -> None:
    track = with_heading(walk, 4.0, 0.0, interval_s, 1)
    assert not track.known.frame.is_north_wrong
    assert walk.errors_m(track)[track.time_s > 10.0].max() < 8.0


def test_the_note_about_a_discarded_heading_says_what_to_check() -> None:
    recording = simulate(rounds(1), seed=2)
    walk = SensedWalk(recording)
    east_m, north_m = walk.at(8.0) - walk.at(6.0)
    wrong = HeadingFix(7.0, float(np.arctan2(-east_m, -north_m)), 0.1)
    track = pdr.track(recording, walk.world, fixes=iter([*every(walk, 2.0, np.random.default_rng(0)), wrong]))
    assert any("contradict an earlier heading fix" in note for note in track.notes)
    assert any("the track was moved by" in note for note in track.notes) is False


# --- frozen positions -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("interval_s", "frame"), [(1.0, "world"), (5.0, "start"), (30.0, "world")])
def test_repeated_positions_do_not_hold_back_a_walking_pedestrian(
    walk: SensedWalk, frame: str, interval_s: float
) -> None:
    config, half_s = walk.world if frame == "world" else walk.config, 0.5 * walk.end_s
    fixes = every(walk, interval_s, np.random.default_rng(0))
    last = [f for f in fixes if f.time_s < half_s][-1]
    right = [f for f in fixes if f.time_s < half_s]
    held = [replace(f, position_m=last.position_m) for f in fixes if f.time_s >= half_s]
    alone, track = walk.tracked(right, config), walk.tracked([*right, *held], config)
    late = track.time_s > half_s
    # a fix within its standard deviation of the last one may still be used
    assert np.abs(walk.errors_m(track)[late] - walk.errors_m(alone)[late]).max() < 1.5
    assert track.outcomes.count("frozen") >= 0.8 * len(held)
    assert track.known.fixes.n_frozen == track.outcomes.count("frozen")
    assert not track.times_of("moved")


def test_a_closed_walk_may_end_at_exactly_its_first_position() -> None:
    recording = simulate(rounds(1), seed=2)
    once = SensedWalk(recording)
    same = [PositionFix(t, np.zeros(2), 0.25 * np.eye(2)) for t in (1.0, once.end_s - 1.0)]
    assert once.tracked(same, once.config).outcomes == ("used", "used")
    # a standing pedestrian who receives the same position again learns nothing new
    assert repetitions(same, np.array([0.0, 90.0]), np.zeros((2, 2)), np.zeros(2)) == ["", "repeated"]


def test_frozen_locations_are_detected_online_in_alignment_and_in_smoothing() -> None:
    recording = simulate(rounds(2), seed=4)
    whole, rng = SensedWalk(recording), np.random.default_rng(3)
    times = np.arange(0.0, whole.end_s, 10.0)
    places = whole.at(times) + rng.normal(0.0, STD_M, (len(times), 2))
    is_held = times > 0.6 * whole.end_s
    places[is_held] = places[~is_held][-1]
    latitude, longitude = pdr.Origin(48.0, 11.0).latitude_longitude_deg(places)
    rows = np.column_stack([latitude, longitude, np.full(len(times), np.nan), np.full(len(times), 5.0)])
    located = replace(recording, location=Samples(times, rows))
    for gnss in ("filter", "align"):
        track = pdr.track(located, gnss=gnss)
        outcomes = [fix.outcome for fix in track.fixes]
        assert outcomes.count("frozen") == is_held.sum()
        assert any("repeat the last position" in note for note in track.notes)
    fixes = [PositionFix(float(t), p, STD_M**2 * np.eye(2)) for t, p in zip(times, places, strict=True)]
    smoothed = pdr.smooth(recording, fixes=fixes)
    assert (smoothed.observations.weight[is_held] == 0.0).all()
    assert any("repeats the last position" in note for note in smoothed.notes)
    assert np.linalg.norm(smoothed.track.position_m - whole.at(smoothed.track.time_s), axis=1).max() < 8.0


# --- late fixes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("late_s", [5.0, 36.0, 59.0])
def test_a_fix_within_the_age_limit_is_used_whatever_its_delay(walk: SensedWalk, late_s: float) -> None:
    assert late_s < MAX_FIX_AGE_S
    rng = np.random.default_rng(2)
    fixes = [replace(f, received_time_s=f.time_s + late_s) for f in every(walk, 10.0, rng)[:20]]
    track = walk.tracked(fixes, walk.config, until_s=270.0)
    assert track.outcomes.count("used") >= 19
    nees = nees_of(track.position_m - walk.at(track.time_s), track.cov_m2)
    assert np.mean(nees < chi2.isf(0.05, 2)) > 0.85
