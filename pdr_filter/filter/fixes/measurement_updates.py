"""Measurement updates by fixes that are functions of position and heading (`values.Measurement`), such as ranges."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pdr_filter.filter.fixes.gating import (
    Filters,
    KalmanUpdate,
    Result,
    gap_displacement_var_m2,
    gated_update,
    joined_updates,
    with_consider_path,
)
from pdr_filter.filter.imm.imm import ImmArithmetic
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.pedestrian_state import PedestrianState, track_pose
from pdr_filter.values import FloatArray, Measurement, measurement_of

# Largest number of linearisations of one update, and the move at which they have converged. After the first few the
# estimate moves by some millimetres, unless it is less certain than the distance to an anchor (`range_solutions`).
_MAX_ITERATIONS, _CONVERGED_M = 8, 5e-3
# Upper 0.1 % quantile of the normal distribution.
_NORMAL_QUANTILE = 3.09
# A measurement is rejected if it is more probably an outlier than regular.
_MIN_REGULAR_PROB = 0.5


def high_quantile(n_dimensions: int) -> float:
    """Return the upper 0.1 % quantile of chi-square with `n_dimensions` degrees of freedom.

    It is the approximation of Wilson and Hilferty.
    """
    share = 2.0 / (9.0 * n_dimensions)
    return n_dimensions * (1.0 - share + _NORMAL_QUANTILE * math.sqrt(share)) ** 3


def gate_of(model: PedestrianModel, n_dimensions: int) -> float:
    """Return the largest accepted normalised innovation squared of a measurement with `n_dimensions` components."""
    if n_dimensions <= 2:
        return model.scalar_gate_nis if n_dimensions == 1 else model.fix_gate_nis
    return high_quantile(n_dimensions)


def on_measurement(
    filters: Filters,
    state: PedestrianState,
    fix: Measurement,
    earlier: FloatArray,
    regular_prob: Callable[[float, float], float] | None = None,
) -> Result:
    """Return the state after a measurement, the outcome, and the normalised innovation squared.

    `earlier` (3,) is east, north and device heading of the track at the time of the measurement. `regular_prob` is for
    scalar measurements: it returns the probability that the measurement is not an outlier, given its residual and the
    variance of the residual. If it is below one half for all filters, the measurement is rejected. There is "nothing to
    compare" in a frame that is not joined, or for a measurement of the heading before the first step.

    Each filter is updated by an iterated extended Kalman filter (B. M. Bell and F. W. Cathey, "The iterated Kalman
    filter update as a Gauss-Newton method", IEEE Trans. Automatic Control 38, 1993).
    """
    if not state.frame.is_joined or (len(state.steps.trail) == 0 and _needs_heading(fix, earlier)):
        return state, "nothing to compare", np.nan
    estimates = state.estimates
    cov = estimates.cov.copy()
    cov[:, :2, :2] += estimates.consider_cov_m2
    # The position at the time of the measurement as a function of the present state: errors of heading and scale have
    # changed the displacement since then.
    east_m, north_m = (track_pose(state).position_m - earlier[:2]).tolist()
    by_state = np.array([[1.0, 0.0, -north_m, -east_m], [0.0, 1.0, east_m, -north_m]])
    shift_m = earlier[:2] - by_state @ estimates.combined[0]
    gap_var_m2 = gap_displacement_var_m2(filters, state, fix.time_s)
    each = [
        _filter_update(
            filters.arithmetic,
            (mean[None], P[None]),
            _Observation(fix, by_state, shift_m, float(earlier[2]) + own_rad, gap_var_m2),
            regular_prob,
        )
        for mean, P, own_rad in zip(estimates.mean, cov, filters.offset_rad.tolist(), strict=True)
    ]
    update = joined_updates([result.update for result in each])
    if max(result.regular_prob for result in each) < _MIN_REGULAR_PROB:
        return state, "rejected", float(update.nis.min())
    gate_nis = gate_of(filters.model, each[0].n_dimensions)
    after, outcome, best_nis = gated_update(filters, with_consider_path(state, cov), update, gate_nis)
    if outcome != "used":
        return state, outcome, best_nis
    no_error_m = np.zeros_like(estimates.consider_error_m)
    after = replace(after, estimates=replace(after.estimates, consider_error_m=no_error_m))
    # the rotation that a user-defined measurement determines is unknown, but it is relative to the present north
    return replace(after, frame=replace(after.frame, north_var_rad2=0.0)), outcome, best_nis


def _needs_heading(fix: Measurement, earlier: FloatArray) -> bool:
    """Return True if the measurement depends on the heading."""
    return bool(np.any(measurement_of(fix, earlier[:2], float(earlier[2]))[1][:, 2]))


class _LinearMeasurement(NamedTuple):
    """Measurement equation z = H x + noise of covariance R, with k components."""

    z: FloatArray  # (k,)
    H: FloatArray  # (k, 4)
    R: FloatArray  # (k, k)


@dataclass(frozen=True, slots=True)
class _Observation:
    """A measurement as a function of the present state x (4,) of one filter.

    At the time of the measurement the position was `by_state` x + `shift_m`, and the heading was `heading_rad` plus the
    heading offset in x. `gap_var_m2` is the additional variance of that position along each axis.
    """

    fix: Measurement
    by_state: FloatArray
    shift_m: FloatArray
    heading_rad: float
    gap_var_m2: float

    def linearised(self, x: FloatArray) -> _LinearMeasurement:
        """Return the measurement linearised at a state x (4,)."""
        heading_rad = self.heading_rad + float(x[HEADING_OFFSET])
        residual, by_pose, cov = measurement_of(self.fix, self.by_state @ x + self.shift_m, heading_rad)
        by_place = by_pose[:, :2]
        H = by_place @ self.by_state
        H[:, HEADING_OFFSET] += by_pose[:, 2]
        return _LinearMeasurement(H @ x - residual, H, cov + self.gap_var_m2 * by_place @ by_place.T)


class _FilterUpdate(NamedTuple):
    """Update of one filter by a measurement."""

    update: KalmanUpdate
    regular_prob: float  # probability that the measurement is not an outlier
    n_dimensions: int  # number of components of the measurement


def _filter_update(
    arithmetic: ImmArithmetic,
    prior: tuple[FloatArray, FloatArray],
    observation: _Observation,
    regular_prob: Callable[[float, float], float] | None,
) -> _FilterUpdate:
    """Return the update of one filter, from its prior mean (1, 4) and covariance (1, 4, 4).

    With `regular_prob`, the result is a mixture of the update and the prior, for a measurement that may be an outlier.
    """
    update, linear = _iterated(arithmetic, prior, observation)
    if regular_prob is None:
        return _FilterUpdate(update, 1.0, len(linear.z))
    (mean,), (cov,) = prior
    innovation_var = linear.H @ cov @ linear.H.T + linear.R
    prob = regular_prob(float((linear.H @ mean - linear.z)[0]), float(innovation_var[0, 0]))
    return _FilterUpdate(_mixed(prior, update, prob), prob, len(linear.z))


def _iterated(
    arithmetic: ImmArithmetic, prior: tuple[FloatArray, FloatArray], observation: _Observation
) -> tuple[KalmanUpdate, _LinearMeasurement]:
    """Return the update by a nonlinear measurement, and the linearisation at which the iterations converged."""
    x = prior[0][0]
    linear = observation.linearised(x)
    update = KalmanUpdate(*arithmetic.update(*prior, *linear))
    for _ in range(_MAX_ITERATIONS - 1):
        moved_m = update.mean[0, :2] - x[:2]
        if float(np.abs(moved_m).max()) < _CONVERGED_M:
            break
        x = update.mean[0]
        linear = observation.linearised(x)
        update = KalmanUpdate(*arithmetic.update(*prior, *linear))
    return update, linear


def _mixed(prior: tuple[FloatArray, FloatArray], regular: KalmanUpdate, prob: float) -> KalmanUpdate:
    """Return the moments of a mixture: the regular update with the probability p, and the prior for an outlier.

    The means of the two components differ by the correction d of the regular update. The mixture has the mean
    m + p d and the covariance p P_regular + (1 - p) P_prior + p (1 - p) d d^T. The last term is the spread of the two
    means about the mean of the mixture. By Bayes' rule, the likelihood of the mixture is that of the regular update
    divided by p, up to a constant factor.
    """
    prior_mean, prior_cov = prior
    moved = prob * (regular.mean - prior_mean)  # p d
    spread = (1.0 - prob) / max(prob, 1e-12) * moved[:, :, None] * moved[:, None, :]
    cov = prob * regular.cov + (1.0 - prob) * prior_cov + spread
    log_likelihood = np.asarray(regular.log_likelihood - math.log(max(prob, 1e-300)), dtype=float)
    return KalmanUpdate(prior_mean + moved, cov, log_likelihood, regular.nis)
