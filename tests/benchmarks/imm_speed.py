# ruff: noqa: N803 - the letters of the equations
"""Speed of the IMM against filterpy's IMMEstimator in the same run: 6 modes, 4 states, a fix of the position each step.

usage: python -m tests.benchmarks.imm_speed [--pedestrians 10000]

One cycle is mix, predict, update, mode probabilities, combine. Both filter the same numbers; the largest difference of
the estimates is printed, so that nobody compares a fast wrong answer with a slow right one.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from filterpy.kalman import IMMEstimator, KalmanFilter

from pdr_filter.filter.imm import imm
from tests.benchmarks.common import Tables, options

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


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--pedestrians", type=int, default=10_000)
    args = parser.parse_args()
    n = args.pedestrians
    fixes = np.cumsum(np.random.default_rng(0).normal(size=(300, 2)), axis=0)

    oracle, mean_of_oracle = of_filterpy(), []

    def filterpy_step(z: np.ndarray) -> None:
        oracle.predict()
        oracle.update(z)
        mean_of_oracle.append(oracle.x.copy())

    filterpy_s = fastest_s(filterpy_step, fixes)
    rows = [["filterpy, IMMEstimator", f"{1e6 * filterpy_s:.1f}", 1, "-"]]
    for name, filters, size in (
        ("`pdr_filter.filter.imm.imm`, one pedestrian", Numpy(None), 1),
        (f"`pdr_filter.filter.imm.imm`, {n} in groups of {GROUP}", Numpy(n), n),
    ):
        found: list[np.ndarray] = []
        steps = fixes if size == 1 else fixes[:MANY_STEPS]
        each_s = fastest_s(lambda z, f=filters, into=found: into.append(f.update(z)), steps) / size
        apart = np.abs(np.array(found) - np.array(mean_of_oracle[: len(steps)])).max()
        rows.append([name, f"{1e6 * each_s:.1f}", f"{filterpy_s / each_s:.0f}", f"{apart:.0e}"])
    columns = ["filter", "µs a step and pedestrian", "times as fast", "largest difference"]
    Tables.of(__spec__.name, args).write("imm_speed", columns, rows, "6 modes, 4 states, a position fix each step.")


if __name__ == "__main__":
    main()
