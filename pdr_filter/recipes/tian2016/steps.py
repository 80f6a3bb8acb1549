"""Steps as peaks of the acceleration that suits how the phone is carried: Tian et al. 2016, section III-C.

Held in front, the acceleration along the vertical (eq. 5, 6) is looked at; in a swinging hand that of the device's y
axis, whose peaks of both signs are steps, because an arm swings once in two steps; in a pocket that of its z axis
(Table III). While the phone moves from one place to another nothing can be detected: what the person walked
meanwhile is filled in afterwards (eq. 8).

The equations are in the convention of iOS: gravity and user acceleration in g, -1 on z for a phone that lies face up.
`ios_acceleration` is the only place that converts.

Deviations: docs/methods/tian2016.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.signal_filters import butterworth, filtered
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

# The states of the paper's machine; the first three are also the rows of `step_signals`.
HOLDING, SWING, POCKET, TRANS = range(4)

# Which of them each of `CARRYING_MODES` is. A phone at the ear hardly turns either, one in a bag lies as it likes.
_STATE_OF = np.array([{"swinging": SWING, "pocket": POCKET, "bag": POCKET}.get(m, HOLDING) for m in CARRYING_MODES])

# Length of a transition: 100 samples at 50 Hz (section III-B).
TRANSITION_S = 2.0


def ios_acceleration(specific_force_mps2: FloatArray, up_sensor: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gravity and user acceleration as CoreMotion gives them, both (N, 3), in g.

    gravity + user acceleration = -f / g0: a phone that lies face up has gravity (0, 0, -1), and pushing it upwards
    gives a negative user acceleration on z.
    """
    gravity_g = -up_sensor
    return gravity_g, -specific_force_mps2 / STANDARD_GRAVITY_MPS2 - gravity_g


def step_signals(specific_force_mps2: FloatArray, up_sensor: FloatArray) -> FloatArray:
    """User acceleration in which steps are sought, (3, N), in g: vertical (HOLDING), y (SWING), z (POCKET); Table III.

    The vertical one is a_uz sin(phi) + a_uy cos(phi) with phi = atan |g_z / g_y| (eq. 5, 6), that is
    -(a_uy g_y + a_uz g_z) / sqrt(g_y^2 + g_z^2): as printed where g_y and g_z are negative, as they are for a phone
    that somebody reads, and with the right sign elsewhere. Zero where both are.
    """
    gravity, user = ios_acceleration(specific_force_mps2, up_sensor)
    in_plane = np.sqrt(gravity[:, 1] ** 2 + gravity[:, 2] ** 2)
    vertical = -(user[:, 1] * gravity[:, 1] + user[:, 2] * gravity[:, 2]) / np.maximum(in_plane, 1e-9)
    return np.stack([vertical, user[:, 1], user[:, 2]])


@dataclass(frozen=True, slots=True)
class CarriedState:
    """The last main mode that was known, and for how many samples none has been."""

    main_mode: int
    n_unknown: int


@dataclass(frozen=True)
class Carried:
    """The paper's state of each sample, from carrying modes that any context stage gives.

    An unknown carrying mode is a transition, but for `transition_s` at most: then it is that before again. Before
    anything is known the phone is held, because somebody has just started the program (section III-B).
    """

    rate_hz: float = 100.0
    transition_s: float = TRANSITION_S

    def __post_init__(self) -> None:
        check_numbers(self)

    @property
    def _n_transition(self) -> int:
        return round(self.transition_s * self.rate_hz)

    def init(self) -> CarriedState:
        """State before the first sample: held."""
        return CarriedState(HOLDING, self._n_transition)

    def update(self, state: CarriedState, carrying_mode: IntArray) -> tuple[CarriedState, IntArray]:
        """New state and HOLDING, SWING, POCKET or TRANS for each index into `CARRYING_MODES`, -1 unknown."""
        n = len(carrying_mode)
        known = carrying_mode >= 0
        last_known = np.maximum.accumulate(np.where(known, np.arange(n), -1))
        n_unknown = np.where(last_known < 0, state.n_unknown, 0) + np.arange(n) - np.maximum(last_known, -1)
        main = np.where(last_known < 0, state.main_mode, _STATE_OF[carrying_mode[last_known]])
        states = np.where((n_unknown > 0) & (n_unknown <= self._n_transition), TRANS, main)
        return CarriedState(int(main[-1]), min(int(n_unknown[-1]), self._n_transition)), states


@dataclass(frozen=True, eq=False)
class TianDetectorState(DetectorState):
    """The samples that wait for their future, filter memories, and the transition that is on."""

    carried: CarriedState
    low_pass_zi: FloatArray | None  # (n_sections, 3, 2); None before the first sample
    transition_start: int  # number of its first sample; -1 outside
    step_hz: float  # frequency of the last step; zero for the first from rest


@dataclass(frozen=True)
class TianStepDetector(BaseStepDetector[TianDetectorState]):
    """Causal mode-aware step detector; a step is reported 0.2 s after its contact or after the transition.

    Parameters
    ----------
    holding_peak_g, swing_peak_g, pocket_peak_g : float
        Smallest peak that is a step. The paper prints one only, the 0.2 g of the walk in a pocket of Fig. 7, which
        loses a fifth of the steps of other people.
    low_pass_hz : float
        Cutoff of the low-pass (Butterworth, second order): people make 0.5 to 5 steps a second.
    min_interval_s : float
        Two peaks closer than this are one step: criterion 1.
    held_rejection_s, pocket_rejection_s : float
        A peak followed by one of the other sense within this time is false: criterion 2; 6 and 3 samples at 50 Hz.
    transition_s : float
        Longest transition.
    rate_hz, max_interval_s, first_step_s : float
        Of every `BaseStepDetector`; after `max_interval_s` the step frequency is zero.
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
        # group delay at low frequencies of a second-order Butterworth low-pass
        return np.sqrt(2.0) / (2.0 * np.pi * self.low_pass_hz)

    @property
    def _n_ahead(self) -> int:
        """Samples after a peak that decide on it; the last of a rejection window is an extremum only with the next."""
        return round(max(self.held_rejection_s, self.pocket_rejection_s) * self.rate_hz) + 1

    @property
    def latency_s(self) -> float:
        """Longest time from a contact to its detection: a step at the start of a transition."""
        return self.transition_s + self._n_ahead / self.rate_hz + self._filter_delay_s + 1.0 / self.rate_hz

    @cached_property
    def _carried(self) -> Carried:
        return Carried(self.rate_hz, self.transition_s)

    def init(self) -> TianDetectorState:
        """State before the first sample of a segment."""
        line = np.zeros((4, self._n_line))
        return TianDetectorState(self._log.init(), line, self._carried.init(), None, -1, 0.0)

    @property
    def _n_line(self) -> int:
        return self._n_ahead + 1

    def _signals(
        self, state: TianDetectorState, block: UniformBlock, attitude: AttitudeBlock, contexts: ContextBlock
    ) -> tuple[TianDetectorState, FloatArray]:
        """The three filtered signals and the state of each sample, (4, N)."""
        raw = step_signals(block.specific_force_mps2, attitude.up_sensor)
        carried, states = self._carried.update(state.carried, contexts.carrying_mode)
        signals, zi = filtered(self._low_pass_sos, raw, state.low_pass_zi)
        return replace_unchecked(state, carried=carried, low_pass_zi=zi), np.vstack([signals, states.astype(float)])

    def _continued(self, state: TianDetectorState) -> FloatArray:
        """The signals go on straight, in the same mode: a transition that has not ended is not filled in."""
        last, slope = state.line[:, -1:], state.line[:, -1:] - state.line[:, -2:-1]
        slope[3] = 0.0  # the mode stays
        return last + slope * np.arange(1, self._n_ahead + 1)

    def _detect(
        self, state: TianDetectorState, line: FloatArray, first: int
    ) -> tuple[TianDetectorState, list[tuple[int, Step]]]:
        # Those decided on have one sample before them and `_n_ahead` after.
        n_new = line.shape[1] - self._n_line
        states = line[3, 1 : n_new + 1].astype(int)
        before = line[3, :n_new]
        peaks = self._peaks(line[:3], states)
        # before the first sample there are only repeats of it
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
        """Whether each sample that is decided on is a true peak of the signal of its mode."""
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
        """New state, and the steps of a transition that ends before this sample."""
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
            # their length is that of the frequency which gave their number (section III-D)
            hz = state.step_hz
            steps.append(replace_unchecked(step, duration_s=1.0 / hz, frequency_hz=hz, from_rest=False))
        return replace_unchecked(state, log=log, transition_start=-1), steps

    def _accept(
        self, state: TianDetectorState, peak: FloatArray, sample: int, known: int
    ) -> tuple[TianDetectorState, Step | None]:
        """The step that a peak makes, if it makes one."""
        at = sample + vertex(peak) - self._filter_delay_s * self.rate_hz
        contact = int(np.floor(at))
        if not self._log.can_end(state.log, contact):
            return state, None
        contact_s = self._log.time_s(state.log, contact) + (at - contact) / self.rate_hz
        if contact_s - state.log.last_contact_s < self.min_interval_s:
            return state, None
        first_of_bout = self._log.starts_bout(state.log, contact_s)
        log, step = self._log.add(state.log, contact, known, at - contact)
        # of the first step from rest, and of it alone, no frequency is known: it is zero (section III-C)
        step_hz = 0.0 if first_of_bout else step.frequency_hz
        return replace_unchecked(state, log=log, step_hz=step_hz), replace_unchecked(step, from_rest=first_of_bout)


def n_filled_in(transition_s: float, step_frequency_hz: float) -> int:
    """Steps during a transition: round(t f_s), half up (eq. 8)."""
    return int(np.floor(transition_s * step_frequency_hz + 0.5))


def _any_after(extremum: BoolArray, n_after: int, n: int) -> BoolArray:
    """Whether any of the `n_after` samples after each of the first n is an extremum."""
    if n_after == 0:
        return np.zeros(n, dtype=bool)
    return np.asarray(sliding_window_view(extremum[1:], n_after)[:n].any(axis=1))
