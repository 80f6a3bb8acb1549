"""The colours that all pictures share: figures, pages, those of the documentation and of the studies.

The first six of the contexts were chosen by search over the usual colour-blind safe palettes, the other six by search
over all colours of moderate chroma. Any two of the twelve differ by 18 or more in CIE Lab for normal sight and for the
three dichromacies.
"""

from __future__ import annotations

from collections.abc import Iterable

from pdr_filter.values import CONTEXTS

GREY, BLUE, ORANGE, GREEN, YELLOW, PURPLE = COLOURS = ("#D0D0D0", "#0072B2", "#CC6600", "#44AA99", "#EECC66", "#882255")
MORE_COLOURS = ("#99DD99", "#443300", "#112288", "#888855", "#9988FF", "#00DDFF")
INK = "#222222"  # words, outlines, the truth
FAINT = "#777777"  # remarks, what others are compared with
GRID = "#E6E6E6"
WRONG = "#AA0000"  # what was rejected, what is odd
ELLIPSE = "#556677"  # outline and fill, with these opacities
# Of floor plans: pale, so that a track is seen on them.
WALL = "#8A8478"
PLAN_COLOURS = {
    "floor": "#FBFAF6",
    "room": "#E4DFD3",
    "stairs": "#D3E0EC",
    "lift": "#E8D8E4",
    "wall": "#B7B0A2",
    "door": "#9BC29B",
}
ELLIPSE_EDGE_ALPHA, ELLIPSE_FILL_ALPHA = 0.6, 0.09


def context_colours(contexts: tuple[str, ...] = CONTEXTS) -> dict[str, str]:
    """Colour of each context, as #rrggbb, by its place; with more than twelve contexts the colours begin again."""
    colours = (*COLOURS, *MORE_COLOURS)
    return {name: colours[i % len(colours)] for i, name in enumerate(contexts)}


# Of storeys from the lowest up: viridis, which is even for all kinds of sight and has none of the colours of contexts.
_FLOORS = ("#440154", "#3B528B", "#21918C", "#5EC962", "#FDE725")


def floor_colours(floors: Iterable[int]) -> dict[int, str]:
    """Colour of each storey, from the lowest up, as #rrggbb; with more than five storeys they begin again."""
    ordered = sorted(set(floors))
    at = [round(i * (len(_FLOORS) - 1) / max(len(ordered) - 1, 1)) for i in range(len(ordered))]
    return {
        floor: _FLOORS[at[i] if len(ordered) <= len(_FLOORS) else i % len(_FLOORS)] for i, floor in enumerate(ordered)
    }
