"""Costs of walking against a floor plan, as fields over its cells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pdr_filter.apps.maps.particle_clusters import weighted_moments
from pdr_filter.apps.maps.storey import CELL_M, LIFT, OUTSIDE, ROOM, STAIRS, WALL, Storey
from pdr_filter.values import BoolArray, FloatArray, check_numbers

_Field = NDArray[np.float32]
# Number of directions tested from each cell.
_N_DIRECTIONS = 16
# Standard deviation of the distance between a lift and the end of its ride: the first step out of the lift, and the
# error of a track over a few steps.
_LIFT_STD_M = 1.0


@dataclass(frozen=True)
class Terrain:
    """Costs of steps that contradict the floor plan.

    A cost is the negative logarithm of the probability of a step relative to a step in the open. No step is impossible,
    because plans lack doors and people enter shops.

    Attributes
    ----------
    wall : float, default 4.6
        Cost of crossing a wall.
    room : float, default 4.6
        Cost of entering a room without a door. At its edge, the cost rises over the depth `soft_m`.
    outside : float, default 6.0
        Cost of leaving the outline of the storey.
    stay_room : float, default 0.3
        Cost of each step that ends in a room without a door, or in a wall.
    stay_outside : float, default 1.0
        Cost of each step that ends outside the outline.
    off_stairs : float, default 2.3
        Cost of a step on stairs away from the drawn stairs.
    off_lift : float, default 4.6
        Cost of a ride in a lift away from the drawn lifts.
    soft_m : float, default 0.5
        Accuracy of drawn edges.
    look_m : float, default 3.0
        Distance that must be free for a direction to count as free.
    leg_m : float, default 6.0
        Distance after which the pedestrian chooses a new direction.

    Raises
    ------
    ValueError
        If a cost is negative or a distance is not positive.

    Notes
    -----
    4.6 is the negative logarithm of a hundredth. One crossing at this cost allows a walk that goes straight on for some
    ten metres to win against a walk that would have to turn at the wall. The exact value matters little. Costs of 2.3,
    4.6 and 9 for wall and room gave median errors of 2.70, 2.60 and 2.61 m on storey F1 of the mall.

    `stay_room` and `stay_outside` replace the information that walls give in a corridor. Inside a room, a wall or
    outside, no wall distinguishes a wrong path from a right one. The costs are those that noisy steps in a corridor
    have on average. `stay_room` was chosen among 0 to 1 on storey F1 of the mall. `stay_outside` is a judgement, made
    after a look at the office of humolire.

    Every `leg_m`, the pedestrian chooses among the directions in which `look_m` is free. A step that stays in a
    corridor, where few directions are free, is therefore stronger evidence than a step in a hall. Of `look_m` of 1.5,
    3, 5 and 10 m, each with an equal `leg_m`, 3 m had the smallest errors on storeys F1 and B1 of the mall. `leg_m` of
    3 m has smaller errors there than 6 m, but not on the other storeys. However, two of nine walks through the office
    of humolire with unknown start were then wrong with a small covariance; with 6 m none.

    Examples
    --------
    >>> from pdr_filter.apps.maps.crossing_costs import Terrain
    >>> Terrain().wall
    4.6
    >>> Terrain(room=2.3).room  # rooms that are often entered
    2.3
    """

    wall: float = 4.6
    room: float = 4.6
    outside: float = 6.0
    stay_room: float = 0.3
    stay_outside: float = 1.0
    off_stairs: float = 2.3
    off_lift: float = 4.6
    soft_m: float = 0.5
    look_m: float = 3.0
    leg_m: float = 6.0

    def __post_init__(self) -> None:
        check_numbers(self, zero=("wall", "room", "outside", "stay_room", "stay_outside", "off_stairs", "off_lift"))


@dataclass(frozen=True, eq=False)
class Ground:
    """Cost fields of one storey."""

    storey: Storey
    terrain: Terrain

    @cached_property
    def height(self) -> _Field:
        """Cost of being in each cell of the storey, as a flattened array (n_rows n_columns,).

        A step pays for an increase of this field. A decrease is free, so leaving a room costs nothing.
        """
        from scipy.ndimage import distance_transform_edt  # imported late: a filter without a plan need not load SciPy

        cells, terrain = self.storey.cells, self.terrain
        closed = (cells == ROOM) | (cells == OUTSIDE)
        share = np.minimum(CELL_M / terrain.soft_m * np.asarray(distance_transform_edt(closed)), 1.0)
        top = np.zeros(OUTSIDE + 1)
        top[[ROOM, WALL, OUTSIDE]] = terrain.room, terrain.wall, terrain.outside
        return np.asarray(top[cells] * np.where(closed, share, 1.0), dtype=np.float32).ravel()

    def choice_cost(self, from_m: FloatArray, length_m: float) -> FloatArray:
        """Return the expected cost (N,) of a step from positions (N, 2) if the pedestrian chose any direction.

        The pedestrian chooses a direction every `Terrain.leg_m`. The cost of that choice is prorated to the step length
        `length_m`. Off the grid it is zero.
        """
        index, inside = self.storey.index(from_m)
        return length_m / self.terrain.leg_m * np.where(inside, self._choice_costs[index], 0.0)

    @cached_property
    def walkable_moments(self) -> tuple[FloatArray, FloatArray]:
        """Mean (2,) in m and covariance (2, 2) in m^2 of a position that is uniform over the walkable cells."""
        position_m = self.storey.middles_m[self.storey.cells <= LIFT]
        return weighted_moments(position_m, np.full(len(position_m), 1.0 / len(position_m)))

    @cached_property
    def mean_cost_per_m(self) -> float:
        """Mean cost per metre of a random walk: from any walkable cell, in any direction."""
        walkable = self.storey.cells.ravel() <= LIFT
        return (
            -float(np.log(np.exp(-self._choice_costs[walkable]).mean())) / self.terrain.look_m
            if walkable.any()
            else 0.0
        )

    @cached_property
    def _choice_costs(self) -> _Field:
        """Cost (n_rows n_columns,) of walking `look_m` straight on from each cell, averaged over all directions."""
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
        """Return the cost (...) of being at positions (..., 2) in m, off the grid the cost of leaving the outline."""
        index, inside = self.storey.index(position_m)
        return np.where(inside, self.height[index], self.terrain.outside)

    def is_closed(self, position_m: FloatArray) -> BoolArray:
        """Return True for each position (..., 2) in m in a wall, in a hole of the plan, or outside the outline."""
        kind = self.storey.kind_at(position_m)
        return (kind == WALL) | (kind == OUTSIDE)

    def is_off_plan(self, position_m: FloatArray, weight: FloatArray) -> bool:
        """Return True if most of the weight (N,) of positions (N, 2) in m is where `is_closed`."""
        return float(weight @ self.is_closed(position_m)) > 0.5

    @cached_property
    def _to_lift_m(self) -> _Field:
        """Distance in m of each cell from the nearest lift, as a flattened array (n_rows n_columns,)."""
        from scipy.ndimage import distance_transform_edt

        return CELL_M * np.asarray(distance_transform_edt(self.storey.cells != LIFT), dtype=np.float32).ravel()

    def lift_costs(self, position_m: FloatArray) -> FloatArray:
        """Return the cost (N,) of having left a lift at positions (N, 2).

        The distance to the nearest drawn lift has a normal likelihood with a standard deviation of one metre. The cost
        is limited by `Terrain.off_lift`, and zero on a storey without lifts.
        """
        if not (self.storey.cells == LIFT).any():
            return np.zeros(len(position_m))
        index, inside = self.storey.index(position_m)
        away_m = np.where(inside, self._to_lift_m[index], np.inf)
        return -np.logaddexp(-0.5 * (away_m / _LIFT_STD_M) ** 2, -self.terrain.off_lift)

    def costs(self, from_m: FloatArray, to_m: FloatArray, on_stairs: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Return the costs (N,) of steps from (N, 2) to (N, 2), and the part of them that comes from crossings (N,).

        The path is sampled in every cell, so that no wall lies between two samples.
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
