"""What a filter knows of a pedestrian, and how steps, gaps and a change of frame alter it: shared by both trackers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from pdr_filter.filter.fixes.alignment import Alignment, Place, moved
from pdr_filter.filter.fixes.frame import Frame
from pdr_filter.filter.fixes.frame_rotation import Compass, PairedPoint
from pdr_filter.filter.fixes.relocation import Doubt
from pdr_filter.filter.fixes.repeated_fixes import SeenPlace
from pdr_filter.filter.imm import imm
from pdr_filter.filter.imm.motion_model import (
    EAST,
    HEADING_OFFSET,
    LOG_SCALE,
    NORTH,
    Directions,
    MotionNoise,
    expect_first_direction,
    initial_estimate,
    predict_heading,
    second_order_errors,
    update_heading,
)
from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.imm.walking_speed import WalkingSpeed, after_step
from pdr_filter.values import (
    CONTEXTS,
    FloatArray,
    OnPlan,
    PositionFix,
    Step,
    as_plain,
    frozen,
    read_only,
    replace,
    wrap_angle,
)

# Final steps that are remembered for late fixes: a minute at four steps a second, which is how late a fix may be
# (`filtering.MAX_FIX_AGE_S`).
TRAIL_STEPS = 256
# Columns of the trail.
TRAIL_TIME, TRAIL_HEADING = 0, 3
TRAIL_POSITION = slice(1, 3)
# Two steps further apart than this have a pause between them.
_PAUSE_S = 2.0
# Rows of the consider parameters: along and across the step, then one for the length parameters of each mode.
_ALONG_AND_ACROSS, _LENGTH_PARAMETERS = slice(2), slice(2, None)


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
        return replace(
            self,
            position_m=read_only(place.position_m),
            position_cov_m2=read_only(place.cov_m2),
            walking_heading_rad=place.heading_rad,
        )

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON has them: None for what is not finite, contexts by their names, and the step's time."""
        named = {f.name: getattr(self, f.name) for f in fields(self)}
        contexts = dict(zip(CONTEXTS, self.context_prob, strict=True))
        return as_plain({"time_s": self.step.time_s, **named, "context_prob": contexts})


@dataclass(frozen=True, eq=False)
class UsedFix:
    """A used position fix with a correlated error, and where the track was then; None if a gap followed it."""

    fix: PositionFix
    track_m: FloatArray | None  # (2,)


@dataclass(frozen=True, eq=False)
class PedestrianState:
    """Estimates of F filters (one for each mode with `imm`, one alone with `hc` and `wc`) and what goes with them."""

    mean: FloatArray  # (F, 4)
    cov: FloatArray  # (F, 4, 4)
    prob: FloatArray  # (F,) of each filter
    walked_m: FloatArray  # (F,) expected distance of all steps so far, if each filter is right about the last of them
    consider_error_m: FloatArray  # (2 + M, 2) of the position, one std of each consider parameter, see `consider_cov`
    last_step_s: float  # contact of the last final step; NaN before the first
    gap_s: float  # time without samples since then
    speed: WalkingSpeed | None  # after the last final step; None before the first of a segment
    first_heading_rad: float  # heading offset that counts as zero: the first that was known
    first_heading_s: float  # contact of the step that it was known from; infinite before
    trail: FloatArray  # (R, 4) time, east, north, device heading of the last final steps: where a late fix belongs
    frame: Frame  # whether positions are in the frame of the fixes yet
    doubt: Doubt  # position fixes that the track does not explain
    used_fixes: tuple[UsedFix, ...]  # the last ones whose errors the next one shares
    seen: SeenPlace | None
    n_fix_errors: int  # innovations of used position fixes, one an axis
    fix_squares: float  # sum of their normalised squares
    n_frozen_fixes: int  # positions that were repeated while steps went on
    standstills: tuple[tuple[float, float], ...]  # begin and end of the last ones
    n_final: int  # steps


def initial_state(model: PedestrianModel, prob: FloatArray) -> PedestrianState:
    """State at the origin, of as many filters as probabilities (F,) are given."""
    mean, cov = initial_estimate(model.noise)
    return PedestrianState(
        mean=np.tile(mean, (len(prob), 1)),
        cov=np.tile(cov, (len(prob), 1, 1)),
        prob=prob,
        walked_m=np.zeros(len(prob)),
        consider_error_m=np.zeros((2 + len(model.modes), 2)),
        last_step_s=np.nan,
        gap_s=0.0,
        speed=None,
        first_heading_rad=0.0,
        first_heading_s=np.inf,
        trail=np.empty((0, 4)),
        frame=model.frame,
        doubt=Doubt(),
        used_fixes=(),
        seen=None,
        n_fix_errors=0,
        fix_squares=0.0,
        n_frozen_fixes=0,
        standstills=(),
        n_final=0,
    )


def with_heading(state: PedestrianState, step: Step, directions: Directions, noise: MotionNoise) -> PedestrianState:
    """Return the state with the heading of the next step, before its displacement.

    The heading offset first drifts for the time since the step before, because the heading stage designs its
    measurement with that drift; then the measured walking heading is used. The first one becomes the zero of the frame.
    """
    since_s = step.duration_s if math.isnan(state.last_step_s) else step.time_s - state.last_step_s
    cov = predict_heading(state.cov, step, since_s, directions, noise)
    if not math.isfinite(step.walking_heading_std_rad):
        return replace(state, cov=cov)
    if math.isinf(state.first_heading_s):
        first_rad = float(wrap_angle(step.walking_heading_rad - step.device_heading_rad))
        cov = expect_first_direction(cov, step.walking_heading_std_rad)
        return replace(state, cov=cov, first_heading_rad=first_rad, first_heading_s=step.time_s)
    mean, cov = update_heading(state.mean, cov, step, state.first_heading_rad)
    return replace(state, mean=mean, cov=cov)


def is_known_to_stand(state: PedestrianState, step: Step) -> bool:
    """Whether the person is known to have stood at a step's contact."""
    return any(begin_s <= step.time_s <= end_s for begin_s, end_s in state.standstills)


@dataclass(frozen=True, slots=True, eq=False)
class Walked:
    """One step as a tracker weighted it. Evidence also moves the estimated position, which is not walking."""

    length_m: float
    length_var_m2: float  # without the person's scale
    heading_rad: float
    parameter_std_m: FloatArray  # (M,) due to the parameters of each mode's length model, weighted by its probability
    direction: FloatArray  # (M, 2), or (1, 2) of all: east and north of the unit vector in which each mode walked


def with_step(
    state: PedestrianState, step: Step, walked: Walked, combined: tuple[FloatArray, FloatArray]
) -> PedestrianState:
    """State whose means and covariances have the step already, with all else that a step changes.

    `combined` is the combined mean (4,) and covariance (4, 4) after the step.
    """
    x, P = combined
    log_scale_var = float(P[LOG_SCALE, LOG_SCALE])
    # a pause before the step starts the smoothed speed afresh
    is_pause = math.isnan(state.last_step_s) or step.time_s - state.last_step_s > 1.5 * step.duration_s
    frame = state.frame
    if math.isfinite(step.north_std_rad) and math.isfinite(step.shown_offset_std_rad):
        # where the person walks against north, less where he walks in the track's frame
        angle_rad = float(wrap_angle(step.shown_offset_rad - step.north_rad - float(x[HEADING_OFFSET])))
        frame = frame.with_compass(Compass(angle_rad, step.north_std_rad**2 + step.shown_offset_std_rad**2))
    trail = np.empty((min(len(state.trail) + 1, TRAIL_STEPS), 4))
    trail[:-1] = state.trail[len(state.trail) + 1 - len(trail) :]
    trail[-1] = step.time_s, x[EAST], x[NORTH], step.device_heading_rad
    return replace(
        state,
        frame=frame,
        consider_error_m=state.consider_error_m + _consider_error_m(walked, P),
        speed=after_step(
            state.speed, walked.length_m, walked.length_var_m2, step.duration_s, log_scale_var, is_first=is_pause
        ),
        last_step_s=step.time_s,
        gap_s=0.0,
        trail=trail,
        n_final=state.n_final + 1,
    )


def _consider_error_m(walked: Walked, P: FloatArray) -> FloatArray:
    """Error (2 + M, 2) of one step for one standard deviation of each consider parameter, see `consider_cov`."""
    along, across = second_order_errors(float(P[HEADING_OFFSET, HEADING_OFFSET]), float(P[LOG_SCALE, LOG_SCALE]))
    sine, cosine = math.sin(walked.heading_rad), math.cos(walked.heading_rad)
    along_m, across_m = walked.length_m * along, walked.length_m * across
    error_m = np.empty((2 + len(walked.parameter_std_m), 2))
    error_m[_ALONG_AND_ACROSS] = (along_m * sine, along_m * cosine), (across_m * cosine, -across_m * sine)
    np.multiply(walked.parameter_std_m[:, None], walked.direction, out=error_m[_LENGTH_PARAMETERS])
    return error_m


# Half a radian: the step along a heading that is off by so much is an eighth shorter than a linear filter believes.
_LOST_HEADING_VAR_RAD2 = 0.25


def with_open_turn(state: PedestrianState) -> PedestrianState:
    """State in the frame of fixes, whose turn is open again from here on if its heading has been lost.

    Where it is becomes the first of the pairs that will show the turn, what is known of the heading the prior of that.
    """
    frame = state.frame
    if not frame.is_known or float(state.prob @ state.cov[:, HEADING_OFFSET, HEADING_OFFSET]) < _LOST_HEADING_VAR_RAD2:
        return state
    if frame.since and not frame.is_joined and len(frame.agreeing) < 2:
        # nothing has been learnt since it was lost, and its errors last: opened anew each step they would be
        # independent
        return state
    if not frame.is_joined:
        turn = frame.most_probable(state.n_final)
        state = in_other_frame(state, turn)
        frame = frame.joined(turn)
    x, P = imm.combine(state.mean, state.cov, state.prob)
    var_m2 = 0.5 * float(np.trace(position_cov(P, consider_cov(state))))
    time_s = float(state.trail[-1, TRAIL_TIME]) if len(state.trail) else 0.0
    here = PairedPoint(read_only(x[:2]), read_only(x[:2]), var_m2, time_s=time_s)
    mean, cov = state.mean.copy(), state.cov.copy()
    mean[:, :LOG_SCALE] = x[:LOG_SCALE]
    cov[:, :LOG_SCALE] = cov[:, :, :LOG_SCALE] = 0.0
    return replace(
        state,
        mean=mean,
        cov=cov,
        consider_error_m=np.zeros_like(state.consider_error_m),
        frame=frame.opened((here,), float(P[HEADING_OFFSET, HEADING_OFFSET]), state.n_final),
        doubt=Doubt(),
        used_fixes=(),
    )


def in_other_frame(state: PedestrianState, alignment: Alignment) -> PedestrianState:
    """State in another frame."""
    mean, cov = moved(state.mean, state.cov, alignment)
    return replace(
        with_moved_past(state, alignment.positions),
        mean=mean,
        cov=cov,
        first_heading_rad=state.first_heading_rad - alignment.angle_rad,
        consider_error_m=state.consider_error_m @ alignment.rotation.T,
        frame=state.frame.moved(alignment),
    )


def with_moved_past(state: PedestrianState, positions: Callable[[FloatArray], FloatArray]) -> PedestrianState:
    """State with the remembered places of the track moved by a function of positions (..., 2)."""
    trail = state.trail.copy()
    trail[:, TRAIL_POSITION] = positions(state.trail[:, TRAIL_POSITION])
    used = (f if f.track_m is None else replace(f, track_m=read_only(positions(f.track_m))) for f in state.used_fixes)
    seen = state.seen
    seen = None if seen is None else replace(seen, track_m=read_only(positions(seen.track_m)))
    return replace(state, trail=trail, used_fixes=tuple(used), seen=seen, doubt=state.doubt.moved(positions))


def after_gap(state: PedestrianState) -> PedestrianState:
    """State in which nothing is known of the way since the used fixes."""
    used = tuple(replace(f, track_m=None) for f in state.used_fixes)
    return replace(state, used_fixes=used, seen=state.seen if state.seen and state.seen.is_frozen else None)


def step_update(
    previous: PedestrianState,
    updated: PedestrianState,
    step: Step,
    walked: Walked,
    combined: tuple[FloatArray, FloatArray],
    context_prob: FloatArray,
    mode_prob: FloatArray,
    is_final: bool = True,
) -> StepUpdate:
    """Return the report of a step that led from one state to the next, see `with_step`."""
    x, P = combined
    if updated.speed is None:
        raise ValueError("the state after a step must have a walking speed: use the state that with_step returns")
    of_start = Place(frozen(x[:2].copy()), position_cov(P, consider_cov(updated)), walked.heading_rad, previous.n_final)
    place = of_start if updated.frame.is_joined else updated.frame.world(of_start)
    return StepUpdate(
        index=previous.n_final,
        step=step,
        is_final=is_final,
        position_m=frozen(place.position_m),
        position_cov_m2=frozen(place.cov_m2),
        of_start=None if updated.frame.is_joined else of_start,
        step_length_m=walked.length_m,
        walked_m=float(updated.prob.dot(updated.walked_m)),
        walking_heading_rad=place.heading_rad,
        speed=updated.speed,
        context_prob=frozen(context_prob),
        mode_prob=frozen(mode_prob),
        gap_before_s=previous.gap_s,
    )


def present_position(state: PedestrianState) -> tuple[FloatArray, FloatArray]:
    """Position (2,) and covariance (2, 2) of the final estimate, in the frame of the fixes as far as it is known."""
    own = own_place(state)
    place = own if state.frame.is_joined else state.frame.world(own)
    return read_only(place.position_m), read_only(place.cov_m2)


def heading_std_rad(state: PedestrianState) -> float:
    """Standard deviation of the heading offset, over all filters."""
    return math.sqrt(float(state.prob.dot(state.cov[:, HEADING_OFFSET, HEADING_OFFSET])))


def moved_by_heading_m(before: PedestrianState, after: PedestrianState, length_m: float) -> float:
    """Distance by which steps of this length moved the position too far; 0 across a pause or a change of frame."""
    is_pause = not after.last_step_s - before.last_step_s < _PAUSE_S
    if (
        is_pause
        or before.frame.alignment is not after.frame.alignment
        or len(before.frame.later) < len(after.frame.later)
    ):
        return 0.0
    moved_m = after.prob.dot(after.mean[:, :LOG_SCALE]) - before.prob.dot(before.mean[:, :LOG_SCALE])
    return max(math.hypot(moved_m[EAST], moved_m[NORTH]) - length_m, 0.0)


def own_place(state: PedestrianState) -> Place:
    """The place of the final estimate in the frame of the filter's states, without its heading."""
    x, P = imm.combine(state.mean, state.cov, state.prob)
    return Place(x[[EAST, NORTH]], position_cov(P, consider_cov(state)), 0.0, state.n_final)


def position_cov(P: FloatArray, consider_cov_m2: FloatArray) -> FloatArray:
    """Covariance (2, 2) of a position with linear covariance P (4, 4) and this `consider_cov`."""
    (xx, xy, _, _), (yx, yy, _, _) = P[:2].tolist()
    (consider_xx, consider_xy), (_, consider_yy) = consider_cov_m2.tolist()
    xy = 0.5 * (xy + yx) + consider_xy
    return frozen(np.array(((xx + consider_xx, xy), (xy, yy + consider_yy))))


def consider_cov(state: PedestrianState) -> FloatArray:
    """Covariance (2, 2) that the consider parameters add to that of the position.

    A consider parameter is a constant that a filter does not estimate, but whose uncertainty is part of its covariance
    (the Schmidt-Kalman filter: S. F. Schmidt, "Application of state-space methods to navigation problems", Advances in
    Control Systems 3, 1966; B. D. Tapley, B. E. Schutz and G. H. Born, "Statistical Orbit Determination", 2004, chapter
    6). With S the derivative of the position with respect to the parameters and C their covariance, S C S' adds to the
    position's own covariance. The rows of `consider_error_m` are the columns of S C^(1/2): the error of the position
    for one standard deviation of each parameter. They add up over the steps as vectors, not as variances, because a
    parameter has the same error in all steps of a person. With independent errors a run of 300 steps would have a
    standard deviation ten times too small.

    The parameters are the second-order errors along and across the steps (`motion_model.second_order_errors`), and for
    each mode those of its length model. A used position fix moves this covariance into that of the states
    (`fix_updates`), where Schmidt's filter would keep the covariance of parameters and states.
    """
    return state.consider_error_m.T.dot(state.consider_error_m)


def length_parameters_cov(state: PedestrianState) -> FloatArray:
    """Part (2, 2) of `consider_cov` that is due to the parameters of the length models."""
    error_m = state.consider_error_m[_LENGTH_PARAMETERS]
    return error_m.T @ error_m
