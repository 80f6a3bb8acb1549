"""Moving without steps: a phone on a trolley, in a pram or a vehicle, which shakes without a pause while nobody walks.

A second rattles if |f| trembles by `min_jitter_mps2`: the rms of the differences of successive means over 20 ms, which
is motion of about 5 to 25 Hz. A run of `min_run_s` such seconds without a step is moving: a hand that holds or handles
a phone pauses. Figures: docs/methods/steps.md.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.values import FloatArray, Step, check_numbers, replace_unchecked

_JITTER_HZ = 50.0
# The first steps of a bout become known up to 4 s after their contacts, and a contact ends a step of a second.
_WAIT_S = 5
# Steps so much before and after a second are walking in it.
_STEP_S = 1.0


@dataclass(frozen=True, eq=False)
class RattleState:
    """The seconds whose steps may still come, the run of rattling ones, and the sums."""

    n_samples: int = 0  # of the segment
    start_s: float = 0.0  # of the segment
    rest: FloatArray = field(default_factory=lambda: np.empty(0))  # |f| of samples that are no whole second yet
    waiting_mps2: tuple[float, ...] = ()  # jitter of the last seconds
    steps: tuple[tuple[int, float], ...] = ()  # sample that revealed them, and time, of the last seconds' steps
    run_s: int = 0
    moving_s: int = 0  # in runs that were long enough
    seen_s: int = 0


@dataclass(frozen=True, slots=True)
class Rattle:
    """Causal stage that counts the seconds in which the phone moves and nobody walks.

    Parameters
    ----------
    rate_hz : float
        Sampling rate of the blocks, a multiple of 50 Hz.
    min_jitter_mps2 : float
        Four times the median of people who stand, half of the median on a trolley.
    min_run_s : int
        Ten seconds find 2 % of phones that are taken out and put away, twenty 0.1 %.
    """

    rate_hz: float = 100.0
    min_jitter_mps2: float = 0.2
    min_run_s: int = 20

    def __post_init__(self) -> None:
        check_numbers(self)
        if self.rate_hz % _JITTER_HZ:
            raise ValueError(f"rate_hz must be a multiple of {_JITTER_HZ:g}, got {self.rate_hz}")

    def init(self) -> RattleState:
        """State before the first sample."""
        return RattleState()

    def after_gap(self, state: RattleState) -> RattleState:
        """State before the first sample after a gap: the sums alone."""
        return RattleState(moving_s=state.moving_s, seen_s=state.seen_s)

    def update(self, state: RattleState, block: UniformBlock, steps: Sequence[tuple[int, Step]]) -> RattleState:
        """State after a block and the steps that were found in it."""
        x, y, z = block.specific_force_mps2.T
        magnitude = np.concatenate([state.rest, np.sqrt(x * x + y * y + z * z)])
        n = round(self.rate_hz)
        first, n_whole = state.n_samples // n, len(magnitude) // n
        state = replace_unchecked(
            state,
            n_samples=state.n_samples + len(block.time_s),
            start_s=float(block.time_s[0]) if state.n_samples == 0 else state.start_s,
            rest=magnitude[n_whole * n :],
        )
        found, n_known = [(number, step.time_s) for number, step in steps], 0
        jitters_mps2 = _jitter(magnitude[: n_whole * n].reshape(n_whole, n)) if n_whole else []
        for second, jitter_mps2 in enumerate(jitters_mps2):
            waiting_mps2 = (*state.waiting_mps2, jitter_mps2)
            until = bisect_left(found, ((first + second + 1) * n,), lo=n_known)
            state = replace_unchecked(state, waiting_mps2=waiting_mps2, steps=(*state.steps, *found[n_known:until]))
            state, n_known = self._judge(state, first + second), until
        return replace_unchecked(state, steps=(*state.steps, *found[n_known:]))

    def _judge(self, state: RattleState, second: int) -> RattleState:
        """State when a second is over: the one some seconds earlier has all its steps."""
        if len(state.waiting_mps2) <= _WAIT_S:
            return state
        jitter_mps2, *waiting_mps2 = state.waiting_mps2
        begin_s, known = state.start_s + second - _WAIT_S, round((second + 1) * self.rate_hz)
        recent = tuple(s for s in state.steps if s[1] > begin_s - _STEP_S)
        walks = any(number < known and time_s < begin_s + 1.0 + _STEP_S for number, time_s in recent)
        run_s = state.run_s + 1 if jitter_mps2 > self.min_jitter_mps2 and not walks else 0
        moving_s = self.min_run_s if run_s == self.min_run_s else int(run_s > self.min_run_s)
        return replace_unchecked(
            state,
            waiting_mps2=tuple(waiting_mps2),
            steps=recent,
            run_s=run_s,
            moving_s=state.moving_s + moving_s,
            seen_s=state.seen_s + 1,
        )


def _jitter(magnitude: FloatArray) -> list[float]:
    """Jitter of each second (S, N)."""
    means = magnitude.reshape(len(magnitude), round(_JITTER_HZ), -1).mean(axis=2)
    return np.sqrt((np.diff(means) ** 2).mean(axis=1)).tolist()
