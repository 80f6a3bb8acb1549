"""How somebody moves up and down in a second of the barometer: seven modes, their estimates and their arithmetic.

The state of each mode is [climbed, its rate, sloped, air]: metres climbed on stairs, lifts and escalators, how fast,
metres that level ground and slopes led up, and what the air added to the height that the pressure shows, weather and
draughts. The barometer measures climbed + sloped + air.

The modes are level ground, where nothing moves but the air; a slope, on which steps lead up or down little by little;
stairs up and down, a riser a step; a lift, or an escalator, that moves somebody who makes no steps, at a rate that
lasts; a jump of the air, a door or a fan, all at once; and a drift of the air about somebody who sits, as in the cabin
of an aeroplane. They are mixed as those of the track are (`imm`), once for each second.
"""

from __future__ import annotations

import math

import numpy as np

from pdr_filter.filter import imm
from pdr_filter.sensing.features.barometric import RISER_M
from pdr_filter.values import FloatArray, read_only

CLIMBED, RATE, SLOPED, AIR = range(4)
LEVEL, SLOPE, UP, DOWN, LIFT, JUMP, DRIFT = range(7)
N_MODES, N_STATES = 7, 4

# The mean pressure of a second differs from that of the seconds around it by 0.12 m, and by 0.025 m a root second more
# the further they are (ipin21, one storey in two minutes).
DRAUGHT_STD_M, AIR_WALK_M = 0.12, 0.025
# A door, a fan: 5 to 50 Pa.
JUMP_STD_M = 1.5
# The cabin of an aeroplane on its way changes by a hPa a minute, 0.14 m/s: half of what an escalator climbs.
DRIFT_M = 0.12
# Ramps of 6 % are the steepest for wheels (DIN 18040), 0.08 m/s at 1.3 m/s.
SLOPE_MPS = 0.08
# Risers of one staircase are alike, and mostly within a centimetre of 0.17 m (`barometric`); a step is known a second
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
        for after, share in _NEXT[mode].items():
            rows[mode, after] = share / stay_s
    return read_only(rows)


_TRANSITIONS = _transitions()
_PRESSURE = read_only(np.array([1.0, 0.0, 1.0, 1.0]))  # what the states add up to
_CLIMBED = read_only(np.eye(N_STATES)[CLIMBED])


def _entries(at: dict[tuple[int, ...], float], shape: tuple[int, ...]) -> FloatArray:
    array = np.zeros(shape)
    for index, value in at.items():
        array[index] = value
    return read_only(array)


# Of each mode: which states last (a rate in a lift only), what a step climbs, the variances of each prediction, and
# those that grow with its time, where nobody makes steps and where somebody does.
_LASTS = _entries(
    {(m, s, s): 1.0 for m in range(N_MODES) for s in range(N_STATES) if s != RATE or m == LIFT},
    (N_MODES, N_STATES, N_STATES),
)
_RISEN = _entries({(UP, CLIMBED): RISER_M, (DOWN, CLIMBED): -RISER_M}, (N_MODES, N_STATES))
_AT_ONCE = {(m, CLIMBED, CLIMBED): STAIRS_STD_M**2 for m in (UP, DOWN)} | {(JUMP, AIR, AIR): JUMP_STD_M**2}
_BY_TIME = {(m, AIR, AIR): AIR_WALK_M**2 + (m == DRIFT) * DRIFT_M**2 for m in range(N_MODES)}
_NOISE = _entries(_AT_ONCE, (N_MODES, N_STATES, N_STATES))
_WALK = tuple(
    _entries(more, (N_MODES, N_STATES, N_STATES))
    for more in (_BY_TIME, _BY_TIME | {(SLOPE, SLOPED, SLOPED): SLOPE_MPS**2})
)


def initial() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Means (7, 4), covariances (7, 4, 4) and mode probabilities (7,) at the start, whose height is zero."""
    return alike(np.zeros(N_STATES), np.diag([0.0, 0.0, 0.0, _UNKNOWN_M2]))


def alike(x: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The same of somebody on level ground, with one mean (4,) and covariance (4, 4) in each mode."""
    return np.tile(x, (N_MODES, 1)), np.tile(P, (N_MODES, 1, 1)), np.eye(N_MODES)[LEVEL]


def with_air_unknown(x: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A mean (4,) and a covariance (4, 4) without a rate, where nothing is known of the air any more."""
    x, cov = x.copy(), P.copy()
    x[RATE] = 0.0
    cov[[RATE, AIR], :] = 0.0
    cov[:, [RATE, AIR]] = 0.0
    cov[AIR, AIR] = _UNKNOWN_M2
    return x, cov


def after_second(
    mean: FloatArray,
    cov: FloatArray,
    prob: FloatArray,
    elapsed_s: float,
    n_steps: int,
    height_m: float,
    height_var_m2: float,
    log_evidence: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Means, covariances and probabilities after a second in which somebody made steps and the pressure was read.

    `log_evidence` (7,) is what else is known of the modes.
    """
    mean, cov, prob = imm.mix(mean, cov, prob, _TRANSITIONS)
    mean, cov = _predict(mean, cov, elapsed_s, n_steps)
    mean, cov, log_likelihood = _measured(mean, cov, _PRESSURE, height_m, DRAUGHT_STD_M**2 + height_var_m2)
    log_likelihood = log_likelihood + log_evidence
    log_likelihood[LIFT] += _log_prob_rides(float(mean[LIFT, RATE]), float(cov[LIFT, RATE, RATE]))
    if n_steps == 0:
        log_likelihood[UP : DOWN + 1] += _NO_STEP_ON_STAIRS
    return mean, cov, imm.update_mode_prob(prob, log_likelihood)


def at_level(mean: FloatArray, cov: FloatArray, climbed_m: float, var_m2: float) -> tuple[FloatArray, FloatArray]:
    """Means and covariances of somebody who is on a level that is known."""
    mean, cov, _ = _measured(mean, cov, _CLIMBED, climbed_m, var_m2)
    return mean, cov


def _predict(mean: FloatArray, cov: FloatArray, elapsed_s: float, n_steps: int) -> tuple[FloatArray, FloatArray]:
    """Mixed estimates led on by a time: x = F x + n c, P = F P F' + Q."""
    lifted_s = min(elapsed_s, _LONGEST_LIFT_S)
    F, Q = _LASTS.copy(), _NOISE + elapsed_s * _WALK[n_steps > 0]
    F[LIFT, CLIMBED, RATE] = lifted_s
    to_climbed, to_rate = 0.5 * LIFT_ACCELERATION_MPS2 * lifted_s**2, LIFT_ACCELERATION_MPS2 * lifted_s
    Q[LIFT, CLIMBED, CLIMBED] = to_climbed**2
    Q[LIFT, CLIMBED, RATE] = Q[LIFT, RATE, CLIMBED] = to_climbed * to_rate
    Q[LIFT, RATE, RATE] = to_rate**2
    mean = (F @ mean[:, :, None])[:, :, 0] + n_steps * _RISEN
    return mean, F @ cov @ F.swapaxes(1, 2) + Q


def _measured(
    mean: FloatArray, cov: FloatArray, h: FloatArray, value: float, variance: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Updated means, covariances and log likelihoods (7,) of a number h x: `imm.update` without its matrices."""
    innovation = value - mean @ h
    Ph = cov @ h
    S = Ph @ h + variance
    K = Ph / S[:, None]
    log_likelihood = -0.5 * (innovation**2 / S + np.log(S))
    return mean + K * innovation[:, None], cov - K[:, :, None] * Ph[:, None, :], log_likelihood


def _log_prob_rides(rate_mps: float, var: float) -> float:
    """Log probability that a rate is that of a lift or an escalator, up or down."""
    scale = math.sqrt(2.0 * max(var, 1e-12))
    slower = math.erf((LEAST_RIDE_MPS - rate_mps) / scale) - math.erf((-LEAST_RIDE_MPS - rate_mps) / scale)
    return math.log(max(1.0 - 0.5 * slower, 1e-6))
