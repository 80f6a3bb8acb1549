"""Parts of a measurement update that all kinds of fixes share: gating, and displacement since the time of the fix."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pdr_filter.filter.imm.imm import ImmArithmetic
from pdr_filter.filter.imm.motion_model import EAST, NORTH
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.pedestrian_state import PedestrianState, with_change, with_moved_past
from pdr_filter.filter.pedestrian.step_history import TRAIL_TIME
from pdr_filter.values import FixOutcome, FloatArray

Result = tuple[PedestrianState, FixOutcome, float]


class Filters(NamedTuple):
    """Constants of the F filters of a tracker that an update by a fix needs."""

    model: PedestrianModel
    arithmetic: ImmArithmetic
    offset_rad: FloatArray  # (F,) walking heading of each filter minus the heading that the body faces


class KalmanUpdate(NamedTuple):
    """Estimates of F filters after a measurement, as returned by `ImmArithmetic.update`."""

    mean: FloatArray  # (F, 4)
    cov: FloatArray  # (F, 4, 4)
    log_likelihood: FloatArray  # (F,)
    nis: FloatArray  # normalised innovation squared (F,)


def joined_updates(updates: Sequence[KalmanUpdate]) -> KalmanUpdate:
    """Return the updates of single filters as one update of all filters."""
    return KalmanUpdate(*(np.concatenate(arrays) for arrays in zip(*updates, strict=True)))


def gated_update(filters: Filters, state: PedestrianState, update: KalmanUpdate, gate_nis: float) -> Result:
    """Return the state after an update, the outcome "used" or "rejected", and the NIS of the mixture of all filters.

    With the probability p_f and the NIS q_f of filter f, the NIS of the mixture is -2 log sum_f p_f exp(-q_f / 2). A
    filter therefore explains a measurement only if it is probable itself: one for sideways steps does not confirm a
    heading that is 90 degrees off while the pedestrian walks ahead. If the NIS exceeds the gate, the update is rejected
    and the state unchanged. A used update also shifts the stored past positions, by the correction of the present
    position.
    """
    mode_prob, least = state.estimates.prob, float(update.nis.min())
    share = float(mode_prob @ np.exp(-0.5 * (update.nis - least))) / float(mode_prob.sum())
    nis = least - 2.0 * math.log(share) if share > 0.0 else math.inf
    if not nis <= gate_nis:
        return state, "rejected", nis
    prior_x, _ = state.estimates.combined
    prob = filters.arithmetic.update_mode_prob(mode_prob, update.log_likelihood)
    state = replace(state, estimates=replace(state.estimates, mean=update.mean, cov=update.cov, prob=prob))
    moved = state.estimates.combined[0] - prior_x
    state, shift_m = with_change(state, lambda path: path.after_correction(moved, 1.0)), moved[[EAST, NORTH]]
    return with_moved_past(state, lambda position_m: position_m + shift_m), "used", nis


def with_consider_path(state: PedestrianState, cov: FloatArray) -> PedestrianState:
    """Return the state with a path of past steps that also includes the errors of the consider parameters.

    `cov` (F, 4, 4) are the covariances of the filters after the caller has added `consider_cov_m2` to their position
    part. The path attributes these errors to the past steps, too (`PastPath.with_shared`). The estimates of the state
    are unchanged.
    """
    estimates = state.estimates
    x, P = estimates.combined
    _, grown_P = replace(estimates, cov=cov).combined
    shared_m2, end_s, present_m = estimates.consider_cov_m2, state.steps.end_s, x[:2].copy()
    return with_change(state, lambda path: path.with_shared(P, shared_m2, grown_P, end_s, present_m))


def gap_displacement_var_m2(filters: Filters, state: PedestrianState, time_s: float) -> float:
    """Return the variance along each axis of the displacement in the gap after a time, or 0 without a gap.

    Only the part of the gap after that time counts.
    """
    gap_s, trail = state.steps.gap_s, state.steps.trail
    if gap_s == 0.0 or len(trail) == 0:
        return 0.0
    into_gap_s = max(time_s - float(trail[-1, TRAIL_TIME]), 0.0)
    return 0.0 if gap_s <= into_gap_s else float(filters.model.noise.gap_var_m2(gap_s - into_gap_s))
