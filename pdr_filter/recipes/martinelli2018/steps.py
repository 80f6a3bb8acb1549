"""Step detector of Martinelli et al. 2018, section IV: maxima of the wavelet transform of the force magnitude.

The magnitude |f| (eq. 1) is band-passed and then transformed at one scale (eq. 3). Both operations are linear, and the
transform at one scale is a short symmetric FIR filter with zero mean. Wavelet (from pywt) and low-pass are therefore
combined to one symmetric kernel. It runs causally with a delay line, so that the delay is the same at every step
frequency.

Deviations from the paper are listed in `WaveletStepDetector`.
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
    """Delay line, state of the filters, and level of the last peaks."""

    power_zi: FloatArray  # (1, 2) filter state of the low-pass of the squared magnitude
    peak_level_mps2: float  # running mean of accepted peaks


@dataclass(frozen=True)
class WaveletStepDetector(ResponseStepDetector[WaveletDetectorState]):
    """Step detector of Martinelli et al. 2018, which finds maxima of the wavelet transform of the force magnitude.

    The detector is causal. A step is reported `latency_s`, 0.8 s, after its contact.

    Parameters
    ----------
    rate_hz : float, default 100.0
        Sampling rate of the blocks in Hz.
    max_interval_s : float, default 2.0
        Pause in s after which a new walking bout begins.
    first_step_s : float, default 0.6
        Duration in s of the first step of a bout, because no contact marks its start.
    wavelet : str, default "mexh"
        Name of a real symmetric wavelet of pywt.
    wavelet_frequency_hz : float, default 1.5
        Frequency in Hz at which the response of the transform is largest, for walking. Scale 16 of the paper at 100 Hz
        is 1.6 Hz with the Mexican hat.
    running_wavelet_frequency_hz : float, default 2.8
        Frequency in Hz at which the response of the transform is largest, for running.
    running_rms_mps2 : float, default 6.5
        Root mean square of |f| - g over about half a second, above which the wavelet for running is used. It is 8 to
        15 m/s2 for jogging and 4 to 7 m/s2 for brisk walking with the phone in a pocket.
    low_pass_hz : float, default 4.0
        Cutoff in Hz of the low-pass (Hamming window, 0.25 s) before the transform.
    min_peak_mps2 : float, default 0.35
        Smallest response of a step. The response to a sinusoid of amplitude 1 m/s2 at the wavelet frequency is 1 m/s2.
    relative_peak : float, default 0.2
        Smallest response of a step relative to the running mean of the last peaks.
    min_interval_s : float, default 0.25
        Shortest time in s between two steps. A second maximum within this time is the push-off after the heel strike.
        0.25 s allows 4 steps per second.

    Raises
    ------
    ValueError
        If a number is invalid.

    Notes
    -----
    Deviations from the paper:

    - The paper does not name the wavelet. The Mexican hat is a choice, and 1.5 Hz is close to the printed scale 16.
    - The paper does not give the band-pass. The low-pass and the wavelet, which has zero mean, are one symmetric kernel
      with the same delay at every step frequency.
    - The paper does not give the threshold of the peaks. It follows the recent peaks (`relative_peak`) and is at least
      `min_peak_mps2`.
    - The paper uses the same scale for running. One scale merges the two feet of a runner, or detects each step of a
      slow walker twice. Therefore running has a second wavelet.
    - The paper searches overlapping windows of 1 s. Here each sample is searched once, which gives the same maxima, and
      none twice at the edges of windows.

    Examples
    --------
    >>> from pdr_filter.recipes.martinelli2018.steps import WaveletStepDetector
    >>> round(WaveletStepDetector().latency_s, 1)
    0.8
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
        """Return the low-passed wavelets for walking and running, padded to the same length to have the same delay."""
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
        line = np.zeros((2, self._n_line))
        return WaveletDetectorState(self._log.init(), line, np.zeros((1, 2)), np.zeros((1, 2)), 0.0)

    @property
    def _n_line(self) -> int:
        return len(self._kernels[0]) - 1

    def _signals(
        self, state: WaveletDetectorState, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[WaveletDetectorState, FloatArray]:
        """Return the new state, and two signals (2, N) of the magnitude of the specific force.

        They are the magnitude in m/s2, and the low-passed square of the magnitude minus gravity.
        """
        magnitude = specific_force_magnitude(block.specific_force_mps2)
        from scipy.signal import sosfilt

        power, power_zi = sosfilt(self._power_sos, (magnitude - STANDARD_GRAVITY_MPS2) ** 2, zi=state.power_zi)
        return replace_unchecked(state, power_zi=power_zi), np.stack([magnitude, power])

    def _response(self, line: FloatArray) -> FloatArray:
        # each output is one dot product with the kernel, so that results are bit-identical for any split into blocks
        walking, running = (np.convolve(line[0], kernel, mode="valid") for kernel in self._kernels)
        n_before = self._delay_samples
        is_running = line[1, n_before : n_before + len(walking)] > self.running_rms_mps2**2
        return np.where(is_running, running, walking)[None]

    def _state_if_step(
        self, state: WaveletDetectorState, peak: FloatArray, interval_s: float, new_bout: bool
    ) -> WaveletDetectorState | None:
        response = float(peak[0])
        level = 0.0 if new_bout else state.peak_level_mps2
        if interval_s < self.min_interval_s or response < self.relative_peak * level:
            return None
        return replace_unchecked(state, peak_level_mps2=response if new_bout else 0.7 * level + 0.3 * response)


def wavelet_kernel(wavelet: str, frequency_hz: float, rate_hz: float) -> FloatArray:
    """Return a sampled wavelet with odd length, zero mean (eq. 2), and unit gain at its frequency."""
    try:
        import pywt  # imported here, because other recipes need neither pywt nor SciPy
    except ImportError:
        remedy = "pip install pywavelets, or use another recipe"
        raise ImportError(
            f"the wavelet step detector of martinelli2018 needs pywt, which is not installed: {remedy}", name="pywt"
        ) from None
    scale = float(pywt.frequency2scale(wavelet, frequency_hz / rate_hz))
    psi, t = cast(Any, pywt).ContinuousWavelet(wavelet).wavefun(10)
    # beyond four scales, the Mexican hat is below 0.5 % of its peak, and a longer kernel would only add latency
    half = int(np.ceil(4.0 * scale))
    kernel = np.interp(np.arange(-half, half + 1) / scale, t, np.real(psi), left=0.0, right=0.0)
    return with_unit_gain(np.asarray(kernel - kernel.mean()), frequency_hz, rate_hz)


def step_kernel(wavelet: str, frequency_hz: float, low_pass_hz: float, rate_hz: float) -> FloatArray:
    """Return a low-passed wavelet, symmetric, with odd length, zero mean, and unit gain at its frequency."""
    kernel = np.convolve(wavelet_kernel(wavelet, frequency_hz, rate_hz), low_pass_kernel(low_pass_hz, rate_hz))
    return with_unit_gain(kernel, frequency_hz, rate_hz)
