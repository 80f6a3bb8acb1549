"""Drawing of floor plans, alone or as a background of tracks."""

from __future__ import annotations

import pathlib
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.path import Path
from matplotlib.transforms import Bbox

from pdr_filter.apps.maps.floor_plan import FloorPlan
from pdr_filter.apps.maps.storey import Storey
from pdr_filter.apps.report.palette import INK, PLAN_COLOURS, PLAN_WIDTHS, WALL
from pdr_filter.apps.report.plot.figures import PLAIN_TEXT, add_legend, new_figure, save


def draw_storey(axes: Axes, storey: Storey) -> None:
    """Draw a storey as a background. The limits of the axes do not change."""
    for kind, colour in PLAN_COLOURS.items():
        areas = [
            Path.make_compound_path(*(Path(ring, closed=True) for ring in f.lines))
            for f in storey.features
            if f.kind == kind and f.is_area
        ]
        filled = PathCollection(areas, facecolors=colour, edgecolors=WALL, linewidths=0.6, zorder=0.5)
        axes.add_collection(filled, autolim=False)
    for kind, width in PLAN_WIDTHS.items():
        lines = [line for f in storey.features if f.kind == kind and not f.is_area for line in f.lines]
        colour = WALL if kind == "wall" else PLAN_COLOURS["door"]
        axes.add_collection(LineCollection(lines, colors=colour, linewidths=0.6 * width, zorder=0.6), autolim=False)


def plan(plan: FloorPlan, path: str | pathlib.Path | None = None) -> Figure:
    """Draw all storeys of a floor plan, with the names of the areas.

    If names would overlap, only the name of the largest area is written.

    Parameters
    ----------
    plan : FloorPlan
        Floor plan to draw. Each storey gets axes of its own.
    path : str or Path, optional
        File to which the figure is saved. The suffix gives the format; missing folders are created.

    Returns
    -------
    matplotlib Figure
        Figure that belongs to no window and to no pyplot state, so that it need not be closed.

    Examples
    --------
    >>> import json, pathlib, tempfile
    >>> import pdr_filter as pdr
    >>> floor = {"type": "Polygon", "coordinates": [[[0, 0], [6, 0], [6, 4], [0, 4], [0, 0]]]}
    >>> feature = {"type": "Feature", "properties": {"type": "floor"}, "geometry": floor}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "office.geojson")
    ...     _ = file.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    ...     plan = pdr.FloorPlan.read(file)
    >>> figure = pdr.plot.plan(plan)
    >>> figure.axes[0].get_xlabel()
    'east (m)'
    """
    figure = new_figure((8.0, 6.0 * len(plan.storeys)))
    for axes, storey in zip(np.atleast_1d(figure.subplots(len(plan.storeys), 1)), plan.storeys, strict=True):
        draw_storey(axes, storey)
        points = np.concatenate([ring for f in storey.features for ring in f.lines])
        axes.update_datalim(points)
        axes.autoscale_view()
        axes.set(aspect="equal", xlabel="east (m)", ylabel="north (m)")
        axes.set_title(f"{plan.name}, floor {storey.floor}", loc="left", color=INK, **PLAIN_TEXT)
        kinds = [kind for kind in PLAN_COLOURS if any(f.kind == kind for f in storey.features)]
        handles = [Patch(facecolor=PLAN_COLOURS[kind], edgecolor=WALL, label=kind) for kind in kinds]
        add_legend(axes, handles)
    for axes, storey in zip(figure.axes, plan.storeys, strict=True):
        _write_names(axes, storey)
    if path is not None:
        save(figure, path)
    return figure


def _write_names(axes: Axes, storey: Storey) -> None:
    """Write the names of areas, the largest area first. A name that would overlap an earlier one is left out.

    The axes need their final layout.
    """
    named = [f for f in storey.features if f.name and f.kind != "floor"]
    written = list[Bbox]()
    figure = axes.get_figure(root=True)
    if figure is None:
        raise ValueError("the axes belong to no figure; create them with Figure.subplots")
    figure.draw_without_rendering()
    for feature in sorted(named, key=lambda f: -float(np.ptp(f.lines[0], axis=0).prod())):
        middle = 0.5 * (feature.lines[0].min(axis=0) + feature.lines[0].max(axis=0))
        style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 6, "color": INK, "clip_on": True}
        words = axes.annotate(feature.name[:20], middle, **style, **PLAIN_TEXT)
        box = words.get_window_extent()
        if any(box.overlaps(other) for other in written):
            words.remove()
        else:
            written.append(box)
