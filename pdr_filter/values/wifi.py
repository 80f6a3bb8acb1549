"""Wi-Fi access points received by a phone, and their grouping into scans."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pdr_filter.values.arrays import FloatArray, IntArray, read_only, reduction

# Minimum pause between two scans. A phone listens to one channel after the other and then pauses. In `ms_indoor` the
# pauses are 0.5 to 0.8 s, and intervals within a scan are less than 0.2 s (0.1 s for 279,000 of 288,000 rows).
_PAUSE_S = 0.35
# Maximum duration of a scan, for phones without pauses: a pedestrian walks three metres. In `ms_indoor` 95 % of the
# scans last up to 1.8 s.
_LONGEST_S = 2.5
# Received power at the limit of reception, and next to the access point.
_SILENT_DBM, _LOUD_DBM = -100.0, -30.0


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Wifi:
    """Received Wi-Fi access points: one row for each reception.

    Attributes
    ----------
    time_s : array_like, shape (N,)
        Time of each reception since the first accelerometer sample, s, in any order.
    bssid : array_like of int, shape (N,)
        Address of the access point, 48 bits as a whole number. `address_text` formats it.
    rssi_dbm : array_like, shape (N,)
        Received power, dBm: -30 next to the access point, -100 at the limit of reception. NaN if unknown.
    frequency_mhz : array_like, shape (N,)
        Frequency of the channel, MHz. NaN if unknown.

    Raises
    ------
    ValueError
        If lengths differ or addresses are not whole numbers of 48 bits.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> wifi = pdr.Wifi([0.0, 0.1, 3.0], [11, 12, 11], [-50.0, -70.0, -55.0], [2412.0, 2437.0, 2412.0])
    >>> wifi, len(wifi.scans())
    (Wifi(3 rows, 2 access points), 2)
    """

    time_s: FloatArray
    bssid: IntArray
    rssi_dbm: FloatArray
    frequency_mhz: FloatArray

    __reduce__ = reduction

    def __post_init__(self) -> None:
        addresses = np.asarray(self.bssid)
        if addresses.size and addresses.dtype.kind not in "iu":
            raise ValueError(
                f"bssid must be whole numbers, got {addresses.dtype}: convert text with int(text.replace(':', ''), 16)"
            )
        bssid = np.array(addresses, dtype=np.int64)
        bssid.flags.writeable = False
        object.__setattr__(self, "bssid", bssid)
        for name in ("time_s", "rssi_dbm", "frequency_mhz"):
            object.__setattr__(self, name, read_only(getattr(self, name), name))
        shapes = [a.shape for a in (self.time_s, self.bssid, self.rssi_dbm, self.frequency_mhz)]
        if len(set(shapes)) > 1 or bssid.ndim != 1:
            raise ValueError(
                f"time_s, bssid, rssi_dbm and frequency_mhz must be (N,), got {shapes}: give equal lengths"
            )
        if len(bssid) and not (bssid.min() >= 0 and bssid.max() < 1 << 48):
            raise ValueError(
                f"bssid must be addresses of 48 bits, got {bssid.min()} to {bssid.max()}: check the column"
            )

    def __len__(self) -> int:
        return len(self.time_s)

    def __repr__(self) -> str:
        return f"Wifi({len(self)} rows, {self.n_access_points} access points)"

    @property
    def n_access_points(self) -> int:
        """Number of different addresses."""
        return len(np.unique(self.bssid))

    def scans(self) -> tuple[WifiScan, ...]:
        """Group the rows with known time and power into scans.

        A scan ends at a pause of more than 0.35 s, or after 2.5 s.

        Returns
        -------
        tuple of WifiScan
            Scans in order of time.
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
    """Scan of all channels by a phone: each received access point once, with its largest power.

    Attributes
    ----------
    time_s, end_s : float
        Mean time of the receptions, and time of the last one, before which an app cannot know the scan, s.
    bssid, rssi_dbm : ndarray, shape (A,)
        Addresses of the access points, in increasing order, and received power of each, dBm.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.values.wifi import WifiScan
    >>> scan = WifiScan.of(np.array([0.0, 0.1, 0.2]), np.array([12, 11, 12]), np.array([-70.0, -50.0, -60.0]))
    >>> scan.bssid.tolist(), scan.rssi_dbm.tolist()
    ([11, 12], [-50.0, -60.0])
    """

    time_s: float
    end_s: float
    bssid: IntArray
    rssi_dbm: FloatArray

    @classmethod
    def of(cls, time_s: FloatArray, bssid: IntArray, rssi_dbm: FloatArray) -> WifiScan:
        """Create a scan from its receptions.

        Parameters
        ----------
        time_s, bssid, rssi_dbm : ndarray, shape (N,)
            Times in s, addresses, and received powers in dBm.

        Returns
        -------
        WifiScan
            Scan with each address once, with its largest power.
        """
        heard, index = np.unique(bssid, return_inverse=True)
        loudest = np.full(len(heard), -np.inf)
        np.maximum.at(loudest, index, rssi_dbm)
        return cls(float(time_s.mean()), float(time_s.max()), heard, loudest)

    @property
    def fingerprint(self) -> FloatArray:
        """Loudness of each access point, (A,), as a unit vector, so that the sensitivity of the phone cancels."""
        level = loudness(self.rssi_dbm)
        return level / np.sqrt(level @ level)


def loudness(rssi_dbm: FloatArray) -> FloatArray:
    """Return the squared level above the limit of reception: 1 at -30 dBm, and at least 1e-6."""
    return np.clip((rssi_dbm - _SILENT_DBM) / (_LOUD_DBM - _SILENT_DBM), 1e-3, None) ** 2


def address_text(bssid: int) -> str:
    """Return an address in the usual notation, such as "06:74:9c:2e:95:ea"."""
    return int(bssid).to_bytes(6, "big").hex(":")
