"""A random forest as plain arrays: scikit-learn trains it, NumPy predicts with it.

One row costs about 0.1 ms for 100 trees (scikit-learn: tens of milliseconds), because all trees take one step down at
the same time. This module does not import scikit-learn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pdr_filter.types import FloatArray, IntArray, read_only

if TYPE_CHECKING:
    from sklearn.ensemble import RandomForestClassifier

NO_CHILD = -1  # in `left` and `right` of a leaf, as scikit-learn has it

# Rows that go down the trees together. It bounds the memory (rows x trees x classes numbers) and changes no result.
_ROWS_AT_ONCE = 512


@dataclass(frozen=True, slots=True, eq=False)
class Forest:
    """All trees of a random forest, concatenated; children come after their parents.

    Parameters
    ----------
    n_features : int
        Features of a row, F.
    roots : (T,)
        Node at which each tree starts.
    feature : (n_nodes,)
        Feature that a node looks at; -1 or anything else in a leaf, where it is not used.
    threshold : (n_nodes,)
        A row goes left where its feature, rounded to float32, is at most this.
    left, right : (n_nodes,)
        Children as node numbers, -1 in a leaf.
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
    # The form that prediction walks over, made from the fields above. A node is addressed by p = 2 node, so that its
    # left child stands at p and its right child at p + 1: one look-up instead of a choice between two.
    _depth: int = field(init=False, repr=False)
    _starts: NDArray[np.intp] = field(init=False, repr=False)  # (T,)
    _feature: NDArray[np.intp] = field(init=False, repr=False)  # (2 n_nodes,)
    _threshold: FloatArray = field(init=False, repr=False)  # (2 n_nodes,)
    _child: NDArray[np.intp] = field(init=False, repr=False)  # (2 n_nodes,)

    def __post_init__(self) -> None:
        for name in ("roots", "feature", "left", "right"):
            object.__setattr__(self, name, _read_only_integers(name, getattr(self, name)))
        for name in ("threshold", "probability"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        _check_shapes(self)
        _check_links(self)
        _check_leaves(self)
        leaf = self.left == NO_CHILD
        node = np.arange(len(self.left))
        # A leaf is its own child on both sides: rows that arrive early wait there until the deepest tree is done.
        child = np.stack([np.where(leaf, node, self.left), np.where(leaf, node, self.right)], axis=1).ravel()
        object.__setattr__(self, "_depth", _depth(self))
        object.__setattr__(self, "_starts", (2 * self.roots).astype(np.intp))
        object.__setattr__(self, "_feature", np.repeat(np.where(leaf, 0, self.feature), 2).astype(np.intp))
        object.__setattr__(self, "_threshold", np.repeat(self.threshold, 2))
        object.__setattr__(self, "_child", (2 * child).astype(np.intp))

    @property
    def n_classes(self) -> int:
        """Number of classes, C."""
        return self.probability.shape[1]

    @classmethod
    def from_sklearn(cls, forest: RandomForestClassifier) -> Forest:
        """Return the fitted forest as arrays; classes stay in the order of `forest.classes_`."""
        if forest.n_outputs_ != 1:
            raise ValueError(f"the forest predicts {forest.n_outputs_} outputs; train one forest for each")
        trees: list[Any] = [estimator.tree_ for estimator in forest.estimators_]
        n_nodes = [tree.node_count for tree in trees]
        starts = np.cumsum([0, *n_nodes[:-1]])
        left = np.concatenate([_shifted(t.children_left, start) for t, start in zip(trees, starts, strict=True)])
        right = np.concatenate([_shifted(t.children_right, start) for t, start in zip(trees, starts, strict=True)])
        leaf = left == NO_CHILD
        value = np.concatenate([tree.value[:, 0, :] for tree in trees])  # fractions of the rows that came by
        probability = np.where(leaf[:, None], value, 0.0)
        return cls(
            n_features=int(trees[0].n_features),
            roots=starts,
            feature=np.concatenate([tree.feature for tree in trees]),
            threshold=np.concatenate([tree.threshold for tree in trees]),
            left=left,
            right=right,
            probability=probability,
        )

    def predict_proba(self, X: ArrayLike) -> FloatArray:
        """Class probabilities of rows, (N, F) to (N, C): the mean over the trees of their leaves.

        The trees are added one after the other, so a row has the same bits alone and in any batch. Raises ValueError
        for NaN or infinite features.
        """
        rows = np.asarray(X, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.n_features:
            raise ValueError(f"X must be (N, {self.n_features}), got {rows.shape}: give the features of the training")
        finite = np.isfinite(rows)
        if not finite.all():
            row, column = np.argwhere(~finite)[0]
            raise ValueError(
                f"feature {column} is {rows[row, column]} in row {row}: leave such rows out or fill in a value"
            )
        blocks = [self._mean_of_leaves(rows[i : i + _ROWS_AT_ONCE]) for i in range(0, len(rows), _ROWS_AT_ONCE)]
        return np.concatenate(blocks) if blocks else np.zeros((0, self.n_classes))

    def _mean_of_leaves(self, rows: FloatArray) -> FloatArray:
        """Class probabilities (N, C) of a few finite rows (N, F)."""
        with np.errstate(over="ignore"):  # beyond the range of float32 is infinite and goes right
            # scikit-learn compares the float32 of a feature with the float64 of a threshold
            values = rows.astype(np.float32).astype(np.float64).ravel()
        n_rows = len(rows)
        row_start = (np.arange(n_rows) * self.n_features)[:, None]
        place = np.broadcast_to(self._starts, (n_rows, len(self._starts)))
        for _ in range(self._depth):
            goes_right = values.take(row_start + self._feature.take(place)) > self._threshold.take(place)
            place = self._child.take(place + goes_right)
        leaves = self.probability.take(place >> 1, axis=0)  # (N, T, C)
        # `accumulate` adds in order by definition; `sum` may take another order for another shape
        return np.add.accumulate(leaves, axis=1)[:, -1] / len(self.roots)

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


def _shifted(children: NDArray[Any], start: int) -> IntArray:
    """Children of one tree as node numbers of the whole forest, (n_nodes,)."""
    return np.where(children == NO_CHILD, NO_CHILD, children + start).astype(np.int64)


def _read_only_integers(name: str, values: ArrayLike) -> IntArray:
    """Return a read-only int64 copy; floats are refused, not rounded."""
    array = np.asarray(values)
    if not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"{name} must hold integers, got {array.dtype}")
    array = array.astype(np.int64)
    array.flags.writeable = False
    return array


def _check_shapes(forest: Forest) -> None:
    """Raise ValueError unless all arrays belong to the same nodes."""
    n_nodes = len(forest.left) if forest.left.ndim == 1 else -1
    expected = {name: (n_nodes,) for name in ("feature", "threshold", "left", "right")}
    shapes = {name: getattr(forest, name).shape for name in expected}
    probability = forest.probability.shape
    if shapes != expected or len(probability) != 2 or probability[0] != n_nodes or probability[1] < 1:
        raise ValueError(f"a forest needs one entry for each node, got shapes {shapes}, probability {probability}")
    if forest.roots.ndim != 1 or not len(forest.roots) or forest.n_features < 1:
        raise ValueError(f"a forest needs trees and features, got {forest.roots.shape} and {forest.n_features}")


def _check_links(forest: Forest) -> None:
    """Raise ValueError unless the nodes are trees: no cycle, no node in two places.

    Children after their parents rule out a cycle; exactly one way to each node rules out shared branches.
    """
    left, right, n_nodes = forest.left, forest.right, len(forest.left)
    inner = np.flatnonzero(left != NO_CHILD)
    if not np.array_equal(inner, np.flatnonzero(right != NO_CHILD)):
        raise ValueError("a node has one child: nodes of a forest have two, leaves none")
    children = np.concatenate([left[inner], right[inner]])
    if (children <= np.tile(inner, 2)).any() or (children >= n_nodes).any():
        raise ValueError(f"a child must come after its parent and before node {n_nodes}")
    if forest.roots.min() < 0 or forest.roots.max() >= n_nodes:
        raise ValueError(f"roots must be nodes 0 to {n_nodes - 1}")
    visits = np.bincount(np.concatenate([children, forest.roots]), minlength=n_nodes)
    if (visits != 1).any():
        raise ValueError(f"node {np.flatnonzero(visits != 1)[0]} belongs to no tree or to more than one place")


def _check_leaves(forest: Forest) -> None:
    """Raise ValueError unless features exist, thresholds are finite and leaves hold probabilities."""
    leaf = forest.left == NO_CHILD
    feature, threshold = forest.feature[~leaf], forest.threshold[~leaf]
    if ((feature < 0) | (feature >= forest.n_features)).any():
        raise ValueError(f"a node looks at a feature outside 0 to {forest.n_features - 1}")
    if not np.isfinite(threshold).all():
        raise ValueError("a threshold is not finite")
    probability = forest.probability[leaf]
    if not ((probability >= 0).all() and np.allclose(probability.sum(axis=1), 1.0, rtol=0, atol=1e-9)):
        raise ValueError("class probabilities of a leaf must be at least zero and sum to one")


def _depth(forest: Forest) -> int:
    """Steps from a root to the deepest leaf."""
    depth, nodes = 0, forest.roots
    while True:
        inner = nodes[forest.left[nodes] != NO_CHILD]
        if not len(inner):
            return depth
        nodes = np.concatenate([forest.left[inner], forest.right[inner]])
        depth += 1
