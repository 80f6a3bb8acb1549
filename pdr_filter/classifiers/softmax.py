"""Multinomial logistic regression as plain arrays: prediction in NumPy only, in some microseconds per row."""

from __future__ import annotations

from dataclasses import dataclass

from pdr_filter.classifiers.base_classifier import Machine
from pdr_filter.values import FloatArray, check_array, softmax


@dataclass(frozen=True, slots=True, eq=False)
class SoftmaxRegression(Machine):
    """Multinomial logistic regression: the logit of class k is w_k . x + b_k for standardised features x.

    The softmax of the logits gives the class probabilities. w_k are the weights and b_k the bias of class k.
    """

    weights: FloatArray  # (K, F) w
    intercept: FloatArray  # (K,) b

    def __post_init__(self) -> None:
        self._make_read_only("weights", "intercept")
        shape = self.weights.shape
        if len(shape) != 2 or shape[0] < 2:
            raise ValueError(f"weights must be (K, F) with K > 1, got {shape}")
        check_array("weights", self.weights)
        check_array("intercept", self.intercept, shape=shape[:1])

    @property
    def n_features(self) -> int:
        return self.weights.shape[1]

    @property
    def n_classes(self) -> int:
        return len(self.weights)

    def _predict(self, rows: FloatArray) -> FloatArray:
        # Sums along the last axis do not depend on the other rows, to the last bit.
        return softmax((self.weights * rows[:, None, :]).sum(axis=2) + self.intercept)
