"""Transitions and exponents recover those of synthetic sequences and agree with the formulas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdr_filter.filter.imm.imm import check_transition_prob
from pdr_filter.filter.imm.weighting import context_log_evidence
from pdr_filter.offline.training.context_sequences import (
    UNKNOWN,
    LabelledProbabilities,
    count_transitions,
    estimate_transitions,
    filter_windows,
    fit_tempering,
    log_loss_by_person,
)
from pdr_filter.recipes import context_transitions
from pdr_filter.values import CONTEXTS
from pdr_filter.values.mixtures import posterior_prob

CHAIN = np.array([[0.90, 0.07, 0.03], [0.02, 0.95, 0.03], [0.10, 0.10, 0.80]])


def drawn_chain(n: int, seed: int, transition_prob: np.ndarray = CHAIN) -> np.ndarray:
    chance, bounds = np.random.default_rng(seed).random(n).tolist(), transition_prob.cumsum(axis=1)[:, :-1].tolist()
    label, now = np.zeros(n, dtype=np.int64), 0
    for k in range(1, n):
        now = sum(chance[k] > bound for bound in bounds[now])
        label[k] = now
    return label


def drawn_windows(
    n_people: int, n: int, repeats: int = 1, prior_in: float = 1.0, seed: int = 0
) -> LabelledProbabilities:
    """Return posteriors of Gaussian features of a chain, with `repeats` times the evidence, and the prior with an
    exponent.
    """
    rng = np.random.default_rng(seed)
    prior = np.array([0.6, 0.3, 0.1])
    label = np.concatenate([drawn_chain(n, seed + p) for p in range(n_people)])
    feature = label + 0.8 * rng.normal(size=len(label))
    log_likelihood = -0.5 * ((feature[:, None] - np.arange(3)) / 0.8) ** 2
    log_post = repeats * log_likelihood + prior_in * np.log(prior)
    prob = np.exp(log_post - log_post.max(axis=1, keepdims=True))
    person = np.repeat([f"p{i}" for i in range(n_people)], n)
    prob /= prob.sum(axis=1, keepdims=True)
    return LabelledProbabilities(prob, np.tile(prior, (len(label), 1)), label, person, person)


# --- Transitions


def test_counts_are_those_of_a_sequence_counted_by_hand() -> None:
    label = np.array([0, 0, 1, 1, 1, 2, 0, 0])
    counts = count_transitions(label, np.array(["a"] * 8), 3)
    np.testing.assert_array_equal(counts, [[2, 1, 0], [0, 2, 1], [1, 0, 0]])


def test_the_end_of_a_sequence_and_an_unknown_context_have_no_successor() -> None:
    label = np.array([0, 1, 1, 0, UNKNOWN, 1])
    counts = count_transitions(label, np.array(["a", "a", "b", "b", "b", "b"]), 2)
    np.testing.assert_array_equal(counts, [[0, 1], [1, 0]])


def test_a_window_counts_as_its_number_of_steps() -> None:
    label, sequence = np.array([0, 0, 0, 1, 1]), np.array(["a"] * 5)
    counts = count_transitions(label, sequence, 2, steps=np.full(5, 2.0))
    np.testing.assert_array_equal(counts, [[5, 1], [0, 2]])
    standing = count_transitions(label, sequence, 2, steps=np.zeros(5))
    np.testing.assert_array_equal(standing, [[0, 1], [0, 0]])  # more changes than steps


def test_a_transition_matrix_is_recovered_from_steps_and_from_windows_of_two_steps() -> None:
    slow = 0.95 * np.eye(3) + 0.05 * CHAIN  # changes are rare within a window, as in walks
    label = drawn_chain(200_000, 1, slow)
    sequence = np.zeros(len(label), dtype="U1")
    of_steps = estimate_transitions(count_transitions(label, sequence, 3), np.full((3, 3), 1 / 3), 1.0)
    np.testing.assert_allclose(of_steps, slow, atol=0.002)
    windows = label[::2]
    counts = count_transitions(windows, sequence[::2], 3, steps=np.full(len(windows), 2.0))
    np.testing.assert_allclose(estimate_transitions(counts, np.full((3, 3), 1 / 3), 1.0), slow, atol=0.002)


def test_the_estimate_is_the_mean_of_the_dirichlet_posterior() -> None:
    counts, prior = np.array([[8.0, 2.0], [0.0, 0.0]]), np.array([[0.5, 0.5], [0.1, 0.9]])
    np.testing.assert_allclose(estimate_transitions(counts, prior, 10.0), [[13 / 20, 7 / 20], [0.1, 0.9]])


def test_without_data_the_default_transitions_are_kept() -> None:
    prior = context_transitions()
    np.testing.assert_allclose(estimate_transitions(np.zeros_like(prior), prior), prior, atol=1e-15)


@given(st.integers(0, 2**31), st.integers(1, 400), st.floats(1e-3, 1e4))
def test_every_estimate_is_a_valid_transition_matrix_for_a_tracker(seed: int, n: int, prior_steps: float) -> None:
    rng = np.random.default_rng(seed)
    label = rng.integers(UNKNOWN, len(CONTEXTS), n)
    sequence = np.sort(rng.integers(0, 4, n)).astype(str)
    counts = count_transitions(label, sequence, len(CONTEXTS), steps=rng.uniform(0, 4, n))
    found = estimate_transitions(counts, context_transitions(), prior_steps)
    check_transition_prob(found, len(CONTEXTS))
    assert (found > 0).all()  # no context is ruled out for good


def test_a_person_who_never_climbs_leaves_level_walking_less_often_than_by_default() -> None:
    walking = np.full(2000, CONTEXTS.index("walking"))
    found = estimate_transitions(count_transitions(walking, np.full(2000, "a"), 6), context_transitions())
    assert found[1, 1] == pytest.approx((1999 + 100 * context_transitions()[1, 1]) / 2099)


# --- Tempering


def test_filtered_windows_equal_the_results_of_the_filters_functions() -> None:
    windows = drawn_windows(2, 50)
    expected, p = [], np.full(3, 1 / 3)
    for k in range(100):
        p = np.full(3, 1 / 3) if k == 50 else p
        evidence = context_log_evidence(windows.prob[k], windows.training_prior[k], 0.5, 0.01, 0.25)
        p = posterior_prob(p @ CHAIN, evidence)
        expected.append(p)
    np.testing.assert_allclose(filter_windows(windows, CHAIN, 0.5, 0.25, 0.01), expected, atol=1e-12)


def test_with_the_true_exponents_the_filter_equals_the_forward_algorithm() -> None:
    windows = drawn_windows(1, 30)
    likelihood = windows.prob / windows.training_prior
    alpha, expected = np.full(3, 1 / 3), []
    for row in likelihood:
        alpha = (alpha @ CHAIN) * row
        expected.append(alpha / alpha.sum())
    np.testing.assert_allclose(filter_windows(windows, CHAIN, 1.0, 1.0, 1e-300), expected, atol=1e-12)


@pytest.mark.parametrize(("repeats", "prior_in"), [(1, 1.0), (2, 0.6), (4, 0.0)])
def test_the_true_exponents_of_synthetic_windows_are_recovered(repeats: int, prior_in: float) -> None:
    # Evidence counted `repeats` times needs the exponent 1 / repeats; prior^prior_in in it, that exponent of the prior.
    windows = drawn_windows(6, 800, repeats, prior_in)
    found = fit_tempering(windows, CHAIN, floor=1e-12)
    assert found.evidence_exponent == pytest.approx(1 / repeats, abs=0.11)
    assert found.prior_exponent == pytest.approx(prior_in, abs=0.31 * repeats)


def test_tempering_lowers_the_log_loss_of_held_out_people() -> None:
    windows = drawn_windows(6, 600, repeats=3)
    found = fit_tempering(windows, CHAIN, floor=1e-6)
    as_it_is = log_loss_by_person(windows, CHAIN, np.ones(1), np.ones(1), 1e-6)[1].mean()
    assert found.log_loss <= found.held_out_log_loss < as_it_is - 0.05


def test_the_held_out_loss_uses_the_exponents_chosen_on_all_other_people() -> None:
    windows = drawn_windows(3, 80, repeats=2)
    found = fit_tempering(windows, CHAIN)
    losses: list[float] = []
    for person in np.unique(windows.person):
        others, own = windows.person != person, windows.person == person
        choice = fit_tempering(part_of(windows, others), CHAIN)
        exponents = np.array([choice.evidence_exponent]), np.array([choice.prior_exponent])
        losses.append(float(log_loss_by_person(part_of(windows, own), CHAIN, *exponents, 0.01)[1][0, 0]))
    assert found.held_out_log_loss == pytest.approx(np.mean(losses), rel=1e-12)


def part_of(windows: LabelledProbabilities, use: np.ndarray) -> LabelledProbabilities:
    return LabelledProbabilities(*(getattr(windows, n)[use] for n in windows.__dataclass_fields__))


def test_every_person_has_the_same_weight_whatever_the_length_of_the_recording() -> None:
    windows = drawn_windows(2, 200)
    short = part_of(windows, np.r_[0:200, 200:240])
    people, loss = log_loss_by_person(short, CHAIN, np.array([0.5]), np.array([0.5]), 0.01)
    assert people == ("p0", "p1")
    result = filter_windows(short, CHAIN, 0.5, 0.5, 0.01)
    of_truth = -np.log(result[np.arange(240), short.label])
    np.testing.assert_allclose(loss[0], [of_truth[:200].mean(), of_truth[200:].mean()])


def test_windows_of_unknown_context_are_filtered_but_not_scored() -> None:
    windows = drawn_windows(1, 60)
    hidden = replace(windows, label=np.where(np.arange(60) % 2, UNKNOWN, windows.label))
    result = filter_windows(windows, CHAIN, 0.5, 0.5, 0.01)
    np.testing.assert_array_equal(filter_windows(hidden, CHAIN, 0.5, 0.5, 0.01), result)
    loss = log_loss_by_person(hidden, CHAIN, np.array([0.5]), np.array([0.5]), 0.01)[1][0, 0]
    assert loss == pytest.approx(-np.log(result[np.arange(0, 60, 2), windows.label[::2]]).mean())


@settings(max_examples=30)
@given(st.integers(0, 2**31))
def test_filtered_probabilities_are_valid_for_classifier_probabilities_of_zero(seed: int) -> None:
    rng = np.random.default_rng(seed)
    prob = np.eye(3)[rng.integers(0, 3, 40)]
    prior = np.tile([0.7, 0.3, 0.0], (40, 1))
    names = np.full(40, "a")
    windows = LabelledProbabilities(prob, prior, np.zeros(40, dtype=np.int64), names, names)
    result = filter_windows(windows, np.eye(3), 1.5, 1.5, 1e-12)
    assert np.isfinite(result).all()
    np.testing.assert_allclose(result.sum(axis=1), 1.0)


def test_one_person_has_no_held_out_loss() -> None:
    found = fit_tempering(drawn_windows(1, 40), CHAIN)
    assert np.isnan(found.held_out_log_loss)
    assert np.isfinite(found.log_loss)
