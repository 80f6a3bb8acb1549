"""How well contexts were recognised: labels against labels, and probabilities against labels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdr_filter.classifiers.probability_calibration import brier_score as brier_score
from pdr_filter.classifiers.probability_calibration import check_classes, check_labels, reliability
from pdr_filter.values import FloatArray, IntArray, Table, table


def confusion_matrix(label: IntArray, predicted: IntArray, n_classes: int) -> IntArray:
    """Counts, (C, C): row the true class, column the predicted one; labels (N,) are 0 to C - 1."""
    for name, values in (("label", label), ("predicted", predicted)):
        check_classes(values, n_classes, name)
    if len(label) != len(predicted):
        raise ValueError(f"{len(label)} labels and {len(predicted)} predictions: give one for each")
    counts = np.zeros((n_classes, n_classes), dtype=np.int64)
    np.add.at(counts, (label, predicted), 1)
    return counts


def accuracy(confusion: IntArray) -> float:
    """Share of right predictions, the trace over the sum of a confusion matrix (C, C); NaN without any."""
    total = confusion.sum()
    return float(np.trace(confusion) / total) if total else np.nan


def recall(confusion: IntArray) -> FloatArray:
    """Share of each true class that was predicted, (C,); NaN for a class that does not occur."""
    return _share(np.diagonal(confusion), confusion.sum(axis=1))


def precision(confusion: IntArray) -> FloatArray:
    """Share of each predicted class that is true, (C,); NaN for a class that was never predicted."""
    return _share(np.diagonal(confusion), confusion.sum(axis=0))


def macro_recall(confusion: IntArray) -> float:
    """Mean recall of the classes that occur: the mean of the diagonal of a table like Martinelli et al.'s III."""
    return float(np.nanmean(recall(confusion))) if confusion.sum() else np.nan


def kappa(confusion: IntArray) -> float:
    """Cohen's kappa (p_o - p_e) / (1 - p_e), p_e the agreement by chance of the same margins (Cohen 1960, eq. 1).

    NaN where chance alone agrees always: one class only, in truth and prediction.
    """
    total = confusion.sum()
    if not total:
        return np.nan
    observed = np.trace(confusion) / total
    by_chance = float(confusion.sum(axis=0) @ confusion.sum(axis=1)) / float(total) ** 2
    return float((observed - by_chance) / (1.0 - by_chance)) if by_chance < 1.0 else np.nan


def log_loss(prob: FloatArray, label: IntArray, floor: float = 1e-15) -> float:
    """Mean of -log p of the true class, nats, of probabilities (N, C) and labels (N,).

    A probability below the floor counts as the floor, as one zero would make the mean infinite. NaN of none.
    """
    check_labels(prob, label)
    if not len(label):
        return np.nan
    return float(-np.log(np.maximum(prob[np.arange(len(label)), label], floor)).mean())


def calibration_error(prob: FloatArray, label: IntArray, n_bins: int = 15) -> float:
    """Expected calibration error of probabilities (N, C): mean distance of confidence and accuracy over bins.

    sum_b |B_b| / N |acc(B_b) - conf(B_b)|, bins of equal width in the highest probability (Guo, Pleiss, Sun and
    Weinberger 2017, eq. 3). `pdr_filter.classifiers.probability_calibration.reliability` has the bins. NaN of none.
    """
    check_labels(prob, label)
    if not len(label):
        return np.nan
    return reliability(prob, prob.argmax(axis=1) == label, n_bins).expected_calibration_error


def class_table(confusion: IntArray, classes: Sequence[str]) -> Table:
    """A row for each class: `class_name, n, recall, precision`."""
    if confusion.shape != (len(classes), len(classes)):
        raise ValueError(f"a confusion matrix of {len(classes)} classes is square, got {confusion.shape}")
    return table(
        {
            "class_name": np.array(classes),
            "n": confusion.sum(axis=1),
            "recall": recall(confusion),
            "precision": precision(confusion),
        }
    )


def _share(part: IntArray, whole: IntArray) -> FloatArray:
    return np.divide(part, whole, out=np.full(len(part), np.nan), where=whole > 0)
