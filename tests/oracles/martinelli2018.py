"""Algorithms 1 and 2 of Martinelli et al. 2018, written line by line from the text, with the numbering of the paper.

Epoch k is "the end boundary of the (k-1)th context time window" (section VI.B). d[k] are the distances of the steps
between epochs k - 1 and k in each context (eq. 17), and `context[k]` the probabilities of window k (eq. 18).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def algorithms(
    d: Sequence[Sequence[float]], context: Sequence[Sequence[float]], threshold: float | None
) -> dict[str, list[float]]:
    """Algorithm 1 (threshold None) or 2 for epochs 1 to K, d[k - 1] of epoch k, and windows 0 to K."""
    n_epochs = len(d)
    pd, final = {0: 0.0}, {0: 0.0}
    total_final, total_provisional = {0: 0.0, -1: 0.0}, {0: 0.0}
    for k in range(1, n_epochs + 2):  # epoch k uses window k - 1
        probabilities = context[k - 1]
        ordered = sorted(probabilities, reverse=True)
        if threshold is None or ordered[1] / ordered[0] < threshold:
            j = list(probabilities).index(ordered[0])  # eq. 19
            weights = [1.0 if i == j else 0.0 for i in range(len(probabilities))]  # eq. 20
        else:
            weights = list(probabilities)
        if k <= n_epochs:
            pd[k] = sum(d[k - 1][i] * weights[i] for i in range(len(weights)))
        if k >= 2:
            final[k - 1] = sum(d[k - 2][i] * weights[i] for i in range(len(weights)))
            total_final[k - 1] = total_final[k - 2] + (final[k - 1] + pd[k - 1]) / 2
        if k <= n_epochs:
            total_provisional[k] = total_provisional[k - 1] + (final[k - 1] - pd[k - 1]) / 2 + pd[k]
    columns = {
        "provisional_m": pd,
        "final_m": final,
        "total_final_m": total_final,
        "total_provisional_m": total_provisional,
    }
    return {name: [column[k] for k in range(1, n_epochs + 1)] for name, column in columns.items()}


def distances_of_epochs(
    contact_s: Sequence[float], length_m: np.ndarray, window_end_s: Sequence[float]
) -> list[list[float]]:
    """Eq. 17 for the epochs 1 to K of K + 1 windows; lengths (N, C) of the steps in each context.

    Steps before the end of window 0 belong to epoch 1.
    """
    epoch_s = {k: window_end_s[k - 1] for k in range(1, len(window_end_s))} | {0: -np.inf}
    found = []
    for k in range(1, len(window_end_s)):
        between = [p for p, t in enumerate(contact_s) if epoch_s[k - 1] < t <= epoch_s[k]]
        found.append([sum(length_m[p][n] for p in between) for n in range(length_m.shape[1])])
    return found
