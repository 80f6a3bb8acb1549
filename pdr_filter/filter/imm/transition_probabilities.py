"""Transition probabilities between the contexts from one step to the next: the matrix of all recipes without their own.

`offline.training.transition_training` estimates a matrix from labelled recordings, and `classifiers.transition_files`
saves it.
"""

from __future__ import annotations

import numpy as np

from pdr_filter.values import CONTEXTS, FloatArray

# Mean stays in steps. Level walking and stairs are of the labels of the terrain data set (four people, 140 flights in
# 140 minutes; part of the "Lower Limb Prostheses Environmental Context Dataset", IEEE DataPort): flights of 6.6 s up
# and 5.8 s down at 1.9 steps a second, level stretches of 33 s at 1.7. The others are set by hand: standing five false
# steps, sideways ten, running fifty.
_STAY_STEPS: dict[str, float] = {
    "stationary": 5.0,
    "walking": 55.0,
    "upstairs": 12.0,
    "downstairs": 11.0,
    "sideways": 10.0,
    "running": 50.0,
}
# Contexts after walking. The same labels have as many steps upstairs as downstairs; the others share the rest.
_AFTER_WALKING: dict[str, float] = {
    "stationary": 0.1,
    "upstairs": 0.35,
    "downstairs": 0.35,
    "sideways": 0.1,
    "running": 0.1,
}


def context_transitions() -> FloatArray:
    """Transition matrix (C, C) of one step, from the context of the row to that of the column.

    The modes of the filter have one context each (`filter.imm.modes`).

    Nine of ten ways out of every other context lead to walking (in the terrain labels all do), the tenth to any of the
    others alike, so that walking is the most frequent context by far, as in life and unlike in training sets.
    """
    rows = np.zeros((len(CONTEXTS), len(CONTEXTS)))
    for i, context in enumerate(CONTEXTS):
        leave = 1 / _STAY_STEPS[context]
        to = _AFTER_WALKING if context == "walking" else {c: 0.9 if c == "walking" else 0.1 / 4 for c in CONTEXTS}
        rows[i] = [1 - leave if c == context else leave * to[c] for c in CONTEXTS]
    return rows
