"""Consistency of covariances and errors, on walks drawn from the filter's own model and over a long time.

A smaller version of `tests/benchmarks/consistency.py`, whose figures are in docs/benchmarks.md.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

import pdr_filter as pdr
from pdr_filter.filter.pedestrian.pedestrian_state import reckoned_position
from pdr_filter.filter.pedestrian.step_history import TRAIL_STEPS
from tests.benchmarks.consistency import Errors, bounds, errors_of_walks, own_model, run_day

# --- NEES and NIS ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def mixed() -> Errors:
    """200 walks of mixed contexts, 40 steps each, a fix every 20."""
    return errors_of_walks(own_model(), own_model(), 200, 40, check_every=20, fix_every=20)


def test_position_errors_agree_with_their_covariance(mixed: Errors) -> None:
    low, high = bounds(2, 200)
    mean = mixed.position.mean(axis=0)
    assert ((mean >= low) & (mean <= high)).all(), mean


def test_the_nis_of_fixes_is_within_its_bounds(mixed: Errors) -> None:
    low, high = bounds(2, mixed.fixes.size)
    assert low <= mixed.fixes.mean() <= high
    assert mixed.rejected <= 0.005 * mixed.fixes.size


def test_the_whole_state_is_nearly_consistent(mixed: Errors) -> None:
    """The approximations of the IMM and of the linear scale add up to a tenth (docs/benchmarks.md)."""
    low, high = bounds(4, 200)
    mean = mixed.state.mean(axis=0)
    assert (mean >= low).all()
    assert (mean <= 1.1 * high).all(), mean


def test_ellipses_contain_their_nominal_share_of_the_positions(mixed: Errors) -> None:
    for prob, allowed in ((0.5, 0.06), (0.95, 0.03)):
        assert (mixed.position < chi2.ppf(prob, 2)).mean() == pytest.approx(prob, abs=allowed)


# --- a long time ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("weighting", ["imm", "wc"])
def test_hours_of_walking_and_rest_do_not_enlarge_the_state(weighting: str) -> None:
    """No array of the state grows, so that neither memory nor time of a step grows."""
    n_steps = 1700
    tracker = pdr.recipes.default().with_weighting(weighting).tracker
    state, found, _ = run_day(tracker, n_steps, 86_400.0 * n_steps / 60_000)
    sizes = np.array(found)
    fifth = len(sizes) // 5
    first, last = sizes[:fifth].max(axis=0), sizes[-fifth:].max(axis=0)
    assert first[2] == TRAIL_STEPS
    assert (last <= first).all()
    pedestrian, estimates = state.pedestrian, state.pedestrian.estimates
    assert pedestrian.steps.n_final >= n_steps - 3
    assert estimates.prob.sum() == pytest.approx(1.0, abs=1e-12)
    assert np.isfinite(estimates.mean).all()
    cov, tolerance = estimates.cov, 1e-12 * np.abs(estimates.cov).max()
    assert np.isfinite(cov).all()
    np.testing.assert_allclose(cov, cov.swapaxes(-1, -2), rtol=0, atol=tolerance)
    assert np.linalg.eigvalsh(cov).min() >= -tolerance
    position_m, cov_m2 = reckoned_position(pedestrian)
    assert np.isfinite(position_m).all()
    assert np.linalg.eigvalsh(cov_m2).min() > 0
