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


def test_the_distance_of_classes_is_that_to_the_nearest_one_about_its_own_mean() -> None:
    rng = np.random.default_rng(2)
    z = np.vstack([rng.normal(size=(3000, 2)) * [0.5, 1.0], rng.normal(size=(3000, 2)) * 0.4 + [6.0, 0.0]])
    label = np.repeat(["a", "b"], 3000)
    fitted = fit_familiarity(z, 1.0, label=label)
    row = np.array([3.5, -0.5])
    expected = []
    for name in ("a", "b"):
        own = z[label == name]
        y = row - own.mean(axis=0)
        expected.append(np.sqrt(y @ np.linalg.inv(np.cov(own.T)) @ y / 2))
    assert fitted.distance(row) == pytest.approx(min(expected), rel=5e-3)
    batch = np.stack([row, z[0], z[-1]])
    np.testing.assert_array_equal(fitted.distance(batch), [fitted.distance(each) for each in batch])


def test_a_window_between_two_classes_is_unfamiliar_only_with_a_group_for_each() -> None:
    rng = np.random.default_rng(3)
    z = np.vstack([rng.normal(size=(500, 2)) * 0.3 - [1, 1], rng.normal(size=(500, 2)) * 0.3 + [1, 1]])
    label = np.repeat(["still", "walking"], 500)
    assert fit_familiarity(z, 1.0).distance(np.zeros(2)) < 0.1
    assert fit_familiarity(z, 1.0, label=label).distance(np.zeros(2)) > 3.0


def test_a_class_whose_features_are_all_narrow_counts_with_the_smallest_variance() -> None:
    z = np.vstack([np.zeros((50, 2)), np.random.default_rng(4).normal(size=(50, 2)) + 5.0])
    fitted = fit_familiarity(z, 1.0, label=np.repeat(["still", "walking"], 50))
    assert fitted.distance(np.array([0.1, 0.0])) == pytest.approx(np.sqrt(0.1**2 / 0.05 / 2))
    narrow = fit_familiarity(0.01 * z, 1.0, label=np.repeat(["still", "walking"], 50))
    assert narrow.distance(np.array([0.1, 0.0])) < np.sqrt(0.1**2 / 0.05 / 2)


def test_windows_are_unlike_from_the_usual_distance_or_else_from_the_limit() -> None:
    rows = np.array([[1.5, 1.5], [0.5, 0.5], [2.5, 2.5]])
    for usual, expected in ((1.0, [True, False, True]), (np.inf, [False, False, True])):
        fitted = Familiarity(np.eye(2), np.ones(2), limit=2.0, usual=usual)
        assert fitted.is_unlike(fitted.distance(rows)).tolist() == expected


def test_arrays_restore_the_familiarity_of_classes() -> None:
    z = np.random.default_rng(5).normal(size=(90, 3))
    fitted = fit_familiarity(z, 1.7, label=np.repeat(["a", "b", "c"], 30), usual=1.2)
    back = Familiarity.from_arrays(fitted.to_arrays())
    np.testing.assert_array_equal(back.distance(z), fitted.distance(z))
    assert (back.limit, back.usual) == (1.7, 1.2)
