"""Place, north and floor plan of a track: one value for the arguments, their texts, and what excludes what."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Literal, TypeVar, get_args

from pdr_filter.values.checks import are_numbers
from pdr_filter.values.fixes import Fix, HeadingFix, PositionFix, has_frame
from pdr_filter.values.origin import Origin
from pdr_filter.values.plan import Plan
from pdr_filter.values.recording import MissingSensorError, Recording

# Use of a recording's own locations.
GnssUse = Literal["filter", "align", "off"]
# Source of north: the magnetometer, or the phone's own attitude, whose world then has y to magnetic north
# (Android's rotation vector) or x to true north (xTrueNorthZVertical of iOS).
NorthUse = Literal["magnetic", "rotation-vector", "true-heading", "off"]

F = TypeVar("F", bound=Callable[..., object])


@dataclass(frozen=True, slots=True, eq=False)
class TrackPlacement:
    """Place, north and floor plan of a track, as given to `track`, `smooth`, `OnlineFilter` and the command line.

    The first sentence of each parameter is also the help of its option. ValueError if a value means nothing, or if two
    of them say the same thing.

    Parameters
    ----------
    gnss : {"filter", "align", "off"}, optional
        Whether the recording's own locations are fixes, turn and shift the whole track, or are not used. "filter": they
        are fixes, in metres from the first of them, and the track is in the world (`Track.origin`), with true north.
        "align": the track of dead reckoning keeps its shape, and is turned and shifted as a whole to fit all locations
        except outliers. "off": they are not used. The default is "filter" where there are locations, unless `fixes` has
        positions or headings, which are in a frame of their own, or `origin` or `heading_rad` is given.
    origin : Origin or (latitude_deg, longitude_deg), optional
        Place on Earth where the track has its zero: the start of the walk, or the zero of the frame of `fixes`.
    heading_rad : float, optional
        True heading in which the person first walked, clockwise from north. The track is turned by it. An error of this
        heading turns the whole track about its start; an `Origin` with a turn also has its standard deviation.
    north : {"magnetic", "rotation-vector", "true-heading", "off"}, optional
        Source of true north until fixes have settled it: the magnetometer or the phone's own attitude. "magnetic": the
        magnetometer, which is also the default where the locations of the recording are used. The phone's own attitude
        needs no magnetometer: "rotation-vector" for a world with y to magnetic north (Android), "true-heading" for a
        world with x to true north (xTrueNorthZVertical of iOS). `fixes` are then in a frame whose north is true north,
        and without fixes the track is turned about its start (`Track.frame` is "north"). "off": none.
    plan : FloorPlan, optional
        Floor plan that keeps the track where people can walk. `fixes` are in its frame, and so is the track then
        (`Track.frame` is "plan"); `Track.clusters` says in how many places the walk may be. The recording's own
        locations are used if the plan was in degrees.
    start : PositionFix or str, optional
        Start of the walk on the plan: a place, the name of an area, or "anywhere". The default is where the fixes put
        the track, or the plan's zero, facing its north.
    """

    gnss: GnssUse | None = None
    origin: Origin | tuple[float, float] | None = None
    heading_rad: float | None = None
    north: NorthUse | None = None
    plan: Plan | None = None
    start: PositionFix | str | None = None

    def __post_init__(self) -> None:
        check_gnss(self.gnss)
        if self.north is not None and self.north not in get_args(NorthUse):
            raise ValueError(f"north must be one of {get_args(NorthUse)}, got {self.north!r}")
        if self.heading_rad is not None and not are_numbers(self.heading_rad):
            raise ValueError(
                f"heading_rad must be a finite number, clockwise from north, got {self.heading_rad!r}; 90 degrees "
                "are math.radians(90)"
            )
        if self.start is not None and self.plan is None:
            raise ValueError(
                f"start is a place on a floor plan, got {self.start!r} without plan: give one, or leave it out"
            )
        turn_rad = None if self.place is None else self.place.turn_rad
        if self.heading_rad is not None and turn_rad is not None:
            raise ValueError(
                f"heading_rad ({self.heading_rad}) and the turn of origin ({turn_rad}) are one: leave one out"
            )
        if self.is_given and self.asks_for_locations:
            pair = ("origin", self.origin), ("heading_rad", self.heading_rad)
            raise ValueError(
                f'gnss="{self.gnss}" takes place and north from the recording\'s locations, and '
                f"{' and '.join(name for name, value in pair if value is not None)} says them too: leave one or the "
                "other out"
            )
        if self.asks_for_north and (self.heading_rad is not None or turn_rad is not None):
            raise ValueError(
                f'heading_rad, or the turn of origin, and north="{self.north}" both say north: leave one out'
            )
        if self.asks_for_north and self.gnss == "align":
            raise ValueError(f'gnss="align" and north="{self.north}" both turn the track: leave one out')

    @property
    def place(self) -> Origin | None:
        """The given origin."""
        return None if self.origin is None else Origin.of(self.origin)

    @property
    def is_given(self) -> bool:
        """Whether the caller states the place or the heading of the track."""
        return self.origin is not None or self.heading_rad is not None

    @property
    def asks_for_locations(self) -> bool:
        """Whether the caller wants the recording's own locations."""
        return self.gnss in ("filter", "align")

    @property
    def asks_for_north(self) -> bool:
        """Whether the caller names a source of north."""
        return self.north not in ("off", None)

    def uses_location(self, recording: Recording, fixes: Sequence[Fix], plan: Plan | None) -> bool:
        """Whether the recording's own locations are used; `plan` is that of the configuration.

        ValueError if fixes or plan exclude an argument. MissingSensorError if the recording lacks a stream for it.
        """
        sensor = "magnetometer" if self.north == "magnetic" else "attitude"
        for name, given, is_asked, needs in (
            ("gnss", self.gnss, self.asks_for_locations, ("location",)),
            ("north", self.north, self.asks_for_north, ("gyroscope", sensor)),
        ):
            missing = [need for need in needs if need not in recording.streams]
            if is_asked and missing:
                raise MissingSensorError(
                    f'{recording.name or "the recording"} has no {" and no ".join(missing)}, got {name}="{given}": '
                    "leave it out"
                )
        has_metres = plan is not None and plan.origin is None
        if self.asks_for_locations and has_metres:
            raise ValueError(
                f'gnss="{self.gnss}" needs to know where on Earth the plan is, got a plan in metres: give one in '
                "longitude and latitude, or FloorPlan.read its origin, or leave gnss out"
            )
        if self.gnss == "align" and plan is not None:
            raise ValueError(
                'gnss="align" turns and shifts a track that the plan has placed: give gnss="filter" or "off"'
            )
        has_positions = any(has_frame(fix) and not isinstance(fix, HeadingFix) for fix in fixes)
        has_headings = any(isinstance(fix, HeadingFix) for fix in fixes)
        if self.asks_for_locations and has_positions:
            raise ValueError(
                f'gnss="{self.gnss}" makes the first location of the recording the origin, and fixes has ranges or '
                'positions in a frame of their own: leave one of them out, or give gnss="off" and the locations among '
                "the fixes (see pdr_filter.filter.fixes.gnss.position_fixes)"
            )
        if self.gnss == "align" and has_headings:
            raise ValueError('gnss="align" finds the turn of the whole track, got a HeadingFix: leave one of them out')
        if self.heading_rad is not None and (has_positions or has_headings):
            raise ValueError(
                f"heading_rad turns a track in the frame of its start, got {self.heading_rad} beside fixes in a frame "
                "of their own: leave it out, and turn the result with Track.turned if that frame does not have true "
                "north"
            )
        if recording.location is None or self.is_given or self.gnss == "off":
            return False
        return self.asks_for_locations or not (has_positions or has_headings or has_metres)


def check_gnss(gnss: str | None) -> None:
    """ValueError for an unknown use of locations."""
    if gnss is not None and gnss not in get_args(GnssUse):
        raise ValueError(f"gnss must be one of {get_args(GnssUse)}, got {gnss!r}")


def texts() -> Mapping[str, str]:
    """Text of each parameter of `TrackPlacement`, by name; empty where Python runs without docstrings."""
    entries = re.findall(r"^(\w+) : .*\n((?:    .*\n?)+)", _parameters(), re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}


def documented(function: F) -> F:
    """Return the function with the parameters of `TrackPlacement` in its docstring, at the line that names them."""
    line = f"{', '.join(field.name for field in fields(TrackPlacement))} : fields of `TrackPlacement`"
    if function.__doc__ is not None:
        function.__doc__ = (inspect.getdoc(function) or "").replace(line, _parameters())
    return function


def _parameters() -> str:
    return (inspect.getdoc(TrackPlacement) or "").partition("----------\n")[2]
