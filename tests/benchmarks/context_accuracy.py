"""Context probabilities of people left out: classifiers side by side, and a reliability diagram.

usage: python -m tests.benchmarks.context_accuracy [--data ../shared/data] [--figure FILE.png]

One of the 12 MotionSense people is left out at a time; every classifier is calibrated on the other eleven, left out as
well. Windows of 2 s, 1 s apart, each judged alone, without those whose labels are doubtful. The rows learn from
MotionSense alone, the last one from all sites with gyroscope, as the default model does (its guard of stairs is not
used). The column of ubicomp13 is walking in a trouser pocket by 13 other people with other phones, fitted on everybody
in training; ubicomp13 is never trained on.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from joblib import Parallel, delayed
from matplotlib.figure import Figure

from models.training.context_training import (
    FEATURE_SETS,
    PLANS,
    ContextPlan,
    calibration,
    cross_calibrated,
    labelled_windows,
)
from models.training.data_sets import recordings_of
from pdr_filter.classifiers.context_model import ContextModel
from pdr_filter.classifiers.probability_calibration import reliability
from pdr_filter.offline.training.classifier_choice import fit_blend, fit_forest, fit_relevance_vectors, fit_softmax
from pdr_filter.offline.training.cross_validation import LabelledWindows, score
from pdr_filter.recipes.martinelli2018 import features as martinelli
from pdr_filter.values import CONTEXTS, BoolArray, FloatArray
from tests.benchmarks.common import Tables, run

WALKING = CONTEXTS.index("walking")
SHIPPED = {plan.name: plan for plan in PLANS}
ALONE = replace(SHIPPED["context"], datasets=("motionsense",))


PAPER = replace(
    SHIPPED["context_martinelli_rvm"], datasets=("motionsense",), feature_names=martinelli.WITHOUT_MAGNETOMETER
)
ROWS: dict[str, ContextPlan] = {
    "logistic regression": replace(ALONE, machine_fit=fit_softmax),
    "RVM, RBF kernel": replace(ALONE, machine_fit=fit_relevance_vectors),
    "RVM, linear": replace(ALONE, machine_fit=partial(fit_relevance_vectors, kernel="linear", window_weight=0.03)),
    "random forest, 100 trees": replace(ALONE, machine_fit=partial(fit_forest, n_trees=100)),
    "logistic regression + boosting": replace(ALONE, machine_fit=fit_blend),
    "the paper's features, RVM": PAPER,
    "all sites: LR + boosting": SHIPPED["context"],
}
IN_FIGURE = ("logistic regression", "RVM, RBF kernel", "all sites: LR + boosting")


@dataclass(frozen=True, eq=False)
class Problem:
    """What a plan learns from and is scored on."""

    plan: ContextPlan
    windows: LabelledWindows  # all, with the plan's features
    use: BoolArray  # (W,) those that the plan learns from

    def fitted(self, rows: BoolArray) -> ContextModel:
        return self.plan.fit(self.windows.part(rows & self.use))


def of_person(problem: Problem, test: BoolArray) -> FloatArray:
    """Probabilities (W, 6) of the windows to test by a model that has not seen their person, not yet calibrated."""
    return problem.fitted(~test).probabilities(problem.windows.features[test])


def in_pockets(data: Path, windows: LabelledWindows) -> BoolArray:
    """Windows of ubicomp13 inside the walk and in a trouser pocket."""
    pocket = {path.stem for path in data.glob("ubicomp13/*pocket*.zip") if "shirt" not in path.stem}
    return np.isin(windows.recording, sorted(pocket))


def draw(probs: dict[str, tuple[FloatArray, BoolArray]], path: Path) -> None:
    """Reliability diagrams above the shares of windows in each bin."""
    figure = Figure(figsize=(3.2 * len(probs), 4.2), layout="constrained")
    top, bottom = figure.subplots(2, len(probs), sharex=True, sharey="row", height_ratios=(3, 1))
    for i, (name, (prob, correct)) in enumerate(probs.items()):
        diagram = reliability(prob, correct)
        top[i].plot([0.2, 1], [0.2, 1], color="0.7", linewidth=1)
        top[i].plot(diagram.confidence, diagram.accuracy, "o-", color="#0072b2", markersize=4)
        top[i].set_title(f"{name}\nECE {diagram.expected_calibration_error:.3f}", fontsize=10)
        bottom[i].bar(diagram.confidence, diagram.share, width=0.05, color="#0072b2")
        bottom[i].set_yscale("log")
        bottom[i].set_xlabel("confidence")
    top[0].set_ylabel("share that is right")
    bottom[0].set_ylabel("share of\nwindows")
    path.parent.mkdir(parents=True, exist_ok=True)
    mpl.rcParams["svg.hashsalt"] = "pdr_filter"
    figure.savefig(path, metadata={"Date": None})


def contexts(tables: Tables, arguments: argparse.Namespace) -> None:
    """One subject of MotionSense left out at a time."""
    datasets = sorted({d for plan in PLANS for d in plan.datasets} | {"ubicomp13"})
    only = arguments.only.split(",") if arguments.only else []
    files = recordings_of(arguments.data, datasets)
    windows = {name: labelled_windows(files, feature_set=name) for name in sorted(FEATURE_SETS)}

    rows: dict[str, dict[str, Any]] = {}
    probs: dict[str, tuple[FloatArray, BoolArray]] = {}
    for name, plan in ROWS.items():
        if only and name not in only:
            continue
        w = windows[plan.feature_set]
        features = plan.features(w)
        problem = Problem(plan, replace(w, features=features), plan.rows(w))
        scored = w.dataset == "motionsense"
        people = [w.person == p for p in np.unique(w.person[scored])]
        found = Parallel(n_jobs=-1)(delayed(of_person)(problem, test) for test in people)
        prob = np.zeros((len(w.context), len(CONTEXTS)))
        for test, part in zip(people, found, strict=True):
            prob[test] = part
        everybody = problem.fitted(np.ones(len(w.context), bool))
        temperature, slip = calibration(prob[scored], w.context[scored], everybody)
        prob[scored] = cross_calibrated(prob[scored], w.context[scored], w.person[scored], everybody)
        result = score(w.context[scored], prob[scored])
        correct = np.array(CONTEXTS)[prob.argmax(axis=1)] == w.context
        pocket = in_pockets(arguments.data, w)
        elsewhere = replace(everybody, temperature=temperature, slip=slip).probabilities(features[pocket])
        rows[name] = {
            "accuracy": result["accuracy"],
            "worst person": min(correct[test].mean() for test in people),
            "macro recall": result["macro_recall"],
            "log loss": result["log_loss"],
            "Brier": result["brier"],
            "ECE": result["expected_calibration_error"],
            "ubicomp13: recall": np.mean(elsewhere.argmax(axis=1) == WALKING),
            "log loss there": -np.log(np.maximum(elsewhere[:, WALKING], 1e-15)).mean(),
        }
        probs[name] = prob[scored], correct[scored]
        print(name, {c: round(r, 3) for c, r in result["recall"].items()}, flush=True)
    columns = list(next(iter(rows.values())))
    table = [[name, *(f"{row[c]:.3f}" for c in columns)] for name, row in rows.items()]
    about = "12 people of MotionSense, each held out; walking of ubicomp13 in trouser pockets."
    replace(tables, folder=None if only else tables.folder).write("contexts", ["", *columns], table, about)
    if arguments.figure:
        draw({name: probs[name] for name in IN_FIGURE if name in probs}, arguments.figure)


if __name__ == "__main__":
    run(__doc__, contexts, figure=None, only="")
