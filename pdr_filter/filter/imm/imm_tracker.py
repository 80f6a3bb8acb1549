"""Steps and context windows in, track rows out: one Kalman filter for each mode, mixed by probability."""

from __future__ import annotations

from dataclasses import dataclass, field

from pdr_filter.filter.fixes.fix_updates import use_fix
from pdr_filter.filter.imm.estimates import Estimates
from pdr_filter.filter.imm.imm import ImmArithmetic, NumpyImm, mixed_values
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, Advance, StepMotion, advance
from pdr_filter.filter.imm.past_path import WalkedStep
from pdr_filter.filter.imm.pedestrian_model import ModeLengths, PedestrianModel
from pdr_filter.filter.imm.pedestrian_state import (
    PedestrianState,
    StepUpdate,
    initial_state,
    over_gap,
    step_update,
    with_heading,
    with_open_turn,
    with_step,
)
from pdr_filter.filter.imm.recent_windows import RecentWindows, n_after, window_before, with_window
from pdr_filter.filter.imm.step_history import Walked
from pdr_filter.sensing.contexts.context_stage import WindowContext
from pdr_filter.values import Fix, FixOutcome, FloatArray, Step, replace_unchecked

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
        return replace_unchecked(state, windows=windows, n_unused=n_unused), ()

    def on_step(self, state: ImmState, step: Step) -> tuple[ImmState, tuple[StepUpdate, ...]]:
        """Return the new state and the update of this step: one cycle of the IMM estimator.

        The parts are interaction, mode-matched filtering, mode probability update and combination (Y. Bar-Shalom, X. R.
        Li and T. Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 11.6.6). The
        measurement of each mode is the walking heading; context windows and the step itself are evidence for the modes.
        """
        model, imm = self.model, self.arithmetic
        previous = with_open_turn(state.pedestrian)
        mixed = self._mixed(previous.estimates)
        turned, drifted_cov = with_heading(
            replace_unchecked(previous, estimates=mixed), step, model.directions, model.noise
        )
        lengths = model.lengths(step)
        ahead = self._ahead(turned.estimates, step, lengths)
        predicted = replace_unchecked(
            turned.estimates, mean=ahead.mean, cov=ahead.cov, walked_m=mixed.walked_m + ahead.motion.length_m
        )
        window = window_before(state.windows, step.time_s)
        state, log_evidence = self._with_evidence(state, step, window)
        prob = imm.update_mode_prob(predicted.prob, log_evidence)
        combined = imm.combine(predicted.mean, predicted.cov, prob)

        walked = self._walked(step, lengths, ahead.motion, prob, combined[0])
        event = WalkedStep.of(step.time_s, mixed, drifted_cov, turned.estimates, ahead, combined[0])
        updated = with_step(
            replace_unchecked(turned, estimates=replace_unchecked(predicted, prob=prob)), step, walked, combined, event
        )
        context_prob = model.context_prob(prob) if window is None else window.prob
        update = step_update(previous, updated, step, walked, combined, context_prob, prob, model.contexts)
        return replace_unchecked(state, pedestrian=updated), (update,)

    def _mixed(self, estimates: Estimates) -> Estimates:
        """Mixed estimates and predicted mode probabilities, before the next step."""
        transition_prob = self.model.transition_prob
        mean, cov, prob = self.arithmetic.mix(estimates.mean, estimates.cov, estimates.prob, transition_prob)
        walked_m = mixed_values(estimates.walked_m, estimates.prob, transition_prob)
        return replace_unchecked(estimates, mean=mean, cov=cov, prob=prob, walked_m=walked_m)

    def _ahead(self, estimates: Estimates, step: Step, lengths: ModeLengths) -> Advance:
        """Displacement of each mode, and the means and covariances after it."""
        length_m, _, residual_var_m2, _ = lengths
        return advance(
            estimates.mean, estimates.cov, step, length_m, residual_var_m2, self.model.directions, self.model.noise
        )

    def _with_evidence(self, state: ImmState, step: Step, window: WindowContext | None) -> tuple[ImmState, FloatArray]:
        """State that has used the window of a step, and the log evidence (M,) of step, window and standstills."""
        evidence = self.model.step_evidence
        if window is not None and (state.used is None or window.time_s > state.used.time_s):
            n_later = n_after(state.windows, window)
            evidence = evidence + self.model.evidence.of(window, state.used, state.n_unused - n_later)
            state = replace_unchecked(state, used=window, n_unused=n_later)
        if state.pedestrian.fixes.is_standing(step.time_s):
            evidence = evidence - _STANDSTILL_LOG_EVIDENCE * self.model.moves
        return state, evidence

    def _walked(self, step: Step, lengths: ModeLengths, motion: StepMotion, prob: FloatArray, x: FloatArray) -> Walked:
        """Length and heading of a step, weighted by the mode probabilities (M,), with the combined mean x (4,)."""
        heading_rad = step.device_heading_rad + float(x[HEADING_OFFSET]) + self.model.mean_heading_offset_rad(prob)
        return Walked(
            length_m=float(prob.dot(motion.length_m)),
            length_var_m2=lengths.mixture_var_m2(prob),
            heading_rad=heading_rad,
            parameter_std_m=prob * lengths.parameter_std_m * motion.scale,
            direction=motion.along,
        )

    def on_gap(self, state: ImmState, gap_s: float) -> tuple[ImmState, tuple[StepUpdate, ...]]:
        """New state after a time without samples: windows start afresh, positions and headings are less known."""
        return replace_unchecked(state, pedestrian=over_gap(state.pedestrian, gap_s, self.model.noise), windows=()), ()

    def on_fix(self, state: ImmState, fix: Fix) -> tuple[ImmState, FixOutcome, float]:
        """New state after a fix, what became of it, and its normalised innovation squared; see `use_fix`."""
        offset_rad = self.model.directions.heading_offset_rad
        pedestrian, outcome, nis = use_fix(self.model, self.arithmetic, state.pedestrian, offset_rad, fix)
        return replace_unchecked(state, pedestrian=pedestrian), outcome, nis

    def finish(self, state: ImmState) -> tuple[ImmState, tuple[StepUpdate, ...]]:
        """New state when no further window will come: no step waits."""
        return state, ()
