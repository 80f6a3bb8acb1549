"""Tracks with given numbers, for tests of what draws and writes them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from helpers import windows_of

from pdr_filter.tracking.track import Track
from pdr_filter.values import CONTEXTS, Step, step_table


def make_track(n_steps: int, n_windows: int, **changes: Any) -> Track:
    """Return a track to the north-east with alternating contexts and a growing covariance."""
    number = np.arange(1, n_steps + 1)
    step = Step(0.5, 1.0, 0.5, 2.0, 3.0, 4.0, -3.0, 14.0, 6.0, 2.0, 0.0, 0.0)
    prob = np.eye(len(CONTEXTS))
    track = Track(
        name="made_up",
        time_s=0.5 * number,
        position_m=np.outer(number, [0.5, 0.5]),
        position_cov_m2=number[:, None, None] * np.array([[0.04, 0.01], [0.01, 0.02]]),
        step_length_m=np.full(n_steps, 0.5**0.5),
        walked_m=0.5**0.5 * number,
        walking_heading_rad=np.full(n_steps, np.pi / 4),
        step_speed_mps=np.full(n_steps, 2**0.5),
        step_speed_std_mps=np.full(n_steps, 0.2),
        smoothed_speed_mps=np.full(n_steps, 2**0.5),
        smoothed_speed_std_mps=np.full(n_steps, 0.1),
        context_prob=prob[number % 6],
        contexts=CONTEXTS,
        mode_prob=prob[number % 6],
        modes=CONTEXTS,
        mode_contexts=CONTEXTS,
        gap_before_s=np.zeros(n_steps),
        height_m=np.zeros(n_steps),
        height_std_m=np.zeros(n_steps),
        floor=np.zeros(n_steps, dtype=np.int64),
        steps=step_table([replace(step, time_s=0.5 * float(k)) for k in number]),
        windows=windows_of(1.0 + np.arange(1, n_windows + 1), prob[np.arange(n_windows) % 6]),
        start_time_s=0.0,
        duration_s=max(0.5 * n_steps, n_windows + 1.0),
        weighting="imm",
        notes=(),
    )
    return replace(track, **changes)
