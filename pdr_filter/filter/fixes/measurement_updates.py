"""Measurement updates by fixes that are functions of position and heading (`values.Measurement`), such as ranges."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pdr_filter.filter.fixes.gating import Result, gap_displacement_var_m2, gated, with_consider_path
from pdr_filter.filter.imm.imm import ImmArithmetic
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET
from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.imm.pedestrian_state import PedestrianState, track_place
from pdr_filter.values import FloatArray, Measurement, measured

# Largest number of linearisations of one update, and the move at which they have converged. After the first few the
# estimate moves by some millimetres, unless it is less certain than the distance to an anchor (`range_placement`).
_MAX_ITERATIONS, _CONVERGED_M = 8, 5e-3
# Upper 0.1 % quantile of the normal distribution.
_NORMAL_QUANTILE = 3.09
# A measurement is rejected if it is more probably an outlier than regular.
_MIN_REGULAR_PROB = 0.5


def high_quantile(n_dimensions: int) -> float:
    """Return the upper 0.1 % quantile of chi-square, by the approximation of Wilson and Hilferty."""
    share = 2.0 / (9.0 * n_dimensions)
    return n_dimensions * (1.0 - share + _NORMAL_QUANTILE * math.sqrt(share)) ** 3


def gate_of(model: PedestrianModel, n_dimensions: int) -> float:
    """Return the largest accepted normalised innovation squared of a measurement with `n_dimensions` components."""
    if n_dimensions <= 2:
        return model.scalar_gate_nis if n_dimensions == 1 else model.fix_gate_nis
    return high_quantile(n_dimensions)


def on_measurement(
    model: PedestrianModel,
    arithmetic: ImmArithmetic,
    state: PedestrianState,
    offset_rad: FloatArray,
    fix: Measurement,
    earlier: FloatArray,
    regular_prob: Callable[[float, float], float] | None = None,
) -> Result:
    """Return the state after a measurement, the outcome, and the normalised innovation squared.

    `earlier` (3,) is east, north and device heading of the track at the time of the measurement. `regular_prob` is for
    scalar measurements: it returns the probability that the measurement is not an outlier, given its residual and the
    variance of the residual.

    Each filter is updated by an iterated extended Kalman filter (B. M. Bell and F. W. Cathey, "The iterated Kalman
    filter update as a Gauss-Newton method", IEEE Trans. Automatic Control 38, 1993). With probability w of a regular
    measurement the estimate moves by w times its correction, and the covariance includes the spread between both cases.
    """
    if not state.frame.is_joined or (len(state.steps.trail) == 0 and _needs_heading(fix, earlier)):
        return state, "nothing to compare", np.nan
    estimates = state.estimates
    cov = estimates.cov.copy()
    cov[:, :2, :2] += estimates.consider_cov_m2
    # The position at the time of the measurement as a function of the present state: errors of heading and scale have
    # changed the displacement since then.
    east_m, north_m = (track_place(state).position_m - earlier[:2]).tolist()
    by_state = np.array([[1.0, 0.0, -north_m, -east_m], [0.0, 1.0, east_m, -north_m]])
    moved_m = earlier[:2] - by_state @ estimates.combined[0]
    gap_var_m2 = gap_displacement_var_m2(model, state, fix.time_s)
    each = [
        _iterated(arithmetic, mean, P, fix, (by_state, moved_m), float(earlier[2]) + own_rad, gap_var_m2, regular_prob)
        for mean, P, own_rad in zip(estimates.mean, cov, offset_rad.tolist(), strict=True)
    ]
    mean, cov_after, log_likelihood, nis = (np.concatenate([result[i] for result in each]) for i in range(4))
    likely, n_dimensions = max(result[4] for result in each), each[0][5]
    if likely < _MIN_REGULAR_PROB:
        return state, "rejected", float(nis.min())
    updated = mean, cov_after, log_likelihood, nis
    after, outcome, best_nis = gated(arithmetic, with_consider_path(state, cov), updated, gate_of(model, n_dimensions))
    if outcome != "used":
        return state, outcome, best_nis
    no_error_m = np.zeros_like(estimates.consider_error_m)
    return replace(after, estimates=replace(after.estimates, consider_error_m=no_error_m)), outcome, best_nis


def _needs_heading(fix: Measurement, earlier: FloatArray) -> bool:
    """Return True if the measurement depends on the heading."""
    return bool(np.any(measured(fix, earlier[:2], float(earlier[2]))[1][:, 2]))


def _iterated(
    arithmetic: ImmArithmetic,
    mean: FloatArray,
    cov: FloatArray,
    fix: Measurement,
    relation: tuple[FloatArray, FloatArray],
    heading_rad: float,
    gap_var_m2: float,
    regular_prob: Callable[[float, float], float] | None,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float, int]:
    """Return the update of one filter by a nonlinear measurement, iterated until its linearisation settles.

    The results are the mean (1, 4), covariance (1, 4, 4), log likelihood (1,), normalised innovation squared (1,), the
    probability that the measurement is not an outlier, and the number of components of the measurement. The position at
    the time of the measurement is B x + b with the present state x (4,) and `relation` = (B, b).
    """
    prior_mean, prior_cov, x = mean[None], cov[None], mean
    linear = _linearised(fix, x, relation, heading_rad, gap_var_m2)
    updated = arithmetic.update(prior_mean, prior_cov, *linear)
    for _ in range(_MAX_ITERATIONS - 1):
        moved_m = updated[0][0, :2] - x[:2]
        if float(np.abs(moved_m).max()) < _CONVERGED_M:
            break
        x = updated[0][0]
        linear = _linearised(fix, x, relation, heading_rad, gap_var_m2)
        updated = arithmetic.update(prior_mean, prior_cov, *linear)
    z, H, R = linear
    after_mean, after_cov, log_likelihood, nis = updated
    if regular_prob is None:
        return after_mean, after_cov, log_likelihood, nis, 1.0, len(z)
    prob = regular_prob(float((H @ mean - z)[0]), float((H @ cov @ H.T + R)[0, 0]))
    moved = prob * (after_mean - prior_mean)
    spread = (1.0 - prob) / max(prob, 1e-12) * moved[:, :, None] * moved[:, None, :]
    mixed_cov = prob * after_cov + (1.0 - prob) * prior_cov + spread
    mixed_likelihood = np.asarray(log_likelihood - math.log(max(prob, 1e-300)), dtype=float)
    return prior_mean + moved, mixed_cov, mixed_likelihood, nis, prob, len(z)


def _linearised(
    fix: Measurement, x: FloatArray, relation: tuple[FloatArray, FloatArray], heading_rad: float, gap_var_m2: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a measurement z (k,), its matrix H (k, 4) and its noise covariance R (k, k), linearised at a state x (4,).

    The linear measurement equation is z = H x + noise of covariance R.
    """
    by_state, shift_m = relation
    residual, by_pose, cov = measured(fix, by_state @ x + shift_m, heading_rad + float(x[HEADING_OFFSET]))
    by_place = by_pose[:, :2]
    H = by_place @ by_state
    H[:, HEADING_OFFSET] += by_pose[:, 2]
    return H @ x - residual, H, cov + gap_var_m2 * by_place @ by_place.T
