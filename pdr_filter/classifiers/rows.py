"""What every machine asks of the rows that it classifies."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.values.arrays import FloatArray


def checked_rows(X: ArrayLike, n_features: int) -> FloatArray:
    """Rows (N, F) as float64; ValueError for another shape, NaN or infinite features, naming the place."""
    rows = np.asarray(X, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != n_features:
        raise ValueError(f"X must be (N, {n_features}), got {rows.shape}: give the features of the training")
    finite = np.isfinite(rows)
    if not finite.all():
        row, column = np.argwhere(~finite)[0]
        raise ValueError(
            f"feature {column} is {rows[row, column]} in row {row}: leave such rows out or fill in a value"
        )
    return rows
