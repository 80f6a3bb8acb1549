"""Multinomial logistic regression as plain arrays: probabilities in NumPy only, some microseconds a row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pdr_filter.classifiers.rows import checked_rows
from pdr_filter.values.arrays import FloatArray, read_only


@dataclass(frozen=True, slots=True, eq=False)
class SoftmaxRegression:
    """p_k = softmax_k(w_k . x + b_k).

    Parameters
    ----------
    weights : (K, F)
        w, for standardised features.
    intercept : (K,)
        b.
    """

    weights: FloatArray
    intercept: FloatArray

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
        rows = checked_rows(X, self.n_features)
        result = np.empty((len(rows), self.n_classes))
        for i, row in enumerate(rows):
            logit = (self.weights * row).sum(axis=1) + self.intercept
            relative = np.exp(logit - logit.max())
            result[i] = relative / relative.sum()
        return result

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the plain arrays that `from_arrays` takes."""
        return {
            "weights": self.weights,
            "intercept": self.intercept,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> SoftmaxRegression:
        """Return what `to_arrays` wrote; KeyError or ValueError if it is something else."""
        return cls(arrays["weights"], arrays["intercept"])
