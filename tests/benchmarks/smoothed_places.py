"""Where a walk was on Earth: the phone's locations, the online and the smoothed track at surveyed points.

usage: python -m tests.benchmarks.smoothed_places [--data ../shared/data]

Walks of ipin2023 on one storey, each with the phone's own locations. The error of a walk is the root mean square over
its surveyed points, without any alignment; the shape is what is left after the best rotation and shift. The share of
points inside the ellipses of 50 and 95 % is over all points of a group. The errors of locations were described on
routes 01 and 02.
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


if __name__ == "__main__":
    run(__doc__, places)
