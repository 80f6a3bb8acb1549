"""Fixes of every kind: positions in an unknown frame, headings, speeds, standstills."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import clockwise, nees_of, push_part, streamed, true_position_m
from scipy.special import logsumexp, softmax
from scipy.stats import chi2, invgamma, multivariate_normal

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.filter.chain.imm_tracker import ImmState, ImmTracker
from pdr_filter.filter.pedestrian.alignment import Alignment, Pose
from pdr_filter.filter.pedestrian.frame import UNKNOWN_FRAME
from pdr_filter.filter.pedestrian.frame_rotation import PairedPoint, align, least_squares_error, rotation_density
from pdr_filter.filter.pedestrian.pedestrian_state import reckoned_position
from pdr_filter.simulate import Leg, simulate
from pdr_filter.tracking import filtering
from pdr_filter.tracking.filtering import add_fixes, init_filter
from pdr_filter.values import Fix, HeadingFix, PositionFix, SpeedFix, Standstill, wrap_angle
from pdr_filter.values.recording import Recording
from pdr_filter.values.serialisation import to_bytes

pytestmark = pytest.mark.usefixtures("sensing_once")


@pytest.fixture(scope="module")
def walk() -> Recording:
    return simulate([Leg("walking", distance_m=60.0), Leg("walking", distance_m=60.0, turn_rad=np.pi / 2)], seed=3)


def fixes_in(walk: Recording, angle_rad: float, shift_m: np.ndarray, every_s: float = 8.0, until_s: float = 1e9):
    """Return fixes in another frame without noise, with a standard deviation of 1 m."""
    times = np.arange(4.0, min(walk.duration_s, until_s), every_s)
    places = true_position_m(walk, times) @ clockwise(angle_rad).T + shift_m
    return [PositionFix(float(t), p, np.eye(2)) for t, p in zip(times, places, strict=True)]


# --- the frame of the world -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle_rad", [0.0, 0.8, 2.9, -2.0])
def test_three_point_pairs_determine_rotation_and_shift(angle_rad: float) -> None:
    track = np.array([[0.0, 0.0], [0.0, 30.0], [25.0, 40.0]])
    world = track @ clockwise(angle_rad).T + [100.0, -40.0]
    found = align([PairedPoint(t, w, 1.0) for t, w in zip(track, world, strict=True)], 7)
    assert found is not None
    assert float(wrap_angle(found.angle_rad - angle_rad)) == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(found.positions(track), world, atol=1e-9)
    assert found.n_steps == 7


def test_fixes_close_together_do_not_determine_the_rotation() -> None:
    near = [PairedPoint(np.array([0.0, y]), np.array([5.0, y]), 25.0) for y in (0.0, 2.0, 4.0)]
    assert align(near, 0) is None
    assert align(near[:1], 0) is None
    assert align([*near, PairedPoint(np.array([0.0, 60.0]), np.array([5.0, 60.0]), 25.0)], 0) is not None


def test_the_first_fix_is_kept_while_the_rotation_is_unknown() -> None:
    frame = UNKNOWN_FRAME
    for k in range(100):
        frame = frame.with_pair(PairedPoint(np.array([0.0, k]), np.array([k, 0.0]), 1.0))
    assert frame.pairs[0].track_m[1] == 0.0
    assert frame.pairs[-1].track_m[1] == 99.0
    assert len(frame.pairs) <= 24


@pytest.mark.parametrize(("weighting", "angle_rad"), [("imm", 0.0), ("imm", 2.5), ("wc", -1.3)])
def test_fixes_determine_the_position_and_the_north_of_a_track(
    walk: Recording, weighting: str, angle_rad: float
) -> None:
    shift = np.array([400.0, -250.0])
    config = recipes.for_recording("default", walk).in_world_frame()
    track = pdr.track(walk, config, weighting=weighting, fixes=fixes_in(walk, angle_rad, shift))
    error = np.linalg.norm(
        track.position_m - (true_position_m(walk, track.time_s) @ clockwise(angle_rad).T + shift), axis=1
    )
    assert np.median(error) < 2.0
    assert error.max() < 6.0  # also for the steps before the first fix
    outcomes = [f.outcome for f in track.fixes]
    n_turned = outcomes.count("turned")
    assert 1 <= n_turned <= 3
    assert outcomes == ["placed", *["turned"] * n_turned, *["used"] * (len(outcomes) - 1 - n_turned)]
    assert track.frame == "fixes"
    first = wrap_angle(track.walking_heading_rad[5:20] - angle_rad)
    assert np.abs(first).max() < 0.4


def test_the_density_of_the_rotation_is_that_of_normal_errors_of_unknown_variance() -> None:
    rng = np.random.default_rng(3)
    track, fix_var, walked_var = rng.normal(scale=6.0, size=(4, 2)), [1.0, 4.0, 2.0, 1.0], [3.0, 3.5, 5.0, 9.0]
    world = track @ clockwise(1.1).T + [30.0, 8.0] + rng.normal(scale=3.5, size=(4, 2))
    pairs = [PairedPoint(t, w, v, s) for t, w, v, s in zip(track, world, fix_var, walked_var, strict=True)]
    assert least_squares_error(pairs) > 2 * 4 - 3  # the errors are larger than stated
    walked = np.array(walked_var) - walked_var[0]
    cov = np.diag(fix_var) + np.minimum(walked[:, None], walked)
    angles = np.linspace(-np.pi, np.pi, 120, endpoint=False)

    def log_density(factor: float) -> np.ndarray:
        # a wide normal distribution of the unknown shift
        errors = np.array([(world - track @ clockwise(a).T).T for a in angles])
        return multivariate_normal.logpdf(errors, cov=factor * cov + 1e6).sum(axis=1)

    np.testing.assert_allclose(rotation_density(pairs).normal_prob, softmax(log_density(1.0)), atol=1e-4)
    # a scaled inverse chi-square distribution with four degrees of freedom: 4 / factor is chi-square
    factors = np.geomspace(0.02, 200.0, 150)
    weights = invgamma.logpdf(factors, 2.0, scale=2.0) + np.log(factors)
    each = np.array([w + log_density(factor) for w, factor in zip(weights, factors, strict=True)])
    np.testing.assert_allclose(rotation_density(pairs).prob, softmax(logsumexp(each, axis=0)), atol=2e-4)


def test_errors_smaller_than_stated_do_not_make_the_rotation_more_certain() -> None:
    track = np.array([[0.0, 0.0], [0.0, 20.0], [15.0, 20.0], [15.0, 60.0]])
    exact = [PairedPoint(t, clockwise(0.8) @ t, 9.0) for t in track]
    off = [replace(exact[0], world_m=np.array([0.0, 3.0])), *exact[1:]]
    further = [replace(exact[0], world_m=np.array([0.0, 15.0])), *exact[1:]]
    of_exact, of_off, of_further = (align(pairs, 0) for pairs in (exact, off, further))
    assert of_exact is not None and of_off is not None and of_further is not None
    away_m = track - track.mean(axis=0)
    assert of_exact.angle_rad == pytest.approx(0.8, abs=1e-9)
    assert of_exact.angle_var_rad2 == pytest.approx(9.0 / (away_m**2).sum())
    assert of_off.angle_var_rad2 == pytest.approx(of_exact.angle_var_rad2, rel=0.1)
    # there are five degrees of freedom
    scatter = (4.0 + least_squares_error(further)) / (4.0 + 5.0)
    assert scatter > 1.5
    assert of_further.centre_var_m2 == pytest.approx(scatter * of_exact.centre_var_m2, rel=0.02)


def test_after_one_fix_the_position_is_distributed_on_a_circle_around_it(walk: Recording) -> None:
    fix = PositionFix(6.0, np.array([70.0, 20.0]), np.eye(2))
    track = pdr.track(walk, recipes.for_recording("default", walk).in_world_frame(), fixes=[fix])
    alone = pdr.track(walk, recipes.for_recording("default", walk))
    assert [f.outcome for f in track.fixes] == ["placed"]
    assert track.frame == "fixes" and alone.frame == "start"
    np.testing.assert_allclose(track.position_m, np.tile(fix.position_m, (track.n_steps, 1)), atol=1e-6)
    at_fix = np.array([np.interp(6.0, alone.time_s, alone.position_m[:, k]) for k in (0, 1)])
    squared_m2 = ((alone.position_m - at_fix) ** 2).sum(axis=1) + np.trace(alone.position_cov_m2, axis1=1, axis2=2)
    np.testing.assert_allclose(np.trace(track.position_cov_m2, axis1=1, axis2=2), squared_m2 + 2.0, rtol=1e-6)


def test_after_two_fixes_two_metres_apart_the_track_is_inside_its_ellipse(walk: Recording) -> None:
    rng = np.random.default_rng(5)
    times = np.array([5.0, 6.6])
    inside = []
    for angle_rad in np.linspace(-3.0, 3.0, 6):
        places = (
            true_position_m(walk, times) @ clockwise(angle_rad).T + [140.0, 93.0] + rng.normal(scale=0.5, size=(2, 2))
        )
        fixes = [PositionFix(float(t), p, 0.25 * np.eye(2)) for t, p in zip(times, places, strict=True)]
        track = pdr.track(walk, recipes.for_recording("default", walk).in_world_frame(), fixes=fixes)
        error = track.position_m - (true_position_m(walk, track.time_s) @ clockwise(angle_rad).T + [140.0, 93.0])
        nees = nees_of(error, track.position_cov_m2)
        assert nees.max() < chi2.isf(1e-3, 2)
        inside.append(np.mean(nees < chi2.ppf(0.95, 2)))
        assert all(f.accepted for f in track.fixes)
    assert np.mean(inside) > 0.85


def test_a_heading_fix_alone_rotates_the_whole_track_including_earlier_steps(walk: Recording) -> None:
    config = recipes.for_recording("default", walk).in_world_frame()
    fix = HeadingFix(20.0, 0.9, 0.01)
    track, alone = (pdr.track(walk, config, fixes=fixes) for fixes in ([fix], []))
    turn_rad = wrap_angle(track.walking_heading_rad - alone.walking_heading_rad)
    np.testing.assert_allclose(turn_rad, turn_rad[0], atol=0.02)
    assert float(np.interp(20.0, track.time_s, np.unwrap(track.walking_heading_rad))) == pytest.approx(0.9, abs=0.1)
    np.testing.assert_allclose(track.position_m, alone.position_m @ clockwise(turn_rad[0]).T, atol=1.0)


def test_first_fixes_work_with_a_heading_that_is_known_exactly(walk: Recording) -> None:
    config = recipes.for_recording("default", walk).in_world_frame()
    config = config.with_model(noise=replace(config.model.noise, initial_heading_offset_std_rad=0.0))
    track = pdr.track(walk, config, fixes=[PositionFix(0.0, np.array([3.0, 4.0]), np.eye(2))])
    assert [f.outcome for f in track.fixes] == ["placed"]
    assert np.isfinite(track.position_m).all() and np.isfinite(track.position_cov_m2).all()


def test_block_sizes_and_saving_change_no_bit_of_a_track_with_all_kinds_of_fixes(walk: Recording) -> None:
    fixes: list[Fix] = [
        *fixes_in(walk, 1.0, np.array([9.0, 9.0])),
        HeadingFix(30.0, 1.0, 0.2, received_time_s=31.5),
        SpeedFix(35.0, 1.3, 0.1),
        Standstill(50.0, 51.0),
    ]
    config = recipes.default().in_world_frame()
    whole = pdr.track(walk, config, fixes=fixes)
    online, updates = streamed(walk, config, fixes, seed=5, n_resumed=10)
    frame = online.state.pedestrian.frame
    assert frame.alignment is not None
    # offline tracking also transforms the steps before the rotation was known
    told = [u.position_m if u.of_start is None else frame.world(u.of_start).position_m for u in updates]
    np.testing.assert_array_equal(told, whole.position_m)
    assert sum(u.of_start is not None for u in updates) == frame.alignment.n_steps
    assert [f.kind for f in whole.fixes].count("position") == len(fixes) - 3


# --- fixes with correlated errors -------------------------------------------------------------------------------------


def standing_pedestrian(std_m: float, n_fix_errors: int = 10**12) -> tuple[ImmTracker, ImmState]:
    """Return a standing pedestrian in a known frame, with a position uncertainty and a number of earlier errors."""
    tracker = recipes.default().tracker
    assert isinstance(tracker, ImmTracker)
    state = tracker.init()
    pedestrian = state.pedestrian
    cov = pedestrian.estimates.cov.copy()
    cov[:, :2, :2] = std_m**2 * np.eye(2)
    fixes = replace(pedestrian.fixes, n_errors=n_fix_errors, squares=float(n_fix_errors))
    estimates = replace(pedestrian.estimates, cov=cov)
    pedestrian = replace(pedestrian, estimates=estimates, fixes=fixes, std_at_start_m=std_m)
    return tracker, replace(state, pedestrian=pedestrian)


@pytest.mark.parametrize(("n_before", "east_m"), [(0, 9.0), (6, 9.0), (0, 2.0)])
def test_an_unexpected_fix_increases_the_covariance_more_after_few_fixes(n_before: int, east_m: float) -> None:
    tracker, state = standing_pedestrian(3.0, n_before)
    state, outcome, nis = tracker.on_fix(state, PositionFix(0.0, np.array([east_m, 0.0]), 7.0 * np.eye(2)))
    assert outcome == "used"
    assert nis == pytest.approx(east_m**2 / 16.0)
    position_m, cov_m2 = reckoned_position(state.pedestrian)
    larger = max((4 + n_before + nis) / (4 + n_before + 2), 1.0)
    np.testing.assert_allclose(position_m, [east_m * 9.0 / 16.0, 0.0])
    np.testing.assert_allclose(cov_m2, larger * 63.0 / 16.0 * np.eye(2), atol=1e-12)
    assert state.pedestrian.fixes.n_errors == n_before + 2


@pytest.mark.parametrize("std_m", [(5.0, 5.0, 5.0, 5.0), (4.0, 9.0, 3.0, 5.0)])
def test_fixes_with_correlated_errors_agree_with_generalised_least_squares(
    std_m: tuple[float, ...],
) -> None:
    tracker, state = standing_pedestrian(8.0)
    times, places = np.array([0.0, 10.0, 18.0, 40.0]), np.random.default_rng(2).normal(scale=2.0, size=(4, 2))
    stds = np.array(std_m)
    for t, place, std in zip(times, places, stds, strict=True):
        fix = PositionFix(float(t), place, std**2 * np.eye(2), correlation_s=20.0)
        state, outcome, _ = tracker.on_fix(state, fix)
        assert outcome == "used"
    # the covariance of two errors is at most the variance of the better fix
    cov = 0.99 * np.minimum(stds[:, None], stds) ** 2 * np.exp(-np.abs(times[:, None] - times) / 20.0)
    np.fill_diagonal(cov, stds**2)
    precision = np.ones(4) @ np.linalg.inv(cov) @ np.ones(4) + 1 / 64.0
    expected = np.ones(4) @ np.linalg.inv(cov) @ places / precision
    position_m, cov_m2 = reckoned_position(state.pedestrian)
    np.testing.assert_allclose(position_m, expected, atol=1e-9)
    np.testing.assert_allclose(cov_m2, np.eye(2) / precision, atol=1e-9)


def test_correlated_fixes_with_crossed_ellipses_never_increase_the_covariance() -> None:
    """Ellipses alternate between two directions, as along two corridors: a^2 R_1 must stay below R_2 in both."""
    tracker, state = standing_pedestrian(8.0)
    covs = (np.diag([400.0, 9.0]), np.diag([9.0, 400.0]))
    for k in range(8):
        fix = PositionFix(4.0 * k, np.array([1e-3 * k, 0.0]), covs[k % 2], correlation_s=30.0)
        before = reckoned_position(state.pedestrian)[1]
        state, outcome, nis = tracker.on_fix(state, fix)
        assert outcome == "used"
        assert nis >= 0
        gained = before - reckoned_position(state.pedestrian)[1]
        assert np.linalg.eigvalsh(gained).min() > -1e-9


def test_across_a_gap_a_correlated_fix_counts_as_a_position_and_not_as_a_displacement() -> None:
    """After 40 m in a gap, the next fix corrects the position and not the heading."""
    tracker, state = standing_pedestrian(2.0)
    first = PositionFix(0.0, np.zeros(2), 16.0 * np.eye(2), correlation_s=20.0)
    state, _, _ = tracker.on_fix(state, first)
    state, _ = tracker.on_gap(state, 20.0)
    heading = state.pedestrian.estimates.mean[:, 2].copy()
    state, outcome, _ = tracker.on_fix(state, replace(first, time_s=20.0, position_m=np.array([40.0, 0.0])))
    assert outcome == "used"
    position_m, cov_m2 = reckoned_position(state.pedestrian)
    left = 0.99 * np.exp(-1.0)
    own_var, before_var = 16.0 * (1 + left) / (1 - left), 20.0**2 + 1 / (1 / 4.0 + 1 / 16.0)
    np.testing.assert_allclose(position_m, [40.0 * before_var / (before_var + own_var), 0.0], atol=1e-9)
    np.testing.assert_allclose(cov_m2, np.eye(2) / (1 / before_var + 1 / own_var), atol=1e-9)
    np.testing.assert_array_equal(state.pedestrian.estimates.mean[:, 2], heading)


def test_displacements_between_correlated_fixes_estimate_the_step_scale_as_two_more_states_would() -> None:
    """On a straight walk with a known heading only the scale is estimated, from the displacements alone."""
    tracker, state = standing_pedestrian(3.0)
    scale_var = 0.1**2

    def placed(mean: np.ndarray, cov: np.ndarray, trail: np.ndarray) -> ImmState:
        """Return the state with other estimates and stored steps."""
        pedestrian = state.pedestrian
        estimates = replace(pedestrian.estimates, mean=mean, cov=cov)
        steps = replace(pedestrian.steps, trail=trail)
        return replace(state, pedestrian=replace(pedestrian, estimates=estimates, steps=steps))

    estimates = state.pedestrian.estimates
    mean, cov = estimates.mean.copy(), np.zeros_like(estimates.cov)
    cov[:, :2, :2], cov[:, 3, 3] = 9.0 * np.eye(2), scale_var
    state = placed(mean, cov, np.array([[0.0, 0.0, 0.0, 0.0]]))
    # reference filter: position, log scale and error of the fix along north
    oracle, oracle_cov, left = np.zeros(3), np.diag([9.0, scale_var, 16.0]), np.exp(-0.5)
    for k in range(4):
        if k:
            estimates, transition = state.pedestrian.estimates, np.eye(4)
            mean = estimates.mean.copy()
            mean[:, 1] += 12.0 * (1.0 + mean[:, 3])
            transition[1, 3] = 12.0
            trail = np.vstack([state.pedestrian.steps.trail, [10.0 * k, *mean[0, :2], 0.0]])
            state = placed(mean, transition @ estimates.cov @ transition.T, trail)
            ahead = np.array([[1.0, 12.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, left]])
            oracle = ahead @ oracle + [12.0, 0.0, 0.0]
            oracle_cov = ahead @ oracle_cov @ ahead.T + np.diag([0.0, 0.0, 16.0 * (1 - left**2)])
        z = 13.5 * k + [1.0, -2.0, 0.5, 1.5][k]
        fix = PositionFix(10.0 * k, np.array([0.0, z]), 16.0 * np.eye(2), correlation_s=20.0)
        state, outcome, _ = tracker.on_fix(state, fix)
        assert outcome == "used"
        h = np.array([1.0, 0.0, 1.0])
        gain = oracle_cov @ h / (h @ oracle_cov @ h)
        oracle, oracle_cov = oracle + gain * (z - h @ oracle), oracle_cov - np.outer(gain, h @ oracle_cov)
    # The filter does not correct the displacement since the earlier fix, so it agrees with the reference to first order
    # only.
    mean, cov = state.pedestrian.estimates.mean[0], state.pedestrian.estimates.cov[0]
    np.testing.assert_allclose(mean[[1, 3]], oracle[:2], rtol=0.03)
    np.testing.assert_allclose(np.diag(cov)[[1, 3]], np.diag(oracle_cov)[:2], rtol=0.03)


# --- headings, speeds, standstills ------------------------------------------------------------------------------------


def test_headings_keep_a_drifting_gyroscope_straight() -> None:
    walk = simulate([Leg("walking", distance_m=150.0)], seed=8)
    assert walk.gyroscope is not None
    # a drift that neither still windows nor corners reveal
    drifting = replace(
        walk,
        gyroscope=pdr.Samples(walk.gyroscope.time_s, walk.gyroscope.values + np.array([0.0, 0.0, 0.02])),
        magnetometer=None,
    )
    alone = pdr.track(drifting)
    fixes = [HeadingFix(t, 0.0, 0.05) for t in np.arange(5.0, walk.duration_s, 5.0)]
    helped = pdr.track(drifting, fixes=fixes)
    sideways = [float(np.abs(t.position_m[:, 0]).max()) for t in (alone, helped)]
    assert sideways[1] < 0.3 * sideways[0]
    assert {f.kind for f in helped.fixes} == {"heading"}


def test_speed_fixes_estimate_the_step_scale() -> None:
    walk = simulate([Leg("walking", distance_m=150.0)], seed=9)
    config = recipes.default()  # the default recipe without a body height
    true_mps = 150.0 / (walk.truth.steps.time_s[-1] - walk.truth.steps.time_s[0])
    fixes = [SpeedFix(t, 1.15 * true_mps, 0.05) for t in np.arange(10.0, 60.0, 5.0)]
    alone, taught = pdr.track(walk, config), pdr.track(walk, config, fixes=fixes)
    late = alone.time_s > 70.0
    ratio = taught.step_length_m[late].mean() / (1.15 * true_mps * alone.steps.duration_s[late].mean())
    assert ratio == pytest.approx(1.0, abs=0.03)
    assert all(f.accepted for f in taught.fixes)


def test_steps_in_a_known_standstill_do_not_move_the_position(walk: Recording) -> None:
    for weighting in ("imm", "wc", "hc"):
        config = recipes.for_recording("default", walk).with_weighting(weighting)
        alone = pdr.track(walk, config)
        standing = pdr.track(walk, config, fixes=[Standstill(20.0, 30.0)])
        inside = (alone.time_s > 20.5) & (alone.time_s < 29.5)
        before = alone.time_s < 20.0
        np.testing.assert_array_equal(standing.step_length_m[before], alone.step_length_m[before])
        assert standing.step_length_m[inside].sum() < 0.1 * alone.step_length_m[inside].sum()
        assert standing.n_steps == alone.n_steps


# --- impossible fixes -------------------------------------------------------------------------------------------------


def test_a_fix_ten_minutes_late_or_from_before_the_start_leaves_finite_numbers(walk: Recording) -> None:
    fixes: list[Fix] = [
        PositionFix(-5.0, np.zeros(2), np.eye(2)),
        PositionFix(10.0, np.array([0.0, 10.0]), np.eye(2), received_time_s=85.0),
        HeadingFix(10.0, 0.0, 0.1, received_time_s=85.0),
        PositionFix(1e6, np.zeros(2), np.eye(2)),
    ]
    track = pdr.track(walk, fixes=fixes)
    assert np.isfinite(track.position_m).all()
    assert len(track.fixes) == len(fixes)
    assert [f.outcome for f in track.fixes] == ["rejected", "rejected", "rejected", "waiting"]
    np.testing.assert_array_equal(track.position_m, pdr.track(walk).position_m)
    assert any("fixes from after the last sample were not used: 1" in note for note in track.notes)


def test_a_fix_from_another_time_is_refused_and_leaves_the_filter_unchanged(walk: Recording) -> None:
    samples = pdr.merge_streams(walk)
    now = int(np.searchsorted(samples.time_s, 80.0))
    online, other = pdr.OnlineFilter(), pdr.OnlineFilter()
    for one in (online, other):
        push_part(one, samples, slice(now))
    before = to_bytes(online.state)
    for time_s, received_s, message in (
        (-50.0, None, r"the fix at -50\.0 s is from before the first sample \(0\.0 s\)"),
        (1.0, None, r"the fix at 1\.0 s comes 79 s late"),
        (75.0, 680.0, r"the fix at 75\.0 s comes 605 s late"),
        (1e6, None, r"is 999920 s ahead of the last sample \(80\.0 s\)"),
    ):
        place = PositionFix(time_s, np.zeros(2), np.eye(2), received_time_s=received_s)
        for fix in (place, HeadingFix(time_s, 0.0, 0.1, received_time_s=received_s)):
            with pytest.raises(ValueError, match=message):
                online.add_fix(fix)
        assert to_bytes(online.state) == before
    push_part(online, samples, slice(now, None)), push_part(other, samples, slice(now, None))
    np.testing.assert_array_equal(online.position_m, other.position_m)


def test_a_fix_soon_after_a_gap_of_minutes_is_accepted_while_its_samples_await_confirmation(walk: Recording) -> None:
    samples = pdr.merge_streams(walk)
    online = pdr.OnlineFilter()
    for part, later_s in ((slice(0, 8000), 0.0), (slice(8000, 8020), 300.0)):
        online.push(samples.time_s[part] + later_s, samples.specific_force_mps2[part], samples.angular_rate_radps[part])
    online.add_fix(PositionFix(380.1, np.zeros(2), np.eye(2)))
    online.add_fix(PositionFix(79.9, np.zeros(2), np.eye(2)))
    with pytest.raises(ValueError, match="the fix at 250"):
        online.add_fix(PositionFix(250.0, np.zeros(2), np.eye(2)))


def test_a_fix_within_a_minute_of_the_last_sample_is_accepted(walk: Recording) -> None:
    samples = pdr.merge_streams(walk)
    now = int(np.searchsorted(samples.time_s, 80.0))
    online = pdr.OnlineFilter()
    push_part(online, samples, slice(now))
    for time_s in (21.0, 80.0, 139.0):
        online.add_fix(PositionFix(time_s, np.zeros(2), np.eye(2)))
    online.add_fix(Standstill(2.0, 79.0))  # received at its end
    assert len(online.state.waiting_fixes) == 4
    online.finish()
    with pytest.raises(ValueError, match="the filter is finished"):
        online.add_fix(PositionFix(80.0, np.zeros(2), np.eye(2)))


def test_adding_a_fix_takes_few_operations_however_many_wait_and_all_wait_in_order_of_their_due_time(
    walk: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A search of each fix among 1,000 takes 10 comparisons, and only a few due fixes are processed at once."""
    compared, processed = list[Fix](), list[Fix]()
    due_s, use_fix = filtering.due_s, filtering._use_fix
    monkeypatch.setattr(filtering, "due_s", lambda config, fix: compared.append(fix) or due_s(config, fix))
    monkeypatch.setattr(filtering, "_use_fix", lambda *given: processed.append(given[2]) or use_fix(*given))
    online, samples = pdr.OnlineFilter(), pdr.merge_streams(walk)
    push_part(online, samples, slice(300))
    times = np.random.default_rng(0).permutation(1_000) / 1_000  # all are due already, in the first three seconds
    fixes = [HeadingFix(float(t), 0.0, 1.0, received_time_s=float(t) + 0.5) for t in times]
    for fix in fixes:
        online.add_fix(fix)
    assert len(compared) < 25 * len(fixes) and 0 < len(processed) < 30
    waiting = online.state.waiting_fixes
    assert [fix.time_s for fix in waiting] == sorted(times.tolist())
    assert add_fixes(online.config, init_filter(online.config), fixes).waiting_fixes == waiting


def test_an_accepted_fix_corrects_the_stored_position_at_the_time_of_a_later_older_fix(walk: Recording) -> None:
    """Of two equal late fixes the second has a small innovation: the first has corrected the stored position."""
    alone = pdr.track(walk)
    k = int(np.searchsorted(alone.time_s, 30.0))
    place = alone.position_m[k] + np.array([1.5, 0.0])
    cov = 0.01 * np.eye(2)
    first = PositionFix(float(alone.time_s[k]), place, cov, received_time_s=38.0)
    again = PositionFix(float(alone.time_s[k]), place + 1e-6, cov, received_time_s=38.5)
    one, two = pdr.track(walk, fixes=[first, again]).fixes
    assert one.accepted and two.accepted
    assert two.nis < 0.2 * one.nis


def test_the_displacement_since_a_late_fix_makes_the_fix_less_certain(walk: Recording) -> None:
    """The standard deviation after the fix includes the error of the step scale since its time."""
    alone = pdr.track(walk)
    k = int(np.searchsorted(alone.time_s, 20.0))
    fix_s = float(alone.time_s[k])
    fix = PositionFix(fix_s, alone.position_m[k], 1e-4 * np.eye(2), received_time_s=fix_s + 15.0)
    track = pdr.track(walk, fixes=[fix])
    after = int(np.searchsorted(track.steps.detected_time_s, fix_s + 16.0))
    std_m = np.sqrt(np.linalg.eigvalsh(track.position_cov_m2[after]))
    since_m = np.linalg.norm(alone.position_m[after] - alone.position_m[k])
    assert std_m[0] > 0.7 * recipes.default(walk.subject).model.noise.log_scale_std * since_m


def test_a_place_with_unknown_rotation_has_the_mean_and_covariance_over_all_rotations() -> None:
    rng = np.random.default_rng(4)
    pairs = [PairedPoint(rng.normal(size=2), rng.normal(size=2), 4.0) for _ in range(3)]
    turn, place = rotation_density(pairs), Pose(np.array([3.0, -7.0]), np.array([[4.0, 1.5], [1.5, 1.0]]), 0.0, 0)
    means, covs = [], []
    for angle_rad in np.linspace(-np.pi, np.pi, 120, endpoint=False):
        turned = clockwise(angle_rad)
        # position by least squares with equal weights of the three pairs
        centre_m, world_m = (np.mean([getattr(p, name) for p in pairs], axis=0) for name in ("track_m", "world_m"))
        means.append(turned @ (place.position_m - centre_m) + world_m)
        covs.append(turned @ place.cov_m2 @ turned.T)
    mean = turn.prob @ np.array(means)
    away = np.array(means) - mean
    cov = np.tensordot(turn.prob, np.array(covs), 1) + (turn.prob[:, None] * away).T @ away
    world = turn.world(place)
    np.testing.assert_allclose(world.position_m, mean, atol=1e-12)
    np.testing.assert_allclose(world.cov_m2, cov + turn.centre_var_m2 * np.eye(2), atol=1e-10)
    # for plots: at the most probable rotation, with mean squares about it
    best, drawn = int(np.argmax(turn.prob)), turn.most_probable().world(place)
    away = np.array(means) - means[best]
    cov = np.tensordot(turn.prob, np.array(covs), 1) + (turn.prob[:, None] * away).T @ away
    np.testing.assert_allclose(drawn.position_m, means[best], atol=1e-12)
    np.testing.assert_allclose(drawn.cov_m2, cov + turn.centre_var_m2 * np.eye(2), atol=1e-10)


def test_an_alignment_rotates_the_ellipse_of_a_place_and_adds_its_own_errors() -> None:
    turn = Alignment(0.7, 1e-4, np.array([1.0, 2.0]), np.array([10.0, -5.0]), 0.3, n_steps=9)
    place = Pose(np.array([4.0, -1.0]), np.array([[4.0, 1.5], [1.5, 1.0]]), 0.2, 0)
    rng, n = np.random.default_rng(0), 200_000
    track = rng.multivariate_normal(place.position_m, place.cov_m2, n) - turn.track_centre_m
    # clockwise rotation by a random angle about a random centre
    angle = 0.7 + 0.01 * rng.standard_normal(n)
    c, s = np.cos(angle), np.sin(angle)
    world = np.column_stack([c * track[:, 0] + s * track[:, 1], c * track[:, 1] - s * track[:, 0]])
    world += turn.world_centre_m + np.sqrt(0.3) * rng.standard_normal((n, 2))
    there = turn.world(place)
    np.testing.assert_allclose(there.position_m, world.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(there.cov_m2, np.cov(world.T), atol=0.04)
    assert there.heading_rad == pytest.approx(0.9)
