"""The radio field of one storey, and how well a scan fits each place of it.

A fingerprint is what a scan hears of each access point, as a vector of unit length: the loudness of the phone cancels.
Each of its components is a Gaussian process over the storey, zero in the mean, all with one kernel

    k(x, x') = exp(-|x - x'| / l),   noise n on the diagonal,

so that one factorisation serves thousands of access points. At a place x it foretells the fingerprint m(x) and its
variance v(x) = k(x, x) - k_x' (K + n I)^-1 k_x + n. With r(x)^2 = |q - m(x)|^2 of a scan's fingerprint q,

    log p(q | x) = -(E / 2) (r(x)^2 / v(x) + log v(x)) + constant.

E is not the number of access points: many are on one box, and all are behind the same walls. It is how many independent
ones say as much together, and was chosen so that regions hold the truth on walks left out. Far from every walk v is
that of the prior: a place where nobody mapped stays possible.
(C. E. Rasmussen and C. K. I. Williams, Gaussian Processes for Machine Learning, 2006, equations 2.23 to 2.26.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_matrix

from pdr_filter.values import FloatArray, IntArray, loudness

# Chosen on storey F1 of `ms_indoor`, walks left out (docs/radio.md): length and noise by the density of the truth,
# evidence so that 95 % regions hold on thin maps too.
LENGTH_M = 40.0
NOISE = 0.3
EVIDENCE = 20.0
# Places that are weighed: hardly further apart than a walker goes in a scan, and so far beyond the walks of the map.
CELL_M = 3.0
MARGIN_M = 30.0


def fingerprints(scan: IntArray, access_point: IntArray, rssi_dbm: FloatArray, shape: tuple[int, int]) -> csr_matrix:
    """Fingerprints (S, A) of hearings (H,), as those of a `WifiScan`."""
    level = loudness(rssi_dbm)
    norm = np.sqrt(np.bincount(scan, level**2, minlength=shape[0]))
    return csr_matrix((level / norm[scan], (scan, access_point)), shape=shape)


def kernel(a_m: FloatArray, b_m: FloatArray) -> FloatArray:
    """Correlation of the field at places (N, 2) and (M, 2)."""
    return np.exp(-np.linalg.norm(a_m[:, None] - b_m, axis=-1) / LENGTH_M)


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """What a storey's map foretells at each cell."""

    cell_m: FloatArray  # (G, 2) middles, from the south-west to the north and then to the east
    shape: tuple[int, int]  # columns to the east, rows to the north
    weight: FloatArray  # (N, G) of the points of the map in what is foretold: m(x) = weight[:, x] of their fingerprints
    variance: FloatArray  # (G,) v
    norm2: FloatArray  # (G,) |m|^2
    heard: Any  # (N, A) fingerprints of the points, sparse

    @classmethod
    def of(cls, position_m: FloatArray, heard: csr_matrix) -> Field:
        """That of fingerprints (N, A) at places (N, 2)."""
        low, high = position_m.min(axis=0) - MARGIN_M, position_m.max(axis=0) + MARGIN_M
        axes = [np.arange(a, b + CELL_M, CELL_M) for a, b in zip(low, high, strict=True)]
        cell_m = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        shape = len(axes[0]), len(axes[1])
        near = kernel(position_m, cell_m)
        factor = cho_factor(kernel(position_m, position_m) + NOISE * np.eye(len(position_m)))
        weight = cho_solve(factor, near)
        variance = 1.0 - (near * weight).sum(axis=0) + NOISE
        norm2 = (weight * ((heard @ heard.T).toarray() @ weight)).sum(axis=0)
        return cls(cell_m, shape, weight, variance, norm2, heard)

    def log_likelihood(self, heard: csr_matrix) -> FloatArray:
        """How well scans of fingerprints (S, A) fit the cells, (S, G); `heard` may be shorter than one.

        What a scan heard and the map does not know is missing in its vector, and counts as misfit.
        """
        misfit = 1.0 - 2.0 * (heard @ self.heard.T).toarray() @ self.weight + self.norm2
        return -0.5 * EVIDENCE * (misfit / self.variance + np.log(self.variance))
