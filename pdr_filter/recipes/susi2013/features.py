"""Features of Susi et al. 2013, sections 6.1 and 6.2, for the motion modes of a handheld device.

Angular rate and specific force are low-passed (Butterworth, 10th order, 15 Hz). The moving mean of their norms (eq. 2)
is removed (eq. 3). Windows of 256 samples at 100 Hz overlap by half. The features of each norm are energy (eq. 4-5),
variance (eq. 6-7) and the dominant frequencies of the short-time Fourier transform.

Equations 1 to 7 and figure 7 are missing or incomplete in the available copy of the paper. The following is assumed
from the surrounding text. The moving mean of eq. 3 is causal and as long as the window, or covers all samples
so far at the start of a segment. Energy, variance and frequencies are computed after removal of the moving mean. A
frame of the transform is the window, with a Hann taper.

A window also has the energy of the norm of the angular rate itself, and the shares of power in the dominant
frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.features.sliding_windows import (
    DescribedWindow,
    SampleWindow,
    SlidingWindows,
    WindowBuffer,
    no_samples,
)
from pdr_filter.sensing.signal_filters import butterworth, filtered_rows
from pdr_filter.sensing.steps.step_log import specific_force_magnitude
from pdr_filter.values import FloatArray

_OF = ("acc", "gyro")
N_DOMINANT = 3
NAMES: tuple[str, ...] = (
    *(f"energy_{s}" for s in _OF),
    *(f"variance_{s}" for s in _OF),
    *(f"dominant_frequency_{k}_{s}_hz" for s in _OF for k in range(1, N_DOMINANT + 1)),
)

# Smaller amplitudes are rounding noise. Without this limit, a constant signal would have dominant frequencies.
_MIN_AMPLITUDE = 1e-9


def motion_features(norms: FloatArray, rate_hz: float) -> FloatArray:
    """Return the features of a window in the order of `NAMES`, shape (10,).

    The rows of `norms` (2, N) are filtered |f| in m/s2 and filtered |omega| in rad/s, each minus its moving mean. A
    missing sensor is a row of zeros, whose features are zero.
    """
    energy = (norms * norms).mean(axis=1)
    centred = norms - norms.mean(axis=1)[:, None]
    variance = (centred * centred).mean(axis=1)
    dominant = [dominant_frequencies(row, rate_hz) for row in norms]
    return np.concatenate([energy, variance, *dominant])


def dominant_frequencies(signal: FloatArray, rate_hz: float) -> FloatArray:
    """Return the frequencies in Hz of the three highest maxima of the spectrum of a frame, highest first, shape (3,).

    They are multiples of rate_hz / N. A missing maximum is zero.
    """
    taper = _taper(len(signal))
    # scaled so that a sinusoid at the centre of a bin has its true amplitude
    amplitude = np.abs(np.fft.rfft(signal * taper)) / (0.5 * taper.sum())
    padded = np.concatenate([[-1.0], amplitude, [-1.0]])
    is_maximum = (amplitude > padded[:-2]) & (amplitude >= padded[2:]) & (amplitude > _MIN_AMPLITUDE)
    maxima = np.flatnonzero(is_maximum)
    highest = maxima[np.argsort(-amplitude[maxima], kind="stable")[:N_DOMINANT]]
    frequency_hz = np.zeros(N_DOMINANT)
    frequency_hz[: len(highest)] = highest * (rate_hz / len(signal))
    return frequency_hz


def dominance(norms: FloatArray) -> FloatArray:
    """Return the share of the power of each row (d, N) in its three highest spectral maxima, (d,), 0 to 1.

    The power is computed from the row after subtraction of its mean and a taper. Each maximum includes its two
    neighbours, which together contain all power of a sinusoid at the centre of a bin. The share is nearly 1 for a
    swinging arm, small for motion that is not periodic, and zero without motion.
    """
    return np.array([_dominance(row) for row in norms])


def _taper(n: int) -> FloatArray:
    from scipy.signal.windows import hann

    return np.asarray(hann(n, sym=False))


def _dominance(signal: FloatArray) -> float:
    power = np.abs(np.fft.rfft((signal - signal.mean()) * _taper(len(signal)))) ** 2
    total = float(power.sum())
    if total < (_MIN_AMPLITUDE * len(signal)) ** 2:
        return 0.0
    inner = power[1:]
    maxima = 1 + np.flatnonzero((inner > power[:-1]) & (inner >= np.append(power[2:], -1.0)))
    highest = maxima[np.argsort(-power[maxima], kind="stable")[:N_DOMINANT]]
    near = np.unique(np.concatenate([highest - 1, highest, np.minimum(highest + 1, len(power) - 1)]))
    return float(power[near].sum()) / total


def filtered_norms(sos: FloatArray, components: FloatArray, zi: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Return the norms of low-passed force and angular rate, (2, N) (eq. 2), and the new filter state.

    `components` (6, N) are the components of specific force and angular rate.
    """
    low_passed, zi = filtered_rows(sos, components, zi)
    return np.stack([specific_force_magnitude(low_passed[:3].T), specific_force_magnitude(low_passed[3:].T)]), zi


@dataclass(frozen=True, slots=True, eq=False)
class MotionWindow(DescribedWindow):
    """Features of one window (`motion_features`), with two more values for the decision tree.

    They are the shares of power in the dominant frequencies, and the mean square of the angular rate.
    """

    features: FloatArray  # (10,)
    has_gyroscope: bool
    dominance: FloatArray  # (2,) share of power in the dominant frequencies of |f| and |omega|
    rotation_energy: float  # mean square of |omega| itself, rad2/s2; zero without gyroscope


@dataclass(frozen=True, slots=True, eq=False)
class MotionWindowState:
    """Filter state, and samples that later windows need."""

    n_samples: int
    zi: FloatArray | None  # (5, 6, 2); None before the first sample
    delay_line: FloatArray  # (2, L - 1) filtered norms, for the moving mean
    buffer: WindowBuffer  # rows: norms minus moving mean, |omega|, 1 if the angular rate is known


@dataclass(frozen=True)
class MotionWindows(SlidingWindows[MotionWindowState, MotionWindow]):
    """Causal windows of the norms of low-passed force and angular rate, with their features."""

    window_s: float = 2.56  # 256 samples at 100 Hz
    hop_s: float = 1.28
    low_pass_hz: float = 15.0  # cutoff in Hz of the 10th-order Butterworth low-pass, whose delay is about 0.07 s

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self._sos  # raises at once if the cutoff is invalid

    @cached_property
    def _sos(self) -> FloatArray:
        return butterworth(10, self.low_pass_hz, self.rate_hz)

    def init(self) -> MotionWindowState:
        return MotionWindowState(0, None, np.zeros((2, self.window_samples - 1)), no_samples(4))

    def update(
        self, state: MotionWindowState, block: UniformBlock, attitude: AttitudeBlock
    ) -> tuple[MotionWindowState, list[tuple[int, MotionWindow]]]:
        """Return the new state and the completed windows, each with the index of its last sample in the segment.

        The attitude is not used, because norms do not depend on it.
        """
        components = np.vstack([block.specific_force_mps2.T, block.angular_rate_radps.T])
        norms, zi = filtered_norms(self._sos, components, state.zi)
        line = np.concatenate([state.delay_line, norms], axis=1)
        centred = norms - self._moving_mean(line, state.n_samples)
        signals = np.vstack([centred, norms[1], block.angular_rate_known.astype(float)])
        buffer, windows = self.cut(state.buffer, block.time_s, signals)
        n = norms.shape[1]
        state = MotionWindowState(state.n_samples + n, zi, line[:, n:], buffer)
        return state, [(window.last, self._describe(window)) for window in windows]

    def _moving_mean(self, line: FloatArray, n_before: int) -> FloatArray:
        """Return the mean over the last L samples at each sample after the delay line (eq. 3).

        At the start of a segment it is the mean over all samples so far.
        """
        length = self.window_samples
        # each output is one dot product over the window, so that results are bit-identical for any split into blocks
        sums = np.stack([np.convolve(row, np.ones(length), mode="valid") for row in line])
        seen = np.minimum(n_before + 1 + np.arange(sums.shape[1]), length)
        return sums / seen

    def _describe(self, window: SampleWindow) -> MotionWindow:
        norms, omega, known = window.samples[:2], window.samples[2], window.samples[3]
        return MotionWindow(
            start_s=window.start_s,
            time_s=window.end_s,
            features=motion_features(norms, self.rate_hz),
            has_gyroscope=bool(known.all()),
            dominance=dominance(norms),
            rotation_energy=float((omega * omega).mean()),
        )
