"""Carrying modes against truth: people and sites left out, and a data set that no model is trained on.

usage: python -m tests.benchmarks.carrying_mode [--data ../shared/data] [--models FOLDER]

Left out: recall of each carrying mode, window by window and followed through the recording, on windows of moving people
that the machine has not seen, nor anything made of them (motionsense: one of twelve people at a time; else the whole
site, which is one person or, ms_indoor, unknown surveyors). ubicomp13: what the windows inside the walk interval are
taken for, by placement; there is no bag among the classes, and how the hand that does not use the phone moves is not
published. The shipped models, or those of the folder.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import pdr_filter as pdr
from models.training.carrying_training import FEATURE_NAMES, MODES, PLANS, RawSignals, features_of
from pdr_filter.classifiers.context_model import ContextModel, load_model
from pdr_filter.sensing.features import invariant
from pdr_filter.sensing.features.feature_windows import FeatureWindows
from pdr_filter.sensing.front_end import feature_windows
from tests.benchmarks.common import ROOT, Tables, recordings, run


def left_out(card: dict[str, Any]) -> list[list[str]]:
    """One row for each site: recall and number of windows of each mode, and how good the probabilities are."""
    result = []
    rows = {"motionsense, one person": card["leave_one_subject_out"], **card["site_left_out"]}
    for name, scores in rows.items():
        recall = [
            f"{scores['recall'][m]:.3f}, {scores['followed_recall'][m]:.3f} ({scores['n'][m]})"
            if m in scores["n"]
            else "-"
            for m in MODES
        ]
        numbers = [scores[key] for key in ("worst_person_accuracy", "log_loss", "expected_calibration_error")]
        result.append([card["name"], name, *recall, *(f"{x:.3f}" for x in numbers)])
    return result


def features_while_walking(recording: pdr.Recording) -> np.ndarray:
    """Features (W, F) of the windows inside the walk interval."""
    walk = recording.truth.segments[0]
    stage = FeatureWindows(features=RawSignals())
    windows = [
        window.features.reshape(len(invariant.SIGNALS), -1)
        for window in feature_windows(stage, [pdr.merge_streams(recording)])
        if walk["start_s"] <= window.time_s - stage.window_s and window.time_s <= walk["end_s"]
    ]
    return features_of(np.array(windows))


def placements(data: Path, model: ContextModel, has_gyroscope: bool) -> list[list[str]]:
    """What windows of each placement are taken for, in per cent, and the mean share that the model calls unknown."""
    columns = [FEATURE_NAMES.index(name) for name in model.feature_names]
    prob: dict[str, list[np.ndarray]] = defaultdict(list)
    unknown: dict[str, list[float]] = defaultdict(list)
    for recording in recordings(data, "ubicomp13"):
        recording = recording if has_gyroscope else replace(recording, gyroscope=None)
        placement = recording.name.split("_", 3)[3]
        for features in features_while_walking(recording):
            of_window, share, *_ = model.assess(features[columns])
            prob[placement].append(of_window)
            unknown[placement].append(share)
    rows = []
    for placement in sorted(prob):
        taken = np.array(model.labels)[np.array(prob[placement]).argmax(axis=1)]
        shares = [f"{100 * np.mean(taken == m):.1f}" for m in MODES]
        rows.append([model.name, placement, str(len(taken)), *shares, f"{np.mean(unknown[placement]):.3f}"])
    return rows


def modes(tables: Tables, arguments: argparse.Namespace) -> None:
    """Both tables."""
    recalls, places = [], []
    for plan in PLANS:
        model = load_model(arguments.models / f"{plan.name}.npz")
        recalls += left_out(model.card)
        places += placements(arguments.data, model, plan.has_gyroscope)
    columns = ["model", "held out", *MODES, "worst person", "log loss", "calibration error"]
    about = "Recall of each window, recall as followed through the recording (windows)."
    tables.write("carrying_mode", columns, recalls, about)
    columns = ["model", "placement", "windows", *(f"{m} %" for m in MODES), "unknown"]
    tables.write("carrying_mode_placements", columns, places, "Classes of the windows of ubicomp13.")


if __name__ == "__main__":
    run(__doc__, modes, models=ROOT / "models")
