from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import conditioned, flat_attitude, uniform_block
from hypothesis import given, settings
from hypothesis import strategies as st

from pdr_filter.data.io.formats import read
from pdr_filter.recipes.zhou2019.contexts import (
    BEHAVIOURS,
    CARRIED,
    FOOT,
    BehaviourStage,
    BehaviourThresholds,
    context_of,
)
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.contexts.context_stage import WindowStageState
from pdr_filter.values import CONTEXTS, STANDARD_GRAVITY_MPS2, WindowContext

G = STANDARD_GRAVITY_MPS2
# Every condition has its own feature: variance 5, DC component 10, energy 7 for walking; 1 and 2 for irregular swing.
ANY = BehaviourThresholds(1.0, 10.0, 5.0, 7.0, 1.0, 2.0)


def at_rest(seconds: float, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(G, 0.02, round(100 * seconds))


def shaking(seconds: float, amplitude_mps2: float, mean_mps2: float = 0.0, frequency_hz: float = 1.0) -> np.ndarray:
    """|f| of a sinusoid: variance A^2 / 2, DC component the mean, energy A over whole periods."""
    t = np.arange(round(100 * seconds)) / 100
    return G + mean_mps2 + amplitude_mps2 * np.sin(2 * np.pi * frequency_hz * t)


def run(
    stage: BehaviourStage, blocks: list[UniformBlock], state: WindowStageState | None = None
) -> tuple[WindowStageState, list[tuple[int, WindowContext]]]:
    state, found = stage.init() if state is None else state, []
    for block in blocks:
        state, contexts = stage.update(state, block, flat_attitude(block.specific_force_mps2[:, 2]))
        found += contexts
    return state, found


def behaviour(context: WindowContext) -> str:
    if context.irregular_prob:
        return "irregular"
    name = CONTEXTS[int(np.argmax(context.prob))]
    return "standing" if name == "stationary" else name


def behaviours(stage: BehaviourStage, *parts: np.ndarray) -> list[str]:
    return [behaviour(c) for _, c in run(stage, [uniform_block(np.concatenate(parts))])[1]]


# --- Table 1 --------------------------------------------------------------------------------------------------------


@settings(max_examples=50, deadline=None)
@given(features=st.tuples(st.floats(0, 20), st.floats(-2, 20), st.floats(0, 20)))
def test_every_window_has_one_of_the_four_behaviours_as_the_nested_conditions_say(
    features: tuple[float, float, float],
) -> None:
    variance, f_0, energy = features
    if f_0 > 10.0:
        expected = "running"
    elif variance > 5.0 and energy > 7.0:
        expected = "walking"
    else:
        expected = "irregular" if f_0 > 1.0 and energy > 2.0 else "standing"
    assert ANY.classify(np.array(features)) == expected
    assert expected in BEHAVIOURS


def test_in_irregular_swing_nobody_moves() -> None:
    contexts = {name: context_of(name, 2.0) for name in BEHAVIOURS}
    named = {name: CONTEXTS[int(np.argmax(c.prob))] for name, c in contexts.items()}
    assert named == {"standing": "stationary", "walking": "walking", "running": "running", "irregular": "stationary"}
    assert {name: c.irregular_prob for name, c in contexts.items()} == {
        "standing": 0.0,
        "walking": 0.0,
        "running": 0.0,
        "irregular": 1.0,
    }
    for context in contexts.values():
        assert context.prob.sum() == 1.0
        assert np.ptp(context.carrying_prob) == 0.0  # nothing is known of it
        assert context.training_prior.sum() == pytest.approx(1.0)


# --- the machine ----------------------------------------------------------------------------------------------------


def test_each_behaviour_is_found_again_after_each_other() -> None:
    stage = BehaviourStage(thresholds=ANY)
    standing, walking = at_rest(10), shaking(10, 8.0)
    running, irregular = shaking(10, 8.0, mean_mps2=11.0), shaking(10, 3.0, mean_mps2=1.5)
    found = behaviours(stage, standing, walking, running, irregular, walking, standing, irregular)
    # windows 3 to 9 of each ten seconds hold nothing of the seconds before
    clean = [set(found[10 * k + 2 : 10 * k + 9]) for k in range(7)]
    names = ["standing", "walking", "running", "irregular", "walking", "standing", "irregular"]
    assert clean == [{name} for name in names]


def test_while_the_maximum_stays_the_behaviour_is_kept_whatever_the_features_say() -> None:
    # The second half has the maximum of the first, but a tenth of its variance: one peak in 2 s.
    t = np.arange(1000) / 100
    peaks = G + 8.0 * np.exp(-((((t + 1) % 2 - 1) / 0.1) ** 2))
    always = replace(ANY, max_change_mps2=0.0)  # every window is classified
    walking = shaking(10, 8.0)
    assert set(behaviours(BehaviourStage(thresholds=ANY), walking, peaks)[3:]) == {"walking"}
    assert set(behaviours(BehaviourStage(thresholds=ANY), peaks)[3:]) == {"standing"}
    assert set(behaviours(BehaviourStage(thresholds=always), walking, peaks)[12:]) == {"standing"}


def test_what_mixes_two_behaviours_is_not_kept_when_the_transition_ends() -> None:
    # Walking begins 0.25 s before a window ends: that window has too little variance, the maximum then stays the same.
    found = behaviours(BehaviourStage(thresholds=ANY), at_rest(9.5), shaking(10, 8.0, frequency_hz=2.0))
    assert "walking" not in found[:9]  # the ninth ends at 9.75 s
    assert set(found[10:]) == {"walking"}


def test_a_changed_maximum_alone_does_not_change_the_behaviour() -> None:
    blow = shaking(20, 8.0)
    blow[1000:1010] += 15.0
    assert set(behaviours(BehaviourStage(thresholds=ANY), blow)) == {"walking"}


def test_a_window_comes_every_second_with_its_last_sample_and_the_time_of_its_motion() -> None:
    _, found = run(BehaviourStage(thresholds=FOOT), [uniform_block(at_rest(10))])
    assert [index for index, _ in found] == list(range(199, 1000, 100))
    np.testing.assert_allclose([c.time_s for _, c in found], np.arange(1.75, 9.8))  # 0.25 s of filter


# --- blocks, gaps, saving -------------------------------------------------------------------------------------------

MIXED = uniform_block(np.concatenate([at_rest(5), shaking(5, 8.0), at_rest(4), shaking(5, 9.0, 11.0)]))


def test_after_a_gap_the_behaviour_has_to_show_anew_and_the_bias_stays() -> None:
    stage = BehaviourStage(thresholds=ANY)
    state, _ = run(stage, [MIXED])
    again = stage.after_gap(state)
    assert again.windows.bias_mps2 is state.windows.bias_mps2
    assert again.windows.bias_mps2 is not None
    _, found = run(stage, [uniform_block(at_rest(5))], again)
    assert {behaviour(c) for _, c in found} == {"standing"}


# --- real recordings ------------------------------------------------------------------------------------------------


def windows_of_file(path: Path, thresholds: BehaviourThresholds) -> tuple[np.ndarray, list[str]]:
    stage = BehaviourStage(thresholds=thresholds)
    state, found = stage.init(), []
    for block in conditioned(read(path)):
        state = stage.after_gap(state) if 0 < block.gap_before_s < np.inf else state
        state, contexts = run(stage, [block], state)
        found += contexts
    return np.array([c.time_s for _, c in found]), [behaviour(c) for _, c in found]


@pytest.mark.recordings
@pytest.mark.parametrize(
    ("what", "expected", "least"),
    [("std", {"standing", "irregular"}, 0.98), ("wlk", {"walking"}, 0.9), ("jog", {"running"}, 0.75)],
)
def test_people_left_out_stand_walk_and_run_with_the_phone_in_the_pocket(
    data_dir: Path, what: str, expected: set[str], least: float
) -> None:
    found = [
        name
        for person in (7, 9, 10, 11)  # the thresholds were found on persons 1 to 6
        for path in sorted((data_dir / "motionsense").glob(f"*_s{person:02d}_{what}_*.zip"))[:1]
        for name in windows_of_file(path, CARRIED)[1]
    ]
    assert len(found) > 80
    assert np.mean([name in expected for name in found]) > least


@pytest.mark.recordings
def test_a_foot_stands_before_the_walk_and_walks_while_motion_capture_sees_it_move(data_dir: Path) -> None:
    n_walking = n_moving = n_standing = n_still = 0
    for path in sorted((data_dir / "pyshoe").glob("*.zip"))[1:8:2]:
        truth = read(path).truth.position
        at_s, names = windows_of_file(path, FOOT)
        for time_s, name in zip(at_s, names, strict=True):
            inside = (truth.time_s > time_s - 2) & (truth.time_s < time_s)
            place = np.column_stack([truth.east_m, truth.north_m])[inside]
            if len(place) < 380:
                continue
            halves_m = [float(np.ptp(half, axis=0).max()) for half in (place[:200], place[200:])]
            n_moving += min(halves_m) > 0.15
            n_walking += min(halves_m) > 0.15 and name == "walking"
            n_still += max(halves_m) < 0.01
            n_standing += max(halves_m) < 0.01 and name == "standing"
    assert n_moving > 50
    assert n_walking >= 0.98 * n_moving
    assert n_still > 0
    assert n_standing >= 0.8 * n_still
