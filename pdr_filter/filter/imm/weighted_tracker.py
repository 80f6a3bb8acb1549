"""Steps and context windows in, track rows out: one filter whose step length weighs those of the contexts.

The step length is the highest context's or the probability-weighted one, each step weighted by the two windows that
contain it: the provisional and the final distance of Martinelli et al. 2018, Algorithms 1 and 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.filter.fixes.fix_updates import use_fix
from pdr_filter.filter.imm.estimates import Estimates
from pdr_filter.filter.imm.imm import NumpyImm
from pdr_filter.filter.imm.motion_model import HEADING_OFFSET, Advance, Directions, advance
from pdr_filter.filter.imm.past_path import WalkedStep
from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
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
from pdr_filter.filter.imm.recent_windows import (
    WINDOW_MEMORY_S,
    RecentWindows,
    window_after,
    window_around,
    with_window,
)
from pdr_filter.filter.imm.step_history import Walked
from pdr_filter.filter.imm.weighting import HC, Weighting, context_weights
from pdr_filter.sensing.contexts.context_stage import WindowContext
from pdr_filter.values import Fix, FixOutcome, FloatArray, Step, check_numbers, replace_unchecked

_SUM_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class WeightedState:
    """The estimate after the last final step, and the steps that wait for their windows."""

    pedestrian: PedestrianState
    windows: RecentWindows
    mode_prob: FloatArray  # (M,) weights of the last final step
    pending: tuple[Step, ...]


@dataclass(frozen=True, eq=False)
class WeightedTracker:
    """One filter over the weighted step lengths of the contexts: highest or weighted context.

    The threshold is the second-highest over the highest probability from which contexts are weighted (Algorithm 2:
    0.8); `weighting.HC` (infinity) takes the highest without exception.
    """

    model: PedestrianModel  # with exactly one mode for each context
    threshold: float = 0.8
    function: Weighting | None = None  # maps context probabilities (C,) to weights (C,); replaces the threshold

    # A step is final when the window after the one in which it is new is known.
    waits_for_windows = 2

    def __post_init__(self) -> None:
        check_numbers(self, zero=("threshold",), infinite=("threshold",))
        self.model.check_one_mode_for_each_context()

    @property
    def weighting(self) -> str:
        """Short name: "hc", "wc", or the name of the function."""
        if self.function is not None:
            return str(getattr(self.function, "__name__", type(self.function).__name__))
        return "hc" if self.threshold == HC else "wc"

    def init(self) -> WeightedState:
        """State at the origin."""
        return WeightedState(initial_state(self.model, np.ones(1)), (), self.model.long_run_mode_prob, ())

    def on_window(self, state: WeightedState, window: WindowContext) -> tuple[WeightedState, tuple[StepUpdate, ...]]:
        """New state, and the steps that this window made final."""
        return self._settle(replace_unchecked(state, windows=with_window(state.windows, window)), force=False)

    def on_step(self, state: WeightedState, step: Step) -> tuple[WeightedState, tuple[StepUpdate, ...]]:
        """Return the new state, the steps that became final, and a provisional update of this step."""
        state = replace_unchecked(state, pending=(*state.pending, step))
        state, final = self._settle(state, force=False)
        provisional_state, provisional = state, tuple[StepUpdate, ...]()
        while provisional_state.pending:
            provisional_state, update = self._weighted_step(provisional_state, is_final=False)
            provisional = (update,)
        return state, (*final, *provisional)

    def on_gap(self, state: WeightedState, gap_s: float) -> tuple[WeightedState, tuple[StepUpdate, ...]]:
        """New state after a time without samples: waiting steps are final, windows start afresh."""
        state, final = self._settle(state, force=True)
        return replace_unchecked(
            state, pedestrian=over_gap(state.pedestrian, gap_s, self.model.noise), windows=()
        ), final

    def on_fix(self, state: WeightedState, fix: Fix) -> tuple[WeightedState, FixOutcome, float]:
        """New state after a fix, what became of it, and its normalised innovation squared; see `use_fix`."""
        pedestrian, outcome, nis = use_fix(self.model, NumpyImm(), state.pedestrian, np.zeros(1), fix)
        return replace_unchecked(state, pedestrian=pedestrian), outcome, nis

    def finish(self, state: WeightedState) -> tuple[WeightedState, tuple[StepUpdate, ...]]:
        """New state with every waiting step final: no further window will come."""
        return self._settle(state, force=True)

    def _settle(self, state: WeightedState, force: bool) -> tuple[WeightedState, tuple[StepUpdate, ...]]:
        """Make steps final, in order, whose last window is known (or all, if no further window will come)."""
        final = list[StepUpdate]()
        while state.pending:
            step = state.pending[0]
            # where windows do not come, steps wait no longer than windows are remembered
            waits = state.pending[-1].time_s - step.time_s <= WINDOW_MEMORY_S
            if window_after(state.windows, step.time_s) is None and waits and not force:
                break
            state, update = self._weighted_step(state, is_final=True)
            final.append(update)
        return state, tuple(final)

    def _weighted_step(self, state: WeightedState, is_final: bool) -> tuple[WeightedState, StepUpdate]:
        """Return the state after the first waiting step, and the update of that step."""
        model, step = self.model, state.pending[0]
        context_prob, weights = self._weights(state, step, is_final)
        previous = with_open_turn(state.pedestrian)
        if previous.fixes.is_standing(step.time_s):
            weights = 1.0 - model.moves
        directions = model.directions.weighted(weights)
        turned, drifted_cov = with_heading(previous, step, directions, model.noise)
        ahead, walked = self._ahead(turned.estimates, step, weights, directions)
        walked_m = previous.estimates.walked_m + ahead.motion.length_m
        predicted = replace_unchecked(turned.estimates, mean=ahead.mean, cov=ahead.cov, walked_m=walked_m)
        combined = predicted.mean[0], predicted.cov[0]
        event = WalkedStep.of(step.time_s, previous.estimates, drifted_cov, turned.estimates, ahead, combined[0])
        updated = with_step(replace_unchecked(turned, estimates=predicted), step, walked, combined, event)
        update = step_update(previous, updated, step, walked, combined, context_prob, weights, model.contexts, is_final)
        mode_prob = weights if is_final else state.mode_prob
        return replace_unchecked(state, pedestrian=updated, pending=state.pending[1:], mode_prob=mode_prob), update

    def _weights(self, state: WeightedState, step: Step, is_final: bool) -> tuple[FloatArray, FloatArray]:
        """Context probabilities (C,) and weights of the modes (M,) of a step.

        Both are the mean of the provisional and the final ones, as (d + pd) / 2 of the algorithms.
        """
        provisional = self._prob_of(state, window_around(state.windows, step.time_s))
        final = self._prob_of(state, window_after(state.windows, step.time_s)) if is_final else provisional
        weights = 0.5 * (self._weights_of(provisional) + self._weights_of(final))
        return 0.5 * (provisional + final), weights[self.model.context_index]

    def _weights_of(self, context_prob: FloatArray) -> FloatArray:
        """Weights of the contexts (C,)."""
        if self.function is None:
            return context_weights(context_prob, self.threshold)
        weights = np.asarray(self.function(context_prob.copy()), dtype=float)
        if weights.shape != context_prob.shape or not (weights >= 0).all() or abs(weights.sum() - 1.0) > _SUM_TOLERANCE:
            raise ValueError(
                f"weighting {self.weighting!r} must return {len(context_prob)} weights that are 0 or more and sum to "
                f"one, got {weights}: divide them by their sum"
            )
        return weights

    def _ahead(
        self, estimates: Estimates, step: Step, weights: FloatArray, directions: Directions
    ) -> tuple[Advance, Walked]:
        """Displacement of a step whose length is that of the modes weighted (M,), and that step."""
        lengths = self.model.lengths(step)
        length_m, length_var_m2 = float(weights @ lengths.length_m), lengths.mixture_var_m2(weights)
        single_var_m2 = max(length_var_m2 - float(weights @ lengths.parameter_std_m**2), 0.0)
        ahead = advance(
            estimates.mean,
            estimates.cov,
            step,
            np.array([length_m]),
            np.array([single_var_m2]),
            directions,
            self.model.noise,
        )
        motion, mean = ahead.motion, ahead.mean
        walked = Walked(
            length_m=float(motion.length_m[0]),
            length_var_m2=length_var_m2,
            heading_rad=step.device_heading_rad + float(mean[0, HEADING_OFFSET] + directions.heading_offset_rad[0]),
            parameter_std_m=weights * lengths.parameter_std_m * motion.scale,
            direction=motion.along,
        )
        return ahead, walked

    def _prob_of(self, state: WeightedState, window: WindowContext | None) -> FloatArray:
        """Context probabilities (C,) of a window; without it of the latest; else those so far."""
        if window is None and not state.windows:
            return self.model.context_prob(state.mode_prob)
        return (window or state.windows[-1]).prob
