"""Weighted means of several classifiers: of their logits, or of their probabilities.

Classifiers of different kinds make different errors. A kernel machine extrapolates smoothly beyond the training data,
and trees model interactions of features. On held-out people, their mean is better than each (docs/benchmarks.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from pdr_filter.classifiers.base_classifier import Machine
from pdr_filter.classifiers.boosting import BoostedTrees
from pdr_filter.classifiers.forest import Forest
from pdr_filter.classifiers.kernel_machine import RelevanceVectors
from pdr_filter.classifiers.model_files import Arrays, of_prefix, with_prefix
from pdr_filter.classifiers.softmax import SoftmaxRegression
from pdr_filter.values import FloatArray, softmax

_KINDS, _WEIGHTS = "kinds", "weights"  # arrays of the kinds of the parts, and of their weights
# Prefixes by the kinds of the parts, in files of earlier versions, which do not state the kinds.
_FORMER = {"softmax": "linear_", "boosting": "trees_"}
_TINY = 1e-300  # smallest probability of a part, whose logarithm is finite


@dataclass(frozen=True, slots=True, eq=False)
class Blend(Machine):
    """Weighted mean of the logits of several classifiers with the same features and classes.

    The probabilities p are proportional to p_1^w_1 p_2^w_2 ... p_n^w_n, with the probabilities p_i of the n parts and
    their weights w_i, which sum to one.
    """

    parts: tuple[Machine, ...]
    weights: tuple[float, ...] = ()  # one for each part; equal weights if empty

    def __post_init__(self) -> None:
        if self.weights and (len(self.weights) != len(self.parts) or abs(sum(self.weights) - 1.0) > 1e-9):
            raise ValueError(f"weights must be one for each of {len(self.parts)} parts and sum to 1: {self.weights}")
        shapes = sorted({(part.n_features, part.n_classes) for part in self.parts})
        if len(shapes) != 1:
            raise ValueError(f"all parts must have the same numbers of features and classes, got {shapes}")

    @property
    def n_features(self) -> int:
        return self.parts[0].n_features

    @property
    def n_classes(self) -> int:
        return self.parts[0].n_classes

    def _predict(self, rows: FloatArray) -> FloatArray:
        return softmax(self._mean([np.log(np.maximum(part._predict(rows), _TINY)) for part in self.parts]))

    def _mean(self, values: list[FloatArray]) -> FloatArray:
        weights = self.weights or [1.0 / len(values)] * len(values)
        return np.add.reduce([weight * value for weight, value in zip(weights, values, strict=True)])

    def to_arrays(self) -> Arrays:
        arrays: Arrays = {_KINDS: np.array([kind_of(part) for part in self.parts])}
        if self.weights:
            arrays[_WEIGHTS] = np.array(self.weights)
        for i, part in enumerate(self.parts):
            arrays |= with_prefix(f"{i}_", part.to_arrays())
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> Self:
        if _KINDS not in arrays:
            return cls(tuple(MACHINES[kind].from_arrays(of_prefix(p, arrays)) for kind, p in _FORMER.items()))
        kinds = arrays[_KINDS].tolist()
        parts = tuple(MACHINES[kind].from_arrays(of_prefix(f"{i}_", arrays)) for i, kind in enumerate(kinds))
        return cls(parts, tuple(arrays[_WEIGHTS].tolist()) if _WEIGHTS in arrays else ())


@dataclass(frozen=True, slots=True, eq=False)
class Mixture(Blend):
    """Weighted mean of the probabilities of several classifiers with the same features and classes.

    Where the classifiers contradict each other, the mean is uncertain. The mean of the logits follows the most certain
    one.
    """

    def _predict(self, rows: FloatArray) -> FloatArray:
        return self._mean([part._predict(rows) for part in self.parts])


# Machines by their names in files.
MACHINES: dict[str, type[Machine]] = {
    "blend": Blend,
    "boosting": BoostedTrees,
    "forest": Forest,
    "mixture": Mixture,
    "relevance_vectors": RelevanceVectors,
    "softmax": SoftmaxRegression,
}


def kind_of(machine: Machine) -> str:
    """Return the name in files of the kind of a machine."""
    return next(kind for kind, cls in MACHINES.items() if type(machine) is cls)
