"""Linear interpolation of sampled quantities."""

from __future__ import annotations

import numpy as np

from pdr_filter.values.arrays import FloatArray


def interpolated_rows(at_s: FloatArray | float, time_s: FloatArray, values: FloatArray) -> FloatArray:
    """Return values (..., d) at times (...), interpolated between rows (N, d) in any order, constant beyond them."""
    if (time_s[1:] < time_s[:-1]).any():
        order = np.argsort(time_s, kind="stable")
        time_s, values = time_s[order], values[order]
    return np.stack([np.interp(at_s, time_s, column) for column in values.T], axis=-1)


def interpolated_near(at_s: FloatArray, time_s: FloatArray, values: FloatArray, max_gap_s: float) -> FloatArray:
    """Return interpolated values (M, d), with NaN where the nearest row is further away than `max_gap_s`."""
    if len(time_s) == 0 or len(at_s) == 0:
        return np.full((len(at_s), values.shape[1]), np.nan)
    result = interpolated_rows(at_s, time_s, values)
    time_s = np.sort(time_s)
    right = np.clip(np.searchsorted(time_s, at_s), 0, len(time_s) - 1)
    left = np.maximum(right - 1, 0)
    result[np.minimum(np.abs(time_s[right] - at_s), np.abs(time_s[left] - at_s)) > max_gap_s] = np.nan
    return result
