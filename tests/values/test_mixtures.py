# ruff: noqa: N806 - the letters of the equations
"""Probabilities of hypotheses and moments of mixtures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import logsumexp

from pdr_filter.values.mixtures import combine, log_sum, possible_outlier, posterior_prob, reweighted_prob, softmax

SEEDS = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("offset", [-1e6, 0.0, 1e6])
def test_softmax_and_log_sum_do_not_overflow_and_agree_with_scipy(offset: float) -> None:
    log_weight = np.random.default_rng(1).normal(size=(3, 7)) * 20 + offset
    np.testing.assert_allclose(
        softmax(log_weight), np.exp(log_weight - logsumexp(log_weight, axis=1, keepdims=True)), atol=1e-9
    )
    assert log_sum(log_weight[0]) == pytest.approx(float(logsumexp(log_weight[0])), abs=1e-12, rel=1e-14)


@given(seed=SEEDS)
def test_finite_evidence_gives_the_same_probabilities_with_and_without_logarithms(seed: int) -> None:
    rng = np.random.default_rng(seed)
    prob, evidence = rng.dirichlet(np.ones(6), 3), 5 * rng.normal(size=(3, 6))
    np.testing.assert_allclose(reweighted_prob(prob, evidence), posterior_prob(prob, evidence), atol=1e-13)


def test_a_possible_outlier_gives_the_moments_of_the_mixture_of_both_cases() -> None:
    variance, noise, innovation, outlier_prob, density = np.array([2.0, 0.5]), 1.0, np.array([1.5, -0.2]), 0.3, 0.05
    S = variance + noise
    inlier = (1 - outlier_prob) * np.exp(-0.5 * innovation**2 / S) / np.sqrt(2 * np.pi * S)
    log_any, prob, by_mean, by_cov = possible_outlier(
        np.log(inlier), float(np.log(outlier_prob * density)), innovation / S, S
    )
    np.testing.assert_allclose(np.exp(log_any), inlier + outlier_prob * density)
    for k in range(2):
        gain = variance[k] / S[k]
        both = np.array([[gain * innovation[k]], [0.0]]), np.array([[[(1 - gain) * variance[k]]], [[variance[k]]]])
        mean, cov = combine(*both, np.array([prob[k], 1 - prob[k]]))
        assert by_mean[k] * variance[k] == pytest.approx(mean[0])
        assert variance[k] + by_cov[k] * variance[k] ** 2 == pytest.approx(cov[0, 0])


def test_mode_probabilities_follow_bayes() -> None:
    prob = posterior_prob(np.array([0.5, 0.3, 0.2]), np.log([0.1, 0.2, 0.4]))
    np.testing.assert_allclose(prob, np.array([0.05, 0.06, 0.08]) / 0.19)


@given(seed=SEEDS, offset=st.sampled_from([-1e6, -1e4, 1e6]))
def test_only_differences_of_log_likelihoods_matter(seed: int, offset: float) -> None:
    rng = np.random.default_rng(seed)
    prior, log_likelihood = rng.dirichlet(np.ones(4)), 10 * rng.normal(size=4)
    shifted = posterior_prob(prior, log_likelihood + offset)
    np.testing.assert_allclose(shifted, posterior_prob(prior, log_likelihood), atol=1e-8)
    assert shifted.sum() == pytest.approx(1.0)


def test_a_mode_of_probability_zero_stays_at_zero_without_a_warning() -> None:
    prob = posterior_prob(np.array([0.0, 0.4, 0.6]), np.array([50.0, -1.0, -1.0]))
    np.testing.assert_allclose(prob, [0.0, 0.4, 0.6])
    assert prob[0] == 0.0


@pytest.mark.parametrize(
    "log_likelihood",
    [np.array([np.nan, 0.0]), np.full(2, np.nan), np.full(2, -np.inf), np.array([np.inf, 0.0])],
    ids=["one nan", "all nan", "all impossible", "infinite"],
)
def test_invalid_evidence_leaves_the_prediction(log_likelihood: np.ndarray) -> None:
    prior = np.array([0.7, 0.3])
    np.testing.assert_array_equal(posterior_prob(prior, log_likelihood), prior)


def test_evidence_against_the_only_possible_mode_leaves_the_prediction() -> None:
    prior = np.array([1.0, 0.0])
    np.testing.assert_array_equal(posterior_prob(prior, np.array([-np.inf, 0.0])), prior)


def test_combining_gives_the_moments_of_the_mixture() -> None:
    x, P = combine(np.array([[0.0], [2.0]]), np.array([[[1.0]], [[3.0]]]), np.array([0.25, 0.75]))
    assert x == pytest.approx([1.5])
    assert P[0, 0] == pytest.approx(0.25 * (1 + 1.5**2) + 0.75 * (3 + 0.5**2))


def test_invalid_evidence_for_one_case_is_still_used_for_the_others() -> None:
    prob = np.array([[0.3, 0.7], [0.3, 0.7], [1.0, 0.0]])
    evidence = np.array([[np.nan, 0.0], [np.log(7.0), np.log(3.0)], [-np.inf, 0.0]])
    np.testing.assert_allclose(posterior_prob(prob, evidence), [[0.3, 0.7], [0.5, 0.5], [1.0, 0.0]])
