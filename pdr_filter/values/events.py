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
    """Climb rate over one window, and the height at its end."""

    time_s: float  # last sample of the window; the rate is a mean, so it refers to half a window earlier
    climb_rate_mps: float  # up positive
    std_mps: float
    n_samples: int
    height_m: float  # mean of the last hop, above the level of 1013.25 hPa
    height_std_m: float  # the part of the sensor alone
