"""Pedestrian dead reckoning: a phone's inertial samples in, a track with honest uncertainty out.

Names are loaded when they are first used, so that importing the package costs nothing that is not needed.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from pdr_filter import batch as batch
    from pdr_filter import evaluate as evaluate
    from pdr_filter import recipes as recipes
    from pdr_filter import simulate as simulate
    from pdr_filter.conditioning import merge_streams as merge_streams
    from pdr_filter.context.rvm import RelevanceVectorClassifier as RelevanceVectorClassifier
    from pdr_filter.io import read as read
    from pdr_filter.offline.calibration import Calibration as Calibration
    from pdr_filter.offline.calibration import calibrate as calibrate
    from pdr_filter.offline.fixed_lag import FixedLagSmoother as FixedLagSmoother
    from pdr_filter.offline.smoother import Smoothed as Smoothed
    from pdr_filter.offline.smoother import smooth as smooth
    from pdr_filter.online import Config as Config
    from pdr_filter.online import OnlineFilter as OnlineFilter
    from pdr_filter.tracking import StepUpdate as StepUpdate
    from pdr_filter.types import CONTEXTS as CONTEXTS
    from pdr_filter.types import HeadingFix as HeadingFix
    from pdr_filter.types import MissingSensorError as MissingSensorError
    from pdr_filter.types import PositionFix as PositionFix
    from pdr_filter.types import Recording as Recording
    from pdr_filter.types import Samples as Samples
    from pdr_filter.types import SpeedFix as SpeedFix
    from pdr_filter.types import Standstill as Standstill
    from pdr_filter.types import Step as Step
    from pdr_filter.types import Track as Track
    from pdr_filter.types import Windows as Windows
    from pdr_filter.whole import classify as classify
    from pdr_filter.whole import detect_steps as detect_steps
    from pdr_filter.whole import track as track

_HOME = {
    "CONTEXTS": "types",
    "Calibration": "offline.calibration",
    "Config": "online",
    "FixedLagSmoother": "offline.fixed_lag",
    "HeadingFix": "types",
    "MissingSensorError": "types",
    "OnlineFilter": "online",
    "PositionFix": "types",
    "Recording": "types",
    "RelevanceVectorClassifier": "context.rvm",
    "Samples": "types",
    "Smoothed": "offline.smoother",
    "SpeedFix": "types",
    "Standstill": "types",
    "Step": "types",
    "StepUpdate": "tracking",
    "Track": "types",
    "Windows": "types",
    "calibrate": "offline.calibration",
    "classify": "whole",
    "detect_steps": "whole",
    "merge_streams": "conditioning",
    "read": "io",
    "smooth": "offline.smoother",
    "track": "whole",
}
_MODULES = ("batch", "evaluate", "recipes", "simulate")

__all__ = [
    "CONTEXTS",
    "Calibration",
    "Config",
    "FixedLagSmoother",
    "HeadingFix",
    "MissingSensorError",
    "OnlineFilter",
    "PositionFix",
    "Recording",
    "RelevanceVectorClassifier",
    "Samples",
    "Smoothed",
    "SpeedFix",
    "Standstill",
    "Step",
    "StepUpdate",
    "Track",
    "Windows",
    "batch",
    "calibrate",
    "classify",
    "detect_steps",
    "evaluate",
    "merge_streams",
    "read",
    "recipes",
    "simulate",
    "smooth",
    "track",
]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(f"{__name__}.{name}")
    if name in _HOME:
        value = getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
