"""Interface of a floor plan for the filter."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from pdr_filter.values.fixes import Fix, PositionFix
from pdr_filter.values.origin import Origin


@runtime_checkable
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

    def stage(self, start: PositionFix | str | None, seed: int) -> Any:
        """Return the stage of the filter that keeps a track on the plan."""
        ...

    def smoothed(self, recording: Any, config: Any, fixes: tuple[Fix, ...], with_location: bool, progress: Any) -> Any:
        """Return the smoothed track of a recording on the plan."""
        ...
