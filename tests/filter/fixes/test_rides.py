"""Vehicle rides between position fixes, against everything that only looks like one."""

from __future__ import annotations

import numpy as np
import pytest

from pdr_filter.filter.fixes.rides import Rides
from pdr_filter.values import FloatArray, PositionFix

NONE = np.empty(0)
SECONDS = np.arange(0.0, 120.0)


def line(times_s: FloatArray, speed_mps: float) -> list[PositionFix]:
    return [PositionFix(float(t), np.array([speed_mps * t, 0.0]), np.eye(2)) for t in times_s]


def rides(fixes: list[PositionFix], steps_s: FloatArray, windows_s: FloatArray, moves: bool = True) -> list[float]:
    found = Rides.of(fixes, steps_s, windows_s, np.full(len(windows_s), moves)).found
    return [ride.length_m for ride in found if not ride.is_outlier]


@pytest.mark.parametrize("interval_s", [0.3, 1.0, 7.0])
def test_fast_fixes_without_steps_are_one_ride(interval_s: float) -> None:
    (length_m,) = rides(line(np.arange(10.0, 60.0, interval_s), 10.0), NONE, SECONDS)
    assert length_m == pytest.approx(490.0, abs=70.0)


def test_fixes_behind_each_other_by_less_than_a_step_are_no_ride() -> None:
    fixes = [PositionFix(t, np.array([x, 0.0]), np.eye(2)) for t, x in ((5.0, 0.0), (5.3, 7.0), (8.0, 3.0))]
    assert rides(fixes, np.arange(0.0, 10.0, 0.5), SECONDS) == []


def test_a_position_that_is_repeated_before_it_jumps_is_no_ride() -> None:
    fixes = [PositionFix(5.0 + 0.3 * k, np.array([7.0 * (k == 10), 0.0]), np.eye(2)) for k in range(11)]
    assert rides(fixes, np.arange(0.0, 10.0, 0.5), SECONDS) == []


def test_fixes_in_a_gap_of_the_samples_are_no_ride() -> None:
    in_gap = (SECONDS > 20.0) & (SECONDS < 80.0)
    fixes = line(np.arange(5.0, 110.0, 3.0), 3.5)
    steps_s = np.arange(0.0, 110.0, 0.4)
    is_walked = (steps_s <= 20.0) | (steps_s >= 80.0)
    assert rides(fixes, steps_s[is_walked], SECONDS[~in_gap]) == []


def test_a_receiver_that_converges_while_the_phone_lies_still_is_no_ride_and_a_smooth_train_is() -> None:
    times_s = np.arange(1.0, 60.0)
    east_m = 50.0 * np.exp(-times_s / 5.0)
    fixes = [PositionFix(float(t), np.array([x, 0.0]), 0.1 * np.eye(2)) for t, x in zip(times_s, east_m, strict=True)]
    assert rides(fixes, NONE, SECONDS, moves=True) != []
    assert rides(fixes, NONE, SECONDS, moves=False) == []
    assert rides(line(times_s, 10.0), NONE, SECONDS, moves=False) != []
