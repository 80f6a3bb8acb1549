"""What it costs to walk against a floor plan, as fields over its cells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pdr_filter.maps.storey import CELL_M, LIFT, OUTSIDE, ROOM, STAIRS, WALL, Storey
from pdr_filter.values import BoolArray, FloatArray, check_numbers

_Field = NDArray[np.float32]
# Directions that are looked in from each cell.
_N_DIRECTIONS = 16
# How far from a lift its ride seems to end: the first step out of it, and what a track is off within a few steps.
_BESIDE_M = 1.0


@dataclass(frozen=True)
class Terrain:
    """Costs of a step, minus logarithms of how much less probable it is than one in the open.

    Nothing is impossible: plans lack doors, and people enter shops. A hundredth for each wall and each room lets a walk
    that goes on for some ten metres where the plan says no win against one that would have to turn there. How dear
    they are matters little: with 2.3, 4.6 and 9 for wall and room the median error on storey F1 of the mall was 2.70,
    2.60 and 2.61 m.
    """

    wall: float = 4.6
    room: float = 4.6  # of entering one without a door; its stairs to the depth of `soft_m`
    outside: float = 6.0  # of leaving the outline
    # Of each step in a room, in masonry or beyond the outline, where no wall tells a wrong way from a right one: what
    # the steps of somebody in a corridor cost, because their noise leads into walls. That of rooms was chosen among 0
    # to 1 on storey F1 of the mall. That of the outside is a judgement, made after a look at the office of humolire.
    stay_room: float = 0.3
    stay_outside: float = 1.0
    off_stairs: float = 2.3  # of a step on stairs beside those that are drawn
    off_lift: float = 4.6  # of a ride in a lift somewhere else than in those that are drawn
    soft_m: float = 0.5  # how well edges are drawn
    # People choose where to go anew every `leg_m`, among the directions in which `look_m` are free. In a corridor
    # there are few: steps that stay in it say more for it than steps in a hall say for the hall. On storeys F1
    # and B1 of the mall looks of 1.5, 3, 5 and 10 m, each as long as the leg, were tried: 3 m had the smallest
    # errors. Legs of 3 m have smaller ones there than of 6 m, not on the other storeys, and were wrong and sure
    # on two walks of nine through the office of humolire whose start was not known; 6 m on none.
    look_m: float = 3.0
    leg_m: float = 6.0

    def __post_init__(self) -> None:
        check_numbers(self, zero=("wall", "room", "outside", "stay_room", "stay_outside", "off_stairs", "off_lift"))


@dataclass(frozen=True, eq=False)
class Ground:
    """One storey under the feet of particles."""

    storey: Storey
    terrain: Terrain

    @cached_property
    def height(self) -> _Field:
        """Cost of being in each cell, flat: a step pays for what it climbs, and goes down for nothing."""
        from scipy.ndimage import distance_transform_edt  # here, because a filter without a plan need not load SciPy

        cells, terrain = self.storey.cells, self.terrain
        closed = (cells == ROOM) | (cells == OUTSIDE)
        share = np.minimum(CELL_M / terrain.soft_m * np.asarray(distance_transform_edt(closed)), 1.0)
        top = np.zeros(OUTSIDE + 1)
        top[[ROOM, WALL, OUTSIDE]] = terrain.room, terrain.wall, terrain.outside
        return np.asarray(top[cells] * np.where(closed, share, 1.0), dtype=np.float32).ravel()

    def of_anybody(self, from_m: FloatArray, length_m: float) -> FloatArray:
        """What a step from positions (N, 2) would cost if people chose any direction, (N,): as a share of a leg."""
        index, inside = self.storey.index(from_m)
        return length_m / self.terrain.leg_m * np.where(inside, self._of_looks[index], 0.0)

    @cached_property
    def of_storey(self) -> float:
        """What a metre costs on average who knows nothing of the plan: from anywhere, in any direction."""
        walkable = self.storey.cells.ravel() <= LIFT
        return -float(np.log(np.exp(-self._of_looks[walkable]).mean())) / self.terrain.look_m if walkable.any() else 0.0

    @cached_property
    def _of_looks(self) -> _Field:
        """Minus the logarithm of the mean probability of going `look_m` from each cell, over all directions, flat."""
        n_rows, n_columns = self.storey.cells.shape
        height, n = self.height.reshape(n_rows, n_columns), round(self.terrain.look_m / CELL_M)
        around = np.pad(height, n, constant_values=self.terrain.outside)
        prob = np.zeros_like(height)
        for angle_rad in np.arange(_N_DIRECTIONS) * (2.0 * np.pi / _N_DIRECTIONS):
            top = height.copy()
            for k in range(1, n + 1):
                row, column = n + round(k * np.cos(angle_rad)), n + round(k * np.sin(angle_rad))
                np.maximum(top, around[row : row + n_rows, column : column + n_columns], out=top)
            prob += np.exp(height - top)
        return -np.log(prob / _N_DIRECTIONS).ravel()

    def heights(self, position_m: FloatArray) -> FloatArray:
        """Cost of being at positions (..., 2)."""
        index, inside = self.storey.index(position_m)
        return np.where(inside, self.height[index], self.terrain.outside)

    @cached_property
    def _to_lift_m(self) -> _Field:
        """Distance of each cell from the nearest lift, flat."""
        from scipy.ndimage import distance_transform_edt

        return CELL_M * np.asarray(distance_transform_edt(self.storey.cells != LIFT), dtype=np.float32).ravel()

    def lift_costs(self, position_m: FloatArray) -> FloatArray:
        """Cost of having left a lift at positions (N, 2): that of where lifts and doors are about a metre away."""
        if not (self.storey.cells == LIFT).any():
            return np.zeros(len(position_m))
        index, inside = self.storey.index(position_m)
        away_m = np.where(inside, self._to_lift_m[index], np.inf)
        return -np.logaddexp(-0.5 * (away_m / _BESIDE_M) ** 2, -self.terrain.off_lift)

    def costs(self, from_m: FloatArray, to_m: FloatArray, on_stairs: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Cost of steps (N, 2) to (N, 2), and the part of it for what they went through, (N,) each.

        The way is looked at in every cell: no step is so long that a wall is between two looks.
        """
        from_m = np.ascontiguousarray(from_m)
        way_m = to_m - from_m
        n = int(np.ceil(np.abs(way_m).max(initial=0.0) / CELL_M)) + 1
        before = top = self.heights(from_m)
        for share in np.linspace(0.0, 1.0, n + 1)[1:]:
            top = np.maximum(top, self.heights(from_m + share * way_m))
        through = np.maximum(top - before, 0.0)
        kind = self.storey.kind_at(to_m)
        stays = self.terrain.stay_room * ((kind == ROOM) | (kind == WALL)) + self.terrain.stay_outside * (
            kind == OUTSIDE
        )
        cost = through + stays
        if self.storey.has_stairs and on_stairs.any():
            cost = cost + self.terrain.off_stairs * (on_stairs & (kind != STAIRS))
        return cost, through
