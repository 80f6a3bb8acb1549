"""Sliding windows over the signals of all sensors: one feature vector a window, causal.

Windows of 2 s with 50 % overlap (Martinelli et al. 2018, section V and Fig. 12) start with the segment; a window that a
gap would cut does not exist.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.features import carrying, invariant, stride
from pdr_filter.sensing.features.sliding_windows import DescribedWindow, SlidingWindows, WindowBuffer, no_samples
from pdr_filter.sensing.signal_filters import butterworth, filtered
from pdr_filter.sensing.steps.step_log import specific_force_magnitude
from pdr_filter.values import FeatureSet, FloatArray

# What a feature set is given of a window: |f| and low-passed |f| in m/s2, |omega| in rad/s, |m| in uT, and then
# `invariant.SIGNALS`.
N_MAGNITUDES = 4
N_SIGNALS = N_MAGNITUDES + len(invariant.SIGNALS)  # named by `values.WINDOW_SIGNALS`


@dataclass(frozen=True)
class AttitudeFreeFeatures:
    """Features that do not change with the phone's attitude, then those of the carrying mode, then of the stride."""

    name: str = "invariant"
    low_pass_hz: None = None
    names: tuple[str, ...] = (*invariant.NAMES, *carrying.NAMES, *stride.NAMES)

    def describe(self, windows: FloatArray, rate_hz: float) -> FloatArray:
        """Features (W, F) of the signals of windows (W, N_SIGNALS, N)."""
        return invariant.in_groups(_of_group, windows[:, N_MAGNITUDES:], rate_hz, len(self.names))


def _of_group(windows: FloatArray, rate_hz: float) -> FloatArray:
    swing = invariant.swing_lines(windows)
    parts = (
        invariant.features_of(windows, swing, rate_hz),
        carrying.features_of(windows, rate_hz),
        stride.features_of(windows, swing, rate_hz),
    )
    return np.concatenate(parts, axis=1)


ATTITUDE_FREE = AttitudeFreeFeatures()


@dataclass(frozen=True, slots=True, eq=False)
class FeatureWindow(DescribedWindow):
    """Features of one window."""

    names: tuple[str, ...]
    features: FloatArray  # (F,) in the order of the names
    has_gyroscope: bool


@dataclass(frozen=True, slots=True, eq=False)
class WindowState:
    """Filter memory, and samples that later windows still need."""

    zi: FloatArray | None  # (1, 1, 2); None before the first sample, and where nothing is filtered
    buffer: WindowBuffer  # of the angular rate known or not, and N_SIGNALS signals


@dataclass(frozen=True)
class FeatureWindows(SlidingWindows[WindowState, FeatureWindow]):
    """Windows and their features."""

    features: FeatureSet = field(kw_only=True)

    @cached_property
    def _sos(self) -> FloatArray | None:
        low_pass_hz = self.features.low_pass_hz
        return None if low_pass_hz is None else butterworth(2, low_pass_hz, self.rate_hz)

    def init(self) -> WindowState:
        """State at the start of a segment."""
        return WindowState(None, no_samples(1 + N_SIGNALS))

    def update(
        self, state: WindowState, block: UniformBlock, attitude: AttitudeBlock
    ) -> tuple[WindowState, list[tuple[int, FeatureWindow]]]:
        """New state and the windows that became complete, each with the index of its last sample."""
        force = specific_force_magnitude(block.specific_force_mps2)
        low_passed, zi = np.zeros((1, len(force))), None
        if self._sos is not None:
            low_passed, zi = filtered(self._sos, force[None], state.zi)
        buffer, windows = self.cut(
            state.buffer,
            block.time_s,
            block.angular_rate_known.astype(float)[None],
            force[None],
            low_passed,
            specific_force_magnitude(block.angular_rate_radps)[None],
            specific_force_magnitude(block.magnetic_field_ut)[None],
            attitude.vertical_mps2[None],
            attitude.horizontal_mps2.T,
            block.angular_rate_radps.T,
            attitude.up_sensor.T,
            block.specific_force_mps2.T,
        )
        if not windows:
            return WindowState(zi, buffer), []
        samples = np.stack([w.samples for w in windows])
        features = self.features.describe(samples[:, 1:], self.rate_hz)
        has_gyroscope = samples[:, 0].min(axis=1) > 0
        found = [
            (w.last, FeatureWindow(w.start_s, w.end_s, self.features.names, features[i], bool(has_gyroscope[i])))
            for i, w in enumerate(windows)
        ]
        return WindowState(zi, buffer), found
