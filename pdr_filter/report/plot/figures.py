"""New axes, and figures as files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure

from pdr_filter.io.files.safe_files import whole_file
from pdr_filter.report.palette import GRID

# Journals refuse the Type 3 fonts that matplotlib makes of its own accord: this embeds the font itself.
_TRUETYPE = 42


# Names and notes come from files: a "$" in them begins no formula.
AS_IT_IS: dict[str, Any] = {"parse_math": False}


def beside(axes: Axes, handles: Sequence[Artist]) -> None:
    """A legend to the right of axes, where it covers nothing."""
    axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, frameon=False)


def new_figure(size_in: tuple[float, float]) -> Figure:
    """A figure that belongs to no window."""
    figure = Figure(figsize=size_in, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def given_or_new(ax: Axes | None, size_in: tuple[float, float] = (5.6, 3.6)) -> Axes:
    """The axes, or those of a new figure; without the frame that says nothing."""
    axes = new_figure(size_in).add_subplot() if ax is None else ax
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def lined(axes: Axes) -> None:
    """A grid below what is drawn."""
    axes.grid(color=GRID, linewidth=0.7)
    axes.set_axisbelow(True)


def check_picture(path: str | Path) -> Path:
    """The path; ValueError if matplotlib makes no pictures with its suffix."""
    path, known = Path(path), FigureCanvasAgg.get_supported_filetypes()
    if path.suffix and path.suffix[1:].lower() not in known:
        raise ValueError(f"{path}: no kind of picture, got {path.suffix!r}; use .png, .pdf, .svg or none")
    return path


def save(figure: Figure | SubFigure | Axes | None, path: str | Path) -> Path:
    """Save a figure, or that of axes, with its fonts, and return the path; the suffix gives the format."""
    whole = figure.get_figure(root=True) if isinstance(figure, Axes | SubFigure) else figure
    if not isinstance(whole, Figure):
        raise ValueError(f"figure must be a figure or axes that belong to one, got {figure!r}")
    path = check_picture(path)
    with rc_context({"pdf.fonttype": _TRUETYPE, "ps.fonttype": _TRUETYPE}), whole_file(path) as file:
        whole.savefig(file, dpi=120, format=path.suffix.removeprefix(".") or None)
    return path
