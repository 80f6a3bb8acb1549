"""Colours of all pictures: figures, HTML pages, documentation and studies.

The first six context colours were selected from common colour-blind safe palettes. The other six were selected from all
colours of moderate chroma. Any two of the twelve differ by at least 18 in CIE Lab, for normal vision and for the three
kinds of dichromacy.
"""

from __future__ import annotations

from collections.abc import Iterable

from pdr_filter.values import CONTEXTS

GREY, BLUE, ORANGE, GREEN, YELLOW, PURPLE = COLOURS = ("#D0D0D0", "#0072B2", "#CC6600", "#44AA99", "#EECC66", "#882255")
MORE_COLOURS = ("#99DD99", "#443300", "#112288", "#888855", "#9988FF", "#00DDFF")
WITHOUT_STEPS = "#707880"  # moving without steps; as far from the contexts as they are from each other
INK = "#222222"  # texts, outlines, ground truth
FAINT = "#777777"  # remarks, baselines
GRID = "#E6E6E6"
WRONG = "#AA0000"  # rejected or unusual values
ELLIPSE = "#556677"  # outline and fill, with the opacities below
# Areas of floor plans are pale, so that a track is visible on them. Lines are visible on a picture of the plan.
WALL = "#6E675B"
PLAN_COLOURS = {
    "floor": "#FBFAF6",
    "room": "#E4DFD3",
    "stairs": "#D3E0EC",
    "lift": "#E8D8E4",
    "wall": "#B7B0A2",
    "door": "#3F9142",
}
PLAN_WIDTHS = {"wall": 2.5, "door": 5.0}  # widths of lines in pixels
ELLIPSE_EDGE_ALPHA, BAND_ALPHA = 0.6, 0.2


def context_colours(contexts: tuple[str, ...] = CONTEXTS) -> dict[str, str]:
    """Return a colour for each context.

    Colours depend on the position of a context, so that a context has the same colour in all figures and reports.

    Parameters
    ----------
    contexts : tuple of str, default CONTEXTS
        Names of the contexts, in the order of the probability columns.

    Returns
    -------
    dict of str to str
        Colour of each context, as "#rrggbb". Colours repeat after twelve contexts.

    Examples
    --------
    >>> from pdr_filter.apps.report.palette import context_colours
    >>> context_colours(("standing", "walking"))
    {'standing': '#D0D0D0', 'walking': '#0072B2'}
    """
    colours = (*COLOURS, *MORE_COLOURS)
    return {name: colours[i % len(colours)] for i, name in enumerate(contexts)}


# Colours of storeys from the lowest up: viridis, which is perceptually uniform, also for colour-blind readers, and
# contains none of the context colours.
_FLOORS = ("#440154", "#3B528B", "#21918C", "#5EC962", "#FDE725")


def floor_colours(floors: Iterable[int]) -> dict[int, str]:
    """Return the colour of each storey as #rrggbb, from the lowest up. Colours repeat if there are more than five."""
    ordered = sorted(set(floors))
    at = [round(i * (len(_FLOORS) - 1) / max(len(ordered) - 1, 1)) for i in range(len(ordered))]
    return {
        floor: _FLOORS[at[i] if len(ordered) <= len(_FLOORS) else i % len(_FLOORS)] for i, floor in enumerate(ordered)
    }
