"""Floor plans of the workbench: GeoJSON files with the pictures that they were drawn over.

The editor works in metres in the frame of the picture. Two points with known latitude and longitude put the plan on
Earth: its features are then saved in degrees, and the collection has a property `georeference` to come back by.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from pdr_filter.apps.maps.floor_plan import FloorPlan
from pdr_filter.apps.maps.plan_checks import problems_of
from pdr_filter.apps.workbench.walks import PLANS, ConflictError
from pdr_filter.values import FloatArray, Origin, limits
from pdr_filter.values.safe_files import read_json, write_text
from pdr_filter.values.sanitise import file_name, free_name

# Two points disagree with the scale of the picture if their distances differ by more.
_MAX_SCALE_ERROR = 0.05
_DIGITS_DEG, _DIGITS_M = 9, 3
# Scale that plan.js assumes for a picture without a scale.
_METRES_PER_PIXEL = 0.05


class Plans:
    """Floor plans in the folder `plans`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / PLANS
        self._saving = Lock()  # saves run in threads: the version must not change between the check and the write

    def names(self) -> list[str]:
        """Names of all floor plans in the folder, sorted."""
        return sorted(path.stem for path in self.folder.glob("*.geojson"))

    def path(self, name: str) -> Path | None:
        """Return the file of a floor plan, or None if it does not exist.

        Only names of existing files become paths, so that a request cannot reach other files.
        """
        return next((path for path in self.folder.glob("*.geojson") if path.stem == name), None)

    def new(self, name: str, text: str = "") -> str:
        """Make an empty plan, or one from the text of a GeoJSON file, and return its name.

        The name may differ from the given one. ValueError if the editor cannot show the plan.
        """
        stem = file_name(name.strip() or "plan").replace("#", "_").replace("%", "_")
        free = free_name(stem, self.names().__contains__)
        path = self.folder / f"{free}.geojson"
        write_text(path, text or json.dumps({"type": "FeatureCollection", "name": free, "features": []}) + "\n")
        try:
            if not isinstance(self.load(free)["features"], list):
                raise ValueError("it has no features")
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            path.unlink()
            words = str(error).replace(f"{path}: ", "")
            raise ValueError(f"{name[:80]} cannot be shown as a floor plan: {words}; export it as GeoJSON") from None
        return free

    def picture(self, name: str, floor: int) -> Path:
        """File of the picture of a storey."""
        return self.folder / f"{name}.{floor}.png"

    def load(self, name: str) -> dict[str, Any]:
        """Return a plan in metres as the editor knows it: version, features, storeys, georeference and problems."""
        path = self._existing(name)
        content = read_json(path, limits.MAX_PLAN_BYTES)
        properties = content.get("properties") or {}
        features = [_plain(feature) for feature in content.get("features", [])]
        reference = properties.get("georeference")
        storeys = properties.get("storeys") or {}
        if not reference and features:
            reference = _reference_of(np.concatenate([_points(f["geometry"]["coordinates"]) for f in features]))
        if reference:
            features = _moved(features, PictureGeoreference.of(reference).to_metres, _DIGITS_M)
        for feature in features:
            storeys.setdefault(str(feature["properties"].get("floor") or 0), {})
        return {
            "name": name,
            "version": _version(path),
            "features": features,
            "storeys": storeys or {"0": {}},
            "georeference": reference,
            **self._checked(path, features),
        }

    def save(self, name: str, version: str, content: Mapping[str, Any]) -> dict[str, Any]:
        """Replace a plan and return it as `load` does. ConflictError if the plan has another version.

        A plan that `FloorPlan.read` rejects is saved, too. The result then has the error message as `reason`.
        """
        path = self._existing(name)
        features = [_plain(feature) for feature in content["features"]]
        reference = content.get("georeference")
        properties = {"storeys": dict(content["storeys"]), "georeference": reference}
        if reference:
            features = _moved(features, PictureGeoreference.of(reference).to_degrees, _DIGITS_DEG)
        plan = {"type": "FeatureCollection", "name": name, "properties": properties, "features": features}
        with self._saving:
            if _version(path) != version:
                raise ConflictError("another browser or program has changed this plan in the meantime: reload the page")
            self._write(path, plan)
        return self.load(name)

    def _existing(self, name: str) -> Path:
        path = self.path(name)
        if path is None:
            raise ValueError(f"there is no floor plan {name[:80]!r}: it was deleted or renamed; load the page again")
        return path

    def _checked(self, path: Path, features: list[dict[str, Any]]) -> dict[str, Any]:
        """Return the `problems` of a drawn plan, and as `reason` the error message of `FloorPlan.read`."""
        found: dict[str, Any] = {"problems": [], "reason": ""}
        if features:
            try:
                found["problems"] = problems_of(features)
            except Exception:  # a damaged geometry can raise any error
                found["reason"] = "the plan could not be checked"
            try:
                FloorPlan.read(path)
            except ValueError as error:
                found["reason"] = str(error).replace(f"{path}: ", "")
        return found

    def _write(self, path: Path, content: Mapping[str, Any]) -> None:
        write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


class PictureGeoreference:
    """Rotation and shift from the frame of a picture to east and north of an origin."""

    def __init__(self, origin: Origin, turn_rad: float, zero_m: FloatArray) -> None:
        self.origin, self.zero_m = origin, zero_m  # position of the origin in the frame of the picture
        cosine, sine = math.cos(turn_rad), math.sin(turn_rad)
        self.rotation = np.array([[cosine, -sine], [sine, cosine]])

    @classmethod
    def of(cls, reference: Mapping[str, Any]) -> PictureGeoreference:
        """The georeference of two `points`, each east and north (m), latitude and longitude (degrees).

        ValueError if the distances of the two differ by more than 5 %, or are at most 1 m.
        """
        try:
            first, second = (tuple(map(float, point)) for point in reference["points"])
            (x0, y0, latitude, longitude), (x1, y1, *there) = first, second
        except (KeyError, TypeError, ValueError):
            raise ValueError("a georeference needs two points, each with east, north, latitude, longitude") from None
        origin, other = Origin.of((latitude, longitude)), Origin.of((there[0], there[1]))
        drawn = np.array([x1 - x0, y1 - y0])
        true = origin.east_north_m(other.latitude_deg, other.longitude_deg)
        drawn_m, true_m = float(np.hypot(*drawn)), float(np.hypot(*true))
        if not drawn_m > 1.0:
            raise ValueError(f"the two points are {drawn_m:.1f} m apart in the plan: choose points more than 1 m apart")
        if abs(true_m / drawn_m - 1.0) > _MAX_SCALE_ERROR:
            raise ValueError(
                f"the two points are {drawn_m:.1f} m apart in the plan and {true_m:.1f} m on Earth: correct the scale "
                "of the picture, or the latitudes and longitudes"
            )
        turn_rad = math.atan2(true[1], true[0]) - math.atan2(drawn[1], drawn[0])
        return cls(origin, turn_rad, np.array([x0, y0]))

    def to_degrees(self, position_m: FloatArray) -> FloatArray:
        """Longitude and latitude (N, 2) of positions (N, 2) in the frame of the picture."""
        latitude, longitude = self.origin.latitude_longitude_deg((position_m - self.zero_m) @ self.rotation.T)
        return np.column_stack([longitude, latitude])

    def to_metres(self, coordinates: FloatArray) -> FloatArray:
        """Positions (N, 2) in the frame of the picture of longitude and latitude (N, 2)."""
        return self.origin.east_north_m(coordinates[:, 1], coordinates[:, 0]) @ self.rotation + self.zero_m


def pictures_of(path: Path, origin: Origin | None) -> list[dict[str, Any]]:
    """Return the pictures of the storeys of a plan in the frame of `origin`, or in its own metres without an origin.

    Each has the number `floor`, the `stamp` of its last change, and its south-west, south-east and north-west
    `corners` in m.
    """
    properties = read_json(path, limits.MAX_PLAN_BYTES).get("properties") or {}
    reference, pictures = properties.get("georeference"), list[dict[str, Any]]()
    for floor, storey in (properties.get("storeys") or {}).items():
        if storey.get("width"):
            size_m = np.array([storey["width"], storey["height"]]) * (
                storey.get("metres_per_pixel") or _METRES_PER_PIXEL
            )
            corners_m = np.array([[0.0, 0.0], [size_m[0], 0.0], [0.0, size_m[1]]])
            if reference and origin is not None:
                longitude, latitude = PictureGeoreference.of(reference).to_degrees(corners_m).T
                corners_m = origin.east_north_m(latitude, longitude)
            pictures.append({"floor": int(floor), "stamp": storey.get("stamp"), "corners": corners_m.tolist()})
    return pictures


def _reference_of(points: FloatArray) -> dict[str, Any] | None:
    """Return the georeference of a plan with the corners `points` (N, 2), or None if these are not degrees.

    A plan from a program other than the workbench has no georeference stored with it. The georeference maps the
    south-west and the north-east corner of a plan in longitude and latitude, with north up.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    if float((high - low).max()) > 0.05 or (np.abs(points) > [180.0, 90.0]).any():
        return None
    origin = Origin(float(low[1]), float(low[0]))
    east_m, north_m = origin.east_north_m(float(high[1]), float(high[0])).tolist()
    return {"points": [[0.0, 0.0, low[1], low[0]], [east_m, north_m, high[1], high[0]]]}


def _points(coordinates: Any) -> FloatArray:
    return np.array([pair[:2] for pair in _flat(coordinates)], dtype=float)


def _flat(coordinates: Any) -> list[Any]:
    """Return the coordinate pairs of a GeoJSON geometry as a flat list."""
    if isinstance(coordinates[0], float | int):
        return [coordinates]
    return [pair for part in coordinates for pair in _flat(part)]


def _moved(features: list[dict[str, Any]], move: Any, digits: int) -> list[dict[str, Any]]:
    """Return the features with transformed coordinates, rounded to `digits` decimals. Third coordinates are dropped.

    `move` transforms positions (N, 2).
    """

    def moved(coordinates: Any) -> Any:
        if isinstance(coordinates[0], float | int):
            return np.round(move(np.array([coordinates[:2]], dtype=float))[0], digits).tolist()
        return [moved(part) for part in coordinates]

    return [
        feature | {"geometry": feature["geometry"] | {"coordinates": moved(feature["geometry"]["coordinates"])}}
        for feature in features
    ]


def _plain(feature: Any) -> dict[str, Any]:
    """Return a feature with only the fields that a floor plan uses.

    ValueError if the geometry is missing, unreadable, not finite or of an unknown type. Properties may be missing.
    """
    try:
        geometry, properties = feature["geometry"], feature.get("properties") or {}
        points = np.array(_flat(geometry["coordinates"]), dtype=float)
        if not np.isfinite(points).all() or geometry["type"] not in _GEOMETRIES:
            raise ValueError(geometry["type"])
        known = {name: properties[name] for name in ("type", "floor", "name") if properties.get(name) not in (None, "")}
        plain = {"type": geometry["type"], "coordinates": geometry["coordinates"]}
        return {"type": "Feature", "properties": known, "geometry": plain}
    except (IndexError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(f"not a feature of a floor plan ({error}): {str(feature)[:80]}; delete it") from None


_GEOMETRIES = ("LineString", "MultiLineString", "Polygon", "MultiPolygon")


def _version(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
