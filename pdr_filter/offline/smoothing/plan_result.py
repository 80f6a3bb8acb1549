"""Result of smoothing a walk on a floor plan."""

from __future__ import annotations

from dataclasses import dataclass

from pdr_filter.tracking.track import Track
from pdr_filter.values import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedOnPlan:
    """Smoothed track on a floor plan, with heading offset and log scale (K,) after each step."""

    track: Track
    heading_offset_rad: FloatArray
    heading_offset_std_rad: FloatArray
    log_scale: FloatArray
    log_scale_std: FloatArray
