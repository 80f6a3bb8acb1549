from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.stats import multivariate_normal

from pdr_filter.filter.imm import imm
from pdr_filter.values import mixtures
from tests.oracles.imm_smoother import ModeEstimates, Transition, smooth_imm

H = np.array([[1.0, 0.0]])
R = np.array([[0.5]])


def forward(
    F: np.ndarray, Q: np.ndarray, M: np.ndarray, prior: np.ndarray, measured: np.ndarray
) -> tuple[list[ModeEstimates], list[Transition]]:
    """The filter over measurements of the first state, one at each time; the modes differ in F (M, n, n) and Q."""
    n_modes, n = len(F), F.shape[1]
    mean, cov, prob = np.zeros((n_modes, n)), np.tile(np.eye(n), (n_modes, 1, 1)), prior
    filtered, transitions = [], []
    for k, z in enumerate(measured):
        if k:
            origin, mixed_cov, prob = imm.mix(mean, cov, prob, M)
            mean, cov = imm.predict(origin, mixed_cov, F, Q)
            transitions.append(Transition(M, origin, mean, F, Q))
        mean, cov, log_likelihood, _ = imm.update(mean, cov, np.array([z]), H, R)
        prob = mixtures.posterior_prob(prob, log_likelihood)
        filtered.append(ModeEstimates(mean, cov, prob))
    return filtered, transitions


def two_modes() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A slow and a fast mode of position and speed."""
    F = np.array([[[1.0, 0.3], [0.0, 0.95]], [[1.0, 1.0], [0.0, 1.0]]])
    Q = np.array([0.05, 1.0])[:, None, None] * np.array([[0.4, 0.1], [0.1, 0.5]])
    return F, Q, np.array([[0.8, 0.2], [0.3, 0.7]]), np.array([0.6, 0.4])


def exact(
    F: np.ndarray, Q: np.ndarray, M: np.ndarray, prior: np.ndarray, measured: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Means (K, n) and mode probabilities (K, M) given all measurements: every sequence of modes on its own."""
    K, n_modes, n = len(measured), len(F), F.shape[1]
    weights, means, sequences = [], [], list(product(range(n_modes), repeat=K))
    for sequence in sequences:
        weight = prior[sequence[0]] * np.prod([M[a, b] for a, b in pairwise(sequence)])
        # the joint Gaussian of all states of this sequence
        cov = np.zeros((K * n, K * n))
        blocks = [np.eye(n)]
        for k in range(1, K):
            A = F[sequence[k]]
            blocks.append(A @ blocks[-1] @ A.T + Q[sequence[k]])
        for k in range(K):
            cov[k * n : (k + 1) * n, k * n : (k + 1) * n] = blocks[k]
            carried = blocks[k]
            for later in range(k + 1, K):
                carried = F[sequence[later]] @ carried
                cov[later * n : (later + 1) * n, k * n : (k + 1) * n] = carried
                cov[k * n : (k + 1) * n, later * n : (later + 1) * n] = carried.T
        H_all = np.kron(np.eye(K), H)
        S = H_all @ cov @ H_all.T + R[0, 0] * np.eye(K)
        weights.append(weight * multivariate_normal(np.zeros(K), S).pdf(measured))
        means.append((cov @ H_all.T @ np.linalg.solve(S, measured)).reshape(K, n))
    posterior = np.array(weights) / np.sum(weights)
    prob = np.array([[posterior[[s[k] == m for s in sequences]].sum() for m in range(n_modes)] for k in range(K)])
    return np.einsum("s,ska->ka", posterior, np.array(means)), prob


def test_with_one_mode_it_is_the_rauch_tung_striebel_smoother() -> None:
    F, Q, _, _ = two_modes()
    measured = np.random.default_rng(0).normal(size=12).cumsum()
    filtered, transitions = forward(F[:1], Q[:1], np.ones((1, 1)), np.ones(1), measured)
    smoothed = smooth_imm(filtered, transitions)
    oracle = KalmanFilter(dim_x=2, dim_z=1)
    oracle.F, oracle.Q, oracle.H, oracle.R = F[0], Q[0], H, R
    expected = oracle.rts_smoother(np.stack([e.mean[0] for e in filtered]), np.stack([e.cov[0] for e in filtered]))
    np.testing.assert_allclose([e.mean[0] for e in smoothed], expected[0], atol=1e-9)
    np.testing.assert_allclose([e.cov[0] for e in smoothed], expected[1], atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_modes_that_move_alike_are_smoothed_as_by_forward_and_backward(seed: int) -> None:
    """Evidence of modes from elsewhere; alpha and beta of a hidden Markov model."""
    rng = np.random.default_rng(seed)
    M, prior = rng.dirichlet(np.ones(3), 3), rng.dirichlet(np.ones(3))
    evidence = rng.normal(size=(9, 3))
    still = np.eye(1)[None].repeat(3, axis=0)
    prob, filtered, transitions = prior, [], []
    for k, log_likelihood in enumerate(evidence):
        if k:
            prob = prob @ M
            transitions.append(Transition(M, np.zeros((3, 1)), np.zeros((3, 1)), still, still))
        prob = mixtures.posterior_prob(prob, log_likelihood)
        filtered.append(ModeEstimates(np.zeros((3, 1)), still, prob))
    alpha, beta = [prior * np.exp(evidence[0])], [np.ones(3)]
    for log_likelihood in evidence[1:]:
        alpha.append((alpha[-1] @ M) * np.exp(log_likelihood))
    for log_likelihood in evidence[:0:-1]:
        beta.append(M @ (np.exp(log_likelihood) * beta[-1]))
    gamma = np.array(alpha) * np.array(beta[::-1])
    smoothed = smooth_imm(filtered, transitions)
    np.testing.assert_allclose([e.mode_prob for e in smoothed], gamma / gamma.sum(axis=1, keepdims=True), atol=1e-12)


def test_it_is_closer_to_the_exact_answer_than_the_filter() -> None:
    F, Q, M, prior = two_modes()
    errors = {"filtered": [], "smoothed": []}
    for seed in range(20):
        measured = np.random.default_rng(seed).normal(scale=1.5, size=7).cumsum()
        expected_mean, expected_prob = exact(F, Q, M, prior, measured)
        filtered, transitions = forward(F, Q, M, prior, measured)
        for name, estimates in (("filtered", filtered), ("smoothed", smooth_imm(filtered, transitions))):
            mean = np.array([imm.combine(e.mean, e.cov, e.mode_prob)[0] for e in estimates])
            prob = np.array([e.mode_prob for e in estimates])
            errors[name].append([np.abs(mean - expected_mean).mean(), np.abs(prob - expected_prob).mean()])
    filtered_error, smoothed_error = np.mean(errors["filtered"], axis=0), np.mean(errors["smoothed"], axis=0)
    # an eighth of the error of the states is left, and a bit more than half of that of the modes
    assert (smoothed_error < np.array([0.2, 0.65]) * filtered_error).all(), (smoothed_error, filtered_error)


def test_a_mode_that_is_impossible_in_hindsight_has_no_probability_and_finite_numbers() -> None:
    still = np.eye(1)[None].repeat(2, axis=0)
    filtered = [
        ModeEstimates(np.zeros((2, 1)), still, np.array([0.5, 0.5])),
        ModeEstimates(np.zeros((2, 1)), still, np.array([1.0, 0.0])),
    ]
    smoothed = smooth_imm(filtered, [Transition(np.eye(2), np.zeros((2, 1)), np.zeros((2, 1)), still, still)])
    np.testing.assert_allclose(smoothed[0].mode_prob, [1.0, 0.0])
    assert np.isfinite(smoothed[0].mean).all()
    assert np.isfinite(smoothed[0].cov).all()


def test_the_numbers_of_estimates_and_transitions_have_to_fit() -> None:
    still = np.eye(1)[None]
    one = ModeEstimates(np.zeros((1, 1)), still, np.ones(1))
    with pytest.raises(ValueError, match="2 estimates need 1 transitions, got 0"):
        smooth_imm([one, one], [])
