"""Fast sparse Bayesian learning: maximisation of the marginal likelihood with many basis functions per pass.

With all other weights fixed, the log evidence depends on the precision alpha_m of the prior of a weight through the
sparsity s_m and the quality q_m of its basis function (Faul and Tipping 2002; Tipping and Faul 2003, "Fast Marginal
Likelihood Maximisation for Sparse Bayesian Models", AISTATS). Its maximum is at alpha_m = s_m^2 / (q_m^2 - s_m) if
q_m^2 > s_m. Otherwise it is at infinity, and the function is deleted.

The posterior is the Laplace approximation for any log-concave likelihood. docs/methods/rvm.md has the equations. The
classifiers are in `classifiers.rvm`.

Deviations from Tipping and Faul:

- The training starts with `max_basis` functions spread over the candidates, not with one function. From the bias alone,
  wide kernels end 10 to 30 nats lower in each class.
- One pass re-estimates all alphas, adds up to 20 functions and deletes at most a fifth, instead of one such action. The
  training takes 15 to 40 passes instead of hundreds.
- Functions are added in turn from the best 60, with S and Q of the others updated after each, so that only one of two
  similar functions is added.
- Many changes at once can lower the evidence. The pass is then undone and repeated with half of the changes.
- Newton's method for the mode has Levenberg's damping and takes the best of three starts, because of saturated
  sigmoids.
- The training ends when two passes in a row each gain less than half of `tol`, and not when ln alpha stands still. The
  last tenth of a nat takes most of the passes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.special import expit

from pdr_filter.values import BoolArray, FloatArray, IntArray

# Maximum number of functions added in one pass. They are chosen from the best `_SHORTLIST` with their mutual
# covariances, so that only one of two similar functions is added. Of more than 20, most are deleted again.
_MAX_ADDED = 20
_SHORTLIST = 60
# Maximum share of functions deleted in one pass. With wide kernels, many functions are redundant one by one, but not
# all of them together.
_MAX_DELETED_SHARE = 0.2
_START_ALPHA = 1e-2  # prior precision of the weights before the first pass, for logits of about ten
# Lower bound of an alpha. Below it the prior is flat in double precision, and the Hessian may be singular.
_MIN_ALPHA = 1e-10
# Minimum evidence gain of a function, in nats. Functions with less are deleted, because they only cost time.
_MIN_EVIDENCE_GAIN = 1e-3
# If the unexplained parts of two functions have a higher correlation, a pass adds only one of them.
_MAX_CORRELATION = 0.99
# A candidate with a smaller unexplained share is, up to rounding, a combination of the functions in the model.
_MIN_UNEXPLAINED = 1e-6
# The search for the mode ends when a Newton step would raise the log posterior by less than this, in nats.
_MODE_TOLERANCE = 1e-8
_MAX_NEWTON_STEPS = 100
# Minimum step size of a pass. The step size multiplies the steps in ln alpha, and the numbers of additions and
# deletions.
_MIN_STEP_SIZE = 0.1
_BLOCK = 64  # functions whose s and q are computed together, so that a block and its square fit into the cache


class Likelihood(Protocol):
    """Log-concave likelihood of the targets as a function of the logits t (N,), independent for each row."""

    def log_likelihood(self, logit: FloatArray) -> float:
        """Return the log-likelihood ln p(y | t) of the targets y given the logits t, in nats."""
        ...

    def slope(self, logit: FloatArray) -> FloatArray:
        """Return the derivatives (N,) of the log-likelihood with respect to the logits."""
        ...

    def curvature(self, logit: FloatArray) -> FloatArray:
        """Return minus the second derivatives (N,) of the log-likelihood with respect to the logits (not negative)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Bernoulli:
    """Likelihood of targets y_n, 0 or 1, with p(y_n = 1) = sigma(t_n + offset_n) and row weights weight_n.

    t_n is the logit of row n, and sigma the logistic function.
    """

    target: FloatArray  # (N,)
    weight: FloatArray  # (N,) positive
    offset: FloatArray  # (N,) nats

    def log_likelihood(self, logit: FloatArray) -> float:
        """Return the log-likelihood in nats (eq. 8 of Martinelli et al. 2018)."""
        t = logit + self.offset
        # y ln sigma(t) + (1 - y) ln(1 - sigma(t)) = y t - ln(1 + e^t), where the right side does not overflow.
        return float(self.weight @ (self.target * t - np.logaddexp(0.0, t)))

    def slope(self, logit: FloatArray) -> FloatArray:
        """Return the weighted residuals y - sigma(t), (N,), of targets y and logits t (offset included)."""
        return self.weight * (self.target - expit(logit + self.offset))

    def curvature(self, logit: FloatArray) -> FloatArray:
        """Return the weighted sigma(t) (1 - sigma(t)), (N,), of logits t (offset included)."""
        probability = expit(logit + self.offset)
        return self.weight * probability * (1.0 - probability)


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """Gaussian (Laplace) posterior of the weights of M basis functions, given the precisions alpha of their prior.

    The evidence is the probability of the training labels given the alphas, with the weights integrated out.
    """

    basis: IntArray  # (M,) rows of the matrix of candidate functions, ascending
    alpha: FloatArray  # (M,) precisions of the zero-mean Gaussian prior of the weights
    mean: FloatArray  # (M,) most probable weights
    cov_factor: FloatArray  # (M, M) G, the covariance is G^T G
    logit: FloatArray  # (N,) logits of the training rows, for the mean weights, without the offset of the likelihood
    log_evidence: float  # log evidence of the alphas, nats

    @property
    def variance(self) -> FloatArray:
        """Diagonal of the covariance, (M,)."""
        return np.sum(self.cov_factor**2, axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class Trained:
    """Result of a training: posterior, number of passes, and history of the log evidence."""

    posterior: Posterior
    n_passes: int
    log_evidence: tuple[float, ...] = field(repr=False)  # before the first and after every pass; it never decreases
    out_of_passes: bool  # stopped by the limit of passes
    out_of_basis: bool  # stopped by the limit of functions, though more would raise the evidence


class Additions(NamedTuple):
    """Basis functions to add in a pass, with their alphas (prior precisions) and their common gain of log evidence."""

    functions: IntArray  # (P,) in descending order of their evidence gain
    alpha: FloatArray  # (P,)
    gain: float  # expected evidence gain of all of them, nats


class Proposal(NamedTuple):
    """Changes proposed for a pass: new alphas (prior precisions), functions to delete, and functions to add."""

    alpha: FloatArray  # (M,)
    delete: BoolArray  # (M,)
    added: Additions
    has_postponed_deletions: bool  # more deletions are due than one pass may do


class _Pass(NamedTuple):
    """Result of a pass, whose proposal was tried with smaller and smaller steps until the evidence rose."""

    posterior: Posterior | None  # None if no try raised the evidence
    step_size: float
    n_tries: int


def spread_start(likelihood: Likelihood, functions: FloatArray, n_functions: int) -> Posterior:
    """Return the posterior of the model with which the training starts.

    The model has up to `n_functions` basis functions. These are the rows of `functions` (R, N) at equal intervals of
    the row index, including the bias in row 0.
    """
    n = max(1, min(n_functions, len(functions)))
    basis = np.unique(np.linspace(0, len(functions) - 1, n).astype(np.int64))
    alpha = np.full(len(basis), _START_ALPHA)
    return posterior(likelihood, functions, basis, alpha, np.zeros(len(basis)), np.zeros(functions.shape[1]))


def train_rvm(
    likelihood: Likelihood,
    functions: FloatArray,
    start: Posterior | None = None,
    *,
    max_basis: int = 100,
    max_passes: int = 100,
    tol: float = 1.0,
) -> Trained:
    """Return the alphas with (locally) maximal evidence, and the posterior of the weights.

    An alpha is the precision of the Gaussian prior of a weight. `functions` (R, N) are the candidates at the N rows,
    with the bias (ones) first. One function is one row, so that blocks of functions are contiguous. `start` is the
    posterior of an earlier training, possibly with another likelihood. The default is `spread_start`. Training stops
    when two consecutive passes each raise the log evidence by less than `tol` / 2.
    """
    if start is None:
        now = spread_start(likelihood, functions, max_basis)
    else:
        now = posterior(likelihood, functions, start.basis, start.alpha, start.mean, start.logit)
    evidence = [now.log_evidence]
    step_size, n_passes, n_small_gains = 1.0, 0, 0
    while n_passes < max_passes:
        proposal = propose(likelihood, functions, now)
        done = _raise_evidence(likelihood, functions, now, proposal, step_size, max_basis, max_passes - n_passes)
        n_passes += done.n_tries
        is_full = proposal.added.gain >= tol and len(now.basis) >= max_basis and not proposal.delete.any()
        if done.posterior is None:  # steps became too small, or the tries ran out
            return Trained(now, n_passes, tuple(evidence), done.step_size >= _MIN_STEP_SIZE, is_full)
        is_small = done.posterior.log_evidence - now.log_evidence < 0.5 * tol and not proposal.has_postponed_deletions
        n_small_gains = n_small_gains + 1 if is_small else 0
        now = done.posterior
        evidence.append(now.log_evidence)
        if n_small_gains == 2:
            return Trained(now, n_passes, tuple(evidence), False, is_full)
        step_size = min(1.0, 2.0 * done.step_size)
    return Trained(now, n_passes, tuple(evidence), True, len(now.basis) >= max_basis)


def _raise_evidence(
    likelihood: Likelihood,
    functions: FloatArray,
    now: Posterior,
    proposal: Proposal,
    step_size: float,
    max_basis: int,
    max_tries: int,
) -> _Pass:
    """Return the first posterior with a higher evidence, the step size and the number of tries.

    Each try that does not raise the evidence halves the step size. The posterior is None if the step size becomes too
    small, or after `max_tries` tries.
    """
    for n_tries in range(1, max_tries + 1):
        changed = apply(likelihood, functions, now, proposal, step_size, max_basis - len(now.basis))
        if changed.log_evidence > now.log_evidence:
            return _Pass(changed, step_size, n_tries)
        step_size *= 0.5
        if step_size < _MIN_STEP_SIZE:
            return _Pass(None, step_size, n_tries)
    return _Pass(None, step_size, max_tries)


def propose(likelihood: Likelihood, functions: FloatArray, now: Posterior) -> Proposal:
    """Return the proposed changes: new alphas, deletions and additions.

    Each new alpha is optimal if nothing else changes. Functions with little evidence gain are deleted, at most a share
    of them in each pass. Each addition takes account of the additions before it.
    """
    s, q = inside_factors(now)
    relevance = q**2 - s
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        alpha = np.where(relevance > 0, s**2 / relevance, np.inf)
    delete = (relevance <= 0) | (evidence_gain(s, q) < _MIN_EVIDENCE_GAIN)
    # A function whose deletion is postponed keeps its alpha.
    alpha = np.clip(np.where(delete, now.alpha, alpha), _MIN_ALPHA, None)
    allowed = max(1, int(_MAX_DELETED_SHARE * len(now.basis)))
    has_postponed_deletions = bool(delete.sum() > allowed)
    if has_postponed_deletions:
        order = np.argsort(np.where(delete, relevance / s, np.inf), kind="stable")
        delete = np.isin(np.arange(len(delete)), order[:allowed])
    # Functions are also added while deletions are postponed, because the new ones replace some of the old ones. The
    # result is much better than with deletions first.
    return Proposal(alpha, delete, additions(likelihood, functions, now), has_postponed_deletions)


def apply(
    likelihood: Likelihood, functions: FloatArray, now: Posterior, proposal: Proposal, step_size: float, room: int
) -> Posterior:
    """Return the posterior after a share (the step size, 0 to 1) of the proposed changes.

    The number of functions grows by at most `room`.
    """
    alpha = now.alpha * (proposal.alpha / now.alpha) ** step_size
    deleted = np.flatnonzero(proposal.delete)
    deleted = deleted[: int(np.ceil(step_size * len(deleted)))]
    keep = np.isin(np.arange(len(alpha)), deleted, invert=True)
    added = proposal.added
    n_added = min(int(np.ceil(step_size * len(added.functions))), room + len(deleted))
    basis = np.concatenate([now.basis[keep], added.functions[:n_added]])
    order = np.argsort(basis)
    alpha = np.concatenate([alpha[keep], added.alpha[:n_added]])[order]
    mean = np.concatenate([now.mean[keep], np.zeros(n_added)])[order]
    return posterior(likelihood, functions, basis[order], alpha, mean, now.logit)


def inside_factors(now: Posterior) -> tuple[FloatArray, FloatArray]:
    """Return the sparsity s and quality q, (M,) each, of the M basis functions in the model.

    With alpha_m the precision of the prior of weight w_m, and Delta the posterior covariance of the weights, they
    follow from 1 / Delta_mm = alpha_m + s_m and w_m = q_m Delta_mm.
    """
    variance = now.variance
    s = np.maximum(1.0 / variance - now.alpha, np.finfo(float).eps / variance)
    return s, now.mean / variance


def evidence_gain(s: FloatArray, q: FloatArray) -> FloatArray:
    """Return the evidence gain of functions at their best alphas, in nats.

    ((q^2 - s) / s + ln(s / q^2)) / 2 where q^2 > s, else zero.
    """
    ratio = np.maximum(q**2 / s, 1.0)
    return 0.5 * (ratio - 1.0 - np.log(ratio))


def outside_factors(likelihood: Likelihood, functions: FloatArray, now: Posterior) -> tuple[FloatArray, FloatArray]:
    """Return the sparsity S and quality Q, (R,) each, of all R candidate basis functions.

    For a function that is not in the model, S and Q equal the s and q that `inside_factors` would give after its
    addition. The formulas are Q = phi^T g and S = phi^T B phi - ||G Phi^T B phi||^2. Here phi is the candidate at all
    rows and Phi are the functions of the model. g is the gradient and B the diagonal matrix of curvatures of the
    log-likelihood. G^T G is the posterior covariance of the weights.

    S is set to infinity for functions in the model and for linear combinations of these functions, so that neither is
    added. Q has no meaning where S is infinite. The matrix product in S takes most of the training time. The product is
    computed in single precision, because S only selects the candidates that `additions` examines exactly.
    """
    beta, slope = likelihood.curvature(now.logit), likelihood.slope(now.logit)
    projection = ((functions[now.basis] * beta).T @ now.cov_factor.T).astype(np.float32)  # (N, M)
    size, explained = np.empty(len(functions)), np.empty(len(functions))
    for i in range(0, len(functions), _BLOCK):
        block = functions[i : i + _BLOCK]
        size[i : i + _BLOCK] = block**2 @ beta
        explained[i : i + _BLOCK] = np.sum((block.astype(np.float32) @ projection) ** 2, axis=1)
    sparsity = size - explained
    sparsity[sparsity <= _MIN_UNEXPLAINED * size] = np.inf  # a combination of functions in the model
    sparsity[now.basis] = np.inf
    return sparsity, functions @ slope


def additions(likelihood: Likelihood, functions: FloatArray, now: Posterior) -> Additions:
    """Return the functions to add, chosen one by one.

    The shortlist are the candidates with the largest evidence gains, if each were added alone. The best function of the
    shortlist is added, S and Q of the others are updated for its presence, and so on.
    """
    sparsity, quality = outside_factors(likelihood, functions, now)
    value = evidence_gain(sparsity, quality)
    short = np.argsort(-value, kind="stable")[:_SHORTLIST]
    short = short[value[short] > _MIN_EVIDENCE_GAIN]
    weighted = functions[short] * likelihood.curvature(now.logit)
    explained = weighted @ functions[now.basis].T @ now.cov_factor.T
    size = weighted @ functions[short].T
    mutual = size - explained @ explained.T  # (P, P), S on its diagonal
    scale = np.sqrt(np.diag(mutual).clip(min=np.finfo(float).tiny))
    alike = np.abs(mutual) > _MAX_CORRELATION * scale[:, None] * scale
    quality, least = quality[short], _MIN_UNEXPLAINED * np.diag(size)
    chosen: list[int] = []
    alphas: list[float] = []
    gain = 0.0
    for _ in range(min(_MAX_ADDED, len(short))):
        s = np.where(np.diag(mutual) > least, np.diag(mutual), np.inf)
        s[alike[chosen].any(axis=0)] = np.inf  # includes the chosen functions, which correlate with themselves
        value = evidence_gain(s, quality)
        best = int(np.argmax(value))
        if value[best] <= _MIN_EVIDENCE_GAIN:
            break
        alpha = max(float(s[best] ** 2 / (quality[best] ** 2 - s[best])), _MIN_ALPHA)
        chosen.append(best)
        alphas.append(alpha)
        gain += float(value[best])
        change = mutual[:, best] / (alpha + mutual[best, best])
        quality = quality - change * quality[best]
        mutual = mutual - np.outer(change, mutual[best])
    return Additions(short[chosen], np.array(alphas), gain)


def posterior(
    likelihood: Likelihood,
    functions: FloatArray,
    basis: IntArray,
    alpha: FloatArray,
    start: FloatArray,
    start_logit: FloatArray,
) -> Posterior:
    """Return the Laplace posterior for given alphas, from Newton's method with Levenberg damping.

    The search starts at the best of three points: one step of reweighted least squares from `start_logit` (N,), the
    weights `start` (M,), and the bias alone. The last avoids slow convergence when sigmoids are saturated. All three
    lead to the same mode.
    """
    phi = functions[basis]
    if not len(basis):
        return _empty(likelihood, functions)

    def objective(weights: FloatArray) -> float:
        return likelihood.log_likelihood(weights @ phi) - 0.5 * float(np.sum(alpha * weights**2))

    starts = [_reweighted(likelihood, phi, alpha, start_logit), start, np.where(basis == 0, start, 0.0)]
    values = [objective(weights) for weights in starts]
    weights, value = starts[int(np.argmax(values))], max(values)
    logit, damping = weights @ phi, 0.0
    precision = _precision(phi, likelihood.curvature(logit), alpha)
    for _ in range(_MAX_NEWTON_STEPS):
        gradient = phi @ likelihood.slope(logit) - alpha * weights
        step, gain = _levenberg_step(precision, gradient, damping)
        proposed = objective(weights + step)
        while gain >= _MODE_TOLERANCE and proposed < value + 0.1 * gain and damping < 1e8:
            damping = max(10.0 * damping, 1e-2)
            step, gain = _levenberg_step(precision, gradient, damping)
            proposed = objective(weights + step)
        if gain < _MODE_TOLERANCE or proposed <= value:
            break  # no gain above rounding: this is the mode
        weights, value = weights + step, proposed
        logit = weights @ phi
        precision = _precision(phi, likelihood.curvature(logit), alpha)
        damping = 0.1 * damping if damping > 1e-3 else 0.0
    factor, scale = _scaled_cholesky(precision)
    # ln p(y) = ln p(y | w*) p(w* | alpha) + (M / 2) ln 2 pi + ln |Delta| / 2. The terms with 2 pi cancel.
    log_evidence = value + 0.5 * float(np.sum(np.log(alpha))) + float(np.sum(np.log(scale / np.diag(factor))))
    return Posterior(basis, alpha, weights, solve_triangular(factor, np.diag(scale), lower=True), logit, log_evidence)


def _reweighted(likelihood: Likelihood, phi: FloatArray, alpha: FloatArray, logit: FloatArray) -> FloatArray:
    """Return the weights (M,) after one step of iteratively reweighted least squares from logits t (N,).

    They are Delta Phi^T B (t + B^-1 g), with the posterior covariance Delta, and the gradient g and the curvatures B
    (diagonal) of the log-likelihood. `phi` (M, N) is the transpose of Phi, with one basis function in each row.
    """
    beta = likelihood.curvature(logit)
    factor, scale = _scaled_cholesky(_precision(phi, beta, alpha))
    return scale * cho_solve((factor, True), scale * (phi @ (beta * logit + likelihood.slope(logit))))


def _empty(likelihood: Likelihood, functions: FloatArray) -> Posterior:
    """Return the posterior of a model without functions, whose logits are zero."""
    logit = np.zeros(functions.shape[1])
    nothing = np.zeros(0)
    return Posterior(np.zeros(0, np.int64), nothing, nothing, np.zeros((0, 0)), logit, likelihood.log_likelihood(logit))


def _precision(phi: FloatArray, beta: FloatArray, alpha: FloatArray) -> FloatArray:
    """Return the precision matrix Phi^T B Phi + A (M, M) of the weights (Martinelli et al. 2018, eq. 10).

    It is the inverse of the posterior covariance. `phi` (M, N) is the transpose of Phi, with one basis function in each
    row. B and A are diagonal matrices, B of the curvatures `beta` and A of the prior precisions `alpha`.
    """
    scaled = phi * np.sqrt(beta)
    precision = scaled @ scaled.T
    precision[np.diag_indices_from(precision)] += alpha
    return precision


def _levenberg_step(precision: FloatArray, gradient: FloatArray, damping: float) -> tuple[FloatArray, float]:
    """Return the damped Newton step (M,), and half of its product with the gradient.

    Damping raises the diagonal of the Hessian by a share.
    """
    factor, scale = _scaled_cholesky(precision, damping)
    step = scale * cho_solve((factor, True), scale * gradient)
    return step, 0.5 * float(gradient @ step)


def _scaled_cholesky(precision: FloatArray, damping: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Return the lower triangular L and the scale d (M,) of a matrix H that is scaled to a unit diagonal.

    L L^T has the elements d_i H_ij d_j, plus the damping on the diagonal. The damping is raised until the matrix is
    positive definite.
    """
    scale = 1.0 / np.sqrt(np.diag(precision))
    scaled = precision * scale[:, None] * scale
    while True:
        try:
            return cholesky(scaled + damping * np.eye(len(scaled)), lower=True, check_finite=False), scale
        except np.linalg.LinAlgError:
            damping = max(10.0 * damping, 1e-14)
