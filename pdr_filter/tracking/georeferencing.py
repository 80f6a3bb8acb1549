"""Which frame a recording's track is in: what is used of its locations, of a given place and of the magnetic field."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pdr_filter.filter.fixes.gnss import origin_of
from pdr_filter.recipes.config import Config
from pdr_filter.values.quaternions import rotation_matrix
from pdr_filter.values.recording import Recording, Samples
from pdr_filter.values.track_placement import TrackPlacement

# Of magnetic north where nobody knows the place: root mean squares are 9.5 degrees over the twenty largest cities of
# the world, and 15 over the globe from 55 degrees south to 65 north.
_UNKNOWN_DECLINATION_STD_RAD = 0.2


_YEAR_S = 365.2425 * 86400.0


def with_north(config: Config, recording: Recording, placement: TrackPlacement, with_location: bool) -> Config:
    """The configuration with what says where north is, if it is used."""
    north, where = placement.north, placement.place
    has_sensors = {"gyroscope", "magnetometer"} <= recording.streams.keys()
    by_itself = with_location and placement.gnss != "align" and has_sensors and config.learns_directions
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
    return with_north(config.in_world_frame(), first, TrackPlacement(), with_location=True)
