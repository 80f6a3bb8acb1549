"""Result of smoothing a walk on a floor plan."""

from __future__ import annotations

from dataclasses import dataclass

from pdr_filter.tracking.track import Track
from pdr_filter.values import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedOnPlan:
    """Smoothed track on a floor plan, with heading offset in rad and log scale (K,) after each step.

    Both have standard deviations (K,). The log scale is the natural logarithm of the factor on the step lengths.
    """

    track: Track
    heading_offset_rad: FloatArray
    heading_offset_std_rad: FloatArray
    log_scale: FloatArray
    log_scale_std: FloatArray
