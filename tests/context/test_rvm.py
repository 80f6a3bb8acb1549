# ruff: noqa: N806  (X as in scikit-learn)
from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.special import expit
from sklearn.base import clone
from sklearn.datasets import make_blobs, make_moons
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import log_loss
from sklearn.utils.estimator_checks import check_estimator
from threadpoolctl import threadpool_limits

from pdr_filter.context.kernel_machine import RelevanceVectors, normalised_sigmoids
from pdr_filter.context.rvm import (
    RelevanceVectorClassifier,
    design_matrix,
    log_posterior,
    log_posterior_gradient,
    median_distance,
    posterior_mode,
    posterior_precision,
    reestimate,
    stratified_rows,
    train_binary,
)


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    with threadpool_limits(limits=1, user_api="blas"):
        yield


def small_problem(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Design (40, 9), targets and alphas."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(40, 2))
    target = (rng.uniform(size=40) < expit(2 * X[:, 0] - 1)).astype(float)
    return design_matrix(X, X[:8], "rbf", 1.0), target, rng.uniform(0.05, 3.0, 9)


def three_blobs(seed: int = 0, n: int = 150) -> tuple[np.ndarray, np.ndarray]:
    return make_blobs(n, 3, centers=[[0, 0, 0], [2.5, 0, 1], [0, 2.5, -1]], random_state=seed)


@pytest.fixture(scope="module")
def blobs() -> tuple[RelevanceVectorClassifier, np.ndarray]:
    X, y = three_blobs()
    return RelevanceVectorClassifier().fit(X, y), three_blobs(1, 200)[0]


@pytest.mark.parametrize("kernel", ["rbf", "linear"])
def test_it_is_a_scikit_learn_estimator(kernel: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # checks that are skipped, and data on which alpha does not settle
        check_estimator(RelevanceVectorClassifier(kernel=kernel, max_samples=40))


# --- the parts, against independent calculations ------------------------------------------------------------------


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
    machine = train_binary(design_matrix(X, X, "rbf", 0.8), y.astype(float), tol=1e-4)
    assert machine.converged
    variance = np.diag(machine.cov_factor.T @ machine.cov_factor)
    np.testing.assert_allclose(1 - machine.alpha * variance, machine.alpha * machine.mean**2, atol=1e-4)


def test_training_ends_at_the_posterior_of_the_functions_that_it_kept() -> None:
    X, y = make_moons(150, noise=0.3, random_state=0)
    design = design_matrix(X, X, "rbf", 0.8)
    machine = train_binary(design, y.astype(float))
    gradient = log_posterior_gradient(machine.mean, design[:, machine.basis], y, machine.alpha)
    np.testing.assert_allclose(gradient, 0.0, atol=1e-3)
    precision = posterior_precision(machine.mean, design[:, machine.basis], machine.alpha)
    np.testing.assert_allclose(machine.cov_factor.T @ machine.cov_factor @ precision, np.eye(len(precision)), atol=1e-6)


def test_labels_that_depend_on_nothing_leave_nothing() -> None:
    design = np.tile(np.array([[1.0, 1.0], [1.0, -1.0]]), (50, 1))
    machine = train_binary(design, np.repeat([0.0, 1.0], 50))  # as many ones as zeros on both sides
    assert len(machine.basis) == 0
    X = design[:, 1:]
    p = RelevanceVectorClassifier(kernel="linear").fit(X, np.repeat([0, 1], 50)).predict_proba(X[:3])
    np.testing.assert_allclose(p, 0.5)


# --- the classifier ---------------------------------------------------------------------------------------------


def test_it_is_sparse_and_nearly_as_good_as_the_best_possible_rule() -> None:
    # Ripley's mixture: two Gaussians for each class, whose best possible error is 8 %
    def draw(seed: int, n: int) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(seed)
        y = np.arange(n) % 2
        centres = np.array([[[-0.7, 0.3], [0.3, 0.3]], [[-0.3, 0.7], [0.4, 0.7]]])
        return centres[y, rng.integers(2, size=n)] + rng.normal(0, np.sqrt(0.03), (n, 2)), y

    X, y = draw(0, 250)
    X_test, y_test = draw(1, 4000)
    classifier = RelevanceVectorClassifier(kernel_width=0.5).fit(X, y)
    assert len(classifier.relevance_vectors_) <= 12
    assert classifier.score(X_test, y_test) > 0.89  # 0.92 is the best possible
    assert log_loss(y_test, classifier.predict_proba(X_test)) < 0.28


def test_two_moons_need_few_vectors() -> None:
    X, y = make_moons(200, noise=0.2, random_state=0)
    X_test, y_test = make_moons(2000, noise=0.2, random_state=1)
    classifier = RelevanceVectorClassifier(kernel_width=0.7).fit(X, y)
    assert len(classifier.relevance_vectors_) <= 20
    assert classifier.score(X_test, y_test) > 0.95


def test_separable_data_are_separated_and_the_weights_stay_finite() -> None:
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (200, 5))
    y = X[:, 0] + X[:, 1] > 0
    X, y = X[np.abs(X[:, 0] + X[:, 1]) > 0.2], y[np.abs(X[:, 0] + X[:, 1]) > 0.2]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # the evidence has no maximum here
        classifier = RelevanceVectorClassifier(kernel="linear").fit(X, y)
    assert classifier.score(X, y) == 1.0
    assert np.isfinite(classifier.machine_.weights).all()


def test_the_linear_kernel_keeps_the_features_that_matter_at_any_scale() -> None:
    rng = np.random.default_rng(0)
    X = rng.normal(size=(800, 10)) * np.logspace(-3, 3, 10)
    logit = 2.0 * X[:, 0] / X[:, 0].std() - 1.5 * X[:, 9] / X[:, 9].std()
    y = rng.uniform(size=800) < expit(logit)
    classifier = RelevanceVectorClassifier(kernel="linear").fit(X, y)
    kept = np.flatnonzero(classifier.relevance_vectors_.any(axis=0))
    assert {0, 9} <= set(kept)
    assert len(kept) <= 4
    oracle = LogisticRegression(C=1e6).fit(X[:, [0, 9]] / X[:, [0, 9]].std(axis=0), y)
    expected = oracle.predict_proba(X[:, [0, 9]] / X[:, [0, 9]].std(axis=0))
    np.testing.assert_allclose(classifier.predict_proba(X), expected, atol=0.12)


def test_probabilities_sum_to_one_near_and_far(blobs: tuple[RelevanceVectorClassifier, np.ndarray]) -> None:
    classifier, X = blobs
    p = classifier.predict_proba(np.vstack([X, 1e3 * X]))
    np.testing.assert_allclose(p.sum(axis=1), 1.0, rtol=1e-14)
    assert (p >= 0).all()
    two = RelevanceVectorClassifier(kernel="linear").fit(X, X[:, 0] > 1)
    np.testing.assert_allclose(two.predict_proba(1e6 * X).sum(axis=1), 1.0, rtol=1e-14)


def test_a_row_that_every_machine_rules_out_still_has_probabilities() -> None:
    p = normalised_sigmoids(np.array([-2000.0, -2000.0, -2001.0]), np.zeros(3))
    np.testing.assert_allclose(p, np.array([1.0, 1.0, np.exp(-1.0)]) / (2.0 + np.exp(-1.0)), rtol=1e-10)


def test_names_and_order_of_the_labels_do_not_matter(blobs: tuple[RelevanceVectorClassifier, np.ndarray]) -> None:
    classifier, X_test = blobs
    X, y = three_blobs()
    names = np.array(["walking", "upstairs", "running"])
    renamed = RelevanceVectorClassifier().fit(X, names[y])
    columns = [list(renamed.classes_).index(name) for name in names]
    np.testing.assert_allclose(renamed.predict_proba(X_test)[:, columns], classifier.predict_proba(X_test), atol=1e-12)


def test_swapping_two_classes_swaps_their_probabilities() -> None:
    X, y = make_moons(120, noise=0.3, random_state=0)
    p = RelevanceVectorClassifier().fit(X, y).predict_proba(X)
    np.testing.assert_allclose(RelevanceVectorClassifier().fit(X, 1 - y).predict_proba(X), p[:, ::-1], atol=1e-6)


def test_each_class_is_trained_against_all_others(blobs: tuple[RelevanceVectorClassifier, np.ndarray]) -> None:
    classifier, X_test = blobs
    X, y = three_blobs()
    sigmoids = []
    for k in range(3):
        machine = train_binary(design_matrix(X, X, "rbf", median_distance(X)), (y == k).astype(float))
        phi = design_matrix(X_test, X, "rbf", median_distance(X))[:, machine.basis]
        covariance = machine.cov_factor.T @ machine.cov_factor
        kappa = 1 / np.sqrt(1 + np.pi / 8 * np.einsum("ni,ij,nj->n", phi, covariance, phi))
        sigmoids.append(expit(kappa * (phi @ machine.mean)))
    expected = np.array(sigmoids).T
    expected /= expected.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(classifier.predict_proba(X_test), expected, atol=1e-10)


def test_moderation_brings_probabilities_nearer_to_even_and_lowers_the_log_loss() -> None:
    X, y = make_moons(150, noise=0.3, random_state=1)
    X_test, y_test = make_moons(3000, noise=0.3, random_state=2)
    moderated = RelevanceVectorClassifier(kernel_width=0.45).fit(X, y).predict_proba(X_test)
    plain = RelevanceVectorClassifier(kernel_width=0.45, moderate=False).fit(X, y).predict_proba(X_test)
    assert (np.abs(moderated - 0.5) <= np.abs(plain - 0.5) + 1e-12).all()
    assert log_loss(y_test, moderated) < log_loss(y_test, plain)


def test_two_fits_are_equal_also_with_drawn_candidates() -> None:
    X, y = three_blobs()
    classifier = RelevanceVectorClassifier(max_samples=30)
    p = classifier.fit(X, y).predict_proba(X)
    np.testing.assert_array_equal(clone(classifier).fit(X, y).predict_proba(X), p)


def test_drawn_candidates_are_rows_of_every_class() -> None:
    label = np.repeat([0, 1, 2], [900, 97, 3])
    rows = stratified_rows(label, 100, np.random.RandomState(0))
    np.testing.assert_array_equal(np.bincount(label[rows]), [90, 10, 1])
    np.testing.assert_array_equal(stratified_rows(label, 1000, np.random.RandomState(0)), np.arange(1000))
    X, y = three_blobs(n=300)
    classifier = RelevanceVectorClassifier(max_samples=15).fit(X, y)
    assert len(classifier.relevance_vectors_) <= 15
    assert all(np.isclose(X, v, rtol=0, atol=0).all(axis=1).any() for v in classifier.relevance_vectors_)


def test_rows_that_are_no_candidates_count_in_the_likelihood() -> None:
    X, y = three_blobs(n=300)
    others = np.setdiff1d(np.arange(300), stratified_rows(y, 15, np.random.RandomState(0)))
    moved = X.copy()
    moved[others] += [0.5, 0.0, 0.0]
    p = RelevanceVectorClassifier(max_samples=15, kernel_width=2.0).fit(X, y).predict_proba(X)
    p_moved = RelevanceVectorClassifier(max_samples=15, kernel_width=2.0).fit(moved, y).predict_proba(X)
    assert np.abs(p_moved - p).max() > 0.01


def test_the_kernel_width_is_the_median_distance_unless_given() -> None:
    X, y = three_blobs(n=60)
    distances = [np.linalg.norm(a - b) for i, a in enumerate(X) for b in X[:i]]
    assert RelevanceVectorClassifier().fit(X, y).kernel_width_ == pytest.approx(np.median(distances))
    assert RelevanceVectorClassifier(kernel_width=2.5).fit(X, y).kernel_width_ == 2.5


def test_too_few_iterations_are_reported() -> None:
    X, y = three_blobs(n=60)
    with pytest.warns(ConvergenceWarning, match="raise max_iter"):
        classifier = RelevanceVectorClassifier(max_iter=2).fit(X, y)
    assert classifier.n_iter_ == 2


@pytest.mark.parametrize(
    ("settings", "message"),
    [({"kernel": "poly"}, "kernel must be"), ({"kernel_width": -1.0}, "kernel_width"), ({"max_samples": 0}, "max_sam")],
)
def test_impossible_settings_are_named(settings: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RelevanceVectorClassifier(**settings).fit(*three_blobs(n=60))


# --- what is stored ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kernel", ["rbf", "linear"])
@pytest.mark.parametrize("n_classes", [2, 3])
def test_stored_inference_equals_the_estimator(kernel: str, n_classes: int) -> None:
    X, y = three_blobs()
    X, y = X[y < n_classes], y[y < n_classes]
    classifier = RelevanceVectorClassifier(kernel=kernel).fit(X, y)
    stored = RelevanceVectors.from_arrays(classifier.machine_.to_arrays())
    np.testing.assert_allclose(stored.predict_proba(X), classifier.predict_proba(X), rtol=1e-13)


def test_a_row_has_the_same_bits_alone_and_in_any_batch(blobs: tuple[RelevanceVectorClassifier, np.ndarray]) -> None:
    machine, rows = blobs[0].machine_, blobs[1]
    together = machine.predict_proba(rows)
    np.testing.assert_array_equal(np.vstack([machine.predict_proba(row[None]) for row in rows]), together)
    np.testing.assert_array_equal(machine.predict_proba(rows[3:17]), together[3:17])
    np.testing.assert_array_equal(machine.predict_proba(np.asfortranarray(rows)), together)


def test_a_feature_that_is_not_finite_is_named(blobs: tuple[RelevanceVectorClassifier, np.ndarray]) -> None:
    with pytest.raises(ValueError, match="feature 2 is nan in row 1"):
        blobs[0].machine_.predict_proba([[0.0, 0.0, 0.0], [0.0, 0.0, np.nan]])


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("kernel", np.array("poly"), "kernel"),
        ("width", np.array(0.0), "width"),
        ("basis", np.array([[0], [99]]), "basis must hold"),
        ("basis", np.array([[0], [-1]]), "basis must hold"),
        ("basis", np.array([[0.0], [1.0]]), "integers"),
        ("weights", np.array([[1.0], [np.nan]]), "finite"),
        ("weights", np.array([[1.0, 2.0]]), "K > 1"),
        ("cov_factor", np.zeros((2, 2, 2)), "shapes"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(name: str, value: np.ndarray, message: str) -> None:
    good = RelevanceVectors(
        "rbf", 1.0, np.zeros((1, 3)), np.array([[0], [1]]), np.array([[1.0], [2.0]]), np.zeros((2, 1, 1))
    )
    with pytest.raises(ValueError, match=message):
        RelevanceVectors.from_arrays(good.to_arrays() | {name: value})
