"""Covariance of the errors of position fixes: valid for any mixture, exact in the closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from pdr_filter.values import PositionFix, error_correlation, error_given_before, repeated_cov_m2
from pdr_filter.values.fix_error_correlation import INDEPENDENT_SHARE


@pytest.mark.parametrize("seed", range(20))
def test_the_correlation_of_any_mixture_of_fixes_is_positive_definite(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(50):
        n = int(rng.integers(2, 25))
        time_s = rng.choice([0.0, 1.0, 1.0, 2.5, 7.0, 60.0], n) * rng.choice([1e-3, 1.0, 100.0])
        correlation_s = rng.choice([0.0, 1e-9, 5.0, 12.0, 20.0, 300.0, 1e9], n)
        var_m2 = rng.choice([1e-6, 1.0, 9.0, 25.0, 1e6], n)
        found = error_correlation(time_s, correlation_s, var_m2)
        np.testing.assert_array_equal(np.diag(found), np.ones(n))
        np.testing.assert_allclose(found, found.T, rtol=1e-12)
        assert np.linalg.eigvalsh(found).min() > 0.9 * INDEPENDENT_SHARE


def test_fixes_of_one_source_have_an_exponential_correlation() -> None:
    time_s = np.array([0.0, 3.0, 40.0])
    found = error_correlation(time_s, np.full(3, 20.0), np.full(3, 9.0))
    expected = (1.0 - INDEPENDENT_SHARE) * np.exp(-np.abs(time_s[:, None] - time_s) / 20.0)
    np.fill_diagonal(expected, 1.0)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_independent_fixes_are_uncorrelated_and_others_share_at_most_the_variance_of_the_better_fix() -> None:
    found = error_correlation(np.zeros(3), np.array([0.0, 20.0, 20.0]), np.array([4.0, 4.0, 16.0]))
    assert found[0, 1] == found[0, 2] == 0.0
    assert found[1, 2] * 2.0 * 4.0 == pytest.approx((1.0 - INDEPENDENT_SHARE) * 4.0)


def fixes_of(times: list[float], correlation_s: list[float], covs: list[np.ndarray]) -> list[PositionFix]:
    rows = zip(times, correlation_s, covs, strict=True)
    return [PositionFix(t, np.zeros(2), cov, correlation_s=c) for t, c, cov in rows]


def test_the_innovation_of_an_error_is_uncorrelated_with_earlier_errors() -> None:
    """The conditional covariances of three fixes give a valid joint one, and each fix keeps its own covariance."""
    covs = [np.array([[9.0, 2.0], [2.0, 4.0]]), np.diag([1.0, 25.0]), 6.0 * np.eye(2)]
    fixes = fixes_of([0.0, 4.0, 4.0], [20.0, 12.0, 20.0], covs)
    joint = np.zeros((6, 6))
    for k, fix in enumerate(fixes):
        by_error, own = error_given_before(fix, fixes[:k])
        from_before, here, past = np.hstack([np.zeros((2, 0)), *by_error]), slice(2 * k, 2 * k + 2), slice(2 * k)
        joint[here, past] = from_before @ joint[past, past]
        joint[past, here] = joint[here, past].T
        joint[here, here] = joint[here, past] @ from_before.T + own
    assert np.linalg.eigvalsh(joint).min() > 0.0
    for k, cov in enumerate(covs):
        np.testing.assert_allclose(joint[2 * k : 2 * k + 2, 2 * k : 2 * k + 2], cov, atol=1e-9)
    correlation = error_correlation(np.array([0.0, 4.0, 4.0]), np.array([20.0, 12.0, 20.0]), np.array([6.5, 13.0, 6.0]))
    # between the first and the last: r S_1 S_3
    assert joint[0, 4] + joint[1, 5] == pytest.approx(correlation[0, 2] * np.sqrt(6.0) * np.trace(root(covs[0])))


def root(cov: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(cov)
    return (vectors * np.sqrt(values)) @ vectors.T


def test_repeated_fixes_have_the_weight_of_one_and_slow_fixes_have_the_hyperbolic_cotangent() -> None:
    fixes = fixes_of([0.0] * 9, [20.0] * 9, [9.0 * np.eye(2)] * 9)
    information = sum(1.0 / repeated_cov_m2(fix, fixes[:k])[0, 0] for k, fix in enumerate(fixes))
    assert 1.0 / information == pytest.approx(9.0, rel=0.02)
    apart = fixes_of([0.0, 30.0], [20.0] * 2, [9.0 * np.eye(2)] * 2)
    assert repeated_cov_m2(apart[1], apart[:1])[0, 0] == pytest.approx(9.0 / np.tanh(0.75), rel=0.01)
