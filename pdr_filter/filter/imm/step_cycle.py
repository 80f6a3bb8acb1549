"""One step in each of F filters: drift of the heading, its measurement, and displacement.

This is the mode-matched filtering of the IMM cycle, steps 2 and 3 of "One step" in docs/methods/imm.md, between
interaction (1, `imm.mix`) and the update of the mode probabilities (4, `imm.update_mode_prob`). `ImmTracker` has one
filter for each mode, `WeightedTracker` a single one for the weighted step. The state of a filter is (east in m, north
in m, heading offset in rad, log step scale).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pdr_filter.filter.imm.estimates import Estimates
from pdr_filter.filter.imm.imm import predict_cov
from pdr_filter.filter.imm.motion_model import (
    EAST,
    HEADING_OFFSET,
    LOG_SCALE,
    MAX_HEADING_VARIANCE,
    N_STATES,
    NORTH,
    Directions,
    MotionNoise,
    bound_heading_variance,
)
from pdr_filter.values import FloatArray, Step, read_only, replace_unchecked, wrap_angle

_IDENTITY = read_only(np.eye(N_STATES))
# Lower bound of a divisor, in case the offset is known exactly: the square of a microradian.
_MIN_HEADING_VARIANCE = 1e-12


@dataclass(frozen=True, slots=True)
class HeadingZero:
    """Heading offset that is the zero of the offset in the filter states: the first measured one."""

    offset_rad: float = 0.0  # walking heading minus device heading at the first step with a measured walking heading
    time_s: float = math.inf  # contact of this step, or infinity before it


class Cycle(NamedTuple):
    """One step in F filters, before its evidence for the modes."""

    # Estimates before the step. For the IMM these are the mixed estimates, with predicted mode probabilities.
    before: Estimates
    unstepped_var_m2: float  # variance of the motion without steps before the step
    drifted_cov: FloatArray  # (F, 4, 4) covariances after the drift of the heading offset, before its measurement
    # Moments (F, 4) and (F, 4, 4) after the measured heading, before the displacement.
    turned_mean: FloatArray
    turned_cov: FloatArray
    zero: HeadingZero  # zero of the heading offset after the step
    ahead: Estimates  # estimates after the displacement
    motion: StepMotion  # displacement of each filter
    by_state: FloatArray  # (F, 4, 4) derivative of the state after the displacement with respect to the state before it


def step_cycle(
    before: Estimates,
    zero: HeadingZero,
    step: Step,
    since: tuple[float, float],
    lengths: tuple[FloatArray, FloatArray],
    directions: Directions,
    noise: MotionNoise,
) -> Cycle:
    """Return the estimates of F filters over one step: drift, heading update, displacement and covariance.

    - Heading (2 of "One step"). The offset drifts for the time since the previous step, because the heading stage
      assumes this drift for its measurement (`predict_heading`). The position becomes less certain by motion without
      steps. Then the measured heading updates each filter (`update_heading`). The first one defines the zero of the
      heading offset instead.
    - Displacement (3). Each filter moves by its own length and direction, P = F P F' + Q (`advance`).

    `since` are the time since the previous step in s, and the variance in m2 of the motion without steps in it.
    `lengths` are the length of the step in m and its variance in m2 in each filter, (F,) each.
    """
    elapsed_s, unstepped_var_m2 = since
    mean, drifted_cov = before.mean, predict_heading(before.cov, step, elapsed_s, directions, noise)
    if unstepped_var_m2:
        drifted_cov[:, [EAST, NORTH], [EAST, NORTH]] += unstepped_var_m2
    cov = drifted_cov
    if math.isfinite(step.walking_heading_std_rad) and not step.states_heading:
        if math.isinf(zero.time_s):
            offset_rad = float(wrap_angle(step.walking_heading_rad - step.device_heading_rad))
            zero, cov = HeadingZero(offset_rad, step.time_s), expect_first_direction(cov, step.walking_heading_std_rad)
        else:
            mean, cov = update_heading(mean, cov, step, zero.offset_rad)
    motion, ahead_mean, ahead_cov, by_state = advance(mean, cov, step, *lengths, directions, noise)
    ahead = replace_unchecked(before, mean=ahead_mean, cov=ahead_cov, walked_m=before.walked_m + motion.length_m)
    return Cycle(before, unstepped_var_m2, drifted_cov, mean, cov, zero, ahead, motion, by_state)


def predict_heading(
    cov: FloatArray, step: Step, elapsed_s: float, directions: Directions, noise: MotionNoise
) -> FloatArray:
    """Return the covariances (..., M, 4, 4) at a step with the drift of the heading offset, before the displacement.

    The offset drifts for `elapsed_s`, the time since the previous step, even while the phone lies on a table. If the
    phone was moved to another place on the body, the offset may have changed. Its variance then also grows by
    `offset_change_std_rad` squared.
    """
    measured_var, unmeasured_var = noise.heading_drift.variances_rad2(
        elapsed_s, step.heading_unknown_s, step.yaw_bias_std_radps, directions.drift_rad2_per_s
    )
    cov = cov.copy()
    cov[..., HEADING_OFFSET, HEADING_OFFSET] += measured_var + unmeasured_var + step.offset_change_std_rad**2
    return bound_heading_variance(cov)


def update_heading(mean: FloatArray, cov: FloatArray, step: Step, frame_rad: float) -> tuple[FloatArray, FloatArray]:
    """Return means (..., M, 4) and covariances (..., M, 4, 4) updated with the measured walking heading of a step.

    The measured walking heading z is the direction that the body faces. Its prediction is frame_rad + device heading +
    offset state, and the innovation is wrapped. The gain is K = P[o, o] / (P[o, o] + r), with o the index of the
    heading offset and r the variance of z. A mode that walks sideways adds its own angle later. `frame_rad` is the
    heading offset that counts as zero. A step without a measured walking heading (infinite standard deviation) changes
    nothing.

    The update also corrects earlier steps. Steps since the heading became uncertain are rotated by the correction delta
    = K innovation. A linear update would move the position p along the tangent, by the lever l = P[p, o] / P[o, o]
    times delta. Write l = J d with J (east, north) = (north, -east), where d is the displacement that rotates with the
    offset. Let R(delta) be the clockwise rotation by delta. This update moves the position along the arc instead, to p
    + (R(delta) - I) d = p + sin(delta) l + (cos(delta) - 1) d. The move is never longer than twice the length of d. The
    lever rotates as well: P[p, :] gains (R(delta) - I) l P[o, :].
    """
    o = HEADING_OFFSET
    variance = step.walking_heading_std_rad**2
    if not math.isfinite(variance):
        return mean, cov
    innovation = wrap_angle(step.walking_heading_rad - step.device_heading_rad - frame_rad - mean[..., o])
    by_offset = cov[..., :, o] / np.maximum(cov[..., o, o], _MIN_HEADING_VARIANCE)[..., None]
    gain = cov[..., o, o] / (cov[..., o, o] + variance)
    correction_rad = gain * innovation
    cov = cov - gain[..., None, None] * by_offset[..., :, None] * cov[..., None, o, :]
    sine, versine = np.sin(correction_rad), 1.0 - np.cos(correction_rad)
    lever_east, lever_north = by_offset[..., EAST], by_offset[..., NORTH]
    # d = -J l, with J (east, north) = (north, -east)
    moved_east = sine * lever_east + versine * lever_north
    moved_north = sine * lever_north - versine * lever_east
    updated_mean = mean + by_offset * correction_rad[..., None]
    updated_mean[..., EAST] = mean[..., EAST] + moved_east
    updated_mean[..., NORTH] = mean[..., NORTH] + moved_north
    # (R(delta) - I) l is the move (R(delta) - I) d rotated by J
    turn = np.empty(cov.shape)
    turn[...] = _IDENTITY
    turn[..., EAST, o] = moved_north
    turn[..., NORTH, o] = -moved_east
    cov = turn @ cov @ turn.swapaxes(-1, -2)
    return updated_mean, 0.5 * (cov + cov.swapaxes(-1, -2))


def expect_first_direction(cov: FloatArray, std_rad: float) -> FloatArray:
    """Return covariances (..., M, 4, 4) in which the heading offset is as uncertain as the first walking heading.

    The first walking heading defines the direction of the frame, so that it causes no innovation. The heading offset
    then has the standard deviation `std_rad` of this heading, because later walking headings can correct only this
    uncertainty. The direction of earlier steps has the same uncertainty, because the offset rotates them.

    Let c be the covariance of the offset with all states, v the variance of the offset, and r = std_rad^2 / v. The
    covariance of all states changes by (r - 1) c c' / v. In particular, c becomes r c and v becomes std_rad^2.
    """
    o = HEADING_OFFSET
    cov = cov.copy()
    std_rad = min(std_rad, float(np.sqrt(MAX_HEADING_VARIANCE)))
    c, variance = cov[..., :, o].copy(), np.maximum(cov[..., o, o], _MIN_HEADING_VARIANCE)
    ratio = std_rad**2 / variance
    cov += ((ratio - 1) / variance)[..., None, None] * c[..., :, None] * c[..., None, :]
    return cov


class Advance(NamedTuple):
    """Prediction of one step for all modes."""

    motion: StepMotion  # displacement of each mode
    mean: FloatArray  # (..., M, 4) predicted means
    cov: FloatArray  # (..., M, 4, 4) predicted covariances
    # (..., M, 4, 4) F, the derivative of the predicted state with respect to the state before the step.
    by_state: FloatArray


def advance(
    mean: FloatArray,
    cov: FloatArray,
    step: Step,
    length_m: FloatArray,
    length_var_m2: FloatArray,
    directions: Directions,
    noise: MotionNoise,
) -> Advance:
    """Return the prediction of a step, with one length for each mode.

    The state is the position p, the heading offset o and the log scale s, with covariance P. Step k changes it to p_k =
    p_{k-1} + d, with the displacement d of `StepMotion`, and s_k = a s_{k-1}, with the decay a of `MotionNoise`. The
    covariance is P_k = F P_{k-1} F' + Q, with the derivative F of the new state by the old one and the process noise Q.
    The drift of the heading offset is not included (see `predict_heading`).
    """
    heading_rad, offset_rad, log_scale = step.reference_heading_rad, mean[..., HEADING_OFFSET], mean[..., LOG_SCALE]
    motion = step_motion(heading_rad, offset_rad, log_scale, length_m, length_var_m2, directions, step.turned_rad)
    # separate components: for so few numbers broadcasting takes longer than the products
    east_m, north_m = motion.length_m * motion.sine, motion.length_m * motion.cosine
    predicted_mean = mean.copy()
    predicted_mean[..., EAST] += east_m
    predicted_mean[..., NORTH] += north_m
    predicted_mean[..., LOG_SCALE] *= noise.log_scale_memory
    F, Q = np.empty((2, *mean.shape, N_STATES))
    F[...], Q[...] = noise.of_log_scale
    F[..., EAST, HEADING_OFFSET] = F[..., NORTH, LOG_SCALE] = north_m
    F[..., NORTH, HEADING_OFFSET], F[..., EAST, LOG_SCALE] = -east_m, east_m
    # var(along) u u' + var(across) v v', and u u' + v v' = I
    excess_m2, isotropic_m2 = motion.var_along_m2 - motion.var_across_m2, motion.var_across_m2 + directions.extra_var_m2
    excess_east_m2 = excess_m2 * motion.sine
    Q[..., EAST, EAST] = excess_east_m2 * motion.sine + isotropic_m2
    Q[..., EAST, NORTH] = Q[..., NORTH, EAST] = excess_east_m2 * motion.cosine
    Q[..., NORTH, NORTH] = excess_m2 * motion.cosine * motion.cosine + isotropic_m2
    return Advance(motion, predicted_mean, predict_cov(cov, F, Q), F)


class StepMotion(NamedTuple):
    """Displacements of steps with their variances.

    Each array is (..., M), for M modes and any leading axes of steps or pedestrians. The displacement is d = L e^s u,
    with u = [sin psi, cos psi] and psi = device heading + heading offset + offset of the mode. Its covariance is
    (e^s)^2 var(L) u u' + (L e^s)^2 var(psi) v v', with u along and v across the step.
    """

    sine: FloatArray  # sin psi
    cosine: FloatArray  # cos psi
    scale: FloatArray  # step scale e^s of the person
    length_m: FloatArray  # length L e^s in m
    var_along_m2: FloatArray  # variance along the step in m2
    var_across_m2: FloatArray  # variance across the step in m2

    @property
    def along(self) -> FloatArray:
        """Unit vector u along each step, (..., M, 2)."""
        along = np.empty((*self.sine.shape, 2))
        along[..., EAST], along[..., NORTH] = self.sine, self.cosine
        return along

    @property
    def across(self) -> FloatArray:
        """Unit vector across each step, (..., M, 2): the derivative of the vector along the step by the heading."""
        return self.along[..., ::-1] * (1.0, -1.0)


def step_motion(
    device_heading_rad: FloatArray | float,
    heading_offset_rad: FloatArray | float,
    log_scale: FloatArray | float,
    length_m: FloatArray,
    length_var_m2: FloatArray,
    directions: Directions,
    turned_rad: FloatArray | float,
) -> StepMotion:
    """Return the displacements of steps with lengths (..., M) and the range `turned_rad` of possible directions."""
    scale = np.exp(log_scale)
    scaled_m = length_m * scale
    psi = device_heading_rad + heading_offset_rad + directions.heading_offset_rad
    return StepMotion(
        sine=np.sin(psi),
        cosine=np.cos(psi),
        scale=scale,
        length_m=scaled_m,
        var_along_m2=scale * scale * length_var_m2,
        var_across_m2=scaled_m * scaled_m * directions.step_var_rad2(turned_rad),
    )
