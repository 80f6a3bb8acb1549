"""Interface of a stage behind the tracker that keeps the track on a floor plan."""

from __future__ import annotations

from typing import Any, Protocol

from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.imm.pedestrian_state import PedestrianState, StepUpdate
from pdr_filter.values import Fix, FixOutcome, FloatArray, FloorPassage, Note, OnPlan, Plan


class PlanStart(Protocol):
    """Start of the walk on the plan."""

    @property
    def floor(self) -> int:
        """Storey of the start."""
        ...


class PlanState(Protocol):
    """State of a plan stage."""

    @property
    def heading_rad(self) -> float:
        """Device heading at the last step."""
        ...


class PlanStage(Protocol):
    """Stage that processes the events of a tracker on a floor plan.

    `pdr_filter.apps.maps.particle_filter.ParticleFilter` is the implementation. Each `on_` method returns the state
    after one event. Its argument `pedestrian` is the state of the tracker after the same event.
    """

    @property
    def plan(self) -> Plan:
        """Floor plan."""
        ...

    @property
    def start(self) -> PlanStart | None:
        """Start of the walk, or None if the tracker determines it."""
        ...

    def init(self) -> Any:
        """Return the state of the stage before the first step."""
        ...

    def on_step(self, state: Any, update: StepUpdate, pedestrian: PedestrianState, model: PedestrianModel) -> Any:
        """Return the state of the stage after a final step, whose track row is `update`."""
        ...

    def on_gap(self, state: Any, gap_s: float, model: PedestrianModel) -> Any:
        """Return the state of the stage after a time of `gap_s` seconds without samples."""
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
        """Return the state of the stage after a fix that the tracker has used or rejected.

        `outcome` is how the tracker has treated the fix, and `floor` is the number of the present storey.
        """
        ...

    def on_passage(self, state: Any, passage: FloorPassage, pedestrian: PedestrianState, model: PedestrianModel) -> Any:
        """Return the state of the stage after the pedestrian has reached another storey."""
        ...

    def place(self, state: Any, reckoned: tuple[FloatArray, FloatArray]) -> OnPlan | None:
        """Return the estimate of the position on the plan, or None before the first one.

        `reckoned` is the position (2,) of the tracker in m and its covariance (2, 2).
        """
        ...

    def notes(self, state: Any) -> list[Note]:
        """Return warnings about the plan and the walk."""
        ...
