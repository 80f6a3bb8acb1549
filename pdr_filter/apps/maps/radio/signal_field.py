"""Gaussian-process field of the Wi-Fi signals of one storey, and the likelihood of a scan at each position.

A fingerprint is the vector of signal strengths of a scan, scaled to unit length. The scaling removes the receiver gain
of the phone. Each component of the fingerprint is a Gaussian process over the storey with zero mean. All components
have the same kernel

    k(x, x') = exp(-|x - x'| / l),   noise n on the diagonal,

so that one factorisation serves thousands of access points. At a position x, the process predicts the fingerprint m(x)
with the variance v(x) = k(x, x) - k_x' (K + n I)^-1 k_x + n. With r(x)^2 = |q - m(x)|^2 for the fingerprint q of a
scan,

    log p(q | x) = -(E / 2) (r(x)^2 / v(x) + log v(x)) + constant.

E is the effective number of independent access points. It is smaller than the number of access points, because many
share one device and all are behind the same walls. It was chosen so that the regions contain the true positions of
held-out walks, even on maps of a third of the walks. Far from every mapped walk, v is the prior variance, so an
unmapped position stays possible. Nearest neighbours (scikit-learn) have the same median error without a reliable
uncertainty: their 95 % regions hold the true position in 57 to 84 % of the scans.
(C. E. Rasmussen and C. K. I. Williams, Gaussian Processes for Machine Learning, 2006, equations 2.23 to 2.26.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_matrix

from pdr_filter.values import FloatArray, IntArray, loudness

# Chosen on storey F1 of `ms_indoor` with held-out walks: length and noise by the density at the true position, evidence
# so that the 95 % regions are valid on sparse maps too.
LENGTH_M = 40.0
NOISE = 0.3
EVIDENCE = 20.0
# Cells in which the likelihood is computed, and their margin around the mapped walks. A cell is about as long as the
# path walked during one scan.
CELL_M = 3.0
MARGIN_M = 30.0


def fingerprints(scan: IntArray, access_point: IntArray, rssi_dbm: FloatArray, shape: tuple[int, int]) -> csr_matrix:
    """Return the fingerprints, in a matrix of `shape` (S, A), of measurements (H,), scaled as in `WifiScan`."""
    level = loudness(rssi_dbm)
    norm = np.sqrt(np.bincount(scan, level**2, minlength=shape[0]))
    return csr_matrix((level / norm[scan], (scan, access_point)), shape=shape)


def kernel(a_m: FloatArray, b_m: FloatArray) -> FloatArray:
    """Return the correlation (N, M) of the field between positions (N, 2) and (M, 2)."""
    return np.exp(-np.linalg.norm(a_m[:, None] - b_m, axis=-1) / LENGTH_M)


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """Fingerprint predicted at each cell of a storey."""

    cell_m: FloatArray  # (G, 2) centres of the cells, first from south to north, then from west to east
    shape: tuple[int, int]  # number of columns to the east and of rows to the north
    weight: FloatArray  # (N, G) of each mapped scan in the prediction at each cell: m(x) = weight[:, x] @ heard
    variance: FloatArray  # (G,) predicted variance v
    norm2: FloatArray  # (G,) squared length of the predicted fingerprint, |m|^2
    heard: Any  # (N, A) sparse fingerprints of the mapped scans

    @classmethod
    def of(cls, position_m: FloatArray, heard: csr_matrix) -> Field:
        """Return the field fitted to fingerprints (N, A) at positions (N, 2)."""
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
        """Return the log likelihood (S, G) of scans with fingerprints (S, A) at each cell.

        A fingerprint may be shorter than one: access points that the map does not contain are missing from it, which
        reduces the fit.
        """
        misfit = 1.0 - 2.0 * (heard @ self.heard.T).toarray() @ self.weight + self.norm2
        return -0.5 * EVIDENCE * (misfit / self.variance + np.log(self.variance))
