"""Preintegration: the steps between two anchors summed into one relative factor before the problem is solved.

In the frame of the heading offset and the scale at the start of an interval, its steps add up to one displacement D,

    p_b = p_a + e^s_a R(theta_a) D,  theta_b = theta_a,  s_b = s_a,  and noise of covariance T Q T',
    T = diag(e^s_a R(theta_a), 1, 1),

so that D and Q are computed once, however often the solver linearises (the idea of C. Forster et al., "On-manifold
preintegration for real-time visual-inertial odometry", IEEE T-RO 33, 2017).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdr_filter.filter.imm.motion_model import (
    EAST,
    HEADING_OFFSET,
    LOG_SCALE,
    MAX_HEADING_VARIANCE,
    N_STATES,
    Directions,
    Mode,
    MotionNoise,
    step_motion,
)
from pdr_filter.filter.step_length.models import StepLengths, uneven_var_m2
from pdr_filter.values import FloatArray, IntArray, Table, read_only, steps_of

# d R(theta) / d theta = TURN @ R(theta): headings are clockwise, vectors (east, north).
TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])
_POSITION = slice(EAST, EAST + 2)
# Smallest variances: a tenth of a millimetre, a thousandth of a milliradian. Without them, a step of exactly known
# length would have a singular covariance.
_MIN_POSITION_VAR_M2 = 1e-8
MIN_STATE_VAR = 1e-12
# Smaller changes of the heading offset are ignored. The heading stage uses them to correct an error that the filter
# detected late. The smoother processes all steps at once and does not need them. A phone that is moved to another place
# has a change of 1.8 rad.
_MIN_CHANGE_STD_RAD = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Increments:
    """Displacement and noise of each of K steps, before the person's scale and heading offset.

    The events have the same order as in the filter: the gap, the change of the heading offset and its drift since the
    previous step, then the measured walking heading, then the displacement, and last the drift of the scale.

    Attributes
    ----------
    time_s : array (K,)
        Times of the contacts.
    duration_s : array (K,)
        Durations of the steps.
    displacement_m : array (K, 2)
        East and north displacement, from device heading and modes.
    cov_m2 : array (K, 2, 2)
        Covariance of the displacement, independent between steps.
    drift_var_rad2 : array (K,)
        Variance of the drift of the heading offset before the step.
    unknown_var_rad2 : array (K,)
        Variance of the heading offset from time without angular rate, before the step.
    scale_drift_var : array (K,)
        Variance of the drift of the log scale after the step.
    jump_var_rad2 : array (K,)
        Variance of a change of the heading offset before the step: the phone was moved, or samples are missing.
    gap_var_m2 : array (K,)
        Variance of the position from walking without samples before the step.
    """

    time_s: FloatArray
    duration_s: FloatArray
    displacement_m: FloatArray
    cov_m2: FloatArray
    drift_var_rad2: FloatArray
    unknown_var_rad2: FloatArray
    scale_drift_var: FloatArray
    jump_var_rad2: FloatArray
    gap_var_m2: FloatArray

    def __len__(self) -> int:
        return len(self.time_s)

    def part(self, first: int, end: int) -> Increments:
        """Return the increments of the steps from index `first` to `end` - 1."""
        return Increments(*(getattr(self, name)[first:end] for name in self.__slots__))


def increments(
    steps: Table,
    mode_prob: FloatArray,
    modes: Sequence[Mode],
    noise: MotionNoise,
    gap_before_s: FloatArray,
) -> tuple[Increments, float]:
    """Return the increments of detected steps, and the variance of the log scale from the step-length parameters.

    The displacement of a step is the mean over the M modes, sum_m mu_m L_m u(psi + o_m), with the covariance of the
    mixture. For mode m, mu_m is the probability, L_m the step length and o_m the heading offset. psi is the device
    heading, and u the unit vector of a heading. All steps share the error of the fitted step-length parameters. The
    second result is therefore the mean of J cov J' / L^2 over steps and modes. J is the derivative of L by the
    parameters, and cov is their covariance. This is an approximation for several parameters. `mode_prob` is (K, M), and
    `gap_before_s` (K,) is the time without samples before each step.
    """
    n = len(steps)
    lengths = StepLengths(tuple(m.step_length for m in modes))
    each = steps_of(steps)
    found = [lengths.predict(step) for step in each]
    moves = np.array([m.moves for m in modes])
    length_m = np.array([f[0] for f in found]).reshape(n, len(modes)) * moves
    variance = np.array([f[1] for f in found]).reshape(n, len(modes))
    residual_var = np.array([m.step_length.residual_std_m**2 for m in modes])
    shared_var = mode_prob * moves * (variance - residual_var) / np.maximum(length_m, 0.1) ** 2

    directions = Directions.of(modes)
    device_heading_rad = np.asarray(steps.device_heading_rad)[:, None]
    own_var = residual_var + np.array([uneven_var_m2(step) for step in each]).reshape(n, 1) * moves
    turned_rad = np.array([step.turned_rad for step in each]).reshape(n, 1)
    move = step_motion(device_heading_rad, 0.0, 0.0, length_m, own_var, directions, turned_rad)
    along, across = move.along, move.across
    displacement_m = move.length_m[..., None] * along
    displacement = np.einsum("km,kma->ka", mode_prob, displacement_m)
    apart = displacement_m - displacement[:, None]
    cov = (
        np.einsum("km,kma,kmb->kab", mode_prob * move.var_along_m2, along, along)
        + np.einsum("km,kma,kmb->kab", mode_prob * move.var_across_m2, across, across)
        + np.einsum("km,kma,kmb->kab", mode_prob, apart, apart)
        + (mode_prob @ directions.extra_var_m2)[:, None, None] * np.eye(2)
    )
    elapsed_s = _elapsed_s(steps, gap_before_s)
    drift_var, unknown_var = noise.heading_drift.variances_rad2(
        elapsed_s,
        np.asarray(steps.heading_unknown_s),
        np.asarray(steps.yaw_bias_std_radps),
        mode_prob @ directions.drift_rad2_per_s,
    )
    change_std_rad = np.asarray(steps.offset_change_std_rad)
    change_std_rad = np.where(change_std_rad < _MIN_CHANGE_STD_RAD, 0.0, change_std_rad)
    jump_var = change_std_rad**2 + noise.heading_drift.unmeasured_rad2(gap_before_s)
    walking = Increments(
        time_s=np.asarray(steps.time_s),
        duration_s=np.asarray(steps.duration_s),
        displacement_m=displacement,
        cov_m2=cov,
        drift_var_rad2=drift_var,
        unknown_var_rad2=unknown_var,
        scale_drift_var=np.full(n, noise.log_scale_drift_var),
        jump_var_rad2=np.minimum(jump_var, MAX_HEADING_VARIANCE),
        gap_var_m2=noise.gap_var_m2(gap_before_s),
    )
    return walking, float(shared_var.sum(axis=1).mean()) if n else 0.0


def _elapsed_s(steps: Table, gap_before_s: FloatArray) -> FloatArray:
    """Return the time since the previous step, for each of K steps, in s.

    The first step, and the first step after a gap, have their own duration.
    """
    time_s, duration_s = np.asarray(steps.time_s), np.asarray(steps.duration_s)
    elapsed_s = np.concatenate([duration_s[:1], np.diff(time_s)])
    return np.maximum(np.where(gap_before_s > 0, duration_s, elapsed_s), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """Steps summed between anchors, with displacement D and covariance Q.

    D is the displacement in m in the frame of the heading offset and scale at the start of an interval. Q is the
    covariance of the state (east, north, heading offset, log scale) that the steps add, in the same frame.

    Attributes
    ----------
    nodes : array (n + 1,)
        Number of steps before each anchor, from 0 to K.
    index : array (K,)
        Interval of each step.
    sum_m : array (K, 2)
        D from the start of the interval to the contact of each step.
    cov : array (K, 4, 4)
        Q from the start of the interval to the contact of each step. It excludes a gap or a change of the heading
        offset after the contact.
    total_m : array (n, 2)
        D of each whole interval.
    total_cov : array (n, 4, 4)
        Q of each whole interval, including a gap and a change of the heading offset at its end.
    whiten : array (n, 4, 4)
        Inverse of the lower Cholesky factor of `total_cov`.
    """

    nodes: IntArray
    index: IntArray
    sum_m: FloatArray
    cov: FloatArray
    total_m: FloatArray
    total_cov: FloatArray
    whiten: FloatArray

    def __len__(self) -> int:
        return len(self.total_m)


def preintegrate(steps: Increments, nodes: IntArray) -> Intervals:
    """Return the steps summed between anchors, in time proportional to the number of steps.

    D is the sum of all steps of an interval, and D_i the sum of its first i steps. C_i is the covariance of step i, and
    q_i and r_i are the drift variances of heading offset and log scale. J is the rotation by a right angle. The
    position covariance is Q_pp = sum C_i + sum q_i J b_i (J b_i)' + sum r_i d_i d_i', with b_i = D - D_{i-1} and d_i =
    D - D_i. The other blocks are similar (docs/methods/smoothing.md). The sums over i are differences of cumulative
    sums, for all steps at once. ValueError unless `nodes`, the numbers of steps before the anchors, increase from 0 to
    the number of steps.
    """
    if len(nodes) < 2 or nodes[0] != 0 or nodes[-1] != len(steps) or (np.diff(nodes) < 1).any():
        raise ValueError(f"anchors must increase from 0 to the number of steps, {len(steps)}, got {nodes}")
    count = np.diff(nodes)
    index = np.repeat(np.arange(len(count)), count)
    first = nodes[:-1][index]

    def within(values: FloatArray) -> FloatArray:
        """Return the sums from the start of each step's interval to the step itself."""
        total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
        return total[1:] - total[first]

    displacement, cov = _moments(steps, first)
    certain = np.linalg.eigvalsh(cov)[:, 0] < _MIN_POSITION_VAR_M2
    cov = np.where(certain[:, None, None], cov + _MIN_POSITION_VAR_M2 * np.eye(2), cov)
    D = within(displacement)
    Q = np.zeros((len(steps), N_STATES, N_STATES))
    Q[:, _POSITION, _POSITION] = within(cov)
    # A drift rotates or scales the path from the drift to the end of the interval, which is D minus the sum at the
    # drift. The heading drifts before its step, the scale after it. The drift before the first step belongs to the
    # previous interval.
    heading_var = np.where(np.arange(len(steps)) == first, 0.0, steps.drift_var_rad2)
    for state, variance, lever, at in (
        (HEADING_OFFSET, heading_var, D @ TURN.T, (D - displacement) @ TURN.T),
        (LOG_SCALE, steps.scale_drift_var, D, D),
    ):
        v = np.maximum(variance, MIN_STATE_VAR)
        s0, s1 = within(v), within(v[:, None] * at)
        s2 = within(v[:, None, None] * at[:, :, None] * at[:, None, :])
        cross = lever[:, :, None] * s1[:, None, :]
        Q[:, _POSITION, _POSITION] += s0[:, None, None] * lever[:, :, None] * lever[:, None, :] + s2
        Q[:, _POSITION, _POSITION] -= cross + cross.swapaxes(-1, -2)
        Q[:, _POSITION, state] = s0[:, None] * lever - s1
        Q[:, state, _POSITION] = Q[:, _POSITION, state]
        Q[:, state, state] = s0

    last = nodes[1:] - 1
    end = np.zeros((len(count), N_STATES, N_STATES))
    inner = nodes[1:-1]  # events before a step belong to the interval that ends there
    end[:-1, _POSITION, _POSITION] = steps.gap_var_m2[inner][:, None, None] * np.eye(2)
    end[:-1, HEADING_OFFSET, HEADING_OFFSET] = steps.jump_var_rad2[inner] + steps.drift_var_rad2[inner]
    end[:-1, HEADING_OFFSET, HEADING_OFFSET] += steps.unknown_var_rad2[inner]
    # without angular rate, `_moments` shortens the path to the end, and the offset at the end is free
    unknown_var = np.where(np.arange(len(steps)) == first, 0.0, steps.unknown_var_rad2)
    end[:, HEADING_OFFSET, HEADING_OFFSET] += within(unknown_var)[last]
    turned = end[:, HEADING_OFFSET, HEADING_OFFSET]
    end[:, HEADING_OFFSET, HEADING_OFFSET] = np.minimum(turned, MAX_HEADING_VARIANCE)
    total_cov = Q[last] + end
    return Intervals(nodes, index, D, Q, D[last], total_cov, read_only(np.linalg.inv(np.linalg.cholesky(total_cov))))


def _moments(steps: Increments, first: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean (K, 2) and covariance (K, 2, 2) of the displacement of each step.

    Both are conditional on the heading at the start of the step's interval. `first` (K,) is the first step of that
    interval. Without a measured angular rate, the heading has a variance V that grows from step to step. The mean
    displacement of a step d is then shortened to exp(-V / 2) d. Let S be the sum of the displacements from the start of
    the interval to a step, with E |S|^2 = sum_ij d_i . d_j exp(-|V_i - V_j| / 2). The variance of S is the difference
    of E |S|^2 and |E S|^2. The increase of this variance by a step is added to the covariance of the step, half on each
    axis.
    """
    if not steps.unknown_var_rad2.any():
        return steps.displacement_m, steps.cov_m2
    displacement, cov = steps.displacement_m.copy(), steps.cov_m2.copy()
    variance = 0.0
    mean, ahead = np.zeros(2), np.zeros(2)  # E S, and E S relative to the current heading
    square = 0.0  # E |S|^2
    spread = 0.0
    for k, (d, grown) in enumerate(zip(steps.displacement_m, steps.unknown_var_rad2, strict=True)):
        if k == first[k]:
            variance, square, spread = 0.0, 0.0, 0.0
            mean, ahead = np.zeros(2), np.zeros(2)
        else:
            variance += grown
            ahead = np.exp(-grown / 2) * ahead
        displacement[k] = np.exp(-variance / 2) * d
        mean = mean + displacement[k]
        square += float(d @ d + 2 * ahead @ d)
        ahead = ahead + d
        grown_spread = max(square - float(mean @ mean), spread)
        cov[k] += 0.5 * (grown_spread - spread) * np.eye(2)
        spread = grown_spread
    return displacement, cov


def scaled_rotation(heading_rad: FloatArray, log_scale: FloatArray) -> FloatArray:
    """Return the matrices e^s R(theta), (..., 2, 2), with heading offset theta, log scale s and rotation matrix R."""
    c, s = np.exp(log_scale) * np.cos(heading_rad), np.exp(log_scale) * np.sin(heading_rad)
    return np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=-2)


def end_states(start: FloatArray, sum_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the states (n, 4) at the end of n intervals, and their derivatives F (n, 4, 4) by the start states.

    Each interval starts at an anchor with state x_a and ends at the next one with state x_b, so F = d x_b / d x_a.
    `sum_m` (n, 2) is the sum D of its steps in m, before rotation and scaling. With J the rotation by a right angle, R
    that by the heading offset and s the log scale, the end position has the derivative J e^s R D by the heading offset
    and e^s R D by the log scale.
    """
    rotation = scaled_rotation(start[:, HEADING_OFFSET], start[:, LOG_SCALE])
    moved = np.einsum("nab,nb->na", rotation, sum_m)
    ahead = start.copy()
    ahead[:, _POSITION] += moved
    F = np.broadcast_to(np.eye(N_STATES), (len(start), N_STATES, N_STATES)).copy()
    F[:, _POSITION, HEADING_OFFSET] = moved @ TURN.T
    F[:, _POSITION, LOG_SCALE] = moved
    return ahead, F


def state_transform(start: FloatArray) -> FloatArray:
    """Return the matrices T (n, 4, 4) that rotate and scale the covariance of an interval by the state at its start."""
    T = np.broadcast_to(np.eye(N_STATES), (len(start), N_STATES, N_STATES)).copy()
    T[:, _POSITION, _POSITION] = scaled_rotation(start[:, HEADING_OFFSET], start[:, LOG_SCALE])
    return T


def step_states(intervals: Intervals, node_mean: FloatArray, joint_cov: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return means (K, 4) and covariances (K, 4, 4) after each step, from the estimates at the anchors.

    Given both ends a and b, a step k in between depends on nothing else. With F and Q from a to k, Phi from k to b, f
    the predictions, and everything rotated into the frame of the map,

        G = Q_ak Phi' Q_ab^-1,  x_k = f_k(x_a) + G (x_b - f(x_a)),
        P_k = [F_ak - G F_ab, G] P_(a,b) [F_ak - G F_ab, G]' + Q_ak - G Phi Q_ak.

    This is exact for the linearised steps, and gives the same numbers as a smoother with every step as a state.
    `node_mean` (n + 1, 4) are the smoothed states at the anchors, and `joint_cov` (n, 8, 8) is the covariance of both
    ends of each interval.
    """
    i = intervals.index
    start = node_mean[:-1]
    ahead, F_ab = end_states(start, intervals.total_m)
    f_k, F_ak = end_states(start[i], intervals.sum_m)
    T = state_transform(start)
    Q_ak = T[i] @ intervals.cov @ T[i].swapaxes(-1, -2)
    whiten = intervals.whiten @ np.linalg.inv(T)
    remaining = intervals.total_m[i] - intervals.sum_m
    Phi = end_states(start[i], remaining)[1]
    G = Q_ak @ Phi.swapaxes(-1, -2) @ (whiten.swapaxes(-1, -2) @ whiten)[i]
    mean = f_k + np.einsum("kab,kb->ka", G, (node_mean[1:] - ahead)[i])
    ends = np.concatenate([F_ak - G @ F_ab[i], G], axis=-1)
    cov = ends @ joint_cov[i] @ ends.swapaxes(-1, -2) + Q_ak - G @ Phi @ Q_ak
    return mean, 0.5 * (cov + cov.swapaxes(-1, -2))
