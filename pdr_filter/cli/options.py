"""Options that commands share, and groups of options: a parameter that is a dataclass is an option for each field."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import typer

from pdr_filter.values import Plan
from pdr_filter.values.track_placement import GnssUse, NorthUse, TrackPlacement, texts

Files = Annotated[list[Path], typer.Argument(metavar="FILE...", help="Recordings, or folders of them.")]
Format = Annotated[
    str | None, typer.Option("--format", help="Format of the files, if it is not to be found by their content.")
]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON object a line for each file, nothing else on stdout.")]
PersonFile = Annotated[
    Path | None,
    typer.Option(
        "--person",
        "--calibration",
        help="Step lengths of the person: a file of pdr-filter calibrate, which stays as it is, or of pdr-filter "
        "track, which adds the steps of each walk with fixes.",
    ),
]
RadioFile = Annotated[
    Path | None, typer.Option("--radio", help="Of pdr-filter radio: a map of this building's Wi-Fi, for fixes.")
]
RangesFile = Annotated[Path | None, typer.Option("--ranges", help="CSV of distances to anchors, see docs/ranges.md.")]
AnchorsFile = Annotated[
    Path | None, typer.Option("--anchors", help="GeoJSON points with a name each: where the anchors of --ranges are.")
]
Folder = Annotated[Path | None, typer.Option(help="Folder for NAME.csv and NAME.png.")]


_TEXT = {name: text.split(". ")[0].replace("`", "").rstrip(".") + "." for name, text in texts().items()}
Gnss = Annotated[GnssUse | None, typer.Option(help=_TEXT.get("gnss"))]
Online = Annotated[
    bool,
    typer.Option("--online", help="What a phone knew at each step, in place of the walk smoothed as a whole."),
]
Loop = Annotated[
    bool, typer.Option("--loop", help="The walk ended within 1 m of its start; not used if the walk contradicts it.")
]
Scheduler = Annotated[str | None, typer.Option(help="The same on a Dask cluster, such as tcp://host:8786.")]


@dataclass(frozen=True, slots=True)
class PlacementOptions:
    """Place, north and floor plan of a track: `TrackPlacement` in words of a command line."""

    gnss: Gnss = None
    north: Annotated[
        NorthUse | None,
        typer.Option(metavar="SOURCE", help=f"{_TEXT.get('north')} One of {', '.join(get_args(NorthUse))}."),
    ] = None
    origin: Annotated[str | None, typer.Option(metavar="LAT,LON", help=_TEXT.get("origin"))] = None
    heading: Annotated[str | None, typer.Option(metavar="DEG", help=_TEXT.get("heading_rad"))] = None
    plan: Annotated[Path | None, typer.Option(metavar="GEOJSON", help=_TEXT.get("plan"))] = None
    start: Annotated[
        str | None, typer.Option(metavar="PLACE", help=f"{_TEXT.get('start')} A place is EAST,NORTH in m.")
    ] = None

    def given(self) -> dict[str, Any]:
        """The options that are given, by their names."""
        return {f"--{f.name}": value for f in fields(self) if (value := getattr(self, f.name)) is not None}

    def arguments(self) -> dict[str, Any]:
        """The arguments of `pdr_filter.track` and `pdr_filter.smooth`; ValueError for options that cannot be used."""
        placement = TrackPlacement(
            gnss=self.gnss,
            origin=_origin_deg(self.origin),
            heading_rad=_heading_rad(self.heading),
            north=self.north,
            plan=None if self.plan is None else _plan(self.plan),
            start=_place(self.start),
        )
        return {field.name: getattr(placement, field.name) for field in fields(placement)}


def _plan(path: Path) -> Plan:
    from pdr_filter.maps.floor_plan import FloorPlan

    return FloorPlan.read(path)


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


def _origin_deg(text: str | None) -> tuple[float, float] | None:
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


def _heading_rad(text: str | None) -> float | None:
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
