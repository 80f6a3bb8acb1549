"""Decision trees as plain arrays, evaluated together: the leaf of each tree that a row reaches.

All trees take one step down at the same time, in a few NumPy calls: some tens of microseconds for 200 trees.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from pdr_filter.classifiers.base_classifier import Machine, Stored
from pdr_filter.classifiers.model_files import Arrays
from pdr_filter.values import BoolArray, FloatArray, IntArray, check_array

NO_CHILD = -1  # value of `left` and `right` of a leaf, as in scikit-learn
# Number of rows times trees that are evaluated together, which fits into the cache. Results do not depend on it.
_BATCH_SIZE = 16_384
# Levels between two checks whether all rows have reached a leaf. A check costs a quarter of the time of a level.
_LEVELS_BETWEEN_CHECKS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Trees(Stored):
    """Concatenated arrays of T binary decision trees. Children come after their parents."""

    n_features: int  # number F of features of a row
    roots: IntArray  # (T,) root node of each tree
    feature: IntArray  # (n_nodes,) feature that a node compares. Unused in a leaf, where it has any value.
    # (n_nodes,) threshold of a node. A row goes to the left child if its feature, rounded to float32, is at most the
    # threshold.
    threshold: FloatArray
    # (n_nodes,) child nodes. -1 in a leaf
    left: IntArray
    right: IntArray
    _children: IntArray = field(init=False, repr=False)  # (2 n_nodes,) left and right child; a leaf is its own child
    _compared: IntArray = field(init=False, repr=False)  # (n_nodes,) feature that a node compares, 0 in a leaf

    def __post_init__(self) -> None:
        self._make_integers("roots", "feature", "left", "right")
        self._make_read_only("threshold")
        _check_shapes(self)
        _check_links(self)
        children = np.stack([self.left, self.right], axis=1)
        children[self.is_leaf] = np.flatnonzero(self.is_leaf)[:, None]
        object.__setattr__(self, "_children", children.ravel())
        object.__setattr__(self, "_compared", np.where(self.is_leaf, 0, self.feature))
        self._make_integers("_children", "_compared")

    @classmethod
    def concatenated(
        cls,
        n_features: int,
        feature: Sequence[NDArray[Any]],
        threshold: Sequence[NDArray[Any]],
        left: Sequence[NDArray[Any]],
        right: Sequence[NDArray[Any]],
    ) -> Trees:
        """Concatenate the arrays of single trees.

        Their children are numbered within the tree, and are `NO_CHILD` in leaves.
        """
        starts = np.cumsum([0, *(len(tree) for tree in left[:-1])])
        return cls(
            n_features=n_features,
            roots=starts,
            feature=np.concatenate(feature).astype(np.int64),
            threshold=np.concatenate(threshold),
            left=np.concatenate([_shifted(tree, start) for tree, start in zip(left, starts, strict=True)]),
            right=np.concatenate([_shifted(tree, start) for tree, start in zip(right, starts, strict=True)]),
        )

    @property
    def is_leaf(self) -> BoolArray:
        """True for nodes (n_nodes,) that are leaves."""
        return self.left == NO_CHILD

    def leaves(self, rows: FloatArray) -> Iterator[NDArray[np.intp]]:
        """Yield the leaf nodes (T, n) that rows reach in each of T trees, for consecutive blocks of n rows.

        The N rows (N, F) must be finite.
        """
        with np.errstate(over="ignore"):  # values beyond float32 become infinite and go right
            values = rows.astype(np.float32)
        at_once = max(1, _BATCH_SIZE // len(self.roots))
        for i in range(0, len(rows), at_once):
            yield self._leaves(values[i : i + at_once])

    def _leaves(self, values: NDArray[np.float32]) -> NDArray[np.intp]:
        """Return the leaves (T, N) that rows (N, F) reach in each tree."""
        n_rows, level = len(values), 0
        place = self.roots.repeat(n_rows)
        first_value = np.tile(np.arange(n_rows) * self.n_features, len(self.roots))
        while True:
            value = values.take(first_value + self._compared.take(place))
            child = self._children.take(2 * place + (value > self.threshold.take(place)))
            if level % _LEVELS_BETWEEN_CHECKS == 0 and np.array_equal(child, place):
                return place.reshape(-1, n_rows)
            place, level = child, level + 1


@dataclass(frozen=True, slots=True, eq=False)
class TreeMachine(Machine):
    """Base class of classifiers with values in the leaves of trees. Arrays of trees and leaves are stored together."""

    trees: Trees

    @property
    def n_features(self) -> int:
        return self.trees.n_features

    def to_arrays(self) -> Arrays:
        return self.trees.to_arrays() | {name: getattr(self, name) for name in self._of_leaves()}

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> Self:
        return cls(Trees.from_arrays(arrays), *(arrays[name] for name in cls._of_leaves()))

    @classmethod
    def _of_leaves(cls) -> list[str]:
        return [f.name for f in fields(cls) if f.name != "trees"]


def _shifted(children: NDArray[Any], start: int) -> IntArray:
    """Return the children of one tree as node numbers in the concatenated arrays, (n_nodes,).

    `start` is the number of the root of the tree there. `NO_CHILD` is unchanged.
    """
    return np.where(children == NO_CHILD, NO_CHILD, children + start).astype(np.int64)


def _check_shapes(trees: Trees) -> None:
    """Raise ValueError unless all arrays have one entry per node, features exist and thresholds are finite."""
    n_nodes = len(trees.left) if trees.left.ndim == 1 else -1
    expected = {name: (n_nodes,) for name in ("feature", "threshold", "left", "right")}
    shapes = {name: getattr(trees, name).shape for name in expected}
    if shapes != expected:
        raise ValueError(f"arrays of trees must have one entry for each node, got shapes {shapes}")
    if trees.roots.ndim != 1 or not len(trees.roots) or trees.n_features < 1:
        raise ValueError(f"at least one tree and one feature are needed, got {trees.roots.shape}, {trees.n_features}")
    feature, threshold = trees.feature[~trees.is_leaf], trees.threshold[~trees.is_leaf]
    if (wrong := feature[(feature < 0) | (feature >= trees.n_features)]).size:
        raise ValueError(
            f"features of inner nodes must be from 0 to {trees.n_features - 1}, got {wrong[0]}: train again"
        )
    check_array("threshold", threshold)


def _check_links(trees: Trees) -> None:
    """Raise ValueError unless the nodes form trees: children after parents (no cycles), and one path to each node."""
    left, right, n_nodes = trees.left, trees.right, len(trees.left)
    inner = np.flatnonzero(left != NO_CHILD)
    if not np.array_equal(inner, np.flatnonzero(right != NO_CHILD)):
        raise ValueError("a node has one child, but must have two, or none for a leaf")
    children = np.concatenate([left[inner], right[inner]])
    if (children <= np.tile(inner, 2)).any() or (children >= n_nodes).any():
        raise ValueError(f"a child must come after its parent and before node {n_nodes}")
    if trees.roots.min() < 0 or trees.roots.max() >= n_nodes:
        raise ValueError(f"roots must be nodes 0 to {n_nodes - 1}")
    visits = np.bincount(np.concatenate([children, trees.roots]), minlength=n_nodes)
    if (visits != 1).any():
        raise ValueError(
            f"node {np.flatnonzero(visits != 1)[0]} belongs to no tree or has several parents: train again"
        )
