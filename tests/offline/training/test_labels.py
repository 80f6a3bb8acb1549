"""Labels and weights of training windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.training.context_training import PLANS, cross_calibrated
from models.training.data_sets import DOUBTFUL, label_of
from pdr_filter.offline.training.cross_validation import LabelledWindows
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import CONTEXTS, table
from pdr_filter.values.recording import Recording


@pytest.fixture(scope="module")
def walk() -> Recording:
    walk = simulate([Leg("walking", distance_m=40.0)], seed=1)
    columns = {"start_s": [0.0], "end_s": [30.0], "context": ["walking"], "carrying_mode": ["pocket"]}
    labels = table({name: np.array(values) for name, values in columns.items()})
    return replace(walk, truth=replace(walk.truth, labels=labels))


def test_a_window_has_the_label_that_contains_it(walk: Recording) -> None:
    assert label_of(walk, 3.0, 5.0) == ("walking", "pocket")
    assert label_of(walk, 29.0, 31.0) is None


def test_doubtful_labels_are_not_used(walk: Recording) -> None:
    for name, from_s in DOUBTFUL.items():
        doubtful = replace(walk, name=name)
        assert label_of(doubtful, max(from_s, 3.0), max(from_s, 3.0) + 2.0) is None
    assert label_of(replace(walk, name="difronzo_user03_exp07"), 3.0, 5.0) == ("walking", "pocket")


def test_only_the_windows_of_the_single_back_pocket_have_weight_five() -> None:
    names = np.array(["tyrex_nodist_backpocket", "tyrex_nodist_frontpocket", "humolire_1f"])
    text = np.array(["walking"] * 3)
    windows = LabelledWindows(np.zeros((3, 2)), text, text, text, text, names, np.ones(3, dtype=bool))
    np.testing.assert_array_equal(PLANS[0].weight(windows), [5.0, 1.0, 1.0])


def test_the_calibration_of_a_held_out_person_does_not_use_that_person() -> None:
    rng = np.random.default_rng(0)
    n = 300
    person = np.repeat(["a", "b", "c"], n // 3)
    label = rng.integers(0, 2, n)
    context = np.array(["walking", "upstairs"])[label]
    right = np.where(person == "c", 0.6, 0.9)  # the third person's predictions are overconfident
    chosen = np.where(rng.random(n) < right, label, 1 - label)
    prob = np.zeros((n, len(CONTEXTS)))
    prob[np.arange(n), 1 + chosen], prob[np.arange(n), 2 - chosen] = 0.97, 0.03

    class Model:
        classes, labels = ("walking", "upstairs"), CONTEXTS

    first = cross_calibrated(prob, context, person, Model())  # type: ignore[arg-type]
    other = np.where(person == "c", np.where(context == "walking", "upstairs", "walking"), context)
    changed = cross_calibrated(prob, other, person, Model())  # type: ignore[arg-type]
    np.testing.assert_array_equal(first[person == "c"], changed[person == "c"])
    assert np.abs(first[person == "a"] - changed[person == "a"]).max() > 0.01
    # calibrated on the third person, the other two are less certain
    assert first[person == "a"].max() < first[person == "c"].max()
