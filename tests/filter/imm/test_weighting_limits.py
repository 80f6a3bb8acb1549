"""HC and WC as limits of the IMM, and mode probabilities after extreme evidence and extreme fixes.

The distance of the IMM equals that of HC or WC under these conditions:

1. Its evidence are the weights of HC or WC: `evidence_exponent` 1, `prior_exponent` 0, floor 0 and
   `step_log_odds_stationary` 0. Windows have the weights of HC (one for the highest context) or of WC.
2. It has no memory: all rows of the transition matrix are uniform, and so is every prediction.
3. Every step has a separate window. A window is evidence only once, and a second step in it would have uniform
   probabilities.
4. No fix has estimated the step scale. Modes with different motion would estimate different scales.

HC and WC weight each step with two windows, the one that contains the step and the next one. The IMM uses the one that
contains the step. Its total is therefore that of the provisional distances, and that of the final distances if both
windows agree.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import a_step, even_transitions, mode_of_each_context, updates_of
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pdr_filter.filter.chain.imm_tracker import ImmState, ImmTracker
from pdr_filter.filter.chain.weighted_tracker import WeightedState, WeightedTracker
from pdr_filter.filter.imm.weighting import HC, context_weights, weighted_distances
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.pedestrian_state import StepUpdate
from pdr_filter.values import CONTEXTS, PositionFix, Step, WindowContext, mixtures

N = len(CONTEXTS)
SEEDS = st.integers(0, 2**32 - 1)
THRESHOLDS = {"hc": HC, "wc": 0.8, "wc always": 0.0}


Tracker = ImmTracker | WeightedTracker
State = ImmState | WeightedState


def memoryless(sideways_rad: float = np.pi / 2, **changes: Any) -> ImmTracker:
    model = PedestrianModel(
        mode_of_each_context(sideways_rad),
        np.full((N, N), 1 / N),
        evidence_exponent=1.0,
        prior_exponent=0.0,
        evidence_floor=1e-300,
        step_log_odds_stationary=0.0,
    )
    return ImmTracker(replace(model, **changes))


def weighted(name: str, sideways_rad: float = np.pi / 2) -> WeightedTracker:
    """Return the tracker of a weighting, which does not use the transitions."""
    model = replace(memoryless(sideways_rad).model, transition_prob=even_transitions(N, 0.9))
    return WeightedTracker(model, THRESHOLDS[name])


def walk(seed: int, n_epochs: int, alike_in_pairs: bool = False) -> tuple[list[Step], list[np.ndarray]]:
    """Return one step in each epoch, and the probabilities of the windows that end at 2, 3, 4 s and so on.

    There is one window more than epochs. Epoch k is from k to k + 1 s. Its step is in window k - 1, which ends with the
    epoch; the next one is window k. With `alike_in_pairs` pairs of windows are equal, and only every second epoch has a
    step.
    """
    rng = np.random.default_rng(seed)
    steps = [
        a_step(
            k + rng.uniform(0.01, 0.99),
            heading_rad=rng.normal(),
            duration_s=rng.uniform(0.4, 0.8),
            variance=rng.gamma(2.0),
        )
        for k in range(1, n_epochs + 1)
    ]
    prob = [rng.dirichlet(np.full(N, 0.5)) for _ in range(n_epochs + 1)]
    # sometimes two contexts are equally probable: eq. 19 uses the first
    for p in prob[:: max(n_epochs // 3, 1)]:
        p[[1, 2]] = p[[1, 2]].mean()
    if alike_in_pairs:
        prob = [prob[k - k % 2] for k in range(len(prob))]
        steps = steps[::2]
    return steps, prob


def windows_of(prob: list[np.ndarray], threshold: float | None = None) -> list[WindowContext]:
    """Return windows with these probabilities, or with the weights of HC or WC, and with a non-uniform prior."""
    prior = np.arange(1.0, N + 1) / np.arange(1.0, N + 1).sum()
    said = prob if threshold is None else [context_weights(p, threshold) for p in prob]
    return [WindowContext(2.0 + k, p, prior) for k, p in enumerate(said)]


def run(tracker: Tracker, steps: list[Step], windows: list[WindowContext]) -> tuple[State, list[StepUpdate]]:
    """Return the final updates. A step is detected together with its window."""
    state, updates = tracker.init(), []
    for _, _, event in sorted(
        [*((w.time_s, 0, w) for w in windows), *((np.ceil(s.time_s), 1, s) for s in steps)], key=lambda e: e[:2]
    ):
        if isinstance(event, WindowContext):
            state, found = updates_of(tracker.on_window(state, event))
        else:
            state, found = updates_of(tracker.on_step(state, event))
        updates += found
    state, found = updates_of(tracker.finish(state))
    return state, [u for u in [*updates, *found] if u.is_final]


def length_of(updates: list[StepUpdate]) -> np.ndarray:
    return np.array([u.step_length_m for u in updates])


def distances(steps: list[Step], n_epochs: int) -> np.ndarray:
    """Return the distance (K, N) of each epoch in each context."""
    found = np.zeros((n_epochs, N))
    for step in steps:
        found[int(step.time_s) - 1] += [m.step_length.predict(step)[0] for m in mode_of_each_context()]
    return found


# --- limits ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", THRESHOLDS)
@pytest.mark.parametrize("seed", range(3))
def test_without_memory_every_step_of_the_imm_has_the_provisional_distance_of_hc_and_wc(name: str, seed: int) -> None:
    n_epochs = 60
    steps, prob = walk(seed, n_epochs)
    expected = weighted_distances(distances(steps, n_epochs), np.stack(prob), THRESHOLDS[name])
    _, updates = run(memoryless(), steps, windows_of(prob, THRESHOLDS[name]))
    np.testing.assert_allclose(length_of(updates), expected.provisional_m, atol=1e-12)
    weights = np.stack([context_weights(p, THRESHOLDS[name]) for p in prob[:-1]])
    np.testing.assert_allclose(np.stack([u.mode_prob for u in updates]), weights, atol=1e-12)


def test_with_the_highest_context_the_whole_estimate_is_that_of_hc() -> None:
    """One mode has all of the probability. Its position and covariance are those of HC, also sideways."""
    steps, prob = walk(6, 60, alike_in_pairs=True)
    state, of_imm = run(memoryless(), steps, windows_of(prob, HC))
    other, of_hc = run(weighted("hc"), steps, windows_of(prob))
    for a, b in zip(of_imm, of_hc, strict=True):
        np.testing.assert_allclose(a.position_m, b.position_m, atol=1e-9)
        np.testing.assert_allclose(a.position_cov_m2, b.position_cov_m2, atol=1e-9)
    x, P = state.pedestrian.estimates.combined  # noqa: N806
    np.testing.assert_allclose(x, other.pedestrian.estimates.mean[0], atol=1e-9)
    np.testing.assert_allclose(P, other.pedestrian.estimates.cov[0], atol=1e-9)


# --- extreme evidence ------------------------------------------------------------------------------------------------


def with_mode_prob(state: ImmState, mode_prob: np.ndarray) -> ImmState:
    pedestrian = state.pedestrian
    estimates = replace(pedestrian.estimates, prob=mode_prob)
    return replace(state, pedestrian=replace(pedestrian, estimates=estimates))


def assert_sane(state: State) -> None:
    assert np.isfinite(state.pedestrian.estimates.prob).all()
    assert (state.pedestrian.estimates.prob >= 0).all()
    assert state.pedestrian.estimates.prob.sum() == pytest.approx(1.0)
    assert np.isfinite(state.pedestrian.estimates.mean).all()
    assert np.isfinite(state.pedestrian.estimates.cov).all()
    cov = state.pedestrian.estimates.cov
    # an eigenvalue may be negative only by rounding of the largest entry
    rounding = 1e-9 * np.abs(cov).max()
    np.testing.assert_allclose(cov, cov.swapaxes(-1, -2), rtol=0, atol=rounding)
    assert np.linalg.eigvalsh(cov).min() >= -rounding


odd_log = st.one_of(st.floats(-1e308, 1e308), st.sampled_from([-np.inf, np.nan, 0.0, -800.0, -1e5]))


@settings(max_examples=100, deadline=None)
@given(seed=SEEDS, n_zero=st.integers(0, N - 1), log_likelihood=st.lists(odd_log, min_size=N, max_size=N))
@example(seed=0, n_zero=0, log_likelihood=[-np.inf] * N)
@example(seed=0, n_zero=5, log_likelihood=[-np.inf] * N)
@example(seed=0, n_zero=0, log_likelihood=[np.nan] * N)
@example(seed=0, n_zero=3, log_likelihood=[-1e308, 1e308, 0.0, 0.0, -1e308, 1e308])
def test_mode_probabilities_stay_finite_and_zero_priors_stay_zero_for_any_evidence(
    seed: int, n_zero: int, log_likelihood: list[float]
) -> None:
    rng = np.random.default_rng(seed)
    prior = rng.dirichlet(np.ones(N))
    prior[:n_zero] = 0.0
    prior /= prior.sum()
    with np.errstate(over="ignore"):
        found = mixtures.posterior_prob(prior, np.array(log_likelihood))
    assert np.isfinite(found).all()
    assert (found[:n_zero] == 0).all()
    assert found.sum() == pytest.approx(1.0)
    if not np.isfinite(log_likelihood).any():
        np.testing.assert_array_equal(found, prior)


odd_prob = st.one_of(st.floats(0.0, 1.0), st.sampled_from([0.0, 1.0, np.nan, 1e-300, 5e-324]))


@settings(max_examples=30, deadline=None)
@given(
    seed=SEEDS,
    said=st.lists(st.lists(odd_prob, min_size=N, max_size=N), min_size=1, max_size=8),
    exponent=st.sampled_from([0.5, 1.0, 1e4]),
    floor=st.sampled_from([0.0, 1e-300, 0.01]),
)
@example(seed=0, said=[[0.0] * N], exponent=1.0, floor=0.0)
@example(seed=0, said=[[np.nan] * N] * 3, exponent=0.5, floor=0.01)
def test_invalid_windows_leave_a_valid_state(seed: int, said: list[list[float]], exponent: float, floor: float) -> None:
    rng = np.random.default_rng(seed)
    tracker = memoryless(transition_prob=even_transitions(N, 0.9), evidence_exponent=exponent, evidence_floor=floor)
    prior = np.where(rng.random(N) < 0.3, 0.0, 1.0)
    state = tracker.init()
    for k, prob in enumerate(said):
        state, _ = updates_of(tracker.on_window(state, WindowContext(k + 1.0, np.array(prob), prior)))
        with np.errstate(divide="ignore"):
            state, [update] = updates_of(tracker.on_step(state, a_step(k + 0.7, heading_rad=rng.normal())))
        assert_sane(state)
        assert np.isfinite(update.position_m).all()


def test_evidence_that_excludes_every_mode_is_ignored() -> None:
    tracker = memoryless(evidence_floor=0.0, transition_prob=even_transitions(N, 0.9))
    for prob in (np.zeros(N), np.full(N, np.nan)):
        state, _ = updates_of(tracker.on_window(tracker.init(), WindowContext(1.0, prob, np.full(N, 1 / N))))
        with np.errstate(divide="ignore"):
            _, [told] = updates_of(tracker.on_step(state, a_step(0.7)))
        _, [untold] = updates_of(tracker.on_step(tracker.init(), a_step(0.7)))
        np.testing.assert_allclose(told.mode_prob, untold.mode_prob, atol=1e-12)
        np.testing.assert_allclose(told.position_m, untold.position_m, atol=1e-12)


def test_a_mode_with_prior_zero_becomes_probable_only_by_a_transition() -> None:
    closed = np.array(even_transitions(N, 0.9))
    closed[:, 5] = 0.0
    closed /= closed.sum(axis=1, keepdims=True)
    running = WindowContext(1.0, np.eye(N)[5], np.full(N, 1 / N))
    for transitions, reachable in ((closed, False), (even_transitions(N, 0.9), True)):
        tracker = memoryless(transition_prob=transitions)
        state = with_mode_prob(tracker.init(), np.eye(N)[1])
        state, _ = updates_of(tracker.on_window(state, running))
        state, [update] = updates_of(tracker.on_step(state, a_step(0.7)))
        assert_sane(state)
        assert (update.mode_prob[5] > 0.99) == reachable
        assert (update.mode_prob[5] > 0) == reachable


@settings(max_examples=30, deadline=None)
@given(
    seed=SEEDS,
    log10_away=st.floats(-3, 8),
    log10_std=st.floats(-3, 7),
    gap_s=st.one_of(st.just(0.0), st.floats(0.1, 1e6)),
    n_zero=st.integers(0, N - 1),
)
def test_a_fix_anywhere_leaves_a_valid_state(
    seed: int, log10_away: float, log10_std: float, gap_s: float, n_zero: int
) -> None:
    rng = np.random.default_rng(seed)
    tracker = memoryless(transition_prob=even_transitions(N, 0.9))
    steps, prob = walk(seed, 10)
    state, _ = run(tracker, steps, windows_of(prob))
    mode_prob = np.where(np.arange(N) < n_zero, 0.0, rng.dirichlet(np.ones(N)) + 1e-6)
    state = with_mode_prob(state, mode_prob / mode_prob.sum())
    if gap_s:
        state, _ = updates_of(tracker.on_gap(state, gap_s))
    angle = rng.uniform(0, 2 * np.pi)
    fix_m = 10**log10_away * np.array([np.sin(angle), np.cos(angle)])
    for _ in range(2):
        state, _, _ = tracker.on_fix(state, PositionFix(11.0, fix_m, 10 ** (2 * log10_std) * np.eye(2)))
        assert_sane(state)
        assert (state.pedestrian.estimates.prob[:n_zero] == 0).all()
    state, [update] = updates_of(tracker.on_step(state, a_step(12.0 + gap_s)))
    assert_sane(state)
    assert np.isfinite(update.position_cov_m2).all()
