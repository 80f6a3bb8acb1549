"""Trained relevance vectors as plain arrays: probabilities in NumPy only, some tens of microseconds a row.

`pdr_filter.classifiers.rvm` trains them and needs scikit-learn; this module does not import it.
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
    """Relevance vector machines, one for each class, that share their relevance vectors.

    Machine k has the logit t_k(x) = sum_m weights[k, m] phi[basis[k, m]](x) (eq. 4 of Martinelli et al. 2018), where
    phi_0(x) = 1 is the bias and phi_r(x) = K(x, vectors[r - 1]). Machines that use fewer than m vectors are filled up
    with weight zero.
    """

    kernel: str  # "rbf": K(x, v) = exp(-||x - v||^2 / (2 width^2)) (eq. 5), or "linear": K(x, v) = x . v
    width: float  # sigma_G of eq. 5, in units of the features; not used by the linear kernel
    vectors: FloatArray  # (R, F) of all machines; R may be zero
    basis: IntArray  # (K, m) basis functions of each machine: 0 the bias, r the vector r - 1
    weights: FloatArray  # (K, m) posterior mean (eq. 10), K at least two
    # (K, m, m) factor G of the weights' posterior covariance G^T G (eq. 10): the variance of the logit is ||G phi||^2.
    # All zeros: no moderation.
    cov_factor: FloatArray
    # From logits to probabilities: `normalised_sigmoids` (each machine knows its class from all others) or, where the
    # logits compete, `moderated_softmax`.
    link: str = "sigmoid"  # files of version 0.1 have none

    def __post_init__(self) -> None:
        self._make_read_only("vectors", "weights", "cov_factor")
        self._make_integers("basis")
        _check(self)

    @property
    def n_features(self) -> int:
        """Number of features, F."""
        return self.vectors.shape[1]

    @property
    def n_classes(self) -> int:
        """Number of classes, K."""
        return len(self.weights)

    def _of_rows(self, rows: FloatArray) -> FloatArray:
        return row_by_row(self._of_row, rows, self.n_classes)

    def _of_row(self, row: FloatArray) -> FloatArray:
        return (normalised_sigmoids if self.link == "sigmoid" else moderated_softmax)(*self._logits(row))

    def _logits(self, features: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and variance (K,) of the logits of a row (F,), without BLAS, whose order depends on the shapes."""
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
    """Class probabilities (K,) from the one-against-all logits and their variances, (K,) each.

    p_k is proportional to sigma(kappa(variance_k) logit_k), with kappa(v) = (1 + pi v / 8)^(-1/2): the sigmoid averaged
    over the uncertainty of the logit (MacKay 1992; Bishop 2006, eq. 4.153 and 4.154).
    """
    moderated = logit / np.sqrt(1.0 + np.pi / 8.0 * variance)
    return softmax(-np.logaddexp(0.0, -moderated))  # in logarithms: far from all classes every sigmoid underflows


def moderated_softmax(logit: FloatArray, variance: FloatArray) -> FloatArray:
    """Class probabilities (K,) from competing logits and their variances, (K,) each.

    p_k is proportional to 1 / sum_j exp(-kappa(variance_k + variance_j) (logit_k - logit_j)), j over all classes, with
    kappa as in `normalised_sigmoids` and 1 for j = k (a mean-field form of Lu, Ie and Sha 2020). With no
    variance it is the softmax, with two classes the moderated sigmoid of the difference.
    """
    kappa = 1.0 / np.sqrt(1.0 + np.pi / 8.0 * (variance[:, None] + variance))
    advantage = kappa * (logit - logit[:, None])  # [k, j]: of j over k
    most = advantage.max(axis=1)  # not negative: a class has no advantage over itself
    return softmax(-most - np.log(np.exp(advantage - most[:, None]).sum(axis=1)))


def _check(machine: RelevanceVectors) -> None:
    """Raise ValueError unless the arrays belong together and are finite."""
    if machine.kernel not in KERNELS:
        raise ValueError(f"kernel must be one of {KERNELS}, got {machine.kernel!r}")
    if machine.link not in LINKS:
        raise ValueError(f"link must be one of {LINKS}, got {machine.link!r}")
    check_array("width", machine.width, "positive")
    if machine.vectors.ndim != 2 or machine.weights.ndim != 2 or len(machine.weights) < 2:
        raise ValueError(f"vectors (R, F), weights (K > 1, m): got {machine.vectors.shape}, {machine.weights.shape}")
    shape = machine.weights.shape
    if machine.basis.shape != shape or machine.cov_factor.shape != (*shape, shape[1]):
        raise ValueError(f"shapes of weights {shape}, basis {machine.basis.shape} and cov_factor disagree")
    if machine.basis.size and not 0 <= machine.basis.min() <= machine.basis.max() <= len(machine.vectors):
        raise ValueError(f"basis must hold 0 (bias) to {len(machine.vectors)} (last relevance vector)")
    for name in ("vectors", "weights", "cov_factor"):
        check_array(name, getattr(machine, name))
