"""Position fixes, ranges to anchors and loop closures from CSV files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter.data.io.text_table import TextTable, text_rows
from pdr_filter.offline.smoothing.observations import LoopClosure
from pdr_filter.values import FloatArray, HeadingFix, Origin, PositionFix, RangeFix, limits
from pdr_filter.values.safe_files import read_json, read_small

# Standard deviations in m of fixes and loop closures in files without the column std_m.
FIX_STD_M, LOOP_CLOSURE_STD_M = 1.0, 0.5
_MOST_FLOORS = 1000
# Anchors in degrees span less than 5.6 km, and anchors in metres more than 5 cm.
_MOST_DEG = 0.05


def fixes_of_file(path: str | Path, std_m: float = FIX_STD_M) -> list[PositionFix | HeadingFix]:
    r"""Read position fixes, with headings and storeys if the file has them, from a CSV file.

    Parameters
    ----------
    path : str or Path
        CSV file with columns `time_s`, `east_m`, `north_m` and optionally `std_m`. Times are on the clock of the
        samples. Two optional columns, `heading_deg` and `heading_std_deg`, give the walking heading at the time of a
        fix, clockwise from north. The optional column `floor` gives the storey. Cells of optional columns are empty
        where the value is not known.
    std_m : float, default 1.0
        Standard deviation in m of fixes in a file without the column `std_m`.

    Returns
    -------
    list of PositionFix and HeadingFix
        Position fixes in the order of the file, followed by the heading fixes.

    Raises
    ------
    ValueError
        If the file cannot be used. The message names the file, the row and the remedy.
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
    optional = (("floor",), ("heading_deg", "heading_std_deg"))
    rows = _rows(file, ("time_s", "east_m", "north_m"), "fixes", std_m, optional)
    fixes: list[PositionFix] = []
    headings: list[HeadingFix] = []
    for k, (t, east, north, std, floor, heading_deg, heading_std_deg) in enumerate(rows, 1):
        if math.isfinite(floor) and (floor != round(floor) or abs(floor) > _MOST_FLOORS):
            raise ValueError(
                f"{file}, row {k}: floor is {floor:g}; write the number of the storey, such as 0, or leave it empty"
            )
        storey = int(floor) if math.isfinite(floor) else None
        fixes.append(PositionFix(t, np.array([east, north]), std**2 * np.eye(2), floor=storey))
        if math.isfinite(heading_deg):
            try:
                headings.append(HeadingFix(t, math.radians(heading_deg), math.radians(heading_std_deg)))
            except ValueError as error:
                raise ValueError(f"{file}, row {k}: heading_std_deg must be positive and finite ({error})") from None
    return [*fixes, *headings]


def ranges_of_file(
    path: str | Path,
    anchors: str | Path | None = None,
    std_m: float = 0.3,
    origin: Origin | tuple[float, float] | None = None,
) -> list[RangeFix]:
    """Read ranges to anchors from a CSV file with columns `time_s`, `anchor`, `range_m` and optionally `std_m`.

    `anchors` is the GeoJSON file for `anchors_of_file`. Without it, columns `anchor_east_m` and `anchor_north_m`
    replace the column `anchor`. Times are on the clock of the samples. `std_m` (m) is for files without that column.
    `origin` is the geographic origin of the track, for anchors in degrees. ValueError names the file, the row and the
    remedy.
    """
    file = Path(path)
    header, *lines = text_rows(read_small(file, limits.MAX_WHOLE_BYTES), str(file)) or [[]]
    fields = [field.strip() for field in header]
    if anchors is None:
        if "anchor" in fields and "anchor_east_m" not in fields:
            raise ValueError(
                f"{file}: the column anchor names anchors, but their positions are unknown: give the file of the "
                "anchors, --anchors anchors.geojson, or columns anchor_east_m,anchor_north_m"
            )
        rows = _rows(file, ("time_s", "anchor_east_m", "anchor_north_m", "range_m"), "ranges", std_m)
        return [_range(file, k, t, np.array([e, n]), r, std) for k, (t, e, n, r, std) in enumerate(rows)]
    places = anchors_of_file(anchors, origin)
    rows = _rows(file, ("time_s", "range_m"), "ranges", std_m)
    if "anchor" not in fields:
        raise ValueError(f"{file}: no column anchor (found: {', '.join(fields)[:160]}); write the name of each anchor")
    column = fields.index("anchor")
    names = [line[column].strip() if column < len(line) else "" for line in lines[: len(rows)]]
    unknown = next((k for k, name in enumerate(names) if name not in places), None)
    if unknown is not None:
        raise ValueError(
            f"{file}, row {unknown + 1}: {anchors} has no anchor {names[unknown][:60]!r} (it has "
            f"{', '.join(places)[:160]}); add it, or correct the name"
        )
    named = zip(names, rows, strict=True)
    return [_range(file, k, t, places[name], r, std) for k, (name, (t, r, std)) in enumerate(named)]


def _range(file: Path, row: int, time_s: float, anchor_m: FloatArray, range_m: float, std_m: float) -> RangeFix:
    try:
        return RangeFix(time_s, anchor_m, range_m, std_m)
    except ValueError as error:
        raise ValueError(f"{file}, row {row + 1}: {error}") from None


def anchors_of_file(path: str | Path, origin: Origin | tuple[float, float] | None = None) -> Mapping[str, FloatArray]:
    """Read the positions of anchors by name from a GeoJSON FeatureCollection of points with a property `name`.

    Coordinates are metres east and north, or longitude and latitude, which are converted to metres from `origin`. A
    third coordinate is the height of the anchor above the phone in m. Anchors that span at most 0.05 are taken as
    degrees; a single anchor only within 0.05 of `origin`. ValueError names the file, the point and the remedy.
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
    is_near = here is not None and bool(np.abs(flat - (here.longitude_deg, here.latitude_deg)).max() <= _MOST_DEG)
    if float(np.ptp(flat, axis=0).max()) > _MOST_DEG or (len(flat) == 1 and not is_near):
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
    row and the remedy.
    """
    rows = _rows(Path(path), ("first_s", "second_s"), "loop closures", std_m)
    back = next((k for k, (first_s, second_s, _) in enumerate(rows) if not first_s < second_s), None)
    if back is not None:
        first_s, second_s, _ = rows[back]
        remedy = "exchange the two" if first_s > second_s else "correct one of them, or leave the row out"
        raise ValueError(
            f"{path}, row {back + 1}: first_s must be before second_s, got {first_s:.15g} and {second_s:.15g}; {remedy}"
        )
    return [LoopClosure(*row) for row in rows]


def _rows(
    file: Path, names: tuple[str, ...], what: str, std_m: float, optional: Sequence[tuple[str, ...]] = ()
) -> list[list[float]]:
    """Return the values of the columns `names` in each row, a standard deviation in m, and groups of optional columns.

    The standard deviation is `std_m` in a file without that column. Optional values are NaN in empty cells, and in a
    file without the first column of the group. `what` names the rows in messages. ValueError if a value is missing, a
    standard deviation is not positive, or the table has no row.
    """
    content = read_small(file, limits.MAX_WHOLE_BYTES)
    table = TextTable([content], str(file))
    columns = (*names, *(("std_m",) if "std_m" in table.fields else ()))
    values = table.parse(table.places(columns), []).values
    unknown = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(unknown):
        raise ValueError(f"{file}, row {unknown[0] + 1}: {','.join(columns)} must all be numbers; leave the row out")
    if len(values) > limits.MAX_FIXES:
        raise ValueError(f"{file}: {len(values)} {what}, more than {limits.MAX_FIXES}; leave out some")
    if not len(values):
        raise ValueError(f"{file}: no {what} below the line {','.join(columns)}; write one in each line")
    if len(columns) == len(names):
        if not 0 < std_m < math.inf:
            raise ValueError(f"std_m must be a positive number, got {std_m:g}")
        values = np.column_stack([values, np.full(len(values), std_m)])
    wrong = np.flatnonzero(~(values[:, -1] > 0))
    if len(wrong):
        raise ValueError(f"{file}, row {wrong[0] + 1}: std_m is {values[wrong[0], -1]:g}; write a positive number")
    for group in optional:
        more = np.full((len(values), len(group)), np.nan)
        if group[0] in table.fields:
            own = TextTable([content], str(file))
            known = own.parse(own.places(group), []).values[: len(more)]  # lacks a last line that is cut off
            more[: len(known)] = known
        values = np.column_stack([values, more])
    return values.tolist()
