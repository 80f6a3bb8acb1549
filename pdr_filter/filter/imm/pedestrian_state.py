"""What a filter knows of a pedestrian, and how steps, gaps and a change of frame alter it: shared by both trackers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from pdr_filter.filter.fixes.alignment import Alignment, Place, moved
from pdr_filter.filter.fixes.fix_history import FixHistory
from pdr_filter.filter.fixes.frame import Frame
from pdr_filter.filter.fixes.frame_rotation import Compass, PairedPoint
from pdr_filter.filter.fixes.relocation import Doubt
from pdr_filter.filter.imm.estimates import ALONG_AND_ACROSS, LENGTH_PARAMETERS, Estimates, position_cov
from pdr_filter.filter.imm.motion_model import (
    EAST,
    HEADING_OFFSET,
    LOG_SCALE,
    NORTH,
    Directions,
    MotionNoise,
    expect_first_direction,
    grow_over_gap,
    initial_estimate,
    predict_heading,
    second_order_errors,
    update_heading,
)
from pdr_filter.filter.imm.past_path import PastPath, WalkedStep
from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.imm.step_history import StepHistory, Walked
from pdr_filter.filter.imm.walking_speed import WalkingSpeed
from pdr_filter.values import (
    FloatArray,
    OnPlan,
    Step,
    as_plain,
    frozen,
    read_only,
    replace_unchecked,
    wrap_angle,
)

# Two steps further apart than this have a pause between them.
_PAUSE_S = 2.0


@dataclass(frozen=True, eq=False)
class StepUpdate:
    """The track after one step.

    With `hc` and `wc` a step is first reported provisionally and again, with the same `index`, when the context window
    that follows it is known; `imm` reports each step once.
    """

    index: int  # number of the step in the track, from 0
    step: Step
    is_final: bool
    position_m: FloatArray  # (2,) east, north
    position_cov_m2: FloatArray  # (2, 2)
    step_length_m: float
    walked_m: float  # of all steps so far, this one among them
    walking_heading_rad: float  # clockwise, not wrapped
    speed: WalkingSpeed
    context_prob: FloatArray  # (C,)
    contexts: tuple[str, ...]  # C names
    mode_prob: FloatArray  # (M,)
    # The same in the frame of the start, while the turn to the frame of the fixes is not settled; None afterwards.
    of_start: Place | None
    gap_before_s: float  # time without samples since the step before
    # Where the step was known: above the start, and the storey; `filter.height.height_filter` knows them, a tracker
    # does not.
    height_m: float = 0.0
    height_std_m: float = 0.0
    floor: int = 0
    # Where particles on a floor plan are; with it position, covariance and heading are theirs. None without a plan.
    on_plan: OnPlan | None = None

    def in_frame(self, frame: Frame) -> StepUpdate:
        """The step by what is known of the frame later on, if it was reported before the turn was settled."""
        if self.of_start is None:
            return self
        place = frame.world(self.of_start)
        return replace_unchecked(
            self,
            position_m=read_only(place.position_m),
            position_cov_m2=read_only(place.cov_m2),
            walking_heading_rad=place.heading_rad,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON values: None for numbers that are not finite, context probabilities by name."""
        named = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "contexts"}
        contexts = dict(zip(self.contexts, self.context_prob, strict=True))
        return as_plain({"time_s": self.step.time_s, **named, "context_prob": contexts})


@dataclass(frozen=True, slots=True)
class HeadingZero:
    """Heading offset that counts as zero in the states: the first one that was known."""

    offset_rad: float = 0.0
    time_s: float = math.inf  # contact of the step that it was known from; infinite before


@dataclass(frozen=True, eq=False)
class PedestrianState:
    """Estimates after the latest event, and the history that later steps and fixes need.

    An event is a gap, a fix, or a step whose row of the track no longer changes.
    """

    estimates: Estimates
    frame: Frame  # whether positions are in the frame of the fixes yet
    heading_zero: HeadingZero = HeadingZero()
    steps: StepHistory = field(default_factory=StepHistory)
    fixes: FixHistory = field(default_factory=FixHistory)
    path: PastPath = field(default_factory=PastPath)  # of all steps, as it is estimated now
    # Second hypothesis of the position, where the last ranges fit two; `tracking.filtering` runs both.
    rival: Rival | None = None


@dataclass(frozen=True, eq=False)
class Rival:
    """The less probable one of two hypotheses, with its log odds against the other."""

    pedestrian: PedestrianState
    log_odds: float  # 0 or less


def initial_state(model: PedestrianModel, prob: FloatArray) -> PedestrianState:
    """State at the origin, of as many filters as probabilities (F,) are given."""
    mean, cov = initial_estimate(model.noise)
    estimates = Estimates(
        mean=np.tile(mean, (len(prob), 1)),
        cov=np.tile(cov, (len(prob), 1, 1)),
        prob=prob,
        walked_m=np.zeros(len(prob)),
        consider_error_m=np.zeros((2 + len(model.modes), 2)),
    )
    return PedestrianState(estimates, model.frame)


def with_heading(
    state: PedestrianState, step: Step, directions: Directions, noise: MotionNoise
) -> tuple[PedestrianState, FloatArray]:
    """Return the state with the heading of the next step, before its displacement.

    The heading offset first drifts for the time since the step before, because the heading stage designs its
    measurement with that drift; then the measured walking heading is used. The first one becomes the zero of the frame.
    The second value are the covariances (F, 4, 4) with the drift and without the measured heading.
    """
    estimates, zero = state.estimates, state.heading_zero
    since_s = step.duration_s if math.isnan(state.steps.last_s) else step.time_s - state.steps.last_s
    mean, drifted_cov = estimates.mean, predict_heading(estimates.cov, step, since_s, directions, noise)
    cov = drifted_cov
    if math.isfinite(step.walking_heading_std_rad):
        if math.isinf(zero.time_s):
            offset_rad = float(wrap_angle(step.walking_heading_rad - step.device_heading_rad))
            zero, cov = HeadingZero(offset_rad, step.time_s), expect_first_direction(cov, step.walking_heading_std_rad)
        else:
            mean, cov = update_heading(mean, cov, step, zero.offset_rad)
    return replace_unchecked(
        state, estimates=replace_unchecked(estimates, mean=mean, cov=cov), heading_zero=zero
    ), drifted_cov


def with_step(
    state: PedestrianState, step: Step, walked: Walked, combined: tuple[FloatArray, FloatArray], event: WalkedStep
) -> PedestrianState:
    """Return the state with all that a step changes besides means and covariances, which have the step already.

    `combined` is the combined mean (4,) and covariance (4, 4) after the step, and `event` what the
    path needs of it.
    """
    x, P = combined
    consider_error_m = state.estimates.consider_error_m + _consider_error_m(walked, P)
    return replace_unchecked(
        state,
        estimates=replace_unchecked(state.estimates, consider_error_m=consider_error_m),
        frame=_with_compass(state.frame, step, float(x[HEADING_OFFSET])),
        steps=state.steps.plus(step, walked, x, P),
        path=state.path.with_event(event),
    )


def _consider_error_m(walked: Walked, P: FloatArray) -> FloatArray:
    """Error (2 + M, 2) of one step for one std of each consider parameter, see `Estimates.consider_cov_m2`."""
    along, across = second_order_errors(float(P[HEADING_OFFSET, HEADING_OFFSET]), float(P[LOG_SCALE, LOG_SCALE]))
    sine, cosine = math.sin(walked.heading_rad), math.cos(walked.heading_rad)
    along_m, across_m = walked.length_m * along, walked.length_m * across
    error_m = np.empty((2 + len(walked.parameter_std_m), 2))
    error_m[ALONG_AND_ACROSS] = (along_m * sine, along_m * cosine), (across_m * cosine, -across_m * sine)
    np.multiply(walked.parameter_std_m[:, None], walked.direction, out=error_m[LENGTH_PARAMETERS])
    return error_m


def _with_compass(frame: Frame, step: Step, heading_offset_rad: float) -> Frame:
    """Frame with the magnetic north of a step, if it has one."""
    if not (math.isfinite(step.north_std_rad) and math.isfinite(step.shown_offset_std_rad)):
        return frame
    # rotation from the track's frame to north: walking direction against north minus that in the track's frame
    angle_rad = float(wrap_angle(step.shown_offset_rad - step.north_rad - heading_offset_rad))
    return frame.with_compass(Compass(angle_rad, step.north_std_rad**2 + step.shown_offset_std_rad**2))


def over_gap(state: PedestrianState, gap_s: float, noise: MotionNoise) -> PedestrianState:
    """Return the state after a time without samples: positions and headings are less known.

    The gap's own growth stands for the time since the last step.
    """
    estimates = replace_unchecked(state.estimates, cov=grow_over_gap(state.estimates.cov, gap_s, noise))
    P = state.estimates.combined[1]
    return replace_unchecked(
        state,
        estimates=estimates,
        steps=state.steps.after_gap(gap_s),
        fixes=state.fixes.after_gap(),
        path=state.path.predicted(P, estimates.combined[1]),
    )


# 50 degrees: beyond it the rotation to the fixes is estimated again, below it the walking directions restore the
# heading. Of 0.25, 0.4, 0.5, 0.6 and 0.75 this gave the smallest errors of shape on routes 21 to 23 of ipin2023 (mean
# 1.2 m instead of 2.5 m with 0.25); on routes 01 and 02, which had no part in the choice, it is 2.8 m instead of 2.5 m.
_LOST_HEADING_VAR_RAD2 = 0.75


def with_open_turn(state: PedestrianState) -> PedestrianState:
    """State in the frame of fixes, whose turn is open again from here on if its heading has been lost.

    Where it is becomes the first of the pairs that will show the turn, what is known of the heading the prior of that.
    """
    frame = state.frame
    if not frame.is_known or state.estimates.heading_var_rad2 < _LOST_HEADING_VAR_RAD2:
        return state
    if frame.since and not frame.is_joined and len(frame.agreeing) < 2:
        # nothing has been learnt since it was lost, and its errors last: opened anew each step they would be
        # independent
        return state
    steps = state.steps
    if not frame.is_joined:
        turn = frame.most_probable(steps.n_final)
        state = in_other_frame(state, turn)
        frame = frame.joined(turn)
    estimates = state.estimates
    x, P = estimates.combined
    var_m2 = 0.5 * float(np.trace(position_cov(P, estimates.consider_cov_m2)))
    time_s = steps.end_s
    turning_point = PairedPoint(read_only(x[:2]), read_only(x[:2]), var_m2, time_s=time_s)
    mean, cov = estimates.mean.copy(), estimates.cov.copy()
    mean[:, :LOG_SCALE] = x[:LOG_SCALE]
    cov[:, :LOG_SCALE] = cov[:, :, :LOG_SCALE] = 0.0
    no_error_m = np.zeros_like(estimates.consider_error_m)
    return replace_unchecked(
        state,
        estimates=replace_unchecked(estimates, mean=mean, cov=cov, consider_error_m=no_error_m),
        frame=frame.opened((turning_point,), float(P[HEADING_OFFSET, HEADING_OFFSET]), steps.n_final),
        fixes=replace_unchecked(state.fixes, doubt=Doubt(), used=(), ranges=()),
        path=state.path.detached(P, time_s, x[:2].copy()),
    )


def in_other_frame(state: PedestrianState, alignment: Alignment) -> PedestrianState:
    """State in another frame."""
    estimates = state.estimates
    mean, cov = moved(estimates.mean, estimates.cov, alignment)
    consider_error_m = estimates.consider_error_m @ alignment.rotation.T
    turned = replace_unchecked(estimates, mean=mean, cov=cov, consider_error_m=consider_error_m)
    x, turned_P = turned.combined
    return replace_unchecked(
        with_moved_past(state, alignment.positions),
        estimates=turned,
        path=state.path.turned(alignment, estimates.combined[1], turned_P, x[:2]),
        heading_zero=HeadingZero(state.heading_zero.offset_rad - alignment.angle_rad, state.heading_zero.time_s),
        frame=state.frame.moved(alignment),
    )


def with_moved_past(state: PedestrianState, positions: Callable[[FloatArray], FloatArray]) -> PedestrianState:
    """State with the remembered places of the track moved by a function of positions (..., 2)."""
    return replace_unchecked(state, steps=state.steps.moved(positions), fixes=state.fixes.moved(positions))


def with_detached_path(state: PedestrianState) -> PedestrianState:
    """State whose present place is learnt afresh: the path until now stays as it is."""
    x, P = state.estimates.combined
    return replace_unchecked(state, path=state.path.detached(P, state.steps.end_s, x[:2].copy()))


def step_update(
    previous: PedestrianState,
    updated: PedestrianState,
    step: Step,
    walked: Walked,
    combined: tuple[FloatArray, FloatArray],
    context_prob: FloatArray,
    mode_prob: FloatArray,
    contexts: tuple[str, ...],
    is_final: bool = True,
) -> StepUpdate:
    """Return the report of a step that led from one state to the next, see `with_step`."""
    x, P = combined
    speed, n_steps = updated.steps.speed, previous.steps.n_final
    if speed is None:
        raise ValueError("the state after a step must have a walking speed: use the state that with_step returns")
    cov_m2 = position_cov(P, updated.estimates.consider_cov_m2)
    of_start = Place(frozen(x[:2].copy()), cov_m2, walked.heading_rad, n_steps)
    place = of_start if updated.frame.is_joined else updated.frame.world(of_start)
    return StepUpdate(
        index=n_steps,
        step=step,
        is_final=is_final,
        position_m=frozen(place.position_m),
        position_cov_m2=frozen(place.cov_m2),
        of_start=None if updated.frame.is_joined else of_start,
        step_length_m=walked.length_m,
        walked_m=updated.estimates.distance_m,
        walking_heading_rad=place.heading_rad,
        speed=speed,
        context_prob=frozen(context_prob),
        contexts=contexts,
        mode_prob=frozen(mode_prob),
        gap_before_s=previous.steps.gap_s,
    )


def present_position(state: PedestrianState) -> tuple[FloatArray, FloatArray]:
    """Return position (2,) and covariance (2, 2) after the last final step.

    They are in the frame of the fixes as soon as the rotation to that frame has an estimate.
    """
    place = track_place(state)
    place = place if state.frame.is_joined else state.frame.world(place)
    return read_only(place.position_m), read_only(place.cov_m2)


def moved_by_heading_m(previous: PedestrianState, updated: PedestrianState, length_m: float) -> float:
    """Distance by which steps of this length moved the position too far; 0 across a pause or a change of frame."""
    is_pause = not updated.steps.last_s - previous.steps.last_s < _PAUSE_S
    if (
        is_pause
        or previous.frame.alignment is not updated.frame.alignment
        or len(previous.frame.later) < len(updated.frame.later)
    ):
        return 0.0
    from_m, to_m = (e.prob.dot(e.mean[:, :LOG_SCALE]) for e in (previous.estimates, updated.estimates))
    moved_m = to_m - from_m
    return max(math.hypot(moved_m[EAST], moved_m[NORTH]) - length_m, 0.0)


def track_place(state: PedestrianState) -> Place:
    """The place of the final estimate in the frame of the filter's states, without its heading."""
    x, P = state.estimates.combined
    return Place(x[[EAST, NORTH]], position_cov(P, state.estimates.consider_cov_m2), 0.0, state.steps.n_final)
