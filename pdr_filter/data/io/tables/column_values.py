"""Tests on the values of a table: presence of gravity, unit, agreement of sensors."""

from __future__ import annotations

import numpy as np

from pdr_filter.data.io.column_names import TIME_UNITS, is_interval, since_1970
from pdr_filter.values import FloatArray, interpolated_rows, limits

# Walking turns the phone by some ten degrees within a step and back; over this time gravity stays and steps cancel.
WINDOW_S = 2.0
# Values are averaged over this, some steps long, so that what the walk adds to gravity is gone, and directions are
# compared this far apart.
TURN_S = 2.0
# How far gravity must have turned within that, as a root mean square, before its turning says anything; and how well
# both must correlate: below, what turned was the acceleration of the walk and not gravity.
LEAST_TURN_RAD = 0.03
LEAST_CORRELATION = 0.4
LEAST_S = 10.0
_SLOWEST_HZ = 0.1  # of times since 1970; other numbers of their size come less often
# Increments of a clock are this near to their median, except for some after a loss or within a pack of samples.
_NEAR = (0.4, 2.5)
_NEAR_SHARE = 0.8
_LEAST_FALLS = 0.05
_TICKS_LOOKED_AT = 1000


def constant_part(time_s: FloatArray, values: FloatArray) -> float:
    """Return the median norm of the mean vectors of windows of 2 s. For an accelerometer it is the size of gravity.

    Rows with NaN, and windows with few rows, are skipped. NaN if there is no complete row.
    """
    time_s, values = _complete(time_s, values)
    if not len(values):
        return float("nan")
    window = np.floor((time_s - time_s[0]) / WINDOW_S)
    starts = np.flatnonzero(np.diff(window, prepend=np.nan) != 0)
    counts = np.diff(np.append(starts, len(values)))
    means = np.add.reduceat(values, starts, axis=0) / counts[:, None]
    enough = counts >= min(5, counts.max())
    return float(np.median(np.linalg.norm(means[enough], axis=1)))


def turning(time_s: FloatArray, force: FloatArray, rate_time_s: FloatArray, rate: FloatArray) -> float | None:
    """Return the rotation of gravity in the phone divided by the rotation that the gyroscope predicts, or None.

    A direction u that is fixed in the world obeys du/dt = -w x u in the phone, with the angular rate w. The factor is 1
    for w in rad/s with the axes of the accelerometer, whose sign does not matter, pi/180 for deg/s, and near 0 or below
    for other axes. None if the recording does not show it.
    """
    time_s, force = _complete(time_s, force)
    rate_time_s, rate = _complete(rate_time_s, rate)
    if min(len(time_s), len(rate_time_s)) < 10:
        return None
    begin, end = max(time_s.min(), rate_time_s.min()), min(time_s.max(), rate_time_s.max())
    if not LEAST_S < end - begin < 1e6:
        return None
    step_s = 0.02
    grid_s = np.arange(begin, min(end, begin + 600.0), step_s)
    u = _smoothed(interpolated_rows(grid_s, time_s, force), round(TURN_S / step_s))
    w = _smoothed(interpolated_rows(grid_s, rate_time_s, rate), round(TURN_S / step_s))
    norm = np.linalg.norm(u, axis=1, keepdims=True)
    u = u / np.where(norm > 0, norm, 1.0)
    lag = round(TURN_S / step_s)
    turned = u[lag:] - u[:-lag]
    expected = np.cumsum(-np.cross(w, u) * step_s, axis=0)
    expected = expected[lag:] - expected[:-lag]
    angle_rad, expected_rad = (float(np.sqrt((x**2).sum(axis=1).mean())) for x in (turned, expected))
    if angle_rad < LEAST_TURN_RAD or expected_rad == 0.0:
        return None
    correlation = float((turned * expected).sum(axis=1).mean()) / (angle_rad * expected_rad)
    # Both have noise: the ratio of their sizes is pulled to neither side, as a regression would be.
    return np.sign(correlation) * angle_rad / expected_rad if abs(correlation) > LEAST_CORRELATION else None


def time_unit_of_values(ticks: FloatArray) -> str:
    """Return the unit of times whose header states none, or an empty string if none fits.

    Times since 1970, and days of a calendar, show it by their size, others by the usual sampling rates of phones.
    """
    ticks = ticks[~np.isnan(ticks)]
    median = float(np.median(ticks)) if len(ticks) else 0.0
    span = float(ticks.max() - ticks.min()) if len(ticks) else 0.0
    per_tick = (len(ticks) - 1) / span if span > 0 else 0.0
    for unit, s in TIME_UNITS.items():
        if since_1970(median, unit) is not None and per_tick >= _SLOWEST_HZ * s:
            return unit
    low, high = limits.RATE_RANGE_HZ
    # Seconds at a high rate are more probable than minutes.
    return next((unit for unit, s in TIME_UNITS.items() if s <= 1 and low <= per_tick / s <= high), "")


def clocks_in(columns: FloatArray) -> list[int]:
    """Return the indices of those columns (N, d) that increase by nearly equal amounts, the best clock first.

    A column with the unit of a usual sampling rate is better than others, and a count of the rows is the last.
    """
    found: dict[int, tuple[bool, bool]] = {}
    for i, column in enumerate(columns.T):
        steps = np.diff(column[np.isfinite(column)])
        rises = steps[steps > 0]
        if len(rises) < 2 or (steps < 0).any() or len(rises) < len(columns) / 10:
            continue
        low, high = np.median(rises) * np.array(_NEAR)
        if np.mean((rises >= low) & (rises <= high)) >= _NEAR_SHARE:
            found[i] = bool((steps == 1).all()), not time_unit_of_values(column)
    return sorted(found, key=lambda i: found[i])


def are_differences(ticks: FloatArray, name: str) -> bool:
    """Return True for the times between samples, in place of the times of the samples.

    They go up and down without a trend, near one value that is the period of a usual sampling rate. Constant ones may
    also be rounded times of samples, so that `name`, that of the column, decides.
    """
    found = ticks[1:_TICKS_LOOKED_AT]  # the first one may be zero
    found = found[np.isfinite(found)]
    if len(found) < limits.MIN_SAMPLES or not found.min() > 0:
        return False
    steps = np.diff(found)
    if not steps.any():
        if not is_interval(name):
            return False
    elif (steps < 0).mean() < _LEAST_FALLS or _has_trend(found):
        return False
    low, high = np.median(found) * np.array(_NEAR)
    is_near = np.mean((found >= low) & (found <= high)) >= _NEAR_SHARE
    return bool(is_near) and time_unit_of_values(np.cumsum(found)) != ""


def _has_trend(ticks: FloatArray) -> bool:
    """Return True if the median of one half of the numbers is outside the range of the other, as of unsorted times."""
    halves = np.array_split(ticks, 2)
    return any(not b.min() <= np.median(a) <= b.max() for a, b in (halves, halves[::-1]))


def _complete(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the times and values of the rows without NaN."""
    known = ~(np.isnan(values).any(axis=1) | np.isnan(time_s))
    return (time_s, values) if known.all() else (time_s[known], values[known])


def _smoothed(values: FloatArray, n: int) -> FloatArray:
    """Return moving means over n rows of d columns, shape (N - n + 1, d)."""
    sums = np.cumsum(np.vstack([np.zeros_like(values[:1]), values]), axis=0)
    return (sums[n:] - sums[:-n]) / n
