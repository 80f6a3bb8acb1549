"""Detect sensors that are stuck while the phone moves.

An axis of a working sensor never stays exactly constant for a second while a person carries the phone, because noise
alone changes the last digits. The gyroscope is judged while the accelerometer shows motion, and the accelerometer while
the gyroscope shows motion. The magnetometer is judged while the gyroscope shows a turn, because on a straight way the
field may change by less than its resolution. The values of a stuck sensor count as missing until the sensor changes
again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.values import FloatArray, IntArray, read_only, replace_unchecked

# Rows of a window, which is 0.1 to 2.5 s at the rates of phones.
_WINDOW_ROWS = 50
# Shortest constant stretch of a stuck sensor, in s. Sensors that are read more slowly than the accelerometer repeat
# their values, at 5 Hz for 0.2 s. A coarse sensor may be constant while a person stands, so that it is judged only in
# windows with motion.
_DEAD_S, _COARSE_DEAD_S = 1.0, 5.0
# Largest range of an axis that counts as constant: rounding errors only.
_CONSTANT = 1e-9
# Smallest range in a window that shows motion of a carried phone, m/s2 and rad/s: a tenth of the range while strolling.
# Noise at rest is a hundred times smaller.
_MOVING = np.array([1.0, 1.0, 1.0, 0.2, 0.2, 0.2])
# Resolution of a coarse accelerometer, m/s2, and gyroscope, rad/s: a tenth of these ranges. Phones have 0.04 and 0.001.
# Single axes of a coarse sensor may be constant while it moves, so that all axes must be.
_COARSE = (0.1, 0.02)
# Smallest turn in which a magnetometer cannot be constant, rad: the field changes by its horizontal part, which is 10
# uT or more in inhabited places, and phones have a resolution of 0.1 to 0.6 uT.
_TURNED_RAD = 1.0
_NO_TURN_RAD = read_only(np.zeros(3))
_Times = tuple[float, float, float]
_Flags = tuple[bool, bool, bool]
_NEVER_S: _Times = (np.nan, np.nan, np.nan)
_NONE: _Flags = (False, False, False)
# Columns of specific force, angular rate and magnetic field, and of the sensor that shows motion for each.
_AXES, _OTHER_AXES = (slice(0, 3), slice(3, 6), slice(6, 9)), (slice(3, 6), slice(0, 3), slice(3, 6))
_N_COLUMNS, _FIELD = 9, 2
_NO_LOW, _NO_HIGH = read_only(np.full(_N_COLUMNS, np.inf)), read_only(np.full(_N_COLUMNS, -np.inf))


@dataclass(frozen=True, eq=False)
class WatchdogState:
    """Extremes of the open window, and how long each sensor has been constant.

    Triples are of accelerometer, gyroscope and magnetometer.
    """

    n_rows: int  # rows of the open window so far
    low: FloatArray  # (9,) minima of specific force, angular rate and magnetic field in the open window
    high: FloatArray  # (9,) maxima of these in the open window
    last: FloatArray  # (9,) last row
    resolution: FloatArray  # (2,) smallest nonzero change between two rows of accelerometer and gyroscope so far
    turned_rad: FloatArray  # (3,) turn about each axis in the windows with a constant magnetic field, rad
    # Start of the consecutive windows in which the sensor is constant, s. NaN if the last window is not constant.
    still_since_s: _Times = _NEVER_S
    moved: _Flags = _NONE  # True if another sensor showed motion in these windows
    dead: _Flags = _NONE  # True if the sensor is stuck
    start_s: float = np.nan  # time of the first row of the open window, s


def init_watchdog() -> WatchdogState:
    """Return the state of the detection of stuck sensors before the first row."""
    return WatchdogState(0, _NO_LOW, _NO_HIGH, np.full(_N_COLUMNS, np.nan), np.full(2, np.inf), _NO_TURN_RAD)


def remove_stuck_values(
    state: WatchdogState, time_s: FloatArray, values: FloatArray
) -> tuple[WatchdogState, FloatArray]:
    """Return the new state and the values (N, 9) with NaN for those of stuck sensors.

    The columns are specific force, angular rate and magnetic field. The array itself is returned if no sensor is stuck.
    Windows are judged when they are complete, so that the result does not depend on how rows were cut into blocks. The
    values of a stuck sensor are removed from the next window on.
    """
    if len(values) == 0:
        return state, values
    begins = np.arange(-state.n_rows, len(values), _WINDOW_ROWS)
    begins[0] = 0
    low, high = np.minimum.reduceat(values, begins), np.maximum.reduceat(values, begins)
    low[0], high[0] = np.minimum(low[0], state.low), np.maximum(high[0], state.high)
    resolution = _resolutions(state, values, begins)
    n_whole, n_rows = divmod(state.n_rows + len(values), _WINDOW_ROWS)
    result, ends = values, [*begins[1:].tolist(), len(values)]
    is_constant = np.logical_or.reduce(high - low <= _CONSTANT, axis=1).tolist()
    judged, start_s = state, state.start_s
    for k, begin in enumerate(begins.tolist()):
        for axes, is_dead in zip(_AXES, judged.dead, strict=True):
            if is_dead:
                result = result.copy() if result is values else result
                result[begin : ends[k], axes] = np.nan
        start_s = start_s if k == 0 and state.n_rows else float(time_s[begin])
        if k < n_whole and is_constant[k]:
            judged = _state_after_window(judged, low[k], high[k], resolution[k], start_s, float(time_s[ends[k] - 1]))
        elif k < n_whole:
            judged = replace_unchecked(judged, still_since_s=_NEVER_S, moved=_NONE, turned_rad=_NO_TURN_RAD, dead=_NONE)
    open_low, open_high, start_s = (low[-1], high[-1], start_s) if n_rows else (_NO_LOW, _NO_HIGH, np.nan)
    kept = {"last": values[-1].copy(), "resolution": resolution[-1], "start_s": start_s}
    return replace_unchecked(judged, n_rows=n_rows, low=open_low, high=open_high, **kept), result


def _resolutions(state: WatchdogState, values: FloatArray, begins: IntArray) -> FloatArray:
    """Return the resolution (W, 2) of accelerometer and gyroscope at the end of each window."""
    change = np.empty((len(values), 6))
    change[0], change[1:] = values[0, :6] - state.last[:6], values[1:, :6] - values[:-1, :6]
    np.abs(change, out=change)
    np.copyto(change, np.inf, where=~(change > _CONSTANT))
    smallest = np.minimum.reduce(np.minimum.reduceat(change, begins).reshape(-1, 2, 3), axis=2)
    smallest[0] = np.minimum(smallest[0], state.resolution)
    return np.minimum.accumulate(smallest)


def _state_after_window(
    state: WatchdogState, low: FloatArray, high: FloatArray, resolution: FloatArray, start_s: float, end_s: float
) -> WatchdogState:
    """Return the state after a complete window with an axis that is constant.

    `low` and `high` (9,) are the extremes in the window, and `resolution` (2,) is that of accelerometer and gyroscope.
    An axis with missing values is neither constant nor moving.
    """
    change = np.asarray(high - low)
    constant, moving = np.asarray(change <= _CONSTANT), np.asarray(change[:6] > _MOVING)
    turned_rad = state.turned_rad
    since_s, moved, dead = list(_NEVER_S), list(_NONE), list(_NONE)
    for sensor, (axes, other_axes) in enumerate(zip(_AXES, _OTHER_AXES, strict=True)):
        is_field, moves = sensor == _FIELD, bool(np.any(moving[other_axes]))
        is_coarse = not is_field and bool(resolution[sensor] > _COARSE[sensor])  # also if it has never changed
        is_still = np.all(constant[axes]) if is_field or is_coarse else np.any(constant[axes])
        if not is_still or (is_coarse and not moves):
            turned_rad = _NO_TURN_RAD if is_field else turned_rad
            continue
        since_s[sensor] = float(np.fmin(state.still_since_s[sensor], start_s))
        if is_field and moves:  # the middle of the extremes does not depend on how rows were cut into blocks
            turned_rad = turned_rad + 0.5 * (low + high)[other_axes] * (end_s - start_s)
            moves = float(turned_rad @ turned_rad) > _TURNED_RAD**2
        moved[sensor] = state.moved[sensor] or moves
        dead[sensor] = moved[sensor] and end_s - since_s[sensor] >= (_COARSE_DEAD_S if is_coarse else _DEAD_S)
    return replace_unchecked(
        state, still_since_s=tuple(since_s), moved=tuple(moved), turned_rad=turned_rad, dead=tuple(dead)
    )
