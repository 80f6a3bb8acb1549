"""Maps of buildings from many walks: `map_walks` and its result `WalkMap`."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from pdr_filter.apps.batch.workers import Failure, each
from pdr_filter.apps.maps.marks import Marks, read_marks
from pdr_filter.apps.maps.radio.radio_map import RadioMap
from pdr_filter.apps.walk_map.chains import Chain, cached_chain, without_times
from pdr_filter.apps.walk_map.drawing import density, map_report, plan_text
from pdr_filter.apps.walk_map.joint import Known, States, contradicting, solve_group, step_positions
from pdr_filter.apps.walk_map.mapped_walk import MappedWalk
from pdr_filter.apps.walk_map.walk_poses import (
    MOST_TOGETHER,
    PACES,
    UNKNOWN_NORTH,
    JoinedWalks,
    ScannedWalks,
    WalkPose,
    adjust,
    clockwise_rotation,
    doubtful_seeds,
    drop_doubtful_storeys,
    grow,
    log_evidence,
    settle,
)
from pdr_filter.offline.smoothing.observations import OUTSIDE_S
from pdr_filter.values import FloatArray, HeadingFix, PositionFix, limits, read_only
from pdr_filter.values.optional_packages import load_optional
from pdr_filter.values.origin import Origin
from pdr_filter.values.recording import Recording
from pdr_filter.values.safe_files import read_json, read_small, write_files
from pdr_filter.values.sanitise import free_name
from pdr_filter.values.serialisation import from_bytes, to_bytes
from pdr_filter.values.uncertainty import worst_std_m
from pdr_filter.version import __version__

_FORMAT = 3
# An access point has moved if walks that receive it this strongly are farther apart than this.
_LOUD_DBM, _MOVED_M = -60.0, 60.0
# Standard deviation of magnetic north around the declination, for all walks of a building together.
DECLINATION_STD_RAD = 0.05
# Largest error of 95 % of the joined walks in the worst direction. Walks with a larger standard deviation are not
# joined: the median over their knots, where 1.96 is the 97.5 % quantile of the normal distribution.
_ACCURATE_M = 15.0
_MOST_STD_M = _ACCURATE_M / 1.96


@dataclass(frozen=True, slots=True, eq=False)
class _JoinedGroup:
    """Group of joined walks in one frame, with the values of its n walks in tuples."""

    number: tuple[int, ...]  # indices among the chains
    pose: tuple[WalkPose, ...]  # rigid poses
    state: tuple[States, ...]  # solved states
    seeds: tuple[int, ...]  # indices of the walks that define the frame
    north_rad: float  # deviation of the frame from magnetic north
    is_known: bool  # True if known positions define the frame

    @property
    def states(self) -> dict[int, States]:
        """Solved states by the number of the walk."""
        return dict(zip(self.number, self.state, strict=True))

    @property
    def poses(self) -> dict[int, WalkPose]:
        """Rigid poses by the number of the walk."""
        return dict(zip(self.number, self.pose, strict=True))

    def of_seeds(self, new: Mapping[int, int]) -> _JoinedGroup | None:
        """Return the group with its seeds alone, or another walk if they are gone, for new numbers of the walks."""
        seeds = [i for i in self.seeds if i in new] or [i for i in self.number if i in new][:1]
        pose, state = tuple(self.poses[i] for i in seeds), tuple(self.states[i] for i in seeds)
        number = tuple(new[i] for i in seeds)
        return replace(self, number=number, pose=pose, state=state, seeds=number) if seeds else None


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class WalkMap:
    """Map of one or several buildings from many walks, returned by `map_walks`.

    Attributes
    ----------
    walks : tuple of MappedWalk
        Joined walks, with positions and covariances in the frame of their group.
    apart : tuple of tuple of str
        Name and reason of each walk that was not joined.
    moved_access_points : tuple of int
        Addresses that were received strongly at distant places. They are not part of `radio`.
    notes : tuple of str
        Warnings: known positions and headings that are not used, and storeys without a map.

    See Also
    --------
    map_walks : Return a map of walks.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.demo_walk()
    >>> walk_map = pdr.map_walks([walk])
    >>> walk_map, walk_map.apart[0][1]
    (WalkMap(0 walks in 0 groups, 1 apart), 'no Wi-Fi scans: record Wi-Fi with the walk')
    """

    walks: tuple[MappedWalk, ...]
    apart: tuple[tuple[str, str], ...]
    moved_access_points: tuple[int, ...]
    notes: tuple[str, ...]
    _chains: tuple[Chain, ...] = field(default=())
    _groups: tuple[_JoinedGroup, ...] = field(default=())
    _known: Mapping[str, Sequence[Known]] = field(default_factory=dict[str, Sequence[Known]])
    _salt: str | None = None
    _north: tuple[float, float] = UNKNOWN_NORTH
    _place: Origin | None = None  # origin of the marks

    def __repr__(self) -> str:
        return f"WalkMap({len(self.walks)} walks in {self.n_groups} groups, {len(self.apart)} apart)"

    @property
    def n_groups(self) -> int:
        """Number of groups: walks in one frame, such as those of one building or of one isolated storey."""
        return len(self._groups)

    def radio(self, group: int = 0) -> RadioMap:
        """Return the radio map of a group, for position fixes of other walks.

        Parameters
        ----------
        group : int, default 0
            Number of the group.

        Returns
        -------
        RadioMap
            Scans of all walks of the group at their estimated positions. Its `position_std_m` is the root mean square
            of the standard deviations of these positions.

        Raises
        ------
        ValueError
            If there is no such group.
        """
        walks = self._walks_of(group)
        pairs = list(zip(walks, (self._chains[i].scans for i in self._groups[group].number), strict=True))
        heard = np.concatenate([s.bssid for _, s in pairs])
        bssid = np.setdiff1d(heard, self.moved_access_points)
        kept = np.isin(heard, bssid)
        first = np.cumsum([0, *(len(s) for _, s in pairs)])
        cov_m2 = np.concatenate([w.position_cov_m2[s.step] for w, s in pairs])
        return RadioMap(
            position_m=np.concatenate([w.position_m[s.step] for w, s in pairs]),
            floor=np.concatenate([w.floor[s.step] for w, s in pairs]).astype(float),
            bssid=bssid,
            point=np.concatenate([s.row + n for (_, s), n in zip(pairs, first[:-1], strict=True)])[kept],
            access_point=np.searchsorted(bssid, heard[kept]),
            rssi_dbm=np.concatenate([s.rssi_dbm for _, s in pairs])[kept],
            card={"walks": [w.name for w in walks], "version": __version__},
            position_std_m=float(np.sqrt(0.5 * np.trace(cov_m2, axis1=1, axis2=2).mean())),
        )

    def density(self, floor: int = 0, group: int = 0, cell_m: float = 1.0) -> tuple[FloatArray, FloatArray]:
        """Return how often each cell of a storey was walked on, blurred by the uncertainty of the positions.

        Parameters
        ----------
        floor : int, default 0
            Storey.
        group : int, default 0
            Number of the group.
        cell_m : float, default 1.0
            Width of a cell, in m.

        Returns
        -------
        south_west_m : array (2,)
            Corner of the first cell, in m.
        steps : array (rows, columns)
            Expected number of steps on each cell. Rows run north and columns east.

        Raises
        ------
        ValueError
            If there is no such group or storey.
        """
        return density(self._walks_of(group), floor, cell_m)

    def write_plan(self, path: str | Path, group: int = 0) -> Path:
        """Write the walked area of a group as a floor plan in GeoJSON, which `FloorPlan.read` reads.

        Parameters
        ----------
        path : str or Path
            File to write.
        group : int, default 0
            Number of the group.

        Returns
        -------
        Path
            The written file.

        Raises
        ------
        ValueError
            If there is no such group.
        ImportError
            If shapely is not installed.
        """
        write_files({Path(path): plan_text(self._walks_of(group)).encode()})
        return Path(path)

    def write_report(self, path: str | Path) -> Path:
        """Write an HTML page with all walks of each storey, and the walks that were not joined.

        Parameters
        ----------
        path : str or Path
            File to write.

        Returns
        -------
        Path
            The written file.
        """
        write_files({Path(path): map_report(self.walks, self.apart, self.moved_access_points, self.notes).encode()})
        return Path(path)

    def add(
        self,
        recordings: Iterable[Recording | str | Path],
        known: Iterable[tuple[str, Known]] = (),
        *,
        cache: str | Path | None = None,
        jobs: int = 1,
        scheduler: str | None = None,
    ) -> WalkMap:
        """Return the map with further walks.

        Walks that were joined before stay where they are. Walks that stayed apart are tried again.

        Parameters
        ----------
        recordings : iterable of Recording, str or Path
            Further recordings.
        known : iterable of tuple of str and PositionFix or HeadingFix
            Known positions and headings of these walks, each with the name of its walk.
        cache : str or Path, optional
            Folder of tracked walks, as in `map_walks`.
        jobs : int, default 1
            Number of processes.
        scheduler : str, optional
            Address of a Dask scheduler.

        Returns
        -------
        WalkMap
            The map with the walks that could be joined.
        """
        chains, apart, marks = _chains_of(recordings, cache, self._salt, jobs, scheduler, earlier=self._chains)
        marked, place = in_one_frame(marks, self._place)
        fixes = {**self._known, **_by_name([*marked, *known], chains)}
        own = {c.name for c in self._chains}
        earlier = [entry for entry in self.apart if entry[0] not in own]
        every = [*self._chains, *chains]
        found = _mapped(every, [*earlier, *apart], fixes, self._salt, self._groups, self._north)
        return replace(found, _place=place)

    def remove(self, names: Iterable[str]) -> WalkMap:
        """Return the map without some walks. The other walks are solved again.

        Parameters
        ----------
        names : iterable of str
            Names of walks on the map or apart.

        Returns
        -------
        WalkMap
            The map without these walks.

        Raises
        ------
        ValueError
            If a walk is unknown.
        """
        gone = set(names)
        present = {c.name for c in self._chains} | {name for name, _ in self.apart}
        if not gone <= present:
            raise ValueError(f"no walk is called {sorted(gone - present)[0]!r}: names are in walks and apart")
        chains = [c for c in self._chains if c.name not in gone]
        known = {name: fixes for name, fixes in self._known.items() if name not in gone}
        others = [e for e in self.apart if e[0] not in {c.name for c in self._chains} | gone]
        number = {i: k for k, i in enumerate(i for i, c in enumerate(self._chains) if c.name not in gone)}
        # a map without known fixes keeps its frame by one walk of each group that stays
        kept = [] if known else [part for g in self._groups if (part := g.of_seeds(number)) is not None]
        return replace(_mapped(chains, others, known, self._salt, kept, self._north), _place=self._place)

    def save(self, folder: str | Path, *, times: bool = False) -> Path:
        """Write the map to a folder, in place of an earlier map.

        By default it contains no times, names of walks, known fixes or notes.

        Parameters
        ----------
        folder : str or Path
            Folder to write. It is made if it does not exist.
        times : bool, default False
            True to keep the times of the steps, the names of the walks, their known fixes and their notes.

        Returns
        -------
        Path
            The folder.
        """
        folder = Path(folder)
        chains = list(self._chains) if times else without_times(self._chains)
        new_name = {old.name: new.name for old, new in zip(self._chains, chains, strict=True)}
        known = {name: tuple(fixes) for name, fixes in self._known.items()} if times else {}
        # other reasons have names of files and walks
        apart = [
            (new_name[name], why)
            if name in new_name
            else (f"recording {i + 1}", "not usable, or a copy of another one")
            for i, (name, why) in enumerate(self.apart)
        ]
        card = {
            "kind": "walk_map",
            "format_version": _FORMAT,
            "n_walks": len(chains),
            "apart": list(self.apart) if times else apart,
            "notes": list(self.notes) if times else [],
            "version": __version__,
        }
        files = {folder / f"{i:05d}.walk": to_bytes(chain) for i, chain in enumerate(chains)}
        files[folder / "groups.bin"] = to_bytes((self._groups, known, self._north, self._place))
        write_files(files | {folder / "walk_map.json": (json.dumps(card, indent=2) + "\n").encode()})
        # an earlier map in this folder can have had more walks
        for path in set(folder.glob("?????.walk")) - files.keys():
            path.unlink()
        return folder

    @classmethod
    def load(cls, folder: str | Path, salt: str | None = None) -> WalkMap:
        """Return the map of a folder written by `save`.

        Parameters
        ----------
        folder : str or Path
            The folder.
        salt : str, optional
            Salt of the addresses of access points, needed to add walks to a hashed map.

        Returns
        -------
        WalkMap
            The map.

        Raises
        ------
        ValueError
            If the folder is not a map of this version of the package.
        """
        folder = Path(folder)
        try:
            card = read_json(folder / "walk_map.json", limits.MAX_DESCRIPTION_BYTES)
            if card["kind"] != "walk_map" or card["format_version"] != _FORMAT:
                raise ValueError(f"its format is {card['format_version']}, this version reads {_FORMAT}")
            walks = [folder / f"{i:05d}.walk" for i in range(card["n_walks"])]
            chains: tuple[Chain, ...] = tuple(from_bytes(read_small(w, limits.MAX_WHOLE_BYTES)) for w in walks)
            groups, known, north, *place = from_bytes(read_small(folder / "groups.bin", limits.MAX_WHOLE_BYTES))
            apart = tuple((name, why) for name, why in card["apart"])
            found = _result(chains, groups, apart, tuple(card["notes"]), known, salt, north)
            return replace(found, _place=place[0] if place else None)
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise ValueError(
                f"{folder}: not a map of walks ({error}): check the folder, or map the recordings again"
            ) from error

    def _walks_of(self, group: int) -> list[MappedWalk]:
        """Return the walks of a group. Raise ValueError for an unknown group."""
        if not 0 <= group < self.n_groups:
            raise ValueError(
                f"group must be from 0 to {self.n_groups - 1}, got {group}"
                if self.n_groups
                else "no walks were joined: apart has the reasons"
            )
        return [w for w in self.walks if w.group == group]


def map_walks(
    recordings: Iterable[Recording | str | Path],
    known: Iterable[tuple[str, Known]] = (),
    *,
    origin: Origin | tuple[float, float] | None = None,
    salt: str | None = None,
    cache: str | Path | None = None,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> WalkMap:
    """Return a map of the walks of one or several buildings, without a floor plan or a survey.

    Each recording is tracked, and walks are joined where their Wi-Fi scans recognise a place. A walk that could be at
    two places, or that the other walks contradict, stays apart and is named with the reason. Joined walks are solved
    together, with position, rotation, step scale and drift of each walk.

    Parameters
    ----------
    recordings : iterable of Recording, str or Path
        Recordings with Wi-Fi. Files are read and tracked one by one.
    known : iterable of tuple of str and PositionFix or HeadingFix
        Known positions and headings, each with the name of its walk. They define the frame of the map, together with
        the marks beside recordings in files (`fixes.csv`), which are converted to the first geographic origin among
        them. Without them, the origin is the start of one walk, and north is magnetic north. Fixes that contradict the
        steps of their walk, each other, or the other walks are not used, and `notes` names them.
    origin : Origin or tuple of float, optional
        Latitude and longitude of the building in degrees, to a few kilometres. With the declination there, the
        magnetometers of all walks say where true north is.
    salt : str, optional
        Secret text with which the addresses of access points are hashed.
    cache : str or Path, optional
        Folder of tracked walks. A run that was killed continues from it. Only for recordings in files.
    jobs : int, default 1
        Number of processes that track walks, or -1 for the number of cores.
    scheduler : str, optional
        Address of a Dask scheduler that tracks walks, instead of `jobs`.
    progress : callable, optional
        Called with the number of tracked walks and the number of recordings.

    Returns
    -------
    WalkMap
        Walks with positions and covariances, walks apart, radio map, density and plan.

    Raises
    ------
    ValueError
        If there are no recordings, or if a known fix names an unknown walk or is outside of its walk.

    See Also
    --------
    WalkMap : Result of this function.
    pdr_filter.RadioMap.fit : Radio map from walks with known positions.

    Notes
    -----
    Walks are placed as rigid shapes first, by the likelihood of all their scans over a grid of positions and rotations.
    The rigid poses of all walks then maximise the joint likelihood of their fingerprints, which are a Gaussian process
    over the storey. Each placed walk is confirmed by the others.

    References
    ----------
    B. Ferris, D. Fox and N. Lawrence, "WiFi-SLAM using Gaussian process latent variable models", IJCAI 2007.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk_map = pdr.map_walks([pdr.simulate.demo_walk()])
    >>> walk_map.n_groups, len(walk_map.apart)
    (0, 1)
    """
    chains, apart, marks = _chains_of(recordings, cache, salt, jobs, scheduler, progress)
    marked, place = in_one_frame(marks)
    if not chains and not apart:
        raise ValueError("recordings is empty: give at least one recording")
    north = UNKNOWN_NORTH if origin is None else (Origin.of(origin).declination_rad(), DECLINATION_STD_RAD)
    found = _mapped(chains, apart, _by_name([*marked, *known], chains), salt, north=north)
    return replace(found, _place=place)


def in_one_frame(
    marks: Sequence[tuple[str, Marks]], place: Origin | None = None
) -> tuple[list[tuple[str, Known]], Origin | None]:
    """Return the fixes in the marks of walks, with their names, in one frame, and the geographic origin of the frame.

    It is `place`, or the first origin among the marks. Marks without an origin are taken to be in this frame.
    """
    fixes: list[tuple[str, Known]] = []
    for name, of_walk in marks:
        place = place or of_walk.origin
        shift_m = np.zeros(2)
        if place is not None and of_walk.origin is not None:
            shift_m = place.east_north_m(of_walk.origin.latitude_deg, of_walk.origin.longitude_deg)
        for fix in of_walk.fixes:
            if isinstance(fix, PositionFix) and shift_m.any():
                fix = replace(fix, position_m=fix.position_m + shift_m)
            fixes.append((name, fix))
    return fixes, place


def _by_name(known: Iterable[tuple[str, object]], chains: Sequence[Chain]) -> dict[str, list[Known]]:
    """Return the known positions and headings of each walk, by its name."""
    names, found = {c.name: c.span_s for c in chains}, dict[str, list[Known]]()
    for name, fix in known:
        if name not in names:
            raise ValueError(
                f"known names the walk {name!r}, which is not among the usable recordings: give one of the names "
                f"{', '.join(sorted(names)[:10]) or '(there are none)'}"
            )
        if not isinstance(fix, PositionFix | HeadingFix):
            raise ValueError(f"known must have PositionFix or HeadingFix, got {type(fix).__name__} for {name!r}")
        start_s, end_s = names[name]
        if not start_s - OUTSIDE_S <= fix.time_s <= end_s + OUTSIDE_S:
            raise ValueError(
                f"known has a fix at {fix.time_s} s for the walk {name!r}, which is from {start_s:.1f} to {end_s:.1f} "
                "s: give the time on the clock of its samples"
            )
        found.setdefault(name, []).append(fix)
    return found


def _chains_of(
    recordings: Iterable[Recording | str | Path],
    cache: str | Path | None,
    salt: str | None,
    jobs: int,
    scheduler: str | None,
    progress: Callable[[int, int], None] | None = None,
    earlier: Sequence[Chain] = (),
) -> tuple[list[Chain], list[tuple[str, str]], list[tuple[str, Marks]]]:
    """Return the chains of recordings, the names and reasons of unusable recordings, and the marks beside them.

    No two chains have the same name, also among `earlier` chains, and copies of a recording are unusable. Marks come
    with the name of their walk.
    """
    load_optional("gtsam")  # otherwise every recording would be unusable for the same reason
    items = [r if isinstance(r, Recording) else str(r) for r in recordings]
    work = partial(cached_chain, cache=None if cache is None else str(cache), salt=salt)
    found: dict[int, Chain | Failure] = {}
    for i, result in each(work, items, jobs=jobs, scheduler=scheduler):
        found[i] = result
        if progress is not None:
            progress(len(found), len(items))
    chains: list[Chain] = []
    apart: list[tuple[str, str]] = []
    marks: list[tuple[str, Marks]] = []
    by_key, taken = {c.key: c.name for c in earlier}, {c.name for c in earlier}
    for i, item in enumerate(items):
        result = found[i]
        if isinstance(result, Failure):
            apart.append((item.name if isinstance(item, Recording) else Path(item).name, result.reason))
        elif result.key in by_key:
            why = f"the same recording as {by_key[result.key]}: one of them is enough"
            apart.append((f"{result.name} (copy)", why))
        else:
            chain = replace(result, name=free_name(result.name or "walk", taken.__contains__, "{} ({})"))
            by_key[chain.key] = chain.name
            taken.add(chain.name)
            chains.append(chain)
            if isinstance(item, str):
                marks.append((chain.name, read_marks(item)))
    return chains, apart, marks


def _mapped(
    chains: Sequence[Chain],
    apart: Sequence[tuple[str, str]],
    known: Mapping[str, Sequence[Known]],
    salt: str | None,
    before: Sequence[_JoinedGroup] = (),
    north: tuple[float, float] = UNKNOWN_NORTH,
) -> WalkMap:
    """Return the map of chains: walks are placed as rigid shapes, grouped, and each group is solved together.

    Walks of the groups in `before` stay where they are. `apart` has the names and reasons of unusable recordings, to
    which walks that cannot be joined are added. `known` has the fixes of each walk by its name.
    """
    walks = ScannedWalks.of(chains)
    reasons = {i: "no Wi-Fi scans: record Wi-Fi with the walk" for i, c in enumerate(chains) if not len(c.scans)}
    fixes, notes = _consistent_fixes(chains, known, north)
    free = {i for i in range(len(chains)) if i not in reasons}
    groups = [JoinedWalks(g.poses, {i: g.poses[i] for i in g.seeds}, g.north_rad, north) for g in before]
    fixed = [g.states for g in before]
    is_known = [g.is_known for g in before]
    free -= {i for g in groups for i in g.poses}
    seeds = {i: pose for i in fixes if i in free and (pose := _known_pose(chains[i], fixes[i])) is not None}
    home = next((k for k, flag in enumerate(is_known) if flag), None)
    of_known = JoinedWalks({}, {}, north[0], north) if home is None else groups[home]
    for i in sorted(doubtful_seeds(walks, of_known, seeds, free - seeds.keys())):
        del seeds[i], fixes[i]
        notes.append(
            f"the known positions of {chains[i].name} are not used: its Wi-Fi scans place it more than 24 m away among "
            "the walks around the other known positions: check the places and their frame"
        )
    if seeds:
        of_known.poses.update(seeds)
        of_known.seeds = {**of_known.seeds, **seeds}
        free.difference_update(seeds)
        if home is None:
            groups, fixed, is_known = [of_known, *groups], [{}, *fixed], [True, *is_known]
    for group in groups:
        _extend(walks, group, free, reasons)
    todo = sorted(free, key=lambda i: (-len(walks.partners[i] & free), i))
    for i in todo:
        if i not in free or not walks.partners[i] & free:
            continue
        pose = WalkPose(north[0] if chains[i].knows_north else 0.0, np.zeros(2))
        group = JoinedWalks({i: pose}, {i: pose}, north[0], north)
        free.discard(i)
        _extend(walks, group, free, reasons)
        if len(group.poses) > 1:
            groups, fixed, is_known = [*groups, group], [*fixed, {}], [*is_known, False]
        else:
            free.add(i)
    solved: list[_JoinedGroup] = []
    for group, earlier, flag in zip(groups, fixed, is_known, strict=True):
        if not group.poses:
            continue
        states = dict(earlier)
        pending = [i for i in group.poses if i not in states]
        # the first walks are solved together, and later ones fitted to them, so that the cost grows linearly
        for start in range(0, max(len(pending), 1), MOST_TOGETHER):
            some = {*states, *pending[start : start + MOST_TOGETHER]}
            part = replace(group, poses={i: p for i, p in group.poses.items() if i in some})
            states = solve_group(walks, part, fixes, states)
        for i in set(states) - set(earlier) - set(group.seeds):
            if np.median(worst_std_m(states[i].joint_cov[:, :2, :2])) <= _MOST_STD_M:
                continue
            reasons[i] = f"its place may be wrong by {_ACCURATE_M:.0f} m: walk longer, or through mapped places"
            del states[i], group.poses[i]
        number = tuple(sorted(states))
        pose, state = tuple(group.poses[i] for i in number), tuple(states[i] for i in number)
        solved.append(_JoinedGroup(number, pose, state, tuple(sorted(group.seeds)), group.north_rad, flag))
    solved.sort(key=lambda g: (not g.is_known, -len(g.number)))
    joined = {i for g in solved for i in g.number}
    for i, chain in enumerate(chains):
        if i not in joined:
            why = reasons.get(i) or (
                "its place among the other walks is ambiguous: walk longer, or through mapped places"
                if walks.partners[i]
                else "recognises no place of another walk: walk through mapped places"
            )
            apart = [*apart, (chain.name, why)]
    heard = {i for i, chain in enumerate(chains) if len(chain.scans)}
    return _result(chains, solved, apart, (*notes, *_storeys_without_map(solved, heard)), known, salt, north)


def _consistent_fixes(
    chains: Sequence[Chain], known: Mapping[str, Sequence[Known]], north: tuple[float, float]
) -> tuple[dict[int, list[Known]], list[str]]:
    """Return the fixes of each walk, by its index, that do not contradict its steps or each other, and notes."""
    fixes, notes = dict[int, list[Known]](), list[str]()
    for i, chain in enumerate(chains):
        if chain.name in known:
            wrong = contradicting(chain, known[chain.name], north)
            fixes[i] = [fix for fix in known[chain.name] if fix not in wrong]
            for fix in wrong:
                kind = "position" if isinstance(fix, PositionFix) else "heading"
                notes.append(
                    f"the known {kind} of {chain.name} at {fix.time_s:.1f} s is not used: its steps and its other "
                    "fixes contradict it: check the place, the heading and the time"
                )
    return fixes, notes


def _storeys_without_map(groups: Sequence[_JoinedGroup], heard: set[int]) -> list[str]:
    """Return a note for each storey with a known walk, to which none of the other walks with scans was joined."""
    left = heard - {i for g in groups if g.is_known for i in g.number}
    with_seeds = {g.poses[i].floor for g in groups if g.is_known for i in g.seeds}
    with_others = {g.poses[i].floor for g in groups if g.is_known for i in g.number if i not in g.seeds}
    return [
        f"storey {floor} has no map: no place among its known walks is sure for any other walk, because too few walks "
        "pass the same places: record more walks there, or give known positions of more walks"
        for floor in sorted(with_seeds - with_others)
        if left
    ]


def _extend(walks: ScannedWalks, group: JoinedWalks, free: set[int], reasons: dict[int, str]) -> None:
    """Join walks of `free` to a group, and remove joined walks whose places the other walks do not confirm.

    The group is changed, but its present walks stay. Joined walks leave `free`. `reasons` gets the reason of each
    removed walk, by its index. If walks with partners in a small group are left, the group is grown at another pace as
    well, and the more probable result counts.
    """
    kept = frozenset(group.poses)
    tries: list[tuple[JoinedWalks, set[int], dict[int, str]]] = []
    for pace in PACES:
        grown, left = replace(group, poses=dict(group.poses)), set(free)
        if len(grown.poses) > 1:
            adjust(walks, grown, list(grown.poses))
        grow(walks, grown, left, pace)
        why = "the other walks contradict its place: access points may have been moved"
        removed = dict.fromkeys(settle(walks, grown, kept), why)
        adjust(walks, grown, list(grown.poses), n_iterations=25)
        why = "the walks joined on its storey do not agree with the walk that defines the frame: more walks are needed"
        removed |= dict.fromkeys(drop_doubtful_storeys(walks, grown, kept), why)
        tries.append((grown, left, removed))
        is_small = len(grown.poses) <= MOST_TOGETHER and (len(grown.poses) > 1 or removed)
        if not is_small or not any(walks.partners[i] & grown.poses.keys() for i in (*left, *removed)):
            break
    best, left, removed = max(tries, key=lambda of: log_evidence(walks, of[0])) if len(tries) > 1 else tries[0]
    group.poses, group.north_rad = best.poses, best.north_rad
    free.intersection_update(left)
    reasons.update(removed)


def _known_pose(chain: Chain, fixes: Sequence[Known]) -> WalkPose | None:
    """Return the rigid pose (rotation, shift, storey) of a walk that its fixes define, or None without a position.

    The rotation comes from the first heading fix, or else from the shape of several positions. For a single position
    without a heading it is zero.
    """
    places = [f for f in fixes if isinstance(f, PositionFix)]
    headings = [f for f in fixes if isinstance(f, HeadingFix)]
    if not places:
        return None
    own = chain.position_m(np.array([chain.step_at(f.time_s) for f in places]))
    at = np.array([f.position_m for f in places])
    turn_rad = 0.0
    if headings:
        step = chain.step_at(headings[0].time_s)
        node = int(chain.node_of(np.array([step]))[0][0])
        turn_rad = headings[0].walking_heading_rad - chain.device_rad_at(step) - float(chain.mean[node, 2])
    elif len(places) > 1:
        a, b = (own - own.mean(axis=0)) @ [1, 1j], (at - at.mean(axis=0)) @ [1, 1j]
        turn_rad = -float(np.angle(np.vdot(a, b)))
    floors = [f.floor - int(chain.floor[chain.step_at(f.time_s)]) for f in places if f.floor is not None]
    return WalkPose(
        turn_rad, at.mean(axis=0) - own.mean(axis=0) @ clockwise_rotation(turn_rad), floors[0] if floors else 0
    )


def _result(
    chains: Sequence[Chain],
    groups: Sequence[_JoinedGroup],
    apart: Sequence[tuple[str, str]],
    notes: tuple[str, ...],
    known: Mapping[str, Sequence[Known]],
    salt: str | None,
    north: tuple[float, float],
) -> WalkMap:
    """Return the map of solved groups, with positions and covariances of all their walks."""
    found = list[MappedWalk]()
    for number, group in enumerate(groups):
        for i, pose, state in zip(group.number, group.pose, group.state, strict=True):
            position_m, cov_m2 = step_positions(chains[i], state)
            floor = chains[i].floor + pose.floor
            found.append(
                MappedWalk(chains[i].name, number, chains[i].time_s, read_only(position_m), read_only(cov_m2), floor)
            )
    moved = _moved_access_points(chains, groups, found)
    return WalkMap(tuple(found), tuple(apart), moved, notes, tuple(chains), tuple(groups), dict(known), salt, north)


def _moved_access_points(
    chains: Sequence[Chain], groups: Sequence[_JoinedGroup], walks: Sequence[MappedWalk]
) -> tuple[int, ...]:
    """Return the addresses of access points that were received strongly at distant places of one group, ascending."""
    moved: set[int] = set()
    for number, group in enumerate(groups):
        scans = [chains[i].scans for i in group.number]
        loud = [s.rssi_dbm >= _LOUD_DBM for s in scans]
        heard = np.concatenate([s.bssid[of] for s, of in zip(scans, loud, strict=True)])
        of_group = zip((w for w in walks if w.group == number), scans, loud, strict=True)
        at_m = np.concatenate([w.position_m[s.step[s.row[of]]] for w, s, of in of_group])
        known, first = np.unique(heard[order := np.argsort(heard)], return_index=True)
        extent_m = np.maximum.reduceat(at_m[order], first) - np.minimum.reduceat(at_m[order], first)
        moved |= set(known[extent_m.max(axis=1) > _MOVED_M].tolist())
    return tuple(sorted(moved))
