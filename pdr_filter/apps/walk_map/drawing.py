"""Drawings of a map of walks: density of steps, floor plan, and a page with all walks."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from pdr_filter.apps.report.palette import COLOURS
from pdr_filter.apps.report.templates import MAP_SCRIPTS, page
from pdr_filter.apps.walk_map.mapped_walk import MappedWalk
from pdr_filter.values import FloatArray, how_many
from pdr_filter.values.optional_packages import load_optional
from pdr_filter.values.uncertainty import worst_std_m

# Half of the width of a narrow corridor. The largest standard deviations for the density and for the outline.
_HALF_WIDTH_M, _MOST_STD_M, _MOST_AROUND_M = 1.5, 5.0, 15.0
_SIMPLIFY_M = 0.5


def density(walks: Sequence[MappedWalk], floor: int, cell_m: float) -> tuple[FloatArray, FloatArray]:
    """Return the south-west corner of the cells, and the expected number of steps on each. Rows run north."""
    if not cell_m > 0:
        raise ValueError(f"cell_m must be positive, got {cell_m}: 1 is usual")
    parts = [(w.position_m[w.floor == floor], w.position_cov_m2[w.floor == floor]) for w in walks]
    if not sum(len(p) for p, _ in parts):
        floors = sorted({int(f) for w in walks for f in np.unique(w.floor)})
        raise ValueError(f"floor {floor} has no walks: floors are {floors}")
    at_m = np.concatenate([p for p, _ in parts])
    low = at_m.min(axis=0) - 3 * _MOST_STD_M
    shape = np.ceil((at_m.max(axis=0) + 3 * _MOST_STD_M - low) / cell_m).astype(int)
    total = np.zeros(shape[::-1])
    for position_m, cov_m2 in parts:
        if len(position_m):
            own = np.zeros(shape[::-1])
            column, row = np.floor((position_m - low) / cell_m).astype(int).T
            np.add.at(own, (row, column), 1.0)
            std_m = np.sqrt(0.5 * np.trace(cov_m2, axis1=1, axis2=2).mean())
            total += gaussian_filter(own, min(float(std_m), _MOST_STD_M) / cell_m)
    return low, total


def plan_text(walks: Sequence[MappedWalk]) -> str:
    """Return the walked areas as GeoJSON: one outline in metres for each storey.

    An outline surrounds each path by 1.5 m plus twice its median standard deviation in the worst direction, of which at
    most 15 m count.
    """
    shapely = load_optional("shapely")
    of_floor: dict[int, list[Any]] = {}
    for walk in walks:
        ends = np.flatnonzero(np.diff(walk.floor)) + 1
        for at_m, cov_m2, floors in zip(
            np.split(walk.position_m, ends),
            np.split(walk.position_cov_m2, ends),
            np.split(walk.floor, ends),
            strict=True,
        ):
            std_m = min(float(np.median(worst_std_m(cov_m2))), _MOST_AROUND_M)
            path = shapely.LineString(at_m) if len(at_m) > 1 else shapely.Point(at_m[0])
            of_floor.setdefault(int(floors[0]), []).append(path.buffer(_HALF_WIDTH_M + 2.0 * std_m))
    features: list[dict[str, Any]] = []
    for floor, areas in sorted(of_floor.items()):
        area = shapely.unary_union(areas).simplify(_SIMPLIFY_M)
        geometry = json.loads(shapely.to_geojson(shapely.set_precision(area, 0.01)))
        properties = {"type": "floor", "floor": floor, "name": "walked area"}
        features.append({"type": "Feature", "properties": properties, "geometry": geometry})
    return json.dumps({"type": "FeatureCollection", "name": "walked area", "features": features}) + "\n"


def map_report(
    walks: Sequence[MappedWalk], apart: Sequence[tuple[str, str]], moved: Sequence[int], notes: Sequence[str]
) -> str:
    """Return the HTML page with the paths of each group and storey, and lists of walks and moved access points."""
    colours = [COLOURS[1:][i % len(COLOURS[1:])] for i in range(len(walks))]  # grey would be hard to see
    storeys = sorted({(w.group, int(f)) for w in walks for f in np.unique(w.floor)})
    drawn = [
        {
            "group": group,
            "floor": floor,
            "paths": [
                {"walk": i, "east": np.round(path_m[:, 0], 1).tolist(), "north": np.round(path_m[:, 1], 1).tolist()}
                for i, w in enumerate(walks)
                if w.group == group and len(path_m := w.position_m[w.floor == floor])
            ],
        }
        for group, floor in storeys
    ]
    return page(
        "walk_map/page/map.html",
        (*MAP_SCRIPTS, "walk_map/page/walks.js"),
        title=f"Map of {how_many(len(walks), 'walk')}, {len(apart)} apart",
        walks=[
            (w.name, colour, w.group, len(w.position_m) - 1, np.median(worst_std_m(w.position_cov_m2)))
            for w, colour in zip(walks, colours, strict=True)
        ],
        data={"storeys": drawn, "walks": colours},
        apart=apart,
        moved=[int(b).to_bytes(6, "big").hex(":") for b in moved],
        notes=notes,
    )
