"""Where past steps were, as all that came later says: a smoother that runs forward with the filter.

With x the present state (east, north, heading offset, log scale), each past position is p = place + B (x - mean) + e,
with an error e that has no part in x. That is exact for a linear filter:

- A prediction x' = F x + w makes B G of B, with G = P F' P'^-1, and adds B (P - G P' G') B' to the covariance of e.
- Whatever else is learnt of x, from a fix, a heading or a context, leaves B and e as they are. The place moves by
  B times the correction of the mean, and along an arc where the heading is corrected.

The result is that of a Rauch-Tung-Striebel smoother (A. Gelb, "Applied optimal estimation", 1974, section 5.4:
fixed-point smoothing), without a pass over the past. Steps that are more than a block old follow an anchor, the state
at the end of the last block, so that a step costs the same after an hour as after a minute.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pdr_filter.filter.fixes.alignment import Alignment
from pdr_filter.filter.imm.motion_model import EAST, HEADING_OFFSET, N_STATES, NORTH
from pdr_filter.values import FloatArray, replace

# Steps between two anchors: with as many a step costs least.
_BLOCK = 64
# Steps that are remembered, an hour of walking at two steps a second; of more, the older ones at even intervals.
MAX_STEPS = 8192
# Where a state is known exactly, its covariance cannot be inverted: a hundredth of a millimetre, squared.
_LEAST_VAR = 1e-10
_LEAST = _LEAST_VAR * np.eye(N_STATES)
_OF_PLACE = np.eye(2, N_STATES)[:, :, None]
# Variance, for each square metre of the way, that the errors of lengths which steps share can have: 10 %.
_MOST_SHARED = 0.01


class Back(NamedTuple):
    """How a state x follows a later one x': x = mean + moved + gain (x' - mean') + an error of covariance `left`."""

    gain: FloatArray  # (4, 4) G
    left: FloatArray  # (4, 4) P - G P' G'
    moved: FloatArray  # (4,) what was learnt of x on the way to x'

    @classmethod
    def over(cls, before: FloatArray, cross: FloatArray, after: FloatArray) -> Back:
        """Over a prediction, with the covariances (4, 4) of x, of x and x', and of x'."""
        gain = cross @ np.linalg.inv(after + _LEAST)
        return cls(gain, before - gain @ cross.T, np.zeros(N_STATES))

    def then(self, later: Back) -> Back:
        """From a state after x' back to x."""
        gain = self.gain
        return Back(gain @ later.gain, self.left + gain @ later.left @ gain.T, self.moved + gain @ later.moved)

    def learnt(self, moved: FloatArray) -> Back:
        """The same after a correction (4,) of x'."""
        return self._replace(moved=self.moved + self.gain @ moved)


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
        """The same as they follow a later state."""
        own_cov_m2 = self.own_cov_m2 + _propagated(self.by_state, back.left)
        return PastSteps(self.time_s, self.moved_m(back.moved), back.gain.T @ self.by_state, own_cov_m2)

    def following(self, place_m: FloatArray, cov_m2: FloatArray, cross: FloatArray, state_cov: FloatArray) -> PastSteps:
        """The same at places (2, N) with covariances (3, N), and (2, 4, N) with a state of covariance (4, 4)."""
        by = np.linalg.inv(state_cov + _LEAST) @ cross
        return PastSteps(self.time_s, place_m, by, cov_m2 - _products(by, cross))


NO_STEPS = PastSteps(np.empty(0), np.empty((2, 0)), np.empty((2, N_STATES, 0)), np.empty((3, 0)))


@dataclass(frozen=True, eq=False)
class PastPath:
    """Past steps of a filter whose present state is known to it."""

    recent: PastSteps = NO_STEPS  # as they follow the present state
    earlier: PastSteps = NO_STEPS  # as they follow the anchor
    anchor_by: FloatArray = field(default_factory=lambda: np.eye(N_STATES))  # how the anchor follows the present state
    anchor_cov: FloatArray = field(default_factory=lambda: np.zeros((N_STATES, N_STATES)))
    anchor_moved: FloatArray = field(default_factory=lambda: np.zeros(N_STATES))  # corrections of its mean
    since_s: float = -math.inf  # steps until then are in the frame of the fixes, whatever becomes of the present frame
    shared_from_m: FloatArray = field(default_factory=lambda: np.zeros(2))  # where, and when, errors that steps share
    shared_from_s: float = -math.inf  # began to add up

    def predicted(self, back: Back) -> PastPath:
        """The path as it follows a later state."""
        by = self.anchor_by
        return replace(
            self,
            recent=self.recent.rebased(back),
            anchor_by=by @ back.gain,
            anchor_cov=self.anchor_cov + by @ back.left @ by.T,
            anchor_moved=self.anchor_moved + by @ back.moved,
        )

    def corrected(self, moved: FloatArray) -> PastPath:
        """The path after a correction (4,) of the present state."""
        recent = replace(self.recent, place_m=self.recent.moved_m(moved))
        return replace(self, recent=recent, anchor_moved=self.anchor_moved + self.anchor_by @ moved)

    def with_step(self, time_s: float, place_m: FloatArray) -> PastPath:
        """The path with a step that led to the present place (2,)."""
        step = PastSteps(np.array([time_s]), place_m[:, None], _OF_PLACE, np.zeros((3, 1)))
        path = replace(self, recent=self.recent.joined(step))
        return path.rebased() if len(path.recent) >= _BLOCK else path

    def rebased(self) -> PastPath:
        """The path with the present state as the anchor."""
        earlier = self.earlier.rebased(Back(self.anchor_by, self.anchor_cov, self.anchor_moved))
        return PastPath(
            earlier=earlier.joined(self.recent),
            since_s=self.since_s,
            shared_from_m=self.shared_from_m,
            shared_from_s=self.shared_from_s,
        )

    def with_shared(
        self, before: FloatArray, shared_m2: FloatArray, after: FloatArray, time_s: float, here_m: FloatArray
    ) -> PastPath:
        """The path after errors that steps share, of covariance (2, 2), have become part of that of x (4, 4).

        They grow with the way from where they began to add up, which is `here_m` (2,) from now on.
        """
        path, way_m, share = self.rebased(), here_m - self.shared_from_m, self._share(shared_m2, here_m)
        steps = path.earlier
        since_m = self._since_shared_m(steps.time_s, steps.place_m)
        cross = before @ steps.by_state
        cross[:, :2] += share * since_m[:, None] * way_m[:, None]
        cov_m2 = steps.cov_m2(before) + share * _squares(since_m)
        earlier = steps.following(steps.place_m, cov_m2, cross, after)
        return replace(path, earlier=earlier, shared_from_s=time_s, shared_from_m=here_m)

    def scaled(self, factor: float) -> PastPath:
        """The path whose errors have so many times the variance."""
        recent, earlier = self.recent, self.earlier
        return replace(
            self,
            recent=replace(recent, own_cov_m2=factor * recent.own_cov_m2),
            earlier=replace(earlier, own_cov_m2=factor * earlier.own_cov_m2),
            anchor_cov=factor * self.anchor_cov,
        )

    def detached(self, cov: FloatArray, time_s: float, here_m: FloatArray) -> PastPath:
        """The path of which nothing later is learnt, as after a lost heading; `cov` (4, 4) is that of x."""
        path = self.rebased()
        steps = path.earlier
        fixed = replace(steps, by_state=np.zeros_like(steps.by_state), own_cov_m2=steps.cov_m2(cov))
        return replace(path, earlier=fixed, since_s=time_s, shared_from_s=time_s, shared_from_m=here_m)

    def turned(self, alignment: Alignment, before: FloatArray, after: FloatArray, here_m: FloatArray) -> PastPath:
        """The path in another frame, with the covariances (4, 4) of x there before and after, and the present place.

        All places of the present frame share the error of the alignment with the present one.
        """
        path, T = self.rebased(), np.eye(N_STATES)
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
        return replace(path, earlier=past.joined(present), shared_from_m=from_m)

    def places(
        self, cov: FloatArray, shared_m2: FloatArray, here_m: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Times (N,), places (2, N) and covariances (3, N) of all steps, given those of x (4, 4) and its place."""
        of_anchor = self.anchor_cov + self.anchor_by @ cov @ self.anchor_by.T
        earlier, recent = self.earlier, self.recent
        time_s = np.concatenate([earlier.time_s, recent.time_s])
        place_m = np.concatenate([earlier.moved_m(self.anchor_moved), recent.place_m], axis=-1)
        cov_m2 = np.concatenate([earlier.cov_m2(of_anchor), recent.cov_m2(cov)], axis=-1)
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
