"""Comparison of several tracks of one recording (of recipes or weightings) with its ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from pdr_filter.evaluate.distance import percent_error, walked_m
from pdr_filter.evaluate.steps import count_error_percent
from pdr_filter.evaluate.tracks import end_error_percent, moved_m, path_m, position_rmse_m, positions_at
from pdr_filter.values import FloatArray, Table, TrackRows, rigid_fit, table
from pdr_filter.values.interpolation import interpolated
from pdr_filter.values.recording import Recording


def comparison_table(recording: Recording, tracks: Mapping[str, TrackRows]) -> Table:
    """Return a table with the errors of several tracks of one recording.

    Parameters
    ----------
    recording : Recording
        Recording with ground truth.
    tracks : mapping of str to Track
        Tracks of the recording by name.

    Returns
    -------
    Table
        A row for each track. Measures without the required ground truth are NaN. Known places are the waypoints, or
        without waypoints the true positions at the steps. The columns are

        - `name`, `n_steps`, `distance_m`.
        - `step_error_percent`, the relative error of the step count.
        - `leg_error_percent`, the relative error of the walked distance in all segments of known distance together.
        - `rmse_m`, the position RMSE at the known places, after rigid alignment to all of them.
        - `end_error_percent`, the position error at the last known place relative to the path length, after rigid
          alignment to the known places of the first 20 % of the path.
        - `context_error_percent`, the share of windows whose most probable context differs from the label at their end.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter import evaluate
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0)])
    >>> rows = evaluate.comparison_table(walk, {w: pdr.track(walk, weighting=w) for w in ("hc", "imm")})
    >>> rows.name.tolist(), bool((abs(rows.step_error_percent) < 10).all())
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
    """Return the relative error of the displacement in all straight segments of known distance together.

    Parameters
    ----------
    recording : Recording
        Recording with truth segments of known distance, which were walked straight.
    track : Track
        Track of the recording.

    Returns
    -------
    float
        Error in per cent. A negative error means too short.

    Raises
    ------
    ValueError
        If there are no segments of known distance.

    Notes
    -----
    The displacement between start and end of a segment is what `pdr_filter.calibrate` fits, and what a tape measures.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0)])
    >>> abs(pdr.evaluate.straight_leg_error_percent(walk, pdr.track(walk))) < 20
    True
    """
    segments = recording.truth.segments
    known = None if segments is None else segments[segments.distance_m > 0]
    if known is None or not len(known):
        raise ValueError(
            f"{recording.name or 'the recording'} has no truth segments of "
            "known distance: add truth_segments.csv "
            "(docs/formats.md)"
        )
    start_m = track.start_position_m
    found_m = moved_m(track.time_s, track.position_m, known["start_s"], known["end_s"], start_m)
    return float(percent_error(found_m.sum(), known["distance_m"].sum()))


def in_truth_frame(recording: Recording, track: TrackRows) -> FloatArray:
    """Return a track after rigid alignment to the waypoints, or without waypoints to the true positions.

    Parameters
    ----------
    recording : Recording
        Recording with waypoints or true positions.
    track : Track
        Track of the recording.

    Returns
    -------
    ndarray of shape (K + 1, 2)
        Start and positions after each step in m, in the frame of the ground truth.

    Raises
    ------
    ValueError
        If the recording has neither.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0)])
    >>> track = pdr.track(walk)
    >>> pdr.evaluate.in_truth_frame(walk, track).shape == (track.n_steps + 1, 2)
    True
    """
    estimate_m, reference_m = _at_known_places(recording, track)
    if not len(reference_m):
        raise ValueError(
            f"{recording.name or 'the recording'} has no waypoints or true positions of known time to align the track "
            "with: add truth_waypoints.csv (docs/formats.md)"
        )
    rotation, shift_m = rigid_fit(estimate_m, reference_m)
    return np.vstack([track.start_position_m, track.position_m]) @ rotation.T + shift_m


def second_over_first(prob: FloatArray) -> FloatArray:
    """Return the ratio of the second-highest to the highest probability.

    Parameters
    ----------
    prob : ndarray of shape (N, C)
        Context probabilities.

    Returns
    -------
    ndarray of shape (N,)
        Ratio, 0 to 1. It is 0 if one context is certain, and 1 if the two most probable contexts are equally probable.

    Notes
    -----
    The weighting WC (weighted context) uses the weighted mean of the step lengths of all contexts if the ratio is at
    least a threshold (Martinelli et al. 2018, Algorithm 2).

    Examples
    --------
    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> pdr.evaluate.second_over_first(np.array([[0.8, 0.2], [0.5, 0.5]])).tolist()
    [0.25, 1.0]
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
    estimate_m, reference_m = _at_known_places(recording, track)
    if len(reference_m) > 2 and path_m(reference_m)[-1] > 0:
        rmse = position_rmse_m(estimate_m, reference_m, "all")
        end = end_error_percent(estimate_m, reference_m, "first")
    labels = recording.truth.labels
    return count, legs, rmse, end, np.nan if labels is None else wrong_context_percent(track, labels)


def leg_error_percent(track: TrackRows, segments: Table) -> float:
    """Return the relative error of the walked distance in all segments of known length together, NaN without segments.

    The final estimate `walked_m` is used instead of the online step lengths.
    """
    if not len(segments):
        return np.nan
    of_step_m = np.diff(track.walked_m, prepend=0.0)
    found_m = walked_m(track.time_s, of_step_m, segments["start_s"], segments["end_s"])
    return float(percent_error(found_m.sum(), segments["distance_m"].sum()))


def wrong_context_percent(track: TrackRows, labels: Table) -> float:
    """Return the per cent of wrong contexts among the windows that end in a label. NaN without such windows."""
    windows = track.windows
    ends_s = windows.time_s[:, None]
    row, label = np.nonzero((ends_s >= labels.start_s) & (ends_s < labels.end_s))
    if not len(row):
        return np.nan
    best = np.array(track.contexts)[windows.context_prob[row].argmax(axis=1)]
    return float(100.0 * (best != labels.context[label]).mean())


def _at_known_places(recording: Recording, track: TrackRows) -> tuple[FloatArray, FloatArray]:
    """Return track positions and true positions, (N, 2) each, at the waypoints with known time and position.

    Without waypoints, they are those at the steps within the times of the true positions.
    """
    points, path = recording.truth.waypoints, recording.truth.position
    is_path = points is None or not len(points)
    known = path if is_path else points
    if known is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    reference_m = np.column_stack([known.east_m, known.north_m])
    is_known = np.isfinite(reference_m).all(axis=1) & np.isfinite(known.time_s)
    time_s, reference_m = known.time_s[is_known], reference_m[is_known]
    if is_path and len(time_s):
        within = (track.time_s >= time_s.min()) & (track.time_s <= time_s.max())
        time_s, reference_m = track.time_s[within], interpolated(track.time_s[within], time_s, reference_m)
    return positions_at(track.time_s, track.position_m, time_s, track.start_position_m), reference_m
