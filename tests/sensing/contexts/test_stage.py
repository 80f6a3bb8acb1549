from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pdr_filter.classifiers.context_model import ContextModel
from pdr_filter.classifiers.familiarity import Familiarity
from pdr_filter.classifiers.softmax import SoftmaxRegression
from pdr_filter.recipes.martinelli2018.features import TABLE_II
from pdr_filter.sensing.contexts.context_stage import ContextModels, with_cadence, with_climbs
from pdr_filter.sensing.features.feature_windows import ATTITUDE_FREE, FeatureWindow
from pdr_filter.values import CARRYING_MODES, CONTEXTS, WindowContext
from pdr_filter.values.events import Climb

NAMES = ATTITUDE_FREE.names
USED = NAMES[:3]


def linear(head: str, labels: tuple[str, ...], weights: np.ndarray, **more: Any) -> ContextModel:
    """Model of the first labels, one for each row of weights, with equal priors."""
    prior = np.zeros(len(labels))
    prior[: len(weights)] = 1 / len(weights)
    machine = SoftmaxRegression(weights, np.zeros(len(weights)))
    return ContextModel(
        head, USED, labels[: len(weights)], prior, np.zeros(3), np.ones(3), machine, {}, head=head, **more
    )


CONTEXT = linear("context", CONTEXTS, np.array([[0.0, 0, 0], [4.0, 0, 0]]))  # stationary, walking
CARRYING = linear("carrying_mode", CARRYING_MODES, np.array([[0.0, 0, 0], [0.0, 2.0, 0], [0, 0, 2.0]]))
OTHER = replace(CONTEXT, name="other")
MODELS = ContextModels(CONTEXT, OTHER, CARRYING, CARRYING)


def window(*values: float, time_s: float = 2.0, has_gyroscope: bool = True) -> FeatureWindow:
    features = np.zeros(len(NAMES))
    features[: len(values)] = values
    return FeatureWindow(time_s - 2.0, time_s, NAMES, features, has_gyroscope)


def after(models: ContextModels, windows: list[FeatureWindow]) -> np.ndarray:
    prob = models.init()
    for each in windows:
        prob, _ = models.update(prob, each)
    return prob


def test_without_angular_rate_the_model_trained_without_it_classifies_and_is_named() -> None:
    assert MODELS.update(MODELS.init(), window(1.0))[1].model == "context"
    assert MODELS.update(MODELS.init(), window(1.0, has_gyroscope=False))[1].model == "other"


def test_the_carrying_mode_is_the_forward_filter_of_a_markov_chain() -> None:
    rng = np.random.default_rng(0)
    windows = [window(*rng.normal(size=3)) for _ in range(20)]
    transition = np.full((3, 3), 0.01) + 0.97 * np.eye(3)
    expected = np.full(3, 1 / 3)
    for each in windows:
        moving = CONTEXT.predict(each.features[:3])[1]
        likelihood = CARRYING.predict(each.features[:3])[:3] * 3
        expected = (transition.T @ expected) * likelihood ** (0.5 * moving)
        expected /= expected.sum()
    found = after(MODELS, windows)
    np.testing.assert_allclose(found[:3], expected, atol=1e-12)
    np.testing.assert_array_equal(found[3:], 0.0)  # no model knows these modes


def test_a_window_unlike_the_training_windows_gets_the_prior_of_the_model() -> None:
    guarded = replace(CONTEXT, familiarity=Familiarity(np.eye(3), np.ones(3), limit=2.0))
    models = ContextModels(guarded, guarded, CARRYING, CARRYING)
    known, strange = window(1.0, 1.0, 1.0), window(8.0, 8.0, 8.0)
    for each, unknown in ((known, 0.0), (strange, 1 - (2 / 8) ** 2)):
        context = models.update(models.init(), each)[1]
        assert context.unknown_share == pytest.approx(unknown)
        expected = (1 - unknown) * CONTEXT.predict(each.features[:3]) + unknown * CONTEXT.training_prior
        np.testing.assert_allclose(context.prob, expected)
        assert context.prob.sum() == pytest.approx(1.0)


@pytest.mark.parametrize(("frequency_hz", "most_likely"), [(1.3, "walking"), (1.9, "walking"), (2.7, "running")])
def test_the_step_frequency_changes_only_the_unknown_share_of_the_probabilities(
    frequency_hz: float, most_likely: str
) -> None:
    prior = np.array([0.2, 0.4, 0.1, 0.1, 0.0, 0.2])
    known = np.array([0.0, 0.0, 0.7, 0.3, 0.0, 0.0])
    for unknown in (0.0, 0.4, 1.0):
        before = WindowContext(2.0, (1 - unknown) * known + unknown * prior, prior, unknown_share=unknown)
        prob = with_cadence(before, frequency_hz).prob
        assert prob.sum() == pytest.approx(1.0)
        guess = prob - (1 - unknown) * known
        if unknown == 0.0:
            np.testing.assert_array_equal(prob, before.prob)
        else:
            assert CONTEXTS[guess.argmax()] == most_likely
            assert guess.max() > 0.5 * unknown
            assert guess[CONTEXTS.index("sideways")] == pytest.approx(0.0)


def test_without_a_carrying_model_all_modes_stay_equally_probable() -> None:
    models = ContextModels(CONTEXT, OTHER)
    np.testing.assert_allclose(after(models, [window(3.0, 3.0)] * 3), 0.2)


def test_a_feature_set_without_the_features_of_the_gate_calls_nothing_irregular() -> None:
    names = TABLE_II.names
    model = replace(CONTEXT, feature_names=names[:3])
    models = ContextModels(model, model)
    event = FeatureWindow(0.0, 2.0, names, np.zeros(len(names)), True)
    assert models.update(models.init(), event)[1].irregular_prob == 0.0


def test_a_model_of_the_wrong_head_is_refused() -> None:
    with pytest.raises(ValueError, match="classifies the carrying_mode, not the context"):
        ContextModels(CARRYING, CONTEXT)
    with pytest.raises(ValueError, match="classifies the context, not the carrying_mode"):
        ContextModels(CONTEXT, CONTEXT, CONTEXT)


# The first feature tells upstairs (high) from walking (low), the second where the phone is: texting, or in the pocket.
CLIMBING = linear("context", CONTEXTS, np.array([[-9.0, 0, 0], [-3.0, 0, 0], [3.0, 0, 0], [-9.0, 0, 0]]))
PLACES = linear("carrying_mode", CARRYING_MODES, np.array([[0, -4.0, 0], [0, -9.0, 0], [0, -9.0, 0], [0, 4.0, 0]]))
LIKE_ALL = Familiarity(np.eye(3), np.ones(3), limit=50.0, sharpness=8.0)
GUARDED = replace(CLIMBING, stairs=LIKE_ALL)
POCKET, HAND = 2.0, -2.0


def in_place(model: ContextModel, place: float, first: float = 3.0) -> WindowContext:
    """Classification of the last of some windows that resemble stairs."""
    models, each = ContextModels(model, model, PLACES, PLACES), window(first, place)
    return models.update(after(models, [each] * 10), each)[1]


def test_stairs_are_recognised_with_the_phone_in_a_pocket_and_unknown_elsewhere() -> None:
    assert in_place(GUARDED, POCKET).stairs_unknown_share < 0.1
    assert in_place(GUARDED, HAND).stairs_unknown_share > 0.9
    assert in_place(CLIMBING, HAND).stairs_unknown_share == 0.0  # a model without limits for stairs


def test_a_window_unlike_all_stairs_in_training_is_walking_even_in_a_pocket() -> None:
    far = replace(CLIMBING, stairs=Familiarity(np.eye(3), np.ones(3), limit=0.5, sharpness=8.0))
    context = in_place(far, POCKET)
    assert context.stairs_unknown_share > 0.99
    assert CONTEXTS[context.prob.argmax()] == "walking"


@pytest.mark.parametrize(
    ("rate_mps", "context"), [(0.3, "upstairs"), (-0.3, "downstairs"), (0.0, "walking"), (0.06, "walking")]
)
def test_a_barometer_decides_where_motion_does_not_show_stairs(rate_mps: float, context: str) -> None:
    told = with_climbs([in_place(GUARDED, HAND)], [Climb(2.0, rate_mps, 0.013, 40, 0.0, 0.03)])[0]
    assert CONTEXTS[told.prob.argmax()] == context
    assert told.prob.max() > 0.6
    assert told.prob.sum() == pytest.approx(1.0)


def test_a_barometer_that_shows_level_ground_outvotes_uncertain_stairs() -> None:
    context = in_place(GUARDED, POCKET, first=0.3)
    assert CONTEXTS[context.prob.argmax()] == "upstairs"
    assert CONTEXTS[with_climbs([context], [Climb(2.0, 0.0, 0.013, 40, 0.0, 0.03)])[0].prob.argmax()] == "walking"
    assert with_climbs([context], [None])[0] is context
