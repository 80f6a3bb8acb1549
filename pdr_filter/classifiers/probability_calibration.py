"""Probability calibration: a temperature and a slip for a classifier, and how far its probabilities are off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pdr_filter.values import BoolArray, FloatArray, IntArray, softmax


def tempered(prob: FloatArray, temperature: float) -> FloatArray:
    """Probabilities (..., K) proportional to p^(1 / T): less sure for T > 1, surer for T < 1, zero stays zero.

    For a softmax it divides the logits by T (Guo, Pleiss, Sun and Weinberger, "On calibration of modern neural
    networks", ICML 2017, section 4.2); the order of the classes never changes.
    """
    if temperature == 1.0:
        return prob
    with np.errstate(divide="ignore"):
        return softmax(np.log(prob) / temperature)


def fit_temperature(prob: FloatArray, label: IntArray) -> float:
    """Temperature that minimises the log loss of probabilities (N, K) for labels (N,), 0.2 to 5.

    The probabilities must be of people whom the classifier has not seen; of its own people it would find T = 1 or less.
    """
    # here, because a program that only classifies does not fit
    from scipy.optimize import minimize_scalar
    from scipy.special import log_softmax

    log_prob = np.log(np.maximum(prob, 1e-300))

    def log_loss(log_temperature: float) -> float:
        scaled = log_softmax(log_prob / np.exp(log_temperature), axis=1)
        return float(-scaled[np.arange(len(label)), label].mean())

    found: Any = minimize_scalar(log_loss, bounds=(np.log(0.2), np.log(5.0)), method="bounded")
    return float(np.exp(found.x))


def slipped(prob: FloatArray, slip: float) -> FloatArray:
    """(1 - e) p + e / K, (..., K): with probability e a window is something else altogether, and any class alike."""
    return prob if slip == 0.0 else (1 - slip) * prob + slip / prob.shape[-1]


def fit_calibration(prob: FloatArray, label: IntArray) -> tuple[float, float]:
    """Temperature and slip that minimise the log loss of probabilities (N, K) for labels (N,), of people left out.

    A temperature alone pays for the few windows that are something else (a landing among the stairs) by making all the
    others unsure: calibration error 0.018 instead of 0.003.
    """
    from scipy.optimize import minimize
    from scipy.special import expit

    chosen = np.arange(len(label)), label

    def log_loss(parameters: FloatArray) -> float:
        temperature, slip = np.exp(np.clip(parameters[0], -1.6, 1.6)), expit(parameters[1])
        calibrated = slipped(tempered(prob, float(temperature)), float(slip))
        return float(-np.log(np.maximum(calibrated[chosen], 1e-300)).mean())

    options = {"xatol": 1e-3, "fatol": 1e-7}
    found: Any = minimize(log_loss, np.array([0.0, -4.0]), method="Nelder-Mead", options=options)
    return float(np.exp(np.clip(found.x[0], -1.6, 1.6))), float(expit(found.x[1]))


@dataclass(frozen=True, slots=True, eq=False)
class Reliability:
    """A reliability diagram: how often predictions of one confidence were right; bins without any are left out."""

    confidence: FloatArray  # (B,) mean probability of the predicted class
    accuracy: FloatArray  # (B,) share of right predictions
    share: FloatArray  # (B,) of all predictions

    @property
    def expected_calibration_error(self) -> float:
        """Mean distance between confidence and accuracy (Guo et al. 2017, eq. 3)."""
        return float(self.share @ np.abs(self.confidence - self.accuracy))


def reliability(prob: FloatArray, correct: BoolArray, n_bins: int = 15) -> Reliability:
    """Reliability of probabilities (N, K) whose highest class was right or not, (N,), in bins of equal width."""
    if prob.ndim != 2 or np.shape(correct) != (len(prob),) or not np.isfinite(prob).all():
        raise ValueError(
            f"prob must be known probabilities (N, K) and correct (N,), got {prob.shape} and {np.shape(correct)}: "
            "leave out rows with NaN"
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
    """Mean squared distance between probabilities (N, K) and truth (N,), 0 to 2, NaN of none (Brier 1950, eq. 2)."""
    check_labels(prob, label)
    if not len(label):
        return np.nan
    truth = np.eye(prob.shape[1])[label]
    return float(((prob - truth) ** 2).sum(axis=1).mean())


def check_labels(prob: FloatArray, label: IntArray) -> None:
    """ValueError unless there is one label of a class for each row of probabilities."""
    if prob.ndim != 2 or len(prob) != len(label):
        raise ValueError(f"prob must be (N, C) and label (N,), got {prob.shape} and {len(label)} labels")
    check_classes(label, prob.shape[1], "label")


def check_classes(values: IntArray, n_classes: int, name: str) -> None:
    """ValueError unless all are numbers of classes; -1, for what is not known, would count as the last class."""
    if not len(values):
        return
    least, largest = np.min(values), np.max(values)
    if np.asarray(values).dtype.kind not in "iu" or least < 0 or largest >= n_classes:
        raise ValueError(
            f"{name} must be whole numbers from 0 to {n_classes - 1}, got {least} to {largest}: leave out what has no "
            "class"
        )
