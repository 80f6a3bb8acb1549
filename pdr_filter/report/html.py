"""A track on one HTML page that needs nothing else: no network, no scripts, no fonts, no other files.

All pictures are SVG in the page, drawn here with plain strings. The page is well-formed XML, and its content security
policy forbids browsers to load anything.
"""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from pdr_filter.io.describe import ReadingReport, reading_report
from pdr_filter.io.recording import Recording
from pdr_filter.report import trust
from pdr_filter.values.arrays import BoolArray, FloatArray
from pdr_filter.values.track_rows import TrackRows

# Of the contexts, the same as in `pdr_filter.report.plotting`, which loads matplotlib.
_COLOURS = ("#D0D0D0", "#0072B2", "#CC6600", "#44AA99", "#EECC66", "#882255")
# Half axes of the 95 % ellipse: the square root of chi-square with two degrees of freedom; and of the 95 % interval.
_SCALE_95 = 2.4477
_INTERVAL_95 = 1.96
_N_ELLIPSES = 8
# Fewer metres than this across look like a zoom into noise.
_MIN_EXTENT_M = 4.0
# Numbers of five digits have no room.
_KM_ABOVE_M = 5000.0
_WIDTH = 920.0
# Room for numbers such as -100 left of a picture, for its name above, and for numbers and a name below: 2.8, 1.6 and
# 2.8 times the height of letters on a phone, 22 units (`_STYLE`).
_LEFT = 62.0
_TOP = 36.0
_BOTTOM = 62.0
_RIGHT = 16.0
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

_STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, sans-serif; color: #222; background: #fff; margin: 0 auto; max-width: 960px;
  padding: 1.5em; }
h1 { font-size: 1.6em; margin: 0; overflow-wrap: anywhere; }
h2 { font-size: 1.1em; margin: 2em 0 0.5em; border-bottom: 1px solid #ddd; }
p.facts { color: #555; margin: 0.2em 0 0; }
ul { margin: 0.4em 0; padding-left: 1.3em; } li { overflow-wrap: anywhere; }
section.doubt { background: #fff6e5; border-left: 4px solid #cc6600; padding: 0.5em 1em; margin-top: 1em; }
section.doubt h2, section.sure h2 { margin-top: 0; border: none; }
section.sure { background: #eef7f4; border-left: 4px solid #44aa99; padding: 0.5em 1em; margin-top: 1em; }
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


def write_report(track: TrackRows, path: str | Path, recording: Recording | None = None) -> Path:
    """Write the page of `html_report` and return its path; folders are created."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(html_report(track, recording), encoding="utf-8")
    return path


def html_report(track: TrackRows, recording: Recording | None = None) -> str:
    """The page: way with 95 % ellipses, where not to trust it, contexts, speed, step lengths, how it was read.

    Parameters
    ----------
    track : TrackRows
    recording : Recording, optional
        What it was made from, for the part about the reading.
    """
    doubts = [*trust.doubts(track), *(_sentence(note) for note in track.notes)]
    name = _text(track.name or "track")
    parts = [
        f"<header><h1><bdi>{name}</bdi></h1><p class='facts'>{_text(_facts(track))}</p></header>",
        _doubt_section(doubts),
        _section("Way", _map(track), _context_legend(track)),
        _section("Contexts over time", _contexts(track), _context_table(track)),
        _section("Walking speed", _speed(track)),
        _section("Step lengths", _step_lengths(track)),
    ]
    if recording is not None:
        parts.append(_reading(recording, reading_report(recording), already_told=set(track.notes)))
    return (
        "<!DOCTYPE html>\n"
        '<html lang="en"><head><meta charset="utf-8" />'
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\" />"
        '<meta name="viewport" content="width=device-width, initial-scale=1" />'
        f"<title>{name}</title><style>{_STYLE}</style></head>\n<body>\n"
        + "\n".join(parts)
        + "\n<footer>Made by pdr_filter. Positions are relative to the start; north is true north only where an "
        "absolute heading was available, otherwise the direction of the phone at the start.</footer>\n</body></html>\n"
    )


# --- words -----------------------------------------------------------------------------------------------------------


def _text(value: object) -> str:
    """Escaped for text and attributes; characters that XML cannot hold become the replacement character."""
    kept = (c if c in "\t\n" or (c.isprintable() and not "\ud800" <= c <= "\udfff") else "�" for c in str(value))
    return html.escape("".join(kept), quote=True)


def _sentence(note: str) -> str:
    return f"{note[:1].upper()}{note[1:]}" + ("" if note.endswith((".", "!", "?")) else ".")


def _facts(track: TrackRows) -> str:
    minutes, seconds = divmod(round(track.duration_s), 60)
    lasted = f"{minutes} min {seconds} s" if minutes else f"{seconds} s"
    facts = [_count(track.n_steps, "step"), f"{track.distance_m:,.1f} m", lasted, f"weighting {track.weighting}"]
    if track.n_steps:
        east_m, north_m = track.position_m[-1]
        std_m = math.sqrt(max(float(np.trace(track.position_cov_m2[-1])), 0.0))
        facts.append(f"end {east_m:.1f} m east, {north_m:.1f} m north, uncertain by {std_m:.1f} m")
    used = [fix.nis for fix in track.fixes if fix.accepted]
    if track.fixes:
        facts.append(f"{len(used)} of {_count(len(track.fixes), 'fix', 'fixes')} used")
    return " · ".join(facts)


def _count(n: int, one: str, many: str = "") -> str:
    return f"{n:,} {one if n == 1 else many or one + 's'}"


def _section(title: str, *content: str) -> str:
    return f"<section><h2>{_text(title)}</h2>{''.join(content)}</section>"


def _list(lines: Iterable[str]) -> str:
    return "<ul>" + "".join(f"<li>{_text(line)}</li>" for line in lines) + "</ul>"


def _doubt_section(doubts: Sequence[str]) -> str:
    if not doubts:
        return "<section class='sure'><h2>Where not to trust it</h2><p>Nothing odd was seen.</p></section>"
    return f"<section class='doubt'><h2>Where not to trust it</h2>{_list(doubts)}</section>"


def _colour(i: int) -> str:
    return _COLOURS[i % len(_COLOURS)]


def _context_legend(track: TrackRows) -> str:
    if not track.n_steps:
        return ""
    occurring = np.unique(track.context_prob.argmax(axis=1))
    items = [f"<li>{_key(_colour(i))}{_text(track.contexts[i])}</li>" for i in occurring]
    items.append("<li>○ start</li><li>■ end</li><li>ellipses: 95 % of where the person may have been</li>")
    return f"<ul class='legend'>{''.join(items)}</ul>"


def _key(colour: str) -> str:
    return f"<span class='key' style='background:{colour}'></span>"


def _context_table(track: TrackRows) -> str:
    seconds = track.context_seconds()
    total_s = sum(seconds.values())
    if total_s <= 0:
        return ""
    items = [
        f"<li>{_key(_colour(i))}{_text(name)} {seconds[name]:.0f} s ({100 * seconds[name] / total_s:.0f} %)</li>"
        for i, name in enumerate(track.contexts)
        if seconds[name] >= 0.5 or (track.windows.context_prob[:, i] > _VISIBLE_PROB).any()
    ]
    return f"<ul class='legend'>{''.join(items)}</ul>" + _words("The height of a colour is the context's probability.")


def _reading(recording: Recording, report: ReadingReport, already_told: set[str]) -> str:
    rows = "".join(
        f"<tr><td>{_text(s.name)}</td><td>{s.n_samples:,}</td>"
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
    lines += [_sentence(note) for note in report.notes if note not in already_told]
    return _section("How it was read", _list(lines), table)


def _or_dash(value: float | None, spec: str) -> str:
    return "-" if value is None or not math.isfinite(value) else format(value, spec)


def _odd(is_odd: bool) -> str:
    return " class='odd'" if is_odd else ""


# --- pictures --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Axis:
    """Numbers from `low` to `high` to pixels from `start` to `end`."""

    low: float
    high: float
    start: float
    end: float

    def at(self, value: float) -> float:
        return self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)

    def all_at(self, values: FloatArray) -> FloatArray:
        return self.start + (values - self.low) / (self.high - self.low) * (self.end - self.start)

    def counted_in(self, unit: float) -> _Axis:
        return _Axis(self.low / unit, self.high / unit, self.start, self.end)

    def ticks(self, n: int) -> list[float]:
        step = _round_up((self.high - self.low) / n)
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return [k * step for k in range(first, last + 1)]


def _round_up(value: float) -> float:
    """The next of 1, 2, 5, 10, 20, 50 ... and their tenths."""
    if not (value > 0 and math.isfinite(value)):
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0, 20.0) if m * power >= value * (1 - 1e-9))


def _n(value: float) -> str:
    """A pixel, short."""
    return f"{value:.1f}".removesuffix(".0")


def _svg(height: float, label: str, *content: str) -> str:
    inside = "".join(content)
    return f"<svg viewBox='0 0 {_n(_WIDTH)} {_n(height)}' role='img' aria-label='{_text(label)}'>{inside}</svg>"


def _label(x: float, y: float, text: str, anchor: str = "middle", down_em: float = 0.0) -> str:
    """Text at a place, moved down by heights of its letters, because these differ between screens."""
    place = f"x='{_n(x)}' y='{_n(y)}' dy='{down_em:g}em' text-anchor='{anchor}'"
    return f"<text {place}>{_text(text)}</text>"


def _line(x1: float, y1: float, x2: float, y2: float, colour: str = "#e6e6e6", width: float = 1.0) -> str:
    ends = f"x1='{_n(x1)}' y1='{_n(y1)}' x2='{_n(x2)}' y2='{_n(y2)}'"
    return f"<line {ends} stroke='{colour}' stroke-width='{width:g}' />"


def _points(x: FloatArray, y: FloatArray) -> str:
    return " ".join(f"{_n(a)},{_n(b)}" for a, b in zip(x, y, strict=True))


def _grid(x: _Axis, y: _Axis, x_name: str, y_name: str, y_ticks: int = 5) -> str:
    """Lines, numbers and names of both axes; y grows upwards, so its start is the lower edge."""
    x_values, y_values = x.ticks(10), y.ticks(y_ticks)
    parts = [
        _line(x.at(v), y.start, x.at(v), y.end) + _label(x.at(v), y.start, f"{v:g}", down_em=1.25) for v in x_values
    ]
    parts += [
        _line(x.start, y.at(v), x.end, y.at(v)) + _label(x.start - 6, y.at(v), f"{v:g}", "end", 0.35) for v in y_values
    ]
    parts.append(_label(0.5 * (x.start + x.end), y.start, x_name, down_em=2.6))
    if y_name:
        parts.append(_label(0.0, y.end, y_name, "start", -0.5))
    return "".join(parts)


def _runs(ends: BoolArray) -> list[tuple[int, int]]:
    """Begin and end [a, b) of the stretches between the places where `ends` holds; it has one item less than they."""
    edges = [0, *(int(i) + 1 for i in np.flatnonzero(ends)), len(ends) + 1]
    return list(pairwise(edges))


def _words(words: str) -> str:
    return f"<p class='facts'>{_text(words)}</p>"


def _map(track: TrackRows) -> str:
    usable: BoolArray = np.all(np.abs(track.position_m) < _FARTHEST_M, axis=1)  # NaN is not
    if not usable.any():
        return _words("There are no steps: nothing to draw.")
    position_m, context = track.position_m[usable], track.context_prob[usable].argmax(axis=1)
    way = np.vstack([track.start_position_m, position_m])
    rows = _ellipse_rows(track, usable)
    half_m = _SCALE_95 * np.sqrt(np.maximum(np.diagonal(track.position_cov_m2[rows], axis1=1, axis2=2), 0.0))
    seen = np.vstack([way, track.position_m[rows] - half_m, track.position_m[rows] + half_m])
    middle, extent = 0.5 * (seen.min(axis=0) + seen.max(axis=0)), np.ptp(seen, axis=0)
    # The same metres in a pixel both ways: as wide as the page, unless that would be too high.
    inner = _WIDTH - _LEFT - _RIGHT
    extent = np.maximum(1.08 * extent, _MIN_EXTENT_M)
    inner_height = float(np.clip(inner * extent[1] / extent[0], 280.0, 640.0))
    m_per_pixel = float(max(extent[0] / inner, extent[1] / inner_height))
    half_width_m, half_height_m = 0.5 * inner * m_per_pixel, 0.5 * inner_height * m_per_pixel
    x = _Axis(float(middle[0]) - half_width_m, float(middle[0]) + half_width_m, _LEFT, _LEFT + inner)
    y = _Axis(float(middle[1]) - half_height_m, float(middle[1]) + half_height_m, _TOP + inner_height, _TOP)
    points_x, points_y = x.all_at(way[:, 0]), y.all_at(way[:, 1])
    n_rows = max(2, round(inner_height / 70))
    unit_m, unit = (1000.0, "km") if max(extent) > _KM_ABOVE_M else (1.0, "m")
    parts = [_grid(x.counted_in(unit_m), y.counted_in(unit_m), f"east ({unit})", f"north ({unit})", n_rows)]
    parts += [_ellipse(track, int(row), x, y, m_per_pixel) for row in rows]
    every = max(1, len(way) // _MAX_POINTS)
    shape = "fill='none' stroke-linejoin='round' stroke-linecap='round'"
    # A dark line under the coloured one: light colours stay visible on white.
    kept = np.unique([*range(0, len(way), every), len(way) - 1])
    whole = _points(points_x[kept], points_y[kept])
    parts.append(f"<polyline points='{whole}' {shape} stroke='#222' stroke-width='5' />")
    for a, b in _runs(np.diff(context) != 0):
        # The step in row k leads from point k to point k + 1.
        inside = np.unique([*range(a, b + 1, every), b])
        line = _points(points_x[inside], points_y[inside])
        parts.append(f"<polyline points='{line}' {shape} stroke='{_colour(int(context[a]))}' stroke-width='3.4' />")
    start_x, start_y, end_x, end_y = points_x[0], points_y[0], points_x[-1], points_y[-1]
    dot = f"cx='{_n(start_x)}' cy='{_n(start_y)}' r='5'"
    parts.append(f"<circle {dot} fill='#fff' stroke='#222' stroke-width='2'><title>start</title></circle>")
    box = f"x='{_n(end_x - 4.5)}' y='{_n(end_y - 4.5)}' width='9' height='9'"
    parts.append(f"<rect {box} fill='#222'><title>end</title></rect>")
    return _svg(_TOP + inner_height + _BOTTOM, f"Way of {_count(track.n_steps, 'step')}, seen from above", *parts)


def _ellipse_rows(track: TrackRows, usable: BoolArray) -> list[int]:
    """The last step, and one every so many metres before it."""
    usable = usable & (np.abs(track.position_cov_m2) < _FARTHEST_M**2).all(axis=(1, 2))
    if not usable.any():
        return []
    walked_m = np.cumsum(track.step_length_m)
    marks_m = np.arange(1, _N_ELLIPSES) * _round_up(float(walked_m[-1]) / _N_ELLIPSES)
    rows = {int(i) for i in np.searchsorted(walked_m, marks_m[marks_m < walked_m[-1]])}
    return sorted(i for i in {*rows, int(np.flatnonzero(usable)[-1])} if usable[i])


def _ellipse(track: TrackRows, row: int, x: _Axis, y: _Axis, m_per_pixel: float) -> str:
    variance, direction = np.linalg.eigh(track.position_cov_m2[row])
    half_m = _SCALE_95 * np.sqrt(np.maximum(variance, 0.0))
    # Counter-clockwise from east on the map; pixels grow downwards, so the turn is negative.
    angle_deg = -math.degrees(math.atan2(direction[1, 1], direction[0, 1]))
    centre_x, centre_y = x.at(float(track.position_m[row, 0])), y.at(float(track.position_m[row, 1]))
    told = f"at {track.time_s[row]:.0f} s: 95 % within {half_m[1]:.1f} m by {half_m[0]:.1f} m"
    return (
        f"<ellipse rx='{_n(half_m[1] / m_per_pixel)}' ry='{_n(half_m[0] / m_per_pixel)}' "
        f"transform='translate({_n(centre_x)} {_n(centre_y)}) rotate({angle_deg:.1f})' "
        f"fill='#556677' fill-opacity='0.07' stroke='#556677' stroke-opacity='0.6'><title>{told}</title></ellipse>"
    )


def _time_axis(track: TrackRows) -> tuple[_Axis, float, str]:
    """Axis of the whole recording, seconds of its unit, and its name."""
    unit_s, name = (60.0, "time (min)") if track.duration_s > 600 else (1.0, "time (s)")
    ends_s = [track.start_time_s + track.duration_s, *track.time_s[-1:], *track.windows.time_s[-1:]]
    end_s = max([*(e for e in ends_s if math.isfinite(e)), track.start_time_s + 1.0])
    return _Axis(track.start_time_s / unit_s, end_s / unit_s, _LEFT, _WIDTH - _RIGHT), unit_s, name


def _contexts(track: TrackRows) -> str:
    windows = track.windows
    if not len(windows):
        return _words("There are no context windows.")
    height = 160.0
    x, unit_s, name = _time_axis(track)
    y = _Axis(0.0, 1.0, _TOP + height, _TOP)
    previous_s = np.concatenate([[track.start_time_s], windows.time_s[:-1]])
    starts_s = np.maximum(previous_s, windows.time_s - 2.0)  # a window tells about its own 2 s
    start_x, end_x, prob = _columns(
        x.all_at(starts_s / unit_s), x.all_at(windows.time_s / unit_s), windows.context_prob
    )
    upper = np.cumsum(prob, axis=1)
    parts: list[str] = []
    for i, context in enumerate(windows.contexts):
        # One path of rectangles for each context.
        shown = prob[:, i] > _VISIBLE_PROB
        low, high = y.all_at((upper - prob)[shown, i]), y.all_at(upper[shown, i])
        boxes = "".join(
            f"M{_n(a)} {_n(b)}H{_n(c)}V{_n(d)}H{_n(a)}Z"
            for a, b, c, d in zip(start_x[shown], low, end_x[shown], high, strict=True)
        )
        if boxes:
            fill = f"fill='{_colour(i)}' shape-rendering='crispEdges'"
            parts.append(f"<path d='{boxes}' {fill}><title>{_text(context)}</title></path>")
    ticks = np.unique(np.round(x.all_at(track.time_s[np.isfinite(track.time_s)] / unit_s), 0))
    marks = "".join(f"M{_n(v)} {_n(_TOP - 10)}V{_n(_TOP - 3)}" for v in ticks)
    if marks:
        parts.append(f"<path d='{marks}' stroke='#222' stroke-width='0.7'><title>steps</title></path>")
    grid = _grid(x, y, f"{name}; ticks on top are steps", "", 2)
    return _svg(_TOP + height + _BOTTOM, "Context probabilities over time", grid, *parts)


def _columns(start_x: FloatArray, end_x: FloatArray, prob: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The same with as many windows together as it takes to have no more columns than a screen."""
    if len(prob) <= _MAX_COLUMNS:
        return start_x, end_x, prob
    # By place and not by number, so that what is missing stays missing.
    column = np.floor(0.5 * (start_x + end_x) * _MAX_COLUMNS / _WIDTH)
    _, first, count = np.unique(column, return_index=True, return_counts=True)
    return start_x[first], end_x[first + count - 1], np.add.reduceat(prob, first, axis=0) / count[:, np.newaxis]


def _speed(track: TrackRows) -> str:
    speed, std = track.smoothed_speed_mps, track.smoothed_speed_std_mps
    usable = np.isfinite(speed) & np.isfinite(std) & np.isfinite(track.time_s)
    if not usable.any():
        return _words("There are no steps.")
    time_s, speed, std = track.time_s[usable], speed[usable], _INTERVAL_95 * std[usable]
    every = max(1, len(time_s) // (4 * _MAX_COLUMNS))
    height = 220.0
    x, unit_s, name = _time_axis(track)
    y = _Axis(0.0, max(1.08 * float(np.max(speed + std)), 0.5), _TOP + height, _TOP)
    parts = [_grid(x, y, name, "speed (m/s)")]
    for a, b in _runs(np.diff(time_s) > _BOUT_PAUSE_S):
        inside = np.unique([*range(a, b, every), b - 1])
        at = x.all_at(time_s[inside] / unit_s)
        low, mean, up = (y.all_at(np.maximum(speed[inside] + k * std[inside], 0.0)) for k in (-1.0, 0.0, 1.0))
        if len(inside) == 1:  # a bar and a dot: a line needs two points
            parts.append(_line(at[0], low[0], at[0], up[0], "#b9d4e6", 3))
            parts.append(f"<circle cx='{_n(at[0])}' cy='{_n(mean[0])}' r='1.5' fill='#0072B2' />")
            continue
        band = _points(np.concatenate([at, at[::-1]]), np.concatenate([low, up[::-1]]))
        parts.append(f"<polygon points='{band}' fill='#0072B2' fill-opacity='0.2' />")
        line = _points(at, mean)
        parts.append(f"<polyline points='{line}' fill='none' stroke='#0072B2' stroke-width='1.6' />")
    words = "Smoothed over the steps of a bout so far, with its 95 % interval."
    return _svg(_TOP + height + _BOTTOM, "Walking speed over time", *parts) + _words(words)


def _step_lengths(track: TrackRows) -> str:
    length_m = track.step_length_m[np.isfinite(track.step_length_m)]
    if not len(length_m):
        return _words("There are no steps.")
    # The far end of nonsense does not squeeze the rest together.
    cut_m = max(float(np.quantile(length_m, 0.999)), 1.0) + _BIN_M
    n_bins = min(math.ceil(cut_m / _BIN_M), 200)
    edges_m = np.linspace(0.0, max(n_bins * _BIN_M, cut_m), n_bins + 1)
    count = np.histogram(np.minimum(length_m, edges_m[-1]), edges_m)[0]
    height = 200.0
    x = _Axis(0.0, float(edges_m[-1]), _LEFT, _WIDTH - _RIGHT)
    y = _Axis(0.0, 1.08 * int(count.max()), _TOP + height, _TOP)
    parts = [_grid(x, y, "step length (m)", "steps")]
    for a, b, n in zip(edges_m[:-1], edges_m[1:], count, strict=True):
        if n:
            x1, x2, y1 = x.at(float(a)), x.at(float(b)), y.at(float(n))
            box = f"x='{_n(x1 + 0.5)}' y='{_n(y1)}' width='{_n(max(x2 - x1 - 1, 0.5))}' height='{_n(y.start - y1)}'"
            told = f"{_count(int(n), 'step')} of {a:.2f} to {b:.2f} m"
            parts.append(f"<rect {box} fill='#0072B2' fill-opacity='0.75'><title>{told}</title></rect>")
    low, median, high = np.quantile(length_m, [0.05, 0.5, 0.95])
    parts.append(_line(x.at(float(median)), y.start, x.at(float(median)), y.end, "#222", 1.5))
    words = f"Median {median:.2f} m (line); nine of ten between {low:.2f} and {high:.2f} m."
    return _svg(_TOP + height + _BOTTOM, "Distribution of the step lengths", *parts) + _words(words)
