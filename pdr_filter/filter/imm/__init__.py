"""Interacting multiple model: modes, motion model, step cycle and weightings.

`pdr_filter.imm` has its public functions. The tracker is `pdr_filter.filter.chain.imm_tracker.ImmTracker`.
"""
