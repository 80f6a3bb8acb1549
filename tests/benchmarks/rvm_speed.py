"""How fast the relevance vector machine trains and predicts, and how good its probabilities are.

usage: python -m tests.benchmarks.rvm_speed

One core: BLAS threads are set to one. The problem is `sklearn.datasets.make_classification` with six classes; 1200
other rows than those of the training are scored. Needs fastrvm.
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

N_TRAINED, N_TESTED, N_FEATURES = 800, 1200, 20
X, Y = make_classification(
    N_TRAINED + N_TESTED, N_FEATURES, n_informative=10, n_classes=6, n_clusters_per_class=1, random_state=0
)


def measure(classifier: Any, repeats: int = 1) -> tuple[float, float, float]:
    """Best training time in seconds, accuracy, log loss in nats."""
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        classifier.fit(X[:N_TRAINED], Y[:N_TRAINED])
        best = min(best, time.perf_counter() - start)
    p, y = classifier.predict_proba(X[N_TRAINED:]), Y[N_TRAINED:]
    return best, float(np.mean(classifier.classes_[p.argmax(axis=1)] == y)), float(log_loss(y, p))


def fastrvm(tables: Tables, arguments: argparse.Namespace) -> None:
    try:
        from fastrvm import RVC  # type: ignore[import-not-found]
    except ImportError:
        print("fastrvm cannot be imported: no comparison.")
        return
    width = median_distance(np.unique(X[:N_TRAINED], axis=0))
    found = {
        "pdr_filter": measure(pdr.RelevanceVectorClassifier(kernel_width=width), 2),
        "fastrvm": measure(RVC(kernel="rbf", gamma=0.5 / width**2, fit_intercept=True)),
        'fastrvm, its defaults (gamma="scale")': measure(RVC()),
    }
    rows = [[name, f"{s:.2f} s", f"{right:.3f}", f"{loss:.3f}"] for name, (s, right, loss) in found.items()]
    columns = ["800 x 20, one cluster a class, same kernel", "training", "accuracy", "log loss"]
    tables.write("rvm_fastrvm", columns, rows, "One core, wall-clock time.")


if __name__ == "__main__":
    run(__doc__, fastrvm)
