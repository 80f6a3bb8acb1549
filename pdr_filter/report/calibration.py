"""The figure of a calibration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pdr_filter.report.palette import BLUE, INK, WRONG, context_colours
from pdr_filter.report.plotting import save
from pdr_filter.values import Table

_MAX_POINTS, _MAX_PEOPLE = 5000, 60


def plot_calibration(
    segments: Table,
    context: str,
    people_m: Mapping[str, tuple[float, float]],
    population_m: tuple[float, float],
    path: str | Path | None = None,
) -> Figure:
    """Errors of segments (each left out) over their known lengths, and the people with 95 % intervals.

    `segments` are those of `Calibration`; `people_m` has the length of a typical step of each person in the context and
    its standard deviation, `population_m` the mean of all people and their spread, NaN for none. Saved if a path is
    given.
    """
    figure = Figure(figsize=(10.0, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    _draw_segments(left, segments)
    _draw_people(right, context, dict(list(people_m.items())[:_MAX_PEOPLE]), *population_m)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    if path is not None:
        save(figure, path)
    return figure


def _draw_segments(axes: Axes, rows: Any) -> None:
    if len(rows) > _MAX_POINTS:
        rows = rows[np.linspace(0, len(rows) - 1, _MAX_POINTS).astype(int)]
    error = 100 * (rows.left_out_m / rows.distance_m - 1)
    colours = context_colours()
    style: dict[str, Any] = {"s": 16, "linewidths": 0.4, "edgecolors": INK}
    for name in dict.fromkeys(rows.context):
        own = (rows.context == name) & ~rows.distrusted
        axes.scatter(rows.distance_m[own], error[own], color=colours[str(name)], label=str(name), **style)
    if rows.distrusted.any():
        x, y = rows.distance_m[rows.distrusted], error[rows.distrusted]
        axes.scatter(x, y, marker="x", color=WRONG, s=30, label="distrusted")
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set(xlabel="known length (m)", ylabel="error with this segment left out (%)")
    axes.legend(frameon=False)


def _draw_people(
    axes: Axes, context: str, people_m: dict[str, tuple[float, float]], centre_m: float, between_m: float
) -> None:
    length_m, std_m = np.array(list(people_m.values())).reshape(-1, 2).T
    number = np.arange(len(people_m))
    interval: dict[str, Any] = {"fmt": "o", "color": BLUE, "markersize": 4, "linewidth": 1}
    axes.errorbar(length_m, number, xerr=1.96 * std_m, label="person, 95 % interval", **interval)
    if between_m > 0:
        band = (centre_m - 1.96 * between_m, centre_m + 1.96 * between_m)
        axes.axvspan(*band, color=BLUE, alpha=0.1, linewidth=0, label="95 % of all people")
    axes.axvline(centre_m, color=INK, linewidth=0.8, label="population")
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=9, columnspacing=1.0)
    names = [n if len(n) <= 22 else f"{n[:9]}...{n[-10:]}" for n in people_m]
    axes.set_yticks(number, names, fontsize=8 if len(names) < 25 else 5)
    axes.set(xlabel=f"length of a typical step, {context} (m)", ylim=(len(names) - 0.5, -0.5))
