"""Placing of walks: each walk as a rigid shape, joined to the placed ones where its scans leave a single place.

A walk is joined if the scans leave one place with `SURE` of the probability. The probability covers all positions on a
grid, all rotations, all storeys of the group, and a place outside of the map. Wrong pairs of scans are thus outvoted
before they are used, and ambiguous walks wait until more walks are placed. After each round the rigid shapes are
adjusted together with a robust loss. Then each walk is placed again by all others, and leaves the group if it fails.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

from pdr_filter.offline.robust_loss import weights as robust_weights
from pdr_filter.values import FloatArray, IntArray
from pdr_filter.walk_map.chains import Chain
from pdr_filter.walk_map.likeness import (
    PAIR_COSINE,
    fingerprint_matrix,
    log_ratio,
    ranges,
)

# All numbers were chosen on storey F1 of `ms_indoor`.
# Share of the probability that one place of a walk must have, and the radius of a place.
SURE, _PLACE_M = 0.8, 12.0
# Smallest cosine of the loud parts of two fingerprints of walks that are compared.
_PARTNER_COSINE = 0.4
# Weight of a pair of scans, because the pairs of a scan share its errors.
_PAIR_WEIGHT = 0.08
# Smallest number of scans of a walk that are similar to mapped scans. Fewer do not hold the walk in its place.
_MIN_SIMILAR = 3
# Standard deviation of the direction of a walk by its magnetometer, of the common deviation of all magnetic fields in
# a building, and of a rotation from a known heading.
_NORTH_STD_RAD, _COMMON_STD_RAD, _SEED_STD_RAD = 0.2, 0.12, 0.1
# Number of places outside of the map, each as probable as a cell of it.
_N_ELSEWHERE = 500
_CELL_M, _MARGIN_M, _MOST_M = 4.0, 50.0, 400.0
# Mapped scans that are compared: one for each square of this width, because neighbours have the same errors.
_THIN_M = 6.0
# Pairs of a scan in the adjustment, and the factor on their standard deviations.
_N_PAIRS, _INFLATION = 4, 4.0
# Walks that are adjusted together. Later walks are fitted to these, so that the cost grows linearly.
MOST_TOGETHER = 200
_MOST_ROUNDS = 60


@dataclass(slots=True)
class Pose:
    """Rigid place of a walk in a group: position = R(turn) own + shift, with a clockwise turn.

    `own` is the position of a point in the frame of the walk alone. `floor` is the storey of the start of the walk.
    """

    turn_rad: float
    shift_m: FloatArray
    floor: int = 0

    def of(self, own_m: FloatArray) -> FloatArray:
        """Return the positions (n, 2), in the frame of the group, of points (n, 2) in the frame of the walk alone."""
        return own_m @ turned(self.turn_rad) + self.shift_m


def turned(angle_rad: float) -> FloatArray:
    """Return the matrix M for which x @ M is the row vector x turned clockwise."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s], [s, c]])


@dataclass(slots=True)
class PlacedGroup:
    """Joined walks in one frame.

    `poses` has the rigid place of each walk, by the index of the walk. The walks in `seeds` define the frame and are
    never removed. `north_rad` is the deviation of the frame from magnetic north.
    """

    poses: dict[int, Pose]
    seeds: frozenset[int]
    north_rad: float = 0.0


@dataclass(slots=True)
class ScannedWalks:
    """Chains (walks reduced to knots and scans) with all their scans in one list, and one fingerprint matrix."""

    chains: Sequence[Chain]
    own_m: FloatArray  # (S, 2) positions of the scans in the frames of their walks
    floor: IntArray  # (S,) storeys relative to the starts of the walks
    owner: IntArray  # (S,) number of the walk of each scan
    heard: Any  # (S, A) sparse fingerprints
    first: IntArray  # first scan of each walk, and the number of scans
    partners: list[set[int]] = field(default_factory=list)

    @classmethod
    def of(cls, chains: Sequence[Chain]) -> ScannedWalks:
        """Return the scans, fingerprints and partners of chains, which are walks reduced to knots and scans."""
        counts = [len(c.scans) for c in chains]
        own = [c.position_m(c.scans.step) for c in chains]
        walks = cls(
            chains=chains,
            own_m=np.concatenate(own) if own else np.zeros((0, 2)),
            floor=np.concatenate([c.floor[c.scans.step] for c in chains]) if own else np.zeros(0, dtype=np.int64),
            owner=np.repeat(np.arange(len(chains)), counts),
            heard=fingerprint_matrix([c.scans for c in chains])[0],
            first=np.cumsum([0, *counts]),
        )
        walks.partners = _partners(walks)
        return walks

    def rows(self, walk: int) -> slice:
        """Return the slice of the scans of a walk, given the index of the walk."""
        return slice(int(self.first[walk]), int(self.first[walk + 1]))

    def scans_of(self, walks: Iterable[int]) -> IntArray:
        """Return the indices of the scans of several walks, those of each walk together."""
        return np.concatenate([np.arange(self.first[i], self.first[i + 1]) for i in walks])

    def cosines(self, rows: slice, others: IntArray) -> FloatArray:
        """Return the cosines (n, m) of the fingerprints of n scans of a walk with those of m other scans."""
        return (self.heard[rows] @ self.heard[others].T).toarray()


def _partners(walks: ScannedWalks) -> list[set[int]]:
    """Return for each walk the indices of the walks that recognise a place of it.

    Two walks do if the loud parts of any two of their scans have a cosine of `_PARTNER_COSINE` or more. Blocks of rows
    bound the memory of the sparse product.
    """
    found: list[set[int]] = [set() for _ in walks.chains]
    # the loudest access points suffice to find candidates, and keep the lists of the index short
    index = walks.heard.copy()
    index.data[index.data < 0.1] = 0.0
    index.eliminate_zeros()
    transposed = index.T.tocsr()
    for start in range(0, index.shape[0], 500):
        near = (index[start : start + 500] @ transposed).tocoo()
        good = near.data >= _PARTNER_COSINE
        a, b = walks.owner[near.row[good] + start], walks.owner[near.col[good]]
        for i, j in np.unique(np.column_stack([a, b]), axis=0).tolist():
            if i != j:
                found[i].add(j)
                found[j].add(i)
    return found


@dataclass(frozen=True, slots=True)
class Candidate:
    """Most probable place of a walk, its probability, and the centre of its scans there."""

    prob: float
    pose: Pose
    centre_m: FloatArray


def locate(walks: ScannedWalks, group: PlacedGroup, walk: int) -> Candidate | None:
    """Return the most probable pose of a walk in a group without this walk, or None if it recognises no place.

    A walk recognises a place if at least `_MIN_SIMILAR` of its scans are similar to scans of the group. `walk` is its
    index.
    """
    rows = walks.rows(walk)
    placed = [i for i in group.poses if i != walk and i in walks.partners[walk]]
    if not placed or rows.stop == rows.start:
        return None
    # all placed walks around count, because scans that do not fit rule places out
    near = set(placed).union(*(walks.partners[i] for i in placed)) & group.poses.keys() - {walk}
    others = walks.scans_of(sorted(near))
    at_m, floor = _placed(walks, group, others)
    kept = _thinned(at_m, floor)
    others, at_m, floor = others[kept], at_m[kept], floor[kept]
    cosine = walks.cosines(rows, others)
    n_similar = int((cosine.max(axis=1, initial=0.0) >= PAIR_COSINE).sum())
    if n_similar < _MIN_SIMILAR:
        return None
    own_m, own_floor = walks.own_m[rows], walks.floor[rows]
    best: list[tuple[float, float, Candidate]] = []
    knows_north = walks.chains[walk].knows_north
    turns = np.radians(np.arange(-32.0, 33.0, 8.0) if knows_north else np.arange(0.0, 360.0, 12.0))
    log_prior = -0.5 * (turns / _NORTH_STD_RAD) ** 2 if knows_north else np.zeros(len(turns))
    elsewhere = _N_ELSEWHERE * float(np.exp(log_prior).sum())
    low = np.maximum(at_m.min(axis=0) - _MARGIN_M, at_m.mean(axis=0) - _MOST_M)
    high = np.minimum(at_m.max(axis=0) + _MARGIN_M, at_m.mean(axis=0) + _MOST_M)
    shape = tuple(np.ceil((high - low) / _CELL_M).astype(int))
    cells = low + _CELL_M * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 2)
    distance_m = np.linalg.norm(cells[:, None] - at_m, axis=-1)
    for up in np.unique(floor[:, None] - own_floor[None, :]).tolist():
        of_scan = np.zeros((len(own_m), len(cells)))
        for storey in np.unique(own_floor).tolist():
            here, there = own_floor == storey, floor == storey + up
            if there.any():
                of_scan[here] = log_ratio(cosine[here][:, there], distance_m[:, there])
        maps = np.clip(_PAIR_WEIGHT * of_scan, -30.0, None).reshape(-1, *shape)
        best.append(_peak(maps, own_m, low, turns, log_prior, group.north_rad if knows_north else 0.0, up))
    top = max(log_max for log_max, _, _ in best)
    total = elsewhere * math.exp(-top) + sum(mass * math.exp(log_max - top) for log_max, mass, _ in best)
    log_max, mass, found = max(best, key=lambda b: b[0])
    prob = found.prob * mass * math.exp(log_max - top) / total
    return Candidate(prob, found.pose, found.centre_m)


def _peak(
    maps: FloatArray,
    own_m: FloatArray,
    low_m: FloatArray,
    turns: FloatArray,
    log_prior: FloatArray,
    north_rad: float,
    up: int,
) -> tuple[float, float, Candidate]:
    """Return the largest log density of poses, the sum of densities relative to it, and the place around it.

    A pose is a cell for the centre of the scans, and one of the rotations `turns` with its `log_prior`, on the storey
    `up`. `maps` (S, nx, ny) are the log ratios of the scans at the cells. The probability of the candidate is that of
    its place among all these poses.
    """
    centre = own_m.mean(axis=0)
    _, nx, ny = maps.shape
    pad = int(np.ceil(np.abs(np.linalg.norm(own_m - centre, axis=1)).max() / _CELL_M)) + 1
    total = np.empty((len(turns), nx + 2 * pad, ny + 2 * pad), dtype=np.float32)
    for r, turn in enumerate(turns.tolist()):
        total[r] = log_prior[r]
        for k, (dx, dy) in enumerate(np.round((own_m - centre) @ turned(turn + north_rad) / _CELL_M).astype(int)):
            total[r, pad - dx : pad - dx + nx, pad - dy : pad - dy + ny] += maps[k]
    log_max = float(total.max())
    density = np.exp(total - log_max)
    _, a, b = np.unravel_index(int(total.argmax()), total.shape)
    x, y = np.ogrid[: total.shape[1], : total.shape[2]]
    near = density * (((x - a) ** 2 + (y - b) ** 2) * _CELL_M**2 <= _PLACE_M**2)
    mass, of_place = float(density.sum()), float(near.sum())
    at = np.array([float((near * x).sum()), float((near * y).sum())]) / of_place
    of_turn = near.sum(axis=(1, 2))
    turn = north_rad + math.atan2(float(of_turn @ np.sin(turns)), float(of_turn @ np.cos(turns)))
    centre_m = low_m + _CELL_M * (at - pad)
    pose = Pose(turn, centre_m - centre @ turned(turn), int(up))
    return log_max, mass, Candidate(of_place / mass, pose, centre_m)


def _placed(walks: ScannedWalks, group: PlacedGroup, rows: IntArray) -> tuple[FloatArray, IntArray]:
    """Return positions (n, 2) and storeys (n,) of scans of placed walks in the frame of the group."""
    at_m, floor = np.empty((len(rows), 2)), np.empty(len(rows), dtype=np.int64)
    owner = walks.owner[rows]
    for i in np.unique(owner).tolist():
        own, pose = owner == i, group.poses[i]
        at_m[own], floor[own] = pose.of(walks.own_m[rows[own]]), walks.floor[rows[own]] + pose.floor
    return at_m, floor


def _thinned(at_m: FloatArray, floor: IntArray) -> IntArray:
    """Return the indices of the scans to keep: one in each square of `_THIN_M` on a storey."""
    squares = np.column_stack([np.floor(at_m / _THIN_M).astype(np.int64), floor])
    return np.unique(squares, axis=0, return_index=True)[1]


def grow(walks: ScannedWalks, group: PlacedGroup, free: set[int]) -> None:
    """Join walks of `free` to a group, round by round, until no further walk has a sure place.

    The group and `free` are changed. A walk that the others do not confirm twice is not tried again.
    """
    n_refused, seen = dict[int, int](), dict[int, int]()
    for _ in range(_MOST_ROUNDS):
        found: dict[int, Candidate] = {}
        for i in sorted(free):
            n_near = len(walks.partners[i] & group.poses.keys())
            # a walk is tried again when its surroundings have grown
            if n_refused.get(i, 0) > 1 or n_near <= seen.get(i, 0):
                continue
            candidate = locate(walks, group, i)
            if candidate is not None and candidate.prob >= SURE:
                found[i] = candidate
            else:
                seen[i] = n_near
        if not found:
            return
        ranked = sorted(found, key=lambda i: -found[i].prob)
        new = ranked[: max(1, len(group.poses) // 2)]
        group.poses.update({i: found[i].pose for i in new})
        adjust(walks, group, new)
        refused = [i for i in new if not _is_confirmed(walks, group, i)]
        for i in refused:
            del group.poses[i]
            n_refused[i] = n_refused.get(i, 0) + 1
        free.difference_update(group.poses)


def settle(walks: ScannedWalks, group: PlacedGroup, kept: frozenset[int]) -> list[int]:
    """Remove the walks of a group that the others do not confirm, and return their indices.

    The walks in `kept` are never removed: those that define the frame of the group, or that are on a map already.
    """
    removed: list[int] = []
    for _ in range(3):
        wrong = [i for i in group.poses if i not in kept and not _is_confirmed(walks, group, i)]
        for i in wrong:
            del group.poses[i]
        removed += wrong
        if not wrong:
            break
        adjust(walks, group, list(group.poses))
    return removed


def _is_confirmed(walks: ScannedWalks, group: PlacedGroup, walk: int) -> bool:
    """True if all other walks of a group place a walk where it is: within `_PLACE_M` and on the same storey."""
    again = locate(walks, group, walk)
    if again is None or again.prob < 0.8 * SURE:
        return False
    pose = group.poses[walk]
    here = pose.of(walks.own_m[walks.rows(walk)]).mean(axis=0)
    return again.pose.floor == pose.floor and float(np.hypot(*(again.centre_m - here))) <= _PLACE_M


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Pairs of similar scans (P,) of different walks, with their range in m and its standard deviation."""

    first: IntArray
    second: IntArray
    range_m: FloatArray
    std_m: FloatArray


def pairs_of(walks: ScannedWalks, group: PlacedGroup, free: Sequence[int]) -> Pairs:
    """Return the pairs of the scans of walks with the most similar scans of other walks of their group.

    Only the most similar pairs count, at most one with each other walk. Less similar pairs are many, and their errors
    come from the same walls, so that they do not average out.
    """
    parts: list[tuple[IntArray, IntArray, FloatArray]] = []
    for i in free:
        rows, near = walks.rows(i), sorted(walks.partners[i] & group.poses.keys())
        if not near or rows.stop == rows.start:
            continue
        others = walks.scans_of(near)
        cosine, owner = walks.cosines(rows, others), walks.owner[others]
        up = walks.floor[rows] + group.poses[i].floor
        other_up = walks.floor[others] + np.array([group.poses[j].floor for j in owner.tolist()])
        cosine[up[:, None] != other_up] = 0.0
        # the scans of each other walk are consecutive
        starts = np.flatnonzero(np.diff(owner, prepend=-1))
        ends = np.append(starts[1:], len(owner))
        best = np.column_stack([a + cosine[:, a:b].argmax(axis=1) for a, b in zip(starts, ends, strict=True)])
        of_best = np.take_along_axis(cosine, best, axis=1)
        chosen = np.argsort(-of_best, axis=1, kind="stable")[:, :_N_PAIRS]
        scan, column = np.nonzero(np.take_along_axis(of_best, chosen, axis=1) >= PAIR_COSINE)
        column = chosen[scan, column]
        parts.append((scan + rows.start, others[best[scan, column]], of_best[scan, column]))
    if not parts:
        none = np.zeros(0, dtype=np.int64)
        return Pairs(none, none, np.zeros(0), np.zeros(0))
    first, second, cosine = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Pairs(first, second, *ranges(cosine))


def residuals(pairs: Pairs, apart_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the residuals (P,) of the ranges of pairs, unit vectors (P, 2), and robust weights (P,).

    `apart_m` (P, 2) is the position of the first scan minus that of the second one. A residual is its length minus the
    range. The unit vector has its direction. The weights are those of a Cauchy loss, divided by the variance.
    """
    length = np.maximum(np.hypot(*apart_m.T), 0.5)
    residual = length - pairs.range_m
    return residual, apart_m / length[:, None], robust_weights(residual / pairs.std_m, "cauchy") / pairs.std_m**2


def adjust(walks: ScannedWalks, group: PlacedGroup, new: Sequence[int]) -> None:
    """Adjust the rigid poses of a group together: of all walks, or of the new ones only in a large group.

    The poses and the deviation from magnetic north are changed in the group. They minimise the robust residuals of
    pairs of similar scans, with priors for magnetic north and for the seeds.
    """
    together = list(group.poses) if len(group.poses) <= MOST_TOGETHER else [i for i in new if i in group.poses]
    pairs = pairs_of(walks, group, together)
    n = len(together)
    number = np.full(len(walks.chains), -1)
    number[together] = np.arange(n)
    a, b = number[walks.owner[pairs.first]], number[walks.owner[pairs.second]]
    directed = np.array([walks.chains[i].knows_north for i in together])
    is_seed = np.array([i in group.seeds for i in together])
    turn = np.array([group.poses[i].turn_rad for i in together])
    known_turn = turn.copy()
    shift = np.array([group.poses[i].shift_m for i in together])
    # the common deviation of all magnetic fields is known in a group of which only a part is adjusted
    is_whole = n == len(group.poses)
    north, known_north = group.north_rad, 0.0 if is_whole else group.north_rad
    north_weight = 1.0 / _COMMON_STD_RAD**2 if is_whole else 1e9
    # unknowns: turns, shifts, and the deviation of north
    size = 3 * n + 1
    for _ in range(20):
        for k, i in enumerate(together):
            group.poses[i].turn_rad, group.poses[i].shift_m = float(turn[k]), shift[k]
        at_first, _ = _placed(walks, group, pairs.first)
        at_second, _ = _placed(walks, group, pairs.second)
        residual, unit, weight = residuals(pairs, at_first - at_second)
        weight = weight / _INFLATION**2
        parts: list[tuple[IntArray, FloatArray]] = []
        for index, at_m, sign in ((a, at_first, 1.0), (b, at_second, -1.0)):
            lever = at_m - shift[index]
            by_turn = unit[:, 0] * lever[:, 1] - unit[:, 1] * lever[:, 0]
            columns = np.stack([index, n + 2 * index, n + 2 * index + 1], axis=1)
            values = sign * np.stack([by_turn, unit[:, 0], unit[:, 1]], axis=1)
            parts.append((columns, np.where((index >= 0)[:, None], values, 0.0)))
        columns = np.concatenate([np.maximum(part[0], 0) for part in parts], axis=1)
        values = np.concatenate([part[1] for part in parts], axis=1)
        of_north = np.where(directed, 1.0 / _NORTH_STD_RAD**2, 0.0)
        of_seed = np.where(is_seed, 1.0 / _SEED_STD_RAD**2, 0.0)
        diagonal = np.full(size, 1e-6)
        diagonal[:n] += of_north + of_seed
        diagonal[n : 3 * n] += np.repeat(np.where(is_seed, 1e4, 1e-4), 2)
        diagonal[3 * n] += of_north.sum() + north_weight
        k, last, every = np.arange(n), np.full(n, 3 * n), np.arange(size)
        squares = weight[:, None, None] * values[:, :, None] * values[:, None, :]
        entries = np.concatenate([squares.ravel(), -of_north, -of_north, diagonal])
        row = np.concatenate([np.repeat(columns, 6, axis=1).ravel(), k, last, every])
        column = np.concatenate([np.tile(columns, (1, 6)).ravel(), last, k, every])
        slope = np.bincount(columns.ravel(), ((weight * residual)[:, None] * values).ravel(), size).astype(float)
        slope[:n] += of_north * (turn - north) + of_seed * (turn - known_turn)
        slope[3 * n] += north_weight * (north - known_north) - float(of_north @ (turn - north))
        change = -splu(coo_matrix((entries, (row, column)), (size, size)).tocsc()).solve(slope)
        largest = np.abs(change[:n]).max() / 0.5, np.abs(change[n : 3 * n]).max() / 30.0
        change *= 1.0 / max(1.0, *largest)
        turn, shift, north = turn + change[:n], shift + change[n : 3 * n].reshape(n, 2), north + float(change[3 * n])
        if np.abs(change).max() < 0.02:
            break
    for k, i in enumerate(together):
        group.poses[i].turn_rad, group.poses[i].shift_m = float(turn[k]), shift[k]
    group.north_rad = north
