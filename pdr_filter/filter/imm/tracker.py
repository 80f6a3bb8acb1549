"""The interface of a tracker: steps, context windows, gaps and fixes in, track rows out."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from pdr_filter.filter.imm.motion_model import MotionNoise, grow_over_gap
from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.imm.pedestrian_state import PedestrianState, StepUpdate, after_gap
from pdr_filter.sensing.contexts.context_stage import WindowContext
from pdr_filter.values import Fix, FixOutcome, Step, replace


def over_gap(state: PedestrianState, gap_s: float, noise: MotionNoise) -> PedestrianState:
    """Return the state after a time without samples: positions and headings are less known.

    The gap's own growth stands for the time since the last step.
    """
    cov = grow_over_gap(state.cov, gap_s, noise)
    return replace(after_gap(state), cov=cov, last_step_s=np.nan, speed=None, gap_s=state.gap_s + gap_s)


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

    def on_window(self, state: Any, window: WindowContext) -> tuple[Any, tuple[StepUpdate, ...]]:
        """New state after a context window, and the steps that it made final."""
        ...

    def on_step(self, state: Any, step: Step) -> tuple[Any, tuple[StepUpdate, ...]]:
        """Return the state after a step, and the updates of this step and of those that became final."""
        ...

    def on_gap(self, state: Any, gap_s: float) -> tuple[Any, tuple[StepUpdate, ...]]:
        """New state after a time without samples."""
        ...

    def on_fix(self, state: Any, fix: Fix) -> tuple[Any, FixOutcome, float]:
        """New state after a fix, what became of it, and its normalised innovation squared."""
        ...

    def finish(self, state: Any) -> tuple[Any, tuple[StepUpdate, ...]]:
        """New state when nothing more will come."""
        ...
