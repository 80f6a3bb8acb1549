"""Front end: all stages before the filter as one causal stage, from samples to steps and contexts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock, AttitudeEstimator, AttitudeState
from pdr_filter.sensing.conditioning import Conditioner, ConditionerState, UniformBlock
from pdr_filter.sensing.contexts.context_stage import ContextStage, with_cadence
from pdr_filter.sensing.device import Device
from pdr_filter.sensing.features.feature_windows import FeatureWindow, FeatureWindows
from pdr_filter.sensing.heading.heading_stage import HeadingStage, ShownOffsets, drift_in_time
from pdr_filter.sensing.heading.magnetic_north import MagneticNorth
from pdr_filter.sensing.heading.walking_heading import WalkingHeading
from pdr_filter.sensing.steps.contact_time_smoothing import ContactTimeSmoothing
from pdr_filter.sensing.steps.detector_protocol import StepDetector
from pdr_filter.sensing.steps.step_detector import BaseStepDetector, ContextBlock
from pdr_filter.sensing.steps.step_gate import StepGate
from pdr_filter.sensing.steps.step_log import NumberedSteps
from pdr_filter.sensing.steps.step_stage import StepStage
from pdr_filter.sensing.vehicle_vibration import VehicleVibration, VehicleVibrationState
from pdr_filter.values import (
    DEFAULT_CONTEXTS,
    ContextSet,
    FloatArray,
    ImuBlock,
    IntArray,
    Step,
    WindowContext,
    replace_unchecked,
)
from pdr_filter.values.events import Gap, Stepless, Undecided

Event = Step | WindowContext | Stepless | Undecided | Gap
# Events, each with the time in s at which it became known.
KnownEvents = list[tuple[float, Event]]

# The step frequency of a window is the median over this number of last steps, if the first of them is recent. The limit
# in s allows for the slowest steps (three take 4 s) and the latency of the detector (0.9 s).
_CADENCE_STEPS, _CADENCE_S = 3, 5.0


@dataclass(frozen=True, eq=False)
class SensingState:
    """States of all stages."""

    conditioner: ConditionerState  # state of the conditioner
    attitude: AttitudeState  # state of the attitude estimator
    # States of the context stage, None without one, and of the step detector
    contexts: object
    steps: object
    of_steps: Mapping[str, object]  # states of the stages that receive the steps, by the name of the stage in `Sensing`
    vibration: VehicleVibrationState  # state of the detection of motion without steps
    # Times (s) and step frequencies (Hz) of the last three steps of this segment
    cadence: tuple[tuple[float, float], ...]
    n_samples: int  # uniform samples of this segment
    # Index of the context of the last window into `Sensing.context_set`. -1 if no context has at least half of the
    # probability.
    context: int
    # Index of the carrying mode of the last window into `CARRYING_MODES`. -1 if no mode has at least half of the
    # probability.
    carrying_mode: int
    processed_s: float  # time of the last processed uniform sample, s

    @property
    def gate(self) -> object:
        """State of the gate, or None without one."""
        return self.of_steps.get("gate")

    @property
    def heading(self) -> object:
        """State of the heading stage, or None without one."""
        return self.of_steps.get("heading")


# Margin of the earliest contact, s. A contact lies between samples, so that it can be slightly earlier than `latency_s`
# states.
_CONTACT_MARGIN_S = 0.1
_KNOWN_GATES = (type(None), StepGate)


class Detected(NamedTuple):
    """Results of the stages before the walking direction, for one uniform block."""

    state: SensingState  # state after the block, with the states of these stages and that of the gate
    part: UniformBlock
    attitude: AttitudeBlock
    contexts: ContextBlock
    windows: list[tuple[int, WindowContext]]
    steps: list[tuple[int, Step]]


@dataclass(frozen=True, eq=False)
class Sensing:
    """Front end of the filter: conditioning, attitude, step detection, contexts and headings as one causal stage.

    All stages run at `conditioner.rate_hz`. Events come in the order in which they became known. At a gap and at the
    end, the steps that still wait for samples are completed first.

    Parameters
    ----------
    steps : StepDetector
        Step detector. It receives the context and the carrying mode of each sample from `contexts`.
    conditioner : Conditioner, optional
        Resampling to a constant rate.
    attitude : AttitudeEstimator, optional
        Estimation of the direction of up, the device heading and the gyroscope bias.
    contexts : ContextStage, optional
        Classification of context and carrying mode. Without it both are unknown.
    heading : HeadingStage, optional
        Estimation of the walking direction. Without it, the walking direction is the device heading.
    gate : StepGate, optional
        Rejection of false steps.
    contact_smoothing : ContactTimeSmoothing, optional
        Smoothing of contact times between left and right. It runs last, so that the statistics of a step are those of
        the samples that the detector assigned to it.
    north : MagneticNorth, optional
        Estimation of the direction of magnetic north.
    context_set : ContextSet, default the six contexts of `pdr_filter.CONTEXTS`
        Names of the contexts, which must be those of `contexts`, and their meanings. `Config` sets the meanings stated
        by the modes of the filter. A stage `contexts` with a field of this name receives it as well.

    Raises
    ------
    ValueError
        If the context stage has other contexts than `context_set`, or the rates of the stages differ.

    Examples
    --------
    The default front end detects the steps of a simulated walk:

    >>> import pdr_filter as pdr
    >>> recording = pdr.simulate.simulate([pdr.simulate.Leg("walking", duration_s=10.0)])
    >>> sensing = pdr.recipes.default().sensing
    >>> state, events = sensing.update(sensing.init(), pdr.merge_streams(recording))
    >>> state, last_events = sensing.finish(state)
    >>> n_steps = sum(isinstance(event, pdr.Step) for _, event in [*events, *last_events])
    >>> abs(n_steps - len(recording.truth.steps)) <= 1
    True
    """

    steps: StepDetector[Any]
    conditioner: Conditioner = field(default_factory=Conditioner)
    attitude: AttitudeEstimator = field(default_factory=AttitudeEstimator)
    contexts: ContextStage | None = None
    heading: HeadingStage[Any] | None = None
    gate: StepGate | None = None
    contact_smoothing: ContactTimeSmoothing | None = None
    north: MagneticNorth | None = None
    context_set: ContextSet = DEFAULT_CONTEXTS

    def __post_init__(self) -> None:
        if self.contexts is not None:
            stage: Any = self.contexts
            if tuple(stage.contexts) != self.context_set.names:
                raise ValueError(
                    f"the context stage has the contexts {stage.contexts}, but context_set has "
                    f"{self.context_set.names}: use config.with_contexts, which sets both to the same contexts"
                )
            if getattr(stage, "context_set", self.context_set) != self.context_set:
                object.__setattr__(self, "contexts", replace(stage, context_set=self.context_set))
        stages = self.conditioner, self.attitude, self.steps, self.contexts, self.north
        rates = {stage.rate_hz for stage in stages if stage is not None}
        if len(rates) > 1:
            raise ValueError(
                f"all stages must have one rate_hz, got {sorted(rates)}: build every stage with the rate_hz of the "
                "conditioner"
            )

    @cached_property
    def _vibration(self) -> VehicleVibration:
        """Detection of motion without steps at the rate of the front end."""
        return VehicleVibration(self.conditioner.rate_hz)

    @cached_property
    def _step_stages(self) -> dict[str, StepStage[Any]]:
        """Stages that receive the steps of the detector one after the other, by name."""
        sets_offsets = self.heading is None or hasattr(self.heading, "learns_directions")
        stages: dict[str, StepStage[Any] | None] = {
            "gate": self.gate,
            "heading": self.heading,
            "shown_offsets": None if sets_offsets else ShownOffsets(),
            "north": self.north,
            "contact_smoothing": self.contact_smoothing,
        }
        return {name: stage for name, stage in stages.items() if stage is not None}

    @property
    def steps_only(self) -> Sensing:
        """Front end that finds the same steps without headings, north, and contexts that the detector does not use."""
        contexts = self.contexts if getattr(self.steps, "uses_contexts", True) else None
        return replace(self, contexts=contexts, heading=None, north=None)

    @property
    def step_latency_s(self) -> float:
        """Longest time from a contact to its step, s, except for the first steps of a bout, which wait for the gate."""
        return max(self.steps.latency_s, self.gate.latency_s if self.gate else 0.0)

    @property
    def window_hop_s(self) -> float:
        """Time between the ends of consecutive windows, s; 0 without a context stage."""
        return self.contexts.hop_s if self.contexts else 0.0

    def init(self) -> SensingState:
        """Return the state before the first sample.

        Returns
        -------
        SensingState
            Initial state of all stages.
        """
        return SensingState(
            conditioner=self.conditioner.init(),
            attitude=self.attitude.init(),
            contexts=self.contexts.init() if self.contexts else None,
            steps=self.steps.init(),
            of_steps={name: stage.init() for name, stage in self._step_stages.items()},
            vibration=self._vibration.init(),
            cadence=(),
            n_samples=0,
            context=-1,
            carrying_mode=-1,
            processed_s=float("-inf"),
        )

    def update(self, state: SensingState, block: ImuBlock) -> tuple[SensingState, KnownEvents]:
        """Return the new state and the events that a block of samples reveals.

        Parameters
        ----------
        state : SensingState
            State after the previous block.
        block : ImuBlock
            Raw samples of any number, such as the result of `pdr_filter.merge_streams`.

        Returns
        -------
        state : SensingState
            New state.
        events : list of (float, Event)
            Events with the time in s at which each became known, in this order.
        """
        conditioner, uniform = self._condition(state, block)
        return self._process_blocks(replace_unchecked(state, conditioner=conditioner), uniform)

    def _condition(self, state: SensingState, block: ImuBlock) -> tuple[ConditionerState, list[UniformBlock]]:
        return self.conditioner.update(state.conditioner, block)

    def finish(self, state: SensingState) -> tuple[SensingState, KnownEvents]:
        """Return the new state and the remaining events when the recording has ended.

        Parameters
        ----------
        state : SensingState
            State after the last block.

        Returns
        -------
        state : SensingState
            New state.
        events : list of (float, Event)
            Events that were still waiting for samples, with the time in s at which each became known.
        """
        conditioner, uniform = self.conditioner.finish(state.conditioner)
        state, events = self._process_blocks(replace_unchecked(state, conditioner=conditioner), uniform)
        return state, [*events, *self._close_segment(state)[1]]

    def _process_blocks(self, state: SensingState, uniform: Sequence[UniformBlock]) -> tuple[SensingState, KnownEvents]:
        """Return the new state and the events of uniform blocks, restarting the stages at gaps."""
        events: KnownEvents = []
        for part in uniform:
            if part.gap_before_s > 0 and state.n_samples > 0:
                state, last = self._close_segment(state)
                events += [*last, (state.processed_s, Gap(part.gap_before_s))]
                state = self._after_gap(state)
            state, found = self._process_block(state, part)
            events += found
        return state, events

    def stepless_s(self, state: SensingState, since_s: float, until_s: float) -> float:
        """Return the time for which the phone has moved although no step explains it.

        Parameters
        ----------
        state : SensingState
            State after any number of samples.
        since_s, until_s : float
            Times of the last known contact (or -inf) and of the newest sample, s.

        Returns
        -------
        float
            Unexplained time of motion between the two times, s (`VehicleVibration.stepless_s`).
        """
        return self._vibration.stepless_s(state.vibration, since_s, until_s)

    def device(self, state: SensingState) -> Device:
        """Return the gyroscope bias of the phone as estimated so far, for its next recording.

        Parameters
        ----------
        state : SensingState
            State after any number of samples.

        Returns
        -------
        Device
            Bias and covariance.
        """
        error_rad, error_var = drift_in_time(self.heading, state.heading)
        return self.attitude.bias.learnt_device(self.attitude.bias_state(state.attitude), error_rad, error_var)

    def trimmed(self, state: SensingState) -> SensingState:
        """Return the state without buffered samples that no later step needs, for saving.

        Stages buffer samples for the slowest step detector. Here the latency of the detector and the steps that wait at
        the gate are known.

        Parameters
        ----------
        state : SensingState
            State after any number of samples.

        Returns
        -------
        SensingState
            State from which the filter continues with the same bits.
        """
        # The samples that a stage of a user needs, subclasses included, are not known.
        if state.n_samples == 0 or not isinstance(self.steps, BaseStepDetector) or type(self.gate) not in _KNOWN_GATES:
            return state
        contact_s, undecided_s = state.processed_s - self.steps.latency_s - _CONTACT_MARGIN_S, ()
        of_steps: dict[str, Any] = dict(state.of_steps)
        if self.gate is not None:
            of_steps["gate"], undecided_s = self.gate.trimmed(of_steps["gate"], contact_s)
        if type(self.heading) is WalkingHeading:
            of_steps["heading"] = self.heading.trimmed(of_steps["heading"], undecided_s, contact_s)
        return replace_unchecked(state, of_steps=of_steps)

    def _process_block(self, state: SensingState, part: UniformBlock) -> tuple[SensingState, KnownEvents]:
        """Return the new state and the events of one uniform block without a gap."""
        return self._after_steps(state, self._detect_steps(state, part))

    def _detect_steps(self, state: SensingState, part: UniformBlock) -> Detected:
        """Return the results of the stages before the walking direction, for one uniform block without a gap."""
        attitude_state, attitude = self.attitude.update(state.attitude, part)
        n_before, n = state.n_samples, len(part.time_s)
        context_state, windows = None, list[tuple[int, WindowContext]]()
        if self.contexts:
            context_state, windows = self.contexts.update(state.contexts, part, attitude)
        context = _held_values(state.context, [(i - n_before, _likely(w.prob)) for i, w in windows], n)
        carrying_mode = _held_values(
            state.carrying_mode, [(i - n_before, _likely(w.carrying_prob)) for i, w in windows], n
        )
        contexts = ContextBlock.of(context, carrying_mode, self.context_set)
        step_state, steps = self.steps.update(state.steps, part, attitude, contexts)
        of_gate, gate = dict[str, object](), self._step_stages.get("gate")
        if gate is not None:
            of_gate["gate"], steps = gate.update(state.of_steps["gate"], part, attitude, contexts, steps)
        after = replace_unchecked(
            state,
            attitude=attitude_state,
            contexts=context_state,
            steps=step_state,
            of_steps=of_gate,
            n_samples=n_before + n,
            context=int(context[-1]),
            carrying_mode=int(carrying_mode[-1]),
            processed_s=float(part.time_s[-1]),
        )
        return Detected(after, part, attitude, contexts, windows, steps)

    def _after_steps(self, before: SensingState, detected: Detected) -> tuple[SensingState, KnownEvents]:
        """Return the new state and the events of a uniform block whose steps have passed the gate."""
        state, part, attitude, contexts, windows, steps = detected
        of_steps = {**state.of_steps}
        for name, stage in [item for item in self._step_stages.items() if item[0] != "gate"]:
            of_steps[name], steps = stage.update(before.of_steps[name], part, attitude, contexts, steps)
        vibration, moved = self._vibration.update(before.vibration, part, steps)
        # A window comes before a step revealed by the same sample, because its evidence also applies to that step.
        events = sorted([*windows, *moved], key=lambda e: e[0])
        in_order, cadence = _with_cadences(before.cadence, events, self.context_set)
        state = replace_unchecked(
            state, conditioner=before.conditioner, of_steps=of_steps, vibration=vibration, cadence=cadence
        )
        return state, [(float(part.time_s[i - before.n_samples]), event) for i, event in in_order]

    def _close_segment(self, state: SensingState) -> tuple[SensingState, KnownEvents]:
        """Return the state at a gap or at the end, and the steps that were still waiting for samples.

        Each step comes with the time of the last processed sample.
        """
        steps = self.steps.finish(state.steps)
        of_steps = dict[str, object]()
        for name, stage in self._step_stages.items():
            of_steps[name], steps = stage.finish(state.of_steps[name], steps)
        vibration, steps = self._vibration.finish(state.vibration, steps)
        state = replace_unchecked(state, of_steps=of_steps, vibration=vibration)
        return state, [(state.processed_s, step) for _, step in steps]

    def _after_gap(self, state: SensingState) -> SensingState:
        """Return the state before the first sample after a gap.

        The step detector and the estimation of north start again. Attitude, contexts and heading keep what remains
        valid after a gap. The conditioner, the gate and the smoothing of contact times continue.
        """
        return replace_unchecked(
            state,
            attitude=self.attitude.after_gap(state.attitude),
            contexts=self.contexts.after_gap(state.contexts) if self.contexts else None,
            steps=self.steps.init(),
            vibration=self._vibration.after_gap(state.vibration),
            of_steps={name: stage.after_gap(state.of_steps[name]) for name, stage in self._step_stages.items()},
            cadence=(),
            n_samples=0,
        )


# Samples whose results are kept for further passes: eleven hours at 100 Hz, which take 1 GB.
KEPT_SAMPLES = 4_000_000


@dataclass(frozen=True, eq=False)
class HeadingRevision(StepStage[None]):
    """Stage that corrects the headings of steps for another estimate of the gyroscope bias."""

    time_s: FloatArray  # (N,) times in s, rising
    turn_rad: FloatArray  # (N,) changes of the device heading at these times, clockwise, rad
    yaw_bias_std_radps: FloatArray  # (N,) standard deviation of the bias about the vertical at these times, rad/s

    def finish(self, state: None, steps: NumberedSteps) -> tuple[None, NumberedSteps]:
        """Return the steps with corrected headings. Their turn rates hardly depend on the bias, and stay the same."""
        ends_s = np.array([step.time_s for _, step in steps])
        starts_s = ends_s - np.array([step.duration_s for _, step in steps])
        # later samples are sensed with the other bias, from attitudes that are turned already
        before, after = (np.interp(t, self.time_s, self.turn_rad, right=0.0).tolist() for t in (starts_s, ends_s))
        bias_std = np.interp(ends_s, self.time_s, self.yaw_bias_std_radps, right=np.nan).tolist()
        return None, [
            (
                number,
                replace_unchecked(
                    step,
                    device_heading_rad=step.device_heading_rad + 0.5 * (first + last),
                    heading_change_rad=step.heading_change_rad + last - first,
                    yaw_bias_std_radps=step.yaw_bias_std_radps if math.isnan(std) else std,
                ),
            )
            for (number, step), first, last, std in zip(steps, before, after, bias_std, strict=True)
        ]


# Interval in samples at which a `HeadingRevision` has the changes of the heading.
_REVISION_SAMPLES = 25


@dataclass(frozen=True, eq=False)
class SensingForTwoPasses(Sensing):
    """Front end that keeps what does not depend on the walking direction for a second pass over the same samples.

    The second pass may have another stage `heading`, and with `with_bias_of` another estimate of the gyroscope bias.
    `keeping` returns such a front end. All copies that `dataclasses.replace` makes share the results.
    """

    conditioned: dict[int, Any] = field(default_factory=dict[int, Any])  # by the number of samples before
    detected: dict[float, Detected] = field(default_factory=dict[float, Detected])  # by the first time of the block
    revision: HeadingRevision | None = None  # correction of the kept steps

    @classmethod
    def keeping(cls, sensing: Sensing) -> SensingForTwoPasses:
        """Return a front end with the stages of another one, which has not kept anything yet."""
        stages = {f.name: getattr(sensing, f.name) for f in fields(Sensing)}
        if isinstance(sensing.heading, WalkingHeading):
            stages["heading"] = replace(sensing.heading, kept_strides={})
        return cls(**stages)

    def with_bias_of(self, attitude: AttitudeEstimator) -> SensingForTwoPasses:
        """Return a front end for a second pass with the gyroscope bias of another attitude estimator.

        The bias turns the attitudes about the vertical and hardly changes the direction of up, so that the windows,
        contexts and steps stay. The headings of the steps are corrected. Samples whose results are not kept are sensed
        again. The results of the first pass are no longer available.
        """
        state, turn_rad, rows = attitude.init(), np.zeros(1), list[FloatArray]()
        for at_s, found in self.detected.items():
            if found.part.gap_before_s > 0:
                state = attitude.after_gap(state)
            first = found.state.attitude, found.attitude
            state, again = attitude.with_other_bias(state.bias, float(turn_rad[-1]), found.part, first)
            turn_rad = again.device_heading_rad - found.attitude.device_heading_rad
            columns = np.array([found.part.time_s, turn_rad, again.yaw_bias_std_radps])
            rows.append(np.append(columns[:, :-1:_REVISION_SAMPLES], columns[:, -1:], axis=1))
            changed = replace_unchecked(found.state, attitude=state)
            self.detected[at_s] = found._replace(state=changed, attitude=again)
        # contacts are half a sample after the last sample of their step
        rows.append(rows[-1][:, -1:] + np.array([[0.75 / attitude.rate_hz], [0.0], [0.0]]))
        return replace(self, attitude=attitude, revision=HeadingRevision(*np.concatenate(rows, axis=1)))

    def released(self) -> Sensing:
        """Release all results, and return a front end with the same bias that senses again.

        It has known walking directions only if they refer to the headings that it estimates.
        """
        self.conditioned.clear()
        self.detected.clear()
        stages = {f.name: getattr(self, f.name) for f in fields(Sensing)}
        if isinstance(self.heading, WalkingHeading):
            known = self.heading.known_placements if self.revision is None else ()
            stages["heading"] = replace(self.heading, known_placements=known, kept_strides=None)
        return Sensing(**stages)

    @cached_property
    def _step_stages(self) -> dict[str, StepStage[Any]]:
        stages = super()._step_stages
        if self.revision is None:
            return stages
        gate = {name: stage for name, stage in stages.items() if name == "gate"}
        return {**gate, "revision": self.revision, **stages}

    def _condition(self, state: SensingState, block: ImuBlock) -> tuple[ConditionerState, list[UniformBlock]]:
        at = state.conditioner.report.n_received
        found = self.conditioned.get(at)
        if found is None:
            found = super()._condition(state, block)
            if at < KEPT_SAMPLES:
                self.conditioned[at] = found
        return found

    def _detect_steps(self, state: SensingState, part: UniformBlock) -> Detected:
        at_s = float(part.time_s[0])
        found = self.detected.get(at_s)
        if found is None:
            found = super()._detect_steps(state, part)
            if state.conditioner.report.n_received <= KEPT_SAMPLES:
                self.detected[at_s] = found
        return found


def feature_windows(stage: FeatureWindows, blocks: Iterable[ImuBlock]) -> Iterator[FeatureWindow]:
    """Yield the feature windows of blocks of samples of one recording.

    Training learns from these windows. They equal those that `LearnedContexts` classifies.
    """
    conditioner, attitude_estimator = Conditioner(stage.rate_hz), AttitudeEstimator(stage.rate_hz)
    intake, attitude_state, state = conditioner.init(), attitude_estimator.init(), stage.init()
    for block in chain(blocks, [None]):
        intake, uniform = conditioner.finish(intake) if block is None else conditioner.update(intake, block)
        for part in uniform:
            if part.gap_before_s > 0:
                attitude_state, state = attitude_estimator.after_gap(attitude_state), stage.init()
            attitude_state, attitude = attitude_estimator.update(attitude_state, part)
            state, found = stage.update(state, part, attitude)
            yield from (window for _, window in found)


def _with_cadences(
    cadence: tuple[tuple[float, float], ...], events: Sequence[tuple[int, Event]], contexts: ContextSet
) -> tuple[list[tuple[int, Event]], tuple[tuple[float, float], ...]]:
    """Return the events with the step frequency added to the windows, and times and frequencies of the last steps.

    Windows without enough recent steps (`_CADENCE_STEPS`) are unchanged.
    """
    result: list[tuple[int, Event]] = []
    for number, event in events:
        if isinstance(event, Step):
            cadence = (*cadence, (event.time_s, event.frequency_hz))[-_CADENCE_STEPS:]
        elif isinstance(event, WindowContext) and _is_recent(cadence, event.time_s):
            median_hz = sorted(frequency_hz for _, frequency_hz in cadence)[_CADENCE_STEPS // 2]
            event = with_cadence(event, median_hz, contexts)
        result.append((number, event))
    return result, cadence


def _is_recent(cadence: tuple[tuple[float, float], ...], time_s: float) -> bool:
    """Return True if there are enough steps for a step frequency at a time, and the first of them is recent."""
    return len(cadence) == _CADENCE_STEPS and time_s - cadence[0][0] < _CADENCE_S


def _likely(prob: FloatArray) -> int:
    """Return the index of the class with at least half of the probability, or -1 if there is none."""
    best = int(prob.argmax())
    return best if prob[best] >= 0.5 else -1


def _held_values(before: int, changes: list[tuple[int, int]], n: int) -> IntArray:
    """Return values (n,) of a quantity that changes at some samples and stays constant in between.

    `before` is the value before the first change. `changes` are pairs of sample index and new value, in order.
    """
    values = [before, *(value for _, value in changes)]
    return np.repeat(values, np.diff([0, *(i for i, _ in changes), n]))
