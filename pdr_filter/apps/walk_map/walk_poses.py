"""Poses of walks in a group: each walk is a rigid shape, and joins where its scans leave a single pose.

A walk is joined if the scans leave one pose with `SURE` of the probability. The probability covers all positions on a
grid, all rotations, all storeys of the group, and a place outside of the map. Misleading scans are thus outvoted, and
ambiguous walks wait until more walks are placed. After each round the poses of all walks are adjusted together, to the
maximum of the joint likelihood of `likeness`, for which GTSAM has no sparse factors. Then each walk is placed again by
all others, and leaves the group if it fails.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pdr_filter.apps.walk_map.chains import Chain
from pdr_filter.apps.walk_map.likeness import fingerprint_matrix, likelihood, log_ratio
from pdr_filter.values import FloatArray, IntArray

# All numbers but the first one were chosen on storey F1 of `ms_indoor`.
# Share of the probability that one place of a walk must have, and the radius of a place. With all others of up to
# twelve walks at their true places, at most 5 % of the placed walks are wrong in the mean of the storeys from this
# share on. Chosen on any four of the five storeys, it is 0.945 to 0.948.
SURE, _PLACE_M = 0.95, 12.0
# Smallest probability of another place at which the known positions of a walk count as wrong, and smallest distance of
# this place from them: two radii, so that both places do not overlap.
_SURE_ELSEWHERE, _ELSEWHERE_M = 0.999, 2.0 * _PLACE_M
# Smallest scalar product of two fingerprints, without their small components, that makes their walks partners.
_PARTNER_COSINE = 0.15
# Smallest cosine of similar scans, and smallest number of scans of a walk that are similar to mapped scans. Fewer do
# not hold the walk in its place.
_SIMILAR_COSINE, _MIN_SIMILAR = 0.5, 3
# Standard deviation of the direction of a walk by its magnetometer, of the common deviation of all magnetic fields in
# a building, and of a rotation from a known heading.
_NORTH_STD_RAD, _SEED_STD_RAD = 0.2, 0.1
# Prior standard deviations of the log scale of a walk, and of the place of the walk that defines the frame.
_SCALE_STD, _SEED_STD_M, _REGION_STD_M = 0.1, 1.0, 1000.0
# Number of places outside of the map, each as probable as a cell of it.
_N_ELSEWHERE = 500
_CELL_M, _MARGIN_M, _MOST_M = 4.0, 50.0, 400.0
# Mapped scans that are compared: one for each square of this width, because neighbours have the same errors.
_THIN_M = 6.0
# Most scans of a storey that are adjusted together. The gain of log density and the damping that end the adjustment.
_MOST_SCANS, _SMALLEST_GAIN, _MOST_DAMPING = 500, 0.05, 100.0
# Walks that are adjusted together. Later walks are fitted to these, so that the cost grows linearly.
MOST_TOGETHER = 200
_MOST_ROUNDS = 60
# Numbers of placed walks for each walk that joins in a round. Walks that are misplaced in the same way can confirm each
# other, and then keep other walks from their correct place. With another number this seldom happens again. Chosen on 18
# sets of given walks.
PACES = 2, 8


@dataclass(slots=True)
class WalkPose:
    """Pose of a walk in a group: position = scale R(turn) own + shift, with a clockwise turn."""

    turn_rad: float
    shift_m: FloatArray
    floor: int = 0  # storey of the start of the walk
    scale: float = 1.0

    def of(self, own_m: FloatArray) -> FloatArray:
        """Return the positions (n, 2), in the frame of the group, of points (n, 2) in the frame of the walk alone."""
        return self.scale * own_m @ clockwise_rotation(self.turn_rad) + self.shift_m


def clockwise_rotation(angle_rad: float) -> FloatArray:
    """Return the matrix M for which x @ M is the row vector x turned clockwise."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s], [s, c]])


# Prior mean and standard deviation of the direction of magnetic north in the frame of a map. Most of it is the
# declination.
UNKNOWN_NORTH = 0.0, 0.12


@dataclass(slots=True)
class JoinedWalks:
    """Joined walks in one frame."""

    poses: dict[int, WalkPose]  # by the index of the walk
    seeds: Mapping[int, WalkPose]  # walks that define the frame by these poses, and are never removed
    north_rad: float = 0.0  # deviation of the frame from magnetic north
    north: tuple[float, float] = UNKNOWN_NORTH  # prior mean and standard deviation of `north_rad`


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
            heard=fingerprint_matrix([c.scans for c in chains]),
            first=np.cumsum([0, *counts]),
        )
        walks.partners = partners_of(walks)
        return walks

    def rows(self, walk: int) -> slice:
        """Return the slice of the scans of a walk, given the index of the walk."""
        return slice(int(self.first[walk]), int(self.first[walk + 1]))

    def scans_of(self, walks: Iterable[int]) -> IntArray:
        """Return the indices of the scans of several walks, those of each walk together."""
        return np.concatenate([np.arange(self.first[i], self.first[i + 1]) for i in walks])

    def cosines(self, rows: slice | IntArray, others: IntArray) -> FloatArray:
        """Return the cosines (n, m) of the fingerprints of n scans with those of m other scans."""
        return (self.heard[rows] @ self.heard[others].T).toarray()


def partners_of(walks: ScannedWalks) -> list[set[int]]:
    """Return for each walk the indices of its partners, the other walks that may have passed the same place.

    Two scans make their walks partners if the scalar product of their fingerprints, without components below 0.1, is at
    least `_PARTNER_COSINE`. Every scan is compared with every third scan only, because neighbouring scans of a walk are
    nearly at the same place.
    """
    found: list[set[int]] = [set() for _ in walks.chains]
    # the loudest access points suffice to find candidates, and keep the lists of the index short
    loud = walks.heard.copy()
    loud.data[loud.data < 0.1] = 0.0
    loud.eliminate_zeros()
    index, owner, n = loud[::3].T.tocsr(), walks.owner[::3], len(walks.chains)
    for start in range(0, loud.shape[0], 500):
        near = (loud[start : start + 500] @ index).tocoo()
        good = near.data >= _PARTNER_COSINE
        pairs = np.unique(n * walks.owner[near.row[good] + start] + owner[near.col[good]])
        for i, j in zip((pairs // n).tolist(), (pairs % n).tolist(), strict=True):
            if i != j:
                found[i].add(j)
                found[j].add(i)
    return found


@dataclass(frozen=True, slots=True)
class Candidate:
    """Most probable pose of a walk, its probability, and the centre of its scans there."""

    prob: float
    pose: WalkPose
    centre_m: FloatArray


def locate(walks: ScannedWalks, group: JoinedWalks, walk: int) -> Candidate | None:
    """Return the most probable pose of a walk in a group without this walk, or None if it recognises no place.

    A walk recognises a place if at least `_MIN_SIMILAR` of its scans are similar to scans of the group. `walk` is its
    index.
    """
    rows = walks.rows(walk)
    placed = [i for i in group.poses if i != walk and i in walks.partners[walk]]
    if not placed or rows.stop == rows.start:
        return None
    # all placed walks around count, because scans that do not fit rule places out
    around = set[int]().union(*(walks.partners[i] for i in placed)) & group.poses.keys() - {walk, *placed}
    others = walks.scans_of(sorted([*placed, *around][:MOST_TOGETHER]))
    at_m, floor = _scans_in_frame(walks, group, others)
    kept = _thinned(at_m, floor)
    others, at_m, floor = others[kept], at_m[kept], floor[kept]
    cosine = walks.cosines(rows, others)
    similar = cosine >= _SIMILAR_COSINE
    if np.count_nonzero(similar.any(axis=1)) < _MIN_SIMILAR:
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
    owner = walks.owner[others]
    for up in np.unique((floor - own_floor[:, None])[similar]).tolist():
        of_scan = np.zeros((len(own_m), len(cells)))
        for storey in np.unique(own_floor).tolist():
            here, there = own_floor == storey, floor == storey + up
            if there.any() and here.any():
                among = walks.cosines(others[there], others[there])
                of_scan[here] = log_ratio(cosine[here][:, there], among, at_m[there], owner[there], cells)
        maps = of_scan.reshape(-1, *shape)
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
        for k, (dx, dy) in enumerate(
            np.round((own_m - centre) @ clockwise_rotation(turn + north_rad) / _CELL_M).astype(int)
        ):
            total[r, pad - dx : pad - dx + nx, pad - dy : pad - dy + ny] += maps[k]
    log_max = float(total.max())
    density = np.exp(total - log_max)
    _, a, b = np.unravel_index(int(total.argmax()), total.shape)
    x, y = np.ogrid[: total.shape[1], : total.shape[2]]
    near = density * (((x - a) ** 2 + (y - b) ** 2) * _CELL_M**2 <= _PLACE_M**2)
    mass, of_peak = float(density.sum()), float(near.sum())
    at = np.array([float((near * x).sum()), float((near * y).sum())]) / of_peak
    of_turn = near.sum(axis=(1, 2))
    turn = north_rad + math.atan2(float(of_turn @ np.sin(turns)), float(of_turn @ np.cos(turns)))
    centre_m = low_m + _CELL_M * (at - pad)
    pose = WalkPose(turn, centre_m - centre @ clockwise_rotation(turn), int(up))
    return log_max, mass, Candidate(of_peak / mass, pose, centre_m)


def _scans_in_frame(walks: ScannedWalks, group: JoinedWalks, rows: IntArray) -> tuple[FloatArray, IntArray]:
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
    squares -= squares.min(axis=0)
    _, n_north, n_floors = squares.max(axis=0) + 1
    return np.unique((squares[:, 0] * n_north + squares[:, 1]) * n_floors + squares[:, 2], return_index=True)[1]


def grow(walks: ScannedWalks, group: JoinedWalks, free: set[int], pace: int) -> None:
    """Join walks of `free` to a group, round by round, until no further walk has a sure place.

    In a round, one walk joins for each `pace` placed ones. The group and `free` are changed. A walk that the others do
    not confirm twice is not tried again.
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
        new = ranked[: max(1, len(group.poses) // pace)]
        group.poses.update({i: found[i].pose for i in new})
        adjust(walks, group, new)
        refused = [i for i in new if not _is_confirmed(walks, group, i)]
        for i in refused:
            del group.poses[i]
            n_refused[i] = n_refused.get(i, 0) + 1
        free.difference_update(group.poses)


def doubtful_seeds(walks: ScannedWalks, group: JoinedWalks, seeds: Mapping[int, WalkPose], free: set[int]) -> set[int]:
    """Return the new seeds of a group whose poses contradict the other seeds by the scans.

    They are those seeds without which the fewest others are contradicted: all candidates, if the scans do not tell
    which one is wrong.
    """
    kept, wrong = dict(seeds), _contradicted(walks, group, seeds, seeds, free)
    while wrong:
        near = kept.keys() & {*wrong}.union(*(_around(walks, i) for i in wrong))
        left: dict[int, list[int]] = {}
        for i in near:
            others = {j: pose for j, pose in kept.items() if j != i}
            left[i] = _contradicted(walks, group, others, wrong, free | seeds.keys() - others.keys())
        fewest = min(map(len, left.values()))
        kept = {i: pose for i, pose in kept.items() if i not in left or len(left[i]) > fewest}
        wrong = _contradicted(walks, group, kept, wrong, free | seeds.keys() - kept.keys())
    return seeds.keys() - kept.keys()


def _around(walks: ScannedWalks, walk: int) -> set[int]:
    """Return the partners of a walk and their partners, without the walk."""
    return walks.partners[walk].union(*(walks.partners[j] for j in walks.partners[walk])) - {walk}


def _contradicted(
    walks: ScannedWalks, group: JoinedWalks, seeds: Mapping[int, WalkPose], some: Iterable[int], free: set[int]
) -> list[int]:
    """Return those of some seeds that the map grown from all other seeds has elsewhere.

    The walks of `free` around a seed are joined to this map first.
    """
    found: list[int] = []
    for i in seeds.keys() & set(some):
        others = {j: pose for j, pose in seeds.items() if j != i}
        trial = replace(group, poses={**group.poses, **others}, seeds={**group.seeds, **others})
        grow(walks, trial, free & _around(walks, i), PACES[0])
        candidate = locate(walks, trial, i)
        if candidate is None or candidate.prob < _SURE_ELSEWHERE:
            continue
        here = seeds[i].of(walks.own_m[walks.rows(i)]).mean(axis=0)
        if candidate.pose.floor != seeds[i].floor or float(np.hypot(*(candidate.centre_m - here))) > _ELSEWHERE_M:
            found.append(i)
    return found


def settle(walks: ScannedWalks, group: JoinedWalks, kept: frozenset[int]) -> list[int]:
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


def drop_doubtful_storeys(walks: ScannedWalks, group: JoinedWalks, kept: frozenset[int]) -> list[int]:
    """Remove the joined walks of each storey on which the others confirm none of the walks in `kept`.

    The walks of a map that grew from a wrongly joined walk agree with each other, but seldom with the walks that define
    the frame. The indices of the removed walks are returned.
    """
    storeys = {group.poses[i].floor for i in kept}
    sure = {group.poses[i].floor for i in kept if _is_confirmed(walks, group, i, SURE)}
    removed = [i for i in group.poses if i not in kept and group.poses[i].floor in storeys - sure]
    for i in removed:
        del group.poses[i]
    return removed


def _is_confirmed(walks: ScannedWalks, group: JoinedWalks, walk: int, prob: float | None = None) -> bool:
    """True if all other walks of a group place a walk where it is: within `_PLACE_M` and on the same storey.

    Their place must have the probability `prob`, or four fifths of `SURE` by default.
    """
    again = locate(walks, group, walk)
    if again is None or again.prob < (0.8 * SURE if prob is None else prob):
        return False
    pose = group.poses[walk]
    here = pose.of(walks.own_m[walks.rows(walk)]).mean(axis=0)
    return again.pose.floor == pose.floor and float(np.hypot(*(again.centre_m - here))) <= _PLACE_M


def log_evidence(walks: ScannedWalks, group: JoinedWalks) -> float:
    """Return the log probability of all scans of a group at its poses minus the sum of those of each walk alone.

    A walk that is not in the group contributes zero, so that groups of different walks can be compared. Of many scans,
    evenly chosen ones are used.
    """
    some = np.arange(0, len(walks.owner), math.ceil(len(walks.owner) / (2 * _MOST_SCANS)))
    scans = some[np.isin(walks.owner[some], list(group.poses))]
    found = joint_poses(walks, group, list(group.poses), scans).objective
    for i in group.poses:
        own = scans[walks.owner[scans] == i]
        found -= sum(value for _, value, _, _ in of_storeys(walks, own, walks.own_m[own], walks.floor[own]))
    return found


@dataclass(slots=True, eq=False)
class JointPoses:
    """Normal equations of the rigid poses of n walks: rotation, east, north and log scale of each, then north."""

    objective: float  # log posterior density
    slope: FloatArray  # (4 n + 1,)
    information: FloatArray  # (4 n + 1, 4 n + 1)


def scans_around(walks: ScannedWalks, group: JoinedWalks, together: Sequence[int]) -> IntArray:
    """Return the scans for a solution of some walks of a group: those of the walks, then those of their partners.

    At most about `_MOST_SCANS` scans of each storey are used, because the cost grows with their third power.
    """
    own = walks.scans_of(together)
    most = _MOST_SCANS * len({group.poses[i].floor for i in together})
    own = own[:: math.ceil(max(len(own), 1) / most)]
    near = set[int]().union(*(walks.partners[i] for i in together)) & group.poses.keys() - set(together)
    if not near:
        return own
    others = walks.scans_of(sorted(near)[:MOST_TOGETHER])
    at_m, floor = _scans_in_frame(walks, group, others)
    kept = _thinned(at_m, floor)
    # other storeys say nothing about these walks
    others = others[kept[np.isin(floor[kept], _scans_in_frame(walks, group, own)[1])]]
    return np.concatenate([own, others[:: math.ceil(len(others) / most)]])


def of_storeys(
    walks: ScannedWalks, scans: IntArray, at_m: FloatArray, floor: IntArray
) -> Iterator[tuple[IntArray, float, FloatArray, FloatArray]]:
    """Yield the log likelihood of the m scans of each storey, and its gradient and information by their positions.

    The first value has the indices (m,) of these scans. All n scans are at `at_m` (n, 2), on the storeys `floor` (n,).
    The gradient has the shape (2 m,) and the information (2 m, 2 m).
    """
    for storey in np.unique(floor).tolist():
        here = np.flatnonzero(floor == storey)
        heard = walks.heard[scans[here]]
        yield here, *likelihood(at_m[here], walks.owner[scans[here]], (heard @ heard.T).toarray())


def joint_poses(
    walks: ScannedWalks,
    group: JoinedWalks,
    together: Sequence[int],
    scans: IntArray,
    weight: float = 1.0,
) -> JointPoses:
    """Return the normal equations of the rigid poses of some walks, given `scans` of these and other walks.

    The other walks of the group keep their poses. The terms are the likelihood of the fingerprints, with a `weight`,
    and the priors of rotation, scale, magnetic north and the walks that define the frame.
    """
    n = len(together)
    number = np.full(len(walks.chains), -1)
    number[together] = np.arange(n)
    at_m, floor = _scans_in_frame(walks, group, scans)
    k = number[walks.owner[scans]]
    own, pose = np.flatnonzero(k >= 0), 4 * k[k >= 0]
    lever = at_m[own] - np.array([group.poses[i].shift_m for i in walks.owner[scans[own]].tolist()]).reshape(-1, 2)
    by_pose = np.zeros((len(scans), 2, 4 * n + 1))
    for axis, by_turn in ((0, lever[:, 1]), (1, -lever[:, 0])):
        by_pose[own, axis, pose] = by_turn
        by_pose[own, axis, pose + 1 + axis] = 1.0
        by_pose[own, axis, pose + 3] = lever[:, axis]
    objective, slope, information = 0.0, np.zeros(4 * n + 1), np.zeros((4 * n + 1, 4 * n + 1))
    for here, value, of_scan, of_scans in of_storeys(walks, scans, at_m, floor):
        by_own = by_pose[here].reshape(-1, 4 * n + 1)
        objective += weight * value
        slope += weight * by_own.T @ of_scan
        information += weight * by_own.T @ (of_scans @ by_own)

    def add(error: float, std: float, *keys: int) -> None:
        """Add a prior with an error that grows with the first unknown and falls with the second one."""
        nonlocal objective
        objective -= 0.5 * (error / std) ** 2
        for a, sign in zip(keys, (1.0, -1.0), strict=False):
            slope[a] -= sign * error / std**2
            for b, other in zip(keys, (1.0, -1.0), strict=False):
                information[a, b] += sign * other / std**2

    for k, i in enumerate(together):
        pose = group.poses[i]
        add(math.log(pose.scale), _SCALE_STD, 4 * k + 3)
        if walks.chains[i].knows_north:
            add(pose.turn_rad - group.north_rad, _NORTH_STD_RAD, 4 * k, 4 * n)
        if i in group.seeds:
            seed = group.seeds[i]
            add(pose.turn_rad - seed.turn_rad, _SEED_STD_RAD, 4 * k)
            centre = walks.chains[i].position_m(np.zeros(1, dtype=np.int64))
            for axis, error in enumerate((pose.of(centre) - seed.of(centre))[0].tolist()):
                add(error, _SEED_STD_M, 4 * k + 1 + axis)
        for axis in range(2):  # without access points in common, a place is only known to be in the region
            add(0.0, _REGION_STD_M, 4 * k + 1 + axis)
    # the deviation of all magnetic fields is known in a group of which only a part is solved
    is_whole = n == len(group.poses)
    add(group.north_rad - group.north[0] if is_whole else 0.0, group.north[1] if is_whole else 1e-4, 4 * n)
    return JointPoses(objective, slope, information)


def adjust(walks: ScannedWalks, group: JoinedWalks, new: Sequence[int], n_iterations: int = 4) -> None:
    """Adjust the rigid poses of a group together, or those of each new walk alone in a large group.

    The poses and the deviation from magnetic north are changed in the group. They maximise the posterior density, by
    Fisher scoring with the damping of Levenberg and Marquardt.
    """
    if len(group.poses) > MOST_TOGETHER and len(new) > 1:
        for i in new:
            adjust(walks, group, [i], n_iterations)
        return
    together = list(group.poses) if len(group.poses) <= MOST_TOGETHER else list(new)
    scans, damping = scans_around(walks, group, together), 1e-3
    now = joint_poses(walks, group, together, scans)
    for _ in range(n_iterations):
        before, trial, gain = ({i: group.poses[i] for i in together}, group.north_rad), now, -1.0
        while gain <= 0.0:
            if damping > _MOST_DAMPING:
                return
            change = np.linalg.solve(now.information + damping * np.diag(np.diag(now.information)), now.slope)
            largest = np.abs(change[:-1].reshape(-1, 4)).max(axis=0) / (0.4, 20.0, 20.0, 0.3)
            change /= max(1.0, float(largest.max()))
            for i, (turn, east, north, log_scale) in zip(together, change[:-1].reshape(-1, 4).tolist(), strict=True):
                pose, moved_m = before[0][i], np.array([east, north])
                scale = pose.scale * math.exp(log_scale)
                group.poses[i] = WalkPose(pose.turn_rad + turn, pose.shift_m + moved_m, pose.floor, scale)
            group.north_rad = before[1] + float(change[-1])
            trial = joint_poses(walks, group, together, scans)
            gain, damping = trial.objective - now.objective, 8.0 * damping
            if gain <= 0.0:
                group.poses.update(before[0])
                group.north_rad = before[1]
        now, damping = trial, damping / 64.0
        if gain < _SMALLEST_GAIN:
            return
