"""The smoother for an app that can wait some seconds: each step is given out once, with the fixes of the seconds after.

A window of steps and fixes is solved as a whole recording is; what leaves it stays as a Gaussian of the state where the
window begins. Positions are therefore in the frame of the fixes, and a wild fix is judged with those around it.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from pdr_filter.filter.fixes.gnss import independent
from pdr_filter.filter.fixes.repeated_fixes import SeenPlace, seen_after
from pdr_filter.filter.imm.motion_model import (
    HEADING_OFFSET,
    LOG_SCALE,
    MAX_HEADING_VARIANCE,
    N_STATES,
    Mode,
    MotionNoise,
)
from pdr_filter.filter.imm.pedestrian_state import StepUpdate
from pdr_filter.offline.smoothing.observations import LoopClosure, Observations, says_nothing
from pdr_filter.offline.smoothing.preintegration import Increments, bridge, end_states, frame, increments, joined
from pdr_filter.offline.smoothing.problem import Problem, Return, pose_problem, start_covariance
from pdr_filter.offline.smoothing.solve import Solution, filtered_at, solve
from pdr_filter.values import (
    N_BEFORE,
    FloatArray,
    PositionFix,
    all_fixes,
    check_numbers,
    read_only,
    step_table,
    wrap_angle,
)

# So many steps that left the window are remembered as places to come back to: three hours of walking, 2.5 MB.
_MAX_PLACES = 20_000
# A heading better known than this is Gaussian enough to be remembered as one: the second-order error is 2 %.
_KNOWN_HEADING_STD_RAD = 0.15
_LONGEST = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Where steps that left the window were: place_m + by_start (x_0 - start_mean), x_0 the state of its start."""

    time_s: FloatArray  # (P,) contacts
    place_m: FloatArray  # (P, 2)
    by_start: FloatArray  # (P, 2, 4)
    cov_m2: FloatArray  # (P, 2, 2) of the rest, which knows nothing of x_0

    def on(self, before: FloatArray, joint_cov: FloatArray, start_mean: FloatArray) -> Places:
        """The same places for a later start x_b: of the old one x_a = m_a + B (x_b - m_b) + eta is known now.

        p = place + G (x_a - start_mean) + e, so place' = place + G (m_a - start_mean), G' = G B, and the covariance of
        the rest grows by G cov(eta) G'.
        """
        regression, rest = regressed(joint_cov)
        return Places(
            self.time_s,
            self.place_m + self.by_start @ (before - start_mean),
            self.by_start @ regression,
            self.cov_m2 + self.by_start @ rest @ self.by_start.swapaxes(-1, -2),
        )


@dataclass(frozen=True, slots=True, eq=False)
class FixedLagState:
    """The state where the window begins, as all before it says, and what the window holds."""

    start_mean: FloatArray  # (4,) east, north, heading offset, log scale
    start_cov: FloatArray  # (4, 4)
    steps: Increments  # of the window
    n_given_out: int  # of them
    fixes: tuple[PositionFix, ...]  # not part of the start yet
    loop_closures: tuple[LoopClosure, ...]  # likewise; the first of their times may be long ago
    places: Places
    last_step_s: float  # contact of the last step; NaN before the first
    start_s: float  # contact of the last step before the window; -inf before the first
    has_place: bool  # whether there was a fix
    used_fixes: tuple[PositionFix, ...] = ()  # the last fixes that left the window, whose errors later ones share
    seen: SeenPlace | None = None  # last new position; the track is that of the steps in the window alone


@dataclass(frozen=True, slots=True, eq=False)
class LateSteps:
    """Steps that became `lag_s` old, and rejected fixes and loop closures that left the window."""

    time_s: FloatArray  # (n,)
    mean: FloatArray  # (n, 4) east, north, heading offset, log scale
    cov: FloatArray  # (n, 4, 4)
    rejected: tuple[PositionFix | LoopClosure, ...]

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True, eq=False)
class FixedLagSmoother:
    """Steps, fixes and loop closures in, the same steps out `lag_s` later, smoothed.

    A loop closure is to any step of the last hours. Not used here: known headings and the walking headings that steps
    show (`smooth` has them).

    Parameters
    ----------
    modes : tuple of Mode
        Of the tracker whose updates are pushed.
    noise : MotionNoise
        Likewise.
    lag_s : float
        How old a step is when it is given out. More than a few intervals between fixes gain nothing.
    memory_s : float
        How old a step is when it leaves the window, not less than `lag_s`. Until then fixes are judged again, and the
        rotation of the map may still turn the window; it grows up to five times as long until the rotation is known.
    start_std_m, start_heading_std_rad : float
        How well the start is known in the frame of the fixes: by default neither where nor which way.
    anchor_interval_s : float
        Longest stretch that is one factor.
    """

    modes: tuple[Mode, ...]
    noise: MotionNoise
    lag_s: float = 20.0
    memory_s: float = 60.0
    start_std_m: float = 1000.0
    start_heading_std_rad: float = float(np.sqrt(MAX_HEADING_VARIANCE))
    anchor_interval_s: float = 10.0

    def __post_init__(self) -> None:
        check_numbers(self, zero=("lag_s", "memory_s"))

    def init(self) -> FixedLagState:
        """Nothing walked yet."""
        cov = start_covariance(self.start_std_m, self.start_heading_std_rad, self.noise.log_scale_std**2)
        return FixedLagState(
            np.zeros(4), cov, _no_steps(), 0, (), (), _no_places(), last_step_s=np.nan, start_s=-np.inf, has_place=False
        )

    def step(
        self,
        state: FixedLagState,
        updates: Iterable[StepUpdate],
        fixes: Iterable[PositionFix] = (),
        gap_before_s: float = 0.0,
        loop_closures: Iterable[LoopClosure] = (),
    ) -> tuple[FixedLagState, LateSteps]:
        """Return the result of `update`, which is the new name: a step is a footstep here. Deprecated."""
        warnings.warn("FixedLagSmoother.step is now FixedLagSmoother.update", DeprecationWarning, stacklevel=2)
        return self.update(state, updates, fixes, gap_before_s, loop_closures)

    def update(
        self,
        state: FixedLagState,
        updates: Iterable[StepUpdate],
        fixes: Iterable[PositionFix] = (),
        gap_before_s: float = 0.0,
        loop_closures: Iterable[LoopClosure] = (),
    ) -> tuple[FixedLagState, LateSteps]:
        """New state and the steps that became `lag_s` old.

        `updates` are as the filter gives them; provisional ones are passed over. `fixes` and
        `loop_closures` are as they arrive; one whose (second) time is older than the window is rejected. `gap_before_s`
        is the time without samples before the first of these steps.
        """
        final = [u for u in updates if u.is_final]
        if not final:
            return self.step_increments(state, _no_steps(), fixes, loop_closures)
        gaps = np.zeros(len(final))
        gaps[0] = gap_before_s
        previous_s = None if np.isnan(state.last_step_s) else state.last_step_s
        prob = np.array([u.mode_prob for u in final])
        steps, shared = increments(step_table([u.step for u in final]), prob, self.modes, self.noise, gaps, previous_s)
        if previous_s is None:
            cov = state.start_cov.copy()
            cov[LOG_SCALE, LOG_SCALE] += shared
            state = replace(state, start_cov=cov)
        return self.step_increments(state, steps, fixes, loop_closures)

    def step_increments(
        self,
        state: FixedLagState,
        steps: Increments,
        fixes: Iterable[PositionFix] = (),
        loop_closures: Iterable[LoopClosure] = (),
    ) -> tuple[FixedLagState, LateSteps]:
        """`step` for steps whose increments are known."""
        fixes, loop_closures = all_fixes(fixes), tuple(loop_closures)
        late: tuple[PositionFix | LoopClosure, ...] = tuple(f for f in fixes if f.time_s < state.start_s)
        is_late = [c.second_s < state.start_s or _is_forgotten(state, c) for c in loop_closures]
        late += tuple(compress(loop_closures, is_late))
        loops = (*state.loop_closures, *compress(loop_closures, [not old for old in is_late]))
        waiting = joined([state.steps, steps]) if len(steps) else state.steps
        seen, fresh, frozen = _without_frozen(waiting, state.seen, [f for f in fixes if f.time_s >= state.start_s])
        late += frozen
        kept = (*state.fixes, *fresh)
        if kept and not state.has_place:
            # where the walk began is unknown: the track so far may be moved to where the first fix is
            mean = np.array([*kept[0].position_m, *state.start_mean[2:]])
            state = replace(state, start_mean=mean, has_place=True)
        last_s = float(steps.time_s[-1]) if len(steps) else state.last_step_s
        state = replace(state, steps=waiting, fixes=kept, loop_closures=loops, last_step_s=last_s, seen=seen)
        due = int(np.searchsorted(waiting.time_s, last_s - self.lag_s, side="right"))
        state, out = self._give_out(state, due)
        return state, replace(out, rejected=(*late, *out.rejected))

    def finish(self, state: FixedLagState) -> tuple[FixedLagState, LateSteps]:
        """New state and all steps that are left, with the rejected fixes of the whole window."""
        return self._give_out(state, len(state.steps), is_end=True)

    def _give_out(self, state: FixedLagState, due: int, is_end: bool = False) -> tuple[FixedLagState, LateSteps]:
        """New state and the steps before number `due` of the window that were not given out before."""
        given = state.n_given_out
        if due <= given:
            return state, LateSteps(np.zeros(0), np.zeros((0, 4)), np.zeros((0, 4, 4)), ())
        last_s = float(state.steps.time_s[-1])
        oldest_s = last_s - self.memory_s
        leaving = 0 if is_end else min(int(np.searchsorted(state.steps.time_s, oldest_s)), due)
        loops = [c for c in state.loop_closures if c.second_s <= last_s]
        inside, nothing = _informative(state.steps, [c for c in loops if c.first_s >= state.start_s])
        state = replace(state, loop_closures=tuple(c for c in state.loop_closures if c not in nothing))
        returns = [c for c in loops if c.first_s < state.start_s]
        problem = pose_problem(
            state.steps,
            state.start_mean,
            state.start_cov,
            Observations(independent(state.fixes, state.used_fixes), tuple(inside)),
            anchor_interval_s=self.anchor_interval_s,
            wanted=(leaving,),
            returns=[_return_of(state.places, c) for c in returns],
        )
        found = solve(problem)
        mean, cov = bridge(problem.intervals, found.mean, found.joint_cov)
        state = replace(state, n_given_out=due)
        time_s = state.steps.time_s[given:due]
        observed = (*state.fixes, *inside, *returns)
        rejected: tuple[PositionFix | LoopClosure, ...] = tuple(nothing)
        if is_end:
            rejected += tuple(compress(observed, (found.weight == 0).tolist()))
            state = replace(state, fixes=(), loop_closures=())
        elif leaving:
            state, gone = self._forget(state, problem, found, leaving, observed)
            rejected += gone
        return state, LateSteps(read_only(time_s), read_only(mean[given:due]), read_only(cov[given:due]), rejected)

    def _forget(
        self,
        state: FixedLagState,
        problem: Problem,
        found: Solution,
        leaving: int,
        observed: Sequence[PositionFix | LoopClosure],
    ) -> tuple[FixedLagState, tuple[PositionFix | LoopClosure, ...]]:
        """The state without its first steps once the rotation is known, and what was rejected among theirs."""
        node = int(np.searchsorted(problem.intervals.nodes, leaving))
        mean, cov, before = filtered_at(problem, found, node)
        waited_s = float(state.steps.time_s[-1] - state.steps.time_s[0])
        if cov[HEADING_OFFSET, HEADING_OFFSET] > _KNOWN_HEADING_STD_RAD**2 and waited_s < _LONGEST * self.memory_s:
            return state, ()
        places = _places(state, problem, leaving, before)
        mean[HEADING_OFFSET] = float(wrap_angle(mean[HEADING_OFFSET]))
        past = problem.positions.node <= node
        gone = [o for o, is_past in zip(observed, past.tolist(), strict=True) if is_past]
        rejected = tuple(compress(observed, (past & (found.weight == 0)).tolist()))
        last = sorted((f for f in state.fixes if f in gone and f.correlation_s > 0), key=lambda f: f.time_s)
        left = replace(
            state,
            used_fixes=(*state.used_fixes, *last)[-N_BEFORE:],
            seen=_seen_later(state.seen, state.steps.displacement_m[:leaving]),
            start_mean=mean,
            start_cov=cov,
            steps=state.steps.part(leaving, len(state.steps)),
            n_given_out=state.n_given_out - leaving,
            fixes=tuple(f for f in state.fixes if f not in gone),
            loop_closures=tuple(c for c in state.loop_closures if c not in gone),
            places=places,
            start_s=float(state.steps.time_s[leaving - 1]),
        )
        return left, rejected


def _without_frozen(
    steps: Increments, seen: SeenPlace | None, fixes: Sequence[PositionFix]
) -> tuple[SeenPlace | None, list[PositionFix], tuple[PositionFix, ...]]:
    """The last new position, new fixes, and those that repeat a position while the steps of the window go on."""
    fresh, frozen = list[PositionFix](), list[PositionFix]()
    way_m = np.cumsum(steps.displacement_m, axis=0)
    walked_m = np.cumsum(np.hypot(*steps.displacement_m.T))
    for fix in sorted(fixes, key=lambda f: f.time_s) if len(steps) else ():
        place = [float(np.interp(fix.time_s, steps.time_s, column)) for column in (*way_m.T, walked_m)]
        seen = seen_after(seen, fix, np.array(place[:2]), place[2])
        (frozen if seen.is_frozen else fresh).append(fix)
    return seen, fresh if len(steps) else list(fixes), tuple(frozen)


def _seen_later(seen: SeenPlace | None, displacement_m: FloatArray) -> SeenPlace | None:
    """The last new position with its place on the track of the steps that are left without these (n, 2)."""
    if seen is None:
        return None
    walked_m = float(np.hypot(*displacement_m.T).sum())
    return replace(seen, track_m=seen.track_m - displacement_m.sum(axis=0), walked_m=seen.walked_m - walked_m)


def _informative(steps: Increments, closures: Sequence[LoopClosure]) -> tuple[list[LoopClosure], list[LoopClosure]]:
    """Loop closures that carry information, one for each two contacts, and the others."""
    walked_m = np.cumsum(np.hypot(*steps.displacement_m.T))
    kept: dict[tuple[int, int], LoopClosure] = {}
    others: list[LoopClosure] = []
    for closure in closures:
        times_s = np.array([closure.first_s, closure.second_s])
        before_m, after_m = np.interp(times_s, steps.time_s, walked_m).tolist()
        first, second = np.searchsorted(steps.time_s, times_s).tolist()
        if says_nothing(closure, after_m - before_m) or kept.setdefault((first, second), closure) is not closure:
            others.append(closure)
    return list(kept.values()), others


def regressed(joint_cov: FloatArray) -> tuple[FloatArray, FloatArray]:
    """B and the covariance of eta in x_a = m_a + B (x_b - m_b) + eta, from the joint covariance (8, 8) of a and b."""
    own, mixed, other = (
        joint_cov[:N_STATES, :N_STATES],
        joint_cov[:N_STATES, N_STATES:],
        joint_cov[N_STATES:, N_STATES:],
    )
    regression = np.asarray(np.linalg.solve(other, mixed.T).T, dtype=float)
    return regression, np.asarray(own - regression @ mixed.T, dtype=float)


def _places(
    state: FixedLagState, problem: Problem, leaving: int, before: list[tuple[FloatArray, FloatArray]]
) -> Places:
    """The places remembered so far and those of the steps that leave, as they follow the new start of the window.

    A leaving step follows the anchor before it: p_k = f(x_j) + noise of Q_jk.
    """
    intervals = problem.intervals
    known = state.places.on(*before[0], state.start_mean)
    node = intervals.index[:leaving]
    start = np.array([m for m, _ in before])[node]
    regression, rest = (np.array(x)[node] for x in zip(*(regressed(cov) for _, cov in before), strict=True))
    ahead, F = end_states(start, intervals.sum_m[:leaving])
    T = frame(start)
    noise = (T @ intervals.cov[:leaving] @ T.swapaxes(-1, -2))[:, :2, :2]
    by_anchor = F[:, :2]
    new = Places(
        state.steps.time_s[:leaving],
        ahead[:, :2],
        by_anchor @ regression,
        by_anchor @ rest @ by_anchor.swapaxes(-1, -2) + noise,
    )
    both = zip((getattr(known, n) for n in Places.__slots__), (getattr(new, n) for n in Places.__slots__), strict=True)
    return Places(*(read_only(np.concatenate(pair)[-_MAX_PLACES:]) for pair in both))


def _return_of(places: Places, closure: LoopClosure) -> Return:
    k = int(np.abs(places.time_s - closure.first_s).argmin())
    cov_m2 = places.cov_m2[k] + closure.std_m**2 * np.eye(2)
    return Return(closure.second_s, places.place_m[k], places.by_start[k], cov_m2)


def _is_forgotten(state: FixedLagState, closure: LoopClosure) -> bool:
    """Whether the first time of a loop closure is before all steps that are remembered."""
    times_s = state.places.time_s
    return len(times_s) == _MAX_PLACES and closure.first_s < float(times_s[0])


def _no_places() -> Places:
    return Places(np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2, N_STATES)), np.zeros((0, 2, 2)))


def _no_steps() -> Increments:
    none = np.zeros(0)
    return Increments(none, none, np.zeros((0, 2)), np.zeros((0, 2, 2)), none, none, none, none, none)
