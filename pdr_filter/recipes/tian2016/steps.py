"""Step detector of Tian et al. 2016, section III-C: peaks of an acceleration that depends on the carrying mode.

For a held phone, peaks of the vertical acceleration (eq. 5, 6) are steps. In a swinging hand, the acceleration along
the y axis of the device is used. Its peaks of both signs are steps, because an arm swings once in two steps. In a
pocket, the acceleration along the z axis is used (Table III). During a transition of the phone no steps can be
detected. These steps are added when the transition ends (eq. 8).

The equations follow the convention of iOS: gravity and user acceleration are in g, and gravity is -1 on z for a phone
that lies face up. Only `ios_acceleration` converts to this convention.

Deviations from the paper are listed in `TianStepDetector`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.signal_filters import butterworth, filtered_rows
from pdr_filter.sensing.steps.step_detector import BaseStepDetector, ContextBlock, DetectorState, local_maxima, vertex
from pdr_filter.values import (
    CARRYING_MODES,
    STANDARD_GRAVITY_MPS2,
    BoolArray,
    FloatArray,
    IntArray,
    Step,
    check_numbers,
    replace_unchecked,
)

# States of the machine of the paper. The first three are also the rows of `step_signals`.
HOLDING, SWING, POCKET, TRANS = range(4)

# State of each of `CARRYING_MODES`. A phone at the ear is treated as held, because it hardly rotates. A phone in a bag
# is treated as in a pocket, because its orientation is arbitrary.
_STATE_OF = np.array([{"swinging": SWING, "pocket": POCKET, "bag": POCKET}.get(m, HOLDING) for m in CARRYING_MODES])

# Length of a transition: 100 samples at 50 Hz (section III-B).
TRANSITION_S = 2.0


def ios_acceleration(specific_force_mps2: FloatArray, up_sensor: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return gravity and user acceleration in the convention of CoreMotion, both (N, 3), in g.

    With f the specific force and g0 the standard gravity, gravity + user acceleration = -f / g0. A phone that lies face
    up has gravity (0, 0, -1), and an upward acceleration gives a negative user acceleration on z.
    """
    gravity_g = -up_sensor
    return gravity_g, -specific_force_mps2 / STANDARD_GRAVITY_MPS2 - gravity_g


def step_signals(specific_force_mps2: FloatArray, up_sensor: FloatArray) -> FloatArray:
    """Return the signals for step detection, (3, N) in g: vertical (HOLDING), y (SWING) and z (POCKET); Table III.

    They are user accelerations. The vertical one is a_uz sin(phi) + a_uy cos(phi) with phi = atan |g_z / g_y| (eq. 5,
    6). It is computed as -(a_uy g_y + a_uz g_z) / sqrt(g_y^2 + g_z^2), which equals the printed form if g_y and g_z are
    negative, as for a phone held for reading, and has the correct sign otherwise. It is zero if both are zero.
    """
    gravity, user = ios_acceleration(specific_force_mps2, up_sensor)
    in_plane = np.sqrt(gravity[:, 1] ** 2 + gravity[:, 2] ** 2)
    vertical = -(user[:, 1] * gravity[:, 1] + user[:, 2] * gravity[:, 2]) / np.maximum(in_plane, 1e-9)
    return np.stack([vertical, user[:, 1], user[:, 2]])


@dataclass(frozen=True, slots=True)
class CarriedState:
    """Last known main mode, and number of samples since then."""

    main_mode: int
    n_unknown: int


@dataclass(frozen=True)
class Carried:
    """Conversion of the carrying modes of any context stage to the states of the paper.

    An unknown carrying mode is a transition for at most `transition_s`, and then the previous main mode again. The
    initial state is HOLDING, because the user has just started the app (section III-B).
    """

    rate_hz: float = 100.0
    transition_s: float = TRANSITION_S

    def __post_init__(self) -> None:
        check_numbers(self)

    @property
    def _n_transition(self) -> int:
        return round(self.transition_s * self.rate_hz)

    def init(self) -> CarriedState:
        """Return the state before the first sample, HOLDING."""
        return CarriedState(HOLDING, self._n_transition)

    def update(self, state: CarriedState, carrying_mode: IntArray) -> tuple[CarriedState, IntArray]:
        """Return the new state, and for each sample the state of the phone: HOLDING, SWING, POCKET or TRANS.

        `carrying_mode` has one index of a carrying mode for each sample, -1 if unknown. An unknown mode is a
        transition (TRANS) for up to `transition_s`. After that, the last known mode holds again.
        """
        n = len(carrying_mode)
        known = carrying_mode >= 0
        last_known = np.maximum.accumulate(np.where(known, np.arange(n), -1))
        n_unknown = np.where(last_known < 0, state.n_unknown, 0) + np.arange(n) - np.maximum(last_known, -1)
        main = np.where(last_known < 0, state.main_mode, _STATE_OF[carrying_mode[last_known]])
        states = np.where((n_unknown > 0) & (n_unknown <= self._n_transition), TRANS, main)
        return CarriedState(int(main[-1]), min(int(n_unknown[-1]), self._n_transition)), states


@dataclass(frozen=True, eq=False)
class TianDetectorState(DetectorState):
    """Samples that need later samples, filter state, and the current transition."""

    carried: CarriedState
    low_pass_zi: FloatArray | None  # (n_sections, 3, 2); None before the first sample
    transition_start: int  # number of the first sample of a transition; -1 outside a transition
    step_hz: float  # frequency of the last step; zero after the first step from rest


@dataclass(frozen=True)
class TianStepDetector(BaseStepDetector[TianDetectorState]):
    """Step detector of Tian et al. 2016, which finds peaks of a signal that depends on the carrying mode.

    The detector is causal. A step is reported 0.2 s after its contact, or at the end of a transition.

    Parameters
    ----------
    rate_hz : float, default 100.0
        Sampling rate of the blocks in Hz.
    max_interval_s : float, default 2.0
        Pause in s after which a new walking bout begins and the step frequency is zero.
    first_step_s : float, default 0.6
        Duration in s of the first step of a bout, because no contact marks its start.
    holding_peak_g, swing_peak_g, pocket_peak_g : float
        Smallest peak of a step in g, for each main mode. The paper prints only one value, 0.2 g for the walk in a
        pocket of Fig. 7, which loses a fifth of the steps in other pockets (ubicomp13, people 1 to 6).
    low_pass_hz : float, default 5.0
        Cutoff in Hz of the second-order Butterworth low-pass. Step frequencies are 0.5 to 5 Hz.
    min_interval_s : float, default 0.2
        Shortest time in s between two steps (criterion 1).
    held_rejection_s, pocket_rejection_s : float
        A peak that is followed by a peak of the opposite sign within this time in s is rejected (criterion 2). The
        defaults are 6 and 3 samples at 50 Hz.
    transition_s : float, default 2.0
        Longest duration of a transition in s.

    Raises
    ------
    ValueError
        If a number is invalid.

    Notes
    -----
    Deviations from the paper:

    - The thresholds of the peaks are not printed, except for one walk (`pocket_peak_g`).
    - The paper prints only the cutoff of the low-pass. The second-order Butterworth and the subtraction of its delay
      from the contact time are choices.
    - Eq. 6 is computed with the signs of gravity (`step_signals`). The result is the same for a phone that is held for
      reading, and also right if the top of the phone points down.
    - The rejection windows are those of the paper, but each step is reported 0.13 s after its peak in every mode, so
      that the latency is the same.
    - The paper does not give the times of the steps that are filled in. They are evenly spaced over the transition, the
      first and the last half an interval from its ends.
    - A carrying mode that is unknown for longer than `transition_s` counts as the mode before. `calling` counts as
      HOLDING and `bag` as POCKET. Other context stages report these modes.

    Examples
    --------
    >>> from pdr_filter.recipes.tian2016.steps import TianStepDetector
    >>> round(float(TianStepDetector().latency_s), 1)
    2.2
    """

    holding_peak_g: float = 0.05
    swing_peak_g: float = 0.15
    pocket_peak_g: float = 0.1
    low_pass_hz: float = 5.0
    min_interval_s: float = 0.2
    held_rejection_s: float = 0.12
    pocket_rejection_s: float = 0.06
    transition_s: float = TRANSITION_S

    def __post_init__(self) -> None:
        check_numbers(self, zero=("held_rejection_s", "pocket_rejection_s"))

    @cached_property
    def _low_pass_sos(self) -> FloatArray:
        return butterworth(2, self.low_pass_hz, self.rate_hz)

    @property
    def _filter_delay_s(self) -> float:
        # low-frequency group delay of a second-order Butterworth low-pass
        return np.sqrt(2.0) / (2.0 * np.pi * self.low_pass_hz)

    @property
    def _n_ahead(self) -> int:
        """Number of later samples needed to accept a peak: the rejection window, and one more to detect an extremum."""
        return round(max(self.held_rejection_s, self.pocket_rejection_s) * self.rate_hz) + 1

    @property
    def latency_s(self) -> float:
        return self.transition_s + self._n_ahead / self.rate_hz + self._filter_delay_s + 1.0 / self.rate_hz

    @cached_property
    def _carried(self) -> Carried:
        return Carried(self.rate_hz, self.transition_s)

    def init(self) -> TianDetectorState:
        line = np.zeros((4, self._n_line))
        return TianDetectorState(self._log.init(), line, self._carried.init(), None, -1, 0.0)

    @property
    def _n_line(self) -> int:
        return self._n_ahead + 1

    def _signals(
        self, state: TianDetectorState, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[TianDetectorState, FloatArray]:
        """Return the new state, and the three filtered signals in g and the carrying state of each sample, (4, N).

        The signals are the result of `step_signals`. The carrying state is HOLDING, SWING, POCKET or TRANS.
        """
        raw = step_signals(block.specific_force_mps2, attitude.up_sensor)
        carried, states = self._carried.update(state.carried, contexts.carrying_mode)
        signals, zi = filtered_rows(self._low_pass_sos, raw, state.low_pass_zi)
        return replace_unchecked(state, carried=carried, low_pass_zi=zi), np.vstack([signals, states.astype(float)])

    def _signals_after_end(self, state: TianDetectorState) -> FloatArray:
        """Return signals after the end, extrapolated linearly in the same mode.

        An unfinished transition therefore adds no steps.
        """
        last, slope = state.line[:, -1:], state.line[:, -1:] - state.line[:, -2:-1]
        slope[3] = 0.0  # the mode is constant
        return last + slope * np.arange(1, self._n_ahead + 1)

    def _detect(
        self, state: TianDetectorState, line: FloatArray, first: int
    ) -> tuple[TianDetectorState, list[tuple[int, Step]]]:
        # a tested sample has one sample before it and `_n_ahead` after it
        n_new = line.shape[1] - self._n_line
        states = line[3, 1 : n_new + 1].astype(int)
        before = line[3, :n_new]
        peaks = self._peaks(line[:3], states)
        # samples with negative numbers are repetitions of the first sample and are skipped
        events = np.flatnonzero(peaks | ((states == TRANS) != (before == TRANS)))
        steps: list[tuple[int, Step]] = []
        for i in events.tolist():
            sample, known = first - self._n_ahead + i, first + i
            if sample < 0:
                continue
            state, filled = self._follow_transition(state, sample, int(states[i]), known)
            steps += [(known, s) for s in filled]
            if peaks[i]:
                state, step = self._accept(state, line[int(states[i]), i : i + 3], sample, known)
                steps += [] if step is None else [(known, step)]
        return state, steps

    def _peaks(self, signals: FloatArray, states: IntArray) -> BoolArray:
        """Return whether each tested sample is an accepted peak of the signal of its mode."""
        n = len(states)
        middle = signals[:, 1:-1]
        is_max, is_min = local_maxima(signals), local_maxima(-signals)
        smallest = (self.holding_peak_g, self.swing_peak_g, self.pocket_peak_g)
        rejection_s = (self.held_rejection_s, self.held_rejection_s, self.pocket_rejection_s)
        peaks = np.zeros(n, dtype=bool)
        for mode in (HOLDING, SWING, POCKET):
            n_reject = round(rejection_s[mode] * self.rate_hz)
            found = is_max[mode, :n] & (middle[mode, :n] >= smallest[mode])
            found &= ~_any_after(is_min[mode], n_reject, n)
            if mode == SWING:
                negative = is_min[mode, :n] & (middle[mode, :n] <= -smallest[mode])
                found |= negative & ~_any_after(is_max[mode], n_reject, n)
            peaks |= found & (states == mode)
        return peaks

    def _follow_transition(
        self, state: TianDetectorState, sample: int, mode: int, known: int
    ) -> tuple[TianDetectorState, list[Step]]:
        """Return the new state, and the steps that are filled in for a transition that ends before this sample (eq. 8).

        No steps are detected while the phone changes between two carrying modes. The filled-in steps are evenly spaced.
        Their number is the duration of the transition times the step frequency before it. The list is empty if no
        transition ends here. `mode` is the state of the phone at `sample`, and `known` the number of the newest sample.
        """
        if mode == TRANS and state.transition_start < 0:
            at_s = self._log.time_s(state.log, sample)
            since_s = at_s - state.log.last_contact_s
            hz = state.step_hz if since_s <= self.max_interval_s else 0.0
            return replace_unchecked(state, transition_start=sample, step_hz=hz), []
        if mode == TRANS or state.transition_start < 0:
            return state, []
        n_steps = n_filled_in((sample - state.transition_start) / self.rate_hz, state.step_hz)
        steps: list[Step] = []
        log = state.log
        for i in range(n_steps):
            at = state.transition_start + (i + 0.5) * (sample - state.transition_start) / n_steps
            log, step = self._log.add(log, int(at), known, at - int(at))
            # the step frequency that gives their number also gives their length (section III-D)
            hz = state.step_hz
            steps.append(replace_unchecked(step, duration_s=1.0 / hz, frequency_hz=hz, from_rest=False))
        return replace_unchecked(state, log=log, transition_start=-1), steps

    def _accept(
        self, state: TianDetectorState, peak: FloatArray, sample: int, known: int
    ) -> tuple[TianDetectorState, Step | None]:
        """Return the new state, and the step of a peak, or None if the peak is rejected.

        It is rejected less than `min_interval_s` after the last contact, or if the samples of its step are not
        available. `peak` (3,) has the peak at `sample` and its neighbours. `known` is the number of the newest sample.
        """
        at = sample + vertex(peak) - self._filter_delay_s * self.rate_hz
        contact_s = self._log.time_s(state.log, at)
        if contact_s - state.log.last_contact_s < self.min_interval_s:
            return state, None
        first_of_bout = self._log.starts_bout(state.log, contact_s)
        state, step = self._end_step(state, at, known)
        if step is None:
            return state, None
        # only the first step from rest has no frequency; it is zero (section III-C)
        step_hz = 0.0 if first_of_bout else step.frequency_hz
        return replace_unchecked(state, step_hz=step_hz), replace_unchecked(step, from_rest=first_of_bout)


def n_filled_in(transition_s: float, step_frequency_hz: float) -> int:
    """Return the number of steps during a transition of t seconds, t f_s rounded half up (eq. 8).

    f_s is the step frequency in Hz.
    """
    return int(np.floor(transition_s * step_frequency_hz + 0.5))


def _any_after(extremum: BoolArray, n_after: int, n: int) -> BoolArray:
    """Return, for each of the first n samples, True if any of the `n_after` samples after it is an extremum."""
    if n_after == 0:
        return np.zeros(n, dtype=bool)
    return np.asarray(sliding_window_view(extremum[1:], n_after)[:n].any(axis=1))
