"""Likelihood of the distance between two Wi-Fi scans, given the cosine of their fingerprints.

The table has the logarithm of p(cosine | distance) / p(cosine | far away), measured with the scans of different walks
on storey F1 of `ms_indoor`. A cosine of 0.7 means "within about 20 m" and no direction. Two walks are therefore
placed relative to each other by many pairs of scans, dissimilar ones included.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from pdr_filter.values import FloatArray, IntArray
from pdr_filter.walk_map.chains import Scans

# Lower edges of the classes of cosines, and distances of the columns of the table, in m.
_COSINES = np.array([0.0, 0.02, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9])
_DISTANCES_M = np.array([2.0, 6, 10, 14, 18, 22.5, 27.5, 32.5, 37.5, 45, 55, 70, 90, 120])
_LOG_RATIO = np.array(
    [
        [-4.6, -4.4, -4.2, -4.0, -3.4, -2.8, -1.9, -1.5, -1.3, -1.0, -0.7, -0.5, -0.3, 0.0],
        [1.8, 1.9, 2.1, 2.6, 3.3, 3.7, 4.1, 4.3, 4.6, 4.7, 4.6, 4.0, 2.5, 0.0],
        [1.8, 2.3, 3.2, 3.7, 4.1, 4.4, 4.6, 4.8, 4.9, 4.9, 4.5, 4.0, 2.0, 0.0],
        [4.2, 4.6, 5.2, 5.9, 6.3, 6.6, 6.7, 6.7, 6.7, 6.6, 6.2, 4.5, 2.0, 0.0],
        [4.5, 5.0, 5.6, 6.1, 6.5, 6.7, 6.7, 6.7, 6.5, 6.3, 5.4, 4.0, 1.0, 0.0],
        [4.9, 5.4, 5.8, 6.3, 6.7, 6.9, 6.8, 6.6, 6.3, 6.0, 4.5, 2.5, 0.5, 0.0],
        [5.8, 6.1, 6.5, 6.8, 7.0, 7.0, 6.7, 6.3, 5.8, 5.0, 3.4, 1.5, 0.0, 0.0],
        [6.0, 6.2, 6.4, 6.5, 6.4, 6.2, 5.7, 5.1, 4.2, 3.0, 1.0, 0.0, 0.0, 0.0],
        [6.4, 6.5, 6.6, 6.6, 6.4, 5.9, 5.2, 4.3, 2.9, 1.0, 0.0, 0.0, 0.0, 0.0],
        [6.7, 6.7, 6.8, 6.5, 6.1, 5.5, 4.7, 3.6, 1.2, 0.0, 0.0, 0.0, 0.0, 0.0],
        [7.0, 7.0, 6.8, 6.3, 5.7, 4.8, 3.9, 2.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [7.2, 7.2, 6.7, 6.2, 5.4, 3.8, 2.3, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [7.2, 7.0, 6.4, 5.4, 4.2, 1.9, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [7.2, 6.8, 5.6, 4.0, 2.1, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ]
)
# Range of a pair of scans in m and its standard deviation, by cosine, and the smallest cosine of a pair with a range.
_RANGE_COSINES = np.array([0.6, 0.7, 0.8, 0.9, 1.0])
_RANGE_M = np.array([15.0, 11.0, 7.0, 5.0, 4.0])
_RANGE_STD_M = np.array([10.0, 8.0, 6.0, 5.0, 5.0])
PAIR_COSINE = 0.65
# Step of the distance in a lookup table, in m.
_STEP_M = 2.0


def _lookup() -> FloatArray:
    far_m = np.append(np.arange(0.0, _DISTANCES_M[-1], _STEP_M), _DISTANCES_M[-1])
    return np.array([np.interp(far_m, _DISTANCES_M, row) for row in _LOG_RATIO])


_TABLE = _lookup().astype(np.float32)


def log_ratio(cosine: FloatArray, distance_m: FloatArray) -> FloatArray:
    """Return the log likelihood ratios (S, G) of S scans at G places relative to places far away.

    They are summed over M mapped scans. `cosine` (S, M) has the cosines of the fingerprints of the scans with those of
    the mapped scans. `distance_m` (G, M) has the distances of the places from the mapped scans.
    """
    of_cosine = np.digitize(cosine, _COSINES) - 1
    of_distance = np.minimum(distance_m / _STEP_M + 0.5, _TABLE.shape[1] - 1).astype(np.int16)
    total = np.zeros((len(cosine), len(distance_m)), dtype=np.float32)
    for k in np.unique(of_cosine):
        total += (of_cosine == k).astype(np.float32) @ _TABLE[k][of_distance].T
    return total.astype(np.float64)


def ranges(cosine: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the expected distances in m of pairs of scans, and their standard deviations, from their cosines."""
    return np.interp(cosine, _RANGE_COSINES, _RANGE_M), np.interp(cosine, _RANGE_COSINES, _RANGE_STD_M)


def fingerprint_matrix(scans: Sequence[Scans]) -> tuple[Any, IntArray]:
    """Return the fingerprints of all scans as a sparse matrix (S, A), and the addresses (A,) of its columns.

    A product of two such matrices visits only pairs of scans with a common access point (an inverted index).
    """
    bssid = np.concatenate([s.bssid for s in scans]) if scans else np.zeros(0, dtype=np.int64)
    known, column = np.unique(bssid, return_inverse=True)
    first = np.cumsum([0, *(len(s) for s in scans)])
    row = np.concatenate([s.row + n for s, n in zip(scans, first[:-1], strict=True)]) if scans else column
    value = np.concatenate([s.fingerprint for s in scans]) if scans else np.zeros(0)
    return csr_matrix((value, (row, column)), (int(first[-1]), len(known))), known
