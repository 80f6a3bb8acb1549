# ruff: noqa: N803, N806 - the letters of the equations
from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import IMMEstimator, KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from pdr_filter.filter.imm.imm import mix, mixed_values, predict, smoothed_mode_prob, update
from pdr_filter.values.mixtures import combine, posterior_prob

SEEDS = st.integers(0, 2**32 - 1)


def random_cov(rng: np.random.Generator, n: int, size: int = 1) -> np.ndarray:
    root = rng.normal(size=(size, n, n))
    return root @ root.transpose(0, 2, 1) + 0.1 * np.eye(n)


def random_modes(seed: int, n_modes: int = 4, n: int = 3) -> tuple[np.ndarray, ...]:
    """Return means, covariances, mode probabilities and a transition matrix."""
    rng = np.random.default_rng(seed)
    prob = rng.dirichlet(np.ones(n_modes))
    return rng.normal(size=(n_modes, n)), random_cov(rng, n, n_modes), prob, rng.dirichlet(np.ones(n_modes), n_modes)


# --- filterpy -------------------------------------------------------------------------------------------------------

# Constant velocity in two dimensions with noise levels; the transition matrix is not symmetric, so that a
# transposed one is found out.
TRANSITIONS = {
    2: np.array([[0.95, 0.05], [0.2, 0.8]]),
    3: np.array([[0.9, 0.08, 0.02], [0.1, 0.85, 0.05], [0.3, 0.1, 0.6]]),
}
NOISE_LEVELS = (0.01, 1.0, 25.0)
F = np.eye(4) + np.eye(4, k=2)
H = np.eye(2, 4)
R = np.array([[1.0, 0.2], [0.2, 0.7]])
G = np.vstack([0.5 * np.eye(2), np.eye(2)])


@pytest.mark.parametrize("n_modes", [2, 3])
def test_a_hundred_steps_agree_with_filterpy(n_modes: int) -> None:
    rng = np.random.default_rng(n_modes)
    M = TRANSITIONS[n_modes]
    Q = np.stack([q * G @ G.T for q in NOISE_LEVELS[:n_modes]])
    mode_prob = np.full(n_modes, 1.0 / n_modes)
    mean, cov = np.zeros((n_modes, 4)), np.tile(10.0 * np.eye(4), (n_modes, 1, 1))
    filters = []
    for j in range(n_modes):
        kalman = KalmanFilter(dim_x=4, dim_z=2)
        kalman.x, kalman.P = mean[j].copy(), cov[j].copy()
        kalman.F, kalman.H, kalman.R, kalman.Q = F, H, R, Q[j]
        filters.append(kalman)
    oracle = IMMEstimator(filters, mode_prob.copy(), M)

    truth = np.zeros(4)
    visited = set()
    for k in range(100):
        truth = F @ truth + np.sqrt(NOISE_LEVELS[k // 20 % n_modes]) * G @ rng.normal(size=2)
        z = H @ truth + rng.multivariate_normal(np.zeros(2), R)
        mean, cov, mode_prob = mix(mean, cov, mode_prob, M)
        mean, cov = predict(mean, cov, np.tile(F, (n_modes, 1, 1)), Q)
        mean, cov, log_likelihood, _ = update(mean, cov, z, H, R)
        mode_prob = posterior_prob(mode_prob, log_likelihood)
        x, P = combine(mean, cov, mode_prob)
        oracle.predict()
        oracle.update(z)
        np.testing.assert_allclose(mode_prob, oracle.mu, atol=1e-9)
        np.testing.assert_allclose(x, oracle.x, atol=1e-9)
        np.testing.assert_allclose(P, oracle.P, atol=1e-9)
        for j, kalman in enumerate(filters):
            np.testing.assert_allclose(mean[j], kalman.x, atol=1e-9)
            np.testing.assert_allclose(cov[j], kalman.P, atol=1e-9)
        visited.add(int(mode_prob.argmax()))
    assert len(visited) > 1  # the test needs a problem with mode switches


def test_a_thousand_precise_updates_leave_the_covariance_symmetric_and_positive() -> None:
    rng = np.random.default_rng(0)
    mean, cov = np.zeros((1, 4)), np.tile(np.diag([1e6, 1e6, 1.0, 1e-4]), (1, 1, 1))
    for _ in range(1000):
        H_ = rng.normal(size=(2, 4))
        mean, cov, _, _ = update(mean, cov, rng.normal(size=2), H_, 1e-8 * np.eye(2))
        cov = cov + 1e-12 * np.eye(4)
        np.testing.assert_allclose(cov[0], cov[0].T, atol=1e-12)
        assert np.linalg.eigvalsh(0.5 * (cov[0] + cov[0].T)).min() >= 0


# --- mixing and combining -------------------------------------------------------------------------------------------


@settings(max_examples=20, deadline=None)
@given(seed=SEEDS, n_modes=st.integers(1, 5))
def test_values_are_mixed_like_means(seed: int, n_modes: int) -> None:
    mean, cov, prob, M = random_modes(seed, n_modes)
    np.testing.assert_allclose(mixed_values(mean[:, 0], prob, M), mix(mean, cov, prob, M)[0][:, 0], atol=1e-12)
    two = np.stack([mean[:, 0], mean[:, 1]]), np.stack([prob, prob[::-1]])
    for k in range(2):
        np.testing.assert_allclose(mixed_values(*two, M)[k], mixed_values(two[0][k], two[1][k], M), atol=1e-12)


def test_no_function_modifies_its_input() -> None:
    mean, cov, prob, M = random_modes(0, 3, 4)
    copies = [a.copy() for a in (mean, cov, prob, M)]
    mix(mean, cov, prob, M)
    update(mean, cov, np.ones(2), H, R)
    posterior_prob(prob, np.array([1.0, np.nan, 2.0]))
    combine(mean, cov, prob)
    for array, copy in zip((mean, cov, prob, M), copies, strict=True):
        np.testing.assert_array_equal(array, copy)


# --- many pedestrians at once -----------------------------------------------------------------------------------------


@settings(max_examples=20, deadline=None)
@given(seed=SEEDS, n_pedestrians=st.integers(1, 5))
def test_many_pedestrians_at_once_are_filtered_as_if_each_were_alone(seed: int, n_pedestrians: int) -> None:
    rng = np.random.default_rng(seed)
    each = [random_modes(int(s)) for s in rng.integers(0, 2**32 - 1, n_pedestrians)]
    mean, cov, prob = (np.stack([e[k] for e in each]) for k in range(3))
    M = each[0][3]
    F_, Q = rng.normal(size=(4, 3, 3)), random_cov(rng, 3, 4)
    H_, z, R_ = rng.normal(size=(2, 3)), rng.normal(size=(n_pedestrians, 2)), random_cov(rng, 2, n_pedestrians)

    def cycle(mean: np.ndarray, cov: np.ndarray, prob: np.ndarray, z: np.ndarray, R_: np.ndarray) -> list[np.ndarray]:
        mean, cov, prob = mix(mean, cov, prob, M)
        mean, cov = predict(mean, cov, F_, Q)
        mean, cov, log_likelihood, nis = update(mean, cov, z, H_, R_)
        prob = posterior_prob(prob, log_likelihood)
        return [mean, cov, prob, nis, *combine(mean, cov, prob)]

    together = cycle(mean, cov, prob, z, R_)
    for k in range(n_pedestrians):
        for all_of_them, alone in zip(together, cycle(mean[k], cov[k], prob[k], z[k], R_[k]), strict=True):
            np.testing.assert_allclose(all_of_them[k], alone, atol=1e-10)


def test_smoothed_mode_probabilities_are_those_of_the_exact_forward_backward_algorithm() -> None:
    rng = np.random.default_rng(5)
    n_steps, lag = 30, 4
    T, log_likelihood = rng.dirichlet(np.ones(3), 3), rng.normal(scale=2.0, size=(n_steps, 3))
    filtered, mu = [], np.full(3, 1 / 3)
    for likelihood in np.exp(log_likelihood):
        mu = (mu @ T) * likelihood
        mu = mu / mu.sum()
        filtered.append(mu)
    lagged = smoothed_mode_prob(np.array(filtered), T, lag)
    for k in range(n_steps):
        # sum of the probabilities of all mode sequences from k on
        beta = np.ones(3)
        for later in range(min(k + lag, n_steps - 1), k, -1):
            beta = T @ (np.exp(log_likelihood[later]) * beta)
        expected = filtered[k] * beta
        np.testing.assert_allclose(lagged[k], expected / expected.sum(), atol=1e-12)
    np.testing.assert_array_equal(smoothed_mode_prob(np.array(filtered), T, 0), filtered)
    of_all = smoothed_mode_prob(np.array(filtered), T)
    np.testing.assert_allclose(of_all, smoothed_mode_prob(np.array(filtered), T, n_steps), atol=1e-12)


def test_a_later_step_that_is_impossible_does_not_change_the_mode_probabilities() -> None:
    filtered = np.array([[1.0, 0.0], [0.0, 1.0], [0.5, 0.5]])
    for lag in (None, 2):
        np.testing.assert_array_equal(smoothed_mode_prob(filtered, np.eye(2), lag)[:2], filtered[:2])


def test_smoothing_of_no_steps_gives_no_steps() -> None:
    assert smoothed_mode_prob(np.empty((0, 2)), np.eye(2), 3).shape == (0, 2)
