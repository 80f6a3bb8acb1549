"""Synthetic storey and walks on it: corridors 2.4 m wide around a block, and a room to the west."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import pdr_filter as pdr
from pdr_filter.simulate import Gait, Leg, SensorError, SensorErrors


def box(west: float, south: float, east: float, north: float) -> dict[str, Any]:
    ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
    return {"type": "Polygon", "coordinates": [ring]}


def feature(kind: str, geometry: dict[str, Any], **properties: Any) -> dict[str, Any]:
    return {"type": "Feature", "properties": {"type": kind, **properties}, "geometry": geometry}


def line(*points: tuple[float, float]) -> dict[str, Any]:
    return {"type": "LineString", "coordinates": [list(p) for p in points]}


FEATURES = [
    feature("floor", box(-1.2, -1.2, 41.2, 19.2), name="ground"),
    feature("room", box(11.2, 1.2, 38.8, 16.8), name="block"),
    feature("room", box(-1.2, 1.2, 8.8, 19.2), name="west"),
]


def write(path: Path, features: list[dict[str, Any]] | None = None) -> Path:
    content = {"type": "FeatureCollection", "features": FEATURES if features is None else features}
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def turned(features: list[dict[str, Any]], angle_rad: float) -> list[dict[str, Any]]:
    """Return the features rotated clockwise about the origin."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)

    def of(values: Any) -> Any:
        if isinstance(values[0], list):
            return [of(v) for v in values]
        x, y = values
        return [c * x + s * y, c * y - s * x]

    return [{**f, "geometry": {**f["geometry"], "coordinates": of(f["geometry"]["coordinates"])}} for f in features]


def in_degrees(features: list[dict[str, Any]], origin: pdr.Origin) -> list[dict[str, Any]]:
    """Return the areas in longitude and latitude."""
    found: list[dict[str, Any]] = []
    for f in features:
        latitude, longitude = origin.latitude_longitude_deg(np.array(f["geometry"]["coordinates"][0]))
        ring = np.column_stack([longitude, latitude]).tolist()
        found.append({**f, "geometry": {**f["geometry"], "coordinates": [ring]}})
    return found


@cache
def round_the_block(seed: int = 0) -> pdr.Recording:
    """Return a walk from (0, 0) east along the south corridor, around the block, and back into the south corridor."""
    turn = -math.pi / 2  # counter-clockwise
    legs = [Leg("walking", distance_m=40.0)]
    legs += [Leg("walking", distance_m=d, turn_rad=turn) for d in (18.0, 30.0, 18.0, 25.0)]
    errors = SensorErrors(gyroscope=SensorError(noise_density=1e-4, bias_std=0.01))
    return pdr.simulate.simulate(
        legs, Gait(height_m=1.95), errors=errors, seed=seed, start_heading_rad=math.pi / 2, name="round the block"
    )
