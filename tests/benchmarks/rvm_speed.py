# ruff: noqa: N806  (X as in scikit-learn)
"""How fast the relevance vector machine trains and predicts, and how good its probabilities are. Prints Markdown.

usage: .venv/bin/python tests/benchmarks/rvm_speed.py [--quick] [--widths]

One core: BLAS threads are set to one. Problems are `sklearn.datasets.make_classification`; rows not trained on are
scored. If the package fastrvm can be imported, it is timed on the first problem.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from typing import Any

import numpy as np
from sklearn.datasets import load_breast_cancer, load_digits, load_wine, make_blobs, make_classification, make_moons
from sklearn.exceptions import ConvergenceWarning
from sklearn.metrics import log_loss
from sklearn.preprocessing import StandardScaler
from threadpoolctl import threadpool_limits

import pdr_filter as pdr
from pdr_filter.classifiers.rvm import median_distance

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


def print_row(*cells: object) -> None:
    print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


def training() -> None:
    problems = {
        "800 x 20, one cluster a class": (six_classes(800, 1200, 20, 1), "1 s, 0.88, 0.40"),
        "800 x 20, two clusters a class": (six_classes(800, 1200, 20, 2), "3 s, 0.66, 1.00"),
        "3600 x 18, 15 informative, one cluster": (six_classes(3600, 1200, 18, 1, 15), "8 s, 0.94"),
    }
    print_row("problem, 6 classes", "form", "training", "accuracy", "log loss", "passes", "vectors a class", "target")
    print_row(*["---"] * 8)
    for name, (problem, target) in problems.items():
        for form in ("one_against_all", "multinomial"):
            classifier = pdr.RelevanceVectorClassifier(multi_class=form)
            seconds, accuracy, loss = measure(classifier, problem, 2)
            size = (classifier.machine_.weights != 0).sum(axis=1)
            cells = f"{seconds:.2f} s", f"{accuracy:.3f}", f"{loss:.3f}", classifier.n_iter_, f"{size.mean():.0f}"
            print_row(name, form, *cells, target)


def scaling(largest: int) -> None:
    print()
    print_row("rows", "candidates", "training", "accuracy", "log loss", "passes")
    print_row(*["---"] * 6)
    for n in (1000, 2000, 5000, 10_000, 20_000, 50_000):
        for candidates in (300, 1000):
            if n <= largest:
                classifier = pdr.RelevanceVectorClassifier(max_samples=candidates)
                seconds, accuracy, loss = measure(classifier, six_classes(n, 1200, 20, 1))
                cells = f"{seconds:.1f} s", f"{accuracy:.3f}", f"{loss:.3f}", classifier.n_iter_
                print_row(n, candidates, *cells)


def against_fastrvm() -> None:
    print()
    try:
        from fastrvm import RVC  # type: ignore[import-not-found]
    except ImportError:
        print("fastrvm cannot be imported: no comparison.")
        return
    problem = six_classes(800, 1200, 20, 1)
    width = median_distance(np.unique(problem[0], axis=0))
    print_row("800 x 20, one cluster a class, same kernel", "training", "accuracy", "log loss")
    print_row(*["---"] * 4)
    ours = measure(pdr.RelevanceVectorClassifier(kernel_width=width), problem, 2)
    print_row("pdr_filter", f"{ours[0]:.2f} s", f"{ours[1]:.3f}", f"{ours[2]:.3f}")
    theirs = measure(RVC(kernel="rbf", gamma=0.5 / width**2, fit_intercept=True), problem)
    print_row("fastrvm", f"{theirs[0]:.2f} s", f"{theirs[1]:.3f}", f"{theirs[2]:.3f}")
    default = measure(RVC(), problem)
    print_row('fastrvm, its defaults (gamma="scale")', f"{default[0]:.2f} s", f"{default[1]:.3f}", f"{default[2]:.3f}")
    print(f"\n{theirs[0] / ours[0]:.0f} times faster than fastrvm with the same kernel.")


def one_row() -> None:
    print()
    print_row("machine", "relevance vectors", "largest machine", "one row")
    print_row(*["---"] * 4)
    for n_clusters in (1, 2):
        for form in ("one_against_all", "multinomial"):
            X, y, X_test, _ = six_classes(800, 1200, 20, n_clusters)
            machine = pdr.RelevanceVectorClassifier(multi_class=form).fit(X, y).machine_
            cost: list[float] = []
            for _ in range(20):
                start = time.perf_counter()
                for row in X_test[:200]:
                    machine.predict_proba(row[None])
                cost.append((time.perf_counter() - start) / 200)
            cells = len(machine.vectors), machine.weights.shape[1], f"{1e6 * min(cost):.0f} us"
            print_row(f"6 classes x {n_clusters} clusters, {form}", *cells)


def widths() -> None:
    """Print the mean log loss over 22 problems as a function of kernel width over median distance."""
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
    table = np.array(losses)
    regret = table - table.min(axis=1, keepdims=True)
    print()
    print_row("width / median distance", *shares)
    print_row(*["---"] * (len(shares) + 1))
    print_row("mean log loss", *(f"{v:.3f}" for v in table.mean(axis=0)))
    print_row("worst loss against the best width", *(f"{v:.3f}" for v in regret.max(axis=0)))


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
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="up to 5000 rows, without fastrvm")
    parser.add_argument("--widths", action="store_true", help="also the comparison of kernel widths")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", ConvergenceWarning)
    with threadpool_limits(limits=1):
        training()
        one_row()
        if arguments.widths:
            widths()
        if not arguments.quick:
            against_fastrvm()
        scaling(5000 if arguments.quick else 50_000)


if __name__ == "__main__":
    main()
