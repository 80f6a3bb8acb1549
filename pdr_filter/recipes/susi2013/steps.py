"""Step detector of Susi et al. 2013, section 7: minima of low-passed norms, selected by the motion mode.

Specific force and angular rate are low-passed (Butterworth, 10th order, 3 Hz), and their norms are computed. Minima
that pass an adaptive threshold are steps. The detector uses minima of |omega| for a device in a swinging hand, minima
of |f| otherwise, and no minima while the person stands or the motion is irregular.

The filter is causal, so that a contact is earlier than the minimum by the phase delay of the filter (0.34 to 0.40 s).
The delay is taken at the step frequency for |f|, and at half of it, the frequency of the arm, for |omega|. A minimum of
|f| is the middle of a step, half way between two contacts (0.41 of a step after the foot switches of Oxford, which are
read 0.05 s late). A minimum of |omega| is a contact, because the arm reverses when the other foot touches the ground.

A minimum must be below the mean of the surrounding window of 2.56 s by a multiple of the standard deviation of the
window. Since the previous minimum, the signal must have been above the mean by the same amount. The mode at a sample is
the mode of the window around it. Both require 1.28 s of later samples. `NormMinimaStepDetector` lists the deviations
from the paper.
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
# Step frequency in Hz that gives the filter delay of the first minimum of a walk, which has no previous minimum.
_TYPICAL_HZ = 1.8
# Longest step in s. A longer interval between minima contains a pause, so that half of it is not the time since
# contact.
_MAX_STEP_S = 1.0
_FORCE, _RATE = 0, 1


@dataclass(frozen=True)
class Trough:
    """Minimum of a norm that is being tracked: the lowest sample so far, its value, and the sample of the last trough.

    `armed` is True after the norm was above its upper threshold, which a minimum requires. `chosen` is True if the
    motion mode uses this norm.
    """

    armed: bool = False  # the norm was above its upper threshold since the previous minimum
    sample: int = -1  # number of the lowest sample of the filtered norm; negative outside a trough
    value: float = 0.0  # norm at this sample
    chosen: bool = False  # the motion mode at this sample uses this norm
    before: int = -1  # number of the lowest sample of the previous trough; negative if there is none


@dataclass(frozen=True, eq=False)
class NormMinimaState(DetectorState):
    """Last window of signals (`NormMinimaStepDetector._signals`), filter state, and troughs of the norms."""

    zi: FloatArray | None  # (5, 6, 2); None before the first sample
    last: FloatArray  # (6,) last specific force and angular rate
    troughs: tuple[Trough, Trough]  # of |f| and |omega|


@dataclass(frozen=True)
class NormMinimaStepDetector(BaseStepDetector[NormMinimaState]):
    """Step detector of Susi et al. 2013, which finds minima of the norm of force or angular rate.

    The detector is causal and requires the motion mode. An unknown mode is treated as walking with the arm at rest.
    Without angular rate, only the norm of the specific force is used.

    Parameters
    ----------
    rate_hz : float, default 100.0
        Sampling rate of the blocks in Hz.
    max_interval_s : float, default 2.0
        Pause in s after which a new walking bout begins.
    first_step_s : float, default 0.6
        Duration in s of the first step of a bout, because no contact marks its start.
    low_pass_hz : float, default 3.0
        Cutoff in Hz of the 10th-order Butterworth low-pass. Steps faster than this (running) are lost.
    window_s : float, default 2.56
        Length in s of the window around a minimum, whose mean and standard deviation define the threshold. It equals
        the window of the motion modes.
    force_depth, rate_depth : float
        Depth of a minimum below the mean, and height of the preceding maximum above it, in standard deviations of the
        window, for |f| (0.5) and |omega| (0.2). Chosen on persons 1 to 6 of ubicomp13 and on one swinging walk of
        Tyrex. For |f|, 0.4 counts the second harmonic of slow walkers, and 0.6 loses steps in trouser pockets.
    min_force_std_mps2, min_rate_std_radps : float
        Smallest standard deviation of a window with steps, which excludes a device at rest.
    min_interval_s : float, default 0.3
        Shortest time in s between two contacts. The low-pass removes faster motion.
    max_wait_s : float, default 0.5
        Time in s after the lowest sample at which a trough ends, if the signal does not rise before.

    Raises
    ------
    ValueError
        If a number is invalid.

    Notes
    -----
    The contact time is t_k = (m_(k-1) + m_k) / 2 - tau(1 / (m_k - m_(k-1))) for |f|, and
    t_k = m_k - tau(1 / (2 (m_k - m_(k-1)))) for |omega|. m_k are the times of the minima, and tau is the phase delay of
    the low-pass (`delay_s`).

    Deviations from the paper:

    - The threshold of a minimum is garbled ("maximum ... assumed as a threshold", "evaluated mean"). Here it is
      computed from mean and standard deviation of the window around the minimum.
    - The windows of the search slide in the paper. Here there is one around every sample, which gives the same minima
      and none twice at the edges of windows.
    - The paper counts steps and has no contact times. Here a contact is half way between two minima of |f|, or at a
      minimum of |omega|.

    Examples
    --------
    >>> from pdr_filter.recipes.susi2013.steps import NormMinimaStepDetector
    >>> round(NormMinimaStepDetector().latency_s, 1)
    2.7
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
        _ = self._sos  # raises at once if the cutoff is invalid

    @cached_property
    def _sos(self) -> FloatArray:
        return butterworth(10, self.low_pass_hz, self.rate_hz)

    @cached_property
    def _delays(self) -> tuple[FloatArray, FloatArray]:
        """Return frequencies up to the cutoff in Hz, and the phase delay of the filter at them in s."""
        # a spacing of 1 % of the cutoff keeps phase differences between neighbours below pi
        frequency_hz = np.linspace(0.0, self.low_pass_hz, 101)[1:]
        return frequency_hz, phase_delay_s(self._sos, frequency_hz, self.rate_hz)

    def delay_s(self, frequency_hz: float) -> float:
        """Return the phase delay of the low-pass.

        Parameters
        ----------
        frequency_hz : float
            Frequency in Hz. Beyond the cutoff, the delay at the cutoff is returned.

        Returns
        -------
        float
            Phase delay in s.
        """
        return float(np.interp(frequency_hz, *self._delays))

    @property
    def _half_samples(self) -> int:
        return round(0.5 * self.window_s * self.rate_hz)

    @property
    def _wait_samples(self) -> int:
        return round(self.max_wait_s * self.rate_hz)

    @property
    def latency_s(self) -> float:
        slowest_s = 0.5 * _MAX_STEP_S + float(self._delays[1].max())
        return slowest_s + (self._half_samples + self._wait_samples + 2) / self.rate_hz

    def init(self) -> NormMinimaState:
        line = np.zeros((6, self._n_line))
        return NormMinimaState(self._log.init(), line, None, np.zeros(6), (Trough(), Trough()))

    @property
    def _n_line(self) -> int:
        return 2 * self._half_samples - 1

    def _signals(
        self, state: NormMinimaState, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[NormMinimaState, FloatArray]:
        """Return the new state, and (6, N): |f|, |omega|, three flags, and the index of the carrying mode.

        |f| and |omega| are the norms of the low-passed components. The flags are 1 if the sample exists, if its angular
        rate is known, and if the context allows steps.
        """
        components = np.vstack([block.specific_force_mps2.T, block.angular_rate_radps.T])
        norms, zi = filtered_norms(self._sos, components, state.zi)
        known = np.stack([block.angular_rate_known, ~contexts.stands, contexts.carrying_mode]).astype(float)
        signals = np.vstack([norms, np.ones(norms.shape[1]), known])
        return replace_unchecked(state, zi=zi, last=components[:, -1].copy()), signals

    def _before(self, signals: FloatArray) -> FloatArray:
        """Return zeros in place of samples before the start."""
        return np.zeros((len(signals), self._n_line))

    def _signals_after_end(self, state: NormMinimaState) -> FloatArray:
        """Return signals after the end: the last sample, repeated for the filter delay, and then zeros.

        The zeros end every trough.
        """
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
        """Return whether each middle sample is above the upper, and whether it is below the lower threshold.

        The thresholds are the mean plus and minus `depth` standard deviations of the window around the sample. No
        sample is below the lower one in a window of a device at rest.
        """
        depth = self.force_depth if norm == _FORCE else self.rate_depth
        min_std = self.min_force_std_mps2 if norm == _FORCE else self.min_rate_std_radps
        ones = np.ones(2 * self._half_samples)
        # each output is one dot product over the window, so that results are bit-identical for any split into blocks
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
        """Return the current trough of a norm after some samples, and pairs of the end and the trough of ended ones.

        The end is the number of a sample, and the samples are numbered from `first`. A trough ends when the norm rises
        above its upper threshold (`high`), or `max_wait_s` after its lowest sample. `chosen` states whether the motion
        mode uses this norm.
        """
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
        """Return the new state, and the step of a minimum, or None if the minimum is rejected.

        It is rejected if the motion mode does not use its norm, less than `min_interval_s` after the last contact, or
        if the samples of its step are not available. `known` is the number of the newest sample.
        """
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
        if self._log.time_s(state.log, contact) - state.log.last_contact_s < self.min_interval_s:
            return state, None
        return self._end_step(state, contact, known)
