# ruff: noqa: N806  (X as in scikit-learn)
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sklearn.datasets import make_classification
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.linear_model import LogisticRegression

from pdr_filter.classifiers.blend import Blend, Mixture, kind_of
from pdr_filter.classifiers.boosting import BoostedTrees
from pdr_filter.classifiers.softmax import SoftmaxRegression

Trained = tuple[HistGradientBoostingClassifier, BoostedTrees, np.ndarray, np.ndarray]


@pytest.fixture(scope="module")
def trained() -> Trained:
    X, y = make_classification(900, 10, n_informative=6, n_classes=4, random_state=0)
    X = X.astype(np.float32).astype(np.float64)
    boosting = HistGradientBoostingClassifier(
        max_iter=20, max_leaf_nodes=8, max_features=0.5, early_stopping=False, random_state=0
    ).fit(X[:600], y[:600])
    return boosting, BoostedTrees.from_sklearn(boosting), X, y


def test_probabilities_are_those_of_scikit_learn(trained: Trained) -> None:
    boosting, ours, X, _ = trained
    np.testing.assert_allclose(ours.predict_proba(X), boosting.predict_proba(X), rtol=1e-12)


def test_two_classes_also_have_the_probabilities_of_scikit_learn() -> None:
    X, y = make_classification(300, 6, random_state=0)
    X = X.astype(np.float32).astype(np.float64)
    boosting = HistGradientBoostingClassifier(max_iter=10, early_stopping=False, random_state=0).fit(X, y)
    ours = BoostedTrees.from_sklearn(boosting)
    np.testing.assert_allclose(ours.predict_proba(X), boosting.predict_proba(X), rtol=1e-12)


def test_a_row_on_a_threshold_goes_to_the_same_side_as_in_scikit_learn(trained: Trained) -> None:
    boosting, ours, X, _ = trained
    rows = np.repeat(X[:1], 400, axis=0)
    inner = np.flatnonzero(~ours.trees.is_leaf)[:400]
    near = ours.trees.threshold[inner].astype(np.float32).astype(np.float64)
    rows[np.arange(len(inner)), ours.trees.feature[inner]] = near
    np.testing.assert_allclose(ours.predict_proba(rows), boosting.predict_proba(rows), rtol=1e-12)


def test_a_row_has_the_same_bits_alone_and_in_a_batch(trained: Trained) -> None:
    _, ours, X, _ = trained
    batch = ours.predict_proba(X)
    for i in range(0, len(X), 50):
        np.testing.assert_array_equal(ours.predict_proba(X[i : i + 1])[0], batch[i])
    assert ours.predict_proba(X[:0]).shape == (0, 4)


def test_arrays_restore_the_boosted_trees(trained: Trained) -> None:
    _, ours, X, _ = trained
    back = BoostedTrees.from_arrays(ours.to_arrays())
    np.testing.assert_array_equal(back.predict_proba(X), ours.predict_proba(X))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(baseline=np.zeros(3)), "divides the number of trees"),
        (dict(baseline=np.zeros(1)), "2 or more classes"),
        (dict(baseline=np.full(4, np.inf)), "must be finite"),
        (dict(value=np.zeros(3)), "finite, got .* one for each node"),
    ],
)
def test_arrays_that_are_not_boosted_trees_are_refused(
    trained: Trained, change: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        replace(trained[1], **change)
    with pytest.raises(ValueError, match=r"features of inner nodes must be from 0 to 1, got [2-9].*train again"):
        replace(trained[1].trees, n_features=2)


def test_nan_is_refused_with_its_row_and_column(trained: Trained) -> None:
    rows = trained[2][:3].copy()
    rows[1, 4] = np.nan
    with pytest.raises(ValueError, match="feature 4 is nan in row 1"):
        trained[1].predict_proba(rows)


def test_a_blend_is_the_mean_of_the_logits(trained: Trained) -> None:
    _, trees, X, y = trained
    fitted = LogisticRegression(max_iter=500).fit(X[:600], y[:600])
    blend = Blend((SoftmaxRegression(fitted.coef_, fitted.intercept_), trees))
    log_prob = 0.5 * (np.log(fitted.predict_proba(X)) + np.log(trees.predict_proba(X)))
    expected = np.exp(log_prob) / np.exp(log_prob).sum(axis=1, keepdims=True)
    np.testing.assert_allclose(blend.predict_proba(X), expected, rtol=1e-9)
    back = Blend.from_arrays(blend.to_arrays())
    np.testing.assert_array_equal(back.predict_proba(X), blend.predict_proba(X))
    assert (blend.n_features, blend.n_classes) == (10, 4)
    former = {"linear_" + name: a for name, a in blend.parts[0].to_arrays().items()}
    former |= {"trees_" + name: a for name, a in trees.to_arrays().items()}
    np.testing.assert_array_equal(Blend.from_arrays(former).predict_proba(X), blend.predict_proba(X))


def test_a_mixture_is_the_mean_of_the_probabilities_and_stays_so_in_files(trained: Trained) -> None:
    _, trees, X, y = trained
    fitted = LogisticRegression(max_iter=500).fit(X[:600], y[:600])
    linear = SoftmaxRegression(fitted.coef_, fitted.intercept_)
    mixture = Mixture((Blend((linear, trees)), trees))
    expected = 0.5 * (Blend((linear, trees)).predict_proba(X) + trees.predict_proba(X))
    np.testing.assert_allclose(mixture.predict_proba(X), expected, rtol=1e-12)
    assert kind_of(mixture) == "mixture"
    back = Mixture.from_arrays(mixture.to_arrays())
    np.testing.assert_array_equal(back.predict_proba(X), mixture.predict_proba(X))


def test_the_weights_of_the_parts_are_used_and_stay_in_files(trained: Trained) -> None:
    _, trees, X, _ = trained
    uniform = SoftmaxRegression(np.zeros((4, 10)), np.zeros(4))
    mixture, blend = Mixture((uniform, trees), (0.25, 0.75)), Blend((uniform, trees), (0.25, 0.75))
    p = trees.predict_proba(X)
    np.testing.assert_allclose(mixture.predict_proba(X), 0.25 * 0.25 + 0.75 * p, rtol=1e-12)
    np.testing.assert_allclose(blend.predict_proba(X), p**0.75 / (p**0.75).sum(axis=1, keepdims=True), rtol=1e-9)
    back = Mixture.from_arrays(mixture.to_arrays())
    np.testing.assert_array_equal(back.predict_proba(X), mixture.predict_proba(X))
    with pytest.raises(ValueError, match="weights must be one for each of 2 parts and sum to 1"):
        Mixture((uniform, trees), (0.5, 0.6))


def test_parts_with_different_features_cannot_be_blended(trained: Trained) -> None:
    with pytest.raises(ValueError, match="same numbers of features and classes"):
        Blend((SoftmaxRegression(np.zeros((4, 3)), np.zeros(4)), trained[1]))
