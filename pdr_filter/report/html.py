"""A track on one HTML page that needs nothing else: no network, no scripts, no fonts, no other files.

All pictures are SVG in the page, drawn here with plain strings. The page is well-formed XML, and its content security
policy forbids browsers to load anything.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from pdr_filter.io.describe import ReadingReport, reading_report
from pdr_filter.io.files import write_text
from pdr_filter.io.recording import Recording
from pdr_filter.maps.floor_plan import FloorPlan
from pdr_filter.report import palette, svg, trust
from pdr_filter.report.geometry import MIN_EXTENT_M, ellipse_axes, ellipse_extent, ellipse_rows, window_starts
from pdr_filter.report.svg import Axis, across, line, picture, pixel, points, polyline, text, titled, upward
from pdr_filter.values import BoolArray, FloatArray, IntArray, TrackRows

# Half width of the 95 % interval in standard deviations.
_INTERVAL_95 = 1.96
# Numbers of five digits have no room.
_KM_ABOVE_M = 5000.0
# More columns than this in a picture over time are finer than a screen, and pages of long recordings would be slow.
_MAX_COLUMNS = 900
_MAX_POINTS = 20_000
_BIN_M = 0.05
# Less of a context is a hair line.
_VISIBLE_PROB = 0.01
# Nobody walks round the Earth: what is further away is nonsense that would make a dot of all else.
_FARTHEST_M = 4e7
# Steps further apart than this belong to different bouts: the speed between them is not known.
_BOUT_PAUSE_S = 2.5

_STYLE = (
    f"""
:root {{ color-scheme: light; --ink: {palette.INK}; --doubt: {palette.ORANGE}; --sure: {palette.GREEN}; }}"""
    + """
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: #fff; margin: 0 auto; max-width: 960px;
  padding: 1.5em; }
h1 { font-size: 1.6em; margin: 0; overflow-wrap: anywhere; }
h2 { font-size: 1.1em; margin: 2em 0 0.5em; border-bottom: 1px solid #ddd; }
p.facts { color: #555; margin: 0.2em 0 0; }
ul { margin: 0.4em 0; padding-left: 1.3em; } li { overflow-wrap: anywhere; }
section.doubt { background: #fff6e5; border-left: 4px solid var(--doubt); padding: 0.5em 1em; margin-top: 1em; }
section.doubt h2, section.sure h2 { margin-top: 0; border: none; }
section.sure { background: #eef7f4; border-left: 4px solid var(--sure); padding: 0.5em 1em; margin-top: 1em; }
table { border-collapse: collapse; margin: 0.5em 0; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 0.15em 0.8em; border-bottom: 1px solid #eee; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
td.odd { color: #b33; font-weight: bold; }
.table { overflow-x: auto; }
svg { width: 100%; height: auto; display: block; }
svg text { font: 12px system-ui, sans-serif; fill: #555; }
.legend { display: flex; flex-wrap: wrap; gap: 0.2em 1.2em; list-style: none; padding: 0; color: #555;
  font-size: 13px; }
.key { display: inline-block; width: 1em; height: 1em; border: 1px solid #888; vertical-align: -0.1em;
  margin-right: 0.4em; }
footer { color: #888; font-size: 12px; margin-top: 2.5em; }
@media print { body { padding: 0; } section, svg { break-inside: avoid; } }
@media screen and (max-width: 600px) {
  body { padding: 1em; }
  svg text { font-size: 22px; }
}
"""
)


def write_report(track: TrackRows, path: str | Path, recording: Recording | None = None) -> Path:
    """Write the page of `html_report` and return its path; folders are created."""
    return write_text(path, html_report(track, recording))


def html_report(track: TrackRows, recording: Recording | None = None) -> str:
    """The page: way with 95 % ellipses, where not to trust it, contexts, speed, step lengths, how it was read.

    The last part needs the recording that the track was made from.
    """
    doubts = [*trust.doubts(track), *(_sentence(note) for note in track.notes)]
    name = text(track.name or "track")
    parts = [
        f"<header><h1><bdi>{name}</bdi></h1><p class='facts'>{text(_facts(track))}</p></header>",
        _doubt_section(doubts),
        _section("Way", _map(track), _context_legend(track), _words(track.about_frame)),
        *([] if track.is_level else [_section("Height", _heights(track), _floor_changes(track))]),
        _section("Contexts over time", _contexts(track), _context_table(track)),
        _section("Walking speed", _speed(track)),
        _section("Step lengths", _step_lengths(track)),
    ]
    if recording is not None:
        parts.append(_reading(recording, reading_report(recording), already_shown=set(track.notes)))
    return (
        "<!DOCTYPE html>\n"
        '<html lang="en"><head><meta charset="utf-8" />'
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\" />"
        '<meta name="viewport" content="width=device-width, initial-scale=1" />'
        f"<title>{name}</title><style>{_STYLE}</style></head>\n<body>\n"
        + "\n".join(parts)
        + "\n<footer>Made by pdr_filter.</footer>\n</body></html>\n"
    )


# --- words -----------------------------------------------------------------------------------------------------------


def _sentence(note: str) -> str:
    return f"{note[:1].upper()}{note[1:]}" + ("" if note.endswith((".", "!", "?")) else ".")


def _facts(track: TrackRows) -> str:
    minutes, seconds = divmod(round(track.duration_s), 60)
    lasted = f"{minutes} min {seconds} s" if minutes else f"{seconds} s"
    facts = [_count(track.n_steps, "step"), f"{track.distance_m:,.1f} m", lasted, f"weighting {track.weighting}"]
    if track.n_steps:
        facts.append(f"end {trust.end(track)}")
    if track.fixes:
        n_used = sum(fix.accepted for fix in track.fixes)
        facts.append(f"{n_used} of {_count(len(track.fixes), 'fix', 'fixes')} used")
    return " · ".join(facts)


def _count(n: int, one: str, many: str = "") -> str:
    return f"{n:,} {one if n == 1 else many or one + 's'}"


def _section(title: str, *content: str) -> str:
    return f"<section><h2>{text(title)}</h2>{''.join(content)}</section>"


def _list(lines: Iterable[str]) -> str:
    return "<ul>" + "".join(f"<li>{text(line)}</li>" for line in lines) + "</ul>"


def _doubt_section(doubts: Sequence[str]) -> str:
    if not doubts:
        return "<section class='sure'><h2>Where not to trust it</h2><p>Nothing odd was seen.</p></section>"
    return f"<section class='doubt'><h2>Where not to trust it</h2>{_list(doubts)}</section>"


def _context_legend(track: TrackRows) -> str:
    if not track.n_steps:
        return ""
    group, colours = _groups(track)
    names = list(colours.items())
    occurring = (names[i] for i in np.unique(group))
    items = [f"<li>{_key(colour)}{text(name)}</li>" for name, colour in occurring]
    items.append("<li>○ start</li><li>■ end</li><li>ellipses: 95 % of where the person may have been</li>")
    return f"<ul class='legend'>{''.join(items)}</ul>"


def _groups(track: TrackRows) -> tuple[IntArray, dict[str, str]]:
    """By what steps are coloured: number of the group of each (K,), storeys or else contexts, and colours by name."""
    colours = palette.floor_colours(track.floor.tolist())
    if len(colours) > 1:
        named = {f"floor {floor}": colour for floor, colour in colours.items()}
        return np.searchsorted(list(colours), track.floor), named
    return track.context_prob.argmax(axis=1), palette.context_colours(track.contexts)


def _key(colour: str) -> str:
    return f"<span class='key' style='background:{colour}'></span>"


def _context_table(track: TrackRows) -> str:
    seconds, without_steps_s = track.context_seconds(), track.seconds_without_steps
    total_s = sum(seconds.values()) + without_steps_s
    if total_s <= 0:
        return ""
    items = [
        f"<li>{_key(colour)}{text(name)} {seconds[name]:.0f} s ({100 * seconds[name] / total_s:.0f} %)</li>"
        for i, (name, colour) in enumerate(palette.context_colours(track.contexts).items())
        if seconds[name] >= 0.5 or (track.windows.context_prob[:, i] > _VISIBLE_PROB).any()
    ]
    if without_steps_s >= 0.5:
        items.append(f"<li>moving without steps {without_steps_s:.0f} s ({100 * without_steps_s / total_s:.0f} %)</li>")
    return f"<ul class='legend'>{''.join(items)}</ul>" + _words("The height of a colour is the context's probability.")


def _reading(recording: Recording, report: ReadingReport, already_shown: set[str]) -> str:
    rows = "".join(
        f"<tr><td>{text(s.name)}</td><td>{s.n_samples:,}</td>"
        f"<td>{_or_dash(s.requested_hz, '.1f')}</td>"
        f"<td{_odd(s.is_slow)}>{_or_dash(s.mean_rate_hz, '.1f')}</td>"
        f"<td{_odd(s.n_gaps > 0)}>{s.n_gaps}</td><td>{_or_dash(s.longest_gap_s if s.n_gaps else None, '.2f')}</td>"
        f"<td{_odd(s.n_duplicates > 0)}>{s.n_duplicates}</td><td{_odd(s.n_backward > 0)}>{s.n_backward}</td></tr>"
        for s in report.streams
    )
    head = ("stream", "samples", "asked Hz", "got Hz", "gaps", "longest s", "repeated", "backward")
    table = f"<div class='table'><table><tr>{''.join(f'<th>{h}</th>' for h in head)}</tr>{rows}</table></div>"
    lines = [_sentence(line) for line in report.about()]
    if recording.source:
        lines.insert(0, f"File: {recording.source}")
    lines += [_sentence(note) for note in report.notes if note not in already_shown]
    return _section("How it was read", _list(lines), table)


def _or_dash(value: float | None, spec: str) -> str:
    return "-" if value is None or not math.isfinite(value) else format(value, spec)


def _odd(is_odd: bool) -> str:
    return " class='odd'" if is_odd else ""


# --- pictures --------------------------------------------------------------------------------------------------------


def _runs(ends: BoolArray) -> list[tuple[int, int]]:
    """Begin and end [a, b) of the stretches between the places where `ends` holds; it has one item less than they."""
    return list(pairwise([0, *(int(i) + 1 for i in np.flatnonzero(ends)), len(ends) + 1]))


def _words(words: str) -> str:
    return f"<p class='facts'>{text(words)}</p>"


def _map(track: TrackRows) -> str:
    usable: BoolArray = np.all(np.abs(track.position_m) < _FARTHEST_M, axis=1)  # NaN is not
    if not usable.any():
        return _words("There are no steps: nothing to draw.")
    way = np.vstack([track.start_position_m, track.position_m[usable]])
    rows = _ellipse_rows(track, usable)
    reach_m = ellipse_extent(track.position_cov_m2[rows])
    seen = np.vstack([way, track.position_m[rows] - reach_m, track.position_m[rows] + reach_m])
    x, y, m_per_pixel = _map_axes(seen)
    unit_m, unit = (1000.0, "km") if max(x.high - x.low, y.high - y.low) > _KM_ABOVE_M else (1.0, "m")
    parts = [] if track.plan is None else [_plan(track.plan, track.floor, x, y)]
    parts += [_ellipse(track, row, x, y, m_per_pixel) for row in rows]
    group, colours = _groups(track)
    parts += _way(group[usable], list(colours.values()), x.at(way[:, 0]), y.at(way[:, 1]))
    return picture(
        x.counted_in(unit_m),
        y.counted_in(unit_m),
        (f"east ({unit})", f"north ({unit})"),
        f"Way of {_count(track.n_steps, 'step')}, seen from above",
        *parts,
        y_ticks=max(2, round((y.start - y.end) / 70)),
    )


def _plan(plan: FloorPlan, floors: IntArray, x: Axis, y: Axis) -> str:
    """The storeys that the track was on, cut off where the picture ends."""
    west, east, top, bottom = x.start, x.end, min(y.start, y.end), max(y.start, y.end)
    box = f"<rect x='{pixel(west)}' y='{pixel(top)}' width='{pixel(east - west)}' height='{pixel(bottom - top)}'/>"
    shapes: list[str] = []
    for storey in plan.storeys:
        if len(plan.storeys) > 1 and storey.floor not in floors:
            continue
        for kind, colour in palette.PLAN_COLOURS.items():
            for feature in (f for f in storey.features if f.kind == kind):
                rings = [np.column_stack([x.at(ring[:, 0]), y.at(ring[:, 1])]) for ring in feature.lines]
                ends = "Z" if feature.is_area else ""
                path = "".join("M" + "L".join(f"{pixel(a)} {pixel(b)}" for a, b in ring) + ends for ring in rings)
                fill = colour if feature.is_area else "none"
                line = colour if kind == "door" else palette.WALL
                shapes.append(f"<path d='{path}' fill='{fill}' fill-rule='evenodd' stroke='{line}' stroke-width='1'/>")
    return f"<clipPath id='inside'>{box}</clipPath><g clip-path='url(#inside)'>{''.join(shapes)}</g>"


def _map_axes(seen_m: FloatArray) -> tuple[Axis, Axis, float]:
    """Axes with the same metres in a pixel both ways, as wide as the page unless that would be too high; the metres."""
    middle = 0.5 * (seen_m.min(axis=0) + seen_m.max(axis=0))
    extent = np.maximum(1.08 * np.ptp(seen_m, axis=0), MIN_EXTENT_M)
    width = svg.WIDTH - svg.LEFT - svg.RIGHT
    height = float(np.clip(width * extent[1] / extent[0], 280.0, 640.0))
    m_per_pixel = float(max(extent[0] / width, extent[1] / height))
    (west, south), (east, north) = (middle + 0.5 * m_per_pixel * k * np.array([width, height]) for k in (-1, 1))
    return across(float(west), float(east)), upward(float(south), float(north), height), m_per_pixel


def _way(group: IntArray, colours: list[str], x: FloatArray, y: FloatArray) -> list[str]:
    """The line through points (K + 1,) in pixels, every step in the colour of its group (K,), and both ends."""
    every = max(1, len(x) // _MAX_POINTS)
    kept = np.unique([*range(0, len(x), every), len(x) - 1])
    # A dark line under the coloured one: light colours stay visible on white.
    parts = [polyline(x[kept], y[kept], palette.INK, 5)]
    for a, b in _runs(np.diff(group) != 0):
        # The step in row k leads from point k to point k + 1.
        inside = np.unique([*range(a, b + 1, every), b])
        parts.append(polyline(x[inside], y[inside], colours[int(group[a])], 3.4))
    start = f"circle cx='{pixel(x[0])}' cy='{pixel(y[0])}' r='5' fill='#fff' stroke='{palette.INK}' stroke-width='2'"
    end = f"rect x='{pixel(x[-1] - 4.5)}' y='{pixel(y[-1] - 4.5)}' width='9' height='9' fill='{palette.INK}'"
    return [*parts, titled(start, "start"), titled(end, "end")]


def _ellipse_rows(track: TrackRows, usable: BoolArray) -> list[int]:
    """Steps with an ellipse that can be drawn; the last of these in any case."""
    usable = usable & (np.abs(track.position_cov_m2) < _FARTHEST_M**2).all(axis=(1, 2))
    if not usable.any():
        return []
    *rows, _ = ellipse_rows(track.step_length_m)
    return sorted(i for i in {*rows, int(np.flatnonzero(usable)[-1])} if usable[i])


def _ellipse(track: TrackRows, row: int, x: Axis, y: Axis, m_per_pixel: float) -> str:
    ((minor_m, major_m),), (angle_rad,) = ellipse_axes(track.position_cov_m2[[row]])
    east, north = x.at(float(track.position_m[row, 0])), y.at(float(track.position_m[row, 1]))
    # Pixels grow downwards, so the turn is negative.
    place = f"translate({pixel(east)} {pixel(north)}) rotate({-math.degrees(angle_rad):.1f})"
    fill = f"fill='{palette.ELLIPSE}' fill-opacity='{palette.ELLIPSE_FILL_ALPHA}' stroke='{palette.ELLIPSE}'"
    radii = f"rx='{pixel(major_m / m_per_pixel)}' ry='{pixel(minor_m / m_per_pixel)}'"
    shape = f"ellipse {radii} transform='{place}' {fill} stroke-opacity='{palette.ELLIPSE_EDGE_ALPHA}'"
    return titled(shape, f"at {track.time_s[row]:.0f} s: 95 % within {major_m:.1f} m by {minor_m:.1f} m")


def _time_axis(track: TrackRows) -> tuple[Axis, float, str]:
    """Axis of the whole recording, seconds of its unit, and its name."""
    unit_s, name = (60.0, "time (min)") if track.duration_s > 600 else (1.0, "time (s)")
    ends_s = [track.start_time_s + track.duration_s, *track.time_s[-1:], *track.windows.time_s[-1:]]
    end_s = max([*(e for e in ends_s if math.isfinite(e)), track.start_time_s + 1.0])
    return across(track.start_time_s / unit_s, end_s / unit_s), unit_s, name


def _contexts(track: TrackRows) -> str:
    windows = track.windows
    if not len(windows):
        return _words("There are no context windows.")
    x, unit_s, name = _time_axis(track)
    y = upward(0.0, 1.0, 160.0)
    starts_s, _ = window_starts(windows, track.start_time_s)
    start_x, end_x, prob = _columns(x.at(starts_s / unit_s), x.at(windows.time_s / unit_s), windows.context_prob)
    upper = np.cumsum(prob, axis=1)
    parts: list[str] = []
    for i, (context, colour) in enumerate(palette.context_colours(windows.contexts).items()):
        # One path of rectangles for each context.
        shown = prob[:, i] > _VISIBLE_PROB
        low, high = y.at((upper - prob)[shown, i]), y.at(upper[shown, i])
        boxes = "".join(
            f"M{pixel(a)} {pixel(b)}H{pixel(c)}V{pixel(d)}H{pixel(a)}Z"
            for a, b, c, d in zip(start_x[shown], low, end_x[shown], high, strict=True)
        )
        if boxes:
            parts.append(titled(f"path d='{boxes}' fill='{colour}' shape-rendering='crispEdges'", context))
    ticks = np.unique(np.round(x.at(track.time_s[np.isfinite(track.time_s)] / unit_s), 0))
    marks = "".join(f"M{pixel(v)} {pixel(svg.TOP - 10)}V{pixel(svg.TOP - 3)}" for v in ticks)
    if marks:
        parts.append(titled(f"path d='{marks}' stroke='{palette.INK}' stroke-width='0.7'", "steps"))
    names = (f"{name}; ticks on top are steps", "")
    return picture(x, y, names, "Context probabilities over time", *parts, y_ticks=2)


def _columns(start_x: FloatArray, end_x: FloatArray, prob: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The same with as many windows together as it takes to have no more columns than a screen."""
    if len(prob) <= _MAX_COLUMNS:
        return start_x, end_x, prob
    # By place and not by number, so that what is missing stays missing.
    column = np.floor(0.5 * (start_x + end_x) * _MAX_COLUMNS / svg.WIDTH)
    _, first, count = np.unique(column, return_index=True, return_counts=True)
    return start_x[first], end_x[first + count - 1], np.add.reduceat(prob, first, axis=0) / count[:, np.newaxis]


def _heights(track: TrackRows) -> str:
    x, unit_s, name = _time_axis(track)
    every = max(1, track.n_steps // (4 * _MAX_COLUMNS))
    time_s, height_m = track.time_s[::every], track.height_m[::every]
    half_m = _INTERVAL_95 * track.height_std_m[::every]
    low, high = float(np.min(height_m - half_m)), float(np.max(height_m + half_m))
    y, at = upward(min(low, 0.0), max(high, 1.0), 200.0), x.at(time_s / unit_s)
    band = points(
        np.concatenate([at, at[::-1]]), np.concatenate([y.at(height_m - half_m), y.at(height_m + half_m)[::-1]])
    )
    colours = palette.floor_colours(track.floor.tolist())
    parts = [f"<polygon points='{band}' fill='{palette.ELLIPSE}' fill-opacity='0.2' />"]
    for a, b in _runs(np.diff(track.floor[::every]) != 0):
        colour, inside = colours[int(track.floor[::every][a])], slice(a, min(b + 1, len(at)))
        parts.append(polyline(at[inside], y.at(height_m[inside]), colour, 2.0))
    words = "Above the start of the walk, with its 95 % interval."
    return picture(x, y, (name, "height (m)"), "Height over time", *parts) + _words(words)


def _floor_changes(track: TrackRows) -> str:
    return _list(
        f"{c.start_s:.0f} to {c.end_s:.0f} s: from floor {c.from_floor} to floor {c.to_floor}, "
        + ("nobody knows how" if c.how == "unknown" else f"by {c.how}")
        for c in track.floor_changes()
    )


def _speed(track: TrackRows) -> str:
    speed, std = track.smoothed_speed_mps, track.smoothed_speed_std_mps
    usable = np.isfinite(speed) & np.isfinite(std) & np.isfinite(track.time_s)
    if not usable.any():
        return _words("There are no steps.")
    time_s, speed, half = track.time_s[usable], speed[usable], _INTERVAL_95 * std[usable]
    every = max(1, len(time_s) // (4 * _MAX_COLUMNS))
    x, unit_s, name = _time_axis(track)
    y = upward(0.0, max(1.08 * float(np.max(speed + half)), 0.5), 220.0)
    parts: list[str] = []
    for a, b in _runs(np.diff(time_s) > _BOUT_PAUSE_S):
        inside = np.unique([*range(a, b, every), b - 1])
        at = x.at(time_s[inside] / unit_s)
        low, mean, up = (y.at(np.maximum(speed[inside] + k * half[inside], 0.0)) for k in (-1.0, 0.0, 1.0))
        if len(inside) == 1:  # a bar and a dot: a line needs two points
            parts.append(line(at[0], low[0], at[0], up[0], "#b9d4e6", 3))
            parts.append(f"<circle cx='{pixel(at[0])}' cy='{pixel(mean[0])}' r='1.5' fill='{palette.BLUE}' />")
            continue
        band = points(np.concatenate([at, at[::-1]]), np.concatenate([low, up[::-1]]))
        parts.append(f"<polygon points='{band}' fill='{palette.BLUE}' fill-opacity='0.2' />")
        parts.append(polyline(at, mean, palette.BLUE, 1.6))
    words = "Smoothed over the steps of a bout so far, with its 95 % interval."
    return picture(x, y, (name, "speed (m/s)"), "Walking speed over time", *parts) + _words(words)


def _step_lengths(track: TrackRows) -> str:
    length_m = track.step_length_m[np.isfinite(track.step_length_m)]
    if not len(length_m):
        return _words("There are no steps.")
    # The far end of nonsense does not squeeze the rest together.
    cut_m = max(float(np.quantile(length_m, 0.999)), 1.0) + _BIN_M
    n_bins = min(math.ceil(cut_m / _BIN_M), 200)
    edges_m = np.linspace(0.0, max(n_bins * _BIN_M, cut_m), n_bins + 1)
    count = np.histogram(np.minimum(length_m, edges_m[-1]), edges_m)[0]
    x, y = across(0.0, float(edges_m[-1])), upward(0.0, 1.08 * int(count.max()), 200.0)
    parts: list[str] = []
    for a, b, n in zip(edges_m[:-1], edges_m[1:], count, strict=True):
        if n:
            left, right, top = x.at(float(a)), x.at(float(b)), y.at(float(n))
            size = f"width='{pixel(max(right - left - 1, 0.5))}' height='{pixel(y.start - top)}'"
            box = f"rect x='{pixel(left + 0.5)}' y='{pixel(top)}' {size} fill='{palette.BLUE}' fill-opacity='0.75'"
            parts.append(titled(box, f"{_count(int(n), 'step')} of {a:.2f} to {b:.2f} m"))
    low, median, high = (float(q) for q in np.quantile(length_m, [0.05, 0.5, 0.95]))
    parts.append(line(x.at(median), y.start, x.at(median), y.end, palette.INK, 1.5))
    words = f"Median {median:.2f} m (line); nine of ten between {low:.2f} and {high:.2f} m."
    return picture(x, y, ("step length (m)", "steps"), "Distribution of the step lengths", *parts) + _words(words)
