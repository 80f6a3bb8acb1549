"""Simulated people beside real ones: contexts, and a tree that tells them apart.

usage: python -m tests.benchmarks.simulated_people [--people 48] [--data ../shared/data] [--print]

contexts: windows of simulated people, classified by the shipped context model, beside those of real people by the same
plan without them: a fourth of the people of motionsense and difronzo at a time, the other sites one at a time. A
decision tree of depth 5 is trained on the features of the context model to tell simulated windows from real ones, and
tested on people left out, real and simulated; 0.5 is no difference. Its best feature is the one it uses most.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics import roc_auc_score
from sklearn.model_selection import GroupKFold
from sklearn.tree import DecisionTreeClassifier

import pdr_filter as pdr
from models.training.context_training import PLANS, labelled_windows
from models.training.data_sets import label_of, recordings_of
from models.training.simulated_people import random_person
from pdr_filter.classifiers.context_model import load_model
from pdr_filter.offline.training.cross_validation import LabelledWindows
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.features.feature_windows import ATTITUDE_FREE, FeatureWindows
from pdr_filter.sensing.front_end import feature_windows
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import BoolArray
from tests.benchmarks.common import Tables, run

TextArray = NDArray[np.str_]
PLAN = {plan.name: plan for plan in PLANS}["context"]
SETS = ("motionsense", "difronzo", "tyrex", "humolire", "ms_indoor")
# Carrying mode, strides (None: of any kind), and what the place is called; a pocket is a front or a back one.
PLACES = {
    "front pocket": ("pocket", "pocket"),
    "back pocket": ("pocket", "back_pocket"),
    "texting": ("texting", None),
    "swinging": ("swinging", None),
    "calling": ("calling", None),
}
MOVING = ("walking", "upstairs", "downstairs", "running")


def person_in(place: str, number: int) -> tuple[pdr.simulate.Gait, pdr.simulate.Carrying]:
    """Somebody who carries the phone there."""
    mode, strides = PLACES[place]
    found = (random_person(mode, n) for n in range(1000 * number, 1000 * (number + 1)))
    return next((g, c) for g, c in found if strides is None or c.strides == strides)


# --- contexts -------------------------------------------------------------------------------------------------------


def simulated_windows(place: str, n_people: int) -> LabelledWindows:
    """Feature windows of people who stand, walk, climb, walk, descend and run."""
    stage, mode = FeatureWindows(features=ATTITUDE_FREE), PLACES[place][0]
    parts: list[LabelledWindows] = []
    for number in range(n_people):
        gait, carrying = person_in(place, number)
        turn_rad = 0.7 * (number % 3 - 1)
        legs = [Leg("stationary", duration_s=8.0)]
        legs += [Leg(c, duration_s=14.0, turn_rad=turn_rad) for c in ("walking", "upstairs", "walking", "downstairs")]
        legs.append(Leg("running", duration_s=14.0))
        rate_hz = 50.0 if number % 2 else 100.0
        walk = simulate(legs, gait, mode, rate_hz=rate_hz, seed=number, carrying={mode: carrying})
        found = [
            (window.features, *label)
            for window in feature_windows(stage, [merge_streams(walk)])
            if (label := label_of(walk, window.time_s - stage.window_s, window.time_s)) is not None
        ]
        features, context, carried = (np.array(column) for column in zip(*found, strict=True))
        known = np.ones(len(features), dtype=bool)
        parts.append(LabelledWindows.of_one(features, context, carried, f"simulated/{number}", "simulated", "", known))
    return replace(w := LabelledWindows.concatenate(parts), features=PLAN.features(w))


def real_windows(data: Path) -> LabelledWindows:
    """Those of all licensed sites with a gyroscope."""
    found = labelled_windows(recordings_of(data, SETS), feature_set="invariant")
    return replace(found, features=PLAN.features(found))


def left_out(windows: LabelledWindows) -> TextArray:
    """Context of each window by models that have not seen its person."""
    named = np.isin(windows.dataset, ("motionsense", "difronzo"))
    folds = [
        np.isin(np.arange(len(named)), np.flatnonzero(named)[test]) for _, test in _folds(windows.person[named], 4)
    ]
    folds += [windows.dataset == site for site in SETS if site not in ("motionsense", "difronzo")]
    trained = np.isin(windows.dataset, PLAN.datasets) & windows.has_gyroscope
    said = np.empty(len(windows.context), dtype=object)
    for test in folds:
        model = PLAN.fit(windows.part(trained & ~test))
        said[test] = np.array(PLAN.labels)[model.probabilities(windows.features[test]).argmax(axis=1)]
    return said.astype(str)


def _folds(groups: TextArray, n: int) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    return GroupKFold(n).split(groups, groups=groups)


def of_place(windows: LabelledWindows, place: str) -> BoolArray:
    """Which real windows are of a place."""
    back = np.char.find(windows.recording, "backpocket") >= 0
    return (windows.carrying_mode == PLACES[place][0]) & (back if place == "back pocket" else ~back)


def told_apart(real: LabelledWindows, made: LabelledWindows) -> tuple[float, str]:
    """Area under the curve of a tree on people left out, and its best feature with medians of both."""
    x, y = np.vstack([real.features, made.features]), np.repeat([0, 1], [len(real.context), len(made.context)])
    who = np.concatenate([np.where(real.person == "ms_indoor/None", real.recording, real.person), made.person])
    weight = np.where(y == 0, 1 / (y == 0).sum(), 1 / (y == 1).sum()) * len(y)
    tree, prob = DecisionTreeClassifier(max_depth=5, min_samples_leaf=20, random_state=0), np.empty(len(y))
    for train, test in _folds(who, 5):
        prob[test] = tree.fit(x[train], y[train], sample_weight=weight[train]).predict_proba(x[test])[:, 1]
    best = int(tree.fit(x, y, sample_weight=weight).feature_importances_.argmax())
    medians = ", ".join(f"{np.median(w.features[:, best]):.2f}" for w in (real, made))
    return float(roc_auc_score(y, prob, sample_weight=weight)), f"`{PLAN.feature_names[best]}` ({medians})"


def contexts(tables: Tables, arguments: argparse.Namespace) -> None:
    real, model = real_windows(arguments.data), load_model("context")
    said, rows = left_out(real), list[list[object]]()
    for place in PLACES:
        made = simulated_windows(place, arguments.people)
        made_said = np.array(PLAN.labels)[model.probabilities(made.features).argmax(axis=1)]
        for context in MOVING:
            own = made.context == context
            there = of_place(real, place) & (real.context == context)
            people = np.unique(real.person[there])
            of_each = [np.mean(said[there & (real.person == p)] == context) for p in people]
            cells: list[object] = [f"{np.mean(made_said[own] == context):.2f}"]
            cells += [f"{np.mean(of_each):.2f}" if len(people) else "-", len(people) or "-"]
            if len(people) and there.sum() > 300:
                area, best = told_apart(real.part(there), made.part(own))
                cells += [f"{area:.2f}", best]
            else:
                cells += ["-", "-"]
            rows.append([place, context, *cells])
    columns = "place | context | recall: simulated | real, held out | real people | tree: AUC | its best feature"
    about = f"{arguments.people} simulated people in each place. Recall of windows, mean over people; "
    about += "medians: real, simulated."
    tables.write("simulated_people", columns, rows, about)


if __name__ == "__main__":
    run(__doc__, contexts, people=48)
