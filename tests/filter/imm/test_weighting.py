from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdr_filter.filter.imm.weighting import HC, context_log_evidence, context_weights, weighted_distances
from tests.oracles.martinelli2018 import algorithms

SEEDS = st.integers(0, 2**32 - 1)


def random_walk(seed: int, n_epochs: int = 30, concentration: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """Return distances (K, 6) of each epoch and probabilities (K + 1, 6) of each window."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0, 2, (n_epochs, 6)), rng.dirichlet(np.full(6, concentration), n_epochs + 1)


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, threshold=st.sampled_from([None, 0.0, 0.3, 0.8, 1.0]), concentration=st.sampled_from([0.1, 1.0, 20]))
def test_distances_equal_the_printed_algorithms(seed: int, threshold: float | None, concentration: float) -> None:
    distance_m, context_prob = random_walk(seed, concentration=concentration)
    ours = weighted_distances(distance_m, context_prob, HC if threshold is None else threshold)
    for name, expected in algorithms(distance_m, context_prob, threshold).items():
        np.testing.assert_allclose(getattr(ours, name), expected, atol=1e-12, err_msg=name)


def test_weights_are_the_probabilities_from_the_threshold_on() -> None:
    certain, at_threshold = np.array([0.6, 0.1, 0.3]), np.array([0.5, 0.4, 0.1])
    np.testing.assert_array_equal(context_weights(certain, 0.8), [1, 0, 0])
    np.testing.assert_array_equal(context_weights(at_threshold, 0.8), at_threshold)
    np.testing.assert_array_equal(context_weights(at_threshold, 0.81), [1, 0, 0])


def test_for_equal_probabilities_hc_uses_the_first_and_wc_both() -> None:
    tie = np.array([0.1, 0.45, 0.45])
    np.testing.assert_array_equal(context_weights(tie, HC), [0, 1, 0])
    np.testing.assert_array_equal(context_weights(tie, 1.0), tie)
    np.testing.assert_array_equal(context_weights(np.full(6, 1 / 6), HC), [1, 0, 0, 0, 0, 0])


@given(seed=SEEDS, threshold=st.floats(0, 1))
def test_weights_sum_to_one_and_do_not_modify_their_input(seed: int, threshold: float) -> None:
    prob = np.random.default_rng(seed).dirichlet(np.full(6, 0.5))
    before = prob.copy()
    weights = context_weights(prob, threshold)
    assert weights.sum() == pytest.approx(1.0)
    weights = weights + 1  # the result may be the input array, so the input must not change
    np.testing.assert_array_equal(prob, before)


# --- evidence -------------------------------------------------------------------------------------------------------


def test_evidence_is_the_tempered_ratio_of_posterior_and_prior() -> None:
    prob, prior = np.array([0.7, 0.2, 0.1]), np.array([0.5, 0.25, 0.25])
    evidence = context_log_evidence(prob, prior, exponent=0.5, floor=0.01)
    np.testing.assert_allclose(evidence, 0.5 * np.log([1.4, 0.8, 0.4]))


def test_the_prior_exponent_sets_how_far_the_prior_is_divided_out() -> None:
    prob, prior = np.array([0.7, 0.2, 0.1]), np.array([0.5, 0.25, 0.25])
    half, none = (context_log_evidence(prob, prior, 0.25, 0.01, prior_exponent=e) for e in (0.5, 0.0))
    np.testing.assert_allclose(half, 0.25 * np.log(prob / np.sqrt(prior)))
    np.testing.assert_allclose(none, 0.25 * np.log(prob))


def test_the_floor_keeps_one_overconfident_window_from_ruling_a_context_out() -> None:
    evidence = context_log_evidence(np.array([1.0, 0.0]), np.array([0.5, 0.5]), 1.0, 0.01)
    np.testing.assert_allclose(evidence, np.log([2.0, 0.02]))


def test_a_context_that_the_classifier_never_saw_is_unlikely_but_not_impossible() -> None:
    evidence = context_log_evidence(np.array([0.8, 0.2, 0.0]), np.array([0.5, 0.5, 0.0]), 1.0, 0.01)
    np.testing.assert_allclose(evidence, np.log([1.6, 0.4, 0.03]))
    assert np.isfinite(evidence).all()
