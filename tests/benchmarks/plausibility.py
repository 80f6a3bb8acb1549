"""Online and smoothed tracks of every recording that can be read: how many are physically impossible.

usage: python -m tests.benchmarks.plausibility [--every 1] [--extra FOLDER]

No truth is needed. A recording counts from eight steps on. The columns of the first table are kinds of oddities, in
recordings:

- distance: the smoothed distance differs by more than 5 % from the online one.
- deviation: a standard deviation of the end exceeds the walked distance.
- scatter: differences between neighbouring step lengths are more than twice as large as online.
- ends: the ends are more than four standard deviations apart, for tracks in the same frame.
- numbers: a value is not finite, or a covariance is not positive semidefinite.
- exceptions: tracking ended in an error other than a refusal of the input.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import pdr_filter as pdr
from tests.benchmarks.common import Tables, run

KINDS = ("distance", "deviation", "scatter", "ends", "numbers", "exceptions")
MIN_STEPS = 8


def oddities(online: pdr.Track, smoothed: pdr.Track) -> Iterator[tuple[str, str]]:
    """Yield kind and description of each physical impossibility of two tracks of one recording."""
    ratio = smoothed.distance_m / online.distance_m
    if abs(ratio - 1) > 0.05:
        yield "distance", f"smoothed distance {100 * (ratio - 1):+.0f} %"
    for name, track in (("online", online), ("smoothed", smoothed)):
        if track.position_std_m[-1] > max(track.distance_m, 1.0):
            yield "deviation", f"{name} ±{track.position_std_m[-1]:.0f} m after {track.distance_m:.0f} m"
    # Below 1 cm a ratio of two scatters compares digits.
    scatter = np.std(np.diff(smoothed.step_length_m)) / max(np.std(np.diff(online.step_length_m)), 0.01)
    if scatter > 2:
        yield "scatter", f"step lengths scatter {scatter:.1f} times as much"
    apart_m = np.linalg.norm(smoothed.position_m[-1] - online.position_m[-1])
    stated_m = online.position_std_m[-1] + smoothed.position_std_m[-1]
    if online.frame == smoothed.frame and apart_m > 4 * stated_m:
        yield "ends", f"ends {apart_m:.0f} m apart, sum of deviations {stated_m:.1f} m"
    if not all(
        np.isfinite(track.position_m).all() and np.linalg.eigvalsh(track.position_cov_m2).min() > -1e-9
        for track in (online, smoothed)
    ):
        yield "numbers", "not finite or not positive semidefinite"


def found_in(path: Path) -> dict[str, str] | None:
    """Return the oddities of a file by kind, or None if it has too few steps or is refused."""
    try:
        recording = pdr.read(path)
        online = pdr.track(recording)
        return dict(oddities(online, pdr.smooth(recording).track)) if online.n_steps >= MIN_STEPS else None
    except (ValueError, OSError):
        return None
    except Exception as error:
        return {"exceptions": f"{type(error).__name__}: {error}"}


def plausibility(tables: Tables, arguments: argparse.Namespace) -> None:
    """Oddities in each set, and the recordings that have some."""
    folders = sorted(path for path in arguments.data.iterdir() if any(path.glob("*.zip")))
    folders += [arguments.extra or arguments.data.parent / "app_files"]
    rows, odd, totals = list[list[object]](), list[list[object]](), Counter[str]()
    for folder in folders:
        paths = sorted(path for path in folder.rglob("*") if path.is_file())[:: arguments.every]
        counts = Counter[str]()
        for path in paths:
            if (found := found_in(path)) is not None:
                counts.update(["n", *found])
                if found:
                    odd.append([path.stem, "; ".join(found.values()).replace("|", "/")])
                    print(path.stem, found, file=sys.stderr, flush=True)
        if counts["n"]:
            rows.append([folder.name, counts["n"], *(counts[kind] for kind in KINDS)])
        totals += counts
    rows.append(["all", totals["n"], *(f"{100 * totals[kind] / totals['n']:.1f} %" for kind in KINDS)])
    tables.write("plausibility", ["set", "recordings", *KINDS], rows, "Tracks that are physically impossible.")
    tables.write("plausibility_odd", ["recording", "oddity"], odd, "Recordings of the table above with an oddity.")


if __name__ == "__main__":
    run(__doc__, plausibility, every=1, extra=None)
