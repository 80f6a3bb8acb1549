"""Several tracks of one recording beside its truth: recipes, and the weightings HC, WC and IMM."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from pdr_filter.evaluate.distance import percent_error, walked_m
from pdr_filter.evaluate.steps import count_error_percent
from pdr_filter.evaluate.tracks import end_error_percent, moved_m, position_rmse_m, positions_at
from pdr_filter.values import FloatArray, Table, TrackRows, rigid_fit, table
from pdr_filter.values.recording import Recording


def comparison_table(recording: Recording, tracks: Mapping[str, TrackRows]) -> Table:
    """A row for each track of the recording: `name, n_steps, distance_m`, and what its truth says, NaN without.

    `step_error_percent`: number of steps against the true ones. `leg_error_percent`: steps' lengths in all truth
    segments of known distance together. `rmse_m`: at the waypoints, after a turn and a move onto all of them.
    `end_error_percent`: of the path, at the last waypoint, after a turn and a move onto those of the first 20 %.
    `context_error_percent`: share of the windows whose most probable context is not that of the label at their end.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter import evaluate
    >>> walk = pdr.simulate.demo_walk()
    >>> rows = evaluate.comparison_table(walk, {w: pdr.track(walk, weighting=w) for w in ("hc", "imm")})
    >>> rows.name.tolist(), bool((abs(rows.step_error_percent) < 5).all())
    (['hc', 'imm'], True)
    """
    rows = [_row(recording, t) for t in tracks.values()]
    names = ("step_error_percent", "leg_error_percent", "rmse_m", "end_error_percent", "context_error_percent")
    return table(
        {
            "name": np.array(list(tracks)),
            "n_steps": np.array([t.n_steps for t in tracks.values()]),
            "distance_m": np.array([t.distance_m for t in tracks.values()]),
        }
        | {name: np.array([row[k] for row in rows]) for k, name in enumerate(names)}
    )


def straight_leg_error_percent(recording: Recording, track: TrackRows) -> float:
    """Error of the displacement over all truth segments of known distance together; ValueError without any.

    For segments that are walked straight: what `pdr_filter.calibrate` fits, and what a tape measure says.
    """
    segments = recording.truth.segments
    known = None if segments is None else segments[segments.distance_m > 0]
    if known is None or not len(known):
        raise ValueError(f"{recording.name or 'the recording'} has no truth segments of known distance")
    start_m = track.start_position_m
    found_m = moved_m(track.time_s, track.position_m, known["start_s"], known["end_s"], start_m)
    return float(percent_error(found_m.sum(), known["distance_m"].sum()))


def in_truth_frame(recording: Recording, track: TrackRows) -> FloatArray:
    """Start and positions of a track (K + 1, 2), turned and moved onto all waypoints of the recording."""
    estimate_m, reference_m = _at_waypoints(recording, track)
    if not len(reference_m):
        raise ValueError(f"{recording.name or 'the recording'} has no waypoints: there is nothing to turn it onto")
    rotation, shift_m = rigid_fit(estimate_m, reference_m)
    return np.vstack([track.start_position_m, track.position_m]) @ rotation.T + shift_m


def second_over_first(prob: FloatArray) -> FloatArray:
    """Second-highest over highest probability, (N,) of (N, C): at or above the threshold, WC weights.

    The ratio of Algorithm 2 of Martinelli et al. 2018. 0 where one is certain, 1 where two are equal.
    """
    if not len(prob):
        return np.zeros(0)
    second, first = np.partition(prob, -2, axis=1)[:, -2:].T
    return second / first


def _row(recording: Recording, track: TrackRows) -> tuple[float, float, float, float, float]:
    steps, segments = recording.truth.steps, recording.truth.segments
    count = legs = rmse = end = np.nan
    if steps is not None and len(steps):
        count = float(count_error_percent(track.n_steps, len(steps)))
    if segments is not None:
        legs = leg_error_percent(track, cast(Table, segments[segments.distance_m > 0]))
    estimate_m, reference_m = _at_waypoints(recording, track)
    if len(reference_m) > 2:
        rmse = position_rmse_m(estimate_m, reference_m, "all")
        end = end_error_percent(estimate_m, reference_m, "first")
    labels = recording.truth.labels
    return count, legs, rmse, end, np.nan if labels is None else wrong_context_percent(track, labels)


def leg_error_percent(track: TrackRows, segments: Table) -> float:
    """Error of the walked distance in all segments of known length together; NaN without segments.

    The walked distance of a track knows better than its steps did when they were made.
    """
    if not len(segments):
        return np.nan
    of_step_m = np.diff(track.walked_m, prepend=0.0)
    found_m = walked_m(track.time_s, of_step_m, segments["start_s"], segments["end_s"])
    return float(percent_error(found_m.sum(), segments["distance_m"].sum()))


def wrong_context_percent(track: TrackRows, labels: Table) -> float:
    """Share of the windows that end in a label and whose most probable context is another one; NaN without any."""
    windows = track.windows
    ends_s = windows.time_s[:, None]
    row, label = np.nonzero((ends_s >= labels.start_s) & (ends_s < labels.end_s))
    if not len(row):
        return np.nan
    best = np.array(track.contexts)[windows.context_prob[row].argmax(axis=1)]
    return float(100.0 * (best != labels.context[label]).mean())


def _at_waypoints(recording: Recording, track: TrackRows) -> tuple[FloatArray, FloatArray]:
    """Where the track is at the waypoints whose time and place are known, and where these are, (N, 2) each."""
    points = recording.truth.waypoints
    if points is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    reference_m = np.column_stack([points.east_m, points.north_m])
    is_known = np.isfinite(reference_m).all(axis=1) & np.isfinite(points.time_s)
    time_s = points.time_s[is_known]
    return positions_at(track.time_s, track.position_m, time_s, track.start_position_m), reference_m[is_known]
