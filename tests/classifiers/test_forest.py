# ruff: noqa: N806  (X as in scikit-learn)
from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, replace

import numpy as np
import pytest
from sklearn.datasets import make_classification
from sklearn.ensemble import RandomForestClassifier

from pdr_filter.classifiers.forest import Forest
from pdr_filter.classifiers.trees import Trees


def problem(seed: int, n_rows: int = 400, n_classes: int = 4) -> tuple[np.ndarray, np.ndarray]:
    return make_classification(
        n_rows, 12, n_informative=6, n_classes=n_classes, flip_y=0.1, random_state=seed
    )  # labels with noise make deep trees


@pytest.fixture(scope="module")
def trained() -> tuple[RandomForestClassifier, Forest, np.ndarray]:
    X, y = problem(0)
    # leaves of several rows hold fractions, whose sum depends on the order of the trees in the last bit
    oracle = RandomForestClassifier(30, min_samples_leaf=3, random_state=0).fit(X, y)
    return oracle, Forest.from_sklearn(oracle), np.random.default_rng(1).normal(0, 2, (700, 12))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "settings",
    [
        {"n_estimators": 1},
        {"n_estimators": 40},
        {"n_estimators": 15, "max_leaf_nodes": 9},  # grown best first: nodes in another order
        {"n_estimators": 15, "min_samples_leaf": 15, "class_weight": "balanced"},
        {"n_estimators": 5, "max_depth": 1},
    ],
)
def test_probabilities_equal_those_of_scikit_learn(seed: int, settings: dict) -> None:
    X, y = problem(seed, n_classes=2 + seed % 3)
    oracle = RandomForestClassifier(random_state=seed, **settings).fit(X, y)
    rows = np.vstack([X, np.random.default_rng(seed).normal(0, 3, (600, 12))])
    np.testing.assert_allclose(Forest.from_sklearn(oracle).predict_proba(rows), oracle.predict_proba(rows), atol=1e-14)


def test_a_tree_that_is_only_a_leaf_predicts_its_class() -> None:
    X = np.zeros((5, 3))
    oracle = RandomForestClassifier(3, random_state=0).fit(X, np.ones(5))
    np.testing.assert_array_equal(Forest.from_sklearn(oracle).predict_proba(X + 7.0), np.ones((5, 1)))
    oracle = RandomForestClassifier(3, random_state=0, bootstrap=False).fit(X, [0, 0, 0, 1, 1])  # nothing to split on
    np.testing.assert_allclose(Forest.from_sklearn(oracle).predict_proba(X[:1]), [[0.6, 0.4]])


def test_features_within_rounding_of_a_threshold_go_where_scikit_learn_sends_them(
    trained: tuple[RandomForestClassifier, Forest, np.ndarray],
) -> None:
    oracle, forest, _ = trained
    inner = np.flatnonzero(forest.trees.left >= 0)[:400]
    edges: list[np.ndarray] = []
    for node in inner:
        threshold = forest.trees.threshold[node]
        in_float32 = float(np.float32(threshold))
        for value in (threshold, in_float32, np.nextafter(in_float32, np.inf), np.nextafter(in_float32, -np.inf)):
            row = np.zeros(12)
            row[forest.trees.feature[node]] = value
            edges.append(row)
    rows = np.array(edges)
    np.testing.assert_allclose(forest.predict_proba(rows), oracle.predict_proba(rows), atol=1e-14)


EDGES = [0.0, -0.0, 1e-50, -1e-50, 1.0, 1 + 1e-9, 1 - 1e-9, 1.0000001, 3.4028234e38, 3.4028236e38, 1e39, -1e39, -1e300]


@pytest.mark.parametrize("threshold", EDGES)  # most of them no float32, some beyond its range
def test_thresholds_are_not_rounded_to_float32(threshold: float) -> None:
    stump = Forest(Trees(1, [0], [0, -1, -1], [threshold, 0, 0], [1, -1, -1], [2, -1, -1]), [[0, 0], [1, 0], [0, 1]])  # type: ignore[arg-type]
    values = np.array(EDGES)
    with np.errstate(over="ignore"):
        in_float32 = values.astype(np.float32).astype(np.float64)
        values = np.concatenate([values, np.nextafter(in_float32.astype(np.float32), np.float32(1)).astype(np.float64)])
        values = values[np.isfinite(values)]
        goes_left = values.astype(np.float32).astype(np.float64) <= threshold
    np.testing.assert_array_equal(stump.predict_proba(values[:, None])[:, 0] == 1, goes_left)


@pytest.mark.parametrize("goes_deep", ["left", "right"])
@pytest.mark.parametrize("n_inner", [1, 2, 5, 13, 40])
def test_every_leaf_of_a_very_uneven_tree_is_reached(goes_deep: str, n_inner: int) -> None:
    # inner node i is 2 i, with a leaf at 2 i + 1 and the next node at 2 i + 2; the deepest leaf is the last node
    inner = 2 * np.arange(n_inner)
    leaf, deeper = np.full((2, 2 * n_inner + 1), -1)
    leaf[inner], deeper[inner] = inner + 1, inner + 2
    threshold = np.zeros(2 * n_inner + 1)
    threshold[inner] = np.arange(n_inner) * (1.0 if goes_deep == "right" else -1.0)
    left, right = (leaf, deeper) if goes_deep == "right" else (deeper, leaf)
    leaves = np.array([*(inner + 1), 2 * n_inner])
    probability = np.zeros((2 * n_inner + 1, n_inner + 1))
    probability[leaves] = np.eye(n_inner + 1)
    tree = Forest(Trees(1, np.array([0]), np.zeros_like(left), threshold, left, right), probability)
    rows = (np.arange(n_inner + 1) - 0.5)[:, None] * (1.0 if goes_deep == "right" else -1.0)
    np.testing.assert_array_equal(tree.predict_proba(rows), np.eye(n_inner + 1))
    for i, row in enumerate(rows):
        np.testing.assert_array_equal(tree.predict_proba(row[None])[0], np.eye(n_inner + 1)[i])


def test_a_large_forest_has_the_same_bits_for_a_row_alone_and_in_any_batch() -> None:
    X, y = problem(0, 600)
    oracle = RandomForestClassifier(200, min_samples_leaf=2, random_state=0).fit(X, y)
    forest = Forest.from_sklearn(oracle)
    together = forest.predict_proba(X)
    np.testing.assert_array_equal(together, oracle.predict_proba(X))
    np.testing.assert_array_equal(np.vstack([forest.predict_proba(row[None]) for row in X]), together)
    np.testing.assert_array_equal(forest.predict_proba(np.asfortranarray(X)), together)
    for size in (2, 81, 82, 599):
        np.testing.assert_array_equal(forest.predict_proba(X[-size:]), together[-size:])


def test_a_forest_larger_than_a_batch_of_trees_predicts_the_mean_of_its_trees() -> None:
    n = 20_000  # stumps, half of them the other way round
    left, right = np.full((2, 3 * n), -1)
    left[::3], right[::3] = 3 * np.arange(n) + 1, 3 * np.arange(n) + 2
    probability = np.tile([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [0.0, 1.0], [1.0, 0.0]], (n // 2, 1))
    forest = Forest(Trees(1, left[::3] - 1, np.zeros(3 * n, int), np.zeros(3 * n), left, right), probability)
    np.testing.assert_array_equal(forest.predict_proba([[-1.0], [1.0], [0.0]]), np.full((3, 2), 0.5))


def test_all_arrays_are_read_only(trained: tuple[RandomForestClassifier, Forest, np.ndarray]) -> None:
    owners = trained[1], trained[1].trees
    arrays = [
        array for owner in owners for f in fields(owner) if isinstance(array := getattr(owner, f.name), np.ndarray)
    ]
    assert len(arrays) == 1 + 7
    assert not any(array.flags.writeable for array in arrays)


def test_no_rows_give_no_probabilities(trained: tuple[RandomForestClassifier, Forest, np.ndarray]) -> None:
    assert trained[1].predict_proba(np.zeros((0, 12))).shape == (0, 4)


def test_arrays_hold_the_whole_forest(trained: tuple[RandomForestClassifier, Forest, np.ndarray]) -> None:
    _, forest, rows = trained
    again = Forest.from_arrays(forest.to_arrays())
    np.testing.assert_array_equal(again.predict_proba(rows), forest.predict_proba(rows))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_feature_that_is_not_finite_is_named(
    trained: tuple[RandomForestClassifier, Forest, np.ndarray], bad: float
) -> None:
    rows = trained[2].copy()
    rows[5, 7] = bad
    with pytest.raises(ValueError, match=r"feature 7 is .* in row 5"):
        trained[1].predict_proba(rows)


def test_a_row_of_another_length_is_refused(trained: tuple[RandomForestClassifier, Forest, np.ndarray]) -> None:
    with pytest.raises(ValueError, match=r"X must be \(N, 12\)"):
        trained[1].predict_proba(np.zeros((2, 11)))


def changed(array: np.ndarray, index: int, value: float) -> np.ndarray:
    result = np.array(array)
    result[index] = value
    return result


@pytest.mark.parametrize(
    ("name", "index", "value", "message"),
    [
        ("left", 0, 0, "after its parent"),  # a circle: prediction would not end
        ("right", 0, 10**6, "after its parent"),
        ("left", 0, -1, "one child"),
        ("left", 0, 2, "belongs to no tree or has several parents"),
        ("roots", 1, 0, "belongs to no tree or has several parents"),
        ("roots", 1, -1, "roots must be nodes"),
        ("feature", 0, 12, "must be from 0 to 11"),
        ("feature", 0, -1, "must be from 0 to 11"),
        ("threshold", 0, np.nan, "threshold must be finite"),
    ],
)
def test_arrays_that_are_not_trees_are_refused(
    trained: tuple[RandomForestClassifier, Forest, np.ndarray], name: str, index: int, value: float, message: str
) -> None:
    trees = trained[1].trees
    with pytest.raises(ValueError, match=message):
        replace(trees, **{name: changed(getattr(trees, name), index, value)})


@pytest.mark.parametrize("leaf", [[0.5, 0.5, 0.5, 0.0], [1.5, -0.5, 0.0, 0.0], [np.nan, 0.0, 0.0, 1.0]])
def test_leaves_that_are_not_probabilities_are_refused(
    trained: tuple[RandomForestClassifier, Forest, np.ndarray], leaf: list[float]
) -> None:
    forest = trained[1]
    probability = np.array(forest.probability)
    probability[np.flatnonzero(forest.trees.left < 0)[3]] = leaf
    with pytest.raises(ValueError, match="sum to one"):
        replace(forest, probability=probability)


def test_arrays_of_different_lengths_are_refused(trained: tuple[RandomForestClassifier, Forest, np.ndarray]) -> None:
    with pytest.raises(ValueError, match="one entry for each node"):
        replace(trained[1].trees, threshold=trained[1].trees.threshold[:-1])


def test_prediction_needs_no_scikit_learn() -> None:
    modules = "pdr_filter.classifiers.forest, pdr_filter.classifiers.context_model"
    code = f"import sys, {modules}; sys.exit('sklearn' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
