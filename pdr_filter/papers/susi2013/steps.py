"""Steps as minima of low-passed norms, chosen by motion mode: Susi et al. 2013, section 7.

Specific force and angular rate are low-passed (Butterworth, 10th order, 3 Hz) and their norms taken. Each minimum that
an adaptive threshold lets pass is a step: a minimum of |omega| where the device is in a swinging hand, of |f|
otherwise, none where its owner stands or the motion is irregular.

A swinging arm stops twice in a full cycle, in front and behind, and |omega| is smallest there. The cycle is a stride,
so that each minimum is a step and two are a stride, as figure 8 has it. |f| of a swinging hand need not do: its
strongest part can be of the stride, because the hand pulls once in front, once behind, and hardly alike (4 of 10 steps
of Tyrex's swinging walks are missing in |f|, but only 4 of 100 of Oxford's).

When a foot touches the ground:

- The filter is causal. A contact is earlier than the minimum by its phase delay (0.34 to 0.40 s) at the step frequency,
  for |omega| at half of it, the frequency of the arm.
- A minimum of |f| is the middle of the step, half way between two contacts: with Oxford's foot switches it comes 0.41
  (median over 16 recordings) of a step after the switch, which is read every 0.1 s, so 0.05 s late on average. So the
  contact of the step is put half way between two minima.
- The arm turns when the other foot touches the ground, so that a minimum of |omega| is a contact: in Tyrex's swinging
  walks the 8 to 25 Hz of |f|, the heel strike, are strongest there (4 times the least, which is half way between).

Deviations, where the paper is silent or garbled ("the maximum value ... is assumed as a threshold ... a bigger value
than the evaluated mean"): a minimum must be below the mean of the window of 2.56 s around it by a part of the window's
standard deviation, and the signal above it by as much since the minimum before. In place of windows that overlap every
sample has its own, centred. The mode at a sample is that of the window around it; both take 1.28 s of waiting.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi, sosfreqz

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.steps.detector import (
    ModeBlock,
    StepLog,
    StepLogState,
    specific_force_magnitude,
    unknown_modes,
)
from pdr_filter.values.arrays import BoolArray, FloatArray
from pdr_filter.values.contexts import CARRYING_MODES, CONTEXTS
from pdr_filter.values.step import Step

_STATIONARY, _SWINGING = CONTEXTS.index("stationary"), CARRYING_MODES.index("swinging")
# Step frequency at which the first minimum of a walk, which has none before it, is delayed.
_TYPICAL_HZ = 1.8
# A longer interval between minima is a pause: the contact is not half of it ago.
_MAX_STEP_S = 1.0
_FORCE, _RATE = 0, 1


@dataclass(frozen=True, slots=True)
class Trough:
    """What is known of the minimum that a norm goes through."""

    armed: bool = False  # the norm was high since the minimum before
    sample: int = -1  # number of the lowest sample of the filtered norm; negative outside a trough
    value: float = 0.0
    chosen: bool = False  # whether the mode there is one that looks at this norm
    before: int = -1  # number of the lowest sample of the trough before; negative without


@dataclass(frozen=True, slots=True, eq=False)
class NormMinimaState:
    """Filter memory, the last window of filtered norms, and the troughs they are in."""

    log: StepLogState
    n_samples: int  # that went through the filter
    zi: FloatArray | None  # (5, 2, 6); None before the first sample
    last: FloatArray  # (6,) last specific force and angular rate
    line: FloatArray  # (4, W - 1): filtered norms, one where there is a sample, one where its angular rate is known
    modes: tuple[int, int]  # last context and carrying mode
    troughs: tuple[Trough, Trough]  # of |f| and |omega|


@dataclass(frozen=True)
class NormMinimaStepDetector:
    """Causal step detector; it needs to know the motion mode, and without angular rate it looks at |f| alone.

    Where the mode is unknown it takes somebody to walk whose arm does not swing.

    Parameters
    ----------
    rate_hz : float
        Sampling rate of the blocks.
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
    max_interval_s : float
        After a longer pause a new bout begins.
    first_step_s : float
        Duration given to the first step of a bout, whose start no contact marks: a typical step from rest.
    """

    rate_hz: float = 100.0
    low_pass_hz: float = 3.0
    window_s: float = 2.56
    force_depth: float = 0.5
    rate_depth: float = 0.2
    min_force_std_mps2: float = 0.2
    min_rate_std_radps: float = 0.1
    min_interval_s: float = 0.3
    max_wait_s: float = 0.5
    max_interval_s: float = 2.0
    first_step_s: float = 0.6

    def __post_init__(self) -> None:
        if not 0 < self.low_pass_hz < 0.5 * self.rate_hz:
            raise ValueError(f"low_pass_hz must be below half the rate, got {self.low_pass_hz} at {self.rate_hz} Hz")

    @cached_property
    def _sos(self) -> FloatArray:
        return np.asarray(butter(10, self.low_pass_hz, fs=self.rate_hz, output="sos"))

    @cached_property
    def _delays(self) -> tuple[FloatArray, FloatArray]:
        """Frequencies up to the cutoff, Hz, and the phase delay of the filter at them, s."""
        # 0.01 of the cutoff to the next keeps the phase below pi between neighbours
        frequency_hz = np.linspace(0.0, self.low_pass_hz, 101)[1:]
        response = np.asarray(sosfreqz(self._sos, worN=frequency_hz, fs=self.rate_hz)[1])
        return frequency_hz, -np.unwrap(np.angle(response)) / (2 * np.pi * frequency_hz)

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

    @cached_property
    def _log(self) -> StepLog:
        return StepLog(self.rate_hz, self.latency_s, self.max_interval_s, self.first_step_s)

    def init(self) -> NormMinimaState:
        """State before the first sample of a segment."""
        return NormMinimaState(
            log=self._log.init(),
            n_samples=0,
            zi=None,
            last=np.zeros(6),
            line=np.zeros((4, 2 * self._half_samples - 1)),
            modes=(-1, -1),
            troughs=(Trough(), Trough()),
        )

    def step(
        self, state: NormMinimaState, block: UniformBlock, attitude: AttitudeBlock, modes: ModeBlock
    ) -> tuple[NormMinimaState, list[tuple[int, Step]]]:
        """New state and the steps that became known, each with the number of the sample that revealed it."""
        if len(block.time_s) == 0:
            return state, []
        components = np.column_stack([block.specific_force_mps2, block.angular_rate_radps])
        state = replace(state, log=self._log.extend(state.log, block, attitude))
        state, norms = self._filtered_norms(state, components)
        rows = np.stack([*norms, np.ones(len(components)), block.angular_rate_known.astype(float)])
        state, steps = self._detect(state, rows, modes)
        last_modes = int(modes.context[-1]), int(modes.carrying_mode[-1])
        return replace(state, log=self._log.trim(state.log), last=components[-1].copy(), modes=last_modes), steps

    def finish(self, state: NormMinimaState) -> list[tuple[int, Step]]:
        """Steps that would have needed more samples, when a gap or the end comes; the last sample is taken to stay."""
        if state.n_samples == 0:
            return []
        end = state.n_samples
        last_s = self._log.time_s(state.log, end - 1)
        n_stay = round(self.delay_s(self.low_pass_hz) * self.rate_hz)
        state, norms = self._filtered_norms(state, np.tile(state.last, (n_stay, 1)))
        stay = np.stack([*norms, np.ones(n_stay), np.full(n_stay, state.line[3, -1])])
        # where there is no sample, then, all rows are zero; it ends every trough too
        nothing = np.zeros((4, self._half_samples + self._wait_samples + 1))
        rows = np.concatenate([stay, nothing], axis=1)
        modes = unknown_modes(rows.shape[1])
        modes = ModeBlock(modes.context * 0 + state.modes[0], modes.carrying_mode * 0 + state.modes[1])
        _, steps = self._detect(state, rows, modes)
        return [(end - 1, replace(s, detected_time_s=last_s)) for _, s in steps if s.time_s <= last_s]

    def _filtered_norms(
        self, state: NormMinimaState, components: FloatArray
    ) -> tuple[NormMinimaState, tuple[FloatArray, FloatArray]]:
        """New state, and |f| and |omega| of the low-passed components (N, 6)."""
        # What was before the first sample is taken to be like it: a zero there would look like a blow.
        before = np.asarray(sosfilt_zi(self._sos))[:, :, None] * components[0] if state.zi is None else state.zi
        filtered, zi = sosfilt(self._sos, components, axis=0, zi=before)
        norms = specific_force_magnitude(filtered[:, :3]), specific_force_magnitude(filtered[:, 3:])
        return replace(state, zi=zi), norms

    def _detect(
        self, state: NormMinimaState, rows: FloatArray, modes: ModeBlock
    ) -> tuple[NormMinimaState, list[tuple[int, Step]]]:
        """Detect in further samples (4, N) of the rows of `line`."""
        line = np.concatenate([state.line, rows], axis=1)
        n_new, half = rows.shape[1], self._half_samples
        middle = line[:, half - 1 : half - 1 + n_new]  # samples whose windows are complete
        walking = modes.context != _STATIONARY
        swinging = (modes.carrying_mode == _SWINGING) & (middle[3] > 0)
        first = state.n_samples - half
        minima: list[tuple[int, int, Trough]] = []
        troughs: list[Trough] = []
        for norm, chosen in ((_FORCE, walking & ~swinging), (_RATE, walking & swinging)):
            high, low = self._above_and_below(line[norm], line[2], middle, norm)
            trough, ended = self._follow(state.troughs[norm], first, middle[norm], high, low, chosen)
            troughs.append(trough)
            minima += [(known + half, norm, each) for known, each in ended]
        state = replace(
            state,
            n_samples=state.n_samples + n_new,
            line=line[:, n_new:].copy(),
            troughs=(troughs[_FORCE], troughs[_RATE]),
        )
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
                    trough = replace(trough, armed=True)
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
        if whole <= max(self._log.first_sample(state.log), state.log.last_contact, 0):
            return state, None
        if whole >= state.log.n_samples:
            return state, None
        if self._log.time_s(state.log, contact) - state.log.last_contact_s < self.min_interval_s:
            return state, None
        log, step = self._log.add(state.log, whole, known, contact - whole)
        return replace(state, log=log), step
