"""A calibration in words and as a figure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pdr_filter.filter.step_length import length_and_jacobian
from pdr_filter.offline.calibration.priors import TYPICAL_STEP
from pdr_filter.values.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pdr_filter.calibration import Calibration
    from pdr_filter.filter.step_length import StepLengthModel

_MOST_PEOPLE, _MOST_NOTES = 20, 12
_MAX_POINTS = 5000
# Journals refuse the Type 3 fonts that matplotlib makes of its own accord: this embeds the font itself.
_TRUETYPE = 42


def text(calibration: Calibration) -> str:
    """Tables of parameters, people and errors, then the notes."""
    c = calibration
    rows: Any = c.segments
    lines = [
        f"{len(rows)} segments, {rows.distance_m.sum():.0f} m, {len(set(rows.recording))} recordings, "
        f"{len(c.subject_ids)} {'person' if len(c.subject_ids) == 1 else 'people'}",
        "",
        f"{'context':<12}{'segments':>9}  {'model':<28}{'population: k +- std (people differ by)'}",
    ]
    for name in c.contexts:
        k, std = c.k[name], np.sqrt(np.diagonal(c.k_cov[name]))
        between = np.sqrt(np.diagonal(c.between[name]))
        values = ", ".join(
            f"{a:.4g}" + (f" +- {b:.2g}" if b > 0 else " held") + (f" ({d:.2g})" if d > 0 else "")
            for a, b, d in zip(k, std, between, strict=True)
        )
        lines.append(f"{name:<12}{c.n_segments[name]:>9.1f}  {type(c.models[name]).__name__:<28}{values}")
        lines.append(f"{'':<23}residual {c.residual_std_m[name]:.3f} m a step")
    lines.append(f"between recordings of one person: {100 * c.recording_std:.1f} %")
    lines += ["", "error of segments in %: bias, spread, RMS", f"{'':<34}{'bias':>7}{'spread':>8}{'RMS':>7}"]
    for label, column in (
        ("uncalibrated (prior)", "uncalibrated_m"),
        ("calibrated, in sample", "predicted_m"),
        ("calibrated, segment left out", "left_out_m"),
        ("calibrated, person left out", "stranger_m"),
    ):
        bias, spread, rms = errors_percent(rows[column], rows.distance_m)
        lines.append(
            f"{label:<34}{bias:>+7.1f}{spread:>8.1f}{rms:>7.1f}"
            if np.isfinite(rms)
            else f"{label:<34}{'needs two people' if len(c.subject_ids) < 2 else 'not determined':>22}"
        )
    main = "walking" if "walking" in c.contexts or not c.contexts else c.contexts[0]
    lines += ["", f"{'person':<34}{'segments':>9}  k of {main} +- std{'':>10}left out: bias, RMS %"]
    people = c.subjects
    for name in c.subject_ids[:_MOST_PEOPLE]:
        person = people[name]
        own = rows[rows.subject == name]
        bias, _, rms = errors_percent(own.left_out_m, own.distance_m)
        std = np.sqrt(np.diagonal(person.k_cov[main]))
        values = ", ".join(f"{a:.4g} +- {b:.2g}" for a, b in zip(person.k[main], std, strict=True) if b > 0)
        lines.append(f"{_short(name, 32):<34}{person.n_segments:>9}  {values:<28}{bias:>+7.1f}{rms:>7.1f}")
    if len(c.subject_ids) > _MOST_PEOPLE:
        lines.append(f"and {len(c.subject_ids) - _MOST_PEOPLE} more people")
    if c.notes:
        lines += ["", *(f"- {note}" for note in c.notes[:_MOST_NOTES])]
        if len(c.notes) > _MOST_NOTES:
            lines.append(f"- and {len(c.notes) - _MOST_NOTES} more notes")
    return "\n".join(lines)


def errors_percent(predicted_m: FloatArray, distance_m: FloatArray) -> tuple[float, float, float]:
    """Bias, spread and RMS of the relative errors in %, NaN if there are none."""
    error = 100 * (predicted_m / distance_m - 1)
    error = error[np.isfinite(error)]
    if len(error) == 0:
        return np.nan, np.nan, np.nan
    return float(error.mean()), float(error.std()), float(np.sqrt((error**2).mean()))


def _short(name: str, most: int) -> str:
    """A long name without its middle: its ends tell recordings apart."""
    return name if len(name) <= most else f"{name[: most - 13]}...{name[-10:]}"


def figure(calibration: Calibration, path: str | Path | None = None) -> Figure:
    """Known against predicted lengths of the segments (each left out), and the people with 95 % intervals.

    People are compared by the length in m of one and the same step, at one height, so that every model has the same
    unit and people differ by their parameters alone: J cov J' is its variance, J = dL / dtheta.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from pdr_filter.report.palette import context_colours

    c = calibration
    drawn = Figure(figsize=(10.0, 4.8), layout="constrained")
    FigureCanvasAgg(drawn)
    left, right = drawn.subplots(1, 2)
    rows: Any = c.segments
    if len(rows) > _MAX_POINTS:
        rows = rows[np.linspace(0, len(rows) - 1, _MAX_POINTS).astype(int)]
    colours = context_colours()
    style: dict[str, Any] = {"s": 16, "linewidths": 0.4, "edgecolors": "#222222"}
    for name in dict.fromkeys(rows.context):
        own = rows[(rows.context == name) & ~rows.distrusted]
        error = 100 * (own.left_out_m / own.distance_m - 1)
        left.scatter(own.distance_m, error, color=colours[str(name)], label=str(name), **style)
    doubtful = rows[rows.distrusted]
    if len(doubtful):
        error = 100 * (doubtful.left_out_m / doubtful.distance_m - 1)
        left.scatter(doubtful.distance_m, error, marker="x", color="#AA0000", s=30, label="distrusted")
    left.axhline(0.0, color="#222222", linewidth=0.8)
    left.set(xlabel="known length (m)", ylabel="error with this segment left out (%)")
    left.legend(frameon=False)
    main = "walking" if "walking" in c.contexts or not c.contexts else c.contexts[0]
    people = list(c.subjects.values())[:60]
    steps = [_typical_step_m(c.models[main], p.k[main], p.k_cov[main]) for p in people]
    length_m, std_m = np.array(steps).reshape(-1, 2).T
    interval: dict[str, Any] = {"fmt": "o", "color": "#0072B2", "markersize": 4, "linewidth": 1}
    right.errorbar(length_m, np.arange(len(people)), xerr=1.96 * std_m, label="person, 95 % interval", **interval)
    # A parameter that is each person's own without a tie has an infinite spread: there is no band then.
    spread = np.where(np.isfinite(c.between[main]), c.between[main], np.nan)
    centre_m, between_m = _typical_step_m(c.models[main], c.k[main], spread)
    if between_m > 0:
        band = (centre_m - 1.96 * between_m, centre_m + 1.96 * between_m)
        right.axvspan(*band, color="#0072B2", alpha=0.1, linewidth=0, label="95 % of all people")
    right.axvline(centre_m, color="#222222", linewidth=0.8, label="population")
    right.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=9, columnspacing=1.0)
    right.set_yticks(np.arange(len(people)), [_short(p.id, 22) for p in people], fontsize=8 if len(people) < 25 else 5)
    right.set(xlabel=f"length of a typical step, {main} (m)", ylim=(len(people) - 0.5, -0.5))
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    if path is not None:
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        with rc_context({"pdf.fonttype": _TRUETYPE, "ps.fonttype": _TRUETYPE}):
            drawn.savefig(path, dpi=120)
    return drawn


def _typical_step_m(model: StepLengthModel, theta: FloatArray, cov: FloatArray) -> tuple[float, float]:
    """Length of a typical step and its standard deviation under the covariance of theta, both in m."""
    length, jacobian = length_and_jacobian(model, TYPICAL_STEP, theta)
    return float(length), float(np.sqrt(jacobian @ cov @ jacobian))
