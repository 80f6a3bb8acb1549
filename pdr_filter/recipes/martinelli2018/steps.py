"""Steps as local maxima of the wavelet transform of the specific-force magnitude: Martinelli et al. 2018, section IV.

|f| (eq. 1) is band-passed, then transformed at one scale (eq. 3). Both are linear, the transform at one scale is a
short symmetric FIR filter and the wavelet has zero mean, so that wavelet and low-pass are one symmetric kernel, taken
from pywt and run causally with a delay line: its delay is the same at every step frequency.

Deviations: docs/methods/martinelli2018.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, cast

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.signal_filters import butterworth, low_pass_kernel, with_unit_gain
from pdr_filter.sensing.steps.step_detector import ContextBlock, ResponseState, ResponseStepDetector
from pdr_filter.sensing.steps.step_log import specific_force_magnitude
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, check_numbers, replace_unchecked


@dataclass(frozen=True, eq=False)
class WaveletDetectorState(ResponseState):
    """The last magnitudes and their power, the last values of the transform, filter memory, and the last peaks."""

    power_zi: FloatArray  # (1, 2) of the low-pass of the squared magnitude
    peak_level_mps2: float  # running mean of accepted peaks


@dataclass(frozen=True)
class WaveletStepDetector(ResponseStepDetector[WaveletDetectorState]):
    """Causal step detector; a step is reported `latency_s`, 0.8 s, after its contact.

    Parameters
    ----------
    wavelet : str
        A real symmetric wavelet of pywt.
    wavelet_frequency_hz : float
        Where the transform responds most. The paper's scale 16 at 100 Hz is 1.6 Hz with the Mexican hat.
    running_wavelet_frequency_hz : float
        The same for running.
    running_rms_mps2 : float
        Root mean square of |f| - g over about half a second above which the faster scale is used. Jogging has 8 to
        15 m/s2, brisk walking with the phone in a pocket 4 to 7.
    low_pass_hz : float
        Cutoff of the low-pass (Hamming window, 0.25 s) before the transform.
    min_peak_mps2 : float
        Smallest response that is a step. The response is scaled so that a sinusoid of amplitude 1 m/s2 at the
        wavelet frequency gives 1 m/s2.
    relative_peak : float
        A step must also reach this part of the running mean of the last peaks.
    min_interval_s : float
        Two maxima closer than this are one step: heel strike, then push-off. 0.25 s allows 4 steps a second.
    """

    uses_contexts: ClassVar[bool] = False

    wavelet: str = "mexh"
    wavelet_frequency_hz: float = 1.5
    running_wavelet_frequency_hz: float = 2.8
    running_rms_mps2: float = 6.5
    low_pass_hz: float = 4.0
    min_peak_mps2: float = 0.35
    relative_peak: float = 0.2
    min_interval_s: float = 0.25

    def __post_init__(self) -> None:
        check_numbers(self, zero=("min_peak_mps2", "relative_peak"), infinite=("running_rms_mps2",))

    @cached_property
    def _kernels(self) -> tuple[FloatArray, FloatArray]:
        """Low-passed wavelet for walking and for running, equally long, so that both have one delay."""
        frequencies_hz = (self.wavelet_frequency_hz, self.running_wavelet_frequency_hz)
        kernels = [step_kernel(self.wavelet, f, self.low_pass_hz, self.rate_hz) for f in frequencies_hz]
        half = max(len(k) for k in kernels) // 2
        walking, running = (np.pad(k, half - len(k) // 2) for k in kernels)
        return walking, running

    @cached_property
    def _power_sos(self) -> FloatArray:
        return butterworth(1, 0.4, self.rate_hz)

    @property
    def _delay_samples(self) -> int:
        return len(self._kernels[0]) // 2

    @property
    def _min_response(self) -> float:
        return self.min_peak_mps2

    def init(self) -> WaveletDetectorState:
        """State before the first sample of a segment."""
        line = np.zeros((2, self._n_line))
        return WaveletDetectorState(self._log.init(), line, np.zeros((1, 2)), np.zeros((1, 2)), 0.0)

    @property
    def _n_line(self) -> int:
        return len(self._kernels[0]) - 1

    def _signals(
        self, state: WaveletDetectorState, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[WaveletDetectorState, FloatArray]:
        """Magnitude and its power, (2, N)."""
        magnitude = specific_force_magnitude(block.specific_force_mps2)
        from scipy.signal import sosfilt

        power, power_zi = sosfilt(self._power_sos, (magnitude - STANDARD_GRAVITY_MPS2) ** 2, zi=state.power_zi)
        return replace_unchecked(state, power_zi=power_zi), np.stack([magnitude, power])

    def _response(self, line: FloatArray) -> FloatArray:
        # Every output is one dot product of the kernel's length, so cutting the signal elsewhere changes no bit.
        walking, running = (np.convolve(line[0], kernel, mode="valid") for kernel in self._kernels)
        n_before = self._delay_samples
        is_running = line[1, n_before : n_before + len(walking)] > self.running_rms_mps2**2
        return np.where(is_running, running, walking)[None]

    def _accepted(
        self, state: WaveletDetectorState, peak: FloatArray, interval_s: float, new_bout: bool
    ) -> WaveletDetectorState | None:
        response = float(peak[0])
        level = 0.0 if new_bout else state.peak_level_mps2
        if interval_s < self.min_interval_s or response < self.relative_peak * level:
            return None
        return replace_unchecked(state, peak_level_mps2=response if new_bout else 0.7 * level + 0.3 * response)


def wavelet_kernel(wavelet: str, frequency_hz: float, rate_hz: float) -> FloatArray:
    """Wavelet sampled at a rate: odd length, zero mean (eq. 2), unit gain at its frequency."""
    import pywt  # with SciPy, what a filter of another recipe need not load

    scale = float(pywt.frequency2scale(wavelet, frequency_hz / rate_hz))
    psi, t = cast(Any, pywt).ContinuousWavelet(wavelet).wavefun(10)
    # Beyond four scales the Mexican hat is below 0.5 % of its peak; a longer kernel only adds latency.
    half = int(np.ceil(4.0 * scale))
    kernel = np.interp(np.arange(-half, half + 1) / scale, t, np.real(psi), left=0.0, right=0.0)
    return with_unit_gain(np.asarray(kernel - kernel.mean()), frequency_hz, rate_hz)


def step_kernel(wavelet: str, frequency_hz: float, low_pass_hz: float, rate_hz: float) -> FloatArray:
    """Low-passed wavelet: symmetric, odd length, zero mean, unit gain at its frequency."""
    kernel = np.convolve(wavelet_kernel(wavelet, frequency_hz, rate_hz), low_pass_kernel(low_pass_hz, rate_hz))
    return with_unit_gain(kernel, frequency_hz, rate_hz)
