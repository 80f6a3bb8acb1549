"""Creation of figures and axes, and saving to files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure

from pdr_filter.apps.report.palette import GRID
from pdr_filter.values.safe_files import whole_file

# Embed TrueType fonts, because journals reject the Type 3 fonts that matplotlib writes by default.
_TRUETYPE = 42


# Text options for names and notes from files, in which a "$" does not start a formula.
PLAIN_TEXT: dict[str, Any] = {"parse_math": False}


def add_legend(axes: Axes, handles: Sequence[Artist]) -> None:
    """Add a legend to the right of axes, where it covers no data."""
    axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, frameon=False)


def new_figure(size_in: tuple[float, float]) -> Figure:
    """Return a figure of this size in inches that belongs to no window."""
    figure = Figure(figsize=size_in, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def given_or_new(ax: Axes | None, size_in: tuple[float, float] = (5.6, 3.6)) -> Axes:
    """Return `ax`, or the axes of a new figure of this size, without the top and right frame lines."""
    axes = new_figure(size_in).add_subplot() if ax is None else ax
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def add_grid(axes: Axes) -> None:
    """Add a grid behind the data."""
    axes.grid(color=GRID, linewidth=0.7)
    axes.set_axisbelow(True)


def check_picture(path: str | Path) -> Path:
    """Return the path. ValueError if matplotlib does not support its suffix."""
    path, known = Path(path), FigureCanvasAgg.get_supported_filetypes()
    if path.suffix and path.suffix[1:].lower() not in known:
        raise ValueError(f"{path}: pictures with the suffix {path.suffix!r} are not supported; use .png, .pdf or .svg")
    return path


def save(figure: Figure | SubFigure | Axes | None, path: str | Path) -> Path:
    """Save a figure, or the figure of axes, with embedded fonts.

    Parameters
    ----------
    figure : matplotlib Figure, SubFigure or Axes
        Figure, or axes of the figure to save.
    path : str or Path
        File to write. The suffix gives the format: .png, .pdf, .svg and others that matplotlib supports. Missing
        folders are created.

    Returns
    -------
    Path
        Path of the file.

    Raises
    ------
    ValueError
        If the suffix is not supported, or if `figure` is not a figure.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> ax = pdr.plot.nees(np.array([0.5, 1.0, 3.0]))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     print(pdr.plot.save(ax, f"{folder}/nees.pdf").name)
    nees.pdf
    """
    whole = figure.get_figure(root=True) if isinstance(figure, Axes | SubFigure) else figure
    if not isinstance(whole, Figure):
        raise ValueError(
            "figure must be a matplotlib Figure or Axes of a figure, got "
            f"{figure!r}; pass the result of a plot function"
        )
    path = check_picture(path)
    with rc_context({"pdf.fonttype": _TRUETYPE, "ps.fonttype": _TRUETYPE}), whole_file(path) as file:
        whole.savefig(file, dpi=120, format=path.suffix.removeprefix(".") or None)
    return path
