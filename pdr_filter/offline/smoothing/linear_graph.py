"""Linear least squares over the anchors of a walk: whitened equations, elimination by GTSAM, and covariances."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import accumulate

import numpy as np

from pdr_filter.filter.imm.motion_model import N_STATES
from pdr_filter.offline.late_gtsam import gtsam
from pdr_filter.offline.smoothing.location_errors import N_ERRORS
from pdr_filter.values import FloatArray, IntArray

NO_WEIGHT = np.zeros(0)


@dataclass(slots=True)
class Rows:
    """Whitened linear equations A x_a + B x_b = rhs, one block of m equations for each pair of unknown vectors.

    An unknown vector x is identified by its number, the key. x_a and x_b are the unknowns with the first and the second
    key.
    """

    a: IntArray  # (n,) first key of each block
    A: FloatArray  # (n, m, da) matrices of the first key
    rhs: FloatArray  # (n, m) right-hand sides
    b: IntArray  # (n,) second key, -1 for none
    B: FloatArray  # (n, m, db) matrices of the second key; empty if no block has one
    weight: FloatArray = field(default_factory=lambda: NO_WEIGHT)  # (n,) weights of the blocks; empty for weight one

    @classmethod
    def of_one(cls, key: int, A: FloatArray, rhs: FloatArray) -> Rows:
        """Return one block of equations A x = rhs for the single unknown with this key."""
        return cls.of_single(np.full(1, key), A[None], rhs[None])

    @classmethod
    def of_single(cls, a: IntArray, A: FloatArray, rhs: FloatArray, weight: FloatArray = NO_WEIGHT) -> Rows:
        """Return blocks of equations A x = rhs, each for a single unknown."""
        return cls(a, A, rhs, np.full(len(a), -1), np.zeros((0, 0, 0)), weight)


def graph_of(rows: Sequence[Rows]) -> gtsam.GaussianFactorGraph:
    """Return the linear factors of GTSAM, one for each block of rows, multiplied by the root of its weight.

    Blocks of weight zero are left out.
    """
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


def eliminate(rows: Sequence[Rows]) -> gtsam.GaussianBayesTree:
    """Return the Bayes tree of the equations, in which each key is solved given the keys eliminated after it."""
    return graph_of(rows).eliminateMultifrontal(gtsam.Ordering.OrderingType.COLAMD, gtsam.EliminateQR)


def cov_of(tree: gtsam.GaussianBayesTree, keys: Sequence[int]) -> FloatArray:
    """Return the joint covariance of the unknowns with these keys, computed by QR factorisation.

    The marginals of GTSAM use a Cholesky factorisation, which works with squared values. It takes a position prior with
    a standard deviation of one kilometre for no information at all.
    """
    R, _ = tree.jointBayesNet(list(keys), gtsam.EliminateQR).matrix()
    inverse = np.linalg.inv(R)
    return inverse @ inverse.T


def joint_covariances(
    rows: Sequence[Rows], n: int, error_node: IntArray, has_frame: bool
) -> tuple[FloatArray, FloatArray]:
    """Return the covariances (n - 1, 8, 8) of both ends of the intervals between n anchors, in one backward pass.

    The second result is the joint covariance (E, 10, 10) of the anchor `error_node` of each error (4 states), followed
    by the error (6 states). Keys are the anchors, the errors, and the rotation of the frame. They are eliminated in the
    order of the walk, each error after its anchor. Each conditional is R x_j + S x_P = d. The parents P of a key j are
    one later key and some of the parents of that key, so the joint covariance of P is known already. Then cov x_j =
    R^-1 R^-T + G cov x_P G' with G = -R^-1 S.
    """
    n_states, error_of = n + len(error_node), {node: n + k for k, node in enumerate(error_node.tolist())}
    keys = [key for j in range(n) for key in ((j, error_of[j]) if j in error_of else (j,))]
    keys += [n_states] if has_frame else []
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    net = graph_of(rows).eliminateSequential(ordering, gtsam.EliminateQR)
    conditionals = [net.at(i) for i in range(len(keys))]
    rank = {key: i for i, key in enumerate(keys)}
    parents_of = [c.keys()[1:] for c in conditionals]
    first_of = [min(parents, key=rank.__getitem__, default=None) for parents in parents_of]
    n_waiting = Counter(first_of)
    # covariance of a key and its parents, kept while the key is the first parent of another key
    cliques, sizes = dict[int, _Clique](), dict[int, int]()
    joint_cov = np.empty((n - 1, 2 * N_STATES, 2 * N_STATES))
    with_error_cov = np.zeros((len(error_node), N_STATES + N_ERRORS, N_STATES + N_ERRORS))
    for conditional, parents, first in zip(conditionals[::-1], parents_of[::-1], first_of[::-1], strict=True):
        inverse = np.linalg.inv(conditional.R())
        m, cov = len(inverse), inverse @ inverse.T
        if first is not None:
            known = cliques[first].of(parents)
            n_waiting[first] -= 1
            if not n_waiting[first]:
                del cliques[first]
            gain = -inverse @ conditional.S()
            mixed, own = gain @ known, cov
            cov = np.empty((m + len(known), m + len(known)))
            cov[:m, :m], cov[:m, m:], cov[m:, :m], cov[m:, m:] = own + mixed @ gain.T, mixed, mixed.T, known
        key = conditional.keys()[0]
        sizes[key] = m
        clique = _Clique.of_sizes(cov, {k: sizes[k] for k in (key, *parents)})
        if n_waiting[key]:
            cliques[key] = clique
        if key < n - 1:  # steps connect the anchor to the next one
            joint_cov[key] = clique.of((key, key + 1))
        if error_of.get(key) in clique.place:
            with_error_cov[error_of[key] - n] = clique.of((key, error_of[key]))
    return joint_cov, with_error_cov


@dataclass(frozen=True, slots=True)
class _Clique:
    """Joint covariance `cov` of some unknowns, and the rows `place` of each unknown in it, by key."""

    cov: FloatArray
    place: dict[int, range]

    @classmethod
    def of_sizes(cls, cov: FloatArray, sizes: dict[int, int]) -> _Clique:
        """Return a clique from the joint covariance `cov` of its unknowns.

        `sizes` maps the key of each unknown to its dimension, in the order of the rows of `cov`.
        """
        ends = accumulate(sizes.values())
        return cls(cov, {key: range(end - size, end) for (key, size), end in zip(sizes.items(), ends, strict=True)})

    def of(self, keys: Sequence[int]) -> FloatArray:
        """Return the joint covariance of the unknowns with some of the keys, in the given order of the keys."""
        index = [i for key in keys for i in self.place[key]]
        return self.cov[index][:, index]
