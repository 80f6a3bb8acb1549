"""Linear interpolation between samples."""

from __future__ import annotations

import numpy as np
import pytest

from pdr_filter.values.interpolation import interpolated_near, interpolated_rows

TIME_S = np.array([2.0, 0.0, 1.0, 5.0])
VALUES = np.array([[20.0, 2.0], [0.0, 0.0], [10.0, 1.0], [50.0, 5.0]])


def test_values_are_linear_between_rows_in_any_order_and_constant_outside() -> None:
    expected = [[0.0, 0.0], [5.0, 0.5], [30.0, 3.0], [50.0, 5.0]]
    np.testing.assert_allclose(interpolated_rows(np.array([-1.0, 0.5, 3.0, 9.0]), TIME_S, VALUES), expected)
    np.testing.assert_allclose(interpolated_rows(0.5, TIME_S, VALUES), [5.0, 0.5])


@pytest.mark.parametrize(("far_s", "near_s"), [(-0.31, -0.29), (2.31, 2.29), (4.69, 4.71), (5.31, 5.29)])
def test_there_is_no_value_where_the_nearest_row_is_too_far_away(far_s: float, near_s: float) -> None:
    found = interpolated_near(np.array([far_s, near_s]), TIME_S, VALUES, 0.3)
    assert np.isnan(found[0]).all()
    assert np.isfinite(found[1]).all()


def test_without_rows_all_values_are_unknown() -> None:
    assert np.isnan(interpolated_near(np.array([1.0]), np.empty(0), np.empty((0, 3)), 0.3)).all()
