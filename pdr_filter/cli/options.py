"""Options that commands share, and groups of options: a parameter that is a dataclass is an option for each field."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

Files = Annotated[list[Path], typer.Argument(metavar="FILE...", help="Recordings, or folders of them.")]
Format = Annotated[
    str | None, typer.Option("--format", help="Format of the files, if it is not to be found by their content.")
]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON object a line for each file, nothing else on stdout.")]
CalibrationFile = Annotated[Path | None, typer.Option(help="Of pdr-filter calibrate: this person's steps.")]
RadioFile = Annotated[
    Path | None, typer.Option("--radio", help="Of pdr-filter radio: a map of this building's Wi-Fi, for fixes.")
]
RangesFile = Annotated[
    Path | None, typer.Option("--ranges", help="CSV of distances to anchors: time_s,anchor,range_m,std_m.")
]
AnchorsFile = Annotated[
    Path | None, typer.Option("--anchors", help="GeoJSON points with a name each: where the anchors of --ranges are.")
]
Folder = Annotated[Path | None, typer.Option(help="Folder for NAME.csv and NAME.png.")]


class GnssUse(StrEnum):
    """What becomes of a recording's own locations."""

    FILTER = "filter"
    ALIGN = "align"
    OFF = "off"


Gnss = Annotated[
    GnssUse | None,
    typer.Option(help="Whether its locations are fixes, turn and shift the whole track, or are left out."),
]


class NorthUse(StrEnum):
    """What says where true north is until locations do."""

    MAGNETIC = "magnetic"
    ROTATION_VECTOR = "rotation-vector"
    TRUE_HEADING = "true-heading"
    OFF = "off"


North = Annotated[
    NorthUse | None,
    typer.Option(
        help="What says where true north is: the magnetometer, also if not given where locations are used, or the "
        "phone's own attitude, Android's rotation vector or the true heading of iOS."
    ),
]
Origin = Annotated[
    str | None,
    typer.Option(metavar="LAT,LON", help="Where the walk starts, in degrees; its own locations are not used then."),
]
Heading = Annotated[
    str | None,
    typer.Option(metavar="DEG", help="True heading in which the person first walks, clockwise from north: 90 is east."),
]
PlanFile = Annotated[
    Path | None, typer.Option("--plan", help="Floor plan (GeoJSON) that keeps the track where people can walk.")
]
Start = Annotated[
    str | None,
    typer.Option(
        metavar="PLACE", help="Where on the plan it begins: EAST,NORTH in m, the name of an area, or anywhere."
    ),
]
Online = Annotated[
    bool,
    typer.Option("--online", help="What a phone knew at each step, in place of the walk smoothed as a whole."),
]
Loop = Annotated[
    bool, typer.Option("--loop", help="The walk ended within 1 m of its start; not used if the walk contradicts it.")
]
Scheduler = Annotated[str | None, typer.Option(help="The same on a Dask cluster, such as tcp://host:8786.")]


def on_plan(plan: Path | None, start: str | None) -> dict[str, Any]:
    """The arguments `plan` and `start` of `pdr_filter.track` and `pdr_filter.smooth`."""
    from pdr_filter.maps.floor_plan import FloorPlan

    if plan is None and start is not None:
        raise ValueError(f"--start is a place on a floor plan, got {start!r} without --plan: give one")
    if plan is None:
        return {}
    return {"plan": FloorPlan.read(plan), "start": _place(start)}


def _place(start: str | None) -> Any:
    """The fix that EAST,NORTH is, or the name as it is."""
    import numpy as np

    from pdr_filter.values import PositionFix

    try:
        east_m, north_m = (float(part) for part in (start or "").split(","))
    except ValueError:
        return start
    return PositionFix(0.0, np.array([east_m, north_m]), np.eye(2))


def ranges_of(ranges: Path | None, anchors: Path | None, origin: tuple[float, float] | None) -> list[Any]:
    """The fixes of --ranges and --anchors."""
    from pdr_filter.io.fix_files import ranges_of_file

    if ranges is None and anchors is not None:
        raise ValueError(f"--anchors says where the anchors of ranges are, got {anchors} without --ranges: give both")
    return [] if ranges is None else list(ranges_of_file(ranges, anchors, origin=origin))


def origin_deg(text: str | None) -> tuple[float, float] | None:
    """Latitude and longitude from LAT,LON."""
    from pdr_filter.values.origin import check_place

    if text is None:
        return None
    try:
        latitude_deg, longitude_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"--origin must be LAT,LON in degrees, such as 51.4779,-0.0015, got {text!r}") from None
    check_place("--origin", latitude_deg, longitude_deg)
    return latitude_deg, longitude_deg


def heading_rad(text: str | None) -> float | None:
    """Radians from DEG."""
    if text is None:
        return None
    try:
        heading_deg = float(text)
    except ValueError:
        heading_deg = math.nan
    if not abs(heading_deg) <= 360:
        raise ValueError(f"--heading must be degrees clockwise from north, such as 90 for east, got {text!r}")
    return math.radians(heading_deg)


def in_groups(command: Callable[..., None]) -> Callable[..., None]:
    """The command as typer takes it, which knows no groups: fields of dataclasses as options, in place of these."""
    groups: dict[str, Any] = {}
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        if is_dataclass(group := parameter.annotation):
            groups[parameter.name] = group
            hints = get_type_hints(group, include_extras=True)
            parameters += [
                parameter.replace(name=f.name, annotation=hints[f.name], default=f.default) for f in fields(group)
            ]
        else:
            parameters.append(parameter)

    def run(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{f.name: values.pop(f.name) for f in fields(group)})
        command(**values)

    # A terminal breaks the lines of each paragraph where it is full, not where the docstring does.
    paragraphs = (inspect.getdoc(command) or "").split("\n\n")
    run.__name__, run.__doc__ = command.__name__, "\n\n".join(" ".join(p.split()) for p in paragraphs)
    run.__annotations__ = {p.name: p.annotation for p in parameters}
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return run
