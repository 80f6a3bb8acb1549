"""Time and memory of a map of many simulated walks through one building, each size in a process of its own.

usage: python -m tests.benchmarks.walk_map_scale [--walks 100 500 2000] [--folder DIR] [--workers 2] [--cluster]

The building has five storeys of 120 m by 80 m with corridors every 20 m, and 100 access points on each, heard through
floors with 15 dB less. Their power has deviations that last about 10 m (5 dB), deviations of a walk (5 dB) and of a
scan (5 dB), with which the fingerprints are about as similar as those of `ms_indoor`. A walk goes along six corridors
chosen at random. One walk a storey is given by its start and direction. Tracking runs on `--workers` processes, or on a
Dask cluster of as many. The second run finds all tracked walks in the cache, as a run does that was killed before its
end. Simulated walks and figures stay in `--folder`, if it is given, and are not made again.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import pdr_filter as pdr
from pdr_filter.apps.batch import each
from pdr_filter.simulate import Leg, simulate
from tests.benchmarks.common import ROOT, Tables, run
from tests.heard import hearing

N_STOREYS, BLOCK_M, N_BLOCKS, N_LEGS = 5, 20.0, (6, 4), 6
N_POINTS, STOREY_M, FLOOR_DB, STD_DB, WAVE_M, N_WAVES = 100, 4.0, 15.0, 5.0, 40.0, 8
WRONG_M = 15.0
DIRECTIONS = np.array([(0, 1), (1, 0), (0, -1), (-1, 0)])  # north, east, south, west


def access_points_m() -> np.ndarray:
    """Places (5, 100, 3) of the access points of each storey."""
    plane_m = np.random.default_rng(0).uniform(0.0, BLOCK_M * np.array(N_BLOCKS), (N_STOREYS, N_POINTS, 2))
    up_m = np.broadcast_to(STOREY_M * np.arange(N_STOREYS)[:, None, None], (N_STOREYS, N_POINTS, 1))
    return np.concatenate([plane_m, up_m], axis=-1)


def heard(time_s: np.ndarray, place_m: np.ndarray, storey: int, rng: np.random.Generator) -> pdr.Wifi:
    """Scans at times (S,) and places (S, 2) on a storey, of all access points of the building."""
    points_m = access_points_m()
    place = np.column_stack([place_m, np.full(len(place_m), STOREY_M * storey)])
    far_m = np.linalg.norm(place[:, None] - points_m.reshape(-1, 3), axis=-1)
    floors = np.repeat(np.abs(np.arange(N_STOREYS) - storey), N_POINTS)
    power = -35.0 - 30.0 * np.log10(np.maximum(far_m, 1.0)) - FLOOR_DB * floors
    fixed = np.random.default_rng(1)  # deviations that all walks share: waves of random directions for each point
    wave = fixed.normal(scale=2.0 * np.pi / WAVE_M, size=(2, N_WAVES, points_m.shape[0] * N_POINTS))
    phase = fixed.uniform(0.0, 2.0 * np.pi, wave.shape[1:])
    power += STD_DB * np.sqrt(2.0 / N_WAVES) * np.cos(np.tensordot(place_m, wave, 1) + phase).sum(axis=1)
    power += STD_DB * (rng.normal(size=power.shape[1]) + rng.normal(size=power.shape))
    scan, point = np.nonzero(power > -90.0)
    within_s = rng.uniform(0.0, 1.2, len(scan))
    return pdr.Wifi(time_s[scan] + within_s, point, np.round(power[scan, point]), np.full(len(scan), 2412.0))


def walked(seed: int) -> tuple[pdr.Recording, int]:
    """A walk along random corridors, and its storey. Its truth is in the frame of the building."""
    rng = np.random.default_rng(seed)
    node = rng.integers(0, np.array(N_BLOCKS) + 1)
    first = facing = int(rng.choice([d for d in range(4) if inside(node + DIRECTIONS[d])]))
    legs, start_m = [Leg("stationary", duration_s=1.0)], BLOCK_M * node
    for _ in range(N_LEGS):
        turns = [t for t in (-1, 0, 1) if inside(node + DIRECTIONS[(facing + t) % 4])]
        turn = int(rng.choice(turns)) if len(legs) > 1 else 0
        legs.append(Leg("walking", distance_m=BLOCK_M, turn_rad=turn * np.pi / 2))
        facing = (facing + turn) % 4
        node = node + DIRECTIONS[facing]
    walk = simulate(legs, start_heading_rad=first * np.pi / 2, seed=seed, name=f"walk{seed:05d}")
    storey = seed % N_STOREYS
    return hearing(walk, start_m, partial(heard, storey=storey, rng=rng)), storey


def inside(node: np.ndarray) -> bool:
    return bool((node >= 0).all() and (node <= N_BLOCKS).all())


def saved(seed: int, folder: str) -> None:
    """Write a walk, unless it is there."""
    path = Path(folder) / f"walk{seed:05d}.zip"
    if not path.exists():
        walked(seed)[0].save(path)


def given(recording: pdr.Recording, seed: int) -> list[tuple[str, pdr.PositionFix | pdr.HeadingFix]]:
    """Start and direction of a walk, if it is the one of its storey that is given."""
    if seed >= N_STOREYS:
        return []
    w = recording.truth.waypoints
    points_m = np.column_stack([w.east_m, w.north_m])
    along_rad = np.arctan2(*(points_m[2] - points_m[1]))
    start = pdr.PositionFix(1.0, points_m[0], np.eye(2), floor=seed % N_STOREYS)
    return [(recording.name, start), (recording.name, pdr.HeadingFix(6.0, along_rad, 0.1))]


def mapped(folder: Path, n_walks: int, workers: int, cluster: bool) -> dict[str, float]:
    """Figures of one map, and of a second run that finds the tracked walks."""
    paths, known, truth = [], [], dict[str, tuple[np.ndarray, int]]()
    for seed in range(n_walks):
        paths.append(folder / f"walk{seed:05d}.zip")
        recording, storey = pdr.read(paths[-1]), seed % N_STOREYS
        w = recording.truth.waypoints
        points = np.column_stack([w.time_s, w.east_m, w.north_m])
        truth[recording.name] = points, storey
        known += given(recording, seed)
    scheduler = None
    if cluster:
        from dask.distributed import LocalCluster

        running = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
        scheduler = running.scheduler_address
    figures = {}
    with TemporaryDirectory() as cache:
        for name in ("first", "second"):
            start = time.perf_counter()
            found = pdr.map_walks(paths, known, cache=cache, jobs=workers, scheduler=scheduler)
            figures[name] = time.perf_counter() - start
    others = [w for w in found.walks if w.group == 0 and w.name not in dict(known)]
    errors, n_wrong = list[float](), 0
    for walk in others:
        points, storey = truth[walk.name]
        error = [float(np.hypot(*(walk.at(t)[0] - place))) for t, *place in points]
        errors += error
        n_wrong += bool(np.mean(error) > WRONG_M or (walk.floor != storey).any())
    figures["joined"] = len(others) / (n_walks - N_STOREYS)
    figures["wrong"] = n_wrong / max(len(others), 1)
    figures["median"] = float(np.median(errors)) if errors else float("nan")
    figures["mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    figures["worker_mb"] = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    return figures


def scale(tables: Tables, arguments: argparse.Namespace) -> None:
    """Maps of more and more walks."""
    from tests.benchmarks import walk_map_scale  # other processes cannot import the main script

    with TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        seeds = range(max(arguments.walks))
        for seed, failure in each(partial(walk_map_scale.saved, folder=str(folder)), seeds, jobs=arguments.workers):
            if failure is not None:
                raise RuntimeError(f"walk {seed}: {failure}")
        rows = []
        for n in arguments.walks:
            measured = folder / f"figures_{n}_{arguments.workers}_{arguments.cluster}.json"
            code = f"""
import json
from pathlib import Path
from tests.benchmarks.walk_map_scale import mapped
if __name__ == "__main__":
    print(json.dumps(mapped(Path({str(folder)!r}), {n}, {arguments.workers}, {arguments.cluster})))
"""
            if not measured.exists():
                done = subprocess.run(
                    [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
                )
                measured.write_text(done.stdout.splitlines()[-1])
            f = json.loads(measured.read_text())
            print(n, f, file=sys.stderr, flush=True)
            costs = [f"{f[run]:.0f} s" for run in ("first", "second")]
            costs += [f"{f[size]:.0f} MB" for size in ("mb", "worker_mb")]
            rows.append(
                [str(n), *costs, f"{100 * f['joined']:.0f} %", f"{100 * f['wrong']:.1f} %", f"{f['median']:.1f} m"]
            )
    columns = "walks | time | from the cache | memory | of a worker | joined | of these wrong | median"
    where = f"{arguments.workers} {'workers of a Dask cluster' if arguments.cluster else 'processes'}"
    about = f"Simulated walks of 120 m, tracked on {where} and solved in one."
    tables.write("walk_map_scale", columns, rows, about)


if __name__ == "__main__":
    run(__doc__, scale, walks=[100, 500, 2000], folder=None, workers=2, cluster=False)
