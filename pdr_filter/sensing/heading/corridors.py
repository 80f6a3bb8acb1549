"""Heading drift from the axes of a building: a mixture of "this walk follows axes" and "it does not".

Straight parts of a walk along corridors differ by multiples of 90 degrees, however long ago they were. The deviation
from such multiples is the drift of the heading. The hypothesis of axes has a bank of Kalman filters with different
drift rates, so that no filter confuses two axes while the drift is uncertain by 45 degrees. Each step of a straight
part is a measurement of the direction modulo 90 degrees, with a possible outlier (Bar-Shalom et al. 2009, as in
`pdr_filter.sensing.gyroscope_bias`). The other hypothesis is that legs have arbitrary directions.

Only the first step of a leg in a new direction changes the odds of the two hypotheses. Walking straight on gives no
evidence of axes, and a slow curve looks like a drift. The prior odds are low, and the drift is weighted with the
probability of axes, so that free walks, circles and curved aisles are not degraded. The drift of a walk, and with it
its whole past, is therefore known after some corners (docs/methods/heading.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pdr_filter.values import FloatArray, check_numbers, replace_unchecked, wrap_angle
from pdr_filter.values.mixtures import log_sum, possible_outlier

_DRIFT, _RATE, _AXIS, _SCALE = range(4)
_RIGHT_ANGLE = 0.5 * math.pi
_ALONG_AXIS = np.array([1.0, 0.0, 1.0, 0.0])  # measurement vector: the heading along an axis is drift plus axis


@dataclass(frozen=True, eq=False)
class CorridorState:
    """Bank of M Kalman filters, and the log odds of axes."""

    # (M, 5, 4) mean (first row) and covariance of each filter. They are stacked so that one matrix product applies a
    # measurement vector to both. The state is drift (rad), drift rate (rad/s), direction of the axes (rad) and scale
    # error (rad of drift per rad of turn), all clockwise.
    bank: FloatArray
    log_weight: FloatArray  # (M,) log probabilities of the filters
    log_odds: float  # log odds that the walk follows axes
    turned_rad: float = 0.0  # total turn since the start, rad
    leg_rad: float = math.nan  # last heading of a straight part (a leg), rad. NaN before the first.
    # Times (s) and headings (rad) of the last steps, which may form a straight part
    recent: tuple[tuple[float, float], ...] = ()

    @property
    def mean(self) -> FloatArray:
        """Means (M, 4) of the M parallel Kalman filters, a view into the array of the bank."""
        return self.bank[:, 0]

    @property
    def cov(self) -> FloatArray:
        """Covariances (M, 4, 4) of the M parallel Kalman filters, a view into the array of the bank."""
        return self.bank[:, 1:]


@dataclass(frozen=True)
class Corridors:
    """Estimator of the heading drift from the axes that a walk follows.

    Parameters
    ----------
    rate_step_radps, max_rate_radps : float
        Spacing and largest absolute value of the drift rates of the bank, rad/s.
    rate_std_radps, wild_rate_prob : float
        Prior of the drift rate: normal about zero with this standard deviation, mixed with a uniform distribution over
        all rates of the bank with this probability. The remaining gyroscope bias is 0.001 to 0.003 rad/s on the phones
        of the test data.
    scale_std : float
        Standard deviation of the scale error of the gyroscope: 0.01 in data sheets, 0.02 in one phone of the test data,
        whose left and right turns drift apart.
    rectangular_prob : float
        Prior probability that a walk follows axes at right angles. It is low, so that evidence is required.
    sure_log_odds : float
        Log odds from which a walk counts as following axes, and the gyroscope bias is estimated from them. Log odds of
        6 were never reached in malls, rooms and free walks, and are reached after four to six corners of an office.
    n_straight, straight_rad, straight_s : int, float, float
        A straight part (a leg) has at least `n_straight` steps within `straight_s` seconds whose headings differ by at
        most `straight_rad`.
    leg_std_rad : float
        Standard deviation of the direction of a leg about its axis, rad.
    step_std_rad : float
        Standard deviation of the direction of a step, used as an independent measurement, rad. The steps of a leg share
        one error, and with this value two of them give about the information of a leg.
    outlier_prob : float
        Probability that a straight part follows no axis in a building with axes.
    corner_rad : float
        A leg has a new direction if it differs from the last one by more than this angle, rad.
    wander_rad_per_sqrt_s : float
        Random walk of the drift in addition to its rate, rad per square root of a second.
    """

    rate_step_radps: float = 0.001
    max_rate_radps: float = 0.009
    rate_std_radps: float = 0.003
    wild_rate_prob: float = 0.02
    scale_std: float = 0.015
    rectangular_prob: float = 0.05
    sure_log_odds: float = 5.0
    n_straight: int = 4
    straight_rad: float = math.radians(20.0)
    straight_s: float = 4.0
    leg_std_rad: float = math.radians(6.0)
    step_std_rad: float = math.radians(8.0)
    outlier_prob: float = 0.1
    corner_rad: float = math.radians(30.0)
    wander_rad_per_sqrt_s: float = math.radians(0.05)

    def __post_init__(self) -> None:
        check_numbers(self, signed=("sure_log_odds",))

    def init(self) -> CorridorState:
        """Return the state before the first step."""
        n = round(self.max_rate_radps / self.rate_step_radps)
        bank = np.zeros((2 * n + 1, 5, 4))
        mean, cov = bank[:, 0], bank[:, 1:]
        mean[:, _RATE] = self.rate_step_radps * np.arange(-n, n + 1)
        # About half of the spacing, so that the sum of the densities is smooth.
        cov[:, _RATE, _RATE] = (0.6 * self.rate_step_radps) ** 2
        cov[:, _SCALE, _SCALE] = self.scale_std**2
        weight = np.exp(-0.5 * (mean[:, _RATE] / self.rate_std_radps) ** 2)
        weight = (1.0 - self.wild_rate_prob) * weight / weight.sum() + self.wild_rate_prob / len(weight)
        odds = math.log(self.rectangular_prob / (1.0 - self.rectangular_prob))
        return CorridorState(bank, np.log(weight), odds)

    def restart(self, state: CorridorState) -> CorridorState:
        """Return the state after a break in the headings: the drift starts at zero, and no axes are known.

        Each filter of the bank keeps its drift rate with its variance, and its weight. It also keeps its estimate of
        the scale error of the gyroscope, but the variance of this estimate is the prior variance again. The odds that
        the walk follows axes, the total turn and the last legs start again.
        """
        initial = self.init()
        mean, cov = initial.mean, initial.cov
        mean[:] = state.mean
        mean[:, [_DRIFT, _AXIS]] = 0.0
        cov[:, _RATE, _RATE] = state.cov[:, _RATE, _RATE]
        return replace_unchecked(initial, log_weight=state.log_weight)

    def update(self, state: CorridorState, time_s: float, heading_rad: float) -> CorridorState:
        """Return the state after a step with this walking heading, which is not wrapped.

        Each step predicts the drift. Only a step of a straight part is a measurement of the axes. The first straight
        part defines their direction.
        """
        last_s, last_rad = state.recent[-1] if state.recent else (time_s, heading_rad)
        bank = self._predict(state, time_s - last_s, heading_rad - last_rad)
        turned_rad = state.turned_rad + heading_rad - last_rad
        near = [r for r in state.recent if time_s - r[0] < self.straight_s][1 - self.n_straight :]
        recent = (*near, (time_s, heading_rad))
        headings = [h for _, h in recent]
        if len(recent) < self.n_straight or max(headings) - min(headings) > self.straight_rad:
            return replace_unchecked(state, bank=bank, recent=recent, turned_rad=turned_rad)
        last_leg_rad = state.leg_rad
        state = replace_unchecked(state, bank=bank, recent=recent, turned_rad=turned_rad, leg_rad=heading_rad)
        if math.isnan(last_leg_rad):
            mean, cov = state.mean, state.cov
            mean[:, _AXIS] = heading_rad - mean[:, _DRIFT]
            # The direction of the axes is unknown before the first leg, which defines it for any drift.
            cov[:, _AXIS, :], cov[:, :, _AXIS] = -cov[:, _DRIFT, :], -cov[:, :, _DRIFT]
            cov[:, _AXIS, _AXIS] = cov[:, _DRIFT, _DRIFT] + self.leg_std_rad**2
            return state
        is_new = abs(float(wrap_angle(heading_rad - last_leg_rad))) > self.corner_rad
        return self._update_straight(state, heading_rad, is_new)

    def probability(self, state: CorridorState) -> float:
        """Return the probability that the walk follows the axes of a building."""
        return 1.0 / (1.0 + math.exp(-state.log_odds))

    def is_sure(self, state: CorridorState) -> bool:
        """Return True if the log odds that the walk follows the axes of a building reach `sure_log_odds`."""
        return state.log_odds >= self.sure_log_odds

    def drift(self, state: CorridorState) -> tuple[float, float]:
        """Return the drift of the headings since the first step under the hypothesis of axes, rad, and its variance.

        The drift is clockwise: headings are too large by it.
        """
        # The variance of a leg is added, because the steps of the present leg share their deviation from its axis.
        return _mean_and_var(state, state.mean[:, _DRIFT].copy(), state.cov[:, _DRIFT, _DRIFT], self.leg_std_rad**2)

    def drift_in_time(self, state: CorridorState) -> tuple[float, float]:
        """Return the heading drift without the part due to the gyroscope's scale error, rad, and its variance, rad2.

        The part due to the scale error is the total turn since the start times the relative scale error of the
        gyroscope.
        """
        h = np.array([1.0, 0.0, 0.0, -state.turned_rad])
        return _mean_and_var(state, state.mean @ h, state.cov @ h @ h, 0.0)

    def mixture_drift(self, state: CorridorState, free_rad: float, free_var_rad2: float) -> tuple[float, float]:
        """Return the mean and variance of the drift, with and without the hypothesis that the walk follows axes.

        Let p be the probability of axes, d their drift and D its variance. Without axes the drift is b = `free_rad`,
        and its variance B = `free_var_rad2`. The mean is p d + (1 - p) b, and the variance is p D + (1 - p) B +
        p (1 - p) (d - b)^2. Improbable axes whose drift differs much from `free_rad` increase the variance more than
        they reduce it.
        """
        prob, (drift_rad, var_rad2) = self.probability(state), self.drift(state)
        difference_rad = drift_rad - free_rad
        var_rad2 = prob * var_rad2 + (1.0 - prob) * (free_var_rad2 + prob * difference_rad * difference_rad)
        return free_rad + prob * difference_rad, var_rad2

    def _predict(self, state: CorridorState, elapsed_s: float, turned_rad: float) -> FloatArray:
        """Return the bank of filters predicted over an elapsed time and a turn.

        The heading drift grows by elapsed time * drift rate + turn * scale error. The other states do not change.
        """
        drift_row = np.array([1.0, elapsed_s, 0.0, turned_rad])
        bank, product = state.bank.copy(), state.bank.dot(drift_row)
        bank[:, :, _DRIFT] = product
        row = product[:, 1:]
        bank[:, 1 + _DRIFT] = row
        bank[:, 1 + _DRIFT, _DRIFT] = row.dot(drift_row) + self.wander_rad_per_sqrt_s**2 * elapsed_s
        return bank

    def _update_straight(self, state: CorridorState, heading_rad: float, is_new: bool) -> CorridorState:
        """Return the state after a step of a straight part. `is_new` is True for a straight part in a new direction."""
        product = state.bank.dot(_ALONG_AXIS)
        gain = product[:, 1:]
        predicted_var = gain[:, _DRIFT] + gain[:, _AXIS]
        innovation = heading_rad - product[:, 0]
        innovation = innovation - _RIGHT_ANGLE * np.rint(innovation / _RIGHT_ANGLE)
        variance = predicted_var + self.step_std_rad**2
        log_in = self._log_likelihood(innovation, variance)
        by = np.empty_like(product)
        log_any, _, by[:, 0], by_cov = possible_outlier(log_in, self._log_outlier, innovation / variance, variance)
        np.multiply(by_cov[:, None], gain, out=by[:, 1:])
        log_odds = state.log_odds
        if is_new:
            leg_inlier = self._log_likelihood(innovation, predicted_var + self.leg_std_rad**2)
            log_weight = state.log_weight + np.logaddexp(leg_inlier, self._log_outlier)
            log_odds += log_sum(log_weight) + math.log(_RIGHT_ANGLE)
        else:
            # A further step of a leg has less weight than a leg, by the ratio of the variances. The factor 2 allows for
            # the shared error of the steps.
            log_weight = state.log_weight + min(2.0 * (self.leg_std_rad / self.step_std_rad) ** 2, 1.0) * log_any
        return replace_unchecked(
            state,
            bank=state.bank + by[:, :, None] * gain[:, None, :],
            log_weight=log_weight - log_sum(log_weight),
            log_odds=log_odds,
        )

    def _log_likelihood(self, innovation: FloatArray, variance: FloatArray) -> FloatArray:
        """Return the log density of innovations (M,) that are not outliers, times the probability of that."""
        squares = innovation * innovation / variance
        return math.log(1.0 - self.outlier_prob) - 0.5 * (np.log(2 * np.pi * variance) + squares)

    @property
    def _log_outlier(self) -> float:
        """Log density of an outlier, uniform over a right angle, times its probability."""
        return math.log(self.outlier_prob / _RIGHT_ANGLE)


def _mean_and_var(state: CorridorState, means: FloatArray, variances: FloatArray, added: float) -> tuple[float, float]:
    """Return the mean and variance of a quantity over the mixture of all M filters of the bank.

    The quantity has the given means and variances (M,) in the filters. `added` is added to the variance.
    """
    weight = np.exp(state.log_weight)
    mean = float(weight.dot(means))
    deviation = means - mean
    return mean, float(weight.dot(variances + deviation * deviation)) + added
