"""Detect wrong units, missing gravity and a wrong sign of the samples within the first seconds.

The limits are those of the readers (`values.plausibility`), applied to windows. The sign of an accelerometer cannot be
proven from its values: a wrong sign looks like a phone whose screen faces down, which is unusual while a person looks
at the phone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.values import FloatArray, median, replace_unchecked
from pdr_filter.values.plausibility import wrong_angular_rate, wrong_specific_force

# A window is complete when it has both this duration and this number of rows.
_WINDOW_S, _WINDOW_ROWS = 2.0, 100
# Interval in s of which only the first row is used, because more rows only make saved filters larger.
_ROW_S = 0.015
# Smallest number and share of windows with an implausible angular rate that cause a warning. Shaking a phone gives
# single windows above 12 rad/s. A walk in deg/s exceeds the limit in nearly all windows.
_FAST_WINDOWS, _FAST_SHARE = 2, 0.2
# The screen faces down in a window if its normal is more than 30 degrees below the horizontal. A warning needs this
# number and share of windows. Of 193 walks in twelve data sets, none reaches 80 % of all its windows, and one reaches
# 80 % of its first five.
_DOWN_COSINE, _DOWN_WINDOWS, _DOWN_SHARE = -0.5, 3, 0.8


@dataclass(frozen=True, eq=False)
class UnitsState:
    """Counts over all complete windows, and the rows of the open window."""

    # Rows of the open window, shape (R, 4): time, norm of the specific force, its z, norm of the angular rate.
    rows: FloatArray
    last_s: float = -np.inf  # time of the last used row, s
    n: int = 0  # complete windows
    n_wrong_force: int = 0  # windows with an implausible median specific force
    n_wrong_rate: int = 0  # windows with an implausible median angular rate
    n_down: int = 0  # windows in which the screen faces down
    wrong_force: str = ""  # description of the first implausible specific force
    wrong_rate: str = ""  # description of the first implausible angular rate

    @property
    def is_wrong(self) -> bool:
        """True if all windows so far, at least one, have an implausible specific force."""
        return 0 < self.n == self.n_wrong_force

    def notes(self) -> tuple[str, ...]:
        """Return warnings about units and signs, or an empty tuple."""
        found: list[str] = []
        if self.n_wrong_force > 0.5 * self.n:
            found.append(f"specific force: {self.wrong_force}")
        if self.n_wrong_rate >= max(_FAST_WINDOWS, _FAST_SHARE * self.n):
            found.append(self.wrong_rate)
        if self.n_down >= max(_DOWN_WINDOWS, _DOWN_SHARE * self.n):
            found.append(
                f"the screen seems to face down in {self.n_down} of {self.n} windows: if it does not, the specific "
                "force has the wrong sign, as in raw samples of iOS; multiply x, y and z by -1"
            )
        return tuple(found)


def init_units() -> UnitsState:
    """Return the state of the unit check before the first row."""
    return UnitsState(np.empty((0, 4)))


def check_units(state: UnitsState, time_s: FloatArray, motion: FloatArray) -> UnitsState:
    """Return the state of the unit check after rows of motion (N, 6) at increasing times (N,).

    The columns of the motion are specific force and angular rate. Windows are judged when they are complete, so that
    the result does not depend on how rows were cut into blocks.
    """
    is_used = np.diff(np.floor(np.concatenate([[state.last_s], time_s]) / _ROW_S)) > 0
    time_s, motion = time_s[is_used], motion[is_used]
    last_s = float(time_s[-1]) if len(time_s) else state.last_s
    new = np.empty((len(time_s), 4))
    new[:, 0], new[:, 2] = time_s, motion[:, 2]
    squares = motion * motion
    np.sqrt(squares[:, 0::3] + squares[:, 1::3] + squares[:, 2::3], out=new[:, 1::2])
    rows = np.concatenate([state.rows, new])
    times_s, start = rows[:, 0], 0
    while len(rows) - start >= _WINDOW_ROWS and times_s[-1] - times_s[start] >= _WINDOW_S:
        end = max(int(times_s.searchsorted(times_s[start] + _WINDOW_S)) + 1, start + _WINDOW_ROWS)
        state, start = _units_after_window(state, rows[start:end]), end
    return replace_unchecked(state, rows=rows[start:], last_s=last_s)


def _units_after_window(state: UnitsState, rows: FloatArray) -> UnitsState:
    """Return the state of the unit check after the rows (R, 4) of one complete window."""
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
