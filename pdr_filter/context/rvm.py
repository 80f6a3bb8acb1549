"""Relevance vector machine: sparse Bayesian classification with probabilities (Tipping 2001).

Training follows section V-C of Martinelli et al. 2018 (eq. 4-11): a Gaussian prior with its own precision alpha_i on
every weight, a Laplace approximation of the weights' posterior, and re-estimation of the alphas until they stand
still. Most alphas grow without bound; their basis functions are dropped, and what stays are the relevance vectors.

Equation 10 is the usual Laplace step (Tipping 2001, eq. 24-26), with B at the mode:
w* = argmax of eq. 9, Delta = (Phi^T B Phi + A)^-1, beta_i = sigma(t_i) (1 - sigma(t_i)).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.spatial.distance import cdist, pdist
from scipy.special import expit
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils import check_random_state
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data
from threadpoolctl import threadpool_limits  # scikit-learn depends on it

from pdr_filter.context.kernel_machine import KERNELS, RelevanceVectors
from pdr_filter.types import FloatArray, IntArray

# Precision of all weights before the first iteration: "a logit of ten or twenty is plausible", basis functions being of
# size one. Of 1, 1e-2 and 1e-4 the middle one ended with the best evidence and log loss on made-up problems: 1 drops
# too much at once with wide kernels (accuracy 0.86 instead of 0.91), 1e-4 starts from saturated sigmoids.
_START_ALPHA = 1e-2

# Lower bound of an alpha: beyond it the prior is flat to double precision and the Hessian may lose its rank.
_MIN_ALPHA = 1e-10

# The mode is found when another Newton step would raise the log posterior by less than this many nats. As long as basis
# functions are dropped, the rough one does: it halves the training time and the next alphas differ by a per cent.
_MODE_TOLERANCE = 1e-9
_ROUGH_MODE_TOLERANCE = 1e-3
_MAX_NEWTON_STEPS = 100

# Candidates from which the kernel width is estimated: the median of half a million distances is as good as any.
_MAX_WIDTH_ROWS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class BinaryMachine:
    """One trained two-class machine; M basis functions are left."""

    basis: IntArray  # (M,) columns of the design matrix that were kept, ascending
    alpha: FloatArray  # (M,) precisions of the weights' prior
    mean: FloatArray  # (M,) posterior mean w* of the weights
    cov_factor: FloatArray  # (M, M) G, the posterior covariance is Delta = G^T G
    n_iter: int
    converged: bool


def design_matrix(X: FloatArray, vectors: FloatArray, kernel: str, width: float) -> FloatArray:
    """Basis functions at the rows, Phi (N, 1 + R): ones for the bias, then K(x, v) of each vector (eq. 5)."""
    gram = np.exp(cdist(X, vectors, "sqeuclidean") / (-2.0 * width**2)) if kernel == "rbf" else X @ vectors.T
    return np.hstack([np.ones((len(X), 1)), gram])


def median_distance(vectors: FloatArray) -> float:
    """Median Euclidean distance between pairs of different vectors (R, F), 1 if there is none."""
    distances = pdist(vectors[:_MAX_WIDTH_ROWS])
    distances = distances[distances > 0]
    return float(np.median(distances)) if len(distances) else 1.0


def log_posterior(weights: FloatArray, design: FloatArray, target: FloatArray, alpha: FloatArray) -> float:
    """Logarithm of p(y | w) p(w | alpha) without constants (eq. 9), targets 0 or 1, in nats."""
    logit = design @ weights
    # y ln sigma(t) + (1 - y) ln(1 - sigma(t)) = y t - ln(1 + e^t), which does not overflow
    return float(np.sum(target * logit - np.logaddexp(0.0, logit)) - 0.5 * np.sum(alpha * weights**2))


def log_posterior_gradient(
    weights: FloatArray, design: FloatArray, target: FloatArray, alpha: FloatArray
) -> FloatArray:
    """Gradient of eq. 9: Phi^T (y - sigma(t)) - A w, (M,)."""
    return design.T @ (target - expit(design @ weights)) - alpha * weights


def posterior_precision(weights: FloatArray, design: FloatArray, alpha: FloatArray) -> FloatArray:
    """Negative Hessian of eq. 9: Phi^T B Phi + A, the inverse of Delta in eq. 10, (M, M)."""
    probability = expit(design @ weights)
    root_beta = np.sqrt(probability * (1.0 - probability))
    scaled = design * root_beta[:, None]
    precision = scaled.T @ scaled
    precision[np.diag_indices_from(precision)] += alpha
    return precision


def posterior_mode(
    design: FloatArray,
    target: FloatArray,
    alpha: FloatArray,
    start: FloatArray,
    tolerance: float = _MODE_TOLERANCE,
) -> tuple[FloatArray, FloatArray]:
    """Most probable weights w* (M,) and G (M, M) with G^T G = Delta, the covariance of eq. 10.

    Newton's method from `start`. Eq. 9 is concave, so halving the step until it gains leads to the only maximum.
    """
    weights = start
    value = log_posterior(weights, design, target, alpha)
    for _ in range(_MAX_NEWTON_STEPS):
        gradient = log_posterior_gradient(weights, design, target, alpha)
        factor, scale = _scaled_cholesky(posterior_precision(weights, design, alpha))
        step = scale * cho_solve((factor, True), scale * gradient)
        gain = float(gradient @ step)  # twice what the quadratic model promises
        if gain < 2.0 * tolerance:
            break
        size = 1.0
        while size > 1e-10:
            proposal = weights + size * step
            proposed_value = log_posterior(proposal, design, target, alpha)
            if proposed_value >= value + 1e-4 * size * gain:
                break
            size *= 0.5
        else:
            break  # no gain left above rounding: this is the mode
        weights, value = proposal, proposed_value
    else:
        factor, scale = _scaled_cholesky(posterior_precision(weights, design, alpha))
    return weights, solve_triangular(factor, np.diag(scale), lower=True)


def _scaled_cholesky(precision: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lower triangle L and scale s with s_i H_ij s_j = (L L^T)_ij, for a precision matrix H.

    The scaling gives H a unit diagonal, for alphas differ by many orders. Nearly equal columns can still take its
    rank to rounding; then Levenberg's damping is raised until the matrix is positive definite.
    """
    scale = 1.0 / np.sqrt(np.diag(precision))
    scaled = precision * scale[:, None] * scale
    damping = 0.0
    while True:
        try:
            return cholesky(scaled + damping * np.eye(len(scaled)), lower=True), scale
        except np.linalg.LinAlgError:
            damping = max(10.0 * damping, 1e-14)


def well_determined(alpha: FloatArray, variance: FloatArray) -> FloatArray:
    """How far the data determine each weight, (M,): gamma_i = 1 - alpha_i Delta_ii, 0 not at all, 1 alone (eq. 11)."""
    return np.maximum(1.0 - alpha * variance, np.finfo(float).eps)


def reestimate(alpha: FloatArray, mean: FloatArray, variance: FloatArray) -> FloatArray:
    """Precisions of higher evidence, alpha_i = gamma_i / mu_i^2 (eq. 11), (M,); infinite where the mean is zero."""
    with np.errstate(divide="ignore", over="ignore"):
        return np.maximum(well_determined(alpha, variance) / mean**2, _MIN_ALPHA)


def train_binary(
    design: FloatArray, target: FloatArray, prune_alpha: float = 1e4, max_iter: int = 500, tol: float = 1e-3
) -> BinaryMachine:
    """Train one machine on Phi (N, M) and targets 0 or 1 (N,): eq. 10 and 11 in turn.

    Basis functions whose alpha passes `prune_alpha` are dropped for good. Converged when none was dropped and
    |gamma_i - alpha_i mu_i^2| < tol for all i: half of that is the slope of the log evidence in ln alpha_i. A bound on
    the change of alpha itself would wait hundreds of iterations for weights that vanish slowly and no longer matter.
    """
    basis = np.arange(design.shape[1])
    alpha = np.full(len(basis), _START_ALPHA)
    tolerance = _ROUGH_MODE_TOLERANCE
    mean, factor = posterior_mode(design, target, alpha, np.zeros(len(basis)), tolerance)
    for n_iter in range(1, max_iter + 1):
        variance = np.sum(factor**2, axis=0)  # diagonal of Delta
        proposed = reestimate(alpha, mean, variance)
        keep = proposed < prune_alpha
        slope = well_determined(alpha, variance) - alpha * mean**2
        if keep.all() and tolerance == _MODE_TOLERANCE and (np.abs(slope) < tol).all():
            return BinaryMachine(basis, alpha, mean, factor, n_iter, True)
        tolerance = _MODE_TOLERANCE
        if not keep.all():
            tolerance = _ROUGH_MODE_TOLERANCE
            basis, design = basis[keep], design[:, keep]
        alpha, mean = proposed[keep], mean[keep]
        if not len(basis):  # the data say nothing, and every logit is zero
            return BinaryMachine(basis, alpha, mean, np.zeros((0, 0)), n_iter, True)
        mean, factor = posterior_mode(design, target, alpha, mean, tolerance)
    return BinaryMachine(basis, alpha, mean, factor, max_iter, False)


def mirrored(machine: BinaryMachine) -> BinaryMachine:
    """Return the machine for the other of two classes: the opposite logit with the same covariance."""
    return replace(machine, mean=-machine.mean)


def assemble(machines: Sequence[BinaryMachine], vectors: FloatArray, kernel: str, width: float) -> RelevanceVectors:
    """Machines (K), trained on the bias and `vectors` (R, F), as arrays; vectors that none uses are left out."""
    used = np.unique(np.concatenate([[0], *(machine.basis for machine in machines)]))  # the bias is always there
    size = max(len(machine.basis) for machine in machines)
    basis = np.zeros((len(machines), size), dtype=np.int64)
    weights = np.zeros((len(machines), size))
    cov_factor = np.zeros((len(machines), size, size))
    for k, machine in enumerate(machines):
        m = len(machine.basis)
        basis[k, :m] = np.searchsorted(used, machine.basis)
        weights[k, :m] = machine.mean
        cov_factor[k, :m, :m] = machine.cov_factor
    return RelevanceVectors(kernel, width, vectors[used[1:] - 1], basis, weights, cov_factor)


def stratified_rows(labels: IntArray, n_rows: int, random: np.random.RandomState) -> IntArray:
    """Choose about `n_rows` rows (ascending indices), each class in proportion but at least once."""
    if n_rows >= len(labels):
        return np.arange(len(labels))
    chosen: list[IntArray] = []
    for label in np.unique(labels):
        rows = np.flatnonzero(labels == label)
        n_chosen = max(1, round(n_rows * len(rows) / len(labels)))
        chosen.append(random.permutation(rows)[:n_chosen])
    return np.sort(np.concatenate(chosen))


class RelevanceVectorClassifier(ClassifierMixin, BaseEstimator):
    """Sparse kernel classifier with probabilities, one machine against the rest for each class.

    Scale the features before (for instance to unit variance): the kernel takes their distances as they are.

    Parameters
    ----------
    kernel : str
        "rbf": one candidate basis function exp(-||x - x_i||^2 / (2 kernel_width^2)) for each training row (eq. 5).
        "linear": one candidate for each feature, x_j over its root mean square, so that relevance selects features.
        (Inner products with the training rows span the same functions with more candidates than dimensions.)
    kernel_width : float, optional
        sigma_G of eq. 5 in units of the features. None: the median distance between candidate rows. That is a start;
        half of it is often better in many dimensions. Choose by cross-validated log loss, not by evidence.
    max_samples : int, optional
        At most about this many training rows, drawn class by class in proportion, become candidates for relevance
        vectors; all rows always count in the likelihood. Time grows with N max_samples^2. None: every row is one.
    moderate : bool
        Average each sigmoid over the uncertainty of its logit (Bishop 2006, eq. 4.153). It lowers the log loss most
        for narrow kernels.
    prune_alpha : float
        Basis functions whose alpha passes this are dropped (weights of standard deviation below 0.01).
    max_iter : int
        Re-estimations of alpha for each class; a ConvergenceWarning says when they were too few.
    tol : float
        Stop when every |gamma_i - alpha_i w_i^2| is below this (zero at a maximum of the evidence).
    random_state : int, RandomState or None
        Draws the candidates if there are more than `max_samples` rows. Nothing else is random.

    Attributes
    ----------
    classes_ : (K,)
        Class labels, sorted; columns of `predict_proba`.
    relevance_vectors_ : (R, F)
        Vectors that any of the machines kept.
    kernel_width_ : float
        The width that was used.
    n_iter_ : int
        Iterations of the class that needed most.
    machine_ : RelevanceVectors
        All that prediction needs, as plain arrays; store this.
    n_features_in_ : int
        Features of a row, F.
    """

    def __init__(
        self,
        *,
        kernel: str = "rbf",
        kernel_width: float | None = None,
        max_samples: int | None = 1000,
        moderate: bool = True,
        prune_alpha: float = 1e4,
        max_iter: int = 500,
        tol: float = 1e-3,
        random_state: int | np.random.RandomState | None = 0,
    ) -> None:
        self.kernel = kernel
        self.kernel_width = kernel_width
        self.max_samples = max_samples
        self.moderate = moderate
        self.prune_alpha = prune_alpha
        self.max_iter = max_iter
        self.tol = tol
        self.random_state = random_state

    def fit(self, X: ArrayLike, y: ArrayLike) -> RelevanceVectorClassifier:
        """Train on rows X (N, F) and labels y (N,), and return the classifier itself."""
        checked: Any = validate_data(self, cast(Any, X), cast(Any, y), dtype=np.float64)
        rows: FloatArray = checked[0]
        check_classification_targets(checked[1])
        self.classes_, label = np.unique(checked[1], return_inverse=True)
        if len(self.classes_) < 2:
            raise ValueError(f"only one class in y ({self.classes_[0]!r}): a classifier needs at least two classes")
        candidates = self._candidates(rows, label)
        design = design_matrix(rows, candidates, self.kernel, self.kernel_width_)
        # With two classes the machine of the second is the machine of the first with the opposite sign.
        trained = [1] if len(self.classes_) == 2 else range(len(self.classes_))
        # One thread: on a busy computer BLAS threads wait for each other, and training took eight times as long.
        with threadpool_limits(limits=1, user_api="blas"):
            machines = [
                train_binary(design, (label == k).astype(np.float64), self.prune_alpha, self.max_iter, self.tol)
                for k in trained
            ]
        slow = [self.classes_[k] for k, machine in zip(trained, machines, strict=True) if not machine.converged]
        if slow:
            warnings.warn(
                f"alpha still changes for classes {slow} after {self.max_iter} iterations: raise max_iter or tol",
                ConvergenceWarning,
                stacklevel=2,
            )
        self.n_iter_ = max(machine.n_iter for machine in machines)
        if len(machines) == 1:
            machines = [mirrored(machines[0]), machines[0]]
        if not self.moderate:
            machines = [replace(machine, cov_factor=np.zeros_like(machine.cov_factor)) for machine in machines]
        self.machine_ = assemble(machines, candidates, self.kernel, self.kernel_width_)
        self.relevance_vectors_ = self.machine_.vectors
        return self

    def _candidates(self, rows: FloatArray, label: IntArray) -> FloatArray:
        """Candidates for relevance vectors, (R, F), and set `kernel_width_`."""
        if self.kernel not in KERNELS:
            raise ValueError(f"kernel must be one of {KERNELS}, got {self.kernel!r}")
        if self.kernel == "linear":
            self.kernel_width_ = 1.0
            size = np.sqrt(np.mean(rows**2, axis=0))
            return np.diag(1.0 / np.where(size > 0, size, 1.0))
        if self.max_samples is not None and self.max_samples < 1:
            raise ValueError(f"max_samples must be at least 1 or None, got {self.max_samples}")
        n_rows = len(rows) if self.max_samples is None else self.max_samples
        candidates = rows[stratified_rows(label, n_rows, check_random_state(self.random_state))]
        self.kernel_width_ = median_distance(candidates) if self.kernel_width is None else float(self.kernel_width)
        if not self.kernel_width_ > 0:
            raise ValueError(f"kernel_width must be positive, in units of the features, got {self.kernel_width}")
        return candidates

    def predict_proba(self, X: ArrayLike) -> FloatArray:
        """Class probabilities of rows, (N, F) to (N, K): the sigmoids of all machines divided by their sum."""
        check_is_fitted(self)
        rows: Any = validate_data(self, cast(Any, X), dtype=np.float64, reset=False)
        return self.machine_.predict_proba(rows)

    def predict(self, X: ArrayLike) -> NDArray[Any]:
        """Most probable class of each row, (N, F) to (N,)."""
        best = self.predict_proba(X).argmax(axis=1)
        return self.classes_[best]
