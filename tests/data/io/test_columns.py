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
        ("lat", "latitude"),
        ("gps_lat", "latitude"),
        ("L\u00e4ngengrad (\u00b0)", "longitude"),
        ("H\u00f6he (m)", "altitude"),
    ],
)
def test_coordinates_are_known_in_other_words(name: str, quantity: str) -> None:
    assert column_of(0, name).quantity == quantity


UNITS = {
    "m/s^2": "m s^-2; m/s²; m·s⁻²; meters per second squared; m/sec^2; metres/second^2",
    "g": "in G's; g's",
    "mg": "mg",
    "rad/s": "rad s^-1; radians/second",
    "deg/s": "deg/sec; degrees per second",
    "°/s": "°/s",
    "ut": "μT; microtesla",
    "hpa": "hPa",
    "ms": "msec",
    "s": "seconds",
}


@pytest.mark.parametrize("unit", UNITS)
def test_units_are_known_however_they_are_spelled(unit: str) -> None:
    assert {normal_unit(written) for written in UNITS[unit].split("; ")} == {unit}


TRIALS = {
    "walk1": "walk1_acc.csv; acc_walk1.csv; walk1Gyro.csv",
    "": "Accelerometer.csv; gyroscope-calibrated.txt",
    "trial_2": "trial 2 - linear acceleration.csv",
    "1": "1.gyro.csv",
    "walk_2": "s01/walk_2_gyr.txt",
    "2024_05_01_10_01": "Gyroscope_2024-05-01_10-01.csv",
}


@pytest.mark.parametrize("trial", TRIALS)
def test_the_trial_of_a_file_is_its_name_without_the_sensor(trial: str) -> None:
    assert {trial_of(name) for name in TRIALS[trial].split("; ")} == {trial}
