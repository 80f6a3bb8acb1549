"""Steps as local maxima of the wavelet transform of the specific-force magnitude: Martinelli et al. 2018, section IV.

|f| (eq. 1) is band-passed, then transformed at one scale (eq. 3). Both are linear, the transform at one scale is a
short symmetric FIR filter and the wavelet has zero mean, so that wavelet and low-pass are one symmetric kernel, taken
from pywt and run causally with a delay line: its delay is the same at every step frequency.

Deviations, where the paper is silent: the wavelet (Mexican hat), its frequency in hertz in place of scale 16, the
low-pass, and a threshold that follows the recent peaks. Running gets a second, faster scale: with one scale either the
two feet of a runner merge into one maximum, or a slow walker's heel strike and push-off make two (docs/benchmarks.md).
In place of overlapping 1 s windows every sample is looked at once: the same maxima, none twice at window edges.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np
import pywt
from scipy.signal import butter, firwin, sosfilt

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.detector import ModeBlock, StepLog, StepLogState, specific_force_magnitude
from pdr_filter.values.arrays import FloatArray
from pdr_filter.values.samples import STANDARD_GRAVITY_MPS2
from pdr_filter.values.step import Step


@dataclass(frozen=True, slots=True, eq=False)
class WaveletDetectorState:
    """Filter memories, and the last contact."""

    log: StepLogState
    n_samples: int  # that went through the transform
    power_zi: FloatArray  # (1, 2) of the low-pass of the squared magnitude
    delay_line: FloatArray  # (2, L - 1) magnitude, and its smoothed squared deviation from gravity; empty at the start
    response: FloatArray  # (2,) last values of the transform
    peak_level_mps2: float  # running mean of accepted peaks


@dataclass(frozen=True)
class WaveletStepDetector:
    """Causal step detector; a step is reported `latency_s`, 0.8 s, after its contact.

    Parameters
    ----------
    rate_hz : float
        Sampling rate of the blocks.
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
    max_interval_s : float
        After a longer pause a new bout begins.
    first_step_s : float
        Duration given to the first step of a bout, whose start no contact marks: a typical step from rest.
    """

    rate_hz: float = 100.0
    wavelet: str = "mexh"
    wavelet_frequency_hz: float = 1.5
    running_wavelet_frequency_hz: float = 2.8
    running_rms_mps2: float = 6.5
    low_pass_hz: float = 4.0
    min_peak_mps2: float = 0.35
    relative_peak: float = 0.2
    min_interval_s: float = 0.25
    max_interval_s: float = 2.0
    first_step_s: float = 0.6

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
        return np.asarray(butter(1, 0.4, fs=self.rate_hz, output="sos"))

    @property
    def _delay_samples(self) -> int:
        return len(self._kernels[0]) // 2

    @property
    def latency_s(self) -> float:
        """Time from a contact to its detection."""
        return (self._delay_samples + 1) / self.rate_hz

    @cached_property
    def _log(self) -> StepLog:
        return StepLog(self.rate_hz, self.latency_s, self.max_interval_s, self.first_step_s)

    def init(self) -> WaveletDetectorState:
        """State before the first sample of a segment."""
        return WaveletDetectorState(
            log=self._log.init(),
            n_samples=0,
            power_zi=np.zeros((1, 2)),
            delay_line=np.empty((2, 0)),
            response=np.zeros(2),
            peak_level_mps2=0.0,
        )

    def step(
        self, state: WaveletDetectorState, block: UniformBlock, attitude: AttitudeBlock, modes: ModeBlock
    ) -> tuple[WaveletDetectorState, list[tuple[int, Step]]]:
        """New state and the steps that became known, each with the number of the sample that revealed it."""
        magnitude = specific_force_magnitude(block.specific_force_mps2)
        power, power_zi = sosfilt(self._power_sos, (magnitude - STANDARD_GRAVITY_MPS2) ** 2, zi=state.power_zi)
        state = replace(state, log=self._log.extend(state.log, block, attitude), power_zi=power_zi)
        if state.n_samples == 0:
            # What was before the first sample is taken to be like it: a zero there would look like a blow.
            before = np.tile([[magnitude[0]], [0.0]], len(self._kernels[0]) - 1)
            state = replace(state, delay_line=before)
        state, steps = self._detect(state, np.stack([magnitude, power]))
        return replace(state, log=self._log.trim(state.log)), steps

    def finish(self, state: WaveletDetectorState) -> list[tuple[int, Step]]:
        """Steps in the last `latency_s` before a gap or the end, whose last value is taken to stay."""
        if state.n_samples == 0:
            return []
        end = state.n_samples
        last_s = self._log.time_s(state.log, end - 1)
        _, steps = self._detect(state, np.tile(state.delay_line[:, -1:], self._delay_samples + 1))
        return [(end - 1, replace(s, detected_time_s=last_s)) for _, s in steps if s.time_s <= last_s]

    def _detect(
        self, state: WaveletDetectorState, signals: FloatArray
    ) -> tuple[WaveletDetectorState, list[tuple[int, Step]]]:
        """Detect in further samples of magnitude and power."""
        line = np.concatenate([state.delay_line, signals], axis=1)
        n_new, n_kernel = signals.shape[1], len(self._kernels[0])
        # Every output is one dot product of the kernel's length, so cutting the signal elsewhere changes no bit.
        walking, running = (np.convolve(line[0], kernel, mode="valid") for kernel in self._kernels)
        is_running = line[1, n_kernel // 2 : n_kernel // 2 + n_new] > self.running_rms_mps2**2
        response = np.concatenate([state.response, np.where(is_running, running, walking)])
        middle = response[1:-1]
        is_peak = (middle > response[:-2]) & (middle >= response[2:]) & (middle >= self.min_peak_mps2)
        n_before = state.n_samples
        steps: list[tuple[int, Step]] = []
        for i in np.flatnonzero(is_peak):
            known = n_before + int(i)  # the sample that made response[i + 2]
            state, step = self._accept(state, response[i : i + 3], known)
            if step is not None:
                steps.append((known, step))
        return (
            replace(
                state,
                n_samples=n_before + n_new,
                delay_line=line[:, line.shape[1] - n_kernel + 1 :],
                response=response[-2:],
            ),
            steps,
        )

    def _accept(
        self, state: WaveletDetectorState, peak: FloatArray, known: int
    ) -> tuple[WaveletDetectorState, Step | None]:
        """The step that a local maximum of the response makes, if it makes one."""
        contact = known - 1 - self._delay_samples
        if contact <= max(self._log.first_sample(state.log), 0) or contact >= state.log.n_samples:
            return state, None
        # vertex of the parabola through the three values: contact times finer than the sampling interval
        curvature = peak[0] - 2 * peak[1] + peak[2]
        fraction = float(0.5 * (peak[0] - peak[2]) / curvature) if curvature < 0 else 0.0
        contact_s = self._log.time_s(state.log, contact) + fraction / self.rate_hz
        new_bout = self._log.starts_bout(state.log, contact_s)
        level = 0.0 if new_bout else state.peak_level_mps2
        if contact_s - state.log.last_contact_s < self.min_interval_s or peak[1] < self.relative_peak * level:
            return state, None
        log, step = self._log.add(state.log, contact, known, fraction)
        level = float(peak[1]) if new_bout else 0.7 * level + 0.3 * float(peak[1])
        return replace(state, log=log, peak_level_mps2=level), step


def wavelet_kernel(wavelet: str, frequency_hz: float, rate_hz: float) -> FloatArray:
    """Wavelet sampled at a rate: odd length, zero mean (eq. 2), unit gain at its frequency."""
    scale = float(pywt.frequency2scale(wavelet, frequency_hz / rate_hz))
    psi, t = cast(Any, pywt).ContinuousWavelet(wavelet).wavefun(10)
    # Beyond four scales the Mexican hat is below 0.5 % of its peak; a longer kernel only adds latency.
    half = int(np.ceil(4.0 * scale))
    kernel = np.interp(np.arange(-half, half + 1) / scale, t, np.real(psi), left=0.0, right=0.0)
    return _with_unit_gain(np.asarray(kernel - kernel.mean()), frequency_hz, rate_hz)


def step_kernel(wavelet: str, frequency_hz: float, low_pass_hz: float, rate_hz: float) -> FloatArray:
    """Low-passed wavelet: symmetric, odd length, zero mean, unit gain at its frequency."""
    # 0.25 s of Hamming window roll off within 4 Hz, enough to join the two humps of one step
    n_taps = 2 * round(0.125 * rate_hz) + 1
    low_pass: FloatArray = np.asarray(firwin(n_taps, min(low_pass_hz, 0.45 * rate_hz), fs=rate_hz), dtype=float)
    kernel = np.convolve(wavelet_kernel(wavelet, frequency_hz, rate_hz), low_pass)
    return _with_unit_gain(kernel, frequency_hz, rate_hz)


def _with_unit_gain(kernel: FloatArray, frequency_hz: float, rate_hz: float) -> FloatArray:
    offset_s = (np.arange(len(kernel)) - len(kernel) // 2) / rate_hz
    return np.asarray(kernel / np.sum(kernel * np.cos(2 * np.pi * frequency_hz * offset_s)))
