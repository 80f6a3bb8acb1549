# ruff: noqa: N806 - the letters of the equations
from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import a_step, clockwise, even_transitions, mode_of_each_context, tracker_of, updates_of
from hypothesis import given, settings
from hypothesis import strategies as st

from pdr_filter import recipes
from pdr_filter.filter.chain.handler import StepsEnd, TrackerHandler, Window
from pdr_filter.filter.chain.imm_tracker import ImmState, ImmTracker
from pdr_filter.filter.chain.weighted_tracker import DetectedStepTracker, WeightedState, WeightedTracker
from pdr_filter.filter.chain.with_path import PathState, WithPath
from pdr_filter.filter.imm import imm
from pdr_filter.filter.imm.motion_model import (
    Directions,
    MotionNoise,
    initial_estimate,
    second_order_errors,
    stepless_var_m2,
)
from pdr_filter.filter.imm.step_cycle import advance
from pdr_filter.filter.imm.weighting import HC, context_weights, weighted_distances
from pdr_filter.filter.pedestrian.alignment import Alignment
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.pedestrian_state import (
    StepUpdate,
    in_other_frame,
    over_stepless,
    reckoned_position,
    with_reopened_rotation,
)
from pdr_filter.values import CONTEXTS, HeadingFix, PositionFix, SpeedFix, Step, WindowContext, replace_unchecked
from pdr_filter.values.events import Stepless

LATENCY_S = 0.74
EVEN_PRIOR = np.full(6, 1 / 6)
STATIONARY, WALKING, RUNNING = (CONTEXTS.index(c) for c in ("stationary", "walking", "running"))
Event = Step | WindowContext


Tracker = ImmTracker | WeightedTracker
State = ImmState | WeightedState


def model() -> PedestrianModel:
    return PedestrianModel(mode_of_each_context(), even_transitions(6, 0.9), evidence_exponent=0.5, prior_exponent=1.0)


def as_printed() -> PedestrianModel:
    """Return the model for the printed algorithms of HC and WC, in which a step is no evidence for a context."""
    return replace(model(), step_log_odds_stationary=0.0)


def tracker(weighting: str) -> Tracker:
    return tracker_of(weighting, model())


def position_of(state: State) -> tuple[np.ndarray, np.ndarray]:
    return reckoned_position(state.pedestrian)


def sure(context: int, prob: float = 1.0) -> np.ndarray:
    return np.where(np.arange(6) == context, prob, (1 - prob) / 5)


def random_walk(seed: int, duration_s: int = 20) -> tuple[list[Step], list[WindowContext]]:
    """Return steps from 1 s on, and windows that end at 2, 3, 4 s and so on."""
    rng = np.random.default_rng(seed)
    contacts_s = 1.05 + np.cumsum(rng.uniform(0.35, 0.8, 60))
    steps = [
        a_step(t, heading_rad=rng.normal(), duration_s=rng.uniform(0.4, 0.8), variance=rng.gamma(2.0))
        for t in contacts_s[contacts_s < duration_s]
    ]
    windows = [WindowContext(float(t), rng.dirichlet(np.full(6, 0.4)), EVEN_PRIOR) for t in range(2, duration_s + 2)]
    return steps, windows


def in_order(steps: list[Step], windows: list[WindowContext]) -> list[Event]:
    """Return steps and windows in the order of the front end, which detects a step some time after its contact."""
    timed = [(w.time_s, 0, w) for w in windows] + [(s.time_s + LATENCY_S, 1, s) for s in steps]
    return [event for *_, event in sorted(timed, key=lambda e: e[:2])]


def run(filter_: Tracker, events: list[Event], state: State | None = None) -> tuple[State, list[StepUpdate]]:
    state, updates = state or filter_.init(), []
    for event in events:
        on_event = filter_.on_window if isinstance(event, WindowContext) else filter_.on_step
        state, found = updates_of(on_event(state, event))  # type: ignore[arg-type]
        provisional = filter_.provisional(state) if isinstance(event, Step) else None
        updates += found if provisional is None else [*found, provisional]
    state, found = updates_of(filter_.finish(state))
    return state, [*updates, *found]


def final(updates: list[StepUpdate]) -> list[StepUpdate]:
    return [u for u in updates if u.is_final]


def distances_of_epochs(steps: list[Step], n_epochs: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance (K, 6) of each epoch in each context, and the epoch of each step. Epoch 1 ends at 2 s."""
    epochs = np.array([int(np.ceil(s.time_s)) - 1 for s in steps])
    distance_m = np.zeros((n_epochs, 6))
    for step, epoch in zip(steps, epochs, strict=True):
        for c, mode in enumerate(mode_of_each_context()):
            distance_m[epoch - 1, c] += mode.step_length.predict(step)[0]
    return distance_m, epochs


@pytest.mark.parametrize("weighting", ["hc", "imm"])
@pytest.mark.parametrize("context", [STATIONARY, WALKING])
def test_a_step_from_rest_has_a_larger_length_variance_in_modes_that_move(weighting: str, context: int) -> None:
    """A contact in the pause may have been missed: 0.7 m in one of four cases, in modes that move only."""
    only = replace(model(), transition_prob=np.eye(6)) if weighting == "imm" else model()
    begin, windows = tracker_of(weighting, only), [WindowContext(2.0, sure(context), EVEN_PRIOR)]
    steps = (a_step(1.5), replace(a_step(1.5), from_rest=True))
    state = begin.init()
    if weighting == "imm":
        estimates = replace(state.pedestrian.estimates, prob=np.eye(6)[context])
        state = replace(state, pedestrian=replace(state.pedestrian, estimates=estimates))
    usual, paused = (run(begin, in_order([step], windows), state)[1][-1] for step in steps)
    np.testing.assert_array_equal(paused.position_m, usual.position_m)
    added_m2 = paused.position_cov_m2 - usual.position_cov_m2
    np.testing.assert_allclose(added_m2, np.diag([0.0, 0.25 * 0.7**2 if context == WALKING else 0.0]), atol=1e-9)


@pytest.mark.parametrize("duration_s", [0.4, 0.6])
def test_an_uneven_step_has_a_larger_length_variance(duration_s: float) -> None:
    even = replace(a_step(1.5), duration_s=duration_s, usual_duration_s=duration_s)
    uneven = replace(even, usual_duration_s=0.5)
    m = model()
    length_m, of_even, *_ = m.lengths(even)
    same_m, of_uneven, *_ = m.lengths(uneven)
    np.testing.assert_array_equal(same_m, length_m)
    np.testing.assert_allclose(of_uneven - of_even, (0.6 * 0.2) ** 2 * m.moves, atol=1e-12)


# --- HC and WC against the algorithms -------------------------------------------------------------------------------


@pytest.mark.parametrize(("weighting", "threshold"), [("hc", HC), ("wc", 0.8)])
@pytest.mark.parametrize("seed", range(5))
def test_final_step_lengths_add_up_to_the_total_final_distance_of_every_epoch(
    weighting: str, threshold: float, seed: int
) -> None:
    steps, windows = random_walk(seed)
    n_epochs = len(windows) - 1
    distance_m, epochs = distances_of_epochs(steps, n_epochs)
    expected = weighted_distances(distance_m, np.stack([w.prob for w in windows]), threshold)
    _, updates = run(tracker_of(weighting, as_printed()), in_order(steps, windows))
    lengths = np.array([u.step_length_m for u in final(updates)])
    assert len(lengths) == len(steps)
    total = [lengths[epochs <= k].sum() for k in range(1, n_epochs + 1)]
    np.testing.assert_allclose(total, expected.total_final_m, atol=1e-12)


@pytest.mark.parametrize(("weighting", "threshold"), [("hc", HC), ("wc", 0.8)])
def test_the_provisional_position_at_the_end_of_an_epoch_is_its_total_provisional_distance(
    weighting: str, threshold: float
) -> None:
    steps, windows = random_walk(1)
    steps = [replace(s, device_heading_rad=0.0) for s in steps]
    straight = tracker_of(
        weighting,
        replace(as_printed(), modes=tuple(replace(m, heading_offset_rad=0.0) for m in mode_of_each_context())),
    )
    distance_m, epochs = distances_of_epochs(steps, len(windows) - 1)
    expected = weighted_distances(distance_m, np.stack([w.prob for w in windows]), threshold)
    _, updates = run(straight, in_order(steps, windows))
    provisional = {u.index: u for u in updates if not u.is_final}
    for k in sorted(set(epochs)):
        last_of_epoch = int(np.flatnonzero(epochs == k)[-1])
        north_m = provisional[last_of_epoch].position_m[1]
        assert north_m == pytest.approx(expected.total_provisional_m[k - 1], abs=1e-12)


@pytest.mark.parametrize("weighting", ["hc", "wc"])
def test_a_published_detector_decides_once_about_a_step_and_only_for_contexts_with_steps(weighting: str) -> None:
    step = a_step(1.5)
    lengths = {c: mode_of_each_context()[c].step_length.predict(step)[0] for c in (WALKING, RUNNING)}
    decided = replace(recipes.zhou2019(), tracker=DetectedStepTracker(model())).with_weighting(weighting).tracker
    for around, following, expected in (
        (RUNNING, WALKING, RUNNING),
        (RUNNING, STATIONARY, RUNNING),
        (STATIONARY, RUNNING, WALKING),
    ):
        windows = [WindowContext(t, sure(c, 1.0), EVEN_PRIOR) for t, c in ((2.0, around), (3.0, following))]
        _, updates = run(decided, in_order([step], windows))
        assert [u.step_length_m for u in final(updates)] == pytest.approx([lengths[expected]], abs=1e-12)
        # the step is final as soon as the window around it is known
        state, _ = updates_of(decided.on_step(decided.init(), step))
        assert len(final(updates_of(decided.on_window(state, windows[0]))[1])) == 1


@pytest.mark.parametrize("weighting", ["hc", "wc"])
def test_every_provisional_update_is_followed_by_one_final_update_of_its_index(weighting: str) -> None:
    steps, windows = random_walk(2)
    _, updates = run(tracker(weighting), in_order(steps, windows))
    assert [u.index for u in final(updates)] == list(range(len(steps)))
    assert [u.index for u in updates if not u.is_final] == list(range(len(steps)))
    for index, step in enumerate(steps):
        first, last = [u for u in updates if u.index == index]
        assert (first.is_final, last.is_final) == (False, True)
        assert first.step == last.step == step


@pytest.mark.parametrize("weighting", ["hc", "wc", "imm"])
def test_a_certain_context_gives_the_length_and_direction_of_its_mode(weighting: str) -> None:
    sideways = CONTEXTS.index("sideways")
    windows = [WindowContext(float(t), sure(sideways), EVEN_PRIOR) for t in range(2, 60)]
    steps = [a_step(2.1 + 0.5 * k, heading_rad=0.3) for k in range(110)]
    _, updates = run(tracker(weighting), in_order(steps, windows))
    last = final(updates)[-1]
    assert last.step_length_m == pytest.approx(0.4, abs=0.005)
    assert last.walking_heading_rad == pytest.approx(0.3 + np.pi / 2, abs=0.05)
    assert last.mode_prob[sideways] > 0.97
    late = final(updates)[-1].position_m - final(updates)[-21].position_m
    np.testing.assert_allclose(late, 20 * 0.4 * np.array([np.cos(0.3), -np.sin(0.3)]), atol=0.4)


# --- IMM ------------------------------------------------------------------------------------------------------------


def test_imm_with_one_mode_is_a_plain_extended_kalman_filter() -> None:
    mode, noise = mode_of_each_context()[WALKING], MotionNoise()
    single = ImmTracker(PedestrianModel((mode,), np.ones((1, 1)), noise=noise))
    steps, windows = random_walk(4)
    x, P = np.zeros(4), np.diag([0.0, 0.0, noise.initial_heading_offset_std_rad**2, noise.log_scale_std**2])
    state = single.init()
    for window in windows[:3]:  # evidence has no effect with a single mode
        state, _ = updates_of(single.on_window(state, window))
    rng = np.random.default_rng(0)
    consider_error_m, last_s = np.zeros((3, 2)), np.nan
    residual_var = mode.step_length.residual_std_m**2
    for k, step in enumerate(steps):
        state, [update] = updates_of(single.on_step(state, step))
        elapsed_s = step.duration_s if np.isnan(last_s) else step.time_s - last_s
        last_s = step.time_s
        length, length_var = mode.step_length.predict(step)
        scaled, psi = length * np.exp(x[3]), step.device_heading_rad + x[2]
        u, v = np.array([np.sin(psi), np.cos(psi)]), np.array([np.cos(psi), -np.sin(psi)])
        F = np.eye(4)
        F[:2, 2], F[:2, 3], F[3, 3] = scaled * v, scaled * u, noise.log_scale_memory
        P[2, 2] += noise.heading_drift.random_walk_rad_per_sqrt_s**2 * elapsed_s
        Q = np.diag([0, 0, 0, noise.log_scale_drift_per_sqrt_step**2])
        own_var = residual_var + step.is_quick_and_soft * length**2 / 3
        of_length = np.exp(x[3]) ** 2 * own_var * np.outer(u, u)
        Q[:2, :2] = of_length + (scaled * mode.heading_std_rad) ** 2 * np.outer(v, v)
        x[:2] += scaled * u
        scale = np.exp(x[3])
        x[3] *= noise.log_scale_memory
        P = F @ P @ F.T + Q
        psi = step.device_heading_rad + x[2]
        u, v = np.array([np.sin(psi), np.cos(psi)]), np.array([np.cos(psi), -np.sin(psi)])
        of_along, of_across = second_order_errors(P[2, 2], P[3, 3])
        of_parameters = np.sqrt(length_var - residual_var)  # an error of the whole person, which adds up over the steps
        consider_error_m += scale * np.array([length * of_along * u, length * of_across * v, of_parameters * u])
        seen = P[:2, :2] + sum(np.outer(e, e) for e in consider_error_m)
        assert (update.index, update.is_final) == (k, True)
        np.testing.assert_allclose(update.position_m, x[:2], atol=1e-9)
        np.testing.assert_allclose(update.position_cov_m2, seen, atol=1e-9)
        if k % 5 == 4:
            z, R = x[:2] + 0.3 * rng.normal(size=2), np.array([[0.5, 0.1], [0.1, 0.4]])
            state, outcome, _ = single.on_fix(state, PositionFix(step.time_s, z, R))
            assert outcome == "used"
            H = np.eye(2, 4)
            P[:2, :2], consider_error_m = seen, np.zeros((3, 2))
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            x, P = x + K @ (z - H @ x), (np.eye(4) - K @ H) @ P
            np.testing.assert_allclose(state.pedestrian.estimates.mean[0], x, atol=1e-9)
            np.testing.assert_allclose(state.pedestrian.estimates.cov[0], P, atol=1e-9)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 1000))
def test_modes_in_another_order_give_the_same_track(seed: int) -> None:
    order = np.random.default_rng(seed).permutation(6)
    rows = np.random.default_rng(seed).dirichlet(np.ones(6), 6)
    straight = ImmTracker(PedestrianModel(mode_of_each_context(), rows))
    permuted = ImmTracker(PedestrianModel(tuple(mode_of_each_context()[i] for i in order), rows[np.ix_(order, order)]))
    events = in_order(*random_walk(seed))
    for a, b in zip(run(permuted, events)[1], run(straight, events)[1], strict=True):
        np.testing.assert_allclose(a.position_m, b.position_m, atol=1e-9)
        np.testing.assert_allclose(a.position_cov_m2, b.position_cov_m2, atol=1e-9)
        np.testing.assert_allclose(a.mode_prob, b.mode_prob[order], atol=1e-9)
        assert a.walked_m == pytest.approx(b.walked_m, abs=1e-9)
        np.testing.assert_allclose(a.context_prob, b.context_prob, atol=1e-9)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 1000))
def test_the_walked_distance_of_the_imm_equals_that_of_a_smoother_at_every_step(seed: int) -> None:
    rows = 0.8 * np.eye(6) + 0.2 * np.random.default_rng(seed).dirichlet(np.ones(6), 6)
    filter_ = ImmTracker(PedestrianModel(mode_of_each_context(), rows))
    _, updates = run(filter_, in_order(*random_walk(seed)))
    length_m = np.array([filter_.model.lengths(u.step)[0] for u in updates])
    prob = np.array([u.mode_prob for u in updates])
    for k in (0, 5, len(updates) // 2, len(updates) - 1):
        smoothed = imm.smoothed_mode_prob(prob[: k + 1], rows)
        assert updates[k].walked_m == pytest.approx((smoothed * length_m[: k + 1]).sum(), rel=1e-9)
    assert updates[-1].walked_m != pytest.approx(sum(u.step_length_m for u in updates), rel=1e-9)


def test_a_change_of_mode_detected_late_counts_from_its_beginning() -> None:
    filter_ = ImmTracker(PedestrianModel(mode_of_each_context(), even_transitions(6, 0.97)))
    windows = [WindowContext(float(t), sure(WALKING if t < 12 else RUNNING, 0.95), EVEN_PRIOR) for t in range(2, 30)]
    steps = [a_step(t) for t in np.arange(2.0, 28.0, 0.5)]
    # every window is two seconds late
    late = sorted(
        [(w.time_s + 2.0, 0, w) for w in windows] + [(s.time_s, 1, s) for s in steps], key=lambda timed: timed[:2]
    )
    _, updates = run(filter_, [event for *_, event in late])
    walking_m, running_m = (filter_.model.lengths(steps[0])[0][c] for c in (WALKING, RUNNING))
    n_walked = sum(s.time_s < 12.0 for s in steps)
    known_m = n_walked * walking_m + (len(steps) - n_walked) * running_m
    at_once_m = sum(u.step_length_m for u in updates)
    assert abs(updates[-1].walked_m - known_m) < 0.5 * abs(at_once_m - known_m)


@pytest.mark.parametrize("weighting", ["hc", "wc", "imm"])
def test_a_step_too_quick_for_walking_and_too_soft_for_running_may_have_up_to_twice_its_length(
    weighting: str,
) -> None:
    filter_ = tracker(weighting)
    quick = replace(a_step(0.5), frequency_hz=2.6, vertical_amplitude_mps2=5.5)
    soft = replace(quick, vertical_amplitude_mps2=4.5)
    assert soft.is_quick_and_soft and not quick.is_quick_and_soft
    window = WindowContext(0.0, sure(WALKING, 0.95), EVEN_PRIOR)
    (before,), (after,) = (run(filter_, [window, step])[1][-1:] for step in (quick, soft))
    length_m = filter_.model.lengths(soft)[0]
    of_uniform_m2 = float(after.mode_prob @ (2 * length_m) ** 2) / 12
    assert of_uniform_m2 > 0.05
    added_m2 = np.trace(after.position_cov_m2 - before.position_cov_m2)
    assert added_m2 == pytest.approx(of_uniform_m2, rel=1e-9)
    np.testing.assert_allclose(after.position_m, before.position_m)


@pytest.mark.parametrize("weighting", ["hc", "wc"])
def test_with_one_filter_the_walked_distance_is_the_sum_of_the_final_steps(weighting: str) -> None:
    updates = final(run(tracker(weighting), in_order(*random_walk(3)))[1])
    np.testing.assert_allclose([u.walked_m for u in updates], np.cumsum([u.step_length_m for u in updates]), rtol=1e-12)


def test_one_window_is_evidence_for_one_step_only() -> None:
    filter_ = ImmTracker(replace(model(), step_log_odds_stationary=0.0))
    window = WindowContext(2.0, sure(RUNNING, 0.9), EVEN_PRIOR)
    state, _ = updates_of(filter_.on_window(filter_.init(), window))
    state, [first] = updates_of(filter_.on_step(state, a_step(1.5)))
    _, [second] = updates_of(filter_.on_step(state, a_step(2.0)))
    evidence = np.sqrt(window.prob / EVEN_PRIOR)
    np.testing.assert_allclose(first.mode_prob, evidence / evidence.sum(), atol=1e-12)
    np.testing.assert_allclose(second.mode_prob, first.mode_prob @ filter_.model.transition_prob, atol=1e-12)


def test_a_detected_step_is_evidence_against_standing() -> None:
    filter_ = tracker("imm")
    _, [update] = updates_of(filter_.on_step(filter_.init(), a_step()))
    assert update.mode_prob[0] / update.mode_prob[1] == pytest.approx(np.exp(filter_.model.step_log_odds_stationary))


@pytest.mark.parametrize("threshold", [HC, 0.8, 0.0])
def test_hc_and_wc_weight_a_step_by_the_context_probabilities_given_the_step(threshold: float) -> None:
    m = model()
    prob = np.array([0.6, 0.25, 0.15, 0.0, 0.0, 0.0])
    likelihood = np.where(np.arange(6) == STATIONARY, np.exp(m.step_log_odds_stationary), 1.0)
    expected = context_weights(prob * likelihood / (prob @ likelihood), threshold)
    windows = [WindowContext(2.0 + k, prob, EVEN_PRIOR) for k in range(3)]
    _, updates = run(WeightedTracker(m, threshold), in_order([a_step(2.5)], windows))
    [update] = final(updates)
    np.testing.assert_allclose(update.mode_prob, expected, atol=1e-12)
    np.testing.assert_allclose(update.context_prob, prob, atol=1e-12)


def test_a_certain_standstill_of_the_contexts_remains_certain_in_spite_of_a_step() -> None:
    windows = [WindowContext(2.0 + k, sure(STATIONARY), EVEN_PRIOR) for k in range(3)]
    for weighting in ("hc", "wc"):
        _, updates = run(tracker(weighting), in_order([a_step(2.5)], windows))
        np.testing.assert_allclose(final(updates)[0].mode_prob, sure(STATIONARY), atol=1e-12)


# --- all weightings -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("weighting", ["hc", "wc", "imm"])
@pytest.mark.parametrize("turn_rad", [np.pi / 2, -2.0])
def test_rotating_all_headings_rotates_the_track(weighting: str, turn_rad: float) -> None:
    steps, windows = random_walk(5)
    turned_steps = [replace(s, device_heading_rad=s.device_heading_rad + turn_rad) for s in steps]
    straight = final(run(tracker(weighting), in_order(steps, windows))[1])
    turned = final(run(tracker(weighting), in_order(turned_steps, windows))[1])
    rotation = clockwise(turn_rad)
    for a, b in zip(turned, straight, strict=True):
        np.testing.assert_allclose(a.position_m, rotation @ b.position_m, atol=1e-9)
        np.testing.assert_allclose(a.position_cov_m2, rotation @ b.position_cov_m2 @ rotation.T, atol=1e-9)
        assert a.step_length_m == pytest.approx(b.step_length_m)


@pytest.mark.parametrize("weighting", ["hc", "wc", "imm"])
def test_covariances_are_symmetric_positive_and_grow_without_fixes(weighting: str) -> None:
    updates = final(run(tracker(weighting), in_order(*random_walk(6)))[1])
    for u in updates:
        np.testing.assert_allclose(u.position_cov_m2, u.position_cov_m2.T, atol=1e-12)
        assert np.linalg.eigvalsh(u.position_cov_m2).min() > 0
        assert u.mode_prob.sum() == pytest.approx(1.0)
        assert u.context_prob.sum() == pytest.approx(1.0)
    assert np.trace(updates[-1].position_cov_m2) > np.trace(updates[0].position_cov_m2)


@pytest.mark.parametrize("weighting", ["hc", "wc", "imm"])
def test_an_accepted_fix_moves_the_position_and_reduces_the_covariance(weighting: str) -> None:
    filter_ = tracker(weighting)
    steps, windows = random_walk(7)
    state, _ = run(filter_, in_order(steps, windows))
    position, cov = position_of(state)
    fix_m = position + 0.5 * np.sqrt(np.diag(cov))
    fixed, outcome, _ = filter_.on_fix(state, PositionFix(20.0, fix_m, 0.01 * np.eye(2)))
    new_position, new_cov = position_of(fixed)
    assert np.linalg.norm(new_position - fix_m) < 0.1 * np.linalg.norm(position - fix_m)
    assert np.trace(new_cov) < 0.1 * np.trace(cov)
    assert outcome == "used"
    np.testing.assert_array_equal(position_of(state)[0], position)


@pytest.mark.parametrize("weighting", ["hc", "wc", "imm"])
def test_a_fix_that_no_mode_explains_is_rejected_and_changes_no_estimate(weighting: str) -> None:
    filter_ = tracker(weighting)
    state, _ = run(filter_, in_order(*random_walk(8)))
    after, outcome, nis = filter_.on_fix(state, PositionFix(20.0, np.array([1000.0, 0.0]), np.eye(2)))
    assert outcome == "rejected" and nis > filter_.model.fix_gate_nis
    for name in ("estimates", "steps", "frame", "heading_zero"):
        assert getattr(after.pedestrian, name) is getattr(state.pedestrian, name)


@pytest.mark.parametrize("weighting", ["hc", "wc", "imm"])
def test_a_speed_or_a_heading_fix_before_any_step_changes_nothing(weighting: str) -> None:
    filter_ = tracker(weighting)
    state = filter_.init()
    for fix in (SpeedFix(0.5, 1.3, 0.2), HeadingFix(0.5, 1.0, 0.2)):
        after, outcome, nis = filter_.on_fix(state, fix)
        assert outcome == "nothing to compare" and np.isnan(nis)
        assert after.pedestrian.estimates is state.pedestrian.estimates


# --- late steps ------------------------------------------------------------------------------------------------------


def test_a_late_step_is_weighted_by_the_windows_of_its_own_time() -> None:
    windows = [
        WindowContext(t, sure(WALKING if t < 5 else RUNNING), EVEN_PRIOR) for t in (2.0, 3.0, 4.0, 5.0, 6.0, 7.0)
    ]
    for weighting in ("imm", "wc", "hc"):
        filter_ = tracker(weighting)
        state = filter_.init()
        for window in windows:
            state, _ = updates_of(filter_.on_window(state, window))
        _, updates = updates_of(filter_.on_step(state, a_step(2.5)))
        assert updates[0].context_prob[WALKING] == 1.0


def test_the_imm_uses_each_window_once_for_steps_of_any_delay() -> None:
    filter_ = tracker("imm")
    window = WindowContext(2.0, sure(RUNNING, 0.9), EVEN_PRIOR)
    state, _ = updates_of(filter_.on_window(filter_.init(), window))
    state, [first] = updates_of(filter_.on_step(state, a_step(1.4)))
    for late_s in (3.0, 4.0, 5.0):
        state, _ = updates_of(filter_.on_window(state, WindowContext(late_s, sure(WALKING), EVEN_PRIOR)))
    _, [second] = updates_of(filter_.on_step(state, a_step(1.9)))
    # between the two steps only the transitions change the probabilities
    moved = (
        first.mode_prob
        @ filter_.model.transition_prob
        * np.exp(np.where(np.arange(6) == STATIONARY, filter_.model.step_log_odds_stationary, 0.0))
    )
    np.testing.assert_allclose(second.mode_prob, moved / moved.sum(), atol=1e-12)


# --- gaps and ends --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("weighting", ["hc", "wc"])
def test_a_gap_makes_pending_steps_final_with_the_windows_of_their_segment(weighting: str) -> None:
    filter_ = tracker(weighting)
    state, _ = updates_of(filter_.on_window(filter_.init(), WindowContext(2.0, sure(WALKING), EVEN_PRIOR)))
    state, _ = updates_of(filter_.on_step(state, a_step(1.6)))
    waiting = filter_.provisional(state)
    assert waiting is not None
    state, updates = updates_of(filter_.on_gap(state, 5.0))
    assert filter_.provisional(state) is None
    assert [(u.index, u.is_final) for u in updates] == [(waiting.index, True)]
    assert updates[0].mode_prob[WALKING] == 1.0
    state, late = updates_of(filter_.on_window(state, WindowContext(9.0, sure(RUNNING), EVEN_PRIOR)))
    assert late == []


@pytest.mark.parametrize("weighting", ["hc", "wc"])
def test_after_a_gap_windows_of_the_segment_before_are_not_used(weighting: str) -> None:
    filter_ = tracker(weighting)
    state, _ = updates_of(filter_.on_window(filter_.init(), WindowContext(2.0, sure(RUNNING), EVEN_PRIOR)))
    state, _ = updates_of(filter_.on_gap(state, 5.0))
    state, _ = updates_of(filter_.on_step(state, a_step(7.5)))
    provisional = filter_.provisional(state)
    assert provisional is not None
    assert provisional.context_prob[RUNNING] == pytest.approx(1 / 6)
    _, updates = run(filter_, [WindowContext(t, sure(WALKING), EVEN_PRIOR) for t in (9.0, 10.0)], state)
    assert [u.mode_prob[WALKING] for u in final(updates)] == [1.0]


def test_after_a_gap_the_previous_window_is_not_evidence_for_the_imm() -> None:
    filter_ = tracker("imm")
    with_window, _ = updates_of(filter_.on_window(filter_.init(), WindowContext(2.0, sure(RUNNING), EVEN_PRIOR)))
    probs = []
    for state in (with_window, filter_.init()):
        state, _ = updates_of(filter_.on_gap(state, 5.0))
        probs.append(updates_of(filter_.on_step(state, a_step(7.5)))[1][0])
    np.testing.assert_array_equal(probs[0].mode_prob, probs[1].mode_prob)
    np.testing.assert_array_equal(probs[0].context_prob, probs[1].context_prob)


def test_the_first_window_of_a_segment_is_evidence_for_the_steps_from_its_beginning_on() -> None:
    filter_ = tracker("imm")
    first, second = (WindowContext(t, sure(c, 0.95), EVEN_PRIOR) for t, c in ((2.0, RUNNING), (3.0, WALKING)))
    state, _ = run(filter_, [first, second])
    state, [early] = updates_of(filter_.on_step(state, a_step(0.4)))
    assert early.mode_prob[RUNNING] > 0.5
    np.testing.assert_array_equal(early.context_prob, first.prob)
    _, [later] = updates_of(filter_.on_step(state, a_step(1.2)))
    np.testing.assert_array_equal(later.context_prob, first.prob)


@pytest.mark.parametrize("weighting", ["hc", "wc", "imm"])
def test_a_gap_makes_the_position_less_certain_and_does_not_move_it(weighting: str) -> None:
    filter_ = tracker(weighting)
    state, _ = run(filter_, in_order(*random_walk(9)))
    after, _ = updates_of(filter_.on_gap(state, 10.0))
    np.testing.assert_array_equal(position_of(after)[0], position_of(state)[0])
    grown = np.diag(position_of(after)[1] - position_of(state)[1])
    np.testing.assert_allclose(grown, (filter_.model.noise.gap_speed_mps * 10.0) ** 2)


@pytest.mark.parametrize("weighting", ["hc", "wc", "imm"])
def test_without_any_window_steps_are_still_tracked(weighting: str) -> None:
    steps, _ = random_walk(10)
    _, updates = run(tracker(weighting), list(steps))
    assert len(final(updates)) == len(steps)
    assert np.isfinite([u.position_m for u in updates]).all()


def test_the_first_imm_step_is_the_mixture_of_the_steps_of_all_modes() -> None:
    filter_ = tracker("imm")
    mean, cov = initial_estimate(filter_.model.noise)
    step = a_step(heading_rad=0.4)
    length, variance = np.transpose([m.step_length.predict(step) for m in mode_of_each_context()])
    moved = advance(
        np.tile(mean, (6, 1)),
        np.tile(cov, (6, 1, 1)),
        step,
        length,
        variance,
        Directions.of(mode_of_each_context()),
        filter_.model.noise,
    ).mean
    _, [update] = updates_of(filter_.on_step(filter_.init(), step))
    np.testing.assert_allclose(update.position_m, update.mode_prob @ moved[:, :2], atol=1e-12)
    assert update.step_length_m == pytest.approx(update.mode_prob @ length)


def test_rotating_the_frame_rotates_the_shared_errors() -> None:
    filter_ = tracker("imm")
    state, _ = run(filter_, in_order(*random_walk(5)))
    known = state.pedestrian
    assert np.linalg.norm(known.estimates.consider_error_m) > 0.1
    turn = Alignment(0.7, 0.0, np.zeros(2), np.zeros(2), 0.0, known.steps.n_final)
    before, after = reckoned_position(known)[1], reckoned_position(in_other_frame(known, turn))[1]
    np.testing.assert_allclose(after, turn.rotation @ before @ turn.rotation.T, atol=1e-9)


@pytest.mark.parametrize("weighting", ["hc", "wc", "imm"])
def test_motion_without_steps_adds_its_variance_once_to_the_position_and_to_the_path(weighting: str) -> None:
    chain = WithPath(TrackerHandler(tracker(weighting)))

    def after_events(state: PathState, *events: Any) -> PathState:
        for event in (*events, StepsEnd()):
            state, _ = chain.on(state, event, 0.0)
        return state

    state = after_events(chain.init(), a_step(1.0), Window(WindowContext(2.0, sure(WALKING), EVEN_PRIOR), None))
    moved = after_events(state, Stepless(4.0))
    added = position_cov(moved) - position_cov(state)
    np.testing.assert_allclose(added, stepless_var_m2(4.0) * np.eye(2), atol=1e-12)
    later = Window(WindowContext(22.0, sure(WALKING), EVEN_PRIOR), None)
    usual = after_events(state, a_step(20.0), later)
    for before, stepless_s in ((state, 10.0), (moved, 10.0), (moved, 4.0)):
        after = after_events(before, replace(a_step(20.0), stepless_s=stepless_s), later)
        added = position_cov(after) - position_cov(usual)
        np.testing.assert_allclose(added, stepless_var_m2(stepless_s) * np.eye(2), atol=1e-9)
        # the motion is not added to the step before the pause
        assert (first_var_m2(after) < np.diag(position_cov(state)) + 1e-6).all()


@pytest.mark.parametrize("weighting", ["hc", "wc", "imm"])
def test_motion_before_the_first_step_counts_only_after_a_position_fix(weighting: str) -> None:
    filter_ = tracker(weighting)
    first = replace(a_step(20.0), stepless_s=10.0)
    window = WindowContext(22.0, sure(WALKING), EVEN_PRIOR)
    usual, _ = run(filter_, [replace(first, stepless_s=0.0), window])
    moved = replace_unchecked(filter_.init(), pedestrian=over_stepless(filter_.init().pedestrian, 4.0))
    after, _ = run(filter_, [first, window], moved)
    np.testing.assert_array_equal(position_cov(after), position_cov(usual))
    fixed, outcome, _ = filter_.on_fix(moved, PositionFix(15.0, [0.0, 0.0], 0.25 * np.eye(2)))
    after, _ = run(filter_, [first, window], fixed)
    assert outcome == "used"
    added = position_cov(after) - position_cov(usual) - position_cov(fixed)
    np.testing.assert_allclose(added, stepless_var_m2(6.0) * np.eye(2), atol=1e-9)


@pytest.mark.parametrize("since_m", [0.0, 6.0])
def test_a_lost_heading_leaves_the_centre_of_its_rotation_and_its_variance_as_they_were(since_m: float) -> None:
    state, _ = run(tracker("imm"), [a_step(1.0)])
    known = state.pedestrian
    mean, cov = known.estimates.mean.copy(), np.zeros_like(known.estimates.cov)
    mean[:, :2] = 3.0, 4.0 + since_m
    # the error of a heading offset rotates the part of the walk north of (3, 4), whose own variance is 0.5
    by_error = np.array([since_m, 0.0, 1.0, 0.0])
    cov[:] = np.outer(by_error, by_error) + np.diag([0.5, 0.5, 0.0, 0.01])
    no_error_m = np.zeros_like(known.estimates.consider_error_m)
    estimates = replace(known.estimates, mean=mean, cov=cov, consider_error_m=no_error_m)
    reopened = with_reopened_rotation(replace_unchecked(known, estimates=estimates))
    (centre,) = reopened.frame.pairs
    np.testing.assert_allclose([*centre.track_m, *centre.world_m], [3.0, 4.0, 3.0, 4.0], atol=1e-9)
    assert (centre.var_m2, reopened.frame.north_var_rad2) == pytest.approx((0.5, 1.0))


def first_var_m2(state: PathState) -> np.ndarray:
    x, P = state.pedestrian.estimates.combined
    return state.path.positions(P, np.zeros((2, 2)), x[:2])[2][[0, 2], 0]


def position_cov(state: State) -> np.ndarray:
    return state.pedestrian.estimates.combined[1][:2, :2]
