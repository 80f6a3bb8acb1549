"""Steps and context windows in, track rows out: one Kalman filter for each mode, mixed by probability."""

from __future__ import annotations

from dataclasses import dataclass, field

from pdr_filter.filter.fixes.fix_updates import use_fix
from pdr_filter.filter.imm.imm import ImmArithmetic, NumpyImm, mixed_values
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, advance
from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.imm.pedestrian_state import (
    PedestrianState,
    StepUpdate,
    Walked,
    initial_state,
    is_known_to_stand,
    shared_cov,
    step_update,
    with_heading,
    with_open_turn,
    with_step,
)
from pdr_filter.filter.imm.recent_windows import RecentWindows, n_after, window_before, with_window
from pdr_filter.filter.imm.tracker import over_gap
from pdr_filter.sensing.contexts.context_stage import WindowContext
from pdr_filter.values import Fix, FixOutcome, Step, replace

# Evidence of a known standstill against every mode that moves: a hundred thousand to one, because a window that is sure
# of walking says a hundred to one for it (`evidence_floor`), and the step itself seven to one.
_STANDSTILL_LOG_EVIDENCE = 12.0


@dataclass(frozen=True, eq=False)
class ImmState:
    """Estimates of all modes, and the windows that are their evidence."""

    pedestrian: PedestrianState
    windows: RecentWindows
    used: WindowContext | None  # the last one that was used as evidence
    n_unused: int  # windows since that one, gaps not counted


@dataclass(frozen=True, eq=False)
class ImmTracker:
    """The interacting multiple model over the modes of a model; each step is reported once, when it is known.

    With `filterpy_backend.FilterpyImm()` the same track comes from filterpy's classes, many times slower.
    """

    model: PedestrianModel
    arithmetic: ImmArithmetic = field(default_factory=NumpyImm)

    weighting = "imm"
    # A step is final when it is known: windows that come later are evidence for later steps.
    waits_for_windows = 0

    def init(self) -> ImmState:
        """State at the origin; modes as probable as the transitions make them in the long run."""
        return ImmState(initial_state(self.model, self.model.long_run_mode_prob), (), None, 0)

    def on_window(self, state: ImmState, window: WindowContext) -> tuple[ImmState, tuple[StepUpdate, ...]]:
        """New state; a window makes no step known."""
        windows = with_window(state.windows, window)
        n_unused = state.n_unused + (windows is not state.windows)
        return replace(state, windows=windows, n_unused=n_unused), ()

    def on_step(self, state: ImmState, step: Step) -> tuple[ImmState, tuple[StepUpdate, ...]]:
        """New state and the update of this step: mix, predict every mode, weigh by evidence, combine."""
        model, imm = self.model, self.arithmetic
        pedestrian = with_open_turn(state.pedestrian)
        mean, cov, prob = imm.mix(pedestrian.mean, pedestrian.cov, pedestrian.prob, model.transition_prob)
        walked_m = mixed_values(pedestrian.walked_m, pedestrian.prob, model.transition_prob)
        pedestrian, mean, cov = with_heading(pedestrian, step, mean, cov, model.directions, model.noise)
        length_m, var_m2, own_var_m2, parameter_std_m = model.lengths(step)
        ahead = advance(mean, cov, step, length_m, own_var_m2, model.directions, model.noise)
        mean, cov = ahead.mean, ahead.cov
        window = window_before(state.windows, step.time_s)
        n_later = n_after(state.windows, window) if window else 0
        is_new = window is not None and (state.used is None or window.time_s > state.used.time_s)
        evidence = model.step_evidence
        if window is not None and is_new:
            evidence = evidence + model.evidence.of(window, state.used, state.n_unused - n_later)
        if is_known_to_stand(pedestrian, step):
            evidence = evidence - _STANDSTILL_LOG_EVIDENCE * model.moves
        prob = imm.update_mode_prob(prob, evidence)
        x, P = imm.combine(mean, cov, prob)
        # The length and heading of the step itself; evidence also moves the combined position, which is no walking.
        walked = Walked(
            length_m=float(prob.dot(ahead.move.length_m)),
            length_var_m2=max(float(prob.dot(var_m2 + length_m * length_m)) - float(prob.dot(length_m)) ** 2, 0.0),
            heading_rad=step.device_heading_rad + float(x[HEADING_OFFSET]) + model.mean_heading_offset_rad(prob),
            parameter_std_m=prob * parameter_std_m * ahead.move.scale,  # the person's, before it is forgotten a little
            own_direction=ahead.move.along,
        )
        walked_m = walked_m + ahead.move.length_m
        after = replace(pedestrian, mean=mean, cov=cov, prob=prob, walked_m=walked_m)
        after = with_step(after, step, walked, (x, P))
        latest = window or (state.windows[-1] if state.windows else None)
        context_prob = latest.prob if latest else model.context_prob(prob)
        shared_m2 = shared_cov(after)
        update = step_update(pedestrian, after, step, walked, (x, P), shared_m2, context_prob, prob)
        state = replace(state, pedestrian=after)
        if is_new:
            state = replace(state, used=window, n_unused=n_later)
        return state, (update,)

    def on_gap(self, state: ImmState, gap_s: float) -> tuple[ImmState, tuple[StepUpdate, ...]]:
        """New state after a time without samples: windows start afresh, positions and headings are less known."""
        return replace(state, pedestrian=over_gap(state.pedestrian, gap_s, self.model.noise), windows=()), ()

    def on_fix(self, state: ImmState, fix: Fix) -> tuple[ImmState, FixOutcome, float]:
        """New state after a fix, what became of it, and its normalised innovation squared; see `use_fix`."""
        offset_rad = self.model.directions.heading_offset_rad
        pedestrian, outcome, nis = use_fix(self.model, self.arithmetic, state.pedestrian, offset_rad, fix)
        return replace(state, pedestrian=pedestrian), outcome, nis

    def finish(self, state: ImmState) -> tuple[ImmState, tuple[StepUpdate, ...]]:
        """New state when no further window will come: no step waits."""
        return state, ()
