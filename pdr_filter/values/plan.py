"""Interface of a floor plan for the filter."""

from __future__ import annotations

from typing import Protocol

from pdr_filter.values.origin import Origin


class Plan(Protocol):
    """Floor plan that a caller passes to the filter, such as `pdr_filter.FloorPlan`."""

    @property
    def name(self) -> str:
        """Name of the plan."""
        ...

    @property
    def origin(self) -> Origin | None:
        """Geographic origin of the frame of the plan. None for a plan in metres without geographic position."""
        ...
