# ruff: noqa: N806  (X as in scikit-learn)
"""How fast the relevance vector machine trains and predicts, and how good its probabilities are.

usage: python -m tests.benchmarks.rvm_speed

One core: BLAS threads are set to one. Problems are `sklearn.datasets.make_classification` with six classes; other rows
than those of the training (1200 for fastrvm) are scored. fastrvm, if it can be imported, is timed on the first problem.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from sklearn.datasets import make_classification
from sklearn.metrics import log_loss

import pdr_filter as pdr
from pdr_filter.classifiers.rvm import median_distance
from tests.benchmarks.common import Tables, run

Problem = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def six_classes(n_train: int, n_test: int, n_features: int, n_clusters: int, n_informative: int = 10) -> Problem:
    """Training rows and labels, test rows and labels, of `make_classification` with random_state 0."""
    X, y = make_classification(
        n_train + n_test,
        n_features,
        n_informative=n_informative,
        n_classes=6,
        n_clusters_per_class=n_clusters,
        random_state=0,
    )
    return X[:n_train], y[:n_train], X[n_train:], y[n_train:]


def measure(classifier: Any, problem: Problem, repeats: int = 1) -> tuple[float, float, float]:
    """Best training time in seconds, accuracy, log loss in nats."""
    X, y, X_test, y_test = problem
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        classifier.fit(X, y)
        best = min(best, time.perf_counter() - start)
    p = classifier.predict_proba(X_test)
    return best, float(np.mean(classifier.classes_[p.argmax(axis=1)] == y_test)), float(log_loss(y_test, p))


def fastrvm(tables: Tables, arguments: argparse.Namespace) -> None:
    try:
        from fastrvm import RVC  # type: ignore[import-not-found]
    except ImportError:
        print("fastrvm cannot be imported: no comparison.")
        return
    problem = six_classes(800, 1200, 20, 1)
    width = median_distance(np.unique(problem[0], axis=0))
    found = {
        "pdr_filter": measure(pdr.RelevanceVectorClassifier(kernel_width=width), problem, 2),
        "fastrvm": measure(RVC(kernel="rbf", gamma=0.5 / width**2, fit_intercept=True), problem),
        'fastrvm, its defaults (gamma="scale")': measure(RVC(), problem),
    }
    rows = [[name, f"{s:.2f} s", f"{right:.3f}", f"{loss:.3f}"] for name, (s, right, loss) in found.items()]
    columns = ["800 x 20, one cluster a class, same kernel", "training", "accuracy", "log loss"]
    tables.write("rvm_fastrvm", columns, rows, "One core, wall-clock time.")


if __name__ == "__main__":
    run(__doc__, fastrvm)
