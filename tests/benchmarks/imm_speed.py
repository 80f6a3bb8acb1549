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

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from filterpy.kalman import IMMEstimator, KalmanFilter

from pdr_filter import imm

N_MODES, N_STATES = 6, 4
GROUP = 500
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pedestrians", type=int, default=10_000)
    n = parser.parse_args().pedestrians
    rng = np.random.default_rng(0)
    fixes = np.cumsum(rng.normal(size=(300, 2)), axis=0)

    oracle, mean_of_oracle = of_filterpy(), []
    begin = time.perf_counter()
    for z in fixes:
        oracle.predict()
        oracle.update(z)
        mean_of_oracle.append(oracle.x.copy())
    filterpy_s = (time.perf_counter() - begin) / len(fixes)

    mean, cov, prob = start()
    found = []
    begin = time.perf_counter()
    for z in fixes:
        mean, cov, prob, x = cycle(mean, cov, prob, z, R)
        found.append(x)
    one_s = (time.perf_counter() - begin) / len(fixes)
    apart = np.abs(np.array(found) - np.array(mean_of_oracle)).max()

    # groups that fit into the cache of a core
    groups = [start(len(group)) for group in np.array_split(np.arange(n), max(n // GROUP, 1))]
    costs, x = [], np.zeros((1, N_STATES))
    for z in fixes[:12]:
        begin = time.perf_counter()
        for k, (mean, cov, prob) in enumerate(groups):
            size = len(mean)
            *state, x = cycle(mean, cov, prob, np.broadcast_to(z, (size, 2)), np.broadcast_to(R, (size, 2, 2)))
            groups[k] = tuple(state)
        costs.append(time.perf_counter() - begin)
    many_s = float(np.median(costs)) / n
    mean, cov, prob = groups[0]
    apart_many = np.abs(x - mean_of_oracle[11]).max()
    state_bytes = (mean.nbytes + cov.nbytes + prob.nbytes) / len(mean)

    print(f"filterpy's IMMEstimator: {1e3 * filterpy_s:.3f} ms a step")
    print(f"one pedestrian: {1e3 * one_s:.3f} ms, {filterpy_s / one_s:.1f} times as fast, at most {apart:.0e} apart")
    print(
        f"{n} pedestrians at once: {1e6 * many_s:.2f} us each, {filterpy_s / many_s:.0f} times as fast, at most "
        f"{apart_many:.0e} apart, {state_bytes:.0f} bytes of state each"
    )


if __name__ == "__main__":
    main()
