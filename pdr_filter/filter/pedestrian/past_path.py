"""Past positions given all later measurements: a smoother that runs together with the filter.

Let x be the present state (east, north, heading offset, log scale). Each past position is
p = place + B (x - mean) + e, with an error e that is uncorrelated with x. This is exact for a linear filter:

- A prediction x' = F x + w replaces B by B G, with G = P F' P'^-1. It adds B (P - G P' G') B' to the covariance of e.
- A correction of x by a fix, a heading or a context leaves B and e unchanged. The place moves by B times the correction
  of the mean, or along an arc if the heading is corrected.

The result is that of a Rauch-Tung-Striebel smoother (A. Gelb, "Applied Optimal Estimation", 1974, section 5.4:
fixed-point smoothing), without a backward pass. The last events are stored and processed together as a block, so that
the path adds only a tenth to the time of a step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import starmap

import numpy as np

from pdr_filter.filter.imm import imm
from pdr_filter.filter.imm.motion_model import EAST, HEADING_OFFSET, N_STATES, NORTH
from pdr_filter.filter.imm.step_cycle import Cycle
from pdr_filter.filter.pedestrian.alignment import Alignment
from pdr_filter.values import FloatArray, replace_unchecked

# Number of events that are processed together.
_BLOCK = 32
# A correction of the heading rotates the steps before it. Below this angle the steps of the block are moved along the
# tangent, which is at most 0.1 m from the arc for a lever of 20 m.
_LARGE_TURN_RAD = 0.1
# Largest number of stored steps: an hour of walking at two steps a second. Beyond it, older steps are thinned evenly.
MAX_STEPS = 8192
# Added to covariances before inversion, in case a state is known exactly: the square of 0.01 mm.
_MIN_VAR = 1e-10
_MIN_COV = _MIN_VAR * np.eye(N_STATES)
_POSITION_ROWS = np.eye(2, N_STATES)[:, :, None]
# Largest variance of shared length errors per square metre of displacement: the square of 10 %.
_MAX_SHARED = 0.01
# Shared errors with a smaller share of the variance of the position are treated as noise, because they hardly bend the
# path.
_MIN_SHARED = 0.01


@dataclass(frozen=True, eq=False)
class BackwardRelation:
    """Backward relation from the later state x' (4,) to an earlier state x (4,).

    x = mean + correction + gain (x' - mean') + error, where the error has the covariance `error_cov`. mean is the
    estimate of x when x was the present state. mean' is the estimate of x' when x' was the present state.

    Attributes
    ----------
    gain : (..., 4, 4) array
        Smoother gain G.
    error_cov : (..., 4, 4) array
        Covariance P - G P' G' of the error.
    correction : (..., 4) array
        Correction of the estimate of x by the measurements between the two times. The correction is not part of mean,
        so that mean + correction is the smoothed estimate of x.
    scale : float, default 1.0
        Factor by which the covariances of all errors before x' are multiplied, as after a position fix that deviates
        more than expected.
    """

    gain: FloatArray
    error_cov: FloatArray
    correction: FloatArray
    scale: float = 1.0

    @property
    def turned_rad(self) -> float:
        """Correction of the heading offset in the earlier state x between the two times, rad."""
        return float(self.correction[HEADING_OFFSET])

    @classmethod
    def over_prediction(cls, before: FloatArray, cross: FloatArray, after: FloatArray) -> BackwardRelation:
        """Return the backward relation over a prediction from state x to state x'.

        The arguments are the covariance of x, the cross-covariance of x and x', and the covariance of x', each (..., 4,
        4).
        """
        gain = cross @ np.linalg.inv(after + _MIN_COV)
        return cls(gain, before - gain @ cross.swapaxes(-1, -2), np.zeros(before.shape[:-1]))

    def followed_by(self, later: BackwardRelation) -> BackwardRelation:
        """Return the backward relation over this interval and the following one.

        This relation leads from the state x' back to x. `later` leads from a later state x'' back to x'. The result
        leads from x'' back to x.
        """
        gain = self.gain
        error_cov = later.scale * self.error_cov + gain @ later.error_cov @ gain.swapaxes(-1, -2)
        correction = self.correction + _times(gain, later.correction)
        return BackwardRelation(gain @ later.gain, error_cov, correction, self.scale * later.scale)

    def with_correction(self, correction: FloatArray) -> BackwardRelation:
        """Return the relation after the estimate of the later state x' was corrected by `correction` (..., 4)."""
        return replace_unchecked(self, correction=self.correction + _times(self.gain, correction))


_UNCHANGED = BackwardRelation(np.eye(N_STATES), np.zeros((N_STATES, N_STATES)), np.zeros(N_STATES))


@dataclass(frozen=True, eq=False)
class WalkedStep:
    """Predictions and updates of one step in all F filters of a tracker.

    Attributes
    ----------
    time_s : float
        Contact that ends the step.
    updated_mean : (4,) array
        Combined mean after the evidence of the step.
    prob : (F,) array
        Filter probabilities before the evidence of the step.
    mean, cov : (F, 4) and (F, 4, 4) array
        Moments before the step.
    drifted_cov : (F, 4, 4) array
        Covariances after the drift of the heading offset.
    turned_mean, turned_cov : (F, 4) and (F, 4, 4) array
        Moments after the measured heading.
    ahead_mean, ahead_cov : (F, 4) and (F, 4, 4) array
        Moments after the displacement.
    by_state : (F, 4, 4) array
        Derivative of the state after the displacement with respect to the state before it (`Advance.by_state`).
    """

    time_s: float
    updated_mean: FloatArray
    prob: FloatArray
    mean: FloatArray
    cov: FloatArray
    drifted_cov: FloatArray
    turned_mean: FloatArray
    turned_cov: FloatArray
    ahead_mean: FloatArray
    ahead_cov: FloatArray
    by_state: FloatArray

    @property
    def turned_rad(self) -> float:
        """Correction of the combined heading offset by the measured heading and the evidence of this step, rad."""
        return float(self.updated_mean[HEADING_OFFSET] - self.prob.dot(self.mean[:, HEADING_OFFSET]))

    @classmethod
    def of(cls, time_s: float, cycle: Cycle, updated_mean: FloatArray) -> WalkedStep:
        """Return the step at a contact, from its cycle to the combined mean (4,) after it."""
        before, ahead = cycle.before, cycle.ahead
        turned = cycle.drifted_cov, cycle.turned_mean, cycle.turned_cov
        of_cycle = before.prob, before.mean, before.cov, *turned, ahead.mean, ahead.cov, cycle.by_state
        return cls(time_s, updated_mean, *of_cycle)


@dataclass(frozen=True, eq=False)
class RelatedStep:
    """A walked step of which only the backward relation is kept, in a tenth of the numbers, for saving.

    Attributes
    ----------
    time_s : float
        Contact that ends the step.
    updated_mean : (4,) array
        Combined mean after the evidence of the step.
    back : BackwardRelation
        Backward relation from the combined state after the step to that before it.
    """

    time_s: float
    updated_mean: FloatArray
    back: BackwardRelation


@dataclass(frozen=True, eq=False)
class SavedEvents:
    """Events of a saved path. A few arrays are saved in less time than the many of single events.

    A row is a `RelatedStep`, or a `BackwardRelation` alone if its time is NaN.
    """

    time_s: FloatArray  # (N,)
    updated_mean: FloatArray  # (N, 4)
    gain: FloatArray  # (N, 4, 4)
    error_cov: FloatArray  # (N, 4, 4)
    correction: FloatArray  # (N, 4)
    scale: tuple[float, ...]  # (N,)

    @classmethod
    def of(cls, events: Sequence[RelatedStep | BackwardRelation]) -> SavedEvents:
        """Return the events in arrays."""
        steps = [event if isinstance(event, RelatedStep) else None for event in events]
        backs = [event.back if isinstance(event, RelatedStep) else event for event in events]
        return cls(
            np.array([step.time_s if step else math.nan for step in steps]),
            np.array([step.updated_mean if step else np.zeros(N_STATES) for step in steps]),
            np.array([back.gain for back in backs]),
            np.array([back.error_cov for back in backs]),
            np.array([back.correction for back in backs]),
            tuple(back.scale for back in backs),
        )

    @property
    def events(self) -> tuple[RelatedStep | BackwardRelation, ...]:
        """The events of which this was made."""
        backs = starmap(BackwardRelation, zip(self.gain, self.error_cov, self.correction, self.scale, strict=True))
        rows = zip(self.time_s.tolist(), self.updated_mean, backs, strict=True)
        return tuple(back if math.isnan(t) else RelatedStep(t, mean, back) for t, mean, back in rows)


def _relations_over_steps(steps: Sequence[WalkedStep]) -> list[BackwardRelation]:
    """Return the backward relation over each step, from the combined state after the step to that before it."""
    (_, updated, prob, mean, cov, drifted_cov, turned_mean, turned_cov, ahead_mean, ahead_cov, by_state) = (
        np.array([getattr(step, name) for step in steps]) for name in WalkedStep.__dataclass_fields__
    )
    x, P = imm.combine(mean, cov, prob)
    turned_x, turned_P = imm.combine(turned_mean, turned_cov, prob)
    ahead_x, ahead_P = imm.combine(ahead_mean, ahead_cov, prob)
    weights = prob[..., None, None]
    cross = (weights * (turned_cov @ by_state.swapaxes(-1, -2))).sum(axis=1)
    spread = (turned_mean - turned_x[:, None]) * prob[..., None]
    cross += spread.swapaxes(-1, -2) @ (ahead_mean - ahead_x[:, None])
    drift = BackwardRelation.over_prediction(P, P, imm.combine(mean, drifted_cov, prob)[1])
    step = BackwardRelation.over_prediction(turned_P, cross, ahead_P)
    back = drift.with_correction(turned_x - x).followed_by(step.with_correction(updated - ahead_x))
    return [BackwardRelation(*each) for each in zip(back.gain, back.error_cov, back.correction, strict=True)]


@dataclass(frozen=True, eq=False)
class PastSteps:
    """Past steps and their relation to a later state x (east, north, heading offset, log scale).

    The position of a step is place + B (x - mean) + e, with mean the estimate of x and e an error that is uncorrelated
    with x. The last axis of all arrays counts the steps.
    """

    time_s: FloatArray  # (N,) contacts of the steps
    position_m: FloatArray  # (2, N) estimated positions (east, north) after each step
    by_state: FloatArray  # (2, 4, N) B, the derivative of each position with respect to the later state
    own_cov_m2: FloatArray  # (3, N) covariance of the error e, as (east east, east north, north north)

    def __len__(self) -> int:
        return len(self.time_s)

    def with_later(self, later: PastSteps) -> PastSteps:
        """Return these steps and later ones, thinned to at most `MAX_STEPS`."""
        keep = np.ones(len(self), dtype=bool)
        if len(self) + len(later) > MAX_STEPS:
            # remove only every second step of the older three quarters, those with the nearest neighbours first
            each = np.arange(1, 3 * len(self) // 4, 2)
            apart_s = self.time_s[each + 1] - self.time_s[each - 1]
            keep[each[np.argsort(apart_s, kind="stable")[: MAX_STEPS // 8]]] = False
        pairs = ((getattr(self, name)[..., keep], getattr(later, name)) for name in self.__dataclass_fields__)
        # Contiguous as in a loaded filter, because the bits of matrix products depend on the layout.
        return PastSteps(*(np.ascontiguousarray(np.concatenate(pair, axis=-1)) for pair in pairs))

    def cov_m2(self, cov: FloatArray) -> FloatArray:
        """Return the covariances (3, N) of the positions, for a covariance (4, 4) of the later state."""
        return self.own_cov_m2 + _propagated(self.by_state, cov)

    def moved_m(self, moved: FloatArray) -> FloatArray:
        """Return the positions (2, N) after a correction (4,) of the later state.

        A correction of the heading moves the positions along an arc, as in `motion_model.update_heading`.
        """
        turn_rad, along_arc = float(moved[HEADING_OFFSET]), moved.copy()
        along_arc[HEADING_OFFSET] = math.sin(turn_rad)
        position_m = self.position_m + along_arc @ self.by_state
        lever_m, versine = self.by_state[:, HEADING_OFFSET], 1.0 - math.cos(turn_rad)
        position_m[EAST] += versine * lever_m[NORTH]
        position_m[NORTH] -= versine * lever_m[EAST]
        return position_m

    def related_to(self, back: BackwardRelation) -> PastSteps:
        """Return the steps related to a later state x' instead of the state x.

        `back` is the backward relation from x' to x.
        """
        own_cov_m2 = back.scale * self.own_cov_m2 + _propagated(self.by_state, back.error_cov)
        return PastSteps(self.time_s, self.moved_m(back.correction), back.gain.T @ self.by_state, own_cov_m2)

    def with_moments(
        self, position_m: FloatArray, cov_m2: FloatArray, cross: FloatArray, state_cov: FloatArray
    ) -> PastSteps:
        """Return the steps with given positions (2, N) and position covariances (3, N), related to a given state.

        `cross` (2, 4, N) are the cross-covariances C of the positions with the state, and `state_cov` (4, 4) is its
        covariance S. The derivative `by_state` becomes B = C S^-1, and `own_cov_m2` the rest of the covariance, which
        is `cov_m2` - B C'.
        """
        by = np.linalg.inv(state_cov + _MIN_COV) @ cross
        return PastSteps(self.time_s, position_m, by, cov_m2 - _products(by, cross))


NO_STEPS = PastSteps(np.empty(0), np.empty((2, 0)), np.empty((2, N_STATES, 0)), np.empty((3, 0)))


@dataclass(frozen=True, eq=False)
class PastPath:
    """All past steps of a filter, related to its present state.

    Attributes
    ----------
    earlier : PastSteps
        Steps related to the state before `events`.
    events : tuple of WalkedStep, RelatedStep or BackwardRelation
        Last events, not yet applied to `earlier`.
    since_s : float
        Time until which steps are already in the frame of the fixes. A change of the present frame does not move these
        steps.
    shared_from_m : (2,) array
        Position of the track when errors that all steps share were last added to the covariance of the state. Such
        errors, for example those of consider parameters, grow in proportion to the displacement from this position.
    shared_from_s : float
        Time at which the track was at `shared_from_m`.
    saved_events : SavedEvents, optional
        The events of a saved path, instead of `events`.
    """

    earlier: PastSteps = NO_STEPS
    events: tuple[WalkedStep | RelatedStep | BackwardRelation, ...] = ()
    since_s: float = -math.inf
    shared_from_m: FloatArray = field(default_factory=lambda: np.zeros(2))
    shared_from_s: float = -math.inf
    saved_events: SavedEvents | None = None

    def __post_init__(self) -> None:
        if self.saved_events is not None:  # in a loaded path
            object.__setattr__(self, "events", self.saved_events.events)
            object.__setattr__(self, "saved_events", None)

    def with_event(self, event: WalkedStep | BackwardRelation) -> PastPath:
        """Return the path after one more event: a step, or a backward relation over a change of the state."""
        if abs(event.turned_rad) > _LARGE_TURN_RAD:
            return replace_unchecked(self.related_to_present(), events=(event,)).related_to_present()
        path = replace_unchecked(self, events=(*self.events, event))
        return path.related_to_present() if len(path.events) >= _BLOCK else path

    def after_prediction(self, before: FloatArray, after: FloatArray) -> PastPath:
        """Return the path after the covariance (4, 4) of the present state has grown from `before` to `after`."""
        return self.with_event(BackwardRelation.over_prediction(before, before, after))

    def after_correction(self, moved: FloatArray, scale: float) -> PastPath:
        """Return the path after a correction (4,) of the present state.

        `scale` is the factor by which the covariances of all errors so far are multiplied.
        """
        return self.with_event(replace_unchecked(_UNCHANGED, correction=moved, scale=scale))

    def related_to_present(self) -> PastPath:
        """Return the path with all steps related to the present state."""
        if not self.events:
            return self
        back, last = self._last()
        return replace_unchecked(self, earlier=self.earlier.related_to(back).with_later(last), events=())

    def _last(self) -> tuple[BackwardRelation, PastSteps]:
        """Return the backward relation over all stored events, and the stored steps related to the present state."""
        steps, back, after_steps = list[RelatedStep](), _UNCHANGED, list[BackwardRelation]()
        for event in reversed(self._related_events()):
            if isinstance(event, RelatedStep):
                steps.append(event)
                after_steps.append(back)
            back = (event.back if isinstance(event, RelatedStep) else event).followed_by(back)
        return back, _related_steps(steps[::-1], after_steps[::-1]) if steps else NO_STEPS

    def for_saving(self) -> PastPath:
        """Return the path with the backward relations of all steps, which a saved path needs instead of their moments.

        The bits of a relation do not depend on the other steps with which it is computed.
        """
        if not self.events:
            return self
        return replace_unchecked(self, events=(), saved_events=SavedEvents.of(self._related_events()))

    def _related_events(self) -> tuple[RelatedStep | BackwardRelation, ...]:
        walked = [event for event in self.events if isinstance(event, WalkedStep)]
        backs = iter(_relations_over_steps(walked) if walked else ())
        return tuple(
            RelatedStep(event.time_s, event.updated_mean, next(backs)) if isinstance(event, WalkedStep) else event
            for event in self.events
        )

    def with_shared(
        self, before: FloatArray, shared_m2: FloatArray, after: FloatArray, time_s: float, present_m: FloatArray
    ) -> PastPath:
        """Return the path after errors that all steps share have been added to the covariance of the present state.

        `shared_m2` (2, 2) is the covariance of the shared errors at the present position `present_m` (2,), at the time
        `time_s`. `before` and `after` (4, 4) are the covariances of the present state without and with them. The shared
        error of a past step is proportional to its displacement from `shared_from_m`. This error is added to the
        covariance of the step and to its covariance with the present state. Later corrections of the state therefore
        move the step, too. Shared errors that arise later accumulate from `present_m`.
        """
        if np.trace(shared_m2) < _MIN_SHARED * np.trace(before[:2, :2]):
            return replace_unchecked(
                self.after_prediction(before, after), shared_from_s=time_s, shared_from_m=present_m
            )
        path, displacement_m, share = (
            self.related_to_present(),
            present_m - self.shared_from_m,
            self._share(shared_m2, present_m),
        )
        steps = path.earlier
        since_m = self._since_shared_m(steps.time_s, steps.position_m)
        cross = before @ steps.by_state
        cross[:, :2] += share * since_m[:, None] * displacement_m[:, None]
        cov_m2 = steps.cov_m2(before) + share * _squares(since_m)
        earlier = steps.with_moments(steps.position_m, cov_m2, cross, after)
        return replace_unchecked(path, earlier=earlier, shared_from_s=time_s, shared_from_m=present_m)

    def without_past(self, cov: FloatArray, time_s: float, present_m: FloatArray) -> PastPath:
        """Return the path whose past steps no longer change with the present state, as after a lost heading.

        `cov` (4, 4) is the covariance of the present state, `time_s` the present time, and `present_m` (2,) the present
        position. Later changes of the frame do not move the steps until `time_s`.
        """
        path = self.related_to_present()
        steps = path.earlier
        fixed = replace_unchecked(steps, by_state=np.zeros_like(steps.by_state), own_cov_m2=steps.cov_m2(cov))
        return replace_unchecked(path, earlier=fixed, since_s=time_s, shared_from_s=time_s, shared_from_m=present_m)

    def turned_until_loss(self, alignment: Alignment) -> PastPath:
        """Return the path whose steps until `since_s` are transformed by an alignment."""
        path = self.related_to_present()
        steps, first = path.earlier, int(np.searchsorted(path.earlier.time_s, self.since_s, side="right"))
        position_m, cov_m2 = steps.position_m.copy(), steps.own_cov_m2.copy()
        position_m[:, :first], cov_m2[:, :first] = aligned_positions(
            alignment, position_m[:, :first], cov_m2[:, :first]
        )
        return replace_unchecked(path, earlier=replace_unchecked(steps, position_m=position_m, own_cov_m2=cov_m2))

    def with_alignment(
        self, alignment: Alignment, before: FloatArray, after: FloatArray, present_m: FloatArray
    ) -> PastPath:
        """Return the path transformed by an alignment from the present frame to another one.

        `before` and `after` are the covariances (4, 4) of the present state in the two frames, and `present_m` (2,) is
        the present position in the new frame, m. The uncertain angle and shift of the alignment move the past positions
        and the present position together. Their variances and their covariance with the present state grow
        accordingly. Steps until `since_s` are already in the frame of the fixes and do not change.
        """
        path, T = self.related_to_present(), np.eye(N_STATES)
        T[:2, :2] = alignment.rotation
        steps, first = path.earlier, int(np.searchsorted(path.earlier.time_s, self.since_s, side="right"))
        past, present = (
            PastSteps(*(getattr(steps, name)[..., part] for name in steps.__dataclass_fields__))
            for part in (slice(first), slice(first, None))
        )
        position_m, cov_m2 = aligned_positions(alignment, present.position_m, present.cov_m2(before))
        lever_m = position_m - alignment.world_centre_m[:, None]
        east_m, north_m = present_m - alignment.world_centre_m
        of_state = np.array([north_m, -east_m, 1.0, 0.0])
        cross = np.einsum("ab,bin->ain", alignment.rotation, T @ before @ present.by_state)
        by_angle = np.stack([lever_m[NORTH], -lever_m[EAST]])
        cross += (
            alignment.angle_var_rad2 * by_angle[:, None] * of_state[:, None] + alignment.centre_var_m2 * _POSITION_ROWS
        )
        present = present.with_moments(position_m, cov_m2, cross, after)
        from_m = alignment.positions(self.shared_from_m)
        return replace_unchecked(path, earlier=past.with_later(present), shared_from_m=from_m)

    def positions(
        self, cov: FloatArray, shared_m2: FloatArray, present_m: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return times (N,) in s, positions (2, N) in m, and covariances (3, N) in m2 of all N steps.

        `cov` (4, 4) is the covariance of the present state, `shared_m2` (2, 2) is the covariance of errors that all
        steps share, and `present_m` (2,) is the present position.
        """
        (back, last), earlier = self._last(), self.earlier
        cov_m2 = back.scale * earlier.own_cov_m2
        cov_m2 += _propagated(earlier.by_state, back.error_cov + back.gain @ cov @ back.gain.T)
        time_s = np.concatenate([earlier.time_s, last.time_s])
        position_m = np.concatenate([earlier.moved_m(back.correction), last.position_m], axis=-1)
        cov_m2 = np.concatenate([cov_m2, last.cov_m2(cov)], axis=-1)
        shared_m2 = self._share(shared_m2, present_m) * _squares(self._since_shared_m(time_s, position_m))
        return time_s, position_m, cov_m2 + shared_m2

    def _share(self, shared_m2: FloatArray, present_m: FloatArray) -> float:
        """Return the variance of the errors that all steps share, per square metre of displacement.

        Let d be the displacement from `shared_from_m` to `present_m` (2,). An error that is proportional to d has the
        covariance s d d'. The result is the largest s, at most `_MAX_SHARED`, for which `shared_m2` (2, 2) minus s d d'
        is positive semidefinite.
        """
        displacement_m = present_m - self.shared_from_m
        (ee, en), (_, nn) = (shared_m2 + _MIN_COV[:2, :2]).tolist()
        east_m, north_m = displacement_m.tolist()
        squares = nn * east_m * east_m - 2.0 * en * east_m * north_m + ee * north_m * north_m
        return min((ee * nn - en * en) / max(squares, _MIN_VAR), _MAX_SHARED)

    def _since_shared_m(self, time_s: FloatArray, position_m: FloatArray) -> FloatArray:
        """Return the vectors (2, N) from `shared_from_m` to the positions `position_m` (2, N) of N steps.

        `shared_from_m` is the position from which the errors that all steps share accumulate, and `shared_from_s` its
        time. The vectors of steps at or before this time are zero.
        """
        return np.where(time_s > self.shared_from_s, position_m - self.shared_from_m[:, None], 0.0)


def aligned_positions(
    alignment: Alignment, position_m: FloatArray, cov_m2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return positions (2, N) and covariances (3, N) in the frame to which an alignment leads.

    Vectorised form of `Alignment.world`.
    """
    c, s = math.cos(alignment.angle_rad), math.sin(alignment.angle_rad)
    (ee, en, nn), var_rad2 = cov_m2, alignment.angle_var_rad2
    moved_m = alignment.positions(position_m.T).T
    east_m, north_m = moved_m - alignment.world_centre_m[:, None]
    return moved_m, np.stack(
        [
            c * c * ee + 2.0 * c * s * en + s * s * nn + var_rad2 * north_m**2 + alignment.centre_var_m2,
            c * s * (nn - ee) + (c * c - s * s) * en - var_rad2 * north_m * east_m,
            s * s * ee - 2.0 * c * s * en + c * c * nn + var_rad2 * east_m**2 + alignment.centre_var_m2,
        ]
    )


def _related_steps(steps: Sequence[RelatedStep], backs: Sequence[BackwardRelation]) -> PastSteps:
    """Return steps related to the present state, from the backward relations to the state after each step."""
    pairs = zip(steps, backs, strict=True)
    position_m = np.stack([step.updated_mean[:2] + back.correction[:2] for step, back in pairs], axis=-1)
    by_state = np.stack([back.gain[:2] for back in backs], axis=-1)
    cov = np.stack([back.error_cov for back in backs], axis=-1)
    own_cov_m2 = np.stack([cov[EAST, EAST], cov[EAST, NORTH], cov[NORTH, NORTH]])
    return PastSteps(np.array([step.time_s for step in steps]), position_m, by_state, own_cov_m2)


def _times(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Return the products (..., 4) of matrices (..., 4, 4) with vectors (..., 4)."""
    return (matrix @ vector[..., None])[..., 0]


def _propagated(by: FloatArray, cov: FloatArray) -> FloatArray:
    """Return the covariances B P B' of N positions as rows (xx, xy, yy), shape (3, N), with x east and y north.

    B is the derivative of each position with respect to the present state, whose covariance is P.
    """
    return _products(cov @ by, by)


def _products(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return symmetric products A B' (3, N) of factors (2, 4, N)."""
    (a_east, a_north), (b_east, b_north) = a, b
    return np.stack([(a_east * b_east).sum(axis=0), (a_east * b_north).sum(axis=0), (a_north * b_north).sum(axis=0)])


def _squares(vector_m: FloatArray) -> FloatArray:
    """Return the outer products v v' of N plane vectors (2, N) as rows of their three distinct elements, (3, N)."""
    east_m, north_m = vector_m
    return np.stack([east_m * east_m, east_m * north_m, north_m * north_m])
