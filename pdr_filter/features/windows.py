"""Sliding windows over the magnitudes of all sensors: one feature vector a window, causal.

Windows of 2 s with 50 % overlap (Martinelli et al. 2018, section V and Fig. 12) start with the segment; a window that a
gap would cut does not exist.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi

from pdr_filter.conditioning import UniformBlock
from pdr_filter.features.martinelli import features_28
from pdr_filter.steps.wavelet import specific_force_magnitude
from pdr_filter.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FeatureWindow:
    """Features of one window."""

    time_s: float  # end of the window
    features: FloatArray  # (28,)
    has_gyroscope: bool
    has_magnetometer: bool


@dataclass(frozen=True, slots=True, eq=False)
class WindowState:
    """Samples that later windows still need."""

    n_samples: int
    zi: FloatArray | None
    buffer: FloatArray  # (7, B): time, four magnitudes, angular rate known, magnetic field known


@dataclass(frozen=True)
class FeatureWindows:
    """Windows and their features.

    Parameters
    ----------
    rate_hz : float
        Sampling rate of the blocks.
    window_s, hop_s : float
        Length and advance.
    low_pass_hz : float
        Cutoff of the low-pass of Table II, which the paper does not give: 5 Hz keeps the first harmonics of a step.
    """

    rate_hz: float = 100.0
    window_s: float = 2.0
    hop_s: float = 1.0
    low_pass_hz: float = 5.0

    @property
    def window_samples(self) -> int:
        """Length in samples."""
        return round(self.window_s * self.rate_hz)

    @property
    def hop_samples(self) -> int:
        """Advance in samples."""
        return round(self.hop_s * self.rate_hz)

    @cached_property
    def _sos(self) -> FloatArray:
        return np.asarray(butter(2, self.low_pass_hz, fs=self.rate_hz, output="sos"))

    def init(self) -> WindowState:
        """State at the start of a segment."""
        return WindowState(0, None, np.empty((7, 0)))

    def step(self, state: WindowState, block: UniformBlock) -> tuple[WindowState, list[tuple[int, FeatureWindow]]]:
        """New state and the windows that became complete, each with the index of its last sample."""
        force = specific_force_magnitude(block.specific_force_mps2)
        zi = state.zi if state.zi is not None else sosfilt_zi(self._sos) * force[0]
        low_passed, zi = sosfilt(self._sos, force, zi=zi)
        new = np.stack(
            [
                block.time_s,
                force,
                low_passed,
                specific_force_magnitude(block.angular_rate_radps),
                specific_force_magnitude(block.magnetic_field_ut),
                block.angular_rate_known.astype(float),
                block.magnetic_field_known.astype(float),
            ]
        )
        buffer = np.concatenate([state.buffer, new], axis=1)
        end = state.n_samples + new.shape[1]
        first = end - buffer.shape[1]  # index of the first sample in the buffer
        windows: list[tuple[int, FeatureWindow]] = []
        # ends are window + k hop; the first one after the samples already seen
        hops_done = max(0, (state.n_samples - self.window_samples) // self.hop_samples + 1)
        next_end = self.window_samples + hops_done * self.hop_samples
        while next_end <= end:
            samples = buffer[:, next_end - self.window_samples - first : next_end - first]
            windows.append((next_end - 1, self._describe(samples)))
            next_end += self.hop_samples
        return WindowState(end, zi, buffer[:, -self.window_samples :]), windows

    def _describe(self, samples: FloatArray) -> FeatureWindow:
        return FeatureWindow(
            time_s=float(samples[0, -1]) + 0.5 / self.rate_hz,
            # contiguous, so that reductions take the same path for every window
            features=features_28(np.ascontiguousarray(samples[1:5]), self.rate_hz),
            has_gyroscope=bool(samples[5].all()),
            has_magnetometer=bool(samples[6].all()),
        )
