"""A classifier that may be wrong about a person: mode probabilities with kinds of people. For `weightings.py`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.sensing.contexts.context_stage import WindowContext
from pdr_filter.values import CONTEXTS, FloatArray

WALKING, UPSTAIRS, DOWNSTAIRS = (CONTEXTS.index(c) for c in ("walking", "upstairs", "downstairs"))


@dataclass(frozen=True, eq=False)
class Kinds:
    """Kinds of people for a classifier: what it takes each context for, and how many there are of each kind."""

    taken_for: FloatArray  # (H, C, C) rows sum to one
    share: FloatArray  # (H,)


def kinds_that_are_wrong(share: float, confused: float) -> Kinds:
    """The classifier may take some people's walking for stairs up, and others' for stairs down, that often."""
    right = np.eye(len(CONTEXTS))
    wrong = [right.copy(), right.copy()]
    for taken, stairs in zip(wrong, (UPSTAIRS, DOWNSTAIRS), strict=True):
        taken[WALKING, [WALKING, stairs]] = 1 - confused, confused
    return Kinds(np.stack([right, *wrong]), np.array([1 - 2 * share, share, share]))


def kinds_that_say_nothing(share: float) -> Kinds:
    """What the classifier says of some people has nothing to do with their contexts."""
    n = len(CONTEXTS)
    return Kinds(np.stack([np.eye(n), np.full((n, n), 1 / n)]), np.array([1 - share, share]))


ONE_KIND = Kinds(np.eye(len(CONTEXTS))[None], np.ones(1))


def chain(
    model: PedestrianModel, evidence: Sequence[WindowContext | None], exponent: float, floor: float, kinds: Kinds
) -> tuple[FloatArray, FloatArray]:
    """Filtered and smoothed context probabilities (K, C): a hidden Markov chain over context and kind of person.

    `evidence` is the window that is new at each step, if there is one. With one kind these are the mode probabilities
    of the IMM. The likelihood of a window in a context is that of all contexts that the classifier takes it for; the
    kind stays for a recording.
    """
    n_steps, transition_prob = len(evidence), model.transition_prob
    standing = np.exp(model.step_log_odds_stationary * model.stands)[:, None]
    p = model.long_run_mode_prob[:, None] * kinds.share
    filtered, predicted = np.empty((2, n_steps, *p.shape))
    for k, window in enumerate(evidence):
        predicted[k] = transition_prob.T @ p
        p = predicted[k] * standing
        if window is not None:
            prior = np.where(window.training_prior > 0, window.training_prior, 1 / len(CONTEXTS))
            likelihood = np.maximum(window.prob, floor) / prior**model.prior_exponent
            p = p * (kinds.taken_for @ likelihood).T ** exponent
        filtered[k] = p = p / p.sum()
    smoothed = filtered.copy()
    for k in range(n_steps - 2, -1, -1):
        smoothed[k] = filtered[k] * (transition_prob @ (smoothed[k + 1] / np.maximum(predicted[k + 1], 1e-300)))
        smoothed[k] /= smoothed[k].sum()
    return filtered.sum(axis=2), smoothed.sum(axis=2)
