# ruff: noqa: N803 - the letters of the equations
"""filterpy's IMMEstimator and the IMM of this package: 6 modes, 4 states, a fix of the position each step.

One cycle is mix, predict, update, mode probabilities, combine. Both filter the same numbers; the largest difference of
the estimates is in the table, so that nobody compares a fast wrong answer with a slow right one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from filterpy.kalman import IMMEstimator, KalmanFilter

from pdr_filter.filter.imm import imm
from pdr_filter.values import mixtures

from .harness import Table
from .walks import FloatArray

N_STEPS, N_AT_ONCE = 300, 500
N_MODES, N_STATES = 6, 4
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
    prob = mixtures.posterior_prob(prob, log_likelihood)
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


def filters() -> Table:
    """Time of a step, and how far the estimates are from filterpy's."""
    columns = ["filter", "ms a step and pedestrian", "times as fast", "largest difference"]
    fixes = np.cumsum(np.random.default_rng(0).normal(size=(N_STEPS, 2)), axis=0)
    oracle = of_filterpy()

    def theirs(fix: FloatArray) -> FloatArray:
        oracle.predict()
        oracle.update(fix)
        return oracle.x.copy()

    def ours(n: int | None) -> Callable[[FloatArray], FloatArray]:
        state = start(n)
        batch = () if n is None else (n,)
        noise = np.broadcast_to(R, (*batch, 2, 2))

        def step(fix: FloatArray) -> FloatArray:
            nonlocal state
            *state, mean = cycle(*state, np.broadcast_to(fix, (*batch, 2)), noise)
            return mean

        return step

    reference, reference_s = _timed(theirs, fixes)
    rows = [["filterpy, IMMEstimator", f"{1e3 * reference_s:.3f}", "1", "-"]]
    for name, n in (
        ("pdr_filter.filter.imm.imm, one pedestrian", None),
        (f"pdr_filter.filter.imm.imm, {N_AT_ONCE} at once", N_AT_ONCE),
    ):
        mean, step_s = _timed(ours(n), fixes)
        apart = max(np.abs(m - r).max() for m, r in zip(mean, reference, strict=True))
        step_s /= n or 1
        rows.append([name, f"{1e3 * step_s:.4f}", f"{reference_s / step_s:.0f}", f"{apart:.0e}"])
    return columns, rows


def _timed(step: Callable[[FloatArray], FloatArray], fixes: FloatArray) -> tuple[Sequence[FloatArray], float]:
    """Estimates after each fix, and the processor time of one."""
    begin_s = time.process_time()
    found = [step(fix) for fix in fixes]
    return found, (time.process_time() - begin_s) / len(fixes)
