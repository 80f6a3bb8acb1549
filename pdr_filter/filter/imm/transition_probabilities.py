"""Default transition probabilities between contexts from one step to the next, and stationary probabilities.

`offline.training.transition_training` estimates a matrix from labelled recordings, and `classifiers.transition_files`
saves it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pdr_filter.values import DEFAULT_CONTEXTS, Context, FloatArray

# Mean stay in steps, and share among the contexts after level walking. Values for level walking and stairs are from the
# labels of the terrain data set (four people, 140 flights in 140 minutes; part of the "Lower Limb Prostheses
# Environmental Context Dataset", IEEE DataPort). There, flights take 6.6 s up and 5.8 s down at 1.9 steps a second,
# level stretches 33 s at 1.7 steps a second, and steps upstairs are as many as steps downstairs. The other values are
# assumptions: 5 false steps while standing, 10 steps sideways, 50 steps of running.
_STANDING, _WALKING, _RUNNING = (5.0, 0.1), (55.0, 0.1), (50.0, 0.1)
_UP, _DOWN, _TURNED = (12.0, 0.35), (11.0, 0.35), (10.0, 0.1)
# Share of transitions out of other contexts that lead to level walking. In the terrain labels all of them do.
_TO_WALKING, _TO_OTHERS = 0.9, 0.1


def _stay_and_share(context: Context) -> tuple[float, float]:
    """Return the mean stay in a context in steps, and the share of transitions out of level walking that lead to it.

    The shares of all contexts are weights that do not sum to one.
    """
    if context.stands:
        return _STANDING
    if context.runs:
        return _RUNNING
    if context.climbs:
        return _UP if context.climbs > 0 else _DOWN
    return _TURNED if context.is_turned else _WALKING


def context_transitions(contexts: Sequence[Context] = DEFAULT_CONTEXTS.contexts) -> FloatArray:
    """Return the transition matrix of the contexts for one step, derived from their meanings.

    The mean stay in steps is 5 in a context without steps, 55 in level walking and on a treadmill, 12 up stairs and 11
    down stairs, 10 sideways, and 50 in running. From every other context, nine of ten transitions lead to level
    walking. The rest is divided evenly among the other contexts. Level walking is therefore by far the most frequent
    context, as in daily life and unlike in training sets. Seven of ten transitions out of level walking lead to stairs,
    if there are contexts for stairs. Without level walking all transitions out of a context are equally probable.

    Parameters
    ----------
    contexts : sequence of Context, optional
        Contexts in the order of the rows. The default are `pdr_filter.CONTEXTS`.

    Returns
    -------
    (C, C) array
        Probability of a transition from the context of the row to the context of the column. Rows sum to one.

    Notes
    -----
    The stays in level walking (33 s) and on stairs (6.6 s up, 5.8 s down) are from the labels of the data set terrain
    (four people, 140 flights). The other stays are assumptions.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> transition_prob = pdr.recipes.context_transitions()
    >>> round(float(transition_prob[pdr.CONTEXTS.index("walking"), pdr.CONTEXTS.index("upstairs")]), 4)
    0.0064
    """
    n = len(contexts)
    level = [c.is_level_walking for c in contexts]
    stay_steps, share = zip(*map(_stay_and_share, contexts), strict=True)
    rows = np.eye(n)
    for i in range(n if n > 1 else 0):
        n_level, n_others = sum(level) - level[i], n - 1 - sum(level) + level[i]
        if level[i]:
            way_out = [each / math.fsum(share[:i] + share[i + 1 :]) for each in share]
        elif n_level and n_others:
            way_out = [_TO_WALKING / n_level if is_level else _TO_OTHERS / n_others for is_level in level]
        else:
            way_out = [1.0 / (n - 1)] * n
        leave = 1 / stay_steps[i]
        rows[i] = [1 - leave if j == i else leave * each for j, each in enumerate(way_out)]
    return rows


def stationary_prob(transition_prob: FloatArray) -> FloatArray:
    """Return the mean share of time that a Markov chain spends in each state, for a uniform start.

    The share is the limit of the mean of p T^k over k = 0 to n, with p = 1 / M. For an irreducible chain the limit is
    the stationary distribution, the solution of q T = q. A periodic chain has it too, although T^k does not converge.
    A reducible chain has one stationary distribution for each closed class, which is a set of states that lead to each
    other and to no other state. The closed classes are weighted by the probability that the uniform start ends in them.

    Parameters
    ----------
    transition_prob : (M, M) array
        Probability of a transition from the state of the row to the state of the column. Rows sum to one.

    Returns
    -------
    (M,) array
        Probabilities, which sum to one.

    Notes
    -----
    The states are eliminated one after the other (W. K. Grassmann, M. I. Taksar and D. P. Heyman, "Regenerative
    analysis and steady state distributions for Markov chains", Operations Research 33, 1985). The method subtracts
    nothing, so that the relative errors are those of the transition probabilities, even for stays of 10^12 steps.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.filter.imm.transition_probabilities import stationary_prob
    >>> stationary_prob(np.array([[1 - 1e-9, 1e-9], [9e-9, 1 - 9e-9]]))
    array([0.9, 0.1])
    >>> stationary_prob(np.array([[0.0, 1.0], [1.0, 0.0]]))
    array([0.5, 0.5])
    """
    n = len(transition_prob)
    reaches = np.eye(n, dtype=bool) | (transition_prob > 0)
    for k in range(n):  # Warshall's algorithm
        reaches |= reaches[:, k : k + 1] & reaches[k]
    is_closed = ~(reaches & ~reaches.T).any(axis=1)
    passing, prob = np.flatnonzero(~is_closed), np.zeros(n)
    # Expected number of visits to each state outside of the closed classes, times the probability to leave it for each
    # state of a closed class.
    visits = np.linalg.solve(
        np.eye(len(passing)) - transition_prob[np.ix_(passing, passing)].T, np.full(len(passing), 1.0 / n)
    )
    entered = 1.0 / n + visits @ transition_prob[passing]
    for first in np.flatnonzero(is_closed & (reaches.argmax(axis=1) == np.arange(n))):
        members = np.flatnonzero(reaches[first])
        prob[members] = entered[members].sum() * _of_irreducible(transition_prob[np.ix_(members, members)])
    return prob / prob.sum()


def _of_irreducible(transition_prob: FloatArray) -> FloatArray:
    """Return the stationary distribution (M,) of an irreducible chain, by elimination of states from the last one."""
    T, n = transition_prob.copy(), len(transition_prob)
    for k in range(n - 1, 0, -1):
        T[:k, k] /= T[k, :k].sum()
        T[:k, :k] += np.outer(T[:k, k], T[k, :k])
    prob = np.ones(n)
    for k in range(1, n):
        prob[k] = prob[:k] @ T[:k, k]
    return prob / prob.sum()
