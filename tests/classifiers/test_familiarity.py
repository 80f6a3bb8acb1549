from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdr_filter.classifiers.familiarity import Familiarity, fit_familiarity


def correlated(n: int, seed: int = 0) -> np.ndarray:
    """Standardised features (n, 3), the first two nearly alike."""
    rng = np.random.default_rng(seed)
    shared, own = rng.normal(size=(2, n, 1))
    return np.hstack([shared + 0.02 * rng.normal(size=(n, 2)), own]) / [1.0, 1.0, 1.0]


def test_training_windows_have_a_mean_squared_distance_of_one() -> None:
    z = np.random.default_rng(0).normal(size=(5000, 4)) @ np.diag([0.5, 1.0, 1.0, 1.5])
    fitted = fit_familiarity(z, 2.0)
    assert np.mean([fitted.distance(row) ** 2 for row in z]) == pytest.approx(1.0, abs=0.05)


def test_the_distance_is_that_of_mahalanobis_where_no_direction_is_narrow() -> None:
    z = np.random.default_rng(1).normal(size=(4000, 3)) @ np.array([[1.0, 0.5, 0.0], [0.0, 0.8, 0.3], [0.0, 0.0, 1.0]])
    fitted = fit_familiarity(z, 1.0)
    row = np.array([1.0, -2.0, 0.5])
    expected = np.sqrt(row @ np.linalg.inv(np.cov(z.T)) @ row / 3)
    assert fitted.distance(row) == pytest.approx(expected, rel=2e-3)  # axes have three digits


def test_features_that_are_equal_in_training_give_a_large_distance_when_they_differ() -> None:
    fitted = fit_familiarity(correlated(4000), 2.0)
    assert fitted.distance(np.array([1.5, 1.5, 0.0])) < 1.5
    assert fitted.distance(np.array([1.5, -1.5, 0.0])) > 4.0
    assert fitted.unknown_share(np.array([1.5, 1.5, 0.0])) == 0.0
    assert fitted.unknown_share(np.array([1.5, -1.5, 0.0])) > 0.7


def test_the_unknown_share_begins_at_the_limit_and_grows_towards_one() -> None:
    fitted = Familiarity(np.eye(2), np.ones(2), limit=2.0)
    assert fitted.unknown_share(np.array([2.0, 2.0])) == 0.0
    assert fitted.unknown_share(np.array([3.0, 3.0])) == pytest.approx(1 - (2 / 3) ** 2)
    assert fitted.unknown_share(np.array([4.0, 4.0])) == pytest.approx(0.75)


@given(st.lists(st.floats(-1e300, 1e300), min_size=3, max_size=3))
def test_the_share_is_between_zero_and_one_for_any_finite_features(z: list[float]) -> None:
    assert 0.0 <= fit_familiarity(correlated(200), 1.5).unknown_share(np.array(z)) < 1.0


def test_one_broken_feature_counts_as_eight_standard_deviations() -> None:
    fitted = fit_familiarity(np.random.default_rng(0).normal(size=(500, 40)), 2.0)
    broken, far = np.zeros(40), np.zeros(40)
    broken[7], far[7] = 1e12, 8.0
    assert fitted.distance(broken) == fitted.distance(far)


def test_arrays_restore_the_familiarity() -> None:
    fitted = fit_familiarity(correlated(300), 1.7)
    back = Familiarity.from_arrays(fitted.to_arrays())
    row = np.array([0.3, -1.0, 2.0])
    assert back.distance(row) == fitted.distance(row)
    assert back.limit == 1.7


@pytest.mark.parametrize(
    "bad", [dict(limit=0.0), dict(variance=np.ones(3)), dict(variance=np.zeros(2)), dict(axes=np.full((2, 2), np.nan))]
)
def test_invalid_arrays_of_a_familiarity_are_refused(bad: dict[str, object]) -> None:
    good = {"axes": np.eye(2), "variance": np.ones(2), "limit": 1.0}
    with pytest.raises(ValueError, match="must be"):
        Familiarity(**{**good, **bad})  # type: ignore[arg-type]
