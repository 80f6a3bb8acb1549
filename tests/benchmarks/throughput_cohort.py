"""Weeks and months, clusters of 1, 2 and 4 workers, maps and calibrations on a cluster, and the plan of a cohort.

usage: python -m tests.benchmarks.throughput_cohort [weeks] [scaling] [joint] [plan] [--days 7 30] [--folder DIR]
       [--workers 1 2 4] [--batch 60] [--minutes 10] [--walks 200] [--people 100]

A day is made of recordings of one person of motionsense, with a phone in a trouser pocket at 50 Hz: eight hours of
night, which are the quietest ten seconds of sitting repeated, then sixteen hours with 49 minutes of sitting, seven of
standing and four of walking each. The next day is of the next person. The recordings follow each other without a
transition, so that the phone jumps from one orientation to another. Recordings and figures stay in `--folder`, if it is
given, and are not made again.

`plan` reads the tables that the other parts have written.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import psutil

import pdr_filter as pdr
from pdr_filter import batch
from pdr_filter.apps.batch.result_table import Task
from pdr_filter.apps.batch.run import track_one
from pdr_filter.values import FloatArray
from tests.benchmarks.common import FOLDER, ROOT, Tables, paths, run
from tests.benchmarks.throughput import QUIET_DASK, in_tree, load, long_walk
from tests.benchmarks.walk_map_scale import N_STOREYS, given, walked

HZ = 50
NIGHT_S, HOURS_AWAKE = 8 * 3600, 16
EACH_HOUR_S = {"sit": 2940, "std": 435, "wlk": 225}  # an hour of walking a day
# In another process: processor time and largest memory of one file, which is read in parts. ru_maxrss would contain
# the memory of the parent.
_OF_FILE = """
import json, sys, time
import pdr_filter as pdr
start = time.process_time()
written = pdr.batch.track_file(sys.argv[1], sys.argv[2])
used_s = time.process_time() - start
(peak_kb,) = [line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")]
print(json.dumps([used_s, int(peak_kb) / 1e3, written.n_steps, written.distance_m, written.about.duration_s]))
"""


# --- weeks -----------------------------------------------------------------------------------------------------------


class Person:
    """Seconds of recordings of one person, as lines of text in which T stands for the second."""

    def __init__(self, data: Path, name: str) -> None:
        found = {kind: paths(data, "motionsense", f"motionsense_{name}_{kind}_*.zip") for kind in EACH_HOUR_S}
        self.of = {kind: [s for path in files for s in _seconds(pdr.read(path))] for kind, files in found.items()}
        calm = [
            (float(r.accelerometer.values[i : i + 10 * HZ].std(axis=0).max()), path, i)
            for path in found["sit"]
            for r in [pdr.read(path)]
            for i in range(0, len(r.accelerometer.values) - 10 * HZ, HZ)
        ]
        _, path, i = min(calm)
        self.night = _seconds(pdr.read(path))[i // HZ : i // HZ + 10]

    def day(self) -> Iterator[list[tuple[str, str]]]:
        """Bouts of a day, each a list of the seconds of accelerometer and gyroscope."""
        yield _of_length(cycle(self.night), NIGHT_S)
        sources = {kind: cycle(seconds) for kind, seconds in self.of.items()}
        for _ in range(HOURS_AWAKE):
            for kind, length_s in EACH_HOUR_S.items():
                yield _of_length(sources[kind], length_s)


def _of_length(seconds: Iterator[tuple[str, str]], length_s: int) -> list[tuple[str, str]]:
    return [next(seconds) for _ in range(length_s)]


def _seconds(recording: pdr.Recording) -> list[tuple[str, str]]:
    """Return the whole seconds of a recording at 50 Hz, as lines of its accelerometer and its gyroscope."""
    assert recording.gyroscope is not None
    streams = [_lines(s.values) for s in (recording.accelerometer, recording.gyroscope)]
    return list(zip(*streams, strict=True))


def _lines(values: FloatArray) -> list[str]:
    rows = [f"T.{i % HZ * 1000 // HZ:03d},{x:.7g},{y:.7g},{z:.7g}\n" for i, (x, y, z) in enumerate(values.tolist())]
    return ["".join(rows[i : i + HZ]) for i in range(0, len(rows) - HZ + 1, HZ)]


def write_days(data: Path, days: int, path: Path) -> Path:
    """A recording of days in the own format, which is never in memory as a whole."""
    names = sorted({p.name.split("_")[1] for p in paths(data, "motionsense")})
    people = [Person(data, name) for name in names[:days]]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("meta.json", json.dumps({"name": "days"}))
        for column, name in enumerate(("accelerometer", "gyroscope")):
            with archive.open(f"{name}.csv", "w", force_zip64=True) as file:
                file.write(b"time_s,x,y,z\n")
                at_s = 0
                for day in range(days):
                    for bout in people[day % len(people)].day():
                        text = [second[column].replace("T", str(at_s + i)) for i, second in enumerate(bout)]
                        file.write("".join(text).encode())
                        at_s += len(bout)
    return path


def weeks(tables: Tables, arguments: argparse.Namespace) -> None:
    """Tracks of a week and of a month, from a file in parts."""
    rows = list[list[str]]()
    for days in arguments.days:
        with kept_in(arguments.folder) as folder:
            measured = folder / f"figures_{days}.json"
            if not measured.exists():
                path, out = folder / f"days_{days}.zip", folder / f"track_{days}.parquet"
                if not path.exists():
                    write_days(arguments.data, days, path.with_suffix(".part")).rename(path)
                figures = [*in_tree(ROOT, _OF_FILE, str(path), str(out)), os.getloadavg()[1]]
                measured.write_text(json.dumps([*figures, path.stat().st_size, out.stat().st_size]))
            used_s, peak_mb, n_steps, distance_m, duration_s, busy, n_read, n_written = json.loads(measured.read_text())
        assert abs(duration_s - 86400 * days) < 2, duration_s
        sizes = [f"{n_read / 1e6:.0f} MB", f"{n_steps}", f"{distance_m / 1e3:.0f} km", f"{n_written / 1e6:.1f} MB"]
        cost = [f"{used_s:.0f} s", f"{86400 * used_s / duration_s:.0f} s", f"{peak_mb:.0f} MB", "400 MB", f"{busy:.1f}"]
        rows.append([str(days), f"{2 * HZ * duration_s / 1e6:.0f} million", *sizes, *cost])
    columns = "days | samples | file | steps | distance | track | processor time | for each day | memory | limit | load"
    about = (
        "Recordings of motionsense at 50 Hz, cut together: each day an hour of walking, two of standing, thirteen of "
        "sitting and eight of a still phone. `batch.track_file` on one core. The load is that of the machine, which is "
        "1 without other work."
    )
    tables.write("throughput_weeks", columns, rows, about)


# --- clusters --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Cluster:
    """Processes of a Dask cluster on this machine."""

    address: str
    scheduler: psutil.Process
    nanny: psutil.Process  # the parent of the workers

    def used_s(self) -> float:
        """Processor time of scheduler and nanny, without the workers."""
        return sum(sum(process.cpu_times()[:2]) for process in (self.scheduler, self.nanny))

    def idle_share(self, seconds: float = 20.0) -> float:
        """Processor time of all processes in a second without recordings."""
        workers = self.nanny.children(recursive=True)
        start, start_s = time.perf_counter(), self.used_s() + sum(sum(w.cpu_times()[:2]) for w in workers)
        time.sleep(seconds)
        used_s = self.used_s() + sum(sum(w.cpu_times()[:2]) for w in workers) - start_s
        return used_s / (time.perf_counter() - start)


@contextmanager
def cluster(n_workers: int, settings: dict[str, str]) -> Generator[Cluster]:
    """A scheduler and workers as they are started by hand, each worker ready to track."""
    from distributed import Client

    environment = {**os.environ, **settings, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    with TemporaryDirectory() as folder:
        where = ["--scheduler-file", f"{folder}/scheduler.json"]
        commands = [
            ["scheduler", *where, "--host", "127.0.0.1", "--port", "0", "--no-dashboard"],
            ["worker", *where, "--nworkers", str(n_workers), "--nthreads", "1", "--no-dashboard"],
        ]
        processes = [
            psutil.Popen(
                [sys.executable, "-m", "dask", *command], cwd=folder, env=environment, stderr=subprocess.DEVNULL
            )
            for command in commands
        ]
        try:
            with Client(scheduler_file=where[1], timeout=120, set_as_default=False) as client:
                client.wait_for_workers(n_workers, timeout=300)
                client.run(_ready)
                address = client.scheduler.address
            yield Cluster(address, *processes)
        finally:
            for process in reversed(processes):
                process.terminate()
                process.wait()


def _ready() -> None:
    """Load all that the tracking of a recording needs."""
    pdr.track(pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=10.0)]))


@dataclass(frozen=True)
class Timed:
    """Processor times of a worker around one recording."""

    pid: int
    begin_s: float  # processor time of the process before the recording
    end_s: float
    used_s: float  # processor time of the thread that tracked the recording
    peak_mb: float


def timed(path: str) -> Timed:
    """Track a recording of a batch."""
    begin_s, start_s = time.process_time(), time.thread_time()
    row = track_one(Task(path))
    assert not row.failed, row.reason
    return Timed(os.getpid(), begin_s, time.process_time(), time.thread_time() - start_s, peak_mb())


def waited(_: str) -> Timed:
    """Wait as long as Dask needs for its messages, without work."""
    begin_s = time.process_time()
    time.sleep(0.3)
    return Timed(os.getpid(), begin_s, time.process_time(), 0.0, peak_mb())


def peak_mb() -> float:
    """Largest memory of this process. `ru_maxrss` may be that of its parent."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (peak_kb,) = [line.split()[1] for line in lines if line.startswith("VmHWM")]
    return int(peak_kb) / 1e3


@dataclass(frozen=True)
class Cost:
    """Cost of a batch for each recording."""

    n: int
    elapsed_s: float
    work_s: float  # processor time of the thread that tracks
    rest_s: float  # other processor time of the workers
    served_s: float  # processor time of this process, of the scheduler and of the nanny
    peak_mb: float


def cost(files: list[str], running: Cluster | None = None, jobs: int = 1, work: str = "timed") -> Cost:
    """Cost of tracking files, or of other work with them, on a cluster or on processes of this machine."""
    from tests.benchmarks import throughput_cohort  # other processes cannot import the main script

    where: dict[str, Any] = {"jobs": jobs} if running is None else {"scheduler": running.address}
    start, own_s, others_s = time.perf_counter(), time.process_time(), running.used_s() if running else 0.0
    found = list[Timed]()
    for _, result in batch.each(getattr(throughput_cohort, work), files, **where):
        if isinstance(result, batch.Failure):
            raise RuntimeError(result.reason)
        found.append(result)
    elapsed_s, n = time.perf_counter() - start, len(files)
    served_s = time.process_time() - own_s + (running.used_s() - others_s if running else 0.0)
    work_s = sum(t.used_s for t in found)
    of_process = {pid: [t for t in found if t.pid == pid] for pid in {t.pid for t in found}}
    whole_s = sum(max(t.end_s for t in of) - min(t.begin_s for t in of) for of in of_process.values())
    peak = max(t.peak_mb for t in found)
    return Cost(n, elapsed_s / n, work_s / n, (whole_s - work_s) / n, served_s / n, peak)


def copies(folder: str, minutes: float, n: int) -> list[str]:
    """Paths of a walk under many names."""
    files = [f"{folder}/walk {i}.zip" for i in range(n)]
    long_walk(minutes / 60.0).save(files[0])
    for file in files[1:]:
        os.link(files[0], file)
    return files


def more_on_dask_s(minutes: float, n: int) -> float:
    """Processor time beyond that of tracking, for each recording on Dask, less that on processes."""
    with TemporaryDirectory() as folder, cluster(2, QUIET_DASK) as running:
        files = copies(folder, minutes, n)
        cost(files[:1], running)  # the scheduler imports the package
        on_dask, on_processes = cost(files, running), cost(files, jobs=2)
    return on_dask.rest_s + on_dask.served_s - on_processes.rest_s - on_processes.served_s


def scaling(tables: Tables, arguments: argparse.Namespace) -> None:
    """Recordings on 2 processes and on clusters of more and more workers."""
    rows = list[list[str]]()
    with TemporaryDirectory() as folder:
        files = copies(folder, arguments.minutes, arguments.batch)

        def add(what: str, n_workers: int, of: Cost, idle: str = "") -> None:
            more_ms = 1e3 * (of.rest_s + of.served_s)
            cores = (of.work_s + of.rest_s + of.served_s) / of.elapsed_s
            times = [f"{60 / of.elapsed_s:.1f}", f"{cores:.2f}", f"{of.work_s:.2f} s"]
            rest = [f"{1e3 * of.rest_s:.1f} ms", f"{1e3 * of.served_s:.1f} ms", f"{more_ms:.1f} ms", idle]
            rows.append([what, str(n_workers), *times, *rest, f"{of.peak_mb:.0f} MB"])

        add("processes", 2, cost(files, jobs=2))
        own = ("Dask's defaults", 2, {})
        for what, n, settings in (*(("Dask", n, QUIET_DASK) for n in arguments.workers), own):
            with cluster(n, settings) as running:
                cost(files[:1], running)  # the scheduler imports the package
                idle = f"{1e3 * running.idle_share():.0f} ms"
                add(what, n, cost(files, running), idle)
                if (what, n) == ("Dask", 2):
                    add("Dask, waiting 0.3 s instead", n, cost(files, running, work="waited"), idle)
    columns = (
        "on | workers | recordings a minute | cores in use | tracking | other threads of the worker | scheduler, nanny "
        "and client | more than tracking | idle, each second | memory of a worker"
    )
    about = (
        f"{arguments.batch} recordings of {arguments.minutes:g} minutes; processor time for each recording, on "
        f"{psutil.cpu_count()} cores, {load()}."
    )
    tables.write("throughput_scaling", columns, rows, about)


# --- maps and calibrations -------------------------------------------------------------------------------------------


def joint(tables: Tables, arguments: argparse.Namespace) -> None:
    """Maps of many walks and calibrations of many people, in one process and on a cluster."""
    from tests.benchmarks import throughput_cohort

    rows = list[list[str]]()
    with kept_in(arguments.folder) as folder:
        for work, n in ((mapped, arguments.walks), (calibrated, arguments.people)):
            make = {mapped: throughput_cohort.saved_walk, calibrated: throughput_cohort.saved_person}[work]
            files = [str(folder / f"{work.__name__}_{i:04d}.zip") for i in range(n)]
            for _, failure in batch.each(make, files):
                assert failure is None, failure
            with TemporaryDirectory() as cache:
                alone_s, alone = _used_s(work, files, cache, None)
                solved_s, again = _used_s(work, files, cache, None)
            with cluster(2, QUIET_DASK) as running, TemporaryDirectory() as cache:
                before_s, start = running.used_s(), time.perf_counter()
                here_s, found = _used_s(work, files, cache, running.address)
                served_s, elapsed_s = running.used_s() - before_s, time.perf_counter() - start
            assert found == alone == again
            times = [f"{s:.1f} s" for s in (alone_s, solved_s, here_s, served_s, elapsed_s)]
            rows.append([f"{n} walks {work.__name__}", *times, f"{alone_s / solved_s:.2f}"])
    columns = (
        "what | in one process | solving alone | with two Dask workers: the caller | scheduler and nanny | elapsed | "
        "most that workers can gain"
    )
    about = (
        "Processor time, but for the elapsed one: simulated walks of 120 m with Wi-Fi, and simulated walks of as many "
        f"people along known distances; {load()}."
    )
    tables.write("throughput_joint", columns, rows, about)


def saved_walk(path: str) -> None:
    """Write a walk for a map, unless it is there."""
    if not Path(path).exists():
        walked(int(Path(path).stem.split("_")[1]))[0].save(path)


def saved_person(path: str) -> None:
    """Write a walk of a person with known distances, unless it is there."""
    if Path(path).exists():
        return
    seed = int(Path(path).stem.split("_")[1])
    rng = np.random.default_rng(seed)
    legs = [pdr.simulate.Leg("walking", distance_m=float(d), turn_rad=1.57) for d in rng.uniform(20.0, 40.0, 4)]
    pdr.simulate.simulate(legs, seed=seed, name=Path(path).stem).save(path)


def mapped(files: list[str], cache: str, scheduler: str | None) -> object:
    """Final positions of the walks of a map, of which one on each storey is given."""
    known = [fix for i, path in enumerate(files[:N_STOREYS]) for fix in given(pdr.read(path), i)]
    found = pdr.map_walks(files, known, cache=cache, scheduler=scheduler)
    return [(walk.name, walk.group, walk.position_m[-1].tolist()) for walk in found.walks]


def calibrated(files: list[str], cache: str, scheduler: str | None) -> object:
    """Step lengths of all people."""
    found = batch.calibrate(files, resume=cache, scheduler=scheduler, each_a_person=True)
    return {name: person.k0 for name, person in found.subjects.items()}


def _used_s(work: Callable[[list[str], str, str | None], object], *arguments: Any) -> tuple[float, object]:
    start_s = time.process_time()
    result = work(*arguments)
    return time.process_time() - start_s, result


# --- the plan --------------------------------------------------------------------------------------------------------


def plan(tables: Tables, arguments: argparse.Namespace) -> None:
    """Machines, hours and bytes of a cohort, from the tables of the other parts."""
    long = max(_rows("throughput_weeks"), key=lambda row: float(row["days"]))
    weeks_of = float(long["days"]) / 7.0
    each_s = 7.0 * _number(long["for each day"])
    read_mb, written_mb = (_number(long[name]) / weeks_of for name in ("file", "track"))
    people, rows = arguments.cohort, list[list[str]]()
    for machines, cores in ((1, 2), (1, 16), (4, 16), (16, 16)):
        hours = people * each_s / 3600.0 / (machines * cores)
        memory_gb = cores * _number(long["memory"]) / 1e3
        rate_mbs = people * read_mb / hours / 3600.0
        times = [f"{hours:,.0f}", f"{hours / 24:.1f}"]
        rows.append([str(machines), str(cores), *times, f"{memory_gb:.1f} GB", f"{rate_mbs:.1f} MB/s"])
    about = (
        f"{people:,} people, a week each: {people * each_s / 3600:,.0f} hours of one core, "
        f"{people * read_mb / 1e6:.1f} TB of recordings, {people * written_mb / 1e3:.0f} GB of tracks. Computed from "
        f"the row of {long['days']} days of throughput_weeks."
    )
    columns = "machines | cores of each | hours | days | memory of each | reading, all machines"
    tables.write("throughput_plan", columns, rows, about)


def _rows(name: str) -> list[dict[str, str]]:
    """Rows of a table that was written."""
    lines = (FOLDER / f"{name}.md").read_text().splitlines()
    cells = [line.strip("| ").split(" | ") for line in lines if line.startswith("|")]
    return [dict(zip(cells[0], row, strict=True)) for row in cells[2:]]


def _number(cell: str) -> float:
    return float(cell.split()[0])


@contextmanager
def kept_in(folder: Path | None) -> Generator[Path]:
    """The folder, or one that is removed afterwards."""
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        yield folder
        return
    with TemporaryDirectory() as temporary:
        yield Path(temporary)


if __name__ == "__main__":
    run(
        __doc__,
        weeks,
        scaling,
        joint,
        plan,
        days=[7, 30],
        folder=None,
        workers=[1, 2, 4],
        batch=60,
        minutes=10.0,
        walks=200,
        people=100,
        cohort=10_000,
    )
