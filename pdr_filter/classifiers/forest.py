"""Random forest as plain arrays, trained by scikit-learn and evaluated in NumPy.

This module does not import scikit-learn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pdr_filter.classifiers.trees import TreeMachine, Trees
from pdr_filter.values import FloatArray

if TYPE_CHECKING:
    from sklearn.ensemble import ExtraTreesClassifier, RandomForestClassifier


@dataclass(frozen=True, slots=True, eq=False)
class Forest(TreeMachine):
    """Random forest: mean of the class probabilities of its trees."""

    probability: FloatArray  # (n_nodes, C) class probabilities of the leaves, which sum to one; unused for other nodes

    def __post_init__(self) -> None:
        self._make_read_only("probability")
        shape, n_nodes = self.probability.shape, len(self.trees.left)
        if len(shape) != 2 or shape[0] != n_nodes or shape[1] < 1:
            raise ValueError(f"probability must have a row for each of {n_nodes} nodes, got {shape}")
        of_leaves = self.probability[self.trees.is_leaf]
        if not ((of_leaves >= 0).all() and np.allclose(of_leaves.sum(axis=1), 1.0, rtol=0, atol=1e-9)):
            raise ValueError("class probabilities of a leaf must be at least zero and sum to one")

    @property
    def n_classes(self) -> int:
        return self.probability.shape[1]

    @classmethod
    def from_sklearn(cls, forest: RandomForestClassifier | ExtraTreesClassifier) -> Forest:
        """Convert a fitted forest of scikit-learn to arrays. The classes keep the order of `forest.classes_`."""
        if forest.n_outputs_ != 1:
            raise ValueError(f"the forest must have one output, got {forest.n_outputs_}: train one forest for each")
        each: list[Any] = [estimator.tree_ for estimator in forest.estimators_]
        trees = Trees.concatenated(
            int(each[0].n_features),
            [tree.feature for tree in each],
            [tree.threshold for tree in each],
            [tree.children_left for tree in each],
            [tree.children_right for tree in each],
        )
        value = np.concatenate([tree.value[:, 0, :] for tree in each])  # class shares of the training rows of a node
        return cls(trees, np.where(trees.is_leaf[:, None], value, 0.0))

    def _predict(self, rows: FloatArray) -> FloatArray:
        """Return the mean of the leaf probabilities over the trees, summed in the order of the trees."""
        # `accumulate` adds in order by definition. The order of `sum` depends on the shape.
        sums = [
            np.add.accumulate(self.probability.take(leaves, axis=0), axis=0)[-1]
            for leaves in self.trees.leaves(rows)  # (T, n, C)
        ]
        total = np.concatenate(sums) if sums else np.zeros((0, self.n_classes))
        return total / len(self.trees.roots)
