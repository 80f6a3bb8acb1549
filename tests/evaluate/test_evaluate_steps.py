"""Step metrics: closed forms, the largest matching of a graph, and the benchmark's own function."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching

from pdr_filter.evaluate import steps


def random_times(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return np.sort(rng.uniform(0, 20, rng.integers(0, 40))), np.sort(rng.uniform(0, 20, rng.integers(0, 40)))


def test_too_many_steps_are_a_positive_error() -> None:
    np.testing.assert_array_equal(steps.count_error_percent([110, 95], [100, 100]), [10.0, -5.0])


def test_one_found_step_matches_one_true_step_only() -> None:
    scores = steps.step_scores(np.array([1.0, 1.1]), np.array([1.05]), 0.25)
    assert (scores.n_true, scores.n_found, scores.n_matched) == (2, 1, 1)


def test_scores_follow_from_the_counts() -> None:
    """3 of 4 found, 1 of 4 false."""
    scores = steps.step_scores(np.array([1.0, 2.0, 3.0, 4.0]), np.array([1.1, 2.1, 3.4, 3.9]), 0.25)
    assert scores.detection_prob == 0.75
    assert scores.miss_prob == 0.25
    assert scores.false_alarm_prob == 0.25
    assert scores.f1 == 0.75
    assert scores.count_error_percent == 0.0


def test_the_tolerance_itself_is_a_match() -> None:
    assert steps.f1_score(np.array([1.0]), np.array([1.25]), 0.25) == 1.0
    assert steps.f1_score(np.array([1.0]), np.array([1.2501]), 0.25) == 0.0


def test_matches_are_as_many_as_the_largest_matching_of_the_graph() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        true_s, found_s = random_times(rng)
        near = np.abs(true_s[:, None] - found_s) <= 0.25
        largest = (maximum_bipartite_matching(csr_matrix(near)) >= 0).sum() if near.size else 0
        pairs = steps.matched_steps(true_s, found_s, 0.25)
        assert len(pairs) == largest
        assert len(set(pairs[:, 0])) == len(set(pairs[:, 1])) == len(pairs)
        assert (np.abs(true_s[pairs[:, 0]] - found_s[pairs[:, 1]]) <= 0.25).all()


def test_true_and_found_change_places_in_false_alarms_and_misses() -> None:
    true_s, found_s = random_times(np.random.default_rng(2))
    there, back = steps.step_scores(true_s, found_s), steps.step_scores(found_s, true_s)
    assert there.false_alarm_prob == back.miss_prob
    assert there.f1 == back.f1


def test_no_steps_at_all_have_no_score() -> None:
    none = steps.step_scores(np.zeros(0), np.zeros(0))
    assert np.isnan([none.f1, none.detection_prob, none.miss_prob, none.false_alarm_prob]).all()
    missed = steps.step_scores(np.array([1.0]), np.zeros(0))
    assert (missed.f1, missed.miss_prob) == (0.0, 1.0)


def test_the_best_offset_undoes_a_shift() -> None:
    true_s = np.arange(1.0, 30.0, 0.53)
    assert steps.best_offset_s(true_s, true_s - 0.2, 0.005) == pytest.approx(0.2)


def test_steps_that_fit_already_are_not_moved() -> None:
    true_s = np.arange(1.0, 30.0, 0.53)
    assert steps.best_offset_s(true_s, true_s) == 0.0
