"""The questions: steps against counts and foot switches, distance and speed against legs and motion capture."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import pdr_filter as pdr
from pdr_filter import evaluate
from tests.benchmarks.common import absolute_bias_spread, paths, way_of

from .harness import Outcome, Table, table
from .walks import GRID_S, FloatArray, Found, Walk

# Time around a walk in which a contact still belongs to it, and from which on it is false.
EDGE_S, OUTSIDE_S = 0.3, 1.0
# oxford: the first and last switch may be those of the second or the last step but one.
SWITCH_EDGE_S = 0.6
# A leg of which less is covered says nothing about speed.
LEAST_COVERED = 0.5
WALKING = ("texting", "phoning", "swinging", "frontpocket", "backpocket")


def walk_of(path: Path) -> Walk:
    """A recording and its walk, as the truth of its site has it."""
    recording = pdr.read(path)
    truth = recording.truth
    match recording.meta["dataset"]:
        case "ubicomp13":
            span = truth.segments.start_s[0], truth.segments.end_s[0]
        case "oxford":
            span = truth.steps.time_s[0] - SWITCH_EDGE_S, truth.steps.time_s[-1] + SWITCH_EDGE_S
        case "humolire":
            span = truth.waypoints.time_s[0], truth.waypoints.time_s[-1]
        case _:
            span = truth.labels.start_s[0], truth.labels.end_s[-1]
    return Walk(recording, float(span[0]), float(span[1]))


def files_of(data: Path, site: str, every: int) -> list[Path]:
    """Every n-th recording of a site; of tyrex those in which the person walks."""
    files = paths(data, site)
    if site == "tyrex":
        files = [p for p in files if p.stem.endswith(WALKING)]
    return files[::every]


def within(found: Found, walk: Walk, edge_s: float) -> FloatArray:
    """Contacts of the walk."""
    return found.step_s[(found.step_s >= walk.start_s - edge_s) & (found.step_s <= walk.end_s + edge_s)]


def _walk_known(o: Outcome) -> str:
    return "yes" if o.method.walk_known else "no"


def _count_error(walk: Walk, found: Found) -> float:
    return float(
        evaluate.count_error_percent(len(within(found, walk, EDGE_S)), walk.recording.truth.segments.n_steps[0])
    )


def counts(outcomes: Sequence[Outcome]) -> Table:
    """Steps of ubicomp13 against those counted on video."""

    def cells(o: Outcome) -> list[str]:
        errors = np.array([_count_error(*pair) for pair in o.found])
        false = outside_s = 0.0
        for walk, found in o.found:
            before_s, after_s = walk.start_s - OUTSIDE_S, walk.end_s + OUTSIDE_S
            false += ((found.step_s < before_s) | (found.step_s > after_s)).sum()
            outside_s += max(0.0, before_s) + max(0.0, walk.recording.duration_s - after_s)
        a_minute = "-" if o.method.walk_known else f"{60 * false / outside_s:.1f}"
        return [_walk_known(o), absolute_bias_spread(errors), f"{np.abs(errors).max():.1f}", a_minute]

    columns = ("walk known", "count error %", "largest", "false steps a minute")
    return table(columns, _finders(outcomes), cells)


def counts_by_place(outcomes: Sequence[Outcome]) -> Table:
    """Mean absolute count error of ubicomp13 by the placement of the phone."""
    places = sorted({place(walk) for o in outcomes for walk, _ in o.found})

    def cells(o: Outcome) -> list[str]:
        errors: dict[str, list[float]] = defaultdict(list)
        for walk, found in o.found:
            errors[place(walk)].append(abs(_count_error(walk, found)))
        return [f"{np.mean(errors[p]):.1f}" if errors[p] else "-" for p in places]

    return table(places, _finders(outcomes), cells)


def place(walk: Walk) -> str:
    """Placement of the phone, from the name of a recording of ubicomp13."""
    return walk.recording.name.split("_", 3)[3]


def step_times(outcomes: Sequence[Outcome]) -> Table:
    """Contacts of oxford against foot switches."""

    def cells(o: Outcome) -> list[str]:
        rows = []
        for walk, found in o.found:
            true_s, found_s = np.asarray(walk.recording.truth.steps.time_s), within(found, walk, 0.0)
            rows.append([100 * (len(found_s) / len(true_s) - 1)])
            for tolerance_s in (0.25, 0.1):
                offset_s = evaluate.best_offset_s(true_s, found_s, tolerance_s)
                rows[-1].append(evaluate.f1_score(true_s, found_s + offset_s, tolerance_s))
        error, wide, narrow = np.array(rows).T
        scores = [f"{wide.mean():.3f}", f"{wide.min():.2f}", f"{narrow.mean():.3f}"]
        return [_walk_known(o), absolute_bias_spread(error, 1), *scores]

    columns = ("walk known", "count error %", "F1 within 0.25 s", "lowest", "F1 within 0.1 s")
    return table(columns, _finders(outcomes), cells)


def _speeds(found: Found, start_s: float, end_s: float) -> FloatArray:
    return found.speeds(np.arange(start_s, end_s, GRID_S))


def legs(outcomes: Sequence[Outcome]) -> Table:
    """Distances and speeds of humolire on straight legs."""

    def cells(o: Outcome) -> list[str]:
        predicted, true, speed_error, covered = [], [], [], []
        for walk, found in o.found:
            truth = walk.recording.truth.segments
            speeds = [_speeds(found, *span) for span in zip(truth.start_s, truth.end_s, strict=True)]
            predicted.append(np.array([GRID_S * np.nansum(s) for s in speeds]))
            true.append(np.asarray(truth.distance_m))
            true_mps = truth.distance_m / (truth.end_s - truth.start_s)
            share = [np.isfinite(s).mean() for s in speeds]
            for speed, t, known in zip(speeds, true_mps, share, strict=True):
                speed_error += [np.nanmean(speed) - t] if known > LEAST_COVERED else []
            covered += share
        sums = np.array([(p.sum(), t.sum()) for p, t in zip(predicted, true, strict=True)])
        others = sums.sum(axis=0) - sums
        factor = others[:, 1] / others[:, 0]
        scaled = [f * p for f, p in zip(factor, predicted, strict=True)]
        return [
            _walk_known(o),
            absolute_bias_spread(evaluate.percent_error(*sums.T), 1),
            _rms_percent(predicted, true),
            _rms_percent(scaled, true),
            f"{absolute_bias_spread(speed_error)}, {len(speed_error)}" if speed_error else "-",
            f"{100 * np.mean(covered):.0f}",
        ]

    columns = "walk known | distance of a walk's legs, error % | of a leg, RMS % | "
    columns += "the same, one factor from the other walks | speed on a leg, error m/s, number of legs | time covered %"
    return table(columns.split(" | "), _speedometers(outcomes), cells)


def _rms_percent(predicted: Sequence[FloatArray], true: Sequence[FloatArray]) -> str:
    error = evaluate.percent_error(np.concatenate(predicted), np.concatenate(true))
    return f"{evaluate.distance_scores(error).rmse_percent:.1f}"


def room(outcomes: Sequence[Outcome]) -> Table:
    """Distances and speeds of tyrex against motion capture."""

    def cells(o: Outcome) -> list[str]:
        distance, speed_error, covered = defaultdict(list), [], []
        for walk, found in o.found:
            grid_s, true_mps = true_speed(walk)
            speed = found.speeds(grid_s)
            known = np.isfinite(speed)
            scenario = walk.recording.name.rsplit("_", 1)[1]
            distance[scenario].append(float(evaluate.percent_error(np.nansum(speed), true_mps.sum())))
            speed_error.append(np.abs(speed - true_mps)[known].mean() if known.any() else np.nan)
            covered.append(known.mean())
        every = [e for errors in distance.values() for e in errors]
        by_scenario = [" ".join(f"{e:+.0f}" for e in distance[s]) for s in WALKING]
        of_speed = [f"{np.nanmean(speed_error):.2f}", f"{100 * np.mean(covered):.0f}"]
        return [_walk_known(o), absolute_bias_spread(every, 1), *by_scenario, *of_speed]

    columns = ("walk known", "distance error %", *WALKING, "speed, mean absolute error m/s", "time covered %")
    return table(columns, _speedometers(outcomes), cells)


def true_speed(walk: Walk) -> tuple[FloatArray, FloatArray]:
    """Times of the walk (G,) and the speed of the phone, its path low-passed at 0.5 Hz, below the sway of steps."""
    grid_s, way_m = way_of(walk.recording, GRID_S)
    speed = np.linalg.norm(np.gradient(way_m, GRID_S, axis=0), axis=1)
    inside = (grid_s >= walk.start_s) & (grid_s <= walk.end_s)
    return grid_s[inside], speed[inside]


def _finders(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Without the rows that would repeat the one before."""
    return [o for o in outcomes if o.method.own_steps]


def _speedometers(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Those that give speeds, and those of which that is not known."""
    return [o for o in outcomes if not o.found or any(len(found.speed_mps) for _, found in o.found)]
