"""The configuration of a filter."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.classifiers.context_model import ContextModel
from pdr_filter.filter.fixes.frame import UNKNOWN_FRAME
from pdr_filter.filter.imm.imm_tracker import ImmTracker
from pdr_filter.filter.imm.motion_model import Mode
from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.imm.tracker import Tracker
from pdr_filter.filter.imm.transition_probabilities import context_transitions
from pdr_filter.filter.imm.weighted_tracker import WeightedTracker
from pdr_filter.filter.imm.weighting import HC, WEIGHTINGS, Weighting
from pdr_filter.filter.plan_stage import PlanStage
from pdr_filter.filter.step_length.models import StepLengthFit
from pdr_filter.filter.step_length.person import Person
from pdr_filter.sensing.contexts.context_stage import ContextStage
from pdr_filter.sensing.contexts.learned_contexts import stage_of, with_carrying_models
from pdr_filter.sensing.device import Device
from pdr_filter.sensing.features.barometer import ClimbRate
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.heading.heading_stage import HeadingStage, drift_of, learns_directions
from pdr_filter.sensing.heading.magnetic_north import MagneticNorth
from pdr_filter.sensing.steps.detector_protocol import StepDetector
from pdr_filter.sensing.stream_merging import StreamMerger
from pdr_filter.values import DECLINATION_STD_RAD, FloatArray, Note, Plan, PositionFix, check_members
from pdr_filter.values.serialisation import to_bytes
from pdr_filter.values.track_placement import TrackPlacement


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
        if self.sensing.context_set != self.model.context_set:
            object.__setattr__(self, "sensing", replace(self.sensing, context_set=self.model.context_set))

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

    def placed(self, placement: TrackPlacement) -> Config:
        """Return the configuration on the floor plan of a placement, if it has one."""
        return self if placement.plan is None else self.with_plan(placement.plan, placement.start)

    def in_hindsight(self) -> Config:
        """The same where later windows are known, too: a window says no more than its share of the time."""
        return self.with_model(evidence_exponent=self.model.hindsight_exponent)

    def with_contexts(
        self,
        model: ContextModel | tuple[ContextModel, ContextModel] | ContextStage,
        modes: Sequence[Mode],
        transition_prob: ArrayLike | None = None,
    ) -> Config:
        """Return a copy with other contexts.

        Parameters
        ----------
        model : ContextModel, two of them, or ContextStage
            Names the contexts (`model.contexts`) and gives their probabilities. Of two models, the second is for
            windows without gyroscope. Without it such windows are unknown, unless the model needs no gyroscope.
        modes : sequence of Mode
            What the contexts mean. "hc", "wc" and functions as weighting need one mode for each context. With "imm" a
            context may have several modes or none; its probability then is evidence for none of them.
        transition_prob : (M, M), optional
            From each mode to each mode between two steps; rows sum to one. If not given, those that the model
            estimated from its labels. A model without them gets those of `recipes.context_transitions`, which follow
            from what the modes mean. Exponents of the evidence are those that the model estimated, or the present ones.

        Examples
        --------
        >>> import pdr_filter as pdr
        >>> names = {"stationary": "resting", "walking": "level"}
        >>> model = pdr.ContextModel.load("context").renamed(names)
        >>> modes = [pdr.Mode("resting", moves=False), pdr.Mode("level")]
        >>> config = pdr.recipes.default().with_contexts(model, modes)
        >>> config.contexts
        ('resting', 'level', 'upstairs', 'downstairs', 'sideways', 'running')
        """
        stage = stage_of(model, self.sensing.contexts)
        _warn_of_state(stage)
        estimated = model[0] if isinstance(model, tuple) else model
        labelled = getattr(estimated, "transition_prob", None)
        prob = _transitions(stage.contexts, modes, labelled) if transition_prob is None else np.asarray(transition_prob)
        exponents = {name: getattr(estimated, name, None) for name in ("evidence_exponent", "prior_exponent")}
        known = self._with_modes(
            modes,
            contexts=stage.contexts,
            transition_prob=prob,
            **{name: value for name, value in exponents.items() if value is not None},
        )
        return replace(
            self,
            sensing=replace(self.sensing, contexts=stage, context_set=known.context_set),
            tracker=replace(self.tracker, model=known),
            notes=self._notes_with(modes),
        )

    def with_carrying_model(self, model: ContextModel | tuple[ContextModel, ContextModel]) -> Config:
        """Return a copy with another model of where the phone is, fitted with `head="carrying_mode"`.

        Of two models, the second is for windows without gyroscope. Without it such windows say nothing of the carrying
        mode, unless the model needs no gyroscope. ValueError for a recipe without trained models of contexts.
        """
        return replace(self, sensing=replace(self.sensing, contexts=with_carrying_models(model, self.sensing.contexts)))

    def with_modes(self, modes: Sequence[Mode], transition_prob: ArrayLike | None = None) -> Config:
        """Return a copy with other modes for the same contexts.

        `transition_prob` (M, M) is between the modes from one step to the next. If not given, it stays as it is if the
        modes are of the same contexts in the same order. Otherwise it is that of `recipes.context_transitions`.
        """
        if transition_prob is not None:
            prob = np.asarray(transition_prob)
        elif [m.context for m in modes] == [m.context for m in self.model.modes]:
            prob = self.model.transition_prob
        else:
            prob = _transitions(self.contexts, modes, None)
        known = self._with_modes(modes, transition_prob=prob)
        return replace(self, tracker=replace(self.tracker, model=known), notes=self._notes_with(modes))

    def with_steps(self, steps: StepDetector[Any]) -> Config:
        """Return a copy with another step detector; ValueError names what it lacks (`pdr_filter.protocols`).

        A UserWarning says if `OnlineFilter.save` cannot save its state.

        Examples
        --------
        >>> import pdr_filter as pdr
        >>> detector = pdr.recipes.zhou2019().sensing.steps
        >>> pdr.recipes.default().with_steps(detector).sensing.steps is detector
        True
        """
        check_members("steps", steps, StepDetector)
        _warn_of_state(steps)
        return replace(self, sensing=replace(self.sensing, steps=steps))

    def with_heading(self, heading: HeadingStage) -> Config:
        """Return a copy with another heading stage; ValueError names what it lacks (`pdr_filter.protocols`).

        A UserWarning says if `OnlineFilter.save` cannot save its state.
        """
        check_members("heading", heading, HeadingStage)
        _warn_of_state(heading)
        return replace(self, sensing=replace(self.sensing, heading=heading))

    def with_step_length(self, name: str, fit: StepLengthFit) -> Config:
        """Return a copy in which the named mode has this step length; ValueError if there is no such mode.

        If `name` is a context and not a mode, all modes of that context get the step length.
        """
        named = [m.name for m in self.model.modes if m.name == name] or [
            m.name for m in self.model.modes if m.context == name
        ]
        if not named:
            raise ValueError(f"no mode {name!r}, there are {', '.join(m.name for m in self.model.modes)}: name one")
        return self.with_modes([replace(m, step_length=fit) if m.name in named else m for m in self.model.modes])

    @property
    def contexts(self) -> tuple[str, ...]:
        """Names of the contexts, C, in the order of all context probabilities."""
        return self.model.contexts

    def _with_modes(self, modes: Sequence[Mode], **changes: Any) -> PedestrianModel:
        """Return the model with other modes; ValueError where these would forget a person."""
        if self.person is not None:
            raise ValueError(
                "the configuration has the step length of a person, which other modes would not have: give modes and "
                "step lengths first, then the person"
            )
        return replace(self.model, modes=tuple(modes), **changes)

    def _notes_with(self, modes: Sequence[Mode]) -> tuple[Note, ...]:
        """Notes without that on the height if no step length depends on it."""
        if any(m.moves and hasattr(m.step_length.model, "height_m") for m in modes):
            return self.notes
        return tuple(note for note in self.notes if note.about != "height")

    def with_weighting(self, weighting: str | Weighting) -> Config:
        """Return a copy with another weighting: "imm", "wc", "hc", or a function.

        The function gets the context probabilities (C,) of a window and returns the weights (C,) of the step lengths
        of the contexts, which are 0 or more and sum to one. ValueError if it returns anything else, or for another
        name.

        Examples
        --------
        >>> import pdr_filter as pdr
        >>> def squared(context_prob):
        ...     return context_prob**2 / (context_prob**2).sum()
        >>> pdr.recipes.default().with_weighting(squared).tracker.weighting
        'squared'
        """
        if not isinstance(weighting, str) and callable(weighting):
            return replace(self, tracker=WeightedTracker(self.model, function=weighting))
        if weighting not in WEIGHTINGS:
            raise ValueError(f"weighting must be one of {WEIGHTINGS}, got {weighting!r}: name one, or give a function")
        if weighting == self.tracker.weighting and getattr(self.tracker, "function", None) is None:
            return self
        if weighting == "imm":
            return replace(self, tracker=ImmTracker(self.model))
        return replace(
            self, tracker=WeightedTracker(self.model, HC) if weighting == "hc" else WeightedTracker(self.model)
        )

    @cached_property
    def fix_delay_s(self) -> float:
        """How long a fix waits for the step that it falls into to be final."""
        waits_s = self.tracker.waits_for_windows * self.sensing.window_hop_s
        return self.sensing.step_latency_s + self.sensing.steps.first_step_s + waits_s


def _transitions(
    contexts: tuple[str, ...], modes: Sequence[Mode], context_transition_prob: FloatArray | None
) -> FloatArray:
    """Transition matrix (M, M) between modes, from that between their contexts (C, C) if that is known.

    Where some contexts have no mode, or several, only the default matrix can be used.
    """
    of_mode = [contexts.index(m.context) for m in modes if m.context in contexts]
    if context_transition_prob is None or sorted(of_mode) != list(range(len(contexts))):
        return context_transitions([mode.meaning for mode in modes])
    return context_transition_prob[np.ix_(of_mode, of_mode)]


def _warn_of_state(part: Any) -> None:
    """Warn if the first state of a part cannot be saved, which a filter would else refuse only in the end."""
    try:
        to_bytes(part.init(), foreign=True)
    except TypeError as error:
        warnings.warn(f"OnlineFilter.save will refuse the state of {type(part).__name__}: {error}", stacklevel=3)


def check_config(config: object) -> None:
    """ValueError unless it is a configuration."""
    if not isinstance(config, Config):
        raise ValueError(
            f"config must be a Config, got {config!r}: call a recipe, such as pdr_filter.recipes.default()"
        )
