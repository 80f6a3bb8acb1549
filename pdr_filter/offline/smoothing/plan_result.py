"""Result of smoothing a walk on a floor plan."""

from __future__ import annotations

from dataclasses import dataclass

from pdr_filter.tracking.track import Track
from pdr_filter.values import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Hindsight:
    """A smoothed track on a plan, and what was learnt on the way."""

    track: Track
    heading_offset_rad: FloatArray  # (K,)
    heading_offset_std_rad: FloatArray  # (K,)
    log_scale: FloatArray  # (K,)
    log_scale_std: FloatArray  # (K,)
