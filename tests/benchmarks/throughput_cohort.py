"""Weeks and months, clusters of 1, 2 and 4 workers, maps and calibrations on a cluster, and the plan of a cohort.

usage: python -m tests.benchmarks.throughput_cohort [weeks] [--days 7 30]

A day is made of recordings of one person of motionsense, with a phone in a trouser pocket at 50 Hz: eight hours of
night, which are the quietest ten seconds of sitting repeated, then sixteen hours with 49 minutes of sitting, seven of
standing and four of walking each. The next day is of the next person. The recordings follow each other without a
transition, so that the phone jumps from one orientation to another.
"""

from __future__ import annotations

import argparse
import json
import zipfile
from collections.abc import Iterator
from itertools import cycle
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import pdr_filter as pdr
from pdr_filter.values import FloatArray
from tests.benchmarks.common import ROOT, Tables, paths, run
from tests.benchmarks.throughput import in_tree, load

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
    """Whole seconds of a recording at 50 Hz."""
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
        with TemporaryDirectory(dir=arguments.folder) as folder:
            path = write_days(arguments.data, days, Path(folder) / "days.zip")
            out = Path(folder) / "track.parquet"
            used_s, peak_mb, n_steps, distance_m, duration_s = in_tree(ROOT, _OF_FILE, str(path), str(out))
            sizes = [f"{p.stat().st_size / 1e6:.0f} MB" for p in (path, out)]
        assert abs(duration_s - 86400 * days) < 2, duration_s
        samples = f"{2 * HZ * duration_s / 1e6:.0f} million"
        cost = [f"{used_s:.0f} s", f"{86400 * used_s / duration_s:.0f} s", f"{peak_mb:.0f} MB", "400 MB"]
        rows.append([str(days), samples, sizes[0], f"{n_steps}", f"{distance_m / 1e3:.0f} km", sizes[1], *cost])
    columns = "days | samples | file | steps | distance | track | processor time | for each day | memory | limit"
    about = (
        "Recordings of motionsense at 50 Hz, cut together: each day an hour of walking, two of standing, thirteen of "
        f"sitting and eight of a still phone. `batch.track_file`, one core, {load()}."
    )
    tables.write("throughput_weeks", columns, rows, about)


if __name__ == "__main__":
    run(__doc__, weeks, days=[7, 30], folder=None)
