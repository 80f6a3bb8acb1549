"""Report and tables of a step-length calibration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from pdr_filter.filter.step_length.calibration_result import CalibrationResult, slices_of
from pdr_filter.values import FloatArray, Table, how_many, table

_MOST_PEOPLE, _MOST_NOTES = 20, 12  # maximum number in the report


def report_text(result: CalibrationResult) -> str:
    """Return parameters, errors and warnings as text of several lines for a fixed-width font."""
    of_all = _once(result.notes)
    notes = [f"- {note}" for note in of_all[:_MOST_NOTES]]
    if len(of_all) > _MOST_NOTES:
        notes.append(f"- and {how_many(len(of_all) - _MOST_NOTES, 'more note')}")
    parts = [_parameter_lines(result), _error_lines(result), _people_lines(result), notes]
    return "\n\n".join("\n".join(lines) for lines in parts if lines)


def report_tables(result: CalibrationResult) -> dict[str, Table]:
    """Return parameters, covariance and segments as tables, as described by `pdr_filter.Calibration.tables`."""
    parts = slices_of(result.models)[0]
    context = np.concatenate([np.full(part.stop - part.start, name) for name, part in parts.items()])
    number = np.concatenate([np.arange(part.stop - part.start) for part in parts.values()])
    row, column = np.indices(result.theta_cov.shape).reshape(2, -1)
    segments = {name: result.segments[name] for name in result.segments.dtype.names or ()}
    return {
        "parameters": table(
            {
                "context": context,
                "parameter": number,
                "value": result.theta,
                "std": np.sqrt(np.diagonal(result.theta_cov)),
                "between_std": np.sqrt(np.diagonal(result.between_cov)),
            }
        ),
        "covariance": table(
            {
                "context": context[row],
                "parameter": number[row],
                "other_context": context[column],
                "other_parameter": number[column],
                "covariance": result.theta_cov[row, column],
            }
        ),
        "segments": table({**segments, "residual_m": result.segments.distance_m - result.segments.left_out_m}),
    }


def _parameter_lines(result: CalibrationResult) -> list[str]:
    rows, n_people = result.segments, len(result.subject_ids)
    lines = [
        f"{how_many(len(rows), 'segment')}, {rows.distance_m.sum():.0f} m, "
        f"{how_many(len(set(rows.recording)), 'recording')}, {how_many(n_people, 'person', 'persons')}",
        "",
        f"{'context':<12}{'segments':>9}{'residual':>10}  model, below it k +- std (std between persons)",
    ]
    for name in result.contexts:
        k, std = result.k[name], result.k_std[name]
        between = np.sqrt(np.diagonal(result.between[name]))
        values = ", ".join(
            f"{a:.4g}" + (f" +- {b:.2g}" if b > 0 else " fixed") + (f" ({d:.2g})" if d > 0 else "")
            for a, b, d in zip(k, std, between, strict=True)
        )
        residual = f"{result.residual_std_m[name]:.3f} m"
        model = type(result.models[name]).__name__
        lines.append(f"{name:<12}{result.n_segments[name]:>9.1f}{residual:>10}  {model}")
        lines.append(f"  {values}")
    return [*lines, f"between recordings of one person: {100 * result.recording_std:.1f} %"]


def _error_lines(result: CalibrationResult) -> list[str]:
    lines, rms_of = [f"{'error of segments in %':<34}{'bias':>7}{'spread':>8}{'RMS':>7}"], dict[str, float]()
    for label, column in (
        ("uncalibrated (prior)", "uncalibrated_m"),
        ("calibrated, in sample", "predicted_m"),
        ("calibrated, segment held out", "left_out_m"),
        ("calibrated, person held out", "stranger_m"),
    ):
        bias, spread, rms = _errors_percent(result.segments[column], result.segments.distance_m)
        rms_of[column] = rms
        is_alone = column == "stranger_m" and len(result.subject_ids) < 2
        missing = "needs two persons" if is_alone else "not determined"
        values = f"{bias:>+7.1f}{spread:>8.1f}{rms:>7.1f}" if np.isfinite(rms) else f"{missing:>22}"
        lines.append(f"{label:<34}{values}")
    before, stranger = rms_of["uncalibrated_m"], rms_of["stranger_m"]
    if stranger > before:
        lines.append(
            f"segments of held-out persons have an RMS error of {stranger:.1f} % with this calibration and of "
            f"{before:.1f} % without it: use it only for the calibrated persons"
        )
    return lines


def _people_lines(result: CalibrationResult) -> list[str]:
    main, people, rows = result.main_context, result.subjects, cast(Any, result.segments)
    lines = [f"{'person (segments held out)':<34}{'segments':>9}{'bias %':>7}{'RMS %':>7}  k of {main} +- std"]
    for name in result.subject_ids[:_MOST_PEOPLE]:
        person = people[name]
        own = rows[rows.subject == name]
        bias, _, rms = _errors_percent(own.left_out_m, own.distance_m)
        std = person.k_std[main]
        values = ", ".join(f"{a:.4g} +- {b:.2g}" for a, b in zip(person.k[main], std, strict=True) if b > 0)
        errors = f"{bias:>+7.1f}{rms:>7.1f}" if np.isfinite(rms) else f"{'-':>7}{'-':>7}"
        lines.append(f"{_shortened(name):<34}{person.n_segments:>9}{errors}  {values}")
    if len(result.subject_ids) > _MOST_PEOPLE:
        lines.append(f"and {len(result.subject_ids) - _MOST_PEOPLE} more persons")
    return lines


def _errors_percent(predicted_m: FloatArray, distance_m: FloatArray) -> tuple[float, float, float]:
    """Return bias, standard deviation and RMS of the relative errors in per cent, NaN without errors."""
    error = 100 * (predicted_m / distance_m - 1)
    error = error[np.isfinite(error)]
    if len(error) == 0:
        return np.nan, np.nan, np.nan
    return float(error.mean()), float(error.std()), float(np.sqrt((error**2).mean()))


def _shortened(name: str) -> str:
    """Shorten a long name in the middle, because recordings differ at the start or at the end of their names."""
    return name if len(name) <= 32 else f"{name[:19]}...{name[-10:]}"


def _once(notes: Sequence[str]) -> list[str]:
    """Return the notes without repetitions.

    Notes with the same text after the last colon, such as those of several recordings, become one note. It has the text
    of the first, and the number of the others.
    """
    alike: dict[str, list[str]] = {}
    for note in notes:
        alike.setdefault(note.rpartition(": ")[2], []).append(note)
    return [f"{first} (and {len(more)} similar notes)" if more else first for first, *more in alike.values()]
