"""Arrays of the value types, and small column tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# A small column table: `table.time_s` and `table["time_s"]` are columns, `len(table)` rows, and
# `pandas.DataFrame(table)` works, without pandas being needed here.
Table = np.recarray[Any, Any]


def read_only(values: ArrayLike) -> FloatArray:
    """Return a read-only contiguous float64 copy."""
    array = np.array(values, dtype=np.float64, order="C")
    array.flags.writeable = False
    return array


def table(columns: Mapping[str, ArrayLike]) -> Table:
    """Return a read-only column table from equally long columns."""
    arrays = {name: np.asarray(column) for name, column in columns.items()}
    length = len(next(iter(arrays.values())))
    result = np.zeros(length, dtype=[(name, array.dtype) for name, array in arrays.items()])
    for name, array in arrays.items():
        result[name] = array
    result.flags.writeable = False
    return result.view(np.recarray)
