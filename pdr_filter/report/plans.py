"""Floor plans in axes, under what else is drawn there."""

from __future__ import annotations

from collections.abc import Iterable

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.path import Path

from pdr_filter.maps.floor_plan import FloorPlan
from pdr_filter.maps.storey import Feature, Storey
from pdr_filter.report.palette import PLAN_COLOURS, WALL


def draw_storey(axes: Axes, storey: Storey) -> None:
    """Draw a storey into axes, which stay as wide as they are."""
    for kind, colour in PLAN_COLOURS.items():
        areas = [f for f in storey.features if f.kind == kind and f.is_area]
        axes.add_collection(
            PathCollection([_path(f) for f in areas], facecolors=colour, edgecolors=WALL, linewidths=0.6, zorder=0.5),
            autolim=False,
        )
    for kind, width in (("wall", 1.4), ("door", 2.6)):
        lines = [line for f in storey.features if f.kind == kind and not f.is_area for line in f.lines]
        colour = WALL if kind == "wall" else PLAN_COLOURS["door"]
        axes.add_collection(LineCollection(lines, colors=colour, linewidths=width, zorder=0.6), autolim=False)


def storeys_of(plan: FloorPlan, floors: Iterable[int]) -> list[Storey]:
    """The storeys that a track was on; of a plan with one storey that one."""
    seen = set(floors)
    return [s for s in plan.storeys if len(plan.storeys) == 1 or s.floor in seen]


def _path(feature: Feature) -> Path:
    return Path.make_compound_path(*(Path(ring, closed=True) for ring in feature.lines))
