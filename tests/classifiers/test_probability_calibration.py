from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics import brier_score_loss

from models.training.carrying_training import fit_temperature
from pdr_filter.classifiers.probability_calibration import (
    brier_score,
    fit_calibration,
    reliability_diagram,
    slipped_prob,
    tempered_prob,
)


def calibrated(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities (n, 4) and labels that were drawn from them."""
    rng = np.random.default_rng(seed)
    logit = 2 * rng.normal(size=(n, 4))
    prob = np.exp(logit) / np.exp(logit).sum(axis=1, keepdims=True)
    return prob, (prob.cumsum(axis=1) > rng.random((n, 1))).argmax(axis=1)


@pytest.mark.parametrize("temperature", [0.5, 1.0, 2.5])
def test_the_temperature_that_made_probabilities_overconfident_is_found(temperature: float) -> None:
    prob, label = calibrated(40_000, 1)
    assert fit_temperature(tempered_prob(prob, 1 / temperature), label) == pytest.approx(temperature, rel=0.05)


@given(st.lists(st.floats(1e-6, 1.0), min_size=2, max_size=6), st.floats(0.2, 5.0))
def test_the_temperature_divides_the_logits(weights: list[float], temperature: float) -> None:
    prob = np.array(weights) / np.sum(weights)
    warm = tempered_prob(prob, temperature)
    assert warm.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(np.log(warm / warm[0]), np.log(prob / prob[0]) / temperature, atol=1e-9)


def test_a_probability_of_zero_stays_zero() -> None:
    np.testing.assert_allclose(tempered_prob(np.array([[0.0, 0.2, 0.8]]), 2.0), [[0.0, 1 / 3, 2 / 3]])


def test_a_temperature_of_one_changes_no_bit() -> None:
    prob, _ = calibrated(10)
    assert tempered_prob(prob, 1.0) is prob


def test_calibrated_probabilities_have_no_calibration_error_and_overconfident_ones_do() -> None:
    prob, label = calibrated(40_000)
    assert reliability_diagram(prob, prob.argmax(axis=1) == label).expected_calibration_error < 0.01
    sure = tempered_prob(prob, 0.4)
    assert reliability_diagram(sure, sure.argmax(axis=1) == label).expected_calibration_error > 0.1


def test_the_calibration_error_is_the_mean_gap_between_confidence_and_accuracy() -> None:
    prob = np.array([[0.9, 0.1]] * 4 + [[0.6, 0.4]] * 6)
    correct = np.array([True, True, True, False] + [True] * 3 + [False] * 3)
    diagram = reliability_diagram(prob, correct, n_bins=10)
    np.testing.assert_allclose(diagram.confidence, [0.6, 0.9])
    np.testing.assert_allclose(diagram.accuracy, [0.5, 0.75])
    np.testing.assert_allclose(diagram.share, [0.6, 0.4])
    assert diagram.expected_calibration_error == pytest.approx(0.6 * 0.1 + 0.4 * 0.15)


def test_certainty_falls_into_the_last_bin() -> None:
    diagram = reliability_diagram(np.array([[1.0, 0.0]]), np.array([True]))
    assert diagram.expected_calibration_error == 0.0


def test_the_brier_score_of_two_classes_is_twice_that_of_scikit_learn() -> None:
    rng = np.random.default_rng(0)
    p, label = rng.random(200), rng.integers(0, 2, 200)
    ours = brier_score(np.column_stack([1 - p, p]), label)
    assert ours == pytest.approx(2 * brier_score_loss(label, p))


@pytest.mark.parametrize(("temperature", "slip"), [(1.0, 0.0), (2.0, 0.03), (0.7, 0.1)])
def test_temperature_and_slip_are_found_together(temperature: float, slip: float) -> None:
    prob, label = calibrated(60_000, 2)
    rng = np.random.default_rng(3)
    other = rng.random(len(label)) < slip
    label = np.where(other, rng.integers(0, 4, len(label)), label)
    found = fit_calibration(tempered_prob(prob, 1 / temperature), label)
    assert found[0] == pytest.approx(temperature, rel=0.06)
    assert found[1] == pytest.approx(slip, abs=0.012)


def test_certain_and_correct_probabilities_do_not_change_and_cause_no_warning() -> None:
    label = np.arange(300) % 3
    prob = tempered_prob(np.eye(3)[label] * 0.9 + 0.1 / 3, 0.3)
    with np.errstate(all="raise"):
        temperature, slip = fit_calibration(prob, label)
    assert slip < 1e-3
    assert temperature <= 1.0


def test_a_slip_is_distributed_equally_over_all_classes() -> None:
    np.testing.assert_allclose(slipped_prob(np.array([1.0, 0.0, 0.0, 0.0]), 0.2), [0.85, 0.05, 0.05, 0.05])
    prob = np.array([0.3, 0.7])
    assert slipped_prob(prob, 0.0) is prob
