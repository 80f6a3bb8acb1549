"""Handler that keeps the track on a floor plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from pdr_filter.filter.chain.handler import Around, Event, FixUse, Handler, Output
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.pedestrian_state import PedestrianState, StepUpdate
from pdr_filter.values import FloatArray, FloorPassage, Note, OnPlan, Plan, replace_unchecked
from pdr_filter.values.events import Gap

PlanEvent = StepUpdate | FixUse | FloorPassage | Gap


class PlanStart(Protocol):
    """Start of the walk on the plan."""

    @property
    def floor(self) -> int:
        """Storey of the start."""
        ...


class PlanStage(Protocol):
    """Stage that estimates the position on a floor plan, from the events of a tracker.

    `pdr_filter.apps.maps.particle_filter.ParticleFilter` is the implementation.
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

    def on(self, state: Any, event: PlanEvent, pedestrian: PedestrianState, model: PedestrianModel) -> Any:
        """Return the state of the stage after a final step, a fix, a floor passage, or a gap.

        `pedestrian` is the state of the tracker after the same event.
        """
        ...

    def estimate(self, state: Any, reckoned: tuple[FloatArray, FloatArray]) -> OnPlan | None:
        """Return the estimate of the position on the plan, or None before the first one.

        `reckoned` is the position (2,) of the tracker in m and its covariance (2, 2).
        """
        ...

    def notes(self, state: Any) -> list[Note]:
        """Return warnings about the plan and the walk."""
        ...


@dataclass(frozen=True, eq=False)
class PlanTrack(Around):
    """State of the inner handler, and of the stage on the plan."""

    particles: Any


class WithPlan:
    """Handler around another one whose rows get position, covariance and heading of a stage on a floor plan."""

    def __init__(self, inner: Handler[Any], stage: PlanStage, model: PedestrianModel) -> None:
        self.inner, self.stage, self.model = inner, stage, model

    def init(self) -> PlanTrack:
        """Return the state before the first step."""
        return PlanTrack(self.inner.init(), self.stage.init())

    def on(self, state: PlanTrack, event: Event, known_s: float) -> tuple[PlanTrack, tuple[Output, ...]]:
        """Return the state after an event, and the outputs of the inner handler on the plan."""
        inner, outputs = self.inner.on(state.inner, event, known_s)
        pedestrian, particles, all_outputs = inner.pedestrian, state.particles, list[Output]()
        if isinstance(event, Gap):
            particles = self.stage.on(particles, event, pedestrian, self.model)
        for output in outputs:
            if isinstance(output, StepUpdate) and output.is_final:
                particles = self.stage.on(particles, output, pedestrian, self.model)
                reckoned = output.position_m, output.position_cov_m2
                output = _on_plan(output, self.stage.estimate(particles, reckoned))
            elif isinstance(output, FloorPassage):
                particles = self.stage.on(particles, output, pedestrian, self.model)
            elif isinstance(output, FixUse):
                after = self.stage.on(particles, output, pedestrian, self.model)
                if output.outcome in ("nothing to compare", "waiting") and after is not particles:
                    output = output._replace(outcome="used")
                particles = after
            all_outputs.append(output)
        return replace_unchecked(state, inner=inner, particles=particles), tuple(all_outputs)


def _on_plan(row: StepUpdate, estimate: OnPlan | None) -> StepUpdate:
    """Return a row with position, covariance and heading on the plan, or unchanged before the first estimate."""
    if estimate is None:
        return row
    return replace_unchecked(
        row,
        on_plan=estimate,
        position_m=estimate.position_m,
        position_cov_m2=estimate.position_cov_m2,
        walking_heading_rad=estimate.walking_heading_rad,
        of_start=None,
    )
