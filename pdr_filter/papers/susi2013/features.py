"""Motion-mode features of a handheld device: Susi et al. 2013, sections 6.1 and 6.2.

Angular rate and specific force are low-passed (Butterworth, 10th order, 15 Hz), their norms taken (eq. 2) and the
moving mean removed (eq. 3); windows of 256 samples at 100 Hz overlap by half. Features of each norm: energy (eq. 4-5),
variance (eq. 6-7) and dominant frequencies of the short-time Fourier transform.

Equations 1 to 7 are missing or partly missing in the copy of the text at hand. Assumed from the words around them:

- The moving mean of eq. 3 is causal and as long as the window, N = 256, over the samples so far at the start of a
  segment: its length is "explained in section 6.2", which chooses N.
- Energy, variance and frequencies are of the norm less its moving mean: all three carry the same tilde, and section 4
  says that windows have their mean removed. (The words below eq. 5 can also be read as the norm itself. Its energy is
  nearly g squared, so that it shows the accelerometer's bias in the direction of gravity: how one phone lies in the
  hand, and nothing of another phone.) Energy is the mean square, variance the mean squared deviation from the window's
  mean; they differ by the square of that mean only, which is what the norm still drifts within a window.
- A frame of the transform is the window, with a Hann taper. Figure 5 shows the three highest maxima of the spectrogram,
  so there are three dominant frequencies, highest first, zero where the spectrum has fewer maxima. A maximum at zero
  frequency counts: "when the user is static the frequencies are almost equal to zero".

Two numbers for what the paper says in words, beside the features: the energy of the norm of the angular rate itself
(the other reading of eq. 5; figure 2 shows a swinging hand by it), and how much of a window is its dominant
frequencies, since frequencies alone do not say whether there are peaks at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi
from scipy.signal.windows import hann

from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.features.sliding import check_window, take_windows
from pdr_filter.sensing.steps.detector import specific_force_magnitude
from pdr_filter.values.arrays import FloatArray

_OF = ("acc", "gyro")
N_DOMINANT = 3
NAMES: tuple[str, ...] = (
    *(f"energy_{s}" for s in _OF),
    *(f"variance_{s}" for s in _OF),
    *(f"dominant_frequency_{k}_{s}_hz" for s in _OF for k in range(1, N_DOMINANT + 1)),
)
WITHOUT_GYROSCOPE: tuple[str, ...] = tuple(n for n in NAMES if "gyro" not in n)

# A sinusoid of smaller amplitude is rounding noise: the spectrum of a constant has no frequency.
_MIN_AMPLITUDE = 1e-9


def motion_features(norms: FloatArray, rate_hz: float) -> FloatArray:
    """Features of a window in the order of `NAMES`, shape (10,).

    Parameters
    ----------
    norms : (2, N)
        Rows: filtered |f| in m/s2 and filtered |omega| in rad/s, each less its moving mean. A missing sensor is a row
        of zeros, whose features are zero.
    rate_hz : float
        Sampling rate.
    """
    energy = (norms * norms).mean(axis=1)
    centred = norms - norms.mean(axis=1)[:, None]
    variance = (centred * centred).mean(axis=1)
    dominant = [dominant_frequencies(row, rate_hz) for row in norms]
    return np.concatenate([energy, variance, *dominant])


def dominant_frequencies(signal: FloatArray, rate_hz: float) -> FloatArray:
    """Frequencies in hertz of the three highest maxima of the spectrogram of one frame, highest first, shape (3,).

    They are multiples of rate_hz / N; zero stands for a maximum that does not exist.
    """
    taper: FloatArray = np.asarray(hann(len(signal), sym=False))
    # scaled so that a sinusoid in the middle of a bin has its amplitude
    amplitude = np.abs(np.fft.rfft(signal * taper)) / (0.5 * taper.sum())
    padded = np.concatenate([[-1.0], amplitude, [-1.0]])
    is_maximum = (amplitude > padded[:-2]) & (amplitude >= padded[2:]) & (amplitude > _MIN_AMPLITUDE)
    maxima = np.flatnonzero(is_maximum)
    highest = maxima[np.argsort(-amplitude[maxima], kind="stable")[:N_DOMINANT]]
    frequency_hz = np.zeros(N_DOMINANT)
    frequency_hz[: len(highest)] = highest * (rate_hz / len(signal))
    return frequency_hz


def dominance(norms: FloatArray) -> FloatArray:
    """Part of the power of each row (d, N) that is in its three highest maxima above zero frequency, (d,), 0 to 1.

    The power is that of the tapered row less its mean; a maximum counts with its two neighbours, which hold all of a
    sinusoid in the middle of a bin. Nearly 1 for a swinging arm, small where nothing repeats; zero without motion.
    """
    return np.array([_dominance(row) for row in norms])


def _dominance(signal: FloatArray) -> float:
    power = np.abs(np.fft.rfft((signal - signal.mean()) * np.asarray(hann(len(signal), sym=False)))) ** 2
    total = float(power.sum())
    if total < (_MIN_AMPLITUDE * len(signal)) ** 2:
        return 0.0
    inner = power[1:]
    maxima = 1 + np.flatnonzero((inner > power[:-1]) & (inner >= np.append(power[2:], -1.0)))
    highest = maxima[np.argsort(-power[maxima], kind="stable")[:N_DOMINANT]]
    near = np.unique(np.concatenate([highest - 1, highest, np.minimum(highest + 1, len(power) - 1)]))
    return float(power[near].sum()) / total


@dataclass(frozen=True, slots=True, eq=False)
class MotionWindow:
    """Features of one window."""

    time_s: float  # end of the window
    features: FloatArray  # (10,)
    has_gyroscope: bool
    dominance: FloatArray  # (2,) of |f| and |omega|, see `dominance`
    rotation_energy: float  # mean square of |omega| itself, rad2/s2; zero without gyroscope


@dataclass(frozen=True, slots=True, eq=False)
class MotionWindowState:
    """Filter memory, and samples that later windows still need."""

    n_samples: int
    zi: FloatArray | None  # (5, 2, 6); None before the first sample
    delay_line: FloatArray  # (2, L - 1) filtered norms, for the moving mean
    first: int  # index of the first sample in the buffer
    buffer: FloatArray  # (5, B): time, norms less their moving mean, |omega|, angular rate known


@dataclass(frozen=True)
class MotionWindows:
    """Filtered norms, windows of them and their features; causal.

    Parameters
    ----------
    rate_hz : float
        Sampling rate of the blocks, more than twice the cutoff.
    window_s, hop_s : float
        Length and advance: 256 and 128 samples at 100 Hz. The hop is at most the window.
    low_pass_hz : float
        Cutoff of the 10th-order Butterworth low-pass. At 15 Hz its delay is about 0.07 s.
    """

    rate_hz: float = 100.0
    window_s: float = 2.56
    hop_s: float = 1.28
    low_pass_hz: float = 15.0

    def __post_init__(self) -> None:
        check_window(self.window_samples, self.hop_samples)
        if not 0 < self.low_pass_hz < 0.5 * self.rate_hz:
            raise ValueError(
                f"low_pass_hz must be below half the rate, got {self.low_pass_hz} at {self.rate_hz} Hz: "
                "resample to a higher rate or lower the cutoff"
            )

    @property
    def window_samples(self) -> int:
        """Length in samples, also of the moving mean."""
        return round(self.window_s * self.rate_hz)

    @property
    def hop_samples(self) -> int:
        """Advance in samples."""
        return round(self.hop_s * self.rate_hz)

    @cached_property
    def _sos(self) -> FloatArray:
        return np.asarray(butter(10, self.low_pass_hz, fs=self.rate_hz, output="sos"))

    def init(self) -> MotionWindowState:
        """State at the start of a segment."""
        return MotionWindowState(0, None, np.zeros((2, self.window_samples - 1)), 0, np.empty((5, 0)))

    def step(
        self, state: MotionWindowState, block: UniformBlock
    ) -> tuple[MotionWindowState, list[tuple[int, MotionWindow]]]:
        """New state and the windows that became complete, each with the index of its last sample."""
        zi, norms = self._filtered_norms(state.zi, block)
        line = np.concatenate([state.delay_line, norms], axis=1)
        deviation = norms - self._moving_mean(line, state.n_samples)
        new = np.vstack([block.time_s, deviation, norms[1], block.angular_rate_known.astype(float)])
        buffer = np.concatenate([state.buffer, new], axis=1)
        buffer, first, cut = take_windows(buffer, state.first, self.window_samples, self.hop_samples)
        windows = [(last, self._describe(samples)) for last, samples in cut]
        n_samples = state.n_samples + norms.shape[1]
        return MotionWindowState(n_samples, zi, line[:, norms.shape[1] :], first, buffer), windows

    def _filtered_norms(self, zi: FloatArray | None, block: UniformBlock) -> tuple[FloatArray, FloatArray]:
        """New filter memory and the norms (2, N) of the filtered components (eq. 2)."""
        components = np.column_stack([block.specific_force_mps2, block.angular_rate_radps])
        if zi is None:
            # What was before the first sample is taken to be like it: a zero there would look like a blow.
            zi = np.asarray(sosfilt_zi(self._sos))[:, :, None] * components[0]
        filtered, after = sosfilt(self._sos, components, axis=0, zi=zi)
        return after, np.stack([specific_force_magnitude(filtered[:, :3]), specific_force_magnitude(filtered[:, 3:])])

    def _moving_mean(self, line: FloatArray, n_before: int) -> FloatArray:
        """Mean over the last L samples, or those so far, of each sample after the delay line (eq. 3)."""
        length = self.window_samples
        # Every output is one dot product of the kernel's length, so cutting the signal elsewhere changes no bit.
        sums = np.stack([np.convolve(row, np.ones(length), mode="valid") for row in line])
        seen = np.minimum(n_before + 1 + np.arange(sums.shape[1]), length)
        return sums / seen

    def _describe(self, samples: FloatArray) -> MotionWindow:
        # contiguous, so that reductions take the same path for every window
        deviation = np.ascontiguousarray(samples[1:3])
        return MotionWindow(
            time_s=float(samples[0, -1]) + 0.5 / self.rate_hz,
            features=motion_features(deviation, self.rate_hz),
            has_gyroscope=bool(samples[4].all()),
            dominance=dominance(deviation),
            rotation_energy=float((samples[3] * samples[3]).mean()),
        )
