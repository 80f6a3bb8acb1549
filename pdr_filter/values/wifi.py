"""Which access points a phone heard, and how loud."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from pdr_filter.values.arrays import FloatArray, IntArray, read_only

# A phone listens to one channel after the other and then rests. Between two scans of the phones of `ms_indoor` nothing
# is heard for 0.5 to 0.8 s, within a scan for less than 0.2 s (279,000 of 288,000 rows follow within 0.1 s).
_PAUSE_S = 0.35
# Their scans last 1.8 s at most in 95 of 100. A phone that never rests is cut here: a walker goes three metres.
_LONGEST_S = 2.5
# What a phone hardly hears, and what it hears of an access point beside it.
_SILENT_DBM, _LOUD_DBM = -100.0, -30.0


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Wifi:
    """Access points that were heard: one row each time one was."""

    time_s: FloatArray  # (N,) when it was heard, seconds from the first accelerometer sample; in any order
    bssid: IntArray  # (N,) the 48 bits of its address as a whole number; `address_text` writes it
    rssi_dbm: FloatArray  # (N,) received power, -30 beside it to -100 hardly heard; NaN if not known
    frequency_mhz: FloatArray  # (N,) of its channel; NaN if not known

    def __post_init__(self) -> None:
        addresses = np.asarray(self.bssid)
        if addresses.size and addresses.dtype.kind not in "iu":
            raise ValueError(
                f"bssid must be whole numbers, got {addresses.dtype}: int(text.replace(':', ''), 16) is one"
            )
        bssid = np.array(addresses, dtype=np.int64)
        bssid.flags.writeable = False
        object.__setattr__(self, "bssid", bssid)
        for name in ("time_s", "rssi_dbm", "frequency_mhz"):
            object.__setattr__(self, name, read_only(getattr(self, name), name))
        shapes = [a.shape for a in (self.time_s, self.bssid, self.rssi_dbm, self.frequency_mhz)]
        if len(set(shapes)) > 1 or bssid.ndim != 1:
            raise ValueError(f"time_s, bssid, rssi_dbm and frequency_mhz must be (N,), got {shapes}: one row a hearing")
        if len(bssid) and not (bssid.min() >= 0 and bssid.max() < 1 << 48):
            raise ValueError(f"bssid must be addresses of 48 bits, got {bssid.min()} to {bssid.max()}")

    def __len__(self) -> int:
        return len(self.time_s)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled and copied through the constructor, so that the arrays stay read-only."""
        return type(self), (self.time_s, self.bssid, self.rssi_dbm, self.frequency_mhz)

    def __repr__(self) -> str:
        return f"Wifi({len(self)} rows, {self.n_access_points} access points)"

    @property
    def n_access_points(self) -> int:
        """How many different addresses were heard."""
        return len(np.unique(self.bssid))

    def scans(self) -> tuple[WifiScan, ...]:
        """Rows of known time and power in the scans of the phone, in order of time.

        A scan ends where nothing is heard for 0.35 s, or after 2.5 s.
        """
        known = np.flatnonzero(np.isfinite(self.time_s) & np.isfinite(self.rssi_dbm))
        order = known[np.argsort(self.time_s[known], kind="stable")]
        time_s = self.time_s[order]
        starts: list[int] = []
        for i, at_s in enumerate(time_s.tolist()):
            if i == 0 or at_s - time_s[i - 1] > _PAUSE_S or at_s - time_s[starts[-1]] > _LONGEST_S:
                starts.append(i)
        rows = (order[i:j] for i, j in pairwise([*starts, len(order)]))
        return tuple(WifiScan.of(self.time_s[k], self.bssid[k], self.rssi_dbm[k]) for k in rows)


@dataclass(frozen=True, slots=True, eq=False)
class WifiScan:
    """What a phone heard while it went once through the channels: each access point once, at its loudest."""

    time_s: float  # mean of the times at which they were heard
    end_s: float  # when the last one was heard: no app can know of the scan before
    bssid: IntArray  # (A,) increasing
    rssi_dbm: FloatArray  # (A,)

    @classmethod
    def of(cls, time_s: FloatArray, bssid: IntArray, rssi_dbm: FloatArray) -> WifiScan:
        """That of rows (N,)."""
        heard, index = np.unique(bssid, return_inverse=True)
        loudest = np.full(len(heard), -np.inf)
        np.maximum.at(loudest, index, rssi_dbm)
        return cls(float(time_s.mean()), float(time_s.max()), heard, loudest)

    @property
    def fingerprint(self) -> FloatArray:
        """Loudness of each access point, (A,), as a vector of unit length: how loud the phone hears at all cancels."""
        level = loudness(self.rssi_dbm)
        return level / np.sqrt(level @ level)


def loudness(rssi_dbm: FloatArray) -> FloatArray:
    """The square of how far each is above silence, 1 beside the access point: the nearest ones say most."""
    return np.clip((rssi_dbm - _SILENT_DBM) / (_LOUD_DBM - _SILENT_DBM), 1e-3, None) ** 2


def address_text(bssid: int) -> str:
    """The address as people write it, such as "06:74:9c:2e:95:ea"."""
    return int(bssid).to_bytes(6, "big").hex(":")
