"""Writing tracks: CSV, parquet, GeoJSON, GPX, KML, TUM. Each creates the folder, writes one file, returns its path."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import IO, Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from pdr_filter.values import FloatArray, Origin, TrackRows, limits, yaw_from_heading
from pdr_filter.values.optional_packages import load_optional
from pdr_filter.values.safe_files import whole_file, write_text
from pdr_filter.version import __version__

# Tracks that lie nowhere are drawn where the equator meets the prime meridian, in the open sea: nobody walks there, and
# a metre is a metre both ways.
NOWHERE = Origin(0.0, 0.0)
NOT_ON_EARTH = "local, not on Earth"


def write_csv(track: TrackRows, path: str | Path, origin: Origin | tuple[float, float] | None = None) -> Path:
    """Write one line for each step under a header with units, and return the path; only the header if no step.

    `origin` gives the track a geographic origin, with which it has columns of latitude, longitude and altitude, if any.
    """
    return write_text(path, _csv_text(_columns(track if origin is None else track.placed(origin)), with_header=True))


def _csv_text(columns: Mapping[str, FloatArray], with_header: bool) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    if with_header:
        writer.writerow(columns)
    formats = [_DIGITS.get(name, ".7g") for name in columns]
    for row in zip(*columns.values(), strict=True):
        writer.writerow([format(value, spec) for value, spec in zip(row, formats, strict=True)])
    return text.getvalue()


def write_parquet(track: TrackRows, path: str | Path, origin: Origin | tuple[float, float] | None = None) -> Path:
    """Write the columns of `write_csv` with all their digits, and return the path. Needs pandas and pyarrow.

    Name, notes, frame and origin of the track are metadata of the file: `attrs` of the DataFrame in pandas.
    """
    pandas_for_parquet(path)
    frame = track_frame(track, origin)
    with whole_file(path) as file:
        frame.to_parquet(file, engine="pyarrow", index=False)
    return Path(path)


# Rows of a group of a Parquet file: some hours of walking, 15 MB. Each group adds 20 kB of metadata.
_GROUP_ROWS = 50_000


class PiecesWriter:
    """Writer of consecutive pieces of a track into one CSV or Parquet file, whose suffix decides.

    The file has the rows of `write_csv` or `write_parquet` for the whole track. The first piece with rows decides the
    columns, because an earlier one may lack an origin.
    """

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        self._file, self._has_header = file, False
        self._writer: Any = None
        self._tables: list[Any] = []  # rows of the next row group
        self._is_parquet = path.suffix.lower() == ".parquet"
        if self._is_parquet:
            pandas_for_parquet(path)

    def __enter__(self) -> PiecesWriter:
        return self

    def __exit__(self, *_: object) -> None:
        """Release the Parquet file after an error. pyarrow would write to it later, when it is closed."""
        if self._writer is not None:
            self._writer.close()

    def write(self, piece: TrackRows) -> None:
        """Append the rows of a piece."""
        if piece.n_steps:
            self._append(piece)

    def _append(self, piece: TrackRows) -> None:
        if not self._is_parquet:
            self._file.write(_csv_text(_columns(piece), with_header=not self._has_header).encode())
        else:
            import pyarrow  # pyright: ignore
            import pyarrow.parquet  # pyright: ignore

            arrow: Any = pyarrow
            rows = arrow.Table.from_pandas(track_frame(piece), preserve_index=False).replace_schema_metadata()
            if self._writer is None:
                self._writer = arrow.parquet.ParquetWriter(self._file, rows.schema, store_schema=False)
            self._tables.append(rows)
            if sum(map(len, self._tables)) >= _GROUP_ROWS:
                self._write_group()
        self._has_header = True

    def _write_group(self) -> None:
        import pyarrow  # pyright: ignore

        arrow: Any = pyarrow
        self._writer.write_table(arrow.concat_tables(self._tables))
        self._tables.clear()

    def close(self, track: TrackRows) -> None:
        """Finish the file. Name, notes, frame and origin of the track are its metadata if it is a Parquet file."""
        if not self._has_header:
            self._append(track)
        if self._writer is not None:
            import pyarrow  # pyright: ignore

            arrow: Any = pyarrow
            self._write_group()
            metadata = arrow.Table.from_pandas(track_frame(track), preserve_index=False).schema.metadata
            self._writer.add_key_value_metadata(metadata)
            self._writer.close()


def track_frame(track: TrackRows, origin: Origin | tuple[float, float] | None = None) -> Any:
    """Return a pandas DataFrame with the columns of `write_csv`. Name, notes and frame are in its `attrs`."""
    placed = track if origin is None else track.placed(origin)
    frame: Any = load_optional("pandas", "Track.to_pandas").DataFrame(_columns(placed))
    frame.attrs = {
        "name": track.name,
        "weighting": track.weighting,
        "start_time_s": float(track.start_time_s),
        "duration_s": float(track.duration_s),
        "notes": list(track.notes),
        "frame": placed.about_frame,
        "origin": None if placed.origin is None else asdict(placed.origin),
        "pdr_filter": __version__,
    }
    return frame


def pandas_for_parquet(path: str | Path) -> Any:
    """Import pandas. ValueError with the extra to install if pandas or pyarrow is missing."""
    try:
        import pandas  # pyright: ignore
        import pyarrow  # noqa: F401  # pyright: ignore
    except ImportError as error:
        raise ValueError(
            f"{path}: parquet needs pandas and pyarrow, pip install 'pdr_filter[parquet]'; or write CSV"
        ) from error
    return pandas


# Digits of columns in CSV files that seven significant ones do not do justice.
_DIGITS = {"time_s": ".6f", "latitude_deg": ".9f", "longitude_deg": ".9f"}


def _columns(track: TrackRows) -> dict[str, FloatArray]:
    """Return name and values of each column of a track file, with one row for each step."""
    covariance = track.position_cov_m2.reshape(-1, 4)
    place: dict[str, FloatArray] = {}
    if track.origin is not None:
        place = {"latitude_deg": track.latitude_deg, "longitude_deg": track.longitude_deg}
    if track.altitude_m is not None:
        place["altitude_m"] = track.altitude_m
    by_phone = {"phone_n_steps": track.phone_n_steps, "phone_heading_rad": track.phone_heading_rad}
    return {
        "time_s": track.time_s,
        "east_m": track.position_m[:, 0],
        "north_m": track.position_m[:, 1],
        **place,
        "cov_ee_m2": covariance[:, 0],
        "cov_en_m2": covariance[:, 1],
        "cov_nn_m2": covariance[:, 3],
        "position_std_m": track.position_std_m,
        "step_length_m": track.step_length_m,
        "walked_m": track.walked_m,
        "walking_heading_rad": track.walking_heading_rad,
        **{name: values for name, values in by_phone.items() if len(values)},
        "smoothed_speed_mps": track.smoothed_speed_mps,
        "smoothed_speed_std_mps": track.smoothed_speed_std_mps,
        "height_m": track.height_m,
        "height_std_m": track.height_std_m,
        "floor": np.array(track.known_floor, dtype=float),
        "floor_prob": track.floor_prob,
        **{f"context_prob_{name}": track.context_prob[:, i] for i, name in enumerate(track.contexts)},
        **{f"mode_prob_{name}": track.mode_prob[:, i] for i, name in enumerate(track.modes)},
    }


def write_geojson(track: TrackRows, path: str | Path, origin: Origin | tuple[float, float] | None = None) -> Path:
    """Write a FeatureCollection with the track as one LineString in WGS 84, and return the path.

    The line has a vertex for the start and for each step. A track without steps is a Point. `origin` is the latitude
    and longitude in degrees of the point with east and north zero, if the track has none. Properties for each vertex
    are `coordTimes` (seconds of the recording), `covariance_m2` ([ee, en, nn]) and, with a third coordinate, `floor`
    (null where unknown). The third coordinate is the altitude if the origin has one, else the height above the start in
    m, if it changes; the property `height` says which. A track over 180 degrees of longitude is a MultiLineString that
    is cut there.
    """
    placed = track if origin is None else track.placed(origin)
    return _write_geojson(placed, path, track.name, placed.about_frame)


def write_local_geojson(track: TrackRows, path: str | Path) -> Path:
    """Write the shape of a track that has no place on Earth, and return the path, which ends in .local.geojson.

    Maps need degrees, so the origin is drawn at latitude and longitude 0, in the open sea, where lengths and angles are
    undistorted. Name, `frame` and `about` say that nobody walked there. ValueError for a track with a place on Earth.
    """
    if track.origin is not None:
        raise ValueError(f"the track {track.name!r} has a place on Earth: write it with to_geojson")
    path = Path(path)
    stem = path.name.removesuffix(".geojson").removesuffix(".local")
    about = f"{track.about_frame} Drawn at latitude and longitude 0 because maps need degrees: nobody walked there."
    name = f"{track.name} ({NOT_ON_EARTH})"
    return _write_geojson(track.placed(NOWHERE), path.with_name(f"{stem}.local.geojson"), name, about, NOT_ON_EARTH)


def write_map(track: TrackRows, path: str | Path) -> Path:
    """Write a track as GeoJSON, in local metres if it has no geographic origin, and return the path."""
    return write_local_geojson(track, path) if track.origin is None else write_geojson(track, path)


def _write_geojson(track: TrackRows, path: str | Path, name: str, about: str, frame: str | None = None) -> Path:
    vertices = _vertices(track)
    covariance = np.vstack([np.zeros((1, 3)), track.position_cov_m2.reshape(-1, 4)[:, [0, 1, 3]]])
    heights: dict[str, Any] = {}
    start_m = None if track.origin is None else track.origin.height_m
    if start_m is not None or not track.is_level:
        above_m = np.round((start_m or 0.0) + np.concatenate([[0.0], track.height_m]), 3).tolist()
        vertices = [[*vertex, height_m] for vertex, height_m in zip(vertices, above_m, strict=True)]
        floors = [*track.known_floor[:1], *track.known_floor]
        what = "metres above the start of the walk" if start_m is None else "altitude in metres, as its locations count"
        heights = {"height": what, "floor": floors}
    properties = {
        "name": name,
        "frame": frame or track.frame,
        "about": about,
        "distance_m": round(track.distance_m, 3),
        "n_steps": track.n_steps,
        "end_std_m": round(float(track.position_std_m[-1]), 3) if track.n_steps else None,
        "notes": list(track.notes),
        "coordTimes": np.round(_vertex_times(track), 6).tolist(),
        "covariance_m2": np.round(covariance, 6).tolist(),
        **heights,
    }
    return write_text(path, json.dumps(geojson_line(vertices, properties), allow_nan=False) + "\n")


# Properties of a line with a value for each vertex.
_OF_VERTICES = ("coordTimes", "covariance_m2", "floor")


def geojson_line(vertices: list[list[float]], properties: dict[str, Any]) -> dict[str, Any]:
    """Return a FeatureCollection with one line of vertices, or a point if there is one vertex only.

    A line over 180 degrees of longitude is cut there (RFC 7946, 3.1.9). Its properties of vertices are then lists of
    lists, as its coordinates are.
    """
    geometry: dict[str, Any] = {"type": "LineString", "coordinates": vertices}
    if len(vertices) == 1:
        geometry = {"type": "Point", "coordinates": vertices[0]}
    pieces = _pieces(np.array(vertices)[:, 0])
    if len(pieces) > 1:
        lines = [piece.vertices(vertices) for piece in pieces]
        geometry = {"type": "MultiLineString", "coordinates": lines}
        known = [name for name in _OF_VERTICES if name in properties]
        properties = properties | {name: [piece.at(properties[name]) for piece in pieces] for name in known}
    feature = {"type": "Feature", "geometry": geometry, "properties": properties}
    return {"type": "FeatureCollection", "features": [feature]}


class _Piece(NamedTuple):
    """Part of a line on one side of 180 degrees of longitude."""

    vertex: FloatArray  # index of its vertices in the line; a fraction for one that was inserted at 180 degrees
    longitude_deg: FloatArray

    def at(self, values: Sequence[Any]) -> list[Any]:
        """Return values of the line at the vertices of this part. Storeys and unknown values are not interpolated."""
        whole = self.vertex.astype(int)
        if any(value is None or isinstance(value, int) for value in values):
            return [values[k] for k in whole]
        array = np.array(values, dtype=float)
        after = array[np.minimum(whole + 1, len(array) - 1)]
        fraction = (self.vertex - whole).reshape(-1, *[1] * (array.ndim - 1))
        return np.round((1 - fraction) * array[whole] + fraction * after, 9).tolist()

    def vertices(self, vertices: Sequence[Sequence[float]]) -> list[list[float]]:
        """Return the vertices of this part, whose line has the given ones."""
        rows = zip(np.round(self.longitude_deg, 9).tolist(), self.at(vertices), strict=True)
        return [[longitude_deg, *row[1:]] for longitude_deg, row in rows]


def _pieces(longitude_deg: FloatArray) -> list[_Piece]:
    """Return the parts of a line, which is cut where it crosses 180 degrees of longitude: one for most lines."""
    along_deg = np.unwrap(longitude_deg, period=360)
    world = np.floor((along_deg + 180) / 360)
    last = np.flatnonzero(np.diff(world))
    edge_deg = 360 * np.maximum(world[last], world[last + 1]) - 180
    cuts = last + (edge_deg - along_deg[last]) / (along_deg[last + 1] - along_deg[last])
    every = np.arange(len(along_deg), dtype=float)
    ends = np.concatenate([[0.0], cuts, every[-1:]])
    found: list[_Piece] = []
    for first, begin, end in zip([0, *(last + 1)], ends[:-1], ends[1:], strict=True):
        index = np.unique(np.concatenate([[begin], every[(every > begin) & (every < end)], [end]]))
        if len(index) > 1 or len(every) == 1:
            found.append(_Piece(index, np.interp(index, every, along_deg) - 360 * world[first]))
    return found


def write_gpx(
    track: TrackRows, path: str | Path, origin: Origin | tuple[float, float] | None = None, epoch_s: float = 0.0
) -> Path:
    """Write a GPX 1.1 track from the start of the walk through all steps, and return the path.

    `origin` is that of `write_geojson`; with an altitude, points have an elevation. `epoch_s` is the unix time of time
    zero (`Recording.epoch_s`); with 0, the walk is in January 1970. ValueError without origin, or for a time not in
    1970 to 9999.
    """
    times_s = _vertex_times(track)
    if not (np.isfinite(epoch_s) and epoch_s + times_s.min() >= 0 and epoch_s + times_s.max() <= limits.MAX_EPOCH_S):
        raise ValueError(
            "epoch_s must be the unix time of time zero in seconds, with all times of the track in 1970 to 9999, got "
            f"{epoch_s} for times from {times_s.min():g} to {times_s.max():g} s"
        )
    placed = track if origin is None else track.placed(origin)
    root = ElementTree.Element(
        "gpx", version="1.1", creator=f"pdr_filter {__version__}", xmlns="http://www.topografix.com/GPX/1/1"
    )
    line = ElementTree.SubElement(root, "trk")
    _add(line, "name", track.name)
    _add(line, "desc", _description_with_notes(placed))
    start_m = None if placed.origin is None else placed.origin.height_m
    vertices = _vertices(placed)
    rows = np.column_stack([times_s, np.concatenate([[0.0], track.height_m])]).tolist()
    for piece in _pieces(np.array(vertices)[:, 0]):
        segment = ElementTree.SubElement(line, "trkseg")
        for (lon, lat), (time_s, height_m) in zip(piece.vertices(vertices), piece.at(rows), strict=True):
            point = ElementTree.SubElement(segment, "trkpt", lat=f"{lat:.9f}", lon=f"{lon:.9f}")
            if start_m is not None:
                _add(point, "ele", f"{start_m + height_m:.2f}")
            at = datetime.fromtimestamp(0, UTC) + timedelta(seconds=epoch_s + time_s)
            _add(point, "time", at.strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z")
    return _write_xml(path, root)


def write_kml(track: TrackRows, path: str | Path, origin: Origin | tuple[float, float] | None = None) -> Path:
    """Write a KML 2.2 document, for example for Google Earth, with track, start and end, and return the path.

    `origin` is that of `write_geojson`. The description has distance, steps, position error of the end, and notes.
    """
    placed = track if origin is None else track.placed(origin)
    vertices = _vertices(placed)
    root = ElementTree.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = ElementTree.SubElement(root, "Document")
    _add(document, "name", track.name)
    _add(document, "description", _description_with_notes(placed))
    style = ElementTree.SubElement(ElementTree.SubElement(document, "Style", id="way"), "LineStyle")
    _add(style, "color", "ffb27200")  # aabbggrr: the blue of the figures
    _add(style, "width", "4")
    if track.n_steps:
        way = _placemark(document, track.name, _description(placed))
        _add(way, "styleUrl", "#way")
        pieces = _pieces(np.array(vertices)[:, 0])
        parent = ElementTree.SubElement(way, "MultiGeometry") if len(pieces) > 1 else way
        for piece in pieces:
            _add_geometry(parent, "LineString", piece.vertices(vertices))
    _add_geometry(_placemark(document, "start", "Where the walk begins."), "Point", vertices[:1])
    if track.n_steps:
        end = _placemark(document, "end", f"After {track.distance_m:.1f} m, {track.how_sure}.")
        _add_geometry(end, "Point", vertices[-1:])
    return _write_xml(path, root)


def _placemark(document: ElementTree.Element, name: str, description: str) -> ElementTree.Element:
    placemark = ElementTree.SubElement(document, "Placemark")
    _add(placemark, "name", name)
    _add(placemark, "description", description)
    return placemark


def _add_geometry(placemark: ElementTree.Element, kind: str, vertices: list[list[float]]) -> None:
    """Add a line or a point on the ground to a placemark of a KML file."""
    geometry = ElementTree.SubElement(placemark, kind)
    if kind == "LineString":
        _add(geometry, "tessellate", "1")  # over hills, not through them
    _add(geometry, "coordinates", " ".join(",".join(f"{value:.9f}" for value in vertex) for vertex in vertices))


def _add(parent: ElementTree.Element, tag: str, text: str) -> None:
    """Add an element with a text. Control characters are removed, because XML cannot hold them even if escaped."""
    ElementTree.SubElement(parent, tag).text = "".join(c for c in text if c.isprintable())


def _description_with_notes(track: TrackRows) -> str:
    return " ".join([_description(track), *(f"Note: {note}." for note in track.notes)])


def _description(track: TrackRows) -> str:
    """Return a description of a track in two sentences."""
    return f"{track.n_steps} steps, {track.how_far}; end: {track.how_sure}. {track.about_frame}"


def _write_xml(path: str | Path, root: ElementTree.Element) -> Path:
    ElementTree.indent(root)
    return write_text(path, '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, "unicode") + "\n")


def write_tum(track: TrackRows, path: str | Path) -> Path:
    """Write lines `timestamp tx ty tz qx qy qz qw` with strictly ascending times, and return the path.

    The position is east, north and zero, in m. The quaternion rotates the x axis about up into the walking heading (yaw
    = pi/2 - heading). The first line is the start, with the heading of the first step.
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
    return write_text(path, "".join(lines))


# Function that writes each kind of file of a track, by the suffix of the file.
_WRITERS: dict[str, Callable[[TrackRows, Path], Path]] = {
    "csv": write_csv,
    "geojson": write_map,
    "gpx": write_gpx,
    "kml": write_kml,
    "parquet": write_parquet,
    "tum": write_tum,
}
KINDS = tuple(_WRITERS)
GEOGRAPHIC_KINDS = ("gpx", "kml")  # kinds that need a track with a place on Earth


def write_by_suffix(track: TrackRows, path: Path, epoch_s: float | None) -> Path:
    """Write a track in the format that the suffix of the file names, one of `KINDS`, and return the path.

    `epoch_s` is the unix time of time zero (`Recording.epoch_s`), which GPX files need.
    """
    if path.suffix == ".gpx":
        return write_gpx(track, path, epoch_s=epoch_s or 0.0)
    return _WRITERS[path.suffix[1:]](track, path)


def _vertex_times(track: TrackRows) -> FloatArray:
    """Return the times of the start and of all K steps, (K + 1,), in s."""
    return np.concatenate([[track.start_time_s], track.time_s])


def _vertices(track: TrackRows) -> list[list[float]]:
    """Return longitude and latitude in degrees of the start and of all K steps, K + 1 pairs, as GeoJSON orders them."""
    lat_deg, lon_deg = track.latitude_longitude_deg(np.vstack([track.start_position_m, track.position_m]))
    return np.round(np.column_stack([lon_deg, lat_deg]), 9).tolist()
