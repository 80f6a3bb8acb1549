"""Smoothing of whole recordings: speed against a Python factor for each step, honesty, wild fixes, real walks.

usage: python -m tests.benchmarks.smoothing [speed] [coverage] [lag] [real] [--data ../shared/data]

speed, coverage and lag are on simulated steps, drawn from the model itself: they show that the arithmetic is right and
fast, not how well real walks follow the model. real: humolire (9 walks of one person, 215 to 239 m), every third
waypoint is a fix, errors at the others. The forward filter gets the fixes in its own frame (the
best rotation and shift of the fixes onto the track without fixes); the smoother gets them as they are.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.filter.imm.motion_model import MotionNoise
from pdr_filter.offline.smoothing.fixed_lag import FixedLagSmoother
from pdr_filter.offline.smoothing.observations import Observations, waypoint_fixes
from pdr_filter.offline.smoothing.preintegration import MIN_STATE_VAR, bridge, frame
from pdr_filter.offline.smoothing.problem import NO_OFFSETS, Problem, pose_problem
from pdr_filter.offline.smoothing.smooth import smooth
from pdr_filter.offline.smoothing.solve import solve
from tests.benchmarks.common import Tables, bias_spread_rms, median_and, options, recordings
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
    return *bridge(problem.intervals, found.mean, found.joint_cov), found.weight


def by_custom_factors(walk: Walk, fixes: list[pdr.PositionFix], begin: np.ndarray) -> tuple[np.ndarray, int]:
    """Every step a Python CustomFactor with exact Jacobians, Gauss-Newton from the answer: as fast as it gets.

    Without marginals, search for wrong fixes and rotation. GTSAM hands a copy of all values to each call of a Python
    factor: the time grows with the square of the steps.
    """
    steps, graph, values = walk.steps, gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, x in enumerate(begin):
        values.insert(k, x)

    def of_step(d: np.ndarray) -> Callable[..., np.ndarray]:
        def error(_: gtsam.CustomFactor, v: gtsam.Values, by: list[np.ndarray] | None) -> np.ndarray:
            a, b = v.atVector(keys[0]), v.atVector(keys[1])
            scale = np.exp(a[3])
            c, s = scale * np.cos(a[2]), scale * np.sin(a[2])
            east, north = c * d[0] + s * d[1], c * d[1] - s * d[0]
            if by is not None:
                by[0] = np.array([[-1, 0, -north, -east], [0, -1, east, -north], [0, 0, -1, 0], [0, 0, 0, -1.0]])
                by[1] = np.eye(4)
            return b - a - [east, north, 0.0, 0.0]

        keys = (len(made), len(made) + 1)
        made.append(keys)
        return error

    made: list[tuple[int, int]] = []
    for k in range(len(steps)):
        own_frame = frame(begin[[k]])[0]
        added_cov = np.zeros((4, 4))
        # the drift before the next step: a state stands where a step has its heading
        drift = steps.drift_var_rad2[k + 1] if k + 1 < len(steps) else MIN_STATE_VAR
        added_cov[:2, :2], added_cov[2, 2], added_cov[3, 3] = steps.cov_m2[k], drift, steps.scale_drift_var[k]
        model = gtsam.noiseModel.Gaussian.Covariance(own_frame @ added_cov @ own_frame.T)
        graph.add(gtsam.CustomFactor(model, [k, k + 1], of_step(steps.displacement_m[k])))
    for fix in fixes:
        k = int(np.searchsorted(steps.time_s, fix.time_s)) + 1
        model = gtsam.noiseModel.Diagonal.Sigmas(np.array([*np.sqrt(np.diag(fix.cov_m2)), 1e3, 1e3]))
        graph.add(gtsam.PriorFactorVector(k, np.array([*fix.position_m, 0.0, 0.0]), model))
    start = gtsam.noiseModel.Diagonal.Sigmas(np.array([1000.0, 1000.0, WIDE_RAD, 0.06]))
    graph.add(gtsam.PriorFactorVector(0, np.array([*np.mean([f.position_m for f in fixes], axis=0), 0, 0]), start))
    optimizer = gtsam.GaussNewtonOptimizer(graph, values)
    found = optimizer.optimize()
    return np.array([found.atVector(k) for k in range(len(begin))]), optimizer.iterations()


def speed(tables: Tables) -> None:
    rng, rows = np.random.default_rng(1), []
    for n_steps, every in ((1000, 20), (3000, 20), (10_000, 20), (10_000, 4), (10_000, 2)):
        walk = simulated_walk(n_steps, rng, any_rotation=True)
        fixes = walk.fixes(every, 2.0, rng)
        took = []
        for _ in range(3):
            start = time.process_time()
            mean, _, _ = smoothed(walk, fixes)
            took.append(time.process_time() - start)
        if n_steps > 3000:  # minutes
            rows.append([n_steps, f"{every / 2:.0f} s", f"{min(took):.2f}", "-", "-", "-"])
            continue
        problem = problem_of(walk, fixes)
        begin = np.vstack([solve(problem).mean[:1], mean])
        start = time.process_time()
        single, iterations = by_custom_factors(walk, fixes, begin)
        custom = time.process_time() - start
        apart = np.linalg.norm(single[1:, :2] - mean[:, :2], axis=1).max()
        times = [f"{min(took):.2f}", f"{custom:.1f} ({iterations})", f"{custom / min(took):.0f}"]
        rows.append([n_steps, f"{every / 2:.0f} s", *times, f"{apart:.2f}"])
    columns = [
        "steps",
        "fix every",
        "smoother s",
        "Python factor for each step s (iterations)",
        "times faster",
        "apart m",
    ]
    tables.write("smoothing_speed", columns, rows)


def coverage(tables: Tables) -> None:
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
            inside.append(np.einsum("ka,kab,kb->k", error, np.linalg.inv(cov[:, :2, :2]), error) < 5.991)
            rmse.append(np.sqrt(np.square(error).sum(axis=1).mean()))
            kept, lost = kept + (wild & (weight > 0)).sum(), lost + (~wild & (weight == 0)).sum()
            n_wild, n_good = n_wild + wild.sum(), n_good + (~wild).sum()
        share = f"{100 * np.mean(inside):.1f} %"
        rows.append(
            [f"{wild_share:.0%}", jumps, share, median_and(rmse, 100), f"{kept} of {n_wild}", f"{lost} of {n_good}"]
        )
    columns = ["wild fixes", "changes of the offset", "in 95 % ellipse", "RMSE m: median, largest", "wild fixes kept"]
    tables.write("smoothing_coverage", [*columns, "good fixes lost"], rows, "300 simulated walks a row.")


def lag(tables: Tables) -> None:
    rows = []
    for lag_s in (0.0, 5.0, 10.0, 20.0, 40.0):
        rng = np.random.default_rng(21)
        inside, square, took, n = [], [], 0.0, 0
        for _ in range(10):
            walk = simulated_walk(300, rng, any_rotation=True)
            waiting = walk.fixes(20, 2.0, rng)
            smoother = FixedLagSmoother((), MotionNoise(log_scale_std=0.06), lag_s=lag_s)
            state, out = smoother.init(), []
            start = time.perf_counter()
            for k in range(len(walk.steps)):
                new = [f for f in waiting if f.time_s <= walk.steps.time_s[k]]
                waiting = waiting[len(new) :]
                state, late = smoother.step_increments(state, walk.steps.part(k, k + 1), new)
                out.append(late)
            out.append(smoother.finish(state)[1])
            took, n = took + time.perf_counter() - start, n + len(walk.steps)
            mean, cov = np.concatenate([o.mean for o in out]), np.concatenate([o.cov for o in out])
            error = (mean[:, :2] - walk.position_m[1:])[100:]  # the rotation of the map is known by then
            inside.append(np.einsum("ka,kab,kb->k", error, np.linalg.inv(cov[100:, :2, :2]), error) < 5.991)
            square.append(np.square(error).sum(axis=1))
        cells = [f"{100 * np.mean(inside):.1f} %", f"{np.sqrt(np.mean(square)):.2f}", f"{1e3 * took / n:.1f}"]
        rows.append([f"{lag_s:.0f}", *cells])
    tables.write("smoothing_lag", ["lag s", "in 95 % ellipse", "RMSE m", "ms per step"], rows, "Ten simulated walks.")


def at_times(track: pdr.Track, start_m: np.ndarray, times: np.ndarray) -> np.ndarray:
    time_s = np.concatenate([[min(times[0], track.time_s[0]) - 1e-3], track.time_s])
    position = np.vstack([start_m, track.position_m])
    return np.column_stack([np.interp(times, time_s, position[:, k]) for k in (0, 1)])


def real(tables: Tables, data: Path) -> None:
    walks = list(recordings(data, "humolire"))
    columns: dict[str, dict[str, str]] = {}
    for wild in (False, True):
        rows: dict[str, list[float]] = {}
        walked: dict[str, list[float]] = {}
        covered, scales = [], []
        rng = np.random.default_rng(5)
        for recording in walks:
            points = waypoint_fixes(recording)
            times, places = np.array([p.time_s for p in points]), np.array([p.position_m for p in points])
            other = np.arange(len(points)) % 3 > 0
            alone = pdr.track(recording)
            estimate_m = at_times(alone, np.zeros(2), times)
            turned = evaluate.fitted(places, estimate_m, ~other)
            bad = rng.choice(np.flatnonzero(~other)) if wild else -1
            angle = rng.uniform(0, 2 * np.pi)
            shift = 40.0 * np.array([np.sin(angle), np.cos(angle)])

            moved = (np.arange(len(points)) == bad)[:, None] * shift
            given, given_turned = (
                [replace(f, position_m=p) for f, p, o in zip(points, where + moved, other, strict=True) if not o]
                for where in (places, turned)
            )
            result = smooth(recording, given)
            tracks = {
                "dead reckoning, aligned": (alone, np.zeros(2), turned),
                "filter with fixes": (pdr.track(recording, fixes=given_turned), np.zeros(2), turned),
                "this smoother": (result.track, result.start_position_m, places),
            }
            for name, (track, start_m, reference) in tracks.items():
                error = at_times(track, start_m, times) - reference
                rows.setdefault(name, []).append(float(np.sqrt(np.square(error[other]).sum(axis=1).mean())))
                legs = recording.truth.segments
                ends = [at_times(track, start_m, np.asarray(t)) for t in (legs.start_s, legs.end_s)]
                length = np.linalg.norm(ends[1] - ends[0], axis=1)
                walked.setdefault(name, []).append(100 * float(length.sum() / legs.distance_m.sum() - 1))
            error = at_times(result.track, result.start_position_m, times) - places
            nearest = np.clip(np.searchsorted(result.track.time_s, times), 0, result.track.n_steps - 1)
            cov = result.track.position_cov_m2[nearest] + 0.3**2 * np.eye(2)  # clicks are good to a third of a metre
            covered.append(np.einsum("ka,kab,kb->k", error, np.linalg.inv(cov), error)[other] < 5.991)
            scales.append(result.scale)
        what = "with one fix 40 m away" if wild else "RMSE m: median, largest"
        columns[what] = {name: median_and(row, 100) for name, row in rows.items()}
        if not wild:
            columns["straight legs %: bias, spread, RMS"] = {n: bias_spread_rms(row) for n, row in walked.items()}
            held, scale = 100 * np.concatenate(covered).mean(), f"{np.mean(scales):.3f} ± {np.std(scales):.3f}"
            columns["waypoints in 95 % ellipse"] = {"this smoother": f"{held:.0f} %"}
            columns["scale"] = {"this smoother": scale}
    names = columns["RMSE m: median, largest"]
    rows_of = [[name, *(column.get(name, "") for column in columns.values())] for name in names]
    tables.write("smoothing_real", ["", *columns], rows_of, "humolire: 9 walks, every third waypoint a fix of 1 m.")


def main() -> None:
    args = options(__doc__, "speed", "coverage", "lag", "real").parse_args()
    tables = Tables.of(__spec__.name, args)
    for part in args.parts:
        if part == "real":
            real(tables, args.data)
        else:
            {"speed": speed, "coverage": coverage, "lag": lag}[part](tables)


if __name__ == "__main__":
    main()
