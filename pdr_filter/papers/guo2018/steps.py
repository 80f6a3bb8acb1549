"""Steps as local maxima of a signal that depends on where the phone is: Guo et al. 2018, sections 2.2.2 and 2.2.3.

The signal is (ay^2 + az^2)^(1/2) when texting, (ax^2 + ay^2)^(1/2) when calling, |a| in a pocket and |gz| when swinging
(eq. 3 to 6), low-passed at 3 Hz. While the level of motion is that of walking (eq. 1), a local maximum (criterion 1)
above mean + c_M deviation of the last seconds (criterion 2) is a step if the step frequency is one of people
(criterion 3). All four signals are filtered all the time, so that a change of pose starts no filter anew.

Deviations:

- In criterion 2, mu - omega_M sigma / alpha, the constants are not printed, only that they depend on the pose. They are
  one number here, c_M = -omega_M / alpha. Mean and deviation are those of the last `statistics_s` up to the maximum, at
  every maximum: the pseudocode updates them with each step, in a window whose length is not printed.
- c_M, v_min and v_max are the same for all poses: one for each was no better on those whom they were chosen on.
- The 10th-order low-pass delays a sinusoid by 0.34 s at 1 Hz and 0.42 s at 3 Hz. That is taken off the time of each
  contact, at the frequency of the step, the first of a bout at that of a typical one.
- A maximum that comes too early after a step is dropped; after a pause longer than 1 / v_min a new bout begins.
- Where the pose is unknown or a bag, or the angular rate of a swinging phone is missing, the signal is |a| (eq. 2).
- A swinging hand is fastest beside the hip, a part of a step after the contact; the time is not corrected for that.

Where the constants come from: c_M, `statistics_s` and v_max were chosen on people 1 to 6 of A. Brajdic and R. Harle,
"Walk detection and step counting on unconstrained smartphones", UbiComp 2013, doi:10.1145/2493432.2493449, in the poses
that the forest of `pdr_filter.papers.guo2018.contexts` told; people 7 to 13 had no say. Nothing else of that data is
here. Their count error is flat from 0.4 to 0.5 deviations and 1.75 to 2 s. A v_max of 2.7 Hz is slightly better for
them (2.0 % in place of 2.2 % at 0.4), because slow walkers make two maxima a step, but a runner would lose every
second step. delta_min and delta_max are those of `pdr_filter.papers.guo2018.contexts`.

Limits: there is no gate for a phone that is handled; on people 7 to 13 that makes 35 false steps a minute. The count
error there is 2.9 % (mean absolute, 35 walks, median 1.4 %); it was 3.4 % with another training of the forest, and is
3.0 % with |a| in all poses: what the poses gain in one place they lose in another (docs/methods/guo2018.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi, sosfreqz

from pdr_filter.papers.guo2018.features import MotionLevel, MotionLevelState
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.detector import ModeBlock, StepLog, StepLogState, specific_force_magnitude
from pdr_filter.values.arrays import BoolArray, FloatArray, IntArray
from pdr_filter.values.contexts import CARRYING_MODES
from pdr_filter.values.step import Step

_TEXTING, _CALLING, _POCKET, _SWINGING = range(4)  # rows of the signals: eq. 3, 4, 5 and 6
# The signal of each carrying mode, and last of an unknown one, which index -1 finds.
_SIGNAL_OF_MODE = np.array(
    [
        *({"texting": _TEXTING, "calling": _CALLING, "swinging": _SWINGING}.get(m, _POCKET) for m in CARRYING_MODES),
        _POCKET,
    ]
)


@dataclass(frozen=True, slots=True, eq=False)
class PoseStepState:
    """Filter memories, and the last contact."""

    log: StepLogState
    level: MotionLevelState
    n_samples: int  # that went through the filter
    zi: FloatArray | None  # (5, 4, 2); None before the first sample
    last: FloatArray  # (6,) the four signals of the last sample, whether somebody walks, row of the pose's signal
    recent: FloatArray  # (6, <= L + 1) the same of the last samples, the signals filtered
    last_peak: float  # number of the sample, and a part, of the last accepted maximum; -inf before


@dataclass(frozen=True)
class PoseStepDetector:
    """Causal step detector; a step is reported at most `latency_s`, 0.44 s, after its contact.

    Parameters
    ----------
    rate_hz : float
        Sampling rate of the blocks.
    low_pass_hz : float
        Cutoff of the 10th-order Butterworth low-pass.
    statistics_s : float
        Length of the window of mean and deviation.
    texting, calling, pocket, swinging : float
        c_M of each pose: how many deviations above the mean a maximum must be.
    min_step_hz, max_step_hz : float
        v_min and v_max.
    min_level, max_level : float
        delta_min and delta_max of eq. 1.
    min_level_accelerometer : float
        delta_min where the angular rate is missing.
    first_step_s : float
        Duration given to the first step of a bout, whose start no contact marks: a typical step from rest.
    """

    rate_hz: float = 100.0
    low_pass_hz: float = 3.0
    statistics_s: float = 2.0
    texting: float = 0.45
    calling: float = 0.45
    pocket: float = 0.45
    swinging: float = 0.45
    min_step_hz: float = 0.5
    max_step_hz: float = 3.0
    min_level: float = 0.91
    max_level: float = 1000.0
    min_level_accelerometer: float = 0.27
    first_step_s: float = 0.6

    def __post_init__(self) -> None:
        if not 0 < self.min_step_hz < self.max_step_hz:
            raise ValueError(f"min_step_hz must be below max_step_hz, got {self.min_step_hz} and {self.max_step_hz}")
        if round(self.statistics_s * self.rate_hz) < 3:
            raise ValueError(f"statistics_s must be at least three samples, got {self.statistics_s}")

    @cached_property
    def _sos(self) -> FloatArray:
        return np.asarray(butter(10, self.low_pass_hz, fs=self.rate_hz, output="sos"))

    @cached_property
    def _delay(self) -> tuple[FloatArray, FloatArray]:
        """Frequencies, and by how many samples the low-pass delays a sinusoid: -phase / (2 pi f)."""
        frequency_hz = np.linspace(0.01, self.max_step_hz, 330)
        response = sosfreqz(self._sos, frequency_hz, fs=self.rate_hz)[1]
        phase = np.unwrap(np.angle(np.asarray(response)))
        return frequency_hz, -phase / (2 * np.pi * frequency_hz) * self.rate_hz

    @cached_property
    def _thresholds(self) -> tuple[float, float, float, float]:
        return self.texting, self.calling, self.pocket, self.swinging  # in the order of the rows

    @property
    def latency_s(self) -> float:
        """Longest time from a contact to its detection."""
        return (math.ceil(float(self._delay[1].max())) + 2) / self.rate_hz

    @cached_property
    def _log(self) -> StepLog:
        return StepLog(self.rate_hz, self.latency_s, 1.0 / self.min_step_hz, self.first_step_s)

    @cached_property
    def _level(self) -> MotionLevel:
        return MotionLevel(self.rate_hz)

    @property
    def _n_statistics(self) -> int:
        return round(self.statistics_s * self.rate_hz)

    def init(self) -> PoseStepState:
        """State before the first sample of a segment."""
        return PoseStepState(self._log.init(), self._level.init(), 0, None, np.zeros(6), np.empty((6, 0)), -np.inf)

    def step(
        self, state: PoseStepState, block: UniformBlock, attitude: AttitudeBlock, modes: ModeBlock
    ) -> tuple[PoseStepState, list[tuple[int, Step]]]:
        """New state and the steps that became known, each with the number of the sample that revealed it."""
        level_state, level, has_rate = self._level.step(state.level, block)
        lowest = np.where(has_rate, self.min_level, self.min_level_accelerometer)
        is_walking = (lowest < level) & (level < self.max_level)
        row = signal_rows(modes.carrying_mode, block.angular_rate_known)
        signals = np.vstack([feature_signals(block), is_walking.astype(float), row.astype(float)])
        state = replace(state, log=self._log.extend(state.log, block, attitude), level=level_state)
        state, steps = self._detect(state, signals)
        return replace(state, log=self._log.trim(state.log)), steps

    def finish(self, state: PoseStepState) -> list[tuple[int, Step]]:
        """Steps in the last `latency_s` before a gap or the end, whose last values are taken to stay."""
        if state.n_samples == 0:
            return []
        end = state.n_samples
        last_s = self._log.time_s(state.log, end - 1)
        n_more = round(self.latency_s * self.rate_hz)
        _, steps = self._detect(state, np.tile(state.last[:, None], n_more))
        return [(end - 1, replace(s, detected_time_s=last_s)) for _, s in steps if s.time_s <= last_s]

    def _detect(self, state: PoseStepState, signals: FloatArray) -> tuple[PoseStepState, list[tuple[int, Step]]]:
        """Detect in further samples (6, N) of the signals, whether somebody walks, and the row of the pose."""
        zi = state.zi
        if zi is None:
            # What was before the first sample is taken to be like it: a zero there would look like a blow.
            zi = np.asarray(sosfilt_zi(self._sos))[:, None, :] * signals[:4, :1]
        filtered, zi = sosfilt(self._sos, signals[:4], axis=1, zi=zi)
        line = np.concatenate([state.recent, np.vstack([filtered, signals[4:]])], axis=1)
        first = state.n_samples - state.recent.shape[1]  # number of the line's first sample
        state = replace(state, n_samples=state.n_samples + signals.shape[1], zi=zi, last=signals[:, -1].copy())
        steps: list[tuple[int, Step]] = []
        # Each sample is judged once, when the one after it is known.
        for index in self._maxima(line, max(state.recent.shape[1] - 1, 1)):
            row = int(line[5, index])
            window = line[row, max(index + 1 - self._n_statistics, 0) : index + 1].copy()
            if window[-1] <= window.mean() + self._thresholds[row] * window.std():  # criterion 2
                continue
            state, step = self._accept(state, line[row, index - 1 : index + 2], first + index)
            if step is not None:
                steps.append((first + index + 1, step))
        return replace(state, recent=line[:, -self._n_statistics - 1 :].copy()), steps

    def _maxima(self, line: FloatArray, start: int) -> list[int]:
        """Samples of a line, from a start on, that are local maxima of their pose's signal while somebody walks."""
        middle = np.arange(start, line.shape[1] - 1)
        row = line[5, middle].astype(np.int64)
        value, before, after = line[row, middle], line[row, middle - 1], line[row, middle + 1]
        return middle[(value > before) & (value >= after) & (line[4, middle] > 0)].tolist()

    def _accept(self, state: PoseStepState, peak: FloatArray, sample: int) -> tuple[PoseStepState, Step | None]:
        """The step that a maximum of the filtered signal makes, if its frequency is that of a step (criterion 3)."""
        # vertex of the parabola through the three values: contact times finer than the sampling interval
        curvature = peak[0] - 2 * peak[1] + peak[2]
        at = sample + (float(0.5 * (peak[0] - peak[2]) / curvature) if curvature < 0 else 0.0)
        interval_s = (at - state.last_peak) / self.rate_hz
        if interval_s * self.max_step_hz < 1.0:
            return state, None
        is_first = interval_s * self.min_step_hz > 1.0
        step_hz = 1.0 / (self.first_step_s if is_first else interval_s)
        contact = at - float(np.interp(step_hz, *self._delay))
        whole = math.floor(contact)
        if whole <= max(self._log.first_sample(state.log), state.log.last_contact, 0) or whole >= state.log.n_samples:
            return state, None
        log, step = self._log.add(state.log, whole, sample + 1, contact - whole)
        return replace(state, log=log, last_peak=at), step


def feature_signals(block: UniformBlock) -> FloatArray:
    """The signals of texting, calling, pocket and swinging, (4, N): eq. 3, 4, 5 and 6."""
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
    """Row of `feature_signals` to use at each sample, (N,), from the carrying mode as `ModeBlock` has it."""
    row = _SIGNAL_OF_MODE[carrying_mode]
    return np.where((row == _SWINGING) & ~angular_rate_known, _POCKET, row)
