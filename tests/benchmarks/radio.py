"""Wi-Fi of a shopping mall: a radio map on walks left out of it.

usage: python -m tests.benchmarks.radio [fixes] [storeys] [walks] [start] [--data DIR]

99 walks of `ms_indoor` with Wi-Fi on five storeys, 40 on F1 and 14 or 15 on each other one. Kernel, noise, evidence,
variances and likeness were chosen on F1; what is reported are the others beside it. A walk is never in
the map that it is located with: the map is that of all other walks of its storey, placed between their waypoints by
`pdr_filter.smooth`. Truth at a scan is the walk's own such track, at a waypoint the waypoint.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.offline.smoothing.observations import waypoint_fixes
from pdr_filter.offline.smoothing.wifi_loops import wifi_loop_closures
from pdr_filter.values import interpolated_rows
from tests.benchmarks.common import HALF, MOST, Tables, median_and, paths, run

CHOSEN_ON = "f1"
START_STD_RAD = np.radians(10.0)


@dataclass(frozen=True, eq=False)
class Known:
    """A walk and where it was."""

    recording: pdr.Recording
    track: pdr.Track  # between its waypoints
    points: np.ndarray  # (W, 3) time, east, north

    @property
    def storey(self) -> str:
        return self.recording.name.split("_")[4]

    def place(self, time_s: float) -> np.ndarray:
        return place(self.track, time_s)


def place(track: pdr.Track, time_s: float) -> np.ndarray:
    times = np.concatenate([[min(track.start_time_s, track.time_s[0]) - 1e-3], track.time_s])
    return interpolated_rows(time_s, times, np.vstack([track.start_position_m, track.position_m]))


@cache
def known_walks(data: Path) -> list[Known]:
    found: list[Known] = []
    for path in paths(data, "ms_indoor"):
        recording = pdr.read(path)
        if recording.wifi is None:
            continue
        w = recording.truth.waypoints
        track = pdr.smooth(recording, fixes=waypoint_fixes(recording)).track
        found.append(Known(recording, track, np.column_stack([w.time_s, w.east_m, w.north_m])))
    return found


def map_of(walks: Sequence[Known]) -> pdr.RadioMap:
    """With storeys, which tracks do not say."""
    maps = [pdr.RadioMap.fit([(k.recording, k.track)]) for k in walks]
    bssid = np.unique(np.concatenate([m.bssid for m in maps]))
    before = np.cumsum([0, *(len(m.floor) for m in maps)])
    floors = [float(k.recording.truth.waypoints.floor[0]) for k in walks]
    return pdr.RadioMap(
        position_m=np.concatenate([m.position_m for m in maps]),
        floor=np.concatenate([np.full(len(m.floor), f) for m, f in zip(maps, floors, strict=True)]),
        bssid=bssid,
        point=np.concatenate([m.point + n for m, n in zip(maps, before[:-1], strict=True)]),
        access_point=np.concatenate([np.searchsorted(bssid, m.bssid[m.access_point]) for m in maps]),
        rssi_dbm=np.concatenate([m.rssi_dbm for m in maps]),
    )


def left_out(walks: Sequence[Known]) -> Iterator[tuple[Known, list[Known]]]:
    """Each walk with all others of its storey."""
    for walk in walks:
        yield walk, [k for k in walks if k is not walk and k.storey == walk.storey]


@cache
def located(data: Path) -> dict[str, list[pdr.PositionFix]]:
    """Fixes of each walk by the map of the others of its storey."""
    return {k.recording.name: map_of(others).fixes(k.recording) for k, others in left_out(known_walks(data))}


# --- fixes -----------------------------------------------------------------------------------------------------------


def scores(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[str]:
    """Of errors (2,) and covariances (2, 2): how many, how far, in 50 and 95 % regions, mean log density."""
    error, cov = np.array([e for e, _ in pairs]), np.array([c for _, c in pairs])
    nees = evaluate.nees(error, cov)
    loss = 0.5 * nees + 0.5 * np.log(np.linalg.det(cov)) + np.log(2 * np.pi)
    shares = [f"{100 * (nees < limit).mean():.0f} %" for limit in (HALF, MOST)]
    far = np.hypot(*error.T)
    quantiles = [f"{value:.1f} m" for value in (np.median(far), np.percentile(far, 90))]
    return [str(len(error)), *quantiles, *shares, f"{loss.mean():.2f}"]


def errors_of(walk: Known, fixes: Sequence[pdr.PositionFix]) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(walk.place(f.time_s) - f.position_m, f.cov_m2) for f in fixes]


def by_storey(walks: Sequence[Known]) -> Iterator[tuple[str, list[Known]]]:
    for storey in sorted({k.storey for k in walks}):
        yield storey.upper() + (" (chosen on)" if storey == CHOSEN_ON else ""), [k for k in walks if k.storey == storey]
    yield "all but F1", [k for k in walks if k.storey != CHOSEN_ON]


def fixes(tables: Tables, arguments: argparse.Namespace) -> None:
    """Fixes of each storey."""
    known, found = known_walks(arguments.data), located(arguments.data)
    rows: list[list[str]] = []
    for name, group in by_storey(known):
        asked = [s for k in group for s in k.recording.wifi.scans()]
        pairs = [e for k in group for e in errors_of(k, found[k.recording.name])]
        without = sum(not found[k.recording.name] for k in group)
        rows.append([name, str(len(group)), str(without), str(len(asked)), *scores(pairs)])
    columns = "storey | walks | without a fix | scans | fixes | median | 90 % | in 50 % region | in 95 % | -log density"
    about = "Each walk by the map of all others of its storey."
    tables.write("radio_fixes", columns, rows, about)


def storeys(tables: Tables, arguments: argparse.Namespace) -> None:
    """Which storey, by one map of all five, without a tenth of the walks at a time."""
    known = known_walks(arguments.data)
    told: dict[str, list[tuple[int | None, int]]] = {}
    for i in range(10):
        asked = list(known[i::10])
        radio = map_of([k for k in known if k not in asked])
        for k in asked:
            true = int(k.recording.truth.waypoints.floor[0])
            told.setdefault(k.storey, []).extend((f.floor, true) for f in radio.fixes(k.recording))
    rows: list[list[object]] = []
    for storey, pairs in sorted(told.items()):
        said = [(f, true) for f, true in pairs if f is not None]
        right = sum(f == true for f, true in said)
        rows.append(
            [storey.upper(), len(pairs), f"{100 * len(said) / len(pairs):.0f} %", f"{100 * right / len(said):.1f} %"]
        )
    about = "One map of all storeys, of nine tenths of the known."
    tables.write("radio_storeys", ["storey", "fixes", "storey given", "of these right"], rows, about)


# --- walks -----------------------------------------------------------------------------------------------------------


def from_start(walk: Known, fixes: Sequence[pdr.PositionFix]) -> tuple[np.ndarray, list[pdr.PositionFix]]:
    """Waypoints and fixes where the first waypoint is the origin and the first leg points north."""
    east_m, north_m = walk.points[1, 1:] - walk.points[0, 1:]
    heading = np.arctan2(east_m, north_m)
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    points = np.column_stack([walk.points[:, 0], (walk.points[:, 1:] - walk.points[0, 1:]) @ turn.T])
    turned = [
        replace(f, position_m=turn @ (f.position_m - walk.points[0, 1:]), cov_m2=turn @ f.cov_m2 @ turn.T)
        for f in fixes
    ]
    return points, turned


def mean_error_m(track: pdr.Track, points: np.ndarray) -> float:
    """At the waypoints after the first."""
    return float(np.mean([np.hypot(*(place(track, t) - (e, n))) for t, e, n in points[1:]]))


def walks(tables: Tables, arguments: argparse.Namespace) -> None:
    """Tracks from a known start, with the map, loops, and both."""
    every, by_map = known_walks(arguments.data), located(arguments.data)
    names = ("dead reckoning", "+ radio map", "smoothed", "+ loops", "+ radio map", "+ both")
    all_errors: list[list[float]] = []
    for walk in every:
        points, radio = from_start(walk, by_map[walk.recording.name])
        here = pdr.PositionFix(points[0, 0], points[0, 1:], 0.25 * np.eye(2))

        def smoothed(known: Sequence[pdr.PositionFix], loops: bool, walk: Known = walk) -> pdr.Track:
            closed = wifi_loop_closures(walk.recording) if loops else ()
            return pdr.smooth(
                walk.recording, fixes=known, loop_closures=closed, start_heading_std_rad=START_STD_RAD
            ).track

        both = [here, *radio]
        tracks = [pdr.track(walk.recording, fixes=fixes) for fixes in ([here], both)]
        tracks += [smoothed(fixes, loops) for fixes in ([here], both) for loops in (False, True)]
        all_errors.append([mean_error_m(track, points) for track in tracks])
    error = np.array(all_errors)
    long = np.array([k.recording.duration_s >= 45 for k in every])
    summary: list[list[str]] = []
    for name, group in (
        *by_storey(every),
        ("45 s and longer, all but F1", [k for k in every if k.storey != CHOSEN_ON]),
    ):
        chosen_rows = np.array([k in group for k in every]) & (long | (not name.startswith("45")))
        e = error[chosen_rows]
        worse = (e > 1.1 * e[:, :1]).mean(axis=0)
        cells = [f"{median_and(e[:, j], 90, 1)} ({100 * worse[j]:.0f} %)" for j in range(len(names))]
        summary.append([name, str(len(e)), *cells])
    tables.write(
        "radio_main",
        ["storey", "walks", *names],
        summary,
        "Median and 90 % of the walks' errors, m, and the share of walks that is worse than 1.1 times dead reckoning.",
    )


def start(tables: Tables, arguments: argparse.Namespace) -> None:
    """Nothing is given but the map."""
    known, fixes = known_walks(arguments.data), located(arguments.data)
    rows: list[list[str]] = []
    tracks = {
        k.recording.name: pdr.track(
            k.recording,
            pdr.recipes.default(k.recording.subject).in_world_frame(),
            fixes=fixes[k.recording.name],
        )
        for k in known
    }
    for name, group in by_storey(known):
        for after_s in (30.0, 60.0, 120.0):
            long = [k for k in group if k.track.time_s[-1] >= after_s]
            if not long:
                rows.append([name, f"{after_s:.0f} s", "0", *["-"] * 6])
                continue
            error, outside = [], []
            for k in long:
                track = tracks[k.recording.name]
                if not any(f.accepted and f.used_s <= after_s for f in track.fixes):
                    continue
                i = int(np.searchsorted(track.time_s, after_s, side="right")) - 1
                e = k.place(track.time_s[i]) - track.position_m[i]
                error.append(np.hypot(*e))
                outside.append(e @ np.linalg.solve(track.position_cov_m2[i], e) > MOST)
            shares = [f"{100 * np.sum(np.array(error) < m) / len(long):.0f} %" for m in (3, 5, 10)]
            median = f"{np.median(error):.1f} m" if error else "-"
            row = [str(len(error)), median, *shares, f"{100 * np.sum(outside) / len(long):.0f} %"]
            rows.append([name, f"{after_s:.0f} s", str(len(long)), *row])
    columns = "storey | after | walks | placed | their median | within 3 m | 5 m | 10 m | outside of the 95 % ellipse"
    about = "Start and direction unknown: `track(recording, config.in_world_frame(), fixes=radio.fixes(recording))`. "
    about += "Shares are of all walks that last so long; one without a fix is not placed, and says so (`Track.frame`)."
    tables.write("radio_start", columns, rows, about)


if __name__ == "__main__":
    run(__doc__, fixes, storeys, walks, start)
