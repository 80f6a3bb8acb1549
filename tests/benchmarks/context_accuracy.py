"""Classifiers of the default recipe side by side, on people and sites that they have not seen.

usage: python -m tests.benchmarks.context_accuracy [--data ../shared/data] [--cache FOLDER] [--figure FILE.png]

People of MotionSense and Di Fronzo are held out in four groups, and whole sites one at a time. Each classifier is
calibrated on all other held-out people. Windows of 2 s, 1 s apart, each judged alone, without those whose labels are
doubtful. ubicomp13 and terrain train no model, so that the shipped models are scored there. False stairs are windows
of level walking whose most probable context is stairs, after the treatment of windows unlike all stairs.

With --cache, windows and fitted models are kept in a folder, from which an interrupted run continues.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from models.training.context_training import PLANS, ContextPlan, labelled_windows, walking_scores
from models.training.data_sets import SCORED_DATASET, recordings_of
from pdr_filter.classifiers.context_model import ContextModel, load_model
from pdr_filter.classifiers.probability_calibration import reliability_diagram
from pdr_filter.offline.training.cross_validation import (
    Fits,
    LabelledWindows,
    calibrate_fits,
    cross_calibrated,
    fit_groups,
    in_window_order,
    most_probable_labels,
    predictions,
    silent,
)
from pdr_filter.values import CONTEXTS, BoolArray, FloatArray
from tests.benchmarks.common import ROOT, Tables, run
from tests.benchmarks.weightings import cached

# Sites that no shipped model is trained on.
UNSEEN = ("terrain", "ubicomp13")
SITES = ("tyrex", "humolire", "ms_indoor", *UNSEEN)
SCORES = {"macro_recall": "macro recall", "log_loss": "log loss", "expected_calibration_error": "ECE"}
_NAMES = {"": "blend", "_rvm": "rvm", "_forest": "forest", "_boosted": "boosted"}


def classifiers(
    plan: ContextPlan, windows: LabelledWindows, cache: Path | None
) -> Iterator[tuple[str, ContextPlan, Fits]]:
    """Name, plan and fits of the models that a plan trains."""
    fits: Fits = cached(cache, f"fits_{plan.name}", lambda: fit_groups(plan, windows, silent))
    for own, of_own in ((plan, fits), *(plan.fits_of_part(fits, part) for part in plan.parts)):
        kind = own.name.removeprefix("context").removesuffix("_accelerometer")
        yield _NAMES[kind] + ("" if plan.has_gyroscope else ", accelerometer alone"), own, of_own


def window_ms(model: ContextModel, features: FloatArray) -> float:
    """Processor time of one window alone, in ms: the least mean of 20 blocks of 20 windows."""
    times_s: list[float] = []
    for block in features[:400].reshape(20, 20, -1):
        start_s = time.process_time()
        for row in block:
            model.assess(row)
        times_s.append((time.process_time() - start_s) / len(block))
    return 1e3 * min(times_s)


def draw(probs: dict[str, tuple[FloatArray, BoolArray]], path: Path) -> None:
    """Reliability diagrams above the shares of windows in each bin."""
    figure = Figure(figsize=(3.2 * len(probs), 4.2), layout="constrained")
    top, bottom = figure.subplots(2, len(probs), sharex=True, sharey="row", height_ratios=(3, 1))
    for i, (name, (prob, correct)) in enumerate(probs.items()):
        diagram = reliability_diagram(prob, correct)
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


def held_out_people(plan: ContextPlan, windows: LabelledWindows, fits: Fits) -> tuple[FloatArray, BoolArray]:
    """Calibrated probabilities of the held-out people of MotionSense, and whether the most probable is right."""
    groups = predictions(plan, windows, fits)
    left = in_window_order(group for name, group in groups.items() if name not in plan.datasets)
    own = windows.part(left.rows)
    prob = cross_calibrated(left.prob, own.context, own.person, fits.model)
    scored = own.dataset == SCORED_DATASET
    return prob[scored], (most_probable_labels(prob, CONTEXTS) == own.context)[scored]


def contexts(tables: Tables, arguments: argparse.Namespace) -> None:
    """All classifiers, with gyroscope and with the accelerometer alone."""
    paths = recordings_of(arguments.data, sorted({d for p in PLANS for d in p.datasets} | set(UNSEEN)))
    people: list[list[str]] = []
    sites: list[list[str]] = []
    probs: dict[str, tuple[FloatArray, BoolArray]] = {}
    for with_gyroscope in (True, False):
        every: LabelledWindows = cached(
            arguments.cache,
            f"w_{with_gyroscope}",
            lambda gyroscope=with_gyroscope: labelled_windows(paths, silent, "invariant", gyroscope),
        )
        usable = every.part(every.has_gyroscope | (not with_gyroscope))
        for plan in (p for p in PLANS if p.guards_stairs and p.has_gyroscope == with_gyroscope):
            windows = plan.of(every)
            for name, of_plan, fits in classifiers(plan, windows, arguments.cache):
                card, shipped = calibrate_fits(of_plan, windows, fits).card, load_model(of_plan.name)
                scores, of_sites = card["leave_one_subject_out"], card["site_left_out"]
                cells = [f"{of[key]:.3f}" for of in (scores, scores["difronzo"]) for key in SCORES]
                size_mb = sum(path.stat().st_size for path in ROOT.glob(f"models/{shipped.name}.*")) / 1e6
                people.append([name, *cells, f"{window_ms(shipped, windows.features):.2f}", f"{size_mb:.2f}"])
                for site in UNSEEN:
                    walking = usable.part((usable.dataset == site) & (usable.context == "walking"))
                    of_sites[site] = walking_scores(shipped.probabilities(of_plan.features(walking)))
                shares = [(of_sites[s]["walking_recall"], of_sites[s]["false_stairs"]) for s in SITES if s in of_sites]
                sites.append([name, *(f"{100 * recall:.1f}, {100 * stairs:.1f}" for recall, stairs in shares)])
                if with_gyroscope:
                    probs[name] = held_out_people(of_plan, windows, fits)
                print(people[-1], sites[-1], flush=True)
    of_people = [f"{dataset}: {what}" for dataset in ("MotionSense", "Di Fronzo") for what in SCORES.values()]
    about = (
        "12 people of MotionSense and 4 of Di Fronzo, held out in four groups. ms: processor time of one window alone."
    )
    tables.write("contexts", ["", *of_people, "ms for a window", "MB"], people, about)
    about = "Windows of level walking: recognised, and taken for stairs, in %. Sites of the training are held out."
    tables.write("contexts_sites", ["", *SITES], sites, about)
    if arguments.figure:
        draw(probs, arguments.figure)


if __name__ == "__main__":
    run(__doc__, contexts, figure=None, cache=None)
