# ruff: noqa: N803, N806 - the letters of the equations
"""The compiled functions against the NumPy form, which is their reference."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdr_filter import imm

pytest.importorskip("numba")

from pdr_filter import imm_compiled

SEEDS = st.integers(0, 2**32 - 1)
BATCHES = st.sampled_from([(), (1,), (3,), (2, 3), (9,), (0,)])  # fewer and more than a vector has lanes


def random_cov(rng: np.random.Generator, n: int, *leading: int) -> np.ndarray:
    root = rng.normal(size=(*leading, n, n))
    return root @ root.swapaxes(-1, -2) + 0.1 * np.eye(n)


def random_modes(
    rng: np.random.Generator, batch: tuple[int, ...] = (), n_modes: int = 3, n: int = 4
) -> tuple[np.ndarray, ...]:
    """Means, covariances, mode probabilities (some zero), transition matrix (some zero: unreachable modes)."""
    prob, transitions = rng.dirichlet(np.ones(n_modes), batch), rng.dirichlet(np.ones(n_modes), n_modes)
    if rng.random() < 0.5:  # the last mode is impossible, and perhaps not entered
        prob[..., -1] = 0.0
        prob[..., 0] = 1.0 - prob[..., 1:].sum(axis=-1)
        if rng.random() < 0.5:
            transitions[:-1] = np.eye(n_modes)[:-1]
    return rng.normal(size=(*batch, n_modes, n)), random_cov(rng, n, *batch, n_modes), prob, transitions


def assert_same(found: Iterable[np.ndarray], expected: Iterable[np.ndarray]) -> None:
    """Equal to 1e-12 of the largest number: sums are taken in another order."""
    for a, b in zip(found, expected, strict=True):
        assert a.shape == b.shape
        scale = max(1.0, np.abs(b[np.isfinite(b)]).max(initial=0.0))
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12 * scale)


def reference_cycle(mean, cov, prob, transitions, F, Q, z, H, R) -> list[np.ndarray]:
    mean, cov, prob = imm.mix(mean, cov, prob, transitions)
    mean, cov = imm.predict(mean, cov, F, Q)
    mean, cov, log_likelihood, nis = imm.update(mean, cov, z, H, R)
    prob = imm.update_mode_prob(prob, log_likelihood)
    return [mean, cov, prob, *imm.combine(mean, cov, prob), nis]


def cycle_arguments(
    rng: np.random.Generator, batch: tuple[int, ...] = (), n_modes: int = 6, n: int = 4, d: int = 2
) -> list[np.ndarray]:
    modes = random_modes(rng, batch, n_modes, n)
    F, Q = np.eye(n) + 0.3 * rng.normal(size=(n_modes, n, n)), random_cov(rng, n, n_modes)
    return [*modes, F, Q, rng.normal(size=(*batch, d)), rng.normal(size=(d, n)), random_cov(rng, d, *batch)]


# --- equal to the NumPy form ----------------------------------------------------------------------------------------


@settings(max_examples=150, deadline=None)
@given(seed=SEEDS, batch=BATCHES, n_modes=st.integers(1, 6), n=st.integers(1, 6), d=st.integers(1, 3))
def test_every_function_equals_the_one_of_numpy(
    seed: int, batch: tuple[int, ...], n_modes: int, n: int, d: int
) -> None:
    rng = np.random.default_rng(seed)
    mean, cov, prob, transitions = random_modes(rng, batch, n_modes, n)
    F, Q = rng.normal(size=(*batch, n_modes, n, n)), random_cov(rng, n, n_modes)
    z, H, R = rng.normal(size=(*batch, d)), rng.normal(size=(d, n)), random_cov(rng, d, *batch)
    for name, arguments in (
        ("mix", (mean, cov, prob, transitions)),
        ("predict", (mean, cov, F, Q)),
        ("update", (mean, cov, z, H, R)),
        ("combine", (mean, cov, prob)),
    ):
        assert_same(getattr(imm_compiled, name)(*arguments), getattr(imm, name)(*arguments))


@settings(max_examples=150, deadline=None)
@given(
    prior=st.lists(st.sampled_from([0.0, 1e-300, 0.2, 1.0]), min_size=3, max_size=3),
    evidence=st.lists(st.sampled_from([0.0, -3.0, 50.0, -1e4, 1e6, np.nan, np.inf, -np.inf]), min_size=6, max_size=6),
)
def test_evidence_of_every_kind_moves_the_mode_probabilities_as_with_numpy(
    prior: list[float], evidence: list[float]
) -> None:
    prior_, evidence_ = np.array(prior), np.reshape(evidence, (2, 3))
    with np.errstate(invalid="ignore"):
        expected = imm.update_mode_prob(np.tile(prior_, (2, 1)), evidence_)
    np.testing.assert_allclose(imm_compiled.update_mode_prob(prior_, evidence_), expected, rtol=1e-12, atol=0)


@settings(max_examples=100, deadline=None)
@given(
    seed=SEEDS,
    batch=BATCHES,
    sizes=st.sampled_from(
        [(6, 4, 2), (2, 4, 2), (6, 4, 1), (3, 3, 2), (1, 1, 1), (4, 6, 3)]
    ),  # the first is compiled apart
)
def test_the_fused_cycle_equals_the_five_functions_of_numpy(
    seed: int, batch: tuple[int, ...], sizes: tuple[int, int, int]
) -> None:
    arguments = cycle_arguments(np.random.default_rng(seed), batch, *sizes)
    assert_same(imm_compiled.cycle(*arguments), reference_cycle(*arguments))


def test_a_fix_that_is_not_a_number_leaves_the_predicted_probabilities_of_that_pedestrian_alone() -> None:
    arguments = cycle_arguments(np.random.default_rng(3), (3,))
    arguments[6][1] = np.nan
    found = imm_compiled.cycle(*arguments)
    np.testing.assert_allclose(found.mode_prob[1], imm.mix(*arguments[:4])[2][1], atol=1e-15)
    assert_same(found, reference_cycle(*arguments))
    assert np.isfinite(found.mean[[0, 2]]).all()
    assert np.isnan(found.mean[1]).all()


def test_a_fix_so_far_away_that_every_likelihood_underflows_still_tells_the_modes_apart() -> None:
    arguments = cycle_arguments(np.random.default_rng(4))
    arguments[6] = np.array([3e3, -2e3])
    found = imm_compiled.cycle(*arguments)
    assert found.nis.min() > 2000  # exp(-1000) is no number
    assert_same(found, reference_cycle(*arguments))
    assert found.mode_prob.max() > 0.999


def test_a_mode_that_cannot_be_reached_keeps_its_own_estimate() -> None:
    mean, cov, _, _ = random_modes(np.random.default_rng(1))
    M = np.array([[0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.0, 0.0, 1.0]])
    mixed_mean, mixed_cov, predicted = imm_compiled.mix(mean, cov, np.array([0.4, 0.6, 0.0]), M)
    np.testing.assert_array_equal(mixed_mean[2], mean[2])
    np.testing.assert_allclose(mixed_cov[2], cov[2], atol=1e-14)
    assert predicted[2] == 0.0


def test_a_thousand_precise_updates_leave_the_covariance_symmetric_and_positive() -> None:
    rng = np.random.default_rng(0)
    mean, cov = np.zeros((1, 4)), np.diag([1e6, 1e6, 1.0, 1e-4])[None]
    for _ in range(1000):
        mean, cov, _, _ = imm_compiled.update(mean, cov, rng.normal(size=2), rng.normal(size=(2, 4)), 1e-8 * np.eye(2))
        cov = cov + 1e-12 * np.eye(4)
        np.testing.assert_array_equal(cov[0], cov[0].T)
        assert np.linalg.eigvalsh(cov[0]).min() >= 0


# --- what the border between Python and compiled code must keep -------------------------------------------------------


@pytest.mark.parametrize("n_threads", [2, 3, 16])
def test_the_number_of_threads_changes_no_bit(n_threads: int) -> None:
    arguments = cycle_arguments(np.random.default_rng(5), (11,))
    for a, b in zip(imm_compiled.cycle(*arguments, n_threads=n_threads), imm_compiled.cycle(*arguments), strict=True):
        np.testing.assert_array_equal(a, b)


def test_what_pedestrians_share_is_given_once() -> None:
    rng = np.random.default_rng(6)
    mean, cov, prob, transitions, F, Q, _, H, R = cycle_arguments(rng)
    z = rng.normal(size=(5, 2))  # one start, five measurements
    found = imm_compiled.cycle(mean, cov, prob, transitions, F, Q, z, H, R)
    for k in range(5):
        alone = imm_compiled.cycle(mean, cov, prob, transitions, F, Q, z[k], H, R)
        assert_same([array[k] for array in found], alone)


def test_arrays_that_are_read_only_strided_or_of_integers_are_taken() -> None:
    mean, cov, prob, transitions, F, Q, _, _, R = cycle_arguments(np.random.default_rng(7), (4,))
    z, H = np.broadcast_to([1, 2], (4, 2)), np.eye(2, 4, dtype=int)
    expected = reference_cycle(mean, cov, prob, transitions, F, Q, z, H, R)
    prob.flags.writeable = False
    found = imm_compiled.cycle(
        np.asfortranarray(mean), np.repeat(cov, 2, axis=0)[::2], prob, transitions, F, Q, z, H, R
    )
    assert_same(found, expected)


def test_no_function_modifies_its_input_or_returns_it() -> None:
    arguments = cycle_arguments(np.random.default_rng(8), (2,))
    mean, cov, prob, transitions, F, Q, z, H, R = arguments
    copies = [a.copy() for a in arguments]
    results = [
        *imm_compiled.mix(mean, cov, prob, transitions),
        *imm_compiled.predict(mean, cov, F, Q),
        *imm_compiled.update(mean, cov, z, H, R),
        imm_compiled.update_mode_prob(prob, np.full((2, 6), np.nan)),
        *imm_compiled.combine(mean, cov, prob),
        *imm_compiled.cycle(*arguments),
    ]
    for array, copy in zip(arguments, copies, strict=True):
        np.testing.assert_array_equal(array, copy)
        assert array.flags.writeable
        assert not any(np.shares_memory(array, result) for result in results)


@pytest.mark.parametrize(
    ("position", "wrong", "name"),
    [(1, np.ones((6, 4, 3)), "cov"), (3, np.eye(2), "transition_prob"), (7, np.eye(2, 3), "H"), (8, np.eye(3), "R")],
)
def test_a_shape_that_would_read_beyond_an_array_is_refused(position: int, wrong: np.ndarray, name: str) -> None:
    arguments = cycle_arguments(np.random.default_rng(9))
    arguments[position] = wrong
    with pytest.raises(ValueError, match=f"{name} must have the trailing shape"):
        imm_compiled.cycle(*arguments)


def test_batches_that_do_not_fit_each_other_are_refused() -> None:
    arguments = cycle_arguments(np.random.default_rng(10), (4,))
    arguments[6] = np.zeros((3, 2))
    with pytest.raises(ValueError, match="broadcast"):
        imm_compiled.cycle(*arguments)
