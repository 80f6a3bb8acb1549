"""Chains: walks reduced to knots every few metres, with their Wi-Fi scans, as input of a problem of many walks."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, LOG_SCALE, MAX_HEADING_VARIANCE
from pdr_filter.offline.smoothing.preintegration import scaled_rotation
from pdr_filter.offline.smoothing.problem import Problem
from pdr_filter.values import FloatArray, IntArray, Wifi, loudness
from pdr_filter.values.recording import Recording
from pdr_filter.values.safe_files import write_files
from pdr_filter.values.serialisation import from_bytes, to_bytes
from pdr_filter.version import __version__

# Largest time between two knots: five to seven metres of walking.
KNOT_S = 5.0
# Scans with fewer access points are not used as fingerprints (as in `apps.maps.radio.radio_map`).
_MIN_ACCESS_POINTS = 5
# Shortest distance walked between two scans. Closer scans have the same errors and cost time.
_SCAN_M = 2.0
# Prior standard deviation of the start of a walk, of which only the region is known.
_REGION_STD_M = 1000.0


@dataclass(frozen=True, slots=True, eq=False)
class Scans:
    """Wi-Fi scans of a walk, at points of its chain."""

    step: IntArray  # (S,) number of steps before each scan
    first: IntArray  # (S + 1,) first reception of each scan, and the number of receptions
    bssid: IntArray  # (H,) addresses of the received access points
    rssi_dbm: FloatArray  # (H,) received power

    def __len__(self) -> int:
        return len(self.step)

    @property
    def row(self) -> IntArray:
        """Number of the scan (H,) of each reception."""
        return np.repeat(np.arange(len(self)), np.diff(self.first))

    @property
    def fingerprint(self) -> FloatArray:
        """Loudness (H,) of each reception, scaled so that the fingerprint of each scan has unit length."""
        level = loudness(self.rssi_dbm)
        return level / np.sqrt(np.bincount(self.row, level**2, minlength=len(self)))[self.row]


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """One walk: its steps summed between N knots, its scans, and its storeys."""

    name: str
    key: str  # checksum of the recording and the options
    problem: Problem  # of the walk alone, with a free start
    mean: FloatArray  # (N, 4) states at the knots, from the walk alone
    frame_rad: float  # rotation of the frame of the heading offsets
    knows_north: bool  # from the magnetometer
    span_s: tuple[float, float]  # first and last time of the recording, zeros in maps without times
    time_s: FloatArray  # (K,) times of the steps, empty in maps without times
    device_rad: FloatArray  # (K,) walking heading of each step minus its heading offset
    floor: IntArray  # (K + 1,) storeys before the first and after each step, relative to the start
    scans: Scans
    notes: tuple[str, ...]  # warnings of the track

    @property
    def n_knots(self) -> int:
        """Number of knots, which are the points of the walk at which a state is estimated."""
        return self.problem.n_nodes

    def node_of(self, step: IntArray) -> tuple[IntArray, FloatArray]:
        """Return the knot at or before each point of the chain, and the displacement (n, 2) from the knot to the point.

        A point is given by the number of steps before it. A knot is a point with a state, given by its index. The
        displacement is before heading offset and scale.
        """
        intervals = self.problem.intervals
        node = np.searchsorted(intervals.nodes, step, side="right") - 1
        inside = step > intervals.nodes[node]
        return node, np.where(inside[:, None], intervals.sum_m[np.maximum(step - 1, 0)], 0.0)

    def position_m(self, step: IntArray) -> FloatArray:
        """Return the positions (n, 2), in the frame of the walk alone, of points after numbers of steps."""
        node, ahead = self.node_of(step)
        rotation = scaled_rotation(self.mean[node, HEADING_OFFSET], self.mean[node, LOG_SCALE])
        return self.mean[node, :2] + np.einsum("nab,nb->na", rotation, ahead)

    def step_at(self, time_s: float) -> int:
        """Return the number of steps before a time."""
        return int(np.searchsorted(self.time_s, time_s, side="right"))

    def device_rad_at(self, step: int) -> float:
        """Return the walking heading minus the heading offset of the last of a number of steps, or of the first one."""
        return float(self.device_rad[max(step - 1, 0)])


def chain_of(recording: Recording, key: str = "", salt: str | None = None) -> Chain:
    """Return the chain of a recording: its steps summed between knots, solved for this walk alone, and its scans.

    `key` identifies the walk. `salt` hashes the addresses of access points. ValueError if the recording has no steps.
    """
    # imported late, because a radio map that is only read does not need the smoother
    from pdr_filter.offline.smoothing.smooth import chain_problem
    from pdr_filter.offline.smoothing.solve import solve

    track, device_rad, problem = chain_problem(recording, KNOT_S)
    knows_north = len(problem.states) > 0
    alone = solve(problem)
    start_cov = problem.start_cov.copy()
    start_cov[:2, :2] = _REGION_STD_M**2 * np.eye(2)
    frame_std_rad = problem.frame_std_rad
    if not knows_north:
        start_cov[HEADING_OFFSET, HEADING_OFFSET] = MAX_HEADING_VARIANCE
        frame_std_rad = float(np.sqrt(MAX_HEADING_VARIANCE))
    wifi = recording.wifi if salt is None or recording.wifi is None else hashed(recording.wifi, salt)
    return Chain(
        name=recording.name,
        key=key,
        problem=replace(problem, start_cov=start_cov, frame_std_rad=frame_std_rad),
        mean=alone.mean,
        frame_rad=alone.frame_rad,
        knows_north=knows_north,
        span_s=(track.start_time_s, max(track.start_time_s + track.duration_s, float(track.time_s[-1]))),
        time_s=np.asarray(track.time_s),
        device_rad=device_rad,
        floor=np.concatenate([track.floor[:1], track.floor]).astype(np.int64),
        scans=_scans(wifi, track.time_s, track.walked_m),
        notes=track.notes,
    )


def _scans(wifi: Wifi | None, time_s: FloatArray, walked_m: FloatArray) -> Scans:
    """Return the scans during the walk with at least five access points, at least two metres of walking apart."""
    kept, last_m = [], -np.inf
    for scan in () if wifi is None else wifi.scans():
        if len(scan.bssid) < _MIN_ACCESS_POINTS or not time_s[0] - 1.0 <= scan.time_s <= time_s[-1] + 1.0:
            continue
        at_m = float(np.interp(scan.time_s, time_s, walked_m))
        if at_m - last_m >= _SCAN_M:
            kept, last_m = [*kept, scan], at_m
    counts = [len(s.bssid) for s in kept]
    # the nearest contact is at most half a step away, which is less than the path walked during a scan
    step = np.searchsorted(time_s, [s.time_s for s in kept])
    return Scans(
        step=step.astype(np.int64),
        first=np.cumsum([0, *counts]).astype(np.int64),
        bssid=np.concatenate([s.bssid for s in kept]) if kept else np.zeros(0, dtype=np.int64),
        rssi_dbm=np.concatenate([s.rssi_dbm for s in kept]) if kept else np.zeros(0),
    )


def hashed(wifi: Wifi, salt: str) -> Wifi:
    """Return the receptions with hashed addresses: the first 48 bits of SHA-256 of the salt and the address.

    Without the salt, addresses can neither be looked up in a public register nor compared with another map.

    Parameters
    ----------
    wifi : Wifi
        Receptions.
    salt : str
        Secret text, the same for all walks of a map.

    Returns
    -------
    Wifi
        Receptions with other addresses.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.apps.walk_map.chains import hashed
    >>> wifi = pdr.Wifi([0.0, 0.1], [11, 12], [-50.0, -70.0], [2412.0, 2437.0])
    >>> hashed(wifi, "secret").n_access_points
    2
    """
    known, number = np.unique(wifi.bssid, return_inverse=True)
    other = [int.from_bytes(hashlib.sha256(f"{salt}\n{b}".encode()).digest()[:6], "big") for b in known.tolist()]
    return replace(wifi, bssid=np.array(other, dtype=np.int64)[number])


def cached_chain(recording: Recording | str, cache: str | None, salt: str | None) -> Chain:
    """Return the chain of a recording, or of one in a file, which comes from the folder `cache` if it is unchanged.

    Each chain is written when it is finished, so that a killed run resumes. `salt` hashes the addresses.
    """
    from pdr_filter.apps.maps.marks import checksum_of
    from pdr_filter.data.io.formats import read

    content = checksum_of(Path(recording)) if isinstance(recording, str) else content_of(recording)
    key = hashlib.sha256(f"{content}\n{salt}\n{__version__}".encode()).hexdigest()[:32]
    if isinstance(recording, Recording):
        return chain_of(recording, key, salt)
    file = None if cache is None else Path(cache) / f"{key}.chain"
    if file is not None and file.exists():
        with suppress(ValueError):  # a file of another version, or damaged: computed again
            if isinstance(found := from_bytes(file.read_bytes()), Chain):
                return found
    chain = chain_of(read(recording), key, salt)
    if file is not None:
        write_files({file: to_bytes(chain)})
    return chain


def content_of(recording: Recording) -> str:
    """Return the checksum of the samples and the Wi-Fi of a recording in memory."""
    parts = [part for name, s in recording.streams.items() for part in (name.encode(), s.time_s, s.values)]
    if (wifi := recording.wifi) is not None:
        parts += [wifi.time_s, wifi.bssid, wifi.rssi_dbm]
    found = hashlib.sha256()
    for part in parts:
        found.update(bytes(part))
    return found.hexdigest()


def without_times(chains: Sequence[Chain]) -> list[Chain]:
    """Return chains (walks reduced to knots and scans) without times and notes, named "walk 1", "walk 2" and so on."""
    nothing = {"span_s": (0.0, 0.0), "time_s": np.zeros(0), "notes": ()}
    return [replace(c, name=f"walk {i + 1}", **nothing) for i, c in enumerate(chains)]
