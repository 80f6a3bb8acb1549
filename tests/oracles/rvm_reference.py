"""Relevance vector machine of two classes as the paper writes it: plain, and slow for many candidates.

Training follows section V-C of Martinelli et al. 2018 (eq. 4-11): a Gaussian prior with its own precision alpha_i on
every weight, a Laplace approximation of the weights' posterior, and re-estimation of the alphas until they stand
still. Most alphas grow without bound; their basis functions are dropped, and what stays are the relevance vectors.

Equation 10 is the usual Laplace step (Tipping 2001, eq. 24-26), with B at the mode:
w* = argmax of eq. 9, Delta = (Phi^T B Phi + A)^-1, beta_i = sigma(t_i) (1 - sigma(t_i)).

`pdr_filter.classifiers.rvm_training` reaches about the same evidence in a fraction of the time and is what
`RelevanceVectorClassifier` uses. Read this to understand it; the tests use it to check it. The two share no code.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.special import expit

from pdr_filter.values import FloatArray, IntArray

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


@dataclass(frozen=True, slots=True, eq=False)
class BinaryMachine:
    """One trained two-class machine; M basis functions are left."""

    basis: IntArray  # (M,) columns of the design matrix that were kept, ascending
    alpha: FloatArray  # (M,) precisions of the weights' prior
    mean: FloatArray  # (M,) posterior mean w* of the weights
    cov_factor: FloatArray  # (M, M) G, the posterior covariance is Delta = G^T G
    n_iter: int
    converged: bool


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
    design: FloatArray, target: FloatArray, alpha: FloatArray, start: FloatArray, tolerance: float = _MODE_TOLERANCE
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


def train_plain(
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


def log_evidence(machine: BinaryMachine, design: FloatArray, target: FloatArray) -> float:
    """Laplace's log p(y | alpha) in nats: maximum of eq. 9 + ln |A| / 2 + ln |Delta| / 2 (Tipping 2001, eq. 26)."""
    log_det_root = float(np.linalg.slogdet(machine.cov_factor)[1])
    value = log_posterior(machine.mean, design[:, machine.basis], target, machine.alpha)
    return value + 0.5 * float(np.sum(np.log(machine.alpha))) + log_det_root
