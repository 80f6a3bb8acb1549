"""Calibration of class probabilities by a temperature and a slip probability, and measures of calibration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pdr_filter.values import BoolArray, FloatArray, IntArray, softmax


def tempered_prob(prob: FloatArray, temperature: float) -> FloatArray:
    """Return probabilities (..., K) proportional to p^(1 / T), with p = `prob` and the temperature T = `temperature`.

    They are less confident for T > 1 and more confident for T < 1. For a softmax, the logits are divided by T (Guo,
    Pleiss, Sun and Weinberger, "On calibration of modern neural networks", ICML 2017, section 4.2). The order of the
    classes does not change, and zero stays zero.
    """
    if temperature == 1.0:
        return prob
    with np.errstate(divide="ignore"):
        return softmax(np.log(prob) / temperature)


def slipped_prob(prob: FloatArray, slip: float) -> FloatArray:
    """Return the probabilities (1 - e) p + e / K, (..., K), of K classes from the probabilities p.

    With the slip probability e, a window belongs to any class with equal probability.
    """
    return prob if slip == 0.0 else (1 - slip) * prob + slip / prob.shape[-1]


def fit_calibration(prob: FloatArray, label: IntArray) -> tuple[float, float]:
    """Return temperature and slip probability with the lowest log loss for labels (N,) of held-out people.

    A temperature alone reduces the confidence of all windows because of the few that have another class than their
    label (a landing between stairs). Its calibration error is 0.018, and with a slip probability it is 0.003.
    """
    from scipy.optimize import minimize
    from scipy.special import expit

    chosen = np.arange(len(label)), label

    def log_loss(parameters: FloatArray) -> float:
        temperature, slip = np.exp(np.clip(parameters[0], -1.6, 1.6)), expit(parameters[1])
        calibrated = slipped_prob(tempered_prob(prob, float(temperature)), float(slip))
        return float(-np.log(np.maximum(calibrated[chosen], 1e-300)).mean())

    options = {"xatol": 1e-3, "fatol": 1e-7}
    found: Any = minimize(log_loss, np.array([0.0, -4.0]), method="Nelder-Mead", options=options)
    return float(np.exp(np.clip(found.x[0], -1.6, 1.6))), float(expit(found.x[1]))


@dataclass(frozen=True, slots=True, eq=False)
class Reliability:
    """Reliability diagram: accuracy of the predictions against their confidence.

    Each bin has the mean probability of the predicted class, the share of correct predictions, and its share of all
    predictions. Empty bins are omitted.
    """

    confidence: FloatArray  # (B,) mean probability of the predicted class
    accuracy: FloatArray  # (B,) share of correct predictions
    share: FloatArray  # (B,) share of all predictions

    @property
    def expected_calibration_error(self) -> float:
        """Mean distance between confidence and accuracy (Guo et al. 2017, eq. 3)."""
        return float(self.share @ np.abs(self.confidence - self.accuracy))


def reliability_diagram(prob: FloatArray, correct: BoolArray, n_bins: int = 15) -> Reliability:
    """Return the reliability diagram of probabilities (N, K) in bins of equal width.

    `correct` (N,) states whether the most probable class was correct.
    """
    if prob.ndim != 2 or np.shape(correct) != (len(prob),) or not np.isfinite(prob).all():
        raise ValueError(
            f"prob must be finite probabilities (N, K) and correct (N,), got {prob.shape} and "
            f"{np.shape(correct)}: leave out rows with NaN"
        )
    confidence = prob.max(axis=1)
    bins = np.minimum((confidence * n_bins).astype(int), n_bins - 1)
    used = np.unique(bins)
    return Reliability(
        np.array([confidence[bins == b].mean() for b in used]),
        np.array([correct[bins == b].mean() for b in used]),
        np.array([np.mean(bins == b) for b in used]),
    )


def brier_score(prob: FloatArray, label: IntArray) -> float:
    """Return the Brier score: the mean squared distance between class probabilities and truth.

    Parameters
    ----------
    prob : ndarray, shape (N, K)
        Class probabilities.
    label : ndarray of int, shape (N,)
        True classes, 0 to K - 1.

    Returns
    -------
    float
        0 (perfect) to 2. NaN for N = 0.

    Raises
    ------
    ValueError
        If shapes or labels are invalid.

    References
    ----------
    .. [1] Brier, "Verification of forecasts expressed in terms of probability", Monthly Weather Review 78, 1950, eq. 2.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> round(pdr.evaluate.brier_score(np.array([[0.9, 0.1], [0.4, 0.6]]), np.array([0, 1])), 2)
    0.17
    """
    check_labels(prob, label)
    if not len(label):
        return np.nan
    truth = np.eye(prob.shape[1])[label]
    return float(((prob - truth) ** 2).sum(axis=1).mean())


def check_labels(prob: FloatArray, label: IntArray) -> None:
    """Raise ValueError unless there is one valid label for each row of probabilities."""
    if prob.ndim != 2 or len(prob) != len(label):
        raise ValueError(f"prob must be (N, C) and label (N,), got {prob.shape} and {len(label)} labels")
    check_classes(label, prob.shape[1], "label")


def check_classes(values: IntArray, n_classes: int, name: str) -> None:
    """Raise ValueError unless all values are class numbers, that is, integers from 0 to `n_classes` - 1.

    A value of -1 (unknown) would be used as the last class. `name` is the name of the values in the message.
    """
    if not len(values):
        return
    least, largest = np.min(values), np.max(values)
    if np.asarray(values).dtype.kind not in "iu" or least < 0 or largest >= n_classes:
        raise ValueError(
            f"{name} must be whole numbers from 0 to {n_classes - 1}, got {least} to {largest} of type "
            f"{np.asarray(values).dtype}: leave out rows without class, and convert floats with astype(int)"
        )
