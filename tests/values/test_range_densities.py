"""Densities of the residuals of ranges, against numerical integration."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.stats import norm

from pdr_filter.values.fixes import range_log_densities


@pytest.mark.parametrize(("std_m", "track_std_m"), [(0.3, 0.0), (0.3, 2.0), (2.0, 0.5)])
def test_the_densities_of_direct_and_reflected_ranges_integrate_to_their_probabilities(
    std_m: float, track_std_m: float
) -> None:
    var_m2 = std_m**2 + track_std_m**2
    residual_m = np.linspace(-200.0, 20.0 * np.sqrt(var_m2), 400_001)
    of_size = np.full_like(residual_m, var_m2), np.full_like(residual_m, std_m)
    direct, reflected = (np.exp(log) for log in range_log_densities(residual_m, *of_size, reflected_prob=0.2))
    assert trapezoid(direct, residual_m) == pytest.approx(0.8, rel=1e-4)
    # the approximation of the noise of reflected ranges adds at most a third, where the noise exceeds the excess
    assert 0.2 * 0.7 < trapezoid(reflected, residual_m) < 0.2 * 1.34


def test_reflected_ranges_have_an_exponential_excess_with_normal_noise_at_its_begin() -> None:
    excess_m = np.append(np.linspace(0.0, 5.0, 100), [20.0, 30.0])
    log_reflected = range_log_densities(-excess_m, *np.ones((2, 102)), reflected_prob=0.2)[1]
    mean_m = 10.0 / (log_reflected[-2] - log_reflected[-1])
    noise_prob = np.exp(log_reflected + excess_m / mean_m) * mean_m / 0.2
    np.testing.assert_allclose(noise_prob, norm.cdf(excess_m), atol=0.02)
