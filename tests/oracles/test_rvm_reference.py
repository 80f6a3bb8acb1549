from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.special import expit
from sklearn.datasets import make_moons
from threadpoolctl import threadpool_limits

from pdr_filter.classifiers.rvm import basis_functions
from tests.oracles.rvm_reference import (
    log_evidence,
    log_posterior,
    log_posterior_gradient,
    posterior_mode,
    posterior_precision,
    reestimate,
    train_plain,
)


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    with threadpool_limits(limits=1, user_api="blas"):
        yield


def design_matrix(X: np.ndarray, vectors: np.ndarray, width: float) -> np.ndarray:
    return basis_functions(X, vectors, "rbf", width).T


def small_problem(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Design (40, 9), targets and alphas."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(40, 2))
    target = (rng.uniform(size=40) < expit(2 * X[:, 0] - 1)).astype(float)
    return design_matrix(X, X[:8], 1.0), target, rng.uniform(0.05, 3.0, 9)


def test_the_log_posterior_is_equation_9() -> None:
    design, target, alpha = small_problem()
    weights = np.linspace(-1, 1, 9)
    p = 1 / (1 + np.exp(-design @ weights))
    expected = np.sum(target * np.log(p) + (1 - target) * np.log(1 - p)) - 0.5 * weights @ np.diag(alpha) @ weights
    assert log_posterior(weights, design, target, alpha) == pytest.approx(expected, rel=1e-12)


def test_the_gradient_and_precision_are_those_of_finite_differences() -> None:
    design, target, alpha = small_problem()
    weights = np.linspace(-1, 1, 9)
    by_difference = approx_fprime(weights, log_posterior, 1e-7, design, target, alpha)
    np.testing.assert_allclose(log_posterior_gradient(weights, design, target, alpha), by_difference, atol=1e-5)
    hessian = approx_fprime(weights, log_posterior_gradient, 1e-7, design, target, alpha)
    np.testing.assert_allclose(posterior_precision(weights, design, alpha), -hessian, atol=1e-5)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("start", [0.0, 30.0])  # 30: nearly all sigmoids saturated, where undamped Newton diverges
def test_the_slope_of_the_log_posterior_is_zero_at_the_mode(seed: int, start: float) -> None:
    design, target, alpha = small_problem(seed)
    mode, _ = posterior_mode(design, target, alpha, np.full(9, start))
    by_difference = [
        (log_posterior(mode + d, design, target, alpha) - log_posterior(mode - d, design, target, alpha)) / 2e-4
        for d in 1e-4 * np.eye(9)
    ]
    np.testing.assert_allclose(by_difference, 0.0, atol=1e-4)


def test_the_laplace_covariance_is_the_inverse_of_the_hessian_by_finite_differences() -> None:
    design, target, alpha = small_problem()
    mode, factor = posterior_mode(design, target, alpha, np.zeros(9))
    hessian = approx_fprime(mode, log_posterior_gradient, 1e-7, design, target, alpha)
    np.testing.assert_allclose(factor.T @ factor, np.linalg.inv(-hessian), rtol=1e-4, atol=1e-6)


def test_equal_columns_and_a_flat_prior_still_have_a_mode() -> None:
    design, target, _ = small_problem()
    doubled = np.hstack([design, design])
    mode, factor = posterior_mode(doubled, target, np.full(18, 1e-9), np.zeros(18))
    assert np.isfinite(mode).all()
    assert np.isfinite(factor).all()
    gradient = log_posterior_gradient(mode, doubled, target, np.full(18, 1e-9))
    assert np.abs(gradient).max() < 1e-3


def test_a_singular_precision_is_damped() -> None:
    target = np.array([0.0, 1.0, 1.0, 1.0])
    mode, factor = posterior_mode(np.ones((4, 2)), target, np.zeros(2), np.zeros(2))
    assert expit(mode.sum()) == pytest.approx(0.75, abs=1e-4)
    assert np.isfinite(factor).all()


def test_an_unsupported_weight_gets_an_infinite_precision() -> None:
    alpha = reestimate(np.array([2.0, 2.0]), np.array([0.0, 0.5]), np.array([0.1, 0.1]))
    np.testing.assert_allclose(alpha, [np.inf, (1 - 2.0 * 0.1) / 0.25])


def test_after_training_gamma_equals_alpha_times_the_squared_mean() -> None:
    X, y = make_moons(150, noise=0.3, random_state=0)
    machine = train_plain(design_matrix(X, X, 0.8), y.astype(float), tol=1e-4)
    assert machine.converged
    variance = np.diag(machine.cov_factor.T @ machine.cov_factor)
    np.testing.assert_allclose(1 - machine.alpha * variance, machine.alpha * machine.mean**2, atol=1e-4)


def test_training_ends_at_the_posterior_of_the_functions_that_it_kept() -> None:
    X, y = make_moons(150, noise=0.3, random_state=0)
    design = design_matrix(X, X, 0.8)
    machine = train_plain(design, y.astype(float))
    gradient = log_posterior_gradient(machine.mean, design[:, machine.basis], y, machine.alpha)
    np.testing.assert_allclose(gradient, 0.0, atol=1e-3)
    precision = posterior_precision(machine.mean, design[:, machine.basis], machine.alpha)
    np.testing.assert_allclose(machine.cov_factor.T @ machine.cov_factor @ precision, np.eye(len(precision)), atol=1e-6)


def test_the_log_evidence_is_the_integral_of_likelihood_times_prior() -> None:
    # one weight: Laplace against quadrature
    design, target = np.ones((60, 1)), np.repeat([0.0, 1.0], [20, 40])
    machine = train_plain(design, target)
    weights = np.linspace(-10, 10, 20001)
    log_joint = [
        log_posterior(np.array([w]), design, target, machine.alpha) + 0.5 * np.log(machine.alpha[0] / (2 * np.pi))
        for w in weights
    ]
    integral = np.log(np.sum(np.exp(log_joint)) * (weights[1] - weights[0]))
    assert log_evidence(machine, design, target) == pytest.approx(integral, abs=0.02)


def test_labels_that_depend_on_nothing_leave_nothing() -> None:
    design = np.tile(np.array([[1.0, 1.0], [1.0, -1.0]]), (50, 1))
    assert len(train_plain(design, np.repeat([0.0, 1.0], 50)).basis) == 0  # as many ones as zeros on both sides
