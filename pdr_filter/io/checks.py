"""Checks that every reader makes: what cannot be right, as of the wrong unit, is refused, never mended."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from pdr_filter.io import limits
from pdr_filter.io.describe import describe_stream, median_norm
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.table import finite
from pdr_filter.values import BoolArray, FloatArray, Samples

TIME_UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}


def checked_streams(
    found: Mapping[str, tuple[FloatArray, FloatArray]],
    zero_s: float,
    suffix: str,
    where: str,
    notes: list[str],
    is_unit_declared: bool = False,
) -> dict[str, Samples]:
    """Streams with known times and values that can be right, the accelerometer first; RecordingError if one cannot.

    `found` holds times (N,) and values (N, d) by the name of the stream, as parsed; `zero_s` becomes time zero. What
    was left out or found odd is added to `notes`, which call a stream by its name and the suffix, as messages do. Where
    the file itself says the unit of its times, a slow rate is believed and no other unit is looked for.
    """
    streams: dict[str, Samples] = {}
    for name in sorted(found, key=lambda name: name != "accelerometer"):
        label = name + suffix
        time_s, values = finite(found[name][0], f"{label} times", notes), finite(found[name][1], label, notes)
        known = with_time(time_s, label, notes)
        samples = Samples(time_s[known] - zero_s, values if known.all() else values[known])
        if name == "accelerometer":
            _check_rows(samples, f"{where}: {label}")
            _check_times(samples, f"{where}: {label}", is_unit_declared)
            _check_specific_force(median_norm(samples.values), f"{where}: {label}")
        elif np.isnan(samples.values).all():  # also true of no rows
            notes.append(f"{label}: no values, left out")
            continue
        streams[name] = samples
    if "gyroscope" in streams:
        _check_angular_rate(median_norm(streams["gyroscope"].values), f"{where}: gyroscope{suffix}")
    notes += _time_notes(streams, suffix)
    return streams


def with_time(time_s: FloatArray, where: str, notes: list[str]) -> BoolArray:
    """Which rows have a time; a note says how many have none."""
    known = ~np.isnan(time_s)
    if not known.all():
        notes.append(f"{where}: {int((~known).sum())} rows without a time left out")
    return known


def up_cosine(accelerometer: Samples, attitude: Samples) -> float:
    """Mean cosine between up and the specific force in the world of the phone's own attitude; NaN if not known.

    It is near 1 if the sign of the accelerometer and the sense of the quaternion (sensor to world) are right.
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


def _time_notes(streams: Mapping[str, Samples], suffix: str) -> list[str]:
    """Notes of streams whose times repeat, go back, or are not those of the accelerometer."""
    time_s = streams["accelerometer"].time_s
    notes: list[str] = []
    for name, samples in streams.items():
        if samples.time_s.min() > time_s.max() or samples.time_s.max() < time_s.min():
            notes.append(f"{name}{suffix}: its times do not overlap those of the accelerometer")
        stream = describe_stream(name, samples)
        if stream.n_duplicates or stream.n_backward:
            notes.append(
                f"{name}{suffix}: {stream.n_duplicates} repeated and {stream.n_backward} backward times, "
                "kept as recorded"
            )
    return notes


def _check_rows(samples: Samples, where: str) -> None:
    if len(samples) < limits.MIN_SAMPLES:
        raise RecordingError(
            f"{where}: only {len(samples)} samples with a time; at least {limits.MIN_SAMPLES} are needed"
        )
    known = ~np.isnan(samples.values)
    if columns := ", ".join(np.array(["x", "y", "z"])[~known.any(axis=0)]):
        raise RecordingError(f"{where}: no values in column {columns}; record the accelerometer on all three axes")
    if not known.all(axis=1).any():
        raise RecordingError(f"{where}: no row has x, y and z together; write the three axes in one row")


def _check_times(samples: Samples, where: str, is_unit_declared: bool) -> None:
    """Refuse times that do not increase, or that are no seconds."""
    found = describe_stream("accelerometer", samples)
    n_still = found.n_duplicates + found.n_backward
    if 2 * n_still > len(samples) - 1:
        raise RecordingError(
            f"{where}: time_s does not increase in {n_still} of {len(samples) - 1} rows; "
            "sort the rows by time and give each its own time"
        )
    rate_hz = found.rate_hz or math.inf
    low, high = limits.RATE_RANGE_HZ
    if rate_hz < low:
        fits = [unit for unit, factor in TIME_UNITS.items() if low <= rate_hz * factor <= high]
        remedy = f"they look like {fits[0]}, convert them to seconds"
        if is_unit_declared or not fits:
            remedy = f"steps cannot be seen in that: record at {low:g} Hz or more, 50 Hz if the app can"
        raise RecordingError(f"{where}: time_s gives a rate of {rate_hz:.3g} Hz (median interval); {remedy}")
    if rate_hz > high:
        raise RecordingError(
            f"{where}: time_s gives a rate of {rate_hz:.4g} Hz (median interval), more than {high:g} Hz; "
            "give the times in seconds"
        )


def _check_specific_force(median_mps2: float, where: str) -> None:
    low, high = limits.SPECIFIC_FORCE_RANGE_MPS2
    if low <= median_mps2 <= high:
        return
    remedy = "columns x, y, z must be specific force in m/s2, about 9.81 at rest"
    if limits.G_RANGE[0] <= median_mps2 <= limits.G_RANGE[1]:
        remedy = "this looks like g units; multiply by 9.80665 (if gravity was removed, record without that)"
    elif median_mps2 < low:
        remedy += "; if gravity was removed, record the accelerometer itself"
    raise RecordingError(f"{where}: median |a| is {median_mps2:.4g}; {remedy}")


def _check_angular_rate(median_radps: float, where: str) -> None:
    if median_radps > limits.MAX_MEDIAN_ANGULAR_RATE_RADPS:
        raise RecordingError(
            f"{where}: median angular rate is {median_radps:.4g}; this looks like deg/s, "
            "multiply x, y and z by pi/180 to get rad/s"
        )
