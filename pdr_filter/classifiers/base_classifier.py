"""What the stored machines share: plain arrays out and in, and rows that are checked before they are classified."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import MISSING, fields
from typing import Any, Self, cast

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.classifiers.model_files import Arrays
from pdr_filter.values import FloatArray, IntArray, pickled, read_only


class Stored:
    """Base of a frozen dataclass of numbers, strings and arrays, which are stored as arrays of the same names."""

    __slots__ = ()
    __reduce__ = pickled

    def to_arrays(self) -> Arrays:
        """Return the plain arrays that `from_arrays` takes, integers as int32."""
        arrays = {f.name: np.asarray(getattr(self, f.name)) for f in fields(cast(Any, self)) if f.init}
        return {name: a.astype(np.int32) if a.dtype.kind == "i" else a for name, a in arrays.items()}

    @classmethod
    def from_arrays(cls, arrays: Arrays) -> Self:
        """Return what `to_arrays` wrote; KeyError or ValueError if it is something else."""
        stored = [f for f in fields(cast(Any, cls)) if f.init and (f.name in arrays or f.default is MISSING)]
        return cls(**{f.name: arrays[f.name] if arrays[f.name].ndim else arrays[f.name].item() for f in stored})

    def _make_read_only(self, *names: str) -> None:
        """Replace fields by read-only float64 copies."""
        for name in names:
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def _make_integers(self, *names: str) -> None:
        """Replace fields by read-only int64 copies; floats are refused, not rounded."""
        for name in names:
            array = np.asarray(getattr(self, name))
            if not np.issubdtype(array.dtype, np.integer):
                raise ValueError(f"{name} must hold integers, got {array.dtype}")
            integers: IntArray = array.astype(np.int64)
            integers.flags.writeable = False
            object.__setattr__(self, name, integers)


class Machine(Stored, ABC):
    """A trained classifier: standardised features in, class probabilities out, in NumPy only."""

    __slots__ = ()

    @property
    @abstractmethod
    def n_features(self) -> int:
        """Number of features, F."""

    @property
    @abstractmethod
    def n_classes(self) -> int:
        """Number of classes, K."""

    def predict_proba(self, X: ArrayLike) -> FloatArray:
        """Class probabilities of rows, (N, F) to (N, K), each row summing to one.

        A row has the same bits alone and in any batch. ValueError for another shape, NaN or infinite features, naming
        the place.
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
        return self._of_rows(rows)

    @abstractmethod
    def _of_rows(self, rows: FloatArray) -> FloatArray:
        """Probabilities (N, K) of checked rows (N, F)."""


def row_by_row(of_row: Callable[[FloatArray], FloatArray], rows: FloatArray, n_classes: int) -> FloatArray:
    """Probabilities (N, K) of rows, one after the other: sums of a batch have other bits than those of a row."""
    result = np.empty((len(rows), n_classes))
    for i, row in enumerate(rows):
        result[i] = of_row(row)
    return result
