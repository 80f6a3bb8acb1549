"""What the page of a track shows, as plain numbers: columns of the steps and windows, the truth and the locations.

Numbers have as many digits as can be seen, and what is finer than a screen is left out, so that the page of a day is as
quick as that of a minute.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.maps.floor_plan import FloorPlan
from pdr_filter.report import palette
from pdr_filter.report.geometry import ellipse_axes, ellipse_rows, places_at, storeys_of, window_starts
from pdr_filter.tracking.trust_report import FARTHEST_M
from pdr_filter.values import BoolArray, FloatArray, IntArray, TrackRows, interpolated, rigid_fit
from pdr_filter.values.recording import Recording

# Rows of all tracks of a page together: 120 bytes a step and 25 a window or a point make less than 1.3 MB.
_MAX_STEPS, _MAX_WINDOWS, _MAX_POINTS = 8000, 4000, 2000
# Of the places where a walk may be on a plan; those after them are improbable.
_MAX_PLACES = 4


def track_data(track: TrackRows, recording: Recording | None, plan: FloorPlan | None, n_tracks: int) -> dict[str, Any]:
    """One of so many tracks."""
    shown = _shown_rows(track, _MAX_STEPS // n_tracks)
    position_m = track.position_m[shown]
    (major_m, minor_m), angle_rad = _ellipses(track.position_cov_m2[shown])
    data: dict[str, Any] = {
        "n_steps": track.n_steps,
        "start": _column(track.start_position_m, 2),
        "start_s": track.start_time_s,
        "end_s": _end_s(track),
        "number": (shown + 1).tolist(),
        "time": _column(track.time_s[shown], 2),
        "east": _column(position_m[:, 0], 2),
        "north": _column(position_m[:, 1], 2),
        "length": _column(track.step_length_m[shown], 3),
        "walked": _column(track.walked_m[shown], 1),
        "heading": _column(np.degrees(track.walking_heading_rad[shown]) % 360.0, 1),
        "speed": _column(track.smoothed_speed_mps[shown], 2),
        "speed_std": _column(track.smoothed_speed_std_mps[shown], 3),
        "std": _column(np.where(np.isfinite(major_m), track.position_std_m[shown], np.nan), 1),  # as all reports say it
        "major": _column(major_m, 2),
        "minor": _column(minor_m, 2),
        "angle": _column(angle_rad, 3),
        "ellipses": _with_ellipse(track, shown, major_m),
        "prob": _percent(track.context_prob[shown]),
        "contexts": list(track.contexts),
        "context_colours": list(palette.context_colours(track.contexts).values()),
        "groups": _groups(track, shown),
        "windows": _windows(track, _MAX_WINDOWS // n_tracks),
        "plan": _plan(plan, track),
    }
    if not track.is_level:
        data["height"] = _column(track.height_m[shown], 2)
        data["height_std"] = _column(track.height_std_m[shown], 3)
        data["floor"] = track.floor[shown].tolist()
    if len(track.anchors_m):
        data["anchors"] = _points(track.anchors_m)
    if any(places := [_places(track, row) for row in shown]):
        data["places"] = places
    if recording is not None:
        data |= _truth(track, recording, shown) | _locations(track, recording)
    return data


def _groups(track: TrackRows, shown: IntArray) -> dict[str, Any]:
    """By what steps can be coloured: for each kind the names, their colours, and the number of each step's."""
    colours = palette.context_colours(track.contexts)
    kinds = {"contexts": _group(colours, track.context_prob[shown].argmax(axis=1))}
    floors = palette.floor_colours(track.floor.tolist())
    if len(floors) > 1:
        named = {f"floor {floor}": colour for floor, colour in floors.items()}
        kinds["floors"] = _group(named, np.searchsorted(list(floors), track.floor[shown]))
    return kinds


def _group(colours: dict[str, str], number: IntArray) -> dict[str, Any]:
    return {"names": list(colours), "colours": list(colours.values()), "group": number.tolist()}


def _column(values: ArrayLike, digits: int) -> list[float | None]:
    """Numbers as JSON has them: without NaN, and short."""
    at = np.asarray(values, dtype=float)
    return [float(v) if math.isfinite(v) else None for v in np.round(at, digits)]


def _percent(prob: FloatArray) -> list[list[int]]:
    """A column of whole per cents for each context."""
    return np.round(100 * np.nan_to_num(prob)).astype(int).T.tolist()


def _every(n: int, most: int) -> IntArray:
    """At most about so many of n rows, evenly, and the last."""
    return np.unique([*range(0, n, math.ceil(max(n, 1) / max(most, 1))), n - 1]) if n else np.zeros(0, dtype=np.int64)


def _shown_rows(track: TrackRows, most: int) -> IntArray:
    usable: BoolArray = (np.abs(track.position_m) < FARTHEST_M).all(axis=1) & np.isfinite(track.time_s)  # NaN is not
    rows = np.flatnonzero(usable)
    return rows[_every(len(rows), most)]


def _end_s(track: TrackRows) -> float:
    ends_s = [track.start_time_s + track.duration_s, *track.time_s[-1:], *track.windows.time_s[-1:]]
    return float(max([*(e for e in ends_s if math.isfinite(e)), track.start_time_s + 1.0]))


def _ellipses(cov_m2: FloatArray) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
    """Half axes of 95 % ellipses, the longer one first, and its angle from east; NaN where nothing can be drawn."""
    usable = (np.abs(cov_m2) < FARTHEST_M**2).all(axis=(1, 2))
    half_m, angle_rad = np.full((len(cov_m2), 2), np.nan), np.full(len(cov_m2), np.nan)
    half_m[usable], angle_rad[usable] = ellipse_axes(cov_m2[usable])
    return (half_m[:, 1], half_m[:, 0]), angle_rad


def _with_ellipse(track: TrackRows, shown: IntArray, major_m: FloatArray) -> list[int]:
    """Shown rows whose ellipse is always drawn."""
    if not len(shown):
        return []
    nearest = np.clip(np.searchsorted(shown, ellipse_rows(track.step_length_m)), 0, len(shown) - 1)
    return [int(row) for row in np.unique(nearest) if math.isfinite(major_m[row])]


def _windows(track: TrackRows, most: int) -> dict[str, Any]:
    """The windows, as many of them together as it takes to have no more columns than can be seen."""
    windows = track.windows
    start_s, _ = window_starts(windows, track.start_time_s)
    end_s, prob = windows.time_s, windows.context_prob
    if len(windows) > most:
        # By place and not by number, so that what is missing stays missing.
        middle_s = 0.5 * (start_s + end_s) - track.start_time_s
        _, first, count = np.unique(
            np.floor(most * middle_s / (_end_s(track) - track.start_time_s)), return_index=True, return_counts=True
        )
        start_s, end_s = start_s[first], end_s[first + count - 1]
        prob = np.add.reduceat(prob, first, axis=0) / count[:, np.newaxis]
    return {"start": _column(start_s, 2), "end": _column(end_s, 2), "prob": _percent(prob)}


def _places(track: TrackRows, row: int) -> list[list[float | None]]:
    """Of each place where a walk may be after a step: per cent, east and north, half axes and angle of its ellipse."""
    found: list[list[float | None]] = []
    for place in places_at(track, row)[:_MAX_PLACES]:
        (major_m, minor_m), angle_rad = _ellipses(place.position_cov_m2[np.newaxis])
        shape = [*place.position_m, *major_m, *minor_m, *angle_rad]
        found.append([round(100 * place.share), *_column(shape, 2)])
    return found


def _plan(plan: FloorPlan | None, track: TrackRows) -> list[dict[str, Any]]:
    """Shapes of the storeys that the track was on, those that lie below first."""
    return [
        {
            "fill": colour if feature.is_area else None,
            "edge": palette.WALL if feature.is_area or kind == "wall" else colour,
            "rings": [np.round(ring, 2).tolist() for ring in feature.lines],
        }
        for storey in storeys_of(plan, track.floor)
        for kind, colour in palette.PLAN_COLOURS.items()
        for feature in storey.features
        if feature.kind == kind
    ]


def _truth(track: TrackRows, recording: Recording, shown: IntArray) -> dict[str, Any]:
    """The true way, or its waypoints, turned and moved so that it fits the whole track best.

    Nothing says how the frames of the two lie. How far a step is from the truth is known where the truth is a way.
    """
    position, waypoints = recording.truth.position, recording.truth.waypoints
    table = position if position is not None else waypoints
    if table is None or not track.n_steps:
        return {}
    way_m = np.column_stack([table["east_m"], table["north_m"]])
    usable = np.isfinite(way_m).all(axis=1) & np.isfinite(table["time_s"])
    time_s, way_m = np.asarray(table["time_s"])[usable], way_m[usable]
    if len(time_s) < 2:
        return {}
    rotation, shift_m = rigid_fit(way_m, _positions_at(track, shown, time_s))
    way_m = way_m @ rotation.T + shift_m
    rows = _every(len(time_s), _MAX_POINTS)
    found: dict[str, Any] = {"truth": _points(way_m[rows]) | {"points": position is None}}
    if position is not None:
        true_m = interpolated(track.time_s[shown], time_s, way_m)
        found["from_truth"] = _column(np.linalg.norm(track.position_m[shown] - true_m, axis=1), 2)
    return found


def _positions_at(track: TrackRows, shown: IntArray, at_s: FloatArray) -> FloatArray:
    """Where the shown steps are at any times, (T, 2)."""
    time_s = np.append(track.start_time_s, track.time_s[shown])
    way_m = np.vstack([track.start_position_m, track.position_m[shown]])
    return interpolated(at_s, time_s, way_m)


def _locations(track: TrackRows, recording: Recording) -> dict[str, Any]:
    """The phone's own locations, if the track says where they are in its frame."""
    if recording.location is None or track.origin is None or not track.knows_north:
        return {}
    values = recording.location.values
    place_m = track.origin.east_north_m(values[:, 0], values[:, 1])
    usable = np.flatnonzero((np.abs(place_m) < FARTHEST_M).all(axis=1))
    rows = usable[_every(len(usable), _MAX_POINTS)]
    return {"gps": _points(place_m[rows]) | {"accuracy": _column(values[rows, 3], 1)}} if len(rows) else {}


def _points(position_m: FloatArray) -> dict[str, Any]:
    return {"east": _column(position_m[:, 0], 2), "north": _column(position_m[:, 1], 2)}
