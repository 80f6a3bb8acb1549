"""Context probabilities -> HC and WC distances, and -> log evidence for the modes of the IMM.

HC (highest context) and WC (weighted context) are Algorithms 1 and 2 of Martinelli et al. 2018, section VI.B.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdr_filter.filter.imm.motion_model import IRREGULAR
from pdr_filter.sensing.contexts.context_stage import CARRYING_STAY_PROB, WindowContext
from pdr_filter.values import CARRYING_MODES, CONTEXTS, FloatArray, IntArray

WEIGHTINGS = ("hc", "wc", "imm")


#: A function of context probabilities (C,) that returns weights (C,): 0 or more, with the sum one.
Weighting = Callable[[FloatArray], FloatArray]


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
    context_prob: FloatArray, training_prior: FloatArray, exponent: float, floor: float, prior_exponent: float = 1.0
) -> FloatArray:
    """Log evidence of each context, shape (..., C): exponent (log max(p, floor) - prior_exponent log prior).

    The classifier gives p(context | features), so it is divided by the prior of its training set to leave what the
    features say. The exponent tempers it, because overlapping windows repeat the same second of data: with hop over
    window each second votes once. A prior exponent of one is Bayes' rule for calibrated probabilities; a smaller one
    trusts the prior of an uncalibrated classifier less. The floor keeps one overconfident window from ruling a context
    out. A context that the classifier was not trained on (prior zero) gets the floor against an even prior: unlikely,
    not impossible.
    """
    prior = np.where(training_prior > 0, training_prior, 1.0 / training_prior.shape[-1])
    return exponent * (np.log(np.maximum(context_prob, floor)) - prior_exponent * np.log(prior))


def carrying_log_evidence(prob: FloatArray, previous_prob: FloatArray | None, n_windows: int) -> FloatArray:
    """Log evidence (D,) of the windows since `before` for where the phone is: the new probabilities over the old ones.

    Probabilities of the carrying mode are of all windows so far, so each of them holds the earlier ones once more. What
    the last windows added is log p_k - log(predicted p_{k-n}), the prediction by the transitions with which they were
    followed (`context.stage.follow_mode`); exact if the mode did not change in between. `before` is None for the first.
    A carrying mode that the classifier does not know (probability zero) has no evidence for or against it. For stages
    that say of each window alone where the phone is (those of two published recipes), this is a difference of two
    windows and means little: give modes a carrying mode with the learned contexts of the default only.
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
    """What a window says for each mode of a filter; exponents and floor are those of `context_log_evidence`."""

    contexts: tuple[str, ...]  # context of each mode: one of `window_contexts`, or "irregular"
    carrying_modes: tuple[str | None, ...]  # carrying mode of each mode; None for all
    exponent: float
    prior_exponent: float
    floor: float
    window_contexts: tuple[str, ...] = CONTEXTS  # C, in the order of the probabilities of a window

    @cached_property
    def _context_index(self) -> IntArray:
        names = (*self.window_contexts, IRREGULAR)
        return np.array([names.index(c) for c in self.contexts])

    @cached_property
    def _carrying_index(self) -> IntArray:
        # the last entry is that of any carrying mode
        return np.array([len(CARRYING_MODES) if c is None else CARRYING_MODES.index(c) for c in self.carrying_modes])

    def of(self, window: WindowContext, used: WindowContext | None, n_windows: int) -> FloatArray:
        """Log evidence (M,) of a window, given the one that was evidence `n_windows` before it (None: there was none).

        With an irregular mode the contexts share what the gate leaves: (1 - p_irregular) p_c, of a prior of one half.
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
