"""Figures of a walk: path with uncertainty, heights, step lengths, and context probabilities over time."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch, PathPatch
from matplotlib.path import Path as Rings
from matplotlib.patheffects import withStroke

from pdr_filter.apps.maps.floor_plan import FloorPlan, plan_of
from pdr_filter.apps.report import palette
from pdr_filter.apps.report.geometry import (
    MIN_EXTENT_M,
    band_margin_m,
    band_rings,
    band_rows,
    ellipse_axes,
    ellipse_extent,
    ellipse_rows,
    places_at,
    shown_context_prob,
    storeys_of,
    window_starts,
)
from pdr_filter.apps.report.palette import FAINT, INK, context_colours, floor_colours
from pdr_filter.apps.report.plot.figures import PLAIN_TEXT, add_grid, add_legend, given_or_new, new_figure, save
from pdr_filter.apps.report.plot.floor_plan_plots import draw_storey
from pdr_filter.tracking.trust_report import WITHOUT_STEPS, closure
from pdr_filter.values import FloatArray, TrackRows, how_many

_SIZE_IN = (8.0, 9.0)
_MAX_NOTES = 3
# A context that never reaches this probability is almost invisible in the chart, and is omitted from the legend.
_VISIBLE_PROB = 0.1
_PLACE_STYLE: dict[str, Any] = {"fill": False, "edgecolor": palette.WRONG, "linestyle": (0, (4, 2)), "zorder": 7}


def track(track: TrackRows, path: str | Path | None = None, reference_m: FloatArray | None = None) -> Figure:
    """Draw the path of a track with its 95 % uncertainty, and the context probabilities over time below.

    The path is coloured by context, or by storey if there are several storeys. A track that is not level also gets a
    height profile.

    Parameters
    ----------
    track : TrackRows
        Track to draw, such as a `Track`.
    path : str or Path, optional
        File to which the figure is saved. The suffix gives the format; missing folders are created.
    reference_m : ndarray of shape (N, 2), optional
        True path, east and north in m in the frame of the track. It is drawn without alignment.

    Returns
    -------
    matplotlib Figure
        Figure that belongs to no window and to no pyplot state, so that it need not be closed.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=10.0)])
    >>> track = pdr.track(walk)
    >>> figure = pdr.plot.track(track)
    >>> len(figure.axes)
    2
    """
    figure = new_figure(_SIZE_IN)
    if track.is_level:
        plane, time = figure.subplots(2, 1, height_ratios=[3.4, 1.0])
    else:
        plane, profile, time = figure.subplots(3, 1, height_ratios=[3.0, 1.0, 0.8])
        heights(track, profile)
        profile.sharex(time)
        profile.set_xlabel("")
        profile.tick_params(labelbottom=False)
    way(track, plane, reference_m)
    contexts(track, time)
    _write_title(plane, track)
    _write_notes(figure, track.notes)
    if path is not None:
        save(figure, path)
    return figure


def way(
    track: TrackRows,
    ax: Axes | None = None,
    reference_m: FloatArray | None = None,
    plan: FloorPlan | None = None,
) -> Axes:
    """Draw the path of a track with its 95 % uncertainty, east to the right and north up, in metres.

    The path is coloured by context, or by storey if there are several storeys. If the track may have ended at several
    positions of a floor plan, each is drawn with its probability. Anchors of ranges are drawn as triangles.

    Parameters
    ----------
    track : TrackRows
        Track to draw, such as a `Track`.
    ax : matplotlib Axes, optional
        Axes to draw into. By default a new figure is created.
    reference_m : ndarray of shape (N, 2), optional
        True path, east and north in m in the frame of the track. It is drawn without alignment.
    plan : FloorPlan, optional
        Floor plan below the path, in the frame of the track. The default is the plan of the track, if it has one.

    Returns
    -------
    matplotlib Axes
        `ax`, or the axes of the new figure (`ax.figure`).

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=10.0)])
    >>> track = pdr.track(walk)
    >>> ax = pdr.plot.way(track)
    >>> ax.get_xlabel(), ax.get_ylabel()
    ('east (m)', 'north (m)')
    """
    axes = given_or_new(ax, (5.6, 5.0))
    for storey in storeys_of(plan or plan_of(track), track.floor):
        draw_storey(axes, storey)
    way_m = np.vstack([track.start_position_m, track.position_m])
    if reference_m is not None:
        axes.plot(*reference_m.T, color=INK, linewidth=1.2, linestyle=(0, (2, 2)), zorder=2)
    if track.n_steps:
        _draw_ellipses(axes, track)
        _draw_places(axes, track)
        colours = floor_colours(track.floor)
        colour = [colours[floor] for floor in track.floor]
        if len(colours) == 1:
            of_context = context_colours(track.contexts)
            colour = [of_context[track.contexts[i]] for i in track.context_prob.argmax(axis=1)]
        parts = np.stack([way_m[:-1], way_m[1:]], axis=1)
        # a dark line below the coloured line keeps light colours visible on white
        axes.plot(*way_m.T, color=INK, linewidth=4.2, solid_capstyle="round", zorder=3)
        axes.add_collection(LineCollection(list(parts), colors=colour, linewidths=3.0, capstyle="round", zorder=4))
    else:
        axes.text(0.5, 0.75, "no steps", transform=axes.transAxes, ha="center", color=FAINT, fontsize=14)
    marker: dict[str, Any] = {"linestyle": "none", "markeredgecolor": INK, "markeredgewidth": 1.5, "zorder": 6}
    axes.plot(*way_m[0], marker="o", markersize=9, markerfacecolor="white", **marker)
    axes.plot(*way_m[-1], marker="s", markersize=7, markerfacecolor=INK, **marker)
    axes.plot(*track.anchors_m.T, marker="^", markersize=7, markerfacecolor="white", **marker)
    _frame_plane(axes, np.vstack([way_m, track.anchors_m, *([] if reference_m is None else [reference_m])]))
    add_legend(axes, _plane_legend(track, reference_m is not None))
    return axes


def heights(track: TrackRows, ax: Axes | None = None) -> Axes:
    """Draw the height above the start over time, with its 95 % interval. Steps are coloured by storey.

    Parameters
    ----------
    track : TrackRows
        Track to draw, such as a `Track`.
    ax : matplotlib Axes, optional
        Axes to draw into. By default a new figure with a legend of the storeys is created.

    Returns
    -------
    matplotlib Axes
        `ax`, or the axes of the new figure (`ax.figure`).

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=10.0)])
    >>> track = pdr.track(walk)
    >>> ax = pdr.plot.heights(track)
    >>> ax.get_ylabel()
    'height (m)'
    """
    axes = given_or_new(ax, (5.6, 2.4))
    unit_s, unit = _time_unit(track)
    at, half = track.time_s / unit_s, 1.96 * track.height_std_m
    colours = floor_colours(track.floor)
    axes.fill_between(at, track.height_m - half, track.height_m + half, color=palette.ELLIPSE, alpha=0.2, linewidth=0)
    axes.plot(at, track.height_m, color=FAINT, linewidth=0.8)
    axes.scatter(at, track.height_m, s=5, c=[colours[floor] for floor in track.floor], zorder=3)
    axes.set(xlabel=f"time ({unit})", ylabel="height (m)")
    add_grid(axes)
    if ax is None and len(colours) > 1:
        add_legend(axes, _floor_legend(colours))
    return axes


def step_lengths(track: TrackRows, ax: Axes | None = None) -> Axes:
    """Draw the step lengths by context, with the median and the quartiles of each context.

    Each dot is one step, drawn in the column of its most probable context.

    Parameters
    ----------
    track : TrackRows
        Track to draw, such as a `Track`.
    ax : matplotlib Axes, optional
        Axes to draw into. By default a new figure is created.

    Returns
    -------
    matplotlib Axes
        `ax`, or the axes of the new figure (`ax.figure`).

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=10.0)])
    >>> track = pdr.track(walk)
    >>> ax = pdr.plot.step_lengths(track)
    >>> ax.get_ylabel()
    'step length (m)'
    """
    axes = given_or_new(ax)
    colours, best = context_colours(track.contexts), track.context_prob.argmax(axis=1)
    occurring = np.unique(best)
    rng = np.random.default_rng(0)  # fixed seed, so that figures are reproducible
    for place, context in enumerate(occurring):
        length_m = track.step_length_m[best == context]
        low, median, high = np.quantile(length_m, [0.25, 0.5, 0.75])
        at = place + rng.uniform(-0.3, 0.3, len(length_m))
        axes.scatter(at, length_m, s=10, color=colours[track.contexts[context]], edgecolors=INK, linewidths=0.2)
        axes.hlines(median, place - 0.38, place + 0.38, color=INK, linewidth=1.8)
        axes.hlines([low, high], place - 0.38, place + 0.38, color=INK, linewidth=0.8, linestyle=(0, (4, 2)))
    names = [f"{track.contexts[c]}\n{how_many(int((best == c).sum()), 'step')}" for c in occurring]
    axes.set_xticks(range(len(occurring)), names)
    axes.set(xlim=(-0.6, max(len(occurring), 1) - 0.4), ylabel="step length (m)")
    axes.set_ylim(bottom=0.0)
    add_grid(axes)
    return axes


def contexts(track: TrackRows, ax: Axes | None = None) -> Axes:
    """Draw the context probabilities of the windows over time as a stacked area, with ticks at the steps.

    Parameters
    ----------
    track : TrackRows
        Track to draw, such as a `Track`.
    ax : matplotlib Axes, optional
        Axes to draw into. By default a new figure with a legend of the contexts is created.

    Returns
    -------
    matplotlib Axes
        `ax`, or the axes of the new figure (`ax.figure`).

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=10.0)])
    >>> track = pdr.track(walk)
    >>> ax = pdr.plot.contexts(track)
    >>> ax.get_xlabel()
    'time (s); ticks on top are steps'
    """
    axes = given_or_new(ax, (5.6, 2.0))
    windows = track.windows
    unit_s, unit = _time_unit(track)
    if len(windows):
        edge_s, prob = _step_curve(track)
        upper = np.cumsum(prob, axis=1)
        lower = upper - prob
        for i, colour in enumerate([*context_colours(windows.contexts).values(), palette.WITHOUT_STEPS]):
            axes.fill_between(edge_s / unit_s, lower[:, i], upper[:, i], color=colour, linewidth=0)
    else:
        axes.text(0.5, 0.5, "no context windows", transform=axes.transAxes, ha="center", va="center", color=FAINT)
    # thousands of thin ticks form a grey band, in which pauses are still visible
    width = float(np.clip(150.0 / max(track.n_steps, 1), 0.1, 0.8))
    axes.vlines(track.time_s / unit_s, 1.04, 1.14, color=INK, linewidth=width, snap=False)
    end_s = max([track.start_time_s + track.duration_s, *track.time_s[-1:], *windows.time_s[-1:]])
    axes.set_xlim(track.start_time_s / unit_s, max(end_s, track.start_time_s + 1.0) / unit_s)
    axes.set(ylim=(0.0, 1.18), yticks=[0.0, 0.5, 1.0], ylabel="context\nprobability")
    axes.set_xlabel(f"time ({unit}); ticks on top are steps")
    if ax is None and len(windows):
        add_legend(axes, _context_legend(track))
    return axes


def _time_unit(track: TrackRows) -> tuple[float, str]:
    return (60.0, "min") if track.duration_s > 600 else (1.0, "s")


def _step_curve(track: TrackRows) -> tuple[FloatArray, FloatArray]:
    """Return times and probabilities of a piecewise constant curve. Rows of NaN mark missing windows."""
    starts_s, previous_s = window_starts(track.windows, track.start_time_s)
    time_s = np.stack([starts_s, track.windows.time_s], axis=1).ravel()
    prob = np.repeat(shown_context_prob(track), 2, axis=0)
    breaks = 2 * np.flatnonzero(starts_s > previous_s + 0.01)
    return np.insert(time_s, breaks, starts_s[breaks // 2]), np.insert(prob, breaks, np.nan, axis=0)


def _draw_ellipses(axes: Axes, track: TrackRows) -> None:
    """Draw the band of the 95 % ellipses along the track, and those at fixes and at the end."""
    band = band_rows(track.position_m, ellipse_axes(track.position_cov_m2)[0][:, 0])
    # one path, so that places in several ellipses have the same colour as others
    rings = Rings.make_compound_path(*map(Rings, band_rings(track.position_m[band], track.position_cov_m2[band])))
    # not as a patch: matplotlib would take its limits from up to 16,000 sides, a fourth of the time of a picture
    axes.add_artist(PathPatch(rings, facecolor=(palette.ELLIPSE, palette.BAND_ALPHA), linewidth=0, zorder=1))
    rows = ellipse_rows(track)
    half_m, angle_rad = ellipse_axes(track.position_cov_m2[rows])
    axes.add_collection(
        EllipseCollection(
            2 * half_m[:, 1],
            2 * half_m[:, 0],
            np.degrees(angle_rad),
            units="xy",
            offsets=track.position_m[rows],
            offset_transform=axes.transData,
            facecolors="none",
            edgecolors=(palette.ELLIPSE, palette.ELLIPSE_EDGE_ALPHA),
            linewidths=0.8,
            zorder=1,
        )
    )
    # matplotlib ignores both when it sets the limits of axes, so the bounding boxes of all ellipses are added
    reach_m = np.minimum(ellipse_extent(track.position_cov_m2[band]), band_margin_m(track))
    axes.update_datalim(np.vstack([track.position_m[band] - reach_m, track.position_m[band] + reach_m]))


def _draw_places(axes: Axes, track: TrackRows) -> None:
    """Draw the possible end positions on a floor plan, with 95 % ellipses and probabilities, if there are several."""
    for place in places_at(track, -1):
        ((minor_m, major_m),), (angle_rad,) = ellipse_axes(place.position_cov_m2[np.newaxis])
        ellipse = Ellipse((0, 0), 2 * major_m, 2 * minor_m, angle=np.degrees(angle_rad), **_PLACE_STYLE)
        ellipse.set_center(tuple(place.position_m))
        axes.add_patch(ellipse)
        words = axes.annotate(
            f"{100 * place.share:.0f} %",
            tuple(place.position_m),
            (0.0, -14.0),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=9,
            color=palette.WRONG,
            zorder=8,
        )
        words.set_path_effects([withStroke(linewidth=3.0, foreground="white")])
        reach_m = ellipse_extent(place.position_cov_m2[np.newaxis])
        axes.update_datalim(np.vstack([place.position_m - reach_m, place.position_m + reach_m]))


def _frame_plane(axes: Axes, points_m: FloatArray) -> None:
    centre_m = 0.5 * (points_m.min(axis=0) + points_m.max(axis=0))
    axes.update_datalim([centre_m - MIN_EXTENT_M / 2, centre_m + MIN_EXTENT_M / 2])
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.05)
    axes.autoscale_view()
    axes.set(xlabel="east (m)", ylabel="north (m)")
    add_grid(axes)


def _floor_legend(colours: dict[int, str]) -> list[Line2D]:
    return [Line2D([], [], color=c, linewidth=3.0, label=f"floor {f}") for f, c in reversed(colours.items())]


def _context_legend(track: TrackRows) -> list[Patch]:
    names = (*track.contexts, WITHOUT_STEPS)
    visible = shown_context_prob(track).max(axis=0, initial=0.0) >= _VISIBLE_PROB
    occurring = {names[i] for i in (*np.flatnonzero(visible), *track.context_prob.argmax(axis=1))}
    return [
        Patch(facecolor=colour, edgecolor=INK, linewidth=0.5, label=name)
        for name, colour in {**context_colours(track.contexts), WITHOUT_STEPS: palette.WITHOUT_STEPS}.items()
        if name in occurring
    ]


def _plane_legend(track: TrackRows, has_reference: bool) -> list[Line2D | Patch]:
    floors = floor_colours(track.floor)
    handles: list[Line2D | Patch] = [*(_floor_legend(floors) if len(floors) > 1 else []), *_context_legend(track)]
    ends: dict[str, Any] = {"linestyle": "none", "markeredgecolor": INK, "markersize": 7}
    handles.append(Line2D([], [], marker="o", markerfacecolor="white", label="start", **ends))
    handles.append(Line2D([], [], marker="s", markerfacecolor=INK, label="end", **ends))
    if len(track.anchors_m):
        handles.append(Line2D([], [], marker="^", markerfacecolor="white", label="anchor of ranges", **ends))
    if track.n_steps:
        reach_m = ellipse_extent(track.position_cov_m2)
        larger = f" (±{reach_m.max():.0f} m, cut off)" if (reach_m > band_margin_m(track)).any() else ""
        handles.append(Patch(facecolor=(palette.ELLIPSE, palette.BAND_ALPHA), label=f"95 % uncertainty{larger}"))
    if track.n_steps and places_at(track, -1):
        handles.append(Patch(**_PLACE_STYLE, label="possible end"))
    if has_reference:
        handles.append(Line2D([], [], color=INK, linewidth=1.2, linestyle=(0, (2, 2)), label="truth"))
    return handles


def _write_title(axes: Axes, track: TrackRows) -> None:
    minutes, seconds = divmod(round(track.duration_s), 60)
    duration = f"{minutes} min {seconds} s" if minutes else f"{track.duration_s:.1f} s"
    steps = how_many(track.n_steps, "step")
    facts = f"{track.how_far}  ·  {duration}  ·  {steps}"
    if track.n_steps:
        facts += f"  ·  end {closure(track)}"
    axes.set_title(facts, loc="left", fontsize=11.5, color=INK, pad=10)
    name = textwrap.shorten(track.name, 60, placeholder="...")
    above: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points"}
    axes.annotate(name, (0.0, 1.0), (0.0, 32.0), **above, **PLAIN_TEXT, fontsize=15, fontweight="bold", color=INK)


def _write_notes(figure: Figure, notes: tuple[str, ...]) -> None:
    if not notes:
        return
    shown = [f"Note: {note}" for note in notes[:_MAX_NOTES]]
    if len(notes) > _MAX_NOTES:
        shown.append(f"and {len(notes) - _MAX_NOTES} more notes")
    text = "\n".join(textwrap.fill(note, 110) for note in shown).replace("`", "")
    figure.supxlabel(text, x=0.02, ha="left", fontsize=9, color=FAINT, **PLAIN_TEXT)
