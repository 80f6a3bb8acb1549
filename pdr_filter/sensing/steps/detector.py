"""What all step detectors share: their interface, what they are told of modes, and how contacts become steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, log
from typing import Any, Protocol

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.values.arrays import FloatArray, IntArray
from pdr_filter.values.samples import STANDARD_GRAVITY_MPS2
from pdr_filter.values.step import Step


@dataclass(frozen=True, slots=True, eq=False)
class ModeBlock:
    """What the context stage says at each uniform sample: the mode that has at least half of the probability."""

    context: IntArray  # (N,) index into `CONTEXTS`; -1 where none has half, and before anything is known
    carrying_mode: IntArray  # (N,) index into `CARRYING_MODES`; -1 likewise


def unknown_modes(n_samples: int) -> ModeBlock:
    """Nothing known at any of the samples."""
    unknown = np.full(n_samples, -1)
    return ModeBlock(unknown, unknown)


class StepDetector(Protocol):
    """A causal stage that finds steps.

    Samples are numbered from 0 in each segment (between gaps). The result does not depend on how the samples were cut
    into blocks.
    """

    @property
    def rate_hz(self) -> float:
        """Sampling rate of the blocks."""
        ...

    @property
    def latency_s(self) -> float:
        """Longest time from a contact to its detection."""
        ...

    @property
    def first_step_s(self) -> float:
        """Duration given to the first step of a bout."""
        ...

    def init(self) -> Any:
        """State before the first sample of a segment."""
        ...

    def step(
        self, state: Any, block: UniformBlock, attitude: AttitudeBlock, modes: ModeBlock
    ) -> tuple[Any, list[tuple[int, Step]]]:
        """New state and the steps that became known, each with the number of the sample that revealed it."""
        ...

    def finish(self, state: Any) -> list[tuple[int, Step]]:
        """Steps whose detection would have needed more samples, when a gap or the end comes."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class StepLogState:
    """The signals of the last seconds, and the last contact."""

    n_samples: int  # seen so far in this segment
    # (6, H): time, magnitude, vertical, device heading, samples without angular rate so far, deviation of the yaw bias
    signals: FloatArray
    last_contact: int  # number of the sample; negative before the first
    last_contact_s: float
    last_unknown: float  # samples without angular rate up to the last contact
    n_usual: float  # steps in the sums of the two logarithms, with the forgetting of `USUAL_DECAY`
    log_amplitudes: float
    log_durations: float


# What is usual for somebody is the mean of about the last twenty steps.
USUAL_DECAY = 0.95
# A step that takes so many times the usual time began with a rest.
_REST_PERIODS = 1.8


@dataclass(frozen=True)
class StepLog:
    """Remembers signals and describes the step that a contact ends; every detector makes its steps here.

    Parameters
    ----------
    rate_hz : float
        Sampling rate.
    latency_s : float
        How long after a contact it may be given.
    max_interval_s : float
        After a longer pause a new bout begins.
    first_step_s : float
        Duration given to the first step of a bout, whose start no contact marks: a typical step from rest.
    """

    rate_hz: float
    latency_s: float
    max_interval_s: float = 2.0
    first_step_s: float = 0.6

    @property
    def _n_kept(self) -> int:
        return round(self.latency_s * self.rate_hz) + 1 + int(np.ceil(self.max_interval_s * self.rate_hz))

    def init(self) -> StepLogState:
        """State before the first sample of a segment."""
        return StepLogState(0, np.empty((6, 0)), -1, -np.inf, 0.0, 0.0, 0.0, 0.0)

    def extend(self, state: StepLogState, block: UniformBlock, attitude: AttitudeBlock) -> StepLogState:
        """State with the samples of a block; call before their contacts are given, and `trim` after."""
        magnitude = specific_force_magnitude(block.specific_force_mps2)
        unknown_before = state.signals[4, -1] if state.signals.shape[1] else 0.0
        unknown = unknown_before + np.cumsum(~block.angular_rate_known)
        bias_std = attitude.yaw_bias_std_radps if len(attitude.yaw_bias_std_radps) else np.zeros(len(magnitude))
        new = np.stack(
            [block.time_s, magnitude, attitude.vertical_mps2, attitude.device_heading_rad, unknown, bias_std]
        )
        signals = np.concatenate([state.signals, new], axis=1)
        return replace(state, n_samples=state.n_samples + len(magnitude), signals=signals)

    def trim(self, state: StepLogState) -> StepLogState:
        """State without the signals that no later contact can need."""
        return replace(state, signals=state.signals[:, -self._n_kept :])

    def first_sample(self, state: StepLogState) -> int:
        """Number of the oldest sample that is remembered: contacts must be later."""
        return state.n_samples - state.signals.shape[1]

    def time_s(self, state: StepLogState, sample: float) -> float:
        """Time of a sample, between samples too."""
        whole = int(np.floor(sample))
        index = min(max(whole - self.first_sample(state), 0), state.signals.shape[1] - 1)
        return float(state.signals[0, index] + (sample - whole) / self.rate_hz)

    def starts_bout(self, state: StepLogState, contact_s: float) -> bool:
        """Whether a contact at this time is the first of a bout."""
        return contact_s - state.last_contact_s > self.max_interval_s

    def add(self, state: StepLogState, contact: int, known: int, fraction: float = 0.0) -> tuple[StepLogState, Step]:
        """New state and the step that a contact ends.

        Parameters
        ----------
        state : StepLogState
            With the contact's sample in it.
        contact : int
            Number of the contact's sample, later than the contact before and than the oldest remembered sample.
        known : int
            Number of the sample that revealed it; beyond the last one where a segment ends.
        fraction : float
            Part of a sampling interval by which the contact is later than its sample.
        """
        first = self.first_sample(state)
        contact_s = float(state.signals[0, contact - first] + fraction / self.rate_hz)
        is_first = self.starts_bout(state, contact_s)
        duration_s = self.first_step_s if is_first else contact_s - state.last_contact_s
        start = contact - round(duration_s * self.rate_hz) if is_first else state.last_contact
        known_s = float(state.signals[0, min(known - first, state.signals.shape[1] - 1)])
        unknown = float(state.signals[4, contact - first])
        unknown_s = (unknown - state.last_unknown) / self.rate_hz
        step = describe_step(
            state.signals[:, max(start - first, 0) : contact - first], contact_s, known_s, duration_s, unknown_s
        )
        state = replace(state, last_contact=contact, last_contact_s=contact_s, last_unknown=unknown)
        return self._compared_with_usual(state, step, is_first)

    def _compared_with_usual(self, state: StepLogState, step: Step, is_first: bool) -> tuple[StepLogState, Step]:
        """The step with what is usual for this person, itself included, and whether it began with a rest."""
        usual_s = exp(state.log_durations / state.n_usual) if state.n_usual > 0 else np.inf
        from_rest = is_first or step.duration_s > _REST_PERIODS * usual_s
        if not from_rest:
            state = replace(
                state,
                n_usual=USUAL_DECAY * state.n_usual + 1.0,
                log_amplitudes=USUAL_DECAY * state.log_amplitudes + log(max(step.vertical_amplitude_mps2, 0.05)),
                log_durations=USUAL_DECAY * state.log_durations + log(step.duration_s),
            )
        usual_mps2 = exp(state.log_amplitudes / state.n_usual) if state.n_usual > 0 else 0.0
        return state, replace(step, usual_amplitude_mps2=usual_mps2, from_rest=from_rest)


def specific_force_magnitude(specific_force_mps2: FloatArray) -> FloatArray:
    """|f| of (N, 3) samples, m/s2 (Martinelli et al. 2018, eq. 1)."""
    x, y, z = specific_force_mps2.T
    return np.sqrt(x * x + y * y + z * z)


def describe_step(
    signals: FloatArray, contact_s: float, detected_s: float, duration_s: float, heading_unknown_s: float
) -> Step:
    """The step that ends at a contact, from its samples (6, n), rows as in `StepLogState.signals`."""
    _, magnitude, vertical, heading, _, bias_std = signals
    return Step(
        time_s=contact_s,
        detected_time_s=detected_s,
        duration_s=duration_s,
        frequency_hz=1.0 / duration_s,
        variance=float(np.var(magnitude)),
        vertical_max_mps2=float(vertical.max()),
        vertical_min_mps2=float(vertical.min()),
        magnitude_max_mps2=float(magnitude.max()),
        magnitude_min_mps2=float(magnitude.min()),
        mean_abs_mps2=float(np.abs(magnitude - STANDARD_GRAVITY_MPS2).mean()),
        heading_change_rad=float(heading[-1] - heading[0]),
        device_heading_rad=float(heading.mean()),
        heading_unknown_s=heading_unknown_s,
        yaw_bias_std_radps=float(bias_std[-1]),
        vertical_amplitude_mps2=amplitude_of_one_period(vertical),
    )


def amplitude_of_one_period(values: FloatArray) -> float:
    """Amplitude of the sinusoid with one period in the values (n,): 2 / n |sum x_k exp(-2 pi i k / n)|."""
    n = len(values)
    phase = 2 * np.pi * np.arange(n) / n
    deviation = values - values.mean()
    return 2 / n * float(np.hypot((deviation * np.cos(phase)).sum(), (deviation * np.sin(phase)).sum()))
