"""A way from one storey to another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

HowClimbed = Literal["stairs", "lift", "escalator", "unknown"]


@dataclass(frozen=True, slots=True)
class FloorPassage:
    """Somebody left one storey and arrived at another."""

    start_s: float  # when the old storey was left
    end_s: float  # when level ground was reached
    from_floor: int
    to_floor: int
    how: HowClimbed
