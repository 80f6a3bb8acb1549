from __future__ import annotations

import numpy as np
import pytest
from sklearn.linear_model import LogisticRegression

from pdr_filter.context.softmax import SoftmaxRegression, fit_temperature


def problem(n: int = 600, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    label = rng.integers(0, 4, n)
    return rng.normal(size=(n, 5)) + np.eye(4, 5)[label], label


def test_probabilities_are_those_of_scikit_learn() -> None:
    rows, y = problem()
    fitted = LogisticRegression(max_iter=500).fit(rows, y)
    ours = SoftmaxRegression(fitted.coef_, fitted.intercept_, temperature=1.0, limit=100.0)
    np.testing.assert_allclose(ours.predict_proba(rows), fitted.predict_proba(rows), atol=1e-12)


def test_a_row_has_the_same_bits_alone_and_in_a_batch() -> None:
    rows, y = problem()
    fitted = LogisticRegression(max_iter=500).fit(rows, y)
    ours = SoftmaxRegression(fitted.coef_, fitted.intercept_, 1.3, 4.0)
    batch = ours.predict_proba(rows)
    for i in range(0, len(rows), 7):
        np.testing.assert_array_equal(ours.predict_proba(rows[i : i + 1])[0], batch[i])


def test_a_feature_beyond_the_limit_counts_as_the_limit() -> None:
    ours = SoftmaxRegression(np.array([[1.0, 0.0], [0.0, 1.0]]), np.zeros(2), 1.0, 4.0)
    np.testing.assert_array_equal(ours.predict_proba([[1e300, 0.0]]), ours.predict_proba([[4.0, 0.0]]))
    with pytest.raises(ValueError, match="NaN"):
        ours.predict_proba([[np.nan, 0.0]])


def test_arrays_come_back() -> None:
    ours = SoftmaxRegression(np.arange(6.0).reshape(2, 3), np.ones(2), 1.7, 4.0)
    back = SoftmaxRegression.from_arrays(ours.to_arrays())
    np.testing.assert_array_equal(back.predict_proba([[1.0, 2.0, 3.0]]), ours.predict_proba([[1.0, 2.0, 3.0]]))


@pytest.mark.parametrize("bad", [dict(temperature=0.0), dict(limit=-1.0), dict(weights=np.full((2, 3), np.nan))])
def test_what_is_no_regression_is_refused(bad: dict[str, object]) -> None:
    good = {"weights": np.zeros((2, 3)), "intercept": np.zeros(2), "temperature": 1.0, "limit": 4.0}
    with pytest.raises(ValueError, match="must be"):
        SoftmaxRegression(**{**good, **bad})  # type: ignore[arg-type]


@pytest.mark.parametrize("temperature", [0.5, 1.0, 2.5])
def test_the_temperature_that_made_probabilities_too_sure_is_found(temperature: float) -> None:
    rng = np.random.default_rng(1)
    logit = 2 * rng.normal(size=(40_000, 4))
    prob = np.exp(logit) / np.exp(logit).sum(axis=1, keepdims=True)
    label = (prob.cumsum(axis=1) > rng.random((len(prob), 1))).argmax(axis=1)
    sharp = prob**temperature / (prob**temperature).sum(axis=1, keepdims=True)
    assert fit_temperature(sharp, label) == pytest.approx(temperature, rel=0.05)


def test_the_temperature_divides_the_logits() -> None:
    weights = np.array([[2.0, 0.0], [0.0, 1.0]])
    warm = SoftmaxRegression(weights, np.array([0.5, 0.0]), 2.0, 4.0).predict_proba([[1.0, 3.0]])[0]
    assert np.log(warm[0] / warm[1]) == pytest.approx((2.5 - 3.0) / 2.0)
