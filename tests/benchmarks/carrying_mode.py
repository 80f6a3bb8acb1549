"""Carrying modes against truth: people and sites left out, and a data set that no model is trained on.

usage: .venv/bin/python tests/benchmarks/carrying_mode.py [--data ../shared/data] [--models models]

Left out: recall of each carrying mode, window by window and followed through the recording, on windows of moving people
that the machine has not seen, nor anything made of them (motionsense: one of twelve people at a time; else the whole
site, which is one person or, ms_indoor, unknown surveyors). ubicomp13: what the windows inside the walk interval are
taken for, by placement; there is no bag among the classes, and how the hand that does not use the phone moves is not
published. Without --models both models are trained first, which takes some minutes.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import pdr_filter as pdr
from pdr_filter.classifiers.model import ContextModel, load_model
from pdr_filter.sensing.features import invariant
from pdr_filter.sensing.front_end import feature_windows
from pdr_filter.training.carrying import FEATURE_NAMES, MODES, PLANS, SignalWindows, features_of, train_carrying
from pdr_filter.training.protocol import recordings_of


def left_out(card: dict[str, Any]) -> None:
    """One row for each site: recall and number of windows of each mode, and how good the probabilities are."""
    print(f"| {card['name']}: left out | {' | '.join(MODES)} | worst person | log loss | calibration error |")
    print("|---" * (len(MODES) + 4) + "|")
    rows = {"motionsense, one person": card["leave_one_subject_out"], **card["site_left_out"]}
    for name, scores in rows.items():
        recall = [
            f"{scores['recall'][m]:.3f}, {scores['followed_recall'][m]:.3f} ({scores['n'][m]})"
            if m in scores["n"]
            else "-"
            for m in MODES
        ]
        numbers = [scores[key] for key in ("worst_person_accuracy", "log_loss", "expected_calibration_error")]
        print(f"| {name} | {' | '.join(recall)} | {' | '.join(f'{x:.3f}' for x in numbers)} |")
    print()


def features_while_walking(recording: pdr.Recording) -> np.ndarray:
    """Features (W, F) of the windows inside the walk interval."""
    walk = recording.truth.segments[0]
    stage = SignalWindows("invariant")
    windows = [
        window.features.reshape(len(invariant.SIGNALS), -1)
        for window in feature_windows(stage, [pdr.merge_streams(recording)])
        if walk["start_s"] <= window.time_s - stage.window_s and window.time_s <= walk["end_s"]
    ]
    return features_of(np.array(windows))


def placements(data: Path, model: ContextModel, has_gyroscope: bool) -> None:
    """What windows of each placement are taken for, in per cent, and the mean share that the model calls unknown."""
    columns = [FEATURE_NAMES.index(name) for name in model.feature_names]
    prob: dict[str, list[np.ndarray]] = defaultdict(list)
    unknown: dict[str, list[float]] = defaultdict(list)
    for path in sorted((data / "ubicomp13").glob("*.zip")):
        recording = pdr.read(path)
        recording = recording if has_gyroscope else replace(recording, gyroscope=None)
        placement = path.stem.split("_", 3)[3]
        for features in features_while_walking(recording):
            of_window, share = model.assess(features[columns])
            prob[placement].append(of_window)
            unknown[placement].append(share)
    print(f"| {model.name}: ubicomp13 | windows | {' | '.join(f'{m} %' for m in MODES)} | unknown |")
    print("|---" * (len(MODES) + 3) + "|")
    for placement in sorted(prob):
        taken = np.array(model.labels)[np.array(prob[placement]).argmax(axis=1)]
        shares = " | ".join(f"{100 * np.mean(taken == m):.1f}" for m in MODES)
        print(f"| {placement} | {len(taken)} | {shares} | {np.mean(unknown[placement]):.3f} |")
    print()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "data")
    parser.add_argument("--models", type=Path, help="folder of trained models; trained anew if not given")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.models or Path(temporary)
        if args.models is None:
            datasets = sorted({d for plan in PLANS for d in plan.datasets})
            train_carrying(recordings_of(args.data, datasets), folder)
        models = [load_model(folder / f"{plan.name}.npz") for plan in PLANS]
        for model in models:
            left_out(model.card)
        for plan, model in zip(PLANS, models, strict=True):
            placements(args.data, model, plan.has_gyroscope)


if __name__ == "__main__":
    main()
