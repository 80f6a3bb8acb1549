"""Steps as minima of low-passed norms, chosen by motion mode: Susi et al. 2013, section 7.

Specific force and angular rate are low-passed (Butterworth, 10th order, 3 Hz) and their norms taken. Each minimum that
an adaptive threshold lets pass is a step: a minimum of |omega| where the device is in a swinging hand, of |f|
otherwise, none where its owner stands or the motion is irregular.

The filter is causal: a contact is earlier than the minimum by its phase delay (0.34 to 0.40 s) at the step frequency,
for |omega| at half of it, the frequency of the arm. A minimum of |f| is the middle of the step, half way between two
contacts (0.41 of a step after Oxford's foot switches, which are read 0.05 s late); a minimum of |omega| is a contact,
because the arm turns when the other foot touches the ground.

Deviations: docs/methods/susi2013.md. A minimum must be below the mean of the window of 2.56 s around it by a part of
the window's standard deviation, and the signal above it by as much since the minimum before. The mode at a sample is
that of the window around it; both take 1.28 s of waiting.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdr_filter.recipes.susi2013.features import filtered_norms
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.signal_filters import butterworth, phase_delay_s
from pdr_filter.sensing.steps.step_detector import BaseStepDetector, ContextBlock, DetectorState
from pdr_filter.values import CARRYING_MODES, BoolArray, FloatArray, Step, check_numbers, replace_unchecked

_SWINGING = CARRYING_MODES.index("swinging")
# Step frequency at which the first minimum of a walk, which has none before it, is delayed.
_TYPICAL_HZ = 1.8
# A longer interval between minima is a pause: the contact is not half of it ago.
_MAX_STEP_S = 1.0
_FORCE, _RATE = 0, 1


@dataclass(frozen=True)
class Trough:
    """What is known of the minimum that a norm goes through."""

    armed: bool = False  # the norm was high since the minimum before
    sample: int = -1  # number of the lowest sample of the filtered norm; negative outside a trough
    value: float = 0.0
    chosen: bool = False  # whether the mode there is one that looks at this norm
    before: int = -1  # number of the lowest sample of the trough before; negative without


@dataclass(frozen=True, eq=False)
class NormMinimaState(DetectorState):
    """The last window of signals (`NormMinimaStepDetector._signals`), filter memory, and the troughs of the norms."""

    zi: FloatArray | None  # (5, 6, 2); None before the first sample
    last: FloatArray  # (6,) last specific force and angular rate
    troughs: tuple[Trough, Trough]  # of |f| and |omega|


@dataclass(frozen=True)
class NormMinimaStepDetector(BaseStepDetector[NormMinimaState]):
    """Causal step detector; it needs to know the motion mode, and without angular rate it looks at |f| alone.

    Where the mode is unknown it takes somebody to walk whose arm does not swing.

    Parameters
    ----------
    low_pass_hz : float
        Cutoff of the 10th-order Butterworth low-pass. Steps faster than this (running) are lost.
    window_s : float
        Around a minimum; its mean and standard deviation are the threshold. That of the motion modes.
    force_depth, rate_depth : float
        How far below the mean a minimum is, and above it the signal before, in standard deviations of the window, for
        |f| and |omega|. Chosen on people 1 to 6 of ubicomp13 (0.4 counts slow walkers' second harmonic, 0.6 loses
        trouser pockets) and on one swinging walk of Tyrex.
    min_force_std_mps2, min_rate_std_radps : float
        Smallest standard deviation of a window that can hold steps: a device at rest has none.
    min_interval_s : float
        Two contacts closer than this are one step; the low-pass leaves nothing faster.
    max_wait_s : float
        A trough ends so long after its lowest sample, if the signal does not rise before.
    """

    low_pass_hz: float = 3.0
    window_s: float = 2.56
    force_depth: float = 0.5
    rate_depth: float = 0.2
    min_force_std_mps2: float = 0.2
    min_rate_std_radps: float = 0.1
    min_interval_s: float = 0.3
    max_wait_s: float = 0.5

    def __post_init__(self) -> None:
        check_numbers(self)
        _ = self._sos  # a wrong cutoff shows at once

    @cached_property
    def _sos(self) -> FloatArray:
        return butterworth(10, self.low_pass_hz, self.rate_hz)

    @cached_property
    def _delays(self) -> tuple[FloatArray, FloatArray]:
        """Frequencies up to the cutoff, Hz, and the phase delay of the filter at them, s."""
        # 0.01 of the cutoff to the next keeps the phase below pi between neighbours
        frequency_hz = np.linspace(0.0, self.low_pass_hz, 101)[1:]
        return frequency_hz, phase_delay_s(self._sos, frequency_hz, self.rate_hz)

    def delay_s(self, frequency_hz: float) -> float:
        """Phase delay of the low-pass at a frequency, s; beyond the cutoff that of the cutoff."""
        return float(np.interp(frequency_hz, *self._delays))

    @property
    def _half_samples(self) -> int:
        return round(0.5 * self.window_s * self.rate_hz)

    @property
    def _wait_samples(self) -> int:
        return round(self.max_wait_s * self.rate_hz)

    @property
    def latency_s(self) -> float:
        """Longest time from a contact to its detection, 2.7 s; typically it is 2.1 s."""
        slowest_s = 0.5 * _MAX_STEP_S + float(self._delays[1].max())
        return slowest_s + (self._half_samples + self._wait_samples + 2) / self.rate_hz

    def init(self) -> NormMinimaState:
        """State before the first sample of a segment."""
        line = np.zeros((6, self._n_line))
        return NormMinimaState(self._log.init(), line, None, np.zeros(6), (Trough(), Trough()))

    @property
    def _n_line(self) -> int:
        return 2 * self._half_samples - 1

    def _signals(
        self, state: NormMinimaState, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[NormMinimaState, FloatArray]:
        """|f|, |omega|, one at a sample, one where the rate is known, one where somebody may step, mode; (6, N)."""
        components = np.vstack([block.specific_force_mps2.T, block.angular_rate_radps.T])
        norms, zi = filtered_norms(self._sos, components, state.zi)
        known = np.stack([block.angular_rate_known, ~contexts.stands, contexts.carrying_mode]).astype(float)
        signals = np.vstack([norms, np.ones(norms.shape[1]), known])
        return replace_unchecked(state, zi=zi, last=components[:, -1].copy()), signals

    def _before(self, signals: FloatArray) -> FloatArray:
        """Where there is no sample all rows are zero."""
        return np.zeros((len(signals), self._n_line))

    def _continued(self, state: NormMinimaState) -> FloatArray:
        """The last sample stays until it is through the filter; then there is none, which ends every trough too."""
        n_stay = round(self.delay_s(self.low_pass_hz) * self.rate_hz)
        norms, _ = filtered_norms(self._sos, np.tile(state.last[:, None], n_stay), state.zi)
        n_nothing = self._half_samples + self._wait_samples + 1
        rows = np.repeat(state.line[:, -1:], n_stay + n_nothing, axis=1)
        rows[:2, :n_stay] = norms
        rows[:4, n_stay:] = 0.0
        return rows

    def _detect(
        self, state: NormMinimaState, line: FloatArray, first: int
    ) -> tuple[NormMinimaState, list[tuple[int, Step]]]:
        half, n_new = self._half_samples, line.shape[1] - self._n_line
        middle = line[:, half - 1 : half - 1 + n_new]  # samples whose windows are complete
        may_step, carrying_mode = line[4:, self._n_line :]
        walking = may_step > 0
        swinging = (carrying_mode == _SWINGING) & (middle[3] > 0)
        minima: list[tuple[int, int, Trough]] = []
        troughs: list[Trough] = []
        for norm, chosen in ((_FORCE, walking & ~swinging), (_RATE, walking & swinging)):
            high, low = self._above_and_below(line[norm], line[2], middle, norm)
            trough, ended = self._follow(state.troughs[norm], first - half, middle[norm], high, low, chosen)
            troughs.append(trough)
            minima += [(known + half, norm, each) for known, each in ended]
        state = replace_unchecked(state, troughs=(troughs[_FORCE], troughs[_RATE]))
        steps: list[tuple[int, Step]] = []
        for known, norm, trough in sorted(minima, key=lambda m: m[:2]):
            state, step = self._accept(state, known, norm, trough)
            if step is not None:
                steps.append((known, step))
        return state, steps

    def _above_and_below(
        self, norm_line: FloatArray, is_sample: FloatArray, middle: FloatArray, norm: int
    ) -> tuple[list[bool], list[bool]]:
        """Whether each middle sample is high, and low, against the window around it."""
        depth = self.force_depth if norm == _FORCE else self.rate_depth
        min_std = self.min_force_std_mps2 if norm == _FORCE else self.min_rate_std_radps
        ones = np.ones(2 * self._half_samples)
        # Every output is one dot product of the window's length, so cutting the signal elsewhere changes no bit.
        number = np.maximum(np.convolve(is_sample, ones, mode="valid"), 1.0)
        mean = np.convolve(norm_line, ones, mode="valid") / number
        power = np.convolve(norm_line * norm_line, ones, mode="valid") / number
        std = np.sqrt(np.maximum(power - mean * mean, 0.0))
        is_known = middle[2] > 0
        high = is_known & (middle[norm] > mean + depth * std)
        low = is_known & (middle[norm] < mean - depth * std) & (std > min_std)
        return high.tolist(), low.tolist()

    def _follow(
        self, trough: Trough, first: int, norm: FloatArray, high: list[bool], low: list[bool], chosen: BoolArray
    ) -> tuple[Trough, list[tuple[int, Trough]]]:
        """The trough after further samples, numbered from `first`, and those that ended, each with where it did."""
        ended: list[tuple[int, Trough]] = []
        for i, value in enumerate(norm.tolist()):
            sample = first + i
            if trough.sample >= 0 and (high[i] or sample - trough.sample > self._wait_samples):
                ended.append((sample, trough))
                trough = Trough(before=trough.sample)
            if high[i]:
                if not trough.armed:
                    trough = replace_unchecked(trough, armed=True)
            elif low[i] and trough.armed and (trough.sample < 0 or value < trough.value):
                trough = Trough(True, sample, value, bool(chosen[i]), trough.before)
        return trough, ended

    def _accept(
        self, state: NormMinimaState, known: int, norm: int, trough: Trough
    ) -> tuple[NormMinimaState, Step | None]:
        """The step that a minimum makes, if it makes one."""
        if not trough.chosen:
            return state, None
        interval_s = (trough.sample - trough.before) / self.rate_hz if trough.before >= 0 else np.inf
        is_first = interval_s > self.max_interval_s
        frequency_hz = _TYPICAL_HZ if is_first else 1.0 / interval_s
        if norm == _FORCE:
            since_s = 0.5 * (self.first_step_s if is_first else min(interval_s, _MAX_STEP_S))
            early_s = since_s + self.delay_s(frequency_hz)
        else:
            early_s = self.delay_s(0.5 * frequency_hz)
        contact = trough.sample - early_s * self.rate_hz
        whole = int(np.floor(contact))
        if not self._log.can_end(state.log, whole):
            return state, None
        if self._log.time_s(state.log, contact) - state.log.last_contact_s < self.min_interval_s:
            return state, None
        log, step = self._log.add(state.log, whole, known, contact - whole)
        return replace_unchecked(state, log=log), step
