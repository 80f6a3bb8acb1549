"""Trained relevance vector machines as plain arrays: prediction in NumPy only, in some tens of microseconds per row.

`pdr_filter.classifiers.rvm` trains them and needs scikit-learn. This module does not import it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pdr_filter.classifiers.base_classifier import Machine
from pdr_filter.values import FloatArray, IntArray, check_array, read_only, softmax

KERNELS = ("rbf", "linear")
LINKS = ("sigmoid", "softmax")
# Number of rows that are evaluated together, whose arrays fit into the cache. Results do not depend on it.
_BATCH_SIZE = 64


@dataclass(frozen=True, slots=True, eq=False)
class RelevanceVectors(Machine):
    """Relevance vector machines, one for each class, with common relevance vectors.

    Machine k has the logit t_k(x) = sum_j weights[k, j] phi[basis[k, j]](x) (eq. 4 of Martinelli et al. 2018), where
    phi_0(x) = 1 is the bias and phi_r(x) = K(x, vectors[r - 1]). The largest machine has m basis functions. Smaller
    machines are padded with weights of zero.
    """

    # "rbf": K(x, v) = exp(-||x - v||^2 / (2 width^2)) (eq. 5 of Martinelli et al. 2018). "linear": K(x, v) = x . v
    kernel: str
    width: float  # sigma_G of eq. 5 of Martinelli et al. 2018, in units of the features. Unused by the linear kernel.
    vectors: FloatArray  # (R, F) relevance vectors of all machines. R may be zero.
    basis: IntArray  # (K, m) basis functions of each machine: 0 is the bias, r is the vector r - 1
    # (K, m) posterior means of the weights (eq. 10 of Martinelli et al. 2018), for two or more classes
    weights: FloatArray
    # (K, m, m) factor G of the posterior covariance G^T G of the weights (eq. 10 of Martinelli et al. 2018). The
    # variance of the logit is ||G phi||^2. This variance moderates the probabilities: they are nearer to each other if
    # the logits are uncertain. If G is zero, probabilities are not moderated.
    cov_factor: FloatArray
    # conversion of logits to probabilities: `normalised_sigmoids` for one-against-all machines, or `moderated_softmax`
    # for competing logits
    link: str = "sigmoid"  # the default is for files of version 0.1, which have no link
    _squares: FloatArray = field(init=False, repr=False)  # (R,) squared norms of the vectors

    def __post_init__(self) -> None:
        self._make_read_only("vectors", "weights", "cov_factor")
        self._make_integers("basis")
        _check(self)
        object.__setattr__(self, "_squares", read_only(np.add.reduce(self.vectors * self.vectors, axis=1)))

    @property
    def n_features(self) -> int:
        return self.vectors.shape[1]

    @property
    def n_classes(self) -> int:
        return len(self.weights)

    def _predict(self, rows: FloatArray) -> FloatArray:
        of_logits = normalised_sigmoids if self.link == "sigmoid" else moderated_softmax
        blocks = [rows[i : i + _BATCH_SIZE] for i in range(0, len(rows), _BATCH_SIZE)]
        prob = [of_logits(*self._logits(np.ascontiguousarray(block))) for block in blocks]
        return np.concatenate([np.zeros((0, self.n_classes)), *prob])

    def _logits(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and variance (N, K) of the logits of rows (N, F)."""
        # One matrix-vector product per row, because products of a batch can differ in the last bits.
        kernel = np.matmul(self.vectors, rows[:, :, None])[:, :, 0]
        if self.kernel == "rbf":
            distance = np.add.reduce(rows * rows, axis=1)[:, None] + self._squares - 2.0 * kernel  # squared
            kernel = np.exp(np.maximum(distance, 0.0) / (-2.0 * self.width**2))
        own = np.concatenate([np.ones((len(rows), 1)), kernel], axis=1).take(self.basis, axis=1)  # (N, K, m)
        projected = np.matmul(self.cov_factor, own[..., None])[..., 0]  # G phi
        return np.add.reduce(self.weights * own, axis=2), np.add.reduce(projected * projected, axis=2)


def normalised_sigmoids(logit: FloatArray, variance: FloatArray) -> FloatArray:
    """Return class probabilities (..., K) from one-against-all logits and their variances, (..., K) each.

    p_k is proportional to sigma(kappa(variance_k) logit_k), with kappa(v) = (1 + pi v / 8)^(-1/2). This is the sigmoid
    sigma averaged over the uncertainty of the logit (MacKay 1992; Bishop 2006, eq. 4.153 and 4.154).
    """
    moderated = logit / np.sqrt(1.0 + np.pi / 8.0 * variance)
    return softmax(-np.logaddexp(0.0, -moderated))  # in logarithms, because all sigmoids underflow far from all classes


def moderated_softmax(logit: FloatArray, variance: FloatArray) -> FloatArray:
    """Return class probabilities (..., K) from competing logits and their variances, (..., K) each.

    The probability p_k of class k is proportional to 1 / sum_j exp(-kappa(variance_k + variance_j) (logit_k -
    logit_j)), with kappa(v) = (1 + pi v / 8)^(-1/2). The sum is over all classes j, and its term for j = k is 1 (a
    mean-field form of Lu, Ie and Sha 2020). Without variance p is the softmax. For two classes it is the moderated
    sigmoid of the difference.
    """
    kappa = 1.0 / np.sqrt(1.0 + np.pi / 8.0 * (variance[..., None] + variance[..., None, :]))
    advantage = kappa * (logit[..., None, :] - logit[..., None])  # [..., k, j]: of j over k
    most = advantage.max(axis=-1)  # not negative, because the advantage of a class over itself is 0
    return softmax(-most - np.log(np.exp(advantage - most[..., None]).sum(axis=-1)))


def _check(machine: RelevanceVectors) -> None:
    """Raise ValueError unless the arrays have matching shapes and finite values."""
    if machine.kernel not in KERNELS:
        raise ValueError(f"kernel must be one of {KERNELS}, got {machine.kernel!r}")
    if machine.link not in LINKS:
        raise ValueError(f"link must be one of {LINKS}, got {machine.link!r}")
    check_array("width", machine.width, "positive")
    if machine.vectors.ndim != 2 or machine.weights.ndim != 2 or len(machine.weights) < 2:
        raise ValueError(
            f"vectors must be (R, F) and weights (K > 1, m), got {machine.vectors.shape}, {machine.weights.shape}"
        )
    shape = machine.weights.shape
    if machine.basis.shape != shape or machine.cov_factor.shape != (*shape, shape[1]):
        raise ValueError(
            f"the shapes of a kernel machine do not match: weights {shape}, basis {machine.basis.shape}, cov_factor "
            f"{machine.cov_factor.shape}; they must be (K, m), (K, m) and (K, m, m): train the model again"
        )
    if machine.basis.size and not 0 <= machine.basis.min() <= machine.basis.max() <= len(machine.vectors):
        raise ValueError(
            f"basis must hold 0 (bias) to {len(machine.vectors)} (last relevance vector), got {machine.basis.min()} to "
            f"{machine.basis.max()}: train the model again"
        )
    for name in ("vectors", "weights", "cov_factor"):
        check_array(name, getattr(machine, name))
