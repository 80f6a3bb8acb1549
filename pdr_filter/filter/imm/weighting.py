"""Weights and evidence of context windows: HC and WC distances, and log evidence for the modes of the IMM.

HC (highest context) and WC (weighted context) are Algorithms 1 and 2 of Martinelli et al. (2018), section VI.B.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdr_filter.filter.imm.motion_model import IRREGULAR
from pdr_filter.sensing.contexts.context_stage import CARRYING_STAY_PROB
from pdr_filter.values import CARRYING_MODES, CONTEXTS, FloatArray, IntArray, WindowContext

WEIGHTINGS = ("hc", "wc", "imm")


#: A function of context probabilities (C,) that returns weights (C,): 0 or more, with the sum one.
Weighting = Callable[[FloatArray], FloatArray]


def context_weights(context_prob: FloatArray, threshold: float) -> FloatArray:
    """Return the weights of the contexts (C,) for context probabilities (C,).

    If the context is uncertain, the weights are the probabilities. Otherwise the most probable context has weight one.
    The context is uncertain if second-highest / highest probability >= threshold (Algorithm 2 of Martinelli et al.
    2018). Threshold 0 is always WC (weighted context). Threshold 1 is HC (highest context) unless the two probabilities
    are equal. The threshold `HC` (infinity) is always HC. Among equal maxima the first one has the weight (eq. 19 of
    Martinelli et al. 2018).
    """
    second, first = np.partition(context_prob, -2)[-2:]
    if second >= threshold * first:
        return context_prob
    weights = np.zeros_like(context_prob)
    weights[int(context_prob.argmax())] = 1.0
    return weights


HC = np.inf  # threshold with which the highest context is always used
WC = 0.8  # threshold of Algorithm 2


@dataclass(frozen=True, eq=False)
class WeightedDistances:
    """Distances in m of Algorithms 1 and 2 of Martinelli et al. (2018) for the epochs 1 to K.

    Two context windows contain an epoch, because windows overlap by half. The provisional distance uses the context
    weights of the window that ends with the epoch. The final distance uses those of the next window.
    """

    provisional_m: FloatArray  # (K,) provisional distance pd_k of each epoch
    final_m: FloatArray  # (K,) final distance d_k of each epoch
    total_final_m: FloatArray  # (K,) total final distance D_k, the sum of (d_i + pd_i) / 2 over the epochs 1 to k
    # (K,) total provisional distance PD_k = PD_{k-1} + (d_{k-1} - pd_{k-1}) / 2 + pd_k, which is known before d_k
    total_provisional_m: FloatArray


def weighted_distances(distance_m: FloatArray, context_prob: FloatArray, threshold: float) -> WeightedDistances:
    """Return the distances of epochs by HC or WC, as Algorithms 1 and 2 of Martinelli et al. (2018).

    HC (highest context) takes the distance of the most probable context. WC (weighted context) takes the mean of the
    distances of all contexts, weighted with the context probabilities.

    Parameters
    ----------
    distance_m : (K, C) array
        Distance of each epoch for each context (eq. 17 and 18 of Martinelli et al. 2018).
    context_prob : (K + 1, C) array
        Context probabilities of the windows 0 to K. Epoch k ends with window k - 1, and is the first half of window k.
    threshold : float
        Ratio of the second-highest to the highest probability from which the contexts are weighted by their
        probabilities (WC). Otherwise the highest context is used. `HC` (infinity) always uses the highest context.

    Returns
    -------
    WeightedDistances
        Provisional, final and total distances.

    Raises
    ------
    ValueError
        If `context_prob` does not have one row more than `distance_m`.

    Notes
    -----
    Let l_k (C,) be row k of `distance_m` and w_k (C,) the weights of context window k. The provisional distance of
    epoch k is pd_k = l_k . w_{k-1}, and the final distance is d_k = l_k . w_k. The totals are D_k = D_{k-1} + (d_k +
    pd_k) / 2 and PD_k = PD_{k-1} + (d_{k-1} - pd_{k-1}) / 2 + pd_k.

    References
    ----------
    A. Martinelli, H. Gao, P. D. Groves, S. Morosi, "Probabilistic Context-Aware Step Length Estimation for Pedestrian
    Dead Reckoning", IEEE Sensors Journal 18(4), 2018, doi:10.1109/JSEN.2017.2776100.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.filter.imm.weighting import HC, weighted_distances
    >>> prob = np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])
    >>> distance_m = np.array([[1.0, 0.4], [1.0, 0.4]])
    >>> weighted_distances(distance_m, prob, threshold=0.8).final_m
    array([0.7, 0.4])
    >>> weighted_distances(distance_m, prob, threshold=HC).final_m
    array([1. , 0.4])
    """
    if len(context_prob) != len(distance_m) + 1:
        raise ValueError(
            f"context_prob must have one row more than distance_m, got {len(context_prob)} and {len(distance_m)} rows: "
            "add the context probabilities before the first distance as first row"
        )
    weights = np.stack([context_weights(p, threshold) for p in context_prob])
    provisional = (distance_m * weights[:-1]).sum(axis=1)
    final = (distance_m * weights[1:]).sum(axis=1)
    correction = 0.5 * (final - provisional)
    total_final = np.cumsum(0.5 * (final + provisional))
    total_provisional = np.cumsum(provisional + np.concatenate([[0.0], correction[:-1]]))
    return WeightedDistances(provisional, final, total_final, total_provisional)


def context_log_evidence(
    context_prob: FloatArray, training_prior: FloatArray, exponent: float, floor: float, prior_exponent: float = 1.0
) -> FloatArray:
    """Return the log evidence of each context, (..., C): exponent (log max(p, floor) - prior_exponent log prior).

    The classifier gives p(context | features). Division by the prior of its training set leaves the likelihood of the
    features.

    - The exponent tempers the evidence, because overlapping windows contain the same data. With exponent hop / window
      length each second of data counts once.
    - A prior exponent of one is Bayes' rule for calibrated probabilities. A smaller one divides out less of the prior,
      for classifiers that are not calibrated.
    - The floor keeps a single overconfident window from excluding a context.

    A context without training data (prior zero) gets the floor and a uniform prior: it is improbable but not
    impossible.
    """
    prior = np.where(training_prior > 0, training_prior, 1.0 / training_prior.shape[-1])
    return exponent * (np.log(np.maximum(context_prob, floor)) - prior_exponent * np.log(prior))


def carrying_log_evidence(prob: FloatArray, previous_prob: FloatArray | None, n_windows: int) -> FloatArray:
    """Return the log evidence (D,) for the carrying modes of the windows since the previous evidence.

    Probabilities of the carrying mode depend on all windows so far, so that later ones contain the evidence of earlier
    ones again. The evidence of the last n windows alone is log p_k - log(predicted p_{k-n}). The prediction applies the
    transitions of the context stage (`context_stage.follow_mode`) n times. It is exact if the mode did not change in
    between. `previous_prob` is None before the first evidence. A carrying mode unknown to the classifier (probability
    zero) has evidence 0.

    Two published recipes classify the carrying mode in each window alone. For them this difference between two windows
    has little meaning. Give modes a carrying mode only with the learned contexts of the default.
    """
    is_known = prob > 0
    n_known = max(int(is_known.sum()), 1)
    even = np.where(is_known, 1.0 / n_known, 0.0)
    changes = (1.0 - CARRYING_STAY_PROB) * n_known / max(n_known - 1, 1)
    predicted = even if previous_prob is None else even + (previous_prob - even) * (1.0 - changes) ** n_windows
    comparable = is_known & (predicted > 0)
    return np.log(np.where(comparable, prob, 1.0)) - np.log(np.where(comparable, predicted, 1.0))


@dataclass(frozen=True, eq=False)
class ModeEvidence:
    """Log evidence of context windows for the modes of a filter."""

    contexts: tuple[str, ...]  # context of each mode: one of `window_contexts`, or "irregular"
    carrying_modes: tuple[str | None, ...]  # carrying mode of each mode, or None for any carrying mode
    # Parameters of `context_log_evidence`.
    exponent: float
    prior_exponent: float
    floor: float
    window_contexts: tuple[str, ...] = CONTEXTS  # C contexts in the order of the probabilities of a window

    @cached_property
    def _context_index(self) -> IntArray:
        names = (*self.window_contexts, IRREGULAR)
        return np.array([names.index(c) for c in self.contexts])

    @cached_property
    def _carrying_index(self) -> IntArray:
        # the last index stands for any carrying mode
        return np.array([len(CARRYING_MODES) if c is None else CARRYING_MODES.index(c) for c in self.carrying_modes])

    def of(self, window: WindowContext, used: WindowContext | None, n_windows: int) -> FloatArray:
        """Return the log evidence (M,) of a window.

        `used` is the previous window that was used as evidence, `n_windows` windows earlier, or None. If there is an
        irregular mode, the gate's probability p_irregular belongs to it, and the contexts get (1 - p_irregular) p_c.
        The prior of irregular motion is one half, and so is p_irregular if it is unknown (NaN).
        """
        prob, prior = window.prob, window.training_prior
        if IRREGULAR in self.contexts:
            irregular = float(np.clip(window.irregular_prob, 0.0, 1.0)) if np.isfinite(window.irregular_prob) else 0.5
            prob = np.append((1.0 - irregular) * prob, irregular)
            prior = np.append(0.5 * prior, 0.5)
        evidence = context_log_evidence(prob, prior, self.exponent, self.floor, self.prior_exponent)
        evidence = evidence[self._context_index]
        if all(c is None for c in self.carrying_modes) or not np.isfinite(window.carrying_prob).all():
            return evidence
        previous_prob = used.carrying_prob if used is not None and np.isfinite(used.carrying_prob).all() else None
        of_carrying = carrying_log_evidence(window.carrying_prob, previous_prob, n_windows)
        return evidence + np.append(of_carrying, 0.0)[self._carrying_index]
