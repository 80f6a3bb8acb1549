from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pdr_filter.values import circular_mean, heading_from_yaw, wrap_angle, yaw_from_heading

ANGLES = st.floats(-1e4, 1e4)


@pytest.mark.parametrize(
    ("angle_rad", "wrapped_rad"),
    [(0, 0), (1, 1), (np.pi, -np.pi), (-np.pi, -np.pi), (1.5 * np.pi, -0.5 * np.pi), (-1.5 * np.pi, 0.5 * np.pi)],
)
def test_wrapping_gives_the_known_angle(angle_rad: float, wrapped_rad: float) -> None:
    assert wrap_angle(angle_rad) == pytest.approx(wrapped_rad, abs=1e-15)


@given(ANGLES)
@example(np.nextafter(-np.pi, -4))  # a hair below the interval: rounding must not put it on the open end
@example(np.nextafter(np.pi, 4))
def test_a_wrapped_angle_is_in_the_half_open_interval_and_the_same_direction(angle_rad: float) -> None:
    wrapped = float(wrap_angle(angle_rad))
    assert -np.pi <= wrapped < np.pi
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angle_rad), abs=1e-11)


def test_wrapping_keeps_the_shape_and_does_not_change_its_input() -> None:
    angles = np.linspace(-9, 9, 12).reshape(3, 4)
    before = angles.copy()
    assert wrap_angle(angles).shape == (3, 4)
    np.testing.assert_array_equal(angles, before)


@pytest.mark.parametrize(
    ("yaw_rad", "heading_rad"),
    [(0, np.pi / 2), (np.pi / 2, 0), (-np.pi / 2, -np.pi), (np.pi, -np.pi / 2), (np.pi / 4, np.pi / 4)],
    ids=["east", "north", "south", "west", "north-east"],
)
def test_heading_is_clockwise_from_north_and_yaw_counter_clockwise_from_east(
    yaw_rad: float, heading_rad: float
) -> None:
    assert heading_from_yaw(yaw_rad) == pytest.approx(heading_rad, abs=1e-15)


@given(ANGLES)
def test_yaw_and_heading_point_in_the_same_direction(yaw_rad: float) -> None:
    heading = float(heading_from_yaw(yaw_rad))
    east_north = np.array([np.sin(heading), np.cos(heading)])
    np.testing.assert_allclose(east_north, [np.cos(yaw_rad), np.sin(yaw_rad)], atol=1e-11)


@given(ANGLES)
def test_heading_to_yaw_and_back_is_the_same_direction(heading_rad: float) -> None:
    back = float(heading_from_yaw(yaw_from_heading(heading_rad)))
    assert np.exp(1j * back) == pytest.approx(np.exp(1j * heading_rad), abs=1e-11)


def test_the_mean_of_350_and_10_degrees_is_zero_not_180() -> None:
    assert circular_mean(np.deg2rad([350.0, 10.0])) == pytest.approx(0.0, abs=1e-15)


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=20), st.floats(-3.0, 3.0))
def test_rotating_all_angles_rotates_their_mean(angles_rad: list[float], turn_rad: float) -> None:
    angles = np.array(angles_rad)
    turned = circular_mean(angles + turn_rad)
    assert np.exp(1j * turned) == pytest.approx(np.exp(1j * (circular_mean(angles) + turn_rad)), abs=1e-9)


@pytest.mark.parametrize("unknown_rad", [np.nan, np.inf, -np.inf])
def test_an_unknown_angle_stays_nan_alone_and_in_an_array(unknown_rad: float) -> None:
    with np.errstate(invalid="ignore"):
        assert np.isnan(wrap_angle(unknown_rad))
        np.testing.assert_equal(wrap_angle(np.array([unknown_rad, 1.0])), [np.nan, 1.0])
