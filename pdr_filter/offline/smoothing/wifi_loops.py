"""Loop closures from Wi-Fi: two times with the same signal strengths are two visits of one place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix

from pdr_filter.offline.smoothing.observations import LoopClosure
from pdr_filter.values import FloatArray, WifiScan
from pdr_filter.values.recording import MissingSensorError, Recording

# Smallest cosine of two fingerprints of one place, and the standard deviation of the distance between two such scans
# along each axis. Both are from pairs of different walks over F1 of `ms_indoor`. On the other storeys, such scans are 5
# to 6 m apart in the median. Of a million pairs of scans on different storeys, none has such a cosine.
MIN_COSINE = 0.85
STD_M = 7.5
# Scans with fewer access points may be similar by chance.
_MIN_ACCESS_POINTS = 20
# Smallest time between two visits. For shorter times the steps are more accurate.
_MIN_VISIT_INTERVAL_S = 30.0
# Scans this close in time to those of a closure belong to the same two visits. Their errors are correlated.
_ONE_VISIT_S = 12.0
# Largest number of scans (two hours) that are compared, because all pairs are held in memory. Of more scans, every
# second, third or later one is used.
_MOST_SCANS = 4000


def wifi_loop_closures(recording: Recording) -> list[LoopClosure]:
    """Return loop closures between times with the same Wi-Fi signals.

    Of each two visits of a place, the most similar pair of scans is used. The visits are more than 30 s apart. Scans of
    fewer than 20 access points are not used. A pair has a standard deviation of 7.5 m along each axis. Such closures
    limit the drift of long walks and have little effect on short ones.

    Parameters
    ----------
    recording : Recording
        A recording with Wi-Fi.

    Returns
    -------
    list of LoopClosure
        Loop closures in order of time.

    Raises
    ------
    MissingSensorError
        If the recording has no Wi-Fi.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> from dataclasses import replace
    >>> from pdr_filter.offline.smoothing.wifi_loops import wifi_loop_closures
    >>> walk = pdr.simulate.demo_walk()
    >>> heard_s = np.repeat([5.0, 100.0], 20)  # the same 20 access points at 5 s and at 100 s
    >>> wifi = pdr.Wifi(heard_s, np.tile(np.arange(20), 2), np.full(40, -60.0), np.full(40, 2412.0))
    >>> [(c.first_s, c.second_s) for c in wifi_loop_closures(replace(walk, wifi=wifi))]
    [(5.0, 100.0)]
    """
    if recording.wifi is None:
        raise MissingSensorError(
            f'{recording.name or "the recording"} has no Wi-Fi, which loop_closures="wifi" (--wifi-loops) needs: omit '
            "this option"
        )
    scans = [s for s in recording.wifi.scans() if len(s.bssid) >= _MIN_ACCESS_POINTS]
    if not scans:
        return []
    scans = scans[:: 1 + len(scans) // _MOST_SCANS]
    likeness, time_s = fingerprint_cosines(scans), np.array([s.time_s for s in scans])
    first, second = np.nonzero((likeness >= MIN_COSINE) & (time_s - time_s[:, None] > _MIN_VISIT_INTERVAL_S))
    found: list[tuple[float, float]] = []
    for k in np.argsort(-likeness[first, second], kind="stable"):
        a, b = float(time_s[first[k]]), float(time_s[second[k]])
        if not any(abs(a - c) < _ONE_VISIT_S and abs(b - d) < _ONE_VISIT_S for c, d in found):
            found.append((a, b))
    start_s = float(recording.accelerometer.time_s.min())
    end_s = float(recording.accelerometer.time_s.max())
    return [LoopClosure(a, b, STD_M) for a, b in sorted(found) if start_s <= a and b <= end_s]


def fingerprint_cosines(scans: Sequence[WifiScan]) -> FloatArray:
    """Return the cosines (S, S) of the fingerprints of scans.

    A cosine is 1 for two scans with the same signals, and 0 for scans without a common access point.
    """
    known, column = np.unique(np.concatenate([s.bssid for s in scans]), return_inverse=True)
    row = np.repeat(np.arange(len(scans)), [len(s.bssid) for s in scans])
    heard = csr_matrix((np.concatenate([s.fingerprint for s in scans]), (row, column)), (len(scans), len(known)))
    return (heard @ heard.T).toarray()
