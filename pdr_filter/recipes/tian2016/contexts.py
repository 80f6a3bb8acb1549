"""How the phone is carried, as a machine of four states: Tian et al. 2016, section III-B, Table I.

HOLDING (our `texting`), SWING (`swinging`) and POCKET (`pocket`) are left when the phone is turned fast; two seconds of
TRANS (unknown) follow, in which the direction of gravity shows what comes next. A person walks while there are steps
and stands when there has been none for two seconds (section III-C), during a transition as before it.

Thresholds are in the convention of iOS (`steps.ios_acceleration`). Deviations: docs/methods/tian2016.md.
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
from pdr_filter.sensing.contexts.context_stage import WindowContext, known_context
from pdr_filter.sensing.steps.step_detector import ContextBlock
from pdr_filter.values import (
    CARRYING_MODES,
    CONTEXTS,
    BoolArray,
    FloatArray,
    IntArray,
    check_numbers,
    replace_unchecked,
)

_CARRYING_MODE: Mapping[int, str] = {HOLDING: "texting", SWING: "swinging", POCKET: "pocket"}


@dataclass(frozen=True)
class MachineState:
    """Where the machine is, and what it has seen of the window that decides what comes next."""

    mode: int
    mode_before: int  # S_bt: the main mode before a transition
    n_window: int  # samples of the window so far
    n_held: int  # of them those in which gravity is as in a phone that is held; without angular rate, screen up
    n_on_edge: int  # and as in one on its long edge
    n_face_down: int  # and in which the screen looks down
    n_screen_up: int  # the last samples in a row in which it looks up


@dataclass(frozen=True)
class CarryingMachine:
    """The machine of Table I, sample by sample.

    It sees transitions in the angular rate. Where that is missing, gravity alone decides: every `transition_s` the
    phone is held if its screen looks up (g_z < -GH_z) in more than half of the samples, swinging if it lies on its long
    edge in more than half, in a pocket otherwise. That is ours: the paper always has a gyroscope. An upright phone
    is taken to be in a pocket there, because most are.

    Parameters
    ----------
    rate_y_radps, rate_z_radps : float
        R_y and R_z: faster about an axis that the mode watches (Table II), and the phone is being moved.
    transition_s : float
        How long a transition lasts.
    held_y_g, held_z_g : float
        GH_y and GH_z: gravity on y or z of a phone that is held, rolled by up to 30 degrees (eq. 7).
    edge_x_g : float
        GS_x: gravity on x of a phone in a swinging hand.
    face_down_z_g : float
        GS_z: gravity on z never reached on the way into a swinging hand.
    held_again_s : float
        A phone that was held and whose screen looks up (g_z < -GH_z) all through the end of the window, for this
        long, was only turned, and is still held. Longer than the window: never, as printed.
    """

    rate_hz: float = 100.0
    rate_y_radps: float = 3.0
    rate_z_radps: float = 5.0
    transition_s: float = 2.0
    held_y_g: float = 0.65
    held_z_g: float = 0.65
    edge_x_g: float = 0.9
    face_down_z_g: float = 0.4
    held_again_s: float = 0.5

    def __post_init__(self) -> None:
        check_numbers(self, infinite=("held_again_s",))

    def init(self) -> MachineState:
        """State before the first sample: held, because somebody has just started the program."""
        return _in_mode(HOLDING)

    def update(
        self, state: MachineState, angular_rate_radps: FloatArray, rate_known: BoolArray, up_sensor: FloatArray
    ) -> tuple[MachineState, IntArray]:
        """New state and HOLDING, SWING, POCKET or TRANS for each sample."""
        held, on_edge, face_down, screen_up = self._gravity_conditions(up_sensor)
        moved = self._moved(angular_rate_radps, rate_known)
        n, n_window = len(rate_known), round(self.transition_s * self.rate_hz)
        modes = np.empty(n, dtype=np.int64)
        i = 0
        while i < n:
            if state.mode != TRANS and rate_known[i]:
                stop = _first(moved[state.mode] | ~rate_known, i, n)
                if stop < n and rate_known[stop]:
                    # the sample that shows the motion is still of the mode before, as in Table I
                    modes[i : stop + 1] = state.mode
                    state = replace_unchecked(_in_mode(state.mode), mode=TRANS)
                    i = stop + 1
                else:
                    modes[i:stop] = state.mode
                    state = _in_mode(state.mode)
                    i = stop
                continue
            # a window of a transition, or one without angular rate, which ends where the rate is back
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
        """Whether gravity is as in a held phone, on its long edge, with the screen down, and up; (N,) each."""
        gravity, _ = ios_acceleration(np.zeros_like(up_sensor), up_sensor)
        x, y, z = gravity.T
        held = ((y < -self.held_y_g) & (z < 0)) | ((z < -self.held_z_g) & (y < 0))
        return held, np.abs(x) > self.edge_x_g, z >= self.face_down_z_g, z < -self.held_z_g

    def _moved(self, angular_rate_radps: FloatArray, rate_known: BoolArray) -> BoolArray:
        """Whether the phone is moved to another place, by the rates that each main mode watches (Table II), (3, N)."""
        about_y = rate_known & (np.abs(angular_rate_radps[:, 1]) > self.rate_y_radps)
        about_z = rate_known & (np.abs(angular_rate_radps[:, 2]) > self.rate_z_radps)
        return np.stack([about_y | about_z, about_y, about_z])

    def _after_transition(self, state: MachineState) -> int:
        """S_at of Table I, and HOLDING again for a phone that was only turned."""
        if state.mode_before in (SWING, POCKET):
            other = POCKET if state.mode_before == SWING else SWING
            return HOLDING if state.n_held > 0 else other
        if state.n_screen_up >= self.held_again_s * self.rate_hz:
            return HOLDING
        return SWING if state.n_on_edge > 0 and state.n_face_down == 0 else POCKET


def _in_mode(mode: int) -> MachineState:
    """In a main mode, with nothing of a window seen."""
    return MachineState(mode, mode, 0, 0, 0, 0, 0)


def _run_at_end(n_before: int, condition: BoolArray) -> int:
    """How many samples in a row, up to the last, a condition has held; `n_before` before these."""
    ends = np.flatnonzero(~condition)
    return len(condition) - 1 - int(ends[-1]) if len(ends) else n_before + len(condition)


def _by_gravity(state: MachineState) -> int:
    """The mode of a window without angular rate, by what gravity was like in more than half of it."""
    if 2 * state.n_held > state.n_window:
        return HOLDING
    return SWING if 2 * state.n_on_edge > state.n_window else POCKET


def _first(condition: BoolArray, start: int, stop: int) -> int:
    """First index from `start` on at which a condition holds; `stop` if it does not before."""
    found = np.flatnonzero(condition[start:stop])
    return start + int(found[0]) if len(found) else stop


@dataclass(frozen=True, eq=False)
class TianContextsState:
    """The machine, its steps, and the last report."""

    machine: MachineState
    detector: TianDetectorState
    n_samples: int  # of this segment
    last_contact: int  # number of the sample that revealed the last step; negative before the first
    walking: bool
    reported_mode: int  # -1 before the first
    n_silent: int  # samples since the last report


@dataclass(frozen=True)
class TianContexts:
    """Context stage: the machine's mode, and walking or stationary.

    It reports at every change and once a second, and is certain: one probability is 1.

    Parameters
    ----------
    steps : TianStepDetector
        Whoever makes steps walks; the same detector as that of the recipe.
    stationary_s : float
        No step for so long, outside transitions, is standing: the step frequency is zero.
    """

    machine: CarryingMachine = field(default_factory=CarryingMachine)
    steps: TianStepDetector = field(default_factory=TianStepDetector)
    stationary_s: float = 2.0

    def __post_init__(self) -> None:
        check_numbers(self)
        if self.machine.rate_hz != self.steps.rate_hz:
            raise ValueError(f"rate_hz must be one, got {self.machine.rate_hz} and {self.steps.rate_hz}")

    @property
    def contexts(self) -> tuple[str, ...]:
        """Names of the contexts, those of the default."""
        return CONTEXTS

    @property
    def rate_hz(self) -> float:
        """Sampling rate of the blocks."""
        return self.machine.rate_hz

    @property
    def hop_s(self) -> float:
        """A report comes once a second, and at every change."""
        return 1.0

    def init(self) -> TianContextsState:
        """State before the first sample."""
        return TianContextsState(self.machine.init(), self.steps.init(), 0, -1, False, -1, 0)

    def after_gap(self, state: TianContextsState) -> TianContextsState:
        """State at the start of a new segment: the mode lasts, a transition is over, nobody is known to walk."""
        mode = state.machine.mode_before
        return replace_unchecked(self.init(), machine=_in_mode(mode))

    def update(
        self, state: TianContextsState, block: UniformBlock, attitude: AttitudeBlock
    ) -> tuple[TianContextsState, list[tuple[int, WindowContext]]]:
        """New state and the reports, each with the number of its last sample."""
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
                # a change is of its own sample, all else of the samples since the last report
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
        """Whether each sample of a block is of a walk, and the number of the sample that revealed the last step."""
        walking = np.empty(len(modes), dtype=bool)
        is_walking, last = state.walking, state.last_contact
        steps = set(revealed)
        for i in range(len(modes)):
            if i in steps:
                is_walking, last = True, state.n_samples + i
            elif modes[i] == TRANS:
                last += 1  # the pause does not count: nobody looks for steps
            elif state.n_samples + i - last > self.stationary_s * self.rate_hz:
                is_walking = False
            walking[i] = is_walking
        return walking, last
