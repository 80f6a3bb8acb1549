"""State of a pedestrian filter, and its changes by steps, gaps and alignments, shared by both trackers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any, NamedTuple, cast

import numpy as np

from pdr_filter.filter.imm.estimates import ALONG_AND_ACROSS, LENGTH_PARAMETERS, Estimates, position_cov
from pdr_filter.filter.imm.motion_model import (
    EAST,
    HEADING_OFFSET,
    LOG_SCALE,
    NORTH,
    MotionNoise,
    bounded_position_cov,
    grow_over_gap,
    initial_estimate,
    second_order_errors,
    stepless_var_m2,
)
from pdr_filter.filter.imm.step_cycle import Cycle, HeadingZero
from pdr_filter.filter.pedestrian.alignment import Alignment, Pose, transformed_estimates, walked_var_m2
from pdr_filter.filter.pedestrian.fix_history import FixHistory
from pdr_filter.filter.pedestrian.frame import Frame
from pdr_filter.filter.pedestrian.frame_rotation import Compass, PairedPoint
from pdr_filter.filter.pedestrian.past_path import PastPath, WalkedStep
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.relocation import RelocationEvidence
from pdr_filter.filter.pedestrian.step_history import StepHistory, Walked
from pdr_filter.filter.pedestrian.walking_speed import WalkingSpeed
from pdr_filter.values import (
    Fix,
    FloatArray,
    OnPlan,
    PositionFix,
    RangeFix,
    Step,
    as_plain,
    make_read_only,
    read_only,
    replace_unchecked,
    wrap_angle,
)
from pdr_filter.values.uncertainty import worst_std_m

# Time between two steps from which there is a pause between them.
PAUSE_S = 2.0


@dataclass(frozen=True, eq=False)
class StepUpdate:
    """Track row after one step, as returned by `OnlineFilter.push`.

    With weighting `hc` or `wc` a step is first reported provisionally. It is reported again with the same `index` when
    the following context window is known. With `imm` each step is reported once.

    Attributes
    ----------
    index : int
        Number of the step in the track, from 0.
    step : Step
        Detected step.
    is_final : bool
        False if the step will be reported again.
    position_m : (2,) array
        Position (east, north) in m.
    position_cov_m2 : (2, 2) array
        Covariance of the position in m2.
    step_length_m : float
        Length of the step in m.
    walked_m : float
        Distance in m of all steps so far, including this one.
    walking_heading_rad : float
        Walking heading in rad, clockwise from north, not wrapped.
    speed : WalkingSpeed
        Walking speed of the step and its smoothed value.
    context_prob : (C,) array
        Context probabilities.
    contexts : tuple of str
        Names of the C contexts.
    mode_prob : (M,) array
        Mode probabilities.
    of_start : Pose or None
        Position, covariance and heading in the start frame of the track, as long as the rotation to the frame of the
        fixes is not settled. None afterwards.
    gap_before_s : float
        Time in s without samples since the previous step.
    reach_m : float, default inf
        Largest possible standard deviation of the position in m, `PedestrianState.reach_m`.
    height_m, height_std_m : float, default 0.0
        Height above the start in m, and its standard deviation. Trackers leave the default; the height filter sets
        them.
    floor : int, default 0
        Storey relative to the start.
    on_plan : OnPlan, optional
        Estimate of the particle filter on a floor plan. If given, the particles determine position, covariance and
        heading.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP
    >>> tracker = pdr.recipes.default().tracker
    >>> state, (update,) = tracker.on_step(tracker.init(), TYPICAL_STEP)
    >>> update.index, update.is_final, update.to_dict()["floor"]
    (0, True, 0)
    """

    index: int
    step: Step
    is_final: bool
    position_m: FloatArray
    position_cov_m2: FloatArray
    step_length_m: float
    walked_m: float
    walking_heading_rad: float
    speed: WalkingSpeed
    context_prob: FloatArray
    contexts: tuple[str, ...]
    mode_prob: FloatArray
    of_start: Pose | None
    gap_before_s: float
    reach_m: float = math.inf
    height_m: float = 0.0
    height_std_m: float = 0.0
    floor: int = 0
    on_plan: OnPlan | None = None

    def in_frame(self, frame: Frame) -> StepUpdate:
        """Return the update in a frame whose rotation is known by now.

        Parameters
        ----------
        frame : Frame
            Later estimate of the relation between the track and the frame of the fixes.

        Returns
        -------
        StepUpdate
            Update with position, covariance and heading in that frame. The update itself is returned if its rotation
            was already settled, or if it is in the frame of a floor plan.
        """
        is_settled = self.of_start is None and frame.north is None
        if is_settled or self.on_plan is not None:
            return self
        # a heading fix also rotates the earlier steps of a track in the start frame
        own = Pose(self.position_m, self.position_cov_m2, self.walking_heading_rad, self.index)
        pose = frame.world(self.of_start or own)
        return replace_unchecked(
            self,
            position_m=read_only(pose.position_m),
            position_cov_m2=read_only(within_reach(pose.cov_m2, frame, self.reach_m)),
            walking_heading_rad=pose.heading_rad,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON values.

        Returns
        -------
        dict
            Fields by name, without `contexts`, and `time_s`. Numbers that are not finite are None. `context_prob` is a
            dictionary by context name.
        """
        named = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "contexts"}
        contexts = dict(zip(self.contexts, self.context_prob, strict=True))
        return as_plain({"time_s": self.step.time_s, **named, "context_prob": contexts})


@dataclass(frozen=True, eq=False)
class PedestrianState:
    """Estimates after the latest event, and the history that later steps and fixes need.

    An event is a gap, a fix, or a step whose track row is final.
    """

    estimates: Estimates  # estimates of all filters
    frame: Frame  # relation between the track and the frame of the fixes
    heading_zero: HeadingZero = field(default_factory=HeadingZero)  # zero of the heading offset
    steps: StepHistory = field(default_factory=StepHistory)  # last final steps
    fixes: FixHistory = field(default_factory=FixHistory)  # earlier fixes, as far as the next fix depends on them
    # what the last event did to the path of past steps (`with_path.WithPath`), as functions of this path
    changes: tuple[Callable[[PastPath], PastPath], ...] = ()
    # Second hypothesis of the position if the last range has found two positions. `TwoHypotheses` takes it over.
    rival: Rival | None = None
    # Standard deviation of the position after the last used position fix, minus the distance walked until then, in m. A
    # gap adds its standard deviation. Infinite before the first step and the first such fix.
    std_at_start_m: float = math.inf
    # variance added by motion without steps since the last used position fix, along each axis, m2
    unstepped_var_m2: float = 0.0

    @property
    def reach_m(self) -> float:
        """Largest possible standard deviation of the position in m (`motion_model.reach_m`).

        It is the standard deviation after the last used position fix plus the way walked since then, or that of the
        motion without steps if it is larger.
        """
        return max(self.std_at_start_m + self.estimates.distance_m, math.sqrt(self.unstepped_var_m2))


@dataclass(frozen=True, eq=False)
class Rival:
    """Less probable one of two hypotheses about the position and heading of the track."""

    pedestrian: PedestrianState
    log_odds: float  # log of the ratio of the probabilities of this hypothesis and the more probable one, 0 or less


def with_change(state: PedestrianState, change: Callable[[PastPath], PastPath]) -> PedestrianState:
    """Return the state with one more change of the path of past steps."""
    return replace_unchecked(state, changes=(*state.changes, change))


def without_changes(state: PedestrianState) -> PedestrianState:
    """Return the state before an event, without the changes that the last event made to the path of past steps."""
    return replace_unchecked(state, changes=()) if state.changes else state


def initial_state(model: PedestrianModel, prob: FloatArray) -> PedestrianState:
    """Return the state of a pedestrian at the origin, with one filter for each of the probabilities (F,)."""
    mean, cov = initial_estimate(model.noise)
    estimates = Estimates(
        mean=np.tile(mean, (len(prob), 1)),
        cov=np.tile(cov, (len(prob), 1, 1)),
        prob=prob,
        walked_m=np.zeros(len(prob)),
        consider_error_m=np.zeros((2 + len(model.modes), 2)),
    )
    return PedestrianState(estimates, model.frame)


def before_step(state: PedestrianState, step: Step) -> PedestrianState:
    """Return the state before a step, whose heading may have been lost (`with_reopened_rotation`).

    The first step begins at the origin, so that motion or a gap before it adds nothing. It does if a position fix has
    shown an earlier pose.
    """
    if math.isfinite(state.std_at_start_m):
        return with_reopened_rotation(state)
    if state.frame.pairs:
        return replace_unchecked(state, std_at_start_m=0.0)
    cov = state.estimates.cov.copy()
    cov[:, :HEADING_OFFSET] = cov[:, :, :HEADING_OFFSET] = 0.0
    return replace_unchecked(
        state,
        estimates=replace_unchecked(state.estimates, cov=cov),
        steps=replace_unchecked(state.steps, stepless_s=step.stepless_s),
        std_at_start_m=0.0,
        unstepped_var_m2=0.0,
    )


def since_last_step(state: PedestrianState, step: Step) -> tuple[float, float]:
    """Return the time since the previous step in s, and the variance of the motion without steps in it, m2.

    The variance is that along each axis, as far as `over_stepless` has not added it yet.
    """
    since_s = step.duration_s if math.isnan(state.steps.last_s) else step.time_s - state.steps.last_s
    return since_s, float(stepless_var_m2(max(step.stepless_s - state.steps.stepless_s, 0.0)))


def with_withheld_length(
    model: PedestrianModel,
    state: PedestrianState,
    step: Step,
    walked: Walked,
    free_prob: FloatArray,
    withheld_m: float,
) -> tuple[PedestrianState, Walked]:
    """Return the state before a step within a stated standstill, and the step, with the withheld length as uncertainty.

    `free_prob` (M,) are the mode probabilities of the step without the standstill, and `withheld_m` is the length that
    the standstill withholds from it. If the statement is wrong, all of its steps lack their lengths. The error is
    therefore one of the length parameter of a mode without displacement, which all steps share. It is added for each
    step that clearly contradicts the standstill, including earlier ones that were not clear before this step.
    """
    since_s, _ = since_last_step(state, step)
    before = state.fixes.standstill_steps
    after = before.plus(step.time_s, since_s, float(free_prob @ model.moves), max(-model.step_log_odds_stationary, 0.0))
    all_withheld_m = max((after.n_contradicting - before.n_contradicting) * withheld_m, 0.0)
    std_m = walked.parameter_std_m.copy()
    std_m[int(np.argmin(model.moves))] += all_withheld_m
    fixes = replace_unchecked(state.fixes, standstill_steps=after)
    reaching = replace_unchecked(state, fixes=fixes, std_at_start_m=state.std_at_start_m + all_withheld_m)
    return reaching, replace(walked, parameter_std_m=std_m)


class StepEstimate(NamedTuple):
    """Estimate after the evidence of a step."""

    estimates: Estimates  # estimates of the filters
    combined: tuple[FloatArray, FloatArray]  # combined mean (4,) and covariance (4, 4)
    mode_prob: FloatArray  # (M,) probabilities of the modes, or their weights
    context_prob: FloatArray  # (C,) context probabilities


def state_after_step(
    model: PedestrianModel,
    previous: PedestrianState,
    step: Step,
    cycle: Cycle,
    walked: Walked,
    estimate: StepEstimate,
    is_final: bool = True,
) -> tuple[PedestrianState, StepUpdate]:
    """Return the state after a step and its track row, from the state before it, its cycle and its estimate."""
    x, P = estimate.combined
    consider_error_m = estimate.estimates.consider_error_m + _consider_error_m(walked, P)
    event = WalkedStep.of(step.time_s, cycle, x)
    updated = replace_unchecked(
        previous,
        estimates=replace_unchecked(estimate.estimates, consider_error_m=consider_error_m),
        frame=_with_compass(previous.frame, step, float(x[HEADING_OFFSET])),
        heading_zero=cycle.zero,
        steps=previous.steps.plus(step, walked, x, P),
        unstepped_var_m2=previous.unstepped_var_m2 + cycle.unstepped_var_m2,
        changes=(*previous.changes, partial(PastPath.with_event, event=event)),
    )
    return updated, _step_update(model, previous, updated, step, walked, estimate, is_final)


def _consider_error_m(walked: Walked, P: FloatArray) -> FloatArray:
    """Return the position error (2 + M, 2) that one step adds for one standard deviation of each consider parameter.

    The error is in m. Consider parameters are errors that all steps share and that the filter does not estimate
    (`Estimates.consider_cov_m2`).
    """
    along, across = second_order_errors(float(P[HEADING_OFFSET, HEADING_OFFSET]), float(P[LOG_SCALE, LOG_SCALE]))
    sine, cosine = math.sin(walked.heading_rad), math.cos(walked.heading_rad)
    along_m, across_m = walked.length_m * along, walked.length_m * across
    error_m = np.empty((2 + len(walked.parameter_std_m), 2))
    error_m[ALONG_AND_ACROSS] = (along_m * sine, along_m * cosine), (across_m * cosine, -across_m * sine)
    np.multiply(walked.parameter_std_m[:, None], walked.direction, out=error_m[LENGTH_PARAMETERS])
    return error_m


def _with_compass(frame: Frame, step: Step, heading_offset_rad: float) -> Frame:
    """Return the frame with the magnetic north of a step, if the step has one.

    A north with a standard deviation of more than one radian carries no information, and the frame is then without it.
    """
    if not (math.isfinite(step.north_std_rad) and math.isfinite(step.shown_offset_std_rad)):
        return frame
    if step.north_std_rad > _MAX_NORTH_STD_RAD:
        return frame.with_compass(None)
    # rotation from the track frame to north: walking direction relative to north minus walking direction in that frame
    angle_rad = float(wrap_angle(step.shown_offset_rad - step.north_rad - heading_offset_rad))
    return frame.with_compass(Compass(angle_rad, step.north_std_rad**2 + step.shown_offset_std_rad**2))


def over_gap(state: PedestrianState, gap_s: float, noise: MotionNoise) -> PedestrianState:
    """Return the state after a time without samples, with larger variances of positions and headings.

    This growth replaces the heading drift since the last step.
    """
    estimates = replace_unchecked(state.estimates, cov=grow_over_gap(state.estimates.cov, gap_s, noise))
    P, after_P = state.estimates.combined[1], estimates.combined[1]
    changed = replace_unchecked(
        state,
        estimates=estimates,
        steps=state.steps.after_gap(gap_s),
        fixes=state.fixes.after_gap(),
        std_at_start_m=state.std_at_start_m + math.sqrt(noise.gap_var_m2(gap_s)),
    )
    return with_change(changed, lambda path: path.after_prediction(P, after_P))


def over_stepless(state: PedestrianState, stepless_s: float) -> PedestrianState:
    """Return the state after a time in which the phone moved without a known step, with a less certain position."""
    estimates, var_m2 = state.estimates, float(stepless_var_m2(stepless_s))
    cov = estimates.cov.copy()
    cov[:, [EAST, NORTH], [EAST, NORTH]] += var_m2
    grown = replace_unchecked(estimates, cov=cov)
    P, grown_P = estimates.combined[1], grown.combined[1]
    changed = replace_unchecked(
        state,
        estimates=grown,
        steps=replace_unchecked(state.steps, stepless_s=state.steps.stepless_s + stepless_s),
        unstepped_var_m2=state.unstepped_var_m2 + var_m2,
    )
    return with_change(changed, lambda path: path.after_prediction(P, grown_P))


_MAX_NORTH_STD_RAD = 1.0  # limit of a normal density on a circle


def with_reach_after_fix(state: PedestrianState, fix: Fix) -> PedestrianState:
    """Return the state after a used fix, with the standard deviation that a fix of the position has given it."""
    if not isinstance(fix, PositionFix | RangeFix):
        return state
    cov_m2 = reckoned_position(state)[1] if state.frame.is_of_start else track_pose(state).cov_m2
    start_m = float(worst_std_m(cov_m2)) - state.estimates.distance_m
    return replace_unchecked(state, std_at_start_m=start_m, unstepped_var_m2=0.0)


# The square of 50 degrees. Above it the rotation to the fixes is estimated again; below it the walking directions
# restore the heading. Among 0.25, 0.4, 0.5, 0.6 and 0.75 this value has the smallest errors of the shape on routes 21
# to 23 of ipin2023 (mean 1.2 m, against 2.5 m with 0.25). On the held-out routes 01 and 02 it is 2.8 m, against 2.5 m.
_LOST_HEADING_VAR_RAD2 = 0.75


def with_reopened_rotation(state: PedestrianState) -> PedestrianState:
    """Return the state with an unknown rotation to the frame of the fixes if the heading has been lost.

    Applies to a track in the frame of the fixes or of the start. The variance of the heading becomes the prior of the
    new rotation, about its first point pair. This is the last fix since an earlier loss, or the centre about which the
    heading error has rotated the track so far, whichever is more certain. The error of that centre is independent of
    the heading error. A rotation that is unknown since an earlier loss stays unknown until a fix arrives.
    """
    frame, is_placed = state.frame, state.frame.is_known or state.frame.is_of_start
    # the first step defines the heading, so that it cannot be lost before
    if not is_placed or state.steps.n_final == 0 or state.estimates.heading_var_rad2 < _LOST_HEADING_VAR_RAD2:
        return state
    if frame.since and not frame.is_joined and len(frame.agreeing) < 2:
        # No fix has arrived since the heading was lost, so keep the open frame. To open a new one at each step would
        # treat the persistent heading error as independent between steps.
        return state
    last = frame.agreeing[-1:]
    state = with_joined_frame(state)
    frame, steps, estimates = state.frame, state.steps, state.estimates
    (x, P), time_s = estimates.combined, steps.end_s
    heading_var_rad2 = float(P[HEADING_OFFSET, HEADING_OFFSET])
    lever_m = P[:HEADING_OFFSET, HEADING_OFFSET] / heading_var_rad2
    centre_m = read_only(x[:HEADING_OFFSET] + np.array([lever_m[NORTH], -lever_m[EAST]]))
    own_var_m2 = walked_var_m2(P) + 0.5 * float(np.trace(estimates.consider_cov_m2))
    turning_point = PairedPoint(centre_m, centre_m, own_var_m2, time_s=time_s)
    for fix in last:
        if (at_fix := steps.at(fix.time_s)) is not None:
            since_m = x[:HEADING_OFFSET] - at_fix[:HEADING_OFFSET]
            var_m2 = fix.var_m2 + min(0.5 * heading_var_rad2, 1.0) * float(since_m @ since_m)
            if var_m2 < fix.walked_var_m2:
                turning_point = replace(fix, track_m=read_only(at_fix[:2]), var_m2=var_m2, walked_var_m2=0.0)
    mean, cov = estimates.mean.copy(), estimates.cov.copy()
    mean[:, :LOG_SCALE] = x[:LOG_SCALE]
    cov[:, :LOG_SCALE] = cov[:, :, :LOG_SCALE] = 0.0
    no_error_m = np.zeros_like(estimates.consider_error_m)
    state = replace_unchecked(
        state,
        estimates=replace_unchecked(estimates, mean=mean, cov=cov, consider_error_m=no_error_m),
        frame=frame.with_lost_heading((turning_point,), heading_var_rad2, steps.n_final),
        fixes=replace_unchecked(state.fixes, relocation=RelocationEvidence(), used=(), ranges=()),
    )
    return with_change(state, lambda path: path.without_past(P, time_s, x[:2].copy()))


def heading_var_rad2(state: PedestrianState) -> float:
    """Return the variance of the heading in rad2, relative to the walk before the heading was lost."""
    lost_rad2 = state.frame.rotation_var_rad2 if state.frame.since else 0.0
    return state.estimates.heading_var_rad2 + lost_rad2


def with_joined_frame(state: PedestrianState) -> PedestrianState:
    """Return the state in the frame of the fixes, rotated by the most probable angle if the frame is not joined.

    The variance of the rotation becomes variance of the heading offset. Raises ValueError before the first fix.
    """
    frame = state.frame
    if frame.is_joined:
        return state
    turn = frame.most_probable(state.steps.n_final)
    return replace_unchecked(in_other_frame(state, turn), frame=frame.with_alignment(turn))


def in_other_frame(state: PedestrianState, alignment: Alignment) -> PedestrianState:
    """Return the state with all positions and headings transformed by an alignment.

    These are the estimates, the past path, the stored steps and fixes, the heading zero and the point pairs of the
    frame. The caller sets the frame of the result.
    """
    estimates = state.estimates
    mean, cov = transformed_estimates(estimates.mean, estimates.cov, alignment)
    consider_error_m = estimates.consider_error_m @ alignment.rotation.T
    turned = replace_unchecked(estimates, mean=mean, cov=cov, consider_error_m=consider_error_m)
    P, (x, turned_P) = estimates.combined[1], turned.combined
    state = replace_unchecked(
        with_moved_past(state, alignment.positions),
        estimates=turned,
        heading_zero=HeadingZero(state.heading_zero.offset_rad - alignment.angle_rad, state.heading_zero.time_s),
        frame=state.frame.with_moved_track(alignment),
    )
    return with_change(state, lambda path: path.with_alignment(alignment, P, turned_P, x[:2]))


def with_moved_past(state: PedestrianState, positions: Callable[[FloatArray], FloatArray]) -> PedestrianState:
    """Return the state with stored positions of steps and fixes transformed by a function of positions (..., 2)."""
    return replace_unchecked(
        state, steps=state.steps.with_moved_track(positions), fixes=state.fixes.with_moved_track(positions)
    )


def with_detached_path(state: PedestrianState) -> PedestrianState:
    """Return the state whose past positions no longer change with the present estimate."""
    x, P = state.estimates.combined
    end_s = state.steps.end_s
    return with_change(state, lambda path: path.without_past(P, end_s, x[:2].copy()))


def _step_update(
    model: PedestrianModel,
    previous: PedestrianState,
    updated: PedestrianState,
    step: Step,
    walked: Walked,
    estimate: StepEstimate,
    is_final: bool,
) -> StepUpdate:
    """Return the track row of a step that led from one state to the next."""
    x, P = estimate.combined
    # the history after a step has its speed
    speed, n_steps = cast(WalkingSpeed, updated.steps.speed), previous.steps.n_final
    cov_m2 = bounded_position_cov(position_cov(P, updated.estimates.consider_cov_m2), updated.reach_m)
    of_start = Pose(make_read_only(x[:2].copy()), cov_m2, walked.heading_rad, n_steps)
    pose = of_start if updated.frame.is_joined else updated.frame.world(of_start)
    return StepUpdate(
        index=n_steps,
        step=step,
        is_final=is_final,
        position_m=make_read_only(pose.position_m),
        position_cov_m2=make_read_only(within_reach(pose.cov_m2, updated.frame, updated.reach_m)),
        of_start=None if updated.frame.is_joined else of_start,
        step_length_m=walked.length_m,
        walked_m=updated.estimates.distance_m,
        walking_heading_rad=pose.heading_rad,
        speed=speed,
        context_prob=make_read_only(estimate.context_prob),
        contexts=model.contexts,
        mode_prob=make_read_only(estimate.mode_prob),
        gap_before_s=previous.steps.gap_s,
        reach_m=updated.reach_m,
    )


def within_reach(cov_m2: FloatArray, frame: Frame, reach_m: float) -> FloatArray:
    """Return a covariance (2, 2) that is at most the reach in the frame of the start, and unchanged in other frames.

    A lost heading is a rotation of the frame, and the reach does not contain the variance of fixes.
    """
    return bounded_position_cov(cov_m2, reach_m) if frame.name == "start" else cov_m2


def reckoned_position(state: PedestrianState) -> tuple[FloatArray, FloatArray]:
    """Return position (2,) and covariance (2, 2) after the last final step.

    They are in the frame of the fixes as soon as the rotation to that frame has an estimate.
    """
    pose = track_pose(state)
    pose = pose if state.frame.is_joined else state.frame.world(pose)
    return read_only(pose.position_m), read_only(within_reach(pose.cov_m2, state.frame, state.reach_m))


def past_position(state: PedestrianState, time_s: float) -> FloatArray | None:
    """Return the position (2,) at a time, in the frame of `reckoned_position`, or None if the steps are not stored."""
    pose, frame = state.steps.at(time_s), state.frame
    if pose is None or frame.is_joined:
        return None if pose is None else pose[:2]
    return frame.world(Pose(pose[:2], np.zeros((2, 2)), 0.0, state.steps.n_final)).position_m


def moved_by_heading_m(previous: PedestrianState, updated: PedestrianState, length_m: float) -> float:
    """Return the length of the move of the position minus the step length, in m, at least 0.

    The move leads from the combined position before a step to that after it. The move is longer than the step if the
    step corrected the heading, which rotates earlier steps. The result is 0 across a pause or a change of the frame.
    """
    is_pause = not updated.steps.last_s - previous.steps.last_s < PAUSE_S
    if (
        is_pause
        or previous.frame.alignment is not updated.frame.alignment
        or len(previous.frame.later) < len(updated.frame.later)
    ):
        return 0.0
    from_m, to_m = (e.prob.dot(e.mean[:, :LOG_SCALE]) for e in (previous.estimates, updated.estimates))
    moved_m = to_m - from_m
    return max(math.hypot(moved_m[EAST], moved_m[NORTH]) - length_m, 0.0)


def track_pose(state: PedestrianState) -> Pose:
    """Return the present position and its covariance in the frame of the filter states. The heading is set to 0."""
    x, P = state.estimates.combined
    cov_m2 = bounded_position_cov(position_cov(P, state.estimates.consider_cov_m2), state.reach_m)
    return Pose(x[[EAST, NORTH]], cov_m2, 0.0, state.steps.n_final)
