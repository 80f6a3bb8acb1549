"""Samples: missing values are NaN, values that are not numbers are refused, and copies are read-only."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.tracking.online import imu_block
from pdr_filter.values import Samples

TIME_S = np.arange(10) / 100
MAKERS: dict[str, Callable[[Any, Any], Any]] = {
    "Samples": lambda time_s, values: Samples(time_s, values).values,
    "push": lambda time_s, values: imu_block(time_s, values).specific_force_mps2,
}


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_masked_values_become_nan(make: Callable[[Any, Any], Any]) -> None:
    values = np.ma.masked_greater(np.tile([1.0, 2.0, 9.8], (10, 1)), 9.0)
    np.testing.assert_array_equal(make(TIME_S, values), np.tile([1.0, 2.0, np.nan], (10, 1)))
    whole_numbers = np.ma.masked_equal(np.tile([1, 2, 3], (10, 1)), 3)
    np.testing.assert_array_equal(make(TIME_S, whole_numbers), np.tile([1.0, 2.0, np.nan], (10, 1)))


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
@pytest.mark.parametrize("unit", ["ns", "ms", "s"])
def test_dates_and_durations_are_refused_with_a_conversion_to_seconds(
    make: Callable[[Any, Any], Any], unit: str
) -> None:
    dates = np.datetime64("2026-01-01", unit) + np.arange(10)
    for times in (dates, dates - dates[0]):
        with pytest.raises(ValueError, match=r"time_s must be numbers, got .*64\[.*\]: give seconds"):
            make(times, np.zeros((10, 3)))


def test_times_of_pressures_and_locations_are_checked_like_those_of_samples() -> None:
    online = pdr.OnlineFilter(pdr.recipes.default().in_world_frame())
    with pytest.raises(ValueError, match="time_s must be numbers, got datetime64"):
        online.push_pressure(np.datetime64("2026-01-01", "ns"), 1000.0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="time_s must be numbers, got datetime64"):
        online.push_location(np.datetime64("2026-01-01", "ns"), 51.0, 0.0, 5.0)  # type: ignore[arg-type]


def test_a_recording_copies_its_meta_data() -> None:
    meta = {"placement": "pocket"}
    recording = pdr.Recording("a", Samples(TIME_S, np.zeros((10, 3))), meta=meta)
    meta["placement"] = "foot"
    assert recording.placement == "pocket"
