"""Floor plans: the walkable areas of a building, by storey."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pdr_filter.apps.maps.geojson import read_plan
from pdr_filter.apps.maps.particle_filter import ParticleFilter
from pdr_filter.apps.maps.plan_smoothing import smooth_on_plan
from pdr_filter.apps.maps.start_area import start_distribution
from pdr_filter.apps.maps.storey import Storey
from pdr_filter.values import Origin, PositionFix, TrackRows


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """Floor plan of a building with one or several storeys, in metres east and north.

    Read one with `FloorPlan.read`. A particle filter on the plan avoids rooms without a door, and crossing walls or the
    outline. Such crossings are improbable, not impossible, so the steps can overrule the plan.

    Attributes
    ----------
    name : str
        Name of the plan.
    storeys : tuple of Storey
        Storeys, the lowest first.
    origin : Origin or None
        Geographic position of east = north = 0, if the plan is in degrees or an origin was given.
    notes : tuple of str
        Remarks about features that were interpreted, such as unknown types.

    See Also
    --------
    pdr_filter.Config.with_plan : Configuration that keeps a track on a plan.

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
    storeys: tuple[Storey, ...]
    origin: Origin | None = None
    notes: tuple[str, ...] = ()

    @classmethod
    def read(cls, path: str | Path, origin: Origin | tuple[float, float] | None = None) -> FloorPlan:
        """Return the floor plan of a GeoJSON file.

        Parameters
        ----------
        path : str or Path
            A GeoJSON FeatureCollection. Each feature has a property "type" ("floor", "wall", "room", "door", "stairs"
            or "lift", or a synonym such as "outline", "corridor", "shop", "toilet", "void", "obstacle" and
            "escalator"), and optionally "floor" and "name". Without a feature of type "floor", the outline of a storey
            is the hull of its features. Coordinates are metres east and north, or longitude and latitude in degrees.
        origin : Origin or tuple of float, optional
            Latitude and longitude of the origin of the plan, in degrees. The default for a plan in degrees is its
            middle.

        Returns
        -------
        FloorPlan
            The plan in metres east and north.

        Raises
        ------
        ValueError
            If the file cannot be read or a feature is not valid. The message names the feature and the remedy.
        ImportError
            If shapely is not installed.
        """
        return cls(*read_plan(path, origin))

    def storey(self, floor: int) -> Storey | None:
        """Return the storey with a given number.

        Parameters
        ----------
        floor : int
            Number of the storey, 0 for the ground floor.

        Returns
        -------
        Storey or None
            The storey, or None if the plan does not have it.
        """
        return next((s for s in self.storeys if s.floor == floor), None)

    def stage(self, start: PositionFix | str | None = None, seed: int = 0) -> ParticleFilter:
        """Return the particle filter that keeps a track on the plan.

        Parameters
        ----------
        start : PositionFix or str, optional
            Start position, the name of an area of the plan, or "anywhere" for all walkable cells of a storey. None, the
            default, starts from the position of the tracker.
        seed : int, default 0
            Seed of the random numbers.

        Returns
        -------
        ParticleFilter
            Filter with default costs and numbers of particles.

        Raises
        ------
        ValueError
            If the plan does not have the start.
        """
        return ParticleFilter(self, None if start is None else start_distribution(self, start), seed=seed)

    smoothed = staticmethod(smooth_on_plan)

    def __repr__(self) -> str:
        floors = ", ".join(str(s.floor) for s in self.storeys)
        return f"FloorPlan({self.name!r}, floors {floors}, {sum(len(s.features) for s in self.storeys)} features)"

    def summary(self) -> dict[str, Any]:
        """Return a summary of the interpreted plan.

        Returns
        -------
        dict
            Name, notes, and for each storey its size in m, its walkable area in m^2 and its number of features per
            kind.
        """
        return {"name": self.name, "storeys": [s.summary() for s in self.storeys], "notes": list(self.notes)}


def plan_of(track: TrackRows) -> FloorPlan | None:
    """Return the floor plan that constrained a track, or None if there was none."""
    return track.plan if isinstance(track.plan, FloorPlan) else None
