"""Configuration of a filter, with methods that return changed copies."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.classifiers.context_model import ContextModel
from pdr_filter.filter.chain.handler import Handler, TrackerHandler
from pdr_filter.filter.chain.imm_tracker import ImmTracker
from pdr_filter.filter.chain.tracker import Tracker
from pdr_filter.filter.chain.two_hypotheses import TwoHypotheses
from pdr_filter.filter.chain.weighted_tracker import WeightedTracker
from pdr_filter.filter.chain.with_height import WithHeight
from pdr_filter.filter.chain.with_path import WithPath
from pdr_filter.filter.chain.with_plan import PlanStage, WithPlan
from pdr_filter.filter.imm.motion_model import Mode
from pdr_filter.filter.imm.transition_probabilities import context_transitions
from pdr_filter.filter.imm.weighting import HC, WC, WEIGHTINGS, Weighting
from pdr_filter.filter.pedestrian.frame import UNKNOWN_FRAME
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.person import Person
from pdr_filter.filter.step_length.models import StepLengthFit
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
from pdr_filter.values.checks import shown
from pdr_filter.values.georeference import Georeference
from pdr_filter.values.serialisation import to_bytes

# Standard deviation of the mean horizontal and upward field in a building around the World Magnetic Model, uT. Over 63
# walks with turns in ms_indoor, ipin2023, ipin21 and tyrex, the differences are -3 +- 4 and 10 +- 8 uT.
_BUILDING_STD_UT = 5.0, 10.0


@dataclass(frozen=True, eq=False, repr=False)
class Config:
    """Configuration of a filter: all stages and parameters, which do not change during a walk.

    A recipe (`pdr_filter.recipes`) is a function that returns a configuration. The methods `with_...` return changed
    copies.

    Attributes
    ----------
    name : str
        Name of the recipe.
    sensing : Sensing
        Stages before the filter: conditioning, attitude, step detection, contexts and walking heading.
    tracker : Tracker
        Filter over the steps, with its pedestrian model: an `ImmTracker` or a `WeightedTracker`.
    climb_rate : ClimbRate
        Estimation of the vertical speed from the barometer.
    needs : tuple of str
        Sensor streams of `Recording`, besides the accelerometer, without which tracks are meaningless. Steps and
        contexts may need fewer streams.
    notes : tuple of Note
        Warnings that apply to every track of this configuration.
    on_foot : bool, default False
        Whether the configuration is for a sensor on the foot instead of a carried phone.
    person : Person, optional
        Person whose step lengths the modes have; see `with_person`.
    on_plan : PlanStage, optional
        Stage that constrains the track to a floor plan; see `with_plan`.
    merger : StreamMerger
        Merges sensor streams that arrive separately.
    keeps_path : bool, default True
        Whether the filter keeps past steps for `OnlineFilter.path`. Whole recordings do not.
    handlers : tuple of callable
        Additional handlers; see `with_handler`.
    wc_threshold : float, default 0.8
        Threshold with which `with_weighting("wc")` weights contexts (`WeightedTracker.threshold`). It is that of the
        tracker, if the tracker has the weighting "wc".

    Raises
    ------
    ValueError
        If the heading stage and the tracker have different models of the heading drift.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> config = pdr.recipes.default().with_weighting("hc")
    >>> config.name, config.needs
    ('default', ())
    """

    name: str
    sensing: Sensing
    tracker: Tracker[Any]  # the state class is Any, because a recipe chooses the tracker at run time
    climb_rate: ClimbRate = field(default_factory=ClimbRate)
    needs: tuple[str, ...] = ()
    notes: tuple[Note, ...] = ()
    on_foot: bool = False
    person: Person | None = None
    on_plan: PlanStage | None = None
    merger: StreamMerger = field(default_factory=StreamMerger)
    keeps_path: bool = True
    handlers: tuple[Callable[[Handler[Any]], Handler[Any]], ...] = ()
    wc_threshold: float = WC

    def __post_init__(self) -> None:
        of_heading, drift = drift_of(self.sensing.heading), self.model.noise.heading_drift
        if of_heading is not None and of_heading != drift:
            raise ValueError(
                f"the heading stage must have the heading drift of the filter, {drift}, got {of_heading}: pass the "
                "same HeadingDrift to both"
            )
        if self.tracker.weighting == "wc" and isinstance(self.tracker, WeightedTracker):
            object.__setattr__(self, "wc_threshold", self.tracker.threshold)
        if self.sensing.context_set != self.model.context_set:
            object.__setattr__(self, "sensing", replace(self.sensing, context_set=self.model.context_set))

    @property
    def model(self) -> PedestrianModel:
        """Pedestrian model of the tracker: modes, transition probabilities, noise and evidence parameters."""
        return self.tracker.model

    @cached_property
    def chain(self) -> Handler[Any]:
        """Chain of handlers that turn steps, windows and fixes into rows, from the tracker outwards."""
        handler: Handler[Any] = TrackerHandler(self.tracker)
        if self.keeps_path:
            handler = WithPath(handler)
        start = None if self.on_plan is None else self.on_plan.start
        handler = TwoHypotheses(handler, self.model.fix_gate_nis)
        handler = WithHeight(handler, self.model, None if start is None else start.floor)
        if self.on_plan is not None:
            handler = WithPlan(handler, self.on_plan, self.model)
        for add in self.handlers:
            handler = add(handler)
        return handler

    def __repr__(self) -> str:
        modes = ", ".join(mode.name for mode in self.model.modes)
        return f"Config({self.name!r}, {self.tracker.weighting} of {modes})"

    def with_handler(self, add: Callable[[Handler[Any]], Handler[Any]]) -> Config:
        """Return a copy with one more handler around the filter.

        Parameters
        ----------
        add : callable
            Function or class that takes the present chain and returns a handler around it
            (`pdr_filter.filter.chain.handler.Handler`).

        Returns
        -------
        Config
            Changed copy. This configuration is not modified.

        Raises
        ------
        ValueError
            If `add` is not callable.
        """
        if not callable(add):
            raise ValueError(
                f"add must be a function or class that takes a handler, got {add!r}: give the class itself"
            )
        return replace(self, handlers=(*self.handlers, add))

    @property
    def learns_directions(self) -> bool:
        """Whether the heading stage estimates the walking direction relative to the phone."""
        return learns_directions(self.sensing.heading)

    def with_model(self, **changes: Any) -> Config:
        """Return a copy in which some fields of the pedestrian model are changed.

        Parameters
        ----------
        **changes
            New values by field names of `PedestrianModel`, such as `evidence_exponent=0.5`.

        Returns
        -------
        Config
            Changed copy. This configuration is not modified.

        Raises
        ------
        ValueError
            If a value is not valid for the field.

        Examples
        --------
        >>> import pdr_filter as pdr
        >>> pdr.recipes.default().with_model(evidence_exponent=0.5).model.evidence_exponent
        0.5
        """
        return replace(self, tracker=replace(self.tracker, model=replace(self.model, **changes)))

    def with_device(self, device: Device) -> Config:
        """Return a copy for a phone with known gyroscope bias.

        Parameters
        ----------
        device : Device
            Gyroscope bias of the phone with its covariance, from an earlier recording.

        Returns
        -------
        Config
            Changed copy. This configuration is not modified.
        """
        attitude = self.sensing.attitude
        known = replace(attitude, bias=replace(attitude.bias, device=device))
        return replace(self, sensing=replace(self.sensing, attitude=known))

    def with_person(self, person: Person) -> Config:
        """Return a copy with the step lengths of a person.

        The step lengths of the modes are scaled to the person, and the uncertainty of the step scale is set to the
        uncertainty of the person. A note states the step length.

        Parameters
        ----------
        person : Person
            Step length of the person, estimated from the fixes of earlier walks.

        Returns
        -------
        Config
            Changed copy. This configuration is not modified.

        Raises
        ------
        ValueError
            If the configuration already has a person.
        """
        if self.person is not None:
            raise ValueError(
                "the configuration already has a person: combine both with Person.pooled, and pass the result to a "
                "recipe's configuration"
            )
        known = replace(self, tracker=replace(self.tracker, model=person.in_model(self.model)))
        walks = f"{len(person.sessions)} walk" + "s" * (len(person.sessions) != 1)
        text = f"step lengths of a person with typical steps of {person.step_length_m:.2f} m, of {walks}"
        notes = (*(n for n in self.notes if n.about != "height"), Note("step lengths", text))
        return replace(known, person=person, notes=notes if person.sessions else self.notes)

    def in_world_frame(self) -> Config:
        """Return a copy for fixes in a frame with unknown origin and north, such as a map frame.

        The filter then estimates position and rotation of the track in this frame from the fixes.

        Returns
        -------
        Config
            Changed copy. This configuration is not modified.
        """
        return self.with_model(frame=UNKNOWN_FRAME)

    def with_magnetic_north(
        self,
        declination_rad: float,
        declination_std_rad: float = DECLINATION_STD_RAD,
        field_ut: tuple[float, float] | None = None,
    ) -> Config:
        """Return a copy that estimates true north from the magnetometer.

        The track is then in a frame with true north, and fixes must be in such a frame as well.

        Parameters
        ----------
        declination_rad : float
            Magnetic declination in rad, positive if magnetic north is east of true north; see `Origin.declination_rad`.
        declination_std_rad : float, optional
            Standard deviation of the declination in rad.
        field_ut : (float, float), optional
            Horizontal and upward component of the Earth's magnetic field in uT; see `Origin.magnetic_field_ut`. A field
            of another strength reveals the hard iron of the phone. None if unknown.

        Returns
        -------
        Config
            Changed copy. This configuration is not modified.

        Raises
        ------
        ValueError
            If the recipe does not estimate the walking direction relative to the phone.
        """
        if not self.learns_directions:
            raise ValueError(
                f"recipe {self.name!r} does not estimate the walking direction relative to the phone, so that the "
                'magnetometer gives no heading of the track: use recipe "default"'
            )
        rate_hz = self.sensing.conditioner.rate_hz
        north = MagneticNorth(rate_hz, declination_rad, declination_std_rad)
        if field_ut is not None:
            north = replace(north, field_ut=field_ut, field_std_ut=_BUILDING_STD_UT)
        return replace(self, sensing=replace(self.sensing, north=north)).in_world_frame()

    def with_plan(self, plan: Plan, start: PositionFix | str | None = None, seed: int = 0) -> Config:
        """Return a copy that constrains tracks to a floor plan with a particle filter.

        Tracks are then in the frame of the plan.

        Parameters
        ----------
        plan : Plan
            Floor plan, such as a `FloorPlan`.
        start : PositionFix or str, optional
            Start of the walk: a position, the name of an area of the plan, or "anywhere". By default the start follows
            from the fixes, or is the zero of the plan frame if there are none.
        seed : int, default 0
            Seed of the random numbers. The same seed gives bit-identical results.

        Returns
        -------
        Config
            Changed copy. This configuration is not modified.

        Raises
        ------
        ValueError
            If `plan` is not a `FloorPlan`, if it does not have the start, or if no cell of a start area is walkable.
        """
        if not isinstance(plan, Plan):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise ValueError(
                f"plan must be a FloorPlan, got {plan!r}: read one from a file with pdr_filter.FloorPlan.read(path)"
            )
        framed = self if start is None else self.in_world_frame()
        return replace(framed, on_plan=plan.stage(start, seed))

    def with_georeference(self, georeference: Georeference) -> Config:
        """Return a copy with the floor plan and the start of a georeference, or this configuration if it has no plan.

        Parameters
        ----------
        georeference : Georeference
            Position, north and floor plan of a track.

        Returns
        -------
        Config
            Changed copy, or this configuration.
        """
        return self if georeference.plan is None else self.with_plan(georeference.plan, georeference.start)

    def in_hindsight(self) -> Config:
        """Return a copy for offline smoothing, with another weight of the context windows.

        Overlapping windows share samples. Offline, the evidence of a window is tempered by `model.hindsight_exponent`,
        so that no second of samples counts twice.

        Returns
        -------
        Config
            Changed copy. This configuration is not modified.
        """
        return self.with_model(evidence_exponent=self.model.hindsight_exponent)

    def with_contexts(
        self,
        model: ContextModel | tuple[ContextModel, ContextModel] | ContextStage,
        modes: Sequence[Mode] | None = None,
        transition_prob: ArrayLike | None = None,
    ) -> Config:
        """Return a copy with other contexts.

        Parameters
        ----------
        model : ContextModel, (ContextModel, ContextModel) or ContextStage
            Classifier of the contexts, whose names are `model.contexts`. The second of two models classifies windows
            without gyroscope. With a single model, such windows have no context, unless the model was trained on them,
            or the present model for such windows has all features of the new model.
        modes : sequence of Mode, optional
            Motion models that define the contexts. By default, contexts keep the present modes of the same name, and
            another context has the mode `Mode(name)`, which walks with the step length of the population. The
            weightings "hc" and "wc" and functions need exactly one mode for each context. With "imm" a context may have
            several modes, and the first one gives its meaning. The probability of a context without a mode is evidence
            for no mode.
        transition_prob : array_like of shape (M, M), optional
            Probability of changing from each mode (row) to each mode (column) between two steps. Rows sum to one. The
            default is the matrix that the model estimated from its labels, if each context has exactly one mode.
            Otherwise, or for a model without such a matrix, it is `recipes.context_transitions`, which follows from the
            properties of the modes.

        Returns
        -------
        Config
            Changed copy. This configuration is not modified.

        Raises
        ------
        ValueError
            If model, modes and transition probabilities do not match, or if the configuration has a person.

        Warns
        -----
        UserWarning
            If several modes move and all have the same step length, so that the weightings hardly differ.

        Notes
        -----
        The exponents of the evidence are taken from the model if it estimated them, else they are unchanged.

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
        if modes is None:
            known = {context: [m for m in self.model.modes if m.context == context] for context in stage.contexts}
            modes = [mode for context, own in known.items() for mode in own or [Mode(context)]]
        _warn_of_one_length(modes)
        estimated = model[0] if isinstance(model, tuple) else model
        labelled = getattr(estimated, "transition_prob", None)
        prob = _transitions(stage.contexts, modes, labelled) if transition_prob is None else np.asarray(transition_prob)
        exponents = {name: getattr(estimated, name, None) for name in ("evidence_exponent", "prior_exponent")}
        changed = self._with_modes(
            modes,
            contexts=stage.contexts,
            transition_prob=prob,
            **{name: value for name, value in exponents.items() if value is not None},
        )
        return replace(
            self,
            sensing=replace(self.sensing, contexts=stage, context_set=changed.context_set),
            tracker=replace(self.tracker, model=changed),
            notes=self._notes_with(modes),
        )

    def with_carrying_model(self, model: ContextModel | tuple[ContextModel, ContextModel]) -> Config:
        """Return a copy with another classifier of the carrying mode.

        Parameters
        ----------
        model : ContextModel or (ContextModel, ContextModel)
            Model from `fit_contexts(..., head="carrying_mode")`. The second of two models classifies windows without
            gyroscope. With a single model, such windows have no carrying mode, unless it needs no gyroscope.

        Returns
        -------
        Config
            Changed copy. This configuration is not modified.

        Raises
        ------
        ValueError
            If the recipe has no trained context models.
        """
        return replace(self, sensing=replace(self.sensing, contexts=with_carrying_models(model, self.sensing.contexts)))

    def with_modes(self, modes: Sequence[Mode], transition_prob: ArrayLike | None = None) -> Config:
        """Return a copy with other modes for the same contexts.

        Parameters
        ----------
        modes : sequence of Mode
            New motion models.
        transition_prob : array_like of shape (M, M), optional
            Probability of changing from each mode (row) to each mode (column) between two steps. By default it is
            unchanged if the new modes have the same contexts in the same order, and `recipes.context_transitions`
            otherwise.

        Returns
        -------
        Config
            Changed copy. This configuration is not modified.

        Raises
        ------
        ValueError
            If the modes do not fit the contexts or the matrix, or if the configuration has a person.
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
        """Return a copy with another step detector.

        Parameters
        ----------
        steps : StepDetector
            Step detector with the interface `pdr_filter.protocols.StepDetector`.

        Returns
        -------
        Config
            Changed copy. This configuration is not modified.

        Raises
        ------
        ValueError
            If the detector lacks a member of the interface, which the message names.

        Warns
        -----
        UserWarning
            If `OnlineFilter.save` cannot save the state of the detector.

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

    def with_heading(self, heading: HeadingStage[Any]) -> Config:
        """Return a copy with another heading stage.

        Parameters
        ----------
        heading : HeadingStage
            Heading stage with the interface `pdr_filter.protocols.HeadingStage`.

        Returns
        -------
        Config
            Changed copy. This configuration is not modified.

        Raises
        ------
        ValueError
            If the stage lacks a member of the interface, which the message names.

        Warns
        -----
        UserWarning
            If `OnlineFilter.save` cannot save the state of the stage.
        """
        check_members("heading", heading, HeadingStage)
        _warn_of_state(heading)
        return replace(self, sensing=replace(self.sensing, heading=heading))

    def with_step_length(self, name: str, fit: StepLengthFit) -> Config:
        """Return a copy with another step-length model for one mode or context.

        Parameters
        ----------
        name : str
            Name of a mode, or else of a context, all of whose modes get the step length.
        fit : StepLengthFit
            Step-length model with its parameters.

        Returns
        -------
        Config
            Changed copy. This configuration is not modified.

        Raises
        ------
        ValueError
            If there is no such mode or context, or if the configuration has a person.

        Examples
        --------
        >>> import pdr_filter as pdr
        >>> fit = pdr.known_length(1.1, 0.1)
        >>> config = pdr.recipes.default().with_step_length("running", fit)
        >>> [mode.name for mode in config.model.modes if mode.step_length is fit]
        ['running']
        """
        named = [m.name for m in self.model.modes if m.name == name] or [
            m.name for m in self.model.modes if m.context == name
        ]
        if not named:
            raise ValueError(
                f"no mode or context is named {name!r}: give one of {', '.join(m.name for m in self.model.modes)}"
            )
        return self.with_modes([replace(m, step_length=fit) if m.name in named else m for m in self.model.modes])

    @property
    def contexts(self) -> tuple[str, ...]:
        """Names of the C contexts, in the order of all context probabilities."""
        return self.model.contexts

    def _with_modes(self, modes: Sequence[Mode], **changes: Any) -> PedestrianModel:
        """Return the pedestrian model with other modes.

        ValueError if they would discard the step lengths of a person.
        """
        if self.person is not None:
            raise ValueError(
                "the configuration has the step lengths of a person, which new modes would discard: set modes and step "
                "lengths first, then call with_person"
            )
        return replace(self.model, modes=tuple(modes), **changes)

    def _notes_with(self, modes: Sequence[Mode]) -> tuple[Note, ...]:
        """Return the notes, without the note about the height if no step length depends on the height."""
        if any(m.moves and hasattr(m.step_length.model, "height_m") for m in modes):
            return self.notes
        return tuple(note for note in self.notes if note.about != "height")

    def with_weighting(self, weighting: str | Weighting) -> Config:
        """Return a copy with another weighting of the contexts.

        Parameters
        ----------
        weighting : {"imm", "wc", "hc"} or callable
            "imm" is the interacting multiple model. "wc" weights the step lengths of the contexts by the context
            probabilities. "hc" (highest context) takes the step length of the most probable context, averaged over the
            windows at and after the step. A function receives the context probabilities (C,) of a window and returns
            non-negative weights (C,) with sum one.

        Returns
        -------
        Config
            Changed copy. This configuration is not modified.

        Raises
        ------
        ValueError
            If `weighting` is an unknown name. A function with invalid results raises when it is called.

        Examples
        --------
        >>> import pdr_filter as pdr
        >>> def squared(context_prob):
        ...     return context_prob**2 / (context_prob**2).sum()
        >>> pdr.recipes.default().with_weighting(squared).tracker.weighting
        'squared'
        """
        weighted = self.tracker if isinstance(self.tracker, WeightedTracker) else WeightedTracker(self.model)
        if not isinstance(weighting, str) and callable(weighting):
            return replace(self, tracker=replace(weighted, function=weighting))
        if weighting not in WEIGHTINGS:
            raise ValueError(f"weighting must be one of {WEIGHTINGS} or a function, got {weighting!r}")
        if weighting == self.tracker.weighting and getattr(self.tracker, "function", None) is None:
            return self
        if weighting == "imm":
            return replace(self, tracker=ImmTracker(self.model))
        threshold = HC if weighting == "hc" else self.wc_threshold
        return replace(self, tracker=replace(weighted, threshold=threshold, function=None))

    @cached_property
    def fix_delay_s(self) -> float:
        """Time in s after which the step during which a fix was measured is final, unless a bout has just begun."""
        waits_s = self.tracker.waits_for_windows * self.sensing.window_hop_s
        return self.sensing.step_latency_s + self.sensing.steps.first_step_s + waits_s


def _transitions(
    contexts: tuple[str, ...], modes: Sequence[Mode], context_transition_prob: FloatArray | None
) -> FloatArray:
    """Return the transition matrix (M, M) between modes, from the matrix (C, C) between their contexts if given.

    The default matrix is used if a context has no mode or several modes.
    """
    of_mode = [contexts.index(m.context) for m in modes if m.context in contexts]
    if context_transition_prob is None or sorted(of_mode) != list(range(len(contexts))):
        return context_transitions([mode.meaning for mode in modes])
    return context_transition_prob[np.ix_(of_mode, of_mode)]


def _warn_of_state(part: Any) -> None:
    """Warn if the first state of a part cannot be saved, because `OnlineFilter.save` would fail only after a walk."""
    try:
        to_bytes(part.init(), part.init())
    except TypeError as error:
        warnings.warn(f"OnlineFilter.save will refuse the state of {type(part).__name__}: {error}", stacklevel=3)


def _warn_of_one_length(modes: Sequence[Mode]) -> None:
    """Warn if several modes move and all have one step length: contexts then have no effect on the distance."""
    fits = [mode.step_length for mode in modes if mode.moves]
    first, *others = fits or [None]
    if others and all(fit is first for fit in others):
        warnings.warn(
            f"the {len(fits)} modes that move have the same step length, so that contexts have no effect on the "
            "distance, and the weightings hardly differ: give a mode its own step_length, such as "
            "pdr.Mode('upstairs', step_length=pdr.known_length(0.29, 0.05), climbs=1)",
            stacklevel=3,
        )


def check_config(config: object) -> None:
    """Raise ValueError unless the argument is a configuration."""
    if not isinstance(config, Config):
        raise ValueError(
            f"config must be a Config, got {shown(config)}: call a recipe, such as pdr_filter.recipes.default(), and "
            "give arguments such as fixes, weighting or priors by their names"
        )
