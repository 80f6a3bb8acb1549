"""Studies with several tracks of many recordings: errors by context, means over persons, paired differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np

from pdr_filter.evaluate.comparison import MEASURES, length_error_percent, wrong_context_percent
from pdr_filter.evaluate.tables import ACRONYMS, heading
from pdr_filter.values import BoolArray, FloatArray, Table, TrackRows, table
from pdr_filter.values.recording import Recording


def context_errors(recording: Recording, tracks: Mapping[str, TrackRows]) -> Table:
    """Return the errors of several tracks in each labelled context.

    Parameters
    ----------
    recording : Recording
        Recording with context labels (`truth.labels`). True positions are not needed.
    tracks : mapping of str to Track
        Its tracks by name.

    Returns
    -------
    Table
        A row for each track and context, with columns `name`, `context`, `time_s` (labelled duration), `wrong_percent`
        (per cent of wrong contexts among the windows that end in a label of this context, NaN without windows),
        `n_steps`, `distance_m` and `leg_error_percent` (relative error of the length of the segments of known length in
        this context, NaN without segments).

    Raises
    ------
    ValueError
        If the recording has no labels.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> legs = [pdr.simulate.Leg("walking", distance_m=20.0), pdr.simulate.Leg("stationary", duration_s=5.0)]
    >>> walk = pdr.simulate.simulate(legs)
    >>> pdr.evaluate.context_errors(walk, {"imm": pdr.track(walk)}).context.tolist()
    ['stationary', 'walking']
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
        legs = length_error_percent(recording, track, cast(Table, segments[(segments.distance_m > 0) & inside]))
    time_s = float((labels.end_s - labels.start_s).sum())
    distance_m = float(np.diff(track.walked_m, prepend=0.0)[walked].sum())
    return time_s, wrong_context_percent(track, labels), int(walked.sum()), distance_m, legs


def _inside(labels: Table, time_s: FloatArray) -> BoolArray:
    """Return a mask (N,) of the times that are inside any of the labels: at or after its start, and before its end."""
    return np.asarray(((time_s[:, None] >= labels.start_s) & (time_s[:, None] < labels.end_s)).any(axis=1))


def study_table(
    rows: Sequence[Table], people: Sequence[str] | None = None, measures: Sequence[str] = MEASURES
) -> Table:
    """Return mean errors over persons of several tracks, with 95 % intervals and paired differences.

    Parameters
    ----------
    rows : sequence of Table
        One `comparison_table` for each recording, all with the same tracks.
    people : sequence of str, optional
        Person of each recording. The recordings of one person are averaged first, because they are not independent. By
        default each recording is of another person.
    measures : sequence of str, optional
        Columns of the rows to average. The default is all measures of `comparison_table`.

    Returns
    -------
    Table
        A row for each measure and track, with columns `measure`, `name`, `n_recordings`, `n_people`, `bias` (mean of
        the signed errors), `mean`, `low`, `high` (mean of the absolute errors with its interval), and `difference`,
        `difference_low`, `difference_high` (absolute error minus the absolute error of the last track, paired by
        person; NaN for the last track, and for measures that are equal for all tracks). Measures without any values are
        omitted. Recordings without a measure do not count for it.

    Raises
    ------
    ValueError
        If there is no recording or no ground truth, if tracks differ, or if `people` and `rows` have different lengths.

    Notes
    -----
    Intervals follow Student's t distribution: mean +- t(0.975, n - 1) s / sqrt(n) over n persons. They are NaN for a
    single person.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> legs = [pdr.simulate.Leg("walking", distance_m=20.0)]
    >>> walks = [pdr.simulate.simulate(legs, seed=seed) for seed in (1, 2)]
    >>> rows = [pdr.evaluate.comparison_table(walk, {"default": pdr.track(walk)}) for walk in walks]
    >>> study = pdr.evaluate.study_table(rows, people=["anna", "ben"])
    >>> study[study.measure == "step_error_percent"].n_people.tolist()
    [2]
    """
    if not rows:
        raise ValueError("rows must contain the comparison_table of at least one recording, got none")
    names = rows[0].name.tolist()
    for k, each in enumerate(rows):
        if each.name.tolist() != names:
            raise ValueError(
                f"rows must have the same tracks for all recordings, got {names} for recording 0 and, for recording "
                f"{k}, {each.name.tolist()}: call comparison_table with tracks of the same names in the same order"
            )
    people = [str(k) for k in range(len(rows))] if people is None else list(people)
    if len(people) != len(rows):
        raise ValueError(f"people must have one name for each of the {len(rows)} recordings, got {len(people)}")
    found: list[tuple[object, ...]] = []
    for measure in measures:
        error = np.array([each[measure] for each in rows])  # (R, T)
        use = np.isfinite(error).all(axis=1)
        if not use.any():
            continue
        error, person_of = error[use], np.array(people)[use]
        # Steps and contexts of windows are the same for all weightings: a difference of zero would seem a result.
        is_equal = bool((error == error[:, -1:]).all())
        persons = sorted(set(person_of.tolist()))
        signed = np.array([error[person_of == person].mean(axis=0) for person in persons])
        size = np.array([np.abs(error[person_of == person]).mean(axis=0) for person in persons])
        for k, name in enumerate(names):
            is_reference = is_equal or k == len(names) - 1
            difference = (np.nan, np.nan, np.nan) if is_reference else _interval(size[:, k] - size[:, -1])
            counts = int(use.sum()), len(size)
            found.append((measure, name, *counts, signed[:, k].mean(), *_interval(size[:, k]), *difference))
    if not found:
        raise ValueError(
            "no recording has a truth that tracks can be compared with: add truth "
            "files to a recording (docs/formats.md)"
        )
    columns = ("measure", "name", "n_recordings", "n_people", "bias", "mean", "low", "high")
    columns += ("difference", "difference_low", "difference_high")
    return table({name: np.array(column) for name, column in zip(columns, zip(*found, strict=True), strict=True)})


def study_rows(study: Table, digits: int = 2) -> list[dict[str, object]]:
    """Return a study as the rows of a table to print, with a value and its interval in one cell.

    Parameters
    ----------
    study : Table
        Result of `study_table`.
    digits : int, default 2
        Number of decimals.

    Returns
    -------
    list of dict
        A row for each measure and track, for `latex` and `markdown`. The columns are the measure, the track, the
        numbers of recordings and persons, the bias, the mean absolute error and the difference to the last track, both
        with the half width of their 95 % interval. Cells without a value are empty.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> legs = [pdr.simulate.Leg("walking", distance_m=20.0)]
    >>> walks = [pdr.simulate.simulate(legs, seed=seed) for seed in (1, 2)]
    >>> rows = [pdr.evaluate.comparison_table(walk, {"default": pdr.track(walk)}) for walk in walks]
    >>> list(pdr.evaluate.study_rows(pdr.evaluate.study_table(rows))[0])
    ['error', 'track', 'recordings', 'persons', 'bias', 'mean', 'difference to default']
    """

    def cell(value: float, high: float, sign: str = "") -> str:
        if value != value:
            return ""
        return f"{value:{sign}.{digits}f}" + (f" ± {high - value:.{digits}f}" if high == high else "")

    def shown(name: str) -> str:
        return name.upper() if name in ACRONYMS else name

    last = shown(str(study["name"][-1]))
    return [
        {
            "error": heading(str(row["measure"])),
            "track": shown(str(row["name"])),
            "recordings": int(row["n_recordings"]),
            "persons": int(row["n_people"]),
            "bias": f"{row['bias']:+.{digits}f}",
            "mean": cell(row["mean"], row["high"]),
            f"difference to {last}": cell(row["difference"], row["difference_high"], "+"),
        }
        for row in study
    ]


def _interval(values: FloatArray) -> tuple[float, float, float]:
    """Return the mean of values (N,), and the lower and upper bound of its 95 % interval, NaN for a single value."""
    from scipy.stats import t as student

    n, mean = len(values), float(values.mean())
    half = float(student.ppf(0.975, n - 1) * values.std(ddof=1) / np.sqrt(n)) if n > 1 else np.nan
    return mean, mean - half, mean + half
