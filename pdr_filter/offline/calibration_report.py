"""A calibration in words and as a figure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pdr_filter.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pdr_filter.offline.calibration import Calibration

_MOST_PEOPLE, _MOST_NOTES = 20, 12
_MAX_POINTS = 5000


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
    """Known against predicted lengths of the segments (each left out), and the people with 95 % intervals."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from pdr_filter.plotting import context_colours

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
    k = np.array([p.k[main][0] for p in people])
    std = np.array([np.sqrt(p.k_cov[main][0, 0]) for p in people])
    right.errorbar(k, np.arange(len(people)), xerr=1.96 * std, fmt="o", color="#0072B2", markersize=4, linewidth=1)
    between = float(np.sqrt(c.between[main][0, 0]))
    centre = float(c.k[main][0])
    if np.isfinite(between) and between > 0:
        right.axvspan(centre - 1.96 * between, centre + 1.96 * between, color="#0072B2", alpha=0.1, linewidth=0)
    right.axvline(centre, color="#222222", linewidth=0.8)
    right.set_yticks(np.arange(len(people)), [_short(p.id, 22) for p in people], fontsize=8 if len(people) < 25 else 5)
    right.set(xlabel=f"first parameter of {main}, with 95 %", ylim=(len(people) - 0.5, -0.5))
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    if path is not None:
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        drawn.savefig(path, dpi=120)
    return drawn
