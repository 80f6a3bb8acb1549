"""Walks with a floor plan: errors at the waypoints, covariances, and effects of a wrong start or plan.

usage: python -m tests.benchmarks.floor_plans [whole] [contradicted] [start] [--data ../shared/data]

The waypoints of the first fifth of a walk are fixes of 0.5 m, the errors are those at all others, in the frame of the
plan, not aligned. What staying in a room costs (`apps.maps.crossing_costs`) and the smallest odds of a wrong start were
chosen on storey F1 of ms_indoor alone, how much a scan of Wi-Fi counts for particles, how uneven steps are and how
often people choose a direction on F1 and B1.
The other storeys and humolire are other walks, but not untouched: what being outside costs, and that people choose
every 6 m rather than 3, are judgements made after a look at humolire, and a term of the filter was dropped because it
did not help on the other storeys. Waypoints are good to a metre, which is added to the covariances that are compared
with them.
"""

from __future__ import annotations

import argparse
import json
import re
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from scipy.stats import chi2
from shapely.affinity import scale

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.apps.maps.storey import LIFT
from pdr_filter.tracking.track import Track
from pdr_filter.values import FloatArray, interpolated_rows
from tests.benchmarks.common import Tables, median_and, paths, places_of, run
from tests.benchmarks.radio import known_walks, left_out, map_of

GROUPS = {
    "ms_indoor, F1 (chosen on)": "_f1_",
    "ms_indoor, B1 (chosen on)": "_b1_",
    "ms_indoor, other storeys": "_f[234]_",
    "humolire": "humolire",
}
WAYPOINT_VAR_M2 = 1.0


@dataclass(frozen=True)
class Walk:
    """A recording, its waypoints, and how many of them are given."""

    recording: pdr.Recording
    time_s: FloatArray
    place_m: FloatArray
    n_given: int
    plan: Path

    @property
    def fixes(self) -> list[pdr.PositionFix]:
        given = zip(self.time_s[: self.n_given], self.place_m, strict=False)
        return [pdr.PositionFix(max(float(t), 0.0), place, 0.25 * np.eye(2)) for t, place in given]

    @property
    def config(self) -> pdr.Config:
        return pdr.recipes.default(self.recording.subject).in_world_frame()

    def away(self, track: Track) -> FloatArray:
        """From the waypoints that were not given, (N, 2)."""
        at_m = interpolated_rows(self.time_s[self.n_given :], track.time_s, track.position_m)
        return at_m - self.place_m[self.n_given :]

    def rmse_m(self, track: Track) -> float:
        return float(np.sqrt((self.away(track) ** 2).sum(axis=1).mean()))

    def nees(self, track: Track) -> FloatArray:
        """Squared errors over their covariances."""
        at = np.minimum(np.searchsorted(track.time_s, self.time_s[self.n_given :]), track.n_steps - 1)
        away, cov = self.away(track), track.position_cov_m2[at] + WAYPOINT_VAR_M2 * np.eye(2)
        return evaluate.nees(away, cov)


def walks(data: Path, pattern: str = "") -> Iterator[Walk]:
    """Those whose names have a pattern, with a plan and two waypoints or more that are not given."""
    for path in (*paths(data, "ms_indoor"), *paths(data, "humolire")):
        if not re.search(pattern, path.stem):
            continue
        storey = re.search(r"site\d+_([bf]\d)", path.stem)
        name = "humolire" if storey is None else f"ms_indoor_site1_{storey[1].upper()}"
        recording = pdr.read(path)
        truth = recording.truth.waypoints
        assert truth is not None
        place = places_of(truth)
        along = evaluate.path_m(place)
        n_given = max(2, int((along <= 0.2 * along[-1]).sum()))
        if len(place) >= n_given + 2:
            yield Walk(recording, np.asarray(truth.time_s), place, n_given, data / "maps" / f"{name}.geojson")


def _expected_worse(alone: Track, better: Track) -> float:
    """Probability that a better track is more than 1.1 times as far off at the end, if both covariances are true.

    What it does not know is independent of what it has learnt: the error of dead reckoning is its own and a second one,
    whose covariance is the difference (its axes and sizes; both are taken along the same axes).
    """
    own, whole = (np.linalg.eigvalsh(track.position_cov_m2[-1]) for track in (better, alone))
    rng = np.random.default_rng(0)
    error = np.sqrt(own) * rng.standard_normal((20_000, 2))
    learnt = np.sqrt(np.maximum(whole - own, 0.0)) * rng.standard_normal((20_000, 2))
    return float(np.mean(np.linalg.norm(error, axis=1) > 1.1 * np.linalg.norm(error + learnt, axis=1)))


def _coverage(nees: Sequence[FloatArray]) -> str:
    every = np.concatenate(nees)
    return ", ".join(f"{100 * np.mean(every < chi2.ppf(p, 2)):.0f}" for p in (0.5, 0.95))


def whole(tables: Tables, arguments: argparse.Namespace) -> None:
    """Dead reckoning, with the plan, and smoothed: each group."""
    rows = []
    for group, pattern in GROUPS.items():
        errors, nees, expected = [], [[], [], []], []
        for walk in walks(arguments.data, pattern):
            plan = pdr.FloorPlan.read(walk.plan)
            tracks = (
                pdr.track(walk.recording, walk.config, fixes=walk.fixes),
                pdr.track(walk.recording, walk.config, fixes=walk.fixes, plan=plan),
                pdr.smooth(walk.recording, fixes=walk.fixes, config=walk.config, plan=plan).track,
            )
            errors.append([walk.rmse_m(track) for track in tracks])
            expected.append([_expected_worse(tracks[0], track) for track in tracks[1:]])
            for of_way, track in zip(nees, tracks, strict=True):
                of_way.append(walk.nees(track))
        alone, kept, later = np.array(errors).T
        worse = [
            f"{100 * np.mean(e > 1.1 * alone):.0f} % ({100 * by_luck:.0f} %), {np.max(e / alone):.2f}"
            for e, by_luck in zip((kept, later), np.mean(expected, axis=0), strict=True)
        ]
        figures = (median_and(e, 90) for e in (alone, kept, later))
        rows.append([group, len(alone), *figures, *worse, *map(_coverage, nees)])
    columns = "walks | n | dead reckoning | with the plan | smoothed | worse | worse smoothed | covered alone | "
    columns += "with the plan | smoothed"
    about = "RMSE in m: median, 90 % of walks. Worse: share of walks with more than 1.1 times the error of dead "
    about += "reckoning (expected at the end of walks that were good without by chance, from the two covariances), and "
    about += "the largest ratio. Covered: % of waypoints in the 50 and 95 % ellipses."
    tables.write("floor_plans", columns, rows, about)


def _mirrored(walk: Walk, folder: Path) -> pdr.FloorPlan:
    """The plan of a walk, mirrored at the north axis through the start."""
    content: dict[str, Any] = json.loads(walk.plan.read_text("utf-8"))
    for feature in content["features"]:
        shape = scale(shapely.geometry.shape(feature["geometry"]), -1.0, 1.0, origin=tuple(walk.place_m[0]))
        feature["geometry"] = shapely.geometry.mapping(shape)
    path = folder / "plan.geojson"
    path.write_text(json.dumps(content), encoding="utf-8")
    return pdr.FloorPlan.read(path)


def _walkable_m(plan: pdr.FloorPlan, walk: Walk, away_m: float, rng: np.random.Generator) -> FloatArray:
    """A walkable place at a distance from the true start, the nearest one to it if there is none."""
    storey = plan.storeys[0]
    place_m = storey.middles_m[storey.cells <= LIFT]
    error_m = np.abs(np.linalg.norm(place_m - walk.place_m[0], axis=1) - away_m)
    near = np.flatnonzero(error_m <= max(1.0, float(error_m.min())))
    return place_m[rng.choice(near)]


def _of_particles(track: Track) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of the particles at the end, without the possibility that they are all elsewhere."""
    share = np.array([cluster.share for cluster in track.clusters[-1]])
    place = np.array([cluster.position_m for cluster in track.clusters[-1]])
    mean = share @ place / share.sum()
    each = [c.position_cov_m2 + np.outer(c.position_m - mean, c.position_m - mean) for c in track.clusters[-1]]
    return mean, np.tensordot(share, each, 1) / share.sum()


def contradicted(tables: Tables, arguments: argparse.Namespace) -> None:
    """Right starts of all walks, and wrong starts and plans of walks of more than a minute."""
    # each case with its share of the walks: all, all of more than a minute, or every second one of these
    n_every = dict.fromkeys(("right fixes", "right start"), 0)
    n_every |= dict.fromkeys(("start 20 m off", "start 40 m off", "plan mirrored"), 1)
    n_every |= dict.fromkeys(("anywhere", "another building, anywhere"), 2)
    rows = {case: [case] for case in n_every}
    with tempfile.TemporaryDirectory() as folder:
        for pattern in ("_f1_", "_b1_|_f[234]_|humolire"):
            found: dict[str, list[tuple[float, float, bool, bool, bool]]] = {case: [] for case in rows}
            n_long = 0
            for number, walk in enumerate(walks(arguments.data, pattern)):
                is_long = walk.time_s[-1] > 60.0
                n_long += is_long
                rng, plan, first = np.random.default_rng(number), pdr.FloorPlan.read(walk.plan), walk.fixes[0]
                other = "ms_indoor_site1_F2" if walk.plan.stem == "humolire" else "humolire"
                for case, every in n_every.items():
                    if every and (not is_long or n_long % every):
                        continue
                    used = plan
                    if case.startswith("another"):
                        used = pdr.FloorPlan.read(walk.plan.with_name(f"{other}.geojson"))
                    elif case == "plan mirrored":
                        used = _mirrored(walk, Path(folder))
                    begun = "anywhere" if case.endswith("anywhere") else first
                    if (off := re.search(r"(\d+) m off", case)) is not None:
                        begun = replace(first, position_m=_walkable_m(plan, walk, float(off[1]), rng))
                    given: dict[str, Any] = {"fixes": walk.fixes} if case == "right fixes" else {"start": begun}
                    track = pdr.track(walk.recording, walk.config, plan=used, **given)
                    is_noted = any("contradict the plan" in note for note in track.notes)
                    mean, cov = _of_particles(track)
                    away = walk.away(track)[-1] + mean - track.position_m[-1]
                    nees = away @ np.linalg.inv(cov + WAYPOINT_VAR_M2 * np.eye(2)) @ away
                    error_m, std_m = float(np.linalg.norm(walk.away(track)[-1])), float(track.position_std_m[-1])
                    found[case].append((error_m, std_m, is_noted, nees > 9.0, float(walk.nees(track)[-1]) > 9.0))
                    print(walk.recording.name, case, *found[case][-1], flush=True)
            for case, values in found.items():
                error, std, *counts = zip(*values, strict=True)
                rows[case].append(f"{np.median(error):.1f}, {np.median(std):.1f}")
                rows[case] += [f"{sum(of)} of {len(of)}" for of in counts]
    columns = "the start or the plan"
    for group in ("ms_indoor, F1 (chosen on)", "other storeys, and humolire"):
        columns += f" | {group} | noted | beyond 3 deviations of the particles | of the track"
    about = (
        "Walks whose start (0.5 m) is given and whose direction is unknown, or, with right fixes, the waypoints of the "
        "first fifth. Right ones of all walks, wrong ones of those of more than a minute, anywhere of every second of "
        "these. Error of the end and stated deviation in m, medians; walks with a note that the start or the plan is "
        "contradicted; ends farther off than three deviations. The error in another building is that in its "
        "coordinates."
    )
    tables.write("floor_plans_contradicted", columns, list(rows.values()), about)


def start(tables: Tables, arguments: argparse.Namespace) -> None:
    """Starts of which less is known; with Wi-Fi, the map is that of all other walks of the storey."""
    rows = []
    mapped = {walk.recording.name: map_of(others) for walk, others in left_out(known_walks(arguments.data))}
    for group, pattern in (("humolire", "humolire"), ("ms_indoor, all storeys", "ms_indoor")):
        found: dict[str, list[tuple[float, bool, bool]]] = {}
        for recorded in walks(arguments.data, pattern):
            if recorded.time_s[-1] < 60.0:
                continue
            plan = pdr.FloorPlan.read(recorded.plan)
            # the first waypoint is given, if any
            walk = replace(recorded, n_given=1)
            first, way = walk.fixes[0], walk.place_m[1] - walk.place_m[0]
            heading = pdr.HeadingFix(first.time_s + 2.0, float(np.arctan2(*way)), 0.1)
            tries = {
                "place and direction, no plan": {"fixes": [first, heading]},
                "place and direction": {"fixes": [first, heading], "plan": plan},
                "place": {"plan": plan, "start": first},
                "nothing": {"plan": plan, "start": "anywhere"},
            }
            if (heard := mapped.get(walk.recording.name)) is not None:
                grids = {"fixes": heard.grids(walk.recording), "plan": plan}
                tries["place, with Wi-Fi"] = {**grids, "start": first}
                tries["nothing, with Wi-Fi"] = {**grids, "start": "anywhere"}
            for known, given in tries.items():
                track = pdr.track(walk.recording, walk.config, **given)
                away, nees = np.linalg.norm(walk.away(track), axis=1), walk.nees(track)
                for at_s in (60.0, 120.0):
                    if walk.time_s[-1] >= at_s:
                        i = int(np.searchsorted(walk.time_s, at_s)) - 1
                        step = min(int(np.searchsorted(track.time_s, walk.time_s[i + 1])), track.n_steps - 1)
                        single = not track.clusters or track.clusters[step][0].share > 0.95
                        sure = bool(single and nees[i] > chi2.ppf(0.95, 2))
                        found.setdefault(f"{known} {at_s:.0f}", []).append((float(away[i]), away[i] < 3.0, sure))
        for known in dict.fromkeys(key.rsplit(" ", 1)[0] for key in found):
            row: list[object] = [group, known]
            for at_s in (60, 120):
                of_time = np.array(found.get(f"{known} {at_s}", []), dtype=float).reshape(-1, 3)
                if len(of_time) == 0:
                    row += [0, "", "", ""]
                    continue
                median, near, false = np.median(of_time[:, 0]), *of_time[:, 1:].mean(axis=0)
                row += [len(of_time), f"{median:.1f}", f"{100 * near:.0f} %", f"{100 * false:.0f} %"]
            rows.append(row)
    columns = "walks | given start"
    for at_s in (60, 120):
        columns += f" | n | error after {at_s} s | within 3 m | wrong with confidence"
    about = "Errors are medians in m, at the first waypoint after that time. Wrong with confidence: one place has 95 % "
    about += "of the particles, or there is no plan, and the truth is outside of the 95 % ellipse."
    tables.write("floor_plans_start", columns, rows, about)


if __name__ == "__main__":
    run(__doc__, whole, contradicted, start)
