"""The configuration of a filter."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from pdr_filter.filter.fixes.frame import UNKNOWN_FRAME
from pdr_filter.filter.imm.imm_tracker import ImmTracker
from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.imm.tracker import Tracker
from pdr_filter.filter.imm.weighted_tracker import WeightedTracker
from pdr_filter.filter.imm.weighting import HC, WEIGHTINGS
from pdr_filter.filter.plan_stage import PlanStage
from pdr_filter.filter.step_length.models import StepLengthFit
from pdr_filter.filter.step_length.person import Person
from pdr_filter.sensing.device import Device
from pdr_filter.sensing.features.barometer import ClimbRate
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.heading.heading_stage import HeadingStage, drift_of, learns_directions
from pdr_filter.sensing.heading.magnetic_north import MagneticNorth
from pdr_filter.sensing.steps.detector_protocol import StepDetector
from pdr_filter.sensing.stream_merging import StreamMerger
from pdr_filter.values import DECLINATION_STD_RAD, Note, Plan, PositionFix, check_members


@dataclass(frozen=True, eq=False)
class Config:
    """Everything about a filter that never changes; a recipe is a function that returns one.

    `needs` names the sensor streams of `Recording`, besides the accelerometer, without which its tracks mean nothing
    (its steps and contexts may do with less); `notes` say in plain words what to keep in mind about every track.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> config = pdr.recipes.default().with_weighting("hc")
    >>> config.name, config.needs
    ('default', ())
    """

    name: str
    sensing: Sensing
    tracker: Tracker[Any]  # any class of states: a recipe chooses the tracker when it is called
    climb_rate: ClimbRate = field(default_factory=ClimbRate)
    needs: tuple[str, ...] = ()
    notes: tuple[Note, ...] = ()
    on_foot: bool = False  # made for a sensor on the foot, not for a carried phone
    person: Person | None = None  # whose step lengths the modes have
    on_plan: PlanStage | None = None  # keeps the track on a floor plan
    merger: StreamMerger = field(default_factory=StreamMerger)  # of sensors that arrive apart

    def __post_init__(self) -> None:
        of_heading, drift = drift_of(self.sensing.heading), self.model.noise.heading_drift
        if of_heading is not None and of_heading != drift:
            raise ValueError(
                f"the heading stage must reckon with the filter's heading drift, {drift}, got {of_heading}: give "
                "one HeadingDrift to both"
            )

    @property
    def model(self) -> PedestrianModel:
        """Modes, transitions, noise and evidence of the tracker."""
        return self.tracker.model

    @property
    def learns_directions(self) -> bool:
        """Whether its steps say where the person walks against the phone."""
        return learns_directions(self.sensing.heading)

    def with_model(self, **changes: Any) -> Config:
        """Return a copy in which some fields of the model have other values."""
        return replace(self, tracker=replace(self.tracker, model=replace(self.model, **changes)))

    def with_device(self, device: Device) -> Config:
        """Return a copy for a phone whose gyroscope bias is known."""
        attitude = self.sensing.attitude
        known = replace(attitude, bias=replace(attitude.bias, device=device))
        return replace(self, sensing=replace(self.sensing, attitude=known))

    def with_person(self, person: Person) -> Config:
        """The same for a person whose step length is known; ValueError if it knows one already."""
        if self.person is not None:
            raise ValueError("the configuration knows a person already: pool the two with Person.pooled")
        known = replace(self, tracker=replace(self.tracker, model=person.in_model(self.model)))
        walks = f"{len(person.sessions)} walk" + "s" * (len(person.sessions) != 1)
        text = f"step lengths of a person with typical steps of {person.step_length_m:.2f} m, of {walks}"
        notes = (*(n for n in self.notes if n.about != "height"), Note("step lengths", text))
        return replace(known, person=person, notes=notes if person.sessions else self.notes)

    def in_world_frame(self) -> Config:
        """The same for fixes in a frame whose origin and north the track does not know, such as that of a map."""
        return self.with_model(frame=UNKNOWN_FRAME)

    def with_magnetic_north(self, declination_rad: float, declination_std_rad: float = DECLINATION_STD_RAD) -> Config:
        """The same in the world frame, with true north, of which the magnetometer says where it is.

        Fixes are then in a frame whose north is true north, too. The declination is by how much magnetic north is east
        of it: `Origin.declination_rad`. ValueError for a recipe that does not learn where the person walks against the
        phone.
        """
        if not self.learns_directions:
            raise ValueError(
                f"recipe {self.name!r} does not learn where the person walks against the phone, so that north of the "
                'magnetometer says nothing of the track: use recipe "default"'
            )
        rate_hz = self.sensing.conditioner.rate_hz
        north = MagneticNorth(rate_hz, declination_rad, declination_std_rad)
        return replace(self, sensing=replace(self.sensing, north=north)).in_world_frame()

    def with_plan(self, plan: Plan, start: PositionFix | str | None = None, seed: int = 0) -> Config:
        """The same for a walk on a floor plan, in whose frame tracks are then.

        Where it begins: a `PositionFix`, the name of an area of the plan, or "anywhere"; if not given, where fixes or
        the frame of the configuration put it. The same `seed` gives the same bits.
        """
        # Only when called: a filter without a plan needs no maps.
        from pdr_filter.maps.particle_filter import ParticleFilter

        placed = self if start is None else self.in_world_frame()
        return replace(placed, on_plan=ParticleFilter.of(plan, start, seed))

    def in_hindsight(self) -> Config:
        """The same where later windows are known, too: a window says no more than its share of the time."""
        return self.with_model(evidence_exponent=self.model.hindsight_exponent)

    def with_steps(self, steps: StepDetector[Any]) -> Config:
        """Return a copy with another step detector; ValueError names what it lacks (`pdr_filter.protocols`).

        Examples
        --------
        >>> import pdr_filter as pdr
        >>> detector = pdr.recipes.zhou2019().sensing.steps
        >>> pdr.recipes.default().with_steps(detector).sensing.steps is detector
        True
        """
        check_members("steps", steps, StepDetector)
        return replace(self, sensing=replace(self.sensing, steps=steps))

    def with_heading(self, heading: HeadingStage) -> Config:
        """Return a copy with another heading stage; ValueError names what it lacks (`pdr_filter.protocols`)."""
        check_members("heading", heading, HeadingStage)
        return replace(self, sensing=replace(self.sensing, heading=heading))

    def with_step_length(self, name: str, fit: StepLengthFit) -> Config:
        """Return a copy in which a mode has another step length; ValueError if there is no mode of that name.

        `name` is that of a mode, or of a context, whose modes then all have this step length.
        """
        modes = self.model.modes
        named = [m.name for m in modes if m.name == name] or [m.name for m in modes if m.context == name]
        if not named:
            raise ValueError(f"no mode {name!r}, there are {', '.join(m.name for m in modes)}: name one")
        changed = tuple(replace(m, step_length=fit) if m.name in named else m for m in modes)
        return self.with_model(modes=changed)

    def with_weighting(self, weighting: str) -> Config:
        """The same with another weighting: "imm", "wc" or "hc"."""
        if weighting not in WEIGHTINGS:
            raise ValueError(f"weighting must be one of {WEIGHTINGS}, got {weighting!r}")
        if weighting == self.tracker.weighting:
            return self
        if weighting == "imm":
            return replace(self, tracker=ImmTracker(self.model))
        threshold = {"threshold": HC} if weighting == "hc" else {}
        return replace(self, tracker=WeightedTracker(self.model, **threshold))

    @cached_property
    def fix_delay_s(self) -> float:
        """How long a fix waits for the step that it falls into to be final."""
        waits_s = self.tracker.waits_for_windows * self.sensing.window_hop_s
        return self.sensing.step_latency_s + self.sensing.steps.first_step_s + waits_s


def check_config(config: object) -> None:
    """ValueError unless it is a configuration."""
    if not isinstance(config, Config):
        raise ValueError(
            f"config must be a Config, got {config!r}: call a recipe, such as pdr_filter.recipes.default()"
        )


def on_plan(config: Config, plan: Plan | None, start: PositionFix | str | None) -> Config:
    """The configuration with a floor plan, if one is given; ValueError for a start without one."""
    if plan is not None:
        return config.with_plan(plan, start)
    if start is not None:
        raise ValueError(f"start is a place on a floor plan, got {start!r} without plan: give one, or leave it out")
    return config
