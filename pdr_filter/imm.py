"""Interacting multiple model (IMM) for any problem: filter, fixed-interval smoother, and their parts.

`JumpMarkovModel` filters and smooths with any linear models. The functions are the parts of the filter, for trackers
with own predictions or measurements. docs/imm.md has examples.
"""

from pdr_filter.filter.imm.imm import mix, predict, smoothed_mode_prob, update, update_mode_prob
from pdr_filter.filter.imm.jump_markov import ImmEstimates, JumpMarkovModel
from pdr_filter.values.mixtures import combine

__all__ = [
    "ImmEstimates",
    "JumpMarkovModel",
    "combine",
    "mix",
    "predict",
    "smoothed_mode_prob",
    "update",
    "update_mode_prob",
]


def __dir__() -> list[str]:
    return __all__
