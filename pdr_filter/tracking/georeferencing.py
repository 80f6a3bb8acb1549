"""Georeferencing of a recording: use of its locations, of a given position, and of the magnetic field."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pdr_filter.filter.fixes.gnss import origin_of
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.heading.walking_heading import WalkingHeading
from pdr_filter.values.georeference import Georeference
from pdr_filter.values.quaternions import rotation_matrix
from pdr_filter.values.recording import Recording, Samples
from pdr_filter.values.track_rows import TrackRows

# Standard deviation of magnetic north against true north at an unknown place. The root mean square of the declination
# is 9.5 degrees over the twenty largest cities of the world, and 15 degrees over the globe from 55 S to 65 N.
_UNKNOWN_DECLINATION_STD_RAD = 0.2
_YEAR_S = 365.2425 * 86400.0


def with_north(config: Config, recording: Recording, georeference: Georeference, with_location: bool) -> Config:
    """Return the configuration with a source of north, or unchanged if none is wanted.

    `georeference.north` selects the source. If it is None, the magnetometer is the source if locations are used as
    fixes (`with_location`, and `georeference.gnss` is not "align"), if the recipe learns walking directions, and if the
    recording has a gyroscope and a magnetometer. Otherwise there is no source. The declination is 0 for "true-heading".
    For other sources it is computed for the given place, or else for the first usable location. Without any place the
    declination of a selected source is uncertain, and with `georeference.north` None the configuration is unchanged.
    """
    north, where = georeference.north, georeference.given_origin
    has_sensors = {"gyroscope", "magnetometer"} <= recording.streams.keys()
    by_itself = with_location and georeference.gnss != "align" and has_sensors and config.learns_directions
    if north == "off" or (north is None and not by_itself):
        return config
    if north == "true-heading":
        return config.with_magnetic_north(0.0)
    if where is None and recording.location is not None:
        where = origin_of(recording.location)
    if where is None:
        return config if north is None else config.with_magnetic_north(0.0, _UNKNOWN_DECLINATION_STD_RAD)
    epoch_s = recording.epoch_s
    year = 2025.0 if epoch_s is None or not np.isfinite(epoch_s) else 1970.0 + epoch_s / _YEAR_S
    # The strength of the synthetic field of an attitude tells nothing about iron.
    field_ut = None if north in _FIELD_UT else where.magnetic_field_ut(year)
    return config.with_magnetic_north(where.declination_rad(year), field_ut=field_ut)


# Magnetic field, microtesla, along the north of the phone's own attitude, in the world axes of that attitude. The
# horizontal component is that of middle latitudes, because `MagneticNorth` is tuned for it. The vertical component
# gives the dip angle of middle latitudes.
_FIELD_UT = {"rotation-vector": (0.0, 25.0, -43.0), "true-heading": (25.0, 0.0, -43.0)}


def with_north_of_attitude(recording: Recording, north: str | None) -> Recording:
    """Return the recording with a synthetic magnetic field that is consistent with the phone's own attitude.

    The recording is unchanged if `north` names another source, or without an attitude. The synthetic field is R' m,
    with the rotation R from sensor to world of the attitude, and the magnetic field m of the Earth in the world. It is
    processed as if it were measured, because the phone derives its attitude from its magnetometer, which the same iron
    disturbs.
    """
    if north not in _FIELD_UT or recording.attitude is None:
        return recording
    field_ut = np.array(_FIELD_UT[north]) @ rotation_matrix(recording.attitude.values)
    return replace(recording, magnetometer=Samples(recording.attitude.time_s, field_ut))


_FIRST_STEPS = 4  # two strides, over which a swing of the arm averages out
_REST_S = 0.5  # duration of the means of the specific force


def first_heading_rad(recording: Recording, track: TrackRows) -> float:
    """Return the heading in the frame of the start that a heading given for the start refers to, rad.

    It is zero, the direction of the device at the first sample, if the phone stays in its place. If the tilt of the
    phone changes between the first sample and the first strides, the phone was moved, and its turn is not that of the
    pedestrian. The result is then the first walking direction, averaged over four steps.
    """
    since_s = np.asarray(track.steps.carried_since_s)
    first = np.flatnonzero(np.isfinite(since_s))[:_FIRST_STEPS]
    if len(first) == 0:
        return 0.0
    time_s, force = recording.accelerometer.time_s, recording.accelerometer.values
    begin_s, end_s = float(time_s[0]), float(track.time_s[first[-1]])
    at_start = force[time_s < begin_s + _REST_S].mean(axis=0)
    step_s = track.time_s[first[0]] - track.steps.duration_s[first[0]]
    walking = force[(time_s > step_s) & (time_s <= end_s)].mean(axis=0)
    cosine = at_start @ walking / (np.linalg.norm(at_start) * np.linalg.norm(walking))
    if not cosine < np.cos(WalkingHeading.max_tilt_rad):  # also if a mean is unknown
        return 0.0
    return float(np.angle(np.exp(1j * track.walking_heading_rad[first]).sum()))


def live_config(first: Recording, config: Config) -> Config:
    """Return the configuration that `track` would use by default for a live recording, given its first seconds.

    Without locations the given configuration is unchanged.
    """
    if first.location is None:
        return config
    return with_north(config.in_world_frame(), first, Georeference(), with_location=True)
