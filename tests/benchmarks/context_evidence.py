"""How far to divide the training prior out of the context probabilities, and how much to temper them.

usage: .venv/bin/python tests/benchmarks/context_evidence.py [--data ../shared/data]

Probabilities of windows are of people whom the default's model has not seen: MotionSense by leaving one person out,
ubicomp13 (walking only, other people and phones) and tyrex by leaving the whole set out. They are then filtered over
time with the default transitions (two steps a window), once for each choice. Prints, for MotionSense less its
standing, recall and log loss, and for the others the mean probability of walking, which is all that they do.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from pdr_filter.context.train import PLANS, LabelledWindows, fit, labelled_windows
from pdr_filter.features.windows import FEATURE_SETS
from pdr_filter.imm import update_mode_prob
from pdr_filter.recipes import context_transitions
from pdr_filter.types import CONTEXTS, BoolArray, FloatArray
from pdr_filter.weighting import context_log_evidence

PLAN = PLANS[0]
FLOOR = 0.01


def unseen_prob(windows: LabelledWindows) -> tuple[FloatArray, FloatArray]:
    """Probabilities (W, 6) of people not in training, and the training prior (W, 6) that goes with each."""
    names = FEATURE_SETS[PLAN.feature_set]
    features = windows.features[:, [names.index(n) for n in PLAN.feature_names]]
    train = np.isin(windows.dataset, PLAN.datasets) & windows.has_gyroscope
    prob, prior = np.zeros((len(features), len(CONTEXTS))), np.zeros((len(features), len(CONTEXTS)))
    people = [windows.person == p for p in np.unique(windows.person[windows.dataset == "motionsense"])]
    for test in [*people, windows.dataset == "ubicomp13", windows.dataset == "tyrex"]:
        rest = train & ~test
        y = windows.context[rest]
        fitted = fit(PLAN.machine_fit, CONTEXTS, features[rest], y, windows.person[rest], np.ones(len(y)))
        prob[test] = fitted.prob(features[test])
        prior[test] = [np.mean(windows.context[rest] == c) for c in CONTEXTS]
    return prob, prior


def filtered(
    prob: FloatArray, prior: FloatArray, new_walk: BoolArray, exponent: float, prior_exponent: float
) -> FloatArray:
    """Mode probabilities (W, 6) after each window, starting even in every recording."""
    transition = np.linalg.matrix_power(context_transitions(), 2)
    result, mode_prob = np.zeros_like(prob), np.full(len(CONTEXTS), 1 / len(CONTEXTS))
    for i in range(len(prob)):
        if new_walk[i]:
            mode_prob = np.full(len(CONTEXTS), 1 / len(CONTEXTS))
        evidence = context_log_evidence(prob[i], prior[i], exponent, FLOOR, prior_exponent)
        mode_prob = update_mode_prob(mode_prob @ transition, evidence)
        result[i] = mode_prob
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "data")
    data = parser.parse_args().data
    names = {*PLAN.datasets, "ubicomp13"}
    paths = [p for d in sorted(names) for p in sorted((data / d).glob("*.zip"))]
    windows = labelled_windows(paths, feature_set=PLAN.feature_set)
    prob, prior = unseen_prob(windows)
    truth = np.array([CONTEXTS.index(c) for c in windows.context])
    new_walk = np.concatenate([[True], windows.recording[1:] != windows.recording[:-1]])
    scored = (windows.dataset == "motionsense") & (windows.context != "stationary")
    walks = {
        "ubicomp13 pocket": (windows.dataset == "ubicomp13") & (windows.carrying_mode == "pocket"),
        "ubicomp13 hand": (windows.dataset == "ubicomp13") & (windows.carrying_mode == "texting"),
        "tyrex walking": (windows.dataset == "tyrex") & (windows.context == "walking"),
    }
    for prior_exponent in (0.0, 0.25, 0.5, 1.0):
        for exponent in (0.25, 0.5, 1.0):
            result = filtered(prob, prior, new_walk, exponent, prior_exponent)
            of_truth = result[scored, truth[scored]]
            recall = {
                CONTEXTS[c]: round(float((result[scored & (truth == c)].argmax(axis=1) == c).mean()), 2)
                for c in np.unique(truth[scored])
            }
            log_loss = -np.log(np.maximum(of_truth, 1e-6)).mean()
            walking = ", ".join(f"{name} {result[use, 1].mean():.2f}" for name, use in walks.items())
            choice = f"prior {prior_exponent}, tempering {exponent}"
            print(f"{choice}: log loss {log_loss:.3f}, recall {recall}; p(walking): {walking}")


if __name__ == "__main__":
    main()
