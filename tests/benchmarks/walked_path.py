"""Compare `OnlineFilter.path()` at the end of a walk with the truth, and with the online and smoothed tracks.

usage: python -m tests.benchmarks.walked_path [--data ../shared/data]

Accuracy: the median over walks, and the 90 % quantile, of the median error of a walk's points. With locations (walks of
ipin2023 on one storey) places are on the Earth, without any alignment. Without, they are after the best rotation and
shift onto all points: surveyed points of ipin2023, every third walk of ms_indoor, the reference at each step of oxiod.
"""

from __future__ import annotations

import argparse
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import pdr_filter as pdr
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.walked_path import walked_path
from pdr_filter.tracking.whole_recording import outputs, prepared_run, track_of_outputs
from pdr_filter.values import read_only
from pdr_filter.values.georeference import Georeference
from tests.benchmarks.common import Tables, median_and, paths, run

FloatArray = NDArray[np.float64]


def tracks(recording: pdr.Recording, gnss: str | None) -> dict[str, Track]:
    """The online track, the same with the places of the path in its end, and the smoothed track."""
    run = prepared_run(recording, None, (), Georeference(gnss))  # pyright: ignore[reportArgumentType]
    brought = list(outputs(run.recording, run.config, (), None, run.with_location, run.with_location))
    online = track_of_outputs(run.recording, run.config, brought)
    path = walked_path(run.config, brought[-1][0])
    at_m = np.column_stack([np.interp(online.time_s, path.time_s, axis) for axis in path.position_m.T])
    smoothed = pdr.smooth(recording, gnss=gnss).track  # pyright: ignore[reportArgumentType]
    return {"online": online, "path()": replace(online, position_m=read_only(at_m)), "smoothed": smoothed}


def aligned_errors_m(reference_m: FloatArray, at_m: FloatArray) -> FloatArray:
    """Distances (N,) after the best rotation and shift."""
    a, b = ((m - m.mean(axis=0)) @ [1, 1j] for m in (at_m, reference_m))
    turn = np.vdot(a, b)
    return np.abs(a * turn / abs(turn) - b)


def errors_m(path: Path, gnss: str | None) -> dict[str, float] | None:
    """Median error of the points of a walk for each estimate; None where it cannot be judged."""
    recording = pdr.read(path)
    points = recording.truth.waypoints if recording.truth.waypoints is not None else recording.truth.position
    if points is None or recording.gyroscope is None or ("floor" in points.dtype.names and len(set(points.floor)) > 1):
        return None
    reference_m = np.column_stack([points.east_m, points.north_m])
    if gnss is None and recording.location is None:
        return None
    found = dict[str, float]()
    for name, track in tracks(recording, gnss).items():
        if track.n_steps < 10:
            return None
        if gnss is None:
            first = re.search(r"First reference point at ([0-9.]+), ([0-9.]+)", str(recording.meta["notes"]))
            assert first is not None
            here = pdr.Origin(float(first[1]), float(first[2].rstrip(".")))
            place_m = here.east_north_m(track.latitude_deg, track.longitude_deg)
        else:
            place_m = track.position_m
        when_s, true_m = points.time_s, reference_m
        if len(when_s) > 200:  # a continuous reference
            when_s = track.time_s[(track.time_s > points.time_s[0]) & (track.time_s < points.time_s[-1])]
            true_m = np.column_stack([np.interp(when_s, points.time_s, axis) for axis in reference_m.T])
        at_m = np.column_stack([np.interp(when_s, track.time_s, axis) for axis in place_m.T])
        off_m = np.linalg.norm(at_m - true_m, axis=1) if gnss is None else aligned_errors_m(true_m, at_m)
        found[name] = float(np.median(off_m))
    return found


def accuracy(tables: Tables, arguments: argparse.Namespace) -> None:
    """Write the table of errors."""
    data: Path = arguments.data
    every_third = paths(data, "ms_indoor")[::3]
    oxiod = [path for path in paths(data, "oxiod") if "trolley" not in path.stem]
    groups = (
        ("ipin2023, locations", paths(data, "ipin2023"), None),
        ("ipin2023", paths(data, "ipin2023"), "off"),
        ("ms_indoor", every_third, "off"),
        ("oxiod", oxiod, "off"),
    )
    rows = list[list[str]]()
    for name, chosen, gnss in groups:
        walks = [found for path in chosen if (found := errors_m(path, gnss)) is not None]
        rows.append([f"{name} ({len(walks)})", *(median_and([w[e] for w in walks], 90) for e in walks[0])])
    columns = ["walks", "online m: median, 90 %", "`path()` at the end m", "smoothed m"]
    tables.write("walked_path", columns, rows, "Median errors of the points of each walk.")


if __name__ == "__main__":
    run(__doc__, accuracy)
