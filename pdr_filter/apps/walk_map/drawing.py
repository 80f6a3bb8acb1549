"""Drawings of a map of walks: density of steps, floor plan, and a page with all walks."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from pdr_filter.apps.walk_map.mapped_walk import MappedWalk
from pdr_filter.values import FloatArray
from pdr_filter.values.uncertainty import worst_std_m

# Half of the width of a narrow corridor. The largest standard deviations for the density and for the outline.
_HALF_WIDTH_M, _MOST_STD_M, _MOST_AROUND_M = 1.5, 5.0, 15.0
_SIMPLIFY_M = 0.5
_WIDTH_PX = 900
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f")


def density(walks: Sequence[MappedWalk], floor: int, cell_m: float) -> tuple[FloatArray, FloatArray]:
    """Return the south-west corner of the cells, and the expected number of steps on each cell (rows, columns).

    Rows run north. ValueError if `cell_m` is not positive or no walk is on the storey.
    """
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
    try:
        import shapely
    except ImportError:
        raise ImportError('floor plans need shapely: pip install "pdr_filter[maps]"') from None
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
    """Return the HTML page with the paths of each group and storey, and lists of walks and moved access points.

    `apart` has the name and the reason of each walk that was not joined. `notes` are the warnings, at the top.
    """
    parts: list[str] = []
    for group in sorted({w.group for w in walks}):
        own = [w for w in walks if w.group == group]
        for floor in sorted({int(f) for w in own for f in np.unique(w.floor)}):
            parts.append(f"<h2>Group {group}, storey {floor}</h2>{_drawing(own, floor)}")
    rows = "".join(
        f"<tr><td>{html.escape(w.name)}</td><td>{w.group}</td><td>{len(w.position_m) - 1}</td>"
        f"<td>{float(np.median(worst_std_m(w.position_cov_m2))):.1f} m</td></tr>"
        for w in walks
    )
    names = "".join(f"<li>{html.escape(name)}: {html.escape(why)}</li>" for name, why in apart)
    addresses = ", ".join(int(b).to_bytes(6, "big").hex(":") for b in moved)
    moved_text = f"<h2>Moved access points</h2><p>{addresses}</p>" if moved else ""
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>Map of walks</title><style>'
        "body{font-family:sans-serif;max-width:960px;margin:2em auto}svg{border:1px solid #ccc;width:100%}"
        "td,th{padding:2px 12px;text-align:left}</style>"
        f"<h1>Map of {len(walks)} walks, {len(apart)} apart</h1>"
        f"{''.join(f'<p>{html.escape(note)}</p>' for note in notes)}{''.join(parts)}"
        f"<h2>Walks</h2><table><tr><th>name<th>group<th>steps<th>standard deviation</tr>{rows}</table>"
        f"<h2>Apart</h2><ul>{names or '<li>none</li>'}</ul>{moved_text}</html>\n"
    )


def _drawing(walks: Sequence[MappedWalk], floor: int) -> str:
    """Return the paths of a storey as SVG, north up, with a bar of ten metres."""
    paths = [w.position_m[w.floor == floor] for w in walks]
    at_m = np.concatenate(paths)
    low, high = at_m.min(axis=0) - 5.0, at_m.max(axis=0) + 5.0
    scale = _WIDTH_PX / float(high[0] - low[0])
    height = scale * float(high[1] - low[1])
    lines: list[str] = []
    for k, path in enumerate(paths):
        if len(path):
            points = " ".join(f"{scale * (e - low[0]):.1f},{height - scale * (n - low[1]):.1f}" for e, n in path)
            colour = _COLOURS[k % len(_COLOURS)]
            title = f"<title>{html.escape(walks[k].name)}</title>"
            lines.append(
                f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2">{title}</polyline>'
            )
    bar = f'<path d="M10 {height - 10:.0f}h{10 * scale:.0f}" stroke="#000" stroke-width="3"/>'
    text = f'<text x="10" y="{height - 16:.0f}" font-size="14">10 m</text>'
    return f'<svg viewBox="0 0 {_WIDTH_PX} {height:.0f}">{"".join(lines)}{bar}{text}</svg>'
