"""Step detectors and context stages of all recipes: any blocks, saving, gaps and clocks give the same results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.recipes.zhou2019.steps import ReferenceLineStepDetector
from pdr_filter.sensing.attitude import AttitudeBlock, AttitudeEstimator
from pdr_filter.sensing.conditioning import Conditioner, UniformBlock
from pdr_filter.sensing.steps.step_detector import BaseStepDetector, ContextBlock
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import CARRYING_MODES, CONTEXTS, Step
from pdr_filter.values.serialisation import from_bytes, to_bytes

SENSING = {name: recipe(recipes.Subject(height_m=1.75)).sensing for name, recipe in recipes.RECIPES.items()}
DETECTORS = {f"steps of {name}": sensing.steps for name, sensing in SENSING.items()}
CONTEXT_STAGES = {f"contexts of {name}": sensing.contexts for name, sensing in SENSING.items() if sensing.contexts}
STAGES: dict[str, Any] = {**DETECTORS, **CONTEXT_STAGES}
N = 1800


@dataclass(frozen=True)
class Samples:
    """What a stage gets of some samples."""

    block: UniformBlock
    attitude: AttitudeBlock
    contexts: ContextBlock

    def part(self, a: int, b: int) -> Samples:
        """Of some samples alone; the gap before the first one is not repeated."""

        def cut(columns: Any) -> Any:
            values = {f.name: getattr(columns, f.name) for f in fields(columns)}
            return replace(columns, **{n: v[a:b] for n, v in values.items() if isinstance(v, np.ndarray) and len(v)})

        block = cut(self.block)
        return Samples(
            replace(block, gap_before_s=block.gap_before_s if a == 0 else 0.0), cut(self.attitude), cut(self.contexts)
        )

    def cut(self, edges: Sequence[int]) -> list[Samples]:
        """In non-empty pieces."""
        return [self.part(a, b) for a, b in pairwise(sorted({0, *(e % N for e in edges), N}))]


@cache
def walk(seed: int) -> Samples:
    """18 s of a noisy walk, the phone is taken out of a pocket; its turn is unknown for a second."""
    legs = [Leg("walking", distance_m=15.0), Leg("walking", distance_m=15.0, carrying_mode="texting")]
    recording = simulate(legs, carrying_mode="pocket", seed=seed % 3)
    conditioner = Conditioner()
    state, blocks = conditioner.update(conditioner.init(), pdr.merge_streams(recording))
    (block,) = [*blocks, *conditioner.finish(state)[1]][:1]
    names = [f.name for f in fields(block) if f.name != "gap_before_s"]
    block = replace(block, **{name: np.array(getattr(block, name)[:N]) for name in names})
    assert len(block.time_s) == N
    rng = np.random.default_rng(seed)
    block.specific_force_mps2[:] += 0.5 * rng.normal(size=(N, 3))
    block.angular_rate_known[600:700] = False
    estimator = AttitudeEstimator()
    _, attitude = estimator.update(estimator.init(), block)
    carried = np.array([CARRYING_MODES.index(mode) for mode in ("pocket", "texting", "swinging")])
    mode = carried[np.arange(N) // 350 % 3]
    return Samples(block, attitude, ContextBlock(np.full(N, CONTEXTS.index("walking")), mode))


def run(stage: Any, pieces: Sequence[Samples], state: Any = None) -> tuple[Any, list[tuple[int, Any]]]:
    """New state, and steps or windows with the sample that revealed each."""
    state, found = stage.init() if state is None else state, []
    for piece in pieces:
        contexts = (piece.contexts,) if isinstance(stage, BaseStepDetector) else ()
        state, new = stage.update(state, piece.block, piece.attitude, *contexts)
        found += new
    return state, found


def finished(stage: Any, state: Any) -> list[tuple[int, Any]]:
    return stage.finish(state) if isinstance(stage, BaseStepDetector) else []


def bits(found: list[tuple[int, Any]]) -> bytes:
    return to_bytes(tuple(found))


@pytest.mark.parametrize("name", STAGES)
@settings(max_examples=10, deadline=None)
@given(edges=st.lists(st.integers(0, N - 1), max_size=60), seed=st.integers(0, 1000))
def test_what_a_stage_finds_does_not_depend_on_how_samples_arrive(name: str, edges: list[int], seed: int) -> None:
    stage, samples = STAGES[name], walk(seed)
    (state, whole), (cut_state, pieces) = run(stage, [samples]), run(stage, samples.cut(edges))
    assert len(whole) > 5
    assert bits(pieces) == bits(whole)
    assert bits(finished(stage, cut_state)) == bits(finished(stage, state))


@pytest.mark.parametrize("name", STAGES)
def test_sample_by_sample_gives_the_same_bits_as_the_whole(name: str) -> None:
    stage, samples = STAGES[name], walk(5).part(0, 900)
    assert bits(run(stage, [samples.part(k, k + 1) for k in range(900)])[1]) == bits(run(stage, [samples])[1])


@pytest.mark.parametrize("at", [1, 430, 903, 1333])
@pytest.mark.parametrize("name", STAGES)
def test_a_stage_that_is_saved_and_loaded_goes_on_as_if_nothing_had_been(name: str, at: int) -> None:
    stage, samples = STAGES[name], walk(7)
    first, second = samples.cut([at])
    state, before = run(stage, [first])
    loaded = from_bytes(to_bytes(stage))
    state, after = run(loaded, [second], from_bytes(to_bytes(state)))
    whole_state, whole = run(stage, [samples])
    assert bits([*before, *after, *finished(loaded, state)]) == bits([*whole, *finished(stage, whole_state)])


@pytest.mark.parametrize("name", DETECTORS)
def test_finishing_changes_nothing_for_a_filter_that_goes_on_and_finds_nothing_before_the_first_sample(
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
def test_after_a_gap_no_window_is_of_before_however_samples_arrive(name: str) -> None:
    stage, samples = CONTEXT_STAGES[name], walk(11)
    first, second = samples.cut([777])
    state = stage.after_gap(run(stage, [first])[0])
    late = replace(second, block=replace(second.block, time_s=second.block.time_s + 60.0, gap_before_s=60.0))
    _, whole = run(stage, [late], state)
    assert bits(run(stage, [late.part(k, k + 50) for k in range(0, N - 777, 50)], state)[1]) == bits(whole)
    assert whole and all(i >= 0 and window.time_s >= late.block.time_s[0] for i, window in whole)


@pytest.mark.parametrize("name", STAGES)
def test_a_shift_of_the_time_base_shifts_what_is_found(name: str) -> None:
    stage, samples = STAGES[name], walk(13)
    late = replace(samples, block=replace(samples.block, time_s=samples.block.time_s + 1024.0))
    here, there = (run(stage, [s])[1] for s in (samples, late))
    assert [i for i, _ in there] == [i for i, _ in here]
    np.testing.assert_allclose([e.time_s for _, e in there], [e.time_s + 1024.0 for _, e in here], atol=1e-9)
    if isinstance(stage, BaseStepDetector):
        np.testing.assert_allclose([e.detected_time_s for _, e in there], [e.detected_time_s + 1024.0 for _, e in here])
        np.testing.assert_allclose([e.duration_s for _, e in there], [e.duration_s for _, e in here], atol=1e-9)


def test_there_are_stages() -> None:
    assert len(DETECTORS) == len(recipes.RECIPES) and len(CONTEXT_STAGES) > 3
    assert isinstance(DETECTORS["steps of zhou2019"], ReferenceLineStepDetector)
    assert all(isinstance(step, Step) for _, step in run(DETECTORS["steps of default"], [walk(0)])[1])
