"""Online and smoothed places of walks, and `OnlineFilter.path()` at the end of a walk, against surveyed points.

usage: python -m tests.benchmarks.smoothed_places [places] [path] [--data ../shared/data]

places: where a walk was on Earth, for walks of ipin2023 on one storey, each with the phone's own locations. The error
of a walk is the root mean square over its surveyed points, without any alignment; the shape is what is left after the
best rotation and shift. The share of points inside the ellipses of 50 and 95 % is over all points of a group. The
errors of locations were described on routes 01 and 02.

path: the median over walks, and the 90 % quantile, of the median error of a walk's points. With locations (walks of
ipin2023 on one storey) places are on the Earth, without any alignment. Without, they are after the best rotation and
shift onto all points: surveyed points of ipin2023, every third walk of ms_indoor, the reference at each step of oxiod.
"""

from __future__ import annotations

import argparse
import re
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.walked_path import walked_path
from pdr_filter.tracking.whole_recording import outputs, prepared_run, track_of_outputs
from pdr_filter.values import FloatArray, interpolated_rows, read_only
from pdr_filter.values.georeference import Georeference
from tests.benchmarks.common import HALF, MOST, Tables, median_and, paths, places_of, run

GROUPS = {"all": r"trial", "routes 01, 02": r"trial0", "routes 21 to 23": r"trial2"}


def origin_of(recording: pdr.Recording) -> pdr.Origin:
    """Place on Earth of the first surveyed point of a walk of ipin2023, where its truth begins."""
    first = re.search(r"First reference point at ([0-9.]+), ([0-9.]+)", str(recording.meta["notes"]))
    assert first is not None
    return pdr.Origin(float(first[1]), float(first[2].rstrip(".")))


def is_on_one_storey(points: np.recarray) -> bool:
    return "floor" not in points.dtype.names or len(set(points.floor)) == 1


def aligned_errors_m(reference_m: FloatArray, at_m: FloatArray) -> FloatArray:
    """Distances (N,) after the best rotation and shift."""
    a, b = ((m - m.mean(axis=0)) @ [1, 1j] for m in (at_m, reference_m))
    turn = np.vdot(a, b)
    return np.abs(a * turn / abs(turn) - b)


def rms(distances_m: FloatArray) -> float:
    return float(np.sqrt(np.mean(distances_m**2)))


# --- places on Earth --------------------------------------------------------------------------------------------------


def scored(path: Path) -> dict[str, tuple[float, float, FloatArray]] | None:
    """Position error, shape error and squared Mahalanobis distances of each estimate of a walk."""
    recording = pdr.read(path)
    points, location = recording.truth.waypoints, recording.location
    if location is None or not is_on_one_storey(points):
        return None
    here, reference_m = origin_of(recording), places_of(points)

    def places_m(time_s: FloatArray, latitude_deg: FloatArray, longitude_deg: FloatArray) -> FloatArray:
        return interpolated_rows(points.time_s, time_s, here.east_north_m(latitude_deg, longitude_deg))

    error_m = places_m(location.time_s, *location.values.T[:2]) - reference_m
    found = {"locations of the phone": (rms(np.linalg.norm(error_m, axis=1)), np.nan, np.zeros(0))}
    for name, track in (("online", pdr.track(recording)), ("smoothed", pdr.smooth(recording).track)):
        at_m = places_m(track.time_s, track.latitude_deg, track.longitude_deg)
        error_m = at_m - reference_m
        k = np.clip(np.searchsorted(track.time_s, points.time_s), 0, track.n_steps - 1)
        squares = evaluate.nees(error_m, track.position_cov_m2[k])
        shape_m = rms(aligned_errors_m(reference_m, at_m))
        found[name] = rms(np.linalg.norm(error_m, axis=1)), shape_m, squares
    return found


def places(tables: Tables, arguments: argparse.Namespace) -> None:
    """Smoothed places of ipin2023."""
    walks = {path.stem: scored(path) for path in paths(arguments.data, "ipin2023")}
    rows = list[list[str]]()
    for group, pattern in GROUPS.items():
        chosen = [found for name, found in walks.items() if found is not None and re.search(pattern, name)]
        for estimate in chosen[0]:
            errors, shapes, squares = zip(*(found[estimate] for found in chosen), strict=True)
            row = [f"{group} ({len(chosen)})", estimate, median_and(errors, 90, 1)]
            if np.isfinite(shapes[0]):
                inside = [np.mean(np.concatenate(squares) < limit) for limit in (HALF, MOST)]
                row += [median_and(shapes, 90, 2), *(f"{100 * share:.0f} %" for share in inside)]
            rows.append([*row, "", "", ""][:6])
    columns = "walks | estimate | position m: median, 90 % | shape m: median, 90 % | in 50 % | in 95 %"
    about = "ipin2023. The errors of locations were described on routes 01 and 02."
    tables.write("smoothed_places", columns, rows, about)


# --- the path at the end of a walk ------------------------------------------------------------------------------------


def tracks(recording: pdr.Recording, gnss: Literal["off"] | None) -> dict[str, Track]:
    """The online track, the same with the places of the path in its end, and the smoothed track."""
    run = prepared_run(recording, None, (), Georeference(gnss))
    brought = list(outputs(run.recording, run.config, (), None, run.with_location, run.with_location))
    online = track_of_outputs(run.recording, run.config, brought)
    path = walked_path(run.config, brought[-1][0])
    at_m = interpolated_rows(online.time_s, path.time_s, path.position_m)
    smoothed = pdr.smooth(recording, gnss=gnss).track
    return {"online": online, "path()": replace(online, position_m=read_only(at_m)), "smoothed": smoothed}


def errors_m(path: Path, gnss: Literal["off"] | None) -> dict[str, float] | None:
    """Median error of the points of a walk for each estimate; None where it cannot be judged."""
    recording = pdr.read(path)
    points = recording.truth.waypoints if recording.truth.waypoints is not None else recording.truth.position
    if points is None or recording.gyroscope is None or not is_on_one_storey(points):
        return None
    if gnss is None and recording.location is None:
        return None
    found = dict[str, float]()
    for name, track in tracks(recording, gnss).items():
        if track.n_steps < 10:
            return None
        when_s, true_m, place_m = points.time_s, places_of(points), track.position_m
        if gnss is None:
            place_m = origin_of(recording).east_north_m(track.latitude_deg, track.longitude_deg)
        if len(when_s) > 200:  # a continuous reference
            when_s = track.time_s[(track.time_s > points.time_s[0]) & (track.time_s < points.time_s[-1])]
            true_m = interpolated_rows(when_s, points.time_s, true_m)
        at_m = interpolated_rows(when_s, track.time_s, place_m)
        off_m = np.linalg.norm(at_m - true_m, axis=1) if gnss is None else aligned_errors_m(true_m, at_m)
        found[name] = float(np.median(off_m))
    return found


def path(tables: Tables, arguments: argparse.Namespace) -> None:
    """Errors of the path at the end of walks."""
    groups = {
        "ipin2023, locations": (paths(arguments.data, "ipin2023"), None),
        "ipin2023": (paths(arguments.data, "ipin2023"), "off"),
        "ms_indoor": (paths(arguments.data, "ms_indoor")[::3], "off"),
        "oxiod": ([p for p in paths(arguments.data, "oxiod") if "trolley" not in p.stem], "off"),
    }
    rows = list[list[str]]()
    for name, (chosen, gnss) in groups.items():
        walks = [found for p in chosen if (found := errors_m(p, gnss)) is not None]
        rows.append([f"{name} ({len(walks)})", *(median_and([w[e] for w in walks], 90) for e in walks[0])])
    columns = "walks | online m: median, 90 % | `path()` at the end m | smoothed m"
    tables.write("walked_path", columns, rows, "Median errors of the points of each walk.")


if __name__ == "__main__":
    run(__doc__, places, path)
