"""Steps as local maxima of a signal that depends on where the phone is: Guo et al. 2018, sections 2.2.2 and 2.2.3.

While the level of motion is that of walking (eq. 1), a local maximum (criterion 1) of the low-passed signal of the pose
(eq. 3 to 6) above mean + c_M standard deviations of the last seconds (criterion 2) is a step if the step frequency is
one of people (criterion 3). All four signals are filtered all the time, so that a change of pose restarts no filter.

Deviations: docs/methods/guo2018.md. c_M = -omega_M / alpha of the paper; a maximum that comes too early after a step is
dropped; after a pause longer than 1 / v_min a new bout begins. c_M, `statistics_s` and v_max were chosen on people 1 to
6 of A. Brajdic and R. Harle, "Walk detection and step counting on unconstrained smartphones", UbiComp 2013,
doi:10.1145/2493432.2493449, with the poses of the forest; people 7 to 13 had no say: the count error there is 2.9 %
(mean absolute, 35 walks, median 1.4 %).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdr_filter.recipes.guo2018.features import MotionLevel, MotionLevelState
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.signal_filters import butterworth, filtered, phase_delay_s
from pdr_filter.sensing.steps.step_detector import BaseStepDetector, ContextBlock, DetectorState, local_maxima, vertex
from pdr_filter.sensing.steps.step_log import specific_force_magnitude
from pdr_filter.values import CARRYING_MODES, BoolArray, FloatArray, IntArray, Step, check_numbers, replace_unchecked

_TEXTING, _CALLING, _POCKET, _SWINGING = range(4)  # rows of the signals: eq. 3, 4, 5 and 6
# The signal of each carrying mode, and last of an unknown one, which index -1 finds.
_SIGNAL_OF_MODE = np.array(
    [
        *({"texting": _TEXTING, "calling": _CALLING, "swinging": _SWINGING}.get(m, _POCKET) for m in CARRYING_MODES),
        _POCKET,
    ]
)


@dataclass(frozen=True, eq=False)
class PoseStepState(DetectorState):
    """The last signals, filter memories, filtered signals, and the last accepted maximum."""

    level: MotionLevelState
    zi: FloatArray | None  # (5, 4, 2); None before the first sample
    recent: FloatArray  # (6, <= L + 1) the four filtered signals, whether somebody walks, row of the pose's signal
    last_peak: float  # number of the sample, and a part, of the last accepted maximum; -inf before


@dataclass(frozen=True)
class PoseStepDetector(BaseStepDetector[PoseStepState]):
    """Causal step detector; a step is reported at most `latency_s`, 0.44 s, after its contact.

    Parameters
    ----------
    low_pass_hz : float
        Cutoff of the 10th-order Butterworth low-pass.
    statistics_s : float
        Length of the window of mean and standard deviation.
    texting, calling, pocket, swinging : float
        c_M of each pose: how many standard deviations above the mean a maximum must be.
    max_step_hz : float
        v_max.
    min_level, max_level : float
        delta_min and delta_max of eq. 1.
    min_level_accelerometer : float
        delta_min where the angular rate is missing.
    rate_hz, max_interval_s, first_step_s : float
        Of every `BaseStepDetector`; `max_interval_s` is 1 / v_min.
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
                f"max_interval_s must be longer than a step at max_step_hz, got {self.max_interval_s} and "
                f"{self.max_step_hz}"
            )
        if round(self.statistics_s * self.rate_hz) < 3:
            raise ValueError(f"statistics_s must be at least three samples, got {self.statistics_s}")

    @cached_property
    def _sos(self) -> FloatArray:
        return butterworth(10, self.low_pass_hz, self.rate_hz)

    @cached_property
    def _delay(self) -> tuple[FloatArray, FloatArray]:
        """Frequencies, and by how many samples the low-pass delays a sinusoid."""
        frequency_hz = np.linspace(0.01, self.max_step_hz, 330)
        return frequency_hz, phase_delay_s(self._sos, frequency_hz, self.rate_hz) * self.rate_hz

    @cached_property
    def _thresholds(self) -> tuple[float, float, float, float]:
        return self.texting, self.calling, self.pocket, self.swinging  # in the order of the rows

    @property
    def latency_s(self) -> float:
        """Longest time from a contact to its detection."""
        return (math.ceil(float(self._delay[1].max())) + 2) / self.rate_hz

    @cached_property
    def _level(self) -> MotionLevel:
        return MotionLevel(self.rate_hz)

    @property
    def _n_statistics(self) -> int:
        return round(self.statistics_s * self.rate_hz)

    def init(self) -> PoseStepState:
        """State before the first sample of a segment."""
        line = np.zeros((6, self._n_line))
        return PoseStepState(self._log.init(), line, self._level.init(), None, np.empty((6, 0)), -np.inf)

    @property
    def _n_line(self) -> int:
        return 1  # what stays where a gap or the end comes

    def _signals(
        self, state: PoseStepState, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[PoseStepState, FloatArray]:
        """The four signals, whether somebody walks, and the row of the pose's signal, (6, N)."""
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
        low_passed, zi = filtered(self._sos, new[:4], state.zi)
        line = np.concatenate([state.recent, np.vstack([low_passed, new[4:]])], axis=1)
        first -= state.recent.shape[1]  # number of the line's first sample
        state = replace_unchecked(state, zi=zi)
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
        return replace_unchecked(state, recent=line[:, -self._n_statistics - 1 :].copy()), steps

    def _maxima(self, line: FloatArray, start: int) -> list[int]:
        """Samples of a line, from a start on, that are local maxima of their pose's signal while somebody walks."""
        line = line[:, start - 1 :]
        row = line[5, 1:-1].astype(np.int64)
        is_maximum = local_maxima(line[:4])[row, np.arange(len(row))]
        return (start + np.flatnonzero(is_maximum & (line[4, 1:-1] > 0))).tolist()

    def _accept(self, state: PoseStepState, peak: FloatArray, sample: int) -> tuple[PoseStepState, Step | None]:
        """The step that a maximum of the filtered signal makes, if its frequency is that of a step (criterion 3)."""
        at = sample + vertex(peak)
        interval_s = (at - state.last_peak) / self.rate_hz
        if interval_s * self.max_step_hz < 1.0:
            return state, None
        is_first = interval_s > self.max_interval_s
        step_hz = 1.0 / (self.first_step_s if is_first else interval_s)
        contact = at - float(np.interp(step_hz, *self._delay))
        whole = math.floor(contact)
        if not self._log.can_end(state.log, whole):
            return state, None
        log, step = self._log.add(state.log, whole, sample + 1, contact - whole)
        return replace_unchecked(state, log=log, last_peak=at), step


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
    """Row of `feature_signals` to use at each sample, (N,), from the carrying mode as `ContextBlock` has it."""
    row = _SIGNAL_OF_MODE[carrying_mode]
    return np.where((row == _SWINGING) & ~angular_rate_known, _POCKET, row)
