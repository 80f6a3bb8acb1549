"""All recipes on the same recordings: steps, tracks and distances, the tables of docs/benchmarks.md.

usage: .venv/bin/python tests/benchmarks/recipes.py [--data ../shared/data] [--recipes default ...] [--jobs 2]

Definitions are those of accuracy.py. Each error is of one walk; n is the number of walks, the bias their mean, the
spread their standard deviation. Distances in the motion-capture room (tyrex) are against the path of the phone,
smoothed below the frequency of steps. A recipe that lacks a sensor of a data set has a dash.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from accuracy import f1_score, track_errors
from joblib import Parallel, delayed
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

import pdr_filter as pdr

FloatArray = NDArray[np.float64]
RECIPES = ("martinelli2018", "tian2016", "zhou2019", "guo2018", "susi2013", "default")


def count_error(recipe: str, path: Path) -> tuple[str, float, int, float]:
    """Placement, count error in per cent, false steps, and the seconds in which a step is false."""
    recording = pdr.read(path)
    walk = recording.truth.segments[0]
    start_s, end_s, n_true = float(walk["start_s"]), float(walk["end_s"]), float(walk["n_steps"])
    time_s = pdr.detect_steps(recording, pdr.recipes.for_recording(recipe, recording)).time_s
    n_found = int(((time_s >= start_s - 0.3) & (time_s <= end_s + 0.3)).sum())
    n_false = int(((time_s < start_s - 1) | (time_s > end_s + 1)).sum())
    outside_s = max(0.0, start_s - 1) + max(0.0, recording.duration_s - end_s - 1)
    return path.stem.split("_", 3)[3], 100 * (n_found - n_true) / n_true, n_false, outside_s


def switch_scores(recipe: str, path: Path) -> tuple[float, float]:
    """F1 within 0.25 s and 0.1 s of foot switches, a constant offset removed."""
    recording = pdr.read(path)
    truth_s = recording.truth.steps.time_s
    found_s = pdr.detect_steps(recording, pdr.recipes.for_recording(recipe, recording)).time_s
    found_s = found_s[(found_s > truth_s[0] - 0.6) & (found_s < truth_s[-1] + 0.6)]
    offsets = np.arange(-0.4, 0.41, 0.02)
    near, close = (max(f1_score(truth_s, found_s + o, tolerance) for o in offsets) for tolerance in (0.25, 0.1))
    return near, close


def waypoint_errors(recipe: str, path: Path) -> tuple[float, ...]:
    """As `accuracy.track_errors`."""
    recording = pdr.read(path)
    return track_errors(recording, pdr.track(recording, pdr.recipes.for_recording(recipe, recording)))


def room_distance(recipe: str, path: Path) -> tuple[str, float]:
    """Scenario, and the error of the distance in per cent in a motion-capture room."""
    recording = pdr.read(path)
    truth = recording.truth.position
    time_s, position = np.asarray(truth.time_s), np.column_stack([truth.east_m, truth.north_m])
    uniform_s = np.arange(time_s[0], time_s[-1], 0.02)
    # 0.5 Hz is below any stride; what is left of the sway of a hand adds nothing to the length
    smooth = sosfiltfilt(
        butter(2, 0.5, fs=50.0, output="sos"),
        np.column_stack([np.interp(uniform_s, time_s, p) for p in position.T]),
        axis=0,
    )
    label = recording.truth.labels[0]
    inside = (uniform_s >= label["start_s"]) & (uniform_s <= label["end_s"])
    length_m = np.linalg.norm(np.diff(smooth[inside], axis=0), axis=1).sum()
    track = pdr.track(recording, pdr.recipes.for_recording(recipe, recording))
    walked = (track.time_s >= label["start_s"]) & (track.time_s <= label["end_s"])
    scenario = path.stem.removeprefix("tyrex_").split("_")[-1]
    return scenario, 100 * (track.step_length_m[walked].sum() / length_m - 1)


def cell(errors: Sequence[float]) -> str:
    """Mean absolute error, bias, spread."""
    e = np.array(errors)
    return f"{np.abs(e).mean():.2f} ({e.mean():+.2f}, {e.std():.2f})"


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table in Markdown."""
    print("| " + " | ".join(header) + " |\n|" + "---|" * len(header))
    for row in rows:
        print("| " + " | ".join(row) + " |")
    print(flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "data")
    parser.add_argument("--recipes", nargs="+", default=RECIPES)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()

    def over(function: Callable[..., Any], recipe: str, dataset: str) -> list[Any] | None:
        """The function of each recording, None if the recipe cannot use them."""
        paths = sorted((args.data / dataset).glob("*.zip"))
        try:
            return list(Parallel(args.jobs)(delayed(function)(recipe, path) for path in paths))
        except pdr.MissingSensorError:
            return None

    steps, rows, header = [], [], ["recipe"]
    for recipe in args.recipes:
        counts = over(count_error, recipe, "ubicomp13") or []
        groups: dict[str, list[float]] = defaultdict(list)
        for placement, error, _, _ in counts:
            groups[placement].append(error)
        header = ["recipe", *(f"{name} (n={len(e)})" for name, e in sorted(groups.items()))]
        rows.append([recipe, *(cell(e) for _, e in sorted(groups.items()))])
        errors, n_false, outside_s = (np.array([c[i] for c in counts]) for i in (1, 2, 3))
        scores = over(switch_scores, recipe, "oxford")
        f1 = "-, -" if scores is None else ", ".join(f"{x:.3f}" for x in np.mean(scores, axis=0))
        false_per_min = f"{60 * n_false.sum() / outside_s.sum():.1f}"
        steps.append([recipe, cell(errors.tolist()), f"{np.abs(errors).max():.1f}", false_per_min, f1])
    print("Steps: mean absolute count error in per cent (bias, spread)\n")
    print_table(["recipe", "ubicomp13 (n=66)", "largest", "false steps a minute", "oxford F1 0.25 s, 0.1 s"], steps)
    print_table(header, rows)

    rows = []
    for recipe in args.recipes:
        row = [recipe]
        for site in ("humolire", "ms_indoor"):
            shape, first, end, distance, _ = np.array(over(waypoint_errors, recipe, site)).T
            row += [f"{np.median(shape):.2f}, {np.percentile(shape, 90):.2f}", f"{np.median(first):.2f}"]
            row += [f"{np.median(end):.1f}", f"{distance.mean():+.1f}, {distance.std():.1f}"]
        rows.append(row)
    print("Tracks: humolire (n=9), then ms_indoor (n=40)\n")
    each = ["RMSE m: median, 90 %", "first 20 %: median", "end % median", "distance %: bias, spread"]
    print_table(["recipe", *each, *each], rows)

    rows, header = [], ["recipe"]
    for recipe in args.recipes:
        by_scenario: dict[str, list[float]] = defaultdict(list)
        for scenario, error in over(room_distance, recipe, "tyrex") or []:
            by_scenario[scenario].append(error)
        header = ["recipe", *sorted(by_scenario)]
        rows.append([recipe, *(" ".join(f"{e:+.0f}" for e in by_scenario[s]) for s in sorted(by_scenario))])
    print("Distance error in per cent in a room of 5 m (tyrex, one person), each recording\n")
    print_table(header, rows)


if __name__ == "__main__":
    main()
