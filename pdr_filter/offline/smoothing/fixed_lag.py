"""The smoother for an app that can wait some seconds: each step is given out once, with the fixes of the seconds after.

A window of steps and fixes is solved as a whole recording is; what leaves it stays as a Gaussian of the state where the
window begins. Positions are therefore in the frame of the fixes, and a wild fix is judged with those around it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pdr_filter.filter.motion import HEADING_OFFSET, LOG_SCALE, MAX_HEADING_VARIANCE, Mode, MotionNoise
from pdr_filter.filter.pedestrian import StepUpdate
from pdr_filter.offline.smoothing.observations import Observations
from pdr_filter.offline.smoothing.preintegration import Increments, bridge, increments, joined
from pdr_filter.offline.smoothing.problem import Problem, pose_problem, start_covariance
from pdr_filter.offline.smoothing.solve import Solution, filtered_at, solve
from pdr_filter.values import FloatArray, PositionFix, read_only, step_table, wrap_angle

# A heading better known than this is Gaussian enough to be remembered as one: the second-order error is 2 %.
_KNOWN_HEADING_STD_RAD = 0.15
_LONGEST = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class FixedLagState:
    """The state where the window begins, as all before it says, and what the window holds."""

    start_mean: FloatArray  # (4,) east, north, heading offset, log scale
    start_cov: FloatArray  # (4, 4)
    steps: Increments  # of the window
    n_given_out: int  # of them
    fixes: tuple[PositionFix, ...]  # not part of the start yet
    last_step_s: float  # contact of the last step; NaN before the first
    start_s: float  # contact of the last step before the window; -inf before the first
    has_place: bool  # whether there was a fix


@dataclass(frozen=True, slots=True, eq=False)
class LateSteps:
    """Steps that became `lag_s` old, and rejected fixes that left the window."""

    time_s: FloatArray  # (n,)
    mean: FloatArray  # (n, 4) east, north, heading offset, log scale
    cov: FloatArray  # (n, 4, 4)
    rejected: tuple[PositionFix, ...]

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True, eq=False)
class FixedLagSmoother:
    """Steps and fixes in, the same steps out `lag_s` later, smoothed.

    Not used here: loop closures, known headings and the walking headings that steps show (`smooth` has them).

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
        if self.lag_s < 0 or self.anchor_interval_s <= 0 or self.start_std_m <= 0:
            raise ValueError(
                f"lag_s must not be negative, anchor_interval_s and start_std_m must be positive, got {self.lag_s}, "
                f"{self.anchor_interval_s}, {self.start_std_m}"
            )

    def init(self) -> FixedLagState:
        """Nothing walked yet."""
        cov = start_covariance(self.start_std_m, self.start_heading_std_rad, self.noise.log_scale_std**2)
        return FixedLagState(np.zeros(4), cov, _no_steps(), 0, (), last_step_s=np.nan, start_s=-np.inf, has_place=False)

    def step(
        self,
        state: FixedLagState,
        updates: Sequence[StepUpdate],
        fixes: Sequence[PositionFix] = (),
        gap_before_s: float = 0.0,
    ) -> tuple[FixedLagState, LateSteps]:
        """New state and the steps that became `lag_s` old.

        `updates` are as the filter gives them; provisional ones are passed over. `fixes` are as they arrive; one older
        than the window is rejected. `gap_before_s` is the time without samples before the first of these steps.
        """
        final = [u for u in updates if u.is_final]
        if not final:
            return self.step_increments(state, _no_steps(), fixes)
        gaps = np.zeros(len(final))
        gaps[0] = gap_before_s
        previous_s = None if np.isnan(state.last_step_s) else state.last_step_s
        prob = np.array([u.mode_prob for u in final])
        steps, shared = increments(step_table([u.step for u in final]), prob, self.modes, self.noise, gaps, previous_s)
        if previous_s is None:
            cov = state.start_cov.copy()
            cov[LOG_SCALE, LOG_SCALE] += shared
            state = replace(state, start_cov=cov)
        return self.step_increments(state, steps, fixes)

    def step_increments(
        self, state: FixedLagState, steps: Increments, fixes: Sequence[PositionFix] = ()
    ) -> tuple[FixedLagState, LateSteps]:
        """`step` for steps whose increments are known."""
        late = tuple(f for f in fixes if f.time_s < state.start_s)
        kept = (*state.fixes, *(f for f in fixes if f.time_s >= state.start_s))
        if kept and not state.has_place:
            # where the walk began is unknown: the track so far may be moved to where the first fix is
            mean = np.array([*kept[0].position_m, *state.start_mean[2:]])
            state = replace(state, start_mean=mean, has_place=True)
        waiting = joined([state.steps, steps]) if len(steps) else state.steps
        last_s = float(steps.time_s[-1]) if len(steps) else state.last_step_s
        state = replace(state, steps=waiting, fixes=kept, last_step_s=last_s)
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
        oldest_s = float(state.steps.time_s[-1]) - self.memory_s
        leaving = 0 if is_end else min(int(np.searchsorted(state.steps.time_s, oldest_s)), due)
        problem = pose_problem(
            state.steps,
            state.start_mean,
            state.start_cov,
            Observations(state.fixes),
            anchor_interval_s=self.anchor_interval_s,
            wanted=(leaving,),
        )
        found = solve(problem)
        mean, cov = bridge(problem.intervals, found.mean, found.joint_cov)
        state = replace(state, n_given_out=due)
        time_s = state.steps.time_s[given:due]
        rejected: tuple[PositionFix, ...] = ()
        if is_end:
            rejected = tuple(f for f, w in zip(state.fixes, found.weight, strict=True) if w == 0)
            state = replace(state, fixes=())
        elif leaving:
            state, rejected = self._forget(state, problem, found, leaving)
        return state, LateSteps(read_only(time_s), read_only(mean[given:due]), read_only(cov[given:due]), rejected)

    def _forget(
        self, state: FixedLagState, problem: Problem, found: Solution, leaving: int
    ) -> tuple[FixedLagState, tuple[PositionFix, ...]]:
        """The state without its first steps once the rotation is known, and the fixes rejected among theirs."""
        node = int(np.searchsorted(problem.intervals.nodes, leaving))
        mean, cov = filtered_at(problem, found, node)
        waited_s = float(state.steps.time_s[-1] - state.steps.time_s[0])
        if cov[HEADING_OFFSET, HEADING_OFFSET] > _KNOWN_HEADING_STD_RAD**2 and waited_s < _LONGEST * self.memory_s:
            return state, ()
        mean[HEADING_OFFSET] = float(wrap_angle(mean[HEADING_OFFSET]))
        past = problem.positions.node <= node
        pairs = list(zip(state.fixes, past.tolist(), found.weight.tolist(), strict=True))
        left = replace(
            state,
            start_mean=mean,
            start_cov=cov,
            steps=state.steps.part(leaving, len(state.steps)),
            n_given_out=state.n_given_out - leaving,
            fixes=tuple(f for f, is_past, _ in pairs if not is_past),
            start_s=float(state.steps.time_s[leaving - 1]),
        )
        return left, tuple(f for f, is_past, w in pairs if is_past and w == 0)


def _no_steps() -> Increments:
    none = np.zeros(0)
    return Increments(none, none, np.zeros((0, 2)), np.zeros((0, 2, 2)), none, none, none, none, none)
