"""Geometry shared by figures and HTML pages: 95 % ellipses along a track, rounded distances. Imports no plotting."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from pdr_filter.apps.maps.floor_plan import FloorPlan
from pdr_filter.apps.maps.storey import Storey
from pdr_filter.values import RADIUS_95, Cluster, FloatArray, TrackRows, Windows

N_ELLIPSES = 8
# Clusters of a floor plan with less probability are not drawn.
_MIN_SHARE = 0.02
# Minimum width of a map in metres. A smaller map of a short track would magnify noise.
MIN_EXTENT_M = 4.0
_WINDOW_S = 2.0


def ellipse_rows(step_length_m: FloatArray) -> list[int]:
    """Return indices of the steps at which ellipses are drawn, ascending.

    They are at equal walked distances, a round number of metres apart, at most `N_ELLIPSES`. The last step is included.
    There must be at least one step.
    """
    walked_m = np.cumsum(step_length_m)
    marks_m = np.arange(1, N_ELLIPSES) * round_up(float(walked_m[-1]) / N_ELLIPSES)
    rows = np.searchsorted(walked_m, marks_m[marks_m < walked_m[-1]])
    return sorted({*(int(i) for i in rows), len(walked_m) - 1})


def ellipse_axes(cov_m2: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the axes of the 95 % ellipses of covariances (N, 2, 2).

    The first value has the half axes in m, (N, 2), the longer one last. The second has the angle of the longer axis in
    rad, counter-clockwise from east, (N,).
    """
    variance, direction = np.linalg.eigh(cov_m2)
    return RADIUS_95 * np.sqrt(np.maximum(variance, 0.0)), np.arctan2(direction[:, 1, 1], direction[:, 0, 1])


def ellipse_extent(cov_m2: FloatArray) -> FloatArray:
    """Return how far the 95 % ellipses of covariances (N, 2, 2) extend to the east and to the north, (N, 2) in m."""
    return RADIUS_95 * np.sqrt(np.maximum(np.diagonal(cov_m2, axis1=1, axis2=2), 0.0))


def places_at(track: TrackRows, row: int) -> list[Cluster]:
    """Return the possible positions on a floor plan after a step with 2 % or more, or an empty list if there is one."""
    places = [c for c in track.clusters[row] if c.share >= _MIN_SHARE] if track.clusters else []
    return places if len(places) > 1 else []


def storeys_of(plan: FloorPlan | None, floors: Iterable[int]) -> list[Storey]:
    """Return the storeys of a plan that a track has visited, or the only storey. Without a plan the list is empty."""
    seen = set(floors)
    return [s for s in plan.storeys if len(plan.storeys) == 1 or s.floor in seen] if plan is not None else []


def shown_context_prob(track: TrackRows) -> FloatArray:
    """Return the probabilities of the contexts in each window, and a last column of moving without steps, (W, C + 1).

    In windows without a step, the last column has the probability of all contexts with steps, so that charts agree
    with the seconds of each context.
    """
    windows = track.windows
    prob = np.column_stack([windows.context_prob, np.zeros(len(windows))])
    with_steps = np.setdiff1d(np.arange(len(windows.contexts)), windows.standing_index)
    cells = np.ix_(track.moves_without_steps, with_steps)
    prob[track.moves_without_steps, -1] = prob[cells].sum(axis=1)
    prob[cells] = 0.0
    return prob


def round_up(value: float) -> float:
    """Return the next value of the series ... 0.5, 1, 2, 5, 10, 20, 50 ... that is not below a value.

    It is 1 for a value that is not positive or not finite.
    """
    if not (value > 0 and math.isfinite(value)):
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0, 20.0) if m * power >= value * (1 - 1e-9))


def window_starts(windows: Windows, start_time_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the drawn start of each window, and the end of the window before it, both (W,) in s.

    A window is drawn from the end of the window before it, but at most over 2 s, so that missing windows stay visible.
    """
    previous_s = np.concatenate([[start_time_s], windows.time_s[:-1]])
    return np.maximum(previous_s, windows.time_s - _WINDOW_S), previous_s
