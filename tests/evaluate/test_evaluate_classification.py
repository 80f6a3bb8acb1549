"""Classification metrics: closed forms, and scikit-learn as the oracle."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pdr_filter.evaluate import classification

sklearn_metrics = pytest.importorskip("sklearn.metrics")


def drawn(seed: int, n: int = 300, n_classes: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Labels and probabilities that know something of them."""
    rng = np.random.default_rng(seed)
    label = rng.integers(0, n_classes, n)
    logits = rng.normal(size=(n, n_classes)) + 1.5 * np.eye(n_classes)[label]
    return label, np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)


def test_rows_of_the_confusion_matrix_are_the_truth() -> None:
    found = classification.confusion_matrix(np.array([0, 0, 1]), np.array([0, 1, 1]), 3)
    np.testing.assert_array_equal(found, [[1, 1, 0], [0, 1, 0], [0, 0, 0]])


def test_counts_and_scores_are_those_of_scikit_learn() -> None:
    for seed in range(5):
        label, prob = drawn(seed)
        predicted = prob.argmax(axis=1)
        confusion = classification.confusion_matrix(label, predicted, 5)
        np.testing.assert_array_equal(confusion, sklearn_metrics.confusion_matrix(label, predicted, labels=range(5)))
        assert classification.accuracy(confusion) == pytest.approx(sklearn_metrics.accuracy_score(label, predicted))
        assert classification.kappa(confusion) == pytest.approx(sklearn_metrics.cohen_kappa_score(label, predicted))
        balanced = sklearn_metrics.balanced_accuracy_score(label, predicted)
        assert classification.macro_recall(confusion) == pytest.approx(balanced)
        for ours, theirs in (
            (classification.recall, sklearn_metrics.recall_score),
            (classification.precision, sklearn_metrics.precision_score),
        ):
            np.testing.assert_allclose(ours(confusion), theirs(label, predicted, average=None))
        assert classification.log_loss(prob, label) == pytest.approx(sklearn_metrics.log_loss(label, prob))


def test_kappa_is_zero_by_chance_and_one_if_all_is_right() -> None:
    assert classification.kappa(np.outer([10, 20], [3, 3])) == pytest.approx(0.0, abs=1e-15)
    assert classification.kappa(np.diag([4, 9])) == 1.0


def test_kappa_of_a_single_class_is_not_known() -> None:
    assert np.isnan(classification.kappa(np.diag([7, 0])))


def test_log_loss_of_knowing_nothing_is_the_log_of_the_number_of_classes() -> None:
    assert classification.log_loss(np.full((9, 6), 1 / 6), np.arange(9) % 6) == pytest.approx(np.log(6))


def test_one_certain_error_does_not_make_the_log_loss_infinite() -> None:
    assert classification.log_loss(np.array([[1.0, 0.0]]), np.array([1])) == pytest.approx(-np.log(1e-15))


def test_calibration_error_is_the_distance_of_confidence_and_accuracy() -> None:
    """Ten windows at 0.8 of which six are right: 0.2 off."""
    prob = np.tile([0.8, 0.2], (10, 1))
    assert classification.calibration_error(prob, np.array([0] * 6 + [1] * 4)) == pytest.approx(0.2)


def test_labels_drawn_from_their_probabilities_are_calibrated() -> None:
    rng = np.random.default_rng(4)
    prob = rng.dirichlet(np.ones(4), 40_000)
    label = (prob.cumsum(axis=1) < rng.random((len(prob), 1))).sum(axis=1)
    assert classification.calibration_error(prob, label) < 0.01
    assert classification.calibration_error(prob**3 / (prob**3).sum(axis=1, keepdims=True), label) > 0.1


def test_a_class_that_does_not_occur_has_no_recall_and_is_in_the_table() -> None:
    confusion = classification.confusion_matrix(np.array([0, 0, 1]), np.array([0, 1, 1]), 3)
    found = classification.class_table(confusion, ("stationary", "walking", "upstairs"))
    assert found.class_name.tolist() == ["stationary", "walking", "upstairs"]
    assert found.n.tolist() == [2, 1, 0]
    np.testing.assert_array_equal(found.recall, [0.5, 1.0, np.nan])
    np.testing.assert_array_equal(found.precision, [1.0, 0.5, np.nan])
    assert classification.macro_recall(confusion) == 0.75


SCORES = (classification.log_loss, classification.calibration_error, classification.brier_score)


@pytest.mark.parametrize("score", SCORES)
@pytest.mark.parametrize("label", [[0, -1], [0, 5], [0.0, 1.0], [0]], ids=["unknown", "too many", "float", "short"])
def test_what_has_no_class_does_not_count_as_the_last_one(score: Any, label: list[float]) -> None:
    prob = drawn(0, n=2)[1]
    with pytest.raises(ValueError, match="label"):
        score(prob, np.array(label))


@pytest.mark.parametrize("score", SCORES)
def test_of_no_predictions_there_is_no_score(score: Any) -> None:
    assert np.isnan(score(np.zeros((0, 3)), np.zeros(0, dtype=int)))


def test_probabilities_that_are_not_known_have_no_reliability() -> None:
    label, prob = drawn(0, n=3)
    prob[1] = np.nan
    with pytest.raises(ValueError, match="leave out rows with NaN"):
        classification.calibration_error(prob, label)
