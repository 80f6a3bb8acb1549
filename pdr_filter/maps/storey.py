"""One storey of a floor plan: what is where, as shapes to draw and as a grid to walk on."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdr_filter.values import BoolArray, FloatArray, IntArray

# What a cell is. Those up to `LIFT` are walked on.
FREE, STAIRS, LIFT, ROOM, WALL, OUTSIDE = range(6)
# Side of a cell: plans are off by more, and 300 m x 300 m are 2.3 million cells.
CELL_M = 0.2
# Room around what is drawn.
MARGIN_M = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Feature:
    """One shape of a plan."""

    kind: str  # "floor", "wall", "room", "door", "stairs" or "lift"
    name: str  # empty if it has none
    lines: tuple[FloatArray, ...]  # (N, 2) each, east and north: rings of an area, or the lines of a wall
    is_area: bool

    def contains(self, position_m: FloatArray) -> BoolArray:
        """Whether positions (..., 2) are in the area: a ray to the east crosses its rings an odd number of times."""
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
    """One storey: its shapes, and the same as cells."""

    floor: int
    features: tuple[Feature, ...]
    south_west_m: FloatArray  # (2,) corner of the first cell
    cells: NDArray[np.uint8]  # (rows to the north, columns to the east): FREE, STAIRS, LIFT, ROOM, WALL or OUTSIDE

    @property
    def has_stairs(self) -> bool:
        """Whether stairs are drawn."""
        return any(f.kind == "stairs" for f in self.features)

    @property
    def middles_m(self) -> FloatArray:
        """Middle of each cell, (rows, columns, 2)."""
        n_rows, n_columns = self.cells.shape
        east, north = np.meshgrid(np.arange(n_columns) + 0.5, np.arange(n_rows) + 0.5)
        return self.south_west_m + CELL_M * np.stack([east, north], axis=-1)

    def index(self, position_m: FloatArray) -> tuple[IntArray, BoolArray]:
        """Flat index of the cell of each position (..., 2), and whether it is on the grid; off it the index is 0."""
        # axis by axis: loops over the two of each position take three times as long
        column, row = ((position_m[..., k] - self.south_west_m[k]) / CELL_M for k in range(2))
        n_rows, n_columns = self.cells.shape
        inside = (row >= 0) & (row < n_rows) & (column >= 0) & (column < n_columns)
        # on the grid the whole part is the floor
        column, row = column.astype(np.int64), row.astype(np.int64)
        return np.where(inside, row * n_columns + column, 0), inside

    def kind_at(self, position_m: FloatArray) -> IntArray:
        """What is at positions (..., 2)."""
        index, inside = self.index(position_m)
        return np.where(inside, self.cells.ravel()[index], OUTSIDE)

    def summary(self) -> dict[str, Any]:
        """What it was understood to be."""
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

    def what_is_near(self, position_m: FloatArray) -> tuple[str, str]:
        """What a walk that ends at a position (2,) has gone through: "room", "outline" or "wall", and its name."""
        kind = int(self.kind_at(position_m))
        if kind == OUTSIDE:
            return "outline", ""
        if kind != ROOM:
            return "wall", ""
        about = [f for f in self.features if f.kind == "room" and f.contains(position_m)]
        return "room", about[-1].name if about else ""
