"""Summaries of weighted particles: mean, covariance, clusters and the number needed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pdr_filter.values import Cluster, FloatArray, IntArray, OnPlan, read_only

# Cell size for clustering. Particles in touching cells, corners included, belong to one cluster.
_CELL_M = 1.0
# Clusters with a smaller share of the weight are stragglers and are not reported.
_LEAST_SHARE = 0.01


class Alternative(NamedTuple):
    """Distribution of the position if no particle is at the true one: probability, mean (2,) and covariance (2, 2)."""

    prob: float
    mean_m: FloatArray
    cov_m2: FloatArray


def on_plan(
    position_m: FloatArray,
    weight: FloatArray,
    heading_rad: FloatArray,
    elsewhere: float = 0.0,
    alternative: Alternative | None = None,
) -> OnPlan:
    """Return the mean, covariance and clusters of weighted particles, with their mean heading and effective number.

    The particles have positions (N, 2), weights (N,) that sum to one, and walking headings (N,). With the probability
    `elsewhere`, no particle is at the true position. `alternative` is the position in that case, or None if unknown.
    The returned mean is the mean of the particles in any case, because it is a walkable position. Clusters are in
    descending order of their weight.
    """
    mean, cov = weighted_moments(position_m, weight)
    cov = inflated_cov(mean, cov, alternative)
    heading = np.arctan2(weight @ np.sin(heading_rad), weight @ np.cos(heading_rad))
    group = cluster_numbers(position_m)
    share = np.bincount(group, weight)
    order = [int(g) for g in np.argsort(-share, kind="stable") if share[g] >= _LEAST_SHARE]
    clusters: list[Cluster] = []
    for g in order:
        inside = group == g
        known = float(share[g] * (1.0 - elsewhere))
        clusters.append(Cluster(known, *weighted_moments(position_m[inside], weight[inside] / share[g])))
    ess = 1.0 / float((weight**2).sum())
    return OnPlan(mean, cov, float(heading), tuple(clusters), len(weight), ess)


def inflated_cov(mean_m: FloatArray, cov_m2: FloatArray, alternative: Alternative | None) -> FloatArray:
    """Return the mean square about `mean_m` (2,) of a mixture of the particles and an alternative, if there is one."""
    if alternative is None:
        return cov_m2
    prob, away = alternative.prob, alternative.mean_m - mean_m
    return read_only((1.0 - prob) * cov_m2 + prob * (alternative.cov_m2 + away[:, None] * away))


def weighted_moments(position_m: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (2,) and covariance (2, 2) of positions (N, 2) with weights (N,) that sum to one."""
    mean = weight @ position_m
    away = position_m - mean
    cov = (weight[:, None] * away).T @ away
    return read_only(mean), read_only(0.5 * (cov + cov.T))


def cluster_numbers(position_m: FloatArray) -> IntArray:
    """Return the cluster number (N,) of each position (N, 2). Positions in touching cells belong to one cluster."""
    from scipy.ndimage import label  # imported late: a filter without a plan need not load SciPy

    cell = np.floor(position_m / _CELL_M).astype(np.int64)
    cell -= cell.min(axis=0)
    columns, rows = cell.max(axis=0) + 1
    taken = np.zeros((columns, rows), dtype=bool)
    taken[cell[:, 0], cell[:, 1]] = True
    labels = np.zeros(taken.shape, dtype=np.int64)
    label(taken, np.ones((3, 3)), labels)
    return labels[cell[:, 0], cell[:, 1]] - 1


def n_needed(cell: IntArray, least: int, most: int) -> int:
    """Return the number of particles that represent their distribution accurately, between `least` and `most`.

    `cell` (N, d) holds the cell of each particle. With k occupied cells, n = (k - 1) / (2 e) (1 - a + z sqrt(a))^3, a =
    2 / (9 (k - 1)), keeps the Kullback-Leibler distance to the true distribution below e = 0.05 with a probability of
    99 % (D. Fox, "Adapting the sample size in particle filters through KLD-sampling", Int. J. Robotics Research 22,
    2003).
    """
    cell = cell - cell.min(axis=0)
    flat = np.ravel_multi_index(tuple(cell.T), tuple(cell.max(axis=0) + 1))
    k = len(np.unique(flat))
    if k < 2:
        return least
    a = 2.0 / (9.0 * (k - 1))
    n = (k - 1) / (2 * 0.05) * (1.0 - a + 2.326 * np.sqrt(a)) ** 3
    return int(min(max(n, least), most))
