"""Consistency of covariances and errors, on walks drawn from the filter's own model and over a long time.

A smaller version of `tests/benchmarks/consistency.py`, whose figures are in docs/benchmarks.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

import numpy as np
import pytest
from scipy.stats import chi2

import pdr_filter as pdr
from pdr_filter.evaluate import mean_bounds
from pdr_filter.filter.chain.imm_tracker import ImmState, ImmTracker
from pdr_filter.filter.chain.weighted_tracker import WeightedState, WeightedTracker
from pdr_filter.filter.pedestrian.pedestrian_state import reckoned_position
from pdr_filter.filter.pedestrian.step_history import TRAIL_STEPS
from pdr_filter.values import CONTEXTS, PositionFix, Step, WindowContext
from tests.benchmarks.consistency import (
    EVEN_PRIOR,
    Errors,
    a_step,
    errors_of_walks,
    own_model,
)

# --- NEES and NIS ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def mixed() -> Errors:
    """200 walks of mixed contexts, 40 steps each, a fix every 20."""
    return errors_of_walks(own_model(), own_model(), 200, 40, check_every=20, fix_every=20)


def test_position_errors_agree_with_their_covariance(mixed: Errors) -> None:
    low, high = mean_bounds(2, 200)
    mean = mixed.position.mean(axis=0)
    assert ((mean >= low) & (mean <= high)).all(), mean


def test_the_nis_of_fixes_is_within_its_bounds(mixed: Errors) -> None:
    low, high = mean_bounds(2, mixed.fixes.size)
    assert low <= mixed.fixes.mean() <= high
    assert mixed.rejected <= 0.005 * mixed.fixes.size


def test_the_whole_state_is_nearly_consistent(mixed: Errors) -> None:
    """The approximations of the IMM and of the linear scale add up to a tenth (docs/benchmarks.md)."""
    low, high = mean_bounds(4, 200)
    mean = mixed.state.mean(axis=0)
    assert (mean >= low).all()
    assert (mean <= 1.1 * high).all(), mean


def test_ellipses_contain_their_nominal_share_of_the_positions(mixed: Errors) -> None:
    for prob, allowed in ((0.5, 0.06), (0.95, 0.03)):
        assert (mixed.position < chi2.ppf(prob, 2)).mean() == pytest.approx(prob, abs=allowed)


# --- a long time ----------------------------------------------------------------------------------------------------


def day(n_steps: int, day_s: float) -> Iterator[Step | WindowContext | PositionFix]:
    """Bouts of about 100 steps with rest between, a window every second, and a good fix now and then.

    The person is where the fixes say: steps lead in a circle, so that a fix may always be near the start.
    """
    rng, fix_every_s = np.random.default_rng(0), 600.0
    step_s, bout = 0.52, 100
    rest_s = max(day_s / (n_steps / bout) - bout * step_s, 5.0)
    sure = {c: np.where(np.arange(len(CONTEXTS)) == i, 0.9, 0.02) for i, c in enumerate(CONTEXTS)}
    clock_s, window_s, fix_s, made = 0.0, 1.0, fix_every_s, 0

    def until(end_s: float, context: str) -> Iterator[WindowContext]:
        nonlocal window_s
        while window_s <= end_s:
            yield WindowContext(window_s, sure[context], EVEN_PRIOR)
            window_s += 1.0

    while made < n_steps:
        context = str(rng.choice(["walking", "walking", "walking", "upstairs", "downstairs", "running"]))
        for k in range(min(bout, n_steps - made)):
            clock_s += step_s
            yield from until(clock_s, context)
            # twice around in a bout: the bout ends where it began
            yield a_step(k, clock_s, rng, 1 / step_s, 4 * np.pi * k / bout)
            made += 1
        if clock_s >= fix_s:
            yield PositionFix(clock_s, rng.normal(scale=3.0, size=2), 100.0 * np.eye(2))
            fix_s = clock_s + fix_every_s
        clock_s += rest_s
        yield from until(clock_s, "stationary")


def sizes(state: ImmState | WeightedState) -> tuple[int, int, int, int]:
    """Numbers in all arrays of the state, windows, rows of the trail, waiting steps."""
    estimates, trail = state.pedestrian.estimates, state.pedestrian.steps.trail
    of_pedestrian = trail.size + sum(getattr(estimates, f.name).size for f in fields(estimates))
    of_windows = sum(w.prob.size + w.training_prior.size + w.carrying_prob.size for w in state.windows)
    waiting = state.pending if isinstance(state, WeightedState) else ()
    return of_pedestrian + of_windows, len(state.windows), len(trail), len(waiting)


def run_day(
    tracker: ImmTracker | WeightedTracker, n_steps: int, day_s: float
) -> tuple[ImmState | WeightedState, list[tuple[int, int, int, int]]]:
    """The state at the end, and the sizes at every twentieth step."""
    state, found = tracker.init(), []
    for event in day(n_steps, day_s):
        if isinstance(event, PositionFix):
            state = tracker.on_fix(state, event)[0]
        elif isinstance(event, WindowContext):
            state, _ = tracker.on_window(state, event)
        else:
            state, _ = tracker.on_step(state, event)
            if state.pedestrian.steps.n_final % 20 == 0:
                found.append(sizes(state))
    return state, found


@pytest.mark.parametrize("weighting", ["imm", "wc"])
def test_hours_of_walking_and_rest_do_not_enlarge_the_state(weighting: str) -> None:
    """No array of the state grows, so that neither memory nor time of a step grows."""
    n_steps = 1700
    tracker = pdr.recipes.default().with_weighting(weighting).tracker
    state, found = run_day(tracker, n_steps, 86_400.0 * n_steps / 60_000)
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
