"""Arguments for position, north and floor plan of a track: values, descriptions, and forbidden combinations."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Literal, TypeVar, get_args

from pdr_filter.values.checks import are_numbers, check_heading
from pdr_filter.values.fixes import Fix, HeadingFix, PositionFix, has_frame
from pdr_filter.values.origin import Origin
from pdr_filter.values.plan import Plan
from pdr_filter.values.recording import MissingSensorError, Recording

# Use of the locations of a recording.
GnssUse = Literal["filter", "align", "off"]
# Source of north: the magnetometer, or the phone's own attitude, whose world then has y to magnetic north
# (Android's rotation vector) or x to true north (xTrueNorthZVertical of iOS).
NorthUse = Literal["magnetic", "rotation-vector", "true-heading", "off"]

F = TypeVar("F", bound=Callable[..., object])


@dataclass(frozen=True, slots=True, eq=False)
class Georeference:
    """Position, north and floor plan of a track, as given to `track`, `smooth`, `OnlineFilter` and the command line.

    The first sentence of each parameter is also the help of the command line option. ValueError if a value is invalid,
    or if two values define the same thing.

    Parameters
    ----------
    gnss : {"filter", "align", "off"}, optional
        Use of the locations of the recording: as fixes, to rotate and shift the whole track, or not at all. "filter":
        the locations are position fixes, in metres from the first of them, and the track has a geographic position
        (`Track.origin`) and true north. "align": the dead-reckoned track keeps its shape, and is rotated and shifted as
        a whole to fit all locations except outliers. "off": the locations are not used. The default is "filter" for a
        recording with locations, and "off" if `fixes` has positions or headings, which are in another frame, or if
        `origin` or `heading_rad` is given. With "filter", positions in `fixes` must be in metres from the first usable
        location, too.
    origin : Origin or (latitude_deg, longitude_deg), optional
        Geographic position of the origin of the track: the start of the walk, or the origin of the frame of `fixes`. A
        plan in degrees must be read with the same origin.
    heading_rad : float, optional
        True heading of the person at the first sample, in rad, clockwise from north. The track is rotated by it. If the
        phone is moved before the first steps, as from the hand to an ear or into a pocket, its turn does not show that
        of the person, and the heading is that of the first steps. An error of this heading rotates the whole track
        about its start. To state the standard deviation of the heading, give an `Origin` with `turn_rad` and
        `turn_std_rad` instead.
    north : {"magnetic", "rotation-vector", "true-heading", "off"}, optional
        Source of true north until fixes determine it: the magnetometer or the phone's own attitude. "magnetic": the
        magnetometer, which is also the default if the locations of the recording are used. "rotation-vector": the
        phone's own attitude, in a world with y to magnetic north (Android). "true-heading": the phone's own attitude,
        in a world with x to true north (xTrueNorthZVertical of iOS). The attitude needs no magnetometer. "off": no
        source. With a source, `fixes` must be in a frame with true north. Without fixes, the track is rotated about its
        start (`Track.frame` is "north").
    plan : FloorPlan, optional
        Floor plan that constrains the track to walkable areas. `fixes` and track are in the frame of the plan
        (`Track.frame` is "plan"), and `Track.clusters` has the candidate areas of the position. The locations of the
        recording are used if the plan is in degrees.
    start : PositionFix or str, optional
        Start of the walk on the plan: a position, the name of an area, or "anywhere". The default is the position from
        the fixes, or the origin of the plan, facing its north.
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
        if self.heading_rad is not None:
            check_heading("heading_rad", self.heading_rad)
        if self.start is not None and self.plan is None:
            raise ValueError(
                f"start is a position on a floor plan, got {self.start!r} without plan: give plan, or leave start out"
            )
        place, of_plan = self.given_origin, getattr(self.plan, "origin", None)  # a wrong plan is refused later
        if place is not None and of_plan is not None and _degrees(place) != _degrees(of_plan):
            raise ValueError(
                f"origin {_degrees(place)} and plan, whose origin is {_degrees(of_plan)}, both define the frame of the "
                "track: leave origin out, or read the plan with it, FloorPlan.read(path, origin)"
            )
        turn_rad = None if place is None else place.turn_rad
        if self.heading_rad is not None and turn_rad is not None:
            raise ValueError(
                f"heading_rad ({self.heading_rad}) and turn_rad of origin ({turn_rad}) define the same angle: leave "
                "one of them out"
            )
        if self.is_given and self.asks_for_locations:
            pair = ("origin", self.origin), ("heading_rad", self.heading_rad)
            names = " and ".join(name for name, value in pair if value is not None)
            raise ValueError(
                f'gnss="{self.gnss}" takes position and north from the locations of the recording, got {names} too: '
                f"leave out gnss or {names}"
            )
        if self.asks_for_north and self.states_north:
            raise ValueError(
                f'heading_rad, or turn_rad of origin, and north="{self.north}" both define north: leave one of them out'
            )
        if self.asks_for_north and self.gnss == "align":
            raise ValueError(f'gnss="align" and north="{self.north}" both define north: leave one of them out')

    @property
    def given_origin(self) -> Origin | None:
        """Geographic position (latitude and longitude) given as the origin of the track, or None if none was given."""
        return None if self.origin is None else Origin.of(self.origin)

    @property
    def is_given(self) -> bool:
        """True if the caller gives the position or the heading of the track."""
        return self.origin is not None or self.heading_rad is not None

    @property
    def states_north(self) -> bool:
        """True if the caller gives the direction of north, by the heading or the turn of the origin."""
        return self.heading_rad is not None or (
            self.given_origin is not None and self.given_origin.turn_rad is not None
        )

    @property
    def asks_for_locations(self) -> bool:
        """True if the caller requests the locations of the recording."""
        return self.gnss in ("filter", "align")

    @property
    def asks_for_north(self) -> bool:
        """True if the caller requests a source of north."""
        return self.north not in ("off", None)

    def uses_location(self, recording: Recording, fixes: Sequence[Fix], plan: Plan | None) -> bool:
        """Return whether the locations of the recording are used, given the plan of the configuration.

        ValueError if fixes or plan exclude an argument. MissingSensorError if the recording lacks a stream that one
        requires.
        """
        sensor = "magnetometer" if self.north == "magnetic" else "attitude"
        for name, given, is_asked, needs in (
            ("gnss", self.gnss, self.asks_for_locations, ("location",)),
            ("north", self.north, self.asks_for_north, ("gyroscope", sensor)),
        ):
            missing = [need for need in needs if need not in recording.streams]
            if is_asked and missing:
                raise MissingSensorError(
                    f'{recording.name or "the recording"} has no {" and no ".join(missing)}, which {name}="{given}" '
                    f"(--{name} {given}) requires: omit it"
                )
        has_metres = plan is not None and plan.origin is None
        if self.asks_for_locations and has_metres:
            raise ValueError(
                f'gnss="{self.gnss}" needs the geographic position of the floor plan, got a plan in metres without '
                "origin: use a plan in longitude and latitude, give the origin to FloorPlan.read, or leave gnss out"
            )
        if self.gnss == "align" and plan is not None:
            raise ValueError(
                'gnss="align" rotates and shifts the whole track, but the floor plan already defines its frame: give '
                'gnss="filter" or "off"'
            )
        has_positions = any(has_frame(fix) and not isinstance(fix, HeadingFix) for fix in fixes)
        has_headings = any(isinstance(fix, HeadingFix) for fix in fixes)
        if self.gnss == "align" and has_positions:
            raise ValueError(
                'gnss="align" determines position and rotation of the whole track, got ranges or positions in fixes: '
                'leave one of them out, or give gnss="filter" and positions in metres from the first location'
            )
        if self.gnss == "align" and has_headings:
            raise ValueError('gnss="align" determines the rotation of the whole track, got a HeadingFix: leave one out')
        if self.heading_rad is not None and (has_positions or has_headings):
            raise ValueError(
                f"heading_rad rotates a track in the frame of its start, got {self.heading_rad} together with fixes in "
                "another frame: leave it out, and rotate the result with Track.turned if that frame does not have true "
                "north"
            )
        if recording.location is None or self.is_given or self.gnss == "off":
            return False
        return self.asks_for_locations or not (has_positions or has_headings or has_metres)


def _degrees(place: Origin) -> tuple[float, float]:
    return place.latitude_deg, place.longitude_deg


def check_gnss(gnss: str | None) -> None:
    """Raise ValueError for an unknown use of locations."""
    if gnss is not None and gnss not in get_args(GnssUse):
        raise ValueError(f"gnss must be one of {get_args(GnssUse)}, got {gnss!r}")


def texts() -> Mapping[str, str]:
    """Return the description of each parameter of `Georeference`, by name; empty if Python has no docstrings."""
    entries = re.findall(r"^(\w+) : .*\n((?:    .*\n?)+)", _parameters(), re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}


def document_georeference(function: F) -> F:
    """Insert the parameters of `Georeference` into the docstring of a function, at the line that names them."""
    line = f"{', '.join(field.name for field in fields(Georeference))} : fields of `Georeference`"
    if function.__doc__ is not None:
        # numpydoc expects the closing quotes on their own line; `getdoc` removes that line break.
        function.__doc__ = f"{(inspect.getdoc(function) or '').replace(line, _parameters())}\n"
    return function


def _parameters() -> str:
    return (inspect.getdoc(Georeference) or "").partition("----------\n")[2]
