"""Numbers shown on the HTML report: columns of steps and windows, ground truth, and locations.

Numbers are rounded to the visible digits, and rows are thinned to the resolution of a screen, so that the page of a
whole day loads as fast as the page of a minute.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.apps.maps.floor_plan import FloorPlan
from pdr_filter.apps.report import palette
from pdr_filter.apps.report.geometry import (
    band_rows,
    ellipse_axes,
    ellipse_rows,
    places_at,
    shown_context_prob,
    storeys_of,
    window_starts,
)
from pdr_filter.tracking.trust_report import FARTHEST_M
from pdr_filter.values import BoolArray, FloatArray, IntArray, TrackRows, interpolated_rows, rigid_fit
from pdr_filter.values.recording import Recording

# Maximum number of rows of all tracks on a page. At 120 bytes per step and 25 per window or point they need < 1.3 MB.
_MAX_STEPS, _MAX_WINDOWS, _MAX_POINTS = 8000, 4000, 2000
# Maximum number of possible positions on a floor plan for each step. Further ones are improbable.
_MAX_PLACES = 4


def track_data(track: TrackRows, recording: Recording | None, plan: FloorPlan | None, n_tracks: int) -> dict[str, Any]:
    """Return the numbers of one track for the page, as a dict for JSON.

    It has columns of the shown steps, context windows and the floor plan, and with a recording also the ground truth
    and the locations. `n_tracks` tracks share the maximum number of rows.
    """
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
        "std": _column(
            np.where(np.isfinite(major_m), track.position_std_m[shown], np.nan), 1
        ),  # as in all other outputs
        "major": _column(major_m, 2),
        "minor": _column(minor_m, 2),
        "angle": _column(angle_rad, 3),
        "ellipses": _with_ellipse(track, shown, major_m),
        "band": [int(row) for row in band_rows(position_m, minor_m) if math.isfinite(major_m[row])],
        "prob": _percent(track.context_prob[shown]),
        "contexts": list(track.contexts),
        "context_colours": list(palette.context_colours(track.contexts).values()),
        "without_steps_colour": palette.WITHOUT_STEPS,
        "groups": _groups(track, shown),
        "windows": _windows(track, _MAX_WINDOWS // n_tracks),
        "plan": _plan(plan, track),
        "storey": int(track.floor[0]) if track.n_steps else 0,
    }
    if not track.is_level:
        data["height"] = _column(track.height_m[shown], 2)
        data["height_std"] = _column(track.height_std_m[shown], 3)
        data["floor"] = [track.known_floor[k] for k in shown.tolist()]
    if len(track.phone_heading_rad):
        data["phone_heading"] = _column(np.degrees(track.phone_heading_rad[shown]) % 360.0, 1)
    if len(track.phone_n_steps):
        data["phone_n_steps"] = _column(track.phone_n_steps[shown], 0)
    if len(track.anchors_m):
        data["anchors"] = _points(track.anchors_m)
    if any(places := [_places(track, row) for row in shown]):
        data["places"] = places
    if recording is not None:
        data |= _truth(track, recording, shown) | _locations(track, recording)
    return data


def _groups(track: TrackRows, shown: IntArray) -> dict[str, Any]:
    """Return the groups by which steps are coloured: contexts, and floors if the track has more than one."""
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
    """Return numbers for JSON, rounded to `digits` decimals, with None in place of NaN and infinity."""
    at = np.asarray(values, dtype=float)
    return [float(v) if math.isfinite(v) else None for v in np.round(at, digits)]


def _percent(prob: FloatArray) -> list[list[int]]:
    """Return probabilities (N, C) as C lists of N whole per cent, with 0 in place of NaN."""
    return np.round(100 * np.nan_to_num(prob)).astype(int).T.tolist()


def _subsample(n: int, most: int) -> IntArray:
    """Return about `most` evenly spaced indices out of `n`, and the last index."""
    return np.unique([*range(0, n, math.ceil(max(n, 1) / max(most, 1))), n - 1]) if n else np.zeros(0, dtype=np.int64)


def _shown_rows(track: TrackRows, most: int) -> IntArray:
    usable: BoolArray = (np.abs(track.position_m) < FARTHEST_M).all(axis=1) & np.isfinite(track.time_s)  # False for NaN
    rows = np.flatnonzero(usable)
    return rows[_subsample(len(rows), most)]


def _end_s(track: TrackRows) -> float:
    ends_s = [track.start_time_s + track.duration_s, *track.time_s[-1:], *track.windows.time_s[-1:]]
    return float(max([*(e for e in ends_s if math.isfinite(e)), track.start_time_s + 1.0]))


def _ellipses(cov_m2: FloatArray) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
    """Return the half axes of 95 % ellipses in m, and the angle of the longer one in rad, counter-clockwise from east.

    The half axes are a pair of arrays (N,), the longer ones first. Values are NaN for covariances that are not finite
    or too large to draw.
    """
    usable = (np.abs(cov_m2) < FARTHEST_M**2).all(axis=(1, 2))
    half_m, angle_rad = np.full((len(cov_m2), 2), np.nan), np.full(len(cov_m2), np.nan)
    half_m[usable], angle_rad[usable] = ellipse_axes(cov_m2[usable])
    return (half_m[:, 1], half_m[:, 0]), angle_rad


def _with_ellipse(track: TrackRows, shown: IntArray, major_m: FloatArray) -> list[int]:
    """Return the indices of the shown steps whose error ellipse is always drawn: at fixes, and the last."""
    if not len(shown):
        return []
    nearest = np.clip(np.searchsorted(shown, ellipse_rows(track)), 0, len(shown) - 1)
    return [int(row) for row in np.unique(nearest) if math.isfinite(major_m[row])]


def _windows(track: TrackRows, most: int) -> dict[str, Any]:
    """Return start, end and probabilities (per cent) of the windows, at most `most` by averaging.

    The last probability is that of moving without steps.
    """
    windows = track.windows
    start_s, _ = window_starts(windows, track.start_time_s)
    end_s, prob = windows.time_s, shown_context_prob(track)
    if len(windows) > most:
        # windows are grouped by time instead of index, so that gaps stay visible
        middle_s = 0.5 * (start_s + end_s) - track.start_time_s
        _, first, count = np.unique(
            np.floor(most * middle_s / (_end_s(track) - track.start_time_s)), return_index=True, return_counts=True
        )
        start_s, end_s = start_s[first], end_s[first + count - 1]
        prob = np.add.reduceat(prob, first, axis=0) / count[:, np.newaxis]
    return {"start": _column(start_s, 2), "end": _column(end_s, 2), "prob": _percent(prob)}


def _places(track: TrackRows, row: int) -> list[list[float | None]]:
    """Return the possible positions on a floor plan after a step, at most four, or an empty list if there is only one.

    Each has the probability in per cent, east and north, and half axes and angle of its ellipse.
    """
    found: list[list[float | None]] = []
    for place in places_at(track, row)[:_MAX_PLACES]:
        (major_m, minor_m), angle_rad = _ellipses(place.position_cov_m2[np.newaxis])
        shape = [*place.position_m, *major_m, *minor_m, *angle_rad]
        found.append([round(100 * place.share), *_column(shape, 2)])
    return found


def _plan(plan: FloorPlan | None, track: TrackRows) -> list[dict[str, Any]]:
    """Return the shapes of the storeys that the track has visited, in drawing order. Empty without a plan."""
    return [
        {
            "fill": colour if feature.is_area else None,
            "edge": palette.WALL if feature.is_area or kind == "wall" else colour,
            "width": 1.2 if feature.is_area else palette.PLAN_WIDTHS[kind],
            "rings": [np.round(ring, 2).tolist() for ring in feature.lines],
        }
        for storey in storeys_of(plan, track.floor)
        for kind, colour in palette.PLAN_COLOURS.items()
        for feature in storey.features
        if feature.kind == kind
    ]


def _truth(track: TrackRows, recording: Recording, shown: IntArray) -> dict[str, Any]:
    """Return the true path, or the waypoints, after rigid alignment to the whole track, whose frame is unrelated.

    The error of each step is added for a true path. The result is empty with fewer than two known points.
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
    rows = _subsample(len(time_s), _MAX_POINTS)
    found: dict[str, Any] = {"truth": _points(way_m[rows]) | {"points": position is None}}
    if position is not None:
        true_m = interpolated_rows(track.time_s[shown], time_s, way_m)
        found["from_truth"] = _column(np.linalg.norm(track.position_m[shown] - true_m, axis=1), 2)
    return found


def _positions_at(track: TrackRows, shown: IntArray, at_s: FloatArray) -> FloatArray:
    """Return the track positions (T, 2) at given times, interpolated between the steps that the page draws."""
    time_s = np.append(track.start_time_s, track.time_s[shown])
    way_m = np.vstack([track.start_position_m, track.position_m[shown]])
    return interpolated_rows(at_s, time_s, way_m)


def _locations(track: TrackRows, recording: Recording) -> dict[str, Any]:
    """Return the locations of the phone in the frame of the track, with accuracies in m, if it is geographic."""
    if recording.location is None or track.origin is None or track.frame == "start":
        return {}
    values = recording.location.values
    place_m = track.origin.east_north_m(values[:, 0], values[:, 1])
    usable = np.flatnonzero((np.abs(place_m) < FARTHEST_M).all(axis=1))
    rows = usable[_subsample(len(usable), _MAX_POINTS)]
    return {"gps": _points(place_m[rows]) | {"accuracy": _column(values[rows, 3], 1)}} if len(rows) else {}


def _points(position_m: FloatArray) -> dict[str, Any]:
    return {"east": _column(position_m[:, 0], 2), "north": _column(position_m[:, 1], 2)}
