"""Path of a session as GeoJSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from pdr_filter.apps.live.settings import Event
from pdr_filter.values import Origin

# Origin of tracks with unknown place, in the Atlantic, like in the files of `data.io.files.track_writers`.
_NOWHERE = (0.0, 0.0)


def geojson(track: Event) -> dict[str, Any]:
    """Return the path of a `track` event as GeoJSON, at latitude and longitude 0 if its place on Earth is unknown."""
    path = np.array(track["path"] or [[0.0] * 6])
    origin = Origin(*(track["origin"] or _NOWHERE))
    latitude_deg, longitude_deg = origin.latitude_longitude_deg(path[:, 1:3])
    vertices = np.round(np.column_stack([longitude_deg, latitude_deg]), 9).tolist()
    line = {"type": "LineString", "coordinates": vertices}
    properties: dict[str, Any] = {
        "name": f"{track['device']} {track['session']}".strip(),
        "frame": "world" if track["origin"] else "local, not on Earth",
        "coordTimes": path[:, 0].tolist(),
        "covariance_m2": np.round(path[:, 3:], 6).tolist(),
    }
    geometry = line if len(vertices) > 1 else {"type": "Point", "coordinates": vertices[0]}
    feature = {"type": "Feature", "geometry": geometry, "properties": properties}
    return {"type": "FeatureCollection", "features": [feature]}
