"""Seven modes of vertical motion in a second of the barometer, with their estimates.

The state of each mode is x = (climbed, rate, sloped, air). `climbed` are metres on stairs, lifts and escalators, and
`rate` is their rate of change. `sloped` are metres gained on level ground and slopes. `air` is the change of the
pressure height by weather and draughts. The barometer measures climbed + sloped + air.

The modes are:

- level ground, where only the air changes;
- a slope, on which steps change the height gradually;
- stairs up and stairs down, with one riser for each step;
- a lift or an escalator, with a persistent rate and no steps;
- a sudden change of the air by a door or a fan;
- a drift of the air around a person who sits, as in an aircraft cabin.

They are mixed as in the IMM of the track (`imm`), once a second.

The estimate is represented by the moments p E[y y'] of each mode, (7, 5, 5), with y = (1, x) and p the probability of
the mode. Mixing is a sum of moments, and a prediction y = G y changes them to G E[y y'] G'. Their sum over the modes is
the combined estimate. This needs half of the function calls of means, covariances and probabilities.
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

# Standard deviation of the mean pressure height of a second (draughts), and random walk of the air per root second, as
# measured on one storey during two minutes (ipin21).
DRAUGHT_STD_M, AIR_WALK_M = 0.12, 0.025
# Standard deviation of a sudden change by a door or a fan: 5 to 50 Pa.
JUMP_STD_M = 1.5
# Additional random walk of the air in the drift mode. The pressure of an aircraft cabin changes by 1 hPa a minute, 0.14
# m/s, which is half of the climb rate of an escalator.
DRIFT_M = 0.12
# Rate on slopes: ramps for wheelchairs have at most 6 % (DIN 18040), which is 0.08 m/s at a speed of 1.3 m/s.
SLOPE_MPS = 0.08
# Standard deviation of the height climbed on stairs in a second. Risers are equal in one staircase, and mostly within a
# centimetre of 0.17 m (`barometer`). Steps are detected a second late, so that their number in a second is wrong by
# one.
STAIRS_STD_M = 0.12
# Acceleration of lifts, 0.5 to 1 m/s2 (more is uncomfortable by ISO 8100-34).
LIFT_ACCELERATION_MPS2 = 0.7
# Smallest rate of a ride. Escalators climb at 0.25 to 0.4 m/s, lifts faster. Slower changes are due to the air.
MIN_RIDE_MPS = 0.2
# Longest prediction of a ride. After a longer gap the height in the lift mode is practically unknown anyway.
_LONGEST_LIFT_S = 10.0
_UNKNOWN_M2 = 1e8

# Mean stays in seconds: flights and level stretches from the terrain labels (`transition_probabilities`), others
# assumed.
_STAYS_S = {LEVEL: 15.0, SLOPE: 20.0, UP: 6.6, DOWN: 5.8, LIFT: 15.0, JUMP: 1.1, DRIFT: 60.0}
# Probabilities of the next mode.
_NEXT = {
    LEVEL: {SLOPE: 0.35, UP: 0.25, DOWN: 0.25, LIFT: 0.09, JUMP: 0.05, DRIFT: 0.01},
    SLOPE: {LEVEL: 0.7, UP: 0.1, DOWN: 0.1, LIFT: 0.05, JUMP: 0.05},
    UP: {LEVEL: 0.9, SLOPE: 0.05, DOWN: 0.02, JUMP: 0.03},
    DOWN: {LEVEL: 0.9, SLOPE: 0.05, UP: 0.02, JUMP: 0.03},
    LIFT: {LEVEL: 0.95, JUMP: 0.05},
    JUMP: {LEVEL: 0.8, SLOPE: 0.1, UP: 0.03, DOWN: 0.03, LIFT: 0.03, DRIFT: 0.01},
    DRIFT: {LEVEL: 0.9, LIFT: 0.05, JUMP: 0.05},
}
# Log evidence of a second without steps for stairs. With a step every 0.55 s this is rare, but steps after a pause are
# detected late.
_NO_STEP_ON_STAIRS = math.log(0.2)


def _transitions() -> FloatArray:
    """Return the transition matrix (7, 7) of the modes per second, from row to column."""
    rows = np.zeros((N_MODES, N_MODES))
    for mode, stay_s in _STAYS_S.items():
        rows[mode, mode] = 1.0 - 1.0 / stay_s
        for next_mode, share in _NEXT[mode].items():
            rows[mode, next_mode] = share / stay_s
    return read_only(rows)


_TRANSITIONS = _transitions()
# Smallest log probability of a mode, because moments are divided by the probability later.
_MIN_LOG_PROB = -400.0


def _sparse(at: dict[tuple[int, ...], float]) -> FloatArray:
    """Return a read-only array (7, 5, 5) with values at some indices, else zero."""
    array = np.zeros(_SHAPE)
    for index, value in at.items():
        array[index] = value
    return read_only(array)


# Arrays of each mode: persistence of the states (the rate persists only in a lift), rise of a step, variances of each
# prediction, and variances per second without and with steps.
_SHAPE = (N_MODES, _SIZE, _SIZE)
_PERSISTENCE = _sparse({(m, s, s): 1.0 for m in range(N_MODES) for s in range(_SIZE) if s != _RATE or m == LIFT})
_RISE_PER_STEP = _sparse({(UP, _CLIMBED, _ONE): RISER_M, (DOWN, _CLIMBED, _ONE): -RISER_M})
_CONSTANT_NOISE = {(m, _CLIMBED, _CLIMBED): STAIRS_STD_M**2 for m in (UP, DOWN)} | {(JUMP, _AIR, _AIR): JUMP_STD_M**2}
_NOISE_PER_S = {(m, _AIR, _AIR): AIR_WALK_M**2 + (m == DRIFT) * DRIFT_M**2 for m in range(N_MODES)}
_NOISE = _sparse(_CONSTANT_NOISE)
_WALK = _sparse(_NOISE_PER_S), _sparse(_NOISE_PER_S | {(SLOPE, _SLOPED, _SLOPED): SLOPE_MPS**2})


class Estimate(NamedTuple):
    """Combined height estimate of all modes."""

    # Climbed height and its variance
    climbed_m: float
    climbed_var_m2: float
    # Height climbed + sloped and its variance
    height_m: float
    height_var_m2: float
    air_m: float  # change of the pressure height by the air


def initial() -> FloatArray:
    """Return the moments p E[y y'] (7, 5, 5) of the vertical modes at the start, where the height is zero.

    p is the probability of a mode and y = (1, climbed, rate, sloped, air) its state. The mode level ground has the
    probability one, and the air is unknown.
    """
    moments = np.zeros(_SHAPE)
    moments[LEVEL, _ONE, _ONE], moments[LEVEL, _AIR, _AIR] = 1.0, _UNKNOWN_M2
    return moments


def combined_height(moments: FloatArray) -> Estimate:
    """Return the combined height estimate of all vertical modes from the moments (7, 5, 5)."""
    (_, climbed_m, _, sloped_m, air_m), climbed, _, sloped, _ = np.add.reduce(moments).tolist()
    climbed_var, sloped_var = climbed[_CLIMBED] - climbed_m**2, sloped[_SLOPED] - sloped_m**2
    height_var = climbed_var + sloped_var + 2.0 * (climbed[_SLOPED] - climbed_m * sloped_m)
    return Estimate(climbed_m, climbed_var, climbed_m + sloped_m, height_var, air_m)


def with_air_unknown(moments: FloatArray, climbed_m: float) -> FloatArray:
    """Return the moments (7, 5, 5) of a person on level ground at a climbed height, with an unknown air state.

    The mode level ground has the probability one. The estimate of the sloped height is kept.
    """
    total = np.add.reduce(moments)
    x, cov = total[_ONE].copy(), total - np.outer(total[_ONE], total[_ONE])
    x[_CLIMBED], x[_RATE] = climbed_m, 0.0
    cov[[_RATE, _AIR], :] = 0.0
    cov[:, [_RATE, _AIR]] = 0.0
    cov[_AIR, _AIR] = _UNKNOWN_M2
    level_moments = np.zeros(_SHAPE)
    level_moments[LEVEL] = cov + np.outer(x, x)
    return level_moments


def moments_after_second(
    moments: FloatArray, elapsed_s: float, n_steps: int, height_m: float, height_var_m2: float, log_evidence: FloatArray
) -> FloatArray:
    """Return the moments (7, 5, 5) after a second with some steps and a pressure measurement.

    `height_m` and `height_var_m2` are the measured pressure height and its variance. `log_evidence` (7,) is further
    evidence for the modes. `elapsed_s` is rounded to 0.1 s. Draughts change the pressure more than this rounding.
    """
    G, Q = _prediction(round(elapsed_s, 1), n_steps)
    mixed = _TRANSITIONS.T.dot(moments.reshape(N_MODES, -1)).reshape(_SHAPE)
    prob = mixed[:, _ONE, _ONE]
    moved = G @ (mixed / prob[:, None, None]) @ G.swapaxes(1, 2) + Q
    pressure = np.array([height_m, -1.0, 0.0, -1.0, -1.0])  # pressure height minus climbed, sloped and air
    updated, log_likelihood = _measured(moved, pressure, DRAUGHT_STD_M**2 + height_var_m2)
    log_likelihood += log_evidence
    rate_mps = float(updated[LIFT, _ONE, _RATE])
    log_likelihood[LIFT] += _log_prob_ride(rate_mps, float(updated[LIFT, _RATE, _RATE]) - rate_mps**2)
    if n_steps == 0:
        log_likelihood[UP : DOWN + 1] += _NO_STEP_ON_STAIRS
    log_posterior = np.log(prob) + log_likelihood
    prob = softmax(np.maximum(log_posterior - log_posterior.max(), _MIN_LOG_PROB))
    return updated * prob[:, None, None]


def moments_after_step(moments: FloatArray, rise_m: float, climbed_var_m2: float, sloped_var_m2: float) -> FloatArray:
    """Return the moments (7, 5, 5) after a step with an expected rise in m, without a measurement.

    `climbed_var_m2` and `sloped_var_m2` are the variances that the step adds to the climbed and to the sloped height.
    """
    moved = moments.copy()
    if rise_m != 0.0:
        moved[:, _CLIMBED] += rise_m * moved[:, _ONE]
        moved[:, :, _CLIMBED] += rise_m * moved[:, :, _ONE]
    prob = moments[:, _ONE, _ONE]
    moved[:, _CLIMBED, _CLIMBED] += climbed_var_m2 * prob
    moved[:, _SLOPED, _SLOPED] += sloped_var_m2 * prob
    return moved


def as_slope(moments: FloatArray, climbed_m: float) -> FloatArray:
    """Return the moments (7, 5, 5) after moving `climbed_m` from the climbed to the sloped height of each mode.

    It corrects a slope that was mistaken for stairs or a lift, because climbed metres change the storey and sloped ones
    do not. `climbed_m` is negative for a descent. The height, climbed + sloped, does not change.
    """
    G = np.eye(_SIZE)
    G[_CLIMBED, _ONE], G[_SLOPED, _ONE] = -climbed_m, climbed_m
    return G @ moments @ G.T


def at_level(moments: FloatArray, climbed_m: float, var_m2: float) -> FloatArray:
    """Return the moments (7, 5, 5) after a measurement of the climbed height by the known height of a storey, in m."""
    prob = moments[:, _ONE, _ONE, None, None]
    # without any pressure six modes have the probability zero
    of_modes = moments / np.maximum(prob, math.exp(_MIN_LOG_PROB))
    return _measured(of_modes, np.array([climbed_m, -1.0, 0.0, 0.0, 0.0]), var_m2)[0] * prob


@lru_cache(maxsize=64)
def _prediction(elapsed_s: float, n_steps: int) -> tuple[FloatArray, FloatArray]:
    """Return the matrices G and Q, (7, 5, 5) each, of the prediction of the state of each vertical mode.

    A prediction over `elapsed_s` seconds with `n_steps` steps leads from the state y = (1, climbed, rate, sloped, air)
    of a mode to G y + noise. Q is the covariance of the noise. Changes from one mode to another are not included.
    """
    lifted_s = min(elapsed_s, _LONGEST_LIFT_S)
    G, Q = _PERSISTENCE + n_steps * _RISE_PER_STEP, _NOISE + elapsed_s * _WALK[n_steps > 0]
    G[LIFT, _CLIMBED, _RATE] = lifted_s
    to_climbed, to_rate = 0.5 * LIFT_ACCELERATION_MPS2 * lifted_s**2, LIFT_ACCELERATION_MPS2 * lifted_s
    Q[LIFT, _CLIMBED, _CLIMBED] = to_climbed**2
    Q[LIFT, _CLIMBED, _RATE] = Q[LIFT, _RATE, _CLIMBED] = to_climbed * to_rate
    Q[LIFT, _RATE, _RATE] = to_rate**2
    return read_only(G), read_only(Q)


def _measured(moments: FloatArray, factor: FloatArray, variance: float) -> tuple[FloatArray, FloatArray]:
    """Return the moments E[y y'] (7, 5, 5) and log likelihoods (7,) of all modes after a scalar measurement.

    y = (1, climbed, rate, sloped, air) is the state of a mode. `moments` are its moments E[y y'] before the
    measurement, not multiplied by the probability of the mode. The innovation is measurement minus prediction, written
    as factor' y. The first element of `factor` is therefore the measured value, and the other elements are minus the
    coefficients of the states. `variance` is the variance of the measurement.

    Let m be the mean and P the covariance of y. Let c be the covariance of y and the innovation, S the variance of the
    innovation, and k = c / S. The mean becomes m - k innovation, and the covariance P - k c' (Kalman update).
    """
    mean, product = moments[:, :, _ONE], moments @ factor
    innovation = product[:, _ONE]
    c = product - mean * innovation[:, None]
    S = c @ factor + variance
    k = c / S[:, None]
    updated = mean - k * innovation[:, None]
    moments = moments - mean[:, :, None] * mean[:, None, :] - k[:, :, None] * c[:, None, :]
    moments += updated[:, :, None] * updated[:, None, :]
    return moments, -0.5 * (innovation * innovation / S + np.log(S))


def _log_prob_ride(rate_mps: float, var: float) -> float:
    """Return the log probability that a climb rate is fast enough for a lift or an escalator, up or down.

    This is the probability that its absolute value exceeds `MIN_RIDE_MPS`, for a normal distribution with the variance
    `var`.
    """
    scale = math.sqrt(2.0 * max(var, 1e-12))
    slower = math.erf((MIN_RIDE_MPS - rate_mps) / scale) - math.erf((-MIN_RIDE_MPS - rate_mps) / scale)
    return math.log(max(1.0 - 0.5 * slower, 1e-6))
