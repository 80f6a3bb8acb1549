"""Path of a session as GeoJSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from pdr_filter.apps.live.settings import Event
from pdr_filter.data.io.files.track_writers import NOT_ON_EARTH, NOWHERE, geojson_line
from pdr_filter.values import Origin


def geojson(track: Event) -> dict[str, Any]:
    """Return the path of a `track` event as GeoJSON, at latitude and longitude 0 if its place on Earth is unknown."""
    path = np.array(track["path"] or [[0.0] * 6])
    origin = Origin(*track["origin"]) if track["origin"] else NOWHERE
    latitude_deg, longitude_deg = origin.latitude_longitude_deg(path[:, 1:3])
    vertices = np.round(np.column_stack([longitude_deg, latitude_deg]), 9).tolist()
    properties: dict[str, Any] = {
        "name": f"{track['device']} {track['session']}".strip(),
        "frame": "world" if track["origin"] else NOT_ON_EARTH,
        "coordTimes": path[:, 0].tolist(),
        "covariance_m2": np.round(path[:, 3:], 6).tolist(),
    }
    return geojson_line(vertices, properties)
