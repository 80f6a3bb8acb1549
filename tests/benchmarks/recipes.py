"""All recipes with HC, WC and IMM on the same recordings.

usage: python -m tests.benchmarks.recipes [tables_of_recipes] [decisions] [--data ../shared/data]
       [--recipes default ...] [--every N] [--jobs 2]

Steps do not depend on the weighting: every recipe senses a recording once, and the weightings share what was sensed.
Every score is of one recording. A cell has the mean over the recordings, or the root of their mean square (%RMSE), and
its standard error, by person where there are several of them. In bold is the best cell of a column and each whose
distance from it, recording by recording, has a mean of no more than one standard error of that mean, or does not show
in the digits.

ubicomp13: steps counted on video against those found from 0.3 s before to 0.3 s after the walk; one found more than a
second outside of it is false. oxford: F1 against foot switches, a constant offset removed. humolire, ms_indoor: RMSE of
the position at the waypoints after rotation and translation onto all of them; end error in per cent of the path, after
that onto the first 20 % of the path; distance on straight legs by displacement (humolire; "a leg":
each of them), or the sum of the step lengths against the line through the waypoints (ms_indoor). tyrex: against the
path of the phone in a room, smoothed below the frequency of steps. pyshoe: against the way of the foot, for a recipe
that fits one. motionsense: share of the steps whose most probable mode is the label, and the distance that the track
walks while the person sits or stands. Speed: on ubicomp13, in the time of the processor, without reading the file.

The same command prints the same figures, but for the speed.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.filter.chain.weighted_tracker import DetectedStepTracker, WeightedTracker
from pdr_filter.filter.imm.weighting import HC, WEIGHTINGS
from pdr_filter.tracking.whole_recording import run_sensing
from pdr_filter.values import Step
from tests.benchmarks.common import Tables, paths, places_of, run
from tests.benchmarks.peers.tables import EDGE_S, OUTSIDE_S, SWITCH_EDGE_S, WALKING, true_speed, walk_of
from tests.benchmarks.peers.walks import GRID_S, Walk
from tests.benchmarks.step_length import way_of_the_foot_m
from tests.benchmarks.weightings import tracked

FloatArray = NDArray[np.float64]
Values = dict[str, float]
RECIPES = ("default", "martinelli2018", "tian2016", "zhou2019", "guo2018", "susi2013")
OWN = "own"  # the recipe's own weighting
TWO = "two windows"  # the mean of two windows, as in Martinelli et al., for recipes that decide once about a step


# --- Scores of one recording -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Found:
    """What a recipe with one weighting made of a recording."""

    config: pdr.Config
    time_s: FloatArray  # (K,)
    position_m: FloatArray  # (K, 2)
    step_length_m: FloatArray  # (K,)
    mode_prob: FloatArray  # (K, M)

    def walked_m(self, start_s: float, end_s: float) -> float:
        """Sum of the step lengths from one time to another."""
        return float(evaluate.walked_m(self.time_s, self.step_length_m, start_s, end_s))


@dataclass(frozen=True, eq=False)
class Scored:
    """A recording with the scores of one recipe and weighting."""

    recipe: str
    weighting: str
    site: str
    name: str
    person: str | None
    values: Values


def count_scores(walk: Walk, step_s: FloatArray) -> Values:
    """Steps of ubicomp13."""
    inside = (step_s >= walk.start_s - EDGE_S) & (step_s <= walk.end_s + EDGE_S)
    before_s, after_s = walk.start_s - OUTSIDE_S, walk.end_s + OUTSIDE_S
    error = float(evaluate.count_error_percent(inside.sum(), walk.recording.truth.segments.n_steps[0]))
    return {
        "count_percent": abs(error),
        "n_false": float(((step_s < before_s) | (step_s > after_s)).sum()),
        "outside_s": max(0.0, before_s) + max(0.0, walk.recording.duration_s - after_s),
    }


def switch_scores(walk: Walk, step_s: FloatArray) -> Values:
    """Steps of oxford; its walks have the edges of the switches."""
    true_s = np.asarray(walk.recording.truth.steps.time_s)
    found_s = step_s[(step_s > true_s[0] - SWITCH_EDGE_S) & (step_s < true_s[-1] + SWITCH_EDGE_S)]

    def f1(tolerance_s: float) -> float:
        return evaluate.f1_score(true_s, found_s + evaluate.best_offset_s(true_s, found_s, tolerance_s), tolerance_s)

    return {"f1": f1(0.25), "f1_close": f1(0.1)}


def waypoint_scores(walk: Walk, found: Found) -> Values:
    """Positions and distances of humolire and ms_indoor."""
    points, segments = walk.recording.truth.waypoints, walk.recording.truth.segments
    reference_m = places_of(points)
    estimate_m = evaluate.positions_at(found.time_s, found.position_m, points.time_s)
    values = {
        "rmse_m": evaluate.position_rmse_m(estimate_m, reference_m, "all"),
        "end_percent": evaluate.end_error_percent(estimate_m, reference_m, "first"),
    }
    if segments is None:
        walked_m = found.walked_m(points.time_s[0], points.time_s[-1])
        return values | {"distance_percent": float(evaluate.percent_error(walked_m, evaluate.path_m(reference_m)[-1]))}
    moved_m = evaluate.moved_m(found.time_s, found.position_m, segments.start_s, segments.end_s)
    each = evaluate.percent_error(moved_m, segments.distance_m)
    return values | {
        "distance_percent": float(evaluate.percent_error(moved_m.sum(), segments.distance_m.sum())),
        "leg_percent": evaluate.distance_scores(each).rmse_percent,
    }


def room_scores(walk: Walk, found: Found) -> Values:
    """Distances of tyrex where the person walks."""
    if not walk.recording.name.endswith(WALKING):
        return {}
    true_m = GRID_S * true_speed(walk)[1].sum()
    return {"walking_percent": float(evaluate.percent_error(found.walked_m(walk.start_s, walk.end_s), true_m))}


def foot_scores(walk: Walk, found: Found) -> Values:
    """Distances of pyshoe."""
    if not found.config.on_foot:
        return {}
    true_m = way_of_the_foot_m(walk.recording)
    return {"foot_percent": float(evaluate.percent_error(found.step_length_m.sum(), true_m))}


def context_scores(walk: Walk, found: Found) -> Values:
    """Contexts of motionsense: of a recording in which nothing was found none is right."""
    label = str(walk.recording.truth.labels.context[0])
    if label == "stationary":
        return {"still_m_per_min": 60 * float(found.step_length_m.sum()) / walk.recording.duration_s}
    modes = np.array([m.context for m in found.config.model.modes])
    right = modes[found.mode_prob.argmax(axis=1)] == label
    return {"right_percent": 100 * float(right.mean()) if len(right) else 0.0}


OF_STEPS: dict[str, Callable[[Walk, FloatArray], Values]] = {"ubicomp13": count_scores, "oxford": switch_scores}
OF_TRACKS: dict[str, Callable[[Walk, Found], Values]] = {
    "humolire": waypoint_scores,
    "ms_indoor": waypoint_scores,
    "tyrex": room_scores,
    "pyshoe": foot_scores,
    "motionsense": context_scores,
}
SITES = (*OF_STEPS, *OF_TRACKS)
# Time is taken where phones were carried in every way, all of them with a gyroscope.
TIMED = "ubicomp13"


def found_by(config: pdr.Config, weighting: str, events: list[object]) -> Found:
    """The track of what was sensed."""
    updates = tracked(events, config, weighting)
    return Found(
        config,
        np.array([u.step.time_s for u in updates]),
        np.array([u.position_m for u in updates]).reshape(-1, 2),
        np.array([u.step_length_m for u in updates]),
        np.array([u.mode_prob for u in updates]).reshape(-1, len(config.model.modes)),
    )


@cache
def warm(recipe: str) -> None:
    """Loads, once in a process, what a recipe needs, so that it is not timed."""
    config = pdr.recipes.RECIPES[recipe](None)
    events = run_sensing(config.sensing, pdr.simulate.demo_walk())[1]
    for weighting in WEIGHTINGS:
        found_by(config, weighting, events)


def scored(path: Path, recipes: Sequence[str]) -> list[Scored]:
    """All recipes with all weightings on one recording; the recipe's own weighting twice, under `OWN` too."""
    walk = walk_of(path)
    recording, site = walk.recording, path.parent.name
    result = []
    for recipe in recipes:
        warm(recipe)
        config = pdr.recipes.for_recording(recipe, recording)
        begin_s = time.process_time()
        events = run_sensing(config.sensing, recording)[1]
        sensed_s = time.process_time() - begin_s
        values: Values = {}
        if site in OF_STEPS:
            values = OF_STEPS[site](walk, np.array([e.time_s for e in events if isinstance(e, Step)]))
        ways = {weighting: config for weighting in WEIGHTINGS}
        if isinstance(config.tracker, DetectedStepTracker):
            ways[TWO] = replace(config, tracker=WeightedTracker(config.model, HC))
        for weighting, weighted in ways.items():
            its = dict(values)
            if site in OF_TRACKS or site == TIMED:
                begin_s = time.process_time()
                found = found_by(weighted, "hc" if weighting == TWO else weighting, events)
                its |= OF_TRACKS[site](walk, found) if site in OF_TRACKS else {}
            if site == TIMED:
                its |= {"spent_s": sensed_s + time.process_time() - begin_s, "recorded_s": recording.duration_s}
            names = [weighting, OWN] if weighting == config.tracker.weighting else [weighting]
            result += [Scored(recipe, n, site, recording.name, recording.subject.id, its) for n in names]
    return result


# --- Columns ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Column:
    """A score of a site over its recordings."""

    title: str
    site: str
    value: str
    digits: int = 1
    root: bool = False  # of the mean square
    ideal: float = 0.0  # scores are no better than that


MAIN = (
    Column("steps %", "ubicomp13", "count_percent", 2),
    Column("humolire distance %RMSE", "humolire", "distance_percent", root=True),
    Column("position m", "humolire", "rmse_m", 2),
    Column("end %", "humolire", "end_percent", 2),
    Column("ms_indoor distance %RMSE", "ms_indoor", "distance_percent", root=True),
    Column("position m", "ms_indoor", "rmse_m", 2),
    Column("end %", "ms_indoor", "end_percent"),
)
REST = (
    Column("oxford F1 0.25 s", "oxford", "f1", 3, ideal=1.0),
    Column("0.1 s", "oxford", "f1_close", 3, ideal=1.0),
    Column("humolire, a leg %RMSE", "humolire", "leg_percent", root=True),
    Column("tyrex distance %RMSE", "tyrex", "walking_percent", root=True),
    Column("motionsense right mode %", "motionsense", "right_percent", ideal=100.0),
    Column("sitting, standing m/min", "motionsense", "still_m_per_min", 2),
    Column("pyshoe distance %RMSE", "pyshoe", "foot_percent", root=True),
)


def standard_error(values: FloatArray, groups: Sequence[str]) -> float:
    """Of the mean of values (N,) that are alike within groups (N,): sums of the groups' deviations, G / (G - 1)."""
    deviation = values - values.mean()
    of_group = np.unique(groups, return_inverse=True)[1]
    sums = np.bincount(of_group, deviation)
    n_groups = len(sums)
    return float(np.sqrt((sums**2).sum() * n_groups / (n_groups - 1)) / len(values)) if n_groups > 1 else np.nan


def groups_of(records: Sequence[Scored]) -> list[str]:
    """People, or recordings where the people are not known or only one."""
    people = {r.person for r in records}
    by_person = len(people) > 1 and None not in people
    return [str(r.person) if by_person else r.name for r in records]


def cells(column: Column, of_row: Sequence[Sequence[Scored]]) -> list[str]:
    """The column of a table: mean or root mean square, standard error, bold if not distinguishable from the best."""
    records = [[r for r in row if r.site == column.site and column.value in r.values] for row in of_row]
    scores = [np.array([r.values[column.value] for r in row]) for row in records]
    loss = [s**2 if column.root else np.abs(column.ideal - s) for s in scores]
    known = [k for k in range(len(loss)) if len(loss[k])]
    if not known:
        return ["-"] * len(of_row)
    best = min(known, key=lambda k: loss[k].mean())
    value = [
        float(np.sqrt(loss[k].mean()) if column.root else scores[k].mean()) if k in known else np.nan
        for k in range(len(loss))
    ]
    text = [f"{v:.{column.digits}f}" for v in value]
    result = ["-"] * len(of_row)
    for k in known:
        groups = groups_of(records[k])
        worse = loss[k] - loss[best]
        near = text[k] == text[best] or worse.mean() <= standard_error(worse, groups)
        # of a root: d sqrt(x) = dx / (2 sqrt(x))
        error = standard_error(loss[k], groups) / (2 * value[k] if column.root else 1.0)
        result[k] = (f"**{text[k]}**" if near else text[k]) + f" ± {error:.{column.digits}f}"
    return result


def total(records: Iterable[Scored], value: str) -> float:
    """Sum over the recordings that have it."""
    return sum(r.values[value] for r in records if value in r.values)


def over(numerator: float, denominator: float, digits: int) -> str:
    """A quotient; a dash of nothing."""
    return f"{numerator / denominator:.{digits}f}" if denominator else "-"


def weighting_tables(tables: Tables, records: Sequence[Scored], recipes: Sequence[str]) -> None:
    """Write the scores of each recipe with each weighting, as two tables."""
    rows = [(recipe, weighting) for recipe in recipes for weighting in WEIGHTINGS]
    of_row = [[r for r in records if (r.recipe, r.weighting) == row] for row in rows]
    names = [f"`{recipe}` {weighting.upper()}" for recipe, weighting in rows]
    speed = [over(total(r, "recorded_s"), total(r, "spent_s"), 0) for r in of_row]
    false = [over(60 * total(r, "n_false"), total(r, "outside_s"), 1) for r in of_row]
    about = "± standard error; bold: not distinguishable from the best."
    main, rest = ([cells(c, of_row) for c in columns] for columns in (MAIN, REST))
    for name, columns, found, title, last in (
        ("recipes_main", MAIN, main, "x real time", speed),
        ("recipes_rest", REST, rest, "false steps a minute", false),
    ):
        titles = ["recipe", *(c.title for c in columns), title]
        tables.write(name, titles, list(zip(names, *found, last, strict=True)), about)


def readme_table(tables: Tables, records: Sequence[Scored], recipes: Sequence[str]) -> None:
    """Each recipe once, with its own weighting, that of its paper."""
    of_row = [[r for r in records if (r.recipe, r.weighting) == (recipe, OWN)] for recipe in recipes]
    names = [f"`{recipe}` {pdr.recipes.RECIPES[recipe](None).tracker.weighting.upper()}" for recipe in recipes]
    steps, *others = [[cell.split(" ±")[0] for cell in cells(c, of_row)] for c in MAIN]
    speed = [over(total(r, "recorded_s"), total(r, "spent_s"), 0) for r in of_row]
    false = [over(60 * total(r, "n_false"), total(r, "outside_s"), 1) for r in of_row]
    titles = "recipe | steps % | false steps a minute | corridors: distance % | position m | end % | "
    titles += "mall: distance % | position m | end % | x real time"
    rows = list(zip(names, steps, false, *others, speed, strict=True))
    tables.write("recipes_readme", titles, rows, "Bold: not distinguishable from the best.")


def decisions(tables: Tables, arguments: argparse.Namespace) -> None:
    """Compare one decision for each step with the mean of two windows, in the recipes that decide once."""
    recipes = [r for r in RECIPES if isinstance(pdr.recipes.RECIPES[r](None).tracker, DetectedStepTracker)]
    thinned = {"motionsense": 6}
    files = [p for site in OF_TRACKS for p in paths(arguments.data, site)[:: thinned.get(site, 1)]]
    records = [r for found in Parallel(arguments.jobs)(delayed(scored)(p, recipes) for p in files) for r in found]
    rows = [(recipe, weighting) for recipe in recipes for weighting in (TWO, OWN)]
    of_row = [[r for r in records if (r.recipe, r.weighting) == row] for row in rows]
    names = [f"`{recipe}`, {'mean of two windows' if w == TWO else 'one decision'}" for recipe, w in rows]
    columns = [c for c in (*MAIN, *REST) if c.site in OF_TRACKS]
    found = [[cells(c, of_row[k : k + 2]) for k in range(0, len(rows), 2)] for c in columns]
    texts = [[cell for pair in of_column for cell in pair] for of_column in found]
    about = "± standard error; bold: the better of the two, or both if not distinguishable. Motionsense: every 6th."
    titles = ["recipe", *(c.title if c.site in c.title else f"{c.site} {c.title}" for c in columns)]
    tables.write("recipes_decisions", titles, list(zip(names, *texts, strict=True)), about)


def tables_of_recipes(tables: Tables, arguments: argparse.Namespace) -> None:
    """All tables."""
    files = [p for site in SITES for p in paths(arguments.data, site)[:: arguments.every]]
    jobs = (delayed(scored)(path, arguments.recipes) for path in files)
    records = [r for found in Parallel(arguments.jobs)(jobs) for r in found]
    if arguments.every > 1 or tuple(arguments.recipes) != RECIPES:
        tables = Tables(tables.command, None)
    weighting_tables(tables, records, arguments.recipes)
    readme_table(tables, records, arguments.recipes)


if __name__ == "__main__":
    from tests.benchmarks import recipes as importable  # what other processes run must be found by its name

    run(__doc__, importable.tables_of_recipes, importable.decisions, recipes=list(RECIPES), every=1, jobs=2)
