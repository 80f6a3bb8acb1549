"""Radio maps, fitted to walks with known positions and used to estimate the positions of other walks."""

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

from pdr_filter.apps.maps.radio.signal_field import CELL_M, Field, fingerprints
from pdr_filter.classifiers.model_files import Arrays, ArtefactFormat, file_pair
from pdr_filter.tracking.track import Track
from pdr_filter.values import (
    FloatArray,
    GridFix,
    IntArray,
    PositionFix,
    Wifi,
    WifiScan,
    check_array,
    check_number,
    interpolated_rows,
    read_only,
)
from pdr_filter.values.recording import MissingSensorError, Recording
from pdr_filter.version import __version__

FORMAT = ArtefactFormat("radio_map", 1, "fit it again, or use the version that wrote it")
_ARRAYS = ("position_m", "floor", "bssid", "point", "access_point", "rssi_dbm")
# Smallest number of mapped access points in a usable scan. Fewer are not a fingerprint, because the scan may contain
# only devices that move with the pedestrian.
_MIN_ACCESS_POINTS = 5
# Variance of each axis that is added to the covariance of the map. A waypoint is accurate to a metre, a scan lasts 1.4
# s of walking, a cell has a width, and the sharpest fixes of held-out walks need this much more (chosen together with
# `signal_field.EVIDENCE`).
_ADDED_VAR_M2 = 6.0
# Correlation time of the errors per standard deviation. Errors of scans are correlated until the pedestrian has left
# the area that the map cannot resolve. On storey F1 of `ms_indoor`, the errors of pairs of scans are correlated for 12
# s where that area is 5 m wide, and for 20 s where it is 8 m wide. Wider areas are extrapolated.
_CORRELATION_S_PER_M = 2.4
# Smallest interval between two fixes, as a share of the correlation time. More frequent fixes would add almost no
# information, and only few fixes are available while the rotation of a track is estimated.
_INTERVAL_SHARE = 0.5
# Scans with a larger standard deviation give no fix. Such a scan fits several corridors or an unmapped area, and a mean
# with a covariance does not describe it.
_WIDEST_STD_M = 15.0
# Correlation time of grid fixes. A phone with a scan every 2.5 s thus counts each scan with a weight of about a fifth.
# Chosen among weights of a tenth to four fifths on storeys F1 and B1 of ms_indoor. From two fifths on, the 95 % regions
# on F1 held 90 % of the waypoints or less. The errors last longer (see above), but here they do not have the normal
# distribution, and positions that agree with the walls of the plan are more often right.
_GRID_CORRELATION_S = 6.0
# Prior probability that a scan was made elsewhere: an access point was moved, or the phone reported an older scan.
_ELSEWHERE_PROB = 0.01
# Smallest probability of the storey for a fix to state it.
_MIN_FLOOR_PROB = 0.95
_MOST_STD_M = 1000.0
_LARGEST_M, _MOST_POINTS, _HIGHEST_FLOOR = 1e6, 20_000, 1000


@dataclass(frozen=True, eq=False, repr=False)
class RadioMap:
    """Radio map of a building: Wi-Fi signal strengths at known positions, with one field per storey.

    Parameters
    ----------
    position_m : array (N, 2)
        East and north of each scan, in m.
    floor : array (N,)
        Storey of each scan, 0 for the ground floor, or NaN if unknown.
    bssid : array (A,) of int
        Addresses of the access points, increasing.
    point : array (H,) of int
        Index of the scan of each measurement.
    access_point : array (H,) of int
        Index of the access point of each measurement.
    rssi_dbm : array (H,)
        Signal strength of each measurement, in dBm.
    card : dict
        Description of the map: names of the walks and version of the package.
    position_std_m : float, default 0
        Standard deviation of the positions on each axis, in m, up to 1000. The covariances of fixes and the blur of
        grids include it. Zero for maps of `fit`, and not for those of `WalkMap.radio`.

    Raises
    ------
    ValueError
        If the arrays do not fit together or contain values out of range.

    Notes
    -----
    Each component of a fingerprint is a Gaussian process over the storey (see `apps.maps.radio.signal_field`).

    References
    ----------
    C. E. Rasmussen and C. K. I. Williams, Gaussian Processes for Machine Learning, 2006.

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
    position_std_m: float = 0.0

    def __post_init__(self) -> None:
        for name in ("position_m", "floor", "rssi_dbm"):
            object.__setattr__(self, name, read_only(getattr(self, name), name))
        _check(self)

    def __repr__(self) -> str:
        return f"RadioMap({len(self.position_m)} scans, {len(self.bssid)} access points, {len(self._fields)} storeys)"

    @classmethod
    def fit(cls, walks: Iterable[Recording | tuple[Recording, Track]]) -> RadioMap:
        """Return the radio map fitted to walks through one building.

        Recordings without Wi-Fi are ignored.

        Parameters
        ----------
        walks : iterable of Recording, or of tuple of Recording and Track
            Recordings with Wi-Fi and waypoints; `pdr_filter.smooth` then gives the positions between the waypoints. Or
            recordings with their tracks, all in one frame, for example tracks with fixes or with true north.

        Returns
        -------
        RadioMap
            Map of all scans whose positions are known.

        Raises
        ------
        ValueError
            If no walk has Wi-Fi scans at known positions.
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
            mapped = [(place, scan) for scan in recording.wifi.scans() if (place := _position(track, scan)) is not None]
            positions += [place for place, _ in mapped]
            scans += [scan for _, scan in mapped]
            floors += [floor] * len(mapped)
            names.append(recording.name)
        if not scans:
            raise ValueError(
                "no walk has Wi-Fi scans at known positions; give recordings with wifi and waypoints, or with tracks"
            )
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
        """Return one position fix per informative Wi-Fi scan of a recording.

        The position and the covariance of a fix are the mean and the covariance of the position over the cells of its
        most probable storey, given the scan. A variance of 6 m2 is added on each axis for the errors of the map, plus
        the variance of the mapped positions (`position_std_m`). The reception time of a fix is the end of the scan. The
        errors of successive scans are correlated (`correlation_s`), and scans that would add almost no information give
        no fix. A scan also gives no fix if it hears fewer than five access points of the map. The same applies if the
        standard deviation of its position is above 15 m per axis before the variance of the mapped positions is added,
        as in unmapped or ambiguous areas. The storey is set if its probability is at least 95 %.

        Parameters
        ----------
        recording : Recording
            A recording with Wi-Fi.

        Returns
        -------
        list of PositionFix
            Fixes in the frame of the map, in order of time.

        Raises
        ------
        MissingSensorError
            If the recording has no Wi-Fi.
        """
        found: list[PositionFix] = []
        for heard in self._located(_wifi_of(recording)):
            scan, cell_m, p = heard.scan, heard.field.cell_m, heard.prob
            mean = p @ cell_m
            apart = cell_m - mean
            cov = (p[:, None] * apart).T @ apart + _ADDED_VAR_M2 * np.eye(2)
            is_vague = np.trace(cov) > 2.0 * _WIDEST_STD_M**2
            cov += self.position_std_m**2 * np.eye(2)
            correlation_s = _CORRELATION_S_PER_M * float(np.sqrt(0.5 * np.trace(cov)))
            is_new = not found or scan.time_s - found[-1].time_s >= _INTERVAL_SHARE * correlation_s
            if is_vague or not is_new:
                continue
            found.append(PositionFix(scan.time_s, mean, cov, scan.end_s, correlation_s, heard.sure_floor))
        return found

    def grids(self, recording: Recording) -> list[GridFix]:
        """Return one grid of position probabilities per Wi-Fi scan of a recording.

        The grids are for a particle filter on a floor plan, in addition to `fixes`. They describe ambiguous positions,
        such as one of two corridors, for which a mean and a covariance are not sufficient. Every scan that hears at
        least five access points of the map gives a grid.

        Parameters
        ----------
        recording : Recording
            A recording with Wi-Fi.

        Returns
        -------
        list of GridFix
            Log probabilities of the cells, in order of time.

        Raises
        ------
        MissingSensorError
            If the recording has no Wi-Fi.
        """
        found: list[GridFix] = []
        for heard in self._located(_wifi_of(recording)):
            blur = math.hypot(math.sqrt(_ADDED_VAR_M2), self.position_std_m) / CELL_M
            cells = gaussian_filter(heard.prob.reshape(heard.field.shape), blur, mode="constant").T
            prob_on_map = (1.0 - _ELSEWHERE_PROB) * heard.floor_prob
            fix = GridFix(
                heard.scan.time_s,
                heard.field.cell_m[0] - 0.5 * CELL_M,
                CELL_M,
                np.log(prob_on_map * cells + (1.0 - prob_on_map) / cells.size),
                received_time_s=heard.scan.end_s,
                # successive scans share the errors of the mapped positions
                correlation_s=_GRID_CORRELATION_S + _CORRELATION_S_PER_M * self.position_std_m,
                floor=heard.sure_floor,
            )
            found.append(fix)
        return found

    def _located(self, wifi: Wifi) -> Iterator[_LocatedScan]:
        """Yield the position distribution of each usable scan, on its most probable storey."""
        scans = [s for s in wifi.scans() if np.isin(s.bssid, self.bssid).sum() >= _MIN_ACCESS_POINTS]
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
            yield _LocatedScan(scan, field_of_floor, prob[k][i] / prob[k][i].sum(), floor, float(of_floor[k, i]))

    def save(self, path: str | Path) -> Path:
        """Write the radio map to NAME.json and its arrays to NAME.npz.

        Parameters
        ----------
        path : str or Path
            Path with or without suffix.

        Returns
        -------
        Path
            Path of the .json file.
        """
        description = {"card": dict(self.card), "position_std_m": self.position_std_m}
        FORMAT.write(path, description, {name: np.asarray(getattr(self, name)) for name in _ARRAYS})
        return file_pair(path)[0]

    @classmethod
    def load(cls, path: str | Path) -> RadioMap:
        """Return the radio map of a file written by `save`.

        Parameters
        ----------
        path : str or Path
            Path with or without suffix.

        Returns
        -------
        RadioMap
            The radio map.

        Raises
        ------
        ValueError
            If the file is missing, damaged or not a radio map. The message names the file and the remedy.
        """

        def assembled(description: Mapping[str, Any], arrays: Arrays) -> RadioMap:
            content: dict[str, Any] = {name: arrays[name] for name in _ARRAYS}
            return cls(**content, card=description["card"], position_std_m=description.get("position_std_m", 0.0))

        return FORMAT.read(path, assembled)

    def _heard(self, scans: Sequence[WifiScan]) -> csr_matrix:
        """Return the fingerprints (S, A) of scans, restricted to the access points of the map.

        A fingerprint is scaled to unit length before access points that are not in the map are removed. A scan with
        many such access points therefore fits all places of the map less well.
        """
        known = np.union1d(self.bssid, np.concatenate([s.bssid for s in scans]))
        index = np.repeat(np.arange(len(scans)), [len(s.bssid) for s in scans])
        column = np.searchsorted(known, np.concatenate([s.bssid for s in scans]))
        whole = fingerprints(index, column, np.concatenate([s.rssi_dbm for s in scans]), (len(scans), len(known)))
        return whole[:, np.searchsorted(known, self.bssid)]

    @cached_property
    def _fields(self) -> tuple[tuple[float, Field], ...]:
        """Pairs of a storey number, ascending (NaN if unknown), and the field fitted to the scans of this storey."""
        heard = fingerprints(self.point, self.access_point, self.rssi_dbm, (len(self.floor), len(self.bssid)))
        floors, number = np.unique(self.floor, return_inverse=True)
        scans = [(float(floor), number == k) for k, floor in enumerate(floors)]
        return tuple((floor, Field.of(self.position_m[on], heard[on])) for floor, on in scans)


@dataclass(frozen=True, slots=True, eq=False)
class _LocatedScan:
    """Position distribution of a scan on its most probable storey: probabilities of the cells of the field there."""

    scan: WifiScan
    field: Field
    prob: FloatArray  # (G,) probability of each cell, sums to one
    floor: float  # NaN if unknown
    floor_prob: float  # probability of the storey

    @property
    def sure_floor(self) -> int | None:
        """Storey, or None if it is unknown or not probable enough."""
        return int(self.floor) if np.isfinite(self.floor) and self.floor_prob >= _MIN_FLOOR_PROB else None


def _wifi_of(recording: Recording) -> Wifi:
    """Return the Wi-Fi of a recording, or raise MissingSensorError."""
    if recording.wifi is None:
        raise MissingSensorError(
            f"{recording.name or 'the recording'} has no Wi-Fi: record it too, or do not use a radio map"
        )
    return recording.wifi


def _between_waypoints(recording: Recording) -> tuple[Track, float]:
    """Return the smoothed track of a recording with waypoints, and its storey (NaN if unknown or not unique)."""
    from pdr_filter.offline.smoothing.observations import waypoint_fixes
    from pdr_filter.offline.smoothing.smooth import smooth

    fixes = waypoint_fixes(recording)
    floors = np.unique(np.asarray(getattr(recording.truth.waypoints, "floor", np.nan)))
    return smooth(recording, fixes=fixes).track, float(floors[0]) if len(floors) == 1 else np.nan


def _position(track: Track, scan: WifiScan) -> FloatArray | None:
    """Return the position (2,) of a scan on a track, or None if the track does not cover the time of the scan."""
    inside = track.start_time_s - 1.0 <= scan.time_s <= track.start_time_s + track.duration_s + 1.0
    if not inside or track.n_steps == 0:
        return None
    time_s = np.concatenate([[min(track.start_time_s, track.time_s[0])], track.time_s])
    position_m = np.vstack([track.start_position_m, track.position_m])
    return interpolated_rows(scan.time_s, time_s, position_m)


def _check(radio: RadioMap) -> None:
    """Raise ValueError unless the arrays fit together and their values are in range."""
    if radio.floor.ndim != 1 or radio.rssi_dbm.ndim != 1:
        raise ValueError(f"floor must be (N,) and rssi_dbm (H,), got {radio.floor.shape} and {radio.rssi_dbm.shape}")
    n, a, h = len(radio.floor), len(radio.bssid), len(radio.rssi_dbm)
    if radio.position_m.shape != (n, 2) or not 0 < n <= _MOST_POINTS:
        raise ValueError(
            f"position_m must be (N, 2) and floor (N,) with N from 1 to {_MOST_POINTS}, got {radio.position_m.shape} "
            f"and ({n},)"
        )
    if not (np.abs(radio.position_m) <= _LARGEST_M).all():
        raise ValueError(f"position_m must be metres up to {_LARGEST_M:g} and finite: check the unit and the origin")
    known = radio.floor[~np.isnan(radio.floor)]
    if not (np.abs(known) <= _HIGHEST_FLOOR).all() or not (known == np.round(known)).all():
        raise ValueError(
            f"floor must be whole numbers from {-_HIGHEST_FLOOR} to {_HIGHEST_FLOOR}, or NaN for an unknown storey"
        )
    for name, largest in (("point", n), ("access_point", a), ("bssid", 1 << 48)):
        numbers = getattr(radio, name)
        if numbers.dtype.kind != "i" or numbers.ndim != 1 or not ((numbers >= 0) & (numbers < largest)).all():
            raise ValueError(
                f"{name} must be whole numbers from 0 to {largest - 1}, in a one-dimensional array of signed integers"
            )
    if not (np.diff(radio.bssid) > 0).all():
        raise ValueError("bssid must increase strictly: sort it, and list each access point once")
    if len(radio.point) != h or len(radio.access_point) != h:
        raise ValueError(
            "point, access_point and rssi_dbm must have the same length, got "
            f"{len(radio.point)}, {len(radio.access_point)} and {h}"
        )
    check_array("rssi_dbm", radio.rssi_dbm)
    check_number("position_std_m", radio.position_std_m, 0.0, _MOST_STD_M, "give the uncertainty of the map in metres")
