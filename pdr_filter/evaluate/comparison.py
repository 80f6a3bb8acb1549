"""Comparison of several tracks of one recording (of recipes or weightings) with its ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from pdr_filter.evaluate.consistency import ellipse_coverage, nees
from pdr_filter.evaluate.distance import percent_error
from pdr_filter.evaluate.steps import count_error_percent
from pdr_filter.evaluate.tracks import end_error_percent, first_of_path, moved_m, path_m, position_rmse_m, positions_at
from pdr_filter.values import FloatArray, Table, TrackRows, limits, rigid_fit, table
from pdr_filter.values.interpolation import interpolated_rows
from pdr_filter.values.recording import Recording

# Columns of a comparison: relative or absolute errors, then the consistency of covariances.
MEASURES = (
    *("step_error_percent", "leg_error_percent", "rmse_m", "end_error_percent", "context_error_percent"),
    *("nees", "inside_50_percent", "inside_95_percent", "nis"),
)
MIN_PLACES = 4  # three places determine the alignment of a track, so that one is left to compare

# Standard deviation of true positions along each axis in m, unless the caller knows better. Waypoints are landmarks
# that were passed within a step, or clicked on a plan: 0.3 m for motion capture, 0.7 m for ticks on the floor, and 1 m
# for clicks.
TRUTH_STD_M = 0.7


def comparison_table(recording: Recording, tracks: Mapping[str, TrackRows], truth_std_m: float = TRUTH_STD_M) -> Table:
    """Return a table with the errors of several tracks of one recording.

    Parameters
    ----------
    recording : Recording
        Recording with ground truth.
    tracks : mapping of str to Track
        Its tracks by name.
    truth_std_m : float, default 0.7
        Standard deviation in m of the true positions along each axis, for the consistency of the covariances.

    Returns
    -------
    Table
        A row for each track. Measures without the required ground truth are NaN. Known places are the waypoints, or
        without waypoints the true positions at the steps. The columns are

        - `name`, `n_steps`, `distance_m`.
        - `step_error_percent`, the relative error of the step count.
        - `leg_error_percent`, the relative error of the length of all segments of known distance together.
        - `rmse_m`, the position RMSE at the known places, after rigid alignment to all of them.
        - `end_error_percent`, the position error at the last known place relative to the path length, after rigid
          alignment to the known places of the first 20 % of the path.
        - `context_error_percent`, the share of windows whose most probable context differs from the label at their end.
        - `nees`, the mean normalised estimation error squared of the positions at the known places, which is 2 for
          correct covariances; `inside_50_percent` and `inside_95_percent`, the shares of these places inside the 50 %
          and 95 % ellipses. A track in the frame of its start is aligned to the known places of the first 20 % of the
          path, which then do not count.
        - `nis`, the mean normalised innovation squared of the fixes that corrected the track.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter import evaluate
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0)])
    >>> rows = evaluate.comparison_table(walk, {w: pdr.track(walk, weighting=w) for w in ("hc", "imm")})
    >>> rows.name.tolist(), bool((abs(rows.step_error_percent) < 10).all())
    (['hc', 'imm'], True)
    """
    rows = [_row(recording, t, truth_std_m) for t in tracks.values()]
    return table(
        {
            "name": np.array(list(tracks)),
            "n_steps": np.array([t.n_steps for t in tracks.values()]),
            "distance_m": np.array([t.distance_m for t in tracks.values()]),
        }
        | {name: np.array([row.get(name, np.nan) for row in rows]) for name in MEASURES}
    )


def leg_error_percent(recording: Recording, track: TrackRows) -> float:
    """Return the relative error of the length of all segments of known distance together.

    Parameters
    ----------
    recording : Recording
        Recording with truth segments of known distance.
    track : Track
        Track of this recording.

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
    The length of a straight segment is its displacement, which is what `pdr_filter.calibrate` fits and what a tape
    measures. It is the sum of the steps as vectors, with the final step lengths of `walked_m`. In a segment with a
    turn, and without a gyroscope, it is the sum of the step lengths.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0)])
    >>> abs(pdr.evaluate.leg_error_percent(walk, pdr.track(walk))) < 20
    True
    """
    segments = recording.truth.segments
    known = None if segments is None else segments[segments.distance_m > 0]
    if known is None or not len(known):
        raise ValueError(
            f"{recording.name or 'the recording'} has no truth segments of known distance: add truth_segments.csv "
            "(docs/formats.md)"
        )
    return length_error_percent(recording, track, cast(Table, known))


def in_truth_frame(recording: Recording, track: TrackRows) -> FloatArray:
    """Return a track after rigid alignment to the waypoints, or without waypoints to the true positions.

    Parameters
    ----------
    recording : Recording
        Recording with waypoints or true positions.
    track : Track
        Track of this recording.

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
    >>> pdr.evaluate.in_truth_frame(walk, pdr.track(walk)).shape[1]
    2
    """
    _, estimate_m, reference_m = _at_known_places(recording, track)
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
    >>> import numpy as np, pdr_filter as pdr
    >>> pdr.evaluate.second_over_first(np.array([[0.8, 0.2], [0.5, 0.5]])).tolist()
    [0.25, 1.0]
    """
    if not len(prob):
        return np.zeros(0)
    second, first = np.partition(prob, -2, axis=1)[:, -2:].T
    return second / first


def _row(recording: Recording, track: TrackRows, truth_std_m: float) -> dict[str, float]:
    """Return the measures of a track whose ground truth is known."""
    row = _consistency(recording, track, truth_std_m)
    steps, segments, labels = recording.truth.steps, recording.truth.segments, recording.truth.labels
    if steps is not None and len(steps):
        row["step_error_percent"] = float(count_error_percent(track.n_steps, len(steps)))
    if segments is not None:
        known = cast(Table, segments[segments.distance_m > 0])
        row["leg_error_percent"] = length_error_percent(recording, track, known)
    _, estimate_m, reference_m = _at_known_places(recording, track)
    if len(reference_m) > 2 and path_m(reference_m)[-1] > 0:
        row["rmse_m"] = position_rmse_m(estimate_m, reference_m, "all")
        row["end_error_percent"] = end_error_percent(estimate_m, reference_m, "first")
    if labels is not None:
        row["context_error_percent"] = wrong_context_percent(track, labels)
    return row


def _consistency(recording: Recording, track: TrackRows, truth_std_m: float) -> dict[str, float]:
    """Return NEES, coverage of the ellipses in per cent, and NIS, as far as places or fixes are known."""
    row = dict[str, float]()
    corrected = [fix.nis for fix in track.fixes if fix.outcome == "used" and np.isfinite(fix.nis)]
    if corrected:
        row["nis"] = float(np.mean(corrected))
    time_s, estimate_m, reference_m = _at_known_places(recording, track)
    walked = (time_s >= track.time_s[0]) & (time_s <= track.time_s[-1]) if track.n_steps else np.zeros(0, dtype=bool)
    if walked.sum() < MIN_PLACES:
        return row
    time_s, estimate_m, reference_m = time_s[walked], estimate_m[walked], reference_m[walked]
    counts = np.ones(len(time_s), dtype=bool)
    if track.frame not in ("fixes", "plan") or track.origin is not None:
        aligned = first_of_path(reference_m)
        rotation, shift_m = rigid_fit(reference_m[aligned], estimate_m[aligned])
        reference_m, counts = reference_m @ rotation.T + shift_m, ~aligned
    error_m = (estimate_m - reference_m)[counts]
    after = np.searchsorted(track.time_s, time_s[counts])
    cov_m2 = track.position_cov_m2[after] + truth_std_m**2 * np.eye(2)
    if len(error_m):
        row["nees"] = float(nees(error_m, cov_m2).mean())
        row["inside_50_percent"], row["inside_95_percent"] = (100.0 * ellipse_coverage(error_m, cov_m2)).tolist()
    return row


def length_error_percent(recording: Recording, track: TrackRows, segments: Table) -> float:
    """Return the error of `leg_error_percent` for given segments, NaN without segments."""
    if not len(segments):
        return np.nan
    heading_rad, of_step_m = track.walking_heading_rad, np.diff(track.walked_m, prepend=0.0)
    path = np.cumsum(of_step_m[:, None] * np.column_stack([np.sin(heading_rad), np.cos(heading_rad)]), axis=0)
    along = np.column_stack([track.walked_m, np.zeros(track.n_steps)])
    moved, walked = (moved_m(track.time_s, way, segments.start_s, segments.end_s) for way in (path, along))
    is_straight = (moved > limits.STRAIGHT * walked) & (recording.gyroscope is not None)
    return float(percent_error(np.where(is_straight, moved, walked).sum(), segments.distance_m.sum()))


def wrong_context_percent(track: TrackRows, labels: Table) -> float:
    """Return the per cent of wrong contexts among the windows that end in a label. NaN without such windows."""
    windows = track.windows
    ends_s = windows.time_s[:, None]
    row, label = np.nonzero((ends_s >= labels.start_s) & (ends_s < labels.end_s))
    if not len(row):
        return np.nan
    best = np.array(track.contexts)[windows.context_prob[row].argmax(axis=1)]
    return float(100.0 * (best != labels.context[label]).mean())


def _at_known_places(recording: Recording, track: TrackRows) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return times (N,), track positions and true positions, (N, 2) each, at the waypoints of known time and place.

    Without waypoints, they are those at the steps within the times of the true positions.
    """
    points, path = recording.truth.waypoints, recording.truth.position
    is_path = points is None or not len(points)
    known = path if is_path else points
    if known is None:
        return np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2))
    reference_m = np.column_stack([known.east_m, known.north_m])
    is_known = np.isfinite(reference_m).all(axis=1) & np.isfinite(known.time_s)
    time_s, reference_m = known.time_s[is_known], reference_m[is_known]
    if is_path and len(time_s):
        within = (track.time_s >= time_s.min()) & (track.time_s <= time_s.max())
        time_s, reference_m = track.time_s[within], interpolated_rows(track.time_s[within], time_s, reference_m)
    return time_s, positions_at(track.time_s, track.position_m, time_s, track.start_position_m), reference_m
