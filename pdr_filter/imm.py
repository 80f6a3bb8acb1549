"""Interacting multiple model (IMM) for any problem: filter, fixed-interval smoother, and their parts.

`JumpMarkovModel` filters and smooths with any linear models. The functions are the parts of the filter, for trackers
with own predictions or measurements. One cycle for a measurement that has just arrived is:

>>> import numpy as np
>>> import pdr_filter as pdr
>>> H, R = np.array([[1.0, 0.0]]), np.array([[0.01]])  # a position is measured
>>> F = np.array([[[1.0, 0.0], [0.0, 0.0]], [[1.0, 1.0], [0.0, 1.0]]])  # at rest, and moving
>>> Q = np.array([np.diag([1e-6, 0.5]), np.diag([1e-6, 1e-2])])
>>> mean, cov, prob = np.zeros((2, 2)), np.stack([np.eye(2)] * 2), np.array([0.5, 0.5])
>>> for measured_m in (0.9, 2.1, 3.0):
...     mean, cov, prob = pdr.imm.mix(mean, cov, prob, np.array([[0.9, 0.1], [0.1, 0.9]]))
...     mean, cov = pdr.imm.predict(mean, cov, F, Q)
...     mean, cov, log_likelihood, nis = pdr.imm.update(mean, cov, np.array([measured_m]), H, R)
...     prob = pdr.imm.update_mode_prob(prob, log_likelihood)
>>> position_and_speed, its_cov = pdr.imm.combine(mean, cov, prob)
>>> prob.round(2), position_and_speed.round(1)
(array([0., 1.]), array([3., 1.]))

The filter of a pedestrian is an interacting multiple model, too. Its motion models are `pdr_filter.Mode`, given to
`pdr_filter.Config.with_contexts`; its tracker is `pdr_filter.filter.chain.imm_tracker.ImmTracker`.
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
