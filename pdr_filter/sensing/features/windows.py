"""Sliding windows over the signals of all sensors: one feature vector a window, causal.

Windows of 2 s with 50 % overlap (Martinelli et al. 2018, section V and Fig. 12) start with the segment; a window that a
gap would cut does not exist.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi

from pdr_filter.papers.martinelli2018 import features as martinelli
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.features import carrying, invariant
from pdr_filter.sensing.features.sliding import check_window, take_windows
from pdr_filter.sensing.steps.detector import specific_force_magnitude
from pdr_filter.values.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FeatureWindow:
    """Features of one window."""

    time_s: float  # end of the window
    names: tuple[str, ...]
    features: FloatArray  # (F,) in the order of the names
    has_gyroscope: bool
    has_magnetometer: bool


@dataclass(frozen=True, slots=True, eq=False)
class WindowState:
    """Samples that later windows still need."""

    first: int  # index of the first sample in the buffer
    zi: FloatArray | None
    buffer: FloatArray  # (19, B): time, four magnitudes, two sensors known or not, `invariant.SIGNALS`


# "invariant" are the attitude-free features for the context, followed by those for the carrying mode.
FEATURE_SETS: dict[str, tuple[str, ...]] = {
    "martinelli": martinelli.NAMES,
    "invariant": (*invariant.NAMES, *carrying.NAMES),
}


@dataclass(frozen=True)
class FeatureWindows:
    """Windows and their features.

    Parameters
    ----------
    feature_set : {"martinelli", "invariant"}
        The 28 features of Martinelli et al. 2018, or those that do not change with the phone's attitude.
    rate_hz : float
        Sampling rate of the blocks.
    window_s, hop_s : float
        Length and advance.
    low_pass_hz : float
        Cutoff of the low-pass of Table II, which the paper does not give: 5 Hz keeps the first harmonics of a step.
    """

    feature_set: str = "martinelli"
    rate_hz: float = 100.0
    window_s: float = 2.0
    hop_s: float = 1.0
    low_pass_hz: float = 5.0

    def __post_init__(self) -> None:
        if self.feature_set not in FEATURE_SETS:
            raise ValueError(f"feature_set must be one of {tuple(FEATURE_SETS)}, got {self.feature_set!r}")
        check_window(self.window_samples, self.hop_samples)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the features."""
        return FEATURE_SETS[self.feature_set]

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
        return WindowState(0, None, np.empty((19, 0)))

    def step(
        self, state: WindowState, block: UniformBlock, attitude: AttitudeBlock
    ) -> tuple[WindowState, list[tuple[int, FeatureWindow]]]:
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
                attitude.vertical_mps2,
                *attitude.horizontal_mps2.T,
                *block.angular_rate_radps.T,
                *attitude.up_sensor.T,
                *block.specific_force_mps2.T,
            ]
        )
        buffer = np.concatenate([state.buffer, new], axis=1)
        buffer, first, cut = take_windows(buffer, state.first, self.window_samples, self.hop_samples)
        if not cut:
            return WindowState(first, zi, buffer), []
        ends, samples = zip(*cut, strict=True)
        return WindowState(first, zi, buffer), list(zip(ends, self._describe(np.stack(samples)), strict=True))

    def _describe(self, samples: FloatArray) -> list[FeatureWindow]:
        """The windows of samples (W, 19, N)."""
        features = (
            np.array([martinelli.features_28(window, self.rate_hz) for window in samples[:, 1:5]])
            if self.feature_set == "martinelli"
            else np.hstack(
                [
                    invariant.invariant_features(samples[:, 7:], self.rate_hz),
                    carrying.carrying_features(samples[:, 7:], self.rate_hz),
                ]
            )
        )
        time_s = samples[:, 0, -1] + 0.5 / self.rate_hz
        known = samples[:, 5:7].min(axis=2) > 0
        return [
            FeatureWindow(float(time_s[i]), self.names, features[i], bool(known[i, 0]), bool(known[i, 1]))
            for i in range(len(samples))
        ]
