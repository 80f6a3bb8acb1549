# ruff: noqa: N806  (X as in scikit-learn)
"""How fast the relevance vector machine trains and predicts, and how good its probabilities are.

usage: python -m tests.benchmarks.rvm_speed [training] [scaling] [fastrvm] [widths]

One core: BLAS threads are set to one. Problems are `sklearn.datasets.make_classification`; rows not trained on are
scored. fastrvm, if it can be imported, is timed on the first problem.
"""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np
from sklearn.datasets import load_breast_cancer, load_digits, load_wine, make_blobs, make_classification, make_moons
from sklearn.exceptions import ConvergenceWarning
from sklearn.metrics import log_loss
from sklearn.preprocessing import StandardScaler
from threadpoolctl import threadpool_limits

import pdr_filter as pdr
from pdr_filter.classifiers.rvm import median_distance
from tests.benchmarks.common import Tables, options

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


def training(tables: Tables) -> None:
    problems = {
        "800 x 20, 10 informative, one cluster a class": six_classes(800, 1200, 20, 1),
        "800 x 20, 10 informative, two clusters a class": six_classes(800, 1200, 20, 2),
        "3600 x 18, 15 informative, one cluster a class": six_classes(3600, 1200, 18, 1, 15),
    }
    rows = []
    for name, problem in problems.items():
        for form in ("one_against_all", "multinomial"):
            classifier = pdr.RelevanceVectorClassifier(multi_class=form)
            seconds, accuracy, loss = measure(classifier, problem, 2)
            machine = classifier.machine_
            size = (machine.weights != 0).sum(axis=1)
            cells = [f"{seconds:.2f} s", f"{accuracy:.3f}", f"{loss:.3f}", classifier.n_iter_, f"{size.mean():.0f}"]
            rows.append([name, form, *cells, f"{1e6 * one_row_s(machine, problem[2]):.0f}"])
    columns = [
        "problem, 6 classes",
        "form",
        "training",
        "accuracy",
        "log loss",
        "passes",
        "vectors a class",
        "one row µs",
    ]
    tables.write("rvm_training", columns, rows, "One core.")


def one_row_s(machine: Any, rows: np.ndarray) -> float:
    """Least mean time of one row."""
    cost: list[float] = []
    for _ in range(20):
        start = time.perf_counter()
        for row in rows[:200]:
            machine.predict_proba(row[None])
        cost.append((time.perf_counter() - start) / 200)
    return min(cost)


def scaling(tables: Tables) -> None:
    rows = []
    for n in (1000, 2000, 5000, 10_000, 20_000, 50_000):
        for candidates in (300, 1000):
            classifier = pdr.RelevanceVectorClassifier(max_samples=candidates)
            seconds, accuracy, loss = measure(classifier, six_classes(n, 1200, 20, 1))
            rows.append([n, candidates, f"{seconds:.1f} s", f"{accuracy:.3f}", f"{loss:.3f}", classifier.n_iter_])
    tables.write("rvm_scaling", ["rows", "candidates", "training", "accuracy", "log loss", "passes"], rows, "One core.")


def against_fastrvm(tables: Tables) -> None:
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


def widths(tables: Tables) -> None:
    """Mean log loss over 22 problems as a function of kernel width over median distance."""
    shares = (0.35, 0.5, 0.7, 0.85, 1.0, 1.4, 2.0, 4.0)
    losses: list[list[float]] = []
    for seed in (0, 1):
        for X, y in _problems(seed):
            n = min(500, len(X) // 2)
            scaler = StandardScaler().fit(X[:n])
            X_train, X_test, y_test = scaler.transform(X[:n]), scaler.transform(X[n : n + 900]), y[n : n + 900]
            median = median_distance(X_train)
            losses.append([])
            for share in shares:
                classifier = pdr.RelevanceVectorClassifier(kernel_width=share * median).fit(X_train, y[:n])
                prob = classifier.predict_proba(X_test)
                losses[-1].append(float(log_loss(y_test, prob, labels=classifier.classes_)))
    found = np.array(losses)
    regret = found - found.min(axis=1, keepdims=True)
    rows = [
        ["mean log loss", *(f"{v:.3f}" for v in found.mean(axis=0))],
        ["worst loss against the best width", *(f"{v:.3f}" for v in regret.max(axis=0))],
    ]
    tables.write("rvm_widths", ["width / median distance", *shares], rows, "22 problems.")


def _problems(seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    problems = [
        make_classification(
            1400,
            n_features,
            n_informative=n_informative,
            n_redundant=2,
            n_classes=4 if n_informative < 5 else 6,
            n_clusters_per_class=n_clusters,
            random_state=seed,
        )
        for n_informative, n_features, n_clusters in (
            (10, 20, 1),
            (10, 20, 2),
            (5, 10, 1),
            (5, 18, 2),
            (15, 18, 1),
            (3, 5, 1),
        )
    ]
    problems.append(make_moons(1400, noise=0.3, random_state=seed))
    problems.append(make_blobs(1400, 3, centers=5, cluster_std=3, random_state=seed))
    for load in (load_digits, load_wine, load_breast_cancer):
        X, y = load(return_X_y=True)
        order = np.random.RandomState(seed).permutation(len(X))
        problems.append((X[order], y[order]))
    return problems


def main() -> None:
    args = options(__doc__, "training", "scaling", "fastrvm", "widths").parse_args()
    tables = Tables.of(__spec__.name, args)
    warnings.simplefilter("ignore", ConvergenceWarning)
    run = {"training": training, "scaling": scaling, "fastrvm": against_fastrvm, "widths": widths}
    with threadpool_limits(limits=1):
        for part in args.parts:
            run[part](tables)


if __name__ == "__main__":
    main()
