"""A walk in which the phone goes from the hand into the pocket, back, and into the swinging hand: docs/images.

usage: python -m tests.benchmarks.carrying_change [--out docs/images/carrying_change.svg] [--walks 10]

Simulated, because no public recording has such a change on a walk of known path. The figure has one walk with the
default recipe and with the direction of the device taken for that of the person; the table has errors of ten walks.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import pdr_filter as pdr
from pdr_filter.simulate import Leg, simulate
from tests.benchmarks.common import ROOT, Tables, median_and, options

RIGHT = np.pi / 2
LEGS = [
    Leg("stationary", duration_s=3.0),
    Leg("walking", distance_m=35.0),
    Leg("walking", distance_m=25.0, turn_rad=RIGHT),
    Leg("stationary", duration_s=4.0, carrying_mode="pocket"),
    Leg("walking", distance_m=35.0, turn_rad=RIGHT),
    Leg("walking", distance_m=15.0, turn_rad=RIGHT),
    Leg("stationary", duration_s=4.0, carrying_mode="texting"),
    Leg("walking", distance_m=20.0, turn_rad=-RIGHT),
    Leg("stationary", duration_s=4.0, carrying_mode="swinging"),
    Leg("walking", distance_m=30.0, turn_rad=-RIGHT),
]
# One for each carrying mode, with dashes of its own.
MODE_STYLES: tuple[dict[str, Any], ...] = (
    {"color": "#0072b2", "linestyle": "-"},
    {"color": "#777777", "linestyle": ":"},
    {"color": "#009e73", "linestyle": "--"},
    {"color": "#e69f00", "linestyle": "-"},
    {"color": "#cc79a7", "linestyle": "-."},
)


def errors_m(walk: pdr.Recording, track: pdr.Track) -> np.ndarray:
    """Distance to the truth after each step."""
    truth = walk.truth.position
    at = np.column_stack([np.interp(track.time_s, truth.time_s, truth[n]) for n in ("east_m", "north_m")])
    return np.linalg.norm(track.position_m - at, axis=1)


def both(walk: pdr.Recording) -> dict[str, pdr.Track]:
    """With the walking heading learnt, and with the device's direction."""
    config = pdr.recipes.for_recording("default", walk)
    deaf = replace(config, sensing=replace(config.sensing, heading=None))
    return {"walking heading learnt": pdr.track(walk, config), "device direction": pdr.track(walk, deaf)}


def draw(walk: pdr.Recording, tracks: dict[str, pdr.Track]) -> Figure:
    """The tracks in the plane, above the probabilities of the carrying modes over time."""
    figure = Figure(figsize=(7.0, 8.5), layout="constrained")
    FigureCanvasAgg(figure)
    plane, time = figure.subplots(2, 1, height_ratios=[2.2, 1.0])
    truth = walk.truth.position
    changes = [row for row in walk.truth.labels if row["context"] == "stationary" and row["start_s"] > 1.0]
    plane.plot(truth.east_m, truth.north_m, color="black", linestyle="--", linewidth=1.2, label="truth")
    for (name, track), color in zip(tracks.items(), ("#0072b2", "#d55e00"), strict=True):
        path = np.vstack([[0.0, 0.0], track.position_m])
        plane.plot(*path.T, color=color, linewidth=1.8, label=name)
    for change in changes:
        place = [np.interp(change["start_s"], truth.time_s, truth[n]) for n in ("east_m", "north_m")]
        plane.plot(*place, marker="o", color="black")
        # Left of and below the place, where no leg of this walk is.
        plane.annotate(change["carrying_mode"], place, (-7, -7), textcoords="offset points", ha="right", va="top")
    plane.set(xlabel="east (m)", ylabel="north (m)", aspect="equal", title="The phone changes its place three times")
    plane.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.02, 1.0))
    windows = tracks["walking heading learnt"].windows
    for i, (mode, style) in enumerate(zip(windows.carrying_modes, MODE_STYLES, strict=True)):
        if windows.carrying_prob[:, i].max() > 0.3:  # the equal shares of the first second are 0.25
            time.plot(windows.time_s, windows.carrying_prob[:, i], linewidth=1.8, label=mode, **style)
    for k, change in enumerate(changes):
        span = (change["start_s"], change["end_s"])
        time.axvspan(*span, color="#dddddd", linewidth=0, label="phone changes its place" if k == 0 else None)
    time.set(xlabel="time (s)", ylabel="probability of carrying mode", ylim=(-0.02, 1.02))
    time.legend(frameon=False, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), columnspacing=1.2)
    return figure


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images" / "carrying_change.svg")
    parser.add_argument("--walks", type=int, default=10)
    args = parser.parse_args()
    ends: dict[str, list[float]] = {}
    for seed in range(args.walks):
        walk = simulate(LEGS, seed=seed)
        for name, track in both(walk).items():
            ends.setdefault(name, []).append(float(errors_m(walk, track)[-1]))
    rows = [[name, len(found), median_and(found, 100, 1)] for name, found in ends.items()]
    Tables.of(__spec__.name, args).write(
        "carrying_change",
        ["heading", "walks", "error of the end m: median, largest"],
        rows,
        "Simulated walks of 160 m.",
    )

    walk = simulate(LEGS, seed=1)
    mpl.rcParams["svg.hashsalt"] = "pdr_filter"
    args.out.parent.mkdir(parents=True, exist_ok=True)
    draw(walk, both(walk)).savefig(args.out, metadata={"Date": None})
    print(f"figure in {args.out}")


if __name__ == "__main__":
    main()
