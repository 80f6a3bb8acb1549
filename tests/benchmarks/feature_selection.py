"""Accuracy against the number of features: floating selection on MotionSense, as Fig. 10 of Martinelli et al. 2018.

usage: .venv/bin/python tests/benchmarks/feature_selection.py [--data ../shared/data] [--windows 30] [--jobs 2]

The 23 features without magnetometer (MotionSense has none), a linear discriminant, folds of two people each out of 12,
at most so many windows of each person in each context. Prints the curve as a markdown table, and the selected set
beside the paper's 18. The last column of the table is for people whom the search has not seen: it runs once more for
each of three thirds of the people left out.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.model_selection import GroupKFold, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from pdr_filter.papers.martinelli2018.features import NAMES, SELECTED_18, WITHOUT_MAGNETOMETER
from pdr_filter.training.contexts import labelled_windows
from pdr_filter.training.protocol import LabelledWindows, recordings_of
from pdr_filter.values.arrays import FloatArray, IntArray
from tests.studies.feature_selection import Selection, select_features

ESTIMATOR = make_pipeline(StandardScaler(), LinearDiscriminantAnalysis())
COLUMNS = [NAMES.index(n) for n in WITHOUT_MAGNETOMETER]


def thinned(windows: LabelledWindows, n_windows: int) -> IntArray:
    """Rows of at most so many windows of each person in each context, drawn evenly over time."""
    rows: list[int] = []
    for person in np.unique(windows.person):
        for context in np.unique(windows.context):
            of_both = np.flatnonzero((windows.person == person) & (windows.context == context))
            if len(of_both):
                n = min(n_windows, len(of_both))
                rows += of_both[np.linspace(0, len(of_both) - 1, n).round().astype(int)].tolist()
    return np.array(sorted(rows))


def search(features: FloatArray, y: np.ndarray, person: np.ndarray, n_folds: int, n_jobs: int) -> Selection:
    return select_features(
        ESTIMATOR, features, y, groups=person, cv=GroupKFold(n_folds), names=WITHOUT_MAGNETOMETER, n_jobs=n_jobs
    )


def unseen_scores(features: FloatArray, y: np.ndarray, person: np.ndarray, n_jobs: int) -> FloatArray:
    """Accuracy (3, F) on each third of the people, of subsets chosen and fitted on the others."""
    scores = []
    for train, test in GroupKFold(3).split(features, y, person):
        curve = search(features[train], y[train], person[train], 4, n_jobs).curve
        columns = [list(subset.columns) for subset in curve]
        scores.append(
            [ESTIMATOR.fit(features[train][:, c], y[train]).score(features[test][:, c], y[test]) for c in columns]
        )
    return np.array(scores)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "data")
    parser.add_argument("--windows", type=int, default=30, help="of each person in each context")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    start_s = time.perf_counter()
    windows = labelled_windows(recordings_of(arguments.data, ["motionsense"]))
    rows = thinned(windows, arguments.windows)
    features, y, person = windows.features[rows][:, COLUMNS], windows.context[rows], windows.person[rows]
    print(f"{len(rows)} windows of {len(np.unique(person))} people, contexts {sorted(set(y.tolist()))}\n")

    selection = search(features, y, person, 6, arguments.jobs)
    unseen = unseen_scores(features, y, person, arguments.jobs)
    print("| features | accuracy | std over folds | accuracy, unseen people |\n|---:|---:|---:|---:|")
    for subset, of_unseen in zip(selection.curve, unseen.T, strict=True):
        n = len(subset.columns)
        print(f"| {n} | {100 * subset.score:.1f} % | {100 * subset.score_std:.1f} % | {100 * of_unseen.mean():.1f} % |")

    best, paper = selection.best, [n for n in SELECTED_18 if n in WITHOUT_MAGNETOMETER]
    columns = [WITHOUT_MAGNETOMETER.index(n) for n in paper]
    of_paper = cross_val_score(ESTIMATOR, features[:, columns], y, groups=person, cv=GroupKFold(6))
    print(f"\nbest: {len(best.columns)} features, {100 * best.score:.1f} %")
    print(f"the paper's 18 less magnetometer: {len(paper)} features, {100 * of_paper.mean():.1f} %")
    removed = [c.name for c in selection.history if c.action == "remove"]
    print(f"{selection.n_evaluated} subsets scored; removed on the way: {', '.join(removed) or 'nothing'}\n")
    print("| feature | selected | in the paper's 18 |\n|---|---|---|")
    for name in NAMES:
        number = f"F{NAMES.index(name) + 1} {name}"
        selected = "no magnetometer" if name not in WITHOUT_MAGNETOMETER else "x" if name in best.names else ""
        print(f"| {number} | {selected} | {'x' if name in SELECTED_18 else ''} |")
    print(f"\n{time.perf_counter() - start_s:.0f} s")


if __name__ == "__main__":
    main()
