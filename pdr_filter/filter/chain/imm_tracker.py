"""IMM tracker: one Kalman filter for each mode, mixed by the mode probabilities."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

from pdr_filter.filter.chain.recent_windows import RecentWindows, n_after, window_before, with_window
from pdr_filter.filter.chain.tracker import TrackerEvents
from pdr_filter.filter.fixes.fix_updates import use_fix
from pdr_filter.filter.fixes.gating import Filters
from pdr_filter.filter.imm.estimates import Estimates
from pdr_filter.filter.imm.imm import ImmArithmetic, NumpyImm, mixed_values
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET
from pdr_filter.filter.imm.step_cycle import StepMotion, step_cycle
from pdr_filter.filter.pedestrian.fix_history import STANDSTILL_LOG_EVIDENCE
from pdr_filter.filter.pedestrian.pedestrian_model import ModeLengths, PedestrianModel
from pdr_filter.filter.pedestrian.pedestrian_state import (
    PedestrianState,
    StepEstimate,
    StepUpdate,
    before_step,
    initial_state,
    over_gap,
    since_last_step,
    state_after_step,
    with_withheld_length,
    without_changes,
)
from pdr_filter.filter.pedestrian.step_history import Walked
from pdr_filter.values import Fix, FixOutcome, FloatArray, Step, WindowContext, replace_unchecked


@dataclass(frozen=True, eq=False)
class ImmState:
    """State of an `ImmTracker`: estimates of all modes, and the windows that are their evidence."""

    pedestrian: PedestrianState
    windows: RecentWindows
    used: WindowContext | None  # last window that was used as evidence
    n_unused: int  # number of windows since `used`; gaps are not counted


@dataclass(frozen=True, eq=False)
class ImmTracker(TrackerEvents[ImmState]):
    """Tracker with the interacting multiple model over the modes of a pedestrian model.

    Each step is reported once, as soon as it is detected.

    Attributes
    ----------
    model : PedestrianModel
        Modes, transitions, noise and evidence.
    arithmetic : ImmArithmetic, default NumpyImm()
        Implementation of mixing, update and combination. `filterpy_backend.FilterpyImm()` gives the same track with the
        classes of filterpy, but is many times slower.

    Notes
    -----
    A step is one cycle of the IMM estimator, in the order and with the numbers of "One step" in docs/methods/imm.md:

    1. interaction (`imm.mix`), 2. heading and 3. displacement of each mode (`step_cycle`), 4. mode probabilities by
    the evidence of step and context window (`imm.update_mode_prob`), 5. combination (`imm.combine`).

    The measured heading gives no mode likelihood: it is the direction that the body faces, which all modes predict
    alike.

    References
    ----------
    Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001,
    section 11.6.6.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.filter.chain.imm_tracker import ImmTracker
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP
    >>> tracker = ImmTracker(pdr.recipes.default().model)
    >>> state, updates = tracker.on_step(tracker.init(), TYPICAL_STEP)
    >>> updates[0].index, updates[0].is_final
    (0, True)
    """

    model: PedestrianModel
    arithmetic: ImmArithmetic = field(default_factory=NumpyImm)

    weighting = "imm"
    # A step is final when it is detected. Later windows are evidence for later steps only.
    waits_for_windows = 0

    @cached_property
    def _filters(self) -> Filters:
        return Filters(self.model, self.arithmetic, self.model.directions.heading_offset_rad)

    def init(self) -> ImmState:
        return ImmState(initial_state(self.model, self.model.long_run_mode_prob), (), None, 0)

    def on_window(self, state: ImmState, window: WindowContext) -> tuple[ImmState, tuple[StepUpdate, ...]]:
        windows = with_window(state.windows, window)
        n_unused = state.n_unused + (windows is not state.windows)
        return replace_unchecked(state, windows=windows, n_unused=n_unused), ()

    def on_step(self, state: ImmState, step: Step) -> tuple[ImmState, tuple[StepUpdate, ...]]:
        model, imm = self.model, self.arithmetic
        previous, lengths = before_step(without_changes(state.pedestrian), step), model.lengths(step)
        mixed = self._mixed(previous.estimates)  # 1
        own, since = (lengths.length_m, lengths.residual_var_m2), since_last_step(previous, step)
        cycle = step_cycle(mixed, previous.heading_zero, step, since, own, model.directions, model.noise)  # 2 and 3
        window = window_before(state.windows, step.time_s)
        state, log_evidence = self._with_evidence(state, step, window)
        prob = imm.update_mode_prob(mixed.prob, log_evidence)  # 4
        combined = imm.combine(cycle.ahead.mean, cycle.ahead.cov, prob)  # 5

        walked = self._walked(step, lengths, cycle.motion, prob, combined[0])
        context_prob = model.context_prob(prob) if window is None else window.prob
        if previous.fixes.is_standing(step.time_s):
            free_prob = model.step_mode_prob(context_prob)
            withheld_m = float((free_prob - prob) @ cycle.motion.length_m)
            previous, walked = with_withheld_length(model, previous, step, walked, free_prob, withheld_m)
        estimate = StepEstimate(replace_unchecked(cycle.ahead, prob=prob), combined, prob, context_prob)
        pedestrian, update = state_after_step(model, previous, step, cycle, walked, estimate)
        return replace_unchecked(state, pedestrian=pedestrian), (update,)

    def provisional(self, state: ImmState) -> StepUpdate | None:
        return None

    def _mixed(self, estimates: Estimates) -> Estimates:
        """Return the mixed estimates and predicted mode probabilities before the next step."""
        transition_prob = self.model.transition_prob
        mean, cov, prob = self.arithmetic.mix(estimates.mean, estimates.cov, estimates.prob, transition_prob)
        walked_m = mixed_values(estimates.walked_m, estimates.prob, transition_prob)
        return replace_unchecked(estimates, mean=mean, cov=cov, prob=prob, walked_m=walked_m)

    def _with_evidence(self, state: ImmState, step: Step, window: WindowContext | None) -> tuple[ImmState, FloatArray]:
        """Return the state and the log evidence (M,) of the step, its context window and known standstills.

        A window is evidence only once, for the first step to which it belongs. The returned state records that it was
        used.
        """
        evidence = self.model.step_evidence
        if window is not None and (state.used is None or window.time_s > state.used.time_s):
            n_later = n_after(state.windows, window)
            evidence = evidence + self.model.evidence.of(window, state.used, state.n_unused - n_later)
            state = replace_unchecked(state, used=window, n_unused=n_later)
        if state.pedestrian.fixes.is_standing(step.time_s):
            evidence = evidence - STANDSTILL_LOG_EVIDENCE * self.model.moves
        return state, evidence

    def _walked(self, step: Step, lengths: ModeLengths, motion: StepMotion, prob: FloatArray, x: FloatArray) -> Walked:
        """Return length and heading of a step with their uncertainties, weighted by the mode probabilities (M,).

        `x` (4,) is the combined mean after the step.
        """
        heading_rad = step.reference_heading_rad + float(x[HEADING_OFFSET]) + self.model.mean_heading_offset_rad(prob)
        return Walked(
            length_m=float(prob.dot(motion.length_m)),
            length_var_m2=lengths.mixture_var_m2(prob),
            heading_rad=heading_rad,
            parameter_std_m=prob * lengths.parameter_std_m * motion.scale,
            direction=motion.along,
        )

    def on_gap(self, state: ImmState, gap_s: float) -> tuple[ImmState, tuple[StepUpdate, ...]]:
        return replace_unchecked(state, pedestrian=over_gap(state.pedestrian, gap_s, self.model.noise), windows=()), ()

    def on_fix(self, state: ImmState, fix: Fix) -> tuple[ImmState, FixOutcome, float]:
        pedestrian, outcome, nis = use_fix(self._filters, state.pedestrian, fix)
        return replace_unchecked(state, pedestrian=pedestrian), outcome, nis

    def finish(self, state: ImmState) -> tuple[ImmState, tuple[StepUpdate, ...]]:
        return state, ()
