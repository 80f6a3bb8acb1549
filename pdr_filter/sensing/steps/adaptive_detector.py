"""Step detector with a wavelet whose scale follows the power of the motion: the default detector.

Pedestrians step faster when they step harder, for all persons and phone places: f = 1.43 R^0.31 within 11 %. Here f is
the step frequency in Hz, and R the rms of |specific force| around the step in m/s2. The law is a regression over 106
recordings of ubicomp13, oxford and of runs of motionsense, each with the same weight. The other parameters were chosen
by the step counts of ubicomp13.

1. R(t) is the standard deviation of the low-passed |f| from `before_s` before to `after_s` after t. The frequency of
   the wavelet is 1.37 R(t)^0.3. Soft running deviates from the law by a factor of 0.6. There |f| is nearly a sine,
   whose frequency can be measured: with the rms values R, R' and R'' of |f| and its derivatives it is
   f_1 = R' / (2 pi R), and for a sine it equals f_2 = R'' / (2 pi R'). Where f_2 < `sine_ratio` f_1 and
   f_1 < `max_sine_hz`, the frequency of the wavelet is at least `sine_share` f_1.
2. The response is the transform of |f| with the Mexican hat wavelet of this frequency, interpolated between a bank of
   such wavelets. Each wavelet is low-passed, ends at `after_s` and has unit gain at its frequency.
3. A local maximum is a step if it reaches `min_peak_mps2` and `relative_peak` times R, and follows the last step by at
   least `min_interval` periods 1 / f. If the rhythm of the last steps predicts a step at this time, `rhythm_share` of
   both thresholds is sufficient.

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

# Frequencies of the wavelet bank, a factor of 1.15 apart: 0.6 to 4.9 Hz. R never maps to frequencies outside.
_BANK_HZ: FloatArray = np.asarray(0.6 * 1.15 ** np.arange(16), dtype=float)


@dataclass(frozen=True, slots=True)
class Rhythm:
    """Rhythm of the last steps of a bout."""

    period_s: float  # running mean of the step intervals, s
    n_intervals: int  # intervals so far


@dataclass(frozen=True, eq=False)
class AdaptiveDetectorState(ResponseState):
    """State of the adaptive detector.

    The signal in `line` is |f| minus gravity, with the specific force f in m/s2. The rows of `response` are the wavelet
    transform, the power R of the motion (standard deviation of the low-passed |f| around each sample, m/s2), and the
    wavelet frequency in Hz.
    """

    rhythm: Rhythm


@dataclass(frozen=True)
class AdaptiveStepDetector(ResponseStepDetector[AdaptiveDetectorState]):
    """Causal step detector with a wavelet whose scale adapts to the power of the motion.

    A step is reported `latency_s` (0.88 s) after its contact. It is the step detector of the default recipe.

    Parameters
    ----------
    rate_hz : float, default 100
        Sampling rate of the blocks, Hz.
    max_interval_s : float, default 2.5
        A new bout begins after a longer time without a contact, s. The slowest steps, at 0.5 Hz, are 2 s apart.
    first_step_s : float, default 0.6
        Duration assigned to the first step of a bout, s.
    frequency_at_1_mps2_hz, frequency_exponent : float, default 1.37 and 0.3
        Wavelet frequency at R = 1 m/s2, Hz, and its exponent of R. The regression has 1.43 Hz and 0.31; the lower
        frequency merges heel strike and push-off more reliably.
    before_s, after_s : float, default 1 and 0.75
        Time before and after a sample over which R is computed, s. It covers about three steps. With 1.5 s before, the
        count of steps is 0.2 % worse. `after_s` is also half the length of the longest wavelet.
    sine_ratio, sine_share, max_sine_hz : float, default 1.12, 0.8 and 2.9
        Conditions under which the motion counts as a sine, and the resulting lower limit of the wavelet frequency.
        Lower values of `sine_ratio` or `max_sine_hz` lose soft running. Higher values worsen the count of ubicomp13
        and ms_indoor.
        While walking, f_1 of a sine is 1.0 to 1.2 times the step frequency, so that with this share the wavelet follows
        the power as before. Faster sines are the two maxima within a walking step of a phone on the back.
    power_low_pass_hz, low_pass_hz : float, default 5.5 and 4
        Cutoff frequencies of the low-passes (Hamming window, 0.25 s) before R and in the response, Hz.
    min_peak_mps2 : float, default 0.15
        Smallest response of a step outside a rhythm, m/s2. 0.2 loses steps of slow walkers, and 0.12 accepts taps on
        the phone.
    relative_peak : float, default 0.3
        Smallest response of a walking step relative to R. A sine has 1.4. Values from 0.2 to 0.3 give the same count.
    rhythm_share : float, default 1/3
        Factor of both thresholds for an expected maximum. Without it the count is 0.1 % worse.
    rhythm_tolerance : float, default 0.25
        A maximum is expected if the logarithm of its interval over the period is within this limit, after at least two
        intervals.
    min_interval : float, default 0.6
        Shortest interval in periods of the wavelet. Heel strike and push-off of one step are closer together. Values
        from 0.5 to 0.7 give the same count.
    min_running_interval : float, default 0.35
        Shortest interval for a wavelet frequency of `running_hz` and above. A running step has a single impact, and R
        determines the frequency less well.
    running_hz : float, default 2
        Wavelet frequency from which the motion is running, or the hardest walking (R = 3.5 m/s2), Hz.

    Raises
    ------
    ValueError
        If a parameter is not a positive number.

    Notes
    -----
    |f| is the magnitude of the specific force. R(t) is the standard deviation of the low-passed |f| from `before_s`
    before to `after_s` after t, and R' and R'' are those of its derivatives. The frequency of the wavelet, a Mexican
    hat, is f = 1.37 R^0.3. If |f| is nearly a sine, f is at least `sine_share` f_1, with f_1 = R' / (2 pi R). |f|
    counts as a sine if f_2 = R'' / (2 pi R') is less than `sine_ratio` f_1, and f_1 is less than `max_sine_hz`. A local
    maximum of the wavelet transform is a step if it reaches `min_peak_mps2` and `relative_peak` R, and follows the last
    step by at least `min_interval` / f. The docstring of the module has the derivation of the constants. Source of the
    transform: Martinelli et al. 2018, section IV.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.sensing.steps.adaptive_detector import AdaptiveStepDetector
    >>> recording = pdr.simulate.simulate([pdr.simulate.Leg("walking", duration_s=8.0)])
    >>> config = pdr.recipes.default().with_steps(AdaptiveStepDetector(min_peak_mps2=0.2))
    >>> steps = pdr.detect_steps(recording, config)
    >>> abs(len(steps) - len(recording.truth.steps)) <= 1
    True
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
        """Three filter kernels (L,): for the low-passed signal, its first derivative and its second derivative in time.

        They have the length of `_power_low_pass`, the low-pass of |f| before its standard deviation R is computed, so
        that all filtered signals have the same samples. The ends are filled with zeros.
        """
        slope = np.array([0.5, 0.0, -0.5]) * self.rate_hz
        smooth = low_pass_kernel(self.low_pass_hz, self.rate_hz, 0.25 - 4 / self.rate_hz)
        first: FloatArray = np.asarray(np.convolve(smooth, slope), dtype=float)
        return np.pad(smooth, 2), np.pad(first, 1), np.asarray(np.convolve(first, slope), dtype=float)

    @cached_property
    def _n_before(self) -> int:
        """Number of samples before a contact that are needed to compute the response (`_response`) at the contact."""
        return round(self.before_s * self.rate_hz) + len(self._power_low_pass) // 2

    @property
    def _delay_samples(self) -> int:
        """Delay of the response in samples: the number of samples after a contact that are needed to compute it there.

        The response is the wavelet transform of |f| at the frequency that R determines (`_response`). Its local maxima
        are the steps. The samples are the number in `after_s`, plus half the length of the low-pass before R.
        """
        return self._n_after

    @cached_property
    def _n_after(self) -> int:
        return round(self.after_s * self.rate_hz) + len(self._power_low_pass) // 2

    @property
    def _min_response(self) -> float:
        return self.rhythm_share * self.min_peak_mps2

    def init(self) -> AdaptiveDetectorState:
        return AdaptiveDetectorState(self._log.init(), np.zeros((1, self._n_line)), np.zeros((3, 2)), Rhythm(0.0, 0))

    @property
    def _n_line(self) -> int:
        return self._n_before + self._delay_samples

    def _signals(
        self, state: AdaptiveDetectorState, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[AdaptiveDetectorState, FloatArray]:
        """Return the unchanged state, and the magnitude of the specific force minus gravity (1, N), in m/s2."""
        return state, specific_force_magnitude(block.specific_force_mps2)[None] - STANDARD_GRAVITY_MPS2

    # Each value below is a sum over neighbouring samples in a fixed order, so that its bits do not depend on where the
    # signal is cut into blocks.

    def _response(self, line: FloatArray) -> FloatArray:
        """Return the wavelet transform, the standard deviation R and the wavelet frequency, (3, N).

        R, in m/s2, is the standard deviation of the magnitude of the specific force over about three steps. The
        frequency is in Hz.
        """
        rms, *derivative_rms = self._rms(line[0], (self._power_low_pass, *self._derivatives))
        frequency_hz = np.maximum(self.frequency_at_1_mps2_hz * rms**self.frequency_exponent, _BANK_HZ[0])
        frequency_hz = np.maximum(np.minimum(frequency_hz, _BANK_HZ[-1]), self._sine_hz(*derivative_rms))
        return np.array([self._transform(line[0], frequency_hz), rms, frequency_hz])

    @cached_property
    def _n_around(self) -> int:
        """Number of samples over which the standard deviation of the specific-force magnitude is computed."""
        return round(self.before_s * self.rate_hz) + round(self.after_s * self.rate_hz) + 1

    def _rms(self, line: FloatArray, kernels: Sequence[FloatArray]) -> FloatArray:
        """Return the standard deviations (K, N) of the signal after each of K filter kernels, around each sample.

        Only samples with enough neighbours on both sides are included.
        """
        smooth = np.array([np.correlate(line, kernel[::-1]) for kernel in kernels])
        mean, square = running_sums(np.array([smooth, smooth * smooth]), self._n_around) / self._n_around
        return np.sqrt(np.maximum(square - mean * mean, 0.0))

    def _sine_hz(self, rms: FloatArray, rms_first: FloatArray, rms_second: FloatArray) -> FloatArray:
        """Return the lower limit of the wavelet frequency (N,), Hz, or 0 where the motion is not a sine.

        The arguments are the rms values (N,) of the specific-force magnitude and of its first two time derivatives.
        """
        rms, rms_first = np.maximum(rms, 1e-9), np.maximum(rms_first, 1e-9)
        frequency_hz = rms_first / (2 * np.pi * rms)
        is_sine = rms_second / (2 * np.pi * rms_first) < self.sine_ratio * frequency_hz
        return np.where(is_sine & (frequency_hz < self.max_sine_hz), self.sine_share * frequency_hz, 0.0)

    def _transform(self, line: FloatArray, frequency_hz: FloatArray) -> FloatArray:
        """Return the wavelet transform (N,) at the wavelet frequency of each sample.

        It is interpolated between the transforms at the fixed frequencies of the filter bank.
        """
        place = np.interp(frequency_hz, _BANK_HZ, np.arange(len(_BANK_HZ), dtype=float))
        lower = np.minimum(place.astype(int), len(_BANK_HZ) - 2)
        upper_share, used, n = place - lower, set(lower.tolist()), len(frequency_hz)
        transforms = np.empty((len(_BANK_HZ), n))
        for k in used | {k + 1 for k in used}:
            kernel = self._bank[k]
            half = len(kernel) // 2
            first = self._n_before - half
            transforms[k] = np.correlate(line[first : first + n + 2 * half], kernel[::-1])
        at = lower * n + np.arange(n)
        return (1.0 - upper_share) * transforms.take(at) + upper_share * transforms.take(at + n)

    def _state_if_step(
        self, state: AdaptiveDetectorState, peak: FloatArray, interval_s: float, new_bout: bool
    ) -> AdaptiveDetectorState | None:
        """Return the new state if a maximum passes the thresholds and the shortest interval, else None."""
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
        """Return True if the rhythm predicts a step after this interval; False before two intervals are known."""
        if rhythm.n_intervals < 2 or interval_s <= 0:
            return False
        return abs(math.log(interval_s / rhythm.period_s)) < self.rhythm_tolerance


def _with_step(rhythm: Rhythm, interval_s: float, new_bout: bool) -> Rhythm:
    """Return the rhythm updated with the interval of a step.

    The first step of a bout (`new_bout`) resets the rhythm.
    """
    if new_bout:
        return Rhythm(0.0, 0)
    period_s = 0.7 * rhythm.period_s + 0.3 * interval_s if rhythm.n_intervals else interval_s
    return Rhythm(period_s, rhythm.n_intervals + 1)


@lru_cache
def bounce_kernel(frequency_hz: float, low_pass_hz: float, max_half_s: float, rate_hz: float) -> FloatArray:
    """Return a low-passed Mexican hat kernel: symmetric, odd length, zero mean, unit gain at its frequency.

    The hat is (1 - u^2) exp(-u^2 / 2) with u = t / s, the time t and s = 1 / (4 f), a quarter of a step at the
    frequency f. It ends at t = 3.5 s, where 1 % of its peak is left, or at `max_half_s`.
    """
    half = round(min(3.5 * 0.25 / frequency_hz, max_half_s) * rate_hz)
    u = np.arange(-half, half + 1) / (rate_hz * (0.25 / frequency_hz))
    hat = (1.0 - u * u) * np.exp(-0.5 * u * u)
    kernel = np.convolve(np.asarray(hat - hat.mean(), dtype=float), low_pass_kernel(low_pass_hz, rate_hz))
    return read_only(with_unit_gain(kernel, frequency_hz, rate_hz))
