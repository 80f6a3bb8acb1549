"""Context probabilities of people left out: classifiers side by side, and a reliability diagram.

usage: .venv/bin/python tests/benchmarks/context_accuracy.py [--data ../shared/data] [--figure FILE.svg]

One of the 12 MotionSense people is left out at a time; every classifier is calibrated on people left out among the
other eleven. Windows of 2 s, 1 s apart, each judged alone. The rows learn from MotionSense alone, the last one from all
sites with gyroscope, as the default model does. The column of ubicomp13 is walking in a trouser pocket by 13 other
people with other phones, fitted on everybody in training; ubicomp13 is never trained on.
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
from rich.console import Console
from rich.table import Table
from sklearn.ensemble import RandomForestClassifier

from pdr_filter.classifiers.forest import Forest
from pdr_filter.classifiers.probability_calibration import reliability
from pdr_filter.papers.martinelli2018 import features as martinelli
from pdr_filter.training.contexts import (
    FEATURE_SETS,
    PLANS,
    Fitted,
    LabelledWindows,
    Plan,
    fit,
    fit_blend,
    fit_relevance_vectors,
    fit_softmax,
    labelled_windows,
    score,
)
from pdr_filter.values.arrays import BoolArray, FloatArray
from pdr_filter.values.contexts import CONTEXTS

WALKING = CONTEXTS.index("walking")
SHIPPED = {plan.name: plan for plan in PLANS}
ALONE = replace(SHIPPED["context"], datasets=("motionsense",))


def fit_large_forest(Z: FloatArray, y: Any, weight: FloatArray) -> tuple[Forest, tuple[str, ...]]:  # noqa: N803
    """100 trees with leaves of 20 windows."""
    forest = RandomForestClassifier(100, min_samples_leaf=20, random_state=0, n_jobs=1).fit(Z, y, sample_weight=weight)
    return Forest.from_sklearn(forest), tuple(str(c) for c in forest.classes_)


PAPER = replace(
    SHIPPED["context_martinelli_rvm"], datasets=("motionsense",), feature_names=martinelli.WITHOUT_MAGNETOMETER
)
ROWS: dict[str, Plan] = {
    "logistic regression": replace(ALONE, machine_fit=fit_softmax),
    "RVM, RBF kernel": replace(ALONE, machine_fit=fit_relevance_vectors),
    "RVM, linear": replace(ALONE, machine_fit=partial(fit_relevance_vectors, kernel="linear", window_weight=0.03)),
    "random forest, 100 trees": replace(ALONE, machine_fit=fit_large_forest),
    "logistic regression + boosting": replace(ALONE, machine_fit=fit_blend),
    "the paper's features, RVM": PAPER,
    "all sites: LR + boosting": SHIPPED["context"],
}
IN_FIGURE = ("logistic regression", "RVM, RBF kernel", "all sites: LR + boosting")


@dataclass(frozen=True, eq=False)
class Problem:
    """What a plan learns from and is scored on."""

    plan: Plan
    features: FloatArray
    windows: LabelledWindows
    use: BoolArray

    def fitted(self, rows: BoolArray) -> Fitted:
        rows = rows & self.use
        y, person = self.windows.context[rows], self.windows.person[rows]
        return fit(self.plan.machine_fit, CONTEXTS, self.features[rows], y, person, np.ones(len(y)))


def of_person(problem: Problem, test: BoolArray) -> FloatArray:
    """Probabilities (W, 6) of the windows to test by a model that has not seen their person."""
    return problem.fitted(~test).prob(problem.features[test])


def in_pockets(data: Path, windows: LabelledWindows) -> BoolArray:
    """Windows of ubicomp13 inside the walk and in a trouser pocket."""
    pocket = {path.stem for path in data.glob("ubicomp13/*pocket*.zip") if "shirt" not in path.stem}
    return np.isin(windows.recording, sorted(pocket))


def table_of(rows: dict[str, dict[str, Any]]) -> Table:
    columns = ("accuracy", "worst person", "macro recall", "log loss", "Brier", "ECE", "ubicomp13 recall", "log loss ")
    table = Table("people left out", *columns, box=None)
    for name, row in rows.items():
        table.add_row(name, *(f"{row[c]:.3f}" for c in columns))
    return table


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "data")
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--only", nargs="*", help="rows of these names")
    args = parser.parse_args()
    datasets = sorted({d for plan in PLANS for d in plan.datasets} | {"ubicomp13"})
    paths = [p for d in datasets for p in sorted((args.data / d).glob("*.zip")) if p.stem != "motionsense_s01_sit_13"]
    windows = {name: labelled_windows(paths, None, name) for name in sorted(FEATURE_SETS)}

    rows: dict[str, dict[str, Any]] = {}
    probs: dict[str, tuple[FloatArray, BoolArray]] = {}
    for name, plan in ROWS.items():
        if args.only and name not in args.only:
            continue
        w = windows[plan.feature_set]
        names = FEATURE_SETS[plan.feature_set].names
        features = w.features[:, [names.index(n) for n in plan.feature_names]]
        problem = Problem(plan, features, w, plan.rows(w))
        scored = w.dataset == "motionsense"
        people = [w.person == p for p in np.unique(w.person[scored])]
        found = Parallel(n_jobs=-1)(delayed(of_person)(problem, test) for test in people)
        prob = np.zeros((len(w.context), len(CONTEXTS)))
        for test, part in zip(people, found, strict=True):
            prob[test] = part
        result = score(w.context[scored], prob[scored])
        correct = np.array(CONTEXTS)[prob.argmax(axis=1)] == w.context
        pocket = in_pockets(args.data, w)
        elsewhere = problem.fitted(np.ones(len(w.context), bool)).prob(features[pocket])
        rows[name] = {
            "accuracy": result["accuracy"],
            "worst person": min(correct[test].mean() for test in people),
            "macro recall": result["macro_recall"],
            "log loss": result["log_loss"],
            "Brier": result["brier"],
            "ECE": result["expected_calibration_error"],
            "ubicomp13 recall": np.mean(elsewhere.argmax(axis=1) == WALKING),
            "log loss ": -np.log(np.maximum(elsewhere[:, WALKING], 1e-15)).mean(),
        }
        probs[name] = prob[scored], correct[scored]
        print(name, rows[name], {c: round(r, 3) for c, r in result["recall"].items()}, flush=True)
    Console(width=150).print(table_of(rows))
    if args.figure:
        draw({name: probs[name] for name in IN_FIGURE if name in probs}, args.figure)


if __name__ == "__main__":
    main()
