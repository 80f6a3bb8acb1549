"""Events of a walk besides steps, context windows and fixes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Gap:
    """A time without samples, of `duration_s` seconds."""

    duration_s: float


@dataclass(frozen=True)
class Stepless:
    """A time of `duration_s` seconds after the last known step in which the phone moved without a step."""

    duration_s: float = 1.0


@dataclass(frozen=True)
class Undecided:
    """Begin of the motion whose steps are not known yet, in s, or infinity without such motion."""

    since_s: float = np.inf


@dataclass(frozen=True, slots=True)
class Climb:
    """Climb rate over one window, and the height at its end.

    Attributes
    ----------
    time_s : float
        Time of the last sample of the window, s. The rate is a mean over the window, so it refers to half a window
        earlier.
    climb_rate_mps : float
        Climb rate, up positive, m/s.
    std_mps : float
        Standard deviation of the climb rate, m/s.
    n_samples : int
        Samples of the window.
    height_m : float
        Height of the mean pressure of the last hop above the level of 1013.25 hPa, m.
    height_std_m : float
        Standard deviation of the height due to the sensor alone, m.
    """

    time_s: float
    climb_rate_mps: float
    std_mps: float
    n_samples: int
    height_m: float
    height_std_m: float
