"""Geometry shared by figures and HTML pages: 95 % ellipses along a track. Imports no plotting."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pdr_filter.apps.maps.floor_plan import FloorPlan
from pdr_filter.apps.maps.storey import Storey
from pdr_filter.values import RADIUS_95, Cluster, FloatArray, IntArray, TrackRows, Windows

_MAX_FIXES = 8
# Number of evenly spaced ellipses of a band, between which their axes change linearly, and corners of each.
_MAX_BAND, _N_CORNERS = 300, 48
# Distance of a step from the line between two ellipses: a share of its shorter half axis, so that the step lies in the
# band, and at least 0.1 m, which is less than the error of any position and narrower than the drawn line.
_MAX_OFF_SHARE, _MIN_OFF_M = 0.5, 0.1
# Clusters of a floor plan with less probability are not drawn.
_MIN_SHARE = 0.02
# Minimum width of a map in metres. A smaller map of a short track would magnify noise.
MIN_EXTENT_M = 4.0
_WINDOW_S = 2.0
# Largest margin of the uncertainty around a path in a picture, in m and relative to the path, as in map.js. A picture
# of a larger band would show the path as a dot.
_BAND_M, _BAND_SHARE = 8.0, 0.25


def ellipse_rows(track: TrackRows) -> list[int]:
    """Return indices of the steps at which ellipses are drawn, ascending: at used fixes, at most eight, and the last.

    There must be at least one step.
    """
    used_s = [fix.time_s for fix in track.fixes if fix.accepted]
    rows = np.unique(np.searchsorted(track.time_s, used_s))
    rows = rows[rows < track.n_steps]
    shown = rows[np.unique(np.linspace(0, len(rows) - 1, _MAX_FIXES).round().astype(int))] if len(rows) else rows
    return sorted({*shown.tolist(), track.n_steps - 1})


def band_rows(position_m: FloatArray, minor_m: FloatArray) -> IntArray:
    """Return indices of the steps whose ellipses make up the band of uncertainty of a path (N, 2), ascending.

    `minor_m` (N,) are the shorter half axes of the ellipses, m. The rows are all steps, or 300 that are evenly spaced,
    and those at which the path turns: no step is further from the line between two rows than half of its shorter half
    axis, or 0.1 m.
    """
    step = np.arange(len(position_m))
    rows = np.unique(np.linspace(0, len(step) - 1, min(len(step), _MAX_BAND)).round().astype(int))
    while len(rows) > 1:
        part = np.clip(np.searchsorted(rows, step, side="right") - 1, 0, len(rows) - 2)
        start_m, along_m = position_m[rows[part]], np.diff(position_m[rows], axis=0)[part]
        moved_m = position_m - start_m
        share = (moved_m * along_m).sum(axis=1) / np.maximum((along_m**2).sum(axis=1), 1e-9)
        off_m = np.linalg.norm(moved_m - np.clip(share, 0.0, 1.0)[:, np.newaxis] * along_m, axis=1)
        excess = off_m / np.maximum(_MAX_OFF_SHARE * minor_m, _MIN_OFF_M)
        is_worst = excess == np.fmax.reduceat(excess, rows[:-1])[part]
        if not (turns := step[is_worst & (excess > 1.0)]).size:
            break
        rows = np.union1d(rows, turns)
    return rows


def band_rings(position_m: FloatArray, cov_m2: FloatArray) -> list[FloatArray]:
    """Return closed counter-clockwise rings (P, 2) whose union is the band of uncertainty of a path (N, 2).

    The rings are the 95 % ellipses of the positions, and quadrilaterals between the sides of neighbouring ellipses.
    """
    (half_m, angle_rad), turn_rad = ellipse_axes(cov_m2), np.linspace(0.0, 2 * np.pi, _N_CORNERS)
    along = half_m[:, 1:] * np.cos(turn_rad)
    across = half_m[:, :1] * np.sin(turn_rad)
    cosine, sine = np.cos(angle_rad)[:, np.newaxis], np.sin(angle_rad)[:, np.newaxis]
    rings = position_m[:, np.newaxis] + np.stack([along * cosine - across * sine, along * sine + across * cosine], -1)
    moved_m = np.diff(position_m, axis=0)
    left = np.stack([-moved_m[:, 1], moved_m[:, 0]], axis=1)
    quads = []
    for a, b, cov_a, cov_b, n in zip(position_m[:-1], position_m[1:], cov_m2[:-1], cov_m2[1:], left, strict=True):
        side_a, side_b = (RADIUS_95 * cov @ n / max(np.sqrt(n @ cov @ n), 1e-9) for cov in (cov_a, cov_b))
        # sorted by direction, because a ring that crosses itself or is clockwise would be a hole in the ellipses
        corners = np.array([a - side_a, b - side_b, b + side_b, a + side_a])
        east, north = (corners - 0.5 * (a + b)).T
        round_ = np.argsort(np.arctan2(north, east))
        quads.append(corners[[*round_, round_[0]]])
    return [*rings, *quads]


def band_margin_m(track: TrackRows) -> FloatArray:
    """Return how far from the path its band of uncertainty widens a picture at most, to east and north, (2,) in m."""
    way_m = np.vstack([track.start_position_m, track.position_m])
    return np.maximum(_BAND_M, _BAND_SHARE * np.ptp(way_m, axis=0))


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


def window_starts(windows: Windows, start_time_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the drawn start of each window, and the end of the window before it, both (W,) in s.

    A window is drawn from the end of the window before it, but at most over 2 s, so that missing windows stay visible.
    """
    previous_s = np.concatenate([[start_time_s], windows.time_s[:-1]])
    return np.maximum(previous_s, windows.time_s - _WINDOW_S), previous_s
