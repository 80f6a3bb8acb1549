"""Walking speed: of each step, and smoothed over steps, with its standard deviation.

Length over duration of single steps alternates: the two feet differ, and a contact that is found late makes one step
long and the next one short. The smoothed speed is a random walk seen through single steps (local-level Kalman filter);
it starts afresh with each bout. What all steps share, the person's own scale, does not average out and is added.

How much the steps scatter is seen in the steps: in a pocket or a swinging hand, where contacts are missed, several
times as much as in the hand. What makes them scatter lasts for some steps, so that half of it is added too.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

# Contacts of the default detector scatter by about this much against foot switches.
CONTACT_STD_S = 0.03
# People change their speed by this much within a second of ordinary walking (standard deviation): from rest to
# 1.3 m/s takes about two seconds, which the start of each bout has to itself.
SPEED_CHANGE_MPS_PER_SQRT_S = 0.1
# The scatter is a running mean over about twenty steps, as all that is usual for a person.
_SCATTER_DECAY = 0.95
# Share of the scatter that the steps around have too: chosen on the five placements of tyrex, one person in a room of
# motion capture, among 0, 0.5, 0.7 and 1 (tests/benchmarks/placements.py).
_LASTING_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class WalkingSpeed:
    """Speed after a step."""

    step_mps: float  # of the step itself: length over duration
    step_std_mps: float
    smoothed_mps: float
    level_var_m2ps2: float  # of the smoothed speed without what all steps share
    smoothed_std_mps: float
    scatter_m2ps2: float  # mean squared difference of the last steps from the speed that was expected of them


def after_step(
    previous: WalkingSpeed | None,
    length_m: float,
    length_var_m2: float,
    duration_s: float,
    log_scale_var: float,
    is_first: bool = False,
) -> WalkingSpeed:
    """Speed after a step; `before` is that of the step before, None if there is none.

    v = L / T with var v = (var L + 2 v^2 s^2) / T^2, s the standard deviation of a contact. Smoothed: P = P + q T;
    D = 0.95 D + 0.05 (v - v_s)^2; K = P / (P + max(var v, D)); v_s = v_s + K (v - v_s); P = (1 - K) P. Both standard
    deviations have v^2 var(log scale) added, that of the smoothed speed D / 2 too. The variance of the length is
    without the person's scale. The first step of a bout starts the smoothed speed afresh, but not D.
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
