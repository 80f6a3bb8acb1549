"""Smoothing of whole recordings: coverage of its ellipses, outliers, real walks.

usage: python -m tests.benchmarks.smoothing [coverage] [real] [--data ../shared/data]

coverage is on simulated steps, drawn from the model itself in any rotation, with a fix of 2 m every 10 s and outliers
of 30 to 100 m: it shows that the arithmetic is right, not how well real walks follow the model. real: humolire (9 walks
of one person, 215 to 239 m), every third waypoint is a fix, errors at the others. The forward filter gets the fixes in
its own frame (the best rotation and shift of the fixes onto the track without fixes); the smoother gets them as they
are.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import replace

import numpy as np

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.offline.smoothing.observations import Observations, waypoint_fixes
from pdr_filter.offline.smoothing.preintegration import step_states
from pdr_filter.offline.smoothing.problem import NO_OFFSETS, Problem, pose_problem
from pdr_filter.offline.smoothing.smooth import smooth
from pdr_filter.offline.smoothing.solve import solve
from tests.benchmarks.common import MOST, Tables, bias_spread_rms, median_and, recordings, run
from tests.simulated_steps import Walk, simulated_walk

WIDE_RAD = float(np.pi / np.sqrt(3))


def problem_of(walk: Walk, fixes: list[pdr.PositionFix]) -> Problem:
    centre = np.mean([f.position_m for f in fixes], axis=0)
    start_cov = np.diag(np.square([1000.0, 1000.0, WIDE_RAD, 0.06]))
    start_mean, observed = np.array([*centre, 0, 0]), Observations(tuple(fixes))
    return pose_problem(walk.steps, start_mean, start_cov, observed, NO_OFFSETS, WIDE_RAD, anchor_interval_s=10.0)


def smoothed(walk: Walk, fixes: list[pdr.PositionFix]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    problem = problem_of(walk, fixes)
    found = solve(problem)
    return *step_states(problem.intervals, found.mean, found.joint_cov), found.weight


def coverage(tables: Tables, arguments: argparse.Namespace) -> None:
    rows = []
    for wild_share, jumps in ((0.0, 0), (0.1, 0), (0.2, 0), (0.0, 2), (0.1, 2)):
        rng = np.random.default_rng(11)
        inside, rmse, kept, lost, n_wild, n_good = [], [], 0, 0, 0, 0
        for _ in range(300):
            walk = simulated_walk(300, rng, any_rotation=True, jumps=jumps)
            fixes = walk.fixes(20, 2.0, rng, wild_share)
            places = walk.position_m[20::20]
            wild = np.linalg.norm([f.position_m - p for f, p in zip(fixes, places, strict=True)], axis=1) > 15
            mean, cov, weight = smoothed(walk, fixes)
            error = mean[:, :2] - walk.position_m[1:]
            inside.append(evaluate.nees(error, cov[:, :2, :2]) < MOST)
            rmse.append(np.sqrt(np.square(error).sum(axis=1).mean()))
            kept, lost = kept + (wild & (weight > 0)).sum(), lost + (~wild & (weight == 0)).sum()
            n_wild, n_good = n_wild + wild.sum(), n_good + (~wild).sum()
        share = f"{100 * np.mean(inside):.1f} %"
        rows.append(
            [f"{wild_share:.0%}", jumps, share, median_and(rmse, 100), f"{kept} of {n_wild}", f"{lost} of {n_good}"]
        )
    columns = "outliers | changes of the offset | in 95 % ellipse | RMSE m: median, largest | outliers kept | "
    columns += "good fixes lost"
    tables.write("smoothing_coverage", columns, rows, "300 simulated walks a row.")


def real(tables: Tables, arguments: argparse.Namespace) -> None:
    walks = list(recordings(arguments.data, "humolire"))
    columns: dict[str, dict[str, str]] = {}
    for wild in (False, True):
        rmse, walked = defaultdict[str, list[float]](list), defaultdict[str, list[float]](list)
        covered, scales = [], []
        rng = np.random.default_rng(5)
        for recording in walks:
            points = waypoint_fixes(recording)
            times, places = np.array([p.time_s for p in points]), np.array([p.position_m for p in points])
            other = np.arange(len(points)) % 3 > 0
            alone = pdr.track(recording)
            estimate_m = evaluate.positions_at(alone.time_s, alone.position_m, times)
            turned = evaluate.fitted(places, estimate_m, ~other)
            bad = rng.choice(np.flatnonzero(~other)) if wild else -1
            angle = rng.uniform(0, 2 * np.pi)
            shift = 40.0 * np.array([np.sin(angle), np.cos(angle)])

            moved = (np.arange(len(points)) == bad)[:, None] * shift
            given, given_turned = (
                [replace(f, position_m=p) for f, p, o in zip(points, where + moved, other, strict=True) if not o]
                for where in (places, turned)
            )
            result = smooth(recording, fixes=given)
            tracks = {
                "dead reckoning, aligned": (alone, np.zeros(2), turned),
                "filter with fixes": (pdr.track(recording, fixes=given_turned), np.zeros(2), turned),
                "this smoother": (result.track, result.start_position_m, places),
            }
            for name, (track, start_m, reference) in tracks.items():
                error = evaluate.positions_at(track.time_s, track.position_m, times, start_m) - reference
                rmse[name].append(float(np.sqrt(np.square(error[other]).sum(axis=1).mean())))
                legs = recording.truth.segments
                moved_m = evaluate.moved_m(track.time_s, track.position_m, legs.start_s, legs.end_s, start_m)
                walked[name].append(100 * float(moved_m.sum() / legs.distance_m.sum() - 1))
            # the last error is that of the smoother
            nearest = np.clip(np.searchsorted(result.track.time_s, times), 0, result.track.n_steps - 1)
            cov = result.track.position_cov_m2[nearest] + 0.3**2 * np.eye(2)  # clicks are good to a third of a metre
            covered.append(evaluate.nees(error, cov)[other] < MOST)
            scales.append(result.scale)
        what = "with one fix 40 m away" if wild else "RMSE m: median, largest"
        columns[what] = {name: median_and(e, 100) for name, e in rmse.items()}
        if not wild:
            columns["straight legs %: bias, spread, RMS"] = {n: bias_spread_rms(row) for n, row in walked.items()}
            held, scale = 100 * np.concatenate(covered).mean(), f"{np.mean(scales):.3f} ± {np.std(scales):.3f}"
            columns["waypoints in 95 % ellipse"] = {"this smoother": f"{held:.0f} %"}
            columns["scale"] = {"this smoother": scale}
    names = columns["RMSE m: median, largest"]
    rows_of = [[name, *(column.get(name, "") for column in columns.values())] for name in names]
    tables.write("smoothing_real", ["", *columns], rows_of, "humolire: 9 walks, every third waypoint a fix of 1 m.")


if __name__ == "__main__":
    run(__doc__, coverage, real)
