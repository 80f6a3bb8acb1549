"""The interface of a tracker: steps, context windows, gaps and fixes in, track rows out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from pdr_filter.filter.imm import ModeEstimates, Transition
from pdr_filter.filter.model import PedestrianModel
from pdr_filter.filter.motion import N_STATES, MotionNoise, grow_over_gap
from pdr_filter.filter.pedestrian import PedestrianState, StepUpdate, after_gap, shared_cov
from pdr_filter.sensing.contexts.stage import WindowContext
from pdr_filter.values import Fix, FixOutcome, FloatArray, Step, replace


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """How one step or gap led the modes on: what a smoother needs."""

    before: ModeEstimates  # with all that is known until then, the walking heading of the step included
    transition: Transition
    shared_cov_m2: FloatArray  # (2, 2) after it, of the errors that all steps share
    is_step: bool


def over_gap(before: PedestrianState, gap_s: float, noise: MotionNoise) -> tuple[PedestrianState, Passage]:
    """State after a time without samples, in which positions and headings become less known, and how it came there.

    The gap's own growth stands for the time since the last step.
    """
    cov = grow_over_gap(before.cov, gap_s, noise)
    after = replace(after_gap(before), cov=cov, last_step_s=np.nan, speed=None, gap_s=before.gap_s + gap_s)
    stay = np.broadcast_to(np.eye(N_STATES), cov.shape)
    transition = Transition(np.eye(len(before.prob)), before.mean, before.mean, stay, cov - before.cov)
    known = ModeEstimates(before.mean, before.cov, before.prob)
    return after, Passage(known, transition, shared_cov(after), is_step=False)


@dataclass(frozen=True, eq=False)
class TrackerOutput:
    """What one event brought."""

    updates: tuple[StepUpdate, ...] = ()
    passages: tuple[Passage, ...] = ()


class TrackerState(Protocol):
    """What every tracker's state has."""

    @property
    def pedestrian(self) -> PedestrianState:
        """Estimates after the last final step."""
        ...


class Tracker(Protocol):
    """One pure function for each kind of event; the state is the tracker's own."""

    @property
    def model(self) -> PedestrianModel:
        """Modes, transitions, noise and evidence."""
        ...

    @property
    def weighting(self) -> str:
        """Its short name: "imm", "wc" or "hc"."""
        ...

    @property
    def waits_for_windows(self) -> int:
        """How many windows must follow before a step is final."""
        ...

    def init(self) -> Any:
        """State at the origin."""
        ...

    def on_window(self, state: Any, window: WindowContext) -> tuple[Any, TrackerOutput]:
        """New state after a context window, and the steps that it made final."""
        ...

    def on_step(self, state: Any, step: Step) -> tuple[Any, TrackerOutput]:
        """New state after a step, and the updates of this one and of those that it made final."""
        ...

    def on_gap(self, state: Any, gap_s: float) -> tuple[Any, TrackerOutput]:
        """New state after a time without samples."""
        ...

    def on_fix(self, state: Any, fix: Fix) -> tuple[Any, FixOutcome, float]:
        """New state after a fix, what became of it, and its normalised innovation squared."""
        ...

    def finish(self, state: Any) -> tuple[Any, TrackerOutput]:
        """New state when nothing more will come."""
        ...
