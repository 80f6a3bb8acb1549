"""Fast sparse Bayesian learning: marginal-likelihood maximisation, many basis functions at a time.

With all other weights fixed, the log evidence depends on the precision alpha_m of a weight's prior through the sparsity
s_m and quality q_m of its basis function (Faul and Tipping 2002; Tipping and Faul 2003, "Fast Marginal Likelihood
Maximisation for Sparse Bayesian Models", AISTATS), and is highest at alpha_m = s_m^2 / (q_m^2 - s_m) if q_m^2 > s_m,
else at infinity (delete the function). Where Tipping and Faul take one such action and refresh the posterior, here one
pass takes many, and is tried again with less if it lowers the evidence. docs/methods/rvm.md has the equations and says
what else differs. The posterior is Laplace's approximation for any log-concave likelihood. `classifiers.rvm` has the
classifiers that call it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.special import expit

from pdr_filter.values import BoolArray, FloatArray, IntArray

# Functions added in one pass at most. They are chosen from the best `_SHORTLIST` with their mutual covariances, so that
# one of two similar functions is taken and not both; more than 20 at once are mostly deleted again.
_MAX_ADDED = 20
_SHORTLIST = 60
# Share of the functions that one pass may delete: with wide kernels many look useless together but not one by one.
_MAX_DELETED_SHARE = 0.2
_START_ALPHA = 1e-2  # prior precision of the weights before the first pass: logits of ten are plausible
# Lower bound of an alpha: beyond it the prior is flat to double precision and the Hessian may lose its rank.
_MIN_ALPHA = 1e-10
# A function whose presence is worth less than this many nats is deleted: it costs time and moves nothing.
_MIN_WORTH = 1e-3
# Of two functions whose parts that the model does not explain correlate more than this, a pass adds one.
_MAX_CORRELATION = 0.99
# A candidate is a combination of the functions in the model, up to rounding, when this share of it is unexplained.
_MIN_UNEXPLAINED = 1e-6
# The mode is found when another Newton step would raise the log posterior by less than this many nats.
_MODE_TOLERANCE = 1e-8
_MAX_NEWTON_STEPS = 100
_MIN_BOLDNESS = 0.1  # how bold a pass is: the step in ln alpha and the numbers added and deleted are multiplied by it
_BLOCK = 64  # basis functions whose s and q are computed together: a block and its square stay in the cache


class Likelihood(Protocol):
    """Log-concave likelihood of the targets as a function of the logits t (N,), independent from row to row."""

    def log_likelihood(self, logit: FloatArray) -> float:
        """Logarithm of p(y | t) in nats."""
        ...

    def slope(self, logit: FloatArray) -> FloatArray:
        """Derivative d ln p / d t_n, (N,)."""
        ...

    def curvature(self, logit: FloatArray) -> FloatArray:
        """beta_n = -d^2 ln p / d t_n^2, (N,), not negative."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Bernoulli:
    """Targets 0 or 1 with p(y_n = 1) = sigma(t_n + offset_n), row n counted weight_n times."""

    target: FloatArray  # (N,)
    weight: FloatArray  # (N,) positive
    offset: FloatArray  # (N,) nats

    def log_likelihood(self, logit: FloatArray) -> float:
        """Eq. 8 of Martinelli et al. 2018, in nats."""
        t = logit + self.offset
        # y ln sigma(t) + (1 - y) ln(1 - sigma(t)) = y t - ln(1 + e^t), which does not overflow
        return float(self.weight @ (self.target * t - np.logaddexp(0.0, t)))

    def slope(self, logit: FloatArray) -> FloatArray:
        """Weighted y - sigma(t), (N,)."""
        return self.weight * (self.target - expit(logit + self.offset))

    def curvature(self, logit: FloatArray) -> FloatArray:
        """Weighted sigma(t) (1 - sigma(t)), (N,)."""
        probability = expit(logit + self.offset)
        return self.weight * probability * (1.0 - probability)


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """Gaussian (Laplace) posterior of the weights of M basis functions, and the evidence of their alphas."""

    basis: IntArray  # (M,) rows of the matrix of candidate functions, ascending
    alpha: FloatArray  # (M,) precisions of the prior
    mean: FloatArray  # (M,) most probable weights
    cov_factor: FloatArray  # (M, M) G, the covariance is G^T G
    logit: FloatArray  # (N,) at the mean
    log_evidence: float  # nats

    @property
    def variance(self) -> FloatArray:
        """Diagonal of the covariance, (M,)."""
        return np.sum(self.cov_factor**2, axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class Trained:
    """Where training ended, how it got there and which budgets it used up."""

    posterior: Posterior
    n_passes: int
    log_evidence: tuple[float, ...] = field(repr=False)  # before the first and after every pass; it never falls
    out_of_passes: bool
    out_of_basis: bool  # functions that would have raised the evidence found no room


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """What a pass would do: the next alphas, where infinite means delete, and functions to add."""

    alpha: FloatArray  # (M,)
    delete: BoolArray  # (M,)
    added: IntArray  # (P,) in the order of their worth
    added_alpha: FloatArray  # (P,)
    gain: float  # nats that the additions promise
    crowded: bool  # more functions wait to be deleted than one pass may


def spread_start(likelihood: Likelihood, functions: FloatArray, n_functions: int) -> Posterior:
    """Posterior with the bias and up to `n_functions` - 1 others, at equal distances in the order of `functions`."""
    n = max(1, min(n_functions, len(functions)))
    basis = np.unique(np.linspace(0, len(functions) - 1, n).astype(np.int64))
    alpha = np.full(len(basis), _START_ALPHA)
    return posterior(likelihood, functions, basis, alpha, np.zeros(len(basis)), np.zeros(functions.shape[1]))


def train(
    likelihood: Likelihood,
    functions: FloatArray,
    start: Posterior | None = None,
    *,
    max_basis: int = 100,
    max_passes: int = 100,
    tol: float = 1.0,
) -> Trained:
    """Alphas of (locally) maximal evidence with the posterior that they imply.

    `functions` (R, N) are the candidates at the N rows, the bias (ones) first: one a row, so that a block of functions
    is contiguous. `start` is where another training ended, perhaps with another likelihood (else `spread_start`).
    Training stops when two passes together raise the log evidence by less than `tol` nats.
    """
    if start is None:
        now = spread_start(likelihood, functions, max_basis)
    else:
        now = posterior(likelihood, functions, start.basis, start.alpha, start.mean, start.logit)
    evidence = [now.log_evidence]
    boldness, n_passes, settled = 1.0, 0, 0
    while n_passes < max_passes:
        proposal = propose(likelihood, functions, now)
        refreshed, boldness, tried = _raise_evidence(
            likelihood, functions, now, proposal, boldness, max_basis, max_passes - n_passes
        )
        n_passes += tried
        full = proposal.gain >= tol and len(now.basis) >= max_basis and not proposal.delete.any()
        if refreshed is None:
            return Trained(now, n_passes, tuple(evidence), boldness >= _MIN_BOLDNESS, full)
        settled = settled + 1 if refreshed.log_evidence - now.log_evidence < 0.5 * tol and not proposal.crowded else 0
        now = refreshed
        evidence.append(now.log_evidence)
        if settled == 2:
            return Trained(now, n_passes, tuple(evidence), False, full)
        boldness = min(1.0, 2.0 * boldness)
    return Trained(now, n_passes, tuple(evidence), True, len(now.basis) >= max_basis)


def _raise_evidence(
    likelihood: Likelihood,
    functions: FloatArray,
    now: Posterior,
    proposal: Proposal,
    boldness: float,
    max_basis: int,
    max_tries: int,
) -> tuple[Posterior | None, float, int]:
    """First posterior of higher evidence, None if there is none, with the boldness and the number of tries it took."""
    for tried in range(1, max_tries + 1):
        refreshed = act(likelihood, functions, now, proposal, boldness, max_basis - len(now.basis))
        if refreshed.log_evidence > now.log_evidence:
            return refreshed, boldness, tried
        boldness *= 0.5  # roll back and try less
        if boldness < _MIN_BOLDNESS:
            return None, boldness, tried
    return None, boldness, max_tries


def propose(likelihood: Likelihood, functions: FloatArray, now: Posterior) -> Proposal:
    """Next alphas, deletions and additions, each best when nothing else changes."""
    s, q = inside_factors(now)
    relevance = q**2 - s
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        alpha = np.where(relevance > 0, s**2 / relevance, np.inf)
    delete = (relevance <= 0) | (worth(s, q) < _MIN_WORTH)
    # a function that should go but may not yet keeps its alpha
    alpha = np.clip(np.where(delete, now.alpha, alpha), _MIN_ALPHA, None)
    allowed = max(1, int(_MAX_DELETED_SHARE * len(now.basis)))
    crowded = bool(delete.sum() > allowed)
    if crowded:
        order = np.argsort(np.where(delete, relevance / s, np.inf), kind="stable")
        delete = np.isin(np.arange(len(delete)), order[:allowed])
    # Also while many wait to be deleted: what is added then replaces some of them, by far better than deleting first.
    added, added_alpha, gain = additions(likelihood, functions, now)
    return Proposal(alpha, delete, added, added_alpha, gain, crowded)


def act(
    likelihood: Likelihood, functions: FloatArray, now: Posterior, proposal: Proposal, boldness: float, room: int
) -> Posterior:
    """Posterior after a share (0 to 1) of what is proposed, with at most `room` functions more than now."""
    alpha = now.alpha * (proposal.alpha / now.alpha) ** boldness
    doomed = np.flatnonzero(proposal.delete)
    doomed = doomed[: int(np.ceil(boldness * len(doomed)))]
    keep = np.isin(np.arange(len(alpha)), doomed, invert=True)
    n_added = min(int(np.ceil(boldness * len(proposal.added))), room + len(doomed))
    basis = np.concatenate([now.basis[keep], proposal.added[:n_added]])
    order = np.argsort(basis)
    alpha = np.concatenate([alpha[keep], proposal.added_alpha[:n_added]])[order]
    mean = np.concatenate([now.mean[keep], np.zeros(n_added)])[order]
    return posterior(likelihood, functions, basis[order], alpha, mean, now.logit)


def inside_factors(now: Posterior) -> tuple[FloatArray, FloatArray]:
    """Sparsity s and quality q (M,) of the functions in the model: 1 / Delta_mm = alpha_m + s_m, w_m = q_m Delta_mm."""
    variance = now.variance
    s = np.maximum(1.0 / variance - now.alpha, np.finfo(float).eps / variance)
    return s, now.mean / variance


def worth(s: FloatArray, q: FloatArray) -> FloatArray:
    """Nats that a function adds at its best alpha: ((q^2 - s) / s + ln(s / q^2)) / 2 where q^2 > s, else zero."""
    ratio = np.maximum(q**2 / s, 1.0)
    return 0.5 * (ratio - 1.0 - np.log(ratio))


def outside_factors(likelihood: Likelihood, functions: FloatArray, now: Posterior) -> tuple[FloatArray, FloatArray]:
    """S and Q of the functions outside the model, there equal to s and q, (R,) each; S is infinite inside.

    Q = phi^T g and S = phi^T B phi - ||G Phi^T B phi||^2, its matrix product, most of the training time, in single
    precision: S decides here only which functions are looked at closely.
    """
    beta, slope = likelihood.curvature(now.logit), likelihood.slope(now.logit)
    projection = ((functions[now.basis] * beta).T @ now.cov_factor.T).astype(np.float32)  # (N, M)
    size, explained = np.empty(len(functions)), np.empty(len(functions))
    for i in range(0, len(functions), _BLOCK):
        block = functions[i : i + _BLOCK]
        size[i : i + _BLOCK] = block**2 @ beta
        explained[i : i + _BLOCK] = np.sum((block.astype(np.float32) @ projection) ** 2, axis=1)
    sparsity = size - explained
    sparsity[sparsity <= _MIN_UNEXPLAINED * size] = np.inf  # adds nothing to what is there
    sparsity[now.basis] = np.inf
    return sparsity, functions @ slope


def additions(likelihood: Likelihood, functions: FloatArray, now: Posterior) -> tuple[IntArray, FloatArray, float]:
    """Functions to add (P,), best first, their alphas (P,) and the nats that they promise.

    The best of the `_SHORTLIST` is added, S and Q of the others are updated for its presence, and so on.
    """
    sparsity, quality = outside_factors(likelihood, functions, now)
    value = worth(sparsity, quality)
    short = np.argsort(-value, kind="stable")[:_SHORTLIST]
    short = short[value[short] > _MIN_WORTH]
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
        s[alike[chosen].any(axis=0)] = np.inf  # what was chosen is like itself
        value = worth(s, quality)
        best = int(np.argmax(value))
        if value[best] <= _MIN_WORTH:
            break
        alpha = max(float(s[best] ** 2 / (quality[best] ** 2 - s[best])), _MIN_ALPHA)
        chosen.append(best)
        alphas.append(alpha)
        gain += float(value[best])
        change = mutual[:, best] / (alpha + mutual[best, best])
        quality = quality - change * quality[best]
        mutual = mutual - np.outer(change, mutual[best])
    return short[chosen], np.array(alphas), gain


def posterior(
    likelihood: Likelihood,
    functions: FloatArray,
    basis: IntArray,
    alpha: FloatArray,
    start: FloatArray,
    start_logit: FloatArray,
) -> Posterior:
    """Laplace posterior for given alphas, by Newton's method with Levenberg's damping.

    The search begins at the best of three: one step of reweighted least squares from `start_logit` (N,), the weights
    `start` (M,), and the bias alone (saturated sigmoids make the others crawl). All lead to the same mode.
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
            break  # or no gain is left above rounding: this is the mode
        weights, value = weights + step, proposed
        logit = weights @ phi
        precision = _precision(phi, likelihood.curvature(logit), alpha)
        damping = 0.1 * damping if damping > 1e-3 else 0.0
    factor, scale = _scaled_cholesky(precision)
    # ln p(y) = ln p(y | w*) p(w* | alpha) + (M / 2) ln 2 pi + ln |Delta| / 2; the 2 pi cancel
    log_evidence = value + 0.5 * float(np.sum(np.log(alpha))) + float(np.sum(np.log(scale / np.diag(factor))))
    return Posterior(basis, alpha, weights, solve_triangular(factor, np.diag(scale), lower=True), logit, log_evidence)


def _reweighted(likelihood: Likelihood, phi: FloatArray, alpha: FloatArray, logit: FloatArray) -> FloatArray:
    """Weights (M,) by one step of reweighted least squares from any logits (N,): Delta Phi^T B (t + B^-1 g)."""
    beta = likelihood.curvature(logit)
    factor, scale = _scaled_cholesky(_precision(phi, beta, alpha))
    return scale * cho_solve((factor, True), scale * (phi @ (beta * logit + likelihood.slope(logit))))


def _empty(likelihood: Likelihood, functions: FloatArray) -> Posterior:
    """Posterior of a model without functions: every logit is zero."""
    logit = np.zeros(functions.shape[1])
    nothing = np.zeros(0)
    return Posterior(np.zeros(0, np.int64), nothing, nothing, np.zeros((0, 0)), logit, likelihood.log_likelihood(logit))


def _precision(phi: FloatArray, beta: FloatArray, alpha: FloatArray) -> FloatArray:
    """Phi^T B Phi + A, the inverse of Delta (Martinelli et al. 2018, eq. 10), (M, M)."""
    scaled = phi * np.sqrt(beta)
    precision = scaled @ scaled.T
    precision[np.diag_indices_from(precision)] += alpha
    return precision


def _levenberg_step(precision: FloatArray, gradient: FloatArray, damping: float) -> tuple[FloatArray, float]:
    """Newton step (M,) with the diagonal of the Hessian raised by a share, and half of its product with the slope."""
    factor, scale = _scaled_cholesky(precision, damping)
    step = scale * cho_solve((factor, True), scale * gradient)
    return step, 0.5 * float(gradient @ step)


def _scaled_cholesky(precision: FloatArray, damping: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Lower L and scale d with L L^T = d_i H_ij d_j + damping I, unit diagonal; damping grows until it is definite."""
    scale = 1.0 / np.sqrt(np.diag(precision))
    scaled = precision * scale[:, None] * scale
    while True:
        try:
            return cholesky(scaled + damping * np.eye(len(scaled)), lower=True, check_finite=False), scale
        except np.linalg.LinAlgError:
            damping = max(10.0 * damping, 1e-14)
