"""Stationary probabilities of a Markov chain: closed forms, and the mean of its powers."""

from __future__ import annotations

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.filter.imm.transition_probabilities import stationary_prob
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel


@pytest.mark.parametrize("leave", [0.3, 1e-4, 1e-9, 1e-15])
def test_two_states_have_shares_in_the_ratio_of_their_ways_in(leave: float) -> None:
    """q = (b, a) / (a + b) for the probabilities a and b to leave, however small they are."""
    transition_prob = np.array([[1 - leave, leave], [3 * leave, 1 - 3 * leave]])
    np.testing.assert_allclose(stationary_prob(transition_prob), [0.75, 0.25], rtol=1e-14)


def test_the_model_starts_with_the_stationary_probabilities_of_rare_transitions() -> None:
    transition_prob = np.array([[1 - 1e-4, 1e-4], [9e-4, 1 - 9e-4]])
    modes = pdr.Mode("resting", moves=False), pdr.Mode("level")
    model = PedestrianModel(modes, transition_prob, contexts=("resting", "level"))
    np.testing.assert_allclose(model.long_run_mode_prob, [0.9, 0.1], rtol=1e-12)


def test_a_birth_death_chain_has_its_closed_form() -> None:
    """Detailed balance: q[i + 1] / q[i] = p(i, i + 1) / p(i + 1, i)."""
    up, down = np.array([0.2, 0.05, 0.3, 1e-6]), np.array([0.1, 0.4, 1e-7, 0.2])
    chain = np.diag(up, 1) + np.diag(down, -1)
    chain += np.diag(1 - chain.sum(axis=1))
    expected = np.cumprod([1.0, *(up / down)])
    np.testing.assert_allclose(stationary_prob(chain), expected / expected.sum(), rtol=1e-12)


def test_a_periodic_chain_has_the_shares_of_its_period() -> None:
    ring = np.roll(np.eye(5), 1, axis=1)
    np.testing.assert_allclose(stationary_prob(ring), 0.2, rtol=1e-14)
    star = np.array([[0.0, 0.7, 0.3], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])  # period two
    np.testing.assert_allclose(stationary_prob(star), [0.5, 0.35, 0.15], rtol=1e-14)


def test_closed_classes_are_weighted_by_where_a_uniform_start_ends() -> None:
    """State 0 leads to state 1 with 0.75 and to the pair (2, 3) with 0.25."""
    chain = np.array([[0.2, 0.6, 0.2, 0.0], [0, 1, 0, 0], [0, 0, 0.0, 1.0], [0, 0, 0.5, 0.5]])
    of_pair = 0.5 + 0.25 * 0.25
    expected = [0.0, 0.25 + 0.25 * 0.75, of_pair / 3, of_pair * 2 / 3]
    np.testing.assert_allclose(stationary_prob(chain), expected, rtol=1e-14)
    np.testing.assert_allclose(stationary_prob(np.eye(3)), 1 / 3, rtol=1e-14)
    np.testing.assert_array_equal(stationary_prob(np.ones((1, 1))), [1.0])


def test_any_chain_agrees_with_the_mean_of_its_powers() -> None:
    """An independent way: the mean of p T^k over many k, for sparse random chains of all kinds."""
    rng = np.random.default_rng(5)
    for n in (2, 3, 4, 6):
        for _ in range(20):
            chain = rng.dirichlet(np.ones(n), n) * (rng.random((n, n)) < 0.5) + 0.2 * np.eye(n)[rng.permutation(n)]
            chain /= chain.sum(axis=1, keepdims=True)
            total, power = np.eye(n), chain.copy()
            for _ in range(20):  # sum of 2^20 powers
                total, power = total + total @ power, power @ power
            np.testing.assert_allclose(stationary_prob(chain), (total / 2**20).mean(axis=0), atol=2e-4)
