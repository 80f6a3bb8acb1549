"""Base classes of the step detectors: the interface, and the loop over blocks of samples."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from math import floor
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.step_log import NumberedSteps, StepLog, StepLogState, StepSpan
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

_BY_DEFAULT: Any = None  # replaced in `ContextBlock.__post_init__`


@dataclass(frozen=True, slots=True, eq=False)
class ContextBlock:
    """Most probable context and carrying mode at each uniform sample.

    A class is given only if it has at least half of the probability. The meanings of the contexts are those of the
    default contexts unless they are given; `of` takes them from other contexts.

    Attributes
    ----------
    context : IntArray
        Index of the context, shape (N,). -1 if no context has half of the probability, and before the first window.
    carrying_mode : IntArray
        Index into `CARRYING_MODES`, shape (N,). -1 if no mode has half of the probability, and before the first window.
    stands : BoolArray
        True where the context is one without steps, shape (N,).
    runs : BoolArray
        True where the context is running, shape (N,).
    is_turned : BoolArray
        True where the context is walking sideways or backward, shape (N,).

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.sensing.steps.step_detector import ContextBlock
    >>> block = ContextBlock(context=np.array([0, 1]), carrying_mode=np.array([-1, -1]))
    >>> block.stands
    array([ True, False])
    """

    context: IntArray
    carrying_mode: IntArray
    stands: BoolArray = _BY_DEFAULT
    runs: BoolArray = _BY_DEFAULT
    is_turned: BoolArray = _BY_DEFAULT

    def __post_init__(self) -> None:
        for name in ("stands", "runs", "is_turned"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, getattr(DEFAULT_CONTEXTS, name)[self.context])

    @classmethod
    def of(cls, context: IntArray, carrying_mode: IntArray, contexts: ContextSet) -> ContextBlock:
        """Return the block for other contexts than the default.

        Parameters
        ----------
        context : (N,) array of int
            Index into `contexts`, or -1 if unknown.
        carrying_mode : (N,) array of int
            Index into `CARRYING_MODES`, or -1 if unknown.
        contexts : ContextSet
            Contexts with their meanings.

        Returns
        -------
        ContextBlock
            Block with the meanings of the contexts.
        """
        meanings = contexts.stands, contexts.runs, contexts.is_turned
        return cls(context, carrying_mode, *(meaning[context] for meaning in meanings))


def unknown_contexts(n_samples: int) -> ContextBlock:
    """Return a block in which context and carrying mode are unknown at all samples."""
    unknown = np.full(n_samples, -1)
    return ContextBlock(unknown, unknown)


@dataclass(frozen=True, eq=False)
class DetectorState:
    """State that all detectors share; each detector adds its own fields.

    Attributes
    ----------
    log : StepLogState
        Recent samples and the last contact.
    line : FloatArray
        Delay line with the last signals of the detector, shape (R, L). Zeros before the first sample.

    Examples
    --------
    >>> from pdr_filter.sensing.steps.adaptive_detector import AdaptiveStepDetector
    >>> from pdr_filter.sensing.steps.step_detector import DetectorState
    >>> isinstance(AdaptiveStepDetector().init(), DetectorState)
    True
    """

    log: StepLogState
    line: FloatArray


S = TypeVar("S", bound=DetectorState)


@dataclass(frozen=True)
class BaseStepDetector(ABC, Generic[S]):
    """Base class of causal stages that detect steps in one or more signals.

    A subclass computes signals from the samples and detects contacts in them. This class provides the loop over blocks,
    the delay line, and the description of the steps. Samples are numbered from 0 in each segment between gaps. The
    result does not depend on how samples are cut into blocks.

    Parameters
    ----------
    rate_hz : float, default 100
        Sampling rate of the blocks, Hz.
    max_interval_s : float, default 2
        A new bout begins after a longer time without a contact, s.
    first_step_s : float, default 0.6
        Duration assigned to the first step of a bout, s, because no contact marks its start. The default is typical for
        a step from rest.

    Raises
    ------
    ValueError
        If a parameter is not a positive number.

    Examples
    --------
    The detectors of the package are subclasses:

    >>> from pdr_filter.sensing.steps.adaptive_detector import AdaptiveStepDetector
    >>> from pdr_filter.sensing.steps.step_detector import BaseStepDetector
    >>> detector = AdaptiveStepDetector(max_interval_s=3.0)
    >>> isinstance(detector, BaseStepDetector), round(detector.latency_s, 2)
    (True, 0.88)
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
        """Longest time from a contact to its detection, s."""

    @abstractmethod
    def init(self) -> S:
        """Return the state before the first sample of a segment.

        Returns
        -------
        DetectorState
            Initial state.
        """

    @property
    @abstractmethod
    def _n_line(self) -> int:
        """Length L of the delay line: columns of earlier signals that `_detect` receives."""

    @abstractmethod
    def _signals(
        self, state: S, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[S, FloatArray]:
        """Return the state with new filter memories, and the signals (R, N) of a block."""

    @abstractmethod
    def _detect(self, state: S, line: FloatArray, first: int) -> tuple[S, NumberedSteps]:
        """Return the new state and the steps detected in R signals, (R, L + N), with L delayed and N new samples.

        The last N columns are new, and the first of them is sample number `first`.
        """

    def _before(self, signals: FloatArray) -> FloatArray:
        """Return the signals (R, L) assumed before the first sample: copies of it, as zeros would be an impulse."""
        return np.repeat(signals[:, :1], self._n_line, axis=1)

    def _signals_after_end(self, state: S) -> FloatArray:
        """Return the signals (R, n) assumed after the last sample of a segment: the last value repeated."""
        return np.repeat(state.line[:, -1:], round(self.latency_s * self.rate_hz), axis=1)

    @cached_property
    def _log(self) -> StepLog:
        """Sample buffer from which the fields of each detected step are computed."""
        return StepLog(self.rate_hz, self.latency_s, self.max_interval_s, self.first_step_s)

    def update(
        self, state: S, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[S, NumberedSteps]:
        """Return the new state and the steps that a block reveals.

        Parameters
        ----------
        state : DetectorState
            State after the previous block.
        block : UniformBlock
            Uniform samples that follow, N samples.
        attitude : AttitudeBlock
            Attitude at these samples.
        contexts : ContextBlock
            Most probable context and carrying mode at each sample.

        Returns
        -------
        state : DetectorState
            New state.
        steps : list of (int, Step)
            Steps that became known, each with the number of the sample that revealed it.
        """
        first = state.log.n_samples
        state = replace_unchecked(state, log=self._log.extend(state.log, block, attitude))
        state, signals = self._signals(state, block, attitude, contexts)
        if first == 0:
            state = replace_unchecked(state, line=self._before(signals))
        state, steps = self._advance(state, signals, first)
        return replace_unchecked(state, log=self._log.trim(state.log)), steps

    def finish(self, state: S) -> NumberedSteps:
        """Return the steps that still wait for samples when a gap or the end comes.

        Parameters
        ----------
        state : DetectorState
            State after the last block of a segment.

        Returns
        -------
        list of (int, Step)
            Remaining steps, each with the index of the last sample of the segment, at whose time it counts as detected.
        """
        end = state.log.n_samples
        if end == 0:
            return []
        last_s = self._log.time_s(state.log, end - 1)
        _, steps = self._advance(state, self._signals_after_end(state), end)
        return [(end - 1, replace_unchecked(s, detected_time_s=last_s)) for _, s in steps if s.time_s <= last_s]

    def _end_step(self, state: S, contact: float, known: int) -> tuple[S, Step | None]:
        """Return the new state and the step that ends at a contact, or None if its samples are not available.

        `contact` is a fractional sample number, and `known` the number of the sample that revealed the contact.
        """
        whole = floor(contact)
        if not self._log.can_end(state.log, whole):
            return state, None
        log, step = self._log.add(state.log, whole, known, contact - whole)
        return replace_unchecked(state, log=log), step

    def _advance(self, state: S, signals: FloatArray, first: int) -> tuple[S, NumberedSteps]:
        """Return the state and the steps after signals (R, N), whose first column is sample number `first`."""
        line = np.concatenate([state.line, signals], axis=1)
        state, steps = self._detect(state, line, first)
        return replace_unchecked(state, line=line[:, signals.shape[1] :].copy()), steps


# Samples whose response is computed together, so that the intermediate arrays fit into the processor's cache.
_SAMPLES_AT_ONCE = 2000


@dataclass(frozen=True, eq=False)
class ResponseState(DetectorState):
    """State of a detector of response maxima.

    Attributes
    ----------
    log : StepLogState
        Recent samples and the last contact.
    line : FloatArray
        Delay line with the last signals of the detector, shape (R, L). Zeros before the first sample.
    response : FloatArray
        Last two columns of the response and its further values, shape (K, 2).

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.sensing.steps.step_detector import ResponseState
    >>> from pdr_filter.sensing.steps.step_log import StepLog
    >>> log = StepLog(rate_hz=100.0, latency_s=0.5).init()
    >>> ResponseState(log, line=np.zeros((1, 50)), response=np.zeros((1, 2))).response.shape
    (1, 2)
    """

    response: FloatArray


R = TypeVar("R", bound=ResponseState)


@dataclass(frozen=True)
class ResponseStepDetector(BaseStepDetector[R]):
    """Base class of detectors whose steps are local maxima of a response signal.

    The response is delayed by `_delay_samples`. Further values may accompany each sample of the response.

    Parameters
    ----------
    rate_hz : float, default 100
        Sampling rate of the blocks, Hz.
    max_interval_s : float, default 2
        A new bout begins after a longer time without a contact, s.
    first_step_s : float, default 0.6
        Duration assigned to the first step of a bout, s.

    Examples
    --------
    >>> from pdr_filter.sensing.steps.step_detector import BaseStepDetector, ResponseStepDetector
    >>> issubclass(ResponseStepDetector, BaseStepDetector)
    True
    """

    @property
    @abstractmethod
    def _delay_samples(self) -> int:
        """Delay of the response, in samples."""

    @property
    @abstractmethod
    def _min_response(self) -> float:
        """Smallest maximum that can be a step."""

    @abstractmethod
    def _response(self, line: FloatArray) -> FloatArray:
        """Return the response, whose maxima are steps (row 0), and its further values, (K, N).

        The input are R signals (R, L + N), with L delayed and N new samples.
        """

    @abstractmethod
    def _state_if_step(self, state: R, peak: FloatArray, interval_s: float, new_bout: bool) -> R | None:
        """Return the new state if a maximum (K,) is a step, else None.

        `interval_s` is the time since the last step, and `new_bout` tells whether the step would be the first of a
        bout.
        """

    @property
    def latency_s(self) -> float:
        return (self._delay_samples + 1) / self.rate_hz

    def _detect(self, state: R, line: FloatArray, first: int) -> tuple[R, NumberedSteps]:
        """Return the new state and the steps at accepted local maxima of the response."""
        width = self._n_line + _SAMPLES_AT_ONCE
        pieces = [
            self._response(line[:, i : i + width]) for i in range(0, line.shape[1] - self._n_line, _SAMPLES_AT_ONCE)
        ]
        response = np.concatenate([state.response, *pieces], axis=1)
        is_peak = local_maxima(response[0]) & (response[0, 1:-1] >= self._min_response)
        numbers, spans = list[int](), list[StepSpan]()
        for i in np.flatnonzero(is_peak).tolist():
            # Column i + 2 of the response became known with sample number first + i.
            state, span = self._step_at(state, response[:, i : i + 3], first + i)
            if span is not None:
                numbers.append(first + i)
                spans.append(span)
        log, steps = self._log.describe(state.log, spans)
        return replace_unchecked(state, log=log, response=response[:, -2:]), list(zip(numbers, steps, strict=True))

    def _step_at(self, state: R, values: FloatArray, known: int) -> tuple[R, StepSpan | None]:
        """Return the new state and the span of the step that ends at a local maximum, or None if it is not a step.

        The maximum is the middle column of `values` (K, 3). Sample number `known` revealed it.
        """
        contact = known - 1 - self._delay_samples
        if not self._log.can_end(state.log, contact):
            return state, None
        fraction = vertex(values[0])
        contact_s = self._log.time_s(state.log, contact) + fraction / self.rate_hz
        interval_s, new_bout = contact_s - state.log.last_contact_s, self._log.starts_bout(state.log, contact_s)
        accepted = self._state_if_step(state, values[:, 1], interval_s, new_bout)
        if accepted is None:
            return state, None
        log, span = self._log.end_step(state.log, contact, known, fraction)
        return replace_unchecked(accepted, log=log), span


def local_maxima(values: FloatArray) -> BoolArray:
    """Return True for each local maximum along the last axis, without the end values.

    Parameters
    ----------
    values : (..., N) array
        Signal.

    Returns
    -------
    (..., N - 2) array of bool
        True at local maxima. The first of equal values counts as the maximum.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.sensing.steps.step_detector import local_maxima
    >>> local_maxima(np.array([0.0, 2.0, 1.0, 3.0, 0.0]))
    array([ True, False,  True])
    """
    middle = values[..., 1:-1]
    return (middle > values[..., :-2]) & (middle >= values[..., 2:])


def vertex(peak: FloatArray) -> float:
    """Return the position of the extremum of the parabola through three values.

    It gives contact times a finer resolution than the sampling interval.

    Parameters
    ----------
    peak : (3,) array
        Values at consecutive samples.

    Returns
    -------
    float
        Position in samples from the middle value; 0 if the values lie on a line.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.sensing.steps.step_detector import vertex
    >>> vertex(np.array([0.0, 2.0, 1.0]))
    0.16666666666666666
    """
    before, middle, after = peak.tolist()
    curvature = before - 2 * middle + after
    return 0.5 * (before - after) / curvature if curvature != 0 else 0.0
