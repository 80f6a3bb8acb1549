"""Steps as local maxima of a wavelet transform whose scale follows the power of the motion: the default detector.

People step faster where they step harder, whoever walks and wherever the phone is: f = 1.43 R^0.31 within 11 %, R the
rms of |specific force| around the step, m/s2, f in Hz (tests/benchmarks/steps.py).

1. R(t): standard deviation of the low-passed |f| from `before_s` before to `after_s` after t.
2. Response: transform of |f| with the Mexican hat of frequency 1.37 R(t)^0.3, interpolated between a bank of hats, each
   low-passed and cut off at `after_s`. It has unit gain at its frequency.
3. A local maximum is a step if it reaches `min_peak_mps2` and `relative_peak` times R, and comes `min_interval`
   periods 1 / f or more after the last step. Where it comes when the rhythm of the last steps expects it,
   `rhythm_share` of both thresholds is enough.

Reasons and figures: docs/methods/steps.md. Source of the transform: Martinelli et al. 2018, section IV.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.filters import low_pass_kernel, with_unit_gain
from pdr_filter.sensing.steps.detector import (
    ContextBlock,
    ResponseState,
    ResponseStepDetector,
    specific_force_magnitude,
)
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray

# Frequencies of the bank, a factor of 1.15 apart: 0.6 to 4.9 Hz. Power shows no lower and no higher ones.
_BANK_HZ: FloatArray = np.asarray(0.6 * 1.15 ** np.arange(16), dtype=float)


@dataclass(frozen=True, slots=True)
class Rhythm:
    """The last steps of the bout."""

    period_s: float  # running mean of their intervals
    n_intervals: int


@dataclass(frozen=True, slots=True, eq=False)
class AdaptiveDetectorState(ResponseState):
    """The last |f| less gravity, the last values of the transform and of R, and the last intervals."""

    rhythm: Rhythm


@dataclass(frozen=True)
class AdaptiveStepDetector(ResponseStepDetector[AdaptiveDetectorState]):
    """Causal step detector; a step is reported `latency_s`, 0.88 s, after its contact.

    Parameters
    ----------
    frequency_at_1_mps2_hz, frequency_exponent : float
        Step frequency where R is 1 m/s2, and its power of R; see the module.
    before_s, after_s : float
        What R is taken over: about three steps, the one in question in the middle. `after_s` is also half the length of
        the longest hat.
    power_low_pass_hz, low_pass_hz : float
        Cutoffs (Hamming window, 0.25 s) before R and in the response.
    min_peak_mps2 : float
        Smallest response that is a step outside a rhythm.
    relative_peak : float
        A step of a walk must also reach this part of R; a sine has 1.4.
    rhythm_share : float
        Part of both thresholds that a peak needs when it is expected.
    rhythm_tolerance : float
        It is expected if the logarithm of interval over period is within this, after two or more intervals.
    min_interval : float
        Smallest interval in periods of the wavelet. Heel strike and push-off are closer.
    min_running_interval : float
        The same from `running_hz` on: there a step is one blow, and R shows less of the frequency.
    running_hz : float
        Wavelet frequency of a run, or of the hardest walking (R = 3.5 m/s2).
    rate_hz, max_interval_s, first_step_s : float
        Of every `StepDetector`; the slowest steps, 0.5 Hz, are 2 s apart.
    """

    max_interval_s: float = 2.5
    frequency_at_1_mps2_hz: float = 1.37
    frequency_exponent: float = 0.3
    before_s: float = 1.0
    after_s: float = 0.75
    power_low_pass_hz: float = 5.5
    low_pass_hz: float = 4.0
    min_peak_mps2: float = 0.15
    relative_peak: float = 0.3
    rhythm_share: float = 1 / 3
    rhythm_tolerance: float = 0.25
    min_interval: float = 0.6
    min_running_interval: float = 0.35
    running_hz: float = 2.0

    @cached_property
    def _bank(self) -> tuple[FloatArray, ...]:
        return tuple(bounce_kernel(f, self.low_pass_hz, self.after_s, self.rate_hz) for f in _BANK_HZ)

    @cached_property
    def _bank_rms_mps2(self) -> FloatArray:
        """R at which each member of the bank responds alone."""
        return (_BANK_HZ / self.frequency_at_1_mps2_hz) ** (1.0 / self.frequency_exponent)

    @cached_property
    def _power_low_pass(self) -> FloatArray:
        return low_pass_kernel(self.power_low_pass_hz, self.rate_hz)

    @property
    def _n_before(self) -> int:
        """Samples before a contact that enter."""
        return round(self.before_s * self.rate_hz) + len(self._power_low_pass) // 2

    @property
    def _delay_samples(self) -> int:
        """Samples after a contact that enter."""
        return round(self.after_s * self.rate_hz) + len(self._power_low_pass) // 2

    @property
    def _min_response(self) -> float:
        return self.rhythm_share * self.min_peak_mps2

    def init(self) -> AdaptiveDetectorState:
        """State before the first sample of a segment."""
        return AdaptiveDetectorState(self._log.init(), np.empty((1, 0)), np.zeros((2, 2)), Rhythm(0.0, 0))

    @property
    def _n_line(self) -> int:
        return self._n_before + self._delay_samples

    def _signals(
        self, state: AdaptiveDetectorState, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[AdaptiveDetectorState, FloatArray]:
        """|f| less gravity, (1, N)."""
        return state, specific_force_magnitude(block.specific_force_mps2)[None] - STANDARD_GRAVITY_MPS2

    # Every value below is a dot product of the kernel's length, so cutting the signal elsewhere changes no bit.

    def _response(self, line: FloatArray) -> FloatArray:
        rms = self._rms(line[0])
        return np.stack([self._transform(line[0], rms), rms])

    def _rms(self, line: FloatArray) -> FloatArray:
        """R at each sample that has enough samples around it."""
        smooth = np.convolve(line, self._power_low_pass, mode="valid")
        n = round(self.before_s * self.rate_hz) + round(self.after_s * self.rate_hz) + 1
        box = np.full(n, 1.0 / n)
        mean = np.convolve(smooth, box, mode="valid")
        return np.sqrt(np.maximum(np.convolve(smooth * smooth, box, mode="valid") - mean * mean, 0.0))

    def _transform(self, line: FloatArray, rms: FloatArray) -> FloatArray:
        """Transform at the scale that R asks for, between two members of the bank."""
        place = np.interp(rms, self._bank_rms_mps2, np.arange(len(_BANK_HZ), dtype=float))
        lower = np.minimum(place.astype(int), len(_BANK_HZ) - 2)
        upper_share = place - lower
        response: FloatArray = np.zeros(len(rms))
        for k in np.unique(np.concatenate([lower, lower + 1])):
            kernel = self._bank[k]
            half = len(kernel) // 2
            first = self._n_before - half
            part = line[first : first + len(rms) + 2 * half]
            share: FloatArray = np.where(lower == k, 1.0 - upper_share, np.where(lower == k - 1, upper_share, 0.0))
            response = np.add(response, share * np.convolve(part, kernel, mode="valid"), dtype=float)
        return response

    def _accepted(
        self, state: AdaptiveDetectorState, peak: FloatArray, interval_s: float, new_bout: bool
    ) -> AdaptiveDetectorState | None:
        response, rms = peak.tolist()
        rhythm = Rhythm(0.0, 0) if new_bout else state.rhythm
        share = self.rhythm_share if self._is_expected(rhythm, interval_s) else 1.0
        relative = self.relative_peak * rms if self._frequency_hz(rms) < self.running_hz else 0.0
        if response < share * max(self.min_peak_mps2, relative):
            return None
        if interval_s < self._min_interval_s(rms):
            return None
        return replace(state, rhythm=_with_step(rhythm, interval_s, new_bout))

    def _is_expected(self, rhythm: Rhythm, interval_s: float) -> bool:
        if rhythm.n_intervals < 2 or interval_s <= 0:
            return False
        return abs(math.log(interval_s / rhythm.period_s)) < self.rhythm_tolerance

    def _frequency_hz(self, rms: float) -> float:
        """Frequency of the wavelet."""
        frequency_hz = self.frequency_at_1_mps2_hz * rms**self.frequency_exponent
        return min(max(frequency_hz, _BANK_HZ[0]), _BANK_HZ[-1])

    def _min_interval_s(self, rms: float) -> float:
        frequency_hz = self._frequency_hz(rms)
        periods = self.min_running_interval if frequency_hz >= self.running_hz else self.min_interval
        return periods / frequency_hz


def _with_step(rhythm: Rhythm, interval_s: float, new_bout: bool) -> Rhythm:
    if new_bout:
        return Rhythm(0.0, 0)
    period_s = 0.7 * rhythm.period_s + 0.3 * interval_s if rhythm.n_intervals else interval_s
    return Rhythm(period_s, rhythm.n_intervals + 1)


def bounce_kernel(frequency_hz: float, low_pass_hz: float, max_half_s: float, rate_hz: float) -> FloatArray:
    """Low-passed Mexican hat: symmetric, odd length, zero mean, unit gain at its frequency.

    The hat (1 - u^2) exp(-u^2 / 2), u = t / s, has s = 1 / (4 f), a quarter of a step, and ends at 3.5 s (1 % of its
    peak is left there) or at `max_half_s`.
    """
    half = round(min(3.5 * 0.25 / frequency_hz, max_half_s) * rate_hz)
    u = np.arange(-half, half + 1) / (rate_hz * (0.25 / frequency_hz))
    hat = (1.0 - u * u) * np.exp(-0.5 * u * u)
    kernel = np.convolve(np.asarray(hat - hat.mean(), dtype=float), low_pass_kernel(low_pass_hz, rate_hz))
    return with_unit_gain(kernel, frequency_hz, rate_hz)
