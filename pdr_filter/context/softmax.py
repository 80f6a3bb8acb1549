"""Multinomial logistic regression as plain arrays: probabilities in NumPy only, some microseconds a row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar

from pdr_filter.types import FloatArray, IntArray, read_only


@dataclass(frozen=True, slots=True, eq=False)
class SoftmaxRegression:
    """p_k = softmax_k((w_k . clip(x) + b_k) / T).

    Parameters
    ----------
    weights : (K, F)
        w, for standardised features.
    intercept : (K,)
        b.
    temperature : float
        T; above one makes the probabilities less sure (Guo et al., "On calibration of modern neural networks", 2017).
    limit : float
        Features are cut to plus and minus this many standard deviations: what training has not seen must not be able
        to outvote everything that it has.
    """

    weights: FloatArray
    intercept: FloatArray
    temperature: float
    limit: float

    def __post_init__(self) -> None:
        for name in ("weights", "intercept"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        shape = self.weights.shape
        if len(shape) != 2 or shape[0] < 2 or self.intercept.shape != shape[:1]:
            raise ValueError(
                f"weights must be (K, F) with K > 1 and intercept (K,), got {shape}, {self.intercept.shape}"
            )
        if not (np.isfinite(self.weights).all() and np.isfinite(self.intercept).all()):
            raise ValueError("weights and intercept must be finite")
        if not (self.temperature > 0 and self.limit > 0):
            raise ValueError(f"temperature and limit must be positive, got {self.temperature} and {self.limit}")

    @property
    def n_features(self) -> int:
        """Number of features, F."""
        return self.weights.shape[1]

    @property
    def n_classes(self) -> int:
        """Number of classes, K."""
        return len(self.weights)

    def predict_proba(self, X: ArrayLike) -> FloatArray:
        """Class probabilities of rows, (N, F) to (N, K), each row computed on its own: the same bits in any batch."""
        rows = np.asarray(X, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.n_features:
            raise ValueError(f"X must be (N, {self.n_features}), got {rows.shape}: give the features of the training")
        if np.isnan(rows).any():
            raise ValueError(f"feature {np.argwhere(np.isnan(rows))[0, 1]} is NaN: leave such windows out")
        result = np.empty((len(rows), self.n_classes))
        for i, row in enumerate(np.clip(rows, -self.limit, self.limit)):
            logit = ((self.weights * row).sum(axis=1) + self.intercept) / self.temperature
            relative = np.exp(logit - logit.max())
            result[i] = relative / relative.sum()
        return result

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the plain arrays that `from_arrays` takes."""
        return {
            "weights": self.weights,
            "intercept": self.intercept,
            "temperature": np.array(self.temperature),
            "limit": np.array(self.limit),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> SoftmaxRegression:
        """Return what `to_arrays` wrote; KeyError or ValueError if it is something else."""
        return cls(arrays["weights"], arrays["intercept"], float(arrays["temperature"]), float(arrays["limit"]))


def fit_temperature(prob: FloatArray, label: IntArray) -> float:
    """Temperature that minimises the log loss of probabilities (N, K) for labels (N,), 0.2 to 5.

    p_k(T) is proportional to p_k^(1 / T), which for a softmax is division of its logits. The probabilities must be of
    people whom the classifier has not seen; of its own people it would find T = 1 or less.
    """
    log_prob = np.log(np.maximum(prob, 1e-300))

    def log_loss(log_temperature: float) -> float:
        scaled = log_prob / np.exp(log_temperature)
        scaled -= scaled.max(axis=1, keepdims=True)
        total = np.log(np.exp(scaled).sum(axis=1))
        return float(-(scaled[np.arange(len(label)), label] - total).mean())

    found: Any = minimize_scalar(log_loss, bounds=(np.log(0.2), np.log(5.0)), method="bounded")
    return float(np.exp(found.x))
