"""Step detectors and context stages of all recipes: any blocks, saving, gaps and clocks give the same results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import detect, uniform_block

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.recipes.zhou2019.steps import ReferenceLineStepDetector
from pdr_filter.sensing.steps.step_detector import BaseStepDetector, ContextBlock
from pdr_filter.testing import StageSamples, bits, stage_samples
from pdr_filter.values import CARRYING_MODES, CONTEXTS, Step

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


@pytest.mark.parametrize("name", PARTS)
def test_every_stage_of_a_recipe_passes_the_checks_for_stages_of_users(name: str) -> None:
    pdr.testing.verify_stage(PARTS[name])


@pytest.mark.parametrize("name", MODELS)
def test_every_step_length_of_a_recipe_passes_the_checks_for_models_of_users(name: str) -> None:
    pdr.testing.verify_step_length(MODELS[name])


RNG = np.random.default_rng(2)
RESTING = {
    "rest": np.full(1500, 9.80665),
    "free fall": np.zeros(1500),
    "slow drift": np.linspace(9.0, 11.0, 1500),
    "noise": 9.81 + RNG.normal(0.0, 0.1, 3000),
}


@pytest.mark.parametrize("what", RESTING)
@pytest.mark.parametrize("name", DETECTORS)
def test_a_phone_that_rests_falls_or_drifts_has_no_steps_in_any_carrying_mode(name: str, what: str) -> None:
    if (name, what) == ("steps of tian2016", "free fall"):
        pytest.skip("a fall from the first sample on is a valley, which this detector reports")
    detector, n = DETECTORS[name], len(RESTING[what])
    block = uniform_block(RESTING[what], rate=RNG.normal(0.0, 0.03, (n, 3)) * (what == "noise"))
    for carrying_mode in range(-1, len(CARRYING_MODES)):
        contexts = ContextBlock(np.full(n, CONTEXTS.index("walking")), np.full(n, carrying_mode))
        state, found = detect(detector, [block], [contexts])
        assert [*found, *detector.finish(state)] == []


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
    assert all(stage.finish(stage.init()) == [] for stage in DETECTORS.values())
    assert all(isinstance(step, Step) for _, step in run(DETECTORS["steps of default"], [walk(0)])[1])
