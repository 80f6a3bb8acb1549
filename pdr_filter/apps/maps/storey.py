"""One storey of a floor plan, as shapes to draw and as a grid of cells to walk on."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pdr_filter.values import BoolArray, FloatArray, IntArray, Plan

# Kinds of cells. Cells up to `LIFT` are walkable.
FREE, STAIRS, LIFT, ROOM, WALL, OUTSIDE = range(6)
# Cell size. Plans have larger errors, and 300 m x 300 m are 2.3 million cells.
CELL_M = 0.2
# Margin of the grid around the drawn features.
MARGIN_M = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Feature:
    """One shape of a floor plan."""

    kind: str  # "floor", "wall", "room", "door", "stairs" or "lift"
    name: str  # or an empty string
    lines: tuple[FloatArray, ...]  # (N, 2) east and north in m: the rings of an area, or the lines of a wall
    is_area: bool

    def contains(self, position_m: FloatArray) -> BoolArray:
        """Return True for each position (..., 2) inside the area. Lines contain no position.

        A position is inside if a ray to the east crosses the rings an odd number of times.
        """
        east, north = position_m[..., 0], position_m[..., 1]
        inside = np.zeros(east.shape, dtype=bool)
        for ring in self.lines if self.is_area else ():
            for (x0, y0), (x1, y1) in pairwise(ring):
                if y0 != y1:
                    beside = (north >= min(y0, y1)) & (north < max(y0, y1))
                    inside ^= beside & (east < x0 + (north - y0) / (y1 - y0) * (x1 - x0))
        return inside


@dataclass(frozen=True, eq=False)
class Storey:
    """One storey of a floor plan: its shapes and its grid of cells."""

    floor: int  # 0 for the ground floor
    features: tuple[Feature, ...]  # shapes as drawn
    south_west_m: FloatArray  # (2,) corner of the first cell
    cells: NDArray[np.uint8]  # kind of each cell, such as FREE; rows run north and columns east

    @property
    def has_stairs(self) -> bool:
        """True if the plan shows stairs on this storey."""
        return any(f.kind == "stairs" for f in self.features)

    @property
    def middles_m(self) -> FloatArray:
        """Centre of each cell, shape (rows, columns, 2)."""
        n_rows, n_columns = self.cells.shape
        east, north = np.meshgrid(np.arange(n_columns) + 0.5, np.arange(n_rows) + 0.5)
        return self.south_west_m + CELL_M * np.stack([east, north], axis=-1)

    def index(self, position_m: FloatArray) -> tuple[IntArray, BoolArray]:
        """Return the flat index of the cell of each position (..., 2), and whether the position is on the grid.

        The index is 0 for positions off the grid.
        """
        # axis by axis, because broadcasting over the pairs takes three times as long
        column, row = ((position_m[..., k] - self.south_west_m[k]) / CELL_M for k in range(2))
        n_rows, n_columns = self.cells.shape
        inside = (row >= 0) & (row < n_rows) & (column >= 0) & (column < n_columns)
        # truncation equals the floor for positions on the grid, and is faster
        column, row = column.astype(np.int64), row.astype(np.int64)
        return np.where(inside, row * n_columns + column, 0), inside

    def kind_at(self, position_m: FloatArray) -> IntArray:
        """Return the kind of the cell at each position (..., 2), OUTSIDE off the grid."""
        index, inside = self.index(position_m)
        return np.where(inside, self.cells.ravel()[index], OUTSIDE)

    def summary(self) -> dict[str, Any]:
        """Return a summary of the interpreted storey, as a dict for JSON.

        It has the number of the storey, its width and height in m, the number of features per kind, whether an outline
        is drawn, and the walkable area in m^2.
        """
        kinds = sorted({f.kind for f in self.features})
        height_m, width_m = (round(n * CELL_M - 2 * MARGIN_M, 1) for n in self.cells.shape)
        walkable_m2 = float((self.cells <= LIFT).sum()) * CELL_M**2
        return {
            "floor": self.floor,
            "width_m": width_m,
            "height_m": height_m,
            "features": {kind: sum(f.kind == kind for f in self.features) for kind in kinds},
            "has_outline": any(f.kind == "floor" for f in self.features),
            "walkable_m2": round(walkable_m2, 1),
        }

    def crossed_feature(self, position_m: FloatArray) -> tuple[str, str]:
        """Return the kind and the name of the feature that a walk ending at a position (2,) has crossed.

        The kind is "room", "outline" or "wall". Only a room has a name.
        """
        kind = int(self.kind_at(position_m))
        if kind == OUTSIDE:
            return "outline", ""
        if kind != ROOM:
            return "wall", ""
        about = [f for f in self.features if f.kind == "room" and f.contains(position_m)]
        return "room", about[-1].name if about else ""


class Storeys(Plan, Protocol):
    """Floor plan with storeys, such as a `pdr_filter.FloorPlan`."""

    @property
    def storeys(self) -> tuple[Storey, ...]:
        """Storeys, the lowest first."""
        ...

    def storey(self, floor: int) -> Storey | None:
        """Return the storey with a number, or None if the plan does not have it."""
        ...
