"""Figures of steps and tracks in the plainest form, to test `pdr_filter.evaluate` against."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import pdr_filter as pdr

FloatArray = NDArray[np.float64]


def f1_score(truth_s: FloatArray, found_s: FloatArray, tolerance_s: float) -> float:
    """F1 of one-to-one matches in time order."""
    i = j = hits = 0
    while i < len(truth_s) and j < len(found_s):
        if abs(found_s[j] - truth_s[i]) <= tolerance_s:
            hits, i, j = hits + 1, i + 1, j + 1
        elif found_s[j] < truth_s[i]:
            j += 1
        else:
            i += 1
    return 2 * hits / (len(truth_s) + len(found_s))


def aligned(reference: FloatArray, estimate: FloatArray, use: NDArray[np.bool_]) -> FloatArray:
    """The estimate, rotated and moved so that its used points fit the reference best (Kabsch, no scale)."""
    a, b = estimate[use], reference[use]
    u, _, vt = np.linalg.svd((a - a.mean(axis=0)).T @ (b - b.mean(axis=0)))
    rotation = (u @ np.diag([1, np.sign(np.linalg.det(u @ vt))]) @ vt).T
    return (estimate - a.mean(axis=0)) @ rotation.T + b.mean(axis=0)


def track_errors(recording: pdr.Recording, track: pdr.Track) -> tuple[float, float, float, float]:
    """RMSE in m after alignment on all waypoints and on the first 20 %, end error of the latter and distance in %."""
    points = recording.truth.waypoints
    reference = np.column_stack([points.east_m, points.north_m])
    legs_m = np.linalg.norm(np.diff(reference, axis=0), axis=1)
    along_m = np.concatenate([[0.0], np.cumsum(legs_m)])
    time_s = np.concatenate([[min(points.time_s[0], track.time_s[0]) - 1e-3], track.time_s])
    position_m = np.vstack([[0.0, 0.0], track.position_m])

    def at(t: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(t, time_s, position_m[:, k]) for k in (0, 1)])

    estimate = at(points.time_s)
    every = np.ones(len(reference), dtype=bool)
    first = along_m <= max(0.2 * along_m[-1], along_m[min(2, len(along_m) - 1)])
    shape_m = np.linalg.norm(aligned(reference, estimate, every) - reference, axis=1)
    error_m = np.linalg.norm(aligned(reference, estimate, first) - reference, axis=1)
    segments = recording.truth.segments
    if segments is not None:
        moved_m = np.linalg.norm(at(segments.end_s) - at(segments.start_s), axis=1)
        distance = moved_m.sum() / segments.distance_m.sum() - 1
    else:
        inside = (track.time_s >= points.time_s[0]) & (track.time_s <= points.time_s[-1])
        distance = track.step_length_m[inside].sum() / along_m[-1] - 1
    rms = np.sqrt((shape_m**2).mean()), np.sqrt((error_m**2).mean())
    return rms[0], rms[1], 100 * error_m[-1] / along_m[-1], 100 * distance
