"""What the axes of a building say of the heading's drift: a mixture of "this walk keeps to axes" and "it does not".

Straight parts of a walk along corridors differ by right angles, however long ago they were. What is missing to that is
the drift of the heading. The hypothesis of axes holds a bank of Kalman filters, each with another rate of the drift, so
that none of them mistakes an axis for the next one while the drift is uncertain by 45 degrees. Each step of a straight
part is a measurement of the direction modulo 90 degrees, and perhaps of none (Bar-Shalom et al. 2009, as in
`pdr_filter.sensing.gyroscope_bias`). The other hypothesis is that legs point anywhere.

The odds of the two count the first step of a leg in a new direction only: who goes straight on says nothing of axes,
and a slow curve looks like a drift. They begin low, and the drift of the axes counts with its probability: free walks,
circles and curved aisles must cost nothing. So the drift of a walk is known after some corners, and with it all of its
past (docs/methods/heading.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pdr_filter.values import FloatArray, check_numbers, replace_unchecked, wrap_angle
from pdr_filter.values.mixtures import log_sum, possible_outlier

_DRIFT, _RATE, _AXIS, _SCALE = range(4)
_RIGHT_ANGLE = 0.5 * math.pi
_ALONG_AXIS = np.array([1.0, 0.0, 1.0, 0.0])  # drift and axis


@dataclass(frozen=True, eq=False)
class CorridorState:
    """A bank of Kalman filters of drift, its rate and the direction of the axes, and the odds of there being axes."""

    # (M, 5, 4) mean, in rad, rad/s, rad, rad of drift a rad of turning, all clockwise, and below it the covariance:
    # what a measurement sees of both is one product
    bank: FloatArray
    log_weight: FloatArray  # (M,) of probabilities
    log_odds: float  # of axes
    turned_rad: float = 0.0  # since the start
    leg_rad: float = math.nan  # last heading of a straight part; NaN before the first
    recent: tuple[tuple[float, float], ...] = ()  # times and headings of the last steps

    @property
    def mean(self) -> FloatArray:
        """Means (M, 4)."""
        return self.bank[:, 0]

    @property
    def cov(self) -> FloatArray:
        """Covariances (M, 4, 4)."""
        return self.bank[:, 1:]


@dataclass(frozen=True)
class Corridors:
    """Drift of the walking heading from the axes that a walk keeps to.

    Parameters
    ----------
    rate_step_radps, max_rate_radps : float
        The bank has a filter for each rate of the drift from minus to plus the second.
    rate_std_radps, wild_rate_prob : float
        Rates are normal about zero, with this share spread over all of them alike: what is left of the gyroscope's bias
        is 0.001 to 0.003 rad/s on the phones here.
    scale_std : float
        How far the gyroscope's scale is off: 0.01 of data sheets, 0.02 in one phone here, whose walks to the left and
        to the right drift apart.
    rectangular_prob : float
        How often a walk keeps to axes at right angles: rarely, so that it has to be shown.
    sure_log_odds : float
        Log odds from which a walk is said to keep to axes, and the phone's gyroscope learns from them. 6 were never
        reached in malls, rooms and free walks, and are after four to six corners of an office.
    n_straight, straight_rad, straight_s : int, float, float
        So many steps in so short a time are a straight part if their headings are this close together.
    leg_std_rad : float
        How far a leg is off its axis.
    step_std_rad : float
        How far a step is off it, as an independent measurement: the steps of a leg have one error, and two of them say
        together what a leg says.
    outlier_prob : float
        How often a straight part follows no axis where there are some.
    corner_rad : float
        A leg is in a new direction if it is this far from the last.
    wander_rad_per_sqrt_s : float
        Random walk of the drift besides its rate.
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
        """State before the first step."""
        n = round(self.max_rate_radps / self.rate_step_radps)
        bank = np.zeros((2 * n + 1, 5, 4))
        mean, cov = bank[:, 0], bank[:, 1:]
        mean[:, _RATE] = self.rate_step_radps * np.arange(-n, n + 1)
        # half of the distance to the next: the sum of the densities is smooth
        cov[:, _RATE, _RATE] = (0.6 * self.rate_step_radps) ** 2
        cov[:, _SCALE, _SCALE] = self.scale_std**2
        weight = np.exp(-0.5 * (mean[:, _RATE] / self.rate_std_radps) ** 2)
        weight = (1.0 - self.wild_rate_prob) * weight / weight.sum() + self.wild_rate_prob / len(weight)
        odds = math.log(self.rectangular_prob / (1.0 - self.rectangular_prob))
        return CorridorState(bank, np.log(weight), odds)

    def restart(self, state: CorridorState) -> CorridorState:
        """State where headings no longer follow on those before: drift and axes are unknown, the rates may be not."""
        fresh = self.init()
        mean, cov = fresh.mean, fresh.cov
        mean[:] = state.mean
        mean[:, [_DRIFT, _AXIS]] = 0.0
        cov[:, _RATE, _RATE] = state.cov[:, _RATE, _RATE]
        return replace_unchecked(fresh, log_weight=state.log_weight)

    def update(self, state: CorridorState, time_s: float, heading_rad: float) -> CorridorState:
        """State after a step in a direction; headings have any number of turns."""
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
            # the axis is unknown: whatever the drift, this heading is along it
            cov[:, _AXIS, :], cov[:, :, _AXIS] = -cov[:, _DRIFT, :], -cov[:, :, _DRIFT]
            cov[:, _AXIS, _AXIS] = cov[:, _DRIFT, _DRIFT] + self.leg_std_rad**2
            return state
        is_new = abs(float(wrap_angle(heading_rad - last_leg_rad))) > self.corner_rad
        return self._see(state, heading_rad, is_new)

    def probability(self, state: CorridorState) -> float:
        """That the walk keeps to axes."""
        return 1.0 / (1.0 + math.exp(-state.log_odds))

    def is_sure(self, state: CorridorState) -> bool:
        """Whether the odds of axes are overwhelming."""
        return state.log_odds >= self.sure_log_odds

    def drift(self, state: CorridorState) -> tuple[float, float]:
        """By how much headings are too far clockwise since the first step, if there are axes, and its variance."""
        # the steps of the leg that is walked now are off its axis alike
        return _moments(state, state.mean[:, _DRIFT].copy(), state.cov[:, _DRIFT, _DRIFT], self.leg_std_rad**2)

    def drift_in_time(self, state: CorridorState) -> tuple[float, float]:
        """The part of the drift that came with time, not with turning, and its variance."""
        of = np.array([1.0, 0.0, 0.0, -state.turned_rad])
        return _moments(state, state.mean @ of, state.cov @ of @ of, 0.0)

    def mixed(self, state: CorridorState, free_rad: float, free_var_rad2: float) -> tuple[float, float]:
        """Mean and variance of the drift, which is known in another way if the walk keeps to no axes.

        Axes that are improbable, and far from what else is known, add more to the variance than they take away.
        """
        prob, (drift_rad, var_rad2) = self.probability(state), self.drift(state)
        apart_rad = drift_rad - free_rad
        var_rad2 = prob * var_rad2 + (1.0 - prob) * (free_var_rad2 + prob * apart_rad * apart_rad)
        return free_rad + prob * apart_rad, var_rad2

    def _predict(self, state: CorridorState, elapsed_s: float, turned_rad: float) -> FloatArray:
        """Return the predicted bank: drift + elapsed time * rate + turn * scale; other states do not change."""
        drift_row = np.array([1.0, elapsed_s, 0.0, turned_rad])
        bank, seen = state.bank.copy(), state.bank.dot(drift_row)
        bank[:, :, _DRIFT] = seen
        row = seen[:, 1:]
        bank[:, 1 + _DRIFT] = row
        bank[:, 1 + _DRIFT, _DRIFT] = row.dot(drift_row) + self.wander_rad_per_sqrt_s**2 * elapsed_s
        return bank

    def _see(self, state: CorridorState, heading_rad: float, is_new: bool) -> CorridorState:
        """State after a step of a straight part, whose leg is in a new direction or goes on."""
        # a heading along an axis is axis and drift
        seen = state.bank.dot(_ALONG_AXIS)
        gain = seen[:, 1:]
        spread = gain[:, _DRIFT] + gain[:, _AXIS]
        away = heading_rad - seen[:, 0]
        away = away - _RIGHT_ANGLE * np.rint(away / _RIGHT_ANGLE)
        variance = spread + self.step_std_rad**2
        log_in = self._log_likelihood(away, variance)
        by = np.empty_like(seen)
        log_any, _, by[:, 0], by_cov = possible_outlier(log_in, self._log_outlier, away / variance, variance)
        np.multiply(by_cov[:, None], gain, out=by[:, 1:])
        log_odds = state.log_odds
        if is_new:
            of_leg = np.logaddexp(self._log_likelihood(away, spread + self.leg_std_rad**2), self._log_outlier)
            log_weight = state.log_weight + of_leg
            log_odds += log_sum(log_weight) + math.log(_RIGHT_ANGLE)
        else:
            # as much less than a leg as its variance is more, twice because half of its steps are the same error
            log_weight = state.log_weight + min(2.0 * (self.leg_std_rad / self.step_std_rad) ** 2, 1.0) * log_any
        return replace_unchecked(
            state,
            bank=state.bank + by[:, :, None] * gain[:, None, :],
            log_weight=log_weight - log_sum(log_weight),
            log_odds=log_odds,
        )

    def _log_likelihood(self, away: FloatArray, variance: FloatArray) -> FloatArray:
        return math.log(1.0 - self.outlier_prob) - 0.5 * (np.log(2 * np.pi * variance) + away * away / variance)

    @property
    def _log_outlier(self) -> float:
        return math.log(self.outlier_prob / _RIGHT_ANGLE)


def _moments(state: CorridorState, means: FloatArray, variances: FloatArray, besides: float) -> tuple[float, float]:
    """Mean and variance over the bank of what has these in its filters, (M,) each."""
    weight = np.exp(state.log_weight)
    mean = float(weight.dot(means))
    away = means - mean
    return mean, float(weight.dot(variances + away * away)) + besides
