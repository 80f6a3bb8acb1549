"""Options shared by several commands, and option groups: dataclasses with a field for each option.

Only `in_groups` makes groups, because the defaults of their fields are objects of typer.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_type_hints

import typer

from pdr_filter.values import limits
from pdr_filter.values.georeference import Georeference, GnssUse, NorthUse, texts
from pdr_filter.values.recording import check_height

if TYPE_CHECKING:
    from pdr_filter.apps.maps.radio.radio_map import RadioMap
    from pdr_filter.filter.pedestrian.person import Person
    from pdr_filter.recipes.calibration import Calibration
    from pdr_filter.recipes.config import Config
    from pdr_filter.values import Origin
    from pdr_filter.values.recording import Recording


def height_in_metres(value: str | float) -> float:
    """Return a value of --height as a number. BadParameter unless it is a plausible height in metres."""
    try:
        check_height(float(value))
        return float(value)
    except ValueError:
        low_m, high_m = limits.HEIGHT_RANGE_M
        given = value if isinstance(value, str) else f"{value:g}"
        hint = ": write a point in place of the comma" if "," in given else ""
        raise typer.BadParameter(
            f"must be the height of a person in metres, {low_m:g} to {high_m:g}, such as 1.78, got {given}{hint}",
            param_hint="'--height'",
        ) from None


Files = Annotated[list[Path], typer.Argument(metavar="FILE...", help="Recordings, or folders of recordings.")]
Format = Annotated[
    str | None, typer.Option("--format", help="Format of the files. Default: detected from their content.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print only a JSON object on stdout for each file, on one line.")]
PersonFile = Annotated[
    Path | None,
    typer.Option(
        "--person",
        "--calibration",
        help="File with the step lengths of the person. A calibration from pdr-filter calibrate is only read. A file "
        "written by pdr-filter track is updated after each walk with fixes.",
    ),
]
RadioFile = Annotated[
    Path | None,
    typer.Option("--radio", help="Wi-Fi map of the building, from pdr-filter radio, which gives position fixes."),
]
RangesFile = Annotated[
    Path | None, typer.Option("--ranges", help="CSV of distances to anchors, as described in docs/ranges.md.")
]
AnchorsFile = Annotated[
    Path | None,
    typer.Option("--anchors", help="Positions of the anchors of --ranges: GeoJSON points, each with a name."),
]
Classifier = Literal["blend", "rvm", "forest", "boosted"]
ClassifierName = Annotated[
    Classifier | None,
    typer.Option(
        metavar="NAME",
        help="Classifier of the contexts in the recipe default: relevance vector machines (rvm), extremely randomised "
        "trees (forest), the mean of both (blend, the default), or logistic regression and boosted trees (boosted).",
    ),
]
ModelFile = Annotated[Path | None, typer.Option(help="Context model (.npz) for recordings with a gyroscope.")]
TransitionsFile = Annotated[
    Path | None, typer.Option(help="Context transitions: transitions.json from pdr-filter train.")
]
FixesFile = Annotated[
    Path | None,
    typer.Option(
        help="CSV of position fixes with columns time_s, east_m, north_m and optionally std_m, floor, heading_deg and "
        "heading_std_deg. Or latitude and longitude in degrees, if --origin, the marks, the plan or locations of the "
        "recording give the origin."
    ),
]
Platform = Annotated[
    Literal["ios", "android"] | None,
    typer.Option(
        help="Platform of the phone, which decides the sign of the acceleration. Needed only when it cannot be "
        "detected."
    ),
]
Tiles = Annotated[
    str,
    typer.Option(
        metavar="URL",
        help="URL of map tiles for the page, which contains {z}, {x} and {y}. By default no server is asked.",
    ),
]
Folder = Annotated[Path | None, typer.Option(help="Folder for NAME.csv and NAME.png.")]
Height = Annotated[
    float | None,
    typer.Option(
        "--height",
        parser=height_in_metres,
        metavar="FLOAT",
        help="Height of the person in m. Replaces a recorded height.",
    ),
]


_TEXT = {name: text.split(". ")[0].replace("`", "").rstrip(".") + "." for name, text in texts().items()}
_HEADING = _TEXT.get("heading_rad", "").replace("in rad", "in degrees")
Gnss = Annotated[GnssUse | None, typer.Option(help=_TEXT.get("gnss"))]
Online = Annotated[
    bool,
    typer.Option("--online", help="Show the estimates that were available at each step, instead of the smoothed walk."),
]
Loop = Annotated[
    bool,
    typer.Option(
        "--loop", help="State that the walk ended within 1 m of its start. Ignored if the walk contradicts it."
    ),
]
Scheduler = Annotated[
    str | None, typer.Option(help="Address of a Dask cluster that processes the recordings, such as tcp://host:8786.")
]


@dataclass(frozen=True, slots=True)
class GeoreferenceOptions:
    """Options for position, north and floor plan of a track, which `arguments` converts to fields of `Georeference`."""

    gnss: Gnss = None
    north: NorthUse | None = typer.Option(
        None, metavar="SOURCE", help=f"{_TEXT.get('north')} One of {', '.join(get_args(NorthUse))}."
    )
    origin: str | None = typer.Option(None, metavar="LAT,LON", help=_TEXT.get("origin"))
    heading: str | None = typer.Option(None, metavar="DEG", help=_HEADING)
    plan: Path | None = typer.Option(None, metavar="GEOJSON", help=_TEXT.get("plan"))
    start: str | None = typer.Option(None, metavar="PLACE", help=f"{_TEXT.get('start')} A position is EAST,NORTH in m.")

    def given(self) -> dict[str, Any]:
        """Return the values of the options that were given, by name such as "--origin"."""
        return {f"--{f.name}": value for f in fields(self) if (value := getattr(self, f.name)) is not None}

    def arguments(self, known: Origin | None = None) -> dict[str, Any]:
        """Return the keyword arguments for `pdr_filter.track` and `pdr_filter.smooth`.

        The origin of the plan is that of --origin, else `known`, the origin of the marks, so that there is one frame.
        """
        if self.start is not None and self.plan is None:
            raise ValueError(f"--start {self.start} is a place on a floor plan: give --plan, or omit --start")
        plan, origin = None, origin_deg(self.origin)
        if self.plan is not None:
            from pdr_filter.apps.maps.floor_plan import FloorPlan

            plan = FloorPlan.read(self.plan, origin or known)
        georeference = Georeference(
            gnss=self.gnss,
            origin=origin,
            heading_rad=_heading_rad(self.heading),
            north=self.north,
            plan=plan,
            start=_place(self.start),
        )
        return {field.name: getattr(georeference, field.name) for field in fields(georeference)}


@dataclass(frozen=True, slots=True)
class Source:
    """Options that complete the contents of a file."""

    file_format: Format = None
    height_m: Height = None

    def read(self, file: Path) -> Recording:
        """Read a recording and set the height of the person if --height is given."""
        import pdr_filter as pdr

        recording = pdr.read(file, self.file_format)
        return recording if self.height_m is None else recording.of_height(self.height_m)


def _place(start: str | None) -> Any:
    """Return a position fix with a standard deviation of 1 m for the text EAST,NORTH in m.

    Any other text is returned unchanged, because it names an area of the plan. None stays None.
    """
    import numpy as np

    from pdr_filter.values import PositionFix

    try:
        east_m, north_m = (float(part) for part in (start or "").split(","))
    except ValueError:
        return start
    return PositionFix(0.0, np.array([east_m, north_m]), np.eye(2))


def context_changes(
    classifier: Classifier | None, model: Path | None, transitions: Path | None, recipe: str
) -> Callable[[Config], Config]:
    """Return a function that puts --classifier, --model and --transitions into a configuration of a recipe.

    ValueError or OSError for a file or combination that cannot be used, before any recording is read.
    """
    from pdr_filter import recipes
    from pdr_filter.classifiers.context_model import load_model
    from pdr_filter.classifiers.transition_files import load_transitions

    if classifier is not None and (recipe != "default" or model is not None):
        other = f"--recipe {recipe}" if model is None else f"--model {model}"
        raise ValueError(
            f"--classifier {classifier} chooses a model of the recipe default, but {other} has a model of its own: "
            "omit one of the two"
        )
    known = None if model is None else load_model(model)
    probable = None if transitions is None else load_transitions(transitions)

    def changed(config: Config) -> Config:
        if classifier is not None:
            contexts = recipes.attitude_free_contexts(classifier)
            config = replace(config, sensing=replace(config.sensing, contexts=contexts))
        if known is not None:
            config = recipes.with_context_model(config, known)
        return config if probable is None else recipes.with_transitions(config, probable)

    return changed


def with_person_of_calibration(recording: Recording, file: Path, person: Person | Calibration | None) -> Recording:
    """Return a recording with the person in the name of its file, as `pdr-filter calibrate` names it.

    The recording is unchanged without a calibration, because only a calibration has step lengths of several persons.
    """
    from pdr_filter.data.io.folders import with_person_of_file
    from pdr_filter.recipes.calibration import Calibration

    return with_person_of_file(recording, file) if isinstance(person, Calibration) else recording


def wifi_fixes(radio: RadioMap, recording: Recording, with_grids: bool) -> list[Any]:
    """Return the position fixes of a recording on a radio map, and also its grids for a particle filter on a plan."""
    return [*radio.fixes(recording), *(radio.grids(recording) if with_grids else [])]


def fixes_of(fixes: Path, std_m: float, recording: Recording, where: dict[str, Any]) -> list[Any]:
    """Return the fixes of the file --fixes.

    Positions in degrees are relative to the origin of the frame (`origin_of_frame`). Without one, and without a plan,
    they are relative to the first usable location of the recording, which then becomes the origin of the track.
    """
    from pdr_filter.data.io.fix_files import degrees_in, fixes_of_file
    from pdr_filter.filter.fixes.gnss import origin_of

    origin = origin_of_frame(where)
    if origin is None and degrees_in(fixes):
        if where.get("plan") is None and recording.location is not None:
            origin = origin_of(recording.location)
        if origin is None:
            raise ValueError(
                f"{fixes}: the positions are in degrees, and the geographic origin of the track is unknown: give "
                "--origin LAT,LON, such as the first position, or write east_m,north_m"
            )
        if where.get("gnss") not in ("filter", "align"):
            where["origin"] = origin
    return list(fixes_of_file(fixes, std_m, origin))


def origin_of_frame(where: Mapping[str, Any]) -> Origin | tuple[float, float] | None:
    """Return the origin of positions in degrees: that in the arguments `where` of the track, or that of its plan."""
    plan = where.get("plan")
    return where.get("origin") or (None if plan is None else plan.origin)


def ranges_of(ranges: Path | None, anchors: Path | None, where: Mapping[str, Any]) -> list[Any]:
    """Return the range fixes of the files --ranges and --anchors, for the arguments `where` of the track.

    ValueError for anchors without ranges.
    """
    from pdr_filter.data.io.fix_files import ranges_of_file

    if ranges is None and anchors is not None:
        raise ValueError(
            f"--anchors {anchors} has no effect without --ranges, the distances to these anchors: give both"
        )
    return [] if ranges is None else list(ranges_of_file(ranges, anchors, origin=origin_of_frame(where)))


def origin_deg(text: str | None) -> tuple[float, float] | None:
    """Parse LAT,LON. Return latitude and longitude in degrees, or None if the option is not given."""
    from pdr_filter.values.origin import check_coordinates

    if text is None:
        return None
    try:
        latitude_deg, longitude_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"--origin must be LAT,LON in degrees, such as 51.4779,-0.0015, got {text!r}") from None
    check_coordinates("--origin", latitude_deg, longitude_deg)
    return latitude_deg, longitude_deg


def _heading_rad(text: str | None) -> float | None:
    """Parse a heading in degrees. Return it in radians, or None if the option is not given."""
    if text is None:
        return None
    try:
        heading_deg = float(text)
    except ValueError:
        heading_deg = math.nan
    if not abs(heading_deg) <= limits.MAX_HEADING_DEG:
        raise ValueError(
            f"--heading must be degrees clockwise from north, -360 to 360, such as 90 for east, got {text!r}"
        )
    return math.radians(heading_deg)


def in_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command for typer, in which each field of an option group is a separate option.

    typer does not support parameters that are dataclasses. The returned function has the fields as parameters, builds
    the dataclasses from them, and calls `command`.
    """
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

    # line breaks within a paragraph of the docstring are removed, so that the terminal wraps at its own width
    paragraphs = (inspect.getdoc(command) or "").split("\n\n")
    run.__name__, run.__doc__ = command.__name__, "\n\n".join(" ".join(p.split()) for p in paragraphs)
    run.__annotations__ = {p.name: p.annotation for p in parameters}
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return run
