# ruff: noqa: N806  (X as in scikit-learn)
from __future__ import annotations

import time
import warnings
from collections.abc import Iterator

import numpy as np
import pytest
from scipy.special import expit, softmax
from sklearn.base import clone
from sklearn.datasets import make_blobs, make_classification, make_moons
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import log_loss
from sklearn.model_selection import GroupKFold
from sklearn.utils.estimator_checks import check_estimator
from threadpoolctl import threadpool_limits

from pdr_filter.classifiers.kernel_machine import RelevanceVectors, moderated_softmax, normalised_sigmoids
from pdr_filter.classifiers.rvm import (
    Budget,
    RelevanceVectorClassifier,
    basis_functions,
    median_distance,
    stratified_rows,
    train_multinomial,
)
from pdr_filter.classifiers.rvm_training import Bernoulli, train_rvm

pytestmark = pytest.mark.filterwarnings("ignore:.*rows are candidates")


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    with threadpool_limits(limits=1, user_api="blas"):
        yield


def three_blobs(seed: int = 0, n: int = 150) -> tuple[np.ndarray, np.ndarray]:
    return make_blobs(n, 3, centers=[[0, 0, 0], [2.5, 0, 1], [0, 2.5, -1]], random_state=seed)


def six_classes(n: int = 700, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    return make_classification(n, 10, n_informative=6, n_classes=6, n_clusters_per_class=1, random_state=seed)


@pytest.fixture(scope="module", params=["one_against_all", "multinomial"])
def blobs(request: pytest.FixtureRequest) -> tuple[RelevanceVectorClassifier, np.ndarray]:
    X, y = three_blobs()
    return RelevanceVectorClassifier(multi_class=request.param).fit(X, y), three_blobs(1, 200)[0]


@pytest.mark.parametrize(("kernel", "multi_class"), [("rbf", "multinomial"), ("linear", "one_against_all")])
def test_it_is_a_scikit_learn_estimator(kernel: str, multi_class: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # checks that are skipped, and candidates that are drawn
        check_estimator(RelevanceVectorClassifier(kernel=kernel, multi_class=multi_class, max_samples=40))


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
    assert len(classifier.relevance_vectors_) <= 15
    assert classifier.score(X_test, y_test) > 0.89  # 0.92 is the best possible
    assert log_loss(y_test, classifier.predict_proba(X_test)) < 0.28


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


def test_a_row_that_every_machine_rejects_still_has_probabilities() -> None:
    p = normalised_sigmoids(np.array([-2000.0, -2000.0, -2001.0]), np.zeros(3))
    np.testing.assert_allclose(p, np.array([1.0, 1.0, np.exp(-1.0)]) / (2.0 + np.exp(-1.0)), rtol=1e-10)


def test_names_and_order_of_the_labels_do_not_matter(blobs: tuple[RelevanceVectorClassifier, np.ndarray]) -> None:
    classifier, X_test = blobs
    X, y = three_blobs()
    names = np.array(["walking", "upstairs", "running"])
    renamed = clone(classifier).fit(X, names[y])
    columns = [list(renamed.classes_).index(name) for name in names]
    difference = np.abs(renamed.predict_proba(X_test)[:, columns] - classifier.predict_proba(X_test))
    if classifier.multi_class == "one_against_all":
        assert difference.max() < 1e-12
    else:  # classes take turns in the order of their names and may end at another local maximum of the evidence
        assert difference.mean() < 0.03


def test_moderation_makes_probabilities_less_confident_and_lowers_the_log_loss() -> None:
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


def test_rows_that_are_not_candidates_count_in_the_likelihood() -> None:
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


def test_each_class_is_trained_against_all_others() -> None:
    X, y = three_blobs()
    X_test = three_blobs(1, 200)[0]
    candidates = np.unique(X, axis=0)
    width = median_distance(candidates)
    functions = basis_functions(X, candidates, "rbf", width)
    sigmoids = []
    for k in range(3):
        machine = train_rvm(Bernoulli((y == k).astype(float), np.ones(150), np.zeros(150)), functions).posterior
        phi = basis_functions(X_test, candidates, "rbf", width)[machine.basis].T
        covariance = machine.cov_factor.T @ machine.cov_factor
        kappa = 1 / np.sqrt(1 + np.pi / 8 * np.einsum("ni,ij,nj->n", phi, covariance, phi))
        sigmoids.append(expit(kappa * (phi @ machine.mean)))
    expected = np.array(sigmoids).T
    expected /= expected.sum(axis=1, keepdims=True)
    p = RelevanceVectorClassifier().fit(X, y).predict_proba(X_test)
    np.testing.assert_allclose(p, expected, atol=1e-10)


def test_with_two_classes_both_forms_are_the_same() -> None:
    X, y = make_moons(120, noise=0.3, random_state=0)
    one = RelevanceVectorClassifier().fit(X, y).predict_proba(X)
    np.testing.assert_allclose(RelevanceVectorClassifier(multi_class="multinomial").fit(X, y).predict_proba(X), one)


def test_the_multinomial_machines_end_at_the_mode_of_the_joint_posterior() -> None:
    X, y = three_blobs()
    functions = basis_functions(X, X, "rbf", median_distance(X))
    machines = train_multinomial(functions, y, np.ones(150), 3, Budget(100, 400, 0.05))
    residual = np.eye(3)[y].T - softmax([m.posterior.logit for m in machines], axis=0)
    for machine, r in zip(machines, residual, strict=True):
        p = machine.posterior
        gradient = functions[p.basis] @ r - p.alpha * p.mean
        newton = p.cov_factor.T @ (p.cov_factor @ gradient)
        assert 0.5 * gradient @ newton < 0.05  # nats that the best step could still gain


@pytest.mark.parametrize("multi_class", ["one_against_all", "multinomial"])
def test_six_classes_are_distinguished(multi_class: str) -> None:
    X, y = six_classes(1200)
    classifier = RelevanceVectorClassifier(multi_class=multi_class).fit(X[:500], y[:500])
    oracle = LogisticRegression(max_iter=2000).fit(X[:500], y[:500])
    loss = log_loss(y[500:], classifier.predict_proba(X[500:]))
    assert loss < log_loss(y[500:], oracle.predict_proba(X[500:])) - 0.1
    assert (classifier.machine_.weights != 0).sum(axis=1).max() <= 60


@pytest.mark.parametrize("share", [0.5, 4.0])
def test_wide_kernels_do_not_diverge(share: float) -> None:
    X, y = six_classes(700)
    width = share * median_distance(X[:400])
    classifier = RelevanceVectorClassifier(kernel_width=width).fit(X[:400], y[:400])
    linear = LogisticRegression(max_iter=2000).fit(X[:400], y[:400])
    assert classifier.score(X[400:], y[400:]) > linear.score(X[400:], y[400:]) - 0.03
    assert np.isfinite(classifier.machine_.weights).all()


def test_duplicated_rows_are_one_candidate_and_count_twice() -> None:
    X, y = three_blobs(n=60)
    doubled = RelevanceVectorClassifier().fit(np.vstack([X, X]), np.concatenate([y, y]))
    weighted = RelevanceVectorClassifier().fit(X, y, sample_weight=np.full(60, 2.0))
    np.testing.assert_allclose(doubled.predict_proba(X), weighted.predict_proba(X), rtol=1e-6)
    assert len(np.unique(doubled.relevance_vectors_, axis=0)) == len(doubled.relevance_vectors_)


@pytest.mark.parametrize("multi_class", ["one_against_all", "multinomial"])
def test_a_class_of_two_rows_has_a_probability(multi_class: str) -> None:
    X, y = three_blobs(n=100)
    keep = np.sort(np.concatenate([np.flatnonzero(y < 2), np.flatnonzero(y == 2)[:2]]))
    for settings in ({}, {"class_weight": "balanced"}, {"kernel_width": "cv"}):
        classifier = RelevanceVectorClassifier(multi_class=multi_class, **settings).fit(X[keep], y[keep])
        p = classifier.predict_proba(X)
        assert np.isfinite(p).all()
        assert (p[:, 2] > 0).all()
        assert p[y == 2, 2].mean() > p[y != 2, 2].mean()


def test_balanced_classes_find_more_of_the_rare_one() -> None:
    X, y = three_blobs(n=600)
    keep = np.sort(np.concatenate([np.flatnonzero(y < 2), np.flatnonzero(y == 2)[:10]]))
    X, y = X[keep] * [0.6, 0.6, 0.6], y[keep]
    plain = RelevanceVectorClassifier().fit(X, y)
    balanced = RelevanceVectorClassifier(class_weight="balanced").fit(X, y)
    given = RelevanceVectorClassifier(class_weight={0: 410 / 600, 1: 410 / 600, 2: 410 / 30}).fit(X, y)
    assert balanced.predict_proba(X)[:, 2].mean() > 2 * plain.predict_proba(X)[:, 2].mean()
    np.testing.assert_allclose(given.predict_proba(X), balanced.predict_proba(X), atol=1e-6)


def test_a_row_of_weight_zero_has_no_effect() -> None:
    X, y = three_blobs(n=90)
    weight = np.arange(90) % 3 > 0
    p = RelevanceVectorClassifier().fit(X, y, sample_weight=weight).predict_proba(X)
    np.testing.assert_array_equal(RelevanceVectorClassifier().fit(X[weight], y[weight]).predict_proba(X), p)


def test_constant_features_change_nothing() -> None:
    X, y = three_blobs(n=90)
    more = np.hstack([X, np.full((90, 2), 3.0)])
    p = RelevanceVectorClassifier().fit(X, y).predict_proba(X)
    np.testing.assert_allclose(RelevanceVectorClassifier().fit(more, y).predict_proba(more), p, atol=1e-6)
    linear = RelevanceVectorClassifier(kernel="linear", tol=1e-5, max_iter=1000)
    p = linear.fit(X, y).predict_proba(X)
    np.testing.assert_allclose(linear.fit(more, y).predict_proba(more), p, atol=0.02)
    same = RelevanceVectorClassifier().fit(np.ones((90, 2)), y).predict_proba(np.ones((1, 2)))
    np.testing.assert_allclose(same, 1 / 3, atol=0.03)


def test_the_width_chosen_by_cross_validation_has_the_lowest_log_loss() -> None:
    X, y = three_blobs(n=100)
    groups = np.repeat(np.arange(20), 5)
    classifier = RelevanceVectorClassifier(kernel_width="cv").fit(X, y)
    losses = classifier.cv_log_loss_
    np.testing.assert_allclose(
        np.array(list(losses)) / median_distance(np.unique(X, axis=0)), [0.5, 0.7, 1, 1.4, 2, 2.8, 4]
    )
    assert losses[classifier.kernel_width_] == min(losses.values())
    given = RelevanceVectorClassifier(kernel_width=classifier.kernel_width_).fit(X, y)
    np.testing.assert_array_equal(given.predict_proba(X), classifier.predict_proba(X))
    by_splitter = RelevanceVectorClassifier(kernel_width="cv", cv=GroupKFold(3)).fit(X, y, groups=groups)
    assert len(by_splitter.cv_log_loss_) == 7


def test_groups_stay_whole_in_the_search_for_a_width() -> None:
    # Each person wears the device differently: rows of the same person give a narrow kernel away.
    rng = np.random.default_rng(0)
    person = np.repeat(np.arange(30), 12)
    y = np.repeat(rng.integers(0, 2, 30), 12)  # a label of the person
    X = rng.normal(size=(30, 4))[person] * 2 + 0.05 * rng.normal(size=(360, 4)) + 0.5 * y[:, None]
    alone = RelevanceVectorClassifier(kernel_width="cv").fit(X, y)
    grouped = RelevanceVectorClassifier(kernel_width="cv").fit(X, y, groups=person)
    assert min(alone.cv_log_loss_.values()) < 0.2
    assert min(grouped.cv_log_loss_.values()) > 0.4


def test_limits_that_were_reached_are_reported() -> None:
    X, y = six_classes(200)
    with pytest.warns(ConvergenceWarning, match="raise max_iter"):
        assert RelevanceVectorClassifier(max_iter=2).fit(X, y).n_iter_ == 2
    with pytest.warns(ConvergenceWarning, match="raise max_basis"):
        classifier = RelevanceVectorClassifier(max_basis=4).fit(X, y)
    assert classifier.machine_.weights.shape[1] <= 4
    with pytest.warns(ConvergenceWarning, match=r"of 200 rows are candidates.*max_samples"):
        RelevanceVectorClassifier(max_samples=50).fit(X, y)
    with pytest.warns(ConvergenceWarning, match="raise max_iter"):
        assert RelevanceVectorClassifier(max_iter=2, multi_class="multinomial").fit(X, y).n_iter_ == 2
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        RelevanceVectorClassifier().fit(X, y)


def test_a_hundred_thousand_rows_stay_within_the_budgets() -> None:
    X, y = make_classification(100_000, 10, n_informative=6, n_classes=3, n_clusters_per_class=1, random_state=0)
    classifier = RelevanceVectorClassifier(max_samples=60, max_basis=20, max_iter=15)
    start = time.process_time()
    with pytest.warns(ConvergenceWarning):
        classifier.fit(X, y)
    assert time.process_time() - start < 30  # about 4 s
    assert classifier.machine_.weights.shape[1] <= 20
    assert classifier.n_iter_ <= 15
    assert classifier.score(X[:500], y[:500]) > 0.8


# --- what is stored ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kernel", ["rbf", "linear"])
@pytest.mark.parametrize("multi_class", ["one_against_all", "multinomial"])
@pytest.mark.parametrize("n_classes", [2, 3])
def test_stored_inference_equals_the_estimator(kernel: str, multi_class: str, n_classes: int) -> None:
    X, y = three_blobs()
    X, y = X[y < n_classes], y[y < n_classes]
    classifier = RelevanceVectorClassifier(kernel=kernel, multi_class=multi_class).fit(X, y)
    stored = RelevanceVectors.from_arrays(classifier.machine_.to_arrays())
    np.testing.assert_array_equal(stored.predict_proba(X), classifier.predict_proba(X))


def test_arrays_without_a_link_are_one_against_all(blobs: tuple[RelevanceVectorClassifier, np.ndarray]) -> None:
    arrays = blobs[0].machine_.to_arrays()
    del arrays["link"]
    assert RelevanceVectors.from_arrays(arrays).link == "sigmoid"


def test_the_moderated_softmax_is_the_softmax_without_variance() -> None:
    logit = np.array([3.0, -1000.0, 2.0, 700.0, 699.0])
    np.testing.assert_allclose(moderated_softmax(logit, np.zeros(5)), softmax(logit), rtol=1e-10)


def test_the_moderated_softmax_of_two_classes_is_the_moderated_sigmoid() -> None:
    kappa = 1 / np.sqrt(1 + np.pi / 8 * 5.0)
    expected = expit(kappa * (1.3 - 0.2))
    np.testing.assert_allclose(moderated_softmax(np.array([0.2, 1.3]), np.array([1.0, 4.0])), [1 - expected, expected])


def test_the_moderated_softmax_is_near_the_mean_over_the_posterior() -> None:
    rng = np.random.default_rng(0)
    logit, variance = np.array([1.0, 0.0, -1.0, 2.0]), np.array([2.0, 1.0, 3.0, 0.5])
    drawn = softmax(logit + np.sqrt(variance) * rng.normal(size=(200_000, 4)), axis=1).mean(axis=0)
    found = moderated_softmax(logit, variance)
    assert np.abs(found - drawn).max() < 0.03
    assert np.abs(found - drawn).max() < 0.5 * np.abs(softmax(logit) - drawn).max()


def test_a_row_has_the_same_bits_alone_and_in_any_batch(blobs: tuple[RelevanceVectorClassifier, np.ndarray]) -> None:
    machine, rows = blobs[0].machine_, blobs[1]
    together = machine.predict_proba(rows)
    np.testing.assert_array_equal(np.vstack([machine.predict_proba(row[None]) for row in rows]), together)
    np.testing.assert_array_equal(machine.predict_proba(rows[3:17]), together[3:17])
    np.testing.assert_array_equal(machine.predict_proba(np.asfortranarray(rows)), together)


def test_a_feature_that_is_not_finite_is_named(blobs: tuple[RelevanceVectorClassifier, np.ndarray]) -> None:
    with pytest.raises(ValueError, match="feature 2 is nan in row 1"):
        blobs[0].machine_.predict_proba([[0.0, 0.0, 0.0], [0.0, 0.0, np.nan]])
