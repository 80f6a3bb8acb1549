"""Preintegration: the steps between two anchors summed into one relative factor before the problem is solved.

In the frame of the heading offset and the scale at the start of an interval, its steps add up to one displacement D,

    p_b = p_a + e^s_a R(theta_a) D,  theta_b = theta_a,  s_b = s_a,  and noise of covariance T Q T',
    T = diag(e^s_a R(theta_a), 1, 1),

so that Q is computed once, however often the solver linearises (the idea of C. Forster et al., "On-manifold
preintegration for real-time visual-inertial odometry", IEEE T-RO 33, 2017). The log scale decays with each step, as in
the filter. It scales each step of D and decays to s_b in `Intervals.steps_from`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pdr_filter.filter.imm.imm import predict_cov
from pdr_filter.filter.imm.motion_model import (
    EAST,
    HEADING_OFFSET,
    LOG_SCALE,
    MAX_HEADING_VARIANCE,
    N_STATES,
    Directions,
    stepless_var_m2,
)
from pdr_filter.filter.imm.step_cycle import StepMotion, step_motion
from pdr_filter.filter.pedestrian.pedestrian_model import ModeLengths, PedestrianModel
from pdr_filter.offline.columns import Columns
from pdr_filter.values import BoolArray, FloatArray, IntArray, Step, Table, read_only, steps_of

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
class Increments(Columns):
    """Displacement and noise of each of K steps, before the person's scale and heading offset.

    The events have the same order as in the filter: the gap, the change of the heading offset and its drift since the
    previous step, then the measured walking heading, then the displacement, and last the drift of the scale.
    """

    time_s: FloatArray  # (K,) times of the contacts
    duration_s: FloatArray  # (K,) durations of the steps
    length_m: FloatArray  # (K,) length, mean over the modes
    displacement_m: FloatArray  # (K, 2) east and north displacement, from device heading and modes
    cov_m2: FloatArray  # (K, 2, 2) covariance of the displacement, independent between steps
    drift_var_rad2: FloatArray  # (K,) variance of the drift of the heading offset before the step
    unknown_var_rad2: FloatArray  # (K,) variance of the heading offset from time without angular rate, before the step
    scale_memory: FloatArray  # (K,) factor on the log scale after the step
    scale_drift_var: FloatArray  # (K,) variance of the drift of the log scale after the step
    # (K,) variance of a change of the heading offset before the step: the phone was moved, or samples are missing
    jump_var_rad2: FloatArray
    # (K,) variance of the position from a gap in the samples, or motion without steps, before the step
    gap_var_m2: FloatArray

    @property
    def is_turned(self) -> BoolArray:
        """True (K,) where the heading before the step is not that of the step before: it was moved, or not measured."""
        return (self.jump_var_rad2 > 0) | (self.gap_var_m2 > 0) | (self.unknown_var_rad2 > 0)


def increments(
    steps: Table, mode_prob: FloatArray, model: PedestrianModel, gap_before_s: FloatArray, *, is_weighted: bool = False
) -> tuple[Increments, FloatArray]:
    """Return the increments of detected steps, and their errors (K, M + 1, 2) in m due to consider parameters.

    The displacement of a step is the mean over the M modes, sum_m mu_m L_m u(psi + o_m), with the covariance of the
    mixture. For mode m, mu_m is the probability, L_m the step length and o_m the heading offset. psi is the device
    heading, and u the unit vector of a heading. If `is_weighted` is True, the step has the weighted length and the
    direction of the single filter of `WeightedTracker` instead. Lengths, directions, drift and decay are those of the
    filter. `mode_prob` is (K, M), and `gap_before_s` (K,) is the time without samples before each step.

    Consider parameters have the same error in all steps, and the smoother does not estimate them. The second result is
    the error of each step for one standard deviation of each. The first M are the length parameters of the modes. The
    last one is the person's scale in steps whose heading is not measured. Such steps may lead anywhere, so that fixes
    closer together than the steps do not contradict their lengths, and fixes farther apart do. An estimate of the scale
    would therefore grow with the errors of the fixes.
    """
    n, noise, each = len(steps), model.noise, steps_of(steps)
    lengths, directions = model.lengths_of_all(each), [model.directions] * n
    parameter_std_m = np.array([of.parameter_std_m for of in lengths]).reshape(n, -1) * mode_prob
    prob = mode_prob
    if is_weighted:
        lengths = [of.of_one_filter(weights) for of, weights in zip(lengths, mode_prob, strict=True)]
        directions = [of.of_one_filter(weights) for of, weights in zip(directions, mode_prob, strict=True)]
        prob = np.ones((n, 1))
    way, move = _motion(each, lengths, directions)
    along, across = move.along, move.across
    displacement_m = move.length_m[..., None] * along
    displacement = np.einsum("km,kma->ka", prob, displacement_m)
    apart = displacement_m - displacement[:, None]
    cov = (
        np.einsum("km,kma,kmb->kab", prob * move.var_along_m2, along, along)
        + np.einsum("km,kma,kmb->kab", prob * move.var_across_m2, across, across)
        + np.einsum("km,kma,kmb->kab", prob, apart, apart)
        + (prob * way.extra_var_m2).sum(axis=1)[:, None, None] * np.eye(2)
    )
    drift_var, unknown_var = noise.heading_drift.variances_rad2(
        _elapsed_s(steps, gap_before_s),
        np.asarray(steps.heading_unknown_s),
        np.asarray(steps.yaw_bias_std_radps),
        (prob * way.drift_rad2_per_s).sum(axis=1),
    )
    # a heading that diffuses by the variance V during a step gives the mean direction of the step the variance V / 3
    cov += (unknown_var / 3.0 * (displacement**2).sum(axis=1))[:, None, None] * np.eye(2)
    change_std_rad = np.asarray(steps.offset_change_std_rad)
    change_std_rad = np.where(change_std_rad < _MIN_CHANGE_STD_RAD, 0.0, change_std_rad)
    jump_var = change_std_rad**2 + noise.heading_drift.unmeasured_rad2(gap_before_s)
    walking = Increments(
        time_s=np.asarray(steps.time_s),
        duration_s=np.asarray(steps.duration_s),
        length_m=(prob * move.length_m).sum(axis=1),
        displacement_m=displacement,
        cov_m2=cov,
        drift_var_rad2=drift_var,
        unknown_var_rad2=unknown_var,
        scale_memory=np.full(n, noise.log_scale_memory),
        scale_drift_var=np.full(n, noise.log_scale_drift_var),
        jump_var_rad2=np.minimum(jump_var, MAX_HEADING_VARIANCE),
        gap_var_m2=noise.gap_var_m2(gap_before_s) + stepless_var_m2(np.asarray(steps.stepless_s)),
    )
    scale_error_m = noise.log_scale_std * np.where(unknown_var[:, None] > 0, displacement, 0.0)
    return walking, np.concatenate([parameter_std_m[..., None] * along, scale_error_m[:, None]], axis=1)


def _motion(
    steps: Sequence[Step], lengths: Sequence[ModeLengths], directions: Sequence[Directions]
) -> tuple[Directions, StepMotion]:
    """Return the directions (K, M) of the modes and the motion of K steps in M modes, without scale and offset."""

    def columns(objects: Sequence[object], name: str) -> FloatArray:
        return np.array([getattr(each, name) for each in objects]).reshape(len(steps), -1)

    way = Directions(*(columns(directions, name) for name in Directions.__slots__))
    length_m, var_m2 = columns(lengths, "length_m"), columns(lengths, "residual_var_m2")
    device_rad, turned_rad = columns(steps, "reference_heading_rad"), columns(steps, "turned_rad")
    return way, step_motion(device_rad, 0.0, 0.0, length_m, var_m2, way, turned_rad)


class ModeSteps(NamedTuple):
    """Displacements of K steps in M modes, before the scale of the person and the heading offset."""

    displacement_m: FloatArray  # (K, M, 2) displacement, of which `Increments` has the mean over the modes
    cov_m2: FloatArray  # (K, M, 2, 2) covariance, independent between steps
    # (K, M, 2) error due to the parameters of the length model of the mode, for one standard deviation
    parameter_error_m: FloatArray

    def of(self, modes: BoolArray) -> ModeSteps:
        """Return the displacements in the modes of a mask (M,)."""
        return ModeSteps(*(each[:, modes] for each in self))


def mode_steps(steps: Table, model: PedestrianModel, unknown_var_rad2: FloatArray) -> ModeSteps:
    """Return the displacements of steps in each mode.

    `unknown_var_rad2` (K,) are the variances of the heading from time without angular rate (`Increments`).
    """
    each = steps_of(steps)
    lengths = model.lengths_of_all(each)
    way, move = _motion(each, lengths, [model.directions] * len(each))
    along, across = move.along, move.across
    around_m2 = way.extra_var_m2 + unknown_var_rad2[:, None] / 3.0 * move.length_m**2
    cov = move.var_along_m2[..., None, None] * along[..., :, None] * along[..., None, :]
    cov += move.var_across_m2[..., None, None] * across[..., :, None] * across[..., None, :]
    cov += around_m2[..., None, None] * np.eye(2)
    parameter_std_m = np.array([of.parameter_std_m for of in lengths])
    return ModeSteps(move.length_m[..., None] * along, cov, parameter_std_m[..., None] * along)


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
    """

    nodes: IntArray  # (n + 1,) number of steps before each anchor, from 0 to K
    index: IntArray  # (K,) interval of each step
    step_m: FloatArray  # (K, 2) displacement of each step
    decay: FloatArray  # (K,) log scale at each step, relative to that at the start of the interval
    # (K,) False for steps without a measured heading, from which the scale is not estimated (`increments`)
    is_measured: BoolArray
    # (K, 2) D from the start of the interval to the contact of each step, without the decay of the scale
    sum_m: FloatArray
    # (K, 4, 4) Q from the start of the interval to the contact of each step. It excludes a gap or a change of the
    # heading offset after the contact.
    cov: FloatArray
    # (K, 4, 4) derivative of the state at the end of the interval by the state at the contact of each step
    to_end: FloatArray
    total_m: FloatArray  # (n, 2) D of each whole interval, without the decay of the scale
    total_decay: FloatArray  # (n,) log scale at the end of each whole interval, relative to that at its start
    # (n, 4, 4) Q of each whole interval, including a gap and a change of the heading offset at its end
    total_cov: FloatArray
    whiten: FloatArray  # (n, 4, 4) inverse of the lower Cholesky factor of `total_cov`

    def __len__(self) -> int:
        return len(self.total_m)

    def steps_from(self, start: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the states (K, 4) at all contacts from those at the starts (n, 4), and their derivatives (K, 4, 4).

        Step j of an interval has the displacement e^(c_j s) R(theta) d_j, with heading offset theta and log scale s at
        the start, and the decay c_j of the log scale. The derivative by s is zero for steps without a measured heading.
        """
        first, state = self.nodes[:-1][self.index], start[self.index]
        scaled_m = np.exp(self.decay * state[:, LOG_SCALE])[:, None] * self.step_m
        rotation = scaled_rotation(state[:, HEADING_OFFSET], np.zeros(len(state)))
        moved = np.einsum("kab,kb->ka", rotation, _since(scaled_m, first))
        F = np.broadcast_to(np.eye(N_STATES), (len(state), N_STATES, N_STATES)).copy()
        F[:, _POSITION, HEADING_OFFSET] = moved @ TURN.T
        by_scale = _since((self.decay * self.is_measured)[:, None] * scaled_m, first)
        F[:, _POSITION, LOG_SCALE] = np.einsum("kab,kb->ka", rotation, by_scale)
        after = np.append(self.decay[1:], 0.0)
        last = self.nodes[1:] - 1
        after[last] = self.total_decay
        F[:, LOG_SCALE, LOG_SCALE] = after
        state[:, _POSITION] += moved
        state[:, LOG_SCALE] *= after
        return state, F

    def ends_from(self, start: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the states (n, 4) at the ends of the intervals from those at their starts, and their derivatives."""
        state, F = self.steps_from(start)
        last = self.nodes[1:] - 1
        return state[last], F[last]


def _since(values: FloatArray, first: IntArray) -> FloatArray:
    """Return the sums of values (K, ...) of the steps from the step `first` (K,) to each step."""
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    return total[1:] - total[first]


def preintegrate(steps: Increments, nodes: IntArray) -> Intervals:
    """Return the steps summed between anchors, in time proportional to the number of steps.

    The covariance is that of the filter, P_k = F P_{k-1} F' + Q (`step_cycle.advance`), which starts at zero in each
    interval. The drift of the heading before the first step of an interval belongs to the previous interval. ValueError
    unless `nodes`, the numbers of steps before the anchors, increase from 0 to the number of steps.
    """
    if len(nodes) < 2 or nodes[0] != 0 or nodes[-1] != len(steps) or (np.diff(nodes) < 1).any():
        raise ValueError(f"anchors must increase from 0 to the number of steps, {len(steps)}, got {nodes}")
    count, n = np.diff(nodes), len(steps)
    index = np.repeat(np.arange(len(count)), count)
    first, last = nodes[:-1][index], nodes[1:] - 1

    certain = np.linalg.eigvalsh(steps.cov_m2)[:, 0] < _MIN_POSITION_VAR_M2
    noise = np.zeros((n, N_STATES, N_STATES))
    noise[:, _POSITION, _POSITION] = steps.cov_m2 + certain[:, None, None] * _MIN_POSITION_VAR_M2 * np.eye(2)
    noise[:, LOG_SCALE, LOG_SCALE] = np.maximum(steps.scale_drift_var, MIN_STATE_VAR)
    drift_var = np.where(np.arange(n) == first, MIN_STATE_VAR, np.maximum(steps.drift_var_rad2, MIN_STATE_VAR))
    F = np.broadcast_to(np.eye(N_STATES), (n, N_STATES, N_STATES)).copy()
    is_measured = steps.unknown_var_rad2 == 0
    F[:, _POSITION, HEADING_OFFSET] = steps.displacement_m @ TURN.T
    F[:, _POSITION, LOG_SCALE] = is_measured[:, None] * steps.displacement_m
    F[:, LOG_SCALE, LOG_SCALE] = steps.scale_memory
    decay, Q, to_end = np.ones(n), np.zeros_like(F), np.broadcast_to(np.eye(N_STATES), F.shape).copy()
    ranks = [nodes[:-1][count > j] + j for j in range(count.max())]  # the steps with number j of all intervals
    for k in ranks:
        inside = k > first[k]
        before = np.where(inside[:, None, None], Q[k - 1], 0.0)
        before[:, HEADING_OFFSET, HEADING_OFFSET] += drift_var[k]
        Q[k] = predict_cov(before, F[k], noise[k])
        decay[k] = np.where(inside, decay[k - 1] * steps.scale_memory[k - 1], 1.0)
    for k in ranks[:0:-1]:
        to_end[k - 1] = to_end[k] @ F[k]

    end = np.zeros((len(count), N_STATES, N_STATES))
    inner = nodes[1:-1]  # events before a step belong to the interval that ends there
    end[:-1, _POSITION, _POSITION] = steps.gap_var_m2[inner][:, None, None] * np.eye(2)
    turned = steps.jump_var_rad2[inner] + steps.drift_var_rad2[inner] + steps.unknown_var_rad2[inner]
    end[:-1, HEADING_OFFSET, HEADING_OFFSET] = np.minimum(turned, MAX_HEADING_VARIANCE)
    D, total_cov = _since(steps.displacement_m, first), Q[last] + end
    return Intervals(
        nodes=nodes,
        index=index,
        step_m=steps.displacement_m,
        decay=decay,
        is_measured=is_measured,
        sum_m=D,
        cov=Q,
        to_end=to_end,
        total_m=D[last],
        total_decay=decay[last] * steps.scale_memory[last],
        total_cov=total_cov,
        whiten=read_only(np.linalg.inv(np.linalg.cholesky(total_cov))),
    )


def scaled_rotation(heading_rad: FloatArray, log_scale: FloatArray) -> FloatArray:
    """Return the matrices e^s R(theta), (..., 2, 2), with heading offset theta, log scale s and rotation matrix R."""
    c, s = np.exp(log_scale) * np.cos(heading_rad), np.exp(log_scale) * np.sin(heading_rad)
    return np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=-2)


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
    f_k, F_ak = intervals.steps_from(start)
    ahead, F_ab = intervals.ends_from(start)
    T = state_transform(start)
    back = np.linalg.inv(T)
    Q_ak = T[i] @ intervals.cov @ T[i].swapaxes(-1, -2)
    whiten = intervals.whiten @ back
    Phi = T[i] @ intervals.to_end @ back[i]
    G = Q_ak @ Phi.swapaxes(-1, -2) @ (whiten.swapaxes(-1, -2) @ whiten)[i]
    mean = f_k + np.einsum("kab,kb->ka", G, (node_mean[1:] - ahead)[i])
    ends = np.concatenate([F_ak - G @ F_ab[i], G], axis=-1)
    cov = ends @ joint_cov[i] @ ends.swapaxes(-1, -2) + Q_ak - G @ Phi @ Q_ak
    return mean, 0.5 * (cov + cov.swapaxes(-1, -2))
