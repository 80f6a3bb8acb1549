"""Writing tracks: CSV, parquet, GeoJSON, GPX and TUM. Each creates the folder, writes one file and returns its path."""

from __future__ import annotations

import csv
import io
import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from pdr_filter.io import limits
from pdr_filter.values import FloatArray, Origin, TrackRows, yaw_from_heading
from pdr_filter.version import __version__

_NORTH = (
    "North is true north only where an absolute heading was available, otherwise it is the direction of the device's "
    "heading at the start."
)
_FRAME = f"East and north are metres from the start of the walk. {_NORTH}"
FRAME_NOTE = f"East and north are metres from the start of the walk, mapped to WGS 84 at the given origin. {_NORTH}"
_TURNED = "East and north are metres from the start of the walk. North is where the magnetic field says."
_PLACED = "East and north are metres from the first location of the recording, which show where north is."


def write_csv(track: TrackRows, path: str | Path) -> Path:
    """Write one line for each step under a header with units, and return the path; only the header if no step."""
    columns = _columns(track)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for time_s, *row in zip(*columns.values(), strict=True):
        writer.writerow([f"{time_s:.6f}", *(f"{value:.7g}" for value in row)])
    return _write(path, text.getvalue())


def write_parquet(track: TrackRows, path: str | Path) -> Path:
    """Write the columns of `write_csv` with all their digits, and return the path.

    What is not in the columns is in the metadata, which pandas gives as `attrs` of the frame. Needs pandas and pyarrow.
    """
    pandas = pandas_for_parquet(path)
    frame: Any = pandas.DataFrame(_columns(track))
    frame.attrs = {
        "name": track.name,
        "weighting": track.weighting,
        "start_time_s": float(track.start_time_s),
        "duration_s": float(track.duration_s),
        "notes": list(track.notes),
        "frame": (_TURNED if track.frame == "north" else _FRAME) if track.origin is None else _PLACED,
        "pdr_filter": __version__,
    }
    frame.to_parquet(_in_new_folder(path), engine="pyarrow", index=False)
    return Path(path)


def pandas_for_parquet(path: str | Path) -> Any:
    """The module pandas; ValueError with the extra to install if it or pyarrow is missing."""
    try:
        import pandas  # pyright: ignore
        import pyarrow  # noqa: F401  # pyright: ignore
    except ImportError as error:
        raise ValueError(
            f"{path}: parquet needs pandas and pyarrow, pip install 'pdr_filter[parquet]'; or write CSV"
        ) from error
    return pandas


def _columns(track: TrackRows) -> dict[str, FloatArray]:
    """Name and values of each column, one row a step."""
    covariance = track.position_cov_m2.reshape(-1, 4)
    return {
        "time_s": track.time_s,
        "east_m": track.position_m[:, 0],
        "north_m": track.position_m[:, 1],
        "cov_ee_m2": covariance[:, 0],
        "cov_en_m2": covariance[:, 1],
        "cov_nn_m2": covariance[:, 3],
        "step_length_m": track.step_length_m,
        "walked_m": track.walked_m,
        "walking_heading_rad": track.walking_heading_rad,
        "smoothed_speed_mps": track.smoothed_speed_mps,
        "smoothed_speed_std_mps": track.smoothed_speed_std_mps,
        **{f"context_prob_{name}": track.context_prob[:, i] for i, name in enumerate(track.contexts)},
        **{f"mode_prob_{name}": track.mode_prob[:, i] for i, name in enumerate(track.modes)},
    }


def write_geojson(track: TrackRows, path: str | Path, origin: Origin | tuple[float, float] | None = None) -> Path:
    """Write a FeatureCollection with the track as one LineString in WGS 84, and return the path.

    The line begins at the start of the walk and has one vertex for each step; a track without steps is a Point.
    `origin` (latitude and longitude in degrees) is where east and north are zero: the start of the walk, but for a
    track in the frame of its fixes. One that its recording's locations placed has an origin of its own. Properties for
    each vertex: `coordTimes` (seconds of the recording) and `covariance_m2` ([ee, en, nn]).
    """
    lat_deg, lon_deg = _geodetic(track, origin)
    vertices = [[round(lon, 9), round(lat, 9)] for lat, lon in zip(lat_deg.tolist(), lon_deg.tolist(), strict=True)]
    covariance = np.vstack([np.zeros((1, 3)), track.position_cov_m2.reshape(-1, 4)[:, [0, 1, 3]]])
    line = {"type": "LineString", "coordinates": vertices}
    feature = {
        "type": "Feature",
        # a LineString needs two positions
        "geometry": line if len(vertices) > 1 else {"type": "Point", "coordinates": vertices[0]},
        "properties": {
            "name": track.name,
            "distance_m": round(track.distance_m, 3),
            "n_steps": track.n_steps,
            "coordTimes": np.round(_vertex_times(track), 6).tolist(),
            "covariance_m2": np.round(covariance, 6).tolist(),
            "frame": FRAME_NOTE if track.origin is None else _PLACED,
            "notes": list(track.notes),
        },
    }
    return _write(path, json.dumps({"type": "FeatureCollection", "features": [feature]}, allow_nan=False) + "\n")


def write_gpx(
    track: TrackRows, path: str | Path, origin: Origin | tuple[float, float] | None = None, epoch_s: float = 0.0
) -> Path:
    """Write a GPX 1.1 track from the start of the walk through all steps, and return the path.

    `origin` is that of `write_geojson`, and time zero of the recording is the unix time
    `epoch_s`; with 0 the walk is in January 1970.
    """
    times_s = _vertex_times(track)
    if not (np.isfinite(epoch_s) and epoch_s + times_s.min() >= 0 and epoch_s + times_s.max() <= limits.MAX_EPOCH_S):
        raise ValueError(f"epoch_s must be the unix time of time zero in seconds, 1970 to 9999, got {epoch_s}")
    root = ElementTree.Element(
        "gpx", version="1.1", creator=f"pdr_filter {__version__}", xmlns="http://www.topografix.com/GPX/1/1"
    )
    line = ElementTree.SubElement(root, "trk")
    frame = FRAME_NOTE if track.origin is None else _PLACED
    # XML cannot hold control characters, not even escaped
    ElementTree.SubElement(line, "name").text = "".join(c for c in track.name if c.isprintable())
    ElementTree.SubElement(line, "desc").text = f"{track.n_steps} steps, {track.distance_m:.1f} m. {frame}"
    segment = ElementTree.SubElement(line, "trkseg")
    for lat, lon, time_s in zip(*_geodetic(track, origin), times_s, strict=True):
        point = ElementTree.SubElement(segment, "trkpt", lat=f"{lat:.9f}", lon=f"{lon:.9f}")
        at = datetime.fromtimestamp(0, UTC) + timedelta(seconds=epoch_s + float(time_s))
        ElementTree.SubElement(point, "time").text = at.strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z"
    ElementTree.indent(root)
    return _write(path, '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, "unicode") + "\n")


def write_tum(track: TrackRows, path: str | Path) -> Path:
    """Write lines `timestamp tx ty tz qx qy qz qw` with strictly ascending times, and return the path.

    East, north, zero; the quaternion turns the x axis about up into the walking heading (yaw = pi/2 - heading). The
    first line is the start of the walk, with the heading of the first step.
    """
    heading_rad = np.concatenate([track.walking_heading_rad[:1], track.walking_heading_rad])
    half_yaw_rad = yaw_from_heading(heading_rad if track.n_steps else np.zeros(1)) / 2
    vertices = np.vstack([track.start_position_m, track.position_m])
    lines: list[str] = []
    last_s = -np.inf
    for time_s, (east_m, north_m), half_rad in zip(_vertex_times(track), vertices, half_yaw_rad, strict=True):
        written_s = round(float(time_s), 6)
        if written_s > last_s:  # tools that compare trajectories refuse repeated times
            rotation = f"{0.0:.9f} {0.0:.9f} {np.sin(half_rad):.9f} {np.cos(half_rad):.9f}"
            lines.append(f"{written_s:.6f} {east_m:.6f} {north_m:.6f} {0.0:.6f} {rotation}\n")
            last_s = written_s
    return _write(path, "".join(lines))


def _vertex_times(track: TrackRows) -> FloatArray:
    """Times of the start and of all steps, (K + 1,)."""
    return np.concatenate([[track.start_time_s], track.time_s])


def _geodetic(track: TrackRows, origin: Origin | tuple[float, float] | None) -> tuple[FloatArray, FloatArray]:
    """Latitude and longitude in degrees of the start and of all steps, (K + 1,) each."""
    return track.placed_at(origin).latitude_longitude_deg(np.vstack([track.start_position_m, track.position_m]))


def _write(path: str | Path, text: str) -> Path:
    _in_new_folder(path).write_text(text, encoding="utf-8", newline="\n")
    return Path(path)


def _in_new_folder(path: str | Path) -> Path:
    """The path, whose folder exists then."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    return Path(path)
