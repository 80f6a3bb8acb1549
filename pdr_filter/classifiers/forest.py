"""A random forest as plain arrays: scikit-learn trains it, NumPy predicts with it.

This module does not import scikit-learn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pdr_filter.classifiers.trees import Trees
from pdr_filter.values.arrays import FloatArray, IntArray, read_only

if TYPE_CHECKING:
    from sklearn.ensemble import RandomForestClassifier


@dataclass(frozen=True, slots=True, eq=False)
class Forest:
    """The mean of the class probabilities of trees.

    Parameters
    ----------
    n_features, roots, feature, threshold, left, right
        The trees, see `Trees`.
    probability : (n_nodes, C)
        Class probabilities of a leaf, summing to one; not used in other nodes.
    """

    n_features: int
    roots: IntArray
    feature: IntArray
    threshold: FloatArray
    left: IntArray
    right: IntArray
    probability: FloatArray
    _trees: Trees = field(init=False, repr=False)

    def __post_init__(self) -> None:
        trees = Trees(self.n_features, self.roots, self.feature, self.threshold, self.left, self.right)
        for name in ("roots", "feature", "threshold", "left", "right"):
            object.__setattr__(self, name, getattr(trees, name))  # as checked, read-only arrays
        object.__setattr__(self, "_trees", trees)
        object.__setattr__(self, "probability", read_only(self.probability))
        _check_leaves(trees, self.probability)

    @property
    def n_classes(self) -> int:
        """Number of classes, C."""
        return self.probability.shape[1]

    @classmethod
    def from_sklearn(cls, forest: RandomForestClassifier) -> Forest:
        """Return the fitted forest as arrays; classes stay in the order of `forest.classes_`."""
        if forest.n_outputs_ != 1:
            raise ValueError(f"the forest predicts {forest.n_outputs_} outputs; train one forest for each")
        each: list[Any] = [estimator.tree_ for estimator in forest.estimators_]
        trees = Trees.concatenated(
            int(each[0].n_features),
            [tree.feature for tree in each],
            [tree.threshold for tree in each],
            [tree.children_left for tree in each],
            [tree.children_right for tree in each],
        )
        value = np.concatenate([tree.value[:, 0, :] for tree in each])  # fractions of the rows that came by
        probability = np.where(trees.is_leaf[:, None], value, 0.0)
        return cls(trees.n_features, trees.roots, trees.feature, trees.threshold, trees.left, trees.right, probability)

    def predict_proba(self, X: ArrayLike) -> FloatArray:
        """Class probabilities of rows, (N, F) to (N, C): the mean over the trees of their leaves.

        The trees are added one after the other, so a row has the same bits alone and in any batch. Raises ValueError
        for NaN or infinite features.
        """
        # `accumulate` adds in order by definition; `sum` may take another order for another shape
        sums = [
            np.add.accumulate(self.probability.take(leaves, axis=0), axis=0)[-1]
            for _, leaves in self._trees.leaves(X)  # (T, n, C)
        ]
        total = np.concatenate(sums) if sums else np.zeros((0, self.n_classes))
        return total / len(self.roots)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the plain arrays that `from_arrays` takes, integers as int32."""
        return {
            "n_features": np.array(self.n_features, dtype=np.int32),
            "roots": self.roots.astype(np.int32),
            "feature": self.feature.astype(np.int32),
            "threshold": self.threshold,
            "left": self.left.astype(np.int32),
            "right": self.right.astype(np.int32),
            "probability": self.probability,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Forest:
        """Return the forest that `to_arrays` wrote; KeyError or ValueError if it is not one."""
        return cls(
            n_features=int(arrays["n_features"]),
            roots=arrays["roots"],
            feature=arrays["feature"],
            threshold=arrays["threshold"],
            left=arrays["left"],
            right=arrays["right"],
            probability=arrays["probability"],
        )


def _check_leaves(trees: Trees, probability: FloatArray) -> None:
    """Raise ValueError unless leaves hold probabilities."""
    n_nodes = len(trees.left)
    if probability.ndim != 2 or probability.shape[0] != n_nodes or probability.shape[1] < 1:
        raise ValueError(f"probability must have a row for each of {n_nodes} nodes, got {probability.shape}")
    of_leaves = probability[trees.is_leaf]
    if not ((of_leaves >= 0).all() and np.allclose(of_leaves.sum(axis=1), 1.0, rtol=0, atol=1e-9)):
        raise ValueError("class probabilities of a leaf must be at least zero and sum to one")
