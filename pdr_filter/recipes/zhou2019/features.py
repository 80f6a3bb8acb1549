"""Features of Zhou et al. 2019, section III, for the behaviour of a person with an accelerometer on the foot.

The acceleration a = |f - b| - g (eq. 2), with the bias b of a static start (eq. 3), is low-passed by a linear-phase FIR
filter with a Hamming window. Variance, DC component f_0 and energy (eq. 4) over 2 s distinguish standing, walking,
running and irregular swing.

Deviations from the paper, in addition to those in `contexts.BehaviourStage`:

- The vertical is the direction of the mean specific force of the start unless it is given, because eq. 3 would count a
  tilt of 5 degrees as a bias of 0.85 m/s2.
- f_0 is the mean of a in m/s2, with its sign.
- The energy is the mean absolute coefficient of the two-sided transform, as printed, so that the energy of a sinusoid
  is its amplitude.
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
from pdr_filter.sensing.signal_filters import low_pass_kernel
from pdr_filter.sensing.steps.step_log import specific_force_magnitude
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, replace_unchecked


def static_bias(static_mps2: FloatArray, up_sensor: FloatArray | None = None) -> FloatArray:
    """Return the accelerometer bias b = mean(f) - g up, (3,) in m/s2, from specific force f (N, 3) of a sensor at rest.

    `up_sensor` is the unit vector up (3,) in the sensor frame. [0, 0, 1] gives eq. 3 of Zhou et al. 2019 as printed. By
    default it is the direction of the mean specific force.
    """
    mean = static_mps2.mean(axis=0)
    up = mean / np.sqrt((mean * mean).sum()) if up_sensor is None else up_sensor
    return mean - STANDARD_GRAVITY_MPS2 * up


def acceleration(specific_force_mps2: FloatArray, bias_mps2: FloatArray) -> FloatArray:
    """Return the acceleration a = |f - b| - g in m/s2, (N,), from specific force f (N, 3) and bias b (3,).

    g is the standard gravity (Zhou et al. 2019, eq. 2).
    """
    return specific_force_magnitude(specific_force_mps2 - bias_mps2) - STANDARD_GRAVITY_MPS2


def behaviour_features(acceleration_mps2: FloatArray) -> FloatArray:
    """Return variance in m2/s4, DC component in m/s2 and energy in m/s2, (3,), of filtered acceleration (N,).

    The DC component f_0 is the mean. The energy is the mean absolute value of the Fourier coefficients without f_0
    (Zhou et al. 2019, eq. 4). It is an amplitude and not a power.
    """
    n = len(acceleration_mps2)
    dc_component = acceleration_mps2.mean()
    centred = acceleration_mps2 - dc_component
    coefficients = np.fft.fft(centred)  # without the DC component
    return np.array([(centred * centred).mean(), dc_component, np.abs(coefficients[1:]).sum() / n])


@dataclass(frozen=True, slots=True, eq=False)
class BehaviourWindow(DescribedWindow):
    """Variance, DC component and energy of one window, and the maximum of its filtered acceleration in m/s2.

    Its times are corrected for the delay of the filter.
    """

    features: FloatArray  # (3,)
    max_mps2: float  # maximum of the filtered acceleration, for Condition 1 of Table 1


@dataclass(frozen=True, eq=False)
class BehaviourState:
    """Bias or the samples collected for it, delay line of the filter, and samples that later windows need."""

    waiting: FloatArray  # (B, 4): time, specific force; empty when the bias is known
    bias_mps2: FloatArray | None  # (3,); None before it is known
    delay_line: FloatArray  # (L - 1,) acceleration; empty before the first sample
    buffer: WindowBuffer  # filtered acceleration


@dataclass(frozen=True)
class BehaviourWindows(SlidingWindows[BehaviourState, BehaviourWindow]):
    """Causal windows of filtered acceleration, and their features."""

    hop_s: float = 2.0
    static_s: float = 1.0  # length of the static start in s, at most that of the window, so that it delays no window
    # Largest standard deviation of |f| of a static start. The bias is zero if it is exceeded, or if |f| is far from
    # gravity. Over one second, a standing foot has less than 0.05 m/s2 (pyshoe), and a walking foot more than 1 m/s2.
    static_std_mps2: float = 0.3
    low_pass_hz: float = 10.0  # cutoff (-6 dB) of the FIR filter in Hz
    # Length of the FIR filter in s. Its delay is half of this. The transition band of 0.5 s is 6.6 Hz wide.
    low_pass_s: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.static_samples <= self.window_samples:
            raise ValueError(f"static_s must be positive and at most window_s, got {self.static_s} and {self.window_s}")
        if not 0 < self.low_pass_hz < 0.5 * self.rate_hz:
            raise ValueError(
                f"low_pass_hz must be positive and below half the rate, got {self.low_pass_hz} at {self.rate_hz} Hz"
            )

    @property
    def static_samples(self) -> int:
        """Length of the static start in samples."""
        return round(self.static_s * self.rate_hz)

    @property
    def latency_s(self) -> float:
        """Delay of the filter in s."""
        return (len(self._taps) // 2) / self.rate_hz

    @cached_property
    def _taps(self) -> FloatArray:
        return low_pass_kernel(self.low_pass_hz, self.rate_hz, self.low_pass_s)

    def init(self) -> BehaviourState:
        return BehaviourState(np.empty((0, 4)), None, np.empty(0), no_samples(1))

    def after_gap(self, state: BehaviourState) -> BehaviourState:
        return replace_unchecked(self.init(), bias_mps2=state.bias_mps2)

    def update(
        self, state: BehaviourState, block: UniformBlock, attitude: AttitudeBlock
    ) -> tuple[BehaviourState, list[tuple[int, BehaviourWindow]]]:
        rows = np.concatenate([state.waiting, np.column_stack([block.time_s, block.specific_force_mps2])])
        bias = state.bias_mps2
        if bias is None:
            if len(rows) < self.static_samples:
                return replace_unchecked(state, waiting=rows), []
            bias = self._bias(np.ascontiguousarray(rows[: self.static_samples, 1:]))
        a = acceleration(rows[:, 1:], bias)
        # the first value is repeated before the start, because a zero there would act like a shock
        before = state.delay_line if len(state.delay_line) else np.full(len(self._taps) - 1, a[0])
        line = np.concatenate([before, a])
        # each output is one dot product with the kernel, so that results are bit-identical for any split into blocks
        buffer, windows = self.cut(state.buffer, rows[:, 0], np.convolve(line, self._taps, mode="valid")[None])
        state = BehaviourState(np.empty((0, 4)), bias, line[len(a) :], buffer)
        return state, [(window.last, self._describe(window)) for window in windows]

    def _bias(self, start_mps2: FloatArray) -> FloatArray:
        magnitude = specific_force_magnitude(start_mps2)
        is_static = magnitude.std() <= self.static_std_mps2 and magnitude.mean() > 0.5 * STANDARD_GRAVITY_MPS2
        return static_bias(start_mps2) if is_static else np.zeros(3)

    def _describe(self, window: SampleWindow) -> BehaviourWindow:
        acceleration_mps2 = window.samples[0]
        return BehaviourWindow(
            start_s=window.start_s - self.latency_s,
            time_s=window.end_s - self.latency_s,
            features=behaviour_features(acceleration_mps2),
            max_mps2=float(acceleration_mps2.max()),
        )
