"""What the name of a column says: quantity, axis and unit."""

from __future__ import annotations

import pytest

from pdr_filter.data.io.column_names import column_of, is_time, normal_unit, trial_of


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


@pytest.mark.parametrize(
    ("name", "quantity"),
    [
        *(("totalacc_x", "acceleration"), ("TOTALACCX", "acceleration"), ("normal_acc_z", "acceleration")),
        *(("medial acc x", "acceleration"), ("globalAccX", "acceleration"), ("wristaccx", "acceleration")),
        *(("lacc_x", "linear_acceleration"), ("LACCX", "linear_acceleration"), ("LAccX", "linear_acceleration")),
        *(("acc_without_gravity_x", "linear_acceleration"), ("accelerationIncludingGravityX", "acceleration")),
        *(("spinal_gyro_z", "gyroscope"), ("thermal_mag_x", "magnetometer"), ("linear_ax", "linear_acceleration")),
        *(("flux", ""), ("flight", ""), ("flat", ""), ("lat", "latitude"), ("gps_lat", "latitude")),
        *(("L\u00e4ngengrad (\u00b0)", "longitude"), ("H\u00f6he (m)", "altitude"), ("rotation.alpha", "")),
    ],
)
def test_words_are_compared_as_words(name: str, quantity: str) -> None:
    assert column_of(0, name).quantity == quantity


@pytest.mark.parametrize(
    ("written", "unit"),
    [
        *(
            ("m s^-2", "m/s^2"),
            ("m/s\u00b2", "m/s^2"),
            ("m\u00b7s\u207b\u00b2", "m/s^2"),
            ("in G's", "g"),
            ("g's", "g"),
        ),
        *(("meters per second squared", "m/s^2"), ("m/sec^2", "m/s^2"), ("metres/second^2", "m/s^2"), ("mg", "mg")),
        *(("rad s^-1", "rad/s"), ("radians/second", "rad/s"), ("deg/sec", "deg/s"), ("degrees per second", "deg/s")),
        *(
            ("\u00b0/s", "\u00b0/s"),
            ("\u03bcT", "ut"),
            ("microtesla", "ut"),
            ("hPa", "hpa"),
            ("msec", "ms"),
            ("seconds", "s"),
        ),
    ],
)
def test_units_are_known_however_they_are_spelled(written: str, unit: str) -> None:
    assert normal_unit(written) == unit


@pytest.mark.parametrize(
    ("name", "trial"),
    [
        *(
            ("walk1_acc.csv", "walk1"),
            ("acc_walk1.csv", "walk1"),
            ("walk1Gyro.csv", "walk1"),
            ("Accelerometer.csv", ""),
        ),
        *(("trial 2 - linear acceleration.csv", "trial_2"), ("1.gyro.csv", "1"), ("s01/walk_2_gyr.txt", "walk_2")),
        *(("Gyroscope_2024-05-01_10-01.csv", "2024_05_01_10_01"), ("gyroscope-calibrated.txt", "")),
    ],
)
def test_the_trial_of_a_file_is_its_name_without_the_sensor(name: str, trial: str) -> None:
    assert trial_of(name) == trial
