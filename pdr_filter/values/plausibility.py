"""Checks for implausible sensor values, with the likely cause as text, for readers of files and for streams."""

from __future__ import annotations

import math

from pdr_filter.values import limits

TIME_UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}


def wrong_specific_force(median_mps2: float) -> str:
    """Return the likely error of a median |specific force|, such as its unit, or "" if it is plausible."""
    low, high = limits.SPECIFIC_FORCE_RANGE_MPS2
    if low <= median_mps2 <= high:
        return ""
    remedy = "columns x, y, z must be specific force in m/s2, about 9.81 at rest"
    if limits.G_RANGE[0] <= median_mps2 <= limits.G_RANGE[1]:
        remedy = "this looks like g units; multiply by 9.80665 (if gravity was removed, record it too)"
    elif median_mps2 < low:
        remedy += "; if gravity was removed, record it too, or read a whole file that calls it linear acceleration"
    return f"median |a| is {median_mps2:.4g}; {remedy}"


def wrong_angular_rate(median_radps: float) -> str:
    """Return the likely error of the unit of a median |angular rate|, or an empty string if it is plausible."""
    if not median_radps > limits.MAX_MEDIAN_ANGULAR_RATE_RADPS:
        return ""
    words = f"median angular rate is {median_radps:.4g}; this looks like deg/s, "
    return words + "multiply x, y and z by pi/180 to get rad/s"


def wrong_rate(rate_hz: float, is_unit_declared: bool = False) -> str:
    """Return the likely error of the sampling rate of an accelerometer, or an empty string if it is plausible.

    If the unit of the times is declared, another unit is not considered.
    """
    low, high = limits.RATE_RANGE_HZ
    if low <= rate_hz <= high:
        return ""
    if rate_hz > high:
        return (
            f"time_s gives a rate of {rate_hz:.4g} Hz (median interval), more than {high:g} Hz; "
            "give the times in seconds"
        )
    unit = "" if is_unit_declared else unit_of_rate(rate_hz)
    slow = (
        f"steps cannot be detected below {low:g} Hz: record at {limits.SUFFICIENT_RATE_HZ:g} Hz or more, 50 Hz if the "
        "app can"
    )
    remedy = f"the times look like {unit}, convert them to seconds" if unit else slow
    return f"time_s gives a rate of {rate_hz:.3g} Hz (median interval); {remedy}"


def unit_of_rate(rate_hz: float) -> str:
    """Return the unit of times, such as "milliseconds", that explains a sampling rate that is too low, or ""."""
    low, high = limits.RATE_RANGE_HZ
    fits = [unit for unit, factor in TIME_UNITS.items() if low <= rate_hz * factor <= high]
    return fits[0] if fits and rate_hz < low else ""


def wrong_time(time_s: float) -> str:
    """Return why a time cannot be in seconds, since 1970 or any other time. "" if it can, and for NaN or infinity."""
    if not limits.MAX_EPOCH_S < abs(time_s) < math.inf:
        return ""
    return f"time_s must be in seconds, got {time_s:.6g}; divide milliseconds by 1e3, nanoseconds by 1e9"
