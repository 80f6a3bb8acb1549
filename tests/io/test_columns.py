"""What the name of a column says: quantity, axis and unit."""

from __future__ import annotations

import pytest

from pdr_filter.io.columns import column_of, is_time


@pytest.mark.parametrize(
    ("name", "quantity", "axis", "unit"),
    [
        ("ax_g", "acceleration", "x", "g"),
        ("gz_dps", "gyroscope", "z", "dps"),
        ("acc_y_mps2", "acceleration", "y", "m/s2"),
        ("acc.y.m_s2", "acceleration", "y", "m/s2"),
        ("gyro_x_rad_s", "gyroscope", "x", "rad/s"),
        ("Gyro Y degps", "gyroscope", "y", "deg/s"),
        ("mag_z_uT", "magnetometer", "z", "ut"),
        ("accX", "acceleration", "x", ""),
        ("gFx", "acceleration", "x", "g"),
        ("accelerometer_lsm6ds3_c.x", "acceleration", "x", ""),
        ("gyroscope_uncalibrated_bmi160.z", "gyroscope", "z", ""),
    ],
)
def test_a_unit_behind_the_axis_is_that_of_the_column(name: str, quantity: str, axis: str, unit: str) -> None:
    column = column_of(0, name)
    assert (column.quantity, column.axis, column.unit) == (quantity, axis, unit)


@pytest.mark.parametrize("name", ["ts", "t", "timestamp_ms", "elapsed", "Tiempo (s)", "\u6642\u9593"])
def test_short_names_of_a_time_are_known(name: str) -> None:
    assert is_time(name)
