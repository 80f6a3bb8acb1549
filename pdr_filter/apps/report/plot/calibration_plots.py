"""Figures of a calibration: errors of the segments, and step lengths of the persons."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pdr_filter.apps.report.palette import BLUE, INK, WRONG, context_colours
from pdr_filter.apps.report.plot.figures import PLAIN_TEXT, given_or_new, new_figure, save
from pdr_filter.values import CONTEXTS, Table

_MAX_POINTS, _MAX_PEOPLE = 5000, 60


def calibration(
    segments: Table,
    context: str,
    people_m: Mapping[str, tuple[float, float]],
    population_m: tuple[float, float],
    path: str | Path | None = None,
) -> Figure:
    """Draw a calibration: segment errors (`residuals`) on the left, step lengths (`people`) on the right.

    `Calibration.plot` draws this figure for a calibration.

    Parameters
    ----------
    segments : Table
        Segments of a calibration (`Calibration.segments`), with columns `context`, `distance_m` (known length),
        `left_out_m` (length predicted without this segment) and `distrusted` (rejected as an outlier).
    context : str
        Name of the context, such as "walking", for the axis label.
    people_m : mapping of str to (float, float)
        For each person the length of a typical step in m and its standard deviation. At most 60 persons are drawn.
    population_m : (float, float)
        Mean over all persons in m, and the standard deviation between persons, NaN if unknown.
    path : str or Path, optional
        File to which the figure is saved. The suffix gives the format; missing folders are created.

    Returns
    -------
    matplotlib Figure
        Figure that belongs to no window and to no pyplot state, so that it need not be closed.

    Examples
    --------
    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> from pdr_filter.values.arrays import table
    >>> segments = table({"context": np.array(["walking", "walking"]), "distance_m": np.array([50.0, 80.0]),
    ...                   "left_out_m": np.array([51.0, 79.0]), "distrusted": np.array([False, False])})
    >>> figure = pdr.plot.calibration(segments, "walking", {"anna": (0.72, 0.01)}, (0.70, 0.05))
    >>> len(figure.axes)
    2
    """
    figure = new_figure((10.0, 4.8))
    left, right = figure.subplots(1, 2)
    residuals(segments, left)
    people(context, people_m, population_m, right)
    if path is not None:
        save(figure, path)
    return figure


def residuals(segments: Table, ax: Axes | None = None) -> Axes:
    """Draw the held-out errors of calibration segments against their known lengths.

    The error of a segment, in per cent, is the error of the length predicted by a calibration without this segment. Of
    more than 5000 segments, 5000 evenly spaced ones are drawn.

    Parameters
    ----------
    segments : Table
        Segments of a calibration (`Calibration.segments`), with columns `context`, `distance_m` (known length),
        `left_out_m` (length predicted without this segment) and `distrusted` (rejected as an outlier).
    ax : matplotlib Axes, optional
        Axes to draw into. By default a new figure is created.

    Returns
    -------
    matplotlib Axes
        `ax`, or the axes of the new figure (`ax.figure`).

    Examples
    --------
    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> from pdr_filter.values.arrays import table
    >>> segments = table({"context": np.array(["walking", "walking"]), "distance_m": np.array([50.0, 80.0]),
    ...                   "left_out_m": np.array([51.0, 79.0]), "distrusted": np.array([False, False])})
    >>> ax = pdr.plot.residuals(segments)
    >>> ax.get_xlabel()
    'known length (m)'
    """
    axes = given_or_new(ax)
    rows: Any = segments
    if len(rows) > _MAX_POINTS:
        rows = rows[np.linspace(0, len(rows) - 1, _MAX_POINTS).astype(int)]
    error = 100 * (rows.left_out_m / rows.distance_m - 1)
    names = tuple(map(str, dict.fromkeys(rows.context)))
    colours = context_colours(CONTEXTS if set(names) <= set(CONTEXTS) else names)
    style: dict[str, Any] = {"s": 16, "linewidths": 0.4, "edgecolors": INK}
    for name in names:
        own = (rows.context == name) & ~rows.distrusted
        axes.scatter(rows.distance_m[own], error[own], color=colours[name], label=name, **style)
    if rows.distrusted.any():
        x, y = rows.distance_m[rows.distrusted], error[rows.distrusted]
        axes.scatter(x, y, marker="x", color=WRONG, s=30, label="distrusted")
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set(xlabel="known length (m)", ylabel="error of the held-out segment (%)")
    axes.legend(frameon=False)
    return axes


def people(
    context: str,
    people_m: Mapping[str, tuple[float, float]],
    population_m: tuple[float, float],
    ax: Axes | None = None,
) -> Axes:
    """Draw the typical step length of each person with its 95 % interval, and the distribution over persons.

    Parameters
    ----------
    context : str
        Name of the context, such as "walking", for the axis label.
    people_m : mapping of str to (float, float)
        For each person the length of a typical step in m and its standard deviation. At most 60 persons are drawn.
    population_m : (float, float)
        Mean over all persons in m, and the standard deviation between persons, NaN if unknown.
    ax : matplotlib Axes, optional
        Axes to draw into. By default a new figure is created.

    Returns
    -------
    matplotlib Axes
        `ax`, or the axes of the new figure (`ax.figure`).

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> ax = pdr.plot.people("walking", {"anna": (0.72, 0.01), "ben": (0.69, 0.02)}, (0.70, 0.05))
    >>> [label.get_text() for label in ax.get_yticklabels()]
    ['anna', 'ben']
    """
    shown = dict(list(people_m.items())[:_MAX_PEOPLE])
    axes = given_or_new(ax, (5.6, max(3.6, 1.0 + 0.14 * len(shown))))
    centre_m, between_m = population_m
    length_m, std_m = np.array(list(shown.values())).reshape(-1, 2).T
    number = np.arange(len(shown))
    interval: dict[str, Any] = {"fmt": "o", "color": BLUE, "markersize": 4, "linewidth": 1}
    axes.errorbar(length_m, number, xerr=1.96 * std_m, label="person, 95 % interval", **interval)
    if between_m > 0:
        band = (centre_m - 1.96 * between_m, centre_m + 1.96 * between_m)
        axes.axvspan(*band, color=BLUE, alpha=0.1, linewidth=0, label="95 % of all persons")
    axes.axvline(centre_m, color=INK, linewidth=0.8, label="population")
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=9, columnspacing=1.0)
    names = [n if len(n) <= 22 else f"{n[:9]}...{n[-10:]}" for n in shown]
    axes.set_yticks(number, names, fontsize=8 if ax is None or len(names) < 25 else 5, **PLAIN_TEXT)
    axes.set(xlabel=f"length of a typical step, {context} (m)", ylim=(max(len(names), 1) - 0.5, -0.5))
    return axes
