"""Blend of a linear classifier and boosted trees.

The linear classifier extrapolates well beyond the training data, and the trees model interactions of features. On
held-out people, their mean is better than either (docs/benchmarks.md).
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
    """Mean of the logits of a linear classifier and of boosted trees.

    The probabilities p are proportional to (p_linear p_trees)^(1/2), with the probabilities of both classifiers.
    """

    linear: SoftmaxRegression
    trees: BoostedTrees

    def __post_init__(self) -> None:
        linear, trees = ((part.n_features, part.n_classes) for part in (self.linear, self.trees))
        if linear != trees:
            raise ValueError(f"both parts must have the same numbers of features and classes, got {linear} and {trees}")

    @property
    def n_features(self) -> int:
        """Number F of features."""
        return self.linear.n_features

    @property
    def n_classes(self) -> int:
        """Number K of classes."""
        return self.linear.n_classes

    def _predict(self, rows: FloatArray) -> FloatArray:
        relative = np.sqrt(self.linear.predict_proba(rows) * self.trees.predict_proba(rows))
        return relative / relative.sum(axis=1, keepdims=True)

    def to_arrays(self) -> Arrays:
        """Return the arrays of both classifiers, with prefixed names, for `from_arrays`."""
        return prefixed(_LINEAR, self.linear.to_arrays()) | prefixed(_TREES, self.trees.to_arrays())

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> Self:
        """Create the blend of a linear classifier and boosted trees from the arrays of `to_arrays`.

        KeyError or ValueError for other arrays.
        """
        return cls(
            SoftmaxRegression.from_arrays(of_prefix(_LINEAR, arrays)),
            BoostedTrees.from_arrays(of_prefix(_TREES, arrays)),
        )
