"""Checks of all readers. Implausible data, such as in a wrong unit, are refused and never corrected."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from pdr_filter.data.io.column_names import PHONE_HEADING, PHONE_STEPS
from pdr_filter.data.io.describe import DELIVERED_ENOUGH, describe_stream, median_norm
from pdr_filter.data.io.text_table import finite
from pdr_filter.values import BoolArray, FloatArray, Samples, limits
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.plausibility import wrong_angular_rate, wrong_rate, wrong_specific_force
from pdr_filter.values.quaternions import rotation_matrix

_MOST_STEPS_PER_S = 5.0  # sprinters take 4 to 5; what grows faster numbers rows
_CLOCK_CHANGE_S = 3600.0  # gap in local times that change to daylight saving time
_TURN_RAD = 2 * math.pi + 1e-9
NO_OVERLAP = "its times do not overlap those of the accelerometer"


def checked_streams(
    found: Mapping[str, tuple[FloatArray, FloatArray]],
    zero_s: float,
    suffix: str,
    where: str,
    notes: list[str],
    is_unit_declared: bool = False,
) -> dict[str, Samples]:
    """Return the streams without rows of unknown time, after checks that their values are plausible.

    `found` has times (N,) and values (N, d) by name. `zero_s` becomes time zero. The result has the accelerometer
    first. What is left out, and repeated or backward times, are added to `notes`. Notes and errors name a stream by its
    name and `suffix`. RecordingError for an implausible stream. A low sampling rate, which another unit of time would
    explain, is accepted if `is_unit_declared`: the file states the unit.
    """
    streams: dict[str, Samples] = {}
    for name in sorted(found, key=lambda name: name != "accelerometer"):
        label = name + suffix
        time_s, values = finite(found[name][0], f"{label} times", notes), finite(found[name][1], label, notes)
        known = with_time(time_s, label, notes)
        samples = Samples(time_s[known] - zero_s, values if known.all() else values[known])
        if name == "accelerometer":
            _check_rows(samples, f"{where}: {label}")
            if still := constant_axis(samples.values):
                notes.append(f"{label}: {still}; record all three axes, because gravity and steps are wrong without it")
            _check_times(samples, f"{where}: {label}", is_unit_declared)
            _refuse(wrong_specific_force(median_norm(samples.values)), f"{where}: {label}")
        elif np.isnan(samples.values).all():  # also true of no rows
            notes.append(f"{label}: no values, left out")
            continue
        streams[name] = samples
    if "gyroscope" in streams:
        _refuse(wrong_angular_rate(median_norm(streams["gyroscope"].values)), f"{where}: gyroscope{suffix}")
    notes += _time_notes(streams, suffix)
    return streams


def constant_axis(values: FloatArray) -> str:
    """Return words about the axis of an accelerometer that alone has one value in all rows, or ""."""
    low, high = np.fmin.reduce(values, axis=0, initial=np.inf), np.fmax.reduce(values, axis=0, initial=-np.inf)
    still = np.flatnonzero(low == high).tolist()
    return f"{'xyz'[still[0]]} is {low[still[0]]:g} in all rows" if len(still) == 1 else ""


def is_of_phone(name: str, time_s: FloatArray, values: FloatArray, duration_s: float) -> bool:
    """Return False for a stream of the phone's own steps or headings that holds something else.

    Headings exceed no full turn, and counts of steps grow, but not faster than steps. `duration_s` is that of the
    recording. Any other stream is True.
    """
    if name not in (PHONE_HEADING, PHONE_STEPS):
        return True
    known = values[np.isfinite(time_s) & np.isfinite(values).all(axis=1), 0] if len(values) else np.empty(0)
    if name == PHONE_HEADING:
        return bool((np.abs(known) <= _TURN_RAD).all())
    most = min(_MOST_STEPS_PER_S * duration_s, limits.LARGEST_VALUE)
    grows = bool((np.diff(known) >= 0).all())
    return len(known) == 0 or (grows and known[0] >= 0 and known[-1] <= known[0] + most)


def with_time(time_s: FloatArray, where: str, notes: list[str]) -> BoolArray:
    """Return a mask of the rows with a known time, and add a note about rows of unknown time."""
    known = ~np.isnan(time_s)
    if not known.all():
        notes.append(f"{where}: {int((~known).sum())} rows without a time left out")
    return known


def up_cosine(accelerometer: Samples, attitude: Samples) -> float:
    """Return the mean cosine between up and the specific force in the world of the phone's own attitude.

    It is near 1 if the sign of the accelerometer and the sense of the quaternion are right, and NaN if unknown.
    """
    known = ~np.isnan(attitude.values).any(axis=1)
    if known.sum() < 2:
        return math.nan
    order = np.argsort(attitude.time_s[known], kind="stable")
    at_s, quaternion = attitude.time_s[known][order], attitude.values[known][order]
    index = np.minimum(np.searchsorted(at_s, accelerometer.time_s), len(at_s) - 1)
    near = np.abs(at_s[index] - accelerometer.time_s) < 0.3
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        unit = quaternion[index] / np.linalg.norm(quaternion[index], axis=1, keepdims=True)
        up_sensor = rotation_matrix(unit)[:, 2]
        force = accelerometer.values
        cosine = (force * up_sensor).sum(axis=1) / np.sqrt(np.square(force).sum(axis=1))
    cosine = cosine[near & np.isfinite(cosine)]
    return float(cosine.mean()) if len(cosine) else math.nan


def _time_notes(streams: Mapping[str, Samples], suffix: str) -> list[str]:
    """Return notes about streams whose times repeat, go backward, or do not overlap the accelerometer."""
    time_s = streams["accelerometer"].time_s
    notes: list[str] = []
    rate_hz = None
    for name, samples in streams.items():
        if samples.time_s.min() > time_s.max() or samples.time_s.max() < time_s.min():
            notes.append(f"{name}{suffix}: {NO_OVERLAP}")
        stream = describe_stream(name, samples)
        rate_hz = stream.rate_hz if name == "accelerometer" else rate_hz
        if stream.n_duplicates or stream.n_backward:
            notes.append(
                f"{name}{suffix}: {stream.n_duplicates} repeated and {stream.n_backward} backward times, "
                "kept as recorded"
            )
    if rate_hz is not None and rate_hz < DELIVERED_ENOUGH * limits.SUFFICIENT_RATE_HZ:
        notes.append(
            f"accelerometer{suffix}: {rate_hz:.1f} Hz, and step detection was tested from "
            f"{limits.SUFFICIENT_RATE_HZ:g} Hz: steps and step lengths may be wrong; record at 50 Hz or more"
        )
    after_s = np.append(np.diff(time_s), 0.0)
    for at_s in time_s[np.abs(after_s - _CLOCK_CHANGE_S) < limits.GAP_S][:1]:
        notes.append(
            f"accelerometer{suffix}: a gap of an hour after {at_s:.1f} s, as local times have at the change to "
            "daylight saving time; if the app recorded on, write times in UTC"
        )
    return notes


def _check_rows(samples: Samples, where: str) -> None:
    if len(samples) < limits.MIN_SAMPLES:
        raise RecordingError(
            f"{where}: only {len(samples)} samples with a time, and {limits.MIN_SAMPLES} are needed; record for "
            "longer, or write a time in each row"
        )
    known = ~np.isnan(samples.values)
    if columns := ", ".join(np.array(["x", "y", "z"])[~known.any(axis=0)]):
        raise RecordingError(
            f"{where}: no values in column {columns}; record the accelerometer on all three axes, and gravity at the "
            "same times if it is a sensor of its own"
        )
    if not known.all(axis=1).any():
        raise RecordingError(f"{where}: no row has x, y and z together; write the three axes in one row")


def _check_times(samples: Samples, where: str, is_unit_declared: bool) -> None:
    """Raise RecordingError if most times do not increase, or if their rate shows a unit other than seconds."""
    found = describe_stream("accelerometer", samples)
    n_still = found.n_duplicates + found.n_backward
    if 2 * n_still > len(samples) - 1:
        remedy = "sort the rows by time and give each its own time"
        if found.n_duplicates > found.n_backward:  # a clock shown as mm:ss.0, or 1.7E+18
            remedy = (
                "the times may be rounded, as a spreadsheet does when it saves what it shows; take the file as the app "
                "wrote it, or show all digits of the time before you save it"
            )
            is_again = (np.diff(samples.time_s) == 0) & (samples.values[1:] == samples.values[:-1]).all(axis=1)
            if is_again.sum() == found.n_duplicates:
                remedy = "rows are repeated, with the same times and values; keep one of each"
        raise RecordingError(f"{where}: time_s does not increase in {n_still} of {len(samples) - 1} rows; {remedy}")
    _refuse(wrong_rate(found.rate_hz or math.inf, is_unit_declared), where)


def _refuse(wrong: str, where: str) -> None:
    """Raise RecordingError unless `wrong`, a sentence with problem and remedy, is empty."""
    if wrong:
        raise RecordingError(f"{where}: {wrong}")
