"""Interfaces of user-defined parts, with shapes and units in their docstrings.

A part needs no base class. `pdr_filter.testing` checks that a part conforms to its interface. docs/extend.md and
the docstrings have examples.
"""

from pdr_filter.filter.imm.weighting import Weighting
from pdr_filter.filter.step_length.models import LinearStepLengthModel, SmoothStepLengthModel, StepLengthModel
from pdr_filter.sensing.contexts.context_stage import ContextStage
from pdr_filter.sensing.heading.heading_stage import HeadingStage
from pdr_filter.sensing.steps.detector_protocol import StepDetector
from pdr_filter.values.fixes import Measurement as Fix

__all__ = [
    "ContextStage",
    "Fix",
    "HeadingStage",
    "LinearStepLengthModel",
    "SmoothStepLengthModel",
    "StepDetector",
    "StepLengthModel",
    "Weighting",
]


def __dir__() -> list[str]:
    return __all__
