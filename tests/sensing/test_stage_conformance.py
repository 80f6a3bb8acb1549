"""Step detectors and context stages of all recipes: any blocks, saving, gaps and clocks give the same results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.recipes.zhou2019.steps import ReferenceLineStepDetector
from pdr_filter.sensing.steps.step_detector import BaseStepDetector
from pdr_filter.testing import StageSamples, bits, stage_samples
from pdr_filter.values import Step

SENSING = {name: recipe(recipes.Subject(height_m=1.75)).sensing for name, recipe in recipes.RECIPES.items()}
DETECTORS = {f"steps of {name}": sensing.steps for name, sensing in SENSING.items()}
CONTEXT_STAGES = {f"contexts of {name}": sensing.contexts for name, sensing in SENSING.items() if sensing.contexts}
STAGES: dict[str, Any] = {**DETECTORS, **CONTEXT_STAGES}
HEADINGS = {f"heading of {name}": sensing.heading for name, sensing in SENSING.items() if sensing.heading}
PARTS: dict[str, Any] = {**STAGES, **HEADINGS}
MODELS = {
    f"{mode.name} of {name}": mode.step_length.model
    for name, recipe in recipes.RECIPES.items()
    for mode in recipe(recipes.Subject(height_m=1.75)).model.modes
}
N = 1800


def walk(seed: int) -> StageSamples:
    return stage_samples(100.0, seed)


def run(stage: Any, pieces: Sequence[StageSamples], state: Any = None) -> tuple[Any, list[tuple[int, Any]]]:
    """New state, and steps or windows with the sample that revealed each."""
    state, found = stage.init() if state is None else state, []
    for piece in pieces:
        contexts = (piece.contexts,) if isinstance(stage, BaseStepDetector) else ()
        state, new = stage.update(state, piece.block, piece.attitude, *contexts)
        found += new
    return state, found


def finished(stage: Any, state: Any) -> list[tuple[int, Any]]:
    return stage.finish(state) if isinstance(stage, BaseStepDetector) else []


@pytest.mark.parametrize("name", PARTS)
def test_every_stage_of_a_recipe_passes_the_checks_for_stages_of_users(name: str) -> None:
    pdr.testing.verify_stage(PARTS[name])


@pytest.mark.parametrize("name", MODELS)
def test_every_step_length_of_a_recipe_passes_the_checks_for_models_of_users(name: str) -> None:
    pdr.testing.verify_step_length(MODELS[name])


@pytest.mark.parametrize("name", STAGES)
@settings(max_examples=4, deadline=None)
@given(edges=st.lists(st.integers(0, N - 1), max_size=60), seed=st.integers(0, 1000))
def test_what_a_stage_finds_does_not_depend_on_how_samples_arrive(name: str, edges: list[int], seed: int) -> None:
    stage, samples = STAGES[name], walk(seed)
    (state, whole), (cut_state, pieces) = run(stage, [samples]), run(stage, samples.cut(edges))
    assert len(whole) > 5
    assert bits(pieces) == bits(whole)
    assert bits(finished(stage, cut_state)) == bits(finished(stage, state))


@pytest.mark.parametrize("name", DETECTORS)
def test_finish_does_not_affect_a_running_detector_and_returns_nothing_before_the_first_sample(
    name: str,
) -> None:
    stage = DETECTORS[name]
    assert stage.finish(stage.init()) == []
    first, second = walk(9).cut([900])
    state, _ = run(stage, [first])
    expected = run(stage, [second], state)[1]
    stage.finish(state)
    assert bits(run(stage, [second], state)[1]) == bits(expected)
    assert len(expected) > 3


@pytest.mark.parametrize("name", CONTEXT_STAGES)
def test_after_a_gap_no_window_contains_earlier_samples(name: str) -> None:
    stage, samples = CONTEXT_STAGES[name], walk(11)
    first, second = samples.cut([777])
    state = stage.after_gap(run(stage, [first])[0])
    late = replace(second, block=replace(second.block, time_s=second.block.time_s + 60.0, gap_before_s=60.0))
    _, whole = run(stage, [late], state)
    assert bits(run(stage, [late.part(k, k + 50) for k in range(0, N - 777, 50)], state)[1]) == bits(whole)
    assert whole and all(i >= 0 and window.time_s >= late.block.time_s[0] for i, window in whole)


def test_the_list_of_stages_is_not_empty() -> None:
    assert len(DETECTORS) == len(recipes.RECIPES) and len(CONTEXT_STAGES) > 3
    assert isinstance(DETECTORS["steps of zhou2019"], ReferenceLineStepDetector)
    assert all(isinstance(step, Step) for _, step in run(DETECTORS["steps of default"], [walk(0)])[1])
