"""Consistency metrics: closed forms and Gaussian errors."""

from __future__ import annotations

import numpy as np
import pytest

from pdr_filter.evaluate import consistency


def gaussian(n: int, too_sure: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Errors of random covariances, and the covariances divided by `too_sure`."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(n, 2, 2)) + np.eye(2)
    return np.einsum("nij,nj->ni", root, rng.normal(size=(n, 2))), root @ root.swapaxes(1, 2) / too_sure


def test_an_error_of_one_deviation_along_an_axis_is_one() -> None:
    error, cov = np.array([[2.0, 0.0], [2.0, 3.0]]), np.tile(np.diag([4.0, 9.0]), (2, 1, 1))
    np.testing.assert_allclose(consistency.nees(error, cov), [1.0, 2.0])
    np.testing.assert_array_equal(consistency.nis(error, cov), consistency.nees(error, cov))


def test_it_is_the_quadratic_form_of_the_inverse() -> None:
    error, cov = gaussian(50)
    expected = [e @ np.linalg.inv(P) @ e for e, P in zip(error, cov, strict=True)]
    np.testing.assert_allclose(consistency.nees(error, cov), expected, rtol=1e-7)


def test_errors_of_the_stated_covariance_are_within_the_bounds() -> None:
    error, cov = gaussian(20_000)
    low, high = consistency.mean_bounds(2, len(error), prob=0.999)
    assert low <= consistency.nees(error, cov).mean() <= high
    np.testing.assert_allclose(consistency.ellipse_coverage(error, cov), [0.5, 0.95], atol=0.01)


def test_a_filter_twice_too_sure_is_found_out() -> None:
    error, cov = gaussian(200, too_sure=2.0)
    assert consistency.nees(error, cov).mean() > consistency.mean_bounds(2, len(error))[1]
    assert consistency.ellipse_coverage(error, cov, 0.95) < 0.9


def test_bounds_close_around_the_degrees_of_freedom() -> None:
    assert consistency.mean_bounds(4, 10**7) == pytest.approx((4.0, 4.0), abs=0.01)
    assert consistency.mean_bounds(2, 200) == pytest.approx((1.732, 2.287), abs=0.001)  # 200 chi-square numbers


def test_coverage_has_the_shape_of_the_probabilities() -> None:
    error, cov = gaussian(10)
    assert consistency.ellipse_coverage(error, cov, 0.5).shape == ()
    assert consistency.ellipse_coverage(error, cov, (0.1, 0.5, 0.9)).shape == (3,)


def test_errors_that_are_not_known_count_neither_way() -> None:
    error, cov = gaussian(100)
    unknown = np.vstack([error, np.full((300, 2), np.nan)])
    covs = np.concatenate([cov, np.tile(np.eye(2), (300, 1, 1))])
    np.testing.assert_array_equal(consistency.ellipse_coverage(unknown, covs), consistency.ellipse_coverage(error, cov))
    assert np.isnan(consistency.ellipse_coverage(error[:0], cov[:0])).all()
