"""The IMM for any problem beside filterpy and exact enumeration: agreement, accuracy and time.

usage: python -m tests.benchmarks.imm_alone

A target on one axis stands, moves or accelerates (docs/imm.md). Accuracy: 200 walks of 60 measurements that are drawn
from the model. Exact: 30 walks of 7 measurements, all 2,187 sequences of modes. Time: one filter, 500 measurements, the
fastest of five runs.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from itertools import product

import numpy as np
from filterpy.kalman import IMMEstimator, KalmanFilter

from pdr_filter.imm import JumpMarkovModel
from pdr_filter.values import FloatArray
from tests.benchmarks.common import Tables, run

F = np.array([np.diag([1.0, 0, 0]), [[1, 1, 0], [0, 1, 0], [0, 0, 0]], [[1, 1, 0.5], [0, 1, 1], [0, 0, 1]]])
Q = np.array([np.diag([1e-4, 1e-4, 1e-4]), np.diag([1e-4, 1e-2, 1e-4]), np.diag([1e-4, 1e-2, 0.1])])
H, R = np.array([[1.0, 0.0, 0.0]]), np.array([[0.25]])
TRANSITIONS = np.array([[0.95, 0.04, 0.01], [0.03, 0.94, 0.03], [0.02, 0.08, 0.90]])
START, START_COV = np.zeros(3), np.eye(3)
MODEL = JumpMarkovModel(F, Q, H, R, TRANSITIONS)


def drawn(n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Modes (n,), states (n, 3) and measurements (n, 1) of a walk of the model."""
    mode, x, rows = int(rng.integers(3)), rng.multivariate_normal(START, START_COV), []
    for _ in range(n):
        mode = int(rng.choice(3, p=TRANSITIONS[mode]))
        x = F[mode] @ x + rng.multivariate_normal(np.zeros(3), Q[mode])
        rows.append((mode, x, H @ x + rng.normal(0.0, 0.5, 1)))
    return tuple(np.array(column) for column in zip(*rows, strict=True))  # type: ignore[return-value]


def exact(z: FloatArray) -> FloatArray:
    """Exact filtered mean at the end, (3,), of all sequences of modes."""
    weights, means = [], []
    for path in product(range(3), repeat=len(z)):
        x, cov, log_weight = START, START_COV, np.log((TRANSITIONS.sum(axis=0) / 3)[path[0]])
        for k, (m, each) in enumerate(zip(path, z, strict=True)):
            log_weight += np.log(TRANSITIONS[path[k - 1], m]) if k else 0.0
            x, cov = F[m] @ x, F[m] @ cov @ F[m].T + Q[m]
            s, y = float(cov[0, 0] + R[0, 0]), float(each[0] - x[0])
            log_weight -= 0.5 * (y * y / s + np.log(s))
            x, cov = x + cov[:, 0] * y / s, cov - np.outer(cov[:, 0], cov[0]) / s
        weights.append(log_weight)
        means.append(x)
    weight = np.exp(np.array(weights) - max(weights))
    return weight @ np.array(means) / weight.sum()


def by_filterpy(z: FloatArray) -> FloatArray:
    """Means (T, 3) of filterpy's IMM."""
    filters = []
    for m in range(3):
        kalman = KalmanFilter(3, 1)
        kalman.F, kalman.Q, kalman.H, kalman.R, kalman.P, kalman.x = F[m], Q[m], H, R, START_COV.copy(), START[:, None]
        filters.append(kalman)
    estimator, means = IMMEstimator(filters, np.full(3, 1 / 3), TRANSITIONS), []
    for each in z:
        estimator.predict()
        estimator.update(each[:, None])
        means.append(estimator.x[:, 0].copy())
    return np.array(means)


def fastest_us(of: Callable[[], object], n: int) -> float:
    """Time of the fastest of five runs, microseconds for each of n measurements."""
    times = []
    for _ in range(5):
        begin_s = time.perf_counter()
        of()
        times.append(time.perf_counter() - begin_s)
    return 1e6 * min(times) / n


def imm_alone(tables: Tables, arguments: argparse.Namespace) -> None:
    """One table."""
    del arguments
    rng = np.random.default_rng(0)
    walks = [drawn(60, rng) for _ in range(200)]
    mode, state, z = (np.stack([walk[k] for walk in walks], axis=1) for k in range(3))
    filtered = MODEL.filter(z, START, START_COV)
    found = {"`filter`": filtered, "`smooth`": MODEL.smooth(filtered)}
    peer = np.stack([by_filterpy(walk[2]) for walk in walks], axis=1)
    short = [drawn(7, rng)[2] for _ in range(30)]
    true_m = np.array([exact(each) for each in short])
    ours = np.array([MODEL.filter(each, START, START_COV).mean[-1] for each in short])
    long = drawn(500, rng)[2]
    kept = MODEL.filter(long, START, START_COV)
    many = np.repeat(long[:50, None], 1000, axis=1)
    us = {
        "filterpy": fastest_us(lambda: by_filterpy(long), 500),
        "`filter`": fastest_us(lambda: MODEL.filter(long, START, START_COV), 500),
        "`smooth`": fastest_us(lambda: MODEL.smooth(kept), 500),
        "`filter`, 1,000 at once": fastest_us(lambda: MODEL.filter(many, START, START_COV), 50_000),
    }

    def rmse(mean: FloatArray) -> str:
        return f"{np.sqrt(np.mean((mean - state)[..., 0] ** 2)):.3f}"

    rows = [["filterpy", rmse(peer), "-", "-", f"{us['filterpy']:.0f}"]]
    for name, each in found.items():
        right = f"{100 * np.mean(each.mode_prob.argmax(axis=-1) == mode):.0f}"
        apart = f"{np.abs(each.mean - peer).max():.0e}" if name == "`filter`" else "-"
        rows.append([name, rmse(each.mean), right, apart, f"{us[name]:.0f}"])
    rows.append(["`filter`, 1,000 at once", "", "", "", f"{us['`filter`, 1,000 at once']:.1f}"])
    gap = np.sqrt(np.mean((ours - true_m)[:, 0] ** 2))
    about = (
        f"Root mean square difference of the filter from exact enumeration after 7 measurements: {gap:.3f} m. "
        f"One filter is {us['filterpy'] / us['`filter`']:.1f} times as fast as filterpy."
    )
    columns = " | RMSE of the position, m | right mode % | largest difference to filterpy | us a measurement"
    tables.write("imm_alone", columns, rows, about)


if __name__ == "__main__":
    run(__doc__, imm_alone)
