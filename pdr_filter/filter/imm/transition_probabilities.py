"""Transition probabilities between contexts from one step to the next, unless they are estimated from labels.

`offline.training.transition_training` estimates a matrix from labelled recordings, and `classifiers.transition_files`
saves it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pdr_filter.values import DEFAULT_CONTEXTS, Context, FloatArray

# Mean stay in steps, and share among the contexts after level walking. Level walking and stairs are of the labels of
# the terrain data set (four people, 140 flights in 140 minutes; part of the "Lower Limb Prostheses Environmental
# Context Dataset", IEEE DataPort): flights of 6.6 s up and 5.8 s down at 1.9 steps a second, level stretches of 33 s at
# 1.7, and as many steps upstairs as downstairs. The others are set by hand: standing five false steps, sideways ten,
# running fifty.
_STANDING, _WALKING, _RUNNING = (5.0, 0.1), (55.0, 0.1), (50.0, 0.1)
_UP, _DOWN, _TURNED = (12.0, 0.35), (11.0, 0.35), (10.0, 0.1)
# Ways out of any context but level walking that lead to level walking; in the terrain labels all do.
_TO_WALKING, _TO_OTHERS = 0.9, 0.1


def _stay_and_share(context: Context) -> tuple[float, float]:
    """Mean stay in a context in steps, and its share among the contexts after level walking, before normalisation."""
    if context.stands:
        return _STANDING
    if context.runs:
        return _RUNNING
    if context.climbs:
        return _UP if context.climbs > 0 else _DOWN
    return _TURNED if context.is_turned else _WALKING


def context_transitions(contexts: Sequence[Context] = DEFAULT_CONTEXTS.contexts) -> FloatArray:
    """Transition matrix (C, C) of one step, from the context of the row to that of the column.

    It follows from what the contexts mean. The mean stay is 5 steps in a context without steps, 55 in level walking and
    on a treadmill, 12 up and 11 down stairs, 10 sideways and 50 in running. Nine of ten ways out of every other context
    lead to level walking, the tenth to any of the others alike. So level walking is the most frequent context by far,
    as in life and unlike in training sets. Ways out of level walking lead to stairs in seven of ten cases, as far as
    there are stairs. Without level walking all ways out are alike.
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
