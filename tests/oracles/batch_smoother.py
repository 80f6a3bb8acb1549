"""Smoother of a walk with every step as a state, solved by `scipy.optimize.least_squares`: the reference of `smooth`.

The process is that of the filter. Step k leads from the state (p, o, s) before it to p + e^s R(o) (d + w), and then the
log scale decays to a s + v. The heading offset drifts between the steps. The covariance of w is rotated and scaled by
the estimate, as in a Kalman filter, and repeated until the estimate does not change.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from pdr_filter.offline.smoothing.preintegration import Increments
from pdr_filter.values import PositionFix


def smooth_every_step(
    steps: Increments, start_mean: np.ndarray, start_cov: np.ndarray, fixes: Sequence[tuple[int, PositionFix]]
) -> np.ndarray:
    """Return the states (K + 1, 4) before the first and after each step, given fixes after numbers of steps."""
    n = len(steps)
    whiten_start = np.linalg.inv(np.linalg.cholesky(start_cov))
    whiten_steps = np.linalg.inv(np.linalg.cholesky(steps.cov_m2))
    drift_std = np.sqrt(steps.drift_var_rad2 + steps.unknown_var_rad2 + steps.jump_var_rad2)
    scale_std = np.sqrt(steps.scale_drift_var)

    def turned(state: np.ndarray, vector: np.ndarray) -> np.ndarray:
        c, s = np.exp(state[:, 3]) * np.cos(state[:, 2]), np.exp(state[:, 3]) * np.sin(state[:, 2])
        return np.column_stack([c * vector[:, 0] + s * vector[:, 1], -s * vector[:, 0] + c * vector[:, 1]])

    def residuals(values: np.ndarray, about: np.ndarray) -> np.ndarray:
        x = values.reshape(n + 1, 4)
        error = x[1:, :2] - x[:-1, :2] - turned(x[:-1], steps.displacement_m)
        back = np.column_stack([about[:-1, :2], -about[:-1, 2], -about[:-1, 3]])
        moved = np.einsum("kab,kb->ka", whiten_steps, turned(back, error))
        parts = [
            whiten_start @ (x[0] - start_mean),
            moved.ravel(),
            (x[1:-1, 2] - x[:-2, 2]) / drift_std[1:],
            np.atleast_1d(1e6 * (x[-1, 2] - x[-2, 2])),
            (x[1:, 3] - steps.scale_memory * x[:-1, 3]) / scale_std,
        ]
        for k, fix in fixes:
            parts.append(np.linalg.inv(np.linalg.cholesky(fix.cov_m2)) @ (x[k, :2] - fix.position_m))
        return np.concatenate(parts)

    state = np.zeros((n + 1, 4))
    state[:, :2] = start_mean[:2] + np.vstack([np.zeros(2), np.cumsum(steps.displacement_m, axis=0)])
    for _ in range(20):
        found = least_squares(
            residuals, state.ravel(), jac="cs", xtol=1e-15, ftol=1e-15, gtol=1e-12, args=(state.copy(),)
        )
        change, state = np.abs(found.x - state.ravel()).max(), found.x.reshape(n + 1, 4)
        if change < 1e-10:
            break
    return state
