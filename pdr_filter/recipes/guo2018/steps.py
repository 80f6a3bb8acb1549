"""Step detector of Guo et al. 2018, sections 2.2.2 and 2.2.3: local maxima of a signal that depends on the pose.

Steps are detected while the level of motion is that of walking (eq. 1). A step must meet three criteria. It is a local
maximum of the low-passed signal of the pose (eq. 3 to 6; criterion 1). It exceeds the mean of the last seconds by c_M
standard deviations (criterion 2). The step frequency is possible for a person (criterion 3). All four signals are
filtered at all times, so that no filter restarts when the pose changes.

c_M is -omega_M / alpha_M of the paper. A maximum too soon after a step is dropped. A new bout begins after a pause
longer than 1 / v_min. `PoseStepDetector` lists the deviations from the paper.

c_M, `statistics_s` and v_max were chosen on persons 1 to 6 of A. Brajdic and R. Harle, "Walk detection and step
counting on unconstrained smartphones", UbiComp 2013, doi:10.1145/2493432.2493449, with the poses of the forest. On the
held-out persons 7 to 13 the mean absolute count error is 2.9 % (35 walks, median 1.4 %).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdr_filter.recipes.guo2018.features import MotionLevel, MotionLevelState
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.signal_filters import butterworth, filtered_rows, phase_delay_s
from pdr_filter.sensing.steps.step_detector import BaseStepDetector, ContextBlock, DetectorState, local_maxima, vertex
from pdr_filter.sensing.steps.step_log import specific_force_magnitude
from pdr_filter.values import CARRYING_MODES, BoolArray, FloatArray, IntArray, Step, check_numbers, replace_unchecked

_TEXTING, _CALLING, _POCKET, _SWINGING = range(4)  # rows of the signals: eq. 3, 4, 5 and 6
# Signal of each carrying mode. The last entry, which index -1 selects, is the signal of an unknown mode.
_SIGNAL_OF_MODE = np.array(
    [
        *({"texting": _TEXTING, "calling": _CALLING, "swinging": _SWINGING}.get(m, _POCKET) for m in CARRYING_MODES),
        _POCKET,
    ]
)


@dataclass(frozen=True, eq=False)
class PoseStepState(DetectorState):
    """State of the filters, the last filtered signals, and the last accepted maximum."""

    level: MotionLevelState
    zi: FloatArray | None  # (5, 4, 2); None before the first sample
    recent: FloatArray  # (6, <= L + 1): four filtered signals, 1 if walking, row of the signal of the pose
    last_peak: float  # fractional sample number of the last accepted maximum; -inf before the first


@dataclass(frozen=True)
class PoseStepDetector(BaseStepDetector[PoseStepState]):
    """Step detector of Guo et al. 2018, which finds local maxima of a signal that depends on the pose.

    The detector is causal. A step is reported at most `latency_s`, 0.44 s, after its contact.

    Parameters
    ----------
    rate_hz : float, default 100.0
        Sampling rate of the blocks in Hz.
    max_interval_s : float, default 2.0
        Pause in s after which a new walking bout begins, 1 / v_min.
    first_step_s : float, default 0.6
        Duration in s of the first step of a bout, because no contact marks its start.
    low_pass_hz : float, default 3.0
        Cutoff of the 10th-order Butterworth low-pass in Hz.
    statistics_s : float, default 2.0
        Length in s of the window of mean and standard deviation.
    texting, calling, pocket, swinging : float, default 0.45
        Threshold c_M of each pose. A maximum must exceed the mean by this many standard deviations.
    max_step_hz : float, default 3.0
        Largest step frequency in Hz, v_max.
    min_level, max_level : float
        Range of the level of motion of walking, delta_min and delta_max of eq. 1, in m2/s4.
    min_level_accelerometer : float
        delta_min without angular rate.

    Raises
    ------
    ValueError
        If a number is invalid, or if `max_interval_s` is shorter than a step at `max_step_hz`.

    Notes
    -----
    Deviations from the paper:

    - c_M = -omega_M / alpha_M is not printed and depends on the pose. Here it is 0.45 for all poses, because one for
      each pose was no better.
    - The window of mean and standard deviation is not given, and renewed with each step. Here it is the 2 s up to the
      maximum.
    - v_min and v_max are not printed. They are 0.5 and 3 Hz, so that the steps of a runner fit in.
    - The delay of the low-pass is not treated in the paper. Here the contact times are corrected by
      tau(f) = -arg H(f) / (2 pi f) at the frequency f of each step, which is 0.34 s at 1 Hz, 0.36 s at 2 Hz and 0.42 s
      at 3 Hz. A delay of 0.4 s is nearly a step.
    - Bags and unknown poses do not occur in the paper. Their signal is |f| (eq. 2). A swinging hand without a gyroscope
      also has this signal.

    Examples
    --------
    >>> from pdr_filter.recipes.guo2018.steps import PoseStepDetector
    >>> round(PoseStepDetector().latency_s, 2)
    0.44
    """

    low_pass_hz: float = 3.0
    statistics_s: float = 2.0
    texting: float = 0.45
    calling: float = 0.45
    pocket: float = 0.45
    swinging: float = 0.45
    max_step_hz: float = 3.0
    min_level: float = 0.91
    max_level: float = 1000.0
    min_level_accelerometer: float = 0.27

    def __post_init__(self) -> None:
        check_numbers(self, zero=("min_level", "min_level_accelerometer"), infinite=("max_level",))
        if not 1.0 / self.max_step_hz < self.max_interval_s:
            raise ValueError(
                f"max_interval_s must be longer than a step at max_step_hz, got {self.max_interval_s} s and "
                f"{self.max_step_hz} Hz"
            )
        if round(self.statistics_s * self.rate_hz) < 3:
            raise ValueError(
                f"statistics_s must be at least three samples long, got {self.statistics_s} s at {self.rate_hz} Hz"
            )

    @cached_property
    def _sos(self) -> FloatArray:
        return butterworth(10, self.low_pass_hz, self.rate_hz)

    @cached_property
    def _delay(self) -> tuple[FloatArray, FloatArray]:
        """Return frequencies in Hz, and the delay of the low-pass for sinusoids of these frequencies, in samples."""
        frequency_hz = np.linspace(0.01, self.max_step_hz, 330)
        return frequency_hz, phase_delay_s(self._sos, frequency_hz, self.rate_hz) * self.rate_hz

    @cached_property
    def _thresholds(self) -> tuple[float, float, float, float]:
        return self.texting, self.calling, self.pocket, self.swinging  # in the order of the rows

    @property
    def latency_s(self) -> float:
        return (math.ceil(float(self._delay[1].max())) + 2) / self.rate_hz

    @cached_property
    def _level(self) -> MotionLevel:
        return MotionLevel(self.rate_hz)

    @property
    def _n_statistics(self) -> int:
        return round(self.statistics_s * self.rate_hz)

    def init(self) -> PoseStepState:
        line = np.zeros((6, self._n_line))
        return PoseStepState(self._log.init(), line, self._level.init(), None, np.empty((6, 0)), -np.inf)

    @property
    def _n_line(self) -> int:
        return 1  # the last sample is kept at a gap or at the end

    def _signals(
        self, state: PoseStepState, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[PoseStepState, FloatArray]:
        """Return the new state, and (6, N): the four signals, 1 for walking samples, and the row of the pose's signal.

        The four signals are the result of `feature_signals`, not yet low-passed. The pose is the carrying mode.
        """
        level_state, level, has_rate = self._level.update(state.level, block)
        lowest = np.where(has_rate, self.min_level, self.min_level_accelerometer)
        is_walking = (lowest < level) & (level < self.max_level)
        row = signal_rows(contexts.carrying_mode, block.angular_rate_known)
        signals = np.vstack([feature_signals(block), is_walking.astype(float), row.astype(float)])
        return replace_unchecked(state, level=level_state), signals

    def _detect(
        self, state: PoseStepState, line: FloatArray, first: int
    ) -> tuple[PoseStepState, list[tuple[int, Step]]]:
        new = line[:, self._n_line :]
        low_passed, zi = filtered_rows(self._sos, new[:4], state.zi)
        line = np.concatenate([state.recent, np.vstack([low_passed, new[4:]])], axis=1)
        first -= state.recent.shape[1]  # number of the first sample of the line
        state = replace_unchecked(state, zi=zi)
        steps: list[tuple[int, Step]] = []
        # each sample is tested once, when the next sample is known
        for index in self._maxima(line, max(state.recent.shape[1] - 1, 1)):
            row = int(line[5, index])
            window = line[row, max(index + 1 - self._n_statistics, 0) : index + 1].copy()
            if window[-1] <= window.mean() + self._thresholds[row] * window.std():  # criterion 2
                continue
            state, step = self._accept(state, line[row, index - 1 : index + 2], first + index)
            if step is not None:
                steps.append((first + index + 1, step))
        return replace_unchecked(state, recent=line[:, -self._n_statistics - 1 :].copy()), steps

    def _maxima(self, line: FloatArray, start: int) -> list[int]:
        """Return the indices of walking samples, from `start` on, that are local maxima of the signal of their pose.

        `line` (6, N) has the four filtered signals, 1 for walking samples, and the row of the signal of the pose.
        """
        line = line[:, start - 1 :]
        row = line[5, 1:-1].astype(np.int64)
        is_maximum = local_maxima(line[:4])[row, np.arange(len(row))]
        return (start + np.flatnonzero(is_maximum & (line[4, 1:-1] > 0))).tolist()

    def _accept(self, state: PoseStepState, peak: FloatArray, sample: int) -> tuple[PoseStepState, Step | None]:
        """Return the new state, and the step of a local maximum, or None if the step frequency is above `max_step_hz`.

        `peak` (3,) has the maximum and its neighbours, and `sample` is the number of the maximum. The frequency limit
        is criterion 3 of Guo et al. 2018. The result is also None if the samples of the step are not available.
        """
        at = sample + vertex(peak)
        interval_s = (at - state.last_peak) / self.rate_hz
        if interval_s * self.max_step_hz < 1.0:
            return state, None
        is_first = interval_s > self.max_interval_s
        step_hz = 1.0 / (self.first_step_s if is_first else interval_s)
        contact = at - float(np.interp(step_hz, *self._delay))
        state, step = self._end_step(state, contact, sample + 1)
        return (state if step is None else replace_unchecked(state, last_peak=at)), step


def feature_signals(block: UniformBlock) -> FloatArray:
    """Return the signals (4, N) in which the steps of each pose (carrying mode) are detected (Guo et al. 2018).

    They are sqrt(f_y^2 + f_z^2) for texting, sqrt(f_x^2 + f_y^2) for calling, |f| for a pocket, and |w_z| for a
    swinging hand (eq. 3 to 6). f is the specific force in m/s2 and w the angular rate in rad/s.
    """
    x, y, z = block.specific_force_mps2.T
    return np.stack(
        [
            np.sqrt(y * y + z * z),
            np.sqrt(x * x + y * y),
            specific_force_magnitude(block.specific_force_mps2),
            np.abs(block.angular_rate_radps[:, 2]),
        ]
    )


def signal_rows(carrying_mode: IntArray, angular_rate_known: BoolArray) -> IntArray:
    """Return the row of `feature_signals` for each sample, (N,), from the carrying mode of a `ContextBlock`.

    Without angular rate, the signal for a pocket replaces the signal for a swinging hand.
    """
    row = _SIGNAL_OF_MODE[carrying_mode]
    return np.where((row == _SWINGING) & ~angular_rate_known, _POCKET, row)
