"""What all step detectors share: their interface, and the loop over blocks of samples."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.step_log import StepLog, StepLogState, StepSpan
from pdr_filter.values import (
    DEFAULT_CONTEXTS,
    BoolArray,
    ContextSet,
    FloatArray,
    IntArray,
    Step,
    check_numbers,
    replace_unchecked,
)

_BY_DEFAULT: Any = None  # until the block is made


@dataclass(frozen=True, slots=True, eq=False)
class ContextBlock:
    """The context and the carrying mode at each uniform sample: those with at least half of the probability.

    What the context means is that of the default contexts unless it is given; `of` takes it from other contexts.
    """

    context: IntArray  # (N,) index into the contexts; -1 where none has half, and before anything is known
    carrying_mode: IntArray  # (N,) index into `CARRYING_MODES`; -1 likewise
    stands: BoolArray = _BY_DEFAULT  # (N,) whether the context is one without steps
    runs: BoolArray = _BY_DEFAULT  # (N,) whether the person runs
    is_turned: BoolArray = _BY_DEFAULT  # (N,) whether the person walks to the side or backward

    def __post_init__(self) -> None:
        for name in ("stands", "runs", "is_turned"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, getattr(DEFAULT_CONTEXTS, name)[self.context])

    @classmethod
    def of(cls, context: IntArray, carrying_mode: IntArray, contexts: ContextSet) -> ContextBlock:
        """Return the block of indices (N,) into some contexts and of carrying modes (N,)."""
        meanings = contexts.stands, contexts.runs, contexts.is_turned
        return cls(context, carrying_mode, *(meaning[context] for meaning in meanings))


def unknown_contexts(n_samples: int) -> ContextBlock:
    """Nothing known at any of the samples."""
    unknown = np.full(n_samples, -1)
    return ContextBlock(unknown, unknown)


@dataclass(frozen=True, eq=False)
class DetectorState:
    """What every detector remembers; each adds its own."""

    log: StepLogState
    line: FloatArray  # (R, L) its last signals; zeros before the first sample


S = TypeVar("S", bound=DetectorState)


@dataclass(frozen=True)
class BaseStepDetector(ABC, Generic[S]):
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

    # Whether the steps depend on the contexts or carrying modes. If not, `Sensing.steps_only` computes none.
    uses_contexts: ClassVar[bool] = True

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

    def update(
        self, state: S, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[S, list[tuple[int, Step]]]:
        """New state and the steps that became known, each with the number of the sample that revealed it."""
        first = state.log.n_samples
        state = replace_unchecked(state, log=self._log.extend(state.log, block, attitude))
        state, signals = self._signals(state, block, attitude, contexts)
        if first == 0:
            state = replace_unchecked(state, line=self._before(signals))
        state, steps = self._advance(state, signals, first)
        return replace_unchecked(state, log=self._log.trim(state.log)), steps

    def finish(self, state: S) -> list[tuple[int, Step]]:
        """Steps whose detection would have needed more samples, when a gap or the end comes."""
        end = state.log.n_samples
        if end == 0:
            return []
        last_s = self._log.time_s(state.log, end - 1)
        _, steps = self._advance(state, self._continued(state), end)
        return [(end - 1, replace_unchecked(s, detected_time_s=last_s)) for _, s in steps if s.time_s <= last_s]

    def _advance(self, state: S, signals: FloatArray, first: int) -> tuple[S, list[tuple[int, Step]]]:
        line = np.concatenate([state.line, signals], axis=1)
        state, steps = self._detect(state, line, first)
        return replace_unchecked(state, line=line[:, signals.shape[1] :].copy()), steps


# Samples whose response is made at once: what is needed for it fits into a cache.
_SAMPLES_AT_ONCE = 2000


@dataclass(frozen=True, eq=False)
class ResponseState(DetectorState):
    """Its last signals, and the last values of the response."""

    response: FloatArray  # (K, 2)


R = TypeVar("R", bound=ResponseState)


@dataclass(frozen=True)
class ResponseStepDetector(BaseStepDetector[R]):
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
        width = self._n_line + _SAMPLES_AT_ONCE
        pieces = [
            self._response(line[:, i : i + width]) for i in range(0, line.shape[1] - self._n_line, _SAMPLES_AT_ONCE)
        ]
        response = np.concatenate([state.response, *pieces], axis=1)
        is_peak = local_maxima(response[0]) & (response[0, 1:-1] >= self._min_response)
        numbers, spans = list[int](), list[StepSpan]()
        for i in np.flatnonzero(is_peak).tolist():
            # column i + 2 was made by sample first + i
            state, span = self._step_at(state, response[:, i : i + 3], first + i)
            if span is not None:
                numbers.append(first + i)
                spans.append(span)
        log, steps = self._log.describe(state.log, spans)
        return replace_unchecked(state, log=log, response=response[:, -2:]), list(zip(numbers, steps, strict=True))

    def _step_at(self, state: R, values: FloatArray, known: int) -> tuple[R, StepSpan | None]:
        """The step that a local maximum of the response, the middle of (K, 3), ends, if it ends one."""
        contact = known - 1 - self._delay_samples
        if not self._log.can_end(state.log, contact):
            return state, None
        fraction = vertex(values[0])
        contact_s = self._log.time_s(state.log, contact) + fraction / self.rate_hz
        interval_s, new_bout = contact_s - state.log.last_contact_s, self._log.starts_bout(state.log, contact_s)
        accepted = self._accepted(state, values[:, 1], interval_s, new_bout)
        if accepted is None:
            return state, None
        log, span = self._log.end_step(state.log, contact, known, fraction)
        return replace_unchecked(accepted, log=log), span


def local_maxima(values: FloatArray) -> BoolArray:
    """Whether each value but the first and the last of (..., N) is a local maximum, (..., N - 2)."""
    middle = values[..., 1:-1]
    return (middle > values[..., :-2]) & (middle >= values[..., 2:])


def vertex(peak: FloatArray) -> float:
    """Where the parabola through three values (3,) has its extremum, in samples after the middle one.

    It dates contacts more finely than the sampling interval.
    """
    before, middle, after = peak.tolist()
    curvature = before - 2 * middle + after
    return 0.5 * (before - after) / curvature if curvature != 0 else 0.0
