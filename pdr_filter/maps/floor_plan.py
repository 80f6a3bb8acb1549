"""Floor plans: where people can walk."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pdr_filter.maps.geojson import read_plan
from pdr_filter.maps.storey import Storey
from pdr_filter.values import Origin, TrackRows


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """Where people can walk: one or several storeys, in metres east and north.

    Read one with `FloorPlan.read`. Rooms are not entered, unless a door leads there or the walk says so; walls and the
    outline are not crossed, unless the walk says so.

    Examples
    --------
    >>> import json, pdr_filter as pdr
    >>> from pathlib import Path
    >>> corners = [[-9, -9], [9, -9], [9, 9], [-9, 9], [-9, -9]]
    >>> hall = {"type": "Feature", "properties": {"type": "floor", "name": "hall"},
    ...         "geometry": {"type": "Polygon", "coordinates": [corners]}}
    >>> _ = Path("hall.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [hall]}))
    >>> plan = pdr.FloorPlan.read("hall.geojson")
    >>> plan.name, len(plan.storeys)
    ('hall', 1)
    """

    name: str
    storeys: tuple[Storey, ...]  # from the lowest
    origin: Origin | None = None  # where on Earth zero is, if the plan was in degrees
    notes: tuple[str, ...] = ()

    @classmethod
    def read(cls, path: str | Path, origin: Origin | tuple[float, float] | None = None) -> FloorPlan:
        """The plan of a GeoJSON file; ValueError that names the feature and the remedy. See `maps.geojson`."""
        return cls(*read_plan(path, origin))

    def storey(self, floor: int) -> Storey | None:
        """The storey of a number; None if it is not drawn."""
        return next((s for s in self.storeys if s.floor == floor), None)

    def __repr__(self) -> str:
        floors = ", ".join(str(s.floor) for s in self.storeys)
        return f"FloorPlan({self.name!r}, floors {floors}, {sum(len(s.features) for s in self.storeys)} features)"

    def summary(self) -> dict[str, Any]:
        """What the plan was understood to be."""
        return {"name": self.name, "storeys": [s.summary() for s in self.storeys], "notes": list(self.notes)}


def plan_of(track: TrackRows) -> FloorPlan | None:
    """The floor plan that a track was kept on, None if there was none."""
    return track.plan if isinstance(track.plan, FloorPlan) else None
