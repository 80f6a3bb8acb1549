"""Linear least squares over the anchors of a walk: whitened equations, GTSAM's elimination, covariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np

from pdr_filter.filter.motion import N_STATES
from pdr_filter.values import BoolArray, FloatArray, IntArray


@dataclass(slots=True)
class Rows:
    """Whitened linear equations A x_a + B x_b = rhs, one block for each pair of keys."""

    a: IntArray
    A: FloatArray  # (n, m, da)
    rhs: FloatArray  # (n, m)
    b: IntArray  # the second key; -1 for none
    B: FloatArray  # (n, m, db)
    weight: FloatArray = field(default_factory=lambda: np.zeros(0))  # (n,); empty for weight one

    @classmethod
    def of_one(cls, key: int, A: FloatArray, rhs: FloatArray) -> Rows:
        """A block with a single key."""
        return cls(np.full(1, key), A[None], rhs[None], np.full(1, -1), np.zeros((0, 0, 0)))

    def chosen(self, keep: BoolArray) -> Rows:
        """Some of the blocks."""
        B = self.B[keep] if len(self.B) else self.B
        weight = self.weight[keep] if len(self.weight) else self.weight
        return Rows(self.a[keep], self.A[keep], self.rhs[keep], self.b[keep], B, weight)


def graph_of(rows: Sequence[Rows]) -> gtsam.GaussianFactorGraph:
    """Linear factors of GTSAM, one for each block of rows; blocks of weight zero are left out."""
    graph = gtsam.GaussianFactorGraph()
    for block in rows:
        model = gtsam.noiseModel.Unit.Create(block.rhs.shape[1])
        root = np.sqrt(block.weight) if len(block.weight) else np.ones(len(block.a))
        a, b = block.a.tolist(), block.b.tolist()
        for i, w in enumerate(root.tolist()):
            if w == 0:
                continue
            A, rhs = w * block.A[i], w * block.rhs[i]
            if b[i] < 0:
                graph.push_back(gtsam.JacobianFactor(a[i], A, rhs, model))
            else:
                graph.push_back(gtsam.JacobianFactor(a[i], A, b[i], w * block.B[i], rhs, model))
    return graph


def eliminated(rows: Sequence[Rows]) -> gtsam.GaussianBayesTree:
    """The equations solved for each key given those eliminated after it."""
    return graph_of(rows).eliminateMultifrontal(gtsam.Ordering.OrderingType.COLAMD, gtsam.EliminateQR)


def cov_of(tree: gtsam.GaussianBayesTree, keys: Sequence[int]) -> FloatArray:
    """Joint covariance by QR: GTSAM's own, by Cholesky, takes what is known within a kilometre for unknown."""
    R, _ = tree.jointBayesNet(list(keys), gtsam.EliminateQR).matrix()
    inverse = np.linalg.inv(R)
    return inverse @ inverse.T


def joint_covariances(rows: Sequence[Rows], n: int, has_frame: bool) -> FloatArray:
    """Covariance of both ends of the intervals between n anchors, (n - 1, 8, 8), by going back through them once.

    Eliminated in the order of the walk, R x_j + S x_P = d, where the parents P are the next anchor and, of loop
    closures and the rotation of the frame (key n), some of its own parents: their joint covariance is known already.
    Then cov x_j = R^-1 R^-T + G cov x_P G' with G = -R^-1 S.
    """
    ordering = gtsam.Ordering()
    for key in range(n + has_frame):
        ordering.push_back(key)
    net = graph_of(rows).eliminateSequential(ordering, gtsam.EliminateQR)
    conditionals = [net.at(j) for j in range(n)]
    inverse = np.linalg.inv([c.R() for c in conditionals])
    own_cov = inverse @ inverse.swapaxes(-1, -2)
    joint_cov = np.empty((n - 1, 2 * N_STATES, 2 * N_STATES))
    # of the anchor before last and its parents, and where each of them is in it
    cov, first = np.zeros((0, 0)), dict[int, int]()
    if has_frame:
        root = np.linalg.inv(net.at(n).R())
        cov, first = root @ root.T, {n: 0}
    for j in reversed(range(n)):
        parents = conditionals[j].keys()[1:]
        index = [i for p in parents for i in range(first[p], first[p] + (len(cov) - first[p] if p == n else N_STATES))]
        known = cov[index][:, index]
        gain = -inverse[j] @ conditionals[j].S()
        mixed = gain @ known
        cov = np.empty((N_STATES + len(known),) * 2)
        cov[:N_STATES, :N_STATES] = own_cov[j] + mixed @ gain.T
        cov[:N_STATES, N_STATES:], cov[N_STATES:, :N_STATES], cov[N_STATES:, N_STATES:] = mixed, mixed.T, known
        first = {j: 0} | {p: N_STATES * (1 + i) for i, p in enumerate(parents)}
        if j < n - 1:  # the next anchor is the first of the parents
            joint_cov[j] = cov[: 2 * N_STATES, : 2 * N_STATES]
    return joint_cov
