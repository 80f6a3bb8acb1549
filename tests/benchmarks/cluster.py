"""What a cluster adds to the time of each of many short recordings.

usage: python -m tests.benchmarks.cluster [--recordings 10000] [--workers 2]

One made-up walk of some seconds, written as so many files, is tracked by Dask with so many worker processes of one
thread on this machine, and by a loop in this process. What the cluster adds is the time of its workers, all of their
waiting included, less the time of the loop, for each recording. Needs the extra `dask`.
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path

from distributed import LocalCluster

import pdr_filter as pdr
from pdr_filter import batch
from pdr_filter.io.files.own_format import write_recording
from pdr_filter.simulate import Leg, simulate
from tests.benchmarks.common import Tables, options

WALKED_M = 8.0
# Of the loop: it is the same for each.
N_LOOP = 300


def main() -> None:
    parser = options(__doc__ or "")
    parser.add_argument("--recordings", type=int, default=10_000)
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        paths = written(Path(folder), args.recordings)
        start = time.perf_counter()
        for path in paths[:N_LOOP]:
            pdr.track(pdr.read(path))
        alone_s = (time.perf_counter() - start) / N_LOOP
        with LocalCluster(n_workers=args.workers, threads_per_worker=1, dashboard_address=None) as cluster:
            on = {"scheduler": cluster.scheduler_address}
            batch.track(paths[: 2 * args.workers], out=Path(folder) / "first.csv", **on)  # all is imported then
            start = time.perf_counter()
            rows = batch.track(paths, out=Path(folder) / "tracks.csv", **on)
            whole_s = time.perf_counter() - start
        each_s = whole_s / len(paths)
        cells = [
            f"{len(rows):,}",
            sum(row.failed for row in rows),
            f"{1e3 * alone_s:.1f} ms",
            f"{whole_s:.0f} s",
            f"{1e3 * (args.workers * each_s - alone_s):.1f} ms",
        ]
    columns = ["recordings", "failed", "alone, each", "on the cluster, all", "more, of a worker's time for each"]
    about = f"{args.workers} workers, {os.cpu_count()} cores, which the scheduler and the client share."
    Tables.of(__spec__.name, args).write("cluster", columns, [cells], about)


def written(folder: Path, n: int) -> list[Path]:
    """Files of one walk."""
    walk = simulate([Leg("walking", distance_m=WALKED_M)], seed=1, name="walk")
    first = folder / "walk_0.zip"
    write_recording(walk, first)
    paths = [folder / f"walk_{k}.zip" for k in range(n)]
    for path in paths[1:]:
        os.link(first, path)
    return paths


if __name__ == "__main__":
    main()
