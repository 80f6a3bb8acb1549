"""Numbers that the recipes ship, against what they stand for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import a_step

from pdr_filter import recipes
from pdr_filter.filter.imm_tracker import ImmTracker
from pdr_filter.sensing.contexts.stage import WindowContext
from pdr_filter.values import CONTEXTS


def length_m(recipe: str, context: str, height_m: float = 1.70) -> float:
    """Length of a step of 1.9 Hz with an ordinary bounce."""
    subject = recipes.Subject(height_m=height_m)
    mode = next(m for m in recipes.RECIPES[recipe](subject).model.modes if m.context == context)
    step = a_step(duration_s=1 / 1.9, variance=3.0)
    step = replace(step, vertical_amplitude_mps2=2.5, usual_amplitude_mps2=2.5)
    return float(mode.step_length.predict(step)[0])


@pytest.mark.parametrize("recipe", recipes.RECIPES)
def test_a_step_on_stairs_is_as_long_as_a_tread(recipe: str) -> None:
    """Treads of public stairs are 0.26 to 0.32 m; downstairs people skip the edge of a landing."""
    assert 0.26 <= length_m(recipe, "upstairs") <= 0.32
    assert 0.26 <= length_m(recipe, "downstairs") <= 0.45
    assert length_m(recipe, "stationary") == 0.0


def test_an_ordinary_step_of_the_default_recipe_is_as_long_as_people_walk() -> None:
    """0.41 of the height at an ordinary cadence, within a tenth; taller people make longer steps."""
    for height_m in (1.55, 1.70, 1.90):
        assert length_m("default", "walking", height_m) == pytest.approx(0.41 * height_m, rel=0.1)


def test_one_window_moves_the_modes_of_the_default_by_its_odds() -> None:
    """p(c | x) / prior(c)^0.4, whole: tempered or with the prior divided out whole it would be another number."""
    model = recipes.default().model
    tracker = ImmTracker(model)
    prob = np.array([0.02, 0.5, 0.3, 0.1, 0.004, 0.076])
    prior = np.array([0.3, 0.4, 0.1, 0.1, 0.0, 0.1])
    state, _ = tracker.on_window(tracker.init(), WindowContext(2.0, prob, prior))
    _, output = tracker.on_step(state, a_step(1.5))
    of_prior = np.where(prior > 0, prior, 1 / 6)
    before = model.long_run_mode_prob @ model.transition_prob
    # a step is seven to one against standing; what the classifier does not know has the floor of one in a hundred
    of_step = np.where(np.array(CONTEXTS) == "stationary", np.exp(-1.9), 1.0)
    expected = before * np.maximum(prob, 0.01) / of_prior**0.4 * of_step
    np.testing.assert_allclose(output.updates[0].mode_prob, expected / expected.sum(), rtol=1e-9)


def test_the_default_transitions_stay_as_long_as_they_say() -> None:
    stay_steps = 1 / (1 - np.diagonal(recipes.context_transitions()))
    expected = {"stationary": 5, "walking": 55, "upstairs": 12, "downstairs": 11, "sideways": 10, "running": 50}
    assert dict(zip(CONTEXTS, stay_steps.round().astype(int).tolist(), strict=True)) == expected
    np.testing.assert_allclose(recipes.context_transitions().sum(axis=1), 1.0)
