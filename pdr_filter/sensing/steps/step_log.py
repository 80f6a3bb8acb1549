"""Buffer of recent samples, and the description of the step that a contact ends. All detectors use it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import exp, floor, hypot, inf, log

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, Step, replace_unchecked

# Steps, each with the number of the sample in the segment that revealed it.
NumberedSteps = list[tuple[int, Step]]
# Rows of the signals: time, magnitude, vertical, device heading, cumulative count of samples without angular rate, and
# standard deviation of the bias about the vertical.
_TIME, _MAGNITUDE, _VERTICAL, _HEADING, _UNKNOWN, _BIAS_STD = range(6)


@dataclass(frozen=True, slots=True)
class StepSpan:
    """Time span of a step, and the samples that belong to it."""

    contact_s: float  # time of the contact that ends the step, s
    known_s: float  # time at which the detector detected the contact, s
    duration_s: float  # duration of the step, s
    heading_unknown_s: float  # time without angular rate since the last contact, s
    columns: tuple[int, int]  # first column of the step and column of the contact in the signals of a `StepLogState`
    is_first: bool  # True if the step is the first of a bout


@dataclass(frozen=True, eq=False)
class StepLogState:
    """Signals of the last seconds, the last contact, and running means over the steps of the person."""

    n_samples: int  # samples of the segment
    # Recent signals, shape (6, H). The rows are time, magnitude and vertical part of the specific force, device
    # heading, cumulative count of samples without angular rate, and standard deviation of the bias about the vertical.
    signals: FloatArray
    last_contact: int  # sample number of the last contact; negative before the first
    last_contact_s: float  # time of the last contact, s
    last_unknown: float  # samples without angular rate up to the last contact
    # Number of steps in the two following sums, exponentially forgotten with `USUAL_DECAY`. First steps of bouts and
    # steps much longer than usual are not in the sums.
    n_usual: float
    log_amplitudes: float  # sum of the logarithms of the vertical amplitudes
    log_durations: float  # sum of the logarithms of the step durations
    last_turn_rad: float  # turn of the device over the last step, rad; 0 before the first
    last_duration_s: float  # duration of the last step, s; 0 before the first
    # vertical amplitude of the last step, m/s2; 0 before the first, and after a step that is not in the sums
    last_amplitude_mps2: float


# Decay per step of the running means, which average about the last twenty steps.
USUAL_DECAY = 0.95
# A step longer than this multiple of the usual duration began with a rest, or spans two steps.
_REST_PERIODS = 1.8
# A step spans two steps with a missed contact if it is at most this multiple of the usual duration, and its vertical
# oscillates twice with at least this share of the usual amplitude. Pauses have up to 0.3, pairs of steps about 0.4 to
# 0.8 (pauses: ms_indoor, ipol; pairs: oxford with foot switches, tyrex with a swinging hand). The rule is limited to
# walking, with a usual duration above the third value in s, because no ground truth of contacts exists for running.
_TWO_PERIODS, _TWICE_SHARE, _WALKING_S = 2.6, 0.5, 1 / 2.4


@dataclass(frozen=True)
class StepLog:
    """Buffer of signals that describes the step ended by a contact.

    Parameters
    ----------
    rate_hz : float
        Sampling rate of the blocks, Hz.
    latency_s : float
        Longest time from a contact to its detection, s, which determines the length of the buffer.
    max_interval_s : float, default 2
        A new bout begins after a longer time without a contact, s.
    first_step_s : float, default 0.6
        Duration assigned to the first step of a bout, s.

    Examples
    --------
    >>> from pdr_filter.sensing.steps.step_log import StepLog
    >>> log = StepLog(rate_hz=100.0, latency_s=0.5)
    >>> log.starts_bout(log.init(), contact_s=3.0)
    True
    """

    rate_hz: float
    latency_s: float
    max_interval_s: float = 2.0
    first_step_s: float = 0.6

    @cached_property
    def _n_kept(self) -> int:
        """Number of buffered samples: the longest step and the latency."""
        return round(self.latency_s * self.rate_hz) + 1 + int(np.ceil(self.max_interval_s * self.rate_hz))

    def init(self) -> StepLogState:
        """Return the state before the first sample of a segment.

        Returns
        -------
        StepLogState
            Initial state without samples.
        """
        return StepLogState(0, np.empty((6, 0)), -1, -np.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def extend(self, state: StepLogState, block: UniformBlock, attitude: AttitudeBlock) -> StepLogState:
        """Return the state with the samples of a block appended.

        Call it before detecting contacts in the block, and `trim` afterwards.

        Parameters
        ----------
        state : StepLogState
            State after the previous block.
        block : UniformBlock
            Uniform samples that follow, N samples.
        attitude : AttitudeBlock
            Attitude at these samples.

        Returns
        -------
        StepLogState
            New state.
        """
        magnitude = specific_force_magnitude(block.specific_force_mps2)
        unknown_before = state.signals[4, -1] if state.signals.shape[1] else 0.0
        n_before, bias_std = state.signals.shape[1], attitude.yaw_bias_std_radps
        signals = np.empty((len(state.signals), n_before + len(magnitude)))
        signals[:, :n_before], new = state.signals, signals[:, n_before:]
        new[_TIME], new[_MAGNITUDE], new[_VERTICAL] = block.time_s, magnitude, attitude.vertical_mps2
        new[_HEADING] = attitude.device_heading_rad
        new[_UNKNOWN] = unknown_before + np.cumsum(~block.turn_known)
        new[_BIAS_STD] = bias_std if len(bias_std) else 0.0
        return replace_unchecked(state, n_samples=state.n_samples + len(magnitude), signals=signals)

    def trim(self, state: StepLogState) -> StepLogState:
        """Return the state without the signals that no later contact can need.

        Parameters
        ----------
        state : StepLogState
            State with the buffered samples.

        Returns
        -------
        StepLogState
            New state.
        """
        n_since = max(state.n_samples - state.last_contact, 1)  # a step begins at the last contact, or later
        return replace_unchecked(state, signals=state.signals[:, -min(n_since, self._n_kept) :])

    def first_sample(self, state: StepLogState) -> int:
        """Return the number of the oldest buffered sample. Contacts must be later.

        Parameters
        ----------
        state : StepLogState
            State with the buffered samples.

        Returns
        -------
        int
            Sample number in the segment.
        """
        return state.n_samples - state.signals.shape[1]

    def can_end(self, state: StepLogState, contact: int) -> bool:
        """Return True if a step can end at a sample: it is buffered and later than the last contact.

        Parameters
        ----------
        state : StepLogState
            State with the buffered samples.
        contact : int
            Sample number of the contact.

        Returns
        -------
        bool
            True if the contact can end a step.
        """
        return max(self.first_sample(state), state.last_contact, 0) < contact < state.n_samples

    def time_s(self, state: StepLogState, sample: float) -> float:
        """Return the time of a sample; fractional sample numbers are interpolated.

        Parameters
        ----------
        state : StepLogState
            State with the buffered samples.
        sample : float
            Sample number in the segment.

        Returns
        -------
        float
            Time, s.
        """
        whole = floor(sample)
        index = min(max(whole - self.first_sample(state), 0), state.signals.shape[1] - 1)
        return float(state.signals[0, index] + (sample - whole) / self.rate_hz)

    def starts_bout(self, state: StepLogState, contact_s: float) -> bool:
        """Return True if a contact is the first of a bout.

        Parameters
        ----------
        state : StepLogState
            State with the buffered samples.
        contact_s : float
            Time of the contact, s.

        Returns
        -------
        bool
            True if the last contact is more than `max_interval_s` earlier.
        """
        return contact_s - state.last_contact_s > self.max_interval_s

    def add(self, state: StepLogState, contact: int, known: int, fraction: float = 0.0) -> tuple[StepLogState, Step]:
        """Return the new state and the step that a contact ends.

        It combines `end_step` and `describe` for a single step.

        Parameters
        ----------
        state : StepLogState
            State with the buffered samples.
        contact : int
            Sample number of the contact.
        known : int
            Number of the sample that revealed the contact. It may lie beyond the last sample at the end of a segment.
        fraction : float, default 0
            Offset of the contact from the sample, in sampling intervals.

        Returns
        -------
        state : StepLogState
            New state.
        step : Step
            Step that the contact ends.
        """
        state, span = self.end_step(state, contact, known, fraction)
        state, (step,) = self.describe(state, [span])
        return state, step

    def end_step(
        self, state: StepLogState, contact: int, known: int, fraction: float = 0.0
    ) -> tuple[StepLogState, StepSpan]:
        """Return the new state and the span of the step that a contact ends.

        Call `describe` for the span before the next samples are appended.

        Parameters
        ----------
        state : StepLogState
            State with the buffered samples.
        contact : int
            Sample number of the contact, for which `can_end` must be true.
        known : int
            Number of the sample that revealed the contact. It may lie beyond the last sample at the end of a segment.
        fraction : float, default 0
            Offset of the contact from the sample, in sampling intervals.

        Returns
        -------
        state : StepLogState
            New state.
        span : StepSpan
            Time span and samples of the step.
        """
        first = self.first_sample(state)
        contact_s = float(state.signals[_TIME, contact - first] + fraction / self.rate_hz)
        is_first = self.starts_bout(state, contact_s)
        duration_s = self.first_step_s if is_first else contact_s - state.last_contact_s
        start = contact - round(duration_s * self.rate_hz) if is_first else state.last_contact
        unknown = float(state.signals[_UNKNOWN, contact - first])
        span = StepSpan(
            contact_s=contact_s,
            known_s=float(state.signals[_TIME, min(known - first, state.signals.shape[1] - 1)]),
            duration_s=duration_s,
            heading_unknown_s=(unknown - state.last_unknown) / self.rate_hz,
            columns=(max(start - first, 0), contact - first),
            is_first=is_first,
        )
        return replace_unchecked(state, last_contact=contact, last_contact_s=contact_s, last_unknown=unknown), span

    def describe(self, state: StepLogState, spans: Sequence[StepSpan]) -> tuple[StepLogState, list[Step]]:
        """Return the new state and the steps of some spans.

        Besides the statistics of its own samples, each step receives quantities that depend on earlier steps: the turn
        rate over two steps, the mean amplitude of a stride, and the usual amplitude and duration of the person. The
        usual amplitude includes the step itself.

        Parameters
        ----------
        state : StepLogState
            State with the buffered samples.
        spans : sequence of StepSpan
            Spans from `end_step`, in the order of time.

        Returns
        -------
        state : StepLogState
            New state.
        steps : list of Step
            One step for each span.
        """
        steps: list[Step] = []
        turn_rad, before_s, before_mps2 = state.last_turn_rad, state.last_duration_s, state.last_amplitude_mps2
        n_usual, log_amplitudes, log_durations = state.n_usual, state.log_amplitudes, state.log_durations
        for span, step in zip(spans, describe_steps(state.signals, spans), strict=True):
            if span.is_first:
                turn_rad, before_s = 0.0, 0.0
            # Body and arm sway with the period of a stride. The sum over two steps cancels the sway, so that only the
            # turn of the pedestrian remains.
            turn_rate_radps = abs(step.heading_change_rad + turn_rad) / (step.duration_s + before_s)
            turn_rad, before_s = step.heading_change_rad, step.duration_s
            usual_s = exp(log_durations / n_usual) if n_usual > 0 else inf
            is_long = span.is_first or step.duration_s > _REST_PERIODS * usual_s
            is_two = False
            if is_long and not span.is_first and usual_s > _WALKING_S and step.duration_s < _TWO_PERIODS * usual_s:
                vertical = state.signals[_VERTICAL, slice(*span.columns)]
                is_two = amplitude(vertical, 2) > _TWICE_SHARE * exp(log_amplitudes / n_usual)
            if not is_long:
                n_usual = USUAL_DECAY * n_usual + 1.0
                log_amplitudes = USUAL_DECAY * log_amplitudes + log(max(step.vertical_amplitude_mps2, 0.05))
                log_durations = USUAL_DECAY * log_durations + log(step.duration_s)
            usual_mps2 = exp(log_amplitudes / n_usual) if n_usual > 0 else 0.0
            own_mps2 = step.vertical_amplitude_mps2
            continues_walk = before_mps2 > 0 and not is_long
            steps.append(
                replace_unchecked(
                    step,
                    turn_rate_radps=turn_rate_radps,
                    stride_amplitude_mps2=0.5 * (before_mps2 + own_mps2) if continues_walk else own_mps2,
                    usual_amplitude_mps2=usual_mps2,
                    usual_duration_s=usual_s if usual_s < inf else 0.0,
                    from_rest=is_long and not is_two,
                    is_two=is_two,
                )
            )
            before_mps2 = 0.0 if is_long else own_mps2
        state = replace_unchecked(
            state,
            last_turn_rad=turn_rad,
            last_duration_s=before_s,
            last_amplitude_mps2=before_mps2,
            n_usual=n_usual,
            log_amplitudes=log_amplitudes,
            log_durations=log_durations,
        )
        return state, steps


# Steps that are described together, so that their samples fit into the processor's cache.
_MAX_GROUP = 32


def describe_steps(signals: FloatArray, spans: Sequence[StepSpan]) -> list[Step]:
    """Return the steps of some spans with the statistics of their own samples in signals (6, H) of a `StepLogState`.

    Each step has the same bits as if it were computed alone.
    """
    if len(spans) > _MAX_GROUP:
        parts = (spans[i : i + _MAX_GROUP] for i in range(0, len(spans), _MAX_GROUP))
        return [step for part in parts for step in describe_steps(signals, part)]
    if not spans:
        return []
    samples = np.concatenate([signals[: _HEADING + 1, slice(*span.columns)] for span in spans], axis=1)
    n = np.array([span.columns[1] - span.columns[0] for span in spans])
    starts = np.cumsum(n) - n
    magnitude = samples[_MAGNITUDE]
    extremes = (f.reduceat(samples[_MAGNITUDE : _VERTICAL + 1], starts, axis=1) for f in (np.maximum, np.minimum))
    deviation = magnitude - np.repeat(np.add.reduceat(magnitude, starts) / n, n)
    sums = np.stack([deviation * deviation, np.abs(magnitude - STANDARD_GRAVITY_MPS2), samples[_HEADING]])
    figures = np.concatenate([*extremes, np.add.reduceat(sums, starts, axis=1) / n]).T.tolist()
    steps: list[Step] = []
    for span, step_figures in zip(spans, figures, strict=True):
        magnitude_max, vertical_max, magnitude_min, vertical_min, variance, mean_abs, heading_rad = step_figures
        first, contact = span.columns
        steps.append(
            Step(
                time_s=span.contact_s,
                detected_time_s=span.known_s,
                duration_s=span.duration_s,
                frequency_hz=1.0 / span.duration_s,
                variance=variance,
                vertical_max_mps2=vertical_max,
                vertical_min_mps2=vertical_min,
                magnitude_max_mps2=magnitude_max,
                magnitude_min_mps2=magnitude_min,
                mean_abs_mps2=mean_abs,
                heading_change_rad=float(signals[_HEADING, contact - 1] - signals[_HEADING, first]),
                device_heading_rad=heading_rad,
                heading_unknown_s=span.heading_unknown_s,
                yaw_bias_std_radps=float(signals[_BIAS_STD, contact - 1]),
                vertical_amplitude_mps2=amplitude(signals[_VERTICAL, first:contact]),
            )
        )
    return steps


def amplitude(values: FloatArray, periods: int = 1) -> float:
    """Return the amplitude of the sinusoid with m periods in n values x (n,): 2 / n |sum x_k exp(-2 pi i m k / n)|."""
    cosine, sine = (values @ _periods(len(values), periods)).tolist()
    return 2 / len(values) * hypot(cosine, sine)


@lru_cache(maxsize=512)
def _periods(n: int, periods: int) -> FloatArray:
    """Return the cosine and sine (n, 2) with the given number of periods in n samples, with their means removed.

    For a single sample they are zero, so its amplitude is zero.
    """
    phase = 2 * np.pi * periods * np.arange(n) / n
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=1)
    return waves - waves.mean(axis=0)


def specific_force_magnitude(specific_force_mps2: FloatArray) -> FloatArray:
    """Return the magnitude of the specific force (Martinelli et al. 2018, eq. 1).

    Parameters
    ----------
    specific_force_mps2 : (N, 3) array
        Specific force in any frame, m/s2.

    Returns
    -------
    (N,) array
        Magnitude, m/s2.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.sensing.steps.step_log import specific_force_magnitude
    >>> specific_force_magnitude(np.array([[3.0, 4.0, 0.0]]))
    array([5.])
    """
    x, y, z = specific_force_mps2.T
    return np.sqrt(x * x + y * y + z * z)
