"""What all step detectors share: their interface, the loop over blocks of samples, and how contacts become steps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import exp, log
from typing import Generic, TypeVar

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.values import STANDARD_GRAVITY_MPS2, BoolArray, FloatArray, IntArray, Step, check_numbers, replace


@dataclass(frozen=True, slots=True, eq=False)
class ContextBlock:
    """The context and the carrying mode at each uniform sample: those with at least half of the probability."""

    context: IntArray  # (N,) index into `CONTEXTS`; -1 where none has half, and before anything is known
    carrying_mode: IntArray  # (N,) index into `CARRYING_MODES`; -1 likewise


def unknown_contexts(n_samples: int) -> ContextBlock:
    """Nothing known at any of the samples."""
    unknown = np.full(n_samples, -1)
    return ContextBlock(unknown, unknown)


@dataclass(frozen=True, eq=False)
class StepLogState:
    """The signals of the last seconds, and the last contact."""

    n_samples: int  # seen so far in this segment
    # (6, H): time, magnitude, vertical, device heading, samples without angular rate so far, std of the yaw bias
    signals: FloatArray
    last_contact: int  # number of the sample; negative before the first
    last_contact_s: float
    last_unknown: float  # samples without angular rate up to the last contact
    n_usual: float  # steps in the sums of the two logarithms, with the forgetting of `USUAL_DECAY`
    log_amplitudes: float
    log_durations: float
    last_turn_rad: float  # of the device over the last step, and how long that took; 0 at the start of a bout
    last_duration_s: float

    def fits(self, n_samples: int) -> bool:
        """Whether a segment of so many samples can leave this."""
        return self.n_samples == n_samples and self.signals.shape[1] <= n_samples and self.last_contact < n_samples


# What is usual for somebody is the mean of about the last twenty steps.
USUAL_DECAY = 0.95
# A step that takes so many times the usual time began with a rest.
_REST_PERIODS = 1.8


@dataclass(frozen=True)
class StepLog:
    """Remembers signals and describes the step that a contact ends; every detector makes its steps here.

    The parameters are those of a `StepDetector`.
    """

    rate_hz: float
    latency_s: float  # how long after a contact it may be given
    max_interval_s: float = 2.0
    first_step_s: float = 0.6

    @property
    def _n_kept(self) -> int:
        return round(self.latency_s * self.rate_hz) + 1 + int(np.ceil(self.max_interval_s * self.rate_hz))

    def init(self) -> StepLogState:
        """State before the first sample of a segment."""
        return StepLogState(0, np.empty((6, 0)), -1, -np.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

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

    def can_end(self, state: StepLogState, contact: int) -> bool:
        """Whether a step can end at a sample: it exists, is remembered, and later than the last contact."""
        return max(self.first_sample(state), state.last_contact, 0) < contact < state.n_samples

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

        The contact is at a sample at which a step `can_end`, and a fraction of a sampling interval. Sample `known`
        revealed it: beyond the last one where a segment ends.
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
        step = _with_turn(step, (0.0, 0.0) if is_first else (state.last_turn_rad, state.last_duration_s))
        state = replace(
            state,
            last_contact=contact,
            last_contact_s=contact_s,
            last_unknown=unknown,
            last_turn_rad=step.heading_change_rad,
            last_duration_s=step.duration_s,
        )
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


def _with_turn(step: Step, before: tuple[float, float]) -> Step:
    """The step with the turn rate of its stride; `before` is what the device turned in the step before, in what time.

    Body and arm sway once in a stride: over two steps that is gone, and what is left is the turn of the person.
    """
    turn_rad, duration_s = before
    rate = abs(step.heading_change_rad + turn_rad) / (step.duration_s + duration_s)
    return replace(step, turn_rate_radps=rate)


@dataclass(frozen=True, eq=False)
class DetectorState:
    """What every detector remembers; each adds its own."""

    log: StepLogState
    line: FloatArray  # (R, L) its last signals; zeros before the first sample

    def fits(self, n_samples: int) -> bool:
        """Whether a segment of so many samples can leave this."""
        return self.log.fits(n_samples)


S = TypeVar("S", bound=DetectorState)


@dataclass(frozen=True)
class StepDetector(ABC, Generic[S]):
    """A causal stage that looks for steps in a few signals; all detectors share this loop over blocks.

    Samples are numbered from 0 in each segment (between gaps). The result does not depend on how the samples were cut
    into blocks.

    Parameters
    ----------
    rate_hz : float
        Sampling rate of the blocks.
    max_interval_s : float
        After a longer pause a new bout begins.
    first_step_s : float
        Duration given to the first step of a bout, whose start no contact marks: a typical step from rest.
    """

    rate_hz: float = 100.0
    max_interval_s: float = 2.0
    first_step_s: float = 0.6

    def __post_init__(self) -> None:
        check_numbers(self)

    @property
    @abstractmethod
    def latency_s(self) -> float:
        """Longest time from a contact to its detection."""

    @abstractmethod
    def init(self) -> S:
        """State before the first sample of a segment."""

    @property
    @abstractmethod
    def _n_line(self) -> int:
        """How many columns of earlier signals `_detect` is given, L."""

    @abstractmethod
    def _signals(
        self, state: S, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[S, FloatArray]:
        """New filter memories and the signals (R, N) of a block."""

    @abstractmethod
    def _detect(self, state: S, line: FloatArray, first: int) -> tuple[S, list[tuple[int, Step]]]:
        """Detect in signals (R, L + N): the last N are new, and the first of these is sample number `first`."""

    def _before(self, signals: FloatArray) -> FloatArray:
        """Signals (R, L) assumed before the first sample: like it, because a zero there would look like a blow."""
        return np.repeat(signals[:, :1], self._n_line, axis=1)

    def _continued(self, state: S) -> FloatArray:
        """Signals (R, n) assumed after the last sample, where a gap or the end comes: the last value stays."""
        return np.repeat(state.line[:, -1:], round(self.latency_s * self.rate_hz), axis=1)

    @cached_property
    def _log(self) -> StepLog:
        return StepLog(self.rate_hz, self.latency_s, self.max_interval_s, self.first_step_s)

    def step(
        self, state: S, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[S, list[tuple[int, Step]]]:
        """New state and the steps that became known, each with the number of the sample that revealed it."""
        first = state.log.n_samples
        state = replace(state, log=self._log.extend(state.log, block, attitude))
        state, signals = self._signals(state, block, attitude, contexts)
        if first == 0:
            state = replace(state, line=self._before(signals))
        state, steps = self._advance(state, signals, first)
        return replace(state, log=self._log.trim(state.log)), steps

    def finish(self, state: S) -> list[tuple[int, Step]]:
        """Steps whose detection would have needed more samples, when a gap or the end comes."""
        end = state.log.n_samples
        if end == 0:
            return []
        last_s = self._log.time_s(state.log, end - 1)
        _, steps = self._advance(state, self._continued(state), end)
        return [(end - 1, replace(s, detected_time_s=last_s)) for _, s in steps if s.time_s <= last_s]

    def _advance(self, state: S, signals: FloatArray, first: int) -> tuple[S, list[tuple[int, Step]]]:
        line = np.concatenate([state.line, signals], axis=1)
        state, steps = self._detect(state, line, first)
        return replace(state, line=line[:, signals.shape[1] :].copy()), steps


@dataclass(frozen=True, eq=False)
class ResponseState(DetectorState):
    """Its last signals, and the last values of the response."""

    response: FloatArray  # (K, 2)


R = TypeVar("R", bound=ResponseState)


@dataclass(frozen=True)
class ResponseStepDetector(StepDetector[R]):
    """Steps as local maxima of a response, which is `_delay_samples` late and may come with further values."""

    @property
    @abstractmethod
    def _delay_samples(self) -> int: ...

    @property
    @abstractmethod
    def _min_response(self) -> float:
        """Lower maxima are no steps in any case."""

    @abstractmethod
    def _response(self, line: FloatArray) -> FloatArray:
        """The response and what comes with it, (K, N), from signals (R, L + N)."""

    @abstractmethod
    def _accepted(self, state: R, peak: FloatArray, interval_s: float, new_bout: bool) -> R | None:
        """New state if a maximum (K,) that comes so long after the last step is a step, else None."""

    @property
    def latency_s(self) -> float:
        """Time from a contact to its detection."""
        return (self._delay_samples + 1) / self.rate_hz

    def _detect(self, state: R, line: FloatArray, first: int) -> tuple[R, list[tuple[int, Step]]]:
        response = np.concatenate([state.response, self._response(line)], axis=1)
        is_peak = local_maxima(response[0]) & (response[0, 1:-1] >= self._min_response)
        steps: list[tuple[int, Step]] = []
        for i in np.flatnonzero(is_peak).tolist():
            # column i + 2 was made by sample first + i
            state, step = self._step_at(state, response[:, i : i + 3], first + i)
            if step is not None:
                steps.append((first + i, step))
        return replace(state, response=response[:, -2:]), steps

    def _step_at(self, state: R, values: FloatArray, known: int) -> tuple[R, Step | None]:
        """The step that a local maximum of the response, the middle of (K, 3), makes, if it makes one."""
        contact = known - 1 - self._delay_samples
        if not self._log.can_end(state.log, contact):
            return state, None
        fraction = vertex(values[0])
        contact_s = self._log.time_s(state.log, contact) + fraction / self.rate_hz
        interval_s, new_bout = contact_s - state.log.last_contact_s, self._log.starts_bout(state.log, contact_s)
        accepted = self._accepted(state, values[:, 1], interval_s, new_bout)
        if accepted is None:
            return state, None
        log, step = self._log.add(state.log, contact, known, fraction)
        return replace(accepted, log=log), step


def local_maxima(values: FloatArray) -> BoolArray:
    """Whether each value but the first and the last of (..., N) is a local maximum, (..., N - 2)."""
    middle = values[..., 1:-1]
    return (middle > values[..., :-2]) & (middle >= values[..., 2:])


def vertex(peak: FloatArray) -> float:
    """Where the parabola through three values (3,) has its extremum, in samples after the middle one.

    It dates contacts more finely than the sampling interval.
    """
    curvature = peak[0] - 2 * peak[1] + peak[2]
    return float(0.5 * (peak[0] - peak[2]) / curvature) if curvature != 0 else 0.0


def specific_force_magnitude(specific_force_mps2: FloatArray) -> FloatArray:
    """|f| of (N, 3) samples, m/s2 (Martinelli et al. 2018, eq. 1)."""
    x, y, z = specific_force_mps2.T
    return np.sqrt(x * x + y * y + z * z)


def describe_step(
    signals: FloatArray, contact_s: float, detected_s: float, duration_s: float, heading_unknown_s: float
) -> Step:
    """The step that ends at a contact, from its samples (6, n), rows as in `StepLogState.signals`."""
    _, magnitude, vertical, heading, _, bias_std = signals
    (_, magnitude_max, vertical_max), (_, magnitude_min, vertical_min) = (
        extreme.reduce(signals[:3], axis=1).tolist() for extreme in (np.maximum, np.minimum)
    )
    return Step(
        time_s=contact_s,
        detected_time_s=detected_s,
        duration_s=duration_s,
        frequency_hz=1.0 / duration_s,
        variance=float(magnitude.var()),
        vertical_max_mps2=vertical_max,
        vertical_min_mps2=vertical_min,
        magnitude_max_mps2=magnitude_max,
        magnitude_min_mps2=magnitude_min,
        mean_abs_mps2=float(np.abs(magnitude - STANDARD_GRAVITY_MPS2).mean()),
        heading_change_rad=float(heading[-1] - heading[0]),
        device_heading_rad=float(heading.mean()),
        heading_unknown_s=heading_unknown_s,
        yaw_bias_std_radps=float(bias_std[-1]),
        vertical_amplitude_mps2=amplitude_of_one_period(vertical),
    )


def amplitude_of_one_period(values: FloatArray) -> float:
    """Amplitude of the sinusoid with one period in the values (n,): 2 / n |sum x_k exp(-2 pi i k / n)|."""
    cosine, sine = _one_period(len(values))
    centred = values - values.mean()
    return 2 / len(values) * float(np.hypot((centred * cosine).sum(), (centred * sine).sum()))


@lru_cache(maxsize=512)
def _one_period(n: int) -> tuple[FloatArray, FloatArray]:
    """Cosine and sine (n,) of one period in n samples."""
    phase = 2 * np.pi * np.arange(n) / n
    return np.cos(phase), np.sin(phase)
