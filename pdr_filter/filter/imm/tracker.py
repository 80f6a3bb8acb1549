"""The interface of a tracker: steps, context windows, gaps and fixes in, track rows out."""

from __future__ import annotations

from dataclasses import Field
from typing import Any, ClassVar, Protocol, TypeVar

from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.imm.pedestrian_state import PedestrianState, StepUpdate
from pdr_filter.sensing.contexts.context_stage import WindowContext
from pdr_filter.values import Fix, FixOutcome, Step


class TrackerState(Protocol):
    """State of any tracker: a frozen dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]  # `dataclasses.replace` accepts only dataclasses

    @property
    def pedestrian(self) -> PedestrianState:
        """Estimates after the last final step."""
        ...


S = TypeVar("S", bound=TrackerState)


class Tracker(Protocol[S]):
    """A frozen dataclass with one pure function for each kind of event; S is the class of its states."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]  # `dataclasses.replace` accepts only dataclasses

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

    def init(self) -> S:
        """State at the origin."""
        ...

    def on_window(self, state: S, window: WindowContext) -> tuple[S, tuple[StepUpdate, ...]]:
        """New state after a context window, and the steps that it made final."""
        ...

    def on_step(self, state: S, step: Step) -> tuple[S, tuple[StepUpdate, ...]]:
        """Return the state after a step, and the updates of this step and of those that became final."""
        ...

    def on_gap(self, state: S, gap_s: float) -> tuple[S, tuple[StepUpdate, ...]]:
        """New state after a time without samples."""
        ...

    def on_fix(self, state: S, fix: Fix) -> tuple[S, FixOutcome, float]:
        """New state after a fix, what became of it, and its normalised innovation squared."""
        ...

    def finish(self, state: S) -> tuple[S, tuple[StepUpdate, ...]]:
        """New state when nothing more will come."""
        ...
