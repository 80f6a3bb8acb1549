"""Evaluation of classifiers: predicted labels or probabilities against true labels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdr_filter.classifiers.probability_calibration import brier_score as brier_score
from pdr_filter.classifiers.probability_calibration import check_classes, check_labels, reliability_diagram
from pdr_filter.values import FloatArray, IntArray, Table, table


def confusion_matrix(label: IntArray, predicted: IntArray, n_classes: int) -> IntArray:
    """Return the confusion matrix of true and predicted labels.

    Parameters
    ----------
    label, predicted : ndarray of int, shape (N,)
        True and predicted labels, 0 to C - 1.
    n_classes : int
        Number of classes C.

    Returns
    -------
    ndarray of int, shape (C, C)
        Counts, with the true class in the row and the predicted class in the column.

    Raises
    ------
    ValueError
        If a label is out of range, or if the numbers of labels differ.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> pdr.evaluate.confusion_matrix(np.array([0, 0, 1]), np.array([0, 1, 1]), 2).tolist()
    [[1, 1], [0, 1]]
    """
    for name, values in (("label", label), ("predicted", predicted)):
        check_classes(values, n_classes, name)
    if len(label) != len(predicted):
        raise ValueError(f"label and predicted must have the same length, got {len(label)} and {len(predicted)}")
    counts = np.zeros((n_classes, n_classes), dtype=np.int64)
    np.add.at(counts, (label, predicted), 1)
    return counts


def accuracy(confusion: IntArray) -> float:
    """Return the share of correct predictions, the trace of a confusion matrix divided by its sum.

    Parameters
    ----------
    confusion : ndarray of int, shape (C, C)
        Confusion matrix, with the true class in the row and the predicted class in the column.

    Returns
    -------
    float
        Accuracy, 0 to 1; NaN for a matrix of zeros.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> pdr.evaluate.accuracy(np.array([[8, 2], [1, 9]]))
    0.85
    """
    total = confusion.sum()
    return float(np.trace(confusion) / total) if total else np.nan


def recall(confusion: IntArray) -> FloatArray:
    """Return the recall of each class: the share of its true samples that were predicted correctly.

    Parameters
    ----------
    confusion : ndarray of int, shape (C, C)
        Confusion matrix, with the true class in the row and the predicted class in the column.

    Returns
    -------
    ndarray of shape (C,)
        Recall, 0 to 1; NaN for a class without true samples.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> pdr.evaluate.recall(np.array([[8, 2], [1, 9]])).tolist()
    [0.8, 0.9]
    """
    return _share(np.diagonal(confusion), confusion.sum(axis=1))


def precision(confusion: IntArray) -> FloatArray:
    """Return the precision of each class: the share of its predictions that are correct.

    Parameters
    ----------
    confusion : ndarray of int, shape (C, C)
        Confusion matrix, with the true class in the row and the predicted class in the column.

    Returns
    -------
    ndarray of shape (C,)
        Precision, 0 to 1; NaN for a class without predictions.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> pdr.evaluate.precision(np.array([[8, 2], [1, 9]])).round(3).tolist()
    [0.889, 0.818]
    """
    return _share(np.diagonal(confusion), confusion.sum(axis=0))


def macro_recall(confusion: IntArray) -> float:
    """Return the mean recall of the classes with true samples (balanced accuracy).

    Parameters
    ----------
    confusion : ndarray of int, shape (C, C)
        Confusion matrix, with the true class in the row and the predicted class in the column.

    Returns
    -------
    float
        Mean recall, 0 to 1; NaN for a matrix of zeros.

    Notes
    -----
    It is the mean of the diagonal of a table such as Table III of Martinelli et al. 2018.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> round(pdr.evaluate.macro_recall(np.array([[8, 2], [1, 9]])), 3)
    0.85
    """
    return float(np.nanmean(recall(confusion))) if confusion.sum() else np.nan


def kappa(confusion: IntArray) -> float:
    """Return Cohen's kappa, the agreement of truth and prediction beyond chance.

    Parameters
    ----------
    confusion : ndarray of int, shape (C, C)
        Confusion matrix, with the true class in the row and the predicted class in the column.

    Returns
    -------
    float
        Kappa, at most 1; NaN if all samples are of one class in both truth and prediction.

    Notes
    -----
    kappa = (p_o - p_e) / (1 - p_e), with the observed agreement p_o and the agreement p_e expected by chance for the
    same marginal counts (J. Cohen, "A coefficient of agreement for nominal scales", Educational and Psychological
    Measurement 20, 1960, eq. 1).

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> round(pdr.evaluate.kappa(np.array([[8, 2], [1, 9]])), 3)
    0.7
    """
    total = confusion.sum()
    if not total:
        return np.nan
    observed = np.trace(confusion) / total
    by_chance = float(confusion.sum(axis=0) @ confusion.sum(axis=1)) / float(total) ** 2
    return float((observed - by_chance) / (1.0 - by_chance)) if by_chance < 1.0 else np.nan


def log_loss(prob: FloatArray, label: IntArray, floor: float = 1e-15) -> float:
    """Return the mean negative log probability of the true class, in nats.

    Parameters
    ----------
    prob : ndarray, shape (N, C)
        Predicted probabilities.
    label : ndarray of int, shape (N,)
        True labels, 0 to C - 1.
    floor : float, default 1e-15
        Smaller probabilities are replaced by this value, because a single zero would make the mean infinite.

    Returns
    -------
    float
        Log loss; NaN without samples.

    Raises
    ------
    ValueError
        If labels and probabilities do not match.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> round(pdr.evaluate.log_loss(np.array([[0.9, 0.1], [0.5, 0.5]]), np.array([0, 1])), 3)
    0.399
    """
    check_labels(prob, label)
    if not len(label):
        return np.nan
    return float(-np.log(np.maximum(prob[np.arange(len(label)), label], floor)).mean())


def calibration_error(prob: FloatArray, label: IntArray, n_bins: int = 15) -> float:
    """Return the expected calibration error, the mean difference between confidence and accuracy.

    Parameters
    ----------
    prob : ndarray, shape (N, C)
        Predicted probabilities.
    label : ndarray of int, shape (N,)
        True labels, 0 to C - 1.
    n_bins : int, default 15
        Number of bins of equal width in the highest probability.

    Returns
    -------
    float
        Expected calibration error, 0 to 1; NaN without samples.

    Raises
    ------
    ValueError
        If labels and probabilities do not match.

    See Also
    --------
    pdr_filter.plot.reliability : Draw the bins.

    Notes
    -----
    ECE = sum_b |B_b| / N |acc(B_b) - conf(B_b)| over the bins B_b (C. Guo, G. Pleiss, Y. Sun and K. Weinberger, "On
    calibration of modern neural networks", ICML 2017, eq. 3).

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> prob = np.array([[0.8, 0.2], [0.8, 0.2]])
    >>> round(pdr.evaluate.calibration_error(prob, np.array([0, 1])), 3)
    0.3
    """
    check_labels(prob, label)
    if not len(label):
        return np.nan
    return reliability_diagram(prob, prob.argmax(axis=1) == label, n_bins).expected_calibration_error


def class_table(confusion: IntArray, classes: Sequence[str]) -> Table:
    """Return a table with the recall and precision of each class.

    Parameters
    ----------
    confusion : ndarray of int, shape (C, C)
        Confusion matrix, with the true class in the row and the predicted class in the column.
    classes : sequence of str
        Names of the C classes.

    Returns
    -------
    Table
        A row for each class, with columns `class_name`, `n` (true samples), `recall` and `precision`.

    Raises
    ------
    ValueError
        If the matrix does not have a row and a column for each class.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> pdr.evaluate.class_table(np.array([[8, 2], [1, 9]]), ["walking", "stairs"]).recall.tolist()
    [0.8, 0.9]
    """
    if confusion.shape != (len(classes), len(classes)):
        raise ValueError(
            f"confusion must be ({len(classes)}, {len(classes)}) for the given classes, got {confusion.shape}"
        )
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
