from __future__ import annotations

import numpy as np
from sklearn.linear_model import LogisticRegression

from pdr_filter.classifiers.softmax import SoftmaxRegression


def problem(n: int = 600, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    label = rng.integers(0, 4, n)
    return rng.normal(size=(n, 5)) + np.eye(4, 5)[label], label


def test_probabilities_are_those_of_scikit_learn() -> None:
    rows, y = problem()
    fitted = LogisticRegression(max_iter=500).fit(rows, y)
    ours = SoftmaxRegression(fitted.coef_, fitted.intercept_)
    np.testing.assert_allclose(ours.predict_proba(rows), fitted.predict_proba(rows), atol=1e-12)


def test_a_row_has_the_same_bits_alone_and_in_a_batch() -> None:
    rows, y = problem()
    fitted = LogisticRegression(max_iter=500).fit(rows, y)
    ours = SoftmaxRegression(fitted.coef_, fitted.intercept_)
    batch = ours.predict_proba(rows)
    for i in range(0, len(rows), 7):
        np.testing.assert_array_equal(ours.predict_proba(rows[i : i + 1])[0], batch[i])


def test_arrays_restore_the_regression() -> None:
    ours = SoftmaxRegression(np.arange(6.0).reshape(2, 3), np.ones(2))
    back = SoftmaxRegression.from_arrays(ours.to_arrays())
    np.testing.assert_array_equal(back.predict_proba([[1.0, 2.0, 3.0]]), ours.predict_proba([[1.0, 2.0, 3.0]]))
