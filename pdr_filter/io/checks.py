"""Checks that every reader makes before it hands a recording over: what cannot be right is refused, never mended.

Real files with the wrong unit, sign or clock look healthy; these are the tests that tell them from right ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from pdr_filter.io.describe import describe_stream, median_norm
from pdr_filter.io.errors import RecordingError
from pdr_filter.values.arrays import BoolArray, FloatArray
from pdr_filter.values.samples import Samples

# A window of 0.2 s at the lowest rate below; less cannot hold a step.
MIN_SAMPLES = 10
# Walking has its step at 2 Hz, so less than 5 Hz cannot show it; no phone delivers more than 2000 Hz. The range spans
# less than a factor of 1000, so at most one of ms, us and ns explains a rate outside it.
RATE_RANGE_HZ = (5.0, 2000.0)
TIME_UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
# Median |specific force| of 349 real recordings is 8.6 to 15.5 m/s2 (jogging, phone in the pocket); in g that is 0.9 to
# 1.6. Walking with gravity removed gives about 1 to 4, so the message for small values names both.
SPECIFIC_FORCE_RANGE_MPS2 = (5.0, 25.0)
G_RANGE = (0.8, 1.7)
# Two turns a second as the median; jogging reaches 4.3. The same walk in deg/s gives 20 and more.
MAX_MEDIAN_ANGULAR_RATE_RADPS = 12.0
# Nothing measured is larger; up to here squares and sums of squares stay finite.
LARGEST_VALUE = 1e30
# Mean cosine between the specific force, turned into the world by the phone's own attitude, and up. It is 0.9 and more
# in a walk with the right sign, -0.9 with the wrong one; attitudes that were never aligned with gravity lie between.
UP_COSINE_WRONG_SIGN = -0.5
UP_COSINE_DOUBTFUL = 0.5


def finite(values: FloatArray, file: str, notes: list[str]) -> FloatArray:
    """Values with infinite and absurdly large ones made NaN, in place, with a note."""
    beyond = np.abs(values) > LARGEST_VALUE
    if beyond.any():
        notes.append(f"{file}: {int(beyond.sum())} infinite or absurdly large values taken as unknown")
        values[beyond] = np.nan
    return values


def with_time(time_s: FloatArray, file: str, notes: list[str]) -> BoolArray:
    """Which rows have a time; a note says how many have none."""
    known = ~np.isnan(time_s)
    if not known.all():
        notes.append(f"{file}: {int((~known).sum())} rows without a time left out")
    return known


def check_accelerometer(samples: Samples, where: str) -> None:
    """Refuse too few rows, times that are no seconds, and values that are no specific force in m/s2."""
    _check_rows(samples, where)
    _check_times(samples, where)
    _check_specific_force(median_norm(samples.values), where)


def check_gyroscope(samples: Samples, where: str) -> None:
    """Refuse angular rates that look like deg/s."""
    if (median := median_norm(samples.values)) > MAX_MEDIAN_ANGULAR_RATE_RADPS:
        raise RecordingError(
            f"{where}: median angular rate is {median:.4g}; this looks like deg/s, "
            "multiply x, y and z by pi/180 to get rad/s"
        )


def overlap_notes(streams: Mapping[str, Samples]) -> list[str]:
    """A note for each stream that shares no time with the accelerometer."""
    time_s = streams["accelerometer"].time_s
    first_s, last_s = time_s.min(), time_s.max()
    return [
        f"{name}.csv: its times do not overlap those of the accelerometer"
        for name, samples in streams.items()
        if samples.time_s.min() > last_s or samples.time_s.max() < first_s
    ]


def up_cosine(accelerometer: Samples, attitude: Samples) -> float:
    """Mean cosine between up and the specific force in the world of the phone's own attitude; NaN if not known.

    Specific force at rest points up, so this is near 1 if the sign of the accelerometer and the sense of the quaternion
    (sensor to world) are right. The mean over a walk hardly feels the steps.
    """
    known = ~np.isnan(attitude.values).any(axis=1)
    if known.sum() < 2:
        return math.nan
    order = np.argsort(attitude.time_s[known], kind="stable")
    at_s, quaternion = attitude.time_s[known][order], attitude.values[known][order]
    index = np.minimum(np.searchsorted(at_s, accelerometer.time_s), len(at_s) - 1)
    near = np.abs(at_s[index] - accelerometer.time_s) < 0.3
    w, x, y, z = quaternion[index].T
    up_sensor = np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        force = accelerometer.values
        cosine = (force * up_sensor).sum(axis=1) / np.sqrt(np.square(force).sum(axis=1))
    cosine = cosine[near & np.isfinite(cosine)]
    return float(cosine.mean()) if len(cosine) else math.nan


def _check_rows(samples: Samples, where: str) -> None:
    if len(samples) < MIN_SAMPLES:
        raise RecordingError(f"{where}: only {len(samples)} samples with a time; at least {MIN_SAMPLES} are needed")
    empty = np.isnan(samples.values).all(axis=0)
    if empty.any():
        columns = ", ".join(np.array(["x", "y", "z"])[empty])
        raise RecordingError(f"{where}: no values in column {columns}; record the accelerometer on all three axes")
    if not (~np.isnan(samples.values)).all(axis=1).any():
        raise RecordingError(f"{where}: no row has x, y and z together; write the three axes in one row")


def _check_times(samples: Samples, where: str) -> None:
    found = describe_stream("accelerometer", samples)
    still = found.n_duplicates + found.n_backward
    if 2 * still > len(samples) - 1:
        raise RecordingError(
            f"{where}: time_s does not increase in {still} of {len(samples) - 1} rows; "
            "sort the rows by time and give each its own time"
        )
    rate_hz = found.rate_hz or math.inf
    low, high = RATE_RANGE_HZ
    if rate_hz < low:
        fits = [unit for unit, factor in TIME_UNITS.items() if low <= rate_hz * factor <= high]
        remedy = f"they look like {fits[0]}, convert them to seconds" if fits else f"record at {low:g} Hz or more"
        raise RecordingError(f"{where}: time_s gives a rate of {rate_hz:.3g} Hz (median interval); {remedy}")
    if rate_hz > high:
        raise RecordingError(
            f"{where}: time_s gives a rate of {rate_hz:.4g} Hz (median interval), more than {high:g} Hz; "
            "give the times in seconds"
        )


def _check_specific_force(median_mps2: float, where: str) -> None:
    low, high = SPECIFIC_FORCE_RANGE_MPS2
    if low <= median_mps2 <= high:
        return
    remedy = "columns x, y, z must be specific force in m/s2, about 9.81 at rest"
    if G_RANGE[0] <= median_mps2 <= G_RANGE[1]:
        remedy = "this looks like g units; multiply by 9.80665 (if gravity was removed, record without that)"
    elif median_mps2 < low:
        remedy += "; if gravity was removed, record the accelerometer itself"
    raise RecordingError(f"{where}: median |a| is {median_mps2:.4g}; {remedy}")
