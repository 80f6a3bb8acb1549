"""The IMM for any problem, against exact enumeration of all mode sequences, filterpy and closed forms."""

from itertools import pairwise, product

import numpy as np
import pytest
from filterpy.kalman import rts_smoother

import pdr_filter as pdr
from pdr_filter.imm import JumpMarkovModel, update

TRANSITIONS = np.array([[0.9, 0.1], [0.2, 0.8]])
F = np.array([[[1.0, 0.0], [0.0, 0.0]], [[1.0, 1.0], [0.0, 1.0]]])  # at rest, at constant speed
Q = np.array([np.diag([1e-4, 0.3]), np.diag([1e-3, 0.02])])
H, R = np.array([[1.0, 0.0]]), np.array([[0.09]])
START, START_COV = np.zeros(2), np.diag([1.0, 0.5])


@pytest.fixture
def model() -> JumpMarkovModel:
    return JumpMarkovModel(F, Q, H, R, TRANSITIONS)


def drawn(model: JumpMarkovModel, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Modes (n,), states (n, 2) and measurements (n, 1) of the model."""
    mode, x = int(rng.integers(2)), rng.multivariate_normal(START, START_COV)
    modes, states, z = [], [], []
    for _ in range(n):
        mode = int(rng.choice(2, p=model.transition_prob[mode]))
        x = model.F[mode] @ x + rng.multivariate_normal(np.zeros(2), model.Q[mode])
        modes.append(mode)
        states.append(x)
        z.append(model.H[mode] @ x + rng.multivariate_normal(np.zeros(1), model.R[mode]))
    return np.array(modes), np.array(states), np.array(z)


def enumerated(model: JumpMarkovModel, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Exact smoothed means (n, 2) and mode probabilities (n, 2), and log likelihood: all sequences of modes."""
    n, log_weights, means, paths = len(z), [], [], []
    for path in product(range(2), repeat=n):
        log_weight = np.log(0.5 * model.transition_prob[:, path[0]].sum())
        log_weight += sum(np.log(model.transition_prob[a, b]) for a, b in pairwise(path))
        x, cov, xs, covs = START, START_COV, [], []
        for m, each in zip(path, z, strict=True):
            x, cov = model.F[m] @ x, model.F[m] @ cov @ model.F[m].T + model.Q[m]
            s = model.H[m] @ cov @ model.H[m].T + model.R[m]
            k = cov @ model.H[m].T @ np.linalg.inv(s)
            y = each - model.H[m] @ x
            log_weight -= 0.5 * float(y @ np.linalg.solve(s, y) + np.log(np.linalg.det(2 * np.pi * s)))
            x, cov = x + k @ y, cov - k @ s @ k.T
            xs.append(x)
            covs.append(cov)
        for k in range(n - 2, -1, -1):
            m = path[k + 1]
            ahead = model.F[m] @ covs[k] @ model.F[m].T + model.Q[m]
            xs[k] = xs[k] + covs[k] @ model.F[m].T @ np.linalg.solve(ahead, xs[k + 1] - model.F[m] @ xs[k])
        log_weights.append(log_weight)
        means.append(xs)
        paths.append(path)
    highest = max(log_weights)
    weights = np.exp(np.array(log_weights) - highest)
    prob = weights / weights.sum()
    modes = np.array(paths)
    by_mode = np.column_stack([(prob[:, None] * (modes == m)).sum(axis=0) for m in range(2)])
    return np.einsum("s,skn->kn", prob, np.array(means)), by_mode, float(np.log(weights.sum()) + highest)


def test_smoothing_is_near_exact_enumeration_of_all_mode_sequences(model: JumpMarkovModel) -> None:
    rng = np.random.default_rng(1)
    smoothed_error, filtered_error, prob_error, likelihood_error = [], [], [], []
    for _ in range(12):
        _, _, z = drawn(model, 8, rng)
        filtered = model.filter(z, START, START_COV)
        smoothed = model.smooth(filtered)
        exact, exact_prob, log_likelihood = enumerated(model, z)
        smoothed_error.append(np.abs(smoothed.mean - exact).max())
        filtered_error.append(np.abs(filtered.mean - exact).max())
        prob_error.append(np.abs(smoothed.mode_prob - exact_prob).mean())
        likelihood_error.append(abs(float(filtered.log_likelihood) - log_likelihood))
    assert np.mean(smoothed_error) < 0.3 * np.mean(filtered_error)
    assert np.mean(prob_error) < 0.03
    assert np.mean(likelihood_error) < 0.1


def test_the_filter_is_exact_for_the_first_measurement(model: JumpMarkovModel) -> None:
    z = np.array([[0.7]])
    found = model.filter(z, START, START_COV)
    exact, exact_prob, log_likelihood = enumerated(model, z)
    np.testing.assert_allclose(found.mean, exact, atol=1e-12)
    np.testing.assert_allclose(found.mode_prob, exact_prob, atol=1e-12)
    assert float(found.log_likelihood) == pytest.approx(log_likelihood, abs=1e-12)


def test_one_mode_is_the_rauch_tung_striebel_smoother() -> None:
    alone = JumpMarkovModel(F[1:], Q[1:], H, R, [[1.0]])
    rng = np.random.default_rng(3)
    z = rng.normal(size=(30, 1)).cumsum(axis=0)
    filtered = alone.filter(z, START, START_COV)
    kept = rts_smoother(filtered.mode_mean[:, 0], filtered.mode_cov[:, 0], [F[1]] * 30, [Q[1]] * 30)
    smoothed = alone.smooth(filtered)
    np.testing.assert_allclose(smoothed.mean, kept[0], atol=1e-9)
    np.testing.assert_allclose(smoothed.cov, kept[1], atol=1e-9)


def test_smoothing_is_better_than_filtering_and_its_covariance_fits(model: JumpMarkovModel) -> None:
    rng = np.random.default_rng(4)
    drawn_walks = [drawn(model, 60, rng) for _ in range(150)]
    true, z = (np.stack([walk[k] for walk in drawn_walks], axis=1) for k in (1, 2))
    filtered = model.filter(z, START, START_COV)
    smoothed = model.smooth(filtered)
    errors = [np.sqrt(np.mean((found.mean - true)[..., 0] ** 2)) for found in (filtered, smoothed)]
    assert errors[1] < 0.8 * errors[0]
    error = smoothed.mean - true
    nees = np.einsum("...i,...ij,...j->...", error, np.linalg.inv(smoothed.cov), error)
    assert 1.7 < nees.mean() < 2.4
    right = [
        np.mean(found.mode_prob.argmax(-1) == np.stack([w[0] for w in drawn_walks], 1))
        for found in (filtered, smoothed)
    ]
    assert right[1] > right[0] + 0.03


def test_many_filters_at_once_are_those_one_by_one_and_modes_may_be_permuted(model: JumpMarkovModel) -> None:
    rng = np.random.default_rng(5)
    z = np.stack([drawn(model, 20, rng)[2] for _ in range(4)], axis=1)
    z[5:8, 2] = np.nan
    together = model.smooth(model.filter(z, START, START_COV))
    swapped = JumpMarkovModel(F[::-1], Q[::-1], H, R, TRANSITIONS[::-1, ::-1])
    for k in range(4):
        alone = model.smooth(model.filter(z[:, k], START, START_COV))
        np.testing.assert_allclose(together.mean[:, k], alone.mean, atol=1e-12)
        np.testing.assert_allclose(together.cov[:, k], alone.cov, atol=1e-12)
    other = swapped.smooth(swapped.filter(z, START, START_COV))
    np.testing.assert_allclose(other.mode_prob[..., ::-1], together.mode_prob, atol=1e-12)


def test_a_missing_measurement_leaves_the_prediction(model: JumpMarkovModel) -> None:
    z = np.array([[0.3], [np.nan], [0.5]])
    found = model.filter(z, START, START_COV)
    np.testing.assert_allclose(found.mode_prob[1], found.mode_prob[0] @ TRANSITIONS, atol=1e-12)
    # the mean of the state goes through each mode with its own mixture
    assert found.cov[1, 0, 0] > found.cov[0, 0, 0] and np.isfinite(model.smooth(found).mean).all()


def test_update_takes_measurement_matrix_and_noise_of_each_mode() -> None:
    rng = np.random.default_rng(6)
    mean, root = rng.normal(size=(5, 3, 4)), rng.normal(size=(5, 3, 4, 4))
    cov, h = root @ root.swapaxes(-1, -2), rng.normal(size=(3, 2, 4))
    r, z = np.stack([np.eye(2) * v for v in (0.1, 0.4, 2.0)]), rng.normal(size=(5, 3, 2))
    together = update(mean, cov, z, h, np.broadcast_to(r, (5, 3, 2, 2)))
    for m in range(3):
        alone = update(mean[:, m : m + 1], cov[:, m : m + 1], z[:, m], h[m], np.broadcast_to(r[m], (5, 2, 2)))
        for found, expected in zip(together, alone, strict=True):
            np.testing.assert_allclose(found[:, m : m + 1], expected, atol=1e-9)


def test_the_module_is_found_by_dir() -> None:
    assert "imm" in dir(pdr) and {"JumpMarkovModel", "mix", "predict", "update", "combine"} <= set(pdr.imm.__all__)


@pytest.mark.parametrize("along", [(1.0, 2.0), (0.0, 1.0), (0.0, 0.0)])
def test_without_noise_and_with_a_singular_start_smoothing_is_least_squares_of_the_start(
    along: tuple[float, float],
) -> None:
    """The state is known except for one factor a: x_k = F^k (x_0 + a v). Rounding must not hide that."""
    model = JumpMarkovModel(F[[1, 1]], np.zeros((2, 2, 2)), H, R, TRANSITIONS)
    start, v = np.array([300.0, -2.0]), np.array(along)
    powers = np.stack([np.linalg.matrix_power(F[1], k) for k in range(1, 21)])
    z = powers @ (start + 0.7 * v) @ H.T + np.random.default_rng(1).normal(scale=0.3, size=(20, 1))
    smoothed = model.smooth(model.filter(z, start, np.outer(v, v)))
    by_a, known = (powers @ v) @ H[0], (powers @ start) @ H[0]
    var = 1.0 / (1.0 + by_a @ by_a / R[0, 0])
    a = var * by_a @ (z[:, 0] - known) / R[0, 0]
    np.testing.assert_allclose(smoothed.mean, powers @ (start + a * v), rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(smoothed.cov, var * np.einsum("ka,kb->kab", powers @ v, powers @ v), atol=1e-8)
