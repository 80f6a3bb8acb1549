"""Position fixes, ranges to anchors and loop closures from CSV files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pdr_filter.data.io.column_names import column_of
from pdr_filter.data.io.text_table import TextTable, to_number
from pdr_filter.offline.smoothing.observations import LoopClosure
from pdr_filter.values import FloatArray, HeadingFix, Origin, PositionFix, RangeFix, limits
from pdr_filter.values.origin import check_coordinates
from pdr_filter.values.safe_files import read_json, read_small
from pdr_filter.values.uncertainty import RADIUS_68

# Standard deviations in m of fixes and loop closures in files without the column std_m.
FIX_STD_M, LOOP_CLOSURE_STD_M = 1.0, 0.5
_MOST_FLOORS = 1000
# Anchors in degrees span less than 5.6 km, and anchors in metres more than 5 cm.
_MOST_DEG = 0.05


def fixes_of_file(
    path: str | Path, std_m: float = FIX_STD_M, origin: Origin | tuple[float, float] | None = None
) -> list[PositionFix | HeadingFix]:
    r"""Read position fixes, with headings and storeys if the file has them, from a CSV file.

    Parameters
    ----------
    path : str or Path
        CSV file with columns `time_s`, `east_m`, `north_m` and optionally `std_m`. Columns of latitude and longitude
        in degrees may replace `east_m` and `north_m`. Times are on the clock of the samples. Two optional columns,
        `heading_deg` and `heading_std_deg`, give the walking heading at the time of a fix, clockwise from north. The
        optional column `floor` gives the storey. Cells of optional columns are empty where the value is not known. In a
        file without `std_m`, a column of horizontal accuracy, such as `accuracy_m`, has the radius of 68 %.
    std_m : float, default 1.0
        Standard deviation in m of fixes without a value in the column `std_m` or of accuracy.
    origin : Origin or (latitude_deg, longitude_deg), optional
        Geographic origin of the track, for positions in degrees.

    Returns
    -------
    list of PositionFix and HeadingFix
        Position fixes in the order of the file, followed by the heading fixes.

    Raises
    ------
    ValueError
        If the file cannot be used. The message names the file, the line and the remedy.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pdr_filter.data.io.fix_files import fixes_of_file
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "fixes.csv")
    ...     _ = path.write_text("time_s,east_m,north_m\n12.5,3.0,4.0\n")
    ...     [(fix.time_s, fix.position_m.tolist()) for fix in fixes_of_file(path)]
    [(12.5, [3.0, 4.0])]
    """
    file = Path(path)
    optional = (("floor",), ("heading_deg", "heading_std_deg"), *_accuracy_in(file))
    degrees = degrees_in(file)
    rows = _rows(file, ("time_s", *(degrees or ("east_m", "north_m"))), "fixes", std_m, optional)
    if degrees:
        rows = _in_metres(file, rows, origin)
    fixes: list[PositionFix] = []
    headings: list[HeadingFix] = []
    for line, (t, east, north, std, floor, heading_deg, heading_std_deg, *accuracy_m), _ in rows:
        if accuracy_m and 0 < accuracy_m[0] < math.inf:  # iOS writes -1 for unknown
            std = accuracy_m[0] / RADIUS_68
        if math.isfinite(floor) and (floor != round(floor) or abs(floor) > _MOST_FLOORS):
            raise ValueError(
                f"{file}, line {line}: floor is {floor:g}; write the number of the storey, such as 0, or leave it empty"
            )
        storey = int(floor) if math.isfinite(floor) else None
        fixes.append(PositionFix(t, np.array([east, north]), std**2 * np.eye(2), floor=storey))
        if math.isfinite(heading_deg):
            try:
                headings.append(HeadingFix(t, math.radians(heading_deg), math.radians(heading_std_deg)))
            except ValueError as error:
                raise ValueError(
                    f"{file}, line {line}: heading_deg must be -360 to 360, and heading_std_deg positive and finite "
                    f"({error})"
                ) from None
    return [*fixes, *headings]


def _accuracy_in(path: Path) -> list[tuple[str]]:
    """Return the name of the column of horizontal accuracy in m, none if there is none or the file has `std_m`."""
    fields = TextTable([read_small(path, limits.MAX_WHOLE_BYTES)], str(path)).fields
    found = [column for i, name in enumerate(fields) if (column := column_of(i, name)).quantity == "accuracy"]
    found.sort(key=lambda column: -column.preference)
    return [(column.name,) for column in found[:1] if "std_m" not in fields]


def degrees_in(path: str | Path) -> tuple[str, str] | None:
    """Return the names of the columns of latitude and longitude in a file of fixes, or None if it has `east_m`."""
    fields = TextTable([read_small(Path(path), limits.MAX_WHOLE_BYTES)], str(path)).fields
    by_quantity = {column_of(i, name).quantity: name for i, name in reversed([*enumerate(fields)])}
    latitude, longitude = by_quantity.get("latitude"), by_quantity.get("longitude")
    return None if "east_m" in fields or latitude is None or longitude is None else (latitude, longitude)


def _in_metres(file: Path, rows: Sequence[_Row], origin: Origin | tuple[float, float] | None) -> list[_Row]:
    """Return rows of time, latitude and longitude with metres east and north of the origin in place of degrees."""
    for line, (_, latitude_deg, longitude_deg, *_), _ in rows:
        check_coordinates(f"{file}, line {line}: position", latitude_deg, longitude_deg)
    if origin is None:
        _, latitude_deg, longitude_deg, *_ = rows[0].values
        raise ValueError(
            f"{file}: the positions are in degrees, and the geographic origin of the track is unknown; give it here "
            f"and to the track, such as the first position: origin=({latitude_deg:.6f}, {longitude_deg:.6f}), or write "
            "east_m,north_m"
        )
    here, found = Origin.of(origin), list[_Row]()
    for row in rows:
        time_s, latitude_deg, longitude_deg, *more = row.values
        east_north_m = here.east_north_m(latitude_deg, longitude_deg)
        _check_near(file, row, here, float(np.hypot(*east_north_m)))
        found.append(row._replace(values=[time_s, *east_north_m.tolist(), *more]))
    return found


def _check_near(file: Path, row: _Row, origin: Origin, distance_m: float) -> None:
    """Raise ValueError if the position of a row, in degrees, is too far from the origin for a pedestrian."""
    if distance_m <= limits.MAX_FIX_DISTANCE_M:
        return
    _, latitude_deg, longitude_deg, *_ = row.values
    is_exchanged = abs(longitude_deg) <= 90 and (
        np.hypot(*origin.east_north_m(longitude_deg, latitude_deg)) <= limits.MAX_FIX_DISTANCE_M
    )
    cause = "latitude and longitude are exchanged" if is_exchanged else "the origin or the row is of another place"
    remedy = "exchange the two columns or the two numbers of the origin" if is_exchanged else "correct one of them"
    raise ValueError(
        f"{file}, line {row.line}: latitude {latitude_deg:g}, longitude {longitude_deg:g} is "
        f"{distance_m / 1000:,.0f} km from the origin, {origin.latitude_deg:g},{origin.longitude_deg:g}: "
        f"{cause}; {remedy}"
    )


def ranges_of_file(
    path: str | Path,
    anchors: str | Path | None = None,
    std_m: float = 0.3,
    origin: Origin | tuple[float, float] | None = None,
) -> list[RangeFix]:
    """Read ranges to anchors from a CSV file with columns `time_s`, `anchor`, `range_m` and optionally `std_m`.

    `anchors` is the GeoJSON file for `anchors_of_file`. Without it, columns `anchor_east_m` and `anchor_north_m`
    replace the column `anchor`. Times are on the clock of the samples. `std_m` (m) is for files without that column.
    `origin` is the geographic origin of the track, for anchors in degrees. ValueError names the file, the line and the
    remedy.
    """
    file = Path(path)
    fields = TextTable([read_small(file, limits.MAX_WHOLE_BYTES)], str(file)).fields
    if anchors is None:
        if "anchor" in fields and "anchor_east_m" not in fields:
            raise ValueError(
                f"{file}: the column anchor names anchors, but their positions are unknown: give the file of the "
                "anchors, --anchors anchors.geojson, or columns anchor_east_m,anchor_north_m"
            )
        rows = _rows(file, ("time_s", "anchor_east_m", "anchor_north_m", "range_m"), "ranges", std_m)
        return [_range(file, line, t, np.array([e, n]), r, std) for line, (t, e, n, r, std), _ in rows]
    places = anchors_of_file(anchors, origin)
    rows = _rows(file, ("time_s", "range_m"), "ranges", std_m)
    if "anchor" not in fields:
        raise ValueError(f"{file}: no column anchor (found: {', '.join(fields)[:160]}); write the name of each anchor")
    column = fields.index("anchor")
    found: list[RangeFix] = []
    for line, (t, r, std), cells in rows:
        name = cells[column].strip() if column < len(cells) else ""
        if name not in places:
            raise ValueError(
                f"{file}, line {line}: {anchors} has no anchor {name[:60]!r} (it has {', '.join(places)[:160]}); add "
                "it, or correct the name"
            )
        found.append(_range(file, line, t, places[name], r, std))
    return found


def _range(file: Path, line: int, time_s: float, anchor_m: FloatArray, range_m: float, std_m: float) -> RangeFix:
    try:
        return RangeFix(time_s, anchor_m, range_m, std_m)
    except ValueError as error:
        raise ValueError(f"{file}, line {line}: {error}") from None


def anchors_of_file(path: str | Path, origin: Origin | tuple[float, float] | None = None) -> Mapping[str, FloatArray]:
    """Read the positions of anchors by name from a GeoJSON FeatureCollection of points with a property `name`.

    Coordinates are metres east and north, or longitude and latitude, which are converted to metres from `origin`. A
    third coordinate is the height of the anchor above the phone in m. Anchors that span at most 0.05 are taken as
    degrees; a single anchor, and anchors on both sides of 180 degrees, only within 0.05 of `origin`. ValueError names
    the file, the point and the remedy.
    """
    file = Path(path)
    content: Any = read_json(file, limits.MAX_PLAN_BYTES)
    found = dict[str, FloatArray]()
    try:
        for feature in content["features"]:
            name, geometry = str(feature["properties"]["name"]).strip(), feature["geometry"]
            place = np.array(geometry["coordinates"], dtype=float)
            if geometry["type"] != "Point" or place.shape not in ((2,), (3,)) or not np.isfinite(place).all():
                raise ValueError(f"the geometry of {name[:60]!r} is not a point with two or three finite coordinates")
            if name in found:
                raise ValueError(f"two points are named {name[:60]!r}")
            found[name] = place
        if not found:
            raise ValueError("no points")
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{file}: the anchors must be GeoJSON points, each with its own property name ({error}); correct the "
            "file, or export the anchors as points from QGIS"
        ) from None
    flat = np.array([place[:2] for place in found.values()])
    here = None if origin is None else Origin.of(origin)
    is_near = False
    if here is not None:
        from_origin = flat - (here.longitude_deg, here.latitude_deg)
        from_origin[:, 0] = (from_origin[:, 0] + 180) % 360 - 180  # which may be on the other side of 180 degrees
        is_near = bool(np.abs(from_origin).max() <= _MOST_DEG)
    if not is_near and (len(flat) == 1 or float(np.ptp(flat, axis=0).max()) > _MOST_DEG):
        return found
    if here is None:
        raise ValueError(
            f"{file}: the anchors span at most {_MOST_DEG}, which is taken as degrees, but the geographic origin of "
            "the track is unknown; give the origin (--origin LAT,LON), or anchors in metres that lie further apart"
        )
    return {n: np.array([*here.east_north_m(float(p[1]), float(p[0])), *p[2:]]) for n, p in found.items()}


def loop_closures_of_file(path: str | Path, std_m: float = LOOP_CLOSURE_STD_M) -> list[LoopClosure]:
    """Read loop closures from a CSV file with columns `first_s`, `second_s` and optionally `std_m`.

    Times are on the clock of the samples. `std_m` (m) is for files without that column. ValueError names the file, the
    line and the remedy.
    """
    rows = _rows(Path(path), ("first_s", "second_s"), "loop closures", std_m)
    for line, (first_s, second_s, _), _ in rows:
        if not first_s < second_s:
            remedy = "exchange the two" if first_s > second_s else "correct one of them, or leave the row out"
            raise ValueError(
                f"{path}, line {line}: first_s must be before second_s, got {first_s:.15g} and {second_s:.15g}; "
                f"{remedy}"
            )
    return [LoopClosure(*row.values) for row in rows]


class _Row(NamedTuple):
    """Row of a table, with its line in the file."""

    line: int
    values: list[float]
    cells: list[str]


def _rows(
    file: Path, names: tuple[str, ...], what: str, std_m: float, optional: Sequence[tuple[str, ...]] = ()
) -> list[_Row]:
    """Return the values of the columns `names` in each row, a standard deviation in m, and groups of optional columns.

    The standard deviation is `std_m` in a file without that column, and in empty cells of it. Optional values are NaN
    in empty cells, and in a file without the first column of the group. Cells may be missing at the end of a row.
    `what` names the rows in messages. ValueError if a value is missing, a standard deviation is not positive, or the
    table has no row.
    """
    table = TextTable([read_small(file, limits.MAX_WHOLE_BYTES)], str(file))
    table.places(names)
    if not 0 < std_m < math.inf:
        raise ValueError(f"std_m must be a positive number, got {std_m:g}")
    known = [group for group in (("std_m",), *optional) if group[0] in table.fields]
    place = {name: i for i, name in enumerate(table.fields)}
    table.places(tuple(name for group in known for name in group))
    found: list[_Row] = []
    for line, cells in table.numbered_rows():
        if len(found) == limits.MAX_FIXES:
            raise ValueError(f"{file}: more than {limits.MAX_FIXES} {what}; leave out some")
        where = f"{file}, line {line}"
        values = [_value(where, cells, name, place) for name in names]
        if not all(map(math.isfinite, values)):
            raise ValueError(f"{where}: {','.join(names)} must all be numbers; leave the row out")
        own_m = _value(where, cells, "std_m", place)
        own_m = std_m if math.isnan(own_m) else own_m
        if not 0 < own_m < math.inf:
            raise ValueError(f"{where}: std_m is {own_m:g}; write a positive number")
        more = [
            _value(where, cells, name, place) if group in known else math.nan for group in optional for name in group
        ]
        found.append(_Row(line, [*values, own_m, *more], cells))
    if not found:
        raise ValueError(f"{file}: no {what} below the line {','.join(table.fields)[:160]}; write one in each line")
    return found


def _value(where: str, cells: Sequence[str], name: str, place: Mapping[str, int]) -> float:
    """Return the number in a column of a row, NaN if it is empty or missing. ValueError for other texts."""
    cell = cells[place[name]] if name in place and place[name] < len(cells) else ""
    number = to_number(cell)
    if number is None:
        raise ValueError(
            f"{where}, column {name}: {cell.strip()[:60]!r} is not a number; use '.' as decimal point, and leave "
            "unknown values empty"
        )
    return number
