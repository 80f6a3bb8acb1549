"""The command; what it does is said in the package."""

from __future__ import annotations

import argparse
import os
import platform
import warnings
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from threadpoolctl import threadpool_limits

from tests.benchmarks import rvm_speed
from tests.benchmarks.common import Tables, run

from . import of_mobgap, of_skdh, ours, tables, textbook
from .harness import outcome
from .speed import speed

METHODS = (*ours.METHODS, *textbook.METHODS, *of_mobgap.METHODS, *of_skdh.METHODS)
PACKAGES = ("pdr_filter", "fastrvm", "mobgap", "scikit-digital-health", "pywavelets")
ENVIRONMENT = ("numpy", "scipy", "scikit-learn", "pandas")
QUESTIONS = {
    "ubicomp13": (("peers_counts", tables.counts), ("peers_places", tables.counts_by_place)),
    "oxford": (("peers_step_times", tables.step_times),),
    "humolire": (("peers_legs", tables.legs),),
    "tyrex": (("peers_room", tables.room),),
}


def installed(package: str) -> str:
    """Name and version, or that it is missing."""
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return f"{package} not installed"


def processor() -> str:
    """What the machine calls itself."""
    info = Path("/proc/cpuinfo")
    names = (
        [line.split(":")[1].strip() for line in info.read_text().splitlines() if "model name" in line]
        if info.exists()
        else []
    )
    return f"{names[0] if names else platform.processor() or platform.machine()}, {os.cpu_count()} cores"


def compare(tables_: Tables, arguments: argparse.Namespace) -> None:
    """All tables of results, of all methods."""
    files = Tables(tables_.command, None if arguments.every > 1 else tables_.folder)
    warnings.simplefilter("ignore")
    files.write(
        "peers_environment",
        ["", ""],
        [
            ["machine", f"Python {platform.python_version()}, {processor()}, one thread"],
            ["packages", ", ".join(installed(p) for p in PACKAGES)],
            ["with", ", ".join(installed(p) for p in ENVIRONMENT)],
        ],
    )
    with threadpool_limits(limits=1):
        rvm_speed.fastrvm(files, arguments)

    by_site = {}
    for site in arguments.sites:
        walks = [tables.walk_of(path) for path in tables.files_of(arguments.data, site, arguments.every)]
        by_site[site] = [outcome(method, walks) for method in METHODS]
        for name, question in QUESTIONS[site]:
            files.write(name, *question(by_site[site]), f"{site}, {len(walks)} walks.")


if __name__ == "__main__":
    run(__doc__, compare, speed, sites=list(QUESTIONS), every=1, before=None)
