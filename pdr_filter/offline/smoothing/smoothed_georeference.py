"""Geographic position of a smoothed walk: from its locations, from an alignment of the whole walk, or as given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pdr_filter.filter.fixes.gnss import LocationState
from pdr_filter.filter.fixes.rides import Rides
from pdr_filter.filter.height.height_filter import Altitude
from pdr_filter.filter.pedestrian.alignment import Pose
from pdr_filter.offline.smoothing.observations import Observations
from pdr_filter.offline.smoothing.preintegration import scaled_rotation
from pdr_filter.offline.smoothing.smoothed import Smoothed
from pdr_filter.offline.smoothing.storeys import with_named_floors
from pdr_filter.tracking.gnss_alignment import DeadReckoning, align_dead_reckoning
from pdr_filter.tracking.step_statistics import is_moving
from pdr_filter.tracking.warnings import notes_of_rides, rotation_note
from pdr_filter.tracking.whole_recording import Run
from pdr_filter.values import (
    FloatArray,
    Origin,
    PositionFix,
    Samples,
    read_only,
    wrap_angle,
)


def aligned_walk(
    smoothed: Smoothed, walked_var_m2: FloatArray, location: Samples
) -> tuple[Smoothed, LocationState, tuple[PositionFix, ...]]:
    """Return a smoothed walk, rotated and shifted as a whole to fit the locations of the recording.

    The second result is the state of the conversion of locations to fixes, with their geographic origin and the counts
    of unusable locations. The third result are the converted locations. The walk is unchanged if there are no usable
    locations. `walked_var_m2` (K,) is the variance of each position for a known heading.
    """
    track, end_s = smoothed.track, smoothed.track.start_time_s + smoothed.track.duration_s
    way = DeadReckoning(
        np.array([track.start_time_s, *track.time_s]),
        np.vstack([track.start_position_m, track.position_m]),
        np.array([0.0, *track.walked_m]),
        np.array([0.0, *walked_var_m2]),
    )
    found = align_dead_reckoning(location, way, track.start_time_s, end_s, track.n_steps)
    if not found.fixes:
        return smoothed, found.locations, ()
    cov_m2, notes = track.position_cov_m2, smoothed.notes
    if found.frame.alignment is not None:
        cov_m2 = way.own_var_m2(found.frame.agreeing)[:, None, None] * np.eye(2)
    else:
        notes = (*notes, rotation_note("locations", found.frame.rotation_var_rad2**0.5))
    frame = found.frame.at_most_probable_rotation()
    rows = zip(track.position_m, cov_m2, track.walking_heading_rad.tolist(), strict=True)
    poses = [frame.world(Pose(*row, k)) for k, row in enumerate(rows)]
    start = frame.world(Pose(track.start_position_m, smoothed.start_position_cov_m2, 0.0, 0))
    track = replace(
        track,
        position_m=read_only(np.array([p.position_m for p in poses]).reshape(-1, 2)),
        position_cov_m2=read_only(np.array([p.cov_m2 for p in poses]).reshape(-1, 2, 2)),
        walking_heading_rad=read_only(wrap_angle(np.array([p.heading_rad for p in poses]))),
        start_position_m=read_only(start.position_m),
        frame="fixes",
        origin=None if found.locations.origin is None else frame.origin(found.locations.origin),
        fixes=tuple(found.results(end_s)),
        notes=notes,
    )
    turned_rad = read_only(wrap_angle(smoothed.heading_offset_rad + start.heading_rad))
    smoothed = replace(
        smoothed,
        track=track,
        heading_offset_rad=turned_rad,
        start_position_m=track.start_position_m,
        start_position_cov_m2=read_only(start.cov_m2),
        notes=notes,
    )
    return smoothed, found.locations, found.fixes


def on_earth(
    smoothed: Smoothed, where: LocationState, locations: Sequence[PositionFix], observed: Observations
) -> Smoothed:
    """Return a smoothed walk with the geographic origin from its locations and with the storeys of the fixes.

    `locations` are the usable locations as fixes. Notes about unusable locations and about rides are added.
    """
    track, notes = smoothed.track, smoothed.notes
    if where.n_unusable:
        notes = (*notes, where.unusable())
    positions = sorted([*locations, *(f for f in observed.fixes if isinstance(f, PositionFix))], key=lambda f: f.time_s)
    start = [track.start_time_s, *track.start_position_m]
    vertices = np.vstack([start, np.column_stack([track.time_s, track.position_m])])
    rides = Rides.of(positions, track.time_s, track.windows.time_s, is_moving(track.windows.standing_prob))
    notes = (*notes, *(note.text for note in notes_of_rides(rides, vertices)))
    origin, altitude = track.origin, Altitude()
    if origin is None and where.origin is not None and track.frame == "fixes" and track.n_steps:
        origin = replace(_turned(where.origin, smoothed), position_std_m=float(track.position_std_m.min()))
    if origin is not None and track.n_steps:
        for fix in locations:
            k = max(int(np.searchsorted(track.time_s, fix.time_s)) - 1, 0)
            if fix.altitude_m is not None:
                altitude = altitude.with_fix(fix, float(track.height_m[k]), float(track.height_std_m[k] ** 2))
        origin = altitude.of(origin)
    track = replace(track, origin=origin, notes=notes)
    return replace(smoothed, track=with_named_floors(track, observed.fixes), notes=notes)


def _turned(origin: Origin, smoothed: Smoothed) -> Origin:
    """Return an origin with the rotation of a smoothed walk into the frame of its fixes."""
    return replace(
        origin,
        turn_rad=float(smoothed.heading_offset_rad[0]),
        turn_std_rad=float(smoothed.heading_offset_std_rad.min()),
    )


def with_given_origin(run: Run, smoothed: Smoothed) -> Smoothed:
    """Return a smoothed walk with the geographic position and heading given by the caller of `smooth`.

    It is unchanged if neither is given.
    """
    before, track = smoothed.track, run.with_given_origin(smoothed.track)
    if track.frame == "fixes" and track.origin is not None and before.origin is None and track.n_steps:
        track = replace(track, origin=_turned(track.origin, smoothed))
    turn_rad = (
        track.origin.turn_rad if track.origin is not None and before.frame == "start" else run.georeference.heading_rad
    )
    if track.frame == before.frame or turn_rad is None:
        return replace(smoothed, track=track, notes=track.notes)
    rotation = scaled_rotation(np.array(turn_rad), np.array(0.0))
    return replace(
        smoothed,
        track=track,
        notes=track.notes,
        heading_offset_rad=read_only(wrap_angle(smoothed.heading_offset_rad + turn_rad)),
        start_position_m=track.start_position_m,
        start_position_cov_m2=read_only(rotation @ smoothed.start_position_cov_m2 @ rotation.T),
    )
