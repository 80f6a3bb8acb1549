"""Recordings whose phone is turned about in the hand before the walk begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import pdr_filter as pdr
from pdr_filter.simulate import Leg, SensorErrors, simulate
from pdr_filter.values import Samples

HANDLED_S = 20.0
ROUTE = [Leg("walking", distance_m=25.0, turn_rad=turn) for turn in (0.0, 1.57, -0.9, 1.57)]


def handled_walk(
    seed: int, *, mirrored: bool = False, turned_rad: float = 0.0, delay_s: float = 0.0, bias_std_radps: float = 0.004
) -> pdr.Recording:
    """Simulated walk with the phone in a pocket, which is handled for 20 s while its owner stands still.

    `mirrored` turns the handling about the opposite axes, `turned_rad` about other axes, and `delay_s` begins it later;
    the walk and its sensor errors stay the same.
    """
    errors = SensorErrors()
    errors = replace(errors, gyroscope=replace(errors.gyroscope, bias_std=bias_std_radps))
    still = Leg("stationary", duration_s=HANDLED_S + 10.0)
    walk = simulate([still, *ROUTE], carrying_mode="pocket", seed=seed, errors=errors)
    rng = np.random.default_rng(seed + 1000)
    size, phase = rng.uniform(0.3, 1.2, (3, 3)), rng.uniform(0, 2 * np.pi, (3, 3))
    rate_hz = rng.uniform(0.1, 0.6, (3, 3))

    def relative(time_s: np.ndarray) -> Rotation:
        """Rotation of the handled phone against the phone that stays in the pocket."""
        since_s = time_s - delay_s
        window = np.where((since_s > 0) & (since_s < HANDLED_S), np.sin(np.pi * since_s / HANDLED_S) ** 2, 0.0)
        waves = (size * np.sin(2 * np.pi * rate_hz * since_s[:, None, None] + phase)).sum(axis=2)
        vector = (-1.0 if mirrored else 1.0) * window[:, None] * waves
        return Rotation.from_rotvec(Rotation.from_euler("z", turned_rad).apply(vector))

    assert walk.gyroscope is not None
    force, rate = walk.accelerometer, walk.gyroscope
    step_s = 1e-3
    relative_rate = (relative(rate.time_s).inv() * relative(rate.time_s + step_s)).as_rotvec() / step_s
    turned_rate = relative(rate.time_s).inv().apply(rate.values.copy()) + relative_rate
    turned_force = relative(force.time_s).inv().apply(force.values.copy())
    return replace(
        walk,
        accelerometer=Samples(force.time_s, turned_force),
        gyroscope=Samples(rate.time_s, turned_rate),
        magnetometer=None,
    )
