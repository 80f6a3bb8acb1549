"""Samples in, steps and feature windows out: everything before the filter, as one causal stage."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from pdr_filter.attitude import AttitudeEstimator, AttitudeState
from pdr_filter.conditioning import Conditioner, ConditionerState, UniformBlock
from pdr_filter.features.windows import FeatureWindow, FeatureWindows, WindowState
from pdr_filter.steps.wavelet import StepDetectorState, WaveletStepDetector
from pdr_filter.types import ImuBlock, Step


@dataclass(frozen=True, slots=True)
class Gap:
    """A time without samples."""

    duration_s: float


Event = Step | FeatureWindow | Gap


@dataclass(frozen=True, slots=True, eq=False)
class SensingState:
    """States of the stages, and the time up to which events are out."""

    conditioner: ConditionerState
    attitude: AttitudeState
    steps: StepDetectorState
    windows: WindowState
    processed_s: float


@dataclass(frozen=True, eq=False)
class Sensing:
    """The front end.

    All stages run at `conditioner.rate_hz`. Events come in the order in which they became known; at a gap, and at the
    end, the steps whose detection would have needed more samples come first.
    """

    conditioner: Conditioner = field(default_factory=Conditioner)
    attitude: AttitudeEstimator = field(default_factory=AttitudeEstimator)
    steps: WaveletStepDetector = field(default_factory=WaveletStepDetector)
    windows: FeatureWindows = field(default_factory=FeatureWindows)

    def __post_init__(self) -> None:
        rates = {self.conditioner.rate_hz, self.attitude.rate_hz, self.steps.rate_hz, self.windows.rate_hz}
        if len(rates) > 1:
            raise ValueError(f"all stages must have one rate_hz, got {sorted(rates)}")

    def init(self) -> SensingState:
        """State before the first sample."""
        return SensingState(
            self.conditioner.init(), self.attitude.init(), self.steps.init(), self.windows.init(), float("-inf")
        )

    def step(self, state: SensingState, block: ImuBlock) -> tuple[SensingState, list[tuple[float, Event]]]:
        """New state, and the events with the time at which each became known."""
        conditioner, uniform = self.conditioner.step(state.conditioner, block)
        state = replace(state, conditioner=conditioner)
        events: list[tuple[float, Event]] = []
        for part in uniform:
            if part.gap_before_s > 0 and state.steps.n_samples > 0:
                events += self._close_segment(state, part.gap_before_s)
                state = replace(
                    state,
                    attitude=self.attitude.after_gap(state.attitude),
                    steps=self.steps.init(),
                    windows=self.windows.init(),
                )
            state, found = self._sense(state, part)
            events += found
        return state, events

    def finish(self, state: SensingState) -> list[tuple[float, Event]]:
        """The steps that were still waiting for samples when the recording ended."""
        return [(step.detected_time_s, step) for _, step in self.steps.finish(state.steps)]

    def _sense(self, state: SensingState, part: UniformBlock) -> tuple[SensingState, list[tuple[float, Event]]]:
        attitude_state, attitude = self.attitude.step(state.attitude, part)
        n_before = state.steps.n_samples
        step_state, steps = self.steps.step(state.steps, part, attitude)
        window_state, windows = self.windows.step(state.windows, part, attitude)
        # A window that ends with the sample that reveals a step is known first: its evidence is for that step too.
        in_order = sorted([*windows, *steps], key=lambda e: e[0])
        events: list[tuple[float, Event]] = [(float(part.time_s[i - n_before]), event) for i, event in in_order]
        state = replace(
            state,
            attitude=attitude_state,
            steps=step_state,
            windows=window_state,
            processed_s=float(part.time_s[-1]),
        )
        return state, events

    def _close_segment(self, state: SensingState, gap_s: float) -> Iterator[tuple[float, Event]]:
        for _, step in self.steps.finish(state.steps):
            yield state.processed_s, step
        yield state.processed_s, Gap(gap_s)
