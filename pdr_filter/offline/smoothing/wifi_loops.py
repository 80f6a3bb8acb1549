"""Two times at which a phone heard the same access points equally loud are two visits of one place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix

from pdr_filter.offline.smoothing.observations import LoopClosure
from pdr_filter.values import FloatArray, WifiScan
from pdr_filter.values.recording import MissingSensorError, Recording

# Cosine of two fingerprints from which on they are of one place, and how far apart along each axis two such scans are:
# pairs of different walks over F1 of `ms_indoor`. On the other storeys scans so alike are 5 to 6 m apart in the median.
# Of a million pairs on different storeys none is so alike.
ALIKE = 0.85
STD_M = 7.5
# Fewer access points than this are alike by chance.
_FEWEST = 20
# Visits that follow each other so closely say nothing that the steps do not know better.
_APART_S = 30.0
# Scans so close to those of a closure are of the same two visits: their errors are alike.
_ONE_VISIT_S = 12.0
# Of more scans, two hours of them, each second, third or later one is compared: all pairs are held in memory.
_MOST_SCANS = 4000


def wifi_loop_closures(recording: Recording) -> list[LoopClosure]:
    """Two times of one place, by Wi-Fi, the most alike pair of each two visits, in order of time.

    A pair is right to 7.5 m along each axis, so that it holds long walks together and cannot sharpen short ones.
    MissingSensorError without Wi-Fi.
    """
    if recording.wifi is None:
        raise MissingSensorError(
            f'{recording.name or "the recording"} has no Wi-Fi, got loop_closures="wifi": leave it out'
        )
    scans = [s for s in recording.wifi.scans() if len(s.bssid) >= _FEWEST]
    if not scans:
        return []
    scans = scans[:: 1 + len(scans) // _MOST_SCANS]
    likeness, time_s = alike(scans), np.array([s.time_s for s in scans])
    first, second = np.nonzero((likeness >= ALIKE) & (time_s - time_s[:, None] > _APART_S))
    found: list[tuple[float, float]] = []
    for k in np.argsort(-likeness[first, second], kind="stable"):
        a, b = float(time_s[first[k]]), float(time_s[second[k]])
        if not any(abs(a - c) < _ONE_VISIT_S and abs(b - d) < _ONE_VISIT_S for c, d in found):
            found.append((a, b))
    start_s = float(recording.accelerometer.time_s.min())
    end_s = float(recording.accelerometer.time_s.max())
    return [LoopClosure(a, b, STD_M) for a, b in sorted(found) if start_s <= a and b <= end_s]


def alike(scans: Sequence[WifiScan]) -> FloatArray:
    """Cosines (S, S) of the fingerprints of scans: 1 where two heard the same, 0 where they share no access point."""
    known, column = np.unique(np.concatenate([s.bssid for s in scans]), return_inverse=True)
    row = np.repeat(np.arange(len(scans)), [len(s.bssid) for s in scans])
    heard = csr_matrix((np.concatenate([s.fingerprint for s in scans]), (row, column)), (len(scans), len(known)))
    return (heard @ heard.T).toarray()
