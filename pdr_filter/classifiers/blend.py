"""A linear classifier and boosted trees with one voice.

The linear one goes on sensibly where there is no training data, the trees know what depends on what; on people left out
their mean is better than either (docs/benchmarks.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from pdr_filter.classifiers.base_classifier import Machine
from pdr_filter.classifiers.boosting import BoostedTrees
from pdr_filter.classifiers.model_files import Arrays, of_prefix, prefixed
from pdr_filter.classifiers.softmax import SoftmaxRegression
from pdr_filter.values import FloatArray

_LINEAR, _TREES = "linear_", "trees_"  # prefixes of the arrays


@dataclass(frozen=True, slots=True, eq=False)
class Blend(Machine):
    """p proportional to (p_linear p_trees)^(1/2): the mean of the logits, of the same features and classes."""

    linear: SoftmaxRegression
    trees: BoostedTrees

    def __post_init__(self) -> None:
        linear, trees = ((part.n_features, part.n_classes) for part in (self.linear, self.trees))
        if linear != trees:
            raise ValueError(f"the parts must be of the same features and classes, got {linear} and {trees}")

    @property
    def n_features(self) -> int:
        """Number of features, F."""
        return self.linear.n_features

    @property
    def n_classes(self) -> int:
        """Number of classes, K."""
        return self.linear.n_classes

    def _of_rows(self, rows: FloatArray) -> FloatArray:
        relative = np.sqrt(self.linear.predict_proba(rows) * self.trees.predict_proba(rows))
        return relative / relative.sum(axis=1, keepdims=True)

    def to_arrays(self) -> Arrays:
        """Return the plain arrays that `from_arrays` takes."""
        return prefixed(_LINEAR, self.linear.to_arrays()) | prefixed(_TREES, self.trees.to_arrays())

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> Self:
        """Return what `to_arrays` wrote; KeyError or ValueError if it is something else."""
        return cls(
            SoftmaxRegression.from_arrays(of_prefix(_LINEAR, arrays)),
            BoostedTrees.from_arrays(of_prefix(_TREES, arrays)),
        )
