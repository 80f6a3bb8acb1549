"""Carrying modes on a data set that no model is trained on, by the placement of the phone.

usage: python -m tests.benchmarks.carrying_mode [--data ../shared/data] [--models FOLDER]

Classes of the windows of ubicomp13 inside the walk interval. There is no bag among the classes, and how the hand that
does not use the phone moves is not published. The shipped models, or those of the folder.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

import pdr_filter as pdr
from models.training.carrying_training import FEATURE_NAMES, MODES, PLANS, RawSignals, features_of
from pdr_filter.classifiers.context_model import ContextModel, load_model
from pdr_filter.sensing.features import invariant
from pdr_filter.sensing.features.feature_windows import FeatureWindows
from pdr_filter.sensing.front_end import feature_windows
from tests.benchmarks.common import ROOT, Tables, recordings, run


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
    """Carrying modes by placement, with the models of both plans."""
    rows = []
    for plan in PLANS:
        rows += placements(arguments.data, load_model(arguments.models / f"{plan.name}.npz"), plan.has_gyroscope)
    columns = ["model", "placement", "windows", *(f"{m} %" for m in MODES), "unknown"]
    tables.write("carrying_mode_placements", columns, rows, "Classes of the windows of ubicomp13.")


if __name__ == "__main__":
    run(__doc__, modes, models=ROOT / "models")
