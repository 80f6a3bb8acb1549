"""A radio map: fitted on walks whose places are known, asked where other walks were."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.sparse import csr_matrix

from pdr_filter.classifiers.model_files import Arrays, ArtefactFormat, file_pair
from pdr_filter.maps.radio.signal_field import CELL_M, Field, fingerprints
from pdr_filter.tracking.track import Track
from pdr_filter.values import FloatArray, GridFix, IntArray, PositionFix, Wifi, WifiScan, interpolated, read_only
from pdr_filter.values.recording import MissingSensorError, Recording
from pdr_filter.version import __version__

FORMAT = ArtefactFormat("radio_map", 1, "fit it again, or use the version that wrote it")
_ARRAYS = ("position_m", "floor", "bssid", "point", "access_point", "rssi_dbm")
# Fewer access points that the map knows are no fingerprint: a phone that walks along has one too.
_FEWEST = 5
# Variance of each axis that the map does not know of: a waypoint is good to a metre, a scan is 1.4 s of walking, a cell
# has a width, and the sharpest fixes of walks left out are wrong by so much more (chosen with `signal_field.EVIDENCE`).
_OWN_VAR_M2 = 6.0
# Two scans of one place err alike until the walker has left what the map does not tell apart: for 12 s where they are
# 5 m wide, for 20 s where 8 m (correlation of the errors of pairs of scans on storey F1 of `ms_indoor`). Wider ones are
# taken to go on like that.
_CORRELATION_S_PER_M = 2.4
# More often than this share of that time fixes would hardly say more, and those that show the turn of a track are few.
_INTERVAL_SHARE = 0.5
# A scan that fits places further apart is no position with an error: several corridors, or all that nobody mapped.
_WIDEST_STD_M = 15.0
# Scans in a row count for particles as if their errors were alike for so long: a fifth of each scan of a phone that has
# one every 2.5 s. Chosen on the storeys F1 and B1 of ms_indoor, of a tenth to four fifths: from two fifths on the
# regions of 95 % on F1 held 90 % of the waypoints and less. Errors last longer (above), but they are not those of a
# normal distribution here, and what agrees with the walls of the plan is right more often.
_GRID_CORRELATION_S = 6.0
# One scan in a hundred is of somewhere else: an access point was carried away, a phone told of an older scan.
_ASTRAY_PROB = 0.01
# The storey is said where it is as sure as this.
_SURE_OF_FLOOR = 0.95
_LARGEST_M, _MOST_POINTS, _HIGHEST_FLOOR = 1e6, 20_000, 1000


@dataclass(frozen=True, eq=False, repr=False)
class RadioMap:
    """What was heard at known places of a building; each storey is a field of its own.

    Parameters
    ----------
    position_m : (N, 2)
        East and north of each scan.
    floor : (N,)
        Its storey, 0 is the ground floor; NaN where nobody said it.
    bssid : (A,)
        Addresses of the access points, increasing.
    point, access_point, rssi_dbm : (H,)
        Which scan heard which access point how loud, dBm.
    card : dict
        What people should know: walks, version.

    Examples
    --------
    >>> import numpy as np
    >>> from dataclasses import replace
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.demo_walk()  # its truth has waypoints; a phone that logs Wi-Fi gives the rest
    >>> heard_s = np.repeat(np.arange(1.0, 100.0, 3.0), 2)
    >>> loud_dbm = np.where(np.arange(len(heard_s)) % 2, -50.0 - 0.2 * heard_s, -70.0 + 0.2 * heard_s)
    >>> wifi = pdr.Wifi(heard_s, np.tile([1, 2], len(heard_s) // 2), loud_dbm, np.full(len(heard_s), 2412.0))
    >>> radio = pdr.RadioMap.fit([replace(walk, wifi=wifi)])
    >>> _ = radio.save("building")
    >>> len(radio.bssid)
    2
    """

    position_m: FloatArray
    floor: FloatArray
    bssid: IntArray
    point: IntArray
    access_point: IntArray
    rssi_dbm: FloatArray
    card: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def __post_init__(self) -> None:
        for name in ("position_m", "floor", "rssi_dbm"):
            object.__setattr__(self, name, read_only(getattr(self, name), name))
        _check(self)

    def __repr__(self) -> str:
        return f"RadioMap({len(self.position_m)} scans, {len(self.bssid)} access points, {len(self._fields)} storeys)"

    @classmethod
    def fit(cls, walks: Iterable[Recording | tuple[Recording, Track]]) -> RadioMap:
        """The map of walks through one building.

        Parameters
        ----------
        walks : iterable of Recording, or of (Recording, Track)
            Recordings with Wi-Fi and waypoints, between which `pdr_filter.smooth` says the places. Or recordings with
            their tracks, all in one frame: of fixes, or of true north.

        Recordings without Wi-Fi are left out; ValueError if nothing is left.
        """
        positions: list[FloatArray] = []
        floors: list[float] = []
        scans: list[WifiScan] = []
        names: list[str] = []
        for walk in walks:
            recording, track = walk if isinstance(walk, tuple) else (walk, None)
            if recording.wifi is None:
                continue
            floor = np.nan
            if track is None:
                track, floor = _between_waypoints(recording)
            mapped = [(place, scan) for scan in recording.wifi.scans() if (place := _place(track, scan)) is not None]
            positions += [place for place, _ in mapped]
            scans += [scan for _, scan in mapped]
            floors += [floor] * len(mapped)
            names.append(recording.name)
        if not scans:
            raise ValueError("no walk has Wi-Fi scans on its way; give recordings with wifi and waypoints, or tracks")
        bssid = np.unique(np.concatenate([s.bssid for s in scans]))
        return cls(
            position_m=np.array(positions),
            floor=np.array(floors),
            bssid=bssid,
            point=np.repeat(np.arange(len(scans)), [len(s.bssid) for s in scans]),
            access_point=np.searchsorted(bssid, np.concatenate([s.bssid for s in scans])),
            rssi_dbm=np.concatenate([s.rssi_dbm for s in scans]),
            card={"version": __version__, "walks": names},
        )

    def fixes(self, recording: Recording) -> list[PositionFix]:
        """Where a recording was, scan by scan, with the covariance of what the map does not tell apart.

        Each is received when its scan ended. Errors of scans that follow each other are alike (`correlation_s`), and
        those that would say nothing new are left out. A scan gives no fix that hears fewer than five access points of
        the map, or that the map does not place within 15 m (standard deviation of an axis): where nobody walked, or too
        much is alike. The storey is said where it is 95 % sure. MissingSensorError without Wi-Fi.
        """
        found: list[PositionFix] = []
        for heard in self._located(_wifi_of(recording)):
            scan, cell_m, p = heard.scan, heard.field.cell_m, heard.prob
            mean = p @ cell_m
            apart = cell_m - mean
            cov = (p[:, None] * apart).T @ apart + _OWN_VAR_M2 * np.eye(2)
            std_m = float(np.sqrt(0.5 * np.trace(cov)))
            correlation_s = _CORRELATION_S_PER_M * std_m
            is_new = not found or scan.time_s - found[-1].time_s >= _INTERVAL_SHARE * correlation_s
            if std_m > _WIDEST_STD_M or not is_new:
                continue
            found.append(PositionFix(scan.time_s, mean, cov, scan.end_s, correlation_s, heard.sure_floor))
        return found

    def grids(self, recording: Recording) -> list[GridFix]:
        """How probable each place is, scan by scan: for particles on a floor plan, beside `fixes`.

        They say what a mean and a covariance cannot: this corridor or that one, not here. No scan is left out that
        hears five access points of the map. MissingSensorError without Wi-Fi.
        """
        found: list[GridFix] = []
        for heard in self._located(_wifi_of(recording)):
            cells = gaussian_filter(
                heard.prob.reshape(heard.field.shape), math.sqrt(_OWN_VAR_M2) / CELL_M, mode="constant"
            ).T
            here = (1.0 - _ASTRAY_PROB) * heard.floor_prob
            fix = GridFix(
                heard.scan.time_s,
                heard.field.cell_m[0] - 0.5 * CELL_M,
                CELL_M,
                np.log(here * cells + (1.0 - here) / cells.size),
                received_time_s=heard.scan.end_s,
                correlation_s=_GRID_CORRELATION_S,
                floor=heard.sure_floor,
            )
            found.append(fix)
        return found

    def _located(self, wifi: Wifi) -> Iterator[_Heard]:
        """Where the scans were that hear enough of the map."""
        scans = [s for s in wifi.scans() if np.isin(s.bssid, self.bssid).sum() >= _FEWEST]
        if not scans:
            return
        log_likelihood = [f.log_likelihood(self._heard(scans)) for _, f in self._fields]
        best = np.max([of_cell.max(axis=1) for of_cell in log_likelihood], axis=0)
        prob = [np.exp(of_cell - best[:, None]) for of_cell in log_likelihood]
        of_floor = np.array([p.sum(axis=1) for p in prob])
        of_floor /= of_floor.sum(axis=0)
        for i, scan in enumerate(scans):
            k = int(of_floor[:, i].argmax())
            floor, field_of_floor = self._fields[k]
            yield _Heard(scan, field_of_floor, prob[k][i] / prob[k][i].sum(), floor, float(of_floor[k, i]))

    def save(self, path: str | Path) -> Path:
        """Write NAME.json, with NAME.npz of plain arrays beside it, and return the path of the .json."""
        FORMAT.write(path, {"card": dict(self.card)}, {name: np.asarray(getattr(self, name)) for name in _ARRAYS})
        return file_pair(path)[0]

    @classmethod
    def load(cls, path: str | Path) -> RadioMap:
        """The map at a path; ValueError names the file and the remedy if it is missing, damaged or something else."""
        return FORMAT.read(path, _assemble)

    def _heard(self, scans: Sequence[WifiScan]) -> csr_matrix:
        """Fingerprints (S, A) of scans, without what the map does not know."""
        known = np.union1d(self.bssid, np.concatenate([s.bssid for s in scans]))
        index = np.repeat(np.arange(len(scans)), [len(s.bssid) for s in scans])
        column = np.searchsorted(known, np.concatenate([s.bssid for s in scans]))
        whole = fingerprints(index, column, np.concatenate([s.rssi_dbm for s in scans]), (len(scans), len(known)))
        return whole[:, np.searchsorted(known, self.bssid)]

    @cached_property
    def _fields(self) -> tuple[tuple[float, Field], ...]:
        heard = fingerprints(self.point, self.access_point, self.rssi_dbm, (len(self.floor), len(self.bssid)))
        floors = np.unique(self.floor)
        return tuple((float(f), Field.of(self.position_m[on := _on(self.floor, f)], heard[on])) for f in floors)


@dataclass(frozen=True, slots=True, eq=False)
class _Heard:
    """Where a scan was, on the storey that is the most probable."""

    scan: WifiScan
    field: Field
    prob: FloatArray  # (G,) of its cells, sums to one
    floor: float  # NaN where nobody said it
    floor_prob: float

    @property
    def sure_floor(self) -> int | None:
        return int(self.floor) if np.isfinite(self.floor) and self.floor_prob >= _SURE_OF_FLOOR else None


def _wifi_of(recording: Recording) -> Wifi:
    if recording.wifi is None:
        raise MissingSensorError(f"{recording.name or 'the recording'} has no Wi-Fi: record it, or go without a map")
    return recording.wifi


def _on(floor: FloatArray, of: float) -> Any:
    return np.isnan(floor) if np.isnan(of) else floor == of


def _between_waypoints(recording: Recording) -> tuple[Track, float]:
    """Track and storey of a recording with waypoints."""
    from pdr_filter.offline.smoothing.observations import waypoint_fixes
    from pdr_filter.offline.smoothing.smooth import smooth  # which loads gtsam

    fixes = waypoint_fixes(recording)
    floors = np.unique(np.asarray(getattr(recording.truth.waypoints, "floor", np.nan)))
    return smooth(recording, fixes).track, float(floors[0]) if len(floors) == 1 else np.nan


def _place(track: Track, scan: WifiScan) -> FloatArray | None:
    """Where a scan was heard, (2,); None if the track says nothing of its time."""
    inside = track.start_time_s - 1.0 <= scan.time_s <= track.start_time_s + track.duration_s + 1.0
    if not inside or track.n_steps == 0:
        return None
    time_s = np.concatenate([[min(track.start_time_s, track.time_s[0])], track.time_s])
    position_m = np.vstack([track.start_position_m, track.position_m])
    return interpolated(scan.time_s, time_s, position_m)


def _assemble(description: Mapping[str, Any], arrays: Arrays) -> RadioMap:
    content: dict[str, Any] = {name: arrays[name] for name in _ARRAYS}
    return RadioMap(**content, card=description["card"])


def _check(radio: RadioMap) -> None:
    """Raise ValueError unless the arrays fit together and are what they are called."""
    if radio.floor.ndim != 1 or radio.rssi_dbm.ndim != 1:
        raise ValueError(f"floor must be (N,) and rssi_dbm (H,), got {radio.floor.shape} and {radio.rssi_dbm.shape}")
    n, a, h = len(radio.floor), len(radio.bssid), len(radio.rssi_dbm)
    if radio.position_m.shape != (n, 2) or not 0 < n <= _MOST_POINTS:
        raise ValueError(
            f"position_m must be (N, 2) and floor (N,), N at most {_MOST_POINTS}, got {radio.position_m.shape} and {n}"
        )
    if not (np.abs(radio.position_m) <= _LARGEST_M).all():
        raise ValueError(f"position_m must be metres up to {_LARGEST_M:g}")
    known = radio.floor[~np.isnan(radio.floor)]
    if not (np.abs(known) <= _HIGHEST_FLOOR).all() or not (known == np.round(known)).all():
        raise ValueError(f"floor must be whole numbers up to {_HIGHEST_FLOOR}, NaN if not known")
    for name, largest in (("point", n), ("access_point", a), ("bssid", 1 << 48)):
        numbers = getattr(radio, name)
        if numbers.dtype.kind != "i" or numbers.ndim != 1 or not ((numbers >= 0) & (numbers < largest)).all():
            raise ValueError(f"{name} must be whole numbers from 0 to {largest - 1}")
    if not (np.diff(radio.bssid) > 0).all():
        raise ValueError("bssid must increase: each access point once")
    if len(radio.point) != h or len(radio.access_point) != h or not np.isfinite(radio.rssi_dbm).all():
        raise ValueError(f"point, access_point and rssi_dbm must be (H,) and finite, got {len(radio.point)}, {h}")
