"""HC and WC tracker: one filter whose step length is a weighted mean of the step lengths of the contexts.

HC (highest context) uses the most probable context, WC (weighted context) the probabilities as weights. Each step is
weighted with the two windows that contain it. They correspond to the provisional and the final distance in Algorithms 1
and 2 of Martinelli et al. (2018).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdr_filter.filter.chain.recent_windows import (
    WINDOW_MEMORY_S,
    RecentWindows,
    window_after,
    window_around,
    with_window,
)
from pdr_filter.filter.chain.tracker import TrackerEvents
from pdr_filter.filter.fixes.fix_updates import use_fix
from pdr_filter.filter.fixes.gating import Filters
from pdr_filter.filter.imm.imm import NumpyImm
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET
from pdr_filter.filter.imm.step_cycle import step_cycle
from pdr_filter.filter.imm.weighting import HC, WC, Weighting, context_weights
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
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
from pdr_filter.values import Fix, FixOutcome, FloatArray, Step, WindowContext, check_numbers, replace_unchecked
from pdr_filter.values.mixtures import posterior_prob

_SUM_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class WeightedState:
    """State of a `WeightedTracker`: estimates after the last final step, and the steps that wait for their windows."""

    pedestrian: PedestrianState
    windows: RecentWindows
    mode_prob: FloatArray  # (M,) weights of the last final step
    pending: tuple[Step, ...]


@dataclass(frozen=True, eq=False)
class WeightedTracker(TrackerEvents[WeightedState]):
    """Tracker with a single filter over the weighted step lengths of the contexts, for the weightings HC and WC.

    HC (highest context) uses the step length of the most probable context. WC (weighted context) uses the mean of the
    step lengths, weighted with the context probabilities. The weights are the mean over two windows: the one around the
    step and the one after it. In both, the step is evidence against contexts without steps, as in the IMM
    (`PedestrianModel.step_evidence`). A step is final when the context window after the first one that contains it is
    known. Until then `provisional` estimates it from the windows so far.

    Attributes
    ----------
    model : PedestrianModel
        Modes, transitions, noise and evidence, with exactly one mode for each context.
    threshold : float, default 0.8
        Ratio of the second-highest to the highest context probability from which contexts are weighted (Algorithm 2 of
        Martinelli et al. 2018). Below it the highest context is used. Infinity (`weighting.HC`) always uses the
        highest.
    function : callable, optional
        Function from context probabilities (C,), given the window and the step, to weights (C,), which replaces the
        threshold. Weights must be 0 or more and sum to one.

    Raises
    ------
    ValueError
        If the threshold is negative, or if the model does not have exactly one mode for each context.

    References
    ----------
    A. Martinelli, H. Gao, P. D. Groves, S. Morosi, "Probabilistic Context-Aware Step Length Estimation for Pedestrian
    Dead Reckoning", IEEE Sensors Journal 18(4), 2018, doi:10.1109/JSEN.2017.2776100.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.filter.chain.weighted_tracker import WeightedTracker
    >>> from pdr_filter.filter.step_length.models import TYPICAL_STEP
    >>> tracker = WeightedTracker(pdr.recipes.default().model)
    >>> state, updates = tracker.on_step(tracker.init(), TYPICAL_STEP)
    >>> updates, tracker.provisional(state).is_final
    ((), False)
    >>> state, updates = tracker.finish(state)
    >>> updates[0].index, updates[0].is_final
    (0, True)
    """

    model: PedestrianModel
    threshold: float = WC
    function: Weighting | None = None

    # A step is final when the window after the first one that contains it is known.
    waits_for_windows = 2
    _last_window = staticmethod(window_after)

    def __post_init__(self) -> None:
        check_numbers(self, zero=("threshold",), infinite=("threshold",))
        self.model.check_one_mode_for_each_context()

    @property
    def weighting(self) -> str:
        """Short name of the rule that turns context probabilities into weights of the step lengths.

        It is "hc" (highest context), "wc" (weighted context), or the name of `function`. "hc" takes the step length of
        the most probable context. "wc" takes the mean of the step lengths, weighted with the context probabilities. The
        weights of a step are the mean over the window around it and the window after it.
        """
        if self.function is not None:
            return str(getattr(self.function, "__name__", type(self.function).__name__))
        return "hc" if self.threshold == HC else "wc"

    @cached_property
    def _filters(self) -> Filters:
        return Filters(self.model, NumpyImm(), np.zeros(1))

    def init(self) -> WeightedState:
        return WeightedState(initial_state(self.model, np.ones(1)), (), self.model.long_run_mode_prob, ())

    def on_window(self, state: WeightedState, window: WindowContext) -> tuple[WeightedState, tuple[StepUpdate, ...]]:
        return self._settle(replace_unchecked(state, windows=with_window(state.windows, window)), force=False)

    def on_step(self, state: WeightedState, step: Step) -> tuple[WeightedState, tuple[StepUpdate, ...]]:
        pedestrian, pending = without_changes(state.pedestrian), (*state.pending, step)
        return self._settle(replace_unchecked(state, pedestrian=pedestrian, pending=pending), force=False)

    def provisional(self, state: WeightedState) -> StepUpdate | None:
        update = None
        while state.pending:
            state, update = self._weighted_step(state, is_final=False)
        return update

    def on_gap(self, state: WeightedState, gap_s: float) -> tuple[WeightedState, tuple[StepUpdate, ...]]:
        state, final = self._settle(state, force=True)
        pedestrian = over_gap(state.pedestrian, gap_s, self.model.noise)
        return replace_unchecked(state, pedestrian=pedestrian, windows=()), final

    def on_fix(self, state: WeightedState, fix: Fix) -> tuple[WeightedState, FixOutcome, float]:
        pedestrian, outcome, nis = use_fix(self._filters, state.pedestrian, fix)
        return replace_unchecked(state, pedestrian=pedestrian), outcome, nis

    def finish(self, state: WeightedState) -> tuple[WeightedState, tuple[StepUpdate, ...]]:
        return self._settle(state, force=True)

    def _settle(self, state: WeightedState, force: bool) -> tuple[WeightedState, tuple[StepUpdate, ...]]:
        """Return the state and the updates after all pending steps have become final whose last window is known.

        If `force` is True, all pending steps become final. So do steps that have waited for more than
        `WINDOW_MEMORY_S`. The order of the steps is kept.
        """
        final = list[StepUpdate]()
        while state.pending:
            step = state.pending[0]
            # without windows, steps wait at most as long as windows are stored
            waits = state.pending[-1].time_s - step.time_s <= WINDOW_MEMORY_S
            if self._last_window(state.windows, step.time_s) is None and waits and not force:
                break
            state, update = self._weighted_step(state, is_final=True)
            final.append(update)
        return state, tuple(final)

    def _weighted_step(self, state: WeightedState, is_final: bool) -> tuple[WeightedState, StepUpdate]:
        """Return the state after the first pending step, and the update of that step.

        In a known standstill, the modes without displacement have the weights.
        """
        model, step = self.model, state.pending[0]
        context_prob, free_weights = self._weights(state, step, is_final)
        previous, lengths = before_step(state.pedestrian, step), model.lengths(step)
        is_standing = previous.fixes.is_standing(step.time_s)
        weights = 1.0 - model.moves if is_standing else free_weights
        directions, mean_lengths = model.directions.of_one_filter(weights), lengths.of_one_filter(weights)
        own, since = (mean_lengths.length_m, mean_lengths.residual_var_m2), since_last_step(previous, step)
        cycle = step_cycle(previous.estimates, previous.heading_zero, step, since, own, directions, model.noise)
        motion, (x,), (P,) = cycle.motion, cycle.ahead.mean, cycle.ahead.cov
        walked = Walked(
            length_m=float(motion.length_m[0]),
            length_var_m2=float(mean_lengths.var_m2[0]),
            heading_rad=step.reference_heading_rad + float(x[HEADING_OFFSET] + directions.heading_offset_rad[0]),
            parameter_std_m=weights * lengths.parameter_std_m * motion.scale,
            direction=motion.along,
        )
        if is_standing:
            withheld_m = float(free_weights @ lengths.length_m) * float(motion.scale[0]) - walked.length_m
            previous, walked = with_withheld_length(model, previous, step, walked, free_weights, withheld_m)
        estimate = StepEstimate(cycle.ahead, (x, P), weights, context_prob)
        pedestrian, update = state_after_step(model, previous, step, cycle, walked, estimate, is_final)
        mode_prob = weights if is_final else state.mode_prob
        return replace_unchecked(state, pedestrian=pedestrian, pending=state.pending[1:], mode_prob=mode_prob), update

    def _weights(self, state: WeightedState, step: Step, is_final: bool) -> tuple[FloatArray, FloatArray]:
        """Return the context probabilities (C,) and the mode weights (M,) of a step.

        Probabilities and weights are the mean of a provisional and a final value. This agrees with the distance (d +
        pd) / 2 in Algorithms 1 and 2 of Martinelli et al. (2018), the mean of final distance d and provisional distance
        pd. The provisional value comes from the first window that ends at or after the step. The final value comes from
        the first window whose new samples all lie after the step. If `is_final` is False, the provisional value
        replaces the final one.

        The algorithms do not use the step as evidence. Without it, a classifier that takes walking for standing would
        leave the track at its start.
        """
        provisional = self._prob_of(state, window_around(state.windows, step.time_s))
        final = self._prob_of(state, self._last_window(state.windows, step.time_s)) if is_final else provisional
        of_step = posterior_prob(np.stack([provisional, final]), self._step_evidence)
        weights = 0.5 * (self._weights_of(of_step[0]) + self._weights_of(of_step[1]))
        return 0.5 * (provisional + final), weights[self.model.context_index]

    def _weights_of(self, context_prob: FloatArray) -> FloatArray:
        """Return the weights (C,) for context probabilities (C,), by `function` or else by the threshold.

        ValueError if `function` returns weights of another number, negative weights, or weights that do not sum to one.
        """
        if self.function is None:
            return context_weights(context_prob, self.threshold)
        weights = np.asarray(self.function(context_prob.copy()), dtype=float)
        if weights.shape != context_prob.shape or not (weights >= 0).all() or abs(weights.sum() - 1.0) > _SUM_TOLERANCE:
            raise ValueError(
                f"weighting {self.weighting!r} must return {len(context_prob)} weights that are 0 or more and sum to "
                f"one, got {weights}: divide them by their sum"
            )
        return weights

    @cached_property
    def _step_evidence(self) -> FloatArray:
        """Log evidence (C,) of a detected step for each context."""
        evidence = np.zeros(len(self.model.contexts))
        evidence[self.model.context_index] = self.model.step_evidence
        return evidence

    def _prob_of(self, state: WeightedState, window: WindowContext | None) -> FloatArray:
        """Return the context probabilities (C,) of a window.

        If `window` is None, the probabilities of the latest window are returned. Without any window these are the
        probabilities of the last final step.
        """
        if window is None and not state.windows:
            return self.model.context_prob(state.mode_prob)
        return (window or state.windows[-1]).prob


@dataclass(frozen=True, eq=False)
class DetectedStepTracker(WeightedTracker):
    """Tracker that decides once about a step, for published systems whose step detectors use the context.

    A step has the length of its most probable context with steps, in the first window that contains it. The detector of
    such a system has rejected the steps of a person who stands. If that window has only contexts without steps, the
    context is the most frequent one with steps.

    Attributes
    ----------
    model : PedestrianModel
        Modes, transitions and noise, with exactly one mode for each context.
    threshold : float, default infinity
        As in `WeightedTracker`, by default the highest context.
    function : callable, optional
        As in `WeightedTracker`.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.filter.chain.weighted_tracker import DetectedStepTracker
    >>> isinstance(pdr.recipes.zhou2019().tracker, DetectedStepTracker)
    True
    """

    threshold: float = HC

    waits_for_windows = 1
    _last_window = staticmethod(window_around)

    def _weights(self, state: WeightedState, step: Step, is_final: bool) -> tuple[FloatArray, FloatArray]:
        """Return the context probabilities (C,) and the mode weights (M,) of a step, from one window."""
        prob = self._prob_of(state, window_around(state.windows, step.time_s))
        with_steps = prob * self._has_steps
        if not with_steps.any():
            usual = self.model.context_prob(self.model.long_run_mode_prob) * self._has_steps
            with_steps = np.eye(len(usual))[usual.argmax()]
        weights = self._weights_of(with_steps / with_steps.sum())
        return prob, weights[self.model.context_index]

    @cached_property
    def _has_steps(self) -> FloatArray:
        """Array (C,) with 0 for contexts without steps, else 1."""
        has_steps = np.ones(len(self.model.contexts))
        has_steps[self.model.context_index] -= self.model.stands
        return has_steps
