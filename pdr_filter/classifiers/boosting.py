"""Gradient-boosted trees as plain arrays, trained by scikit-learn and evaluated in NumPy.

This module does not import scikit-learn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pdr_filter.classifiers.trees import NO_CHILD, TreeMachine, Trees
from pdr_filter.values import FloatArray, check_array, softmax

if TYPE_CHECKING:
    from sklearn.ensemble import HistGradientBoostingClassifier


@dataclass(frozen=True, slots=True, eq=False)
class BoostedTrees(TreeMachine):
    """Gradient-boosted trees: p = softmax(baseline + sum of the leaf values), with one tree for each class and round.

    p (K,) are the probabilities of the K classes. The trees are ordered by round, and within a round by class.
    Friedman, "Greedy function approximation: a gradient boosting machine", Annals of Statistics 29, 2001, Algorithm 6.
    """

    value: FloatArray  # (n_nodes,) values of the leaves; unused for other nodes
    baseline: FloatArray  # (K,) logits before the first round

    def __post_init__(self) -> None:
        self._make_read_only("value", "baseline")
        n_nodes, n_trees = len(self.trees.left), len(self.trees.roots)
        check_array("value", self.value, shape=(n_nodes,), remedy="give one for each node")
        check_array("baseline", self.baseline)
        n_classes = len(self.baseline) if self.baseline.ndim == 1 else 0
        if n_classes < 2 or n_trees % n_classes:
            raise ValueError(
                f"baseline must have 2 or more classes, whose number divides the number of trees ({n_trees}), "
                f"got shape {self.baseline.shape}"
            )

    @property
    def n_classes(self) -> int:
        return len(self.baseline)

    @classmethod
    def from_sklearn(cls, boosting: HistGradientBoostingClassifier) -> BoostedTrees:
        """Convert fitted trees of scikit-learn to arrays. The classes keep the order of `boosting.classes_`.

        The conversion is exact for numerical features in float32. For two classes scikit-learn has one tree per round,
        for the logit of the second class. It becomes two trees here, with half of the logit for the second class and
        half against the first.
        """
        fitted: Any = boosting
        halves = (-0.5, 0.5) if len(fitted.classes_) == 2 else (1.0,)
        nodes: list[Any] = [tree.nodes for round_ in fitted._predictors for tree in round_ for _ in halves]

        def child(tree: Any, side: str) -> NDArray[np.int64]:
            return np.where(tree["is_leaf"] > 0, NO_CHILD, tree[side].astype(np.int64))

        trees = Trees.concatenated(
            int(fitted.n_features_in_),
            [tree["feature_idx"] for tree in nodes],
            [tree["num_threshold"] for tree in nodes],
            [child(tree, "left") for tree in nodes],
            [child(tree, "right") for tree in nodes],
        )
        factors = halves * (len(nodes) // len(halves))
        of_nodes = np.concatenate([factor * tree["value"] for factor, tree in zip(factors, nodes, strict=True)])
        baseline = np.outer(np.ravel(fitted._baseline_prediction), halves).ravel()
        return cls(trees, np.where(trees.is_leaf, of_nodes, 0.0), baseline)

    def _predict(self, rows: FloatArray) -> FloatArray:
        """Return the softmax of the leaf values, summed in the order of the rounds."""
        sums: list[FloatArray] = [np.zeros((0, self.n_classes))]
        for leaves in self.trees.leaves(rows):
            values = self.value.take(leaves).reshape(-1, self.n_classes, leaves.shape[1])
            # `accumulate` adds in order by definition. The order of `sum` depends on the shape.
            sums.append(np.add.accumulate(values, axis=0)[-1].T)
        return softmax(np.concatenate(sums) + self.baseline)
