"""Past positions given all later measurements: a smoother that runs forward with the filter.

With x the present state (east, north, heading offset, log scale), each past position is p = place + B (x - mean) + e,
with an error e that has no part in x. That is exact for a linear filter:

- A prediction x' = F x + w makes B G of B, with G = P F' P'^-1, and adds B (P - G P' G') B' to the covariance of e.
- Whatever else is learnt of x, from a fix, a heading or a context, leaves B and e as they are. The place moves by
  B times the correction of the mean, and along an arc where the heading is corrected.

The result is that of a Rauch-Tung-Striebel smoother (A. Gelb, "Applied optimal estimation", 1974, section 5.4:
fixed-point smoothing), without a pass over the past. The last events are kept as they are and worked out together, so
that the path adds a tenth to the time of a step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from pdr_filter.filter.fixes.alignment import Alignment
from pdr_filter.filter.imm import imm
from pdr_filter.filter.imm.estimates import Estimates
from pdr_filter.filter.imm.motion_model import EAST, HEADING_OFFSET, N_STATES, NORTH, Advance
from pdr_filter.values import FloatArray, replace_unchecked

# Events that are worked out together.
_BLOCK = 32
# A correction of the heading turns the steps before it. A smaller one moves those of its block along the tangent, for
# 20 m to 0.1 m from the arc.
_LARGE_TURN_RAD = 0.1
# Steps that are remembered, an hour of walking at two steps a second; of more, the older ones at even intervals.
MAX_STEPS = 8192
# Added to covariances before inversion, for states that are known exactly: 0.01 mm, squared.
_LEAST_VAR = 1e-10
_LEAST = _LEAST_VAR * np.eye(N_STATES)
_OF_PLACE = np.eye(2, N_STATES)[:, :, None]
# Variance, for each square metre of the way, that the errors of lengths which steps share can have: 10 %.
_MOST_SHARED = 0.01
# Shared errors whose variance is a smaller part of that of the position do not bend the path: noise stands for them.
_LEAST_SHARED = 0.01


@dataclass(frozen=True, eq=False)
class Back:
    """How states x (..., 4) follow later ones x': x = mean + moved + gain (x' - mean') + an error.

    After the event all errors so far have `scale` times their variance.
    """

    gain: FloatArray  # (..., 4, 4) G
    left: FloatArray  # (..., 4, 4) P - G P' G', the covariance of the error
    moved: FloatArray  # (..., 4) correction of x between x and x'
    scale: float = 1.0

    @property
    def turned_rad(self) -> float:
        """By how much the heading of x was corrected."""
        return float(self.moved[HEADING_OFFSET])

    @classmethod
    def over(cls, before: FloatArray, cross: FloatArray, after: FloatArray) -> Back:
        """Over a prediction, with the covariances (..., 4, 4) of x, of x and x', and of x'."""
        gain = cross @ np.linalg.inv(after + _LEAST)
        return cls(gain, before - gain @ cross.swapaxes(-1, -2), np.zeros(before.shape[:-1]))

    def then(self, later: Back) -> Back:
        """From states after x' back to x."""
        gain = self.gain
        left = later.scale * self.left + gain @ later.left @ gain.swapaxes(-1, -2)
        moved = self.moved + _times(gain, later.moved)
        return Back(gain @ later.gain, left, moved, self.scale * later.scale)

    def learnt(self, moved: FloatArray) -> Back:
        """Relation after corrections (..., 4) of x'."""
        return replace_unchecked(self, moved=self.moved + _times(self.gain, moved))


_STAYED = Back(np.eye(N_STATES), np.zeros((N_STATES, N_STATES)), np.zeros(N_STATES))


@dataclass(frozen=True, eq=False)
class WalkedStep:
    """A step as the filters (F,) of a tracker went over it; their probabilities are those before its evidence."""

    time_s: float
    updated_mean: FloatArray  # (4,) combined, after the evidence
    prob: FloatArray  # (F,)
    mean: FloatArray  # (F, 4) and covariances (F, 4, 4) before
    cov: FloatArray
    drifted_cov: FloatArray  # with the drift of the heading offset
    turned_mean: FloatArray  # with the measured heading
    turned_cov: FloatArray
    ahead_mean: FloatArray  # with the displacement
    ahead_cov: FloatArray
    by_state: FloatArray  # (F, 4, 4), see `Advance`

    @property
    def turned_rad(self) -> float:
        """By how much the heading was corrected."""
        return float(self.updated_mean[HEADING_OFFSET] - self.prob.dot(self.mean[:, HEADING_OFFSET]))

    @classmethod
    def of(
        cls,
        time_s: float,
        mixed: Estimates,
        drifted_cov: FloatArray,
        turned: Estimates,
        ahead: Advance,
        updated_mean: FloatArray,
    ) -> WalkedStep:
        """The step at a contact, from the estimates before it to the combined mean (4,) after it."""
        before = mixed.prob, mixed.mean, mixed.cov, drifted_cov, turned.mean, turned.cov
        return cls(time_s, updated_mean, *before, ahead.mean, ahead.cov, ahead.by_state)


def _over_steps(steps: Sequence[WalkedStep]) -> list[Back]:
    """How the combined state before each step follows that after it."""
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
    drift = Back.over(P, P, imm.combine(mean, drifted_cov, prob)[1]).learnt(turned_x - x)
    back = drift.then(Back.over(turned_P, cross, ahead_P).learnt(updated - ahead_x))
    return [Back(*each) for each in zip(back.gain, back.left, back.moved, strict=True)]


@dataclass(frozen=True, eq=False)
class PastSteps:
    """Past steps and how they follow a later state; the last axis is that of the steps."""

    time_s: FloatArray  # (N,) contacts
    place_m: FloatArray  # (2, N) east, north
    by_state: FloatArray  # (2, 4, N) B
    own_cov_m2: FloatArray  # (3, N) of e: east, east and north, north

    def __len__(self) -> int:
        return len(self.time_s)

    def joined(self, later: PastSteps) -> PastSteps:
        """These and later ones, at most `MAX_STEPS`."""
        keep = np.ones(len(self), dtype=bool)
        if len(self) + len(later) > MAX_STEPS:
            # every second of the older three quarters may go, and those go first that have the nearest neighbours
            each = np.arange(1, 3 * len(self) // 4, 2)
            apart_s = self.time_s[each + 1] - self.time_s[each - 1]
            keep[each[np.argsort(apart_s, kind="stable")[: MAX_STEPS // 8]]] = False
        pairs = ((getattr(self, name)[..., keep], getattr(later, name)) for name in self.__dataclass_fields__)
        return PastSteps(*(np.concatenate(pair, axis=-1) for pair in pairs))

    def cov_m2(self, cov: FloatArray) -> FloatArray:
        """Covariances (3, N) of the places, given that of the state (4, 4) that they follow."""
        return self.own_cov_m2 + _propagated(self.by_state, cov)

    def moved_m(self, moved: FloatArray) -> FloatArray:
        """Places (2, N) after a correction (4,) of the state that they follow: along the arc of `update_heading`."""
        turn_rad, along_arc = float(moved[HEADING_OFFSET]), moved.copy()
        along_arc[HEADING_OFFSET] = math.sin(turn_rad)
        place_m = self.place_m + along_arc @ self.by_state
        lever_m, versine = self.by_state[:, HEADING_OFFSET], 1.0 - math.cos(turn_rad)
        place_m[EAST] += versine * lever_m[NORTH]
        place_m[NORTH] -= versine * lever_m[EAST]
        return place_m

    def rebased(self, back: Back) -> PastSteps:
        """Steps related to a later state."""
        own_cov_m2 = back.scale * self.own_cov_m2 + _propagated(self.by_state, back.left)
        return PastSteps(self.time_s, self.moved_m(back.moved), back.gain.T @ self.by_state, own_cov_m2)

    def following(self, place_m: FloatArray, cov_m2: FloatArray, cross: FloatArray, state_cov: FloatArray) -> PastSteps:
        """Steps at places (2, N) with covariances (3, N) and cross covariances (2, 4, N) with a state (4, 4)."""
        by = np.linalg.inv(state_cov + _LEAST) @ cross
        return PastSteps(self.time_s, place_m, by, cov_m2 - _products(by, cross))


NO_STEPS = PastSteps(np.empty(0), np.empty((2, 0)), np.empty((2, N_STATES, 0)), np.empty((3, 0)))


@dataclass(frozen=True, eq=False)
class PastPath:
    """Past steps of a filter whose present state is known to it."""

    earlier: PastSteps = NO_STEPS  # as they follow the state before the last events
    events: tuple[WalkedStep | Back, ...] = ()
    since_s: float = -math.inf  # steps until then are in the frame of the fixes, whatever becomes of the present frame
    shared_from_m: FloatArray = field(default_factory=lambda: np.zeros(2))  # where, and when, errors that steps share
    shared_from_s: float = -math.inf  # began to add up

    def with_event(self, event: WalkedStep | Back) -> PastPath:
        """The path with one more event."""
        if abs(event.turned_rad) > _LARGE_TURN_RAD:
            return replace_unchecked(self.settled(), events=(event,)).settled()
        path = replace_unchecked(self, events=(*self.events, event))
        return path.settled() if len(path.events) >= _BLOCK else path

    def predicted(self, before: FloatArray, after: FloatArray) -> PastPath:
        """The path after the covariance (4, 4) of the present state has grown."""
        return self.with_event(Back.over(before, before, after))

    def corrected(self, moved: FloatArray, scale: float) -> PastPath:
        """The path after a correction (4,) of the present state that scales the variances of all errors."""
        return self.with_event(replace_unchecked(_STAYED, moved=moved, scale=scale))

    def settled(self) -> PastPath:
        """The path whose steps all follow the present state."""
        if not self.events:
            return self
        back, last = self._last()
        return replace_unchecked(self, earlier=self.earlier.rebased(back).joined(last), events=())

    def _last(self) -> tuple[Back, PastSteps]:
        """How the state before the last events follows the present one, and the steps since then as they follow it."""
        steps = [event for event in self.events if isinstance(event, WalkedStep)]
        over_steps = iter(_over_steps(steps) if steps else ())
        backs = [next(over_steps) if isinstance(event, WalkedStep) else event for event in self.events]
        back, after_steps = _STAYED, list[Back]()
        for event, over in zip(reversed(self.events), reversed(backs), strict=True):
            if isinstance(event, WalkedStep):
                after_steps.append(back)
            back = over.then(back)
        return back, _behind(steps, after_steps[::-1]) if steps else NO_STEPS

    def with_shared(
        self, before: FloatArray, shared_m2: FloatArray, after: FloatArray, time_s: float, here_m: FloatArray
    ) -> PastPath:
        """The path after errors that steps share, of covariance (2, 2), have become part of that of x (4, 4).

        They grow with the way from where they began to add up, which is `here_m` (2,) from now on.
        """
        if np.trace(shared_m2) < _LEAST_SHARED * np.trace(before[:2, :2]):
            return replace_unchecked(self.predicted(before, after), shared_from_s=time_s, shared_from_m=here_m)
        path, way_m, share = self.settled(), here_m - self.shared_from_m, self._share(shared_m2, here_m)
        steps = path.earlier
        since_m = self._since_shared_m(steps.time_s, steps.place_m)
        cross = before @ steps.by_state
        cross[:, :2] += share * since_m[:, None] * way_m[:, None]
        cov_m2 = steps.cov_m2(before) + share * _squares(since_m)
        earlier = steps.following(steps.place_m, cov_m2, cross, after)
        return replace_unchecked(path, earlier=earlier, shared_from_s=time_s, shared_from_m=here_m)

    def detached(self, cov: FloatArray, time_s: float, here_m: FloatArray) -> PastPath:
        """The path of which nothing later is learnt, as after a lost heading; `cov` (4, 4) is that of x."""
        path = self.settled()
        steps = path.earlier
        fixed = replace_unchecked(steps, by_state=np.zeros_like(steps.by_state), own_cov_m2=steps.cov_m2(cov))
        return replace_unchecked(path, earlier=fixed, since_s=time_s, shared_from_s=time_s, shared_from_m=here_m)

    def turned(self, alignment: Alignment, before: FloatArray, after: FloatArray, here_m: FloatArray) -> PastPath:
        """The path in another frame, with the covariances (4, 4) of x there before and after, and the present place.

        All places of the present frame share the error of the alignment with the present one.
        """
        path, T = self.settled(), np.eye(N_STATES)
        T[:2, :2] = alignment.rotation
        steps, first = path.earlier, int(np.searchsorted(path.earlier.time_s, self.since_s, side="right"))
        past, present = (
            PastSteps(*(getattr(steps, name)[..., part] for name in steps.__dataclass_fields__))
            for part in (slice(first), slice(first, None))
        )
        place_m, cov_m2 = turned(alignment, present.place_m, present.cov_m2(before))
        lever_m = place_m - alignment.world_centre_m[:, None]
        east_m, north_m = here_m - alignment.world_centre_m
        of_state = np.array([north_m, -east_m, 1.0, 0.0])
        cross = np.einsum("ab,bin->ain", alignment.rotation, T @ before @ present.by_state)
        by_angle = np.stack([lever_m[NORTH], -lever_m[EAST]])
        cross += alignment.angle_var_rad2 * by_angle[:, None] * of_state[:, None] + alignment.centre_var_m2 * _OF_PLACE
        present = present.following(place_m, cov_m2, cross, after)
        from_m = alignment.positions(self.shared_from_m)
        return replace_unchecked(path, earlier=past.joined(present), shared_from_m=from_m)

    def places(
        self, cov: FloatArray, shared_m2: FloatArray, here_m: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Times (N,), places (2, N) and covariances (3, N) of all steps, given those of x (4, 4) and its place."""
        (back, last), earlier = self._last(), self.earlier
        cov_m2 = back.scale * earlier.own_cov_m2
        cov_m2 += _propagated(earlier.by_state, back.left + back.gain @ cov @ back.gain.T)
        time_s = np.concatenate([earlier.time_s, last.time_s])
        place_m = np.concatenate([earlier.moved_m(back.moved), last.place_m], axis=-1)
        cov_m2 = np.concatenate([cov_m2, last.cov_m2(cov)], axis=-1)
        shared_m2 = self._share(shared_m2, here_m) * _squares(self._since_shared_m(time_s, place_m))
        return time_s, place_m, cov_m2 + shared_m2

    def _share(self, shared_m2: FloatArray, here_m: FloatArray) -> float:
        """Largest variance, for each square metre, of an error along the way that is part of `shared_m2` (2, 2)."""
        way_m = here_m - self.shared_from_m
        (ee, en), (_, nn) = (shared_m2 + _LEAST[:2, :2]).tolist()
        east_m, north_m = way_m.tolist()
        squares = nn * east_m * east_m - 2.0 * en * east_m * north_m + ee * north_m * north_m
        return min((ee * nn - en * en) / max(squares, _LEAST_VAR), _MOST_SHARED)

    def _since_shared_m(self, time_s: FloatArray, place_m: FloatArray) -> FloatArray:
        return np.where(time_s > self.shared_from_s, place_m - self.shared_from_m[:, None], 0.0)


def turned(alignment: Alignment, place_m: FloatArray, cov_m2: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places (2, N) and covariances (3, N) in the frame to which an alignment leads: `Alignment.world` of many."""
    c, s = math.cos(alignment.angle_rad), math.sin(alignment.angle_rad)
    (ee, en, nn), var_rad2 = cov_m2, alignment.angle_var_rad2
    moved_m = alignment.positions(place_m.T).T
    east_m, north_m = moved_m - alignment.world_centre_m[:, None]
    return moved_m, np.stack(
        [
            c * c * ee + 2.0 * c * s * en + s * s * nn + var_rad2 * north_m**2 + alignment.centre_var_m2,
            c * s * (nn - ee) + (c * c - s * s) * en - var_rad2 * north_m * east_m,
            s * s * ee - 2.0 * c * s * en + c * c * nn + var_rad2 * east_m**2 + alignment.centre_var_m2,
        ]
    )


def _behind(steps: Sequence[WalkedStep], backs: Sequence[Back]) -> PastSteps:
    """Steps as they follow the present state, given how the state after each follows it."""
    pairs = zip(steps, backs, strict=True)
    place_m = np.stack([step.updated_mean[:2] + back.moved[:2] for step, back in pairs], axis=-1)
    by_state = np.stack([back.gain[:2] for back in backs], axis=-1)
    left = np.stack([back.left for back in backs], axis=-1)
    own_cov_m2 = np.stack([left[EAST, EAST], left[EAST, NORTH], left[NORTH, NORTH]])
    return PastSteps(np.array([step.time_s for step in steps]), place_m, by_state, own_cov_m2)


def _times(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Products (..., 4) of matrices (..., 4, 4) and vectors (..., 4)."""
    return (matrix @ vector[..., None])[..., 0]


def _propagated(by: FloatArray, cov: FloatArray) -> FloatArray:
    """Covariances B P B' (3, N)."""
    return _products(cov @ by, by)


def _products(a: FloatArray, b: FloatArray) -> FloatArray:
    """A B' (3, N) of (2, 4, N), where it is symmetric."""
    (a_east, a_north), (b_east, b_north) = a, b
    return np.stack([(a_east * b_east).sum(axis=0), (a_east * b_north).sum(axis=0), (a_north * b_north).sum(axis=0)])


def _squares(vector_m: FloatArray) -> FloatArray:
    """Products v v' (3, N) of vectors (2, N)."""
    east_m, north_m = vector_m
    return np.stack([east_m * east_m, east_m * north_m, north_m * north_m])
