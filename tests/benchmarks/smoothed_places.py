"""Where a walk was on Earth: the phone's locations, the online and the smoothed track at surveyed points.

usage: python -m tests.benchmarks.smoothed_places [places] [loops] [--data ../shared/data]

Walks of ipin2023 on one storey, each with the phone's own locations. The error of a walk is the root mean square over
its surveyed points, without any alignment; the shape is what is left after the best rotation and shift. The share of
points inside the ellipses of 50 and 95 % is over all points of a group. The errors of locations were described on
routes 01 and 02.

Loops: the shape error with and without the statement that the walk ended where it began, without locations; on closed
walks, and on walks for which the statement is false.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

import pdr_filter as pdr
from tests.benchmarks.common import Tables, median_and, paths, run

FloatArray = NDArray[np.float64]
GROUPS = {"all": r"trial", "routes 01, 02": r"trial0", "routes 21 to 23": r"trial2"}
QUANTILES = (0.5, 0.95)


def shape_error_m(reference_m: FloatArray, at_m: FloatArray) -> float:
    """Root mean square distance after the best rotation and shift."""
    a, b = at_m - at_m.mean(axis=0), reference_m - reference_m.mean(axis=0)
    turn = np.conj((a @ [1, 1j]) @ np.conj(b @ [1, 1j]))
    return float(np.sqrt(np.mean(np.abs((a @ [1, 1j]) * turn / abs(turn) - b @ [1, 1j]) ** 2)))


def scored(path: Path) -> dict[str, tuple[float, float, FloatArray]] | None:
    """Position error, shape error and squared Mahalanobis distances of each estimate of a walk."""
    recording = pdr.read(path)
    points, location = recording.truth.waypoints, recording.location
    first = re.search(r"First reference point at ([0-9.]+), ([0-9.]+)", str(recording.meta["notes"]))
    if location is None or first is None or len(set(points.floor)) > 1:
        return None
    here = pdr.Origin(float(first[1]), float(first[2].rstrip(".")))
    reference_m = np.column_stack([points.east_m, points.north_m])

    def places_m(time_s: FloatArray, latitude_deg: FloatArray, longitude_deg: FloatArray) -> FloatArray:
        east_north_m = here.east_north_m(latitude_deg, longitude_deg)
        return np.column_stack([np.interp(points.time_s, time_s, east_north_m[:, k]) for k in (0, 1)])

    found = dict[str, tuple[float, float, FloatArray]]()
    error_m = places_m(location.time_s, *location.values.T[:2]) - reference_m
    found["locations of the phone"] = float(np.sqrt((error_m**2).sum(axis=1).mean())), np.nan, np.zeros(0)
    for name, track in (("online", pdr.track(recording)), ("smoothed", pdr.smooth(recording).track)):
        at_m = places_m(track.time_s, track.latitude_deg, track.longitude_deg)
        error_m = at_m - reference_m
        k = np.clip(np.searchsorted(track.time_s, points.time_s), 0, track.n_steps - 1)
        squares = np.einsum("ka,kab,kb->k", error_m, np.linalg.inv(track.position_cov_m2[k]), error_m)
        found[name] = float(np.sqrt((error_m**2).sum(axis=1).mean())), shape_error_m(reference_m, at_m), squares
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
                inside = [np.mean(np.concatenate(squares) < chi2.ppf(q, 2)) for q in QUANTILES]
                row += [median_and(shapes, 90, 2), *(f"{100 * share:.0f} %" for share in inside)]
            rows.append([*row, "", "", ""][:6])
    columns = ["walks", "estimate", "position m: median, 90 %", "shape m: median, 90 %", "in 50 %", "in 95 %"]
    about = "ipin2023. The errors of locations were described on routes 01 and 02."
    tables.write("smoothed_places", columns, rows, about)


def loops(tables: Tables, arguments: argparse.Namespace) -> None:
    """What it gains and costs to say that a walk ended where it began."""
    groups = {
        "humolire, closed": ("humolire", 0.0, 1.0, "true"),
        "ms_indoor, ends 5 m or more away": ("ms_indoor", 5.0, np.inf, "false"),
        "ipin2023, begins with a phone in busy hands": ("ipin2023", 0.0, 1.0, "true"),
    }
    rows = list[list[str]]()
    for group, (site, least_m, most_m, statement) in groups.items():
        errors_m, n_rejected = list[tuple[float, float]](), 0
        for path in paths(arguments.data, site):
            recording = pdr.read(path)
            truth = recording.truth
            points = truth.waypoints if truth.waypoints is not None else truth.position
            if points is None or ("floor" in points.dtype.names and len(set(points.floor)) > 1):
                continue
            reference_m = np.column_stack([points.east_m, points.north_m])
            if not least_m <= np.linalg.norm(reference_m[-1] - reference_m[0]) < most_m:
                continue
            pair = list[float]()
            for loop in (False, True):
                smoothed = pdr.smooth(recording, gnss="off", loop=loop)
                track = smoothed.track
                at_m = np.column_stack([np.interp(points.time_s, track.time_s, axis) for axis in track.position_m.T])
                pair.append(shape_error_m(reference_m, at_m))
            errors_m.append((pair[0], pair[1]))
            n_rejected += any("loop was not used" in note for note in smoothed.notes)
        without, with_loop = np.array(errors_m).T
        shape = f"{np.median(without):.2f}, {np.median(with_loop):.2f}"
        rows.append([f"{group} ({len(errors_m)})", statement, shape, str(n_rejected)])
    columns = ["walks, without locations", "the statement is", "shape m: median, without and with it", "rejected"]
    tables.write("smoothed_loops", columns, rows, "Closed walks end within 1 m of their start.")


if __name__ == "__main__":
    run(__doc__, places, loops)
