"""How somebody moves up and down in a second of the barometer: seven modes, their estimates and their arithmetic.

The state of each mode is x = (climbed, its rate, sloped, air): metres climbed on stairs, lifts and escalators, how
fast, metres that level ground and slopes led up, and what the air added to the height that the pressure shows, weather
and draughts. The barometer measures climbed + sloped + air.

The modes are level ground, where nothing moves but the air; a slope, on which steps lead up or down little by little;
stairs up and down, a riser a step; a lift, or an escalator, that moves somebody who makes no steps, at a rate that
lasts; a jump of the air, a door or a fan, all at once; and a drift of the air about somebody who sits, as in the cabin
of an aeroplane. They are mixed as those of the track are (`imm`), once for each second.

What is known is the moments p E[y y'] of each mode, y = (1, x) and p its probability, (7, 5, 5): mixing modes adds
moments up, a prediction y = G y turns them to G E[y y'] G', and their sum over the modes is what is known of x. That
takes half of the calls that means, covariances and probabilities take.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pdr_filter.sensing.features.barometer import RISER_M
from pdr_filter.values import FloatArray, read_only, softmax

_ONE, _CLIMBED, _RATE, _SLOPED, _AIR = range(5)
LEVEL, SLOPE, UP, DOWN, LIFT, JUMP, DRIFT = range(7)
N_MODES, _SIZE = 7, 5

# The mean pressure of a second differs from that of the seconds around it by 0.12 m, and by 0.025 m a root second more
# the further they are (ipin21, one storey in two minutes).
DRAUGHT_STD_M, AIR_WALK_M = 0.12, 0.025
# A door, a fan: 5 to 50 Pa.
JUMP_STD_M = 1.5
# The cabin of an aeroplane on its way changes by a hPa a minute, 0.14 m/s: half of what an escalator climbs.
DRIFT_M = 0.12
# Ramps of 6 % are the steepest for wheels (DIN 18040), 0.08 m/s at 1.3 m/s.
SLOPE_MPS = 0.08
# Risers of one staircase are alike, and mostly within a centimetre of 0.17 m (`barometer`); a step is known a second
# after its contact, so that the steps of a second are wrong by one.
STAIRS_STD_M = 0.12
# Lifts start and stop with 0.5 to 1 m/s2 (ISO 8100-34 calls more uncomfortable).
LIFT_ACCELERATION_MPS2 = 0.7
# Escalators climb with 0.25 to 0.4 m/s, lifts faster: what moves more slowly than this is air.
LEAST_RIDE_MPS = 0.2
# After a gap all heights that a lift may have come to are alike.
_LONGEST_LIFT_S = 10.0
_UNKNOWN_M2 = 1e8

# Mean stays in seconds: flights and level stretches of the terrain labels (`modes`), rides and slopes by judgement.
_STAYS_S = {LEVEL: 15.0, SLOPE: 20.0, UP: 6.6, DOWN: 5.8, LIFT: 15.0, JUMP: 1.1, DRIFT: 60.0}
# Where they lead to.
_NEXT = {
    LEVEL: {SLOPE: 0.35, UP: 0.25, DOWN: 0.25, LIFT: 0.09, JUMP: 0.05, DRIFT: 0.01},
    SLOPE: {LEVEL: 0.7, UP: 0.1, DOWN: 0.1, LIFT: 0.05, JUMP: 0.05},
    UP: {LEVEL: 0.9, SLOPE: 0.05, DOWN: 0.02, JUMP: 0.03},
    DOWN: {LEVEL: 0.9, SLOPE: 0.05, UP: 0.02, JUMP: 0.03},
    LIFT: {LEVEL: 0.95, JUMP: 0.05},
    JUMP: {LEVEL: 0.8, SLOPE: 0.1, UP: 0.03, DOWN: 0.03, LIFT: 0.03, DRIFT: 0.01},
    DRIFT: {LEVEL: 0.9, LIFT: 0.05, JUMP: 0.05},
}
# A step every 0.55 s on stairs: seldom none in a second, but steps after a pause are known late.
_NO_STEP_ON_STAIRS = math.log(0.2)


def _transitions() -> FloatArray:
    rows = np.zeros((N_MODES, N_MODES))
    for mode, stay_s in _STAYS_S.items():
        rows[mode, mode] = 1.0 - 1.0 / stay_s
        for next_mode, share in _NEXT[mode].items():
            rows[mode, next_mode] = share / stay_s
    return read_only(rows)


_TRANSITIONS = _transitions()
# Moments of a mode that was ruled out are divided by its probability later on.
_LEAST_LOG_PROB = -400.0


def _entries(at: dict[tuple[int, ...], float], shape: tuple[int, ...]) -> FloatArray:
    array = np.zeros(shape)
    for index, value in at.items():
        array[index] = value
    return read_only(array)


# Of each mode: which states last (a rate in a lift only), what a step climbs, the variances of each prediction, and
# those that grow with its time, where nobody makes steps and where somebody does.
_SHAPE = (N_MODES, _SIZE, _SIZE)
_LASTS = _entries(
    {(m, s, s): 1.0 for m in range(N_MODES) for s in range(_SIZE) if s != _RATE or m == LIFT},
    _SHAPE,
)
_RISEN = _entries({(UP, _CLIMBED, _ONE): RISER_M, (DOWN, _CLIMBED, _ONE): -RISER_M}, _SHAPE)
_AT_ONCE = {(m, _CLIMBED, _CLIMBED): STAIRS_STD_M**2 for m in (UP, DOWN)} | {(JUMP, _AIR, _AIR): JUMP_STD_M**2}
_BY_TIME = {(m, _AIR, _AIR): AIR_WALK_M**2 + (m == DRIFT) * DRIFT_M**2 for m in range(N_MODES)}
_NOISE = _entries(_AT_ONCE, _SHAPE)
_WALK = tuple(_entries(more, _SHAPE) for more in (_BY_TIME, _BY_TIME | {(SLOPE, _SLOPED, _SLOPED): SLOPE_MPS**2}))


class Estimate(NamedTuple):
    """What is known of the height, whatever the mode."""

    climbed_m: float
    climbed_var_m2: float
    height_m: float  # climbed + sloped
    height_var_m2: float
    air_m: float


def initial() -> FloatArray:
    """Moments (7, 5, 5) at the start, whose height is zero."""
    moments = np.zeros(_SHAPE)
    moments[LEVEL, _ONE, _ONE], moments[LEVEL, _AIR, _AIR] = 1.0, _UNKNOWN_M2
    return moments


def combined(moments: FloatArray) -> Estimate:
    """What moments say of the height."""
    (_, climbed_m, _, sloped_m, air_m), climbed, _, sloped, _ = np.add.reduce(moments).tolist()
    climbed_var, sloped_var = climbed[_CLIMBED] - climbed_m**2, sloped[_SLOPED] - sloped_m**2
    height_var = climbed_var + sloped_var + 2.0 * (climbed[_SLOPED] - climbed_m * sloped_m)
    return Estimate(climbed_m, climbed_var, climbed_m + sloped_m, height_var, air_m)


def with_air_unknown(moments: FloatArray, climbed_m: float) -> FloatArray:
    """Moments of somebody on level ground who climbed so much, where nothing is known of the air any more."""
    total = np.add.reduce(moments)
    x, cov = total[_ONE].copy(), total - np.outer(total[_ONE], total[_ONE])
    x[_CLIMBED], x[_RATE] = climbed_m, 0.0
    cov[[_RATE, _AIR], :] = 0.0
    cov[:, [_RATE, _AIR]] = 0.0
    cov[_AIR, _AIR] = _UNKNOWN_M2
    level_moments = np.zeros(_SHAPE)
    level_moments[LEVEL] = cov + np.outer(x, x)
    return level_moments


def after_second(
    moments: FloatArray, elapsed_s: float, n_steps: int, height_m: float, height_var_m2: float, log_evidence: FloatArray
) -> FloatArray:
    """Moments after a second in which somebody made steps and the pressure was read.

    `log_evidence` (7,) is what else is known of the modes. Times are those of a tenth of a second, which is less than
    draughts do.
    """
    G, Q = _moves(round(elapsed_s, 1), n_steps)
    mixed = _TRANSITIONS.T.dot(moments.reshape(N_MODES, -1)).reshape(_SHAPE)
    prob = mixed[:, _ONE, _ONE]
    moved = G @ (mixed / prob[:, None, None]) @ G.swapaxes(1, 2) + Q
    updated, log_likelihood = _measured(moved, _pressure(height_m), DRAUGHT_STD_M**2 + height_var_m2)
    log_likelihood += log_evidence
    rate_mps = float(updated[LIFT, _ONE, _RATE])
    log_likelihood[LIFT] += _log_prob_rides(rate_mps, float(updated[LIFT, _RATE, _RATE]) - rate_mps**2)
    if n_steps == 0:
        log_likelihood[UP : DOWN + 1] += _NO_STEP_ON_STAIRS
    log_posterior = np.log(prob) + log_likelihood
    prob = softmax(np.maximum(log_posterior - log_posterior.max(), _LEAST_LOG_PROB))
    return updated * prob[:, None, None]


def after_step(moments: FloatArray, rise_m: float, climbed_var_m2: float, sloped_var_m2: float) -> FloatArray:
    """Moments after a step that climbed something, of which nothing was measured."""
    moved = moments.copy()
    if rise_m != 0.0:
        moved[:, _CLIMBED] += rise_m * moved[:, _ONE]
        moved[:, :, _CLIMBED] += rise_m * moved[:, :, _ONE]
    prob = moments[:, _ONE, _ONE]
    moved[:, _CLIMBED, _CLIMBED] += climbed_var_m2 * prob
    moved[:, _SLOPED, _SLOPED] += sloped_var_m2 * prob
    return moved


def as_slope(moments: FloatArray, climbed_m: float) -> FloatArray:
    """Moments of somebody of whose climbed height so much was a slope: the height above the start stays."""
    G = np.eye(_SIZE)
    G[_CLIMBED, _ONE], G[_SLOPED, _ONE] = -climbed_m, climbed_m
    return G @ moments @ G.T


def at_level(moments: FloatArray, climbed_m: float, var_m2: float) -> FloatArray:
    """Moments of somebody who is on a level that is known."""
    prob = moments[:, _ONE, _ONE, None, None]
    updated, _ = _measured(moments / prob, np.array([climbed_m, -1.0, 0.0, 0.0, 0.0]), var_m2)
    return updated * prob


def _pressure(height_m: float) -> FloatArray:
    """What the pressure shows less what the states add up to, as a factor of y."""
    return np.array([height_m, -1.0, 0.0, -1.0, -1.0])


@lru_cache(maxsize=64)
def _moves(elapsed_s: float, n_steps: int) -> tuple[FloatArray, FloatArray]:
    """G and Q (7, 5, 5) of a prediction over some time."""
    lifted_s = min(elapsed_s, _LONGEST_LIFT_S)
    G, Q = _LASTS + n_steps * _RISEN, _NOISE + elapsed_s * _WALK[n_steps > 0]
    G[LIFT, _CLIMBED, _RATE] = lifted_s
    to_climbed, to_rate = 0.5 * LIFT_ACCELERATION_MPS2 * lifted_s**2, LIFT_ACCELERATION_MPS2 * lifted_s
    Q[LIFT, _CLIMBED, _CLIMBED] = to_climbed**2
    Q[LIFT, _CLIMBED, _RATE] = Q[LIFT, _RATE, _CLIMBED] = to_climbed * to_rate
    Q[LIFT, _RATE, _RATE] = to_rate**2
    return read_only(G), read_only(Q)


def _measured(moments: FloatArray, of_y: FloatArray, variance: float) -> tuple[FloatArray, FloatArray]:
    """Updated moments E[y y'] and log likelihoods (7,) where of_y' y, the innovation, is zero but for a variance.

    With c the covariance of y and the innovation, S that of the innovation and k = c / S, the mean becomes
    m - k innovation and the covariance P - k c' (Kalman).
    """
    mean, product = moments[:, :, _ONE], moments @ of_y
    innovation = product[:, _ONE]
    c = product - mean * innovation[:, None]
    S = c @ of_y + variance
    k = c / S[:, None]
    updated = mean - k * innovation[:, None]
    moments = moments - mean[:, :, None] * mean[:, None, :] - k[:, :, None] * c[:, None, :]
    moments += updated[:, :, None] * updated[:, None, :]
    return moments, -0.5 * (innovation * innovation / S + np.log(S))


def _log_prob_rides(rate_mps: float, var: float) -> float:
    """Log probability that a rate is that of a lift or an escalator, up or down."""
    scale = math.sqrt(2.0 * max(var, 1e-12))
    slower = math.erf((LEAST_RIDE_MPS - rate_mps) / scale) - math.erf((-LEAST_RIDE_MPS - rate_mps) / scale)
    return math.log(max(1.0 - 0.5 * slower, 1e-6))
