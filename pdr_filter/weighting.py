"""Context probabilities -> HC and WC distances, and -> log evidence for the modes of the IMM.

HC (highest context) and WC (weighted context) are Algorithms 1 and 2 of Martinelli et al. 2018, section VI.B.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.types import FloatArray

WEIGHTINGS = ("hc", "wc", "imm")


def context_weights(context_prob: FloatArray, threshold: float) -> FloatArray:
    """Weight of each context, shape (C,): the probabilities if the context is uncertain, else one for the highest.

    Uncertain means second-highest over highest probability >= threshold (the condition of Algorithm 2). Threshold 1
    gives HC unless the two are equal, 0 always WC; `HC` (infinity) is HC without exception. Of equal maxima the first
    wins (eq. 19).
    """
    second, first = np.partition(context_prob, -2)[-2:]
    if second >= threshold * first:
        return context_prob
    weights = np.zeros_like(context_prob)
    weights[int(context_prob.argmax())] = 1.0
    return weights


HC = np.inf  # as a threshold: never weighted


@dataclass(frozen=True, eq=False)
class WeightedDistances:
    """Distances of Algorithms 1 and 2 for epochs 1 to K, each (K,), in m."""

    provisional_m: FloatArray  # pd_k
    final_m: FloatArray  # d_k
    total_final_m: FloatArray  # D_k
    total_provisional_m: FloatArray  # PD_k


def weighted_distances(distance_m: FloatArray, context_prob: FloatArray, threshold: float) -> WeightedDistances:
    """HC (threshold `HC`) or WC distances, exactly as Algorithms 1 and 2.

    pd_k = d_k . w_{k-1};  d_{k-1} = d_{k-1} . w_{k-1};  D_{k-1} = D_{k-2} + (d_{k-1} + pd_{k-1}) / 2;
    PD_k = PD_{k-1} + (d_{k-1} - pd_{k-1}) / 2 + pd_k, with w_k the weights of the context window k.

    Parameters
    ----------
    distance_m : (K, C)
        Distance of each epoch if it had been each context (eq. 17, 18).
    context_prob : (K + 1, C)
        Probabilities of window 0 (before the first epoch) to K.
    threshold : float
        See `context_weights`.
    """
    if len(context_prob) != len(distance_m) + 1:
        raise ValueError(
            f"context_prob needs one row more than distance_m (window 0 first), got {len(context_prob)} and "
            f"{len(distance_m)}"
        )
    weights = np.stack([context_weights(p, threshold) for p in context_prob])
    provisional = (distance_m * weights[:-1]).sum(axis=1)
    final = (distance_m * weights[1:]).sum(axis=1)
    correction = 0.5 * (final - provisional)
    total_final = np.cumsum(0.5 * (final + provisional))
    total_provisional = np.cumsum(provisional + np.concatenate([[0.0], correction[:-1]]))
    return WeightedDistances(provisional, final, total_final, total_provisional)


def context_log_evidence(
    context_prob: FloatArray,
    training_prior: FloatArray,
    exponent: float,
    floor: float,
    prior_exponent: float = 1.0,
) -> FloatArray:
    """Log evidence of each context, shape (C,): exponent (log max(p, floor) - prior_exponent log prior).

    The classifier gives p(context | features), so it is divided by the prior of its training set to leave what the
    features say. The exponent tempers it, because overlapping windows repeat the same second of data: with hop over
    window each second votes once. A prior exponent of one is Bayes' rule for calibrated probabilities; a smaller one
    trusts the prior of an uncalibrated classifier less. The floor keeps one overconfident window from ruling a context
    out. A context that the classifier was not trained on (prior zero) gets the floor against an even prior: unlikely,
    not impossible.
    """
    prior = np.where(training_prior > 0, training_prior, 1.0 / len(training_prior))
    return exponent * (np.log(np.maximum(context_prob, floor)) - prior_exponent * np.log(prior))
