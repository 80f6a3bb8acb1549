"""Reader of floor plans in GeoJSON, in metres or degrees.

Invalid features raise a ValueError that names the feature and the remedy.
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdr_filter.apps.maps.storey import CELL_M, FREE, LIFT, MARGIN_M, OUTSIDE, ROOM, STAIRS, WALL, Feature, Storey
from pdr_filter.values import FloatArray, IntArray, Origin, limits, read_only
from pdr_filter.values.optional_packages import load_optional
from pdr_filter.values.safe_files import read_json

# Accepted values of the property "type", by kind of feature.
_KINDS = {
    "floor": ("floor", "outline", "storey", "level", "corridor"),
    "wall": ("wall",),
    "room": ("room", "shop", "closed", "toilet", "void", "rest", "obstacle", "parking"),
    "door": ("door", "opening"),
    "stairs": ("stairs", "staircase", "escalator", "ramp"),
    "lift": ("lift", "elevator"),
}
_KIND_OF = {word: kind for kind, words in _KINDS.items() for word in words}
_AREAS = ("floor", "room", "stairs", "lift")
# Allowed extent of a building in metres. A smaller or larger extent shows that the drawing uses other units.
_LEAST_M, _MOST_M = 2.0, 3000.0
# Largest number of cells of all storeys together: one square kilometre, more than any shopping mall.
_MOST_CELLS = 25_000_000
# Cells tested per block, which limits the memory.
_BLOCK_CELLS = 1_000_000
# Largest extent of a plan in degrees (5.6 km). A building in metres always spans more than 0.05.
_MOST_DEG = 0.05
# Margin of the outline around the convex hull of the features, if no outline is drawn.
_OUTLINE_MARGIN_M = 1.0
# A door opens all walls and rooms within this distance, because drawn edges do not meet exactly.
_NEAR_M = 0.3


@dataclass(frozen=True, slots=True)
class _RawFeature:
    """Feature of a floor plan as read from the file: index in the file, kind, name, storey and shapely geometry."""

    number: int
    kind: str
    name: str
    floor: int
    shape: Any

    def __str__(self) -> str:
        return f"feature {self.number}" + (f" ({self.name!r})" if self.name else "")


def read_plan(
    path: str | Path, origin: Origin | tuple[float, float] | None = None
) -> tuple[str, tuple[Storey, ...], Origin | None, tuple[str, ...]]:
    """Return the name, storeys, origin and notes of a file, the fields of a `FloorPlan` (see `FloorPlan.read`)."""
    path = Path(path)
    if not path.exists():
        raise ValueError(f"{path}: no such file; check the path")
    try:
        content = read_json(path, limits.MAX_PLAN_BYTES)
        features, properties = content["features"], content.get("properties") or {}
        if content["type"] != "FeatureCollection" or not isinstance(features, list) or not isinstance(properties, dict):
            raise ValueError(f"type {content['type']}, features not a list, or properties not an object")
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: not a GeoJSON FeatureCollection ({error}); export one from QGIS") from None
    notes: list[str] = []
    try:
        drawn = [_drawn(i, f, properties.get("floor", 0), notes) for i, f in enumerate(features)]
        if not drawn:
            raise ValueError("the plan has no features; draw the outline of the floor, or walls")
        drawn, plan_origin = _in_metres(drawn, None if origin is None else Origin.of(origin))
        for d in drawn:
            _check_shape(d)
        floors = sorted({d.floor for d in drawn})
        of_floor = {floor: [d for d in drawn if d.floor == floor] for floor in floors}
        if (n_cells := sum(np.prod(_grid(part)[1]) for part in of_floor.values())) > _MOST_CELLS:
            raise ValueError(
                f"the storeys have {n_cells * CELL_M**2 / 1e6:.1f} square kilometres together, more than "
                f"{_MOST_CELLS * CELL_M**2 / 1e6:g}; draw a single building, and check for points far outside of it"
            )
        storeys = tuple(_storey(floor, part) for floor, part in of_floor.items())
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    name = html.unescape(str(content.get("name") or path.stem))  # some exporters write &amp;
    return name, storeys, plan_origin, tuple(dict.fromkeys(notes))


def _drawn(number: int, feature: Any, floor: Any, notes: list[str]) -> _RawFeature:
    """Return one feature of the file, checked; append remarks about interpreted types to `notes`."""
    geometry = load_optional("shapely.geometry")
    properties: Any = feature.get("properties") or {} if isinstance(feature, dict) else None
    if not isinstance(properties, dict):
        raise ValueError(f"feature {number} is not a feature with properties, got {str(feature)[:60]}; delete it")
    name, word = html.unescape(str(properties.get("name") or "")), str(properties.get("type") or "").lower()
    which = f"feature {number}" + (f" ({name!r})" if name else "")
    if not word:
        raise ValueError(f'{which} has no property "type"; give it one of {", ".join(_KINDS)}')
    kind = _KIND_OF.get(word)
    try:
        shape = geometry.shape(feature["geometry"])
    except Exception as error:  # damaged geometries raise many kinds of exceptions
        raise ValueError(f"{which} has a geometry that cannot be read ({error}); draw it again, or delete it") from None
    is_area = shape.geom_type in ("Polygon", "MultiPolygon")
    if kind is None:
        if not is_area:
            raise ValueError(
                f"{which} has the unknown type {word!r} and is a {shape.geom_type}; use one of {', '.join(_KIND_OF)}"
            )
        kind = "room"
        notes.append(f"features of the unknown type {word!r} are treated as rooms without a door")
    if kind in _AREAS and not is_area:
        raise ValueError(f"{which} is a {kind} drawn as a {shape.geom_type}; draw it as a polygon")
    if shape.geom_type not in ("Polygon", "MultiPolygon", "LineString", "MultiLineString"):
        raise ValueError(f"{which} is a {shape.geom_type}; draw it as a line or a polygon")
    try:
        storey = int(properties.get("floor", floor))
    except (TypeError, ValueError, OverflowError):
        raise ValueError(
            f"{which} has floor {properties.get('floor', floor)!r}; give a whole number, 0 at the ground"
        ) from None
    return _RawFeature(number, kind, name, storey, shape)


def _in_metres(drawn: Sequence[_RawFeature], origin: Origin | None) -> tuple[list[_RawFeature], Origin | None]:
    """Return the features in metres, and the origin: the given one, or the middle of a plan in degrees, or None."""
    import shapely

    for d in drawn:
        if d.shape.is_empty or not np.isfinite(shapely.get_coordinates(d.shape)).all():
            raise ValueError(f"{d} has no coordinates, or not finite ones; draw it again, or delete it")
    points = np.concatenate([shapely.get_coordinates(d.shape) for d in drawn])
    low, high = points.min(axis=0), points.max(axis=0)
    span = float((high - low).max())
    if span <= _MOST_DEG and (np.abs(points) <= [180.0, 180.0]).all():
        if np.abs(points[:, 1]).max() > 90:
            raise ValueError(
                f"{drawn[0]} has a latitude of {points[0, 1]}; GeoJSON has the longitude first: swap the coordinates"
            )
        middle = Origin(float(0.5 * (low[1] + high[1])), float(0.5 * (low[0] + high[0])))
        if origin is not None and np.linalg.norm(origin.east_north_m(middle.latitude_deg, middle.longitude_deg)) > 1e4:
            raise ValueError(
                f"the plan is near latitude {middle.latitude_deg:.4f}, longitude {middle.longitude_deg:.4f}, more "
                "than 10 km from the origin; GeoJSON has the longitude first: check the order of the coordinates, and "
                "the origin"
            )
        plan_origin = origin or middle

        def metres(coordinates: FloatArray) -> FloatArray:
            return plan_origin.east_north_m(coordinates[:, 1], coordinates[:, 0])

        shapes = (shapely.transform(d.shape, metres) for d in drawn)
        return [replace(d, shape=shape) for d, shape in zip(drawn, shapes, strict=True)], plan_origin
    if not _LEAST_M <= span <= _MOST_M:
        raise ValueError(
            f"the plan spans {span:g}, but a building spans {_LEAST_M:g} to {_MOST_M:g} m, or at most {_MOST_DEG:g} "
            "degrees; give metres, or longitude and latitude in degrees, not millimetres, feet or pixels"
        )
    return list(drawn), origin


def _check_shape(drawn: _RawFeature) -> None:
    """Raise ValueError if the geometry of a feature is invalid, for example with crossing lines."""
    from shapely.validation import explain_validity

    if not drawn.shape.is_valid:
        raise ValueError(
            f"{drawn} is not a valid {drawn.kind} ({explain_validity(drawn.shape)}); draw it again without crossing "
            "lines, or repair it with Fix geometries in QGIS"
        )


def _grid(drawn: Sequence[_RawFeature]) -> tuple[FloatArray, IntArray]:
    """Return the south-west corner (2,) of the cells of a storey in m, and the numbers of columns and rows (2,)."""
    import shapely

    points = np.concatenate([shapely.get_coordinates(d.shape) for d in drawn])
    south_west = points.min(axis=0) - MARGIN_M
    return south_west, np.ceil((points.max(axis=0) + MARGIN_M - south_west) / CELL_M).astype(int)


def _storey(floor: int, drawn: Sequence[_RawFeature]) -> Storey:
    """Return the storey of the given features.

    The areas are rasterised first, then the walls, without the parts at doors. A room with a door is walkable, and its
    boundary is a wall. ValueError if there are neither outlines nor walls.
    """
    import shapely

    of_kind = {kind: [d for d in drawn if d.kind == kind] for kind in _KINDS}
    if not of_kind["floor"] and not of_kind["wall"]:
        raise ValueError(
            f'floor {floor} has neither an outline nor walls; draw a polygon of type "floor" around the walkable area'
        )
    south_west, (n_columns, n_rows) = _grid(drawn)
    east = south_west[0] + CELL_M * (np.arange(n_columns) + 0.5)
    north = south_west[1] + CELL_M * (np.arange(n_rows) + 0.5)
    cells = np.full((n_rows, n_columns), OUTSIDE, dtype=np.uint8)

    def fill(shape: Any, kind: int) -> None:
        """Set the cells with their centre inside an area to a kind."""
        shapely.prepare(shape)
        (x0, y0), (x1, y1) = np.reshape(shape.bounds, (2, 2))
        columns, (first, end) = slice(*np.searchsorted(east, [x0, x1])), np.searchsorted(north, [y0, y1])
        n_together = max(_BLOCK_CELLS // max(columns.stop - columns.start, 1), 1)
        for row in range(first, end, n_together):
            rows = slice(row, min(row + n_together, end))
            x, y = np.meshgrid(east[columns], north[rows])
            cells[rows, columns][shapely.contains_xy(shape, x, y)] = kind

    doors = [d.shape for d in of_kind["door"]]
    near = shapely.unary_union(doors).buffer(_NEAR_M) if doors else shapely.Polygon()
    # without a drawn outline, the floor is the convex hull of the features with a margin
    drawn_parts = shapely.GeometryCollection([d.shape for d in drawn])
    outlines = [d.shape for d in of_kind["floor"]] or [drawn_parts.convex_hull.buffer(_OUTLINE_MARGIN_M)]
    for outline in outlines:
        fill(outline, FREE)
    walls: list[Any] = [
        d.shape if d.shape.geom_type.endswith("LineString") else d.shape.boundary for d in of_kind["wall"]
    ]
    for d in of_kind["room"]:
        if doors and d.shape.boundary.intersects(near):
            fill(d.shape, FREE)
            walls.append(d.shape.boundary)
        else:
            fill(d.shape, ROOM)
    for d in of_kind["wall"]:
        if d.shape.geom_type.endswith("Polygon"):
            fill(d.shape, WALL)
    for d in of_kind["stairs"]:
        fill(d.shape, STAIRS)
    for d in of_kind["lift"]:
        fill(d.shape, LIFT)
    for wall in walls:
        _draw_line(cells, south_west, wall.difference(near) if doors else wall)
    features = tuple(_feature(d) for d in drawn)
    cells.flags.writeable = False
    return Storey(floor, features, read_only(south_west), cells)


def _draw_line(cells: NDArray[np.uint8], south_west_m: FloatArray, line: Any) -> None:
    """Set the cells along a line to WALL. Points a quarter of a cell apart leave no gap between wall cells."""
    import shapely

    for part in shapely.get_parts(line):
        ends = shapely.get_coordinates(part)
        for a, b in pairwise(ends):
            n = int(np.ceil(np.linalg.norm(b - a) / (CELL_M / 4))) + 1
            points = a + np.linspace(0.0, 1.0, n)[:, None] * (b - a)
            column, row = np.floor((points - south_west_m) / CELL_M).astype(int).T
            cells[row, column] = WALL


def _feature(drawn: _RawFeature) -> Feature:
    """Return the shape as a `Feature`: the rings of a polygon, or the parts of a line."""
    import shapely

    is_area = drawn.shape.geom_type.endswith("Polygon")
    lines: list[Any] = []
    for part in shapely.get_parts(drawn.shape):
        lines += [part.exterior, *part.interiors] if is_area else [part]
    return Feature(drawn.kind, drawn.name, tuple(read_only(shapely.get_coordinates(p)) for p in lines), is_area)
