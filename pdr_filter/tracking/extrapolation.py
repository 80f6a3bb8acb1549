"""Estimate at the time of the newest sample, extrapolated beyond the last accepted step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from pdr_filter.filter.chain.handler import states_of
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, stepless_var_m2
from pdr_filter.filter.pedestrian.alignment import EYE, Pose
from pdr_filter.filter.pedestrian.pedestrian_state import StepUpdate, reckoned_position, track_pose, within_reach
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.stream_merging import SENSORS
from pdr_filter.tracking.filtering import State, estimate_on_plan
from pdr_filter.tracking.warnings import notes_of
from pdr_filter.values import CARRYING_MODES, FixResult, FloatArray, OnPlan, Step, as_plain, read_only
from pdr_filter.values.uncertainty import floor_prob, worst_std_m


@dataclass(frozen=True, slots=True, eq=False)
class ProvisionalStep:
    """Candidate step that has been detected but not accepted yet. It may still be rejected."""

    time_s: float  # time of the foot contact, s
    position_m: FloatArray  # (2,) East and north after the step, m


@dataclass(frozen=True, slots=True, eq=False)
class Now:
    """Estimate of the filter at the time of its newest sample.

    D is the number of carrying modes, and C the number of contexts.

    Attributes
    ----------
    time_s : float
        Time of the newest sample on the clock of the track, s. NaN before the first sample.
    latency_s : float
        Delay of the processed samples behind the newest sample, s.
    n_steps : int
        Number of accepted steps.
    distance_m : float
        Walked distance of the accepted steps, m.
    position_m : ndarray, shape (2,)
        East and north, m.
    position_cov_m2 : ndarray, shape (2, 2)
        Covariance of `position_m`, m^2. It grows by (1 m/s t)^2 along each axis while the phone moves for the time t
        without known steps.
    is_provisional : bool
        True if the position is ahead of the last accepted step, so that it may be withdrawn.
    provisional_steps : tuple of ProvisionalStep
        Candidate steps included in the position, in order of time.
    walking_heading_rad, walking_heading_std_rad : float
        Walking direction, rad, clockwise from north and not wrapped, and its standard deviation. While the pedestrian
        stands, the direction in which he or she faces.
    walking_speed_mps, walking_speed_std_mps : float
        Smoothed walking speed and its standard deviation, m/s. While the pedestrian stands, 0 and NaN.
    context_prob : ndarray, shape (C,)
        Probability of each context in the last window. NaN before the first window.
    contexts : tuple of str
        Names of the contexts.
    carrying_prob : ndarray, shape (D,)
        Probability of each carrying mode of `CARRYING_MODES`. NaN before the first window.
    height_m, height_std_m : float
        Height above the start, and its standard deviation, m.
    floor : int
        Storey. The start is on storey 0, unless a fix names the storey.
    fixes : tuple of FixResult
        Outcomes of the last 16 fixes.
    rates_hz : mapping of str to float
        Sampling rate of each sensor, Hz.
    n_gaps : int
        Number of gaps in the samples.
    lost_s : float
        Total duration of the gaps, s.
    notes : tuple of str
        Warnings about the track so far.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> samples = pdr.merge_streams(pdr.simulate.demo_walk())
    >>> online = pdr.OnlineFilter()
    >>> _ = online.push(samples.time_s[:2000], samples.specific_force_mps2[:2000], samples.angular_rate_radps[:2000])
    >>> now = online.now()
    >>> now.walking_speed_mps > 0.5
    True
    >>> now.to_dict()["n_steps"] == now.n_steps
    True
    """

    time_s: float
    latency_s: float
    n_steps: int
    distance_m: float
    position_m: FloatArray
    position_cov_m2: FloatArray
    is_provisional: bool
    provisional_steps: tuple[ProvisionalStep, ...]
    walking_heading_rad: float
    walking_heading_std_rad: float
    walking_speed_mps: float
    walking_speed_std_mps: float
    context_prob: FloatArray
    contexts: tuple[str, ...]
    carrying_prob: FloatArray
    height_m: float
    height_std_m: float
    floor: int
    fixes: tuple[FixResult, ...]
    rates_hz: Mapping[str, float]
    n_gaps: int
    lost_s: float
    notes: tuple[str, ...]

    @property
    def position_std_m(self) -> float:
        """Standard deviation of the position in its least certain direction, m."""
        return float(worst_std_m(self.position_cov_m2))

    def to_dict(self) -> dict[str, Any]:
        """Return the fields and `position_std_m` as JSON values.

        Returns
        -------
        dict
            Arrays are lists, numbers that are not finite are None, and probabilities are dictionaries by name.
        """
        named = as_plain(self)
        del named["contexts"]
        return {
            **named,
            "position_std_m": as_plain(self.position_std_m),
            "floor_prob": float(floor_prob(np.array(self.height_std_m))),
            "context_prob": as_plain(dict(zip(self.contexts, self.context_prob, strict=True))),
            "carrying_prob": as_plain(dict(zip(CARRYING_MODES, self.carrying_prob, strict=True))),
        }


# Delay of a sample after the wait for other sensors, s: reordering, bunching, uniform sampling and hops have 0.4 s.
_DELAY_S = 1.0
# Errors of the distance extrapolated beyond the last known contact, along and across, as shares of that distance (root
# mean squares): the pedestrian may have stopped or turned. Chosen, with `_QUIET_MPS2`, on every other walk of the 34 of
# ms_indoor. The held-out walks have 0.39 and 0.17, humolire 0.21 and 0.07 (tests/benchmarks/provisional.py).
_ALONG_SHARE, _ACROSS_SHARE = 0.4, 0.15
# The pedestrian stands if the standard deviation of |specific force| over the last half second (rows at 25 Hz) is
# smaller.
_QUIET_MPS2, _QUIET_ROWS = 0.8, 13


class Present(NamedTuple):
    """Position at the time of the newest sample."""

    time_s: float  # time of the newest sample on the clock of the track, s
    pose: Pose  # position and walking direction
    steps: tuple[ProvisionalStep, ...]  # candidate steps included in the position
    extrapolated_m: float  # distance from the last contact to the position, m
    # Walking speed and its standard deviation, m/s. 0 and NaN while the pedestrian stands.
    speed_mps: float
    speed_std_mps: float
    reach_m: float  # largest possible standard deviation of the position, m (`PedestrianState.reach_m`)


def present_pose(config: Config, state: State) -> Present:
    """Return the position at the time of the newest sample, in the frame of the filter's states.

    The position follows from three parts. The first is the last accepted step. The second is the candidate steps: steps
    that the gate has not decided yet, and steps that wait for a bout while walking is more probable than not. The third
    is an extrapolation from the last contact at the smoothed speed. Its direction is the direction of the step, rotated
    by half of the rotation of the phone since then. The extrapolation ends when the next contact is overdue or the
    phone is quiet. After `finish` the position has the first part only.

    Without extrapolation the phone may still move. The pedestrian may then walk with steps that are not known yet, or
    push the phone on a trolley. The covariance then grows as in a gap of the samples, by the time of motion that no
    step explains (`VehicleVibration.stepless_s`). It is that of the tracker again when steps are accepted. Time for
    which the accelerometer is silent or stuck counts as such motion.
    """
    last, steps = _with_candidates(config, state)
    pose = _pose_after(state, last, bool(steps))
    reach_m = state.pedestrian.reach_m if last is None or not steps else last.reach_m
    speed_mps, speed_std_mps, extrapolated_m, silent_s = 0.0, math.nan, 0.0, _silent_s(config, state)
    if last is not None and not state.finished and not silent_s and _is_walking(config, state, last, bool(steps)):
        speed_mps, speed_std_mps = last.speed.smoothed_mps, last.speed.smoothed_std_mps
        extrapolated_m = speed_mps * max(_newest_accelerometer_s(state) - last.step.time_s, 0.0)
        pose = _extrapolated(pose, extrapolated_m, _turned_since(state, last))
        reach_m += extrapolated_m
    else:
        var_m2 = config.model.noise.gap_var_m2(_stepless_s(config, state, last) + silent_s)
        # the tracker already has the part of this motion that is certain to have no step
        var_m2 = max(float(var_m2 - stepless_var_m2(state.pedestrian.steps.stepless_s)), 0.0)
        pose = replace(pose, cov_m2=pose.cov_m2 + var_m2 * EYE)
        reach_m += math.sqrt(var_m2)
    return Present(_newest_s(state), pose, steps, extrapolated_m, speed_mps, speed_std_mps, reach_m)


def _with_candidates(config: Config, state: State) -> tuple[StepUpdate | None, tuple[ProvisionalStep, ...]]:
    """Return the last accepted or candidate step, and all candidate steps with their positions.

    The last step is None if there has been no step since the start or the last gap. The positions are in the frame of
    the filter's states.
    """
    (*_, tracker), last, steps = states_of(state.chain), state.last.update, list[ProvisionalStep]()
    for step in () if state.finished else _candidates(state.sensing.gate):
        tracker, updates = config.tracker.on_step(tracker, step)
        last = config.tracker.provisional(tracker) or updates[-1]
        steps.append(ProvisionalStep(step.time_s, (last.of_start or last).position_m))
    return last, tuple(steps)


def _pose_after(state: State, last: StepUpdate | None, is_candidate: bool) -> Pose:
    """Return the position after the last step, with the present walking direction.

    It is the present estimate of the tracker, unless the step is a candidate or provisional.
    """
    pedestrian = state.pedestrian
    if last is None or (last.is_final and not is_candidate):
        mean, _ = pedestrian.estimates.combined
        stated_rad = 0.0 if last is None else last.step.reference_heading_rad - last.step.device_heading_rad
        heading_rad = state.sensing.attitude.device_heading_rad + stated_rad + float(mean[HEADING_OFFSET])
        return replace(track_pose(pedestrian), heading_rad=heading_rad)
    n_steps = pedestrian.steps.n_final
    pose = last.of_start or Pose(last.position_m, last.position_cov_m2, last.walking_heading_rad, n_steps)
    return replace(pose, heading_rad=pose.heading_rad + _turned_since(state, last))


def _turned_since(state: State, last: StepUpdate) -> float:
    """Return the rotation of the phone about the vertical since a step, in rad, clockwise."""
    return state.sensing.attitude.device_heading_rad - last.step.device_heading_rad


def now(config: Config, state: State) -> Now:
    """Return the estimate at the time of the newest sample, in the frame of the fixes or of the floor plan."""
    sensing, pedestrian = state.sensing, state.pedestrian
    present = _in_output_frame(config, state, present_pose(config, state))
    _, cov = pedestrian.estimates.combined
    window, report, height = state.last.window, sensing.conditioner.report, state.height.known
    contexts = config.model.contexts
    unknown = np.full(len(contexts), np.nan), np.full(len(CARRYING_MODES), np.nan)
    context_prob, carrying_prob = (window.prob, window.carrying_prob) if window else unknown
    heading_var_rad2 = float(cov[HEADING_OFFSET, HEADING_OFFSET]) + pedestrian.frame.rotation_var_rad2
    return Now(
        time_s=present.time_s,
        latency_s=present.time_s - sensing.processed_s if math.isfinite(sensing.processed_s) else math.nan,
        n_steps=pedestrian.steps.n_final,
        distance_m=pedestrian.estimates.distance_m,
        position_m=read_only(present.pose.position_m),
        position_cov_m2=read_only(present.pose.cov_m2),
        is_provisional=bool(present.steps) or present.extrapolated_m > 0,
        provisional_steps=present.steps,
        walking_heading_rad=present.pose.heading_rad,
        walking_heading_std_rad=math.sqrt(heading_var_rad2),
        walking_speed_mps=present.speed_mps,
        walking_speed_std_mps=present.speed_std_mps,
        context_prob=read_only(context_prob),
        contexts=contexts,
        carrying_prob=read_only(carrying_prob),
        height_m=height.height_m,
        height_std_m=height.height_std_m,
        floor=height.floors.floor,
        fixes=state.last.fixes,
        rates_hz=_rates_hz(state),
        n_gaps=report.n_gaps,
        lost_s=report.lost_s,
        notes=tuple(note.text for note in notes_of(config, state)),
    )


def _in_output_frame(config: Config, state: State, present: Present) -> Present:
    """Return a position of the tracker in the frame of the fixes, or of the floor plan if there are particles."""
    pedestrian = state.pedestrian
    frame = pedestrian.frame
    particles = estimate_on_plan(config, state, reckoned_position(pedestrian))

    def in_world(pose: Pose) -> Pose:
        pose = pose if frame.is_joined else frame.world(pose)
        return replace(pose, cov_m2=within_reach(pose.cov_m2, frame, present.reach_m))

    def converted(pose: Pose) -> Pose:
        if particles is None:
            return in_world(pose)
        mean, _ = pedestrian.estimates.combined
        heading_rad = state.particles.heading_rad + float(mean[HEADING_OFFSET])
        return _on_plan(in_world(pose), in_world(replace(track_pose(pedestrian), heading_rad=heading_rad)), particles)

    poses = (Pose(step.position_m, np.zeros((2, 2)), 0.0, pedestrian.steps.n_final) for step in present.steps)
    steps = (
        replace(step, position_m=converted(pose).position_m) for step, pose in zip(present.steps, poses, strict=True)
    )
    return present._replace(pose=converted(present.pose), steps=tuple(steps))


def _extrapolated(pose: Pose, extrapolated_m: float, turned_rad: float) -> Pose:
    """Return a position extrapolated by a distance, while the phone rotated by an angle to its present heading.

    The direction is rotated back by half of the angle, and the covariance grows with the distance.
    """
    heading_rad = pose.heading_rad - 0.5 * turned_rad
    along = np.array([math.sin(heading_rad), math.cos(heading_rad)])
    across = np.array([along[1], -along[0]])
    share = _ALONG_SHARE**2 * np.outer(along, along) + _ACROSS_SHARE**2 * np.outer(across, across)
    position_m, cov_m2 = pose.position_m + extrapolated_m * along, pose.cov_m2 + extrapolated_m**2 * share
    return replace(pose, position_m=position_m, cov_m2=cov_m2)


def _on_plan(pose: Pose, base: Pose, on_plan: OnPlan) -> Pose:
    """Return a position of the tracker in the frame of the particles.

    `base` is the position of the tracker at its last step, and `on_plan` the position of the particles there. The
    displacement since that step is rotated and added to the position of the particles. Covariance and heading are
    converted in the same way.
    """
    turn_rad = on_plan.walking_heading_rad - base.heading_rad
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    rotation = np.array([[c, s], [-s, c]])
    value, vector = np.linalg.eigh(pose.cov_m2 - base.cov_m2)
    grown = vector @ np.diag(np.maximum(value, 0.0)) @ vector.T
    return replace(
        pose,
        position_m=on_plan.position_m + rotation @ (pose.position_m - base.position_m),
        cov_m2=on_plan.position_cov_m2 + rotation @ grown @ rotation.T,
        heading_rad=pose.heading_rad + turn_rad,
    )


def _candidates(gate: Any) -> list[Step]:
    """Return the candidate steps of the gate, if walking is more probable than not.

    A gate without the attribute `candidates` has none.
    """
    return list(getattr(gate, "candidates", ()))


def _is_walking(config: Config, state: State, last: StepUpdate, is_candidate: bool) -> bool:
    """True if the pedestrian still walks after the last step: the next step is not overdue, and the phone moves."""
    sensing, gate = config.sensing, state.sensing.gate
    latency_s = sensing.steps.latency_s if is_candidate else sensing.step_latency_s
    if not state.sensing.processed_s - last.step.time_s <= latency_s + last.step.duration_s:
        return False
    rows = getattr(gate, "rows", np.empty((0, 3)))[-_QUIET_ROWS:]
    return len(rows) < _QUIET_ROWS or float(np.sqrt((rows * rows).sum(axis=1)).std()) >= _QUIET_MPS2


def _stepless_s(config: Config, state: State, last: StepUpdate | None) -> float:
    """Return the time since the last step in which the phone moved without a step; 0 until the next step is due."""
    newest_s = _newest_accelerometer_s(state)
    if last is None:
        return config.sensing.stepless_s(state.sensing, -math.inf, newest_s)
    if newest_s - last.step.time_s <= last.step.duration_s:
        return 0.0
    return config.sensing.stepless_s(state.sensing, last.step.time_s, newest_s)


def _silent_s(config: Config, state: State) -> float:
    """Return the time since the last usable sample of the accelerometer; 0 if the filter alone may have delayed it.

    A sensor that was ahead of the accelerometer from its first sample on has another clock, or began later.
    """
    ahead_s = 0.0
    if state.merger.is_used:
        force = state.merger.stream("accelerometer")
        others = (s for s in state.merger.streams if s.n_received)
        ahead_s = max(s.last_s - force.last_s - max(s.first_s - force.first_s, 0.0) for s in others)
    silent_s = ahead_s + _newest_accelerometer_s(state) - state.sensing.processed_s
    return silent_s if config.merger.wait_s + _DELAY_S < silent_s < math.inf else 0.0


def _newest_s(state: State) -> float:
    """Return the time of the newest sample of any sensor, on the clock of the track."""
    if state.merger.is_used:
        return max(s.last_s for s in state.merger.streams) + state.clock_offset_s
    return state.sensing.conditioner.report.last_time_s


def _newest_accelerometer_s(state: State) -> float:
    """Return the time of the newest accelerometer sample. Other sensors may have another clock."""
    if not state.merger.is_used:
        return _newest_s(state)
    return state.merger.stream("accelerometer").last_s + state.clock_offset_s


def _rates_hz(state: State) -> dict[str, float]:
    """Return the sampling rate of each sensor that arrives separately, by sensor.

    Merged samples have one rate, under "accelerometer". The result is empty before it is known.
    """
    if state.merger.is_used:
        streams = zip(SENSORS, state.merger.streams, strict=True)
        return {sensor: stream.rate_hz for sensor, stream in streams if stream.n_received}
    report = state.sensing.conditioner.report
    seen_s = report.last_time_s - report.first_time_s - report.lost_s
    return {"accelerometer": report.n_received / seen_s} if seen_s > 0 else {}
