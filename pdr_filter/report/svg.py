"""Pictures as SVG text: axes, grids, lines and labels in strings, for pages that need nothing else.

Pixels are numbers of the view box, as wide as `WIDTH`; they are written with one decimal.
"""

from __future__ import annotations

import html
import math
from dataclasses import dataclass
from typing import TypeVar

from pdr_filter.report.geometry import round_up
from pdr_filter.report.palette import GRID
from pdr_filter.values import FloatArray

WIDTH = 920.0
# Room for numbers such as -100 left of a picture, for its name above, and for numbers and a name below: 2.8, 1.6 and
# 2.8 times the height of letters on a phone, 22 units (the style of `html`).
LEFT, TOP, BOTTOM, RIGHT = 62.0, 36.0, 62.0, 16.0

Numbers = TypeVar("Numbers", float, FloatArray)


@dataclass(frozen=True, slots=True)
class Axis:
    """Numbers from `low` to `high` to pixels from `start` to `end`."""

    low: float
    high: float
    start: float
    end: float

    def at(self, value: Numbers) -> Numbers:
        """Pixel of a number, or of each of many."""
        return self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)

    def counted_in(self, unit: float) -> Axis:
        """The same axis for numbers in a unit so many times as large."""
        return Axis(self.low / unit, self.high / unit, self.start, self.end)

    def ticks(self, n: int) -> list[float]:
        """Round numbers on the axis, at most about n."""
        step = round_up((self.high - self.low) / n)
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return [k * step for k in range(first, last + 1)]


def across(low: float, high: float) -> Axis:
    """The horizontal axis of a picture, as wide as there is room."""
    return Axis(low, high, LEFT, WIDTH - RIGHT)


def upward(low: float, high: float, height: float) -> Axis:
    """The vertical axis of a picture, which grows upwards: it starts at the lower edge."""
    return Axis(low, high, TOP + height, TOP)


def picture(x: Axis, y: Axis, names: tuple[str, str], label: str, *content: str, y_ticks: int = 5) -> str:
    """A picture with lines, numbers and names of both axes below its content; the label is read aloud."""
    height = y.start + BOTTOM
    inside = _grid(x, y, names, y_ticks) + "".join(content)
    return f"<svg viewBox='0 0 {pixel(WIDTH)} {pixel(height)}' role='img' aria-label='{text(label)}'>{inside}</svg>"


def text(value: object) -> str:
    """Escaped for text and attributes; characters that XML cannot hold become the replacement character."""
    kept = (c if c in "\t\n" or (c.isprintable() and not "\ud800" <= c <= "\udfff") else "�" for c in str(value))
    return html.escape("".join(kept), quote=True)


def pixel(value: float) -> str:
    """A pixel, short."""
    return f"{value:.1f}".removesuffix(".0")


def line(x1: float, y1: float, x2: float, y2: float, colour: str, width: float = 1.0) -> str:
    """A straight line."""
    ends = f"x1='{pixel(x1)}' y1='{pixel(y1)}' x2='{pixel(x2)}' y2='{pixel(y2)}'"
    return f"<line {ends} stroke='{colour}' stroke-width='{width:g}' />"


def polyline(x: FloatArray, y: FloatArray, colour: str, width: float) -> str:
    """A line through points with round corners."""
    shape = "fill='none' stroke-linejoin='round' stroke-linecap='round'"
    return f"<polyline points='{points(x, y)}' {shape} stroke='{colour}' stroke-width='{width:g}' />"


def points(x: FloatArray, y: FloatArray) -> str:
    """Points of a line or an area."""
    return " ".join(f"{pixel(a)},{pixel(b)}" for a, b in zip(x, y, strict=True))


def titled(shape: str, title: str) -> str:
    """A shape, such as `rect x='0' y='0'`, with a title that appears where the mouse rests."""
    return f"<{shape}><title>{text(title)}</title></{shape.split()[0]}>"


def _grid(x: Axis, y: Axis, names: tuple[str, str], y_ticks: int) -> str:
    parts = [
        line(x.at(v), y.start, x.at(v), y.end, GRID) + _label(x.at(v), y.start, f"{v:g}", down_em=1.25)
        for v in x.ticks(10)
    ]
    parts += [
        line(x.start, y.at(v), x.end, y.at(v), GRID) + _label(x.start - 6, y.at(v), f"{v:g}", "end", 0.35)
        for v in y.ticks(y_ticks)
    ]
    parts.append(_label(0.5 * (x.start + x.end), y.start, names[0], down_em=2.6))
    parts.append(_label(0.0, y.end, names[1], "start", -0.5))
    return "".join(parts)


def _label(x: float, y: float, words: str, anchor: str = "middle", down_em: float = 0.0) -> str:
    """Text at a place, moved down by heights of its letters, because these differ between screens."""
    place = f"x='{pixel(x)}' y='{pixel(y)}' dy='{down_em:g}em' text-anchor='{anchor}'"
    return f"<text {place}>{text(words)}</text>" if words else ""
