# ruff: noqa: N803 - the letters of the equations
"""Speed of the IMM against filterpy's IMMEstimator in the same run: 6 modes, 4 states, a fix of the position each step.

usage: .venv/bin/python tests/benchmarks/imm_speed.py [--pedestrians 10000]

One cycle is mix, predict, update, mode probabilities, combine. Both filter the same numbers; the largest difference of
the estimates is printed, so that nobody compares a fast wrong answer with a slow right one.
"""

from __future__ import annotations

import argparse
import os
import time
import tracemalloc
from collections.abc import Callable

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from filterpy.kalman import IMMEstimator, KalmanFilter

from pdr_filter import imm_compiled
from pdr_filter.filter import imm

N_MODES, N_STATES = 6, 4
GROUP = 500
MANY_STEPS = 100
H = np.eye(2, N_STATES)
R = np.array([[4.0, 0.5], [0.5, 3.0]])
M = np.full((N_MODES, N_MODES), 0.02) + 0.88 * np.eye(N_MODES)
F = np.tile(np.eye(N_STATES), (N_MODES, 1, 1))
F[:, 0, 2], F[:, 1, 3] = 0.3, np.linspace(0.2, 0.8, N_MODES)
Q = np.stack([np.diag([0.01, 0.01, 1e-4, 1e-5]) * 2.0**k for k in range(N_MODES)])
PRIOR = np.full(N_MODES, 1 / N_MODES)


def start(n: int | None = None) -> tuple[np.ndarray, ...]:
    """Means, covariances, mode probabilities of one pedestrian or of n."""
    batch = () if n is None else (n, 1, 1)
    mean, cov = np.zeros((N_MODES, N_STATES)), np.tile(np.eye(N_STATES), (N_MODES, 1, 1))
    if not batch:
        return mean, cov, PRIOR
    return np.tile(mean, batch), np.tile(cov, (n, 1, 1, 1)), np.tile(PRIOR, (n, 1))


def cycle(mean: np.ndarray, cov: np.ndarray, prob: np.ndarray, z: np.ndarray, R_: np.ndarray) -> tuple[np.ndarray, ...]:
    """One step with its fix; the last is the combined mean."""
    mean, cov, prob = imm.mix(mean, cov, prob, M)
    mean, cov = imm.predict(mean, cov, F, Q)
    mean, cov, log_likelihood, _ = imm.update(mean, cov, z, H, R_)
    prob = imm.update_mode_prob(prob, log_likelihood)
    return mean, cov, prob, imm.combine(mean, cov, prob)[0]


def of_filterpy() -> IMMEstimator:
    """The same problem on filterpy's classes."""
    filters = []
    for k in range(N_MODES):
        kalman = KalmanFilter(dim_x=N_STATES, dim_z=2)
        kalman.x, kalman.P = np.zeros(N_STATES), np.eye(N_STATES)
        kalman.F, kalman.Q, kalman.H, kalman.R = F[k], Q[k], H, R
        filters.append(kalman)
    return IMMEstimator(filters, PRIOR.copy(), M)


def fastest_s(run: Callable[[np.ndarray], object], fixes: np.ndarray) -> float:
    """Time of the fastest step, the one that other work on the machine disturbed least."""
    costs = []
    for z in fixes:
        begin = time.perf_counter()
        run(z)
        costs.append(time.perf_counter() - begin)
    return min(costs)


class Numpy:
    """All pedestrians by `imm`, in groups that fit into the cache of a core; one pedestrian without a leading axis."""

    def __init__(self, n: int | None) -> None:
        sizes = [None] if n is None else [len(g) for g in np.array_split(np.arange(n), max(n // GROUP, 1))]
        self.groups = [start(size) for size in sizes]

    def step(self, z: np.ndarray) -> np.ndarray:
        """Combined mean of the last pedestrian."""
        x = np.zeros(N_STATES)
        for k, (mean, cov, prob) in enumerate(self.groups):
            batch = prob.shape[:-1]
            each = (np.broadcast_to(z, (*batch, 2)), np.broadcast_to(R, (*batch, 2, 2))) if batch else (z, R)
            *state, x = cycle(mean, cov, prob, *each)
            self.groups[k] = tuple(state)
        return np.atleast_2d(x)[-1]


class Compiled:
    """The same by `imm_compiled.cycle`; every pedestrian has a fix and a covariance of its own."""

    def __init__(self, n: int | None, n_threads: int = 1) -> None:
        self.state, self.n_threads = start(n), n_threads
        self.R = R if n is None else np.tile(R, (n, 1, 1))

    def step(self, z: np.ndarray) -> np.ndarray:
        """Combined mean of the last pedestrian."""
        z_ = z if self.R is R else np.tile(z, (len(self.R), 1))
        found = imm_compiled.cycle(*self.state, M, F, Q, z_, H, self.R, n_threads=self.n_threads)
        self.state = found[:3]
        return np.atleast_2d(found.combined_mean)[-1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pedestrians", type=int, default=10_000)
    n = parser.parse_args().pedestrians
    fixes = np.cumsum(np.random.default_rng(0).normal(size=(300, 2)), axis=0)

    oracle, mean_of_oracle = of_filterpy(), []

    def filterpy_step(z: np.ndarray) -> None:
        oracle.predict()
        oracle.update(z)
        mean_of_oracle.append(oracle.x.copy())

    filterpy_s = fastest_s(filterpy_step, fixes)
    begin = time.perf_counter()
    Compiled(None).step(fixes[0])
    first_call_s = time.perf_counter() - begin

    print(f"fastest step of each; one pedestrian: {len(fixes)} steps, {n} at once: {MANY_STEPS} steps")
    print(f"{'':44s}{'a pedestrian':>14s}{'faster':>10s}{'apart':>9s}{'memory each':>13s}")
    print(f"{'filterpy IMMEstimator':44s}{1e6 * filterpy_s:11.2f} us{1:9d}x")
    for name, filters, size in (
        ("imm, one pedestrian", Numpy(None), 1),
        ("imm_compiled.cycle, one pedestrian", Compiled(None), 1),
        (f"imm, {n} in groups of {GROUP}", Numpy(n), n),
        (f"imm_compiled.cycle, {n}, 1 thread", Compiled(n), n),
        (f"imm_compiled.cycle, {n}, 2 threads", Compiled(n, 2), n),
    ):
        found: list[np.ndarray] = []
        steps = fixes if size == 1 else fixes[:MANY_STEPS]
        each_s = fastest_s(lambda z, f=filters, into=found: into.append(f.step(z)), steps) / size
        apart = np.abs(np.array(found) - np.array(mean_of_oracle[: len(steps)])).max()
        tracemalloc.start()
        filters.step(fixes[0])
        together = min(size, GROUP) if isinstance(filters, Numpy) else size
        used = tracemalloc.get_traced_memory()[1] / together
        tracemalloc.stop()
        print(f"{name:44s}{1e6 * each_s:11.2f} us{filterpy_s / each_s:9.0f}x{apart:9.0e}{used:11.0f} B")
    state = sum(array.nbytes for array in start())
    print(
        f"state between two steps: {state} bytes a pedestrian; memory: the most that a step takes besides, its results"
    )
    print(f"and arguments included. First call of imm_compiled.cycle in this process: {first_call_s:.1f} s")


if __name__ == "__main__":
    main()
