"""What figures and pages draw alike, in numbers: 95 % ellipses along a track, round distances. Imports no plotting."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from pdr_filter.maps.floor_plan import FloorPlan
from pdr_filter.maps.storey import Storey
from pdr_filter.values import RADIUS_95, Cluster, FloatArray, TrackRows, Windows

N_ELLIPSES = 8
# Places that are less probable are not drawn.
_MIN_SHARE = 0.02
# Fewer metres than this across look like a zoom into noise.
MIN_EXTENT_M = 4.0
_WINDOW_S = 2.0


def ellipse_rows(step_length_m: FloatArray) -> list[int]:
    """Steps at which ellipses are drawn: the last, and one every so many metres before it; ascending."""
    walked_m = np.cumsum(step_length_m)
    marks_m = np.arange(1, N_ELLIPSES) * round_up(float(walked_m[-1]) / N_ELLIPSES)
    rows = np.searchsorted(walked_m, marks_m[marks_m < walked_m[-1]])
    return sorted({*(int(i) for i in rows), len(walked_m) - 1})


def ellipse_axes(cov_m2: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Half axes of 95 % ellipses, (N, 2) in m, the longer one last, and its angle from east, (N,), of (N, 2, 2)."""
    variance, direction = np.linalg.eigh(cov_m2)
    return RADIUS_95 * np.sqrt(np.maximum(variance, 0.0)), np.arctan2(direction[:, 1, 1], direction[:, 0, 1])


def ellipse_extent(cov_m2: FloatArray) -> FloatArray:
    """How far 95 % ellipses reach to the east and to the north, (N, 2) in m, of (N, 2, 2)."""
    return RADIUS_95 * np.sqrt(np.maximum(np.diagonal(cov_m2, axis1=1, axis2=2), 0.0))


def places_at(track: TrackRows, row: int) -> list[Cluster]:
    """The places on a floor plan where a walk may be after a step, if there are several."""
    places = [c for c in track.clusters[row] if c.share >= _MIN_SHARE] if track.clusters else []
    return places if len(places) > 1 else []


def storeys_of(plan: FloorPlan | None, floors: Iterable[int]) -> list[Storey]:
    """The storeys that a track was on; of a plan with one storey that one, without a plan none."""
    seen = set(floors)
    return [s for s in plan.storeys if len(plan.storeys) == 1 or s.floor in seen] if plan is not None else []


def round_up(value: float) -> float:
    """The next of 1, 2, 5, 10, 20, 50 ... and their tenths."""
    if not (value > 0 and math.isfinite(value)):
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0, 20.0) if m * power >= value * (1 - 1e-9))


def window_starts(windows: Windows, start_time_s: float) -> tuple[FloatArray, FloatArray]:
    """Time from which each window's probabilities are drawn, and end of the window before it, both (W,).

    They differ where windows are missing.
    """
    previous_s = np.concatenate([[start_time_s], windows.time_s[:-1]])
    return np.maximum(previous_s, windows.time_s - _WINDOW_S), previous_s
