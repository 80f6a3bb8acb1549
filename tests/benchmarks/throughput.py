"""How fast the whole pipeline is: recordings of all sets, their stages, an hour, a day in blocks, a block, a start.

usage: python -m tests.benchmarks.throughput [recordings] [stages] [pushed] [calls] [hour] [costs] [day] [start]
       [--before TREE] [--every 4]

The hour is the embedded simulated walk repeated in time; costs are those of one real walk, a part of the filter left
out or put in. `--before` is another checkout of the project: its recordings, stages, pushed blocks and starts are timed
in turns with ours, ours twice, so that the two figures of one tree show what the machine adds. Times are of the
processor, one core.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import pdr_filter as pdr
from pdr_filter.filter.imm.modes import context_modes
from pdr_filter.filter.imm.transition_probabilities import context_transitions
from pdr_filter.filter.step_length.models import bounce_fit
from pdr_filter.recipes import default
from pdr_filter.sensing.features.feature_windows import ATTITUDE_FREE, FeatureWindows
from pdr_filter.values import PositionFix, Samples
from tests.benchmarks.common import ROOT, Tables, options, paths
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
# The stages of the default, by the class of each, and of a step what follows them.
_OF_STAGES = """
import importlib, json, sys, time
import pdr_filter as pdr

STAGES = {
    "conditioner": "sensing.conditioning.Conditioner.step",
    "attitude and bias": "sensing.attitude.AttitudeEstimator.step",
    "features of windows": "sensing.features.windows.FeatureWindows.step",
    "contexts, features included": "sensing.contexts.learned.LearnedContexts.step",
    "step detector": "sensing.steps.adaptive.AdaptiveStepDetector.step",
    "gate": "sensing.steps.gate.StepGate.step",
    "walking heading": "sensing.heading.walking_heading.WalkingHeading.step",
    "sensing in all": "sensing.front_end.Sensing.step",
    "tracker, steps": "filter.imm_tracker.ImmTracker.on_step",
    "tracker, fixes": "filter.imm_tracker.ImmTracker.on_fix",
}
taken = dict.fromkeys(STAGES, 0.0)

def timed(function, name):
    def run(*arguments):
        start = time.process_time()
        result = function(*arguments)
        taken[name] += time.process_time() - start
        return result
    return run

recordings = [pdr.read(path) for path in sys.argv[1:]]
pdr.track(recordings[0])
for name, place in STAGES.items():
    module, owner, method = place.rsplit(".", 2)
    owner = getattr(importlib.import_module("pdr_filter." + module), owner)
    setattr(owner, method, timed(getattr(owner, method), name))
best = []
for _ in range(3):
    taken.update(dict.fromkeys(taken, 0.0))
    start = time.process_time()
    for recording in recordings:
        pdr.track(recording)
    best.append([time.process_time() - start, *taken.values()])
least = [min(times) for times in zip(*best)]
seconds = sum(recording.duration_s for recording in recordings)
print(json.dumps([["pdr.track in all", *taken], [1e3 * t / seconds for t in least]]))
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
_OF_START = """
import json, sys, time
start = time.perf_counter(), time.process_time()
import pdr_filter
pdr_filter.OnlineFilter()
print(json.dumps((time.perf_counter() - start[0], time.process_time() - start[1])))
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


def of_recordings(tables: Tables, args: argparse.Namespace) -> None:
    """Times real time of real recordings with all their sensors, for each set."""
    rows: list[list[str]] = []
    every: dict[str, list[np.ndarray]] = {name: [] for name in trees(args.before)}
    for site in SITES:
        chosen = [str(path) for path in paths(args.data, site)[:: args.every]]
        times = {name: np.array(in_tree(tree, _OF_RECORDINGS, *chosen)) for name, tree in trees(args.before).items()}
        for name, found in times.items():
            every[name].append(found)
        rows.append([site, str(len(chosen)), *(f"{(t[:, 0] / t[:, 1]).mean():.0f}" for t in times.values())])
    all_of = {name: np.concatenate(found) for name, found in every.items()}
    n = len(next(iter(all_of.values())))
    rows.append(["all", str(n), *(f"{(t[:, 0] / t[:, 1]).mean():.0f}" for t in all_of.values())])
    rows.append(["all, time by time", str(n), *(f"{t[:, 0].sum() / t[:, 1].sum():.0f}" for t in all_of.values())])
    about = f"Times real time, the mean over the recordings; one core, {load()}."
    tables.write("throughput_recordings", ["set", "recordings", *all_of], rows, about)


def of_stages(tables: Tables, args: argparse.Namespace) -> None:
    """Cost of each stage on one recording of each set."""
    chosen = [str(found[len(found) // 2]) for site in SITES if (found := paths(args.data, site))]
    runs = {name: [] for name in trees(args.before)}
    for _ in range(3):
        for name, tree in trees(args.before).items():
            stages, taken = in_tree(tree, _OF_STAGES, *chosen)
            runs[name].append(taken)
    least = [np.min(taken, axis=0) for taken in runs.values()]
    rows = [[stage, *(f"{of_tree[i]:.3f}" for of_tree in least)] for i, stage in enumerate(stages)]
    about = (
        f"ms a second of data, {len(chosen)} recordings, one of each set; the least of nine runs, in turns, one core, "
        f"{load()}."
    )
    tables.write("throughput_stages", ["stage", *runs], rows, about)


def of_pushed(tables: Tables, args: argparse.Namespace) -> None:
    """Blocks of 0.1 s of a real walk with all its sensors."""
    path, runs = str(paths(args.data, "oxiod")[2]), {name: [] for name in trees(args.before)}
    for _ in range(3):
        for name, tree in trees(args.before).items():
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


def features_s(recording: pdr.Recording) -> tuple[float, int]:
    """Time of all features of a recording, the signals given, and the number of windows."""
    sensing, stage = default().sensing, FeatureWindows(features=ATTITUDE_FREE)
    _, uniform = sensing.conditioner.update(sensing.conditioner.init(), pdr.merge_streams(recording))
    state, parts = sensing.attitude.init(), []
    for part in uniform:
        state, attitude = sensing.attitude.update(state, part)
        parts.append((part, attitude))
    start, n, windows = time.process_time(), 0, stage.init()
    for part, attitude in parts:
        windows, found = stage.update(windows, part, attitude)
        n += len(found)
    return time.process_time() - start, n


def pushed_ms(block: pdr.ImuBlock, n_samples: int = 10, most: int = 60_000) -> np.ndarray:
    """Cost of each pushed block, ms."""
    online, cost = pdr.OnlineFilter(), []
    for i in range(0, min(len(block.time_s), most), n_samples):
        part = slice(i, i + n_samples)
        start = time.process_time()
        online.push(block.time_s[part], block.specific_force_mps2[part], block.angular_rate_radps[part])
        cost.append(1e3 * (time.process_time() - start))
    return np.array(cost)


def of_an_hour(tables: Tables, args: argparse.Namespace) -> None:
    """The simulated hour, a pushed block, a saved filter."""
    recording, rows = long_walk(args.hours), []
    pdr.track(pdr.simulate.demo_walk())  # loads models, fills caches
    for weighting in ("imm", "wc", "hc"):
        best = best_s(lambda w=weighting: pdr.track(recording, weighting=w))
        times, n_steps = recording.duration_s / best, pdr.track(recording, weighting=weighting).n_steps
        rows.append([f"an hour, `{weighting}`, {n_steps} steps", f"{best:.1f} s, {times:.0f} times real time"])
    best, n_windows = min(features_s(recording) for _ in range(3))
    rows.append([f"{len(ATTITUDE_FREE.names)} features of its {n_windows} windows", f"{best:.2f} s"])
    block = pdr.merge_streams(recording)
    cost = np.min([pushed_ms(block) for _ in range(3)], axis=0)
    high = np.percentile(cost, 99)
    rows.append(["one pushed block of 0.1 s", f"mean {np.mean(cost):.2f} ms, 99th percentile {high:.1f} ms"])
    online = pdr.OnlineFilter()
    online.push(block.time_s[:3000], block.specific_force_mps2[:3000], block.angular_rate_radps[:3000])
    blob = online.save()
    loaded_ms = 1e3 * best_s(lambda: pdr.OnlineFilter.load(blob))
    rows.append(["a saved filter, models included", f"{len(blob) / 1e3:.0f} kB, loaded in {loaded_ms:.0f} ms"])
    tables.write("throughput", ["what", "result"], rows, f"One core, {load()}.")


def around(track: pdr.Track) -> pdr.FloorPlan:
    """A hall that holds a track, with four walls in it."""
    corners = np.array([track.position_m.min(axis=0) - 10.0, track.position_m.max(axis=0) + 10.0])
    west, south, east, north = corners.ravel().tolist()
    walls = [line((x, south), (x, south + 5.0)) for x in np.linspace(west, east, 6)[1:-1].tolist()]
    features = [feature("floor", box(west, south, east, north)), *(feature("wall", wall) for wall in walls)]
    with TemporaryDirectory() as folder:
        return pdr.FloorPlan.read(write(Path(folder) / "hall.geojson", features))


def of_parts(tables: Tables, args: argparse.Namespace) -> None:
    """A real walk with parts of the filter left out or put in."""
    recording = pdr.read(args.data / "oxiod" / "oxiod_anon_floor1_handheld1.zip")
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


def of_calls(tables: Tables, args: argparse.Namespace) -> None:
    """A minute of a real walk, pushed in larger and smaller pieces, merged and as its sensors come."""
    block = pdr.merge_streams(pdr.read(args.data / "oxiod" / "oxiod_anon_floor1_handheld1.zip"))
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


def of_a_day(tables: Tables, args: argparse.Namespace) -> None:
    """A day in blocks of a minute: whether its cost is that of its length, and its memory that of an hour."""
    block, online, rows = pdr.merge_streams(long_walk(1.0)), pdr.OnlineFilter(), []
    period_s, used_s, n_steps = float(block.time_s[-1]) + 0.01, 0.0, 0
    for hour in range(args.day_hours):
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


def of_start(tables: Tables, args: argparse.Namespace) -> None:
    """From the first import to the first filter."""
    found = {name: [] for name in trees(args.before)}
    for _ in range(7):
        for name, tree in trees(args.before).items():
            found[name].append(in_tree(tree, _OF_START))
    rows = [[name, *(f"{v:.2f} s" for v in np.min(taken, axis=0))] for name, taken in found.items()]
    about = "`import pdr_filter; pdr_filter.OnlineFilter()` in a fresh interpreter; the least of seven, in turns."
    tables.write("throughput_start", ["", "from start to end", "processor time"], rows, about)


PARTS: dict[str, Callable[[Tables, argparse.Namespace], None]] = {
    "recordings": of_recordings,
    "stages": of_stages,
    "pushed": of_pushed,
    "calls": of_calls,
    "hour": of_an_hour,
    "costs": of_parts,
    "day": of_a_day,
    "start": of_start,
}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = options(__doc__, *PARTS)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--day-hours", type=int, default=24)
    parser.add_argument("--every", type=int, default=4, help="take every so many-th recording of a set")
    parser.add_argument("--before", type=Path, help="another checkout to compare with")
    args = parser.parse_args(arguments)
    tables = Tables.of(__spec__.name, args)
    for part in args.parts:
        PARTS[part](tables, args)


if __name__ == "__main__":
    main()
