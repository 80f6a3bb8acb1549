# ruff: noqa: N806  (X as in scikit-learn)
from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.special import expit
from scipy.stats import multivariate_normal
from sklearn.datasets import make_moons
from threadpoolctl import threadpool_limits

from pdr_filter.classifiers.rvm import basis_functions, median_distance
from pdr_filter.classifiers.rvm_training import (
    Bernoulli,
    Posterior,
    additions,
    evidence_gain,
    inside_factors,
    outside_factors,
    posterior,
    spread_start,
    train_rvm,
)
from tests.oracles import rvm_reference


@dataclass(frozen=True, slots=True, eq=False)
class Gaussian:
    """Targets t_n plus noise of a known precision: the regression of Tipping 2001, for which nothing is approximate."""

    target: np.ndarray  # (N,)
    noise_precision: float

    def log_likelihood(self, logit: np.ndarray) -> float:
        """Logarithm of N(y | t, 1 / precision), in nats."""
        n = len(self.target)
        squares = float(np.sum((self.target - logit) ** 2))
        return 0.5 * (n * np.log(self.noise_precision / (2.0 * np.pi)) - self.noise_precision * squares)

    def slope(self, logit: np.ndarray) -> np.ndarray:
        """Return precision times residual, (N,)."""
        return self.noise_precision * (self.target - logit)

    def curvature(self, logit: np.ndarray) -> np.ndarray:
        """Return the precision, (N,)."""
        return np.full_like(logit, self.noise_precision)


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    with threadpool_limits(limits=1, user_api="blas"):
        yield


def bernoulli(target: np.ndarray) -> Bernoulli:
    return Bernoulli(target.astype(float), np.ones(len(target)), np.zeros(len(target)))


def moons(n: int = 150, width_share: float = 0.7, seed: int = 0) -> tuple[Bernoulli, np.ndarray]:
    X, y = make_moons(n, noise=0.3, random_state=seed)
    return bernoulli(y), basis_functions(X, X, "rbf", width_share * median_distance(X))


def regression(n: int = 60, n_functions: int = 12, seed: int = 0) -> tuple[Gaussian, np.ndarray]:
    """Targets of noise precision 4 from three of the functions."""
    rng = np.random.default_rng(seed)
    functions = rng.normal(size=(n_functions, n))
    return Gaussian(functions[[1, 4, 7]].T @ [1.0, -2.0, 0.5] + rng.normal(0, 0.5, n), 4.0), functions


def at(likelihood: Gaussian | Bernoulli, functions: np.ndarray, basis: list[int], alpha: list[float]) -> Posterior:
    n = functions.shape[1]
    return posterior(likelihood, functions, np.array(basis), np.array(alpha), np.zeros(len(basis)), np.zeros(n))


# --- closed forms: the Gaussian likelihood, where nothing is approximate -------------------------------------------


def test_the_gaussian_posterior_and_evidence_are_those_of_the_joint_normal_distribution() -> None:
    likelihood, functions = regression()
    basis, alpha = [1, 4, 9], np.array([0.5, 2.0, 30.0])
    found = at(likelihood, functions, basis, list(alpha))
    phi = functions[basis].T
    precision = 4.0 * phi.T @ phi + np.diag(alpha)
    np.testing.assert_allclose(found.mean, np.linalg.solve(precision, 4.0 * phi.T @ likelihood.target), rtol=1e-9)
    np.testing.assert_allclose(found.cov_factor.T @ found.cov_factor, np.linalg.inv(precision), rtol=1e-9, atol=1e-14)
    of_targets = phi @ np.diag(1 / alpha) @ phi.T + np.eye(60) / 4.0
    expected = multivariate_normal(np.zeros(60), of_targets).logpdf(likelihood.target)
    assert found.log_evidence == pytest.approx(expected, rel=1e-10)


def test_sparsity_and_quality_are_those_of_the_inverse_covariance_of_the_targets() -> None:
    likelihood, functions = regression()
    now = at(likelihood, functions, [1, 4], [0.5, 2.0])
    phi = functions[[1, 4]].T
    inverse = np.linalg.inv(phi @ np.diag([2.0, 0.5]) @ phi.T + np.eye(60) / 4.0)
    sparsity, quality = outside_factors(likelihood, functions, now)
    others = [m for m in range(12) if m not in (1, 4)]
    assert np.isinf(sparsity[[1, 4]]).all()
    expected = np.einsum("mn,nk,mk->m", functions, inverse, functions)
    np.testing.assert_allclose(sparsity[others], expected[others], rtol=1e-5)
    np.testing.assert_allclose(quality, functions @ inverse @ likelihood.target, rtol=1e-9, atol=1e-9)


def test_factors_inside_are_those_outside_of_the_model_without_the_function() -> None:
    likelihood, functions = regression()
    s, q = inside_factors(at(likelihood, functions, [1, 4, 9], [0.5, 2.0, 30.0]))
    for i, (out, left, alpha) in enumerate([(1, [4, 9], [2.0, 30.0]), (4, [1, 9], [0.5, 30.0]), (9, [1, 4], [0.5, 2])]):
        sparsity, quality = outside_factors(likelihood, functions, at(likelihood, functions, left, alpha))
        assert s[i] == pytest.approx(sparsity[out], rel=1e-5)
        assert q[i] == pytest.approx(quality[out], rel=1e-7, abs=1e-7)


def test_the_best_alpha_and_the_evidence_gain_of_a_function_equal_those_of_a_search() -> None:
    likelihood, functions = regression()
    without = at(likelihood, functions, [1], [0.5])
    sparsity, quality = outside_factors(likelihood, functions, without)
    for m in (4, 7):
        s, q = sparsity[m], quality[m]
        search = minimize_scalar(
            lambda ln_alpha, m=m: -at(likelihood, functions, [1, m], [0.5, np.exp(ln_alpha)]).log_evidence,
            bounds=(-10, 15),
            method="bounded",
            options={"xatol": 1e-9},
        )
        assert np.exp(search.x) == pytest.approx(s**2 / (q**2 - s), rel=1e-4)
        assert -search.fun - without.log_evidence == pytest.approx(float(evidence_gain(s, q)), rel=1e-5)


def test_a_function_that_explains_nothing_has_no_evidence_gain() -> None:
    np.testing.assert_array_equal(evidence_gain(np.array([4.0, 4.0, np.inf]), np.array([1.9, 0.0, 5.0])), 0.0)


def test_of_two_equal_functions_one_is_added() -> None:
    likelihood, functions = regression()
    doubled = np.vstack([functions, functions])
    added, alpha, gain = additions(likelihood, doubled, at(likelihood, doubled, [1], [0.5]))
    assert len({m % 12 for m in added}) == len(added)
    alone = additions(likelihood, functions, at(likelihood, functions, [1], [0.5]))
    np.testing.assert_array_equal(added % 12, alone[0])
    np.testing.assert_allclose(alpha, alone[1])
    assert gain == pytest.approx(alone[2])


def test_the_expected_gain_of_additions_equals_the_evidence_gained() -> None:
    likelihood, functions = regression()
    now = at(likelihood, functions, [1], [0.5])
    added, alpha, gain = additions(likelihood, functions, now)
    after = at(likelihood, functions, [1, *added], [0.5, *alpha])
    assert after.log_evidence - now.log_evidence == pytest.approx(gain, rel=1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_the_subset_with_the_highest_evidence_is_found(seed: int) -> None:
    likelihood, functions = regression(n_functions=8, seed=seed)
    found = train_rvm(likelihood, functions, tol=1e-9, max_passes=300).posterior
    best = -np.inf
    for size in range(1, 6):
        for basis in itertools.combinations(range(8), size):
            start = at(likelihood, functions, list(basis), [1.0] * size)
            only = functions[list(basis)]
            inside = train_rvm(
                likelihood,
                only,
                Posterior(np.arange(size), start.alpha, start.mean, start.cov_factor, start.logit, 0.0),
                tol=1e-6,
                max_passes=60,
            ).posterior
            best = max(best, inside.log_evidence)
    assert found.log_evidence == pytest.approx(best, abs=1e-3)


# --- two classes: against the plain algorithm of the paper ---------------------------------------------------------


def test_fast_and_plain_training_agree() -> None:
    gaps: list[float] = []
    for seed, width_share in itertools.product(range(2), [0.5, 1.0, 2.0, 4.0]):
        likelihood, functions = moons(100, width_share, seed)
        plain = rvm_reference.train_plain(functions.T, likelihood.target, tol=1e-3)
        fast = train_rvm(likelihood, functions, tol=1e-3, max_passes=300).posterior
        gaps.append(fast.log_evidence - rvm_reference.log_evidence(plain, functions.T, likelihood.target))
        probability = expit(functions[plain.basis].T @ plain.mean)
        assert np.mean(np.abs(expit(fast.logit) - probability)) < 0.05
    assert min(gaps) > -3.0  # nats; both find a local maximum, sometimes different ones
    assert np.mean(gaps) > -0.5


def test_the_posterior_is_that_of_the_plain_algorithm_for_the_same_alphas() -> None:
    likelihood, functions = moons()
    found = train_rvm(likelihood, functions).posterior
    design = functions[found.basis].T
    mean, factor = rvm_reference.posterior_mode(design, likelihood.target, found.alpha, np.zeros(len(found.mean)))
    np.testing.assert_allclose(found.mean, mean, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(found.cov_factor.T @ found.cov_factor, factor.T @ factor, rtol=1e-3, atol=1e-6)
    machine = rvm_reference.BinaryMachine(found.basis, found.alpha, mean, factor, 0, True)
    expected = rvm_reference.log_evidence(machine, functions.T, likelihood.target)
    assert found.log_evidence == pytest.approx(expected, abs=1e-5)


def test_trained_to_the_end_no_alpha_addition_or_deletion_raises_the_evidence() -> None:
    likelihood, functions = moons()
    found = train_rvm(likelihood, functions, tol=1e-6, max_passes=500).posterior
    for m in range(len(found.basis)):
        for factor in (0.8, 1.25):
            alpha = found.alpha.copy()
            alpha[m] *= factor
            assert at(likelihood, functions, list(found.basis), list(alpha)).log_evidence < found.log_evidence + 2e-2
        rest = [i for i in range(len(found.basis)) if i != m]
        less = at(likelihood, functions, list(found.basis[rest]), list(found.alpha[rest]))
        assert less.log_evidence < found.log_evidence + 2e-2
    assert additions(likelihood, functions, found)[2] < 0.05


def test_integer_weights_equal_repeated_rows() -> None:
    likelihood, functions = moons(80)
    weight = np.arange(80) % 3 + 1
    weighted = Bernoulli(likelihood.target, weight.astype(float), np.zeros(80))
    repeated = bernoulli(np.repeat(likelihood.target, weight))
    basis, alpha = [0, 3, 20], [0.1, 1.0, 2.0]
    one = at(weighted, functions, basis, alpha)
    other = at(repeated, np.repeat(functions, weight, axis=1), basis, alpha)
    np.testing.assert_allclose(one.mean, other.mean, rtol=1e-8)
    assert one.log_evidence == pytest.approx(other.log_evidence, rel=1e-12)


def test_an_offset_is_a_function_of_known_weight() -> None:
    likelihood, functions = moons(80)
    offset = 1.7 * functions[5]
    shifted = Bernoulli(likelihood.target, np.ones(80), offset)
    one = at(shifted, functions, [0, 5], [0.1, 1e-10])
    other = at(likelihood, functions, [0, 5], [0.1, 1e-10])
    np.testing.assert_allclose(one.mean + np.array([0.0, 1.7]), other.mean, rtol=1e-5)


@pytest.mark.parametrize("width_share", [0.2, 0.5, 1.0, 2.0, 4.0, 20.0])
@pytest.mark.parametrize("seed", range(2))
def test_the_evidence_never_falls(seed: int, width_share: float) -> None:
    likelihood, functions = moons(120, width_share, seed)
    trained = train_rvm(likelihood, functions, tol=1e-3)
    assert (np.diff(trained.log_evidence) > 0).all()
    assert trained.log_evidence[-1] == trained.posterior.log_evidence
    assert np.isfinite(trained.posterior.mean).all()


def test_with_wide_kernels_a_start_with_many_functions_reaches_more_evidence_than_the_bias_alone() -> None:
    # From the bias alone, additions one by one end far below: this is why training begins with many.
    rng = np.random.default_rng(3)
    X = rng.normal(size=(300, 6))
    y = (X[:, 0] * X[:, 1] + 0.5 * X[:, 2] > 0).astype(float)
    functions = basis_functions(X, X, "rbf", 2 * median_distance(X))
    bias_only = at(bernoulli(y), functions, [0], [1e-2])
    many = train_rvm(bernoulli(y), functions).posterior
    few = train_rvm(bernoulli(y), functions, bias_only).posterior
    assert many.log_evidence > few.log_evidence + 20.0


def test_a_bad_start_leads_to_the_same_mode() -> None:
    likelihood, functions = moons()
    basis, alpha = np.arange(20), np.full(20, 1e-3)
    good = posterior(likelihood, functions, basis, alpha, np.zeros(20), np.zeros(150))
    saturated = posterior(likelihood, functions, basis, alpha, np.full(20, 1e3), 1e3 * functions[:20].sum(axis=0))
    np.testing.assert_allclose(saturated.mean, good.mean, atol=1e-2)
    assert saturated.log_evidence == pytest.approx(good.log_evidence, abs=1e-3)


def test_a_singular_gram_matrix_has_a_posterior() -> None:
    likelihood, functions = moons(40)
    doubled = np.vstack([functions[:5]] * 4)
    found = posterior(likelihood, doubled, np.arange(20), np.full(20, 1e-10), np.zeros(20), np.zeros(40))
    assert np.isfinite(found.mean).all()
    assert np.isfinite(found.cov_factor).all()
    trained = train_rvm(likelihood, doubled)
    assert len(trained.posterior.basis) <= 5
    assert np.isfinite(trained.posterior.log_evidence)


def test_limits_are_kept_and_reported() -> None:
    likelihood, functions = moons(width_share=0.1)
    few = train_rvm(likelihood, functions, max_basis=3)
    assert len(few.posterior.basis) <= 3
    assert few.out_of_basis
    short = train_rvm(likelihood, functions, max_passes=2)
    assert short.n_passes == 2
    assert short.out_of_passes
    enough = train_rvm(*moons())
    assert not enough.out_of_basis
    assert not enough.out_of_passes


def test_the_spread_start_has_the_bias_and_is_no_larger_than_the_candidates() -> None:
    likelihood, functions = moons(50)
    np.testing.assert_array_equal(spread_start(likelihood, functions, 100).basis, np.arange(51))
    basis = spread_start(likelihood, functions, 6).basis
    np.testing.assert_array_equal(basis, [0, 10, 20, 30, 40, 50])
    np.testing.assert_array_equal(spread_start(likelihood, functions, 1).basis, [0])
