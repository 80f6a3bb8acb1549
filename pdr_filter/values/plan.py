"""Interface of a floor plan, as far as the filter needs one."""

from __future__ import annotations

from typing import Protocol

from pdr_filter.values.origin import Origin


class Plan(Protocol):
    """A floor plan that a caller passes in, such as `pdr_filter.FloorPlan`."""

    @property
    def name(self) -> str:
        """Name of the plan."""
        ...

    @property
    def origin(self) -> Origin | None:
        """Geographic origin of its frame, None for a plan in metres."""
        ...
