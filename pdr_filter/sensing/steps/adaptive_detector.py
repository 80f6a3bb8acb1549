"""Steps as local maxima of a wavelet transform whose scale follows the power of the motion: the default detector.

People step faster where they step harder, whoever walks and wherever the phone is: f = 1.43 R^0.31 within 11 %, R the
rms of |specific force| around the step, m/s2, f in Hz (a regression over 106 recordings of ubicomp13, oxford and of
runs of motionsense, each with the same weight).

1. R(t): standard deviation of the low-passed |f| from `before_s` before to `after_s` after t. The hat's frequency is
   1.37 R(t)^0.3. Soft running breaks that law, by 0.6, but there |f| is nearly one sine, whose frequency shows: with
   the rms R, R' and R'' of |f| and its derivatives it is f_1 = R' / (2 pi R), and f_2 = R'' / (2 pi R') is alike. Where
   f_2 < `sine_ratio` f_1 and f_1 < `max_sine_hz` the hat's frequency is `sine_share` f_1 at least.
2. Response: transform of |f| with the Mexican hat of that frequency, interpolated between a bank of hats, each
   low-passed and cut off at `after_s`. It has unit gain at its frequency.
3. A local maximum is a step if it reaches `min_peak_mps2` and `relative_peak` times R, and comes `min_interval`
   periods 1 / f or more after the last step. Where it comes when the rhythm of the last steps expects it,
   `rhythm_share` of both thresholds is enough.

Reasons: docs/methods/steps.md; figures: docs/benchmarks.md. Source of the transform: Martinelli et al. 2018,
section IV.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import ClassVar

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.signal_filters import low_pass_kernel, running_sums, with_unit_gain
from pdr_filter.sensing.steps.step_detector import ContextBlock, ResponseState, ResponseStepDetector
from pdr_filter.sensing.steps.step_log import specific_force_magnitude
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, read_only, replace_unchecked

# Frequencies of the bank, a factor of 1.15 apart: 0.6 to 4.9 Hz. Power shows no lower and no higher ones.
_BANK_HZ: FloatArray = np.asarray(0.6 * 1.15 ** np.arange(16), dtype=float)


@dataclass(frozen=True, slots=True)
class Rhythm:
    """The last steps of the bout."""

    period_s: float  # running mean of their intervals
    n_intervals: int


@dataclass(frozen=True, eq=False)
class AdaptiveDetectorState(ResponseState):
    """The last |f| less gravity, the last values of transform, R and frequency, and the last intervals."""

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
    sine_ratio, sine_share, max_sine_hz : float
        Where |f| is one sine of the steps, see the module. In walking f_1 is 1.0 to 1.2 steps a second there, so that
        with this share of it the hat follows the power as before. Faster sines are the two humps of a walking step on
        somebody's back.
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
        Of every `BaseStepDetector`; the slowest steps, 0.5 Hz, are 2 s apart.
    """

    uses_contexts: ClassVar[bool] = False

    max_interval_s: float = 2.5
    frequency_at_1_mps2_hz: float = 1.37
    frequency_exponent: float = 0.3
    before_s: float = 1.0
    after_s: float = 0.75
    sine_ratio: float = 1.12
    sine_share: float = 0.8
    max_sine_hz: float = 2.9
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
    def _power_low_pass(self) -> FloatArray:
        return low_pass_kernel(self.power_low_pass_hz, self.rate_hz)

    @cached_property
    def _derivatives(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Low-pass, and low-pass with one and two derivatives, each as long as that before R with zeros at the ends."""
        slope = np.array([0.5, 0.0, -0.5]) * self.rate_hz
        smooth = low_pass_kernel(self.low_pass_hz, self.rate_hz, 0.25 - 4 / self.rate_hz)
        first: FloatArray = np.asarray(np.convolve(smooth, slope), dtype=float)
        return np.pad(smooth, 2), np.pad(first, 1), np.asarray(np.convolve(first, slope), dtype=float)

    @cached_property
    def _n_before(self) -> int:
        """Samples before a contact that enter."""
        return round(self.before_s * self.rate_hz) + len(self._power_low_pass) // 2

    @property
    def _delay_samples(self) -> int:
        """Samples after a contact that enter."""
        return self._n_after

    @cached_property
    def _n_after(self) -> int:
        return round(self.after_s * self.rate_hz) + len(self._power_low_pass) // 2

    @property
    def _min_response(self) -> float:
        return self.rhythm_share * self.min_peak_mps2

    def init(self) -> AdaptiveDetectorState:
        """State before the first sample of a segment."""
        return AdaptiveDetectorState(self._log.init(), np.zeros((1, self._n_line)), np.zeros((3, 2)), Rhythm(0.0, 0))

    @property
    def _n_line(self) -> int:
        return self._n_before + self._delay_samples

    def _signals(
        self, state: AdaptiveDetectorState, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[AdaptiveDetectorState, FloatArray]:
        """|f| less gravity, (1, N)."""
        return state, specific_force_magnitude(block.specific_force_mps2)[None] - STANDARD_GRAVITY_MPS2

    # Every value below is a sum over the samples around in a fixed order: cutting the signal elsewhere changes no bit.

    def _response(self, line: FloatArray) -> FloatArray:
        rms, *of_sine = self._rms(line[0], (self._power_low_pass, *self._derivatives))
        frequency_hz = np.maximum(self.frequency_at_1_mps2_hz * rms**self.frequency_exponent, _BANK_HZ[0])
        frequency_hz = np.maximum(np.minimum(frequency_hz, _BANK_HZ[-1]), self._sine_hz(*of_sine))
        return np.array([self._transform(line[0], frequency_hz), rms, frequency_hz])

    @cached_property
    def _n_around(self) -> int:
        """Samples that R is taken over."""
        return round(self.before_s * self.rate_hz) + round(self.after_s * self.rate_hz) + 1

    def _rms(self, line: FloatArray, kernels: Sequence[FloatArray]) -> FloatArray:
        """Standard deviations (K, N) of the filtered signal around each sample that has enough samples around it."""
        smooth = np.array([np.convolve(line, kernel, mode="valid") for kernel in kernels])
        mean, square = running_sums(np.array([smooth, smooth * smooth]), self._n_around) / self._n_around
        return np.sqrt(np.maximum(square - mean * mean, 0.0))

    def _sine_hz(self, position: FloatArray, speed: FloatArray, acceleration: FloatArray) -> FloatArray:
        """What the hat's frequency is at least, by the rms of |f| and its derivatives; 0 where |f| is no sine."""
        position, speed = np.maximum(position, 1e-9), np.maximum(speed, 1e-9)
        frequency_hz = speed / (2 * np.pi * position)
        is_sine = acceleration / (2 * np.pi * speed) < self.sine_ratio * frequency_hz
        return np.where(is_sine & (frequency_hz < self.max_sine_hz), self.sine_share * frequency_hz, 0.0)

    def _transform(self, line: FloatArray, frequency_hz: FloatArray) -> FloatArray:
        """Transform at a frequency for each sample, between two members of the bank."""
        place = np.interp(frequency_hz, _BANK_HZ, np.arange(len(_BANK_HZ), dtype=float))
        lower = np.minimum(place.astype(int), len(_BANK_HZ) - 2)
        upper_share = place - lower
        response: FloatArray = np.zeros(len(frequency_hz))
        n_uses = np.bincount(lower, minlength=len(_BANK_HZ)) + np.bincount(lower + 1, minlength=len(_BANK_HZ))
        for k in n_uses.nonzero()[0].tolist():
            kernel = self._bank[k]
            half = len(kernel) // 2
            first = self._n_before - half
            part = line[first : first + len(frequency_hz) + 2 * half]
            share: FloatArray = np.where(lower == k, 1.0 - upper_share, np.where(lower == k - 1, upper_share, 0.0))
            response = np.add(response, share * np.convolve(part, kernel, mode="valid"), dtype=float)
        return response

    def _accepted(
        self, state: AdaptiveDetectorState, peak: FloatArray, interval_s: float, new_bout: bool
    ) -> AdaptiveDetectorState | None:
        response, rms, frequency_hz = peak.tolist()
        rhythm = Rhythm(0.0, 0) if new_bout else state.rhythm
        share = self.rhythm_share if self._is_expected(rhythm, interval_s) else 1.0
        relative = self.relative_peak * rms if frequency_hz < self.running_hz else 0.0
        if response < share * max(self.min_peak_mps2, relative):
            return None
        periods = self.min_running_interval if frequency_hz >= self.running_hz else self.min_interval
        if interval_s < periods / frequency_hz:
            return None
        return replace_unchecked(state, rhythm=_with_step(rhythm, interval_s, new_bout))

    def _is_expected(self, rhythm: Rhythm, interval_s: float) -> bool:
        if rhythm.n_intervals < 2 or interval_s <= 0:
            return False
        return abs(math.log(interval_s / rhythm.period_s)) < self.rhythm_tolerance


def _with_step(rhythm: Rhythm, interval_s: float, new_bout: bool) -> Rhythm:
    if new_bout:
        return Rhythm(0.0, 0)
    period_s = 0.7 * rhythm.period_s + 0.3 * interval_s if rhythm.n_intervals else interval_s
    return Rhythm(period_s, rhythm.n_intervals + 1)


@lru_cache
def bounce_kernel(frequency_hz: float, low_pass_hz: float, max_half_s: float, rate_hz: float) -> FloatArray:
    """Low-passed Mexican hat: symmetric, odd length, zero mean, unit gain at its frequency.

    The hat (1 - u^2) exp(-u^2 / 2), u = t / s, has s = 1 / (4 f), a quarter of a step, and ends at 3.5 s (1 % of its
    peak is left there) or at `max_half_s`.
    """
    half = round(min(3.5 * 0.25 / frequency_hz, max_half_s) * rate_hz)
    u = np.arange(-half, half + 1) / (rate_hz * (0.25 / frequency_hz))
    hat = (1.0 - u * u) * np.exp(-0.5 * u * u)
    kernel = np.convolve(np.asarray(hat - hat.mean(), dtype=float), low_pass_kernel(low_pass_hz, rate_hz))
    return read_only(with_unit_gain(kernel, frequency_hz, rate_hz))
