"""Where a walk on a plan begins: at a place, in a room, or anywhere on a storey."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from pdr_filter.maps.floor_plan import FloorPlan
from pdr_filter.maps.storey import CELL_M, LIFT, ROOM
from pdr_filter.values import FloatArray, IntArray, PositionFix, read_only

ANYWHERE = "anywhere"


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Either a place with its covariance, or cells, each as probable."""

    floor: int
    position_m: FloatArray  # (2,) the place, or the south-west corner of the grid
    cov_m2: FloatArray  # (2, 2)
    cells: IntArray  # (K, 2) column and row; none for a place

    def draw(self, rng: Generator, n: int) -> FloatArray:
        """Positions (n, 2)."""
        if len(self.cells) == 0:
            return self.position_m + rng.standard_normal((n, 2)) @ np.linalg.cholesky(self.cov_m2).T
        # each cell in turn, so that no part of the storey is empty by chance
        of = self.cells[
            np.minimum((np.arange(n) + rng.random()) * len(self.cells) / n, len(self.cells) - 1).astype(int)
        ]
        return self.position_m + CELL_M * (of + rng.random((n, 2)))


def start_of(plan: FloorPlan, start: PositionFix | str) -> Start:
    """The start that somebody gives; ValueError if the plan does not have it."""
    if isinstance(start, PositionFix):
        floor = plan.storeys[0].floor if start.floor is None else start.floor
        if plan.storey(floor) is None or (start.floor is None and len(plan.storeys) > 1):
            floors = [s.floor for s in plan.storeys]
            raise ValueError(f"the plan has floors {floors}, got a start on {start.floor}: give the fix one of them")
        return Start(floor, start.position_m, start.cov_m2, np.empty((0, 2), dtype=np.int64))
    if start == ANYWHERE:
        if len(plan.storeys) > 1 and plan.storey(0) is None:
            raise ValueError('start="anywhere" is on storey 0, which the plan does not have: give a place or a name')
        storey = plan.storeys[0] if len(plan.storeys) == 1 else plan.storey(0)
        if storey is None:
            raise ValueError(f"the plan has no storey, got {plan.name!r}: draw one")
        where = storey.cells <= LIFT
    else:
        found = [(s, f) for s in plan.storeys for f in s.features if f.name == start and f.is_area]
        if not found:
            names = sorted({f.name for s in plan.storeys for f in s.features if f.name and f.is_area})
            some = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
            raise ValueError(
                f'start must be a PositionFix, "anywhere" or the name of an area, got {start!r}; has {some}'
            )
        storey = found[0][0]
        inside = np.zeros(storey.cells.shape, dtype=bool)
        for s, feature in found:
            if s is storey:
                inside |= feature.contains(storey.middles_m)
        where = inside & (storey.cells <= ROOM)
    row, column = np.nonzero(where)
    if len(row) == 0:
        raise ValueError(f"nobody can stand in {start!r}: it has no cell of {CELL_M} m; draw it larger")
    return Start(storey.floor, storey.south_west_m, read_only(np.zeros((2, 2))), np.column_stack([column, row]))
