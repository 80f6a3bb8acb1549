"""Change of storey."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

HowClimbed = Literal["stairs", "lift", "escalator", "unknown"]


@dataclass(frozen=True, slots=True)
class FloorPassage:
    """Passage from one storey to another."""

    start_s: float  # end of the stay on the old storey
    end_s: float  # arrival on level ground
    from_floor: int
    to_floor: int
    how: HowClimbed
