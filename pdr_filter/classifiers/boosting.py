"""Gradient-boosted trees as plain arrays: scikit-learn trains them, NumPy predicts with them.

This module does not import scikit-learn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pdr_filter.classifiers.trees import NO_CHILD, Trees
from pdr_filter.values.arrays import FloatArray, IntArray, read_only

if TYPE_CHECKING:
    from sklearn.ensemble import HistGradientBoostingClassifier


@dataclass(frozen=True, slots=True, eq=False)
class BoostedTrees:
    """p = softmax(baseline + sum over rounds of the leaves' values), one tree for each class and round.

    Friedman, "Greedy function approximation: a gradient boosting machine", Annals of Statistics 29, 2001, Algorithm 6.

    Parameters
    ----------
    n_features, roots, feature, threshold, left, right
        The trees, see `Trees`; round after round, in each round the classes in order.
    value : (n_nodes,)
        Of a leaf; not used in other nodes.
    baseline : (K,)
        Logits before the first round.
    """

    n_features: int
    roots: IntArray
    feature: IntArray
    threshold: FloatArray
    left: IntArray
    right: IntArray
    value: FloatArray
    baseline: FloatArray
    _trees: Trees = field(init=False, repr=False)

    def __post_init__(self) -> None:
        trees = Trees(self.n_features, self.roots, self.feature, self.threshold, self.left, self.right)
        for name in ("roots", "feature", "threshold", "left", "right"):
            object.__setattr__(self, name, getattr(trees, name))  # as checked, read-only arrays
        object.__setattr__(self, "_trees", trees)
        for name in ("value", "baseline"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        if self.value.shape != self.left.shape or not np.isfinite(self.value).all():
            raise ValueError(f"value must be a finite number for each of {len(self.left)} nodes")
        n_classes = len(self.baseline) if self.baseline.ndim == 1 else 0
        if n_classes < 3 or len(self.roots) % n_classes or not np.isfinite(self.baseline).all():
            raise ValueError(
                f"baseline must be finite, of 3 or more classes, and {len(self.roots)} trees one for each class and "
                f"round, got shape {self.baseline.shape}"
            )

    @property
    def n_classes(self) -> int:
        """Number of classes, K."""
        return len(self.baseline)

    @classmethod
    def from_sklearn(cls, boosting: HistGradientBoostingClassifier) -> BoostedTrees:
        """Return the fitted trees as arrays; classes stay in the order of `boosting.classes_`, three or more.

        Exact for features that are float32 numbers and that are not categories.
        """
        fitted: Any = boosting
        nodes: list[Any] = [tree.nodes for round_ in fitted._predictors for tree in round_]

        def child(tree: Any, side: str) -> NDArray[np.int64]:
            return np.where(tree["is_leaf"] > 0, NO_CHILD, tree[side].astype(np.int64))

        trees = Trees.concatenated(
            int(fitted.n_features_in_),
            [tree["feature_idx"] for tree in nodes],
            [tree["num_threshold"] for tree in nodes],
            [child(tree, "left") for tree in nodes],
            [child(tree, "right") for tree in nodes],
        )
        value = np.where(trees.is_leaf, np.concatenate([tree["value"] for tree in nodes]), 0.0)
        return cls(
            trees.n_features,
            trees.roots,
            trees.feature,
            trees.threshold,
            trees.left,
            trees.right,
            value,
            np.ravel(fitted._baseline_prediction),
        )

    def predict_proba(self, X: ArrayLike) -> FloatArray:
        """Class probabilities of rows, (N, F) to (N, K); the same bits alone and in any batch.

        Raises ValueError for NaN or infinite features.
        """
        sums: list[FloatArray] = [np.zeros((0, self.n_classes))]
        for _, leaves in self._trees.leaves(X):
            values = self.value.take(leaves).reshape(-1, self.n_classes, leaves.shape[1])
            # `accumulate` adds in order by definition; `sum` may take another order for another shape
            sums.append(np.add.accumulate(values, axis=0)[-1].T)
        logit = np.concatenate(sums) + self.baseline
        relative = np.exp(logit - logit.max(axis=1, keepdims=True))
        return relative / relative.sum(axis=1, keepdims=True)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the plain arrays that `from_arrays` takes, integers as int32."""
        return {
            "n_features": np.array(self.n_features, dtype=np.int32),
            "roots": self.roots.astype(np.int32),
            "feature": self.feature.astype(np.int32),
            "threshold": self.threshold,
            "left": self.left.astype(np.int32),
            "right": self.right.astype(np.int32),
            "value": self.value,
            "baseline": self.baseline,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> BoostedTrees:
        """Return what `to_arrays` wrote; KeyError or ValueError if it is something else."""
        return cls(
            n_features=int(arrays["n_features"]),
            roots=arrays["roots"],
            feature=arrays["feature"],
            threshold=arrays["threshold"],
            left=arrays["left"],
            right=arrays["right"],
            value=arrays["value"],
            baseline=arrays["baseline"],
        )
