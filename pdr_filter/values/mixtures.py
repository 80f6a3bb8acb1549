"""Probabilities of hypotheses and moments of Gaussian mixtures, for all filters with several hypotheses.

Pure functions of arrays: `mean` (..., M, n), `cov` (..., M, n, n) and probabilities (..., M) of M hypotheses. Leading
axes are independent cases.
"""

from __future__ import annotations

import math

import numpy as np

from pdr_filter.values.arrays import FloatArray


def softmax(log_weight: FloatArray) -> FloatArray:
    """Return the probabilities exp(l_k) / sum_j exp(l_j) of log weights l over the last axis, without overflow."""
    relative = np.exp(log_weight - np.maximum.reduce(log_weight, axis=-1, keepdims=True))
    return relative / np.add.reduce(relative, axis=-1, keepdims=True)


def log_sum(log_weight: FloatArray) -> float:
    """Return the logarithm of the sum of weights (M,), given their logarithms."""
    largest = float(np.maximum.reduce(log_weight))
    return largest + math.log(float(np.add.reduce(np.exp(log_weight - largest))))


def posterior_prob(prior_prob: FloatArray, log_likelihood: FloatArray) -> FloatArray:
    """Return the posterior probabilities of hypotheses.

    A hypothesis with prior probability 0 stays at 0. Evidence that is NaN, or that excludes every hypothesis, is
    ignored: the prior is returned.

    Parameters
    ----------
    prior_prob, log_likelihood : ndarray, shape (..., M)
        Prior probabilities, and log-likelihoods. A constant added to all of the latter has no effect.

    Returns
    -------
    ndarray, shape (..., M)
        Posterior probabilities, which sum to 1.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.values.mixtures import posterior_prob
    >>> posterior_prob(np.array([0.5, 0.5]), np.log([0.9, 0.1])).round(3)
    array([0.9, 0.1])
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


def reweighted_prob(prob: FloatArray, log_evidence: FloatArray) -> FloatArray:
    """Return the probabilities proportional to p_k exp(e_k), shape (..., K), of K hypotheses.

    Unlike `posterior_prob` it needs no logarithms of the p_k. The log evidence e_k must be finite, and of a few nats
    unless all p_k are positive.
    """
    relative = prob * np.exp(log_evidence - np.maximum.reduce(log_evidence, axis=-1, keepdims=True))
    return relative / np.add.reduce(relative, axis=-1, keepdims=True)


def combine(mean: FloatArray, cov: FloatArray, prob: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of a Gaussian mixture (moment matching).

    Parameters
    ----------
    mean, cov : ndarray, shape (..., M, n) and (..., M, n, n)
        Means and covariances of the M components.
    prob : ndarray, shape (..., M)
        Weights of the components, which sum to 1.

    Returns
    -------
    tuple of ndarray, shape (..., n) and (..., n, n)
        Mean and covariance of the mixture.

    Notes
    -----
    x = sum mu_j x_j;  P = sum mu_j (P_j + (x_j - x)(x_j - x)').

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.values.mixtures import combine
    >>> mean, cov = combine(np.array([[0.0], [2.0]]), np.array([[[1.0]], [[1.0]]]), np.array([0.5, 0.5]))
    >>> mean, cov
    (array([1.]), array([[2.]]))
    """
    *batch, n_modes, n = mean.shape
    weights = prob[..., None, :]
    combined = product(weights, mean)  # (..., 1, n)
    spread = mean - combined
    within = product(weights, cov.reshape(*batch, n_modes, n * n)).reshape(*batch, n, n)
    return combined[..., 0, :], within + product((prob[..., None] * spread).swapaxes(-1, -2), spread)


def product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return products of matrices (..., k, l) and (..., l, m). A single pair takes a third of the time of `@`."""
    return a.dot(b) if a.ndim == 2 else a @ b


def possible_outlier(
    log_inlier: FloatArray, log_outlier: float, shift: FloatArray, variance: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the terms of a Kalman update of hypotheses (M,) by a scalar measurement that may be an outlier.

    `log_inlier` (M,) and `log_outlier` are the log densities of the measurement in both cases, plus the log of the
    prior probability of the case. Let g be the covariance of state and innovation, S the `variance` of the innovation,
    and d = innovation / S the `shift`. The results are the log density of the measurement, the probability w of an
    inlier, the factor of g in the mean, and the factor of g g' in the covariance (Bar-Shalom, Daum and Huang, 2009):

        x = x + w d g;  P = P + w ((1 - w) d^2 - 1 / S) g g'.
    """
    log_any = np.logaddexp(log_inlier, log_outlier)
    prob = np.exp(log_inlier - log_any)
    return log_any, prob, prob * shift, prob * ((1.0 - prob) * shift * shift - 1.0 / variance)
