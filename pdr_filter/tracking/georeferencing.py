"""Which frame a recording's track is in: what is used of its locations, of a given place and of the magnetic field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from pdr_filter.filter.fixes.gnss import origin_of
from pdr_filter.recipes.config import Config
from pdr_filter.values import Fix, HeadingFix, Origin, are_numbers, has_frame
from pdr_filter.values.quaternions import rotation_matrix
from pdr_filter.values.recording import MissingSensorError, Recording, Samples

# What becomes of a recording's own locations.
GnssUse = Literal["filter", "align", "off"]
# What says where north is: the magnetometer, or the phone's own attitude, whose world then has y to magnetic north
# (Android's rotation vector) or x to true north (xTrueNorthZVertical of iOS).
NorthUse = Literal["magnetic", "rotation-vector", "true-heading", "off"]


def is_placed(
    origin: Origin | tuple[float, float] | None, heading_rad: float | None, fixes: Sequence[Fix], gnss: str | None
) -> bool:
    """Whether somebody says where the track lies or which way; ValueError for what contradicts itself."""
    if origin is None and heading_rad is None:
        return False
    if gnss not in ("off", None):
        given = " and ".join(n for n, v in (("origin", origin), ("heading_rad", heading_rad)) if v is not None)
        raise ValueError(
            f'gnss="{gnss}" takes place and north from the recording\'s locations, and {given} says them too: leave '
            "one or the other out"
        )
    turn_rad = None if origin is None else Origin.of(origin).turn_rad
    if heading_rad is not None and not are_numbers(heading_rad):
        raise ValueError(
            f"heading_rad must be a finite number, clockwise from north, got {heading_rad!r}; 90 degrees "
            "are math.radians(90)"
        )
    if heading_rad is not None and turn_rad is not None:
        raise ValueError(f"heading_rad ({heading_rad}) and the turn of origin ({turn_rad}) are one: leave one out")
    if heading_rad is not None and any(has_frame(fix) for fix in fixes):
        raise ValueError(
            f"heading_rad turns a track in the frame of its start, got {heading_rad} beside fixes in a frame of their "
            "own: leave it out, and turn the result with Track.turned if that frame does not have true north"
        )
    return True


def uses_location(recording: Recording, config: Config, fixes: Sequence[Fix], gnss: str | None) -> bool:
    """Whether the locations of a recording are used; ValueError for what contradicts itself."""
    if gnss is not None and gnss not in get_args(GnssUse):
        raise ValueError(f"gnss must be one of {get_args(GnssUse)}, got {gnss!r}")
    is_asked = gnss in ("filter", "align")
    if is_asked and recording.location is None:
        raise MissingSensorError(
            f'{recording.name or "the recording"} has no location, got gnss="{gnss}": leave it out'
        )
    has_metres = config.on_plan is not None and config.on_plan.plan.origin is None
    if is_asked and has_metres:
        raise ValueError(
            f'gnss="{gnss}" needs to know where on Earth the plan is, got a plan in metres: give one in longitude and '
            "latitude, or FloorPlan.read its origin, or leave gnss out"
        )
    if gnss == "align" and config.on_plan is not None:
        raise ValueError('gnss="align" turns and shifts a track that the plan has placed: give gnss="filter" or "off"')
    own_frame = any(has_frame(fix) and not isinstance(fix, HeadingFix) for fix in fixes)
    if is_asked and own_frame:
        raise ValueError(
            f'gnss="{gnss}" makes the first location of the recording the origin, and fixes has ranges or '
            'positions in a frame of their own: leave one of them out, or give gnss="off" and the locations among the '
            "fixes (see pdr_filter.filter.fixes.gnss.position_fixes)"
        )
    own_frame |= any(isinstance(fix, HeadingFix) for fix in fixes)
    if gnss == "align" and own_frame:
        raise ValueError('gnss="align" finds the turn of the whole track, got a HeadingFix: leave one of them out')
    # a plan in metres has a frame of its own, too
    own_frame |= has_metres
    return recording.location is not None and (is_asked or (gnss is None and not own_frame))


# Of magnetic north where nobody knows the place: root mean squares are 9.5 degrees over the twenty largest cities of
# the world, and 15 over the globe from 55 degrees south to 65 north.
_UNKNOWN_DECLINATION_STD_RAD = 0.2


_YEAR_S = 365.2425 * 86400.0


def with_north(
    config: Config,
    recording: Recording,
    origin: Origin | tuple[float, float] | None,
    heading_rad: float | None,
    with_location: bool,
    gnss: str | None,
    north: str | None,
) -> Config:
    """The configuration with what says where north is, if it is used; ValueError for what contradicts itself."""
    if north is not None and north not in get_args(NorthUse):
        raise ValueError(f"north must be one of {get_args(NorthUse)}, got {north!r}")
    where = None if origin is None else Origin.of(origin)
    sensor = "attitude" if north in _FIELD_UT else "magnetometer"
    missing = [name for name in ("gyroscope", sensor) if name not in recording.streams]
    if north not in ("off", None):
        if heading_rad is not None or (where is not None and where.turn_rad is not None):
            raise ValueError(f'heading_rad, or the turn of origin, and north="{north}" both say north: leave one out')
        if gnss == "align":
            raise ValueError(f'gnss="align" and north="{north}" both turn the track: leave one out')
        if missing:
            raise MissingSensorError(
                f'{recording.name or "the recording"} has no {" and no ".join(missing)}, got north="{north}": leave '
                "it out"
            )
    by_itself = with_location and gnss != "align" and not missing and config.learns_directions
    if north == "off" or (north is None and not by_itself):
        return config
    if north == "true-heading":
        return config.with_magnetic_north(0.0)
    if where is None and recording.location is not None:
        where = origin_of(recording.location)
    if where is None:
        return config if north is None else config.with_magnetic_north(0.0, _UNKNOWN_DECLINATION_STD_RAD)
    epoch_s = recording.epoch_s
    if epoch_s is None or not np.isfinite(epoch_s):
        return config.with_magnetic_north(where.declination_rad())
    return config.with_magnetic_north(where.declination_rad(1970.0 + epoch_s / _YEAR_S))


# The field of an attitude's own north, in its world: horizontally that of middle latitudes, against which the doubt of
# a field is set (`MagneticNorth`); as much down as it dips there.
_FIELD_UT = {"rotation-vector": (0.0, 25.0, -43.0), "true-heading": (25.0, 0.0, -43.0)}


def with_north_of_attitude(recording: Recording, north: str | None) -> Recording:
    """The recording with the field that a magnetometer would show if the phone's own attitude were right.

    R' m, R from the sensor to the attitude's world. What the phone made of its magnetometer is doubted like one: it
    bends to the same iron.
    """
    if north not in _FIELD_UT or recording.attitude is None:
        return recording
    field_ut = np.array(_FIELD_UT[north]) @ rotation_matrix(recording.attitude.values)
    return replace(recording, magnetometer=Samples(recording.attitude.time_s, field_ut))


def live_config(first: Recording, config: Config) -> Config:
    """The configuration of `track` for a recording of which only the first seconds are known."""
    if first.location is None:
        return config
    return with_north(config.in_world_frame(), first, None, None, with_location=True, gnss=None, north=None)
