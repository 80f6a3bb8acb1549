"""Steps and tracks against truth on the real recordings, walk by walk: the tables of docs/benchmarks.md.

usage: .venv/bin/python tests/benchmarks/accuracy.py [--data ../shared/data] [--weighting imm] [--recipe default]

Steps (ubicomp13): count error of each walk against steps counted on video; steps found a second or more outside the
walk, where the phone is only handled, are false. Steps (oxford): one-to-one matches with foot switches within 0.25 s
and 0.1 s, a constant offset removed. Tracks (humolire, ms_indoor): RMSE of the position at the waypoints (square root
of the mean squared distance) after rotation and translation onto all waypoints, and onto those of the first 20 % of
the path; end error of the latter in per cent of the path; distance error on straight legs by displacement (humolire)
or by the sum of step lengths against the line through the waypoints (ms_indoor).
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import pdr_filter as pdr

FloatArray = NDArray[np.float64]


def count_errors(data: Path, config: pdr.Config) -> None:
    """Errors of walks by placement, false steps a minute, and the people not used to choose the detector."""
    errors: dict[str, list[float]] = defaultdict(list)
    unseen: list[float] = []
    n_false, outside_s = 0, 0.0
    for path in sorted((data / "ubicomp13").glob("*.zip")):
        recording = pdr.read(path)
        walk = recording.truth.segments[0]
        time_s = pdr.detect_steps(recording, config).time_s
        start_s, end_s, n_true = float(walk["start_s"]), float(walk["end_s"]), float(walk["n_steps"])
        n_found = int(((time_s >= start_s - 0.3) & (time_s <= end_s + 0.3)).sum())
        error = 100 * (n_found - n_true) / n_true
        errors[path.stem.split("_", 3)[3]].append(error)
        if int(path.stem.split("_p")[1][:2]) >= 7:
            unseen.append(error)
        n_false += int(((time_s < start_s - 1) | (time_s > end_s + 1)).sum())
        outside_s += max(0.0, start_s - 1) + max(0.0, recording.duration_s - end_s - 1)
    print("| placement | walks | mean absolute error % | bias % | spread % | largest % |\n|---|---|---|---|---|---|")
    every = [e for group in errors.values() for e in group]
    groups = {**dict(sorted(errors.items())), "all": every, "people 7 to 13 (not tuned on)": unseen}
    for name, values in groups.items():
        e = np.array(values)
        print(
            f"| {name} | {len(e)} | {np.abs(e).mean():.2f} | {e.mean():+.2f} | {e.std():.2f} | {np.abs(e).max():.1f} |"
        )
    per_minute = 60 * n_false / outside_s
    print(f"\nfalse steps while the phone is handled: {per_minute:.1f} a minute ({outside_s / 60:.0f} min)\n")


def f1_score(truth_s: FloatArray, found_s: FloatArray, tolerance_s: float) -> float:
    """F1 of one-to-one matches in time order."""
    i = j = hits = 0
    while i < len(truth_s) and j < len(found_s):
        if abs(found_s[j] - truth_s[i]) <= tolerance_s:
            hits, i, j = hits + 1, i + 1, j + 1
        elif found_s[j] < truth_s[i]:
            j += 1
        else:
            i += 1
    return 2 * hits / (len(truth_s) + len(found_s))


def step_times(data: Path, config: pdr.Config) -> None:
    """F1 against foot switches."""
    scores: list[tuple[float, float]] = []
    for path in sorted((data / "oxford").glob("*.zip")):
        recording = pdr.read(path)
        truth_s = recording.truth.steps.time_s
        found_s = pdr.detect_steps(recording, config).time_s
        found_s = found_s[(found_s > truth_s[0] - 0.6) & (found_s < truth_s[-1] + 0.6)]
        offsets = np.arange(-0.4, 0.41, 0.02)
        scores.append(tuple(max(f1_score(truth_s, found_s + o, tol) for o in offsets) for tol in (0.25, 0.1)))
    f1 = np.array(scores)
    print(
        f"foot switches, n = {len(f1)} walks: F1 within 0.25 s mean {f1[:, 0].mean():.4f}, "
        f"lowest {f1[:, 0].min():.4f}; within 0.1 s mean {f1[:, 1].mean():.4f}\n"
    )


def aligned(reference: FloatArray, estimate: FloatArray, use: NDArray[np.bool_]) -> FloatArray:
    """The estimate, rotated and moved so that its used points fit the reference best (Kabsch, no scale)."""
    a, b = estimate[use], reference[use]
    u, _, vt = np.linalg.svd((a - a.mean(axis=0)).T @ (b - b.mean(axis=0)))
    rotation = (u @ np.diag([1, np.sign(np.linalg.det(u @ vt))]) @ vt).T
    return (estimate - a.mean(axis=0)) @ rotation.T + b.mean(axis=0)


def track_errors(recording: pdr.Recording, track: pdr.Track) -> tuple[float, float, float, float, float]:
    """RMSE on all, RMSE and end error on the first 20 %, distance error, squared end error over predicted variance."""
    points = recording.truth.waypoints
    reference = np.column_stack([points.east_m, points.north_m])
    legs_m = np.linalg.norm(np.diff(reference, axis=0), axis=1)
    along_m = np.concatenate([[0.0], np.cumsum(legs_m)])
    time_s = np.concatenate([[min(points.time_s[0], track.time_s[0]) - 1e-3], track.time_s])
    position_m = np.vstack([[0.0, 0.0], track.position_m])
    variance_m2 = np.concatenate([[0.0], np.trace(track.position_cov_m2, axis1=1, axis2=2)])

    def at(t: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(t, time_s, position_m[:, k]) for k in (0, 1)])

    estimate = at(points.time_s)
    every = np.ones(len(reference), dtype=bool)
    first = along_m <= max(0.2 * along_m[-1], along_m[min(2, len(along_m) - 1)])
    shape_m = np.linalg.norm(aligned(reference, estimate, every) - reference, axis=1)
    error_m = np.linalg.norm(aligned(reference, estimate, first) - reference, axis=1)
    segments = recording.truth.segments
    if segments is not None:
        moved_m = np.linalg.norm(at(segments.end_s) - at(segments.start_s), axis=1)
        distance = moved_m.sum() / segments.distance_m.sum() - 1
    else:
        inside = (track.time_s >= points.time_s[0]) & (track.time_s <= points.time_s[-1])
        distance = track.step_length_m[inside].sum() / along_m[-1] - 1
    consistency = error_m[-1] ** 2 / np.interp(points.time_s[-1], time_s, variance_m2)
    rms = np.sqrt((shape_m**2).mean()), np.sqrt((error_m**2).mean())
    return rms[0], rms[1], 100 * error_m[-1] / along_m[-1], 100 * distance, consistency


def tracks(data: Path, recipe: str, weighting: str) -> None:
    """One row for each site."""
    print(
        "| site | walks | RMSE m median, 90 % | first 20 %: RMSE m median, 90 % | end error % median | "
        "distance % bias, spread, RMS | squared end error over predicted |\n|---|---|---|---|---|---|---|"
    )
    for site in ("humolire", "ms_indoor"):
        recordings = [pdr.read(p) for p in sorted((data / site).glob("*.zip"))]
        rows = np.array(
            [
                track_errors(r, pdr.track(r, pdr.recipes.for_recording(recipe, r), weighting=weighting))
                for r in recordings
            ]
        )
        shape, first, end, distance, consistency = rows.T
        print(
            f"| {site} | {len(rows)} | {np.median(shape):.2f}, {np.percentile(shape, 90):.2f} | "
            f"{np.median(first):.2f}, {np.percentile(first, 90):.2f} | {np.median(end):.1f} | "
            f"{distance.mean():+.1f}, {distance.std():.1f}, {np.sqrt((distance**2).mean()):.1f} | "
            f"{consistency.mean():.2f} |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "data")
    parser.add_argument("--weighting", default="imm")
    parser.add_argument("--recipe", default="default")
    args = parser.parse_args()
    config = getattr(pdr.recipes, args.recipe)()
    count_errors(args.data, config)
    step_times(args.data, config)
    tracks(args.data, args.recipe, args.weighting)


if __name__ == "__main__":
    main()
