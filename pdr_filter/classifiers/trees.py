"""Many decision trees as plain arrays: which leaf of each tree a row comes to.

All trees take one step down at the same time, in four NumPy calls: some tens of microseconds for 200 trees.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from pdr_filter.classifiers.base_classifier import Machine, Stored
from pdr_filter.classifiers.model_files import Arrays
from pdr_filter.values import BoolArray, FloatArray, IntArray, check_array

NO_CHILD = -1  # in `left` and `right` of a leaf, as scikit-learn has it
# Rows times trees that go down together: what stays in the processor's cache. It changes no result.
_WALKS_AT_ONCE = 16_384
# In the lower half of the trees, levels between two looks at whether all have arrived; a look costs a third of a level.
_LEVELS_BETWEEN_LOOKS = 3
# All that a step down needs to know about a node, in 16 bytes, so that one look-up fetches it from one place in memory.
_FORMATS = [np.intp, np.float32, np.int32]
_NODE = np.dtype(
    {"names": ["left", "threshold", "feature"], "formats": _FORMATS, "offsets": [0, 8, 12], "itemsize": 16}
)
_NODE_AS_NUMBER = np.complex128  # a plain type of the same size: `take` copies it twice as fast as a record

_LOWEST_BYTE = 0 if sys.byteorder == "little" else np.dtype(np.intp).itemsize - 1


@dataclass(frozen=True, slots=True, eq=False)
class Trees(Stored):
    """All trees, concatenated; children come after their parents."""

    n_features: int  # of a row, F
    roots: IntArray  # (T,) node at which each tree starts
    feature: IntArray  # (n_nodes,) that a node looks at; -1 or anything else in a leaf, where it is not used
    threshold: FloatArray  # (n_nodes,) a row goes left where its feature, rounded to float32, is at most this
    left: IntArray  # (n_nodes,) children as node numbers, -1 in a leaf
    right: IntArray  # (n_nodes,)
    # The form that a row walks over, made from the fields above: nodes level by level through all trees at once (first
    # the T roots), so that the right child always stands behind the left one. See `_walkable`.
    _nodes: NDArray[Any] = field(init=False, repr=False)  # (n_nodes,), `_NODE` seen as `_NODE_AS_NUMBER`
    _original: NDArray[np.intp] = field(init=False, repr=False)  # (n_nodes,) number of the node in the fields above
    _first_of_level: tuple[int, ...] = field(init=False, repr=False)  # place of the first node of each level

    def __post_init__(self) -> None:
        self._make_integers("roots", "feature", "left", "right")
        self._make_read_only("threshold")
        _check_shapes(self)
        _check_links(self)
        levels = _levels(self)
        order = np.concatenate(levels)
        nodes = _walkable(self, order).view(_NODE_AS_NUMBER)
        nodes.flags.writeable = order.flags.writeable = False
        first_of_level = np.cumsum([0, *(len(level) for level in levels[:-1])]).tolist()
        object.__setattr__(self, "_nodes", nodes)
        object.__setattr__(self, "_original", order)
        object.__setattr__(self, "_first_of_level", tuple(first_of_level))

    @classmethod
    def concatenated(
        cls,
        n_features: int,
        feature: Sequence[NDArray[Any]],
        threshold: Sequence[NDArray[Any]],
        left: Sequence[NDArray[Any]],
        right: Sequence[NDArray[Any]],
    ) -> Trees:
        """Trees from the arrays of each, children counted within the tree and `NO_CHILD` in leaves."""
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
        """Which nodes are leaves, (n_nodes,)."""
        return self.left == NO_CHILD

    def leaves(self, rows: FloatArray) -> Iterator[NDArray[np.intp]]:
        """Nodes (T, n) of the leaves at which some finite rows of (N, F) after the other arrive."""
        with np.errstate(over="ignore"):  # beyond the range of float32 is infinite and goes right
            values = rows.astype(np.float32)
        at_once = max(1, _WALKS_AT_ONCE // len(self.roots))
        for i in range(0, len(rows), at_once):
            yield self._leaves(values[i : i + at_once])

    def _leaves(self, values: NDArray[np.float32]) -> NDArray[np.intp]:
        """Leaves (T, N) at which rows (N, F) arrive in each tree; with `out` and mode "clip" a look-up costs half."""
        n_rows, n_trees, depth = len(values), len(self.roots), len(self._first_of_level) - 1
        place = np.arange(n_trees).repeat(n_rows)
        first_value = np.tile(np.arange(n_rows) * self.n_features, n_trees) if n_rows > 1 else None
        node = np.empty(len(place), _NODE)
        node_as_number = node.view(_NODE_AS_NUMBER)
        left, threshold, feature = node["left"], node["threshold"], node["feature"]
        value = np.empty(len(place), np.float32)
        # Written into the lowest byte of an integer, False and True are the integers 0 and 1: no conversion later.
        to_the_right = np.zeros(len(place), np.intp)
        goes_right = to_the_right.view(np.bool_)[_LOWEST_BYTE :: to_the_right.itemsize]
        take_node, take_value = self._nodes.take, values.ravel().take
        for level in range(depth):
            may_be_done = 2 * level > depth and level % _LEVELS_BETWEEN_LOOKS == 0
            if may_be_done and place.max() < self._first_of_level[level]:
                break  # all stand at leaves of the levels above
            take_node(place, out=node_as_number, mode="clip")
            take_value(feature if first_value is None else feature + first_value, out=value, mode="clip")
            np.greater(value, threshold, out=goes_right)
            np.add(left, to_the_right, out=place)
        return self._original.take(place).reshape(n_trees, n_rows)


@dataclass(frozen=True, slots=True, eq=False)
class TreeMachine(Machine):
    """Trees with something in their leaves; the arrays of the trees are stored beside those of the leaves."""

    trees: Trees

    @property
    def n_features(self) -> int:
        """Number of features, F."""
        return self.trees.n_features

    def to_arrays(self) -> Arrays:
        """Return the plain arrays that `from_arrays` takes, integers as int32."""
        return self.trees.to_arrays() | {name: getattr(self, name) for name in self._of_leaves()}

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> Self:
        """Return what `to_arrays` wrote; KeyError or ValueError if it is something else."""
        return cls(Trees.from_arrays(arrays), *(arrays[name] for name in cls._of_leaves()))

    @classmethod
    def _of_leaves(cls) -> list[str]:
        return [f.name for f in fields(cls) if f.name != "trees"]


def _shifted(children: NDArray[Any], start: int) -> IntArray:
    """Children of one tree as node numbers of the whole forest, (n_nodes,)."""
    return np.where(children == NO_CHILD, NO_CHILD, children + start).astype(np.int64)


def _check_shapes(trees: Trees) -> None:
    """Raise ValueError unless all arrays belong to the same nodes, features exist and thresholds are finite."""
    n_nodes = len(trees.left) if trees.left.ndim == 1 else -1
    expected = {name: (n_nodes,) for name in ("feature", "threshold", "left", "right")}
    shapes = {name: getattr(trees, name).shape for name in expected}
    if shapes != expected:
        raise ValueError(f"trees need one entry for each node, got shapes {shapes}")
    if trees.roots.ndim != 1 or not len(trees.roots) or trees.n_features < 1:
        raise ValueError(f"at least one tree and one feature is needed, got {trees.roots.shape} and {trees.n_features}")
    feature, threshold = trees.feature[~trees.is_leaf], trees.threshold[~trees.is_leaf]
    if ((feature < 0) | (feature >= trees.n_features)).any():
        raise ValueError(f"a node looks at a feature outside 0 to {trees.n_features - 1}")
    check_array("threshold", threshold)


def _check_links(trees: Trees) -> None:
    """Raise ValueError unless the nodes are trees: children after parents (no cycle), one way to each node."""
    left, right, n_nodes = trees.left, trees.right, len(trees.left)
    inner = np.flatnonzero(left != NO_CHILD)
    if not np.array_equal(inner, np.flatnonzero(right != NO_CHILD)):
        raise ValueError("a node has one child: nodes of a forest have two, leaves none")
    children = np.concatenate([left[inner], right[inner]])
    if (children <= np.tile(inner, 2)).any() or (children >= n_nodes).any():
        raise ValueError(f"a child must come after its parent and before node {n_nodes}")
    if trees.roots.min() < 0 or trees.roots.max() >= n_nodes:
        raise ValueError(f"roots must be nodes 0 to {n_nodes - 1}")
    visits = np.bincount(np.concatenate([children, trees.roots]), minlength=n_nodes)
    if (visits != 1).any():
        raise ValueError(f"node {np.flatnonzero(visits != 1)[0]} belongs to no tree or to more than one place")


def _levels(trees: Trees) -> list[NDArray[np.intp]]:
    """Nodes of all trees, level by level; the two children of a node stand side by side."""
    levels = [trees.roots.astype(np.intp)]
    while True:
        inner = levels[-1][trees.left[levels[-1]] != NO_CHILD]
        if not len(inner):
            return levels
        levels.append(np.stack([trees.left[inner], trees.right[inner]], axis=1).ravel().astype(np.intp))


def _walkable(trees: Trees, order: NDArray[np.intp]) -> NDArray[Any]:
    """Nodes in this order as `_NODE`, children as places in it; a leaf is its own left child, so who is early waits."""
    place = np.empty(len(order), np.intp)
    place[order] = np.arange(len(order))
    leaf = trees.left[order] == NO_CHILD
    nodes = np.empty(len(order), _NODE)
    nodes["left"] = np.where(leaf, place[order], place[trees.left[order]])
    nodes["threshold"] = np.where(leaf, np.float32(np.inf), _rounded_down(trees.threshold[order]))
    nodes["feature"] = np.where(leaf, 0, trees.feature[order])
    return nodes


def _rounded_down(threshold: FloatArray) -> NDArray[np.float32]:
    """Largest float32 that is at most the threshold: a float32 is above the one where it is above the other."""
    with np.errstate(over="ignore"):
        nearest = threshold.astype(np.float32)
    return np.where(nearest > threshold, np.nextafter(nearest, np.float32(-np.inf)), nearest)
