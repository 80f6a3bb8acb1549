"""The command; what it does is said in the package."""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import platform
import warnings
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from threadpoolctl import threadpool_limits

from .. import rvm_speed
from . import of_filterpy, of_mobgap, of_skdh, ours, tables, textbook
from .harness import outcome

METHODS = (*ours.METHODS, *textbook.METHODS, *of_mobgap.METHODS, *of_skdh.METHODS)
PACKAGES = ("pdr_filter", "filterpy", "fastrvm", "mobgap", "scikit-digital-health", "pywavelets")
ENVIRONMENT = ("numpy", "scipy", "scikit-learn", "pandas")
QUESTIONS = {
    "ubicomp13": (
        ("Steps counted on video", tables.counts),
        ("By placement of the phone, mean absolute error %", tables.counts_by_place),
    ),
    "oxford": (("Step times against foot switches", tables.step_times),),
    "humolire": (("Distance and speed on straight legs", tables.legs),),
    "tyrex": (("Distance and speed in a room of 5 m", tables.room),),
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


def show(title: str, lines: tuple[str, ...]) -> None:
    """A titled table."""
    print(f"\n### {title}\n\n" + "\n".join(lines), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.peers")
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[4] / "shared" / "data")
    parser.add_argument("--sites", nargs="*", choices=QUESTIONS, default=list(QUESTIONS))
    parser.add_argument("--every", type=int, default=1, help="only every n-th recording, for all methods alike")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    print(f"{date.today()}, Python {platform.python_version()}, {processor()}, one thread.")
    print("Packages: " + ", ".join(installed(p) for p in PACKAGES) + ".")
    print("With: " + ", ".join(installed(p) for p in ENVIRONMENT) + ".", flush=True)

    show("The filter against filterpy's IMMEstimator", of_filterpy.table_lines())
    print("\n### The relevance vector machine against fastrvm", flush=True)
    with threadpool_limits(limits=1):
        rvm_speed.against_fastrvm()

    by_site = {}
    for site in arguments.sites:
        walks = tables.walks_of(arguments.data, site, arguments.every)
        by_site[site] = [outcome(method, walks) for method in METHODS]
        for title, question in QUESTIONS[site]:
            show(f"{title}: {site}, {len(walks)} walks", question(by_site[site]))
    show("Times real time, one core, without reading and alignment", tables.throughput(by_site))


if __name__ == "__main__":
    main()
