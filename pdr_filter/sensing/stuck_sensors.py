"""Detect sensors that are stuck while the phone moves.

An axis of a working sensor never stays exactly constant for a second while a person carries the phone, because noise
alone changes the last digits. The gyroscope is judged while the accelerometer shows motion, and the accelerometer while
the gyroscope shows motion. The values of a stuck sensor count as missing until the sensor changes again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.values import BoolArray, FloatArray, read_only

# Rows of a window, which is 0.1 to 2.5 s at the rates of phones.
_WINDOW_ROWS = 50
# Shortest constant stretch of a stuck sensor, in s. Sensors that are read more slowly than the accelerometer repeat
# their values, at 5 Hz for 0.2 s.
_DEAD_S = 1.0
# Largest range of an axis that counts as constant: rounding errors only.
_CONSTANT = 1e-9
# Smallest range in a window that shows motion of a carried phone, m/s2 and rad/s: a tenth of the range while strolling.
# Noise at rest is a hundred times smaller.
_MOVING = np.array([1.0, 1.0, 1.0, 0.2, 0.2, 0.2])
# Columns of specific force and of angular rate.
_AXES = [0, 1, 2], [3, 4, 5]
_NEVER_S = read_only(np.full(2, np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class WatchdogState:
    """Extremes of the open window, and how long each sensor has been constant.

    Pairs are of accelerometer and gyroscope.

    Attributes
    ----------
    n_rows : int
        Rows of the open window so far.
    low : FloatArray
        Minima of specific force and angular rate in the open window, shape (6,).
    high : FloatArray
        Maxima of specific force and angular rate in the open window, shape (6,).
    still_since_s : FloatArray
        Start of the consecutive windows in which an axis of the sensor is constant, shape (2,), s. NaN if the last
        window is not constant.
    moved : tuple of bool
        True if the other sensor showed motion in these windows.
    dead : tuple of bool
        True if the sensor is stuck.
    start_s : float
        Time of the first row of the open window, s.
    """

    n_rows: int
    low: FloatArray
    high: FloatArray
    still_since_s: FloatArray
    moved: tuple[bool, bool]
    dead: tuple[bool, bool] = (False, False)
    start_s: float = np.nan


def init_watchdog() -> WatchdogState:
    """Return the state of the detection of stuck sensors before the first row."""
    return WatchdogState(0, np.full(6, np.inf), np.full(6, -np.inf), np.full(2, np.nan), (False, False))


def remove_stuck_values(
    state: WatchdogState, time_s: FloatArray, motion: FloatArray
) -> tuple[WatchdogState, FloatArray]:
    """Return the new state and the motion (N, 6) with NaN for the values of stuck sensors.

    The columns are specific force and angular rate. The array itself is returned if no sensor is stuck. Windows are
    judged when they are complete, so that the result does not depend on how rows were cut into blocks. The values of a
    stuck sensor are removed from the next window on.
    """
    if len(motion) == 0:
        return state, motion
    begins = np.arange(-state.n_rows, len(motion), _WINDOW_ROWS)
    begins[0] = 0
    low, high = np.minimum.reduceat(motion, begins), np.maximum.reduceat(motion, begins)
    low[0], high[0] = np.minimum(low[0], state.low), np.maximum(high[0], state.high)
    n_whole, n_rows = divmod(state.n_rows + len(motion), _WINDOW_ROWS)
    change = high - low
    constant, moving = np.asarray(change <= _CONSTANT), np.asarray(change > _MOVING)
    is_constant, result, ends = np.asarray(constant.any(axis=1)), motion, [*begins[1:].tolist(), len(motion)]
    since_s, moved, dead, start_s = state.still_since_s, state.moved, state.dead, state.start_s
    for k, begin in enumerate(begins.tolist()):
        missing = [c for axes, is_dead in zip(_AXES, dead, strict=True) if is_dead for c in axes]
        if missing:
            result = result.copy() if result is motion else result
            result[begin : ends[k], missing] = np.nan
        start_s = start_s if k == 0 and state.n_rows else float(time_s[begin])
        if k < n_whole and is_constant[k]:
            end_s = float(time_s[ends[k] - 1])
            since_s, moved, dead = _judged(constant[k], moving[k], since_s, moved, start_s, end_s)
        elif k < n_whole:
            since_s, moved, dead = _NEVER_S, (False, False), (False, False)
    if n_rows == 0:
        fresh = init_watchdog()
        return WatchdogState(0, fresh.low, fresh.high, since_s, moved, dead), result
    return WatchdogState(n_rows, low[-1], high[-1], since_s, moved, dead, start_s), result


def _judged(
    constant: BoolArray,
    moving: BoolArray,
    since_s: FloatArray,
    moved_before: tuple[bool, bool],
    start_s: float,
    end_s: float,
) -> tuple[FloatArray, tuple[bool, bool], tuple[bool, bool]]:
    """Return `still_since_s`, `moved` and `dead` of `WatchdogState` after a complete window.

    Each result is a pair, for the accelerometer and the gyroscope. `constant` and `moving` (6,) tell for each axis,
    three of the specific force and three of the angular rate, whether it was constant or showed motion in the window.
    An axis with missing values is neither. `still_since_s` is the start of the consecutive windows in which an axis of
    the sensor was constant. `moved` is True if the other sensor showed motion in these windows. A sensor is `dead` if
    this lasts for `_DEAD_S`.
    """
    since_s, moved, dead = since_s.copy(), list(moved_before), [False, False]
    for sensor, (columns, other_columns) in enumerate((_AXES, _AXES[::-1])):
        if not constant[columns].any():
            since_s[sensor], moved[sensor] = np.nan, False
            continue
        since_s[sensor] = np.fmin(since_s[sensor], start_s)
        moved[sensor] = moved[sensor] or bool(moving[other_columns].any())
        dead[sensor] = moved[sensor] and bool(end_s - since_s[sensor] >= _DEAD_S)
    return since_s, (moved[0], moved[1]), (dead[0], dead[1])
