"""Sensors that stand still while the phone moves: an axis that gives one number for a second is dead, not at rest.

No axis of a sensor that works stays exactly constant for a second while somebody carries it: noise alone moves it by
some units of the last digit. Each of gyroscope and accelerometer is judged while the other moves. What a dead sensor
says counts as missing until it moves again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.values import BoolArray, FloatArray, read_only

# Rows that are judged at once: 0.1 to 2.5 s.
_WINDOW_ROWS = 50
# Sensors that are read more slowly than the accelerometer repeat themselves, at 5 Hz for 0.2 s.
_DEAD_S = 1.0
# Constant but for what arithmetic leaves.
_CONSTANT = 1e-9
# Motion of somebody who carries a phone: a tenth of the range of strolling. Noise at rest is a hundred times less.
_MOVING = np.array([1.0, 1.0, 1.0, 0.2, 0.2, 0.2])
# Of specific force and angular rate.
_AXES = [0, 1, 2], [3, 4, 5]
_NEVER_S = read_only(np.full(2, np.nan))


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
    fresh = watchdog()
    if n_rows == 0:
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
    """Since when sensors stand still, whether the phone moved since, and which are dead, after a whole window.

    Where values are missing nothing is constant, and nothing moves.
    """
    since_s, moved, dead = since_s.copy(), list(moved_before), [False, False]
    for sensor, (columns, witnesses) in enumerate((_AXES, _AXES[::-1])):
        if not constant[columns].any():
            since_s[sensor], moved[sensor] = np.nan, False
            continue
        since_s[sensor] = np.fmin(since_s[sensor], start_s)
        moved[sensor] = moved[sensor] or bool(moving[witnesses].any())
        dead[sensor] = moved[sensor] and bool(end_s - since_s[sensor] >= _DEAD_S)
    return since_s, (moved[0], moved[1]), (dead[0], dead[1])
