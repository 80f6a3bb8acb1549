"""How fast the whole pipeline is: recordings of all sets, pieces of a minute, parts of the filter, and many hours.

usage: python -m tests.benchmarks.throughput [recordings] [calls] [costs] [stages] [long] [limits] [--before TREE]
       [--every 4] [--batch 1000] [--days 7] [--hours 1] [--on-dask 60]

Costs are those of one real walk, a part of the filter left out or put in. `--before` is another checkout of the
project: its recordings are timed in turns with ours, ours twice, so that the two figures of one tree show what the
machine adds. `limits` prints the figures of a recording of `--hours` beside those that the package must keep.
Times are of the processor, one core. A batch is one simulated recording of ten minutes under many names,
the embedded walk repeated in time. A recording of days is the same walk repeated.

A step takes about 1,000 calls of Python and NumPy functions on small arrays, together 0.7 ms, and no function takes
more than 7 % of a track. Only fewer calls, or compiled code, can make it faster. One row of the default classifier
takes 40 us.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.filter.chain.two_hypotheses import TwoHypotheses
from pdr_filter.filter.chain.with_height import WithHeight
from pdr_filter.filter.imm.transition_probabilities import context_transitions
from pdr_filter.filter.step_length.models import bounce_fit
from pdr_filter.offline.smoothing import dead_reckoning
from pdr_filter.offline.smoothing import smooth as smooth_module
from pdr_filter.recipes import default
from pdr_filter.recipes.modes import context_modes
from pdr_filter.sensing.attitude import AttitudeEstimator
from pdr_filter.sensing.conditioning import Conditioner
from pdr_filter.sensing.contexts.context_stage import ContextModels
from pdr_filter.sensing.features.feature_windows import FeatureWindows
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.gyroscope_bias import GyroBias
from pdr_filter.sensing.heading.walking_heading import WalkingHeading
from pdr_filter.sensing.steps.adaptive_detector import AdaptiveStepDetector
from pdr_filter.sensing.steps.step_gate import StepGate
from pdr_filter.tracking import filtering, whole_recording
from pdr_filter.values import PositionFix, Samples
from tests.apps.maps.made_up import box, feature, line, write
from tests.benchmarks.common import ROOT, Tables, part_of, paths, push, run

SITES = ("humolire", "ms_indoor", "oxiod", "ubicomp13", "tyrex", "oxford", "ipol", "motionsense", "ipin2023")
# The lines of docs/methods/batch.md: without them each process of Dask wakes up some hundred times a second.
QUIET_DASK = {
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",
    "DASK_DISTRIBUTED__ADMIN__SYSTEM_MONITOR__INTERVAL": "5s",
    "DASK_DISTRIBUTED__WORKER__MEMORY__MONITOR_INTERVAL": "1s",
}
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
# In another process, so that the memory and the processor time of its workers are those of one batch.
_OF_BATCH = """
import json, resource, sys, time
from contextlib import nullcontext
from pathlib import Path
from pdr_filter import batch

def used():
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(r.ru_utime + r.ru_stime for r in both), max(r.ru_maxrss for r in both) / 1e3

if __name__ == "__main__":
    way, folder = sys.argv[1], Path(sys.argv[2])
    files, cluster = sorted(folder.glob("*.zip"))[: int(sys.argv[3])], nullcontext()
    batch.track(files[:1], out=folder / f"{way} first.csv")  # loads everything
    if way == "dask":
        from distributed import LocalCluster
        cluster = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
    where = {"loop": {"jobs": 1}, "processes": {"jobs": 2}}.get(way) or {"scheduler": cluster.scheduler_address}
    start, before = time.perf_counter(), used()[0]
    with cluster:
        rows = batch.track(files, out=folder / f"{way}.csv", **where)
        elapsed_s = time.perf_counter() - start
    assert not any(row.failed for row in rows), rows[0].reason
    print(json.dumps([elapsed_s, used()[0] - before, used()[1]]))
"""
_OF_DAYS = """
import json, resource, sys, time
import pdr_filter as pdr
from tests.benchmarks.throughput import long_walk
recording = long_walk(24.0 * float(sys.argv[1]))
start = time.process_time()
pdr.track(recording)
used_s, peak_mb = time.process_time() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
held_mb = sum(s.time_s.nbytes + s.values.nbytes for s in (recording.accelerometer, recording.gyroscope)) / 1e6
print(json.dumps([used_s, peak_mb, held_mb, recording.duration_s]))
"""
_OF_PARTS = """
import json, resource, sys, time
import pdr_filter as pdr
start = time.process_time()
pdr.batch.track_file(sys.argv[1], sys.argv[2])
print(json.dumps([time.process_time() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3]))
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
    """Return what code prints, as JSON, in a fresh interpreter that imports the package of a checkout."""
    environment = {**os.environ, **QUIET_DASK, "PYTHONPATH": str(tree)}
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


def write_long_walk(hours: float, path: Path) -> Path:
    """A file of the walk of `long_walk`, which is never in memory as a whole."""
    walk = pdr.simulate.demo_walk()
    period_s = walk.duration_s + 0.01
    n = int(np.ceil(hours * 3600 / period_s))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("meta.json", json.dumps({"name": "long"}))
        for name in ("accelerometer", "gyroscope"):
            stream = walk.streams[name]
            values = [",{:.7g},{:.7g},{:.7g}\n".format(*row) for row in stream.values.tolist()]
            with archive.open(f"{name}.csv", "w", force_zip64=True) as file:
                file.write(b"time_s,x,y,z\n")
                for i in range(n):
                    times = (stream.time_s + period_s * i).tolist()
                    file.write("".join(f"{t:.6f}{v}" for t, v in zip(times, values, strict=True)).encode())
    return path


def mostly_resting(hours: float, walking_share: float) -> pdr.Recording:
    """A phone that rests on a table before and after a walk, which takes exactly its share of the time."""
    walk = long_walk(hours * walking_share)
    n_walking = int(hours * walking_share * 360_000)
    n = (int(hours * 360_000) - n_walking) // 2
    rng = np.random.default_rng(0)

    def around_walk(stream: Samples, mean: np.ndarray, std: float) -> Samples:
        rest = [mean + rng.normal(0.0, std, (n, 3)) for _ in range(2)]
        values = np.concatenate([rest[0], stream.values[:n_walking], rest[1]])
        return Samples(0.01 * np.arange(len(values)), values)

    assert walk.gyroscope is not None
    force = around_walk(walk.accelerometer, np.array([0.2, 0.4, 9.8]), 0.03)
    return pdr.Recording("rest", force, around_walk(walk.gyroscope, np.array([0.003, -0.002, 0.001]), 0.002))


def limits(tables: Tables, arguments: argparse.Namespace) -> None:
    """Measured speed and memory beside their limits."""
    from tests.benchmarks.throughput_cohort import more_on_dask_s  # which imports this module

    block = pdr.merge_streams(pdr.read(arguments.data / "oxiod" / "oxiod_anon_floor1_handheld1.zip"))
    minute = part_of(block, slice(0, int(np.searchsorted(block.time_s, block.time_s[0] + 60.0))))

    def pushed(samples: int) -> None:
        online = pdr.OnlineFilter()
        for part in minute.parts(samples):
            push(online, part)
        online.finish()

    online, quiet = pdr.OnlineFilter(), list[float]()
    for part in minute.parts(1):
        n_waiting, start = len(online._waiting), time.process_time()
        push(online, part)
        if len(online._waiting) > n_waiting:
            quiet.append(time.process_time() - start)
    whole_s, tenths_s = np.min([[best_s(lambda n=n: pushed(n), 1) for n in (100_000, 10)] for _ in range(3)], axis=0)
    walk, day = long_walk(arguments.hours), mostly_resting(arguments.hours, 1 / 24)
    pdr.smooth(long_walk(0.02))
    runs = [lambda: pdr.track(walk), lambda: pdr.smooth(walk), lambda: pdr.track(day)]
    track_s, smooth_s, day_s = np.min([[best_s(run, 1) for run in runs] for _ in range(2)], axis=0)
    with TemporaryDirectory() as folder:
        path = write_long_walk(24.0 * arguments.days, Path(folder) / "long.zip")
        used_s, peak_mb = in_tree(ROOT, _OF_PARTS, str(path), str(Path(folder) / "track.parquet"))
    dask_s = more_on_dask_s(10.0, arguments.on_dask)
    rows = [
        ["push that completes no hop", f"{1e6 * np.median(quiet):.0f} us", "15 us"],
        ["blocks of 0.1 s against the whole recording", f"{tenths_s / whole_s:.1f}", "3"],
        ["a day with an hour of walking against a day of walking", f"{day_s / track_s:.2f}", "0.33"],
        ["`smooth` against `track`", f"{smooth_s / track_s:.2f}", "1.21"],
        ["a recording of ten minutes on Dask, more than on processes", f"{1e3 * dask_s:.0f} ms", "20 ms"],
        [f"`batch.track_file`, {arguments.days:g} days in {used_s:.0f} s", f"{peak_mb:.0f} MB", "400 MB"],
    ]
    about = f"Processor time; {arguments.hours:g} hours of a simulated walk repeated, {load()}."
    tables.write("throughput_limits", ["what", "measured", "limit"], rows, about)


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
    rows = list[list[str]]()
    for (name, _), t in zip(runs, taken, strict=True):
        more = f"{1e3 * (t - taken[0]) / n_steps:+.2f}" if rows else ""
        rows.append([name, f"{1e3 * t / recording.duration_s:.2f}", more, f"{recording.duration_s / t:.0f}"])
    about = (
        f"{recording.duration_s:.0f} s of walking, {n_steps} steps, processor time; the least of four runs in turns, "
        f"{load()}."
    )
    tables.write("throughput_parts", ["what", "ms a second", "ms a step more", "times real time"], rows, about)


# Stages by their name in the table, and the functions that are the stage.
_STAGES: dict[str, tuple[tuple[object, str], ...]] = {
    "conditioning": ((Conditioner, "update"),),
    "attitude": ((AttitudeEstimator, "update"),),
    "gyroscope bias": ((GyroBias, "update"),),
    "windows and their features": ((FeatureWindows, "update"),),
    "classifiers": ((ContextModels, "update_all"),),
    "step detector": ((AdaptiveStepDetector, "update"),),
    "gate": ((StepGate, "update"),),
    "walking direction": ((WalkingHeading, "update"),),
    "rest of the front end": ((Sensing, "update"), (Sensing, "finish")),
    "trackers and height": ((TwoHypotheses, "on"), (WithHeight, "on")),
    "events and rows": tuple(
        [(filtering, "_process"), (whole_recording, "track_of_outputs"), (dead_reckoning, "track_of_outputs")]
    ),
    "smoothing": ((smooth_module, "smooth"),),
    "calls of `push`": ((pdr.OnlineFilter, "push"),),
}


def of_stages(work: Callable[[], object]) -> dict[str, float]:
    """Processor time of each stage without the stages that it calls, s."""
    taken, inner = dict.fromkeys(_STAGES, 0.0), list[float]()

    def timed(stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def run_timed(*given: Any, **named: Any) -> Any:
            inner.append(0.0)
            start = time.process_time()
            result = function(*given, **named)
            used_s = time.process_time() - start
            taken[stage] += used_s - inner.pop()
            if inner:
                inner[-1] += used_s
            return result

        return run_timed

    with pytest.MonkeyPatch.context() as patch:
        for stage, functions in _STAGES.items():
            for owner, name in functions:
                patch.setattr(owner, name, timed(stage, getattr(owner, name)))
        work()
    return taken


def stages(tables: Tables, arguments: argparse.Namespace) -> None:
    """Write the table of the time that each stage takes in a walk, pushed blocks, a rest and smoothing."""
    block = pdr.merge_streams(pdr.read(arguments.data / "oxiod" / "oxiod_anon_floor1_handheld1.zip"))
    walk, rest = long_walk(0.1), mostly_resting(0.25, 1 / 500)

    def pushed(samples: int) -> None:
        online = pdr.OnlineFilter()
        for part in block.parts(samples):
            push(online, part)

    runs: dict[str, tuple[Callable[[], object], float]] = {
        "`track` of a walk": (lambda: pdr.track(walk), walk.duration_s),
        "of a rest": (lambda: pdr.track(rest), rest.duration_s),
        "`smooth` of a walk": (lambda: smooth_module.smooth(walk), walk.duration_s),
        "pushed in blocks of 0.1 s": (lambda: pushed(10), float(np.ptp(block.time_s))),
    }
    turns = [[of_stages(work) for work, _ in runs.values()] for _ in range(4)]
    best = [min((turn[i] for turn in turns[1:]), key=lambda of: sum(of.values())) for i in range(len(runs))]
    scales = [1e3 / duration_s for _, duration_s in runs.values()]
    rows = [[name, *(f"{k * of[name]:.3f}" for k, of in zip(scales, best, strict=True))] for name in _STAGES]
    rows.append(["all", *(f"{k * sum(of.values()):.2f}" for k, of in zip(scales, best, strict=True))])
    about = f"Processor time, ms for a second of data; the least of three runs in turns, {load()}."
    tables.write("throughput_stages", ["stage", *runs], rows, about)


def calls(tables: Tables, arguments: argparse.Namespace) -> None:
    """A minute of a real walk, pushed in larger and smaller pieces, merged and as its sensors come."""
    block = pdr.merge_streams(pdr.read(arguments.data / "oxiod" / "oxiod_anon_floor1_handheld1.zip"))
    n = int(np.searchsorted(block.time_s, block.time_s[0] + 60.0))

    minute = part_of(block, slice(0, n))

    def merged(samples: int) -> None:
        online = pdr.OnlineFilter()
        for part in minute.parts(samples):
            push(online, part)

    def apart(samples: int) -> None:
        online = pdr.OnlineFilter()
        for part in minute.parts(samples):
            online.push_accelerometer(part.time_s, part.specific_force_mps2)
            online.push_gyroscope(part.time_s, part.angular_rate_radps)
            online.push_magnetometer(part.time_s, part.magnetic_field_ut)

    pieces = {"blocks of 1 s": 100, "blocks of 0.1 s": 10, "single samples": 1}
    runs = [lambda way=way, size=size: way(size) for size in pieces.values() for way in (merged, apart)]
    taken = np.min([[best_s(run, 1) for run in runs] for _ in range(3)], axis=0).reshape(-1, 2)
    rows = [[what, *(f"{1e3 * t / 60.0:.1f}" for t in both)] for what, both in zip(pieces, taken, strict=True)]
    columns = ["ms of a core for a second of data", "`push`", "`push_accelerometer`, `push_gyroscope`, ..."]
    about = f"60 s of walking, {n / 60.0:.0f} Hz, three sensors; the least of three runs in turns, {load()}."
    tables.write("throughput_calls", columns, rows, about)


def _hours(hours: float, used_s: float) -> list[str]:
    return [f"{hours:.1f}", f"{used_s:.0f} s", f"{used_s / hours:.1f} s"]


def long(tables: Tables, arguments: argparse.Namespace) -> None:
    """Many recordings in three ways, and one recording of days."""
    rows, each_s = list[list[str]](), 0.0
    with TemporaryDirectory() as folder:
        first = long_walk(1 / 6).save(Path(folder) / "walk 0.zip")
        for i in range(1, arguments.batch):
            os.link(first, Path(folder) / f"walk {i}.zip")
        ways = {"loop": "in a loop", "processes": "on two processes", "dask": "on a Dask cluster of two workers"}
        for way, title in ways.items():
            n = min(arguments.batch, 50) if way == "loop" else arguments.batch
            elapsed_s, used_s, peak_mb = in_tree(ROOT, _OF_BATCH, way, folder, str(n))
            each_s = each_s or used_s / n
            more = "" if way == "loop" else f"{1e3 * (used_s / n - each_s):.0f} ms"
            row = [*_hours(n / 6, used_s), more, f"{60 * n / elapsed_s:.0f}", f"{peak_mb:.0f} MB"]
            rows.append([f"{n} recordings of ten minutes {title}", *row])
    used_s, peak_mb, held_mb, duration_s = in_tree(ROOT, _OF_DAYS, str(arguments.days))
    title = f"one recording of {duration_s / 86400:.2g} days, {held_mb:.0f} MB of samples"
    rows.append([title, *_hours(duration_s / 3600, used_s), "", "", f"{peak_mb:.0f} MB"])
    with TemporaryDirectory() as folder:
        path = write_long_walk(24.0 * arguments.days, Path(folder) / "long.zip")
        used_s, peak_mb = in_tree(ROOT, _OF_PARTS, str(path), str(Path(folder) / "track.parquet"))
    rows.append(["the same, from a file in parts", *_hours(duration_s / 3600, used_s), "", "", f"{peak_mb:.0f} MB"])
    columns = " | hours | processor time | for each hour | each more than in a loop | a minute | largest process"
    about = f"A simulated walk repeated; that of ten minutes under many names, read from files; two cores, {load()}."
    tables.write("throughput_day", columns, rows, about)


if __name__ == "__main__":
    run(
        __doc__,
        recordings,
        calls,
        costs,
        stages,
        long,
        limits,
        before=None,
        every=4,
        batch=1000,
        days=7.0,
        hours=1.0,
        on_dask=60,
    )
