"""Several tracks of many recordings beside their truth: errors in contexts, means over people, paired differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np

from pdr_filter.evaluate.comparison import leg_error_percent, wrong_context_percent
from pdr_filter.values import BoolArray, FloatArray, Table, TrackRows, table
from pdr_filter.values.recording import Recording

MEASURES = ("step_error_percent", "leg_error_percent", "rmse_m", "end_error_percent", "context_error_percent")


def context_errors(recording: Recording, tracks: Mapping[str, TrackRows]) -> Table:
    """Return the errors in each labelled context: a row for each track and context.

    Parameters
    ----------
    recording : Recording
        With labels (`truth.labels`). It needs no positions.
    tracks : mapping of str to Track
        Tracks of the recording by name.

    Returns
    -------
    Table
        Columns `name`, `context`, `time_s` (labelled duration), `wrong_percent` (share of the windows that end in it
        and whose most probable context is another one; NaN without windows), `n_steps`, `distance_m`, and
        `leg_error_percent`: the error of the walked distance in the segments of known length that lie in this context,
        NaN without any.

    Raises
    ------
    ValueError
        If the recording has no labels.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.demo_walk()
    >>> rows = pdr.evaluate.context_errors(walk, {"imm": pdr.track(walk)})
    >>> sorted(set(rows.context.tolist()))
    ['downstairs', 'running', 'stationary', 'upstairs', 'walking']
    """
    labels = recording.truth.labels
    if labels is None or not len(labels):
        raise ValueError(f"{recording.name or 'the recording'} has no labels: add truth_labels.csv (docs/formats.md)")
    rows = [
        (name, context, *_in_context(recording, cast(Table, labels[labels.context == context]), track))
        for name, track in tracks.items()
        for context in sorted(set(labels.context.tolist()))
    ]
    names = ("name", "context", "time_s", "wrong_percent", "n_steps", "distance_m", "leg_error_percent")
    return table({name: np.array([row[k] for row in rows]) for k, name in enumerate(names)})


def _in_context(recording: Recording, labels: Table, track: TrackRows) -> tuple[float, float, int, float, float]:
    segments, walked, legs = recording.truth.segments, _inside(labels, track.time_s), np.nan
    if segments is not None:
        inside = _inside(labels, 0.5 * (segments.start_s + segments.end_s))
        legs = leg_error_percent(track, cast(Table, segments[(segments.distance_m > 0) & inside]))
    time_s, distance_m = float((labels.end_s - labels.start_s).sum()), float(track.step_length_m[walked].sum())
    return time_s, wrong_context_percent(track, labels), int(walked.sum()), distance_m, legs


def _inside(labels: Table, time_s: FloatArray) -> BoolArray:
    """Whether times (N,) lie in any of the labels."""
    return np.asarray(((time_s[:, None] >= labels.start_s) & (time_s[:, None] < labels.end_s)).any(axis=1))


def study_table(rows: Sequence[Table], people: Sequence[str] | None = None) -> Table:
    """Return means over people of the errors of several tracks, with 95 % intervals and paired differences.

    Parameters
    ----------
    rows : sequence of Table
        One `comparison_table` for each recording, all with the same tracks.
    people : sequence of str, optional
        The person of each recording. The recordings of one person are averaged first, as they are not independent. If
        not given, each recording is of another person.

    Returns
    -------
    Table
        A row for each measure and track: `measure`, `name`, `n_recordings`, `n_people`, `bias` (mean of the signed
        errors), `mean`, `low`, `high` (mean of their absolute values), and `difference`, `difference_low`,
        `difference_high`: the absolute error less that of the last track, paired by person; NaN for that track itself.
        Measures that no recording has are left out. Recordings without a measure do not count in it.

    Raises
    ------
    ValueError
        If there is no recording, if tracks differ, or if `people` has another length than `rows`.

    Notes
    -----
    Intervals are those of Student's t: mean +- t(0.975, n - 1) s / sqrt(n) over n people, NaN for one person.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walks = [pdr.simulate.demo_walk(seed=seed) for seed in (1, 2)]
    >>> rows = [pdr.evaluate.comparison_table(w, pdr.evaluate.weighting_tracks(w)) for w in walks]
    >>> study = pdr.evaluate.study_table(rows)
    >>> study[study.measure == "step_error_percent"].n_people.tolist()
    [2, 2, 2]
    """
    if not rows:
        raise ValueError("rows must hold the comparison_table of one recording at least, got none")
    names = rows[0].name.tolist()
    for k, each in enumerate(rows):
        if each.name.tolist() != names:
            raise ValueError(
                f"rows must have the same tracks, got {names} and, for recording {k}, {each.name.tolist()}"
            )
    people = [str(k) for k in range(len(rows))] if people is None else list(people)
    if len(people) != len(rows):
        raise ValueError(f"people must name the person of each of the {len(rows)} recordings, got {len(people)}")
    found: list[dict[str, object]] = []
    for measure in MEASURES:
        error = np.array([each[measure] for each in rows])  # (R, T)
        use = np.isfinite(error).all(axis=1)
        if not use.any():
            continue
        error, whose = error[use], np.array(people)[use]
        signed = np.array([error[whose == person].mean(axis=0) for person in sorted(set(whose.tolist()))])
        size = np.array([np.abs(error[whose == person]).mean(axis=0) for person in sorted(set(whose.tolist()))])
        for k, name in enumerate(names):
            mean, low, high = _interval(size[:, k])
            apart = _interval(size[:, k] - size[:, -1]) if k < len(names) - 1 else (np.nan, np.nan, np.nan)
            found.append(
                {
                    "measure": measure,
                    "name": name,
                    "n_recordings": int(use.sum()),
                    "n_people": len(size),
                    "bias": float(signed[:, k].mean()),
                    "mean": mean,
                    "low": low,
                    "high": high,
                    "difference": apart[0],
                    "difference_low": apart[1],
                    "difference_high": apart[2],
                }
            )
    if not found:
        raise ValueError("no recording has a truth that a track can be compared with: add one (docs/formats.md)")
    return table({key: np.array([row[key] for row in found]) for key in found[0]})


def _interval(values: FloatArray) -> tuple[float, float, float]:
    """Mean and its 95 % interval."""
    from scipy.stats import t as student

    n, mean = len(values), float(values.mean())
    half = float(student.ppf(0.975, n - 1) * values.std(ddof=1) / np.sqrt(n)) if n > 1 else np.nan
    return mean, mean - half, mean + half
