"""Base classes of stored classifiers: conversion to and from plain arrays, and checks of the rows to classify."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import MISSING, fields
from typing import Any, Self, cast

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.classifiers.model_files import Arrays
from pdr_filter.values import FloatArray, IntArray, read_only, reduction


class Stored:
    """Base class of frozen dataclasses of numbers, strings and arrays. Each field is stored as an array of its name."""

    __slots__ = ()
    __reduce__ = reduction

    def to_arrays(self) -> Arrays:
        """Return the fields as plain arrays for `from_arrays`. Integers are int32."""
        arrays = {f.name: np.asarray(getattr(self, f.name)) for f in fields(cast(Any, self)) if f.init}
        return {name: a.astype(np.int32) if a.dtype.kind == "i" else a for name, a in arrays.items()}

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> Self:
        """Create an object from the arrays of `to_arrays`. KeyError or ValueError for other arrays."""
        stored = [f for f in fields(cast(Any, cls)) if f.init and (f.name in arrays or f.default is MISSING)]
        return cls(**{f.name: arrays[f.name] if arrays[f.name].ndim else arrays[f.name].item() for f in stored})

    def _make_read_only(self, *names: str) -> None:
        """Replace the named fields by read-only float64 copies."""
        for name in names:
            object.__setattr__(self, name, read_only(getattr(self, name), name))

    def _make_integers(self, *names: str) -> None:
        """Replace fields by read-only int64 copies. ValueError for floats, which are not rounded."""
        for name in names:
            array = np.asarray(getattr(self, name))
            if not np.issubdtype(array.dtype, np.integer):
                raise ValueError(f"{name} must hold integers, got {array.dtype}")
            integers: IntArray = array.astype(np.int64)
            integers.flags.writeable = False
            object.__setattr__(self, name, integers)


class Machine(Stored, ABC):
    """Base class of trained classifiers: standardised features in, class probabilities out, in NumPy only."""

    __slots__ = ()

    @property
    @abstractmethod
    def n_features(self) -> int:
        """Number F of features."""

    @property
    @abstractmethod
    def n_classes(self) -> int:
        """Number K of classes."""

    def predict_proba(self, X: ArrayLike) -> FloatArray:
        """Return the class probabilities (N, K) of rows (N, F). Each row of the result sums to one.

        The result for a row does not depend on the other rows, to the last bit. ValueError for another shape, and for
        NaN or infinite features, with their row and column.
        """
        rows = np.asarray(X, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.n_features:
            raise ValueError(f"X must be (N, {self.n_features}), got {rows.shape}: give the features used in training")
        finite = np.isfinite(rows)
        if not finite.all():
            row, column = np.argwhere(~finite)[0]
            raise ValueError(
                f"feature {column} is {rows[row, column]} in row {row}: leave such rows out or fill in a value"
            )
        return self._predict(rows)

    @abstractmethod
    def _predict(self, rows: FloatArray) -> FloatArray:
        """Return the probabilities (N, K) of rows (N, F) that have been checked."""
