"""Sliding windows over the signals of all sensors, each with one feature vector, as a causal stage.

Windows of 2 s with 50 % overlap (Martinelli et al. 2018, section V and Fig. 12) start at the beginning of the segment.
No window spans a gap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.features import carrying, invariant, stride
from pdr_filter.sensing.features.sliding_windows import (
    DescribedWindow,
    SampleWindow,
    SlidingWindows,
    WindowBuffer,
    no_samples,
)
from pdr_filter.sensing.signal_filters import butterworth, filtered_rows
from pdr_filter.sensing.steps.step_log import specific_force_magnitude
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FeatureSet, FloatArray, read_only

# Signals of a window that a feature set receives: |f| and low-passed |f| in m/s2, |omega| in rad/s, |m| in uT, and then
# `invariant.SIGNALS`. `values.WINDOW_SIGNALS` has their names.
N_MAGNITUDES = 4
N_SIGNALS = N_MAGNITUDES + len(invariant.SIGNALS)
# Rows of the specific force and of the angular rate in the samples of a window, after the row of known angular rates.
_FORCE, _RATE = (slice(i, i + 3) for i in (N_SIGNALS - 2, N_SIGNALS - 8))


@dataclass(frozen=True)
class AttitudeFreeFeatures:
    """Feature set of the shipped models, independent of the attitude of the phone.

    The features describe the motion (`invariant`), the carrying mode (`carrying`) and the stride (`stride`).
    """

    name: str = "invariant"
    low_pass_hz: None = None
    names: tuple[str, ...] = (*invariant.NAMES, *carrying.NAMES, *stride.NAMES)

    def describe(self, windows: FloatArray, rate_hz: float) -> FloatArray:
        """Return the features (W, F) of the signals of windows (W, N_SIGNALS, N)."""
        return invariant.features_in_groups(_all_features, windows[:, N_MAGNITUDES:], rate_hz, len(self.names))


def _all_features(motion: invariant.MotionLines, rate_hz: float) -> FloatArray:
    """Return all features (W, F) of a few windows."""
    parts = (
        invariant.invariant_features_of_motion,
        carrying.carrying_features_of_motion,
        stride.stride_features_of_motion,
    )
    return np.concatenate([features(motion, rate_hz) for features in parts], axis=1)


ATTITUDE_FREE = AttitudeFreeFeatures()


@dataclass(frozen=True, slots=True, eq=False)
class FeatureWindow(DescribedWindow):
    """Features of one window.

    Attributes
    ----------
    names : tuple of str
        Names of the F features.
    features : FloatArray
        Values of the features, shape (F,).
    has_gyroscope : bool
        True if the angular rate is known in all samples of the window.
    is_still : bool
        True if the features are those of a motionless phone (`FeatureWindows`).
    """

    names: tuple[str, ...]
    features: FloatArray
    has_gyroscope: bool
    is_still: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class WindowState:
    """State of the feature windows."""

    # (1, 1, 2) memory of the low-pass filter. None before the first sample, and for feature sets without low-pass.
    zi: FloatArray | None
    # Buffered signals: 1 or 0 for a known or unknown angular rate, followed by the `N_SIGNALS` signals
    buffer: WindowBuffer


@dataclass(frozen=True)
class FeatureWindows(SlidingWindows[WindowState, FeatureWindow]):
    """Causal stage that cuts sliding windows and computes the features of each.

    Parameters
    ----------
    rate_hz : float, default 100
        Sampling rate of the blocks, Hz.
    window_s : float, default 2
        Length of the windows, s.
    hop_s : float, default 1
        Time between the starts of consecutive windows, s, at most `window_s`.
    features : FeatureSet
        Feature set: names, cutoff of the low-pass, and a function of the signals of windows.
    still_mps2, still_radps : float, default 0
        A window is still if the standard deviations of its specific force and of its angular rate are below these
        limits. Each is the square root of the summed variances of the three axes. A still window has the features of a
        motionless phone, which are computed only once. With 0, no window is still.

    Raises
    ------
    ValueError
        If a parameter is out of its range, or `hop_s` is longer than `window_s`.

    Examples
    --------
    Three seconds of a phone at rest give two windows of 2 s:

    >>> import numpy as np
    >>> from pdr_filter.sensing.features.feature_windows import ATTITUDE_FREE, FeatureWindows
    >>> from pdr_filter.sensing.front_end import feature_windows
    >>> from pdr_filter.values import ImuBlock
    >>> time_s = np.arange(0.0, 3.1, 0.01)
    >>> force, rate = np.full((310, 3), [0.0, 0.0, 9.81]), np.zeros((310, 3))
    >>> samples = ImuBlock(time_s, force, rate, magnetic_field_ut=np.full((310, 3), np.nan))
    >>> windows = list(feature_windows(FeatureWindows(features=ATTITUDE_FREE), [samples]))
    >>> [(round(w.start_s, 2), round(w.time_s, 2), w.has_gyroscope) for w in windows]
    [(0.0, 2.0, True), (1.0, 3.0, True)]
    >>> windows[0].features.shape == (len(ATTITUDE_FREE.names),)
    True
    """

    features: FeatureSet = field(kw_only=True)
    still_mps2: float = field(default=0.0, kw_only=True)
    still_radps: float = field(default=0.0, kw_only=True)

    _may_be_zero = ("still_mps2", "still_radps")

    @cached_property
    def _sos(self) -> FloatArray | None:
        """Second-order sections of the low-pass, or None if the feature set needs no low-pass."""
        low_pass_hz = self.features.low_pass_hz
        return None if low_pass_hz is None else butterworth(2, low_pass_hz, self.rate_hz)

    def init(self) -> WindowState:
        return WindowState(None, no_samples(1 + N_SIGNALS))

    def update(
        self, state: WindowState, block: UniformBlock, attitude: AttitudeBlock
    ) -> tuple[WindowState, list[tuple[int, FeatureWindow]]]:
        magnitudes, zi = np.zeros((N_MAGNITUDES, len(block.time_s))), None
        # The features of the shipped models use no magnitudes, which would only make saved filters larger.
        if type(self.features) is not AttitudeFreeFeatures:
            magnitudes[0] = specific_force_magnitude(block.specific_force_mps2)
            magnitudes[2] = specific_force_magnitude(block.angular_rate_radps)
            magnitudes[3] = specific_force_magnitude(block.magnetic_field_ut)
        if self._sos is not None:
            magnitudes[1:2], zi = filtered_rows(self._sos, magnitudes[:1], state.zi)
        buffer, windows = self.cut(
            state.buffer,
            block.time_s,
            block.angular_rate_known.astype(float)[None],
            magnitudes,
            attitude.vertical_mps2[None],
            attitude.horizontal_mps2.T,
            block.angular_rate_radps.T,
            attitude.up_sensor.T,
            block.specific_force_mps2.T,
        )
        if not windows:
            return WindowState(zi, buffer), []
        has_gyroscope = (np.array([w.samples[0] for w in windows]).min(axis=1) > 0).tolist()
        still, names = self._are_still(windows), self.features.names
        moving = [w.samples for w, is_still in zip(windows, still, strict=True) if not is_still]
        features = iter(self.features.describe(np.array(moving)[:, 1:], self.rate_hz) if moving else ())
        found = [
            (w.last, FeatureWindow(w.start_s, w.end_s, names, self._at_rest if rests else next(features), known, rests))
            for w, known, rests in zip(windows, has_gyroscope, still, strict=True)
        ]
        return WindowState(zi, buffer), found

    def _are_still(self, windows: Sequence[SampleWindow]) -> list[bool]:
        """Return True for each still window, which depends on the standard deviations of this window alone."""
        if not (self.still_mps2 and self.still_radps):
            return [False] * len(windows)
        motion = np.array([(w.samples[_FORCE], w.samples[_RATE]) for w in windows])
        variance = invariant.mean_square(invariant.about_mean(motion)).sum(axis=2)
        return (variance < np.square([self.still_mps2, self.still_radps])).all(axis=1).tolist()

    @cached_property
    def _at_rest(self) -> FloatArray:
        """Features (F,) of a motionless phone, which lies face up."""
        signals = np.zeros((1, N_SIGNALS, self.window_samples))
        signals[:, [0, 1, N_MAGNITUDES + invariant.SIGNALS.index("force_z")]] = STANDARD_GRAVITY_MPS2
        signals[:, N_MAGNITUDES + invariant.SIGNALS.index("up_z")] = 1.0
        return read_only(self.features.describe(signals, self.rate_hz)[0])
