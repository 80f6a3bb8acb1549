"""Walks as step increments with exact truth, drawn from the model itself: no samples, thousands of steps at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.offline.smoothing.preintegration import Increments, scaled_rotation
from pdr_filter.values import PositionFix

STEP_S = 0.5


@dataclass(frozen=True)
class Walk:
    steps: Increments
    position_m: np.ndarray  # (K + 1, 2) in the frame of the map
    heading_offset_rad: np.ndarray  # (K + 1,) after each step
    log_scale: np.ndarray  # (K + 1,)

    def fixes(self, every: int, std_m: float, rng: np.random.Generator, wild_share: float = 0.0) -> list[PositionFix]:
        """A noisy fix at every so many steps; wild ones are 30 to 100 m away."""
        found = []
        for k in range(every, len(self.position_m), every):
            place = self.position_m[k] + rng.normal(scale=std_m, size=2)
            if rng.random() < wild_share:
                angle = rng.uniform(0, 2 * np.pi)
                place = place + rng.uniform(30, 100) * np.array([np.sin(angle), np.cos(angle)])
            found.append(PositionFix(float(self.steps.time_s[k - 1]), place, std_m**2 * np.eye(2)))
        return found


def simulated_walk(
    n_steps: int,
    rng: np.random.Generator,
    *,
    drift_rad_per_sqrt_s: float = 0.015,
    log_scale_std: float = 0.06,
    start_heading_std_rad: float = 0.15,
    any_rotation: bool = False,
    jumps: int = 0,
    scale_memory: float = 1.0,
    loop: bool = False,
) -> Walk:
    """A walk with a turn every 20 steps or so, its errors drawn from the covariances that the increments carry.

    A loop is a rectangle, whose errors are drawn given that it ends at its start.
    """
    length = rng.normal(0.7, 0.05, n_steps)
    corner = np.where(rng.random(n_steps) < 0.05, rng.choice([-np.pi / 2, np.pi / 2], n_steps), 0.0)
    psi = np.cumsum(corner + rng.normal(scale=0.03, size=n_steps))
    if loop:
        length[n_steps // 2 :] = length[: n_steps // 2]
        psi = np.pi / 2 * (np.arange(n_steps) * 4 // n_steps)
    along = np.column_stack([np.sin(psi), np.cos(psi)])
    across = np.column_stack([np.cos(psi), -np.sin(psi)])
    cov = 0.06**2 * along[:, :, None] * along[:, None, :]
    cov = cov + (0.1 * length[:, None, None]) ** 2 * across[:, :, None] * across[:, None, :]
    jump_var = np.zeros(n_steps)
    jump_var[rng.choice(np.arange(1, n_steps), jumps, replace=False)] = 1.0
    drift_var = np.full(n_steps, drift_rad_per_sqrt_s**2 * STEP_S)
    scale_var = np.full(n_steps, 0.001**2)
    steps = Increments(
        time_s=STEP_S * np.arange(1, n_steps + 1),
        duration_s=np.full(n_steps, STEP_S),
        length_m=length,
        displacement_m=length[:, None] * along,
        cov_m2=cov,
        drift_var_rad2=drift_var,
        unknown_var_rad2=np.zeros(n_steps),
        scale_memory=np.full(n_steps, scale_memory),
        scale_drift_var=scale_var,
        jump_var_rad2=jump_var,
        gap_var_m2=np.zeros(n_steps),
    )
    start = rng.uniform(-np.pi, np.pi) if any_rotation else rng.normal(scale=start_heading_std_rad)
    jump, drift = rng.normal(size=n_steps) * np.sqrt(jump_var), rng.normal(size=n_steps) * np.sqrt(drift_var)
    # the offset that a step is walked with has the change before it, and the drifts of those before it
    walked_with = start + np.cumsum(jump) + np.concatenate([[0.0], np.cumsum(drift)[:-1]])
    scale = np.full(n_steps + 1, rng.normal(scale=log_scale_std))
    for k, drift_of_scale in enumerate(rng.normal(size=n_steps) * np.sqrt(scale_var)):
        scale[k + 1] = scale_memory * scale[k] + drift_of_scale
    noise = np.einsum("kab,kb->ka", np.linalg.cholesky(cov), rng.normal(size=(n_steps, 2)))
    moved = np.einsum("kab,kb->ka", scaled_rotation(walked_with, scale[:-1]), steps.displacement_m + noise)
    if loop:
        moved -= moved.mean(axis=0)
    position = np.concatenate([np.zeros((1, 2)), np.cumsum(moved, axis=0)])
    return Walk(steps, position, np.concatenate([[start], walked_with + drift]), scale)
