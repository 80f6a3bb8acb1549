"""Likely mistakes in a drawing of a floor plan: open walls, crossing outlines, no entrance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

# A wall that ends within this distance of another line meets it.
_MEETS_M = 0.3


def problems_of(features: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the problems of GeoJSON features in metres as dicts with "words", a sentence, and "feature".

    "feature" is the index of the feature, or None for a problem of a whole storey. A plan with problems may still be
    usable. `FloorPlan.read` rejects a plan that is not.
    """
    import shapely
    import shapely.geometry
    from shapely.validation import explain_validity

    found: list[dict[str, Any]] = []

    def add(number: int | None, words: str) -> None:
        found.append({"feature": number, "words": words})

    shapes = [shapely.geometry.shape(feature["geometry"]) for feature in features]
    kinds = [str(feature["properties"].get("type")) for feature in features]
    floors = [int(feature["properties"].get("floor") or 0) for feature in features]
    for number, shape in enumerate(shapes):
        if not shape.is_valid:
            add(number, f"the outline crosses itself ({explain_validity(shape)}): move its corners")
        elif shape.geom_type == "Polygon" and shape.area < 0.1:
            add(number, f"the area is only {shape.area:.2f} m2: delete it, or correct the scale")
    for floor in sorted(set(floors)):
        own = [k for k in range(len(shapes)) if floors[k] == floor and shapes[k].is_valid]
        outlines = [shapes[k] for k in own if kinds[k] == "floor"]
        doors = [shapes[k] for k in own if kinds[k] == "door"]
        if not outlines:
            add(None, f"floor {floor} has no outline: draw the area that people walk on as floor")
        edges = [shape.boundary for shape in outlines]
        if doors and outlines:
            is_entered = any(edge.distance(door) <= _MEETS_M for edge in edges for door in doors)
        else:
            is_entered = any(kinds[k] in ("stairs", "lift") for k in own)
        if outlines and not is_entered:
            add(None, f"floor {floor} has no entrance: draw a door on its outline, or stairs or a lift")
        for k in own:
            if kinds[k] != "wall" or shapes[k].geom_type != "LineString" or shapes[k].is_ring:
                continue
            lines = [shapes[j] for j in own if j != k and kinds[j] in ("wall", "door")] + edges
            lines += [shapes[j].boundary for j in own if kinds[j] in ("room", "stairs", "lift")]
            for end in (shapely.Point(shapes[k].coords[0]), shapely.Point(shapes[k].coords[-1])):
                if not any(line.distance(end) <= _MEETS_M for line in lines):
                    add(k, f"the wall is open at {end.x:.1f}, {end.y:.1f}: move its end onto another line")
    return found
