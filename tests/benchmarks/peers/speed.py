"""Speed of all methods on the same walks, in turns, so that other work on the machine affects all of them."""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from tests.benchmarks.common import Tables
from tests.benchmarks.throughput import in_tree, load

from . import of_mobgap, of_skdh, ours, textbook
from .tables import files_of, walk_of
from .walks import FloatArray, Run, Walk

METHODS = (*ours.METHODS, *textbook.METHODS, *of_mobgap.DETECTORS, *of_mobgap.METHODS, *of_skdh.METHODS)
ROUNDS = 3
# Runs in another process, so that it can import another version of the package.
_OF_TREE = """
import json, sys, time
import pdr_filter as pdr
function, found = getattr(pdr, sys.argv[1]), []
for path in sys.argv[2:]:
    recording = pdr.read(path)
    if not found:
        function(recording)
    start = time.process_time()
    function(recording)
    found.append(time.process_time() - start)
print(json.dumps(found))
"""


class Contestant(NamedTuple):
    """Method with a function that returns its processor times, (W,) in s, for the walks of one site."""

    name: str
    times_s: Callable[[list[Path], list[Walk]], FloatArray]
    walk_known: bool = False


def _of_tree(tree: Path, function: str, files: list[Path], walks: list[Walk]) -> FloatArray:
    return np.array(in_tree(tree, _OF_TREE, function, *map(str, files)))


def _here(run: Run, files: list[Path], walks: list[Walk]) -> FloatArray:
    """Return the processor times (W,) in s; NaN for walks on which the method fails."""
    taken = np.full(len(walks), np.nan)
    for i, walk in enumerate(walks):
        try:
            start = time.process_time()
            run(walk)
            taken[i] = time.process_time() - start
        except Exception:  # the other tables report what fails
            continue
    return taken


def contestants(before: Path | None) -> list[Contestant]:
    """Return all installed methods. Our detector comes twice, and an earlier version as well if it is given."""
    found = list[Contestant]()
    if before is not None:
        functions = "detect_steps", "track"
        found = [Contestant(f"pdr_filter, {f}, before", partial(_of_tree, before, f)) for f in functions]
    for method in (*METHODS[:1], *METHODS):
        try:
            run = method.load()
        except ImportError:  # the table of the environment names missing packages
            continue
        again = ", again" if any(c.name == method.name for c in found) else ""
        found.append(Contestant(method.name + again, partial(_here, run), method.walk_known))
    return found


def times_real_time(
    contestants: list[Contestant], files: list[Path], walks: list[Walk], rounds: int = ROUNDS
) -> FloatArray:
    """Return the recorded time over the processor time of each method, from the least time of each walk."""
    for walk in walks:
        _ = walk.body, walk.track  # computed once, and not counted
    for contestant in contestants:
        contestant.times_s(files[:1], walks[:1])  # compiles and loads
    runs = [[c.times_s(files, walks) for c in contestants] for _ in range(rounds)]
    least_s = np.min(runs, axis=0)
    recorded_s, inside_s = np.array([(walk.recording.duration_s, walk.end_s - walk.start_s) for walk in walks]).T
    spans_s = np.array([inside_s if c.walk_known else recorded_s for c in contestants])
    return np.where(np.isnan(least_s), 0.0, spans_s).sum(axis=1) / np.nansum(least_s, axis=1)


def speed(tables: Tables, arguments: argparse.Namespace) -> None:
    """Write the times real time of all methods on all sites."""
    warnings.simplefilter("ignore")
    methods, columns, n_walks = contestants(arguments.before), list[FloatArray](), list[str]()
    with threadpool_limits(limits=1):
        for site in arguments.sites:
            files = files_of(arguments.data, site, arguments.every)
            n_walks.append(str(len(files)))
            columns.append(times_real_time(methods, files, [walk_of(path) for path in files]))
    rows = [[m.name, *(f"{c[i]:.0f}" for c in columns)] for i, m in enumerate(methods)]
    of_walks = f"{', '.join(n_walks)} walks, of each the least of {ROUNDS} runs in turns"
    about = f"Times real time, one core; {of_walks}, {load()}."
    tables.write("peers_speed", ["method", *arguments.sites], rows, about)
