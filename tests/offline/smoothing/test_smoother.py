"""The smoother: exactness, robustness, and recordings with fixes, loops and known headings."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from simulated_steps import Walk, simulated_walk
from true_positions import errors_m, position_fixes, true_m

import pdr_filter as pdr
from pdr_filter.offline.calibration.fit import calibrate
from pdr_filter.offline.smoothing import solve as solve_module
from pdr_filter.offline.smoothing.observations import (
    FloorChange,
    KnownHeading,
    LoopClosure,
    Observations,
    waypoint_fixes,
)
from pdr_filter.offline.smoothing.preintegration import Increments, state_transform, step_states
from pdr_filter.offline.smoothing.problem import NO_OFFSETS, ObservedOffsets, Problem, pose_problem
from pdr_filter.offline.smoothing.smooth import smooth
from pdr_filter.offline.smoothing.smoothed import notes_of_reckoning
from pdr_filter.offline.smoothing.solve import linear_equations, solve
from pdr_filter.simulate import Leg, simulate
from pdr_filter.tracking.step_statistics import HEADING_UNKNOWN
from pdr_filter.values import PositionFix, table, wrap_angle
from tests.oracles.imm_smoother import ModeEstimates, Transition, smooth_imm

ANY_HEADING = float(np.pi / np.sqrt(3))


def problem_of(
    walk: Walk,
    fixes: list[PositionFix],
    *,
    heading_std_rad: float = ANY_HEADING,
    start_std_m: float = 1000.0,
    loops: tuple[LoopClosure, ...] = (),
    headings: tuple[KnownHeading, ...] = (),
    offsets: ObservedOffsets = NO_OFFSETS,
) -> Problem:
    start_cov = np.diag(np.square([start_std_m, start_std_m, heading_std_rad, 0.06]))
    observed = Observations(tuple(fixes), loops, headings)
    return pose_problem(walk.steps, np.zeros(4), start_cov, observed, offsets, heading_std_rad, anchor_interval_s=10.0)


def solved(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    found = solve(problem)
    assert found.converged
    return step_states(problem.intervals, found.mean, found.joint_cov)


def rms_m(walk: Walk, mean: np.ndarray) -> float:
    return float(np.sqrt(np.square(mean[:, :2] - walk.position_m[1:]).sum(axis=1).mean()))


@pytest.mark.parametrize(("last_m", "converged"), [(5e-4, True), (0.1, False)])
def test_a_slow_solution_has_converged_if_its_last_step_is_below_a_millimetre(
    monkeypatch: pytest.MonkeyPatch, last_m: float, converged: bool
) -> None:
    rng = np.random.default_rng(1)
    walk = simulated_walk(40, rng)
    problem = problem_of(walk, walk.fixes(10, 1.0, rng))
    exact = solve_module._solved

    def slow(graph: object, of: Problem) -> tuple[np.ndarray, float]:
        state, turn = exact(graph, of)
        return np.full_like(state, last_m), turn

    monkeypatch.setattr(solve_module, "_solved", slow)
    start = np.zeros((problem.n_states, 6))
    found = solve_module._gauss_newton(problem, start, 0.0, problem.possible, -np.inf)
    assert bool(found[2]) == converged


# --- exactness ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("every", [1, 7, 30])
def test_positions_and_covariances_equal_those_of_a_smoother_with_every_step_as_a_state(every: int) -> None:
    """The reference is a Kalman filter and a Rauch-Tung-Striebel smoother over single steps, with the same
    linearisation.
    """
    rng = np.random.default_rng(every + 10)
    walk = simulated_walk(90, rng)
    fixes = walk.fixes(every, 1.0, rng)
    problem = problem_of(walk, fixes, heading_std_rad=0.15, start_std_m=5.0)
    found = solve(problem)
    mean, cov = step_states(problem.intervals, found.mean, found.joint_cov)
    assert (found.weight == 1).all()

    steps, x, state_cov = walk.steps, problem.start_mean, problem.start_cov
    at = {round(f.time_s, 3): f for f in fixes}
    estimates, transitions = [ModeEstimates(x[None], state_cov[None], np.ones(1))], []
    for k in range(len(steps)):
        start = found.mean[problem.intervals.index[k]]
        own_frame = state_transform(start[None])[0]
        moved = own_frame[:2, :2] @ steps.displacement_m[k]
        by_state = np.eye(4)
        by_state[:2, 2], by_state[:2, 3] = [moved[1], -moved[0]], moved
        offset = np.zeros(4)
        offset[:2] = moved - by_state[:2, 2:] @ start[2:]
        added_cov = np.zeros((4, 4))
        added_cov[:2, :2] = steps.cov_m2[k]
        # the drift before a step, which for the first step is part of the prior of the start
        drift_cov = np.zeros((4, 4))
        drift_cov[2, 2] = steps.drift_var_rad2[k] if k else 0.0
        added_cov[3, 3] = steps.scale_drift_var[k]
        added_cov = own_frame @ added_cov @ own_frame.T + by_state @ drift_cov @ by_state.T
        transitions.append(Transition(np.ones((1, 1)), np.zeros((1, 4)), offset[None], by_state[None], added_cov[None]))
        x, state_cov = by_state @ x + offset, by_state @ state_cov @ by_state.T + added_cov
        fix = at.get(round(float(steps.time_s[k]), 3))
        if fix is not None:
            gain = state_cov[:, :2] @ np.linalg.inv(state_cov[:2, :2] + fix.cov_m2)
            x, state_cov = x + gain @ (fix.position_m - x[:2]), state_cov - gain @ state_cov[:2]
        estimates.append(ModeEstimates(x[None], state_cov[None], np.ones(1)))
    expected = smooth_imm(estimates, transitions)[1:]
    np.testing.assert_allclose(mean, [e.mean[0] for e in expected], atol=1e-9)
    np.testing.assert_allclose(cov, [e.cov[0] for e in expected], atol=1e-9)


def test_equations_agree_with_finite_differences_of_their_residuals() -> None:
    """Finite differences of every block: start, intervals, fixes, a loop closure, a known heading, offsets."""
    rng = np.random.default_rng(2)
    walk = simulated_walk(40, rng)
    fixes = [replace(f, time_s=f.time_s + 0.1) for f in walk.fixes(9, 1.0, rng)]
    problem = problem_of(
        walk,
        fixes,
        heading_std_rad=0.3,
        start_std_m=5.0,
        loops=(LoopClosure(2.0, 15.0),),
        headings=(KnownHeading(3.0, 9.0, 0.4),),
        offsets=ObservedOffsets(np.array([0, 20]), np.array([0.1, 0.2]), np.array([0.2, 0.3])),
    )
    n = problem.n_nodes
    mean = solve(problem).mean + rng.normal(scale=0.05, size=(n, 4))
    ones = np.ones(len(problem.positions) + len(problem.directions))
    kinds = linear_equations(problem, mean, 0.2, ones)
    assert len(kinds) == 6  # the last one is the prior of the rotation

    for number, rows in enumerate(kinds):
        for block in range(len(rows.a)):

            def residual(values: np.ndarray, number: int = number, block: int = block) -> np.ndarray:
                moved = linear_equations(problem, values[:-1].reshape(n, 4), float(values[-1]), ones)[number].rhs[block]
                if number != 1:
                    return -moved
                # an interval's covariance stays where it was linearised
                fixed, own = (
                    problem.intervals.whiten[block] @ np.linalg.inv(state_transform(x[None])[0])
                    for x in (mean[block], values[:-1].reshape(n, 4)[block])
                )
                return -fixed @ np.linalg.solve(own, moved)

            numeric = approx_fprime(np.append(mean.ravel(), 0.2), residual, 1e-6).reshape(-1, 4 * n + 1)
            expected = np.zeros_like(numeric)
            for key, matrices in ((rows.a[block], rows.A), (rows.b[block], rows.B)):
                if key >= 0:
                    expected[:, 4 * key : 4 * key + matrices.shape[2]] += matrices[block]
            scale = np.abs(expected).max()
            np.testing.assert_allclose(numeric, expected, atol=2e-4 * scale)


# --- honest covariance ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wild_share", [0.0, 0.1])
def test_95_percent_ellipses_contain_the_truth_with_that_frequency_in_any_rotation(wild_share: float) -> None:
    rng = np.random.default_rng(7)
    inside = []
    for _ in range(60):
        walk = simulated_walk(150, rng, any_rotation=True)
        mean, cov = solved(problem_of(walk, walk.fixes(12, 2.0, rng, wild_share)))
        error = mean[:, :2] - walk.position_m[1:]
        inside.append(np.einsum("ka,kab,kb->k", error, np.linalg.inv(cov[:, :2, :2]), error) < 5.991)
    assert 0.91 < np.mean(inside) < 0.985


def test_a_tenth_of_outlying_fixes_is_rejected_and_hardly_changes_the_track() -> None:
    rng = np.random.default_rng(3)
    n_wild, missed, false_alarms, worse = 0, 0, 0, []
    for _ in range(30):
        walk = simulated_walk(200, rng, any_rotation=True)
        fixes = walk.fixes(10, 2.0, rng, wild_share=0.1)
        places = walk.position_m[10::10][: len(fixes)]
        wild = np.linalg.norm([f.position_m - p for f, p in zip(fixes, places, strict=True)], axis=1) > 15
        problem = problem_of(walk, fixes)
        found = solve(problem)
        without = solved(problem_of(walk, [f for f, w in zip(fixes, wild, strict=True) if not w]))[0]
        worse.append(rms_m(walk, step_states(problem.intervals, found.mean, found.joint_cov)[0]) / rms_m(walk, without))
        n_wild += wild.sum()
        missed += (wild & (found.weight > 0)).sum()
        false_alarms += (~wild & (found.weight == 0)).sum()
    assert n_wild > 30
    assert missed == 0
    assert false_alarms <= 3
    assert np.mean(worse) < 1.02


def test_a_change_of_carrying_starts_a_new_heading_offset() -> None:
    rng = np.random.default_rng(4)
    errors = []
    for _ in range(10):
        walk = simulated_walk(200, rng, any_rotation=True, jumps=1)
        stiff = replace(walk, steps=replace(walk.steps, jump_var_rad2=np.zeros(200)))
        fixes = walk.fixes(20, 2.0, rng)
        found = [solve(problem_of(w, fixes)) for w in (walk, stiff)]
        problems = [problem_of(w, fixes) for w in (walk, stiff)]
        errors.append(
            [
                rms_m(walk, step_states(p.intervals, f.mean, f.joint_cov)[0])
                for p, f in zip(problems, found, strict=True)
            ]
        )
    joint, without = np.median(errors, axis=0)
    assert joint < 2.0
    assert joint < 0.7 * without


def test_the_frame_of_the_fixes_may_be_rotated_and_thousands_of_metres_away() -> None:
    rng = np.random.default_rng(5)
    walk = simulated_walk(120, rng, any_rotation=True)
    fixes = walk.fixes(12, 2.0, rng)
    far = [replace(f, position_m=f.position_m + np.array([40_000.0, -70_000.0])) for f in fixes]
    start = np.array([*np.mean([f.position_m for f in far], axis=0), 0.0, 0.0])
    near_mean, near_cov = solved(problem_of(walk, fixes))
    far_mean, far_cov = solved(replace(problem_of(walk, far), start_mean=start))
    np.testing.assert_allclose(far_mean[:, :2] - [40_000.0, -70_000.0], near_mean[:, :2], atol=1e-2)
    np.testing.assert_allclose(far_cov, near_cov, atol=1e-3)


def test_a_loop_closure_alone_joins_both_ends() -> None:
    """The walk is sent straight back to its position after 10 s, with a last step of known error."""
    rng = np.random.default_rng(6)
    walk = simulated_walk(200, rng, drift_rad_per_sqrt_s=0.03)
    known = {"heading_std_rad": 0.15, "start_std_m": 1e-3}
    open_mean, open_cov = solved(problem_of(walk, [], **known))
    home = replace(
        walk.steps.part(slice(199, 200)),
        time_s=walk.steps.time_s[-1:] + 0.5,
        displacement_m=open_mean[[19], :2] - open_mean[[199], :2] + [3.0, -2.0],
        cov_m2=1e-2 * np.eye(2)[None],
    )
    both = (np.concatenate([getattr(part, name) for part in (walk.steps, home)]) for name in Increments.__slots__)
    looped = replace(walk, steps=Increments(*both))
    mean, cov = solved(problem_of(looped, [], loops=(LoopClosure(10.0, float(home.time_s[0]), 0.1),), **known))
    assert np.linalg.norm(mean[200, :2] - mean[19, :2]) < 0.3
    assert np.trace(cov[150, :2, :2]) < 0.8 * np.trace(open_cov[150, :2, :2])


@pytest.mark.parametrize(("gap_s", "std_m"), [(0.1, 0.1), (1.0, 0.5)])
def test_a_loop_closure_over_a_short_distance_changes_nothing_and_gives_a_note(gap_s: float, std_m: float) -> None:
    found, alone = smooth(WALKED, loop_closures=[LoopClosure(20.0, 20.0 + gap_s, std_m)]), smooth_alone()
    np.testing.assert_allclose(found.track.position_m, alone.track.position_m, atol=1e-6)
    assert len(found.rejected) == 1
    assert any("the distance walked between its two times is within its uncertainty" in note for note in found.notes)


def test_copies_of_a_wrong_loop_closure_do_not_confirm_each_other() -> None:
    wrong = [LoopClosure(20.0, 32.0, 0.5)] * 1000
    found, alone = smooth(WALKED, loop_closures=wrong), smooth_alone()
    assert len(found.rejected) == 1000
    assert found.scale == pytest.approx(alone.scale, abs=1e-6)


@cache
def smooth_alone() -> pdr.Smoothed:
    """Return the smoothed track without observations, by the same least squares."""
    return smooth(WALKED, loop_closures=[LoopClosure(20.0, 20.1)])


def test_observations_may_come_from_iterators_and_keep_their_numbers() -> None:
    fixes = [replace(fix, correlation_s=20.0) for fix in fixes_of(WALKED)]
    closures = [LoopClosure(20.0, 20.1)]
    found = smooth(WALKED, fixes=iter(fixes[::-1]), loop_closures=iter(closures))
    assert (found.observations.kind == "fix").sum() == len(fixes)
    np.testing.assert_array_equal(found.observations.time_s[: len(fixes)], [fix.time_s for fix in fixes[::-1]])
    np.testing.assert_allclose(found.track.position_m, smooth(WALKED, fixes=fixes).track.position_m, atol=1e-6)


def test_known_headings_rotate_the_track_into_the_map() -> None:
    rng = np.random.default_rng(8)
    walk = simulated_walk(100, rng, any_rotation=True)
    way = walk.position_m[60] - walk.position_m[10]
    heading = KnownHeading(5.0, 30.0, float(np.arctan2(way[0], way[1])), 0.02)
    mean, cov = solved(problem_of(walk, [], headings=(heading,), start_std_m=1e-3))
    assert abs(float(wrap_angle(mean[30, 2] - walk.heading_offset_rad[31]))) < 4 * np.sqrt(cov[30, 2, 2])
    assert np.sqrt(cov[30, 2, 2]) < 0.1


# --- recordings and bad input ---------------------------------------------------------------------------------------

WALKED = simulate([Leg("walking", distance_m=40.0), Leg("walking", distance_m=30.0, turn_rad=1.5)], seed=2)


def clockwise(angle_rad: float) -> np.ndarray:
    """Return the matrix that rotates rows (east, north) clockwise."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s], [s, c]])


def fixes_of(walk: pdr.Recording, rotation_rad: float = 0.0, std_m: float = 1.0) -> list[PositionFix]:
    times = np.arange(4.0, float(walk.truth.position.time_s[-1]), 6.0)
    places = true_m(walk, times) @ clockwise(rotation_rad)
    return position_fixes(times, places + np.random.default_rng(1).normal(scale=std_m, size=places.shape), std_m)


def test_a_recording_is_smoothed_into_the_frame_of_its_fixes() -> None:
    fixes = fixes_of(WALKED, rotation_rad=2.0)
    wild = replace(fixes[3], position_m=fixes[3].position_m + np.array([60.0, 10.0]))
    outside = replace(fixes[0], time_s=500.0)
    result = smooth(
        WALKED, fixes=[*fixes[:3], wild, *fixes[4:], outside], floor_changes=[FloorChange(0.0, 1), FloorChange(30.0, 2)]
    )
    track = result.track
    error = np.linalg.norm(track.position_m - true_m(WALKED, track.time_s) @ clockwise(2.0), axis=1)
    assert np.sqrt((error**2).mean()) < 1.2
    assert result.rejected.number.tolist() == [3, len(fixes)]
    assert [n for n in result.notes if "fix 3: not used, because the walk contradicts it" in n]
    assert [n for n in result.notes if f"fix {len(fixes)}: outside the recording" in n]
    assert abs(result.scale - 1) < 0.1 and 0 < result.scale_std < 0.06
    assert set(result.floor) == {1.0, 2.0}
    assert "1 rejected" not in repr(result) and "2 rejected" in repr(result)


def test_without_fixes_the_track_is_that_of_dead_reckoning_with_a_growing_covariance() -> None:
    forward = pdr.track(WALKED)
    result = smooth(WALKED)
    std = [np.sqrt(np.trace(t.position_cov_m2, axis1=1, axis2=2)) for t in (result.track, forward)]
    assert (np.linalg.norm(result.track.position_m - forward.position_m, axis=1) < 0.3 * std[1] + 0.2).all()
    np.testing.assert_allclose(std[0][20:], std[1][20:], rtol=0.2)
    assert std[0][-1] > std[0][10] > 0


def test_without_fixes_the_smoothed_deviation_of_walking_before_running_is_the_online_one() -> None:
    """Each mode has its own uncertain step length. With "imm", smoothed mode probabilities begin to run earlier."""
    legs = [Leg("stationary", duration_s=3.0), *(Leg(of, distance_m=15.0) for of in ("walking", "running"))]
    walk = replace(simulate(legs, seed=1), magnetometer=None)
    for weighting, within in (("hc", 0.02), ("imm", 0.25)):
        online, smoothed = pdr.track(walk, weighting=weighting), smooth(walk, weighting=weighting).track
        np.testing.assert_allclose(smoothed.position_std_m[10:], online.position_std_m[10:], rtol=within)


def test_a_single_fix_gives_a_position_but_no_direction() -> None:
    fix = fixes_of(WALKED)[3]
    result = smooth(WALKED, fixes=[fix])
    track = result.track
    near = int(np.argmin(np.abs(track.time_s - fix.time_s)))
    assert np.linalg.norm(track.position_m[near] - fix.position_m) < 1.0
    assert np.sqrt(np.trace(track.position_cov_m2[near])) < 2.0
    assert np.sqrt(np.trace(track.position_cov_m2[-1])) > 0.7 * np.linalg.norm(track.position_m[-1] - fix.position_m)
    assert [n for n in result.notes if "a single fix" in n]


def test_without_a_gyroscope_no_note_speaks_of_its_bias_or_of_fixes_that_do_not_exist() -> None:
    blind = replace(WALKED, gyroscope=None)
    for notes in (pdr.track(blind).notes, smooth(blind).notes):
        assert [note for note in notes if "no gyroscope: the heading is unknown" in note]
        assert not [note for note in notes if "gyroscope bias" in note or "before and after" in note]


def test_the_warning_about_headings_counts_the_smoothed_headings() -> None:
    gyroscope = WALKED.gyroscope
    missing = (gyroscope.time_s > 8.0) & (gyroscope.time_s < 14.0)
    walk = replace(WALKED, gyroscope=pdr.Samples(gyroscope.time_s[~missing], gyroscope.values[~missing]))
    alone, fixed = smooth(walk), smooth(walk, fixes=fixes_of(WALKED))
    n = int((alone.heading_offset_std_rad > 0.5).sum())
    assert n > 20 > (fixed.heading_offset_std_rad > 0.5).sum()
    assert [note for note in alone.notes if f"uncertain by more than 0.5 rad in {n} of {alone.track.n_steps}" in note]
    assert not [note for note in fixed.notes if "uncertain by more than" in note]


@pytest.mark.parametrize(
    ("std_rad", "said"),
    [(0.51, "by more than 0.5 rad in 1 of"), (0.3, "the smoothed heading is uncertain by up to 0.30 rad"), (0.2, "")],
)
def test_a_warning_about_the_gyroscope_bias_stays_while_a_smoothed_heading_is_doubtful(
    std_rad: float, said: str
) -> None:
    known = smooth_alone().track
    warned = replace(known, notes=(*known.notes, f"in 40 steps: {HEADING_UNKNOWN}"))
    found, std = SimpleNamespace(joint_cov=np.zeros((1, 8, 8))), np.full(known.n_steps, 0.1)
    std[-1] = std_rad
    notes = notes_of_reckoning(warned, cast(Any, found), std)
    assert notes[: len(known.notes)] == list(known.notes)
    assert [said in note and HEADING_UNKNOWN in note for note in notes[len(known.notes) :]] == [True] * bool(said)
    assert notes_of_reckoning(known, cast(Any, found), std) == list(known.notes)


def test_without_a_gyroscope_the_fixes_give_the_directions_with_a_large_covariance() -> None:
    fixes = fixes_of(WALKED)
    blind, seeing = smooth(replace(WALKED, gyroscope=None), fixes=fixes), smooth(WALKED, fixes=fixes)
    spread = [np.sqrt(np.trace(r.track.position_cov_m2, axis1=1, axis2=2)).mean() for r in (blind, seeing)]
    assert spread[0] > 1.5 * spread[1]
    assert [n for n in blind.notes if "no angular rate" in n]
    error = blind.track.position_m - true_m(WALKED, blind.track.time_s)
    nees = np.einsum("ka,kab,kb->k", error, np.linalg.inv(blind.track.position_cov_m2), error)
    assert (nees < 9.2).mean() > 0.9


def test_a_recording_without_steps_has_the_position_of_its_fixes() -> None:
    still = simulate([Leg("stationary", duration_s=8.0)])
    fixes = [PositionFix(2.0, np.array([5.0, 1.0]), np.eye(2)), PositionFix(4.0, np.array([7.0, 1.0]), np.eye(2))]
    result = smooth(still, fixes=fixes)
    assert result.track.n_steps == 0
    np.testing.assert_allclose(result.start_position_m, [6.0, 1.0])
    np.testing.assert_allclose(result.start_position_cov_m2, 0.5 * np.eye(2))


def test_a_calibration_gives_the_step_lengths_and_their_uncertainty() -> None:
    truth = WALKED.truth.position
    start_s, end_s = np.array([4.0, 12.0]), np.array([12.0, 20.0])
    distance_m = np.linalg.norm(true_m(WALKED, end_s) - true_m(WALKED, start_s), axis=1)
    parts = table({"start_s": start_s, "end_s": end_s, "distance_m": distance_m, "n_steps": [np.nan] * 2})
    somebody = replace(
        WALKED, meta={**WALKED.meta, "subject": {"id": "somebody"}}, truth=replace(WALKED.truth, segments=parts)
    )
    known, unknown = smooth(somebody, calibration=calibrate([somebody])), smooth(WALKED)
    assert known.scale_std < 0.8 * unknown.scale_std
    walked_m = np.hypot(np.diff(truth.east_m), np.diff(truth.north_m)).sum()
    assert known.track.distance_m == pytest.approx(walked_m, rel=0.08)


def test_a_gap_in_the_samples_is_bridged_by_fixes() -> None:
    def cut(samples: pdr.Samples) -> pdr.Samples:
        keep = (samples.time_s < 12.0) | (samples.time_s > 18.0)
        return pdr.Samples(samples.time_s[keep], samples.values[keep])

    broken = replace(WALKED, accelerometer=cut(WALKED.accelerometer), gyroscope=cut(WALKED.gyroscope))
    result = smooth(broken, fixes=fixes_of(WALKED))
    assert len(result.rejected) == 0
    assert (np.linalg.eigvalsh(result.track.position_cov_m2) > 0).all()
    assert result.track.step_length_m.max() < 1.5
    assert errors_m(result.track, WALKED)[result.track.time_s > 20.0].mean() < 3.0


def test_repeated_fixes_change_nothing_and_a_fix_before_the_first_step_is_accepted() -> None:
    fixes = fixes_of(WALKED)
    early = PositionFix(0.0, np.zeros(2), np.eye(2))
    once, twice = smooth(WALKED, fixes=[early, *fixes]), smooth(WALKED, fixes=[early, *fixes, *fixes])
    np.testing.assert_array_equal(twice.track.position_m, once.track.position_m)
    np.testing.assert_array_equal(twice.track.position_cov_m2, once.track.position_cov_m2)
    n = 1 + len(fixes)
    assert [fix.outcome for fix in twice.track.fixes] == n * ["used"] + len(fixes) * ["repeated"]
    (note,) = set(twice.notes) - set(once.notes)
    assert "repeats an earlier fix" in note


@pytest.mark.recordings
def test_the_smoothed_track_passes_real_waypoints_between_the_fixes_within_a_metre(data_dir: Path) -> None:
    squares = []
    for name in ("1f", "forward"):
        recording = pdr.read(data_dir / "humolire" / f"humolire_user1_{name}.zip")
        fixes = waypoint_fixes(recording)
        track = smooth(recording, fixes=fixes[::3]).track
        for number, fix in enumerate(fixes):
            if number % 3:
                at = [np.interp(fix.time_s, track.time_s, track.position_m[:, k]) for k in (0, 1)]
                squares.append(np.square(at - fix.position_m).sum())
    assert np.sqrt(np.mean(squares)) < 1.0
