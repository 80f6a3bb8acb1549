"""A map of many walks through a shopping mall, from the first waypoint and direction of one walk a storey.

usage: python -m tests.benchmarks.walk_map [storeys] [numbers] [calibration] [radio] [plan] [--data DIR]

99 walks of `ms_indoor` with Wi-Fi on five storeys. All parameters were chosen on F1, but the probability from which a
walk is joined: `calibration` chooses it on four storeys and tests it on the fifth one. The given walk of a storey is
the one with the most partners, walks with a similar scan: this choice uses no waypoint. The map knows the city, and
with it the declination, where a table says so.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.apps.walk_map.chains import Chain, chain_of
from pdr_filter.apps.walk_map.walk_map import DECLINATION_STD_RAD, _mapped
from pdr_filter.apps.walk_map.walk_poses import (
    SURE,
    UNKNOWN_NORTH,
    JoinedWalks,
    ScannedWalks,
    WalkPose,
    clockwise_rotation,
    locate,
)
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET
from pdr_filter.offline.smoothing.observations import waypoint_fixes
from tests.benchmarks.common import MOST, Tables, paths, run
from tests.benchmarks.radio import Known, errors_of, map_of, place, scores

CHOSEN_ON = "f1"
WRONG_M = 15.0
CITY = pdr.Origin(30.29, 120.08)


@dataclass(frozen=True, eq=False)
class Walk:
    """A walk, its chain and its waypoints."""

    chain: Chain
    recording: pdr.Recording
    points: np.ndarray  # (W, 3) time, east, north
    floor: int

    @property
    def storey(self) -> str:
        return self.recording.name.split("_")[4]


@cache
def walks_of(data: Path) -> list[Walk]:
    found: list[Walk] = []
    for path in paths(data, "ms_indoor"):
        recording = pdr.read(path)
        if recording.wifi is None:
            continue
        w = recording.truth.waypoints
        points = np.column_stack([w.time_s, w.east_m, w.north_m])
        found.append(Walk(chain_of(recording, recording.name), recording, points, int(w.floor[0])))
    return found


def n_partners(walks: Sequence[Walk]) -> np.ndarray:
    """Number of walks, for each walk, that have a scan with a cosine of 0.4 to one of it, by loud access points."""
    scanned = ScannedWalks.of([w.chain for w in walks])
    loud = scanned.heard.copy()
    loud.data[loud.data < 0.1] = 0.0
    rows, columns = ((loud @ loud.T).toarray() >= 0.4).nonzero()
    pairs = np.unique(np.column_stack([scanned.owner[rows], scanned.owner[columns]]), axis=0)
    return np.bincount(pairs[pairs[:, 0] != pairs[:, 1], 0], minlength=len(walks))


def given(walks: Sequence[Walk], rank: int = 0) -> tuple[Walk, list[object]]:
    """The given walk of a storey, that with the most partners or a later one, and its first waypoint and direction."""
    walk = walks[int(np.argsort(-n_partners(walks), kind="stable")[rank])]
    away_m = np.hypot(*(walk.points[:, 1:] - walk.points[0, 1:]).T)
    (t0, *start), (t1, *second) = walk.points[[0, int(np.argmax(away_m > 10.0))]]
    # the direction is that of the line to a waypoint 10 m away, which the walk may not follow at any moment
    chain, steps = walk.chain, np.array([walk.chain.step_at(t) for t in (t0, t1)])
    own = np.diff(chain.position_m(steps), axis=0)[0]
    k = int(steps.mean())
    node = int(chain.node_of(np.array([k]))[0][0])
    beside = chain.device_rad[k] + chain.mean[node, 2] - np.arctan2(*own)
    heading = float(np.arctan2(*(np.array(second) - start)) + beside)
    return walk, [
        pdr.PositionFix(max(t0, 0.0), start, np.eye(2), floor=walk.floor),
        pdr.HeadingFix(chain.time_s[k], heading, np.radians(8.0)),
    ]


def mapped(
    walks: Sequence[Walk], city: bool = True, ranks: Sequence[int] = (0,)
) -> tuple[pdr.WalkMap, set[str], float]:
    """Map of walks, the names of the given walks (one a storey for each rank), and the time of the processor in s."""
    start = time.process_time()
    known: dict[str, list[object]] = {}
    for storey in sorted({w.storey for w in walks}):
        for rank in ranks:
            walk, fixes = given([w for w in walks if w.storey == storey], rank)
            known[walk.chain.name] = fixes
    north = (CITY.declination_rad(), DECLINATION_STD_RAD) if city else UNKNOWN_NORTH
    found = _mapped([w.chain for w in walks], [], known, None, north=north)
    return found, set(known), time.process_time() - start


def matched(walks: Sequence[Walk], found: pdr.WalkMap, known: set[str]) -> list[tuple[Walk, pdr.MappedWalk]]:
    """Joined walks that were not given, each with its truth."""
    others = {w.chain.name: w for w in walks if w.chain.name not in known}
    return [(others[w.name], w) for w in found.walks if w.group == 0 and w.name in others]


def aligned(mapped_m: np.ndarray, true_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Matrix M and shift d for which mapped @ M + d fits the true positions best, without scale."""
    a, b = (mapped_m - mapped_m.mean(axis=0)) @ [1, 1j], (true_m - true_m.mean(axis=0)) @ [1, 1j]
    turn = clockwise_rotation(-float(np.angle(np.vdot(a, b))))
    return turn, true_m.mean(axis=0) - mapped_m.mean(axis=0) @ turn


def row(name: str, walks: Sequence[Walk], found: pdr.WalkMap, known: set[str], seconds: float) -> list[str]:
    n, pairs = sum(w.chain.name not in known for w in walks), matched(walks, found, known)
    if not pairs:
        return [name, str(n), "0 %", *["-"] * 5, f"{seconds:.1f} s"]
    at, true_m, n_wrong = [], np.concatenate([truth.points[:, 1:] for truth, _ in pairs]), 0
    for truth, walk in pairs:
        of_walk = [walk.at(t) for t in truth.points[:, 0]]
        error = np.hypot(*(np.array([p for p, _ in of_walk]) - truth.points[:, 1:]).T)
        n_wrong += bool(error.mean() > WRONG_M) or bool((walk.floor != truth.floor).any())
        at += of_walk
    at_m, cov_m2 = np.array([p for p, _ in at]), np.array([c for _, c in at]) + np.eye(2)
    apart, (turn, shift_m) = at_m - true_m, aligned(at_m, true_m)
    error, of_shape = np.hypot(*apart.T), np.hypot(*(at_m @ turn + shift_m - true_m).T)
    inside = evaluate.nees(apart, cov_m2) < MOST
    figures = [f"{value:.1f} m" for value in (np.median(error), np.percentile(error, 90), np.median(of_shape))]
    joined, wrong = f"{100 * len(pairs) / n:.0f} %", f"{100 * n_wrong / len(pairs):.0f} %"
    return [name, str(n), joined, wrong, *figures, f"{100 * np.mean(inside):.0f} %", f"{seconds:.1f} s"]


def true_pose(walk: Walk) -> WalkPose:
    """Rigid pose of a walk that fits its waypoints; with fewer than two of them, its direction is the magnetic one."""
    own = walk.chain.position_m(np.array([walk.chain.step_at(t) for t in walk.points[:, 0]]))
    a, b = (own - own.mean(axis=0)) @ [1, 1j], (walk.points[:, 1:] - walk.points[:, 1:].mean(axis=0)) @ [1, 1j]
    ratio = np.vdot(a, b) / np.vdot(a, a) if np.abs(b).max() > 5.0 else np.exp(-1j * CITY.declination_rad())
    turn_rad, scale = -float(np.angle(ratio)), float(abs(ratio))
    return WalkPose(
        turn_rad, walk.points[:, 1:].mean(axis=0) - scale * own.mean(axis=0) @ clockwise_rotation(turn_rad), 0, scale
    )


def among_true(walks: Sequence[Walk]) -> str:
    """Share of the walks that their scans place when all others are at their true places, how many wrongly, and the
    median error of their centres."""
    scanned = ScannedWalks.of([w.chain for w in walks])
    poses = {i: true_pose(w) for i, w in enumerate(walks)}
    group = JoinedWalks(poses, {}, CITY.declination_rad())
    error_m: list[float] = []
    for i in poses:
        found = locate(scanned, group, i)
        if found is not None and found.prob >= SURE:
            centre_m = poses[i].of(scanned.own_m[scanned.rows(i)]).mean(axis=0)
            error_m.append(float(np.hypot(*(found.centre_m - centre_m))))
    n_wrong = sum(error > WRONG_M for error in error_m)
    if not error_m:
        return "0 %"
    return f"{100 * len(error_m) / len(walks):.0f} %, {n_wrong} wrong, {np.median(error_m):.1f} m"


COLUMNS = "storey | other walks | joined | of these wrong | median | 90 % | after alignment | in 95 % region | time"


def by_storey(walks: Sequence[Walk]) -> list[tuple[str, list[Walk]]]:
    names = sorted({w.storey for w in walks}, key=lambda s: (s != CHOSEN_ON, s))
    return [
        (s.upper() + (" (chosen on)" if s == CHOSEN_ON else ""), [w for w in walks if w.storey == s]) for s in names
    ]


def storeys(tables: Tables, arguments: argparse.Namespace) -> None:
    """Each storey alone, with and without the declination, and all in one folder, recognised by Wi-Fi alone."""
    every = walks_of(arguments.data)
    together = mapped(every)
    rows: list[list[str]] = []
    for name, group in by_storey(every):
        rows.append([*row(name, group, *mapped(group)), among_true(group)])
        rows.append([*row(f"{name}, city unknown", group, *mapped(group, city=False)), ""])
        rows.append([*row(f"{name}, all storeys together", group, *together), ""])
    about = (
        "Errors at the waypoints of all joined walks but the given one. Wrong: more than 15 m on average, or another "
        "storey. After alignment: median after the best rotation and shift of the map. Last column: walks that their "
        "scans place with all others at their true places, and the median error of their centres."
    )
    tables.write("walk_map", COLUMNS + " | among true places", rows, about)


ABOUT_NUMBERS = (
    "Storeys by the walks with the most partners, one after the other or together, and with the true direction of each "
    "walk instead of that of its magnetometer; below, walks drawn at random. Maps without joined walks are not in the "
    "mean of the errors."
)


def with_true_direction(walk: Walk) -> Walk:
    """The walk and the direction of its magnetometer, rotated to the true direction."""
    turn_rad, chain = true_pose(walk).turn_rad - CITY.declination_rad(), walk.chain
    mean = np.column_stack(
        [chain.mean[:, :2] @ clockwise_rotation(turn_rad), chain.mean[:, 2] + turn_rad, chain.mean[:, 3]]
    )
    problem, observed = chain.problem, chain.problem.states
    start_mean = problem.start_mean + turn_rad * (np.arange(len(problem.start_mean)) == HEADING_OFFSET)
    states = replace(observed, value=observed.value + turn_rad * (observed.state == HEADING_OFFSET))
    problem = replace(problem, start_mean=start_mean, states=states)
    return replace(walk, chain=replace(chain, mean=mean, frame_rad=chain.frame_rad + turn_rad, problem=problem))


def mean_row(name: str, walks: Sequence[Walk], n_given: int) -> list[str]:
    """Means of the figures of maps with one given walk each. Without joined walks, a map has no errors."""
    found = [row(name, walks, *mapped(walks, ranks=[k])) for k in range(min(n_given, len(walks)))]
    means = [name, found[0][1]]
    for cells in list(zip(*found, strict=True))[2:]:
        known = [cell.split() for cell in cells if cell != "-"]
        unit = known[0][1] if known else ""
        digits = 0 if unit == "%" else 1
        means.append(f"{np.mean([float(k[0]) for k in known]):.{digits}f} {unit}" if known else "-")
    return means


def numbers(tables: Tables, arguments: argparse.Namespace) -> None:
    """Storeys by many given walks, F1 by several ones and with true directions, and parts of F1, drawn at random."""
    means = [
        mean_row(f"{name}, mean of {min(10, len(group))} given walks", group, 10)
        for name, group in by_storey(walks_of(arguments.data))
    ]
    every = [w for w in walks_of(arguments.data) if w.storey == CHOSEN_ON]
    rows = [row(f"F1, given walk {k + 1}", every, *mapped(every, ranks=[k])) for k in range(4)]
    rows += [row(f"F1, given walks 1 to {n}", every, *mapped(every, ranks=range(n))) for n in (2, 3, 4)]
    turned_walks = [with_true_direction(w) for w in every]
    rows.append(row("F1, true directions", turned_walks, *mapped(turned_walks)))
    for n in (10, 20):
        for seed in range(3):
            chosen = np.random.default_rng(seed).permutation(len(every))[:n]
            part = [every[i] for i in sorted(chosen)]
            rows.append(row(f"{len(part)} walks of F1, draw {seed + 1}", part, *mapped(part)))
    tables.write("walk_map_numbers", COLUMNS, [*means, *rows], ABOUT_NUMBERS)


ABOUT_CALIBRATION = (
    "Each walk among 1 to 12 others at their true places, drawn at random. Wrong: its centre is more than 15 m away. "
    "The threshold is the smallest probability from which at most 5 % of the places are wrong, in the mean of the four "
    "other storeys."
)
SIZES = (*[1] * 14, *[2] * 8, *[3] * 6, *[5] * 6, *[8] * 4, *[12] * 4)


def placed(walks: Sequence[Walk]) -> np.ndarray:
    """Probability (n,) and error in m of the best place of walks among a few others at their true places, (n, 2)."""
    scanned, rng = ScannedWalks.of([w.chain for w in walks]), np.random.default_rng(0)
    poses, found = {i: true_pose(w) for i, w in enumerate(walks)}, list[tuple[float, float]]()
    for i in poses:
        for size in SIZES if scanned.partners[i] else ():
            some = {int(rng.choice(sorted(scanned.partners[i])))}
            while len(some) < size and (near := set().union(*(scanned.partners[j] for j in some)) - some - {i}):
                some.add(int(rng.choice(sorted(near))))
            group = JoinedWalks({j: poses[j] for j in sorted(some)}, {}, CITY.declination_rad())
            candidate = locate(scanned, group, i) if len(some) == size else None
            if candidate is not None:
                centre_m = poses[i].of(scanned.own_m[scanned.rows(i)]).mean(axis=0)
                found.append((candidate.prob, float(np.hypot(*(candidate.centre_m - centre_m)))))
    return np.array(found)


def calibration(tables: Tables, arguments: argparse.Namespace) -> None:
    """Threshold of the probability of a place, chosen without each storey in turn, and its errors there."""
    of_storey = {name: placed(group) for name, group in by_storey(walks_of(arguments.data))}

    def wrong(name: str, prob: float) -> float:
        sure = of_storey[name][of_storey[name][:, 0] >= prob]
        return float((sure[:, 1] > WRONG_M).mean()) if len(sure) else 0.0

    odds, rows = np.exp(np.arange(0.0, 8.0, 0.05)), list[list[str]]()
    for name, found in of_storey.items():
        others = [other for other in of_storey if other != name]
        prob = next(p for p in (odds / (1.0 + odds)).tolist() if np.mean([wrong(o, p) for o in others]) <= 0.05)
        share = (found[:, 0] >= prob).mean()
        cells = [f"{100 * value:.0f} %" for value in (share, wrong(name, prob), wrong(name, 0.8), wrong(name, SURE))]
        rows.append([name, str(len(found)), f"{prob:.3f}", *cells])
    columns = ["storey", "places", "threshold of the others", "sure", "of these wrong", "from 0.8", f"from {SURE}"]
    tables.write("walk_map_calibration", columns, rows, ABOUT_CALIBRATION)


ABOUT_RADIO = (
    "Each fifth of the walks of F1 by the map of the others. The map that is turned and shifted keeps its uncertainty."
)


def radio(tables: Tables, arguments: argparse.Namespace) -> None:
    """Fixes of held-out walks by the radio map of such a map, and by a surveyed one, on F1."""
    every = [w for w in walks_of(arguments.data) if w.storey == CHOSEN_ON]
    known = [
        Known(w.recording, pdr.smooth(w.recording, fixes=waypoint_fixes(w.recording)).track, w.points)  # the truth
        for w in every
    ]
    pairs: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for fold in range(5):
        held_out, others = known[fold::5], [i for i in range(len(every)) if i % 5 != fold]
        walks = [every[i] for i in others]
        found, names, _ = mapped(walks)
        joined = {w.name for w in found.walks if w.group == 0}
        points = [
            (walk.at(t)[0], place_m) for true, walk in matched(walks, found, names) for t, *place_m in true.points
        ]
        turn, shift_m = aligned(*(np.array(p) for p in zip(*points, strict=True)))
        radio_map = found.radio()
        maps = {
            "this map": radio_map,
            "of two given walks": mapped(walks, ranks=range(2))[0].radio(),
            "turned and shifted to the truth": replace(radio_map, position_m=radio_map.position_m @ turn + shift_m),
            "surveyed, the same walks": map_of([known[i] for i in others if every[i].chain.name in joined]),
            "surveyed, all walks": map_of([known[i] for i in others]),
        }
        for name, of_name in maps.items():
            for walk in held_out:
                pairs.setdefault(name, []).extend(errors_of(walk, of_name.fixes(walk.recording)))
    rows = [[name, *scores(of_map)] for name, of_map in pairs.items()]
    columns = "radio map | fixes | median | 90 % | in 50 % region | in 95 % | -log density"
    tables.write("walk_map_radio", columns, rows, ABOUT_RADIO)


def plan(tables: Tables, arguments: argparse.Namespace) -> None:
    """Held-out walks of F1 by dead reckoning, and on the plan that the walks of such a map draw."""
    every = [w for w in walks_of(arguments.data) if w.storey == CHOSEN_ON]
    errors: dict[str, list[float]] = {}
    for fold in range(5):
        found, _, _ = mapped([w for i, w in enumerate(every) if i % 5 != fold])
        with TemporaryDirectory() as folder:
            drawn = pdr.FloorPlan.read(found.write_plan(Path(folder) / "plan.geojson"))
            hall = pdr.FloorPlan.read(_hall(Path(folder) / "hall.geojson", every))
        for walk in every[fold::5]:
            if len(walk.points) < 4 or drawn.storeys[0].kind_at(walk.points[:1, 1:])[0] != 0:
                continue
            _, fixes = given([walk])
            # the direction is known from the time of its fix on
            after = walk.points[walk.points[:, 0] > fixes[1].time_s]
            config = pdr.recipes.default(walk.recording.subject).in_world_frame()
            plans = {"dead reckoning": None, "on the drawn plan": drawn, "on a plan of one large hall": hall}
            for name, where in plans.items():
                track = pdr.track(walk.recording, config, fixes=fixes, plan=where)
                at = np.array([place(track, t) for t in after[:, 0]])
                errors.setdefault(name, []).append(float(np.hypot(*(at - after[:, 1:]).T).mean()))
    before = np.array(errors["dead reckoning"])
    rows: list[list[str]] = []
    for name, of_walk in errors.items():
        e = np.array(of_walk)
        shares = [f"{100 * np.mean(e < before / 1.1):.0f} %", f"{100 * np.mean(e > 1.1 * before):.0f} %"]
        rows.append([name, str(len(e)), f"{np.median(e):.2f} m", f"{np.mean(e):.2f} m", f"{e.max():.1f} m", *shares])
    about = (
        "Mean errors of held-out walks of F1 that begin on the drawn plan, with given start and direction. Better, "
        "worse: by more than a tenth than dead reckoning."
    )
    tables.write("walk_map_plan", ["track", "walks", "median", "mean", "worst", "better", "worse"], rows, about)


def _hall(path: Path, walks: Sequence[Walk]) -> Path:
    """Write a plan without walls around all walks, 60 m away from them."""
    points = np.concatenate([w.points[:, 1:] for w in walks])
    (west, south), (east, north) = (points.min(axis=0) - 60.0).tolist(), (points.max(axis=0) + 60.0).tolist()
    ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
    hall = {"type": "floor", "name": "hall"}, {"type": "Polygon", "coordinates": [ring]}
    feature = {"type": "Feature", "properties": hall[0], "geometry": hall[1]}
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    return path


if __name__ == "__main__":
    run(__doc__, storeys, numbers, calibration, radio, plan)
