# ruff: noqa: N803 - the letters of the equations
"""How fast the whole pipeline is: recordings of all sets, a day in blocks, a block, its parts, and the IMM itself.

usage: python -m tests.benchmarks.throughput [recordings] [pushed] [calls] [costs] [day] [imm_cycles] [--before TREE]
       [--every 4] [--hours 24] [--pedestrians 10000]

The day is the embedded simulated walk repeated in time; costs are those of one real walk, a part of the filter left
out or put in. `--before` is another checkout of the project: its recordings and pushed blocks are timed in turns with
ours, ours twice, so that the two figures of one tree show what the machine adds. Times are of the processor, one core.

imm_cycles: one cycle is mix, predict, update, mode probabilities, combine; 6 modes, 4 states, a position fix each step,
against filterpy's IMMEstimator in the same run. Both filter the same numbers; the largest difference of the estimates
is in the table, so that nobody compares a fast wrong answer with a slow right one.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from filterpy.kalman import IMMEstimator, KalmanFilter

import pdr_filter as pdr
from pdr_filter.filter.imm import imm
from pdr_filter.filter.imm.modes import context_modes, context_transitions
from pdr_filter.filter.step_length.models import bounce_fit
from pdr_filter.recipes import default
from pdr_filter.values import PositionFix, Samples
from tests.benchmarks.common import ROOT, Tables, paths, run
from tests.maps.made_up import box, feature, line, write

SITES = ("humolire", "ms_indoor", "oxiod", "ubicomp13", "tyrex", "oxford", "ipol", "motionsense", "ipin2023")
# In another process, so that trees can be compared: reads nothing but the package and the recordings.
_OF_RECORDINGS = """
import json, sys, time
import pdr_filter as pdr
found = []
for path in sys.argv[1:]:
    recording, best = pdr.read(path), float("inf")
    for _ in range(2):
        start = time.process_time()
        pdr.track(recording)
        best = min(best, time.process_time() - start)
    found.append((recording.duration_s, best))
print(json.dumps(found))
"""
_OF_PUSHED = """
import json, sys, time
import pdr_filter as pdr
block, runs = pdr.merge_streams(pdr.read(sys.argv[1])), []
for _ in range(3):
    online, cost = pdr.OnlineFilter(), []
    for i in range(0, min(len(block.time_s), 12000), 10):
        part = slice(i, i + 10)
        samples = block.specific_force_mps2[part], block.angular_rate_radps[part], block.magnetic_field_ut[part]
        start = time.process_time()
        online.push(block.time_s[part], *samples)
        cost.append(1e3 * (time.process_time() - start))
    runs.append(cost)
least = sorted(min(costs) for costs in zip(*runs))
print(json.dumps([sum(least) / len(least), least[len(least) // 2], least[int(0.99 * len(least))]]))
"""


def best_s(run: Callable[[], object], times: int = 3) -> float:
    """Least processor time of some runs."""
    taken: list[float] = []
    for _ in range(times):
        start = time.process_time()
        run()
        taken.append(time.process_time() - start)
    return min(taken)


def load() -> str:
    """What else the machine does: without it the load is one."""
    return f"the machine's load {os.getloadavg()[1]:.1f}"


def in_tree(tree: Path, code: str, *arguments: str) -> Any:
    """What code prints, as JSON, in a fresh interpreter that imports the package of a checkout."""
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def trees(before: Path | None) -> dict[str, Path]:
    """Checkouts that are timed in turns, by what the tables call them."""
    return {"now": ROOT} if before is None else {"before": before, "now": ROOT, "now, again": ROOT}


def recordings(tables: Tables, arguments: argparse.Namespace) -> None:
    """Times real time of real recordings with all their sensors, for each set."""
    rows: list[list[str]] = []
    every: dict[str, list[np.ndarray]] = {name: [] for name in trees(arguments.before)}
    for site in SITES:
        chosen = [str(path) for path in paths(arguments.data, site)[:: arguments.every]]
        times = {
            name: np.array(in_tree(tree, _OF_RECORDINGS, *chosen)) for name, tree in trees(arguments.before).items()
        }
        for name, found in times.items():
            every[name].append(found)
        rows.append([site, str(len(chosen)), *(f"{(t[:, 0] / t[:, 1]).mean():.0f}" for t in times.values())])
    all_of = {name: np.concatenate(found) for name, found in every.items()}
    n = len(next(iter(all_of.values())))
    rows.append(["all", str(n), *(f"{(t[:, 0] / t[:, 1]).mean():.0f}" for t in all_of.values())])
    rows.append(["all, time by time", str(n), *(f"{t[:, 0].sum() / t[:, 1].sum():.0f}" for t in all_of.values())])
    about = f"Times real time, the mean over the recordings; one core, {load()}."
    tables.write("throughput_recordings", ["set", "recordings", *all_of], rows, about)


def pushed(tables: Tables, arguments: argparse.Namespace) -> None:
    """Blocks of 0.1 s of a real walk with all its sensors."""
    path, runs = str(paths(arguments.data, "oxiod")[2]), {name: [] for name in trees(arguments.before)}
    for _ in range(3):
        for name, tree in trees(arguments.before).items():
            runs[name].append(in_tree(tree, _OF_PUSHED, path))
    rows = [[name, *(f"{v:.2f} ms" for v in np.min(taken, axis=0))] for name, taken in runs.items()]
    about = (
        f"A pushed block of 0.1 s, two minutes of walking; of each block the least of three runs, one core, {load()}."
    )
    tables.write("throughput_pushed", ["", "mean", "median", "99th percentile"], rows, about)


def long_walk(hours: float) -> pdr.Recording:
    """The demo walk again and again, at 100 Hz."""
    walk = pdr.simulate.demo_walk()
    period_s = walk.duration_s + 0.01
    n = int(np.ceil(hours * 3600 / period_s))

    def repeat(stream: Samples | None) -> Samples | None:
        if stream is None:
            return None
        time_s = (stream.time_s[None, :] + period_s * np.arange(n)[:, None]).ravel()
        return Samples(time_s, np.tile(stream.values, (n, 1)))

    return pdr.Recording(
        name="long",
        accelerometer=repeat(walk.accelerometer),
        gyroscope=repeat(walk.gyroscope),  # type: ignore[arg-type]
    )


def around(track: pdr.Track) -> pdr.FloorPlan:
    """A hall that holds a track, with four walls in it."""
    corners = np.array([track.position_m.min(axis=0) - 10.0, track.position_m.max(axis=0) + 10.0])
    west, south, east, north = corners.ravel().tolist()
    walls = [line((x, south), (x, south + 5.0)) for x in np.linspace(west, east, 6)[1:-1].tolist()]
    features = [feature("floor", box(west, south, east, north)), *(feature("wall", wall) for wall in walls)]
    with TemporaryDirectory() as folder:
        return pdr.FloorPlan.read(write(Path(folder) / "hall.geojson", features))


def costs(tables: Tables, arguments: argparse.Namespace) -> None:
    """A real walk with parts of the filter left out or put in."""
    recording = pdr.read(arguments.data / "oxiod" / "oxiod_anon_floor1_handheld1.zip")
    track = pdr.track(recording)
    n_steps = track.n_steps
    config, fix_cov = default(recording.subject), 9.0 * np.eye(2)
    sensing, modes = config.sensing, context_modes(bounce_fit())

    def with_modes(n: int) -> pdr.Config:
        chosen = (*modes, *(replace(m, name=f"{m.name} {k}") for k in range(1, 5) for m in modes))[1 : n + 1]
        rows = np.full((n, n), 0.1 / max(n - 1, 1)) + (0.9 if n > 1 else 1.0 - 0.1) * np.eye(n)
        rows = rows / rows.sum(axis=1, keepdims=True)
        return config.with_model(modes=chosen, transition_prob=rows if n != len(modes) else context_transitions())

    fixes = [PositionFix(float(t), p, fix_cov) for t, p in zip(track.time_s[::2], track.position_m[::2], strict=True)]
    time_s = np.arange(0.0, recording.duration_s, 0.1)
    particles = config.with_plan(around(track), PositionFix(0.0, np.zeros(2), fix_cov))
    assert particles.on_plan is not None
    on_plan = [
        (f"on a floor plan, {n:,} particles at most", replace(particles, on_plan=replace(particles.on_plan, n_most=n)))
        for n in (4_000, particles.on_plan.n_most)
    ]
    climbing = replace(recording, barometer=Samples(time_s, 1000.0 + 0.01 * np.sin(0.1 * time_s)[:, None]))
    runs: list[tuple[str, Callable[[], object]]] = [
        ("the default, 6 modes", lambda: pdr.track(recording)),
        *((f"{n} modes", lambda n=n: pdr.track(recording, with_modes(n))) for n in (1, 2, 12, 24)),
        ("without contexts", lambda: pdr.track(recording, replace(config, sensing=replace(sensing, contexts=None)))),
        (
            "without walking direction",
            lambda: pdr.track(recording, replace(config, sensing=replace(sensing, heading=None))),
        ),
        ("without the gate", lambda: pdr.track(recording, replace(config, sensing=replace(sensing, gate=None)))),
        ("with a barometer, 10 Hz", lambda: pdr.track(climbing)),
        ("with a fix for every second step", lambda: pdr.track(recording, config, fixes=fixes)),
        *((name, lambda given=given: pdr.track(recording, given)) for name, given in on_plan),
        ("with magnetic north", lambda: pdr.track(recording, north="magnetic")),
        ("steps alone (`detect_steps`)", lambda: pdr.detect_steps(recording)),
    ]
    taken = np.min([[best_s(run, 1) for _, run in runs] for _ in range(4)], axis=0)
    rows = [
        [
            name,
            f"{1e3 * t / recording.duration_s:.2f}",
            f"{1e3 * (t - taken[0]) / n_steps:+.2f}" if i else "",
            f"{recording.duration_s / t:.0f}",
        ]
        for i, ((name, _), t) in enumerate(zip(runs, taken, strict=True))
    ]
    about = (
        f"{recording.duration_s:.0f} s of walking, {n_steps} steps, processor time; the least of four runs in turns, "
        f"{load()}."
    )
    tables.write("throughput_parts", ["what", "ms a second", "ms a step more", "times real time"], rows, about)


def calls(tables: Tables, arguments: argparse.Namespace) -> None:
    """A minute of a real walk, pushed in larger and smaller pieces, merged and as its sensors come."""
    block = pdr.merge_streams(pdr.read(arguments.data / "oxiod" / "oxiod_anon_floor1_handheld1.zip"))
    n = int(np.searchsorted(block.time_s, block.time_s[0] + 60.0))

    def merged(samples: int) -> None:
        online = pdr.OnlineFilter()
        for i in range(0, n, samples):
            part = slice(i, i + samples)
            sensors = block.specific_force_mps2[part], block.angular_rate_radps[part], block.magnetic_field_ut[part]
            online.push(block.time_s[part], *sensors)

    def apart(samples: int) -> None:
        online = pdr.OnlineFilter()
        for i in range(0, n, samples):
            part = slice(i, i + samples)
            online.push_accelerometer(block.time_s[part], block.specific_force_mps2[part])
            online.push_gyroscope(block.time_s[part], block.angular_rate_radps[part])
            online.push_magnetometer(block.time_s[part], block.magnetic_field_ut[part])

    pieces = {"blocks of 1 s": 100, "blocks of 0.1 s": 10, "single samples": 1}
    runs = [lambda way=way, size=size: way(size) for size in pieces.values() for way in (merged, apart)]
    taken = np.min([[best_s(run, 1) for run in runs] for _ in range(3)], axis=0).reshape(-1, 2)
    rows = [[what, *(f"{1e3 * t / 60.0:.1f}" for t in both)] for what, both in zip(pieces, taken, strict=True)]
    columns = ["ms of a core for a second of data", "`push`", "`push_accelerometer`, `push_gyroscope`, ..."]
    about = f"60 s of walking, {n / 60.0:.0f} Hz, three sensors; the least of three runs in turns, {load()}."
    tables.write("throughput_calls", columns, rows, about)


def day(tables: Tables, arguments: argparse.Namespace) -> None:
    """A day in blocks of a minute: whether its cost is that of its length, and its memory that of an hour."""
    block, online, rows = pdr.merge_streams(long_walk(1.0)), pdr.OnlineFilter(), []
    period_s, used_s, n_steps = float(block.time_s[-1]) + 0.01, 0.0, 0
    for hour in range(arguments.hours):
        for i in range(0, len(block.time_s), 6000):
            part = slice(i, i + 6000)
            time_s = block.time_s[part] + hour * period_s
            start = time.process_time()
            updates = online.push(time_s, block.specific_force_mps2[part], block.angular_rate_radps[part])
            used_s += time.process_time() - start
            n_steps += len(updates)
        if hour + 1 in (1, 2, 6, 12, 24, 48, 168):
            peak_mb, saved_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3, len(online.save()) / 1e3
            each_s = used_s / (hour + 1)
            rows.append(
                [hour + 1, n_steps, f"{used_s:.0f} s", f"{each_s:.2f} s", f"{peak_mb:.0f} MB", f"{saved_kb:.0f} kB"]
            )
    columns = ["hours", "steps", "processor time", "for each hour", "largest memory of the process", "saved filter"]
    tables.write("throughput_day", columns, rows, f"Pushed in blocks of a minute, whose updates were let go; {load()}.")


N_MODES, N_STATES = 6, 4
GROUP = 500
MANY_STEPS = 100
H = np.eye(2, N_STATES)
R = np.array([[4.0, 0.5], [0.5, 3.0]])
M = np.full((N_MODES, N_MODES), 0.02) + 0.88 * np.eye(N_MODES)
F = np.tile(np.eye(N_STATES), (N_MODES, 1, 1))
F[:, 0, 2], F[:, 1, 3] = 0.3, np.linspace(0.2, 0.8, N_MODES)
Q = np.stack([np.diag([0.01, 0.01, 1e-4, 1e-5]) * 2.0**k for k in range(N_MODES)])
PRIOR = np.full(N_MODES, 1 / N_MODES)


def started(n: int | None = None) -> tuple[np.ndarray, ...]:
    """Means, covariances, mode probabilities of one pedestrian or of n."""
    batch = () if n is None else (n, 1, 1)
    mean, cov = np.zeros((N_MODES, N_STATES)), np.tile(np.eye(N_STATES), (N_MODES, 1, 1))
    if not batch:
        return mean, cov, PRIOR
    return np.tile(mean, batch), np.tile(cov, (n, 1, 1, 1)), np.tile(PRIOR, (n, 1))


def cycle(mean: np.ndarray, cov: np.ndarray, prob: np.ndarray, z: np.ndarray, R_: np.ndarray) -> tuple[np.ndarray, ...]:
    """One step with its fix; the last is the combined mean."""
    mean, cov, prob = imm.mix(mean, cov, prob, M)
    mean, cov = imm.predict(mean, cov, F, Q)
    mean, cov, log_likelihood, _ = imm.update(mean, cov, z, H, R_)
    prob = imm.update_mode_prob(prob, log_likelihood)
    return mean, cov, prob, imm.combine(mean, cov, prob)[0]


def of_filterpy() -> IMMEstimator:
    """The same problem on filterpy's classes."""
    filters = []
    for k in range(N_MODES):
        kalman = KalmanFilter(dim_x=N_STATES, dim_z=2)
        kalman.x, kalman.P = np.zeros(N_STATES), np.eye(N_STATES)
        kalman.F, kalman.Q, kalman.H, kalman.R = F[k], Q[k], H, R
        filters.append(kalman)
    return IMMEstimator(filters, PRIOR.copy(), M)


def fastest_s(run: Callable[[np.ndarray], object], fixes: np.ndarray) -> float:
    """Time of the fastest step, the one that other work on the machine disturbed least."""
    costs = []
    for z in fixes:
        begin = time.perf_counter()
        run(z)
        costs.append(time.perf_counter() - begin)
    return min(costs)


class Numpy:
    """All pedestrians by `imm`, in groups that fit into the cache of a core; one pedestrian without a leading axis."""

    def __init__(self, n: int | None) -> None:
        sizes = [None] if n is None else [len(g) for g in np.array_split(np.arange(n), max(n // GROUP, 1))]
        self.groups = [started(size) for size in sizes]

    def step(self, z: np.ndarray) -> np.ndarray:
        """Combined mean of the last pedestrian."""
        x = np.zeros(N_STATES)
        for k, (mean, cov, prob) in enumerate(self.groups):
            batch = prob.shape[:-1]
            each = (np.broadcast_to(z, (*batch, 2)), np.broadcast_to(R, (*batch, 2, 2))) if batch else (z, R)
            *state, x = cycle(mean, cov, prob, *each)
            self.groups[k] = tuple(state)
        return np.atleast_2d(x)[-1]


def imm_cycles(tables: Tables, arguments: argparse.Namespace) -> None:
    """Cycles of the IMM against filterpy's."""
    n = arguments.pedestrians
    fixes = np.cumsum(np.random.default_rng(0).normal(size=(300, 2)), axis=0)

    oracle, mean_of_oracle = of_filterpy(), []

    def filterpy_step(z: np.ndarray) -> None:
        oracle.predict()
        oracle.update(z)
        mean_of_oracle.append(oracle.x.copy())

    filterpy_s = fastest_s(filterpy_step, fixes)
    rows = [["filterpy, IMMEstimator", f"{1e6 * filterpy_s:.1f}", 1, "-"]]
    for name, filters, size in (
        ("`pdr_filter.filter.imm.imm`, one pedestrian", Numpy(None), 1),
        (f"`pdr_filter.filter.imm.imm`, {n} in groups of {GROUP}", Numpy(n), n),
    ):
        found: list[np.ndarray] = []
        steps = fixes if size == 1 else fixes[:MANY_STEPS]
        each_s = fastest_s(lambda z, f=filters, into=found: into.append(f.step(z)), steps) / size
        apart = np.abs(np.array(found) - np.array(mean_of_oracle[: len(steps)])).max()
        rows.append([name, f"{1e6 * each_s:.1f}", f"{filterpy_s / each_s:.0f}", f"{apart:.0e}"])
    columns = ["filter", "µs a step and pedestrian", "times as fast", "largest difference"]
    tables.write("imm_speed", columns, rows, "6 modes, 4 states, a position fix each step.")


if __name__ == "__main__":
    run(__doc__, recordings, pushed, calls, costs, day, imm_cycles, before=None, every=4, hours=24, pedestrians=10_000)
