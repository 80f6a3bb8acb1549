"""Sensors that stand still while the phone moves: an axis that gives one number for a second is dead, not at rest.

No axis of a sensor that works stays exactly constant for a second while somebody carries it: noise alone moves it by
some units of the last digit. Each of gyroscope and accelerometer is judged while the other moves. What a dead sensor
says counts as missing until it moves again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.values import FloatArray

# Rows that are judged at once: 0.1 to 2.5 s.
_WINDOW_ROWS = 50
# Sensors that are read more slowly than the accelerometer repeat themselves, at 5 Hz for 0.2 s.
_DEAD_S = 1.0
# Constant but for what arithmetic leaves.
_CONSTANT = 1e-9
# Motion of somebody who carries a phone: a tenth of the range of strolling. Noise at rest is a hundred times less.
_MOVING = np.array([1.0, 1.0, 1.0, 0.2, 0.2, 0.2])
_FORCE, _RATE = slice(0, 3), slice(3, 6)


@dataclass(frozen=True, slots=True, eq=False)
class WatchdogState:
    """Extremes of the window so far, and since when a sensor has not moved."""

    n_rows: int  # of the window
    low: FloatArray  # (6,) specific force, angular rate
    high: FloatArray  # (6,)
    still_since_s: FloatArray  # (2,) first row of the windows in which an axis is constant; NaN if none is
    moved: tuple[bool, bool]  # whether the phone moved in these
    dead: tuple[bool, bool] = (False, False)  # accelerometer, gyroscope
    start_s: float = np.nan  # of the window


def watchdog() -> WatchdogState:
    """State before the first row."""
    return WatchdogState(0, np.full(6, np.inf), np.full(6, -np.inf), np.full(2, np.nan), (False, False))


def watch(state: WatchdogState, time_s: FloatArray, motion: FloatArray) -> tuple[WatchdogState, FloatArray]:
    """New state, and motion (N, 6), specific force and angular rate, with NaN where a sensor is dead.

    A window is judged when it is whole, so that the result does not depend on how rows were cut into blocks.
    """
    result, start = motion, 0
    while start < len(motion):
        end = min(start + _WINDOW_ROWS - state.n_rows, len(motion))
        part = motion[start:end]
        if any(state.dead):
            result = result.copy() if result is motion else result
            for sensor, columns in enumerate((_FORCE, _RATE)):
                if state.dead[sensor]:
                    result[start:end, columns] = np.nan
        start_s = float(time_s[start]) if state.n_rows == 0 else state.start_s
        low, high = np.minimum(state.low, part.min(axis=0)), np.maximum(state.high, part.max(axis=0))
        state = WatchdogState(
            state.n_rows + end - start, low, high, state.still_since_s, state.moved, state.dead, start_s
        )
        if state.n_rows == _WINDOW_ROWS:
            state = _judged(state, float(time_s[end - 1]))
        start = end
    return state, result


def _judged(state: WatchdogState, end_s: float) -> WatchdogState:
    """State after a whole window. Where values are missing nothing is constant, and nothing moves."""
    change = state.high - state.low
    constant, moving = change <= _CONSTANT, change > _MOVING
    since_s, moved, dead = state.still_since_s.copy(), list(state.moved), [False, False]
    for sensor, (columns, witnesses) in enumerate(((_FORCE, _RATE), (_RATE, _FORCE))):
        if not constant[columns].any():
            since_s[sensor], moved[sensor] = np.nan, False
            continue
        since_s[sensor] = np.fmin(since_s[sensor], state.start_s)
        moved[sensor] = moved[sensor] or bool(moving[witnesses].any())
        dead[sensor] = moved[sensor] and end_s - since_s[sensor] >= _DEAD_S
    fresh = watchdog()
    return WatchdogState(0, fresh.low, fresh.high, since_s, (moved[0], moved[1]), (dead[0], dead[1]))
