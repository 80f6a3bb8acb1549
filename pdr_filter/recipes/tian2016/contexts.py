"""Context stage of Tian et al. 2016, section III-B, Table I: a state machine for the carrying mode.

The main modes are HOLDING (`texting` here), SWING (`swinging`) and POCKET (`pocket`). A fast rotation of the phone ends
a main mode. The transition TRANS follows for two seconds, in which the direction of gravity determines the next main
mode. The person walks while steps are detected, and stands after two seconds without a step (section III-C). This does
not change during a transition.

Thresholds follow the sign convention of iOS (`steps.ios_acceleration`). Deviations from the paper are listed in
`TianContexts`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pdr_filter.recipes.tian2016.steps import (
    HOLDING,
    POCKET,
    SWING,
    TRANS,
    TianDetectorState,
    TianStepDetector,
    ios_acceleration,
)
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.contexts.context_stage import ContextStage
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.values import (
    CARRYING_MODES,
    CONTEXTS,
    BoolArray,
    FloatArray,
    IntArray,
    WindowContext,
    check_numbers,
    known_context,
    replace_unchecked,
)

_CARRYING_MODE: Mapping[int, str] = {HOLDING: "texting", SWING: "swinging", POCKET: "pocket"}


@dataclass(frozen=True)
class MachineState:
    """State of the machine that decides on the carrying mode.

    It has the present mode, and counts of samples in the window that determines the next mode.
    """

    mode: int
    mode_before: int  # S_bt, the main mode before a transition
    n_window: int  # samples of the window so far
    n_held: int  # samples with the gravity of a held phone; without angular rate, with the screen up
    n_on_edge: int  # samples with the phone on its long edge
    n_face_down: int  # samples with the screen down
    n_screen_up: int  # latest consecutive samples with the screen up


@dataclass(frozen=True)
class CarryingMachine:
    """State machine of the carrying mode (Tian et al. 2016, Table I), which is updated sample by sample.

    The main modes are HOLDING (in the hand in front of the body), SWING (in a swinging hand) and POCKET. A main mode
    ends when an angular rate exceeds a limit: about y or z in HOLDING, about y in SWING, about z in POCKET (Table II).
    The transition TRANS follows for `transition_s`.

    Gravity in the samples of the transition determines the next main mode. After SWING or POCKET, it is HOLDING if
    gravity is as for a phone in front of the body in any sample. Otherwise it is the other one of SWING and POCKET.
    After HOLDING, it is HOLDING if the phone was only rotated (see `held_again_s`). It is SWING if the phone is on its
    long edge (|g_x| > GS_x) in any sample, and its screen is down (g_z >= GS_z) in none. In all other cases it is
    POCKET.

    Without angular rate, gravity alone determines the mode every `transition_s`. The mode is HOLDING if the screen is
    up (g_z < -GH_z) in more than half of the samples. It is SWING if the phone is on its long edge in more than half,
    and POCKET otherwise. This is an extension, because the paper assumes a gyroscope. An upright phone is then assigned
    to POCKET, which is the most frequent case.
    """

    rate_hz: float = 100.0  # sampling rate in Hz
    # angular rates R_y and R_z about the y and z axis of the phone that start a transition, in rad/s
    rate_y_radps: float = 3.0
    rate_z_radps: float = 5.0
    transition_s: float = 2.0  # duration of a transition in s
    # gravity GH_y and GH_z on y or z of a held phone with a roll of up to 30 degrees (eq. 7), in g
    held_y_g: float = 0.65
    held_z_g: float = 0.65
    edge_x_g: float = 0.9  # gravity GS_x on x of a phone in a swinging hand, in g
    # gravity GS_z on z, in g. If g_z reaches it in any sample of a transition, the screen is down, and the mode after
    # HOLDING is not SWING.
    face_down_z_g: float = 0.4
    # duration in s at the end of the transition. A held phone whose screen is up (g_z < -GH_z) during all of it was
    # only rotated, and stays in HOLDING. A value longer than the window disables this, as in the paper.
    held_again_s: float = 0.5

    def __post_init__(self) -> None:
        check_numbers(self, infinite=("held_again_s",))

    def init(self) -> MachineState:
        """Return the state before the first sample: HOLDING, because the user has just started the app."""
        return _in_mode(HOLDING)

    def update(
        self, state: MachineState, angular_rate_radps: FloatArray, rate_known: BoolArray, up_sensor: FloatArray
    ) -> tuple[MachineState, IntArray]:
        """Return the new state, and HOLDING, SWING, POCKET or TRANS for each sample (N,)."""
        held, on_edge, face_down, screen_up = self._gravity_conditions(up_sensor)
        moved = self._moved(angular_rate_radps, rate_known)
        n, n_window = len(rate_known), round(self.transition_s * self.rate_hz)
        modes = np.empty(n, dtype=np.int64)
        i = 0
        while i < n:
            if state.mode != TRANS and rate_known[i]:
                stop = _first(moved[state.mode] | ~rate_known, i, n)
                if stop < n and rate_known[stop]:
                    # the sample that shows the motion still has the previous mode, as in Table I
                    modes[i : stop + 1] = state.mode
                    state = replace_unchecked(_in_mode(state.mode), mode=TRANS)
                    i = stop + 1
                else:
                    modes[i:stop] = state.mode
                    state = _in_mode(state.mode)
                    i = stop
                continue
            # window of a transition, or window without angular rate, which ends when the rate is known again
            stop = min(i + n_window - state.n_window, n)
            if state.mode != TRANS:
                stop = _first(rate_known, i, stop)
            modes[i:stop] = state.mode
            state = replace_unchecked(
                state,
                n_window=state.n_window + stop - i,
                n_held=state.n_held + int((held if state.mode == TRANS else screen_up)[i:stop].sum()),
                n_on_edge=state.n_on_edge + int(on_edge[i:stop].sum()),
                n_face_down=state.n_face_down + int(face_down[i:stop].sum()),
                n_screen_up=_run_at_end(state.n_screen_up, screen_up[i:stop]),
            )
            if state.n_window == n_window:
                mode = self._after_transition(state) if state.mode == TRANS else _by_gravity(state)
                state = _in_mode(mode)
            i = stop
        return state, modes

    def _gravity_conditions(self, up_sensor: FloatArray) -> tuple[BoolArray, BoolArray, BoolArray, BoolArray]:
        """Return four masks (N,): phone in front of the body, on its long edge, screen down, and screen up."""
        gravity, _ = ios_acceleration(np.zeros_like(up_sensor), up_sensor)
        x, y, z = gravity.T
        held = ((y < -self.held_y_g) & (z < 0)) | ((z < -self.held_z_g) & (y < 0))
        return held, np.abs(x) > self.edge_x_g, z >= self.face_down_z_g, z < -self.held_z_g

    def _moved(self, angular_rate_radps: FloatArray, rate_known: BoolArray) -> BoolArray:
        """Return whether the angular rate starts a transition, (3, N), in HOLDING, SWING and POCKET (rows)."""
        about_y = rate_known & (np.abs(angular_rate_radps[:, 1]) > self.rate_y_radps)
        about_z = rate_known & (np.abs(angular_rate_radps[:, 2]) > self.rate_z_radps)
        return np.stack([about_y | about_z, about_y, about_z])

    def _after_transition(self, state: MachineState) -> int:
        """Return the main mode after a transition, from the counts of samples with each direction of gravity.

        The rules are in `CarryingMachine`. They are S_at in Table I of Tian et al. 2016, except for a held phone that
        was only rotated.
        """
        if state.mode_before in (SWING, POCKET):
            other = POCKET if state.mode_before == SWING else SWING
            return HOLDING if state.n_held > 0 else other
        if state.n_screen_up >= self.held_again_s * self.rate_hz:
            return HOLDING
        return SWING if state.n_on_edge > 0 and state.n_face_down == 0 else POCKET


def _in_mode(mode: int) -> MachineState:
    """Return the state at the start of a main mode, with an empty window."""
    return MachineState(mode, mode, 0, 0, 0, 0, 0)


def _run_at_end(n_before: int, condition: BoolArray) -> int:
    """Return for how many consecutive samples, up to the last, a condition holds, after `n_before` earlier samples."""
    ends = np.flatnonzero(~condition)
    return len(condition) - 1 - int(ends[-1]) if len(ends) else n_before + len(condition)


def _by_gravity(state: MachineState) -> int:
    """Return the mode of a window without angular rate, from gravity in the majority of its samples."""
    if 2 * state.n_held > state.n_window:
        return HOLDING
    return SWING if 2 * state.n_on_edge > state.n_window else POCKET


def _first(condition: BoolArray, start: int, stop: int) -> int:
    """Return the first index in [start, stop) at which a condition holds, or `stop`."""
    found = np.flatnonzero(condition[start:stop])
    return start + int(found[0]) if len(found) else stop


@dataclass(frozen=True, eq=False)
class TianContextsState:
    """State of the carrying-mode machine and of the step detector, and the last report."""

    machine: MachineState
    detector: TianDetectorState
    n_samples: int  # samples of this segment
    last_contact: int  # sample at which the last step was detected; negative before the first
    walking: bool
    reported_mode: int  # -1 before the first report
    n_silent: int  # samples since the last report


@dataclass(frozen=True)
class TianContexts(ContextStage):
    """Context stage of Tian et al. 2016, which reports the carrying mode, and walking or stationary.

    A report is made at every change and once per second. Probabilities are 0 or 1.

    Parameters
    ----------
    machine : CarryingMachine
        State machine of the carrying mode.
    steps : TianStepDetector
        Step detector, which should equal the step detector of the recipe. The person walks while it detects steps.
    stationary_s : float, default 2.0
        Time in s without a step, outside transitions, after which the person stands.

    Raises
    ------
    ValueError
        If `stationary_s` is not positive, or if machine and detector have different sampling rates.

    Notes
    -----
    Deviations from the paper:

    - After a transition from HOLDING, the mode is HOLDING again if the screen was up during the last 0.5 s of the
      transition (`CarryingMachine.held_again_s`). In the paper, a phone that is only turned in the hand counts as in a
      pocket. The mode of phones in the hand is better with the deviation (ubicomp13, people 1 to 6).
    - After a gap in the samples, the main mode stays, and a transition has ended. The paper has no gaps.
    - Without angular rate, gravity alone determines the mode every 2 s. The paper assumes a gyroscope.

    Examples
    --------
    >>> from pdr_filter.recipes.tian2016.contexts import TianContexts
    >>> TianContexts().hop_s
    1.0
    """

    machine: CarryingMachine = field(default_factory=CarryingMachine)
    steps: TianStepDetector = field(default_factory=TianStepDetector)
    stationary_s: float = 2.0

    def __post_init__(self) -> None:
        check_numbers(self)
        if self.machine.rate_hz != self.steps.rate_hz:
            raise ValueError(
                "the state machine of the carrying mode (machine) and the step detector (steps) must have the same "
                f"rate_hz, got {self.machine.rate_hz} and {self.steps.rate_hz}: set one of the two"
            )

    @property
    def contexts(self) -> tuple[str, ...]:
        return CONTEXTS

    @property
    def rate_hz(self) -> float:
        return self.machine.rate_hz

    @property
    def hop_s(self) -> float:
        return 1.0

    def init(self) -> TianContextsState:
        return TianContextsState(self.machine.init(), self.steps.init(), 0, -1, False, -1, 0)

    def after_gap(self, state: TianContextsState) -> TianContextsState:
        mode = state.machine.mode_before
        return replace_unchecked(self.init(), machine=_in_mode(mode))

    def update(
        self, state: TianContextsState, block: UniformBlock, attitude: AttitudeBlock
    ) -> tuple[TianContextsState, list[tuple[int, WindowContext]]]:
        n = len(block.time_s)
        machine, modes = self.machine.update(
            state.machine, block.angular_rate_radps, block.angular_rate_known, attitude.up_sensor
        )
        carrying = np.array([CARRYING_MODES.index(_CARRYING_MODE[m]) if m in _CARRYING_MODE else -1 for m in range(4)])
        known = ContextBlock(np.full(n, -1), carrying[modes])
        detector, steps = self.steps.update(state.detector, block, attitude, known)
        walking, last_contact = self._walking(state, modes, [number - state.n_samples for number, _ in steps])
        reports: list[tuple[int, WindowContext]] = []
        before = np.concatenate([[state.reported_mode], modes[:-1]])
        changed = (modes != before) | (walking != np.concatenate([[state.walking], walking[:-1]]))
        n_silent = state.n_silent
        for i in range(n):
            n_silent += 1
            if changed[i] or n_silent >= self.hop_s * self.rate_hz:
                window = known_context(
                    float(block.time_s[i]),
                    {"walking" if walking[i] else "stationary": 1.0},
                    {_CARRYING_MODE[mode]: 1.0} if (mode := int(modes[i])) in _CARRYING_MODE else {},
                    ("stationary", "walking"),
                    "tian2016",
                )
                # a report of a change describes one sample, any other report all samples since the last report
                n_described = 1 if changed[i] else n_silent
                start_s = window.time_s - (n_described - 0.5) / self.rate_hz
                reports.append(
                    (state.n_samples + i, replace_unchecked(window, start_s=start_s, hop_s=n_silent / self.rate_hz))
                )
                n_silent = 0
        state = TianContextsState(
            machine=machine,
            detector=detector,
            n_samples=state.n_samples + n,
            last_contact=last_contact,
            walking=bool(walking[-1]),
            reported_mode=int(modes[-1]),
            n_silent=n_silent,
        )
        return state, reports

    def _walking(self, state: TianContextsState, modes: IntArray, revealed: list[int]) -> tuple[BoolArray, int]:
        """Return whether the person walks at each sample (N,), and the sample since which no step was detected.

        Sample numbers count from the start of the segment. `modes` (N,) are the states of the phone, and `revealed` the
        indices in the block at which a step became known. Walking ends `stationary_s` after the last step. Samples of a
        transition do not count for this time, so each of them increases the second result by one.
        """
        walking = np.empty(len(modes), dtype=bool)
        is_walking, last = state.walking, state.last_contact
        steps = set(revealed)
        for i in range(len(modes)):
            if i in steps:
                is_walking, last = True, state.n_samples + i
            elif modes[i] == TRANS:
                last += 1  # the time of a transition does not count, because steps are not detected in it
            elif state.n_samples + i - last > self.stationary_s * self.rate_hz:
                is_walking = False
            walking[i] = is_walking
        return walking, last
