"""Interacting multiple model (IMM) for any problem: filter, fixed-interval smoother, and their parts.

`JumpMarkovModel` filters and smooths with any linear models. The functions are the parts of the filter, for trackers
with own predictions or measurements. docs/imm.md has examples.
"""

from pdr_filter.filter.imm.imm import mix as mix
from pdr_filter.filter.imm.imm import predict as predict
from pdr_filter.filter.imm.imm import smoothed_mode_prob as smoothed_mode_prob
from pdr_filter.filter.imm.imm import update as update
from pdr_filter.filter.imm.imm import update_mode_prob as update_mode_prob
from pdr_filter.filter.imm.jump_markov import ImmEstimates as ImmEstimates
from pdr_filter.filter.imm.jump_markov import JumpMarkovModel as JumpMarkovModel
from pdr_filter.values.mixtures import combine as combine

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
