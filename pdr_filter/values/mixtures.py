"""Weights of hypotheses and moments of Gaussian mixtures, for all filters that run several hypotheses at once.

Pure functions on arrays: `mean` (..., M, n), `cov` (..., M, n, n) and probabilities (..., M) of M hypotheses. Leading
axes, if any, are independent cases.
"""

from __future__ import annotations

import math

import numpy as np

from pdr_filter.values.arrays import FloatArray


def softmax(log_weight: FloatArray) -> FloatArray:
    """Probabilities exp(l_k) / sum_j exp(l_j) over the last axis, without overflow."""
    relative = np.exp(log_weight - np.maximum.reduce(log_weight, axis=-1, keepdims=True))
    return relative / np.add.reduce(relative, axis=-1, keepdims=True)


def log_sum(log_weight: FloatArray) -> float:
    """Logarithm of the sum of weights (M,), from their logarithms."""
    largest = float(np.maximum.reduce(log_weight))
    return largest + math.log(float(np.add.reduce(np.exp(log_weight - largest))))


def posterior_prob(prior_prob: FloatArray, log_likelihood: FloatArray) -> FloatArray:
    """Posterior probabilities, shape (..., M). A hypothesis with prior zero stays at zero.

    Evidence that is not a number, or that rules out every hypothesis, is ignored: the prior is returned.
    """
    with np.errstate(divide="ignore"):
        log_posterior = np.log(prior_prob) + log_likelihood
    highest = np.maximum.reduce(log_posterior, axis=-1, keepdims=True)  # NaN if any is
    if all(map(math.isfinite, highest.ravel().tolist())):
        relative = np.exp(log_posterior - highest)
        return relative / np.add.reduce(relative, axis=-1, keepdims=True)
    is_finite = np.isfinite(highest)
    if not is_finite.any():
        return prior_prob
    return np.where(is_finite, softmax(np.where(is_finite, log_posterior, 0.0)), prior_prob)


def reweighted(prob: FloatArray, log_evidence: FloatArray) -> FloatArray:
    """Probabilities p_k ~ p_k exp(e_k), shape (..., K), for finite evidence of a few nats.

    `posterior_prob` takes evidence of any size, at the cost of the logarithms of the probabilities.
    """
    relative = prob * np.exp(log_evidence - log_evidence.max(axis=-1, keepdims=True))
    return relative / relative.sum(axis=-1, keepdims=True)


def combine(mean: FloatArray, cov: FloatArray, prob: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Moment-matched mean (..., n) and covariance (..., n, n).

    x = sum mu_j x_j;  P = sum mu_j (P_j + (x_j - x)(x_j - x)').
    """
    *batch, n_modes, n = mean.shape
    weights = prob[..., None, :]
    combined = product(weights, mean)  # (..., 1, n)
    spread = mean - combined
    within = product(weights, cov.reshape(*batch, n_modes, n * n)).reshape(*batch, n, n)
    return combined[..., 0, :], within + product((prob[..., None] * spread).swapaxes(-1, -2), spread)


def product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products of matrices (..., k, l) and (..., l, m); of one pair in a third of the time that `@` takes."""
    return a.dot(b) if a.ndim == 2 else a @ b


def possible_outlier(
    log_inlier: FloatArray, log_outlier: float, shift: FloatArray, variance: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Kalman update of hypotheses (M,) by a number that may be an outlier (Bar-Shalom, Daum and Huang, 2009).

    Returns the log density of the measurement, the probability w of an inlier, and the factors of g in the mean and of
    g g' in the covariance: x = x + w d g; P = P + w ((1 - w) d^2 - 1 / S) g g'. Here g is the covariance of state and
    innovation, S the `variance` of the innovation, and d = innovation / S the `shift`.
    """
    log_any = np.logaddexp(log_inlier, log_outlier)
    prob = np.exp(log_inlier - log_any)
    return log_any, prob, prob * shift, prob * ((1.0 - prob) * shift * shift - 1.0 / variance)
