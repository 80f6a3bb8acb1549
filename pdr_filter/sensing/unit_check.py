"""Samples in another unit, without gravity or of the other sign: noticed within the first seconds, said once.

The limits are those of the readers (`values.plausibility`), looked at in windows. An accelerometer of the other sign
cannot be told by physics from one that is right: a phone that is looked at would have its screen down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.values import FloatArray, median, replace_unchecked
from pdr_filter.values.plausibility import wrong_angular_rate, wrong_specific_force

# A window is whole after both.
_WINDOW_S, _WINDOW_ROWS = 2.0, 100
# Shaking a phone makes single windows of more than 12 rad/s; a walk in deg/s is nearly all of them.
_FAST_WINDOWS, _FAST_SHARE = 2, 0.2
# The screen is more than 30 degrees below the horizontal: for 80 % of all windows in none of 193 walks of twelve data
# sets, for 80 % of the first five in one.
_DOWN_COSINE, _DOWN_WINDOWS, _DOWN_SHARE = -0.5, 3, 0.8


@dataclass(frozen=True, eq=False)
class UnitsState:
    """What windows so far had, and the rows of the one that is open."""

    rows: FloatArray  # (R, 4) time, |specific force|, its z, |angular rate|
    n: int = 0  # windows
    n_wrong_force: int = 0
    n_wrong_rate: int = 0
    n_down: int = 0
    wrong_force: str = ""  # of the first of these, in words
    wrong_rate: str = ""

    @property
    def is_wrong(self) -> bool:
        """Whether no window yet had a specific force that can be right."""
        return 0 < self.n == self.n_wrong_force

    def notes(self) -> tuple[str, ...]:
        """In plain words, empty if nothing is wrong."""
        found: list[str] = []
        if self.n_wrong_force > 0.5 * self.n:
            found.append(f"specific force: {self.wrong_force}")
        if self.n_wrong_rate >= max(_FAST_WINDOWS, _FAST_SHARE * self.n):
            found.append(self.wrong_rate)
        if self.n_down >= max(_DOWN_WINDOWS, _DOWN_SHARE * self.n):
            found.append(
                "the screen seems to face down: if it does not, the specific force has the other sign, as iOS gives "
                "it raw; multiply x, y and z by -1"
            )
        return tuple(found)


def units() -> UnitsState:
    """State before the first row."""
    return UnitsState(np.empty((0, 4)))


def look(state: UnitsState, time_s: FloatArray, motion: FloatArray) -> UnitsState:
    """State after motion (N, 6), specific force and angular rate, at increasing times (N,).

    A window is judged when it is whole, so that the result does not depend on how rows were cut into blocks.
    """
    new = np.empty((len(time_s), 4))
    new[:, 0], new[:, 2] = time_s, motion[:, 2]
    for column, (x, y, z) in ((1, motion[:, :3].T), (3, motion[:, 3:].T)):
        new[:, column] = np.sqrt(x * x + y * y + z * z)
    rows = np.concatenate([state.rows, new])
    times_s, start = rows[:, 0], 0
    while len(rows) - start >= _WINDOW_ROWS and times_s[-1] - times_s[start] >= _WINDOW_S:
        end = max(int(times_s.searchsorted(times_s[start] + _WINDOW_S)) + 1, start + _WINDOW_ROWS)
        state, start = _judged(state, rows[start:end]), end
    return replace_unchecked(state, rows=rows[start:])


def _judged(state: UnitsState, rows: FloatArray) -> UnitsState:
    """State after a whole window."""
    _, force, z, rate = rows.T
    known = rate[np.isfinite(rate)]
    wrong_force = wrong_specific_force(median(force))
    wrong_rate = wrong_angular_rate(median(known)) if len(known) else ""
    down = float(z.sum()) < _DOWN_COSINE * float(force.sum())
    return replace_unchecked(
        state,
        n=state.n + 1,
        n_wrong_force=state.n_wrong_force + bool(wrong_force),
        n_wrong_rate=state.n_wrong_rate + bool(wrong_rate),
        n_down=state.n_down + down,
        wrong_force=state.wrong_force or wrong_force,
        wrong_rate=state.wrong_rate or wrong_rate,
    )
