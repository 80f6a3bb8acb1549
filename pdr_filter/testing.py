"""Checks of user-defined parts for the interfaces in `pdr_filter.protocols`."""

from pdr_filter.evaluate.conformance import check_fix as check_fix
from pdr_filter.evaluate.conformance import check_stage as check_stage
from pdr_filter.evaluate.conformance import check_step_length as check_step_length

__all__ = ["check_fix", "check_stage", "check_step_length"]
