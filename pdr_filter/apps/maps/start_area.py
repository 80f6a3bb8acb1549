"""Start of a walk on a floor plan: a position, a room, or a whole storey."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from pdr_filter.apps.maps.storey import CELL_M, LIFT, ROOM, Storey, Storeys
from pdr_filter.values import BoolArray, FloatArray, IntArray, PositionFix, read_only

ANYWHERE = "anywhere"


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Distribution of the start: a normal distribution, or a uniform one over cells."""

    floor: int
    position_m: FloatArray  # (2,) mean, or the south-west corner of the grid
    cov_m2: FloatArray  # (2, 2)
    cells: IntArray  # (K, 2) column and row of each start cell, empty for a start position

    def draw(self, rng: Generator, n: int) -> FloatArray:
        """Return `n` positions (n, 2) drawn from the distribution."""
        if len(self.cells) == 0:
            return self.position_m + rng.standard_normal((n, 2)) @ np.linalg.cholesky(self.cov_m2).T
        # stratified over the cells, so that no part of the storey stays empty by chance
        of = self.cells[
            np.minimum((np.arange(n) + rng.random()) * len(self.cells) / n, len(self.cells) - 1).astype(int)
        ]
        return self.position_m + CELL_M * (of + rng.random((n, 2)))


def start_distribution(plan: Storeys, start: PositionFix | str) -> Start:
    """Return the start distribution for a position fix, "anywhere", or the name of an area.

    "anywhere" is uniform over the walkable cells of storey 0, or of the only storey. An area is all polygons of this
    name on the lowest storey that has one, without walls and cells outside the outline. Raises ValueError if the plan
    does not have the storey or the area, or if the area has no cell.
    """
    if isinstance(start, PositionFix):
        floor = plan.storeys[0].floor if start.floor is None else start.floor
        if plan.storey(floor) is None or (start.floor is None and len(plan.storeys) > 1):
            floors = [s.floor for s in plan.storeys]
            raise ValueError(
                f"the plan has the floors {floors}, got a start on floor {start.floor}: set the floor of the fix to "
                "one of them"
            )
        return Start(floor, start.position_m, start.cov_m2, np.empty((0, 2), dtype=np.int64))
    if start == ANYWHERE:
        storey = plan.storeys[0] if len(plan.storeys) == 1 else plan.storey(0)
        if storey is None:
            raise ValueError(
                'start="anywhere" means storey 0, which the plan does not have: give a position or the name of an area'
            )
        return anywhere_on(storey)
    found = [(s, f) for s in plan.storeys for f in s.features if f.name == start and f.is_area]
    if not found:
        names = sorted({f.name for s in plan.storeys for f in s.features if f.name and f.is_area})
        some = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "") if names else "no named area"
        raise ValueError(
            f'start must be a PositionFix, "anywhere" or the name of an area, got {start!r}; the plan has {some}'
        )
    storey = found[0][0]
    inside = [feature.contains(storey.middles_m) for s, feature in found if s is storey]
    return _start_in(storey, np.any(inside, axis=0) & (storey.cells <= ROOM), start)


def anywhere_on(storey: Storey) -> Start:
    """Return the uniform start distribution over the walkable cells of a storey."""
    return _start_in(storey, storey.cells <= LIFT, ANYWHERE)


def _start_in(storey: Storey, where: BoolArray, start: str) -> Start:
    """Return the uniform distribution over cells of a storey. ValueError names `start` if there are none."""
    row, column = np.nonzero(where)
    if len(row) == 0:
        raise ValueError(
            f"the area {start!r} contains no walkable cell of {CELL_M} m: it is too small, inside walls or outside of "
            "the outline; draw it larger, or move it to where people can walk"
        )
    return Start(storey.floor, storey.south_west_m, read_only(np.zeros((2, 2))), np.column_stack([column, row]))
