from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_steps import Walk, simulated_walk

import pdr_filter as pdr
from pdr_filter.filter.fixes.gnss import independent
from pdr_filter.filter.imm.motion_model import MotionNoise
from pdr_filter.offline.smoothing.fixed_lag import FixedLagSmoother, LateSteps
from pdr_filter.offline.smoothing.observations import LoopClosure, Observations
from pdr_filter.offline.smoothing.preintegration import bridge
from pdr_filter.offline.smoothing.problem import pose_problem
from pdr_filter.offline.smoothing.solve import solve
from pdr_filter.recipes import default
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import PositionFix
from pdr_filter.values import serialisation as serialise

NOISE = MotionNoise(log_scale_std=0.06)


def run(
    smoother: FixedLagSmoother, walk: Walk, fixes: list[PositionFix], at_a_time: int = 1, save: bool = False
) -> tuple[list[LateSteps], int]:
    """What comes out, and the most steps that the state held."""
    state, outputs, held, waiting = smoother.init(), [], 0, list(fixes)
    for first in range(0, len(walk.steps), at_a_time):
        part = walk.steps.part(first, min(first + at_a_time, len(walk.steps)))
        new = [f for f in waiting if f.time_s <= part.time_s[-1]]
        waiting = waiting[len(new) :]
        state, out = smoother.step_increments(state, part, new)
        if save:
            state = serialise.from_bytes(serialise.to_bytes(state))
        outputs.append(out)
        held = max(held, len(state.steps))
    outputs.append(smoother.finish(state)[1])
    return outputs, held


def whole(
    walk: Walk, fixes: list[PositionFix], smoother: FixedLagSmoother, loops: list[LoopClosure] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    start = smoother.init()
    mean = np.array([*fixes[0].position_m, 0.0, 0.0])
    observed = Observations(tuple(fixes), tuple(loops or ()))
    problem = pose_problem(walk.steps, mean, start.start_cov, observed, anchor_interval_s=10.0)
    found = solve(problem)
    return bridge(problem.intervals, found.mean, found.joint_cov)


def test_with_a_lag_longer_than_the_walk_it_is_the_smoother_of_the_whole_walk() -> None:
    rng = np.random.default_rng(1)
    walk = simulated_walk(120, rng, any_rotation=True)
    fixes = walk.fixes(15, 2.0, rng)
    smoother = FixedLagSmoother((), NOISE, lag_s=1e4)
    outputs, _ = run(smoother, walk, fixes, at_a_time=40)
    mean, cov = whole(walk, fixes, smoother)
    np.testing.assert_allclose(np.concatenate([o.mean for o in outputs]), mean, atol=1e-9)
    np.testing.assert_allclose(np.concatenate([o.cov for o in outputs]), cov, atol=1e-9)


@pytest.mark.parametrize("correlation_s", [20.0, 1e4])
def test_correlated_fixes_count_as_in_the_smoother_of_the_whole_walk(correlation_s: float) -> None:
    rng = np.random.default_rng(1)
    walk = simulated_walk(120, rng, any_rotation=True)
    fixes = [replace(fix, correlation_s=correlation_s) for fix in walk.fixes(15, 2.0, rng)]
    smoother = FixedLagSmoother((), NOISE, lag_s=1e4)
    outputs, _ = run(smoother, walk, fixes, at_a_time=40)
    mean, cov = whole(walk, list(independent(fixes)), smoother)
    np.testing.assert_allclose(np.concatenate([o.mean for o in outputs]), mean, atol=1e-9)
    np.testing.assert_allclose(np.concatenate([o.cov for o in outputs]), cov, atol=1e-9)
    short, _ = run(FixedLagSmoother((), NOISE, lag_s=5.0, memory_s=10.0), walk, fixes, at_a_time=5)
    alone, _ = run(FixedLagSmoother((), NOISE, lag_s=5.0, memory_s=10.0), walk, walk.fixes(15, 2.0, rng), at_a_time=5)
    ends = [float(np.trace(out[-1].cov[-1, :2, :2])) for out in (short, alone)]
    assert ends[0] > 1.5 * ends[1]


def test_a_fix_that_repeats_the_last_position_is_not_used() -> None:
    rng = np.random.default_rng(6)
    walk = simulated_walk(200, rng)
    fixes = walk.fixes(10, 2.0, rng)
    held = [replace(f, position_m=fixes[9].position_m) if k > 9 else f for k, f in enumerate(fixes)]
    outputs, _ = run(FixedLagSmoother((), NOISE, lag_s=10.0, memory_s=20.0), walk, held, at_a_time=5)
    rejected = [f.time_s for o in outputs for f in o.rejected]
    assert rejected == [f.time_s for f in held[10:]]


def test_each_step_comes_once_in_order_and_the_window_stays_short() -> None:
    rng = np.random.default_rng(2)
    walk = simulated_walk(240, rng, any_rotation=True)
    outputs, held = run(FixedLagSmoother((), NOISE, lag_s=10.0, memory_s=30.0), walk, walk.fixes(12, 2.0, rng), 4)
    np.testing.assert_array_equal(np.concatenate([o.time_s for o in outputs]), walk.steps.time_s)
    assert held <= 120  # 30 s are 60 steps; more wait until the rotation is known


def test_positions_are_nearly_those_of_the_whole_walk_and_as_sure_as_they_say() -> None:
    rng = np.random.default_rng(3)
    inside, square_m2 = [], []
    for _ in range(6):
        walk = simulated_walk(200, rng, any_rotation=True)
        fixes = walk.fixes(15, 2.0, rng)
        smoother = FixedLagSmoother((), NOISE, lag_s=20.0, memory_s=40.0)
        outputs, _ = run(smoother, walk, fixes, at_a_time=10)
        late = np.concatenate([o.mean for o in outputs]), np.concatenate([o.cov for o in outputs])
        errors = [(mean[:, :2] - walk.position_m[1:])[60:] for mean, _ in (late, whole(walk, fixes, smoother))]
        covs = [cov[60:, :2, :2] for _, cov in (late, whole(walk, fixes, smoother))]
        inside.append(
            [
                np.mean(np.einsum("ka,kab,kb->k", e, np.linalg.inv(c), e) < 5.991)
                for e, c in zip(errors, covs, strict=True)
            ]
        )
        square_m2.append([np.square(e).sum(axis=1).mean() for e in errors])
    late_inside, whole_inside = np.mean(inside, axis=0)
    late_m, whole_m = np.sqrt(np.mean(square_m2, axis=0))
    assert late_inside > whole_inside - 0.1  # six walks; the benchmark has more
    assert late_m < 1.3 * whole_m


def test_wild_fixes_and_fixes_that_come_too_late_are_rejected() -> None:
    rng = np.random.default_rng(4)
    walk = simulated_walk(200, rng, any_rotation=True)
    fixes = walk.fixes(10, 2.0, rng)
    wild = replace(fixes[9], position_m=fixes[9].position_m + np.array([50.0, -40.0]))
    smoother = FixedLagSmoother((), NOISE, lag_s=10.0, memory_s=20.0)
    outputs, _ = run(smoother, walk, [*fixes[:9], wild, *fixes[10:]], at_a_time=5)
    assert [f.time_s for o in outputs for f in o.rejected] == [wild.time_s]
    state, _ = smoother.step_increments(smoother.init(), walk.steps, fixes)
    late = replace(fixes[0], time_s=1.0, received_time_s=100.0)
    _, out = smoother.step_increments(state, walk.steps.part(0, 0), [late])
    assert [f.time_s for f in out.rejected] == [1.0]


def test_a_saved_and_restored_state_goes_on_as_if_nothing_had_happened() -> None:
    rng = np.random.default_rng(5)
    walk = simulated_walk(80, rng)
    smoother = FixedLagSmoother((), NOISE, lag_s=5.0, memory_s=10.0)
    fixes = walk.fixes(8, 2.0, rng)
    one, two = run(smoother, walk, fixes, 8)[0], run(smoother, walk, fixes, 8, save=True)[0]
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.mean, b.mean)
        np.testing.assert_array_equal(a.cov, b.cov)


def test_updates_of_the_online_filter_go_in_as_they_come() -> None:
    walk = simulate([Leg("walking", distance_m=60.0)], seed=2)
    config = default()
    online = pdr.OnlineFilter(config)
    smoother = FixedLagSmoother(config.model.modes, config.model.noise, lag_s=10.0)
    truth = walk.truth.position
    times = np.arange(3.0, float(truth.time_s[-1]), 4.0)
    places = np.column_stack([np.interp(times, truth.time_s, truth[n]) for n in ("east_m", "north_m")])
    fixes = [PositionFix(float(t), p, 0.25 * np.eye(2)) for t, p in zip(times, places, strict=True)]
    samples = pdr.merge_streams(walk)
    found = online.push(samples.time_s, samples.specific_force_mps2, samples.angular_rate_radps)
    updates = [*found, *online.finish()]
    state, outputs = smoother.init(), []
    for update in updates:
        new = [f for f in fixes if f.time_s <= update.step.time_s]
        fixes = fixes[len(new) :]
        state, out = smoother.update(state, [update], new)
        outputs.append(out)
    outputs.append(smoother.finish(state)[1])
    mean, time_s = np.concatenate([o.mean for o in outputs]), np.concatenate([o.time_s for o in outputs])
    at = np.column_stack([np.interp(time_s, truth.time_s, truth[n]) for n in ("east_m", "north_m")])
    assert len(mean) == len([u for u in updates if u.is_final])
    assert np.sqrt(np.square(mean[:, :2] - at).sum(axis=1).mean()) < 1.0


def test_impossible_times_are_refused() -> None:
    with pytest.raises(ValueError, match="lag_s of FixedLagSmoother must be 0 or more"):
        FixedLagSmoother((), NOISE, lag_s=-1.0)


def crossings(walk: Walk, apart: int = 150) -> list[LoopClosure]:
    """Where the walk comes back within 0.3 m to a place that it left at least so many steps before."""
    place, time_s = walk.position_m[1:], walk.steps.time_s
    closures: list[LoopClosure] = []
    for j in range(apart, len(place)):
        distance = np.hypot(*(place[: j - apart + 1] - place[j]).T)
        if distance.min() < 0.3 and (not closures or time_s[j] - closures[-1].second_s > 10.0):
            closures.append(LoopClosure(float(time_s[distance.argmin()]), float(time_s[j]), 0.5))
    return closures


def with_loops(
    smoother: FixedLagSmoother, walk: Walk, fixes: list[PositionFix], loops: list[LoopClosure]
) -> tuple[np.ndarray, np.ndarray, list[object]]:
    """Means and covariances of all steps, and what was rejected; loop closures arrive when they happen."""
    state = smoother.init()
    outputs: list[LateSteps] = []
    for first in range(0, len(walk.steps), 10):
        part = walk.steps.part(first, min(first + 10, len(walk.steps)))
        since, until = walk.steps.time_s[first - 1] if first else -1.0, part.time_s[-1]
        new = [f for f in fixes if since < f.time_s <= until]
        closed = [c for c in loops if since < c.second_s <= until]
        state, out = smoother.step_increments(state, part, new, closed)
        state = serialise.from_bytes(serialise.to_bytes(state))
        outputs.append(out)
    outputs.append(smoother.finish(state)[1])
    mean, cov = (np.concatenate([getattr(o, name) for o in outputs]) for name in ("mean", "cov"))
    return mean, cov, [r for o in outputs for r in o.rejected]


@pytest.mark.parametrize("seed", [0, 3, 7])
def test_a_place_that_left_the_window_minutes_ago_is_found_again_as_well_as_by_the_smoother_of_the_whole(
    seed: int,
) -> None:
    """Fixes end after 100 of 600 steps, the window has 60. Where headings are known, nothing is lost by forgetting."""
    rng = np.random.default_rng(seed)
    walk = simulated_walk(600, rng, drift_rad_per_sqrt_s=0.02)
    fixes, loops = walk.fixes(10, 1.0, rng)[:10], crossings(walk)
    assert len(loops) >= 2
    smoother = FixedLagSmoother((), NOISE, lag_s=10.0, memory_s=30.0)
    mean, cov, rejected = with_loops(smoother, walk, fixes, loops)
    assert not rejected
    expected, expected_cov = whole(walk, fixes, smoother, loops)
    assert np.hypot(*(mean - expected)[-1, :2]) < 0.25
    np.testing.assert_allclose(np.trace(cov[-1, :2, :2]), np.trace(expected_cov[-1, :2, :2]), rtol=0.15)
    without, _, _ = with_loops(smoother, walk, fixes, [])
    assert np.hypot(*(without - expected)[-1, :2]) > 2.0


def test_a_loop_closure_that_cannot_be_is_rejected_and_one_in_the_window_counts() -> None:
    rng = np.random.default_rng(3)
    walk = simulated_walk(300, rng)
    fixes = walk.fixes(10, 1.0, rng)
    time_s = walk.steps.time_s
    wrong = LoopClosure(float(time_s[20]), float(time_s[280]), 0.5)
    assert np.hypot(*(walk.position_m[21] - walk.position_m[281])) > 20.0
    smoother = FixedLagSmoother((), NOISE, lag_s=10.0, memory_s=30.0)
    mean, _, rejected = with_loops(smoother, walk, fixes, [wrong])
    assert rejected == [wrong]
    np.testing.assert_allclose(mean, with_loops(smoother, walk, fixes, [])[0], atol=2e-3)
    state, _ = smoother.step_increments(smoother.init(), walk.steps.part(0, 200), fixes[:20])
    state, out = smoother.step_increments(state, walk.steps.part(200, 210))
    too_late = LoopClosure(0.5, state.start_s - 1.0, 0.5)
    state, out = smoother.step_increments(state, walk.steps.part(210, 211), (), [too_late])
    assert too_late in out.rejected


def test_loop_closures_of_near_times_and_copies_carry_no_information() -> None:
    rng = np.random.default_rng(4)
    walk = simulated_walk(150, rng)
    at_s, fixes = float(walk.steps.time_s[60]), walk.fixes(15, 2.0, rng)
    near = [LoopClosure(at_s, at_s + gap_s, 0.5) for gap_s in (0.1, 0.6, 1.0)]
    smoother = FixedLagSmoother((), NOISE, lag_s=1e4)
    state, _ = smoother.step_increments(smoother.init(), walk.steps, fixes, near)
    _, with_them = smoother.finish(state)
    _, without = smoother.finish(smoother.step_increments(smoother.init(), walk.steps, fixes)[0])
    np.testing.assert_array_equal(with_them.mean, without.mean)
    assert [c for c in with_them.rejected if isinstance(c, LoopClosure)] == near


def test_loop_closures_within_the_window_are_those_of_the_smoother_of_the_whole_walk() -> None:
    rng = np.random.default_rng(6)
    walk = simulated_walk(300, rng)
    fixes, loops = walk.fixes(20, 2.0, rng)[:3], crossings(walk, 25)
    assert len(loops) == 3
    smoother = FixedLagSmoother((), NOISE, lag_s=1e4)
    mean, cov, rejected = with_loops(smoother, walk, fixes, loops)
    expected = whole(walk, fixes, smoother, loops)
    np.testing.assert_allclose(mean, expected[0], atol=1e-9)
    np.testing.assert_allclose(cov, expected[1], atol=1e-9)
    assert not rejected
    assert np.abs(mean - whole(walk, fixes, smoother)[0]).max() > 0.05


def test_the_old_name_of_the_update_works_and_warns() -> None:
    smoother = FixedLagSmoother((), NOISE)
    with pytest.warns(DeprecationWarning, match=r"step is now FixedLagSmoother\.update"):
        _, late = smoother.step(smoother.init(), ())
    assert len(late) == 0
