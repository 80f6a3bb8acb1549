"""Interface of a stage behind the tracker that keeps the track on a floor plan."""

from __future__ import annotations

from typing import Any, Protocol

from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.imm.pedestrian_state import PedestrianState, StepUpdate
from pdr_filter.values import Fix, FixOutcome, FloatArray, FloorPassage, Note, OnPlan, Plan


class PlanStart(Protocol):
    """Where the walk begins on the plan."""

    @property
    def floor(self) -> int:
        """Storey of the start."""
        ...


class PlanState(Protocol):
    """State of a plan stage: all that changes."""

    @property
    def heading_rad(self) -> float:
        """Device heading at the last step."""
        ...


class PlanStage(Protocol):
    """A stage that follows the tracker's events on a floor plan.

    `pdr_filter.maps.particle_filter.ParticleFilter` is one. Each method returns the state after one event, and
    `pedestrian` is the state of the tracker after that event.
    """

    @property
    def plan(self) -> Plan:
        """The floor plan."""
        ...

    @property
    def start(self) -> PlanStart | None:
        """Where the walk begins, None if the tracker shows it."""
        ...

    def init(self) -> Any:
        """State before the first step."""
        ...

    def on_step(self, state: Any, update: StepUpdate, pedestrian: PedestrianState, model: PedestrianModel) -> Any:
        """State after a step."""
        ...

    def on_gap(self, state: Any, gap_s: float, model: PedestrianModel) -> Any:
        """State after a time without samples."""
        ...

    def on_fix(
        self,
        state: Any,
        fix: Fix,
        outcome: FixOutcome,
        pedestrian: PedestrianState,
        model: PedestrianModel,
        floor: int,
    ) -> Any:
        """State after a fix that the tracker has used or rejected."""
        ...

    def on_passage(self, state: Any, passage: FloorPassage, pedestrian: PedestrianState, model: PedestrianModel) -> Any:
        """State after the pedestrian has reached another storey."""
        ...

    def place(self, state: Any, reckoned: tuple[FloatArray, FloatArray]) -> OnPlan | None:
        """Estimate of the position on the plan, None before there is one."""
        ...

    def notes(self, state: Any) -> list[Note]:
        """Warnings about the plan and the walk."""
        ...
