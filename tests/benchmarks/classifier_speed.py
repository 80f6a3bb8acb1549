# ruff: noqa: N803, N806  (X as in scikit-learn)
"""What the probabilities of one row cost, beside scikit-learn's `predict_proba` for the same row.

usage: python -m tests.benchmarks.classifier_speed

One core: BLAS threads are set to one. All classifiers learn 6 classes from rows of 18 features, of
`sklearn.datasets.make_classification`; other rows are classified one at a time. A time is the mean of these rows, and
the smallest of many repeats. Forest and softmax regression give the probabilities of scikit-learn, and the largest
difference is printed. scikit-learn has no relevance vector machine: its Gaussian process, with a kernel as wide, is the
nearest to it.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
from sklearn.ensemble import RandomForestClassifier
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessClassifier
from sklearn.gaussian_process.kernels import RBF
from sklearn.linear_model import LogisticRegression
from threadpoolctl import threadpool_limits

from pdr_filter.classifiers.forest import Forest
from pdr_filter.classifiers.kernel_machine import RelevanceVectors
from pdr_filter.classifiers.rvm import RelevanceVectorClassifier
from pdr_filter.classifiers.softmax import SoftmaxRegression
from tests.benchmarks.common import Tables, options
from tests.benchmarks.rvm_speed import six_classes

Machine = Forest | RelevanceVectors | SoftmaxRegression


def seconds_a_row(classifier: Any, rows: np.ndarray, repeats: int) -> float:
    """Least mean time of `predict_proba`, one row at a time."""
    cost: list[float] = []
    for _ in range(repeats):
        start = time.perf_counter()
        for row in rows:
            classifier.predict_proba(row[None])
        cost.append((time.perf_counter() - start) / len(rows))
    return min(cost)


def compare(name: str, machine: Machine, theirs: Any, rows: np.ndarray, same_model: bool = True) -> list[str]:
    """The row of one machine and of the scikit-learn classifier."""
    ours_s, theirs_s = seconds_a_row(machine, rows, 50), seconds_a_row(theirs, rows[:20], 5)
    difference = f"{np.abs(machine.predict_proba(rows) - theirs.predict_proba(rows)).max():.0e}" if same_model else ""
    cells = [f"{1e6 * ours_s:.0f}", type(theirs).__name__, f"{1e6 * theirs_s:.0f}", f"{theirs_s / ours_s:.1f}"]
    return [name, *cells, difference]


def forests(X: np.ndarray, y: np.ndarray, rows: np.ndarray) -> Iterator[list[str]]:
    for name, settings in (("unlimited depth", {}), ("20 rows a leaf or more", {"min_samples_leaf": 20})):
        theirs = RandomForestClassifier(200, random_state=0, **settings).fit(X, y)
        depth = max(tree.get_depth() for tree in theirs.estimators_)
        yield compare(f"forest, 200 trees, {name} ({depth} levels)", Forest.from_sklearn(theirs), theirs, rows)


def relevance_vectors(X: np.ndarray, y: np.ndarray, rows: np.ndarray) -> Iterator[list[str]]:
    for form in ("one_against_all", "multinomial"):
        machine = RelevanceVectorClassifier(multi_class=form).fit(X, y).machine_
        theirs = GaussianProcessClassifier(RBF(machine.width), optimizer=None).fit(X, y)
        name = f"relevance vector machine, {form}, {len(machine.vectors)} vectors"
        yield compare(name, machine, theirs, rows, same_model=False)


def softmax(X: np.ndarray, y: np.ndarray, rows: np.ndarray) -> Iterator[list[str]]:
    theirs = LogisticRegression().fit(X, y)
    yield compare("softmax regression", SoftmaxRegression(theirs.coef_, theirs.intercept_), theirs, rows)


def main() -> None:
    args = options(__doc__).parse_args()
    warnings.simplefilter("ignore", ConvergenceWarning)
    X, y, X_test, _ = six_classes(3600, 1200, 18, 2)
    rows = X_test[:200]
    with threadpool_limits(limits=1):
        found = [*forests(X, y, rows), *softmax(X, y, rows)]
        found += relevance_vectors(X[:800], y[:800], rows)  # a Gaussian process keeps all its rows
    columns = ["machine", "one row µs", "scikit-learn", "its one row µs", "times faster", "difference"]
    Tables.of(__spec__.name, args).write("classifier_speed", columns, found)


if __name__ == "__main__":
    main()
