"""Walking speed of each step and smoothed over steps, with standard deviations.

Length divided by duration alternates from step to step. The two feet differ, and a contact that is detected late makes
one step long and the next one short. The smoothed speed is a random walk that is observed through single steps
(local-level Kalman filter). It starts again with each bout. The error that all steps share, the scale of the person,
does not average out and is added to the variance.

The scatter of the steps is estimated from the steps. It is several times larger in a pocket or a swinging hand than in
a still hand, because contacts are missed. Its causes last for several steps, so half of it is added to the variance as
well.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

# Standard deviation of the contact times of the default detector, compared with foot switches.
CONTACT_STD_S = 0.03
# Standard deviation of the change of speed within a second of ordinary walking. Setting off from rest to 1.3 m/s takes
# about two seconds, but each bout starts a new estimate.
SPEED_CHANGE_MPS_PER_SQRT_S = 0.1
# Decay of the running mean of the scatter: about twenty steps, as for all other running statistics of a person.
_SCATTER_DECAY = 0.95
# Share of the scatter that neighbouring steps have in common. Chosen among 0, 0.5, 0.7 and 1 on the five placements of
# tyrex, one person in a motion capture room (tests/benchmarks/placements.py).
_LASTING_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class WalkingSpeed:
    """Walking speed after a step."""

    step_mps: float  # speed of the step in m/s: length divided by duration
    step_std_mps: float  # standard deviation of `step_mps`
    smoothed_mps: float  # speed in m/s, smoothed over the steps of the bout
    level_var_m2ps2: float  # variance of the smoothed speed without the errors that all steps share
    smoothed_std_mps: float  # standard deviation of the smoothed speed, including the errors that all steps share
    scatter_m2ps2: float  # running mean of the squared difference between the speed of a step and its prediction


def speed_after_step(
    previous: WalkingSpeed | None,
    length_m: float,
    length_var_m2: float,
    duration_s: float,
    log_scale_var: float,
    is_first: bool = False,
) -> WalkingSpeed:
    """Return the walking speed after a step, or after the first step if `previous` is None.

    A step of length L and duration T has the speed v = L / T, with variance var v = (var L + 2 v^2 s^2) / T^2. Here s
    is the standard deviation of a contact time. The smoothed speed v_s has the variance P, and D is the scatter of the
    steps. Each step updates them in this order, with q = 0.01 m2/s3 the variance of the change of speed per second:

    D = 0.95 D + 0.05 (v - v_s)^2; P = P + q T; K = P / (P + max(var v, D)); v_s = v_s + K (v - v_s); P = (1 - K) P.

    `step_std_mps` is the root of var v + v^2 var(log scale). `smoothed_std_mps` is the root of P + D / 2 + v_s^2
    var(log scale). The variance of the length must not include the scale of the person. The first step of a bout
    (`is_first`) restarts the smoothed speed, but not the scatter D.
    """
    speed = length_m / duration_s
    var = (length_var_m2 + 2 * (speed * CONTACT_STD_S) ** 2) / duration_s**2
    level, level_var = speed, var
    scatter = var if previous is None else previous.scatter_m2ps2
    if previous is not None and not is_first:
        innovation = speed - previous.smoothed_mps
        scatter = _SCATTER_DECAY * scatter + (1 - _SCATTER_DECAY) * innovation**2
        predicted = previous.level_var_m2ps2 + SPEED_CHANGE_MPS_PER_SQRT_S**2 * duration_s
        gain = predicted / (predicted + max(var, scatter))
        level = previous.smoothed_mps + gain * innovation
        level_var = (1 - gain) * predicted
    return WalkingSpeed(
        step_mps=speed,
        step_std_mps=sqrt(var + speed**2 * log_scale_var),
        smoothed_mps=level,
        level_var_m2ps2=level_var,
        smoothed_std_mps=sqrt(level_var + _LASTING_SHARE * scatter + level**2 * log_scale_var),
        scatter_m2ps2=scatter,
    )
