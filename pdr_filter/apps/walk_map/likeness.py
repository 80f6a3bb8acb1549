"""Gaussian process of Wi-Fi fingerprints, for walks whose positions are not known.

A fingerprint is the vector of signal strengths of a scan, scaled to unit length. Each of its components is a Gaussian
process over a storey with the covariance

    K_ij = s (k(|x_i - x_j|) (1 + w [same walk]) + n [i = j]),   k(d) = 1 / (1 + (d / l)^2),

scaled to one on the diagonal. The term w describes errors that all scans of a walk share. With the cosines C of the
fingerprints, the log likelihood of all positions together is

    log p = -(E / 2) (tr(K^-1 C) + log det K),

where E is the effective number of independent access points (Ferris, Fox and Lawrence, "WiFi-SLAM using Gaussian
process latent variable models", IJCAI 2007). `apps.maps.radio.signal_field` has the likelihood of one scan on a
surveyed map, for which a longer and rougher kernel is more accurate.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_matrix

from pdr_filter.apps.walk_map.chains import Scans
from pdr_filter.values import FloatArray, IntArray

# All numbers were chosen on storey F1 of `ms_indoor`. The length leaves the scale of a map right, whether its walks
# overlap much or little: longer ones drive crowded walks apart, shorter ones pull sparse walks together.
LENGTH_M, NOISE, OF_WALK = 12.0, 0.27, 0.15
_SCALE = 1.0 / (1.0 + OF_WALK + NOISE)
# Effective number of independent access points of all scans together, and of one scan in a walk.
EVIDENCE = 5.0


def _covariance(first_m: FloatArray, second_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the displacements (n, m, 2) between positions (n, 2) and (m, 2), and the kernel k (n, m)."""
    apart_m = first_m[:, None] - second_m
    return apart_m, 1.0 / (1.0 + np.einsum("nma,nma->nm", apart_m, apart_m) / LENGTH_M**2)


def log_ratio(
    cosine: FloatArray, among: FloatArray, mapped_m: FloatArray, owner: IntArray, cell_m: FloatArray
) -> FloatArray:
    """Return the log likelihood ratios (S, G) of S scans at G places relative to places far away.

    `cosine` (S, M) has the cosines of the fingerprints of the scans and of the mapped scans, and `among` (M, M) those
    of the mapped scans with each other. The mapped scans are at the positions `mapped_m` (M, 2), and `owner` (M,) has
    the indices of their walks.
    """
    same = 1.0 + OF_WALK * (owner[:, None] == owner)
    known = _SCALE * (_covariance(mapped_m, mapped_m)[1] * same + NOISE * np.eye(len(owner)))
    near = _SCALE * _covariance(mapped_m, cell_m)[1]
    weight = cho_solve(cho_factor(known), near)
    variance = 1.0 - np.einsum("mg,mg->g", near, weight)
    norm2 = np.einsum("mg,mg->g", weight, among @ weight)
    misfit = 1.0 - 2.0 * cosine @ weight + norm2
    return -0.5 * EVIDENCE * (misfit / variance + np.log(variance) - 1.0)


def likelihood(position_m: FloatArray, owner: IntArray, cosine: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Return the log likelihood of the positions (n, 2) of scans, its gradient (2 n,), and its information (2 n, 2 n).

    `cosine` (n, n) has the cosines of the fingerprints, and `owner` (n,) the indices of the walks. The unknowns are
    east and north of the first scan, then of the second one, and so on. With A = K^-1 and the rows U_i of the
    derivatives of K by x_i, the Fisher information of x_i and x_j is E (A_ij (U A U')_ij + (U A)_ij (A U')_ij).
    """
    n = len(position_m)
    same = 1.0 + OF_WALK * (owner[:, None] == owner)
    apart_m, k = _covariance(position_m, position_m)
    known = _SCALE * (k * same + NOISE * np.eye(n))
    inverse = np.linalg.inv(known)
    value = -0.5 * EVIDENCE * (float((inverse * cosine).sum()) + float(np.linalg.slogdet(known)[1]))
    by_cov = 0.5 * EVIDENCE * (inverse @ cosine @ inverse - inverse)
    by_distance = -2.0 * _SCALE / LENGTH_M**2 * k * k * same
    by_position = [by_distance * apart_m[..., a] for a in range(2)]
    across = [u @ inverse for u in by_position]
    slope, information = np.empty((n, 2)), np.empty((n, 2, n, 2))
    for a in range(2):
        slope[:, a] = 2.0 * (by_cov * by_position[a]).sum(axis=1)
        for b in range(2):
            information[:, a, :, b] = EVIDENCE * (inverse * (across[a] @ by_position[b].T) + across[a] * across[b].T)
    return value, slope.ravel(), information.reshape(2 * n, 2 * n)


def fingerprint_matrix(scans: Sequence[Scans]) -> Any:
    """Return the fingerprints of all scans as a sparse matrix (S, A), with a column for each access point.

    A product of two such matrices visits only pairs of scans with a common access point (an inverted index).
    """
    if not scans:
        return csr_matrix((0, 0))
    known, column = np.unique(np.concatenate([s.bssid for s in scans]), return_inverse=True)
    first = np.cumsum([0, *(len(s) for s in scans)])
    row = np.concatenate([s.row + n for s, n in zip(scans, first[:-1], strict=True)])
    return csr_matrix((np.concatenate([s.fingerprint for s in scans]), (row, column)), (int(first[-1]), len(known)))
