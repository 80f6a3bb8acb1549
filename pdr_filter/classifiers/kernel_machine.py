"""Trained relevance vector machines as plain arrays: prediction in NumPy only, in some tens of microseconds per row.

`pdr_filter.classifiers.rvm` trains them and needs scikit-learn. This module does not import it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.classifiers.base_classifier import Machine, row_by_row
from pdr_filter.values import FloatArray, IntArray, check_array, softmax

KERNELS = ("rbf", "linear")
LINKS = ("sigmoid", "softmax")


@dataclass(frozen=True, slots=True, eq=False)
class RelevanceVectors(Machine):
    """Relevance vector machines, one for each class, with common relevance vectors.

    Machine k has the logit t_k(x) = sum_j weights[k, j] phi[basis[k, j]](x) (eq. 4 of Martinelli et al. 2018), where
    phi_0(x) = 1 is the bias and phi_r(x) = K(x, vectors[r - 1]). The largest machine has m basis functions. Smaller
    machines are padded with weights of zero.

    Attributes
    ----------
    kernel : {"rbf", "linear"}
        "rbf": K(x, v) = exp(-||x - v||^2 / (2 width^2)) (eq. 5 of Martinelli et al. 2018). "linear": K(x, v) = x . v.
    width : float
        sigma_G of eq. 5 of Martinelli et al. 2018, in units of the features. Unused by the linear kernel.
    vectors : ndarray, shape (R, F)
        Relevance vectors of all machines. R may be zero.
    basis : ndarray of int, shape (K, m)
        Basis functions of each machine: 0 is the bias, r is the vector r - 1.
    weights : ndarray, shape (K, m)
        Posterior means of the weights (eq. 10 of Martinelli et al. 2018), for two or more classes.
    cov_factor : ndarray, shape (K, m, m)
        Factor G of the posterior covariance G^T G of the weights (eq. 10 of Martinelli et al. 2018). The variance of
        the logit is ||G phi||^2. This variance moderates the probabilities: they are nearer to each other if the logits
        are uncertain. If G is zero, probabilities are not moderated.
    link : {"sigmoid", "softmax"}
        Conversion of logits to probabilities: `normalised_sigmoids` for one-against-all machines, or
        `moderated_softmax` for competing logits.
    """

    kernel: str
    width: float
    vectors: FloatArray
    basis: IntArray
    weights: FloatArray
    cov_factor: FloatArray
    link: str = "sigmoid"  # the default is for files of version 0.1, which have no link

    def __post_init__(self) -> None:
        self._make_read_only("vectors", "weights", "cov_factor")
        self._make_integers("basis")
        _check(self)

    @property
    def n_features(self) -> int:
        """Number F of features."""
        return self.vectors.shape[1]

    @property
    def n_classes(self) -> int:
        """Number K of classes."""
        return len(self.weights)

    def _predict(self, rows: FloatArray) -> FloatArray:
        return row_by_row(self._predict_row, rows, self.n_classes)

    def _predict_row(self, row: FloatArray) -> FloatArray:
        return (normalised_sigmoids if self.link == "sigmoid" else moderated_softmax)(*self._logits(row))

    def _logits(self, features: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and variance (K,) of the logits of a row (F,).

        BLAS is not used, because its order of summation depends on the shapes.
        """
        phi = np.ones(len(self.vectors) + 1)
        if self.kernel == "rbf":
            difference = self.vectors - features
            phi[1:] = np.exp(np.einsum("rf,rf->r", difference, difference) / (-2.0 * self.width**2))
        else:
            phi[1:] = np.einsum("rf,f->r", self.vectors, features)
        own = phi.take(self.basis)  # (K, m)
        projected = np.einsum("kij,kj->ki", self.cov_factor, own)  # G phi
        return np.einsum("km,km->k", self.weights, own), np.einsum("km,km->k", projected, projected)


def normalised_sigmoids(logit: FloatArray, variance: FloatArray) -> FloatArray:
    """Return class probabilities (K,) from one-against-all logits and their variances, (K,) each.

    p_k is proportional to sigma(kappa(variance_k) logit_k), with kappa(v) = (1 + pi v / 8)^(-1/2). This is the sigmoid
    sigma averaged over the uncertainty of the logit (MacKay 1992; Bishop 2006, eq. 4.153 and 4.154).
    """
    moderated = logit / np.sqrt(1.0 + np.pi / 8.0 * variance)
    return softmax(-np.logaddexp(0.0, -moderated))  # in logarithms, because all sigmoids underflow far from all classes


def moderated_softmax(logit: FloatArray, variance: FloatArray) -> FloatArray:
    """Return class probabilities (K,) from competing logits and their variances, (K,) each.

    The probability p_k of class k is proportional to 1 / sum_j exp(-kappa(variance_k + variance_j) (logit_k -
    logit_j)), with kappa(v) = (1 + pi v / 8)^(-1/2). The sum is over all classes j, and its term for j = k is 1 (a
    mean-field form of Lu, Ie and Sha 2020). Without variance p is the softmax. For two classes it is the moderated
    sigmoid of the difference.
    """
    kappa = 1.0 / np.sqrt(1.0 + np.pi / 8.0 * (variance[:, None] + variance))
    advantage = kappa * (logit - logit[:, None])  # [k, j]: of j over k
    most = advantage.max(axis=1)  # not negative, because the advantage of a class over itself is 0
    return softmax(-most - np.log(np.exp(advantage - most[:, None]).sum(axis=1)))


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
