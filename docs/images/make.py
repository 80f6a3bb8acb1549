"""The pictures of the documentation that are not figures of a benchmark: the data flow, tracks, and the gallery.

usage: .venv/bin/python -m docs.images.make [NAME...]
NAME is data_flow, carrying_change, demo_track, online_or_smoothed, real_track or gallery; all without NAME.

The gallery is the code of docs/gallery.md, run in this folder.

SVG files have the same bytes for the same tracks. The picture of the README, real_track, is a PNG file, because not all
sites display SVG. It needs the real recordings (`tests/data_folder.py`) and is not changed without them.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

import pdr_filter as pdr
from pdr_filter.apps.report.palette import BLUE, FAINT, INK, ORANGE
from tests.data_folder import DATA

HERE = Path(__file__).resolve().parent
REAL_WALK = DATA / "humolire" / "humolire_user1_forward.zip"
REAL_PLAN = DATA / "maps" / "humolire.geojson"

# Online and offline parts have different borders as well, for readers who do not see the colours.
ONLINE: dict[str, object] = {"facecolor": "#DCEBF5", "edgecolor": BLUE, "linestyle": "-"}
OFFLINE: dict[str, object] = {"facecolor": "#FBEBDD", "edgecolor": ORANGE, "linestyle": (0, (4, 2))}
OUTSIDE: dict[str, object] = {"facecolor": "#FFFFFF", "edgecolor": FAINT, "linestyle": "-"}

# name: centre, half width and half height in the units of the figure, title, package, style
BOXES: dict[str, tuple[float, float, float, float, str, str, dict[str, object]]] = {
    "file": (3.4, 10.0, 1.35, 0.42, "file or folder", "data.io", OUTSIDE),
    "app": (7.0, 10.0, 1.35, 0.42, "app", "tracking.online", OUTSIDE),
    "uniform": (5.2, 8.4, 1.35, 0.42, "uniform samples", "sensing.conditioning", ONLINE),
    "attitude": (1.75, 6.8, 1.35, 0.42, "attitude", "sensing.attitude,\ngyroscope_bias", ONLINE),
    "contexts": (5.2, 6.8, 1.25, 0.48, "contexts", "sensing.features, contexts\nclassifiers, recipes", ONLINE),
    "steps": (8.7, 6.8, 1.25, 0.42, "steps, gate", "sensing.steps, recipes", ONLINE),
    "heading": (5.2, 5.2, 1.45, 0.42, "walking heading", "sensing.heading, recipes", ONLINE),
    "climb": (1.55, 3.35, 1.3, 0.42, "climb rate", "sensing.features", ONLINE),
    "filter": (5.2, 3.35, 1.35, 0.6, "filter", "filter.chain: tracker,\npath, height, plan", ONLINE),
    "fixes": (8.9, 3.35, 1.2, 0.42, "fixes", "values.fixes", OUTSIDE),
    "calibrate": (1.55, 1.6, 1.3, 0.42, "calibrate", "offline.calibration", OFFLINE),
    "track": (5.2, 1.6, 1.4, 0.42, "Track", "tracking", OUTSIDE),
    "smooth": (8.9, 1.6, 1.3, 0.42, "smooth", "offline.smoothing", OFFLINE),
    "results": (5.2, 0.25, 1.4, 0.42, "results", "evaluate, apps.report", OFFLINE),
}
# from, its side, to, its side, data, offset of the label from the middle of the arrow
ARROWS: list[tuple[str, str, str, str, str, tuple[float, float]]] = [
    ("file", "s", "uniform", "nw", "Recording", (-0.95, 0.2)),
    ("app", "s", "uniform", "ne", "blocks of any length", (1.5, 0.2)),
    ("uniform", "sw", "attitude", "n", "", (0.0, 0.0)),
    ("uniform", "s", "contexts", "n", "100 Hz", (0.45, 0.05)),
    ("uniform", "se", "steps", "n", "", (0.0, 0.0)),
    ("attitude", "e", "contexts", "w", "up", (0.0, 0.16)),
    ("contexts", "e", "steps", "w", "carrying\nmode", (0.0, 0.28)),
    ("attitude", "s", "heading", "nw", "device heading", (-0.95, -0.1)),
    ("contexts", "s", "heading", "n", "carrying mode", (0.85, 0.1)),
    ("steps", "s", "heading", "ne", "contact times", (0.95, -0.1)),
    ("heading", "s", "filter", "n", "Step, WindowContext", (1.2, -0.22)),
    ("climb", "e", "filter", "w", "stairs\nor not", (0.0, 0.28)),
    ("fixes", "w", "filter", "e", "with\ncovariance", (0.0, 0.28)),
    ("filter", "s", "track", "n", "StepUpdate", (0.7, 0.0)),
    ("calibrate", "ne", "filter", "sw", "k, with\ncovariance", (-0.65, 0.15)),
    ("track", "w", "calibrate", "e", "known\ndistances", (0.0, -0.28)),
    ("track", "e", "smooth", "w", "whole\nwalk", (0.0, -0.28)),
    ("fixes", "s", "smooth", "n", "", (0.0, 0.0)),
    ("track", "s", "results", "n", "", (0.0, 0.0)),
]


def data_flow() -> Figure:
    """Return the data flow from samples to a track: stages as boxes, data on the arrows."""
    figure = Figure(figsize=(7.2, 7.45))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, 10.4), ylim=(-0.25, 10.51), aspect="equal")
    axes.axis("off")
    axes.add_patch(
        FancyBboxPatch(
            (0.15, 4.5), 10.1, 4.6, "round,pad=0,rounding_size=0.15", facecolor="#F6F8FA", edgecolor="#BBBBBB"
        )
    )
    axes.text(0.35, 8.75, "sensing.front_end", color=FAINT, fontsize=10, style="italic")
    for x, y, half_width, half_height, title, module, style in BOXES.values():
        corner = (x - half_width, y - half_height)
        shape = "round,pad=0,rounding_size=0.1"
        axes.add_patch(FancyBboxPatch(corner, 2 * half_width, 2 * half_height, shape, linewidth=1.3, **style))
        lift = 0.1 + 0.09 * module.count("\n")
        axes.text(x, y + lift, title, ha="center", va="center", fontsize=9.5, fontweight="bold", color=INK)
        axes.text(x, y - 0.6 * lift - 0.08, module, ha="center", va="center", fontsize=7.5, color=INK, linespacing=1.1)
    for start, leaves, end, enters, words, (dx, dy) in ARROWS:
        a, b = _edge(start, leaves), _edge(end, enters)
        line = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", b, a, arrowprops=line)
        x, y = (a + b) / 2 + (dx, dy)
        axes.text(x, y, words, ha="center", va="center", fontsize=7.5, color=FAINT, linespacing=1.1)
    for k, (name, style) in enumerate((("online", ONLINE), ("offline", OFFLINE))):
        y = 10.2 - 0.4 * k
        axes.add_patch(FancyBboxPatch((8.75, y), 0.35, 0.2, "round,pad=0,rounding_size=0.05", linewidth=1.1, **style))
        axes.text(9.2, y + 0.1, name, va="center", fontsize=8, color=INK)
    return figure


def _edge(name: str, side: str) -> np.ndarray:
    """Return a point on the border of a box: the middle of a side, or near a corner."""
    x, y, half_width, half_height, *_ = BOXES[name]
    east = ("e" in side) - ("w" in side)
    north = ("n" in side) - ("s" in side)
    if len(side) == 2:  # on the vertical side, half way to the corner
        return np.array([x + east * half_width, y + 0.55 * north * half_height])
    return np.array([x + east * half_width, y + north * half_height])


def demo_track() -> Figure:
    """Return a figure of the walk of `pdr-filter demo` with its truth."""
    walk = pdr.simulate.demo_walk()
    truth = walk.truth.position
    return pdr.plot.track(pdr.track(walk), None, np.column_stack([truth.east_m, truth.north_m]))


def real_track() -> Figure | None:
    """Return a figure of a real walk on the plan of its building, or None without recording and plan.

    The first two surveyed points place the walk on the plan, and it ended where it began. The rest is dead reckoning,
    and the other points show its errors.
    """
    if not (REAL_WALK.exists() and REAL_PLAN.exists()):
        return None
    walk, plan = pdr.read(REAL_WALK), pdr.FloorPlan.read(REAL_PLAN)
    time_s = walk.truth.waypoints.time_s
    surveyed_m = np.column_stack([walk.truth.waypoints.east_m, walk.truth.waypoints.north_m])
    given = [pdr.PositionFix(time_s[i], surveyed_m[i], 0.5**2 * np.eye(2)) for i in (0, 1)]
    track = pdr.smooth(walk, pdr.recipes.default().in_world_frame(), fixes=given, loop=True).track
    tracked_m = np.column_stack([np.interp(time_s, track.time_s, column) for column in track.position_m.T])
    error_m = np.linalg.norm(tracked_m - surveyed_m, axis=1)[2:]
    figure = Figure(figsize=(8.0, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = pdr.plot.way(track, figure.add_subplot(), plan=plan)
    drawn = axes.get_legend()
    (points,) = axes.plot(*surveyed_m[2:].T, "x", color=ORANGE, markeredgewidth=2, zorder=9)
    handles = [*(drawn.legend_handles if drawn else []), points]
    texts = [text.get_text() for text in (drawn.get_texts() if drawn else [])]
    # the axes below show the whole band
    labels = [*(text.partition(" (±")[0] for text in texts), "surveyed, not used"]
    axes.legend(handles, labels, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=5)
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlim=(-4.0, 80.0), ylim=(-8.0, 46.0))
    error = f"mean error at {len(error_m)} surveyed points {error_m.mean():.1f} m"
    axes.set_title(f"{track.distance_m:.0f} m in a building, {track.n_steps} steps; {error}", fontsize=10)
    return figure


def online_or_smoothed() -> Figure:
    """Return a figure of a simulated walk four times round a block: locations, online and smoothed track, truth."""
    sides_m, corner = (45.0, 30.0) * 8, np.pi / 2
    legs = [pdr.simulate.Leg("walking", distance_m=d, turn_rad=corner * (k > 0)) for k, d in enumerate(sides_m)]
    walk = pdr.simulate.simulate(legs, seed=5, name="block")
    truth, here = walk.truth.position, pdr.Origin(48.137, 11.575)
    time_s = np.arange(1.0, walk.duration_s)
    true_m = np.column_stack([truth.east_m, truth.north_m])
    place_m = np.column_stack([np.interp(time_s, truth.time_s, column) for column in true_m.T])
    rng, alike = np.random.default_rng(4), np.exp(-1.0 / 20.0)
    error_m = rng.normal(scale=6.0, size=place_m.shape)
    for k in range(1, len(time_s)):
        error_m[k] = alike * error_m[k - 1] + np.sqrt(1.0 - alike**2) * error_m[k]
    degrees = here.latitude_longitude_deg(place_m + error_m)
    location = pdr.Samples(time_s, np.column_stack([*degrees, np.full((len(time_s), 2), [np.nan, 9.1])]))
    walk = replace(walk, location=location)
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.plot(*(place_m + error_m)[::10].T, "o", color=FAINT, markersize=3, label="locations")
    axes.plot(*true_m.T, color=INK, linewidth=1.0, label="truth")
    for track, colour in ((pdr.track(walk), ORANGE), (pdr.smooth(walk).track, BLUE)):
        way_m = here.east_north_m(track.latitude_deg, track.longitude_deg)
        axes.plot(*way_m.T, color=colour, linewidth=1.6, label=track.estimate)
    axes.set(xlabel="east (m)", ylabel="north (m)", aspect="equal")
    axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def carrying_change() -> Figure:
    """Return a figure of a walk in which the phone goes from the hand to a pocket, back, and into the swinging hand."""
    right = np.pi / 2
    change = {"context": "stationary", "duration_s": 4.0}
    legs = [
        {"context": "stationary", "duration_s": 3.0},
        {"context": "walking", "distance_m": 35.0},
        {"context": "walking", "distance_m": 25.0, "turn_rad": right},
        {**change, "carrying_mode": "pocket"},
        {"context": "walking", "distance_m": 35.0, "turn_rad": right},
        {"context": "walking", "distance_m": 15.0, "turn_rad": right},
        {**change, "carrying_mode": "texting"},
        {"context": "walking", "distance_m": 20.0, "turn_rad": -right},
        {**change, "carrying_mode": "swinging"},
        {"context": "walking", "distance_m": 30.0, "turn_rad": -right},
    ]
    walk = pdr.simulate.simulate([pdr.simulate.Leg(**leg) for leg in legs], seed=1)
    truth = walk.truth.position
    axes = pdr.plot.way(pdr.track(walk), reference_m=np.column_stack([truth.east_m, truth.north_m]))
    assert isinstance(axes.figure, Figure)
    return axes.figure


PICTURES: dict[str, Callable[[], Figure | None]] = {
    "data_flow.svg": data_flow,
    "carrying_change.svg": carrying_change,
    "demo_track.svg": demo_track,
    "online_or_smoothed.svg": online_or_smoothed,
    "real_track.png": real_track,
}


def gallery() -> None:
    """Run each example of docs/gallery.md, which stores its picture in the working directory."""
    os.chdir(HERE)
    page = (HERE.parent / "gallery.md").read_text("utf-8")
    for code in re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL):
        exec(compile(code, "docs/gallery.md", "exec"), {})
    for plan in HERE.glob("*.geojson"):
        plan.unlink()


def main() -> None:
    mpl.rcParams["svg.hashsalt"] = "pdr_filter"
    wanted = sys.argv[1:]
    for name, draw in PICTURES.items():
        if wanted and name.split(".")[0] not in wanted:
            continue
        figure = draw()
        if figure is None:
            print(f"{name} is not changed: there is no {REAL_WALK}")
        else:
            figure.savefig(HERE / name, dpi=120, metadata={"Date": None} if name.endswith("svg") else None)
            print(f"{HERE / name} written")
    if not wanted or "gallery" in wanted:
        gallery()


if __name__ == "__main__":
    main()
