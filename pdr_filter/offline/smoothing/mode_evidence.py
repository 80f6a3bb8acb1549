"""Mode probabilities of a walk, smoothed with the evidence of its positions, headings, speeds and ranges.

The walk is a jump Markov linear system near a solution of the smoothing problem: each mode has its own displacement of
a step. An IMM filter runs over the steps, as online, and the smoother of `filter.imm.jump_markov` runs back over pairs
of modes. With the resulting probabilities the problem is posed and solved again.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from pdr_filter.filter.imm.imm import mix, predict, update
from pdr_filter.filter.imm.jump_markov import one_step_back
from pdr_filter.filter.imm.motion_model import EAST, HEADING_OFFSET, LOG_SCALE, N_STATES
from pdr_filter.offline.smoothing.location_errors import N_ERRORS
from pdr_filter.offline.smoothing.preintegration import TURN, Increments, ModeSteps, scaled_rotation, step_states
from pdr_filter.offline.smoothing.problem import Problem
from pdr_filter.offline.smoothing.solve import Solution, linear_equations
from pdr_filter.values import FloatArray
from pdr_filter.values.mixtures import posterior_prob

_POSITION = slice(EAST, EAST + 2)


@dataclass(slots=True)
class Observed:
    """Linear observation z = H x + v of the state (D,), with noise covariance R.

    `is_evidence` is False if its likelihood does not change the mode probabilities.
    """

    z: FloatArray
    H: FloatArray
    R: FloatArray
    is_evidence: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class SwitchingWalk:
    """Jump Markov linear system of K steps in M modes: x_(k+1) = F x_k + shift + w, with covariance Q of w."""

    # (D,), (D, D) state before the first step
    start_mean: FloatArray
    start_cov: FloatArray
    start_prob: FloatArray  # (M,) mode probabilities before the first step
    # (K, M, D, D) transition matrix and process noise of each step in each mode
    F: FloatArray
    Q: FloatArray
    shift: FloatArray  # (K, M, D) displacement of each step in each mode
    log_evidence: FloatArray  # (K, M) log evidence of each step for the modes, other than that of the observations
    # (M, M) probability of a transition from mode i (row) to mode j (column) between two steps
    transition_prob: FloatArray
    # observations by the number of steps before them
    observed: dict[int, list[Observed]] = field(default_factory=dict[int, list[Observed]])

    def smoothed_modes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return probabilities (K, M), means (K, M, D) and covariances of the modes at each step."""
        n, n_modes, size = self.shift.shape
        prob, mean, cov = np.empty((n, n_modes)), np.empty((n, n_modes, size)), np.empty((n, n_modes, size, size))
        here = self.start_prob, np.tile(self.start_mean, (n_modes, 1)), np.tile(self.start_cov, (n_modes, 1, 1))
        here = self._with_observations(0, *here)
        for k in range(n):
            mixed_mean, mixed_cov, predicted = mix(here[1], here[2], here[0], self.transition_prob)
            ahead, ahead_cov = predict(mixed_mean, mixed_cov, self.F[k], self.Q[k])
            after = posterior_prob(predicted, self.log_evidence[k])
            here = prob[k], mean[k], cov[k] = self._with_observations(k + 1, after, ahead + self.shift[k], ahead_cov)
        for k in range(n - 2, -1, -1):
            later = prob[k + 1], mean[k + 1], cov[k + 1]
            now, j = (prob[k], mean[k], cov[k]), k + 1
            prob[k], mean[k], cov[k] = one_step_back(
                now, later, self.F[j], self.shift[j], self.Q[j], self.transition_prob
            )
        return prob, mean, cov

    def _with_observations(
        self, k: int, prob: FloatArray, mean: FloatArray, cov: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the estimates of the modes with the observations after k steps."""
        for each in self.observed.get(k, ()):
            mean, cov, log_likelihood, _ = update(mean, cov, each.z, each.H, each.R)
            prob = posterior_prob(prob, log_likelihood) if each.is_evidence else prob
        return prob, mean, cov


def step_log_evidence(filtered: FloatArray, start_prob: FloatArray, transition_prob: FloatArray) -> FloatArray:
    """Return the log evidence (K, M) of steps and context windows that led to filtered mode probabilities (K, M).

    `start_prob` (M,) are the mode probabilities before the first step. A constant is free for each step.
    """
    predicted = np.vstack([start_prob, filtered[:-1]]) @ transition_prob
    with np.errstate(divide="ignore"):
        return np.log(np.divide(filtered, predicted, out=np.zeros_like(filtered), where=predicted > 0))


def switching_walk(
    steps: Increments,
    of_modes: ModeSteps,
    problem: Problem,
    found: Solution,
    log_evidence: FloatArray,
    start_prob: FloatArray,
    transition_prob: FloatArray,
) -> SwitchingWalk:
    """Return a walk with the displacements of its modes, linearised at a solution of its smoothing problem.

    The state is the error of the anchors or steps of the solution: east, north, heading offset and log scale. Then
    follow the rotation of the frame of the heading offsets, the parameter error of each mode in standard deviations,
    and the errors of correlated fixes if there are any.
    """
    n, n_modes = of_modes.displacement_m.shape[:2]
    intervals, errors = problem.intervals, problem.errors
    own = N_STATES + 1 + n_modes
    size = own + (N_ERRORS if len(errors) else 0)
    at = np.empty((n + 1, N_STATES))  # the solution before each step, after gaps and changes of the heading offset
    at[1:], _ = step_states(intervals, found.mean, found.joint_cov)
    at[intervals.nodes] = found.mean
    rotation = scaled_rotation(at[:-1, HEADING_OFFSET], at[:-1, LOG_SCALE])
    moved_m = np.einsum("kab,kmb->kma", rotation, of_modes.displacement_m)

    F = np.broadcast_to(np.eye(size), (n, n_modes, size, size)).copy()
    F[..., _POSITION, HEADING_OFFSET] = moved_m @ TURN.T
    F[..., _POSITION, LOG_SCALE] = (steps.unknown_var_rad2 == 0)[:, None, None] * moved_m
    F[..., LOG_SCALE, LOG_SCALE] = steps.scale_memory[:, None]
    for m in range(n_modes):
        F[:, m, _POSITION, N_STATES + 1 + m] = np.einsum("kab,kb->ka", rotation, of_modes.parameter_error_m[:, m])
    shift = np.zeros((n, n_modes, size))
    shift[..., :N_STATES] = (at[:-1] - at[1:])[:, None]
    shift[..., _POSITION] += moved_m
    shift[..., LOG_SCALE] = (steps.scale_memory * at[:-1, LOG_SCALE] - at[1:, LOG_SCALE])[:, None]
    Q = np.zeros_like(F)
    Q[..., _POSITION, _POSITION] = rotation[:, None] @ of_modes.cov_m2 @ rotation[:, None].swapaxes(-1, -2)
    Q[..., LOG_SCALE, LOG_SCALE] = steps.scale_drift_var[:, None]
    # a gap, a change of the heading offset and its drift before the next step follow the displacement
    Q[:-1, :, _POSITION, _POSITION] += steps.gap_var_m2[1:, None, None, None] * np.eye(2)
    turned_var = steps.drift_var_rad2 + steps.jump_var_rad2 + steps.unknown_var_rad2
    Q[:-1, :, HEADING_OFFSET, HEADING_OFFSET] += turned_var[1:, None]

    start_mean, start_cov = np.zeros(size), np.eye(size)  # parameters and correlated fixes have unit variances
    start_mean[:N_STATES] = problem.start_mean - found.mean[0]
    start_mean[N_STATES] = -found.frame_rad
    start_cov[:N_STATES, :N_STATES] = problem.start_cov
    start_cov[N_STATES, N_STATES] = problem.frame_std_rad**2
    start_mean[own:] = -found.states[problem.n_nodes :][:1].reshape(-1)
    for k, node in enumerate(intervals.nodes[errors.node][1:].tolist()):
        i, decay = np.arange(own, size), errors.decay[k]
        before, after = found.states[problem.n_nodes + k : problem.n_nodes + k + 2]
        F[node - 1][:, i] *= decay[:, None]
        shift[node - 1][:, i] = decay * before - after
        Q[node - 1][:, i, i] = 1.0 - decay**2
    observed = _observations(problem, found, own, size)
    return SwitchingWalk(start_mean, start_cov, start_prob, F, Q, shift, log_evidence, transition_prob, observed)


def _observations(problem: Problem, found: Solution, own: int, size: int) -> dict[int, list[Observed]]:
    """Return the used observations of a problem by the number of steps before them.

    The errors of correlated fixes begin at `own` in the state. A loop closure is an observation of its later anchor, in
    which the earlier one has its smoothed position and covariance. A direction between two anchors tells no lengths
    apart, so that it is left out.
    """
    n, frame = problem.n_nodes, problem.n_states
    own_cov = np.concatenate([found.joint_cov[:, :N_STATES, :N_STATES], found.joint_cov[-1:, N_STATES:, N_STATES:]])
    result: defaultdict[int, list[Observed]] = defaultdict(list)
    for rows in linear_equations(problem, found.states, found.frame_rad, found.weight)[2:]:
        for i, (a, b) in enumerate(zip(rows.a.tolist(), rows.b.tolist(), strict=True)):
            if a >= n or (len(rows.weight) and not rows.weight[i]):
                continue  # a prior of an error or of the frame is part of the model; a rejected observation
            by_a, by_b = rows.A[i], rows.B[i] if b >= 0 else np.zeros((0, 0))
            H, cov = np.zeros((len(by_a), size)), np.eye(len(by_a))
            H[:, :N_STATES] = by_a
            if b == frame:
                H[:, N_STATES : N_STATES + 1] = by_b
            elif b >= n:
                H[:, own:] = by_b
            elif b >= 0:
                if len(by_a) == 1:
                    continue
                if a < b:
                    a, b, by_a, by_b = b, a, by_b, by_a
                H[:, :N_STATES], cov = by_a, cov + by_b @ own_cov[b] @ by_b.T
            # the walking heading is measured relative to the body, so that it tells nothing about the mode
            result[int(problem.intervals.nodes[a])].append(Observed(rows.rhs[i], H, cov, b != frame))
    return result
