# ruff: noqa: N806 - the letters of the equations
from __future__ import annotations

from dataclasses import replace

import numpy as np
from filterpy.kalman import IMMEstimator, KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

import pdr_filter as pdr
from pdr_filter.filter.chain.imm_tracker import ImmTracker
from pdr_filter.filter.imm import filterpy_backend as imm_filterpy
from pdr_filter.filter.imm import imm
from pdr_filter.filter.imm.filterpy_backend import FilterpyImm, MendedIMMEstimator
from pdr_filter.values import PositionFix, mixtures

M = np.array([[0.9, 0.1], [0.3, 0.7]])  # from row to column
PRIOR = np.array([0.9, 0.1])


def estimator(kind: type = MendedIMMEstimator, prob: np.ndarray = PRIOR) -> IMMEstimator:
    """Return two modes in one dimension that differ in their process noise."""
    filters = []
    for q in (0.01, 1.0):
        kalman = KalmanFilter(dim_x=1, dim_z=1)
        kalman.x, kalman.P, kalman.Q, kalman.R = np.zeros(1), np.eye(1), q * np.eye(1), np.eye(1)
        kalman.H = np.eye(1)
        filters.append(kalman)
    return kind(filters, prob.copy(), M)


# --- the four traps: each test would fail with filterpy's own class, and shows that it does --------------------------


def test_the_transition_matrix_is_from_row_to_column() -> None:
    mended = estimator()
    mended.predict()
    np.testing.assert_allclose(mended.mu, PRIOR @ M)
    assert not np.allclose(mended.mu, M @ PRIOR)  # as the documentation of filterpy states


def test_no_measurement_changes_nothing() -> None:
    mended, original = estimator(), estimator(IMMEstimator)
    for imm_ in (mended, original):
        imm_.predict()
        imm_.update(np.array([0.5]))
    np.testing.assert_allclose(mended.mu, original.mu)
    expected = mended.mu @ M
    for imm_ in (mended, original):
        imm_.predict()
        imm_.update(None)
    np.testing.assert_allclose(mended.mu, expected)
    assert not np.allclose(original.mu, expected, atol=1e-3)


def test_two_predictions_in_a_row_are_two_transitions() -> None:
    mended, original = estimator(), estimator(IMMEstimator)
    for imm_ in (mended, original):
        imm_.predict()
        imm_.predict()
    np.testing.assert_allclose(mended.mu, PRIOR @ M @ M)
    np.testing.assert_allclose(original.mu, PRIOR)


def test_evidence_that_underflows_in_every_mode_still_distinguishes_them() -> None:
    mended, original = estimator(), estimator(IMMEstimator)
    for imm_ in (mended, original):
        imm_.predict()
        imm_.update(np.array([100.0]))
    # the mode with the larger noise explains it better by hundreds of natural logarithms
    assert mended.mu[1] > 0.999
    np.testing.assert_allclose(original.mu, PRIOR @ M)


def test_a_mode_that_cannot_be_reached_keeps_its_estimate() -> None:
    mean, cov = np.array([[0.0], [5.0]]), np.array([[[1.0]], [[2.0]]])
    for module in (imm, imm_filterpy):
        mixed_mean, mixed_cov, prob = module.mix(mean, cov, np.array([1.0, 0.0]), np.eye(2))
        np.testing.assert_allclose(mixed_mean, mean)
        np.testing.assert_allclose(mixed_cov, cov)
        np.testing.assert_allclose(prob, [1.0, 0.0])


# --- equal results ----------------------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n_modes=st.integers(1, 6), n=st.integers(1, 4))
def test_every_function_agrees_with_the_numpy_one(seed: int, n_modes: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n_modes, n, n))
    mean, cov = rng.normal(size=(n_modes, n)), root @ root.transpose(0, 2, 1) + 0.1 * np.eye(n)
    prob, transitions = rng.dirichlet(np.ones(n_modes)), rng.dirichlet(np.ones(n_modes), n_modes)
    H, z, R = rng.normal(size=(2, n)), rng.normal(size=2), np.array([[1.0, 0.3], [0.3, 0.5]])
    evidence = 300.0 * rng.normal(size=n_modes)
    for function, arguments in (
        ("mix", (mean, cov, prob, transitions)),
        ("update", (mean, cov, z, H, R)),
        ("combine", (mean, cov, prob)),
    ):
        expected, found = (getattr(module, function)(*arguments) for module in (imm, imm_filterpy))
        for a, b in zip(expected, found, strict=True):
            np.testing.assert_allclose(b, a, atol=1e-9)
    np.testing.assert_allclose(
        imm_filterpy.update_mode_prob(prob, evidence), mixtures.posterior_prob(prob, evidence), atol=1e-12
    )


def test_a_walk_with_fixes_is_the_same_with_the_arithmetic_of_filterpy() -> None:
    walk = pdr.simulate.demo_walk()
    truth = walk.truth.waypoints
    assert truth is not None
    fixes = [
        PositionFix(float(p.time_s), np.array([p.east_m, p.north_m]), 4.0 * np.eye(2), float(p.time_s) + 1.5)
        for p in truth[1:]
    ]
    config = pdr.recipes.default()
    other = replace(config, tracker=ImmTracker(config.model, FilterpyImm()))
    expected, found = (pdr.track(walk, c, fixes=fixes) for c in (config, other))
    for name in ("position_m", "position_cov_m2", "step_length_m", "mode_prob", "walking_heading_rad"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-9)
